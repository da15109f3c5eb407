//! Plots as SVG that follow the colours of the page.

use std::fmt::Write;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 74.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 52.0;
/// Least distance of two names, and about how wide a letter of one is.
const LINE_HEIGHT: f64 = 15.0;
const LETTER: f64 = 8.0;
/// Colours of the page; a series beyond them gets one of them again, dashed.
const COLOURS: usize = 8;

/// A named line of points; a lone point is a dot with a name. The name is HTML.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// A plot with logarithmic axes, for points above 0. `what` says for whom cannot see it what it shows.
pub(crate) fn log_log(series: &[Series], x_title: &str, y_title: &str, what: &str) -> String {
    let all = || series.iter().flat_map(|s| &s.points);
    let right = right_of(series);
    let x = Axis::logarithmic(all().map(|p| p.0), LEFT, right);
    let y = Axis::logarithmic(all().map(|p| p.1), HEIGHT - BOTTOM, TOP);
    plot(series, &x, &y, [x_title, y_title], what)
}

/// A plot with linear axes, the vertical one from 0 to at least `most`, so that several plots can be compared. `what` says
/// for whom cannot see it what it shows.
pub(crate) fn linear(series: &[Series], most: f64, x_title: &str, y_title: &str, what: &str) -> String {
    let all = || series.iter().flat_map(|s| &s.points);
    let right = right_of(series);
    let x = Axis::linear(all().map(|p| p.0), LEFT, right);
    let y = Axis::linear(all().map(|p| p.1).chain([0.0, most]), HEIGHT - BOTTOM, TOP);
    plot(series, &x, &y, [x_title, y_title], what)
}

/// Where the axes end, so that the names have room.
fn right_of(series: &[Series]) -> f64 {
    let longest = series.iter().map(|s| s.name.chars().count()).max().unwrap_or(0);
    WIDTH - (24.0 + LETTER * longest as f64)
}

fn plot(series: &[Series], x: &Axis, y: &Axis, [x_title, y_title]: [&str; 2], what: &str) -> String {
    let mut svg = opening(what);
    draw_grid(&mut svg, x, y);
    for (i, s) in series.iter().enumerate() {
        draw_series(&mut svg, s, &class(i), x, y);
    }
    draw_names(&mut svg, series, x, y);
    svg + &titles(x.to, x_title, y_title)
}

/// Shares in bins, one or more bars to each.
pub(crate) struct Bars {
    pub(crate) name: String,
    /// 0 to 1.
    pub(crate) shares: Vec<f64>,
}

/// A histogram. `edges` are the limits of the bins, one more than there are bins.
pub(crate) fn histogram(bars: &[Bars], edges: &[String], x_title: &str, what: &str) -> String {
    let (right, bottom) = (WIDTH - 16.0, HEIGHT - BOTTOM);
    let bins = edges.len().saturating_sub(1).max(1);
    let most = bars.iter().flat_map(|b| &b.shares).copied().fold(0.0, f64::max);
    let top = (most * 20.0).ceil().max(1.0) / 20.0;
    let y = |share: f64| bottom - (bottom - TOP) * share / top;
    let width = (right - LEFT) / bins as f64;
    let mut svg = opening(what);
    let step = if top > 0.5 {
        0.2
    } else if top > 0.2 {
        0.1
    } else {
        0.05
    };
    for i in 0..=(top / step + 1e-9) as usize {
        let share = i as f64 * step;
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{LEFT} {0:.1}H{right}\"/>\n<text x=\"{1}\" y=\"{2:.1}\" text-anchor=\"end\">{3:.0} %</text>\n",
            y(share),
            LEFT - 8.0,
            y(share) + 4.0,
            100.0 * share
        );
    }
    let bar = width * 0.84 / bars.len().max(1) as f64;
    for (i, b) in bars.iter().enumerate() {
        for (bin, &share) in b.shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
            let _ = writeln!(
                svg,
                "<rect class=\"dot {}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{bar:.1}\" height=\"{:.1}\"><title>{}, {} to {}: {:.1} %</title></rect>",
                class(i),
                LEFT + width * (bin as f64 + 0.08) + bar * i as f64,
                y(share),
                bottom - y(share),
                b.name,
                edges[bin],
                edges[bin + 1],
                100.0 * share
            );
        }
    }
    for (i, edge) in edges.iter().enumerate() {
        let place = LEFT + width * i as f64;
        let _ = writeln!(svg, "<text x=\"{place:.1}\" y=\"{}\" text-anchor=\"middle\">{edge}</text>", bottom + 18.0);
    }
    for (i, b) in bars.iter().enumerate() {
        let place = TOP + 8.0 + 20.0 * i as f64;
        let (square, text) = (LEFT + 12.0, LEFT + 32.0);
        let _ = write!(
            svg,
            "<rect class=\"dot {0}\" x=\"{square}\" y=\"{place}\" width=\"12\" height=\"12\" rx=\"2\"/>\n\
             <text class=\"name {0}\" x=\"{text}\" y=\"{1}\">{2}</text>\n",
            class(i),
            place + 10.5,
            b.name
        );
    }
    svg + &titles(right, x_title, "share of the triangles")
}

