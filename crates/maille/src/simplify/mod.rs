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
//! | `local_quadric` | the same for passes: in single precision, four edges at a time |
//! | `attributes/` | the same with what wedges carry: by gradients, by generalised quadrics |
//! | `corners` | which wedge each corner has |
//! | `lindstrom_turk` | the metric of Lindstrom and Turk |
//! | `uncertain` | probabilistic quadrics, line quadrics |
//! | `silhouette` | where contours are likely to be seen |
//! | `features` | borders, seams, material borders, locks |
//! | `legality` | link condition, fold-over, valence, quality |
//! | `crossings` | collapses after which the surface would pass through itself |
//! | `normal_cones` | normals of the original |
//! | `wedges` | attributes of merged wedges |
//! | `pairs` | vertices to be joined although no edge does |

mod attributes;
mod corners;
mod crossings;
mod driver;
mod features;
mod legality;
mod lindstrom_turk;
mod local_quadric;
mod metric;
mod normal_cones;
mod options;
mod pairs;
mod passes;
mod patience;
mod poses;
mod quadric;
mod queue;
mod record;
mod silhouette;
mod uncertain;
mod wedges;

#[cfg(test)]
mod tests;

pub use driver::{Observer, Outcome, Request, collapse_edges};
pub use features::{Barred, Features};
pub use legality::{Collapse, Limits, triangle_quality};
pub use lindstrom_turk::LindstromTurk;
pub use metric::{
    Anchor, Candidate, EdgeContext, Metric, QuadricMemory, QuadricMetric, QuadricOptions, ShortestEdge, Update,
};
pub use options::{
    AttributeError, AttributeMetricKind, AttributeWeights, ColorSpace, CurvePoint, EdgePolicy, MetricKind,
    NormalPolicy, Order, PlacementKind, QuadricWeight, Refusals, SimplifyError, SimplifyOptions, SimplifyReport, Stop,
    Target, TopologyPolicy,
};
pub use quadric::Quadric;
pub use uncertain::FaceQuadric;
pub use wedges::WedgeMerger;

pub(crate) use attributes::Lifted;
pub(crate) use record::{Record, Recording, Rows, attributes_of_wedges, attributes_of_wedges_mut};

use rayon::prelude::*;

use crate::cluster::{ClusterOptions, ClusterReport, cluster_mapped};
use crate::topology::collapse_mesh::Frame;
use crate::topology::{CollapseMesh, UnionFind};

use crate::mesh::order::{curve_order, ranks};
use crate::{Control, Mesh};
use attributes::{AttributeMetric, GeneralizedQuadrics};
use passes::{Done, Surface, collapse_in_passes};
use poses::Posed;
use record::Recorder;

/// Reduces a triangle mesh by greedy edge collapse, cheapest first.
///
/// Any triangle mesh will do: non-manifold edges and vertices, open borders, several components. Wedges merge by the
/// continuity across the vanishing triangles, attributes are blended; those of untouched wedges keep their bits. The
/// result has no unused vertices or wedges and is in spatial order ([`Mesh::sort_spatially`]). Triangles that name a
/// vertex twice are dropped.
///
/// Units: `max_error` and the reported error are distances in model units. Cost: O(n log n) time; [`StageTimes`](crate::StageTimes)
/// tells that of `sorting`, `preparing`, `passes`, `queue` and `finishing`.
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
    if let Some(clustered) = clustered_first(mesh, options, control)? {
        return clustered.collapse(mesh, options, control);
    }
    let (report, _) = collapse(mesh, options, false, control)?;
    Ok(report)
}

/// All that was done to a mesh, and what is to be done to what is made of it.
pub(crate) type Recorded = (Box<Recording>, Lifted);

/// Reduces a mesh as [`simplify`] does, and writes down every collapse, so that each can be undone: what a
/// [`ProgressiveMesh`](crate::progressive::ProgressiveMesh) is made of. The mesh is left with the attributes of all wedges
/// and vertices that there ever were, as they were last, in spatial order, without positions and triangles.
pub(crate) fn simplify_recorded(
    mesh: &mut Mesh,
    options: &SimplifyOptions,
    control: Control<'_>,
) -> Result<(SimplifyReport, Recorded), SimplifyError> {
    mesh.check()?;
    check_options(mesh, options)?;
    let invalid = |name, reason: &str| Err(SimplifyError::InvalidOption { name, reason: reason.to_owned() });
    if options.cluster_first.is_some() {
        return invalid("cluster_first", "clustering cannot be undone step by step");
    }
    if options.normals == NormalPolicy::Recompute {
        return invalid("normals", "they are computed anew in the end, not in each step");
    }
    let (report, recorded) = collapse(mesh, options, true, control)?;
    Ok((report, recorded.expect("it was asked for")))
}

