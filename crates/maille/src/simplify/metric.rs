//! What a collapse costs and where the merged vertex goes.

use glam::DVec3;
use rayon::prelude::*;

use super::features::Features;
use super::legality::Collapse;
use super::options::{PlacementKind, QuadricWeight};
use super::patience::Patience;
use super::poses::Posed;
use super::quadric::Quadric;
use super::uncertain::{FaceQuadric, normal_line};
use crate::Mesh;
use crate::prefetch::prefetch;
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::RingFace;

/// Which end of an edge the merged vertex may move to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// Anywhere.
    Free,
    /// It stays at the first end.
    First,
    /// It stays at the second end.
    Second,
}

/// An edge that might collapse, in the unit frame of the mesh.
#[derive(Debug, Clone, Copy)]
pub struct EdgeContext {
    /// The two vertices.
    pub ends: [u32; 2],
    /// Their positions.
    pub points: [DVec3; 2],
    /// Where the merged vertex may go.
    pub anchor: Anchor,
}

/// A placement and what it costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// What the queue sorts by.
    pub cost: f64,
    /// Squared distance from the original that the metric expects, in the unit frame.
    pub error_sq: f64,
    /// Where the merged vertex goes.
    pub position: DVec3,
}

/// When the costs of edges are computed again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Update {
    /// When they come up: right if costs never fall as vertices merge.
    WhenDue,
    /// Those at the merged vertex at once.
    AtVertex,
    /// Those at the merged vertex at once, and those at its neighbours when they come up.
    AtVertexThenRing,
}

/// Cost and placement of collapses: the plug of the simplifier's socket.
///
/// Cost and placement are one call because a cost belongs to a placement. Implementations keep what they need per
/// vertex and are told of every collapse.
pub trait Metric: Sync {
    /// Looks at the whole mesh before the first collapse. `features` are the edges that are to be preserved.
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features);

    /// The best placement for merging the ends of an edge; `None` when the metric forbids it. The mesh and its features
    /// are as they are now.
    fn evaluate(&self, mesh: &CollapseMesh, features: &Features, edge: &EdgeContext) -> Option<Candidate>;

    /// A last look at the placement of a collapse about to be made, with the faces around both ends at hand; the
    /// candidate's own by default. `None` refuses the collapse. Other tests may still refuse it.
    fn refine(
        &mut self,
        _: &CollapseMesh,
        _: &EdgeContext,
        candidate: &Candidate,
        _: [&[RingFace]; 2],
    ) -> Option<DVec3> {
        Some(candidate.position)
    }

    /// The collapse that was refined last is about to be made.
    fn on_collapse(&mut self, _: &Collapse<'_>) {}

    /// Writes the attributes that the metric has chosen for some wedges into a mesh with the same wedges; nothing by
    /// default.
    fn give_values(&self, _wedges: &[u32], _mesh: &mut Mesh) {}

    /// The edge has collapsed: `removed` is now `kept`. `neighbors` are the vertices around it.
    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features);

    /// When costs have to be computed again.
    fn update(&self) -> Update;

    /// A vertex will soon be looked at: a chance to load what is kept for it.
    fn prefetch(&self, _vertex: u32) {}
}

/// The shortest edge first (seed 000, 4.3.1).
#[derive(Debug, Clone, Copy)]
pub struct ShortestEdge {
    placement: PlacementKind,
}

impl ShortestEdge {
    /// Without a quadric there is no optimum: `Optimal` means the middle.
    pub fn new(placement: PlacementKind) -> Self {
        Self { placement }
    }
}

impl Metric for ShortestEdge {
    fn prepare(&mut self, _: &CollapseMesh, _: &Features) {}

    fn evaluate(&self, _: &CollapseMesh, _: &Features, edge: &EdgeContext) -> Option<Candidate> {
        let [a, b] = edge.points;
        let cost = a.distance_squared(b);
        let (position, error_sq) = match (edge.anchor, self.placement) {
            (Anchor::First, _) | (Anchor::Free, PlacementKind::Subset) => (a, cost),
            (Anchor::Second, _) => (b, cost),
            (Anchor::Free, _) => ((a + b) / 2.0, cost / 4.0),
        };
        Some(Candidate { cost, error_sq, position })
    }

