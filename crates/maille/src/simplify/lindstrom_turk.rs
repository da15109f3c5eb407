//! The metric of Lindstrom and Turk: volumes and areas of border, as things are now.

use glam::DVec3;
use rayon::prelude::*;

use super::features::Features;
use super::metric::{Anchor, Candidate, EdgeContext, FLAT, Metric, SHORTNESS, Update, drift_after, is_near, mean};
use super::options::PlacementKind;
use super::patience::Patience;
use super::quadric::Quadric;
use crate::prefetch::prefetch;
use crate::topology::CollapseMesh;

/// Lindstrom and Turk's memoryless metric (Fast and Memory Efficient Polygonal Simplification, Visualization 1998;
/// Evaluation of Memoryless Simplification, TVCG 1999).
///
/// The merged vertex is where linear constraints, taken in this order until three are independent, want it to be:
///
/// 1. *boundary preservation*: the area enclosed by an open border stays,
/// 2. *volume preservation*: the volume under the surface stays,
/// 3. *volume and boundary optimisation*: `f_V + w L^2 f_B` is least,
/// 4. *triangle shape optimisation*: the squared lengths of the edges at the vertex are least,
///
/// and it costs `f_V + w L^2 f_B` there. `f_V` sums the squared volumes between the merged vertex p and the faces around
/// the edge, `((x - a) x (y - a) . (p - a) / 6)^2`, each face once; `f_B` the squared areas `(|e x (p - s)| / 2)^2`
/// between it and the border edges e from s; L is the length of the edge.
///
/// A constraint is independent if it leaves the span of those before by more than one degree. Instead of solving three
/// equations at once, the vertex moves within what the constraints have left open, a plane, a line, a point; in a plane,
/// along the two directions in which the objective decides separately. That is the same point, does not depend on the axes,
/// and never lacks a constraint: the shape decides whatever is left.
///
/// Where the papers are silent: directions in which the objective hardly changes at all are left to the shape; a vertex
/// that would land far from the edge goes to the best point of it; features that are no border (seams, edges of three
/// faces) count in `f_B` and are not in the way of 2.
///
/// [`PlacementKind::OptimalVolume`] is all this, [`PlacementKind::Optimal`] the least cost without 1 and 2, the
/// others place the vertex by themselves and take the cost.
#[derive(Debug)]
pub struct LindstromTurk {
    placement: PlacementKind,
    /// The weight w of borders and other features.
    boundary: f64,
    /// Whether step 4 is taken.
    shape: bool,
    stars: Vec<Star>,
    /// As [`QuadricMetric`](super::QuadricMetric) keeps it: what a memoryless metric does not know.
    drift_sq: Vec<f32>,
    /// Used up, stars of very many faces stay as they are.
    patience: Patience,
}

/// What the faces around a vertex, or both ends of an edge, say.
#[derive(Debug, Clone, Copy, Default)]
struct Star {
    /// Sum of the squared volumes under the faces.
    volume: Quadric,
    /// Sum of the faces' normals as long as twice the area; `flux . p = level` where the volume stays.
    flux: DVec3,
    level: f64,
    /// Sum of the corners of the faces that are on the rim, and how many; inner ones count twice.
    rim: DVec3,
    corners: f64,
}

/// The features at an edge.
struct Boundary {
    /// Sum of the squared areas, as weighted.
    area: Quadric,
    /// Mean weight of the squared distance in it: what a squared area is divided by to be a squared distance.
    weight: f64,
    /// A point and the unit direction of the line on which the area inside the border stays.
    line: Option<(DVec3, DVec3)>,
}

/// Sine of the least angle between a constraint and those before: one degree, by the paper.
const INDEPENDENT: f64 = 0.017_452_406;

/// Least share of an objective's curvature that a direction must have to be decided by it. Below, `f32` coordinates are
/// what decides.
const DECISIVE: f64 = 1e-9;

/// Flux, relative to the root of the volume's weight, below which a star bends back so far that it has no volume to keep.
const BENT: f64 = 1e-3;

/// Faces around a vertex beyond which its features are not looked at.
const MANY: usize = 256;

impl Star {
    fn of(p: DVec3, faces: impl Iterator<Item = [DVec3; 2]>) -> Self {
        let mut star = Self::default();
        for [x, y] in faces {
            star.add_face([p, x, y], 1.0);
            star.rim += x + y;
            star.corners += 2.0;
        }
        star
    }

    fn add_face(&mut self, [p, x, y]: [DVec3; 3], sign: f64) {
        let scaled_normal = (x - p).cross(y - p);
        let length_sq = scaled_normal.length_squared();
        if length_sq > 0.0 {
            self.volume += Quadric::plane(scaled_normal / length_sq.sqrt(), p, sign * length_sq / 36.0);
        }
        self.flux += scaled_normal * sign;
        self.level += scaled_normal.dot(p) * sign;
    }

