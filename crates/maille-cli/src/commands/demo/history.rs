//! The table of the first thesis that Maille continues, beside ours.

use std::time::Instant;

use maille::measure::{CompareOptions, compare};
use maille::simplify::{MetricKind, PlacementKind, SimplifyOptions, Target, TopologyPolicy, simplify};
use maille::{Mesh, samples};

use super::failed;
use crate::failure::Failure;
use crate::session::Session;

/// Triangles of the model of the year 2000.
pub(super) const TRIANGLES: usize = 13_594;
/// Share that is left when the error is measured.
pub(super) const MEASURED_PERCENT: usize = 10;
/// How often each simplification is timed; in 2000 it was ten times.
pub(super) const REPEATS: u32 = 5;
const SAMPLES: u64 = 100_000;

/// Metrics of the thesis with its times in milliseconds, on an Athlon of 600 MHz (seed 000, 4.3).
const THEN: [(&str, MetricKind, u32); 5] = [
    ("Shortest edge (SEM)", MetricKind::ShortestEdge, 626),
    ("Quadrics (QEM)", MetricKind::Quadric, 809),
    ("Quadrics, constrained", MetricKind::ConstrainedQuadric, 829),
    ("Quadrics, memoryless", MetricKind::MemorylessQuadric, 1211),
    ("Quadrics, memoryless and constrained", MetricKind::ConstrainedMemorylessQuadric, 2059),
];

/// One metric, then and now.
pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) milliseconds_then: u32,
    pub(super) milliseconds_now: f64,
    /// Shares of the diagonal.
    pub(super) mean: f64,
    pub(super) rms: f64,
    pub(super) max: f64,
}

/// The whole table.
pub(super) struct History {
    pub(super) triangles: usize,
    pub(super) rows: Vec<Row>,
}

/// Simplifies a model of the same size with the same metrics, as far as it goes, as it was done then; and once to a
/// tenth for the error.
pub(super) fn run(session: &Session) -> Result<History, Failure> {
    let mesh = samples::statue(TRIANGLES);
    let rows = THEN.into_iter().map(|(name, metric, then)| row(session, &mesh, name, metric, then));
    Ok(History { triangles: mesh.triangle_count(), rows: rows.collect::<Result<_, _>>()? })
}

fn row(session: &Session, mesh: &Mesh, name: &'static str, metric: MetricKind, then: u32) -> Result<Row, Failure> {
    let control = session.quiet_control();
    let mut seconds = 0.0;
    for _ in 0..REPEATS {
        let mut copy = mesh.clone();
        let start = Instant::now();
        simplify(&mut copy, &options(metric, 0), control).map_err(|error| failed(session, error))?;
        seconds += start.elapsed().as_secs_f64();
    }
    let mut tenth = mesh.clone();
    let target = mesh.triangle_count() * MEASURED_PERCENT / 100;
    simplify(&mut tenth, &options(metric, target), control).map_err(|error| failed(session, error))?;
    let measure = CompareOptions { samples: SAMPLES, ..CompareOptions::default() };
    let c = compare(mesh, &tenth, &measure, control).map_err(|error| failed(session, error))?;
    Ok(Row {
        name,
        milliseconds_then: then,
        milliseconds_now: 1000.0 * seconds / f64::from(REPEATS),
        mean: c.relative(c.mean()),
        rms: c.relative(c.rms()),
        max: c.relative(c.max()),
    })
}

/// As in the thesis: nothing is forbidden, the shortest edge goes to its middle, and quadrics choose the best place.
fn options(metric: MetricKind, triangles: usize) -> SimplifyOptions {
    let placement = match metric {
        MetricKind::ShortestEdge => PlacementKind::Midpoint,
        _ => PlacementKind::Optimal,
    };
    SimplifyOptions {
        target: Target { triangles: Some(triangles), max_error: None },
        metric,
        placement,
        topology: TopologyPolicy::Free,
        max_normal_turn: None,
        ..SimplifyOptions::default()
    }
}
