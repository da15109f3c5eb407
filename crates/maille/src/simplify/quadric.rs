//! Quadrics: sums of weighted squared distances to planes.

use glam::{DMat3, DVec3};

/// `Q(p) = p' A p + 2 b' p + c`, the weighted sum of squared distances of p from planes, with the sum of the weights
/// (Garland and Heckbert 1997; seed 000, 4.1; seed 001, 2.3).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quadric {
    /// A, symmetric: xx, xy, xz, yy, yz, zz.
    a: [f64; 6],
    b: [f64; 3],
    c: f64,
    /// Sum of the weights of the planes.
    pub weight: f64,
}

/// Share of the mean eigenvalue that pulls an optimum towards the start point: what decides along directions in which
/// the planes decide nothing. See [`Quadric::minimize_near`].
const PULL: f64 = 1e-9;

impl Quadric {
    /// Squared distance to the plane through `point` with unit normal `normal`, times `weight`.
    #[inline]
    pub fn plane(normal: DVec3, point: DVec3, weight: f64) -> Self {
        let d = -normal.dot(point);
        let n = normal * weight;
        Self {
            a: [n.x * normal.x, n.x * normal.y, n.x * normal.z, n.y * normal.y, n.y * normal.z, n.z * normal.z],
            b: [n.x * d, n.y * d, n.z * d],
            c: weight * d * d,
            weight,
        }
    }

    /// Adds `(p - origin)' M (p - origin)`; M as xx, xy, xz, yy, yz, zz.
    #[inline]
    pub(super) fn add_form(&mut self, m: [f64; 6], origin: DVec3) {
        let [xx, xy, xz, yy, yz, zz] = m;
        let b = DVec3::new(
            xx * origin.x + xy * origin.y + xz * origin.z,
            xy * origin.x + yy * origin.y + yz * origin.z,
            xz * origin.x + yz * origin.y + zz * origin.z,
        );
        self.a.iter_mut().zip(m).for_each(|(sum, x)| *sum += x);
        self.b.iter_mut().zip(b.to_array()).for_each(|(sum, x)| *sum -= x);
        self.c += origin.dot(b);
    }

    /// Adds `2 (slope . p + offset)`.
    #[inline]
    pub(super) fn add_linear(&mut self, slope: DVec3, offset: f64) {
        self.b.iter_mut().zip(slope.to_array()).for_each(|(sum, x)| *sum += x);
        self.c += 2.0 * offset;
    }

    /// Adds `factor (slope . p + offset)^2`.
    #[inline]
    pub(super) fn add_square(&mut self, slope: DVec3, offset: f64, factor: f64) {
        let n = slope * factor;
        let a = [n.x * slope.x, n.x * slope.y, n.x * slope.z, n.y * slope.y, n.y * slope.z, n.z * slope.z];
        self.a.iter_mut().zip(a).for_each(|(sum, x)| *sum += x);
        self.b.iter_mut().zip(n.to_array()).for_each(|(sum, x)| *sum += x * offset);
        self.c += factor * offset * offset;
    }

    /// Squared distance to the line through `point` with unit direction `direction`, times `weight`.
    #[inline]
    pub fn line(direction: DVec3, point: DVec3, weight: f64) -> Self {
        let across = DMat3::IDENTITY
            - DMat3::from_cols(direction * direction.x, direction * direction.y, direction * direction.z);
        Self::centered(across * weight, DVec3::ZERO, 0.0, point, weight)
    }

    /// `(p - center)' A (p - center) + 2 b' (p - center) + c` with a symmetric A.
    #[inline]
    pub(super) fn centered(a: DMat3, b: DVec3, c: f64, center: DVec3, weight: f64) -> Self {
        let pulled = a * center;
        let [x, y, z] = [a.x_axis, a.y_axis, a.z_axis];
        Self {
            a: [x.x, x.y, x.z, y.y, y.z, z.z],
            b: (b - pulled).to_array(),
            c: c - 2.0 * b.dot(center) + pulled.dot(center),
            weight,
        }
    }

    /// `A d`: how half the gradient changes along d.
    #[inline]
    pub(super) fn curvature(&self, d: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        DVec3::new(xx * d.x + xy * d.y + xz * d.z, xy * d.x + yy * d.y + yz * d.z, xz * d.x + yz * d.y + zz * d.z)
    }

    /// The same form times a factor, with another weight.
    #[inline]
    pub(super) fn scaled(self, factor: f64, weight: f64) -> Self {
        Self { a: self.a.map(|x| x * factor), b: self.b.map(|x| x * factor), c: self.c * factor, weight }
    }

    /// Sum of the eigenvalues of A.
    #[inline]
    pub(super) fn trace(&self) -> f64 {
        self.a[0] + self.a[3] + self.a[5]
    }

    /// `A p + b`, half the gradient at p.
    #[inline]
    pub(super) fn half_gradient(&self, p: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        DVec3::new(
            xx * p.x + xy * p.y + xz * p.z + self.b[0],
            xy * p.x + yy * p.y + yz * p.z + self.b[1],
            xz * p.x + yz * p.y + zz * p.z + self.b[2],
        )
    }

    /// Q(p); rounding may leave it slightly below zero.
    #[inline]
    pub fn at(&self, p: DVec3) -> f64 {
        p.dot(self.half_gradient(p)) + DVec3::from(self.b).dot(p) + self.c
    }

