//! Signed distances of simple shapes, negative inside, and how to join them.
//!
//! All are 1-Lipschitz (they never overstate the distance), so that whole blocks of space can be skipped.
//! After Inigo Quilez, "distance functions", and Barbier and Galin 2004 for round cones.

use glam::{Vec2, Vec3};

/// A box with rounded edges; `half` is half its size including the rounding.
pub(super) fn rounded_box(p: Vec3, half: Vec3, rounding: f32) -> f32 {
    let q = p.abs() - half + rounding;
    q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - rounding
}

/// An ellipsoid: a lower bound of the distance, exact on the surface.
pub(super) fn ellipsoid(p: Vec3, radii: Vec3) -> f32 {
    ((p / radii).length() - 1.0) * radii.min_element()
}

/// The hull of two spheres.
pub(super) fn round_cone(p: Vec3, a: Vec3, b: Vec3, ra: f32, rb: f32) -> f32 {
    let axis = b - a;
    let length_sq = axis.length_squared();
    let narrowing = ra - rb;
    let a2 = length_sq - narrowing * narrowing;
    if a2 <= 0.0 {
        // one sphere holds the other
        return if ra > rb { p.distance(a) - ra } else { p.distance(b) - rb };
    }
    let il2 = 1.0 / length_sq;
    let pa = p - a;
    let y = pa.dot(axis);
    let z = y - length_sq;
    let x2 = (pa * length_sq - axis * y).length_squared();
    let y2 = y * y * length_sq;
    let z2 = z * z * length_sq;
    let k = narrowing.signum() * narrowing * narrowing * x2;
    if z.signum() * a2 * z2 > k {
        (x2 + z2).sqrt() * il2 - rb
    } else if y.signum() * a2 * y2 < k {
        (x2 + y2).sqrt() * il2 - ra
    } else {
        ((x2 * a2 * il2).sqrt() + y * narrowing) * il2 - ra
    }
}

/// A torus about the y axis.
pub(super) fn torus(p: Vec3, major: f32, minor: f32) -> f32 {
    Vec2::new(Vec2::new(p.x, p.z).length() - major, p.y).length() - minor
}

/// Union with a fillet of about `size` (polynomial smooth minimum).
pub(super) fn join(a: f32, b: f32, size: f32) -> f32 {
    let h = (size - (a - b).abs()).max(0.0) / size;
    a.min(b) - h * h * size * 0.25
}

/// `a` without `b`, with a fillet of about `size`.
pub(super) fn carve(a: f32, b: f32, size: f32) -> f32 {
    -join(-a, b, size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_cone_is_the_distance_to_the_nearest_of_its_spheres() {
        let (a, b, ra, rb) = (Vec3::new(0.1, 0.0, 0.2), Vec3::new(0.9, 0.6, -0.3), 0.5, 0.2);
        for i in 0..200u32 {
            let p = Vec3::from(
                [1, 2, 3].map(|s| 2.0 * super::super::noise::signed_unit(super::super::noise::mix(i * 3 + s))),
            );
            let sphere = |k: i32| {
                let t = k as f32 / 1000.0;
                p.distance(a.lerp(b, t)) - (ra + t * (rb - ra))
            };
            let slow = (0..=1000).map(sphere).fold(f32::INFINITY, f32::min);
            assert!((round_cone(p, a, b, ra, rb) - slow).abs() < 2e-3);
        }
    }
}