/// Collapses edges, and writes down how, if that is asked for.
fn collapse(
    mesh: &mut Mesh,
    options: &SimplifyOptions,
    is_recorded: bool,
    control: Control<'_>,
) -> Result<(SimplifyReport, Option<Recorded>), SimplifyError> {
    let triangles_in = mesh.triangle_count();
    let frame = Frame::of(&mesh.positions);
    let quadric = quadric_options(options, || mean_edge(&frame, mesh));
    let in_passes =
        quadric.filter(|quadric| wants_passes(options) && triangles_in >= passes::FEWEST && passes::know(quadric));
    let in_passes = in_passes.filter(|_| !is_recorded);
    let passed = match in_passes.filter(|_| is_bare(mesh)) {
        Some(quadric) => Some(pass_over_bare(mesh, options, quadric, frame, control)?),
        None => None,
    };
    let target = options.target.triangles.unwrap_or(1);
    let (mut done, mut surface_metric) = (Done::default(), None);
    let (mut work, mut options) = match passed {
        Some(passed) if passed.mesh.triangle_count() <= target => {
            *mesh = passed.mesh;
            return Ok((report_of(triangles_in, mesh, passed.done.outcome(), options, &frame), None));
        }
        Some(passed) => {
            (done, surface_metric) = (passed.done, Some(passed.metric));
            (passed.mesh, passed.options)
        }
        None => control.time("sorting", || sorted(mesh, options)),
    };
    let is_passed = surface_metric.is_some();
    let lifted = if quadric.is_some() { Lifted::lift(&mut work, &options) } else { Lifted::default() };
    let is_generalized = options.attribute_metric == AttributeMetricKind::GeneralizedQuadric;
    let posed = || (!options.poses.is_empty()).then(|| Posed::new(&work, &frame, &options.poses));
    let surface = |q| QuadricMetric::new(q).in_poses(posed());
    let mut appearance =
        quadric.filter(|_| !is_generalized).and_then(|q| AttributeMetric::new(surface(q), &work, &frame, &options));
    let mut generalized =
        quadric.filter(|_| is_generalized).and_then(|q| GeneralizedQuadrics::new(q, &work, &frame, &options));
    if appearance.is_none() && generalized.is_none() && !is_passed {
        surface_metric = quadric.map(surface);
    }
    let positions = std::mem::take(&mut work.positions);
    let triangles: Vec<[u32; 3]> = work.triangles.iter().map(|t| t.map(|w| work.wedge_vertices[w as usize])).collect();
    if !is_passed {
        weigh_silhouettes(&mut options, &positions, &triangles);
    }
    let options = options;
    let corners = if is_recorded { work.triangles.clone() } else { Vec::new() };
    let mut wedges = WedgeMerger::new(work, &options);
    let has_positions_only = wedges.is_idle();
    let mut request = request_of(&options, &frame);
    let close = options.join_distance.map(|distance| {
        let parts = options.join_parts_only.then(|| parts_of(positions.len(), &triangles));
        pairs::close_pairs(&positions, distance, parts.as_deref())
    });
    let rest;
    let mut faces = match &mut surface_metric {
        Some(metric) if in_passes.is_some() && !is_passed => {
            let vertices = positions.len();
            let new_surface = || Surface::new(frame, positions, &triangles, Some(&wedges), &options);
            let mut surface = control.time("preparing", new_surface);
            drop(triangles);
            let observer = if wedges.is_idle() { None } else { Some(&mut wedges) };
            let passes = || collapse_in_passes(&mut surface, &metric.options, observer, &request, control);
            done = control.time("passes", passes)?;
            let faces;
            (faces, rest) = control.time("preparing", || surface.into_collapse_mesh(vertices, triangles_in));
            metric.start_with(rest.sums, rest.drift_sq);
            (request.importance, request.strictness) = (&rest.importance, &rest.strictness);
            faces
        }
        _ => control.time("preparing", || CollapseMesh::in_frame(frame, positions, triangles.into_iter())),
    };
    if let Some(close) = close {
        faces.add_pairs(&close);
    }
    let mut features = Features::new(&wedges, &faces, &options);
    let mut observer =
        if is_recorded { Recorder::new(wedges, faces.positions().to_vec(), corners) } else { Recorder::idle(wedges) };
    let outcome = control.time("queue", || match (surface_metric, &mut appearance, &mut generalized) {
        (Some(mut metric), ..) => {
            collapse_edges(&mut faces, &mut metric, &mut features, &mut observer, &request, control)
        }
        (_, Some(metric), _) => collapse_edges(&mut faces, metric, &mut features, &mut observer, &request, control),
        (.., Some(metric)) => collapse_edges(&mut faces, metric, &mut features, &mut observer, &request, control),
        _ if options.metric == MetricKind::LindstromTurk => {
            let mut metric = LindstromTurk::new(options.placement, options.constraint_weight, has_positions_only);
            collapse_edges(&mut faces, &mut metric, &mut features, &mut observer, &request, control)
        }
        _ => {
            let mut metric = ShortestEdge::new(options.placement);
            collapse_edges(&mut faces, &mut metric, &mut features, &mut observer, &request, control)
        }
    })?;
    let carried = appearance.map(|metric| metric.carried).or(generalized.map(|metric| metric.carried));
    let attributes = carried.as_ref().map_or_else(Vec::new, |carried| carried.errors());
    let outcome = done.and(outcome);
    let (mut wedges, recording) = observer.into_parts();
    if let Some(carried) = &carried {
        carried.give_all_values(wedges.mesh_mut());
    }
    if let Some(mut recording) = recording {
        recording.left = (0..faces.face_count() as u32).filter(|&f| faces.face(f as usize).is_some()).collect();
        let unit = unit_of_costs(&options, &frame);
        recording.collapses.iter_mut().for_each(|record| record.cost = (f64::from(record.cost) * unit) as f32);
        *mesh = wedges.into_mesh();
        let report = SimplifyReport {
            attributes,
            triangles_out: recording.left.len(),
            ..report_of(triangles_in, mesh, outcome, &options, &frame)
        };
        return Ok((report, Some((recording, lifted))));
    }
    *mesh = control.time("finishing", || wedges.finish(faces));
    lifted.put_back(mesh);
    Ok((SimplifyReport { attributes, ..report_of(triangles_in, mesh, outcome, &options, &frame) }, None))
}

