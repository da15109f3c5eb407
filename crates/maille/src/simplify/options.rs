//! What a caller asks of the simplifier, and what it answers.

use super::metric::QuadricMemory;
use crate::cluster::ClusterError;
use crate::control::Cancelled;
use crate::mesh::Semantic;
use crate::skin::Pose;

/// When to stop. Several may be given; the first one reached stops the work.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Target {
    /// Stop at this many triangles or fewer. Unless it is zero, at least one triangle stays.
    pub triangles: Option<usize>,
    /// Stop before the error would exceed this distance, in model units.
    pub max_error: Option<f64>,
}

/// What a collapse costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum MetricKind {
    /// Shortest edge first (seed 000, 4.3.1: SEM).
    ShortestEdge,
    /// Plane quadrics, summed as vertices merge (Garland and Heckbert 1997; seed 000, 4.3.2: QEM).
    Quadric,
    /// [`Quadric`](Self::Quadric) with constraint planes through border edges (seed 000, 4.3.3).
    ConstrainedQuadric,
    /// Quadrics rebuilt from the current triangles at every step (Lindstrom and Turk 1999; seed 000, 4.3.4).
    MemorylessQuadric,
    /// [`MemorylessQuadric`](Self::MemorylessQuadric) with constraint planes (seed 000, 4.3.5).
    ConstrainedMemorylessQuadric,
    /// Placed as [`ConstrainedMemorylessQuadric`](Self::ConstrainedMemorylessQuadric), at its cost and a share of that of
    /// [`ConstrainedQuadric`](Self::ConstrainedQuadric): nearly as near to the original as the one, and thin
    /// ends last as long as with the other.
    #[default]
    HybridQuadric,
    /// [`ConstrainedQuadric`](Self::ConstrainedQuadric) divided by the accumulated weight, a mean squared distance
    /// (seed 002, 6.3).
    NormalizedQuadric,
    /// Volumes and areas of border as they are now, with a placement by constraints (Lindstrom and Turk 1998 and 1999):
    /// see [`LindstromTurk`](super::LindstromTurk). [`QuadricWeight`] does not apply: faces count by the square of their
    /// area.
    LindstromTurk,
    /// [`ConstrainedQuadric`](Self::ConstrainedQuadric) with the expected distances from uncertain planes
    /// (Trettner and Kobbelt 2020): [`position_sigma`](SimplifyOptions::position_sigma) and
    /// [`normal_sigma`](SimplifyOptions::normal_sigma).
    ProbabilisticPlane,
    /// [`ConstrainedQuadric`](Self::ConstrainedQuadric) with the expected distances from triangles with uncertain corners
    /// (Trettner and Kobbelt 2020): [`position_sigma`](SimplifyOptions::position_sigma).
    ProbabilisticTriangle,
    /// [`ConstrainedQuadric`](Self::ConstrainedQuadric) with a share of the distance from the line along each vertex's
    /// normal, which keeps vertices evenly spread (Liu, Rahimzadeh and Zordan 2025):
    /// [`line_weight`](SimplifyOptions::line_weight).
    LineQuadrics,
}

impl MetricKind {
    /// All metrics with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 11] = [
        ("sem", Self::ShortestEdge),
        ("qem", Self::Quadric),
        ("qem-constrained", Self::ConstrainedQuadric),
        ("qem-memoryless", Self::MemorylessQuadric),
        ("qem-memoryless-constrained", Self::ConstrainedMemorylessQuadric),
        ("qem-hybrid", Self::HybridQuadric),
        ("qem-normalized", Self::NormalizedQuadric),
        ("lindstrom-turk", Self::LindstromTurk),
        ("probabilistic-plane", Self::ProbabilisticPlane),
        ("probabilistic-triangle", Self::ProbabilisticTriangle),
        ("line-quadrics", Self::LineQuadrics),
    ];

    /// The placement that serves a metric best: the middle of the edge where there is nothing to minimise.
    pub fn usual_placement(self) -> PlacementKind {
        match self {
            Self::ShortestEdge => PlacementKind::Midpoint,
            _ => PlacementKind::default(),
        }
    }
}