    fn joined(&self, other: &Self) -> Self {
        Self {
            volume: self.volume + other.volume,
            flux: self.flux + other.flux,
            level: self.level + other.level,
            rim: self.rim + other.rim,
            corners: self.corners + other.corners,
        }
    }

    /// Whether there is a volume to be kept: the unit normal and length of the flux.
    fn direction(&self) -> Option<(DVec3, f64)> {
        let length = self.flux.length();
        (length > BENT * 6.0 * self.volume.weight.max(0.0).sqrt() && length > 0.0).then(|| (self.flux / length, length))
    }
}

impl LindstromTurk {
    /// A metric that has not seen a mesh yet. `boundary` is the weight of features, 1 by the paper, 0: they do not count.
    /// Without `shape`, an end that costs nothing is kept, and what 1 to 3 leave open goes to the middle of the edge: for
    /// meshes with attributes, which are interpolated along the edge and would not follow.
    pub fn new(placement: PlacementKind, boundary: f64, shape: bool) -> Self {
        Self { placement, boundary, shape, stars: Vec::new(), drift_sq: Vec::new(), patience: Patience::default() }
    }

    fn star_of(mesh: &CollapseMesh, vertex: u32) -> Star {
        Star::of(mesh.point(vertex), mesh.faces_around(vertex).map(|face| [mesh.point(face.x), mesh.point(face.y)]))
    }

    /// The faces around both ends of an edge, each once.
    #[inline]
    fn star(&self, mesh: &CollapseMesh, edge: &EdgeContext) -> Star {
        let [a, b] = edge.ends;
        let (one, two) = (&self.stars[a as usize], &self.stars[b as usize]);
        let mut star = one.joined(two);
        let (at, other) = if one.corners <= two.corners { (a, b) } else { (b, a) };
        for face in mesh.faces_around(at).filter(|face| face.x == other || face.y == other) {
            let corners @ [p, x, y] = [at, face.x, face.y].map(|v| mesh.point(v));
            star.add_face(corners, -1.0);
            let (end, apex) = if face.x == other { (x, y) } else { (y, x) };
            star.rim -= p + end + apex * 2.0;
            star.corners -= 4.0;
        }
        star
    }

    /// The features around both ends of an edge.
    fn features(&self, mesh: &CollapseMesh, features: &Features, edge: &EdgeContext) -> Option<Boundary> {
        let touched = || edge.ends.iter().any(|&v| features.touches(v));
        let is_small = |&v: &u32| mesh.faces_around(v).nth(MANY).is_none();
        if self.boundary <= 0.0 || !touched() || !edge.ends.iter().all(is_small) {
            return None;
        }
        let middle = (edge.points[0] + edge.points[1]) / 2.0;
        let mut edges: Vec<(u32, [u32; 2])> = Vec::new();
        for (i, v) in edge.ends.into_iter().enumerate() {
            for face in mesh.faces_around(v) {
                let sides = [(face.edge_x, [v, face.x]), (face.edge_y, [face.y, v])];
                let first_time = |ends: &[u32; 2]| i == 0 || !ends.contains(&edge.ends[0]);
                edges.extend(sides.into_iter().filter(|(e, ends)| features.is_feature(*e) && first_time(ends)));
            }
        }
        edges.sort_unstable();
        let weight = self.boundary * edge.points[0].distance_squared(edge.points[1]);
        let mut area = Quadric::default();
        let (mut along, mut around) = (DVec3::ZERO, DVec3::ZERO);
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            let [s, t] = same[0].1.map(|v| mesh.point(v));
            let length_sq = s.distance_squared(t);
            if length_sq <= 0.0 {
                continue;
            }
            area += Quadric::line((t - s) / length_sq.sqrt(), s, weight * length_sq / 4.0);
            if same.len() == 1 {
                along += t - s;
                around += (s - middle).cross(t - middle);
            }
        }
        // (s - p) x (t - p) adds up to `around + p x along`: no area is left where that is least
        let length_sq = along.length_squared();
        let line = (length_sq > 1e-12 * middle.distance_squared(edge.points[0]))
            .then(|| (middle + along.cross(around) / length_sq, along / length_sq.sqrt()));
        (area.weight > 0.0).then_some(Boundary { area, weight: area.weight, line })
    }

    /// Where the merged vertex goes.
    fn place(&self, star: &Star, line: Option<(DVec3, DVec3)>, objective: &Quadric, edge: &EdgeContext) -> DVec3 {
        let [a, b] = edge.points;
        let middle = (a + b) / 2.0;
        let end = if objective.at(b) < objective.at(a) { b } else { a };
        match (edge.anchor, self.placement) {
            (Anchor::First, _) => return a,
            (Anchor::Second, _) => return b,
            (Anchor::Free, PlacementKind::Subset) => return end,
            (Anchor::Free, PlacementKind::Midpoint) => return middle,
            (Anchor::Free, PlacementKind::Optimal | PlacementKind::OptimalVolume) => {}
        }
        if !self.shape && objective.at(end) <= FLAT * FLAT * star.volume.weight {
            return end; // with all its attributes
        }
        let rim = if self.shape && star.corners > 0.5 { star.rim / star.corners } else { middle };
        let (held, best) = if self.placement == PlacementKind::Optimal {
            (rim, objective.minimize_near(rim).unwrap_or(rim))
        } else {
            constrained(star, line, objective, rim)
        };
        [best, held].into_iter().find(|&p| is_near(p, edge)).unwrap_or_else(|| objective.minimize_on_segment(a, b))
    }
}