    fn commit(&mut self, _: &CollapseMesh, _: u32, _: u32, _: &[u32], _: &Features) {}

    fn update(&self) -> Update {
        Update::AtVertex
    }
}

/// What quadrics know of the surface that was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum QuadricMemory {
    /// They are summed as vertices merge: all original planes count.
    #[default]
    Summed,
    /// They are rebuilt from the faces as they are now.
    Rebuilt,
    /// Those that are rebuilt place the vertex; the cost is theirs and a share of that of those that are summed.
    Both,
}

impl QuadricMemory {
    /// All sorts of memory with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 3] =
        [("summed", Self::Summed), ("rebuilt", Self::Rebuilt), ("both", Self::Both)];
}

/// Options of the quadric metrics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadricOptions {
    /// What a face gives to its vertices.
    pub face: FaceQuadric,
    /// Weight of the lines along the normals of the vertices, relative to the planes (Liu, Rahimzadeh and Zordan 2025);
    /// 0: no lines.
    pub line: f64,
    /// Weight of each plane.
    pub weight: QuadricWeight,
    /// Where merged vertices go.
    pub placement: PlacementKind,
    /// Weight of constraint planes through feature edges, relative to the square of their length; `None`: no planes.
    pub constraint: Option<f64>,
    /// What the quadrics know of the past.
    pub memory: QuadricMemory,
    /// Divide the cost by the sum of the weights.
    pub normalized: bool,
}

/// Plane quadrics: cumulative, memoryless or normalised, with or without constraint planes
/// (Garland and Heckbert 1997, Lindstrom and Turk 1999; seed 000, 4.3.2 to 4.3.5; seed 002, 6.3).
///
/// [`QuadricMemory::Both`] is ours. Rebuilt quadrics place vertices better than summed ones, whose planes reach beyond
/// the faces that they stand for; but thin ends (fingers, folds) vanish before their time, as every step that shortens
/// them looks cheap. Costs that remember prevent that.
#[derive(Debug)]
pub struct QuadricMetric {
    pub(super) options: QuadricOptions,
    /// Of each vertex, the planes of the faces around it as they are now; empty where quadrics are only summed.
    rebuilt: Vec<Quadric>,
    /// Of each vertex, the sum of all that it has merged with; empty where quadrics are only rebuilt.
    sums: Vec<Quadric>,
    /// Squared distance from the original that the vertices have gone: what memoryless quadrics do not know. Steps add
    /// up like independent errors. Empty where sums are kept.
    drift_sq: Vec<f32>,
    /// What the sums count in the cost where quadrics are rebuilt as well.
    remembered: f64,
    /// Used up, quadrics at vertices of very many faces stay as they are.
    patience: Patience,
    /// The faces in several poses, where these count instead of the one in which they are stored; `rebuilt` then holds but
    /// the constraint planes.
    posed: Option<Posed>,
    /// Error of the collapse about to be made, in model units; only with poses.
    error: f64,
}

/// What makes short edges go first among equals, as a squared distance relative to the edge's.
/// Small enough to decide only where the planes do not (flat regions), where it keeps triangles from becoming needles.
pub(super) const SHORTNESS: f64 = 1e-12;

/// Below this distance, in the unit frame, the planes cannot be told from exact ones in `f32`: an end that is that good
/// is kept, as its coordinates and attributes are those of the original.
pub(super) const FLAT: f64 = 1e-7;

/// How many times the least cost a placement that keeps the volume may cost. By measurement: without a limit, very
/// coarse levels get worse (a plane fitted to bent stars of few faces says little).
pub(super) const VOLUME_PRICE: f64 = 1.5;

/// What the summed quadrics count in the cost, of what the rebuilt ones do, where both are kept. By measurement: with 1,
/// errors are 2 to 3 % larger on scans, with 0.1, coarse levels of folded surfaces (a brain) get worse, and without them
/// thin ends vanish.
pub(super) const REMEMBERED: f64 = 0.3;

/// Faces below which they count fully: of the last shapes of a figure, each is a large part of the error.
const LAST: usize = 500;

/// How far, in edge lengths from the middle, an optimum may lie before it counts as badly conditioned.
const REACH: f64 = 2.0;