impl MetricKind {
    /// With which power of the size of a model the costs grow: squared distances, times areas or squared areas.
    pub fn cost_power(self, weight: QuadricWeight) -> i32 {
        match (self, weight) {
            (Self::ShortestEdge | Self::NormalizedQuadric, _) | (_, QuadricWeight::Uniform | QuadricWeight::Angle) => 2,
            (Self::LindstromTurk, _) | (_, QuadricWeight::AreaSquared) => 6,
            (_, QuadricWeight::Area) => 4,
        }
    }
}

/// How much a triangle's plane counts in the quadrics of its vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum QuadricWeight {
    /// Every plane the same.
    Uniform,
    /// By the triangle's area: the quadric of a region does not depend on its tessellation (seed 001, 2.4.3).
    #[default]
    Area,
    /// By the square of the triangle's area, as in the first paper of Garland and Heckbert and in those of Lindstrom and
    /// Turk.
    AreaSquared,
    /// By the triangle's angle at the vertex.
    Angle,
}

/// In which order edges collapse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Order {
    /// The cheapest first, always.
    Exact,
    /// As long as many edges are left (32,768), costs within a factor of 1.5 count as equal, and among equals the order
    /// is that of space: what is worked on next is near in memory. On a million triangles this takes a third to a half
    /// less time, and the measured error rises by less than 1 %.
    Spatial,
    /// As long as many triangles are left (32,768) in passes, on all cores: each part of the surface by itself takes its
    /// cheapest edges, up to a cost that is the same for all. Borders, seams and the rest go the way of
    /// [`Spatial`](Self::Spatial). On a million triangles three to five times as fast on one core, at the same measured error
    /// within 2 %. Limits on valence, triangle quality, deviation of normals and self-intersections, pairs to be joined,
    /// attributes that count, weights by angle and metrics that know more than planes of faces rule passes out.
    #[default]
    Passes,
}

impl Order {
    /// All orders with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 3] =
        [("exact", Self::Exact), ("spatial", Self::Spatial), ("passes", Self::Passes)];
}

/// Where the merged vertex goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum PlacementKind {
    /// Onto the better of the two end points (half-edge collapse).
    Subset,
    /// Onto the middle of the edge.
    Midpoint,
    /// Where the quadric is least; where it is singular, the least-squares point nearest the middle, else the best
    /// point of the segment, else the better end point.
    Optimal,
    /// As [`Optimal`](Self::Optimal), among the points that leave the volume under the surface as it is (Lindstrom and
    /// Turk 1998), unless that costs much more.
    #[default]
    OptimalVolume,
}

impl PlacementKind {
    /// All placements with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("subset", Self::Subset),
        ("midpoint", Self::Midpoint),
        ("optimal", Self::Optimal),
        ("optimal-volume", Self::OptimalVolume),
    ];
}

/// What happens to edges of one sort: open borders, seams of attributes, borders between materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum EdgePolicy {
    /// Nothing special.
    Free,
    /// Nothing is forbidden, but planes through them make it costly to leave them
    /// ([`constraint_weight`](SimplifyOptions::constraint_weight), with the constrained and the hybrid metrics).
    Hold,
    /// They may collapse along themselves; nothing is pulled off or across them.
    #[default]
    Preserve,
    /// Their vertices stay where they are.
    Lock,
}

/// What collapses may do to the topology.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum TopologyPolicy {
    /// Nothing: the link condition holds for every collapse (Dey et al. 1999, seed 001, 2.3.3), so that components,
    /// boundary loops and handles stay as they are.
    Preserve,
    /// What is manifold stays so, but a hole of three edges may close; and when there is nothing else left to collapse, the
    /// last triangles of a component may go, unless a largest error is asked for: the metrics do not see how far what
    /// vanishes is from the rest. So holes and specks do not keep a coarse level from its triangles.
    #[default]
    Manifold,
    /// Anything: handles may close and parts touch, with non-manifold edges and vertices where they do.
    Free,
}

impl TopologyPolicy {
    /// All policies with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 3] =
        [("preserve", Self::Preserve), ("manifold", Self::Manifold), ("free", Self::Free)];
}

