//! `peers simplify`: all simplifiers on all meshes.

use anyhow::{Result, ensure};
use maille::measure::{CompareOptions, compare};
use maille::{Control, Mesh};
use serde::Serialize;

use crate::inputs::{self, Input};
use crate::memory::Cost;
use crate::ours;
use crate::peer::Peer;
use crate::peers::{Meshoptimizer, PythonPeer};
use crate::row::{OutputArgs, Row, Table, median, three_digits};

/// Time, memory and error of ours and of the peers on the same meshes.
///
/// The tools take turns, so that what else the machine does is shared by all; the time is the median of the turns.
#[derive(clap::Args)]
pub struct Args {
    /// Files, folders, or samples made in code: `statue`, `statue:1000000`. Without any: samples and the models in the
    /// folder `static` of `MAILLE_MODELS`.
    inputs: Vec<String>,
    /// Percent of the triangles to keep.
    #[arg(long, value_delimiter = ',', default_value = "50,10,1")]
    targets: Vec<f64>,
    /// Tools to run; all that are there without it.
    #[arg(long, value_delimiter = ',')]
    tools: Vec<String>,
    /// Threads of ours; the peers have one.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// How often each tool is timed.
    #[arg(long, default_value_t = 3)]
    repeat: usize,
    /// Samples on each surface when the error is measured.
    #[arg(long, default_value_t = 500_000)]
    samples: u64,
    /// Leaves out files with fewer triangles: their times say nothing.
    #[arg(long, default_value_t = 5000)]
    min_triangles: usize,
    #[command(flatten)]
    output: OutputArgs,
}

/// A tool on a mesh.
#[derive(Serialize)]
struct Figures {
    mesh: String,
    triangles_in: usize,
    target_percent: f64,
    tool: String,
    version: String,
    triangles_out: usize,
    /// Median, of the algorithm alone.
    seconds: f64,
    /// Millions of input triangles in a second.
    mtriangles_per_s: f64,
    /// Beyond the input.
    peak_bytes: Option<u64>,
    /// Distances in millionths of the diagonal: the larger of both directions.
    mean: f64,
    rms: f64,
    max: f64,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(args.repeat > 0, "--repeat must be at least 1");
    ensure!(args.targets.iter().all(|&t| t > 0.0 && t <= 100.0), "--targets are percents above 0 and up to 100");
    let tools = tools(args)?;
    let mut table = Table::new(&args.output)?;
    for name in inputs::names(&args.inputs)? {
        match inputs::open(&name) {
            Ok(input) if input.mesh.triangle_count() >= args.min_triangles => {
                for &target in &args.targets {
                    compare_tools(&tools, &input, target, args, &mut table)?;
                }
            }
            Ok(input) => eprintln!("{}: left out, {} triangles are too few", input.name, input.mesh.triangle_count()),
            Err(error) => eprintln!("{name}: left out: {error:#}"),
        }
    }
    Ok(())
}

/// Those that were asked for and are there; says which are not.
fn tools(args: &Args) -> Result<Vec<Box<dyn Peer>>> {
    let wanted = |name: &str| args.tools.is_empty() || args.tools.iter().any(|tool| tool == name);
    let mut tools: Vec<Box<dyn Peer>> = Vec::new();
    tools.extend(ours::variants(args.threads)?.map(|tool| Box::new(tool) as _));
    tools.extend(Meshoptimizer::ALL.map(|tool| Box::new(tool) as _));
    tools.retain(|tool| wanted(tool.name()));
    for name in PythonPeer::NAMES.into_iter().filter(|name| wanted(name)) {
        match PythonPeer::find(name) {
            Ok(tool) => tools.push(Box::new(tool)),
            Err(error) => eprintln!("{name}: left out: {error:#} (MAILLE_PYTHON names the Python that has it)"),
        }
    }
    ensure!(!tools.is_empty(), "none of the tools asked for is there");
    Ok(tools)
}

fn compare_tools(
    tools: &[Box<dyn Peer>],
    input: &Input,
    target_percent: f64,
    args: &Args,
    table: &mut Table,
) -> Result<()> {
    let triangles = (input.mesh.triangle_count() as f64 * target_percent / 100.0).round() as usize;
    let mut runs: Vec<Vec<(Mesh, Cost)>> = tools.iter().map(|_| Vec::new()).collect();
    for _ in 0..args.repeat {
        for (tool, runs) in tools.iter().zip(&mut runs) {
            match tool.simplify(&input.mesh, triangles) {
                Ok((_, cost)) if !runs.is_empty() => runs.push((Mesh::default(), cost)),
                Ok(first) => runs.push(first),
                Err(error) => eprintln!("{} on {}: {error:#}", tool.name(), input.name),
            }
        }
    }
    for (tool, runs) in tools.iter().zip(&runs).filter(|(_, runs)| !runs.is_empty()) {
        match figures(tool.as_ref(), input, target_percent, runs, args.samples) {
            Ok(figures) => table.print(&figures)?,
            Err(error) => eprintln!("{} on {}: cannot be measured: {error:#}", tool.name(), input.name),
        }
    }
    Ok(())
}

/// The figures of a tool from its turns, the first of which has kept its result.
fn figures(
    tool: &dyn Peer,
    input: &Input,
    target_percent: f64,
    runs: &[(Mesh, Cost)],
    samples: u64,
) -> Result<Figures> {
    let (result, first) = &runs[0];
    let options = CompareOptions { samples, ..CompareOptions::default() };
    let comparison = compare(&input.mesh, result, &options, Control::default())?;
    let millionths = |distance: f64| 1e6 * comparison.relative(distance);
    let seconds = median(&mut runs.iter().map(|(_, cost)| cost.seconds).collect::<Vec<_>>());
    Ok(Figures {
        mesh: input.name.clone(),
        triangles_in: input.mesh.triangle_count(),
        target_percent,
        tool: tool.name().to_owned(),
        version: tool.version().to_owned(),
        triangles_out: result.triangle_count(),
        seconds,
        mtriangles_per_s: 1e-6 * input.mesh.triangle_count() as f64 / seconds,
        peak_bytes: first.peak_bytes,
        mean: millionths(comparison.mean()),
        rms: millionths(comparison.rms()),
        max: millionths(comparison.max()),
    })
}

impl Row for Figures {
    fn heads() -> String {
        let units = "error in millionths of the diagonal";
        format!(
            "{:<20} {:>10} {:>7} {:<20} {:>10} {:>9} {:>9} {:>9}   {units}\n\
             {:<20} {:>10} {:>7} {:<20} {:>10} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9}",
            "",
            "",
            "",
            "",
            "",
            "",
            "",
            "peak",
            "mesh",
            "triangles",
            "target",
            "tool",
            "left",
            "seconds",
            "Mtri/s",
            "MB",
            "mean",
            "RMS",
            "max",
        )
    }

    fn line(&self) -> String {
        let peak = self.peak_bytes.map_or("-".to_owned(), |bytes| format!("{:.1}", 1e-6 * bytes as f64));
        let [speed, mean, rms, max] = [self.mtriangles_per_s, self.mean, self.rms, self.max].map(three_digits);
        format!(
            "{:<20.20} {:>10} {:>6}% {:<20} {:>10} {:>9.4} {speed:>9} {peak:>9} {mean:>9} {rms:>9} {max:>9}",
            self.mesh, self.triangles_in, self.target_percent, self.tool, self.triangles_out, self.seconds,
        )
    }
}
