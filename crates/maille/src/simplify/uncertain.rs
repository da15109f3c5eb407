//! Quadrics that expect noise: of planes and triangles that are known up to a standard deviation, and of the lines along
//! normals, which do a similar service.

use glam::{DMat3, DVec3};

use super::options::QuadricWeight;
use super::quadric::Quadric;

/// What a face gives to the quadrics of its vertices.
///
/// The probabilistic ones are expected values of the weighted squared distance when the input is uncertain, with
/// independent Gaussian noise in every coordinate (Trettner and Kobbelt, Fast and Robust QEF Minimization using
/// Probabilistic Quadrics, Eurographics 2020). Their matrices are positive definite, so every placement has a solution,
/// and vertices keep their distance where planes alone say nothing. Surfaces come out more even, and farther from the
/// original.
///
/// Distances are in the coordinates that the metric computes in.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FaceQuadric {
    /// The squared distance from the plane of the face.
    #[default]
    Plane,
    /// The same of a plane through the middle of the face, whose point and normal are uncertain.
    ProbabilisticPlane {
        /// Standard deviation of the point, in each coordinate.
        position: f64,
        /// Standard deviation of the unit normal, in each coordinate.
        normal: f64,
    },
    /// The same of a triangle whose corners are uncertain.
    ProbabilisticTriangle {
        /// Standard deviation of the corners, in each coordinate.
        position: f64,
    },
}

impl FaceQuadric {
    /// The quadric of a face with the given unit normal, which counts so much; `sort` is what `weight` stands for.
    pub(super) fn uncertain(self, corners: [DVec3; 3], normal: DVec3, weight: f64, sort: QuadricWeight) -> Quadric {
        match self {
            Self::Plane => Quadric::plane(normal, corners[0], weight),
            Self::ProbabilisticPlane { position, normal: deviation } => {
                let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
                Quadric::probabilistic_plane(middle, normal, position, deviation, weight)
            }
            Self::ProbabilisticTriangle { position } => {
                let whole = Quadric::probabilistic_triangle(corners, position);
                // the trace is the expected square of twice the area
                let area_sq = whole.trace() / 4.0;
                let weight = match sort {
                    QuadricWeight::Area => area_sq.sqrt(),
                    QuadricWeight::AreaSquared => area_sq,
                    QuadricWeight::Uniform | QuadricWeight::Angle => weight,
                };
                if area_sq > 0.0 { whole.scaled(weight / whole.trace(), weight) } else { Quadric::default() }
            }
        }
    }

    /// What is left of a mean squared distance when that is taken away which noise alone adds everywhere.
    #[inline]
    pub(super) fn above_floor(self, mean_sq: f64) -> f64 {
        match self {
            Self::Plane => mean_sq,
            Self::ProbabilisticPlane { position, normal } => {
                (mean_sq - position * position * (1.0 + 3.0 * normal * normal)).max(0.0)
            }
            // in the middle of a triangle, three corners average
            Self::ProbabilisticTriangle { position } => (mean_sq - position * position / 3.0).max(0.0),
        }
    }
}

/// Squared distance from the line along a normal (of any length) through p, times `weight`; the line keeps p where the
/// planes let it slide, and does not count in the weight, so that errors stay distances from planes
/// (Liu, Rahimzadeh and Zordan, Controlling Quadric Error Simplification with Line Quadrics, 2025).
pub(super) fn normal_line(normal: DVec3, p: DVec3, weight: f64) -> Quadric {
    match normal.try_normalize() {
        Some(direction) => Quadric::line(direction, p, weight).scaled(1.0, 0.0),
        None => Quadric::default(),
    }
}

impl Quadric {
    /// Expected squared distance from the plane through `point` with normal `normal`, times `weight`, if the coordinates
    /// of the point have the standard deviation s and those of the normal t. With `d = p - point`:
    ///
    /// `(n . d)^2 + t^2 |d|^2 + s^2 |n|^2 + 3 s^2 t^2` (Trettner and Kobbelt 2020, isotropic case)
    pub fn probabilistic_plane(point: DVec3, normal: DVec3, s: f64, t: f64, weight: f64) -> Self {
        let (s_sq, t_sq) = (s * s, t * t);
        let a = outer(normal) + DMat3::from_diagonal(DVec3::splat(t_sq));
        let c = s_sq * (normal.length_squared() + 3.0 * t_sq);
        Self::centered(a * weight, DVec3::ZERO, c * weight, point, weight)
    }