fn opening(what: &str) -> String {
    format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n", super::escape(what))
}

/// The titles of the axes and the end of the picture.
fn titles(right: f64, x_title: &str, y_title: &str) -> String {
    let (middle_x, middle_y) = ((LEFT + right) / 2.0, (TOP + HEIGHT - BOTTOM) / 2.0);
    format!(
        "<text class=\"title\" x=\"{middle_x}\" y=\"{}\" text-anchor=\"middle\">{x_title}</text>\n\
         <text class=\"title\" transform=\"translate(16 {middle_y}) rotate(-90)\" text-anchor=\"middle\">{y_title}</text>\n\
         </svg>\n",
        HEIGHT - 10.0
    )
}

/// CSS classes of a series: colour, and dashes from the ninth on.
fn class(series: usize) -> String {
    let dashed = if series >= COLOURS { " dashed" } else { "" };
    format!("s{}{dashed}", series % COLOURS + 1)
}

/// From values to places, over whole steps.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    /// From one tick to the next; `None`: the axis is logarithmic.
    step: Option<f64>,
}

impl Axis {
    /// Over steps of 1, 2, 5.
    fn logarithmic(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(0.0, f64::max);
        let (low, high) = if low <= high && low > 0.0 { (low, high) } else { (0.1, 1.0) };
        Self { low: step_below(low), high: step_above(high), from, to, step: None }
    }

    /// Over five to twelve equal steps.
    fn linear(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(f64::NEG_INFINITY, f64::max);
        let low = if low.is_finite() { low } else { 0.0 };
        let high = if high.is_finite() && high > low { high } else { low + 1.0 };
        let step = step_below((high - low) / 5.0);
        let [first, last] = [(low / step + 1e-9).floor(), (high / step - 1e-9).ceil()];
        Self { low: first * step, high: last * step, from, to, step: Some(step) }
    }

    fn place(&self, value: f64) -> f64 {
        let share = match self.step {
            None => (value / self.low).ln() / (self.high / self.low).ln(),
            Some(_) => (value - self.low) / (self.high - self.low),
        };
        self.from + (self.to - self.from) * share
    }

    /// The steps within the axis; those of 1 are major where it is logarithmic, 0 elsewhere.
    fn ticks(&self) -> Vec<(f64, bool)> {
        if let Some(step) = self.step {
            let count = ((self.high - self.low) / step).round() as usize;
            let tick = |i: usize| (self.low / step).round() + i as f64;
            return (0..=count).map(|i| (tick(i) * step, tick(i) == 0.0)).collect();
        }
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let steps = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|step| (step * 10_f64.powi(decade), step == 1.0)));
        steps.filter(|(tick, _)| *tick >= self.low * 0.999 && *tick <= self.high * 1.001).collect()
    }
}

fn step_below(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0].map(|step| step * decade).into_iter().find(|step| *step <= value * 0.999).unwrap_or(decade / 2.0)
}