/// What passes have left of a mesh, and what is to go on with.
struct Passed {
    mesh: Mesh,
    /// With lists for the vertices that are left.
    options: SimplifyOptions,
    metric: QuadricMetric,
    done: Done,
}

/// Whether a mesh is but positions and triangles.
fn is_bare(mesh: &Mesh) -> bool {
    let attributes = [&mesh.wedge_attributes, &mesh.vertex_attributes, &mesh.triangle_attributes];
    attributes.iter().all(|all| all.is_empty())
        && mesh.morph_targets.is_empty()
        && mesh.triangle_materials.is_empty()
        && mesh.material_names.is_empty()
        && mesh.wedge_count() == mesh.vertex_count()
        && mesh.wedge_vertices.iter().zip(0..).all(|(&v, w)| v == w)
}

/// Passes over a mesh that is but positions and triangles: what they do not need is never made.
fn pass_over_bare(
    mesh: &Mesh,
    options: &SimplifyOptions,
    quadric: QuadricOptions,
    frame: Frame,
    control: Control<'_>,
) -> Result<Passed, SimplifyError> {
    let (positions, triangles, mut options) = control.time("sorting", || {
        let order = curve_order(&mesh.positions);
        let ranks = ranks(&order);
        let positions: Vec<[f32; 3]> = order.iter().map(|&v| mesh.positions[v as usize]).collect();
        let triangles: Vec<[u32; 3]> = mesh.triangles.par_iter().map(|t| t.map(|v| ranks[v as usize])).collect();
        (positions, triangles, in_order(options, &order))
    });
    weigh_silhouettes(&mut options, &positions, &triangles);
    let mut surface = control.time("preparing", || Surface::new(frame, positions, &triangles, None, &options));
    drop(triangles);
    let request = request_of(&options, &frame);
    let pass = || collapse_in_passes::<()>(&mut surface, &quadric, None, &request, control);
    let done = control.time("passes", pass)?;
    let (mesh, rest) = control.time("finishing", || surface.into_mesh());
    let mut metric = QuadricMetric::new(quadric);
    metric.start_with(rest.sums, rest.drift_sq);
    let mut options = in_order(&options, &rest.origin);
    (options.importance, options.strictness) = (rest.importance, rest.strictness);
    Ok(Passed { mesh, options, metric, done })
}

