//! Simplification by edge collapse.

mod options;

pub use options::{
    EdgePolicy, MetricKind, NormalPolicy, PlacementKind, QuadricWeight, Refusals, SimplifyError, SimplifyOptions,
    SimplifyReport, Stop, Target,
};

use crate::{Control, Mesh};

/// Reduces a triangle mesh by greedy edge collapse, cheapest first.
///
/// # Errors
/// [`SimplifyError`] for options that make no sense, a mesh that breaks its invariants, or cancellation; the mesh is
/// unchanged then.
pub fn simplify(
    _mesh: &mut Mesh,
    _options: &SimplifyOptions,
    _control: Control<'_>,
) -> Result<SimplifyReport, SimplifyError> {
    Err(SimplifyError::InvalidOption { name: "target", reason: "under construction".into() })
}