fn step_above(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
    steps.into_iter().find(|step| *step >= value * 1.001).unwrap_or(20.0 * decade)
}

fn draw_grid(svg: &mut String, x: &Axis, y: &Axis) {
    let class = |major: bool| if major { "grid major" } else { "grid" };
    let (bottom, right) = (HEIGHT - BOTTOM, x.to);
    // labels need room; what is between them still gets its line
    let mut free = f64::NEG_INFINITY;
    for (tick, major) in x.ticks() {
        let place = x.place(tick);
        let _ = writeln!(svg, "<path class=\"{}\" d=\"M{place:.1} {TOP}V{bottom}\"/>", class(major));
        let (label, below) = (tick_label(tick), bottom + 18.0);
        let half = LETTER * label.chars().count() as f64 / 2.0;
        if place - half >= free {
            let _ = writeln!(svg, "<text x=\"{place:.1}\" y=\"{below}\" text-anchor=\"middle\">{label}</text>");
            free = place + half + LETTER;
        }
    }
    let mut free = f64::INFINITY;
    for (tick, major) in y.ticks() {
        let place = y.place(tick);
        let _ = writeln!(svg, "<path class=\"{}\" d=\"M{LEFT} {place:.1}H{right:.1}\"/>", class(major));
        if place <= free {
            let (left, middle) = (LEFT - 8.0, place + 4.0);
            let label = tick_label(tick);
            let _ = writeln!(svg, "<text x=\"{left}\" y=\"{middle:.1}\" text-anchor=\"end\">{label}</text>");
            free = place - LINE_HEIGHT;
        }
    }
}

fn draw_series(svg: &mut String, series: &Series, class: &str, x: &Axis, y: &Axis) {
    let places: Vec<(f64, f64)> = series.points.iter().map(|p| (x.place(p.0), y.place(p.1))).collect();
    let path: Vec<String> = places.iter().map(|(x, y)| format!("{x:.1} {y:.1}")).collect();
    if path.len() > 1 {
        let _ = writeln!(svg, "<path class=\"line {class}\" d=\"M{}\"/>", path.join("L"));
    }
    for ((px, py), (vx, vy)) in places.iter().zip(&series.points) {
        let title = format!("{}: {} at {}", series.name, tick_label(*vy), tick_label(*vx));
        let _ = writeln!(
            svg,
            "<circle class=\"dot {class}\" cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"4\"><title>{title}</title></circle>"
        );
    }
}

/// Names beside the last points, moved apart where they would cover each other.
fn draw_names(svg: &mut String, series: &[Series], x: &Axis, y: &Axis) {
    let last = |s: &Series| s.points.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    let end = |(i, s): (usize, &Series)| last(s).map(|(vx, vy)| (i, x.place(vx), y.place(vy)));
    let mut ends: Vec<(usize, f64, f64)> = series.iter().enumerate().filter_map(end).collect();
    ends.sort_by(|a, b| a.2.total_cmp(&b.2).then(a.0.cmp(&b.0)));
    let mut names: Vec<(f64, f64)> = Vec::with_capacity(ends.len());
    for &(_, px, py) in &ends {
        let clear = |names: &[(f64, f64)], at: f64| {
            let near =
                |&&(nx, ny): &&(f64, f64)| (nx - px).abs() < 12.0 * LETTER && (ny - at).abs() < LINE_HEIGHT - 0.01;
            names.iter().find(near).map(|&(_, ny)| ny)
        };
        let mut at = py;
        while let Some(taken) = clear(&names, at) {
            at = taken + LINE_HEIGHT;
        }
        names.push((px, at));
    }
    // what ran out at the bottom moves up together
    let excess = names.iter().map(|&(_, at)| at).fold(0.0, f64::max) - (HEIGHT - BOTTOM);
    let lift = excess.max(0.0);
    for (&(i, px, py), &(_, at)) in ends.iter().zip(&names) {
        let at = if lift > 0.0 { at - lift } else { at };
        let (class, from, text) = (class(i), px + 5.0, px + 16.0);
        if (at - py).abs() > 3.0 {
            let _ = writeln!(svg, "<path class=\"leader\" d=\"M{from:.1} {py:.1}L{:.1} {at:.1}\"/>", text - 2.0);
        }
        let (base, name) = (at + 4.0, &series[i].name);
        let _ = writeln!(svg, "<text class=\"name {class}\" x=\"{text:.1}\" y=\"{base:.1}\">{name}</text>");
    }
}