/// How the normals of merged wedges come about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum NormalPolicy {
    /// Interpolated along the edge and made unit.
    #[default]
    Interpolate,
    /// The mean of the triangles that share the wedge, weighted by their angle (seed 000, 4.2.3).
    Recompute,
}

/// How much wedge attributes count in quadric metrics, besides the surface.
///
/// Each has an automatic weight, which tells what distance a difference of 1 is worth; factors are on these. Skins and
/// tangents never count: what they do shows in motion and follows from the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct AttributeWeights {
    /// Factor on the weights of all that is not named; 0: they do not count.
    pub factor: f64,
    /// Factors on some attributes.
    pub named: Vec<(Semantic, f64)>,
}

impl AttributeWeights {
    /// Only the surface counts.
    pub const NONE: Self = Self { factor: 0.0, named: Vec::new() };

    /// The factor of an attribute.
    pub fn factor_of(&self, semantic: &Semantic) -> f64 {
        self.named.iter().rev().find(|(named, _)| named == semantic).map_or(self.factor, |&(_, factor)| factor)
    }
}

impl Default for AttributeWeights {
    fn default() -> Self {
        Self { factor: 1.0, named: Vec::new() }
    }
}

/// How attributes enter the metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum AttributeMetricKind {
    /// By their gradients over the surface (Hoppe 1999, Hoppe and Marschner 2000); added to the metric of the surface.
    #[default]
    Gradients,
    /// By distances in the space of positions and attributes together (Garland and Heckbert 1998), summed; in place of the
    /// metric of the surface. For comparison: time and memory grow with the square of the number of channels.
    GeneralizedQuadric,
}

impl AttributeMetricKind {
    /// All kinds with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 2] =
        [("gradients", Self::Gradients), ("generalized-quadric", Self::GeneralizedQuadric)];
}

/// In which space differences of colours count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum ColorSpace {
    /// As the values are stored.
    #[default]
    Rgb,
    /// CIE L*a*b* by a hundredth ([`color::to_lab`](crate::color::to_lab)), where equal differences look equal.
    Lab,
}

impl ColorSpace {
    /// All spaces with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 2] = [("rgb", Self::Rgb), ("lab", Self::Lab)];
}

/// What simplification has done to an attribute that counted in the metric.
#[derive(Debug, Clone, PartialEq)]
pub struct AttributeError {
    /// Which.
    pub semantic: Semantic,
    /// Distance that a difference of 1 was worth, in model units.
    pub weight: f64,
    /// Largest error of a collapse, in units of the attribute (of colours, in those of their space): root of the mean squared difference over the faces around.
    /// As the error of the surface it is an estimate of the metric.
    pub error: f64,
}

/// A point on the way of a simplification: how many triangles were left, and how much collapses had cost by then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Triangles left.
    pub triangles: usize,
    /// Highest cost of a collapse so far, in model units to the power of [`MetricKind::cost_power`].
    pub cost: f64,
}

