//! Error over triangles, as SVG that follows the colours of the page.

use std::fmt::Write;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 74.0;
const RIGHT: f64 = 96.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 52.0;

/// A named line of points, x and y above 0.
pub(super) struct Series {
    pub(super) name: &'static str,
    /// CSS class, which carries the colour.
    pub(super) class: &'static str,
    pub(super) points: Vec<(f64, f64)>,
}

/// A plot with logarithmic axes.
pub(super) fn log_log(series: &[Series], x_title: &str, y_title: &str) -> String {
    let all = || series.iter().flat_map(|s| &s.points);
    let x = Axis::new(all().map(|p| p.0), LEFT, WIDTH - RIGHT);
    let y = Axis::new(all().map(|p| p.1), HEIGHT - BOTTOM, TOP);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{y_title} over {x_title}, logarithmic\">\n"
    );
    draw_grid(&mut svg, &x, &y);
    for s in series {
        draw_series(&mut svg, s, &x, &y);
    }
    let (middle_x, middle_y) = ((LEFT + WIDTH - RIGHT) / 2.0, (TOP + HEIGHT - BOTTOM) / 2.0);
    let _ = write!(
        svg,
        "<text class=\"title\" x=\"{middle_x}\" y=\"{}\" text-anchor=\"middle\">{x_title}</text>\n\
         <text class=\"title\" transform=\"translate(16 {middle_y}) rotate(-90)\" text-anchor=\"middle\">{y_title}</text>\n\
         </svg>",
        HEIGHT - 10.0
    );
    svg
}

/// From values to places, logarithmic, over whole steps of 1, 2, 5.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(0.0, f64::max);
        let (low, high) = if low <= high && low > 0.0 { (low, high) } else { (0.1, 1.0) };
        Self { low: step_below(low), high: step_above(high), from, to }
    }

    fn place(&self, value: f64) -> f64 {
        self.from + (self.to - self.from) * (value / self.low).ln() / (self.high / self.low).ln()
    }

    /// Steps of 1, 2 and 5 within the axis; those of 1 are major.
    fn ticks(&self) -> Vec<(f64, bool)> {
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
    for (tick, major) in x.ticks() {
        let (place, class) = (x.place(tick), if major { "grid major" } else { "grid" });
        let bottom = HEIGHT - BOTTOM;
        let _ = writeln!(svg, "<path class=\"{class}\" d=\"M{place:.1} {TOP}V{bottom}\"/>");
        let label = tick_label(tick);
        let _ = writeln!(svg, "<text x=\"{place:.1}\" y=\"{}\" text-anchor=\"middle\">{label}</text>", bottom + 18.0);
    }
    for (tick, major) in y.ticks() {
        let (place, class) = (y.place(tick), if major { "grid major" } else { "grid" });
        let _ = writeln!(svg, "<path class=\"{class}\" d=\"M{LEFT} {place:.1}H{}\"/>", WIDTH - RIGHT);
        let label = tick_label(tick);
        let _ = writeln!(svg, "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>", LEFT - 8.0, place + 4.0);
    }
}

fn draw_series(svg: &mut String, series: &Series, x: &Axis, y: &Axis) {
    let places: Vec<(f64, f64)> = series.points.iter().map(|p| (x.place(p.0), y.place(p.1))).collect();
    let path: Vec<String> = places.iter().map(|(x, y)| format!("{x:.1} {y:.1}")).collect();
    let _ = writeln!(svg, "<path class=\"line {}\" d=\"M{}\"/>", series.class, path.join("L"));
    for ((px, py), (vx, vy)) in places.iter().zip(&series.points) {
        let title = format!("{}: {} at {} triangles", series.name, tick_label(*vy), crate::output::count(*vx as u64));
        let class = series.class;
        let _ = writeln!(
            svg,
            "<circle class=\"dot {class}\" cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"4\"><title>{title}</title></circle>"
        );
    }
    let last = places.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((px, py)) = last {
        let _ = writeln!(
            svg,
            "<text class=\"name {}\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            series.class,
            px + 10.0,
            py + 4.0,
            series.name
        );
    }
}

fn tick_label(value: f64) -> String {
    if value >= 1000.0 {
        return crate::output::count(value.round() as u64);
    }
    crate::output::number(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_hold_all_values_between_round_steps() {
        let axis = Axis::new([3.0, 47.0, 1000.0].into_iter(), 0.0, 100.0);
        assert_eq!((axis.low, axis.high), (2.0, 2000.0));
        assert_eq!(axis.place(2.0), 0.0);
        assert_eq!(axis.place(2000.0), 100.0);
        let ticks: Vec<f64> = axis.ticks().iter().map(|tick| tick.0).collect();
        assert_eq!(ticks, [2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0]);
    }

    #[test]
    fn nothing_to_draw_gives_an_empty_plot() {
        let series = [Series { name: "none", class: "a", points: vec![] }];
        assert!(log_log(&series, "x", "y").ends_with("</svg>"));
    }
}