impl QuadricMetric {
    /// A metric without quadrics yet: [`Metric::prepare`] makes them.
    pub fn new(options: QuadricOptions) -> Self {
        Self {
            options,
            rebuilt: Vec::new(),
            sums: Vec::new(),
            drift_sq: Vec::new(),
            remembered: REMEMBERED,
            patience: Patience::default(),
            posed: None,
            error: 0.0,
        }
    }

    /// The same metric, summed over poses.
    pub(super) fn in_poses(self, posed: Option<Posed>) -> Self {
        Self { posed, ..self }
    }

    /// Goes on with what vertices have merged already: the planes of faces, summed, or how far they have gone.
    pub(super) fn start_with(&mut self, sums: Vec<Quadric>, drift_sq: Vec<f32>) {
        (self.sums, self.drift_sq) = (sums, drift_sq);
    }

    /// The quadric of a vertex from the faces around it, and how many they are.
    fn quadric_of(&self, mesh: &CollapseMesh, vertex: u32, features: &Features) -> (Quadric, usize) {
        if self.posed.is_some() {
            return (self.constraint_planes(mesh, vertex, features), 0);
        }
        let (planes, faces) = if self.options.is_plain() {
            self.planes_of::<true>(mesh, vertex)
        } else {
            self.planes_of::<false>(mesh, vertex)
        };
        (planes + self.constraint_planes(mesh, vertex, features), faces)
    }

    /// Generic as a whole: the walk around the vertex is then a type of its own for each, and inlined.
    #[inline]
    fn planes_of<const PLAIN: bool>(&self, mesh: &CollapseMesh, vertex: u32) -> (Quadric, usize) {
        let p = mesh.point(vertex);
        let mut faces = 0;
        let around =
            mesh.faces_around(vertex).inspect(|_| faces += 1).map(|face| [mesh.point(face.x), mesh.point(face.y)]);
        let planes = self.options.planes::<PLAIN>(p, around);
        (planes, faces)
    }

    /// Planes through the features at a vertex, upright on the surface.
    pub(super) fn constraint_planes(&self, mesh: &CollapseMesh, vertex: u32, features: &Features) -> Quadric {
        let mut sum = Quadric::default();
        let Some(constraint) = self.options.constraint.filter(|_| features.touches(vertex)) else { return sum };
        let p = mesh.point(vertex);
        for face in mesh.faces_around(vertex) {
            let (to_x, to_y) = (mesh.point(face.x) - p, mesh.point(face.y) - p);
            let scaled_normal = to_x.cross(to_y);
            let edges = [(face.edge_x, to_x), (face.edge_y, to_y)];
            for (_, along) in edges.into_iter().filter(|&(edge, _)| features.is_feature(edge)) {
                if let Some(across) = scaled_normal.cross(along).try_normalize() {
                    sum += Quadric::plane(across, p, constraint * along.length_squared());
                }
            }
        }
        sum
    }

    /// The quadric that places the merged vertex of an edge: with poses, if it will be part `t` on the way from the first
    /// end to the second.
    #[inline]
    pub(super) fn placing(&self, edge: &EdgeContext, t: f64) -> Quadric {
        let quadrics = if self.options.memory == QuadricMemory::Summed { &self.sums } else { &self.rebuilt };
        let sum = sum_of(quadrics, edge.ends);
        match &self.posed {
            Some(posed) if self.options.memory != QuadricMemory::Summed => sum + posed.around(edge, t),
            _ => sum,
        }
    }

    /// As [`Metric::evaluate`], over poses: the planes that the merged vertex sees depend on where on the edge it will be,
    /// so that is asked twice.
    #[inline(never)] // what looks at no poses stays small
    fn evaluate_in_poses(&self, more: &Quadric, edge: &EdgeContext) -> Candidate {
        let guess = match edge.anchor {
            Anchor::Free => 0.5,
            Anchor::First => 0.0,
            Anchor::Second => 1.0,
        };
        let first = self.evaluate_at(guess, more, edge);
        let better = share_of_way(first.position, edge);
        if better == guess { first } else { self.evaluate_at(better, more, edge) }
    }

