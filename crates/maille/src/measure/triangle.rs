//! Geometry of one triangle, in double precision.

use glam::DVec3;

/// Barycentric coordinates of a point of a triangle and its squared distance from some query.
pub(crate) type OnTriangle = ([f64; 3], f64);

/// The normal of a triangle, as long as twice its area.
pub(crate) fn scaled_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The point with the given barycentric coordinates.
pub(crate) fn at([a, b, c]: [DVec3; 3], [u, v, w]: [f64; 3]) -> DVec3 {
    a * u + b * v + c * w
}

/// The point of a triangle nearest to `p`.
///
/// The projection of `p` onto the plane lies inside, or is seen from outside by one or two of the edges; the nearest
/// point lies on one of those. The signs come from cross products with the normal, not from the products of dot
/// products of the usual region test, which cancel on needles: corners are `f32`, so their differences, and nearly
/// the normal, are exact in `f64`. Without a normal (a needle beyond that, a point) the three edges are the triangle.
///
/// Forced into its callers: corners passed by memory cost a search near the surface 12 % of its time, one farther
/// away 25 %.
#[inline(always)]
pub(crate) fn closest_on_triangle(p: DVec3, corners @ [a, b, c]: [DVec3; 3]) -> OnTriangle {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let normal = ab.cross(ac);
    let normal_sq = normal.length_squared();
    let (v, w) = (ap.cross(ac).dot(normal), ab.cross(ap).dot(normal));
    let inside = [normal_sq - v - w, v, w];
    if normal_sq > 0.0 && inside.iter().all(|&x| x >= 0.0) {
        return (inside.map(|x| x / normal_sq), ap.dot(normal).powi(2) / normal_sq);
    }
    let mut best = ([0.0; 3], f64::INFINITY);
    for (corner, &side) in inside.iter().enumerate() {
        if side < 0.0 || normal_sq <= 0.0 {
            let (from, to) = ((corner + 1) % 3, (corner + 2) % 3);
            let (t, distance_sq) = closest_on_segment(p, corners[from], corners[to]);
            if distance_sq < best.1 {
                let mut barycentric = [0.0; 3];
                (barycentric[from], barycentric[to]) = (1.0 - t, t);
                best = (barycentric, distance_sq);
            }
        }
    }
    best
}

/// How far along the segment from `a` to `b` its point nearest to `p` lies (0 to 1), and its squared distance.
fn closest_on_segment(p: DVec3, a: DVec3, b: DVec3) -> (f64, f64) {
    let (ab, ap) = (b - a, p - a);
    let length_sq = ab.length_squared();
    let t = if length_sq > 0.0 { (ap.dot(ab) / length_sq).clamp(0.0, 1.0) } else { 0.0 };
    (t, (ap - ab * t).length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(range: i32) -> impl Strategy<Value = DVec3> {
        // a coarse lattice, so that corners coincide, lie in line and hit edges and corners exactly
        prop::array::uniform3(-range..=range).prop_map(|p| DVec3::from(p.map(f64::from)) * 0.25)
    }

    proptest! {
        #[test]
        fn no_point_of_the_triangle_is_nearer(
            p in point(8), corners in prop::array::uniform3(point(4)), weights in prop::array::uniform3(0.0..1.0f64),
        ) {
            let (barycentric, distance_sq) = closest_on_triangle(p, corners);
            prop_assert!(barycentric.iter().all(|x| (0.0..=1.0).contains(x)));
            prop_assert!((barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(((at(corners, barycentric) - p).length_squared() - distance_sq).abs() < 1e-12);
            let sum = weights.iter().sum::<f64>().max(1e-9);
            let other = at(corners, weights.map(|w| w / sum));
            prop_assert!(sum < 1e-8 || other.distance_squared(p) >= distance_sq - 1e-12);
            for corner in corners {
                prop_assert!(corner.distance_squared(p) >= distance_sq - 1e-12);
            }
        }
    }

    #[test]
    fn regions_of_an_obtuse_triangle() {
        let corners = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(-3.0, 1.0, 0.0)];
        let nearest = |x: f64, y: f64| at(corners, closest_on_triangle(DVec3::new(x, y, 2.0), corners).0);
        assert_eq!(nearest(1.0, -1.0), DVec3::new(1.0, 0.0, 0.0));
        assert_eq!(nearest(-0.1, -1.0), DVec3::ZERO);
        assert_eq!(nearest(9.0, 0.0), corners[1]);
        assert_eq!(nearest(-9.0, 3.0), corners[2]);
        assert!((nearest(0.5, 0.25) - DVec3::new(0.5, 0.25, 0.0)).length() < 1e-15);
    }

    #[test]
    fn a_needle_is_measured_to_its_axis() {
        let corners = [DVec3::ZERO, DVec3::new(1e6, 0.0, 0.0), DVec3::new(5e5, f64::from(f32::MIN_POSITIVE), 0.0)];
        let (_, distance_sq) = closest_on_triangle(DVec3::new(3e5, 3.0, 4.0), corners);
        assert!((distance_sq - 25.0).abs() < 1e-9);
    }
}
