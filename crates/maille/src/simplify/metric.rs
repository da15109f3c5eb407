//! What a collapse costs and where the merged vertex goes.

use glam::DVec3;
use rayon::prelude::*;

use super::features::Features;
use super::options::{PlacementKind, QuadricWeight};
use super::quadric::Quadric;
use crate::topology::CollapseMesh;

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

    /// The edge has collapsed: `removed` is now `kept`. `neighbors` are the vertices around it.
    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features);

    /// When costs have to be computed again.
    fn update(&self) -> Update;
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

/// Options of the quadric metrics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadricOptions {
    /// Weight of each plane.
    pub weight: QuadricWeight,
    /// Where merged vertices go.
    pub placement: PlacementKind,
    /// Weight of constraint planes through feature edges, relative to the square of their length; `None`: no planes.
    pub constraint: Option<f64>,
    /// Rebuild quadrics from the current faces instead of summing them.
    pub memoryless: bool,
    /// Divide the cost by the sum of the weights.
    pub normalized: bool,
}

/// Plane quadrics: cumulative, memoryless or normalised, with or without constraint planes
/// (Garland and Heckbert 1997, Lindstrom and Turk 1999; seed 000, 4.3.2 to 4.3.5; seed 002, 6.3).
#[derive(Debug)]
pub struct QuadricMetric {
    options: QuadricOptions,
    quadrics: Vec<Quadric>,
}

/// What makes short edges go first among equals, as a squared distance relative to the edge's.
/// Small enough to decide only where the planes do not (flat regions), where it keeps triangles from becoming needles.
const SHORTNESS: f64 = 1e-9;

/// How far, in edge lengths from the middle, an optimum may lie before it counts as badly conditioned.
const REACH: f64 = 2.0;

impl QuadricMetric {
    /// A metric without quadrics yet: [`Metric::prepare`] makes them.
    pub fn new(options: QuadricOptions) -> Self {
        Self { options, quadrics: Vec::new() }
    }

    /// The quadric of a vertex from the faces around it.
    fn quadric_of(&self, mesh: &CollapseMesh, vertex: u32, features: &Features) -> Quadric {
        let p = mesh.point(vertex);
        let constraint = self.options.constraint.filter(|_| features.touches(vertex));
        let mut sum = Quadric::default();
        for face in mesh.faces_around(vertex) {
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
        sum
    }

    fn place(&self, q: &Quadric, edge: &EdgeContext) -> DVec3 {
        let [a, b] = edge.points;
        match (edge.anchor, self.options.placement) {
            (Anchor::First, _) => a,
            (Anchor::Second, _) => b,
            (Anchor::Free, PlacementKind::Subset) => {
                if q.at(b) < q.at(a) {
                    b
                } else {
                    a
                }
            }
            (Anchor::Free, PlacementKind::Midpoint) => (a + b) / 2.0,
            (Anchor::Free, PlacementKind::Optimal) => {
                let middle = (a + b) / 2.0;
                let near = |p: &DVec3| p.distance_squared(middle) <= REACH * REACH * a.distance_squared(b);
                q.minimize_near(middle).filter(near).unwrap_or_else(|| {
                    let ends = [a, b].map(|p| (q.at(p), p));
                    let inside = q.minimize_on_segment(a, b);
                    ends.into_iter().fold((q.at(inside), inside), |best, end| if end.0 < best.0 { end } else { best }).1
                })
            }
        }
    }
}

impl Metric for QuadricMetric {
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features) {
        let quadrics = (0..mesh.vertex_count() as u32).into_par_iter().map(|v| self.quadric_of(mesh, v, features));
        self.quadrics = quadrics.collect();
    }

    #[inline]
    fn evaluate(&self, edge: &EdgeContext) -> Option<Candidate> {
        let q = self.quadrics[edge.ends[0] as usize] + self.quadrics[edge.ends[1] as usize];
        let position = self.place(&q, edge);
        let squared = q.at(position).max(0.0);
        let error_sq = if q.weight > 0.0 { squared / q.weight } else { 0.0 };
        let shortness = SHORTNESS * edge.points[0].distance_squared(edge.points[1]);
        let cost = if self.options.normalized { error_sq + shortness } else { squared + shortness * q.weight };
        Some(Candidate { cost, error_sq, position })
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features) {
        if self.options.memoryless {
            for &vertex in std::iter::once(&kept).chain(neighbors) {
                self.quadrics[vertex as usize] = self.quadric_of(mesh, vertex, features);
            }
        } else {
            let other = self.quadrics[removed as usize];
            self.quadrics[kept as usize] += other;
        }
    }

    fn update(&self) -> Update {
        match (self.options.memoryless, self.options.placement, self.options.normalized) {
            (true, ..) => Update::AtVertexThenRing,
            (false, PlacementKind::Optimal, false) => Update::WhenDue,
            (false, ..) => Update::AtVertex,
        }
    }
}