    /// As [`Metric::evaluate`], if more than the surface decides: `more` counts in placement and cost, not in the error.
    #[inline]
    pub(super) fn evaluate_with(&self, more: &Quadric, edge: &EdgeContext) -> Candidate {
        if self.posed.is_some() { self.evaluate_in_poses(more, edge) } else { self.evaluate_at(0.5, more, edge) }
    }

    #[inline]
    fn evaluate_at(&self, t: f64, more: &Quadric, edge: &EdgeContext) -> Candidate {
        let surface = self.placing(edge, t);
        let mut all = surface + *more;
        all.weight = surface.weight;
        let summed = match self.options.memory {
            QuadricMemory::Both => Some(sum_of(&self.sums, edge.ends)),
            QuadricMemory::Summed | QuadricMemory::Rebuilt => None,
        };
        let remembered = summed.as_ref().map(|sums| (sums, self.remembered));
        let mut candidate = self.options.candidate(&all, remembered, 0.0, edge);
        let mut error_sq = mean(surface.at(candidate.position).max(0.0), surface.weight) + self.drift_sq_of(edge.ends);
        if let Some(sums) = summed {
            error_sq = error_sq.max(mean(sums.at(candidate.position).max(0.0), sums.weight));
        }
        candidate.error_sq = error_sq;
        candidate
    }

    /// As [`Metric::refine`], if more than the surface decides.
    #[inline]
    pub(super) fn refine_with(
        &self,
        more: &Quadric,
        mesh: &CollapseMesh,
        edge: &EdgeContext,
        position: DVec3,
        rings: [&[RingFace]; 2],
    ) -> DVec3 {
        let placing = self.placing(edge, share_of_way(position, edge)) + *more;
        self.options.refine(&placing, edge, position, faces_of_star(edge.ends, rings, |v| mesh.point(v)))
    }

    /// Whether the quadric at a vertex is still brought up to date: always, unless it has very many faces.
    pub(super) fn is_patient_with(&self, mesh: &CollapseMesh, vertex: u32) -> bool {
        self.patience.allows(mesh, vertex)
    }

    /// The larger drift of two vertices.
    #[inline]
    pub(super) fn drift_sq_of(&self, vertices: [u32; 2]) -> f64 {
        let [a, b] = vertices.map(|v| self.drift_sq.get(v as usize).copied().unwrap_or(0.0));
        f64::from(a.max(b))
    }
}

impl QuadricOptions {
    /// Whether faces give nothing but their planes by area: what is asked for as a rule.
    #[inline]
    pub(super) fn is_plain(&self) -> bool {
        self.face == FaceQuadric::Plane && self.line <= 0.0 && self.weight == QuadricWeight::Area
    }

    /// The quadric of the planes of the faces around p; each face is given by its two other corners. `PLAIN` is
    /// [`is_plain`](Self::is_plain): that loop has to fit into the registers.
    #[inline]
    pub(super) fn planes<const PLAIN: bool>(&self, p: DVec3, faces: impl Iterator<Item = [DVec3; 2]>) -> Quadric {
        let (mut sum, mut normals) = (Quadric::default(), DVec3::ZERO);
        for [x, y] in faces {
            let (to_x, to_y) = (x - p, y - p);
            let scaled_normal = to_x.cross(to_y);
            let length = scaled_normal.length();
            if length <= 0.0 {
                continue;
            }
            if PLAIN {
                sum += Quadric::plane(scaled_normal / length, p, length / 2.0);
            } else {
                let weight = self.weight_of(length, [to_x, to_y]);
                sum += self.face.uncertain([p, x, y], scaled_normal / length, weight, self.weight);
                normals += scaled_normal;
            }
        }
        if !PLAIN && self.line > 0.0 {
            sum += normal_line(normals, p, self.line * sum.weight / 3.0);
        }
        sum
    }

    /// What a face counts at a corner: `length` is that of the product of the sides there.
    #[inline]
    fn weight_of(&self, length: f64, [to_x, to_y]: [DVec3; 2]) -> f64 {
        match self.weight {
            QuadricWeight::Uniform => 1.0,
            QuadricWeight::Area => length / 2.0,
            QuadricWeight::AreaSquared => length * length / 4.0,
            QuadricWeight::Angle => to_x.angle_between(to_y),
        }
    }

