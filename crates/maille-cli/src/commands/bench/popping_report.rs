//! The page of `maille bench popping`.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use maille::measure::viridis;

use super::popping::{BAR, HEAD, Switch, cells, largest_ratio, meaning};
use crate::args::PoppingArgs;
use crate::commands::report::{Page, Series, bar, command_line, count, escape, linear, table};
use crate::render::{Picture, encoded};

/// What the page tells.
pub(super) struct Report<'a> {
    pub(super) args: &'a PoppingArgs,
    pub(super) switches: &'a [Switch],
}

impl Report<'_> {
    pub(super) fn html(&self) -> String {
        let name = self.args.input.file_name().unwrap_or_default().to_string_lossy();
        let heading = format!("{name}: popping of {} levels", self.switches.len());
        let mut page = Page::new(&heading, &heading, &self.lead());
        page.section("Figures", &self.figures());
        page.section("From frame to frame", &self.plot());
        for switch in self.switches {
            let [finer, coarser] = switch.triangles.map(count);
            page.section(&format!("{finer} to {coarser} triangles"), &pictures(switch));
        }
        page.section("How it was made", &format!("<pre><code>{}</code></pre>\n", escape(&command_line())));
        page.finish("The same figures as JSON are beside this page.")
    }

    fn lead(&self) -> String {
        let what = if self.args.morph_target { "the morph target of a glTF" } else { "a geomorph" };
        format!(
            "Each level goes over into the next one by {what} in {} frames. The largest change of a pixel's light between two frames is at \
             most {:.3} times that of a cut; {BAR} is the bar.",
            self.args.frames,
            largest_ratio(self.switches)
        )
    }

    fn figures(&self) -> String {
        let row = |switch: &Switch| {
            let mut cells = cells(switch);
            cells[4] = bar(&cells[4], switch.ratio());
            cells
        };
        table(&escape(&meaning(self.args)), &HEAD, &self.switches.iter().map(row).collect::<Vec<_>>())
    }

    fn plot(&self) -> String {
        let series = |switch: &Switch| Series {
            name: format!("to {}", count(switch.triangles[1])),
            points: (1..).zip(switch.steps()).map(|(frame, change)| (f64::from(frame), change)).collect(),
        };
        let series: Vec<Series> = self.switches.iter().map(series).collect();
        let alt = "largest change of a pixel over the frames of a geomorph, one line to each switch";
        let svg = linear(&series, 0.0, "frame", "largest change of a pixel, share of white", alt);
        format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n")
    }
}

/// Both levels, the middle between them, and what changes, from where the geomorph changes most.
fn pictures(switch: &Switch) -> String {
    let (width, height) = switch.size;
    let [before, middle, after]: [Vec<Vec3>; 3] =
        switch.pictures.colours.each_ref().map(|light| light.iter().copied().map(encoded).collect());
    let scale = switch.cut().light.max(f32::MIN_POSITIVE);
    let coloured = |i: usize| -> Vec<Vec3> {
        switch.pictures.changes.iter().map(|change| Vec3::from(viridis(change[i] / scale))).collect()
    };
    let [cut, step] = [0, 1].map(coloured);
    let shown = [
        (&before, "the finer level".to_owned()),
        (&middle, "the middle of the geomorph".to_owned()),
        (&after, "the coarser level".to_owned()),
        (&cut, format!("changes with a cut: yellow is {:.0} % of white", 100.0 * scale)),
        (&step, "largest change from frame to frame, in the same colours".to_owned()),
    ];
    let mut html = String::from("<div class=\"cards pictures\">\n");
    for (colours, name) in shown {
        let png = STANDARD.encode(Picture::of(width, height, colours).to_png());
        let _ = writeln!(
            html,
            "<figure>\n<img width=\"{width}\" height=\"{height}\" alt=\"{name}\" src=\"data:image/png;base64,{png}\">\n\
             <figcaption>{name}</figcaption>\n</figure>"
        );
    }
    html + "</div>\n"
}