/// Everything the simplifier can be asked for. `SimplifyOptions::default()` with a target is what most want.
#[derive(Debug, Clone, PartialEq)]
pub struct SimplifyOptions {
    /// When to stop; at least one of its parts must be given.
    pub target: Target,
    /// What a collapse costs.
    pub metric: MetricKind,
    /// How planes are weighted in quadric metrics.
    pub quadric_weight: QuadricWeight,
    /// What quadrics know of the past; `None`: what the metric is named after.
    pub memory: Option<QuadricMemory>,
    /// Standard deviation of positions in the probabilistic metrics, relative to the mean length of an edge.
    pub position_sigma: f64,
    /// Standard deviation of unit normals, in each coordinate, in [`MetricKind::ProbabilisticPlane`].
    pub normal_sigma: f64,
    /// Weight of the lines in [`MetricKind::LineQuadrics`], relative to the planes.
    pub line_weight: f64,
    /// Where merged vertices go.
    pub placement: PlacementKind,
    /// What the attributes of wedges count, with quadric metrics.
    pub attributes: AttributeWeights,
    /// In which space differences of colours count, and colours are mixed.
    pub color_space: ColorSpace,
    /// How attributes enter the metric.
    pub attribute_metric: AttributeMetricKind,
    /// Whether triangles may be turned over in the texture, where texture coordinates count.
    pub texture_may_fold: bool,
    /// Refuse collapses after which texture coordinates that count are off by more than this, by the estimate of the
    /// metric: root of the mean square around the vertex, in units of texture coordinates; steps add up as independent
    /// errors do. `None`: allow all.
    pub max_texture_error: Option<f64>,
    /// In which order edges collapse.
    pub order: Order,
    /// Open borders.
    pub boundary: EdgePolicy,
    /// Edges where a wedge attribute jumps.
    pub seams: EdgePolicy,
    /// Edges between triangles of different materials.
    pub material_borders: EdgePolicy,
    /// Weight of the constraint planes of preserved edges, relative to the triangles (1: as much as a square of the
    /// edge's length).
    pub constraint_weight: f64,
    /// What collapses may do to the topology.
    pub topology: TopologyPolicy,
    /// Refuse collapses after which a triangle's normal turns by more than this angle, in radians; `None`: allow all.
    pub max_normal_turn: Option<f64>,
    /// Refuse collapses after which the normal of a triangle deviates by more than this angle, in radians, from that of an
    /// original triangle that it stands for; `None`: allow all. Other than [`max_normal_turn`](Self::max_normal_turn)
    /// this adds up over all collapses. A triangle stands for itself, and for those whose gap it has closed
    /// (normal cones: Cohen et al. 1998).
    pub max_normal_deviation: Option<f64>,
    /// Refuse collapses that leave a vertex with a valence outside this range (seed 002 uses 4 to 11).
    pub valence: Option<(u32, u32)>,
    /// Refuse collapses that make a triangle both worse than before and worse than this quality
    /// (4 sqrt 3 area / sum of squared edges: 1 for an equilateral triangle, 0 for a needle).
    pub min_quality: Option<f64>,
    /// Refuse collapses whose new triangles would meet other triangles, or each other, beyond the vertices and edges that
    /// they share. A mesh that does not pass through itself then never does; where it does already, what lies there may stay
    /// as it is. What is too near to tell counts as meeting. Rules passes out; takes four to five times the time of
    /// the order [`Spatial`](Order::Spatial), and 6 bytes per triangle.
    pub no_self_intersections: bool,
    /// Poses in which quadric metrics look at the surface, instead of where its vertices are stored: the costs of all are
    /// added, each times its share. For plane quadrics weighted by area. Rules passes out; time and memory grow with the number
    /// of poses. Empty: none.
    pub poses: Vec<Pose>,
    /// Also join vertex pairs without an edge that are closer than this distance, in model units.
    pub join_distance: Option<f64>,
    /// Join only vertices of different parts of the surface.
    pub join_parts_only: bool,
    /// One entry per vertex: vertices that must stay. Empty: none.
    pub locked: Vec<bool>,
    /// One factor per vertex on the cost of its collapses (0 or more; 1 is neutral). Empty: all 1.
    pub importance: Vec<f32>,
    /// How much more collapses cost where contours are likely to be seen, relative to a model as curved as a sphere in its
    /// bounding box (about): costs are multiplied by `1 + weight * diagonal * density`, where the density is the
    /// length of contour that a unit of the surface shows to a random view. 0: silhouettes do not count.
    pub silhouette_weight: f64,
    /// One factor per vertex on the errors of its collapses before they are compared with `target.max_error` (0 or more; 1
    /// is neutral, more is stricter, infinite allows none). Costs, and so the order, do not change. Empty: all 1.
    pub strictness: Vec<f32>,
    /// Normals of merged wedges.
    pub normals: NormalPolicy,
    /// Most joints that move one wedge; `None`: as many as the attributes have room for.
    pub max_influences: Option<u32>,
    /// Cluster the vertices first, by quadrics ([`cluster`](mod@crate::cluster)), to this many times the wanted triangles,
    /// and collapse what is left (Garland and Shaffer 2002): for meshes so large that collapsing all of them takes too long.
    /// More than 1. A largest error is shared: clustering moves no vertex by more than half of it. Without a number of
    /// triangles there is nothing to be clustered to. `None`: collapse all.
    pub cluster_first: Option<f64>,
}

