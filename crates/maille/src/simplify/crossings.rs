//! Collapses after which the surface would pass through itself.
//!
//! The faces that are left are kept in a binary tree of boxes over their numbers: the mesh is in spatial order, so that faces
//! with near numbers are near in space and stay so when their neighbours vanish. A collapse changes the boxes of a few leaves
//! and what is above them.
//!
//! The tests are those of edges against triangles, with the signs of volumes in `f64` (positions are `f32`); what is too near
//! to tell counts as crossing.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::legality::Collapse;
use crate::topology::CollapseMesh;

/// Faces to a leaf.
const LEAF: usize = 8;
/// Rounding of a volume, as a share of the product of the three edges that span it.
const ROUNDING: f64 = 1e-15;

type Box3 = [Vec3; 2];

const NOTHING: Box3 = [Vec3::INFINITY, Vec3::NEG_INFINITY];

/// The faces of a mesh, by place.
#[derive(Debug)]
pub(super) struct Crossings {
    /// The children of node `i` are `2 i` and `2 i + 1`, the root is 1; the second half are the leaves.
    boxes: Vec<Box3>,
    /// Number of faces, those that are no more among them.
    faces: usize,
    /// Faces about to be tested, and of the star.
    near: Vec<u32>,
    star: Vec<[u32; 3]>,
    stack: Vec<usize>,
}

impl Crossings {
    pub(super) fn new(mesh: &CollapseMesh) -> Self {
        let leaves = mesh.face_count().div_ceil(LEAF).next_power_of_two();
        let mut boxes = vec![NOTHING; leaves];
        boxes.extend((0..leaves).into_par_iter().map(|leaf| leaf_box(mesh, leaf)).collect::<Vec<_>>());
        for i in (1..leaves).rev() {
            boxes[i] = union(boxes[2 * i], boxes[2 * i + 1]);
        }
        Self { boxes, faces: mesh.face_count(), near: Vec::new(), star: Vec::new(), stack: Vec::new() }
    }

    /// Brings the boxes up to date after faces have changed or gone.
    pub(super) fn update(&mut self, mesh: &CollapseMesh, faces: impl Iterator<Item = u32>) {
        let leaves = self.boxes.len() / 2;
        self.near.clear();
        self.near.extend(faces.map(|face| face / LEAF as u32));
        self.near.sort_unstable();
        self.near.dedup();
        for &leaf in &self.near {
            let mut node = leaves + leaf as usize;
            let mut now = leaf_box(mesh, leaf as usize);
            while self.boxes[node] != now {
                self.boxes[node] = now;
                node /= 2;
                if node == 0 {
                    break;
                }
                now = union(self.boxes[2 * node], self.boxes[2 * node + 1]);
            }
        }
    }

    /// Whether a face that a collapse makes would cross another one, or one of those it makes as well.
    pub(super) fn would_cross(&mut self, mesh: &CollapseMesh, collapse: &Collapse<'_>) -> bool {
        let star = &collapse.star;
        let target = mesh.frame().enter(collapse.position);
        let rings = || star.kept_ring.iter().chain(star.removed_ring);
        self.star.clear();
        self.star.extend(rings().filter(|face| !star.kills(face)).map(|face| [star.kept, face.x, face.y]));
        let corners = |face: &[u32; 3]| [target, mesh.point(face[1]), mesh.point(face[2])];
        for (i, first) in self.star.iter().enumerate() {
            if self.star[i + 1..].iter().any(|second| cross((first, corners(first)), (second, corners(second)))) {
                return true;
            }
        }
        for i in 0..self.star.len() {
            let face = self.star[i];
            let points = corners(&face);
            self.gather(outward_box(points));
            for &other in &self.near {
                let Some(vertices) = mesh.face(other as usize) else { continue };
                if vertices.contains(&star.kept) || vertices.contains(&star.removed) {
                    continue; // of the star itself
                }
                if cross((&face, points), (&vertices, vertices.map(|v| mesh.point(v)))) {
                    return true;
                }
            }
        }
        false
    }

