//! Simplification by edge collapse: the classical engine.
//!
//! [`simplify`] is the easy door; [`collapse_edges`] the workshop door, with any [`Metric`] and [`Observer`]. The loop
//! knows neither attributes (an observer, `wedges`, merges them) nor what a cost means (the metric does).
//!
//! | file | holds |
//! |---|---|
//! | `driver` | the loop |
//! | `queue` | edges by cost, cheapest first |
//! | `passes` | many collapses at once, on all cores, before the queue |
//! | `metric`, `quadric` | costs and placements |
//! | `features` | borders, seams, material borders, locks |
//! | `legality` | link condition, fold-over, valence, quality |
//! | `crossings` | collapses after which the surface would pass through itself |
//! | `wedges` | attributes of merged wedges |
//! | `pairs` | vertices to be joined although no edge does |

mod crossings;
mod driver;
mod features;
mod legality;
mod metric;
mod options;
mod pairs;
mod passes;
mod patience;
mod quadric;
mod queue;
mod wedges;

#[cfg(test)]
mod tests;

pub use driver::{Observer, Outcome, Request, collapse_edges};
pub use features::{Barred, Features};
pub use legality::{Collapse, Limits, triangle_quality};
pub use metric::{
    Anchor, Candidate, EdgeContext, Metric, QuadricMemory, QuadricMetric, QuadricOptions, ShortestEdge, Update,
};
pub use options::{
    EdgePolicy, MetricKind, NormalPolicy, Order, PlacementKind, QuadricWeight, Refusals, SimplifyError,
    SimplifyOptions, SimplifyReport, Stop, Target, TopologyPolicy,
};
pub use quadric::Quadric;
pub use wedges::WedgeMerger;

use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::Frame;
use crate::{Control, Mesh};
use passes::{Done, Surface, collapse_in_passes};

/// Reduces a triangle mesh by greedy edge collapse, cheapest first.
///
/// Any triangle mesh will do: non-manifold edges and vertices, open borders, several components. Wedges merge by the
/// continuity across the vanishing triangles, attributes are blended; those of untouched wedges keep their bits. The
/// result has no unused vertices or wedges and is in spatial order ([`Mesh::sort_spatially`]). Triangles that name a
/// vertex twice are dropped.
///
/// Units: `max_error` and the reported error are distances in model units. Cost: O(n log n) time.
///
/// # Errors
/// [`SimplifyError`] for options that make no sense, a mesh that breaks its invariants, or cancellation; the mesh is
/// unchanged then.
///
/// # References
/// Garland and Heckbert, SIGGRAPH 1997; Hoppe, SIGGRAPH 1996 (wedges); seed 000, chapter 4; seed 001, chapter 2.
///
/// # Examples
/// ```
/// use maille::simplify::{SimplifyOptions, Stop, Target, simplify};
/// let mut mesh = maille::mesh::shapes::sphere(4);
/// let options = SimplifyOptions { target: Target { triangles: Some(500), ..Default::default() }, ..Default::default() };
/// let report = simplify(&mut mesh, &options, Default::default())?;
/// assert_eq!(report.stopped, Stop::Triangles);
/// assert_eq!((report.triangles_in, mesh.triangle_count()), (2048, 500));
/// assert!(report.error < 0.01);
/// # Ok::<(), maille::simplify::SimplifyError>(())
/// ```
pub fn simplify(
    mesh: &mut Mesh,
    options: &SimplifyOptions,
    control: Control<'_>,
) -> Result<SimplifyReport, SimplifyError> {
    mesh.check()?;
    check_options(mesh, options)?;
    let triangles_in = mesh.triangle_count();
    let (mut work, options) = sorted(mesh, options);
    let positions = std::mem::take(&mut work.positions);
    let triangles: Vec<[u32; 3]> = work.triangles.iter().map(|t| t.map(|w| work.wedge_vertices[w as usize])).collect();
    let mut wedges = WedgeMerger::new(work, &options);
    let frame = Frame::of(&positions);
    let mut request = Request {
        order: options.order,
        target_faces: options.target.triangles.unwrap_or(1),
        limits: Limits {
            topology: options.topology,
            // a small part that vanishes looks cheap to planes, and is as far from the rest as it was away: last of all
            parts_may_go: options.topology != TopologyPolicy::Manifold,
            min_normal_cos: options.max_normal_turn.map(f64::cos),
            valence: options.valence,
            min_quality: options.min_quality,
            no_self_intersections: options.no_self_intersections,
            max_error_sq: options.target.max_error.map(|e| (e / frame.unit()).powi(2)),
        },
        importance: &options.importance,
        strictness: &options.strictness,
    };
    let close = options.join_distance.map(|distance| pairs::close_pairs(&positions, distance));
    let mut metric = quadric_options(&options).map(QuadricMetric::new);
    let mut done = Done::default();
    let (importance, strictness);
    let mut faces = match &mut metric {
        Some(metric) if wants_passes(&options) => {
            let mut surface = Surface::new(frame, positions, &triangles, &wedges, &options);
            drop(triangles);
            let observer = if wedges.is_idle() { None } else { Some(&mut wedges) };
            done = collapse_in_passes(&mut surface, metric, observer, &request, control)?;
            let faces;
            (faces, importance, strictness) = surface.into_collapse_mesh(triangles_in);
            (request.importance, request.strictness) = (&importance, &strictness);
            faces
        }
        _ => CollapseMesh::in_frame(frame, positions, triangles.into_iter()),
    };
    if let Some(close) = close {
        faces.add_pairs(&close);
    }
    let mut features = Features::new(&wedges, &faces, &options);
    let outcome = match metric {
        None => {
            let mut metric = ShortestEdge::new(options.placement);
            collapse_edges(&mut faces, &mut metric, &mut features, &mut wedges, &request, control)
        }
        Some(mut metric) => collapse_edges(&mut faces, &mut metric, &mut features, &mut wedges, &request, control),
    }?;
    *mesh = wedges.finish(faces);
    Ok(SimplifyReport {
        triangles_in,
        triangles_out: mesh.triangle_count(),
        collapses: done.collapses + outcome.collapses,
        error: done.error.max(outcome.error),
        stopped: match outcome.stopped {
            Stop::Triangles if options.target.triangles.is_none() => Stop::Exhausted,
            stopped => stopped,
        },
        refused: outcome.refused,
    })
}