/// Makes what is likely to be seen as a contour count more, where that is asked for.
fn weigh_silhouettes(options: &mut SimplifyOptions, positions: &[[f32; 3]], triangles: &[[u32; 3]]) {
    if options.silhouette_weight <= 0.0 {
        return;
    }
    let factors = silhouette::factors(positions, triangles, options.silhouette_weight);
    if options.importance.is_empty() {
        options.importance = factors;
    } else {
        options.importance.iter_mut().zip(factors).for_each(|(importance, factor)| *importance *= factor);
    }
}

/// What the loops are asked for.
fn request_of<'a>(options: &'a SimplifyOptions, frame: &Frame) -> Request<'a> {
    Request {
        order: options.order,
        target_faces: options.target.triangles.unwrap_or(1),
        limits: Limits {
            topology: options.topology,
            // a small part that vanishes looks cheap to planes, and is as far from the rest as it was away: last of all
            parts_may_go: options.topology != TopologyPolicy::Manifold,
            min_normal_cos: options.max_normal_turn.map(f64::cos),
            max_normal_deviation: options.max_normal_deviation,
            valence: options.valence,
            min_quality: options.min_quality,
            no_self_intersections: options.no_self_intersections,
            // who limits how far a texture slips does not want parts to vanish instead: that is for limited errors
            max_error_sq: options
                .target
                .max_error
                .map(|e| (e / frame.unit()).powi(2))
                .or(options.max_texture_error.map(|_| f64::INFINITY)),
        },
        importance: &options.importance,
        strictness: &options.strictness,
    }
}

/// What a cost of 1 in the frame is in model units.
fn unit_of_costs(options: &SimplifyOptions, frame: &Frame) -> f64 {
    frame.unit().powi(options.metric.cost_power(options.quadric_weight))
}

/// What to tell of a simplification to a mesh.
fn report_of(
    triangles_in: usize,
    mesh: &Mesh,
    outcome: Outcome,
    options: &SimplifyOptions,
    frame: &Frame,
) -> SimplifyReport {
    let unit = unit_of_costs(options, frame);
    let mut curve = outcome.curve;
    curve.iter_mut().for_each(|point| point.cost *= unit);
    SimplifyReport {
        triangles_in,
        triangles_out: mesh.triangle_count(),
        collapses: outcome.collapses,
        error: outcome.error,
        curve,
        attributes: Vec::new(),
        stopped: match outcome.stopped {
            Stop::Triangles if options.target.triangles.is_none() => Stop::Exhausted,
            stopped => stopped,
        },
        refused: outcome.refused,
    }
}

/// A mesh whose vertices have been clustered before edges collapse.
struct Clustered {
    mesh: Mesh,
    report: ClusterReport,
    /// The vertex that each of the original is now part of.
    map: Vec<u32>,
}

/// Clusters vertices to a multiple of the target, if that is asked for and the mesh has more.
fn clustered_first(
    mesh: &Mesh,
    options: &SimplifyOptions,
    control: Control<'_>,
) -> Result<Option<Clustered>, SimplifyError> {
    let (Some(multiple), Some(target)) = (options.cluster_first, options.target.triangles) else { return Ok(None) };
    let triangles = (target as f64 * multiple).ceil() as usize;
    if triangles >= mesh.triangle_count() {
        return Ok(None);
    }
    let cluster = ClusterOptions {
        triangles: Some(triangles),
        max_error: options.target.max_error.map(|error| error / 2.0),
        locked: options.locked.clone(),
        importance: options.importance.clone(),
        ..ClusterOptions::default()
    };
    let mut mesh = mesh.clone();
    let (report, map) = cluster_mapped(&mut mesh, &cluster, control)?;
    Ok((report.triangles_out < report.triangles_in).then_some(Clustered { mesh, report, map }))
}

