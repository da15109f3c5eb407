//! `peers scaling`: how time and memory of ours grow with the mesh.

use anyhow::{Result, ensure};
use maille::samples;
use serde::Serialize;

use crate::memory::Cost;
use crate::ours;
use crate::peer::Peer;
use crate::row::{OutputArgs, Row, Table, median, three_digits};

/// Most bytes per input triangle beyond the input that Maille allows itself.
const BYTES_PER_TRIANGLE: f64 = 200.0;
/// Time may grow as n log n; caches, which small meshes fit in, and the noise of timing have this much of the exponent.
const EXPONENT_TOLERANCE: f64 = 0.05;

/// Time per triangle and memory of ours to 10 %, from small to large, and how they grow.
#[derive(clap::Args)]
pub struct Args {
    /// Triangles of the statue.
    #[arg(long, value_delimiter = ',', default_value = "10000,30000,100000,300000,1000000,3000000,10000000")]
    sizes: Vec<usize>,
    /// Percent of the triangles to keep.
    #[arg(long, default_value_t = 10.0)]
    target: f64,
    /// Threads.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// How often each size is timed.
    #[arg(long, default_value_t = 3)]
    repeat: usize,
    #[command(flatten)]
    output: OutputArgs,
}

/// A variant at a size.
#[derive(Serialize)]
struct Figures {
    tool: &'static str,
    triangles_in: usize,
    triangles_out: usize,
    seconds: f64,
    ns_per_triangle: f64,
    /// Beyond the input.
    peak_bytes: u64,
    bytes_per_triangle: f64,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(args.repeat > 0, "--repeat must be at least 1");
    ensure!(args.sizes.len() > 1, "--sizes must be two at least: one tells nothing about growth");
    ensure!(args.target > 0.0 && args.target <= 100.0, "--target is a percent above 0 and up to 100");
    let variants = ours::variants(args.threads)?;
    let mut table = Table::new(&args.output)?;
    let mut all: Vec<Vec<Figures>> = variants.iter().map(|_| Vec::new()).collect();
    for &size in &args.sizes {
        let mesh = samples::statue(size);
        for (variant, all) in variants.iter().zip(&mut all) {
            let figures = figures(variant, &mesh, args)?;
            table.print(&figures)?;
            all.push(figures);
        }
    }
    for figures in &all {
        table.say(&verdict(figures));
    }
    Ok(())
}

fn figures(variant: &ours::Ours, mesh: &maille::Mesh, args: &Args) -> Result<Figures> {
    let triangles = mesh.triangle_count();
    let target = (triangles as f64 * args.target / 100.0).round() as usize;
    let runs = (0..args.repeat).map(|_| {
        let (result, cost) = variant.simplify(mesh, target)?;
        Ok((result.triangle_count(), cost))
    });
    let runs: Vec<(usize, Cost)> = runs.collect::<Result<_>>()?;
    let seconds = median(&mut runs.iter().map(|(_, cost)| cost.seconds).collect::<Vec<_>>());
    let peak_bytes = runs.iter().filter_map(|(_, cost)| cost.peak_bytes).max().unwrap_or(0);
    Ok(Figures {
        tool: variant.name,
        triangles_in: triangles,
        triangles_out: runs[0].0,
        seconds,
        ns_per_triangle: 1e9 * seconds / triangles as f64,
        peak_bytes,
        bytes_per_triangle: peak_bytes as f64 / triangles as f64,
    })
}

/// Whether the bars hold for a variant.
fn verdict(figures: &[Figures]) -> String {
    let Some(first) = figures.first() else { return String::new() };
    let n = |f: &Figures| f.triangles_in as f64;
    let exponent = slope(figures.iter().map(|f| (n(f).ln(), f.seconds.ln())));
    let allowed = slope(figures.iter().map(|f| (n(f).ln(), (n(f) * n(f).ln()).ln())));
    let bytes = figures.iter().map(|f| f.bytes_per_triangle).fold(0.0, f64::max);
    let judge = |holds: bool| if holds { "holds" } else { "falls short" };
    format!(
        "{}: time grows as n^{exponent:.3}, n log n would as n^{allowed:.3}: {}; \
         at most {bytes:.0} bytes per triangle of {BYTES_PER_TRIANGLE:.0}: {}",
        first.tool,
        judge(exponent <= allowed + EXPONENT_TOLERANCE),
        judge(bytes <= BYTES_PER_TRIANGLE),
    )
}

/// Slope of the line nearest to some points, by least squares; NaN for fewer than two.
fn slope(points: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let count = points.clone().count() as f64;
    let (x, y) = points.clone().fold((0.0, 0.0), |(x, y), p| (x + p.0 / count, y + p.1 / count));
    let (xy, xx) = points.fold((0.0, 0.0), |(xy, xx), p| (xy + (p.0 - x) * (p.1 - y), xx + (p.0 - x) * (p.0 - x)));
    xy / xx
}

impl Row for Figures {
    fn heads() -> String {
        format!(
            "{:<20} {:>10} {:>10} {:>9} {:>12} {:>9} {:>14}",
            "tool", "triangles", "left", "seconds", "ns/triangle", "peak MB", "bytes/triangle"
        )
    }

    fn line(&self) -> String {
        format!(
            "{:<20} {:>10} {:>10} {:>9.4} {:>12} {:>9.1} {:>14}",
            self.tool,
            self.triangles_in,
            self.triangles_out,
            self.seconds,
            three_digits(self.ns_per_triangle),
            1e-6 * self.peak_bytes as f64,
            three_digits(self.bytes_per_triangle),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::slope;

    #[test]
    fn slope_of_a_line_is_its_slope() {
        let points = [1.0, 2.0, 4.0, 7.0].map(|x| (x, 1.5 * x - 3.0));
        assert!((slope(points.into_iter()) - 1.5).abs() < 1e-12);
        assert!(slope([(1.0, 1.0)].into_iter()).is_nan());
    }
}