/// Whether passes come first: they know neither valence nor quality of triangles nor pairs nor what lies near.
fn wants_passes(options: &SimplifyOptions) -> bool {
    options.order == Order::Passes
        && options.valence.is_none()
        && options.min_quality.is_none()
        && options.join_distance.is_none()
        && !options.no_self_intersections
}

/// A copy of the mesh in spatial order, and the options with their lists in the same order.
///
/// Neighbours that are near in memory are worth more than any other choice of layout; input that is in order already
/// loses little.
fn sorted(mesh: &Mesh, options: &SimplifyOptions) -> (Mesh, SimplifyOptions) {
    let (mut mesh, mut options) = (mesh.clone(), options.clone());
    let order = mesh.sort_spatially();
    if !options.locked.is_empty() {
        options.locked = order.iter().map(|&v| options.locked[v as usize]).collect();
    }
    if !options.strictness.is_empty() {
        options.strictness = order.iter().map(|&v| options.strictness[v as usize]).collect();
    }
    if !options.importance.is_empty() {
        options.importance = order.iter().map(|&v| options.importance[v as usize]).collect();
    }
    (mesh, options)
}

/// The options of the quadric metrics, `None` for the metric that has no quadrics.
fn quadric_options(options: &SimplifyOptions) -> Option<QuadricOptions> {
    let (constrained, memory, normalized) = match options.metric {
        MetricKind::ShortestEdge => return None,
        MetricKind::Quadric => (false, QuadricMemory::Summed, false),
        MetricKind::ConstrainedQuadric => (true, QuadricMemory::Summed, false),
        MetricKind::MemorylessQuadric => (false, QuadricMemory::Rebuilt, false),
        MetricKind::ConstrainedMemorylessQuadric => (true, QuadricMemory::Rebuilt, false),
        MetricKind::HybridQuadric => (true, QuadricMemory::Both, false),
        MetricKind::NormalizedQuadric => (true, QuadricMemory::Summed, true),
    };
    Some(QuadricOptions {
        weight: options.quadric_weight,
        placement: options.placement,
        constraint: constrained.then_some(options.constraint_weight),
        memory,
        normalized,
    })
}

fn check_options(mesh: &Mesh, options: &SimplifyOptions) -> Result<(), SimplifyError> {
    let invalid = |name, reason: &str| Err(SimplifyError::InvalidOption { name, reason: reason.to_owned() });
    let positive = |x: f64| x >= 0.0 && x.is_finite();
    if options.target.triangles.is_none() && options.target.max_error.is_none() {
        return invalid("target", "neither a triangle count nor an error is given");
    }
    if !options.target.max_error.is_none_or(|e| e >= 0.0) {
        return invalid("max_error", "must not be negative or NaN");
    }
    if !positive(options.constraint_weight) {
        return invalid("constraint_weight", "must be finite and not negative");
    }
    if !options.join_distance.is_none_or(positive) {
        return invalid("join_distance", "must be finite and not negative");
    }
    if !options.max_normal_turn.is_none_or(|a| (0.0..=std::f64::consts::PI).contains(&a)) {
        return invalid("max_normal_turn", "must be between 0 and pi");
    }
    if options.valence.is_some_and(|(low, high)| low > high) {
        return invalid("valence", "the lower bound is above the upper one");
    }
    if !options.min_quality.is_none_or(|q| (0.0..=1.0).contains(&q)) {
        return invalid("min_quality", "must be between 0 and 1");
    }
    if options.max_influences == Some(0) {
        return invalid("max_influences", "at least one joint must move a wedge");
    }
    let per_vertex = [
        ("locked", options.locked.len()),
        ("importance", options.importance.len()),
        ("strictness", options.strictness.len()),
    ];
    if let Some((name, _)) = per_vertex.into_iter().find(|&(_, n)| n != 0 && n != mesh.vertex_count()) {
        return invalid(name, "needs one entry per vertex, or none at all");
    }
    if !options.importance.iter().all(|&x| positive(f64::from(x))) {
        return invalid("importance", "must be finite and not negative");
    }
    if !options.strictness.iter().all(|&x| x >= 0.0) {
        return invalid("strictness", "must not be negative or NaN");
    }
    let broken = |p: &[f32; 3]| !p.iter().all(|x| x.is_finite());
    match mesh.positions.iter().position(broken) {
        Some(vertex) => Err(SimplifyError::NotFinite { vertex }),
        None => Ok(()),
    }
}