impl Default for SimplifyOptions {
    fn default() -> Self {
        Self {
            target: Target::default(),
            metric: MetricKind::default(),
            quadric_weight: QuadricWeight::default(),
            memory: None,
            position_sigma: 0.01,
            normal_sigma: 0.01,
            line_weight: 1e-3,
            placement: PlacementKind::default(),
            attributes: AttributeWeights::default(),
            color_space: ColorSpace::default(),
            attribute_metric: AttributeMetricKind::default(),
            texture_may_fold: false,
            max_texture_error: None,
            order: Order::default(),
            boundary: EdgePolicy::default(),
            seams: EdgePolicy::Hold,
            material_borders: EdgePolicy::Hold,
            constraint_weight: 1.0,
            topology: TopologyPolicy::default(),
            max_normal_turn: Some(75.0_f64.to_radians()),
            max_normal_deviation: None,
            valence: None,
            min_quality: None,
            no_self_intersections: false,
            poses: Vec::new(),
            join_distance: None,
            join_parts_only: false,
            locked: Vec::new(),
            importance: Vec::new(),
            silhouette_weight: 0.0,
            strictness: Vec::new(),
            normals: NormalPolicy::default(),
            max_influences: None,
            cluster_first: None,
        }
    }
}

/// Why the simplifier stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Stop {
    /// The wanted number of triangles was reached.
    Triangles,
    /// The next collapse would exceed the wanted error.
    MaxError,
    /// Every collapse left is forbidden by a constraint.
    NoLegalCollapse,
    /// No edge is left.
    Exhausted,
}

/// How many candidate collapses each constraint refused (a pair may be refused several times).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refusals {
    /// Because of the topology.
    pub topology: u64,
    /// By the fold-over test.
    pub fold_over: u64,
    /// By the bound on the deviation of normals from the original.
    pub normal_deviation: u64,
    /// By borders, seams or material borders.
    pub border: u64,
    /// By locked vertices.
    pub locked: u64,
    /// By the valence range, or because so many faces meet at a vertex that testing them would take for ever.
    pub valence: u64,
    /// By the quality of triangles.
    pub quality: u64,
    /// Because a triangle would be turned over in the texture, or the texture would slip too far.
    pub texture: u64,
    /// Because the surface would have passed through itself.
    pub self_intersections: u64,
}

/// What the simplifier did.
#[derive(Debug, Clone, PartialEq)]
pub struct SimplifyReport {
    /// Triangles before.
    pub triangles_in: usize,
    /// Triangles after.
    pub triangles_out: usize,
    /// Edge collapses done.
    pub collapses: u64,
    /// Largest error of a collapse, in model units: an estimate by the metric, not a bound; measure with
    /// [`compare`](crate::measure).
    pub error: f64,
    /// What became of the attributes that counted in the metric.
    pub attributes: Vec<AttributeError>,
    /// How the costs have risen, about every sixteenth of the triangles: what a budget over several meshes is made with.
    pub curve: Vec<CurvePoint>,
    /// Why it stopped.
    pub stopped: Stop,
    /// What the constraints refused.
    pub refused: Refusals,
}

/// Why the simplifier refused to start, or did not end.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimplifyError {
    /// An option makes no sense.
    #[error("option {name}: {reason}")]
    InvalidOption {
        /// Its name.
        name: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The mesh breaks an invariant.
    #[error(transparent)]
    Mesh(#[from] crate::mesh::MeshError),
    /// A position is not finite.
    #[error("vertex {vertex} is not finite; repair the mesh first")]
    NotFinite {
        /// Which vertex.
        vertex: usize,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<ClusterError> for SimplifyError {
    fn from(error: ClusterError) -> Self {
        match error {
            ClusterError::InvalidOption { name, reason } => Self::InvalidOption { name, reason },
            ClusterError::Mesh(error) => Self::Mesh(error),
            ClusterError::NotFinite { vertex } => Self::NotFinite { vertex },
            ClusterError::Cancelled(cancelled) => Self::Cancelled(cancelled),
        }
    }
}
