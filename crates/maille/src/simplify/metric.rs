//! What a collapse costs and where the merged vertex goes.

use glam::DVec3;
use rayon::prelude::*;

use super::features::Features;
use super::options::{PlacementKind, QuadricWeight};
use super::patience::Patience;
use super::quadric::Quadric;
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

    /// The best placement for merging the ends of an edge; `None` when the metric forbids it.
    fn evaluate(&self, edge: &EdgeContext) -> Option<Candidate>;

    /// A last look at the placement of a collapse about to be made, with the faces around both ends at hand; the
    /// candidate's own by default.
    fn refine(&self, _: &CollapseMesh, _: &EdgeContext, candidate: &Candidate, _: [&[RingFace]; 2]) -> DVec3 {
        candidate.position
    }

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

    fn evaluate(&self, edge: &EdgeContext) -> Option<Candidate> {
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
    /// Those that are rebuilt place the vertex; the cost is the sum of both.
    Both,
}

/// Options of the quadric metrics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadricOptions {
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
    options: QuadricOptions,
    /// Of each vertex, what it is placed by.
    quadrics: Vec<Quadric>,
    /// Of each vertex, the sum of all that it has merged with; empty unless both kinds are wanted.
    summed: Vec<Quadric>,
    /// Squared distance from the original that the vertices have gone: what memoryless quadrics do not know. Steps add
    /// up like independent errors. Empty where sums are kept.
    drift_sq: Vec<f32>,
    /// Used up, quadrics at vertices of very many faces stay as they are.
    patience: Patience,
}

/// What makes short edges go first among equals, as a squared distance relative to the edge's.
/// Small enough to decide only where the planes do not (flat regions), where it keeps triangles from becoming needles.
const SHORTNESS: f64 = 1e-12;

/// Below this distance, in the unit frame, the planes cannot be told from exact ones in `f32`: an end that is that good
/// is kept, as its coordinates and attributes are those of the original.
const FLAT: f64 = 1e-7;

/// How many times the least cost a placement that keeps the volume may cost. By measurement: without a limit, very
/// coarse levels get worse (a plane fitted to bent stars of few faces says little).
const VOLUME_PRICE: f64 = 1.5;

/// How far, in edge lengths from the middle, an optimum may lie before it counts as badly conditioned.
const REACH: f64 = 2.0;

impl QuadricMetric {
    /// A metric without quadrics yet: [`Metric::prepare`] makes them.
    pub fn new(options: QuadricOptions) -> Self {
        Self { options, quadrics: Vec::new(), summed: Vec::new(), drift_sq: Vec::new(), patience: Patience::default() }
    }

    /// The quadric of a vertex from the faces around it, and how many they are.
    fn quadric_of(&self, mesh: &CollapseMesh, vertex: u32, features: &Features) -> (Quadric, usize) {
        let p = mesh.point(vertex);
        let constraint = self.options.constraint.filter(|_| features.touches(vertex));
        let (mut sum, mut faces) = (Quadric::default(), 0);
        for face in mesh.faces_around(vertex) {
            faces += 1;
            let (to_x, to_y) = (mesh.point(face.x) - p, mesh.point(face.y) - p);
            let scaled_normal = to_x.cross(to_y);
            let length = scaled_normal.length();
            if length <= 0.0 {
                continue;
            }
            let normal = scaled_normal / length;
            let weight = match self.options.weight {
                QuadricWeight::Uniform => 1.0,
                QuadricWeight::Area => length / 2.0,
                QuadricWeight::Angle => to_x.angle_between(to_y),
            };
            sum += Quadric::plane(normal, p, weight);
            if let Some(constraint) = constraint {
                let edges = [(face.edge_x, to_x), (face.edge_y, to_y)];
                for (_, along) in edges.into_iter().filter(|&(edge, _)| features.is_feature(edge)) {
                    if let Some(across) = normal.cross(along).try_normalize() {
                        sum += Quadric::plane(across, p, constraint * along.length_squared());
                    }
                }
            }
        }
        (sum, faces)
    }