    /// Placement and cost of a collapse: `placing` places, and where `summed` is given, too, a share of it counts in the cost.
    #[inline(always)] // what it is called with lies in registers then: a fifth fewer instructions
    pub(super) fn candidate(
        &self,
        placing: &Quadric,
        summed: Option<(&Quadric, f64)>,
        drift_sq: f64,
        edge: &EdgeContext,
    ) -> Candidate {
        let (position, squared) = self.place(placing, edge);
        let mut squared = squared.max(0.0);
        let mut error_sq = self.face.above_floor(mean(squared, placing.weight)) + drift_sq;
        let shortness = SHORTNESS * edge.points[0].distance_squared(edge.points[1]);
        if let Some((all, share)) = summed {
            let remembered = all.at(position).max(0.0);
            error_sq = error_sq.max(self.face.above_floor(mean(remembered, all.weight)));
            squared += share * remembered;
        }
        let cost = if self.normalized { error_sq + shortness } else { squared + shortness * placing.weight };
        Candidate { cost, error_sq, position }
    }

    /// The placement that keeps the volume under the surface, where that is wanted and does not cost much more. `faces`
    /// are the faces around the edge, each once: the end that they are at, and their other corners.
    #[inline]
    pub(super) fn refine(
        &self,
        placing: &Quadric,
        edge: &EdgeContext,
        position: DVec3,
        faces: impl Iterator<Item = (usize, [DVec3; 2])>,
    ) -> DVec3 {
        let [a, b] = edge.points;
        let keeps_end = position == a || position == b;
        if self.placement != PlacementKind::OptimalVolume || edge.anchor != Anchor::Free || keeps_end {
            return position;
        }
        let middle = (a + b) / 2.0;
        let (flux, level) = volume_plane(edge, middle, faces);
        let most = VOLUME_PRICE * placing.at(position) + FLAT * FLAT * placing.weight;
        let fair = |p: &DVec3| is_near(*p, edge) && placing.at(*p) <= most;
        placing.minimize_on_plane(middle, flux, level).filter(fair).unwrap_or(position)
    }

    /// Where the merged vertex goes, and the value of the quadric there.
    #[inline]
    fn place(&self, q: &Quadric, edge: &EdgeContext) -> (DVec3, f64) {
        let [a, b] = edge.points;
        let with_value = |p: DVec3| (p, q.at(p));
        let better_end = || {
            let [a, b] = [with_value(a), with_value(b)];
            if b.1 < a.1 { b } else { a }
        };
        match (edge.anchor, self.placement) {
            (Anchor::First, _) => with_value(a),
            (Anchor::Second, _) => with_value(b),
            (Anchor::Free, PlacementKind::Subset) => better_end(),
            (Anchor::Free, PlacementKind::Midpoint) => with_value((a + b) / 2.0),
            (Anchor::Free, PlacementKind::Optimal | PlacementKind::OptimalVolume) => {
                let optimum = q.minimize_near((a + b) / 2.0).filter(|&p| is_near(p, edge)).map(with_value);
                let flat = FLAT * FLAT * q.weight;
                if let Some(optimum) = optimum.filter(|optimum| optimum.1 > flat) {
                    return optimum; // no end can be better, so none is good enough to be kept
                }
                let end = better_end();
                if end.1 <= flat {
                    return end;
                }
                optimum.unwrap_or_else(|| {
                    let inside = with_value(q.minimize_on_segment(a, b));
                    if end.1 < inside.1 { end } else { inside }
                })
            }
        }
    }
}

