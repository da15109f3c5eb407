//! Ours.

use std::sync::Arc;

use anyhow::Result;
use maille::simplify::{MetricKind, PlacementKind, SimplifyOptions, Target, simplify};
use maille::{Control, Mesh};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::memory::{Cost, measure};
use crate::peer::Peer;

/// Maille with some options, on some threads.
pub struct Ours {
    pub name: &'static str,
    options: SimplifyOptions,
    pool: Arc<ThreadPool>,
}

/// What a user gets who asks for nothing but a target, and the classical combination of 1997.
pub fn variants(threads: usize) -> Result<[Ours; 2]> {
    let pool = Arc::new(ThreadPoolBuilder::new().num_threads(threads).build()?);
    let classical = SimplifyOptions {
        metric: MetricKind::Quadric,
        placement: PlacementKind::Optimal,
        ..SimplifyOptions::default()
    };
    Ok([
        Ours { name: "maille", options: SimplifyOptions::default(), pool: pool.clone() },
        Ours { name: "maille-qem-optimal", options: classical, pool },
    ])
}

impl Peer for Ours {
    fn name(&self) -> &str {
        self.name
    }

    fn version(&self) -> &str {
        env!("CARGO_PKG_VERSION")
    }

    fn simplify(&self, mesh: &Mesh, triangles: usize) -> Result<(Mesh, Cost)> {
        let mut mesh = mesh.clone();
        let target = Target { triangles: Some(triangles), max_error: None };
        let options = SimplifyOptions { target, ..self.options.clone() };
        let (report, cost) = measure(|| self.pool.install(|| simplify(&mut mesh, &options, Control::default())));
        report?;
        Ok((mesh, cost))
    }
}
