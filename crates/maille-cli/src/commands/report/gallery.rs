//! Pictures on a page: cards of which all show the same kind of picture at a time, chosen by buttons that need no script.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maille::measure::viridis;

use super::studio::{HeatScale, Look};

/// One picture.
pub(crate) struct Shot {
    pub(crate) look: Look,
    /// What it shows, for who cannot see it: text.
    pub(crate) alt: String,
    pub(crate) png: Vec<u8>,
}

/// Pictures of the same thing, one of each look.
pub(crate) struct Card {
    pub(crate) shots: Vec<Shot>,
    /// HTML.
    pub(crate) caption: String,
}

/// All pictures of a page; there is one gallery to a page.
pub(crate) struct Gallery<'a> {
    pub(crate) cards: &'a [&'a Card],
    /// Whether cards come in pairs, to be shown side by side on any screen.
    pub(crate) pairs: bool,
    /// Size of a picture in pixels.
    pub(crate) size: (u32, u32),
    pub(crate) scale: HeatScale,
}

impl Gallery<'_> {
    pub(crate) fn html(&self) -> String {
        let mut html = String::from("<section class=\"gallery\" aria-label=\"Pictures\">\n");
        let has = |look: Look| self.cards.iter().any(|card| card.shots.iter().any(|shot| shot.look == look));
        for (i, look) in Look::ALL.into_iter().filter(|&look| has(look)).enumerate() {
            let (id, checked) = (look.id(), if i == 0 { " checked" } else { "" });
            let _ = writeln!(
                html,
                "<input type=\"radio\" name=\"look\" id=\"{id}\"{checked}><label for=\"{id}\">{}</label>",
                look.name()
            );
        }
        html += &legend(&self.scale);
        let class = if self.pairs { "cards pairs" } else { "cards" };
        let _ = writeln!(html, "<div class=\"{class}\">");
        for card in self.cards {
            html += &self.figure(card);
        }
        html + "</div>\n</section>\n"
    }

    fn figure(&self, card: &Card) -> String {
        let picture = |shot: &Shot| {
            format!(
                "<img class=\"{}\" width=\"{}\" height=\"{}\" alt=\"{}\" src=\"data:image/png;base64,{}\">\n",
                shot.look.id(),
                self.size.0,
                self.size.1,
                super::escape(&shot.alt),
                STANDARD.encode(&shot.png)
            )
        };
        let pictures: String = card.shots.iter().map(picture).collect();
        format!("<figure>\n{pictures}<figcaption>{}</figcaption>\n</figure>\n", card.caption)
    }
}

/// A picture in a row of them.
pub(crate) struct Picture {
    pub(crate) caption: String,
    /// What it shows, for whom cannot see it.
    pub(crate) alt: String,
    pub(crate) png: Vec<u8>,
}

/// Pictures side by side, `size` in pixels.
pub(crate) fn film(pictures: &[Picture], (width, height): (u32, u32)) -> String {
    let figure = |picture: &Picture| {
        format!(
            "<figure>\n<img width=\"{width}\" height=\"{height}\" alt=\"{}\" src=\"data:image/png;base64,{}\">\n\
             <figcaption>{}</figcaption>\n</figure>\n",
            super::escape(&picture.alt),
            STANDARD.encode(&picture.png),
            super::escape(&picture.caption)
        )
    };
    format!("<div class=\"cards film\">\n{}</div>\n", pictures.iter().map(figure).collect::<String>())
}

/// What the colours of the distance pictures mean.
fn legend(scale: &HeatScale) -> String {
    const STOPS: usize = 9;
    let stop = |i: usize| {
        let [r, g, b] = viridis(i as f32 / (STOPS - 1) as f32).map(|x| (255.0 * x).round() as u8);
        format!("rgb({r} {g} {b})")
    };
    let stops: Vec<String> = (0..STOPS).map(stop).collect();
    let labels = scale.labels();
    let spans: String = labels.iter().map(|label| format!("<span>{label}</span>")).collect();
    let (first, last) = (&labels[0], &labels[labels.len() - 1]);
    format!(
        "<div class=\"scale\"><div role=\"img\" aria-label=\"Colours of distances: violet {first}, yellow {last} and more\" \
         style=\"background:linear-gradient(to right,{})\"></div><p>{spans}</p><p>{}</p></div>\n",
        stops.join(","),
        scale.meaning()
    )
}