    /// Expected square of six times the volume between a point and a triangle, which is the squared distance from its
    /// plane times the square of twice its area, if the coordinates of the corners have the standard deviation s. The
    /// weight is the expected square of twice the area (Trettner and Kobbelt 2020, isotropic case).
    ///
    /// With corners relative to their middle, `N = p x q + q x r + r x p`, `D = p x q . r` and
    /// `[v] = |v|^2 I - v v'`, the form is `x' A x - 2 b' x + c` of
    ///
    /// - `A = N N' + s^2 ([p - q] + [q - r] + [r - p]) + 6 s^4 I`
    /// - `b = D N - s^2 ((p - q) x (p x q) + (q - r) x (q x r) + (r - p) x (r x p)) + 2 s^4 (p + q + r)`
    /// - `c = D^2 + s^2 (|p x q|^2 + |q x r|^2 + |r x p|^2) + 2 s^4 (|p|^2 + |q|^2 + |r|^2) + 6 s^6`
    pub fn probabilistic_triangle(corners: [DVec3; 3], s: f64) -> Self {
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let [p, q, r] = corners.map(|corner| corner - middle);
        let [pq, qr, rp] = [p.cross(q), q.cross(r), r.cross(p)];
        let (s_sq, n, d) = (s * s, pq + qr + rp, pq.dot(r));
        let spread = |v: DVec3| DMat3::from_diagonal(DVec3::splat(v.length_squared())) - outer(v);
        let a = outer(n)
            + (spread(p - q) + spread(q - r) + spread(r - p)) * s_sq
            + DMat3::from_diagonal(DVec3::splat(6.0 * s_sq * s_sq));
        // corners relative to their middle add up to nothing
        let b = n * d - ((p - q).cross(pq) + (q - r).cross(qr) + (r - p).cross(rp)) * s_sq;
        let c = d * d
            + s_sq * (pq.length_squared() + qr.length_squared() + rp.length_squared())
            + 2.0 * s_sq * s_sq * (p.length_squared() + q.length_squared() + r.length_squared())
            + 6.0 * s_sq * s_sq * s_sq;
        let weight = a.x_axis.x + a.y_axis.y + a.z_axis.z;
        Self::centered(a, -b, c, middle, weight)
    }
}