/// The point nearest to the middle of the rim that keeps areas and volume, and among those that keep them, the one that the
/// objective wants.
fn constrained(star: &Star, line: Option<(DVec3, DVec3)>, objective: &Quadric, rim: DVec3) -> (DVec3, DVec3) {
    let missing = |p: DVec3| star.level - star.flux.dot(p);
    match (line, star.direction()) {
        (Some((through, along)), volume) => {
            let held = through + along * along.dot(rim - through);
            match volume {
                Some((normal, length)) if normal.dot(along).abs() > INDEPENDENT => {
                    let met = held + along * (missing(held) / (length * normal.dot(along)));
                    (met, met)
                }
                _ => (held, held + step(objective, held, along)),
            }
        }
        (None, Some((normal, length))) => {
            let held = rim + normal * (missing(rim) / length);
            let best = principal(objective, normal).into_iter().fold(held, |p, along| p + step(objective, p, along));
            (held, best)
        }
        (None, None) => (rim, objective.minimize_near(rim).unwrap_or(rim)),
    }
}

/// How far to go along a direction to where the objective is least; not at all where it does not decide.
fn step(objective: &Quadric, from: DVec3, along: DVec3) -> DVec3 {
    let row = objective.curvature(along);
    let curvature = along.dot(row);
    let decides = curvature > INDEPENDENT * row.length() && curvature > DECISIVE * objective.trace();
    if decides { along * (-along.dot(objective.half_gradient(from)) / curvature) } else { DVec3::ZERO }
}

/// The two directions across a normal along which an objective changes independently: a Jacobi rotation.
fn principal(objective: &Quadric, normal: DVec3) -> [DVec3; 2] {
    let (u, v) = normal.any_orthonormal_pair();
    let (along_u, along_v) = (objective.curvature(u), objective.curvature(v));
    let (uu, uv, vv) = (u.dot(along_u), u.dot(along_v), v.dot(along_v));
    if uv == 0.0 {
        return [u, v];
    }
    let half = (vv - uu) / (2.0 * uv);
    let tangent = half.signum() / (half.abs() + (half * half + 1.0).sqrt());
    let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
    let sine = tangent * cosine;
    [u * cosine - v * sine, u * sine + v * cosine]
}

impl Metric for LindstromTurk {
    fn prepare(&mut self, mesh: &CollapseMesh, _: &Features) {
        self.patience = Patience::new(mesh);
        self.stars = (0..mesh.vertex_count() as u32).into_par_iter().map(|v| Self::star_of(mesh, v)).collect();
        self.drift_sq = vec![0.0; mesh.vertex_count()];
    }

    #[inline]
    fn evaluate(&self, mesh: &CollapseMesh, features: &Features, edge: &EdgeContext) -> Option<Candidate> {
        let star = self.star(mesh, edge);
        let boundary = self.features(mesh, features, edge);
        let mut objective = star.volume;
        if let Some(boundary) = &boundary {
            objective += boundary.area;
        }
        let position = self.place(&star, boundary.as_ref().and_then(|boundary| boundary.line), &objective, edge);
        let distance_sq = |q: &Quadric, weight: f64| mean(q.at(position).max(0.0), weight);
        let step_sq = distance_sq(&star.volume, star.volume.weight)
            .max(boundary.map_or(0.0, |boundary| distance_sq(&boundary.area, boundary.weight)));
        let [a, b] = edge.ends.map(|v| f64::from(self.drift_sq[v as usize]));
        let shortness = SHORTNESS * edge.points[0].distance_squared(edge.points[1]) * star.volume.weight.max(0.0);
        let cost = objective.at(position).max(0.0) + shortness;
        Some(Candidate { cost, error_sq: step_sq + a.max(b), position })
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], _: &Features) {
        let around = self.stars[kept as usize].volume + self.stars[removed as usize].volume;
        let [a, b] = [kept, removed].map(|v| f64::from(self.drift_sq[v as usize]));
        self.drift_sq[kept as usize] = drift_after(&around, mesh.point(kept), a.max(b));
        for &vertex in std::iter::once(&kept).chain(neighbors) {
            if self.patience.allows(mesh, vertex) {
                let star = Self::star_of(mesh, vertex);
                self.patience.spend(star.corners as usize / 2);
                self.stars[vertex as usize] = star;
            }
        }
    }

    fn update(&self) -> Update {
        Update::AtVertexThenRing
    }

    #[inline]
    fn prefetch(&self, vertex: u32) {
        prefetch(&self.stars, vertex as usize);
    }
}