/// Lets a collapse that looks flat go first if it changes nothing: the faces around the end that vanishes lie in planes
/// through the other one. Quadrics do not tell that from coordinates that were rounded to single precision.
#[cold]
fn without_a_trace(mesh: &CollapseMesh, edge: &EdgeContext, candidate: Candidate) -> Candidate {
    let leaves_no_trace = |end: usize| {
        let (kept, removed) = (edge.points[end], edge.points[1 - end]);
        let most = EXACT * kept.distance(removed);
        mesh.faces_around(edge.ends[1 - end]).zip(0..=MOST_FACES).all(|(face, place)| {
            let [x, y] = [face.x, face.y].map(|v| mesh.point(v));
            let scaled_normal = (x - removed).cross(y - removed);
            let is_in_plane = scaled_normal.dot(kept - removed).abs() <= most * scaled_normal.length();
            let after = (x - kept).cross(y - kept);
            let longest_sq = (x - kept).length_squared().max((y - kept).length_squared());
            let vanishes = face.x == edge.ends[end] || face.y == edge.ends[end];
            // what is left of a needle would be one, or turned over
            let stays_sound = after.dot(scaled_normal) > 0.0 && after.length() > NEEDLE * longest_sq;
            is_in_plane && (vanishes || stays_sound) && place < MOST_FACES
        })
    };
    // the end that the planes prefer, if it is one: they know of borders, too
    let is_first = edge.points.iter().position(|&end| end == candidate.position).is_some_and(leaves_no_trace);
    if is_first { Candidate { cost: candidate.cost * SHORTNESS, ..candidate } } else { candidate }
}

/// Sine below which what lies in a plane does so exactly, but for rounding in double precision.
const EXACT: f64 = 1e-12;

/// Sine of the least corner of a triangle that does not count as a needle.
const NEEDLE: f64 = 1e-3;

/// Vertices of more faces are left to the quadrics: looking at all of them for each edge would take for ever.
const MOST_FACES: usize = 64;

/// A sum of squares over its weight.
#[inline]
pub(super) fn mean(squared: f64, weight: f64) -> f64 {
    if weight > 0.0 { squared / weight } else { 0.0 }
}

/// Squared drift of a merged vertex at p, from the larger drift of its two and the planes that placed it.
pub(super) fn drift_after(placing: &Quadric, p: DVec3, drift_sq: f64) -> f32 {
    (mean(placing.at(p).max(0.0), placing.weight) + drift_sq) as f32
}

/// The faces around an edge, each once: the end that they are at, and their other corners.
#[inline]
pub(super) fn faces_of_star<'a>(
    ends: [u32; 2],
    rings: [&'a [RingFace]; 2],
    point: impl Fn(u32) -> DVec3 + 'a,
) -> impl Iterator<Item = (usize, [DVec3; 2])> + 'a {
    let second = rings[1].iter().filter(move |face| face.x != ends[0] && face.y != ends[0]).map(|face| (1, face));
    let all = rings[0].iter().map(|face| (0, face)).chain(second);
    all.map(move |(end, face)| (end, [point(face.x), point(face.y)]))
}

#[inline]
fn sum_of(quadrics: &[Quadric], [a, b]: [u32; 2]) -> Quadric {
    quadrics[a as usize] + quadrics[b as usize]
}

/// How far along an edge a point is, by orthogonal projection, from 0 to 1.
#[inline]
fn share_of_way(p: DVec3, edge: &EdgeContext) -> f64 {
    let [a, b] = edge.points;
    let along = b - a;
    let length_sq = along.length_squared();
    if length_sq > 0.0 { ((p - a).dot(along) / length_sq).clamp(0.0, 1.0) } else { 0.0 }
}

/// Whether a placement is within [`REACH`] of an edge.
pub(super) fn is_near(p: DVec3, edge: &EdgeContext) -> bool {
    let [a, b] = edge.points;
    p.distance_squared((a + b) / 2.0) <= REACH * REACH * a.distance_squared(b)
}

/// The points `flux . p = level` at which the faces around an edge, pulled together there, enclose the volume that they
/// enclose now: each face (a, x, y) spans `(x - a) x (y - a) . p / 6` with a point p.
fn volume_plane(edge: &EdgeContext, origin: DVec3, faces: impl Iterator<Item = (usize, [DVec3; 2])>) -> (DVec3, f64) {
    let (mut flux, mut level) = (DVec3::ZERO, 0.0);
    for (end, [x, y]) in faces {
        let p = edge.points[end];
        let normal = (x - p).cross(y - p);
        flux += normal;
        level += normal.dot(p - origin);
    }
    (flux, level + flux.dot(origin))
}