    /// The faces in leaves whose boxes meet the given one.
    fn gather(&mut self, place: Box3) {
        let leaves = self.boxes.len() / 2;
        self.near.clear();
        self.stack.clear();
        self.stack.push(1);
        while let Some(node) = self.stack.pop() {
            let [low, high] = self.boxes[node];
            if !(low.cmple(place[1]).all() && high.cmpge(place[0]).all()) {
                continue;
            }
            if node < leaves {
                self.stack.extend([2 * node, 2 * node + 1]);
            } else {
                let first = (node - leaves) * LEAF;
                self.near.extend(first as u32..(first + LEAF).min(self.faces) as u32);
            }
        }
    }
}

fn leaf_box(mesh: &CollapseMesh, leaf: usize) -> Box3 {
    let faces = (leaf * LEAF..((leaf + 1) * LEAF).min(mesh.face_count())).filter_map(|face| mesh.face(face));
    faces.fold(NOTHING, |all, face| union(all, outward_box(face.map(|v| mesh.point(v)))))
}

fn outward_box(points: [DVec3; 3]) -> Box3 {
    let [a, b, c] = points;
    let (low, high) = (a.min(b).min(c).as_vec3(), a.max(b).max(c).as_vec3());
    [low.to_array().map(f32::next_down).into(), high.to_array().map(f32::next_up).into()]
}

