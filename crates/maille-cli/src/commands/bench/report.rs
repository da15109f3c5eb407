//! The report of `maille bench metrics`, as a page and as a table in Markdown.

use super::metrics::{HEAD, Outcome, attribute_cells, attribute_heads, cells, level_name, meaning};
use crate::commands::report::{
    Card, Gallery, HeatScale, Page, Series, Trials, bar, command_line, count, escape, log_log, table,
};
use crate::output::number;

/// What the page tells.
pub(super) struct Report<'a> {
    pub(super) levels: &'a [Vec<Outcome>],
    pub(super) trials: &'a Trials<'a>,
    pub(super) cards: &'a [Card],
    pub(super) scale: HeatScale,
    /// Of a picture, in pixels.
    pub(super) size: (u32, u32),
    /// Triangles that the pictures show.
    pub(super) pictured: usize,
}

impl Report<'_> {
    pub(super) fn html(&self) -> String {
        let name = self.trials.path.file_name().unwrap_or_default().to_string_lossy();
        let heading = format!("{name}: {} ways to simplify it", self.levels[0].len());
        let mut page = Page::new(&heading, &heading, &self.lead());
        let cards: Vec<&Card> = self.cards.iter().collect();
        let pictured = format!("Pictures: {} triangles", count(self.pictured));
        page.add(&format!("<h2>{pictured}, the best first</h2>\n"));
        page.add(&Gallery { cards: &cards, pairs: false, size: self.size, scale: self.scale }.html());
        if self.levels.len() > 1 {
            page.section("Error over triangles", &self.curves());
        }
        for level in self.levels {
            page.section(&level_name(level, self.trials), &self.level(level));
        }
        page.section("How it was made", &format!("<pre><code>{}</code></pre>\n", escape(&command_line())));
        page.finish("The same figures as JSON are beside this page.")
    }

    fn lead(&self) -> String {
        let best: Vec<String> = (self.levels.iter())
            .filter_map(|level| level.first())
            .map(|best| format!("{} at {} triangles", best.way.name(), count(best.target)))
            .collect();
        format!(
            "{} triangles, simplified by edge collapse in different ways and measured against the original. Nearest in the root \
             mean square: {}.",
            count(self.trials.original.triangle_count()),
            escape(&best.join(", "))
        )
    }

    fn level(&self, level: &[Outcome]) -> String {
        let worst = level.last().map_or(1.0, |outcome| outcome.trial.comparison.rms()).max(f64::MIN_POSITIVE);
        let row = |outcome: &Outcome| {
            let mut cells = cells(outcome);
            cells[4] = bar(&cells[4], outcome.trial.comparison.rms() / worst);
            cells.extend(attribute_cells(outcome));
            cells
        };
        let attributes: Vec<String> = attribute_heads(self.levels).iter().map(|name| escape(name)).collect();
        let head: Vec<&str> = HEAD.into_iter().chain(attributes.iter().map(String::as_str)).collect();
        let caption = escape(&meaning(self.trials, self.levels));
        let rows: Vec<Vec<String>> = level.iter().map(row).collect();
        let missed = level.iter().filter(|outcome| outcome.trial.report.triangles_out > outcome.target);
        let missed: Vec<String> = missed
            .map(|o| format!("{} stopped at {} triangles", o.way.name(), count(o.trial.report.triangles_out)))
            .collect();
        let note = match missed.is_empty() {
            true => String::new(),
            false => format!("<p class=\"note\">{}.</p>\n", escape(&missed.join("; "))),
        };
        format!("{}{note}{}", table(&caption, &head, &rows), scatter(level))
    }

    fn curves(&self) -> String {
        let plot = |what: &str, distance: fn(&Outcome) -> f64| {
            let mut series: Vec<Series> = Vec::new();
            for outcome in self.levels.iter().flatten() {
                let point = (outcome.trial.report.triangles_out as f64, distance(outcome));
                if point.1 <= 0.0 {
                    continue;
                }
                let name = outcome.way.name();
                match series.iter_mut().find(|s| s.name == name) {
                    Some(series) => series.points.push(point),
                    None => series.push(Series { name, points: vec![point] }),
                }
            }
            series.iter_mut().for_each(|s| s.points.sort_by(|a, b| a.0.total_cmp(&b.0)));
            let alt = format!("{what} distance over the number of triangles, logarithmic, one line to each way");
            let svg = log_log(&series, "triangles", &format!("{what} distance, millionths of the diagonal"), &alt);
            format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n")
        };
        let rms = plot("RMS", |o| millionths(o, o.trial.comparison.rms()));
        let max = plot("largest", |o| millionths(o, o.trial.comparison.max()));
        format!("<div class=\"columns\">\n{rms}{max}</div>\n")
    }
}

fn millionths(outcome: &Outcome, distance: f64) -> f64 {
    1e6 * outcome.trial.comparison.relative(distance)
}

/// What the time buys.
fn scatter(level: &[Outcome]) -> String {
    let point = |outcome: &Outcome| {
        let rms = millionths(outcome, outcome.trial.comparison.rms());
        (rms > 0.0).then(|| Series { name: outcome.way.name(), points: vec![(1e3 * outcome.trial.seconds, rms)] })
    };
    let series: Vec<Series> = level.iter().filter_map(point).collect();
    let alt = "RMS distance over time, logarithmic, one dot to each way";
    let svg = log_log(&series, "milliseconds", "RMS distance, millionths of the diagonal", alt);
    format!(
        "<details><summary>RMS distance over time</summary>\n<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n</details>\n"
    )
}

/// The tables of all levels, for documents.
pub(super) fn markdown(levels: &[Vec<Outcome>], trials: &Trials<'_>) -> String {
    let mut text = String::new();
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    for level in levels {
        let mut head = HEAD.map(str::to_owned).to_vec();
        head.extend(attribute_heads(levels));
        let rule: Vec<String> = (0..head.len()).map(|i| if i < 2 { "---" } else { "---:" }.to_owned()).collect();
        text += &format!("{}:\n\n{}{}", level_name(level, trials), line(&head), line(&rule));
        for outcome in level {
            let mut cells = cells(outcome);
            for name in &mut cells[..2] {
                *name = format!("`{name}`");
            }
            cells.extend(attribute_cells(outcome));
            text += &line(&cells);
        }
        text.push('\n');
    }
    let diagonal = number(trials.surface.diagonal());
    text + &format!("{} The diagonal is {diagonal} units long.\n", meaning(trials, levels))
}
