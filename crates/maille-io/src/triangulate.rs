//! Polygons into triangles.
//!
//! A polygon of n corners becomes n - 2 triangles over the same corners: none is added and none is lost, so that
//! neighbours that share an edge still share it (ear clippers that skip collinear points, as the crate `earcut` does,
//! leave T-junctions; it serves here only for polygons too large for the quadratic clipper).

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// Polygons with more corners than this are left to `earcut`.
const CLIP_LIMIT: usize = 4096;

/// Polygons of any number of corners, each corner the index of a wedge.
#[derive(Default)]
pub(crate) struct Polygons {
    corners: Vec<u32>,
    /// Where each polygon ends in `corners`.
    ends: Vec<usize>,
}

/// What triangulation gives.
pub(crate) struct Triangulated {
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The polygon of each triangle; `None` when polygons and triangles are the same.
    pub(crate) sources: Option<Vec<u32>>,
    /// Polygons of fewer than three corners, which are no surface.
    pub(crate) left_out: usize,
}

impl Polygons {
    /// Adds a corner to the polygon under work.
    pub(crate) fn push_corner(&mut self, wedge: u32) {
        self.corners.push(wedge);
    }

    /// Ends the polygon under work.
    pub(crate) fn end_polygon(&mut self) {
        self.ends.push(self.corners.len());
    }

    /// Ends the polygon under work if it has any corners.
    pub(crate) fn end_open_polygon(&mut self) {
        if self.ends.last().copied().unwrap_or(0) < self.corners.len() {
            self.end_polygon();
        }
    }

    /// Number of polygons.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// All corners, polygon after polygon.
    pub(crate) fn corners(&self) -> &[u32] {
        &self.corners
    }

    /// All corners for renumbering.
    pub(crate) fn corners_mut(&mut self) -> &mut [u32] {
        &mut self.corners
    }

    /// Splits all polygons; `position` gives the place of a wedge.
    pub(crate) fn triangulate(self, position: impl Fn(u32) -> [f32; 3]) -> Triangulated {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let polygons = starts.zip(self.ends.iter().copied());
        if polygons.clone().all(|(start, end)| end - start == 3) {
            let triangles = self.corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
            return Triangulated { triangles, sources: None, left_out: 0 };
        }
        let (mut triangles, mut sources, mut left_out) = (Vec::new(), Vec::new(), 0);
        let mut points = Vec::new();
        for (polygon, (start, end)) in polygons.enumerate() {
            let corners = &self.corners[start..end];
            points.clear();
            points.extend(corners.iter().map(|&w| glam::Vec3::from(position(w)).as_dvec3()));
            left_out += usize::from(corners.len() < 3);
            split(&points, |t| triangles.push(t.map(|i| corners[i])));
            sources.resize(triangles.len(), polygon as u32);
        }
        Triangulated { triangles, sources: Some(sources), left_out }
    }
}

/// Splits one polygon and hands over the triangles as indices of its corners, wound as the polygon.
fn split(points: &[DVec3], mut emit: impl FnMut([usize; 3])) {
    match points.len() {
        0..3 => {}
        3 => emit([0, 1, 2]),
        4 => split_quad(points, emit),
        n => {
            let plane = project(points);
            if is_convex(&plane) {
                zigzag(n, emit);
            } else if n <= CLIP_LIMIT {
                clip_ears(&plane, emit);
            } else {
                let mut triangles: Vec<u32> = Vec::new();
                Earcut::new().earcut(plane.iter().map(|p| p.to_array()), &[], &mut triangles);
                if triangles.len() == 3 * (n - 2) {
                    triangles.chunks_exact(3).for_each(|t| emit([t[0], t[1], t[2]].map(|i| i as usize)));
                } else {
                    zigzag(n, emit);
                }
            }
        }
    }
}

/// Twice the area times the normal of a triangle.
fn normal(a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    (b - a).cross(c - a)
}

/// A quad along the diagonal over which it bends least; between two flat ones, along the shorter. At a reflex corner
/// the other diagonal lies outside and bends by 180 degrees, so concave quads come out right, too.
fn split_quad(p: &[DVec3], mut emit: impl FnMut([usize; 3])) {
    let bend = |a: usize, b: usize, c: usize, d: usize| {
        let (left, right) = (normal(p[a], p[b], p[c]), normal(p[a], p[c], p[d]));
        left.normalize_or_zero().dot(right.normalize_or_zero())
    };
    let (along_02, along_13) = (bend(0, 1, 2, 3), bend(1, 2, 3, 0));
    let shorter_13 = p[1].distance_squared(p[3]) < p[0].distance_squared(p[2]);
    let take_13 = if (along_02 - along_13).abs() < 1e-3 { shorter_13 } else { along_13 > along_02 };
    if take_13 {
        emit([0, 1, 3]);
        emit([1, 2, 3]);
    } else {
        emit([0, 1, 2]);
        emit([0, 2, 3]);
    }
}