fn union(a: Box3, b: Box3) -> Box3 {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Whether two triangles have more in common than the vertices that they share: by number, or by place.
fn cross((first, p): (&[u32; 3], [DVec3; 3]), (second, q): (&[u32; 3], [DVec3; 3])) -> bool {
    let [p_low, p_high] = [p[0].min(p[1]).min(p[2]), p[0].max(p[1]).max(p[2])];
    let [q_low, q_high] = [q[0].min(q[1]).min(q[2]), q[0].max(q[1]).max(q[2])];
    if p_low.cmpgt(q_high).any() || q_low.cmpgt(p_high).any() {
        return false;
    }
    let same = |i: usize, j: usize| first[i] == second[j] || p[i] == q[j];
    let shared_in_second = |i: usize| (0..3).find(|&j| same(i, j));
    let shared = [0, 1, 2].map(shared_in_second);
    match shared.iter().flatten().count() {
        0 => {
            let edges = |t: [DVec3; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            edges(p).iter().any(|&edge| meets(edge, q)) || edges(q).iter().any(|&edge| meets(edge, p))
        }
        1 => {
            let i = (0..3).find(|&i| shared[i].is_some()).expect("one is shared");
            let j = shared[i].expect("it was found by that");
            let opposite = |t: [DVec3; 3], k: usize| [t[(k + 1) % 3], t[(k + 2) % 3]];
            meets(opposite(p, i), q) || meets(opposite(q, j), p)
        }
        2 => {
            let i = (0..3).find(|&i| shared[i].is_none()).expect("one is not shared");
            let j = (0..3).find(|j| !shared.contains(&Some(*j))).expect("one is not shared");
            let (a, b) = (p[(i + 1) % 3], p[(i + 2) % 3]);
            let sides = [p[i], q[j]].map(|apex| (b - a).cross(apex - a));
            side([a, b, p[i]], q[j]) == 0 && sides[0].dot(sides[1]) > 0.0
        }
        _ => true,
    }
}

/// On which side of a plane a point lies: -1, 0 (too near to tell) or 1.
fn side([a, b, c]: [DVec3; 3], p: DVec3) -> i32 {
    let (u, v, w) = (b - a, c - a, p - a);
    let volume = u.cross(v).dot(w);
    let rounding = ROUNDING * u.length() * v.length() * w.length();
    if volume > rounding {
        1
    } else if volume < -rounding {
        -1
    } else {
        0
    }
}

/// Whether an edge and a triangle have a point in common, as far as rounding can tell.
fn meets([p, q]: [DVec3; 2], triangle: [DVec3; 3]) -> bool {
    let [a, b, c] = triangle;
    match (side(triangle, p), side(triangle, q)) {
        (0, 0) => meets_in_plane([p, q], triangle),
        (x, y) if x == y => false,
        _ => {
            let around = [side([p, q, a], b), side([p, q, b], c), side([p, q, c], a)];
            around.iter().all(|&s| s >= 0) || around.iter().all(|&s| s <= 0)
        }
    }
}

/// The same where all lies in one plane. A triangle without a plane is met by nothing: its edges are tested themselves.
fn meets_in_plane(edge: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    if normal.length() <= ROUNDING * (b - a).length() * (c - a).length() {
        return false;
    }
    let most = normal.abs().max_element();
    let flat = |p: DVec3| {
        if normal.x.abs() == most {
            DVec2::new(p.y, p.z)
        } else if normal.y.abs() == most {
            DVec2::new(p.z, p.x)
        } else {
            DVec2::new(p.x, p.y)
        }
    };
    let [p, q] = edge.map(flat);
    let corners = [a, b, c].map(flat);
    let turn = |a: DVec2, b: DVec2, c: DVec2| {
        let (u, v) = (b - a, c - a);
        let area = u.perp_dot(v);
        if area.abs() <= ROUNDING * u.length() * v.length() { 0 } else { area.signum() as i32 }
    };
    let inside = |p: DVec2| {
        let turns = [0, 1, 2].map(|k| turn(corners[k], corners[(k + 1) % 3], p));
        turns.iter().all(|&t| t >= 0) || turns.iter().all(|&t| t <= 0)
    };
    let crosses = |k: usize| {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let (ends, corners) = ([turn(p, q, a), turn(p, q, b)], [turn(a, b, p), turn(a, b, q)]);
        let in_line = ends == [0, 0] && corners == [0, 0];
        let overlap = a.min(b).cmple(p.max(q)).all() && p.min(q).cmple(a.max(b)).all();
        if in_line { overlap } else { ends[0] * ends[1] <= 0 && corners[0] * corners[1] <= 0 }
    };
    inside(p) || inside(q) || (0..3).any(crosses)
}

#[cfg(test)]
mod tests {
    use super::super::{SimplifyOptions, Target, simplify};
    use super::*;
    use crate::{Control, Mesh};

    fn triangle(points: [[f64; 3]; 3]) -> [DVec3; 3] {
        points.map(DVec3::from)
    }

    #[test]
    fn pairs_of_triangles() {
        let flat = triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let crosses = |other: [[f64; 3]; 3], second: [u32; 3]| {
            let other = triangle(other);
            let both = [cross((&[0, 1, 2], flat), (&second, other)), cross((&second, other), (&[0, 1, 2], flat))];
            assert_eq!(both[0], both[1]);
            both[0]
        };
        assert!(crosses([[0.2, 0.2, -1.0], [0.2, 0.2, 1.0], [3.0, 3.0, 0.5]], [3, 4, 5]), "a blade through it");
        assert!(!crosses([[0.2, 0.2, 0.1], [0.2, 0.2, 1.0], [3.0, 3.0, 0.5]], [3, 4, 5]), "a blade above it");
        assert!(crosses([[0.1, 0.1, 0.0], [0.3, 0.1, 0.0], [0.1, 0.3, 0.0]], [3, 4, 5]), "within it, in its plane");
        assert!(!crosses([[1.0, 1.0, 0.0], [0.6, 1.0, 0.0], [1.0, 0.6, 0.0]], [3, 4, 5]), "beside it, in its plane");
        assert!(!crosses([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0, 4, 5]), "at a corner");
        assert!(crosses([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 1.0, -1.0]], [0, 4, 5]), "through it, from a corner");
        assert!(!crosses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0, 1, 5]), "its neighbour");
        assert!(!crosses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1e-3]], [0, 1, 5]), "a sharp fold");
        assert!(crosses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 2.0, 0.0]], [0, 1, 5]), "folded onto it");
        assert!(!crosses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [7, 8, 9]), "a neighbour by place");
    }

    /// Pairs of triangles that share no vertex by number and have a point in common, by another test: an edge of one
    /// passes through the other at a point whose weights are all positive.
    fn crossings_by_brute_force(mesh: &Mesh) -> usize {
        let passes = |[p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]| {
            let normal = (b - a).cross(c - a);
            let along = normal.dot(q - p);
            let t = normal.dot(a - p) / along;
            let hit = p + (q - p) * t;
            let weights = [(b, c), (c, a), (a, b)].map(|(u, v)| (u - hit).cross(v - hit).dot(normal));
            along != 0.0 && (0.0..=1.0).contains(&t) && weights.iter().all(|&w| w > 0.0)
        };
        let triangles: Vec<_> =
            (0..mesh.triangle_count()).map(|t| (mesh.triangle_vertices(t), mesh.triangle_points(t))).collect();
        let edges = |t: [DVec3; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        let mut count = 0;
        for (i, (first, p)) in triangles.iter().enumerate() {
            for (second, q) in &triangles[i + 1..] {
                let apart = !first.iter().any(|v| second.contains(v));
                let cross = || edges(*p).iter().any(|&e| passes(e, *q)) || edges(*q).iter().any(|&e| passes(e, *p));
                count += usize::from(apart && cross());
            }
        }
        count
    }

    /// Two wavy sheets, one just above the other, with the waves of the triangles out of step.
    fn sheets(gap: f32) -> Mesh {
        let n = 41; // the last leaf of the tree is not full
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for sheet in 0..2_u32 {
            let first = positions.len() as u32;
            let shift = 0.37 * sheet as f32;
            for y in 0..=n {
                for x in 0..=n {
                    let (x, y) = ((x as f32 + shift) / n as f32, (y as f32 + shift) / n as f32);
                    let wave = 0.1 * (9.0 * x).sin() * (7.0 * y).cos();
                    positions.push([x, y, wave + gap * sheet as f32]);
                }
            }
            for y in 0..n {
                for x in 0..n {
                    let a = first + y * (n + 1) + x;
                    let (b, c, d) = (a + 1, a + n + 1, a + n + 2);
                    triangles.extend([[a, b, d], [a, d, c]]);
                }
            }
        }
        Mesh::from_triangles(positions, triangles).expect("indices are in range")
    }

    #[test]
    fn sheets_that_lie_close_stay_apart() {
        let mesh = sheets(0.01);
        assert_eq!(crossings_by_brute_force(&mesh), 0);
        let reduced = |no_self_intersections| {
            let mut mesh = mesh.clone();
            let target = Target { triangles: Some(300), ..Target::default() };
            let options = SimplifyOptions { target, no_self_intersections, ..SimplifyOptions::default() };
            let report = simplify(&mut mesh, &options, Control::default()).expect("the options make sense");
            (crossings_by_brute_force(&mesh), mesh.triangle_count(), report.refused.self_intersections)
        };
        let (crossing, _, refused) = reduced(false);
        assert!(crossing > 0 && refused == 0, "the test needs sheets that would cross");
        let (crossing, triangles, refused) = reduced(true);
        assert_eq!(crossing, 0);
        assert!(refused > 0 && triangles <= 600, "{triangles} triangles, {refused} refused");
    }

    #[test]
    fn the_tree_finds_what_a_search_of_all_faces_finds() {
        let mesh = crate::mesh::shapes::torus(3.0, 1.0, 29, 19);
        let triangles: Vec<_> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
        let faces = CollapseMesh::new(&mesh.positions, triangles.into_iter());
        let mut crossings = Crossings::new(&faces);
        for t in (0..faces.face_count()).step_by(7) {
            let corners = |t: usize| faces.face(t).map(|face| face.map(|v| faces.point(v)));
            let place = outward_box(corners(t).expect("nothing has gone"));
            crossings.gather(place);
            let meets = |other: &u32| {
                let [low, high] = outward_box(corners(*other as usize).expect("nothing has gone"));
                low.cmple(place[1]).all() && high.cmpge(place[0]).all()
            };
            let found: Vec<u32> = crossings.near.clone();
            assert!((0..faces.face_count() as u32).filter(meets).all(|face| found.contains(&face)));
        }
    }
}