impl Clustered {
    /// Collapses edges of what is left, and puts the result in the place of `mesh`.
    fn collapse(
        mut self,
        mesh: &mut Mesh,
        options: &SimplifyOptions,
        control: Control<'_>,
    ) -> Result<SimplifyReport, SimplifyError> {
        let mut rest = SimplifyOptions { cluster_first: None, ..options.clone() };
        rest.target.max_error = options.target.max_error.map(|error| (error - self.report.error).max(0.0));
        let vertices = self.mesh.vertex_count();
        let (mut locked, mut importance) = (vec![false; vertices], vec![0.0_f32; vertices]);
        for (old, &new) in self.map.iter().enumerate().filter(|&(_, &new)| new != u32::MAX) {
            let new = new as usize;
            locked[new] |= options.locked.get(old).copied().unwrap_or(false);
            importance[new] = importance[new].max(options.importance.get(old).copied().unwrap_or(1.0));
        }
        rest.locked = if options.locked.is_empty() { Vec::new() } else { locked };
        rest.importance = if options.importance.is_empty() { Vec::new() } else { importance };
        let report = simplify(&mut self.mesh, &rest, control)?;
        *mesh = self.mesh;
        let triangles_in = self.report.triangles_in;
        Ok(SimplifyReport { triangles_in, error: self.report.error + report.error, ..report })
    }
}

/// The part of the surface that each vertex belongs to: the lowest vertex of it.
fn parts_of(vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut parts = UnionFind::new(vertices);
    for &[a, b, c] in triangles {
        parts.union(a, b);
        parts.union(b, c);
    }
    parts.into_roots()
}

/// Whether passes come first: they know neither valence nor quality of triangles, original normals, pairs nor what lies near.
fn wants_passes(options: &SimplifyOptions) -> bool {
    options.order == Order::Passes
        && options.valence.is_none()
        && options.min_quality.is_none()
        && options.max_normal_deviation.is_none()
        && options.join_distance.is_none()
        && !options.no_self_intersections
        && options.poses.is_empty()
}

/// A copy of the mesh in spatial order, and the options with their lists in the same order.
///
/// Neighbours that are near in memory are worth more than any other choice of layout; input that is in order already
/// loses little.
fn sorted(mesh: &Mesh, options: &SimplifyOptions) -> (Mesh, SimplifyOptions) {
    let mut mesh = mesh.clone();
    let order = mesh.sort_spatially();
    (mesh, in_order(options, &order))
}

/// The options with their lists in the order of the vertices.
fn in_order(options: &SimplifyOptions, order: &[u32]) -> SimplifyOptions {
    fn gathered<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
        let places = if values.is_empty() { &[] } else { order };
        places.iter().map(|&v| values[v as usize]).collect()
    }
    SimplifyOptions {
        locked: gathered(&options.locked, order),
        strictness: gathered(&options.strictness, order),
        importance: gathered(&options.importance, order),
        ..options.clone()
    }
}

/// The mean length of the triangles' edges, in the frame.
fn mean_edge(frame: &Frame, mesh: &Mesh) -> f64 {
    let perimeter = |t: usize| {
        let [a, b, c] = mesh.triangle_points(t);
        (a.distance(b) + b.distance(c) + c.distance(a)) / frame.unit()
    };
    let triangles = mesh.triangle_count();
    (0..triangles).map(perimeter).sum::<f64>() / (3 * triangles.max(1)) as f64
}

/// The weight of features in a metric that knows them, `None` for the others.
fn constraint_weight(options: &SimplifyOptions) -> Option<f64> {
    let knows_features = match options.metric {
        MetricKind::ShortestEdge | MetricKind::Quadric | MetricKind::MemorylessQuadric => false,
        MetricKind::ConstrainedQuadric
        | MetricKind::ConstrainedMemorylessQuadric
        | MetricKind::HybridQuadric
        | MetricKind::NormalizedQuadric
        | MetricKind::LindstromTurk
        | MetricKind::ProbabilisticPlane
        | MetricKind::ProbabilisticTriangle
        | MetricKind::LineQuadrics => true,
    };
    knows_features.then_some(options.constraint_weight)
}