fn tick_label(value: f64) -> String {
    if value >= 1000.0 {
        return super::count(value.round() as u64);
    }
    let text = format!("{value:.3e}");
    match text.split_once('e').filter(|_| value != 0.0 && value.abs() < 1e-3) {
        Some((digits, power)) => format!("{}e{power}", digits.trim_end_matches('0').trim_end_matches('.')),
        None => crate::output::number(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_hold_all_values_between_round_steps() {
        let axis = Axis::logarithmic([3.0, 47.0, 1000.0].into_iter(), 0.0, 100.0);
        assert_eq!((axis.low, axis.high), (2.0, 2000.0));
        assert_eq!(axis.place(2.0), 0.0);
        assert_eq!(axis.place(2000.0), 100.0);
        let ticks: Vec<f64> = axis.ticks().iter().map(|tick| tick.0).collect();
        assert_eq!(ticks, [2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0]);
    }

    #[test]
    fn linear_axes_hold_all_values_between_equal_steps() {
        let axis = Axis::linear([0.13, 1.04].into_iter(), 0.0, 100.0);
        let ticks: Vec<String> = axis.ticks().iter().map(|tick| tick_label(tick.0)).collect();
        assert_eq!(ticks, ["0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7", "0.8", "0.9", "1", "1.1"]);
        assert_eq!((axis.place(axis.low), axis.place(axis.high)), (0.0, 100.0));
        let small: Vec<String> =
            Axis::linear([0.0, 3e-4].into_iter(), 0.0, 1.0).ticks().iter().map(|tick| tick_label(tick.0)).collect();
        assert_eq!(small, ["0", "5e-5", "1e-4", "1.5e-4", "2e-4", "2.5e-4", "3e-4"]);
        assert_eq!(Axis::linear([0.0, 50.0].into_iter(), 0.0, 1.0).ticks().len(), 11);
        for values in [vec![], vec![0.0], vec![7.0; 3], vec![-2.0, 3e-9]] {
            let axis = Axis::linear(values.into_iter(), 0.0, 1.0);
            assert!(axis.high > axis.low && (2..20).contains(&axis.ticks().len()));
        }
    }

    #[test]
    fn nothing_to_draw_gives_an_empty_plot() {
        let series = [Series { name: "none".to_owned(), points: vec![] }];
        assert!(log_log(&series, "x", "y", "nothing").ends_with("</svg>\n"));
        assert!(linear(&series, 0.0, "x", "y", "nothing").ends_with("</svg>\n"));
        assert!(histogram(&[], &[], "x", "nothing").ends_with("</svg>\n"));
    }

    #[test]
    fn names_do_not_cover_each_other() {
        let line =
            |i: usize| Series { name: format!("line {i}"), points: vec![(1.0, 1.0), (9.0, 1.0 + 1e-3 * i as f64)] };
        let svg = log_log(&(0..12).map(line).collect::<Vec<_>>(), "x", "y", "lines");
        let name = |text: &str| text.split("y=\"").nth(1)?.split('"').next()?.parse::<f64>().ok();
        let mut places: Vec<f64> = svg.lines().filter(|l| l.contains("class=\"name")).filter_map(name).collect();
        places.sort_by(f64::total_cmp);
        assert_eq!(places.len(), 12);
        assert!(places.windows(2).all(|pair| pair[1] - pair[0] >= LINE_HEIGHT - 0.11), "{places:?}");
        assert!(places.iter().all(|&place| (0.0..HEIGHT).contains(&place)));
        assert!(svg.contains("s4 dashed"), "colours come again with dashes");
    }
}