    /// The point of least Q, as near to `start` as the planes leave open.
    ///
    /// Solves `(A + e I)(p - start) = -(A start + b)` with a tiny e: with three independent directions that is the
    /// minimum, and where A is singular (all planes parallel, or all through one line) the least-squares solution
    /// nearest to `start`. `None` when there are no planes.
    #[inline]
    pub fn minimize_near(&self, start: DVec3) -> Option<DVec3> {
        let factors = self.factors()?;
        Some(start - factors.solve(self.half_gradient(start)))
    }

    /// As [`minimize_near`](Self::minimize_near), among the points on one plane `flux . p = level`.
    #[inline]
    pub fn minimize_on_plane(&self, start: DVec3, flux: DVec3, level: f64) -> Option<DVec3> {
        let factors = self.factors()?;
        let free = start - factors.solve(self.half_gradient(start));
        let across = factors.solve(flux);
        let slope = flux.dot(across);
        // a bent star whose normals cancel has no side to be kept on
        if slope <= 1e-6 * flux.length() {
            return Some(free);
        }
        Some(free + across * ((level - flux.dot(free)) / slope))
    }

    fn factors(&self) -> Option<Factors> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let trace = xx + yy + zz;
        if trace <= 0.0 || !trace.is_finite() {
            return None;
        }
        let pull = trace * PULL;
        let d0 = xx + pull;
        let (r10, r20) = (xy / d0, xz / d0);
        let d1 = yy + pull - r10 * xy;
        let l21 = yz - r20 * xy;
        let r21 = l21 / d1;
        let d2 = zz + pull - r20 * xz - r21 * l21;
        Some(Factors { inverse: [1.0 / d0, 1.0 / d1, 1.0 / d2], r10, r20, r21 })
    }

    /// The point of least Q on the segment from `a` to `b`.
    pub fn minimize_on_segment(&self, a: DVec3, b: DVec3) -> DVec3 {
        let along = b - a;
        let slope = along.dot(self.half_gradient(a));
        let curvature = along.dot(self.half_gradient(b)) - slope;
        let t = if curvature > 0.0 { (-slope / curvature).clamp(0.0, 1.0) } else { 0.5 };
        a + along * t
    }
}

/// `L D L'` of a symmetric positive definite matrix; no pivoting needed.
struct Factors {
    /// One over the diagonal of D.
    inverse: [f64; 3],
    r10: f64,
    r20: f64,
    r21: f64,
}

impl Factors {
    #[inline]
    fn solve(&self, g: DVec3) -> DVec3 {
        let y0 = g.x;
        let y1 = g.y - self.r10 * y0;
        let y2 = g.z - self.r20 * y0 - self.r21 * y1;
        let z = y2 * self.inverse[2];
        let y = y1 * self.inverse[1] - self.r21 * z;
        let x = y0 * self.inverse[0] - self.r10 * y - self.r20 * z;
        DVec3::new(x, y, z)
    }
}

impl std::ops::Add for Quadric {
    type Output = Self;
    #[inline]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl std::ops::AddAssign for Quadric {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        for (x, y) in self.a.iter_mut().zip(other.a) {
            *x += y;
        }
        for (x, y) in self.b.iter_mut().zip(other.b) {
            *x += y;
        }
        self.c += other.c;
        self.weight += other.weight;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: DVec3, b: DVec3, tolerance: f64) -> bool {
        (a - b).length() < tolerance
    }

    #[test]
    fn three_planes_meet_in_the_minimum() {
        let corner = DVec3::new(0.3, -0.2, 0.7);
        let normals = [DVec3::X, DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.0, 0.6, 0.8)];
        let q = normals.iter().fold(Quadric::default(), |q, &n| q + Quadric::plane(n, corner, 0.5));
        let p = q.minimize_near(corner + DVec3::splat(0.01)).unwrap();
        assert!(close(p, corner, 1e-5), "{p}");
        assert!(q.at(p).abs() < 1e-12 && (q.weight - 1.5).abs() < 1e-15);
    }

    #[test]
    fn a_distance_is_weighted_and_squared() {
        let q = Quadric::plane(DVec3::Z, DVec3::new(5.0, 6.0, 1.0), 3.0);
        assert!((q.at(DVec3::new(-2.0, 9.0, 1.5)) - 3.0 * 0.25).abs() < 1e-12);
    }

    #[test]
    fn singular_quadrics_stay_near_the_start() {
        let one_plane = Quadric::plane(DVec3::Z, DVec3::ZERO, 2.0);
        assert!(close(one_plane.minimize_near(DVec3::new(0.2, 0.3, 0.1)).unwrap(), DVec3::new(0.2, 0.3, 0.0), 1e-5));
        let crease = one_plane + Quadric::plane(DVec3::X, DVec3::ZERO, 1.0);
        assert!(close(crease.minimize_near(DVec3::new(0.2, 0.3, 0.1)).unwrap(), DVec3::new(0.0, 0.3, 0.0), 1e-5));
        assert_eq!(Quadric::default().minimize_near(DVec3::ONE), None);
    }

    #[test]
    fn the_best_point_of_a_segment_is_inside_it() {
        let q = Quadric::plane(DVec3::X, DVec3::new(0.25, 0.0, 0.0), 1.0);
        assert!(close(q.minimize_on_segment(DVec3::ZERO, DVec3::X), DVec3::X * 0.25, 1e-12));
        assert!(close(q.minimize_on_segment(DVec3::X * 2.0, DVec3::X), DVec3::X, 1e-12));
        assert!(close(q.minimize_on_segment(DVec3::Y, DVec3::Z), (DVec3::Y + DVec3::Z) / 2.0, 1e-12));
    }
}
