//! `peers thesis`: the five metrics of seed 000 beside the times of the year 2000.

use anyhow::{Result, ensure};
use maille::measure::{CompareOptions, compare};
use maille::simplify::{MetricKind, PlacementKind, SimplifyOptions, Target, TopologyPolicy, simplify};
use maille::{Control, Mesh};
use serde::Serialize;

use crate::inputs;
use crate::memory::measure;
use crate::row::{OutputArgs, Row, Table, median, three_digits};

/// Triangles of the model of seed 000 (figure 4.4).
const TRIANGLES: usize = 13_594;

/// Metrics with the milliseconds they took on an Athlon of 600 MHz, mean of ten runs (seed 000, 4.3).
const THEN: [(&str, MetricKind, u32); 5] = [
    ("SEM", MetricKind::ShortestEdge, 626),
    ("QEM", MetricKind::Quadric, 809),
    ("QEM, constrained", MetricKind::ConstrainedQuadric, 829),
    ("QEM, memoryless", MetricKind::MemorylessQuadric, 1211),
    ("QEM, memoryless and constrained", MetricKind::ConstrainedMemorylessQuadric, 2059),
];

/// The five metrics of seed 000: time to simplify a model of 13,594 triangles down to nothing, as in the year 2000, and the
/// error at some levels.
///
/// The motorcycle of seed 000 is not to be had, so only the number of triangles is the same. The statue has no border: the
/// constraint costs next to nothing and changes nothing there.
#[derive(clap::Args)]
pub struct Args {
    /// A file or a sample made in code, with a few triangles more.
    #[arg(default_value = "statue:14300")]
    input: String,
    /// Percent of the triangles at which the error is measured.
    #[arg(long, value_delimiter = ',', default_value = "50,10,1")]
    targets: Vec<f64>,
    /// How often each metric is timed.
    #[arg(long, default_value_t = 10)]
    repeat: usize,
    /// Samples on each surface when the error is measured.
    #[arg(long, default_value_t = 500_000)]
    samples: u64,
    #[command(flatten)]
    output: OutputArgs,
}

/// A metric at a level.
#[derive(Serialize)]
struct Figures {
    metric: &'static str,
    triangles_in: usize,
    /// Milliseconds of the whole simplification, in 2000 and now.
    ms_2000: u32,
    ms_now: f64,
    target_percent: f64,
    triangles_out: usize,
    /// Distances in millionths of the diagonal: the larger of both directions.
    mean: f64,
    rms: f64,
    max: f64,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(args.repeat > 0, "--repeat must be at least 1");
    ensure!(args.targets.iter().all(|&t| t > 0.0 && t <= 100.0), "--targets are percents above 0 and up to 100");
    let mesh = model(&args.input)?;
    let mut table = Table::new(&args.output)?;
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); THEN.len()];
    for _ in 0..args.repeat {
        for ((_, metric, _), times) in THEN.iter().zip(&mut times) {
            times.push(simplified(&mesh, *metric, 0)?.1);
        }
    }
    for ((name, metric, ms_2000), times) in THEN.into_iter().zip(&mut times) {
        let ms_now = 1000.0 * median(times);
        for &target_percent in &args.targets {
            let triangles = (mesh.triangle_count() as f64 * target_percent / 100.0).round() as usize;
            let (result, _) = simplified(&mesh, metric, triangles)?;
            let options = CompareOptions { samples: args.samples, ..CompareOptions::default() };
            let comparison = compare(&mesh, &result, &options, Control::default())?;
            let millionths = |distance: f64| 1e6 * comparison.relative(distance);
            table.print(&Figures {
                metric: name,
                triangles_in: mesh.triangle_count(),
                ms_2000,
                ms_now,
                target_percent,
                triangles_out: result.triangle_count(),
                mean: millionths(comparison.mean()),
                rms: millionths(comparison.rms()),
                max: millionths(comparison.max()),
            })?;
        }
    }
    Ok(())
}

/// The input with exactly as many triangles as the model of seed 000: a few collapses of our best kind take away what it
/// has too many.
fn model(name: &str) -> Result<Mesh> {
    let mut mesh = inputs::open(name)?.mesh;
    let target = Target { triangles: Some(TRIANGLES), max_error: None };
    simplify(&mut mesh, &SimplifyOptions { target, ..SimplifyOptions::default() }, Control::default())?;
    Ok(mesh)
}

/// The mesh simplified as in seed 000, where nothing was forbidden and the shortest edge went to its middle; and the
/// seconds it took.
fn simplified(mesh: &Mesh, metric: MetricKind, triangles: usize) -> Result<(Mesh, f64)> {
    let shortest = metric == MetricKind::ShortestEdge;
    let mut options = SimplifyOptions {
        metric,
        placement: if shortest { PlacementKind::Midpoint } else { PlacementKind::Optimal },
        topology: TopologyPolicy::Free,
        max_normal_turn: None,
        ..SimplifyOptions::default()
    };
    options.target.triangles = Some(triangles);
    let mut mesh = mesh.clone();
    let (report, cost) = measure(|| simplify(&mut mesh, &options, Control::default()));
    report?;
    Ok((mesh, cost.seconds))
}

impl Row for Figures {
    fn heads() -> String {
        let units = "error in millionths of the diagonal";
        format!(
            "{:<32} {:>9} {:>9} {:>9} {:>7} {:>9}   {units}\n{:<32} {:>9} {:>9} {:>9} {:>7} {:>9} {:>9} {:>9} {:>9}",
            "", "", "ms", "ms", "", "", "metric", "triangles", "in 2000", "now", "target", "left", "mean", "RMS", "max",
        )
    }

    fn line(&self) -> String {
        let [now, mean, rms, max] = [self.ms_now, self.mean, self.rms, self.max].map(three_digits);
        format!(
            "{:<32} {:>9} {:>9} {now:>9} {:>6}% {:>9} {mean:>9} {rms:>9} {max:>9}",
            self.metric, self.triangles_in, self.ms_2000, self.target_percent, self.triangles_out,
        )
    }
}
