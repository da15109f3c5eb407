//! The kit that reports are made of: one HTML file that holds its pictures and asks for nothing from the network.
//!
//! | file | holds |
//! |---|---|
//! | `page` | the page, its sections and tables; text into HTML |
//! | `plot` | lines over logarithmic or linear axes, bars; as SVG that follows the colours of the page |
//! | `studio` | pictures of an asset and of what became of it, by the same cameras; distances as colours |
//! | `gallery` | those pictures on the page |
//! | `trial` | a simplification, timed and measured against the original |
//! | `figures` | figures as JSON, the same in every command |

mod figures;
mod gallery;
mod page;
mod plot;
mod studio;
mod trial;

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{is_same_file, refuse_folder};
use crate::failure::Failure;
use crate::session::Session;

pub(crate) use figures::{angle_bins, attributes_json, attributes_rows, comparison_json, curve_json};
pub(crate) use gallery::{Card, Gallery, Picture, Shot, film};
pub(crate) use page::{Page, bar, command_line, count, escape, facts, percent, settings, table};
pub(crate) use plot::{Bars, Series, histogram, linear, log_log};
pub(crate) use studio::{HeatScale, Look, Model, Studio};
pub(crate) use trial::{Trial, Trials};

/// Where a report goes: an HTML file, and the same figures as JSON beside it.
pub(crate) struct ReportFiles {
    html: PathBuf,
    json: PathBuf,
}

impl ReportFiles {
    /// Refuses what cannot be written, before any work is done. `others` are files that the command reads or writes.
    pub(crate) fn new(html: &Path, others: &[&Path]) -> Result<Self, Failure> {
        let usage = |problem: &str| Err(Failure::Usage(format!("{}: {problem}", html.display())));
        if html.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("html")) {
            return usage("reports are HTML, so the name must end in .html");
        }
        refuse_folder(html, "report.html")?;
        if others.iter().any(|other| is_same_file(other, html) || *other == html) {
            return usage("this is one of the files of the work; choose another name for the report");
        }
        Session::check_place(html)?;
        Ok(Self { html: html.to_owned(), json: html.with_extension("json") })
    }

    /// Writes both, whole or not at all.
    pub(crate) fn write(&self, session: &Session, page: &str, figures: &Value) -> Result<(), Failure> {
        let figures = format!("{figures:#}\n");
        session.write_together(&[(page.as_bytes(), &self.html), (figures.as_bytes(), &self.json)])
    }

    /// The files, the page first.
    pub(crate) fn files(&self) -> [&Path; 2] {
        [&self.html, &self.json]
    }
}
