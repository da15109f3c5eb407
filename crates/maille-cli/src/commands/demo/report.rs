//! The report: one HTML file that holds its pictures and asks for nothing from the network.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maille::measure::{Comparison, viridis};

use super::history::{self, History};
use super::plot::{self, Series};
use super::{COLDEST, HOTTEST, Level, PICTURE};
use crate::output::{bytes, count, seconds};

/// What the report tells.
pub(super) struct Report<'a> {
    pub(super) levels: &'a [Level],
    pub(super) history: &'a History,
    pub(super) samples: u64,
}

impl Report<'_> {
    pub(super) fn html(&self) -> String {
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n<title>Maille: from {} triangles to {}</title>\n\
             <style>{STYLE}</style>\n</head>\n<body>\n",
            count(self.original().triangles),
            count(self.coarsest().triangles)
        );
        page += &self.opening();
        page += &self.gallery();
        page += &self.figures();
        page += &self.plot();
        page += &self.history();
        page += &self.colophon();
        page += "</body>\n</html>\n";
        page
    }

    fn original(&self) -> &Level {
        self.levels.first().expect("the original is the first level")
    }

    fn coarsest(&self) -> &Level {
        self.levels.last().expect("the original is the first level")
    }

    fn opening(&self) -> String {
        let tenth = self.levels.iter().find(|level| level.percent == 10).unwrap_or(self.coarsest());
        let figure = tenth.comparison.as_ref().map_or(0.0, |c| c.relative(c.mean()));
        format!(
            "<header>\n<p class=\"brand\">Maille</p>\n<h1>One statue, five levels of detail</h1>\n\
             <p class=\"lead\">{} triangles, simplified by edge collapse and measured against the original. With a tenth \
             of the triangles the surface is off by {} of the model's diagonal on average; that took {}.</p>\n</header>\n",
            count(self.original().triangles),
            percent(figure),
            tenth.seconds.map_or(String::new(), seconds)
        )
    }

    fn gallery(&self) -> String {
        let mut html = String::from("<section class=\"gallery\" aria-label=\"Pictures\">\n");
        for (i, (id, name)) in [("shaded", "Shaded"), ("wireframe", "Wireframe"), ("error", "Error")].iter().enumerate()
        {
            let checked = if i == 0 { " checked" } else { "" };
            let _ = writeln!(
                html,
                "<input type=\"radio\" name=\"mode\" id=\"{id}\"{checked}><label for=\"{id}\">{name}</label>"
            );
        }
        html += &scale();
        html += "<div class=\"levels\">\n";
        for level in self.levels {
            html += &card(level);
        }
        html + "</div>\n</section>\n"
    }

    fn figures(&self) -> String {
        let mut html = String::from(
            "<section>\n<h2>Figures</h2>\n<div class=\"scroll\"><table>\n<thead><tr><th>Triangles</th><th>Share</th>\
             <th>File</th><th>Time</th><th>Mean</th><th>RMS</th><th>Maximum</th><th>Normals</th><th>Volume</th></tr></thead>\n<tbody>\n",
        );
        for level in self.levels {
            let c = level.comparison.as_ref();
            let share =
                |distance: fn(&Comparison) -> f64| c.map_or(String::new(), |c| percent(c.relative(distance(c))));
            let volume = c.filter(|c| c.a.volume != 0.0).map(|c| 100.0 * (c.b.volume - c.a.volume) / c.a.volume);
            let cells = [
                count(level.triangles),
                format!("{} %", level.percent),
                format!("<a href=\"{0}\">{1}</a>", level.file, bytes(level.bytes)),
                level.seconds.map_or(String::new(), seconds),
                share(Comparison::mean),
                share(Comparison::rms),
                share(Comparison::max),
                c.map_or(String::new(), |c| format!("{:.1}°", c.normal_deg())),
                volume.map_or(String::new(), |change| format!("{change:+.3} %")),
            ];
            html += &row(&cells);
        }
        let _ = write!(
            html,
            "</tbody>\n</table></div>\n<p class=\"note\">Distances in percent of the diagonal of the bounding box, the larger of \
             both directions; {} points sampled on each surface. Normals: mean angle between corresponding triangles. \
             Time: simplification alone, each level from the original, on one thread.</p>\n</section>\n",
            count(self.samples)
        );
        html
    }

    fn plot(&self) -> String {
        let series = |name, class, distance: fn(&Comparison) -> f64| Series {
            name,
            class,
            points: (self.levels.iter())
                .filter_map(|level| {
                    let c = level.comparison.as_ref()?;
                    Some((level.triangles as f64, 100.0 * c.relative(distance(c)))).filter(|point| point.1 > 0.0)
                })
                .collect(),
        };
        let all = [
            series("maximum", "s3", Comparison::max),
            series("RMS", "s2", Comparison::rms),
            series("mean", "s1", Comparison::mean),
        ];
        let svg = plot::log_log(&all, "triangles", "distance, % of the diagonal");
        format!("<section>\n<h2>Error over triangles</h2>\n<div class=\"scroll\">{svg}</div>\n</section>\n")
    }

    fn history(&self) -> String {
        let mut html = format!(
            "<section>\n<h2>Then and now</h2>\n<p>The thesis that Maille grew out of timed five metrics on a model of {} \
             triangles, on a 600 MHz Athlon in 2000. Here they are on a statue of {}, simplified as far as it goes.</p>\n\
             <div class=\"scroll\"><table>\n<thead><tr><th>Metric</th><th>2000</th><th>Now</th><th>Faster</th><th>Mean</th>\
             <th>RMS</th><th>Maximum</th></tr></thead>\n<tbody>\n",
            count(history::TRIANGLES),
            count(self.history.triangles)
        );
        for entry in &self.history.rows {
            let cells = [
                entry.name.to_owned(),
                format!("{} ms", count(entry.milliseconds_then)),
                format!("{:.1} ms", entry.milliseconds_now),
                format!("{:.0} x", f64::from(entry.milliseconds_then) / entry.milliseconds_now),
                percent(entry.mean),
                percent(entry.rms),
                percent(entry.max),
            ];
            html += &row(&cells);
        }
        let _ = write!(
            html,
            "</tbody>\n</table></div>\n<p class=\"note\">Time: mean of {} runs, one thread. Distances: at {} % of the triangles, in \
             percent of the diagonal; the thesis gives none.</p>\n</section>\n",
            history::REPEATS,
            history::MEASURED_PERCENT
        );
        html
    }

    fn colophon(&self) -> String {
        let (original, coarsest) = (self.original(), self.coarsest());
        format!(
            "<section>\n<h2>Do it yourself</h2>\n<pre><code>maille simplify {0} -o small.glb --ratio 10%\n\
             maille compare {0} {1} --heatmap error.glb\nmaille info {1}</code></pre>\n</section>\n\
             <footer>Made by maille {2}. The .glb files are beside this page.</footer>\n",
            original.file,
            coarsest.file,
            env!("CARGO_PKG_VERSION")
        )
    }
}