/// The options of the quadric metrics, `None` for those that have no quadrics. `edge` is the mean length of an edge.
fn quadric_options(options: &SimplifyOptions, edge: impl Fn() -> f64) -> Option<QuadricOptions> {
    let memory = match options.metric {
        MetricKind::ShortestEdge | MetricKind::LindstromTurk => return None,
        MetricKind::MemorylessQuadric | MetricKind::ConstrainedMemorylessQuadric => QuadricMemory::Rebuilt,
        MetricKind::HybridQuadric => QuadricMemory::Both,
        _ => QuadricMemory::Summed,
    };
    let position = |sigma: f64| sigma * edge();
    Some(QuadricOptions {
        face: match options.metric {
            MetricKind::ProbabilisticPlane => FaceQuadric::ProbabilisticPlane {
                position: position(options.position_sigma),
                normal: options.normal_sigma,
            },
            MetricKind::ProbabilisticTriangle => {
                FaceQuadric::ProbabilisticTriangle { position: position(options.position_sigma) }
            }
            _ => FaceQuadric::Plane,
        },
        line: if options.metric == MetricKind::LineQuadrics { options.line_weight } else { 0.0 },
        weight: options.quadric_weight,
        placement: options.placement,
        constraint: constraint_weight(options),
        memory: options.memory.unwrap_or(memory),
        normalized: options.metric == MetricKind::NormalizedQuadric,
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
    let weights = [
        ("constraint_weight", options.constraint_weight),
        ("position_sigma", options.position_sigma),
        ("normal_sigma", options.normal_sigma),
        ("line_weight", options.line_weight),
        ("silhouette_weight", options.silhouette_weight),
    ];
    if let Some((name, _)) = weights.into_iter().find(|&(_, weight)| !positive(weight)) {
        return invalid(name, "must be finite and not negative");
    }
    let factors = options.attributes.named.iter().map(|&(_, factor)| factor);
    if !factors.chain([options.attributes.factor]).all(positive) {
        return invalid("attributes", "factors must be finite and not negative");
    }
    if !options.join_distance.is_none_or(positive) {
        return invalid("join_distance", "must be finite and not negative");
    }
    if !options.max_normal_turn.is_none_or(|a| (0.0..=std::f64::consts::PI).contains(&a)) {
        return invalid("max_normal_turn", "must be between 0 and pi");
    }
    if !options.max_normal_deviation.is_none_or(|a| (0.0..=std::f64::consts::PI).contains(&a)) {
        return invalid("max_normal_deviation", "must be between 0 and pi");
    }
    if options.valence.is_some_and(|(low, high)| low > high) {
        return invalid("valence", "the lower bound is above the upper one");
    }
    if !options.min_quality.is_none_or(|q| (0.0..=1.0).contains(&q)) {
        return invalid("min_quality", "must be between 0 and 1");
    }
    if !options.cluster_first.is_none_or(|multiple| multiple > 1.0 && multiple.is_finite()) {
        return invalid("cluster_first", "must be more than 1");
    }
    if !options.max_texture_error.is_none_or(positive) {
        return invalid("max_texture_error", "must be finite and not negative");
    }
    if !options.poses.is_empty() {
        let sees_poses = !matches!(
            options.metric,
            MetricKind::ShortestEdge
                | MetricKind::LindstromTurk
                | MetricKind::ProbabilisticPlane
                | MetricKind::ProbabilisticTriangle
                | MetricKind::LineQuadrics
        ) && options.quadric_weight == QuadricWeight::Area
            && options.attribute_metric == AttributeMetricKind::Gradients;
        if !sees_poses {
            return invalid("poses", "only quadrics of planes weighted by area are summed over them");
        }
        let shares = || options.poses.iter().map(|pose| pose.share);
        let is_finite = options.poses.iter().all(|pose| {
            pose.transform.is_finite()
                && pose.joint_matrices.iter().all(|matrix| matrix.is_finite())
                && pose.morph_weights.iter().all(|weight| weight.is_finite())
        });
        if !shares().all(positive) || shares().sum::<f64>() <= 0.0 || !is_finite {
            return invalid(
                "poses",
                "matrices and weights must be finite, shares not negative, and one of them more than 0",
            );
        }
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
