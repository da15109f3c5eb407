//! What the demo tells.

use maille::measure::Comparison;

use super::character::Character;
use super::history::{self, History};
use super::{Level, PICTURE};
use crate::commands::report::{Gallery, HeatScale, Page, Series, count, log_log, percent, table};
use crate::output::{bytes, seconds};

/// What the report tells.
pub(super) struct Report<'a> {
    pub(super) levels: &'a [Level],
    pub(super) character: &'a Character,
    pub(super) history: &'a History,
    pub(super) samples: u64,
    pub(super) scale: HeatScale,
}

impl Report<'_> {
    pub(super) fn html(&self) -> String {
        let (first, last) = (count(self.original().triangles), count(self.coarsest().triangles));
        let title = format!("Maille: from {first} triangles to {last}");
        let mut page = Page::new(&title, "One statue, five levels of detail", &self.lead());
        let cards: Vec<_> = self.levels.iter().map(|level| &level.card).collect();
        let size = (PICTURE.0 / 2, PICTURE.1 / 2);
        page.add(&Gallery { cards: &cards, pairs: false, size, scale: self.scale }.html());
        page.section("Figures", &self.figures());
        page.section("Error over triangles", &self.plot());
        page.section("A character in levels of detail", &self.character.html());
        page.section("Then and now", &self.history());
        page.section("Do it yourself", &self.commands());
        page.finish("The .glb files are beside this page.")
    }

    fn original(&self) -> &Level {
        self.levels.first().expect("the original is the first level")
    }

    fn coarsest(&self) -> &Level {
        self.levels.last().expect("the original is the first level")
    }

    fn lead(&self) -> String {
        let tenth = self.levels.iter().find(|level| level.percent == 10).unwrap_or(self.coarsest());
        let figure = tenth.comparison.as_ref().map_or(0.0, |c| c.relative(c.mean()));
        format!(
            "{} triangles, simplified by edge collapse and measured against the original. With a tenth of the triangles the \
             surface is off by {} of the model's diagonal on average; that took {}.",
            count(self.original().triangles),
            percent(figure),
            tenth.seconds.map_or(String::new(), seconds)
        )
    }

    fn figures(&self) -> String {
        let row = |level: &Level| {
            let c = level.comparison.as_ref();
            let share =
                |distance: fn(&Comparison) -> f64| c.map_or(String::new(), |c| percent(c.relative(distance(c))));
            let volume = c.filter(|c| c.a.volume != 0.0).map(|c| 100.0 * (c.b.volume - c.a.volume) / c.a.volume);
            vec![
                count(level.triangles),
                format!("{} %", level.percent),
                format!("<a href=\"{0}\">{1}</a>", level.file, bytes(level.bytes)),
                level.seconds.map_or(String::new(), seconds),
                share(Comparison::mean),
                share(Comparison::rms),
                share(Comparison::max),
                c.map_or(String::new(), |c| format!("{:.1}°", c.normal_deg())),
                volume.map_or(String::new(), |change| format!("{change:+.3} %")),
            ]
        };
        let caption = format!(
            "Distances in percent of the diagonal of the bounding box, the larger of both directions; {} points sampled on \
             each surface. Normals: mean angle between corresponding triangles. Time: simplification alone, each level from \
             the original.",
            count(self.samples)
        );
        let head = ["Triangles", "Share", "File", "Time", "Mean", "RMS", "Maximum", "Normals", "Volume"];
        table(&caption, &head, &self.levels.iter().map(row).collect::<Vec<_>>())
    }

    fn plot(&self) -> String {
        let series = |name: &str, distance: fn(&Comparison) -> f64| Series {
            name: name.to_owned(),
            points: (self.levels.iter())
                .filter_map(|level| {
                    let c = level.comparison.as_ref()?;
                    Some((level.triangles as f64, 100.0 * c.relative(distance(c)))).filter(|point| point.1 > 0.0)
                })
                .collect(),
        };
        let all =
            [series("mean", Comparison::mean), series("RMS", Comparison::rms), series("maximum", Comparison::max)];
        let what = "Distance over the number of triangles, logarithmic: mean, RMS and maximum";
        let svg = log_log(&all, "triangles", "distance, % of the diagonal", what);
        format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n")
    }

    fn history(&self) -> String {
        let row = |entry: &history::Row| {
            vec![
                entry.name.to_owned(),
                format!("{} ms", count(entry.milliseconds_then)),
                format!("{:.1} ms", entry.milliseconds_now),
                format!("{:.0} x", f64::from(entry.milliseconds_then) / entry.milliseconds_now),
                percent(entry.mean),
                percent(entry.rms),
                percent(entry.max),
            ]
        };
        let caption = format!(
            "Time: mean of {} runs. Distances: at {} % of the triangles, in percent of the diagonal; the thesis gives none.",
            history::REPEATS,
            history::MEASURED_PERCENT
        );
        let head = ["Metric", "2000", "Now", "Faster", "Mean", "RMS", "Maximum"];
        format!(
            "<p>The thesis that Maille grew out of timed five metrics on a model of {} triangles, on a 600 MHz Athlon in 2000. \
             Here they are on a statue of {}, simplified as far as it goes.</p>\n{}",
            count(history::TRIANGLES),
            count(self.history.triangles),
            table(&caption, &head, &self.history.rows.iter().map(row).collect::<Vec<_>>())
        )
    }

    fn commands(&self) -> String {
        format!(
            "<pre><code>maille simplify {0} -o small.glb --ratio 10% --report report.html\n\
             maille compare {0} {1} --heatmap error.glb\nmaille lod character.glb -o levels.glb --geomorph\nmaille bench metrics {0} -o metrics.html</code></pre>\n",
            self.original().file,
            self.coarsest().file
        )
    }
}