/// `v v'`
fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Pairs of independent Gaussian numbers from a fixed sequence (Box and Muller).
    struct Gauss(u64);

    impl Gauss {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
            let mixed = (self.0 ^ self.0 >> 33).wrapping_mul(0xff51_afd7_ed55_8ccd);
            ((mixed ^ mixed >> 33) >> 11) as f64 / (1_u64 << 53) as f64
        }

        fn vector(&mut self, deviation: f64) -> DVec3 {
            DVec3::from([0, 1, 2].map(|_| {
                let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
                deviation * radius * (std::f64::consts::TAU * self.uniform()).cos()
            }))
        }
    }

    fn mean_of(samples: usize, mut sample: impl FnMut() -> f64) -> f64 {
        (0..samples).map(|_| sample()).sum::<f64>() / samples as f64
    }

    const CORNERS: [DVec3; 3] = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(1.1, 0.4, -0.3), DVec3::new(-0.2, 0.9, 0.5)];
    const POINTS: [DVec3; 3] = [DVec3::ZERO, DVec3::new(0.5, 0.5, 0.5), DVec3::new(-1.0, 2.0, 0.7)];

    #[test]
    fn the_expected_distance_from_a_plane_is_the_mean_of_samples() {
        let (point, normal, s, t) = (CORNERS[0], DVec3::new(0.6, 0.0, 0.8), 0.1, 0.2);
        let q = Quadric::probabilistic_plane(point, normal, s, t, 2.0);
        for p in POINTS {
            let mut gauss = Gauss(1);
            let mean = mean_of(200_000, || (normal + gauss.vector(t)).dot(p - point - gauss.vector(s)).powi(2));
            assert!((q.at(p) / (2.0 * mean) - 1.0).abs() < 0.02, "{} for {mean}", q.at(p));
        }
    }

    #[test]
    fn the_expected_volume_over_a_triangle_is_the_mean_of_samples() {
        let q = Quadric::probabilistic_triangle(CORNERS, 0.15);
        for point in POINTS {
            let mut gauss = Gauss(2);
            let mean = mean_of(200_000, || {
                let [a, b, c] = CORNERS.map(|corner| corner + gauss.vector(0.15));
                (b - a).cross(c - a).dot(point - a).powi(2)
            });
            assert!((q.at(point) / mean - 1.0).abs() < 0.03, "{} for {mean}", q.at(point));
        }
        let mut gauss = Gauss(3);
        let mean = mean_of(200_000, || {
            let [a, b, c] = CORNERS.map(|corner| corner + gauss.vector(0.15));
            (b - a).cross(c - a).length_squared()
        });
        assert!((q.weight / mean - 1.0).abs() < 0.02, "{} for {mean}", q.weight);
    }

    #[test]
    fn without_noise_they_are_those_of_planes() {
        let [a, b, c] = CORNERS;
        let scaled = (b - a).cross(c - a);
        let normal = scaled.normalize();
        let plane = Quadric::plane(normal, a, 0.7);
        for sort in [QuadricWeight::Uniform, QuadricWeight::Area, QuadricWeight::AreaSquared, QuadricWeight::Angle] {
            let weight = match sort {
                QuadricWeight::Area => scaled.length() / 2.0,
                QuadricWeight::AreaSquared => scaled.length_squared() / 4.0,
                _ => 0.7,
            };
            for face in [
                FaceQuadric::ProbabilisticPlane { position: 0.0, normal: 0.0 },
                FaceQuadric::ProbabilisticTriangle { position: 0.0 },
            ] {
                let q = face.uncertain(CORNERS, normal, weight, sort);
                assert!((q.weight - weight).abs() < 1e-12);
                for p in POINTS {
                    assert!((q.at(p) / q.weight - plane.at(p) / 0.7).abs() < 1e-12, "{face:?}, {sort:?}");
                }
            }
        }
    }

    #[test]
    fn a_line_counts_the_distance_across_it() {
        let q = normal_line(DVec3::Z * 5.0, DVec3::new(1.0, 2.0, 3.0), 2.0);
        assert!((q.at(DVec3::new(1.0, 2.0, -8.0))).abs() < 1e-12 && q.weight == 0.0);
        assert!((q.at(DVec3::new(4.0, 6.0, 0.0)) - 50.0).abs() < 1e-12);
        assert_eq!(normal_line(DVec3::ZERO, DVec3::ONE, 1.0), Quadric::default());
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0_f64, -1.0..1.0, -1.0..1.0].prop_map(DVec3::from)
    }

    proptest! {
        /// Positive definite: the least value is inside, and more than nothing.
        #[test]
        fn noise_makes_every_triangle_decide_in_all_directions(
            corners in [vector(), vector(), vector()], s in 0.01..0.2_f64, direction in vector(),
        ) {
            prop_assume!(direction.length() > 0.1);
            let direction = direction.normalize();
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(DVec3::X);
            for q in [
                Quadric::probabilistic_triangle(corners, s),
                Quadric::probabilistic_plane(corners[0], normal, s, s, 1.0),
            ] {
                prop_assert!(direction.dot(q.curvature(direction)) > 0.0);
                let least = q.minimize_near(corners[0]).expect("it has a minimum");
                prop_assert!(q.at(least) > 0.0);
                prop_assert!(q.at(least) <= q.at(least + direction * 0.1));
            }
        }

        /// Turned and moved, it is the same.
        #[test]
        fn rigid_motion_moves_the_form(
            corners in [vector(), vector(), vector()], p in vector(), axis in vector(), move_by in vector(), angle in 0.0..3.0_f64,
        ) {
            prop_assume!(axis.length() > 0.1);
            let turn = glam::DQuat::from_axis_angle(axis.normalize(), angle);
            let moved = |p: DVec3| turn * p + move_by;
            let here = Quadric::probabilistic_triangle(corners, 0.1);
            let there = Quadric::probabilistic_triangle(corners.map(moved), 0.1);
            prop_assert!((here.at(p) - there.at(moved(p))).abs() < 1e-10);
            prop_assert!((here.weight - there.weight).abs() < 1e-10);
        }

        /// In units twice as large, volumes are an eighth.
        #[test]
        fn scale_scales_the_form(corners in [vector(), vector(), vector()], p in vector()) {
            let here = Quadric::probabilistic_triangle(corners, 0.1);
            let there = Quadric::probabilistic_triangle(corners.map(|c| c * 0.5), 0.05);
            prop_assert!((here.at(p) / 64.0 - there.at(p * 0.5)).abs() < 1e-12);
        }
    }
}
