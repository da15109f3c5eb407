//! Tests that a collapse has to pass: link condition, fold-over, valence, quality.

use glam::DVec3;

use super::options::{Refusals, TopologyPolicy};
use crate::topology::EdgeStar;
use crate::topology::collapse_mesh::{CollapseMesh, Frame, Marks, RingFace};

/// Which tests are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// What may happen to the topology.
    pub topology: TopologyPolicy,
    /// Whether [`TopologyPolicy::Manifold`] lets parts vanish already, not only holes close.
    pub parts_may_go: bool,
    /// Least cosine of the angle by which a face's normal may turn.
    pub min_normal_cos: Option<f64>,
    /// Largest angle, in radians, between the normal of a face and those of the original faces that it stands for.
    pub max_normal_deviation: Option<f64>,
    /// Least and largest valence of the merged vertex, and least of its neighbours'.
    pub valence: Option<(u32, u32)>,
    /// Least quality of a triangle, unless it was worse before.
    pub min_quality: Option<f64>,
    /// Whether collapses are refused after which the surface would pass through itself.
    pub no_self_intersections: bool,
    /// Largest squared error of a collapse, in the unit frame.
    pub max_error_sq: Option<f64>,
}

/// A collapse about to be tested or made: `removed` merges into `kept`, which moves.
#[derive(Debug)]
pub struct Collapse<'a> {
    /// The edge and the faces around it.
    pub star: EdgeStar<'a>,
    /// Where the merged vertex goes, in model units, as stored.
    pub position: [f32; 3],
    /// Where on the segment from `kept` (0) to `removed` (1) that is, by orthogonal projection.
    pub t: f32,
    /// Distance from the original that the metric expects, in model units.
    pub error: f64,
    /// What it costs, in the frame; infinitely little for one that comes with the one before: the last two triangles of a
    /// part.
    pub cost: f64,
}

/// Where a merged vertex goes: the position as stored, to the bit that of an end if it goes there, and the place on the
/// segment between the ends. `stored` are the positions of the ends, `points` the same in the frame.
#[inline]
pub(super) fn landing(frame: &Frame, target: DVec3, stored: [[f32; 3]; 2], [a, b]: [DVec3; 2]) -> ([f32; 3], f32) {
    let along = b - a;
    let length_sq = along.length_squared();
    let t = if length_sq > 0.0 { ((target - a).dot(along) / length_sq).clamp(0.0, 1.0) } else { 0.0 };
    let position = if target == a {
        stored[0]
    } else if target == b {
        stored[1]
    } else {
        frame.leave(target)
    };
    (position, t as f32)
}

/// The larger of the factors of two vertices, if they have any.
#[inline]
pub(super) fn strictest(a: Option<f32>, b: Option<f32>) -> f32 {
    a.zip(b).map_or(1.0, |(a, b)| a.max(b))
}

impl Limits {
    /// Whether an error is larger than it may be where vertices are so strict.
    #[inline]
    pub(super) fn exceeds(&self, error_sq: f64, strictness: f32) -> bool {
        // where nothing may move, nor may what costs nothing
        let strict = |most| strictness == f32::INFINITY || error_sq * f64::from(strictness).powi(2) > most;
        self.max_error_sq.is_some_and(strict)
    }

    /// Whether a collapse passes all tests; counts the first that it fails.
    pub fn allow(
        &self,
        mesh: &CollapseMesh,
        collapse: &Collapse<'_>,
        marks: &mut Marks,
        refused: &mut Refusals,
    ) -> bool {
        let counter = if self.folds_over(mesh.frame(), collapse, |v| mesh.point(v)) {
            &mut refused.fold_over
        } else if !keeps_topology(&collapse.star, self.topology, self.parts_may_go, marks) {
            &mut refused.topology
        } else if self.valence.is_some_and(|range| leaves_valence(mesh, collapse, marks, range)) {
            &mut refused.valence
        } else if self.min_quality.is_some_and(|least| spoils_triangles(mesh, collapse, least)) {
            &mut refused.quality
        } else {
            return true;
        };
        *counter += 1;
        false
    }

    /// Whether the normal of a face turns by more than it may.
    #[inline]
    pub(super) fn folds_over(&self, frame: &Frame, collapse: &Collapse<'_>, point: impl Fn(u32) -> DVec3) -> bool {
        let Some(min_cos) = self.min_normal_cos else { return false };
        let target = frame.enter(collapse.position);
        [(collapse.star.kept, collapse.star.kept_ring), (collapse.star.removed, collapse.star.removed_ring)]
            .into_iter()
            .any(|(v, ring)| {
                let p = point(v);
                ring.iter().filter(|face| !collapse.star.kills(face)).any(|face| {
                    let (x, y) = (point(face.x), point(face.y));
                    let before = (x - p).cross(y - p);
                    let after = (x - target).cross(y - target);
                    // a face without area has no normal: before, there is none to keep; after, that is no good
                    let lengths = (before.length_squared() * after.length_squared()).sqrt();
                    before != DVec3::ZERO && before.dot(after) <= min_cos * lengths
                })
            })
    }
}