impl Metric for QuadricMetric {
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features) {
        self.patience = Patience::new(mesh);
        let vertices = 0..mesh.vertex_count() as u32;
        if let Some(posed) = &mut self.posed {
            posed.prepare(mesh);
        }
        if self.options.memory != QuadricMemory::Rebuilt {
            self.sums = if let Some(posed) = &self.posed {
                let sum = |v| posed.around_vertex(v, mesh.point(v)) + self.constraint_planes(mesh, v, features);
                vertices.clone().into_par_iter().map(sum).collect()
            } else if self.sums.is_empty() {
                vertices.clone().into_par_iter().map(|v| self.quadric_of(mesh, v, features).0).collect()
            } else {
                // what passes have left: planes of faces alone
                let sum = |v: u32| self.sums[v as usize] + self.constraint_planes(mesh, v, features);
                vertices.clone().into_par_iter().map(sum).collect()
            };
        }
        if self.options.memory == QuadricMemory::Rebuilt && self.drift_sq.is_empty() {
            self.drift_sq = vec![0.0; mesh.vertex_count()];
        }
        if self.options.memory != QuadricMemory::Summed {
            self.rebuilt = vertices.into_par_iter().map(|v| self.quadric_of(mesh, v, features).0).collect();
        }
    }

    #[inline]
    fn evaluate(&self, mesh: &CollapseMesh, _: &Features, edge: &EdgeContext) -> Option<Candidate> {
        let candidate = match self.options.memory {
            _ if self.posed.is_some() => return Some(self.evaluate_in_poses(&Quadric::default(), edge)),
            QuadricMemory::Summed => self.options.candidate(&sum_of(&self.sums, edge.ends), None, 0.0, edge),
            QuadricMemory::Rebuilt => {
                self.options.candidate(&sum_of(&self.rebuilt, edge.ends), None, self.drift_sq_of(edge.ends), edge)
            }
            QuadricMemory::Both => {
                let sums = sum_of(&self.sums, edge.ends);
                self.options.candidate(&sum_of(&self.rebuilt, edge.ends), Some((&sums, self.remembered)), 0.0, edge)
            }
        };
        Some(if candidate.error_sq <= FLAT * FLAT { without_a_trace(mesh, edge, candidate) } else { candidate })
    }

    fn refine(
        &mut self,
        mesh: &CollapseMesh,
        edge: &EdgeContext,
        candidate: &Candidate,
        rings: [&[RingFace]; 2],
    ) -> Option<DVec3> {
        Some(self.refine_with(&Quadric::default(), mesh, edge, candidate.position, rings))
    }

    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        if let Some(posed) = &mut self.posed {
            posed.merge(collapse.star.kept, collapse.star.removed, collapse.t);
            self.error = collapse.error;
        }
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features) {
        let ends = [kept, removed];
        match self.options.memory {
            QuadricMemory::Summed => return self.sums[kept as usize] = sum_of(&self.sums, ends),
            QuadricMemory::Rebuilt if self.posed.is_some() => {
                self.drift_sq[kept as usize] = (self.error / mesh.frame().unit()).powi(2) as f32;
            }
            QuadricMemory::Rebuilt => {
                let q = sum_of(&self.rebuilt, ends);
                self.drift_sq[kept as usize] = drift_after(&q, mesh.point(kept), self.drift_sq_of(ends));
            }
            QuadricMemory::Both => {
                self.sums[kept as usize] = sum_of(&self.sums, ends);
                if mesh.live_face_count() < LAST {
                    self.remembered = 1.0; // costs rise, which shows when they come up
                }
            }
        }
        for &vertex in std::iter::once(&kept).chain(neighbors) {
            if self.patience.allows(mesh, vertex) {
                let (quadric, faces) = self.quadric_of(mesh, vertex, features);
                self.rebuilt[vertex as usize] = quadric;
                if let Some(posed) = &mut self.posed {
                    posed.rebuild(mesh, vertex);
                }
                self.patience.spend(faces);
            }
        }
    }

    #[inline]
    fn prefetch(&self, vertex: u32) {
        prefetch(&self.rebuilt, vertex as usize);
        prefetch(&self.sums, vertex as usize);
    }

    fn update(&self) -> Update {
        let is_summed = self.options.memory == QuadricMemory::Summed;
        match (is_summed, self.options.placement, self.options.normalized) {
            (false, ..) => Update::AtVertexThenRing,
            (true, PlacementKind::Optimal | PlacementKind::OptimalVolume, false) => Update::WhenDue,
            (true, ..) => Update::AtVertex,
        }
    }
}