    /// The larger drift of two vertices.
    #[inline]
    fn drift_sq_of(&self, vertices: [u32; 2]) -> f64 {
        let [a, b] = vertices.map(|v| self.drift_sq.get(v as usize).copied().unwrap_or(0.0));
        f64::from(a.max(b))
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
        match (edge.anchor, self.options.placement) {
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

/// A sum of squares over its weight.
#[inline]
fn mean(squared: f64, weight: f64) -> f64 {
    if weight > 0.0 { squared / weight } else { 0.0 }
}

/// Whether a placement is within [`REACH`] of an edge.
fn is_near(p: DVec3, edge: &EdgeContext) -> bool {
    let [a, b] = edge.points;
    p.distance_squared((a + b) / 2.0) <= REACH * REACH * a.distance_squared(b)
}

/// The points `flux . p = level` at which the faces around an edge, pulled together there, enclose the volume that they
/// enclose now: each face (a, x, y) spans `(x - a) x (y - a) . p / 6` with a point p.
fn volume_plane(mesh: &CollapseMesh, edge: &EdgeContext, origin: DVec3, rings: [&[RingFace]; 2]) -> (DVec3, f64) {
    let (mut flux, mut level) = (DVec3::ZERO, 0.0);
    for (end, (ring, p)) in rings.into_iter().zip(edge.points).enumerate() {
        // faces at both ends are in both rings: they count once
        let counts = |face: &&RingFace| end == 0 || (face.x != edge.ends[0] && face.y != edge.ends[0]);
        for face in ring.iter().filter(counts) {
            let normal = (mesh.point(face.x) - p).cross(mesh.point(face.y) - p);
            flux += normal;
            level += normal.dot(p - origin);
        }
    }
    (flux, level + flux.dot(origin))
}

impl Metric for QuadricMetric {
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features) {
        let quadrics = (0..mesh.vertex_count() as u32).into_par_iter().map(|v| self.quadric_of(mesh, v, features).0);
        self.quadrics = quadrics.collect();
        self.patience = Patience::new(mesh);
        match self.options.memory {
            QuadricMemory::Summed => {}
            QuadricMemory::Rebuilt => self.drift_sq = vec![0.0; self.quadrics.len()],
            QuadricMemory::Both => self.summed = self.quadrics.clone(),
        }
    }

    #[inline]
    fn evaluate(&self, edge: &EdgeContext) -> Option<Candidate> {
        let q = self.quadrics[edge.ends[0] as usize] + self.quadrics[edge.ends[1] as usize];
        let (position, squared) = self.place(&q, edge);
        let mut squared = squared.max(0.0);
        let mut error_sq = mean(squared, q.weight);
        let shortness = SHORTNESS * edge.points[0].distance_squared(edge.points[1]);
        match self.options.memory {
            QuadricMemory::Summed => {}
            QuadricMemory::Rebuilt => error_sq += self.drift_sq_of(edge.ends),
            QuadricMemory::Both => {
                let all = self.summed[edge.ends[0] as usize] + self.summed[edge.ends[1] as usize];
                let remembered = all.at(position).max(0.0);
                error_sq = error_sq.max(mean(remembered, all.weight));
                squared += remembered;
            }
        }
        let cost = if self.options.normalized { error_sq + shortness } else { squared + shortness * q.weight };
        Some(Candidate { cost, error_sq, position })
    }

    fn refine(&self, mesh: &CollapseMesh, edge: &EdgeContext, candidate: &Candidate, rings: [&[RingFace]; 2]) -> DVec3 {
        let [a, b] = edge.points;
        let keeps_end = candidate.position == a || candidate.position == b;
        if self.options.placement != PlacementKind::OptimalVolume || edge.anchor != Anchor::Free || keeps_end {
            return candidate.position;
        }
        let middle = (a + b) / 2.0;
        let (flux, level) = volume_plane(mesh, edge, middle, rings);
        let q = self.quadrics[edge.ends[0] as usize] + self.quadrics[edge.ends[1] as usize];
        let most = VOLUME_PRICE * q.at(candidate.position) + FLAT * FLAT * q.weight;
        let fair = |p: &DVec3| is_near(*p, edge) && q.at(*p) <= most;
        q.minimize_on_plane(middle, flux, level).filter(fair).unwrap_or(candidate.position)
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features) {
        let ends = [kept, removed];
        let sum_of = |quadrics: &[Quadric]| quadrics[kept as usize] + quadrics[removed as usize];
        match self.options.memory {
            QuadricMemory::Summed => return self.quadrics[kept as usize] = sum_of(&self.quadrics),
            QuadricMemory::Rebuilt => {
                let q = sum_of(&self.quadrics);
                let step_sq = mean(q.at(mesh.point(kept)).max(0.0), q.weight);
                self.drift_sq[kept as usize] = (step_sq + self.drift_sq_of(ends)) as f32;
            }
            QuadricMemory::Both => self.summed[kept as usize] = sum_of(&self.summed),
        }
        for &vertex in std::iter::once(&kept).chain(neighbors) {
            if self.patience.allows(mesh, vertex) {
                let (quadric, faces) = self.quadric_of(mesh, vertex, features);
                self.quadrics[vertex as usize] = quadric;
                self.patience.spend(faces);
            }
        }
    }

    #[inline]
    fn prefetch(&self, vertex: u32) {
        prefetch(&self.quadrics, vertex as usize);
        prefetch(&self.summed, vertex as usize);
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