/// The polygon seen along its normal (Newell's, the sum over the edges), wound counter-clockwise.
fn project(points: &[DVec3]) -> Vec<DVec2> {
    let origin = points[0];
    let edges = points.iter().zip(points.iter().cycle().skip(1));
    let normal: DVec3 = edges.map(|(&a, &b)| (a - origin).cross(b - origin)).sum();
    let size = normal.abs();
    // dropping the axis of the largest component keeps shapes sound and costs no rounding
    let flat = |p: &DVec3| match size.max_element() {
        m if m == size.z => DVec2::new(p.x, p.y) * DVec2::new(1.0, normal.z.signum()),
        m if m == size.x => DVec2::new(p.y, p.z) * DVec2::new(1.0, normal.x.signum()),
        _ => DVec2::new(p.z, p.x) * DVec2::new(1.0, normal.y.signum()),
    };
    points.iter().map(flat).collect()
}

/// Twice the signed area.
fn area(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

fn is_convex(p: &[DVec2]) -> bool {
    let n = p.len();
    // turning left everywhere, and around only once: the edges change from rising to falling and back
    let left = (0..n).all(|i| area(p[i], p[(i + 1) % n], p[(i + 2) % n]) > 0.0);
    let rises = |i: usize| p[(i + 1) % n].y > p[i % n].y;
    left && (0..n).filter(|&i| rises(i) != rises(i + 1)).count() <= 2
}

/// A strip across a convex polygon: better shaped than a fan.
fn zigzag(n: usize, mut emit: impl FnMut([usize; 3])) {
    let (mut low, mut high) = (0, n - 1);
    while high - low > 1 {
        emit([low, low + 1, high]);
        low += 1;
        if high - low > 1 {
            emit([low, high - 1, high]);
            high -= 1;
        }
    }
}

/// Clips ears, in turn around the polygon. Where none is left (flat or self-crossing rest) the corner with the
/// smallest area goes, so that there are always n - 2 triangles.
fn clip_ears(p: &[DVec2], mut emit: impl FnMut([usize; 3])) {
    let mut ring: Vec<usize> = (0..p.len()).collect();
    let (mut at, mut tried) = (0, 0);
    while ring.len() > 3 {
        let n = ring.len();
        at %= n;
        let corner = |i: usize| [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
        if tried == n {
            let size = |i: usize| corner(i).map(|c| p[c]);
            let size = |i: usize| area(size(i)[0], size(i)[1], size(i)[2]).abs();
            at = (0..n).min_by(|&a, &b| size(a).total_cmp(&size(b))).expect("the ring has corners");
        } else if !is_ear(p, &ring, corner(at)) {
            (at, tried) = (at + 1, tried + 1);
            continue;
        }
        emit(corner(at));
        ring.remove(at);
        // the next corner has just lost its neighbour: going on behind it spreads the triangles
        (at, tried) = (at + 1, 0);
    }
    emit([ring[0], ring[1], ring[2]]);
}

/// Whether a corner turns left and no other corner lies in its triangle or on its cut.
fn is_ear(p: &[DVec2], ring: &[usize], [a, b, c]: [usize; 3]) -> bool {
    let (pa, pb, pc) = (p[a], p[b], p[c]);
    if area(pa, pb, pc) <= 0.0 {
        return false;
    }
    let inside = |q: DVec2| area(pa, pb, q) >= 0.0 && area(pb, pc, q) >= 0.0 && area(pc, pa, q) >= 0.0;
    let at_corner = |q: DVec2| q == pa || q == pb || q == pc;
    !ring.iter().any(|&i| i != a && i != b && i != c && inside(p[i]) && !at_corner(p[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn triangles_of(points: &[DVec3]) -> Vec<[usize; 3]> {
        let mut triangles = Vec::new();
        split(points, |t| triangles.push(t));
        triangles
    }

    fn signed_area(points: &[DVec3], t: &[usize; 3]) -> f64 {
        normal(points[t[0]], points[t[1]], points[t[2]]).z / 2.0
    }

    /// Directed edges that no triangle runs the other way.
    fn outline(triangles: &[[usize; 3]]) -> Vec<(usize, usize)> {
        let edges: Vec<_> = triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        let mut open: Vec<_> = edges.iter().copied().filter(|&(a, b)| !edges.contains(&(b, a))).collect();
        open.sort_unstable();
        open
    }

    fn flat(points: &[(f64, f64)]) -> Vec<DVec3> {
        points.iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect()
    }

    #[test]
    fn concave_quads_are_cut_at_the_reflex_corner() {
        for shift in 0..4 {
            let mut points = flat(&[(0.0, 0.0), (2.0, -1.0), (0.5, 0.0), (2.0, 1.0)]);
            points.rotate_left(shift);
            let triangles = triangles_of(&points);
            assert!(triangles.iter().all(|t| signed_area(&points, t) > 0.0), "{shift}: {triangles:?}");
        }
    }

    #[test]
    fn combs_with_collinear_points_keep_area_and_outline() {
        // teeth upward on a base with a point under every tooth
        let mut points = vec![];
        for i in 0..9 {
            points.push((f64::from(i), 0.0));
        }
        for i in (0..9).rev() {
            points.push((f64::from(i), if i % 2 == 0 { 3.0 } else { 0.5 }));
        }
        let points = flat(&points);
        let triangles = triangles_of(&points);
        assert_eq!(triangles.len(), points.len() - 2);
        let shoelace: f64 = (0..points.len())
            .map(|i| points[i].truncate().perp_dot(points[(i + 1) % points.len()].truncate()) / 2.0)
            .sum();
        let total: f64 = triangles.iter().map(|t| signed_area(&points, t)).sum();
        let unsigned: f64 = triangles.iter().map(|t| signed_area(&points, t).abs()).sum();
        assert!((total - shoelace).abs() < 1e-12 && (unsigned - shoelace).abs() < 1e-12);
        let mut sides: Vec<_> = (0..points.len()).map(|i| (i, (i + 1) % points.len())).collect();
        sides.sort_unstable();
        assert_eq!(outline(&triangles), sides);
    }

    #[test]
    fn degenerate_polygons_still_give_all_their_triangles() {
        let points = vec![DVec3::ONE; 7];
        assert_eq!(triangles_of(&points).len(), 5);
        let line: Vec<_> = (0..6).map(|i| DVec3::splat(f64::from(i))).collect();
        assert_eq!(triangles_of(&line).len(), 4);
        let not_a_number = vec![DVec3::NAN; 5];
        assert_eq!(triangles_of(&not_a_number).len(), 3);
    }

    #[test]
    fn huge_polygons_of_nonsense_come_to_an_end() {
        let nonsense = [f64::NAN, f64::INFINITY, 0.0, 1e308, -1.0, 3.4e38, f64::NEG_INFINITY];
        let at = |i: usize| DVec3::new(nonsense[i % 7], nonsense[i % 5], nonsense[i * i % 7]);
        for n in [7, 100, 5000] {
            let points: Vec<_> = (0..n).map(at).collect();
            assert_eq!(triangles_of(&points).len(), n - 2);
            let spiral: Vec<_> = (0..n).map(|i| DVec3::new((i * 37 % 101) as f64, (i * 53 % 89) as f64, 0.0)).collect();
            assert_eq!(triangles_of(&spiral).len(), n - 2);
        }
    }

    #[test]
    fn huge_concave_polygons_go_through_earcut() {
        let star = |i: u32| {
            let (angle, radius) = (f64::from(i) * std::f64::consts::TAU / 6000.0, 1.0 + f64::from(i % 2));
            DVec3::new(radius * angle.cos(), radius * angle.sin(), 0.0)
        };
        let points: Vec<_> = (0..6000).map(star).collect();
        let triangles = triangles_of(&points);
        assert_eq!(triangles.len(), 5998);
        assert!(triangles.iter().all(|t| signed_area(&points, t) > 0.0));
    }

    proptest! {
        /// Any star-shaped polygon, tilted in space: all triangles face the polygon's way, areas add up.
        #[test]
        fn star_shaped_polygons_are_covered_once(radii in prop::collection::vec(0.2_f64..3.0, 3..40), tilt in 0.0_f64..1.4) {
            let n = radii.len() as f64;
            let turn = glam::DQuat::from_rotation_x(tilt);
            let at = |(i, r): (usize, &f64)| turn * (*r * DVec3::from((DVec2::from_angle(i as f64 * std::f64::consts::TAU / n), 0.0)));
            let points: Vec<_> = radii.iter().enumerate().map(at).collect();
            let up = turn * DVec3::Z;
            let triangles = triangles_of(&points);
            prop_assert_eq!(triangles.len(), points.len() - 2);
            let areas = triangles.iter().map(|t| normal(points[t[0]], points[t[1]], points[t[2]]).dot(up));
            prop_assert!(areas.clone().all(|a| a > -1e-9));
            let whole: f64 = (0..points.len()).map(|i| points[i].cross(points[(i + 1) % points.len()]).dot(up)).sum();
            prop_assert!((areas.sum::<f64>() - whole).abs() < 1e-9 * whole.abs().max(1.0));
        }
    }
}
