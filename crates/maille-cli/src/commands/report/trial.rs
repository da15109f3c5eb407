//! One simplification, timed and measured against the original.

use std::borrow::Cow;
use std::path::Path;
use std::time::Instant;

use maille::Mesh;
use maille::measure::{CompareError, CompareOptions, Comparison, compare};
use maille_io::{Asset, AssetOptions, AssetReport, simplify_asset};

use crate::commands::collapse::refusal;
use crate::failure::Failure;
use crate::session::Session;

/// What trials have in common.
pub(crate) struct Trials<'a> {
    pub(crate) session: &'a Session,
    /// What messages call the original.
    pub(crate) path: &'a Path,
    pub(crate) original: &'a Asset,
    /// The original as one mesh.
    pub(crate) surface: &'a Mesh,
    /// Samples on each surface.
    pub(crate) samples: u64,
    /// How often each simplification is done; the fastest one counts.
    pub(crate) repeat: u32,
}

/// What came of one.
pub(crate) struct Trial {
    pub(crate) asset: Asset,
    pub(crate) report: AssetReport,
    /// Of the simplification alone.
    pub(crate) seconds: f64,
    pub(crate) comparison: Comparison,
}

impl Trials<'_> {
    /// Simplifies a copy of the original and measures it.
    pub(crate) fn run(&self, options: &AssetOptions) -> Result<Trial, Failure> {
        let mut best: Option<(Asset, AssetReport, f64)> = None;
        for _ in 0..self.repeat.max(1) {
            let mut asset = self.original.clone();
            let start = Instant::now();
            let report = simplify_asset(&mut asset, options, self.session.quiet_control());
            let seconds = start.elapsed().as_secs_f64();
            let report = report.map_err(|error| refusal(self.path, &error))?;
            if best.as_ref().is_none_or(|best| seconds < best.2) {
                best = Some((asset, report, seconds));
            }
        }
        let (asset, report, seconds) = best.expect("it has been done once at least");
        let comparison = self.compare(&asset.flattened())?;
        Ok(Trial { asset, report, seconds, comparison })
    }

    /// Measures a surface against the original.
    pub(crate) fn compare(&self, surface: &Mesh) -> Result<Comparison, Failure> {
        compare(self.surface, surface, &self.sampling(), self.session.quiet_control()).map_err(|e| self.failure(&e))
    }

    /// How surfaces are sampled.
    pub(crate) fn sampling(&self) -> CompareOptions {
        CompareOptions { samples: self.samples, ..CompareOptions::default() }
    }

    /// Why two surfaces could not be compared, for the user.
    pub(crate) fn failure(&self, error: &CompareError) -> Failure {
        match error {
            CompareError::Cancelled(_) => Failure::Cancelled,
            error => Failure::about(self.path, format!("the result cannot be measured: {error}")),
        }
    }
}

impl Trial {
    /// The result as one mesh.
    pub(crate) fn surface(&self) -> Cow<'_, Mesh> {
        self.asset.flattened()
    }
}
