//! A figure line: for people, for machines, and for the record.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;

/// Where the lines go.
#[derive(Args)]
pub struct OutputArgs {
    /// Print one JSON object per line instead of a table.
    #[arg(long)]
    json: bool,
    /// Also write the lines to a CSV file, for `benches/records`.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

/// A line of figures.
pub trait Row: Serialize {
    /// Heads of the columns, as wide as the columns.
    fn heads() -> String;

    /// The line under them.
    fn line(&self) -> String;
}

/// Writes lines as they come.
pub struct Table {
    json: bool,
    csv: Option<BufWriter<File>>,
    lines: usize,
}

impl Table {
    pub fn new(args: &OutputArgs) -> Result<Self> {
        let create = |path: &PathBuf| File::create(path).with_context(|| path.display().to_string());
        let csv = args.csv.as_ref().map(create).transpose()?.map(BufWriter::new);
        Ok(Self { json: args.json, csv, lines: 0 })
    }

    pub fn print<R: Row>(&mut self, row: &R) -> Result<()> {
        if self.json {
            println!("{}", serde_json::to_string(row)?);
        } else {
            if self.lines == 0 {
                println!("{}", R::heads());
            }
            println!("{}", row.line());
        }
        if let Some(csv) = &mut self.csv {
            let fields = fields(row)?;
            if self.lines == 0 {
                writeln!(csv, "{}", fields.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(","))?;
            }
            writeln!(csv, "{}", fields.into_iter().map(|(_, value)| value).collect::<Vec<_>>().join(","))?;
            csv.flush()?;
        }
        self.lines += 1;
        Ok(())
    }

    /// A sentence for people, below the table.
    pub fn say(&self, sentence: &str) {
        if !self.json {
            println!("{sentence}");
        }
    }
}

/// Names and values of the fields in their order. Names of meshes and tools need no quotes: commas are replaced.
fn fields<R: Row>(row: &R) -> Result<Vec<(String, String)>> {
    let serde_json::Value::Object(fields) = serde_json::to_value(row)? else {
        unreachable!("rows are structs with named fields")
    };
    let text = |value| match value {
        serde_json::Value::String(text) => text.replace(',', ";"),
        serde_json::Value::Null => String::new(),
        number => number.to_string(),
    };
    Ok(fields.into_iter().map(|(name, value)| (name, text(value))).collect())
}

/// The middle of some figures, or the mean of the two in the middle; NaN of none.
pub fn median(figures: &mut [f64]) -> f64 {
    figures.sort_by(f64::total_cmp);
    match figures {
        [] => f64::NAN,
        _ => 0.5 * (figures[(figures.len() - 1) / 2] + figures[figures.len() / 2]),
    }
}

/// A number with three digits that count.
pub fn three_digits(x: f64) -> String {
    let digits = if x > 0.0 { (2.0 - x.log10().floor()).clamp(0.0, 4.0) as usize } else { 0 };
    format!("{x:.digits$}")
}
