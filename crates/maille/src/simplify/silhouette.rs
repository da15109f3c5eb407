//! Where silhouettes are likely to be.

use glam::{DVec3, Vec3};

/// Of each vertex, by how much a collapse there counts more when silhouettes count `weight` times.
///
/// Seen from a direction that is as likely as any other, a convex edge whose two faces turn by the angle `phi` is on the
/// contour with probability `phi / pi` (the directions that see one face and not the other are two wedges of that angle;
/// cf. McGuire, Observations on Silhouette Sizes, 2004); an open border always is, a concave edge hides its contour
/// behind itself. So `sum(length * phi / pi) / area` is the length of contour to be expected in a unit of the surface,
/// 1 / length; times the diagonal d of the model it is a pure number. If the surface is off by e, the squared distance
/// over the surface is the integral of `e^2`, that over the contours of all views the integral of `e^2` times this
/// density. Their weighted sum is what a cost is after that is multiplied by
///
/// `1 + weight * d * density`
///
/// Of noisy scans, every edge turns. The density is therefore a mean over a few rings ([`ROUNDS`]).
pub(super) fn factors(positions: &[[f32; 3]], triangles: &[[u32; 3]], weight: f64) -> Vec<f32> {
    let point = |v: u32| Vec3::from(positions[v as usize]).as_dvec3();
    let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * triangles.len());
    for (t, corners) in (0..).zip(triangles) {
        let edges = [[corners[0], corners[1]], [corners[1], corners[2]], [corners[2], corners[0]]];
        sides.extend(edges.map(|[a, b]| ([a.min(b), a.max(b)], t)));
    }
    sides.sort_unstable();
    let normal = |t: u32| {
        let [a, b, c] = triangles[t as usize].map(point);
        (b - a).cross(c - a)
    };
    // of each vertex, the contour expected and the area, in thirds and halves of what lies around it
    let mut known = vec![[0.0_f64; 2]; positions.len()];
    for (t, corners) in (0..).zip(triangles) {
        let third = normal(t).length() / 6.0;
        corners.iter().for_each(|&v| known[v as usize][1] += third);
    }
    let mut edges = Vec::with_capacity(sides.len() / 2 + 1);
    for same in sides.chunk_by(|a, b| a.0 == b.0) {
        let ([a, b], _) = same[0];
        if a == b {
            continue;
        }
        edges.push([a, b]);
        let turn = match same {
            &[(_, one), (_, other)] => {
                convex_turn([normal(one), normal(other)], point(a), far(triangles, other, [a, b]).map(point))
            }
            _ => std::f64::consts::PI,
        };
        let contour = point(a).distance(point(b)) * turn / std::f64::consts::PI;
        [a, b].iter().for_each(|&v| known[v as usize][0] += contour / 2.0);
    }
    for _ in 0..ROUNDS {
        let before = known.clone();
        for &[a, b] in &edges {
            for k in 0..2 {
                known[a as usize][k] += before[b as usize][k];
                known[b as usize][k] += before[a as usize][k];
            }
        }
    }
    let diagonal = diagonal(positions);
    let factor = |&[contour, area]: &[f64; 2]| {
        let density = if area > 0.0 { contour / area } else { 0.0 };
        (1.0 + weight * diagonal * density).min(MOST) as f32
    };
    known.iter().map(factor).collect()
}

/// Rings over which the density is a mean.
const ROUNDS: usize = 3;

/// Largest factor: a border of tiny triangles is no reason to give everything else up.
const MOST: f64 = 1e4;

/// The angle by which the normals of two faces turn at a convex edge, 0 at a concave one. `a` is on the edge, `far` the
/// third corner of the second face.
fn convex_turn([one, other]: [DVec3; 2], a: DVec3, far: Option<DVec3>) -> f64 {
    let is_convex = far.is_some_and(|far| one.dot(far - a) < 0.0);
    if is_convex { one.cross(other).length().atan2(one.dot(other)) } else { 0.0 }
}

/// The corner of a triangle that is not on an edge.
fn far(triangles: &[[u32; 3]], t: u32, edge: [u32; 2]) -> Option<u32> {
    triangles[t as usize].into_iter().find(|v| !edge.contains(v))
}

fn diagonal(positions: &[[f32; 3]]) -> f64 {
    let points = positions.iter().map(|p| Vec3::from(*p).as_dvec3());
    let (low, high) = points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let diagonal = (high - low).length();
    if diagonal.is_finite() { diagonal } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn of(mesh: &crate::Mesh) -> Vec<f32> {
        let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
        factors(&mesh.positions, &triangles, 1.0)
    }

    #[test]
    fn a_sphere_has_the_contour_of_its_curvature() {
        // of a sphere of radius r, the contour is 2 pi r of 4 pi r^2, and the diagonal 2 sqrt(3) r; the contour of a
        // polyhedron runs in zigzags along its edges, which is longer by 4 / pi
        let smooth = 0.5 * 2.0 * 3.0_f32.sqrt();
        let mesh = shapes::sphere(5);
        let ratios: Vec<f32> = of(&mesh).iter().map(|f| (f - 1.0) / smooth).collect();
        assert!(ratios.iter().all(|ratio| (1.2..1.35).contains(ratio)), "{:?}", &ratios[..8]);
        let mut large = mesh.clone();
        large.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= 64.0);
        assert_eq!(of(&mesh), of(&large));
    }

    #[test]
    fn inside_out_there_is_no_contour() {
        let mut mesh = shapes::sphere(3);
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!(of(&mesh).iter().all(|&f| f == 1.0));
    }

    #[test]
    fn flat_inside_and_open_border() {
        let mesh = shapes::grid(20);
        let factors = of(&mesh);
        let at = |x: f32, y: f32| mesh.positions.iter().position(|p| p[..2] == [x, y]).map(|v| factors[v]);
        assert_eq!(at(0.5, 0.5), Some(1.0));
        assert!(at(0.0, 0.5).is_some_and(|f| f > 5.0));
    }
}