fn card(level: &Level) -> String {
    let picture = |mode: &str, png: &[u8], what: &str| {
        format!(
            "<img class=\"{mode}\" width=\"{}\" height=\"{}\" alt=\"{what} of the statue with {} triangles\" \
             src=\"data:image/png;base64,{}\">\n",
            PICTURE.0 / 2,
            PICTURE.1 / 2,
            level.triangles,
            STANDARD.encode(png)
        )
    };
    let caption = match &level.comparison {
        None => "the original".to_owned(),
        Some(c) => format!("mean error {}", percent(c.relative(c.mean()))),
    };
    format!(
        "<figure>\n{}{}{}<figcaption><b>{}</b> triangles<br>{caption}</figcaption>\n</figure>\n",
        picture("shaded", &level.pictures.shaded, "Shaded picture"),
        picture("wireframe", &level.pictures.wireframe, "Wireframe"),
        picture("error", &level.pictures.error, "Distance map"),
        count(level.triangles)
    )
}

/// The legend of the error pictures.
fn scale() -> String {
    const STOPS: usize = 9;
    let stop = |i: usize| {
        let [r, g, b] = viridis(i as f32 / (STOPS - 1) as f32).map(|x| (255.0 * x).round() as u8);
        format!("rgb({r} {g} {b})")
    };
    let stops: Vec<String> = (0..STOPS).map(stop).collect();
    let decades = (HOTTEST / COLDEST).log10().round() as i32;
    let labels: String = (0..=decades).map(|i| format!("<span>{}</span>", percent(COLDEST * 10_f64.powi(i)))).collect();
    format!(
        "<div class=\"scale\"><div style=\"background:linear-gradient(to right,{})\"></div><p>{labels}</p></div>\n",
        stops.join(",")
    )
}

fn row(cells: &[String]) -> String {
    let cells: String = cells
        .iter()
        .enumerate()
        .map(|(i, cell)| match i {
            0 => format!("<th scope=\"row\">{cell}</th>"),
            _ => format!("<td>{cell}</td>"),
        })
        .collect();
    format!("<tr>{cells}</tr>\n")
}

/// A share as a percentage of three digits.
fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent <= 0.0 || !percent.is_finite() {
        return "0\u{202f}%".to_owned();
    }
    let digits = (2 - percent.log10().floor() as i32).clamp(0, 7) as usize;
    let text = format!("{percent:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}\u{202f}%")
}

const STYLE: &str = include_str!("report.css");