/// The link condition (Dey et al. 1999; seed 001, 2.3.3): the links of the two ends meet in the link of the edge and
/// nowhere else. Borders are closed by an imaginary vertex, as in the seed. [`TopologyPolicy::Manifold`] makes the two
/// exceptions that it names.
fn keeps_topology(star: &EdgeStar<'_>, policy: TopologyPolicy, parts_may_go: bool, marks: &mut Marks) -> bool {
    /// Bits of a mark: in the link of the kept vertex, opposite to the edge, in a face that stays.
    const KEPT: u32 = 1;
    const APEX: u32 = 2;
    const STAYS: u32 = 4;
    if policy == TopologyPolicy::Free || star.is_regular() {
        return true;
    }
    let lenient = policy == TopologyPolicy::Manifold;
    marks.clear();
    let dying = star.kept_ring.iter().filter(|face| star.kills(face)).count();
    if dying == 0 {
        return true; // a pair to be joined: that is meant to change the topology
    }
    if dying > 2 {
        return false; // an edge of many faces
    }
    if dying == star.kept_ring.len() && dying == star.removed_ring.len() {
        return lenient && parts_may_go; // the last faces of a component, or a flap that hangs by a vertex
    }
    for face in star.kept_ring {
        let role = if star.kills(face) { APEX } else { STAYS };
        for v in [face.x, face.y].into_iter().filter(|&v| v != star.removed) {
            let before = marks.get(v).unwrap_or(0);
            if before & role & APEX != 0 {
                return false; // two faces of the same three vertices: a bubble would vanish
            }
            marks.set(v, before | KEPT | role);
        }
    }
    for face in star.removed_ring {
        for v in [face.x, face.y].into_iter().filter(|&v| v != star.kept) {
            let before = marks.get(v).unwrap_or(0);
            if before & KEPT != 0 && before & APEX == 0 {
                // a common neighbour that no face joins to the edge: three edges around a hole, or around a handle
                let on_border = |ring: &[RingFace]| ring.iter().filter(|face| face.x == v || face.y == v).count() == 1;
                if !(lenient && on_border(star.kept_ring) && on_border(star.removed_ring)) {
                    return false;
                }
            }
            if !star.kills(face) {
                marks.set(v, before | STAYS);
            }
        }
    }
    let cut_off = |v: u32| v != star.removed && marks.get(v).is_some_and(|m| m & STAYS == 0);
    let mut dead = star.kept_ring.iter().filter(|face| star.kills(face));
    if dead.any(|face| cut_off(face.x) || cut_off(face.y)) {
        return false; // an apex would lose its only tie to the merged vertex
    }
    // an edge between two apexes with a face to either end: the two faces would fall together
    let apexes = |v: u32| v != star.kept && v != star.removed && marks.get(v).is_some_and(|m| m & APEX != 0);
    let joins_apexes = |face: &RingFace| !star.kills(face) && apexes(face.x) && apexes(face.y);
    if star.kept_ring.iter().any(joins_apexes) && star.removed_ring.iter().any(joins_apexes) {
        // a tetrahedron may go as a whole: the driver takes away what is left of it
        return lenient && parts_may_go && star.kept_ring.len() == 3 && star.removed_ring.len() == 3 && dying == 2;
    }
    // two border vertices may only merge along the border: else it is pinched
    dying == 1 || !(is_on_border(star.kept_ring) && is_on_border(star.removed_ring))
}

/// Whether some edge around a vertex has an odd number of faces: the exclusive or of (well mixed) edge numbers, each
/// taken once per face, cancels where all are even.
fn is_on_border(ring: &[RingFace]) -> bool {
    let mixed = |edge: u32| (u64::from(edge) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ring.iter().fold(0, |all, face| all ^ mixed(face.edge_x) ^ mixed(face.edge_y)) != 0
}

fn leaves_valence(mesh: &CollapseMesh, collapse: &Collapse<'_>, marks: &mut Marks, (low, high): (u32, u32)) -> bool {
    marks.clear();
    let mut valence = 0;
    let mut apexes = Vec::new();
    for face in collapse.star.kept_ring.iter().chain(collapse.star.removed_ring) {
        for v in [face.x, face.y].into_iter().filter(|&v| v != collapse.star.kept && v != collapse.star.removed) {
            valence += u32::from(marks.set(v, 0).is_none());
            if collapse.star.kills(face) && !apexes.contains(&v) {
                apexes.push(v);
            }
        }
    }
    // an apex loses one neighbour; it may have had fewer than the range allows already
    let starved = |&apex: &u32| {
        let faces = mesh.faces_around(apex).count() as u32;
        faces > 0 && faces - 1 < low
    };
    valence > high || valence < low || apexes.iter().any(starved)
}

/// `4 sqrt(3) area / (a^2 + b^2 + c^2)`: 1 for an equilateral triangle, 0 for a needle.
pub fn triangle_quality(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let squares = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    if squares > 0.0 { 2.0 * 3.0_f64.sqrt() * (b - a).cross(c - a).length() / squares } else { 0.0 }
}

fn spoils_triangles(mesh: &CollapseMesh, collapse: &Collapse<'_>, least: f64) -> bool {
    let target = mesh.frame().enter(collapse.position);
    let mut before = f64::INFINITY;
    let mut after = f64::INFINITY;
    for (v, ring) in
        [(collapse.star.kept, collapse.star.kept_ring), (collapse.star.removed, collapse.star.removed_ring)]
    {
        for face in ring {
            let [p, x, y] = [v, face.x, face.y].map(|v| mesh.point(v));
            before = before.min(triangle_quality(p, x, y));
            if !collapse.star.kills(face) {
                after = after.min(triangle_quality(target, x, y));
            }
        }
    }
    after < least && after < before
}
