//! Quadrics in single precision, each relative to the vertex that keeps it: half the memory, and four edges at a time.
//!
//! Around the origin of a whole model, single precision tells distances of a few ten-thousandths of its size apart, no
//! less. Around the vertex itself it tells apart what is that small beside the edges there, at every level.

use std::ops::{Add, Mul, Sub};

use glam::{DMat3, DVec3};
use wide::f32x4;

use super::options::PlacementKind;
use super::quadric::Quadric;

/// `Q(v + p) = p' A p + 2 b' p + c` around the place of a vertex v, with the sum of the weights.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LocalQuadric {
    /// xx, yy and zz of A, and the weight.
    diagonal: f32x4,
    /// xy, xz and yz of A, and c.
    rest: f32x4,
    /// b.
    slope: f32x4,
}

/// Planes through the vertex itself: those of the faces around it, as b and c are zero then.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LocalPlanes {
    diagonal: f32x4,
    rest: f32x4,
}

/// Share of the mean eigenvalue that pulls an optimum towards the middle of the edge. Well above the rounding of what is
/// summed, as that would decide otherwise where a surface is flat.
const PULL: f32 = 3e-6;

/// Makes short edges go first among equals, as a squared distance relative to the edge's.
const SHORTNESS: f32 = 1e-7;

/// A squared distance relative to the edge's that cannot be told from none: an end that is that good is kept.
const FLAT: f32 = 1e-8;

/// How far, in edge lengths from the middle, an optimum may lie before it counts as badly conditioned.
const REACH: f32 = 2.0;

/// One number, or one for each of four edges.
pub(super) trait Lane:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + std::ops::Div<Output = Self>
{
    /// The same number everywhere.
    fn splat(x: f32) -> Self;
}

impl Lane for f32 {
    #[inline]
    fn splat(x: f32) -> Self {
        x
    }
}

impl Lane for f32x4 {
    #[inline]
    fn splat(x: f32) -> Self {
        Self::splat(x)
    }
}

/// A vector by its axes. (`map` on arrays is not always made into straight code.)
#[inline(always)]
pub(super) fn axes<T>(at: impl Fn(usize) -> T) -> [T; 3] {
    [at(0), at(1), at(2)]
}

/// A vector times a factor.
#[inline(always)]
pub(super) fn scaled<T: Lane>(a: [T; 3], factor: T) -> [T; 3] {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

/// Scalar product.
#[inline(always)]
pub(super) fn dot<T: Lane>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[inline(always)]
pub(super) fn cross<T: Lane>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Difference.
#[inline(always)]
pub(super) fn minus<T: Lane>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// A quadric around the middle of an edge, whose ends are at `-half` and `half`.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeQuadric<T> {
    /// xx, yy, zz, xy, xz, yz.
    a: [T; 6],
    b: [T; 3],
    c: T,
    /// Sum of the weights.
    pub weight: T,
}

/// `L D L'` of A with the pull on its diagonal.
#[derive(Debug, Clone, Copy)]
struct Factors<T> {
    inverse: [T; 3],
    r10: T,
    r20: T,
    r21: T,
    pull: T,
}

impl<T: Lane> Factors<T> {
    #[inline(always)]
    fn solve(&self, g: [T; 3]) -> [T; 3] {
        let y1 = g[1] - self.r10 * g[0];
        let y2 = g[2] - self.r20 * g[0] - self.r21 * y1;
        let z = y2 * self.inverse[2];
        let y = y1 * self.inverse[1] - self.r21 * z;
        [g[0] * self.inverse[0] - self.r10 * y - self.r20 * z, y, z]
    }
}

impl<T: Lane> EdgeQuadric<T> {
    /// From the sums and differences of what two ends keep, in the order of [`LocalQuadric`].
    #[inline(always)]
    fn new(sum: [[T; 4]; 3], difference: [[T; 4]; 3], half: [T; 3]) -> Self {
        let two = T::splat(2.0);
        let [[xx, yy, zz, weight], [xy, xz, yz, c], [bx, by, bz, _]] = sum;
        let [[dxx, dyy, dzz, _], [dxy, dxz, dyz, _], [dbx, dby, dbz, _]] = difference;
        let a = [xx, yy, zz, xy, xz, yz];
        let moved = product([dxx, dyy, dzz, dxy, dxz, dyz], half);
        let c = c + two * dot([dbx, dby, dbz], half) + dot(product(a, half), half);
        Self { a, b: [bx + moved[0], by + moved[1], bz + moved[2]], c, weight }
    }

    /// The same of planes through the ends.
    #[inline(always)]
    fn of_planes(sum: [[T; 4]; 2], difference: [[T; 4]; 2], half: [T; 3]) -> Self {
        let [[xx, yy, zz, weight], [xy, xz, yz, _]] = sum;
        let [[dxx, dyy, dzz, _], [dxy, dxz, dyz, _]] = difference;
        let a = [xx, yy, zz, xy, xz, yz];
        let b = product([dxx, dyy, dzz, dxy, dxz, dyz], half);
        Self { a, b, c: dot(product(a, half), half), weight }
    }

    /// The value at a place.
    #[inline(always)]
    pub(super) fn at(&self, p: [T; 3]) -> T {
        let ap = product(self.a, p);
        let b = self.b;
        dot(p, [ap[0] + b[0] + b[0], ap[1] + b[1] + b[1], ap[2] + b[2] + b[2]]) + self.c
    }

    #[inline(always)]
    fn factors(&self) -> Factors<T> {
        let [xx, yy, zz, xy, xz, yz] = self.a;
        // never zero, so that nothing is divided by it
        let pull = (xx + yy + zz) * T::splat(PULL) + T::splat(f32::MIN_POSITIVE);
        let one = T::splat(1.0);
        let i0 = one / (xx + pull);
        let (r10, r20) = (xy * i0, xz * i0);
        let i1 = one / (yy + pull - r10 * xy);
        let l21 = yz - r20 * xy;
        let r21 = l21 * i1;
        let i2 = one / (zz + pull - r20 * xz - r21 * l21);
        Factors { inverse: [i0, i1, i2], r10, r20, r21, pull }
    }

    /// The value at a place as a mean over the planes.
    #[inline(always)]
    pub(super) fn mean(&self, value: T) -> T {
        value / (self.weight + T::splat(f32::MIN_POSITIVE))
    }

    /// The place of the least value, and that value.
    #[inline(always)]
    fn optimum(&self) -> ([T; 3], T) {
        let factors = self.factors();
        let [x, y, z] = factors.solve(self.b);
        let zero = T::splat(0.0);
        let p = [zero - x, zero - y, zero - z];
        (p, self.c + dot(self.b, p) - factors.pull * dot(p, p))
    }
}

/// `A p`.
#[inline(always)]
fn product<T: Lane>([xx, yy, zz, xy, xz, yz]: [T; 6], p: [T; 3]) -> [T; 3] {
    [xx * p[0] + xy * p[1] + xz * p[2], xy * p[0] + yy * p[1] + yz * p[2], xz * p[0] + yz * p[1] + zz * p[2]]
}

/// Where a merged vertex goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// From the middle of the edge.
    pub offset: [f32; 3],
    /// The value of the quadric there, not below zero.
    pub value: f32,
    /// The end that this is, if it is one.
    pub end: Option<usize>,
}

/// A cost per weight that makes short edges go first among equals.
#[inline(always)]
pub(super) fn shortness<T: Lane>(half: [T; 3]) -> T {
    dot(half, half) * T::splat(4.0 * SHORTNESS)
}

impl EdgeQuadric<f32x4> {
    /// The places of the least values, those values, and as bits which of the places are near their edges.
    #[inline(always)]
    pub(super) fn optima(&self, half: [f32x4; 3]) -> ([f32x4; 3], f32x4, u32) {
        let (place, value) = self.optimum();
        let most = dot(half, half) * f32x4::splat(4.0 * REACH * REACH);
        (place, value, dot(place, place).simd_le(most).to_bitmask())
    }
}

impl EdgeQuadric<f32> {
    /// The best placement of a kind.
    pub(super) fn place(&self, half: [f32; 3], kind: PlacementKind) -> Place {
        let at = |offset: [f32; 3], end| Place { offset, value: self.at(offset).max(0.0), end };
        let other = scaled(half, -1.0);
        let better_end = || {
            let [a, b] = [at(other, Some(0)), at(half, Some(1))];
            if b.value < a.value { b } else { a }
        };
        match kind {
            PlacementKind::Subset => return better_end(),
            PlacementKind::Midpoint => return at([0.0; 3], None),
            PlacementKind::Optimal | PlacementKind::OptimalVolume => {}
        }
        let length_sq = 4.0 * dot(half, half);
        let flat = FLAT * length_sq * self.weight;
        let (offset, value) = self.optimum();
        let is_near = dot(offset, offset) <= REACH * REACH * length_sq;
        if is_near && value > flat {
            return Place { offset, value, end: None };
        }
        let end = better_end();
        if end.value <= flat {
            return end;
        }
        if is_near {
            return Place { offset, value: value.max(0.0), end: None };
        }
        // the least on the edge
        let slope = dot(self.b, half);
        let curvature = dot(product(self.a, half), half);
        let t = if curvature > 0.0 { (-slope / curvature).clamp(-1.0, 1.0) } else { 0.0 };
        let inside = at(scaled(half, t), None);
        if end.value < inside.value { end } else { inside }
    }

    /// The placement nearest in value to `place` among those on the plane `flux . p = level`, if it costs at most
    /// `price` times as much.
    pub(super) fn on_plane(
        &self,
        half: [f32; 3],
        place: &Place,
        flux: [f32; 3],
        level: f32,
        price: f32,
    ) -> Option<Place> {
        let across = self.factors().solve(flux);
        let slope = dot(flux, across);
        let length_sq = 4.0 * dot(half, half);
        // a bent star whose normals cancel has no side to be kept on
        if slope.is_nan() || slope <= 1e-6 * dot(flux, flux).sqrt() {
            return None;
        }
        let step = (level - dot(flux, place.offset)) / slope;
        let offset = axes(|k| place.offset[k] + step * across[k]);
        let value = self.at(offset).max(0.0);
        let is_near = dot(offset, offset) <= REACH * REACH * length_sq;
        let fair = is_near && value <= price * place.value + FLAT * length_sq * self.weight;
        fair.then_some(Place { offset, value, end: None })
    }
}

/// What is kept at one end of four edges.
#[inline(always)]
fn four<'a, T>(all: &'a [T], ends: &[[u32; 2]; 4], end: usize) -> [&'a T; 4] {
    let at = |i: usize| &all[ends[i][end] as usize];
    [at(0), at(1), at(2), at(3)]
}

#[inline(always)]
fn four_of<T>(four: &[&T; 4], part: impl Fn(&T) -> f32x4) -> [f32x4; 4] {
    [part(four[0]), part(four[1]), part(four[2]), part(four[3])]
}

/// Sums and differences, each number of all four together.
#[inline(always)]
fn sum_and_difference(u: [f32x4; 4], v: [f32x4; 4]) -> [[f32x4; 4]; 2] {
    [
        f32x4::transpose([u[0] + v[0], u[1] + v[1], u[2] + v[2], u[3] + v[3]]),
        f32x4::transpose([u[0] - v[0], u[1] - v[1], u[2] - v[2], u[3] - v[3]]),
    ]
}

impl LocalPlanes {
    /// The plane of a face with that scaled normal, by a weight.
    #[inline(always)]
    pub(super) fn of_face([x, y, z]: [f32; 3], weight: f32, length_sq: f32) -> Self {
        let factor = weight / length_sq;
        let n = [x * factor, y * factor, z * factor];
        Self {
            diagonal: f32x4::new([n[0] * x, n[1] * y, n[2] * z, weight]),
            rest: f32x4::new([n[0] * y, n[0] * z, n[1] * z, 0.0]),
        }
    }

    /// The quadrics of an edge from the planes at its ends.
    #[inline(always)]
    pub(super) fn of_edge(u: &Self, v: &Self, half: [f32; 3]) -> EdgeQuadric<f32> {
        let rows = |a: f32x4, b: f32x4| [a.to_array(), b.to_array()];
        let sum = rows(u.diagonal + v.diagonal, u.rest + v.rest);
        EdgeQuadric::of_planes(sum, rows(u.diagonal - v.diagonal, u.rest - v.rest), half)
    }

    /// The same for four edges.
    #[inline(always)]
    pub(super) fn of_edges(all: &[Self], ends: &[[u32; 2]; 4], half: [f32x4; 3]) -> EdgeQuadric<f32x4> {
        let (u, v) = (four(all, ends, 0), four(all, ends, 1));
        let diagonal = sum_and_difference(four_of(&u, |q| q.diagonal), four_of(&v, |q| q.diagonal));
        let rest = sum_and_difference(four_of(&u, |q| q.rest), four_of(&v, |q| q.rest));
        EdgeQuadric::of_planes([diagonal[0], rest[0]], [diagonal[1], rest[1]], half)
    }
}

impl std::ops::AddAssign for LocalPlanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.diagonal += other.diagonal;
        self.rest += other.rest;
    }
}

impl Sub for LocalPlanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { diagonal: self.diagonal - other.diagonal, rest: self.rest - other.rest }
    }
}

impl From<LocalPlanes> for LocalQuadric {
    fn from(planes: LocalPlanes) -> Self {
        Self { diagonal: planes.diagonal, rest: planes.rest, slope: f32x4::splat(0.0) }
    }
}

impl LocalQuadric {
    /// The same around the origin, for a vertex at p.
    pub(super) fn around(&self, p: DVec3) -> Quadric {
        let [xx, yy, zz, weight] = self.diagonal.to_array().map(f64::from);
        let [xy, xz, yz, c] = self.rest.to_array().map(f64::from);
        let [x, y, z, _] = self.slope.to_array().map(f64::from);
        let a = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        Quadric::centered(a, DVec3::new(x, y, z), c, p, weight)
    }

    /// The quadrics of an edge from those of its ends.
    #[inline(always)]
    pub(super) fn of_edge(u: &Self, v: &Self, half: [f32; 3]) -> EdgeQuadric<f32> {
        let rows = |a: f32x4, b: f32x4, c: f32x4| [a.to_array(), b.to_array(), c.to_array()];
        let sum = rows(u.diagonal + v.diagonal, u.rest + v.rest, u.slope + v.slope);
        EdgeQuadric::new(sum, rows(u.diagonal - v.diagonal, u.rest - v.rest, u.slope - v.slope), half)
    }

    /// The same for four edges.
    #[inline(always)]
    pub(super) fn of_edges(all: &[Self], ends: &[[u32; 2]; 4], half: [f32x4; 3]) -> EdgeQuadric<f32x4> {
        let (u, v) = (four(all, ends, 0), four(all, ends, 1));
        let diagonal = sum_and_difference(four_of(&u, |q| q.diagonal), four_of(&v, |q| q.diagonal));
        let rest = sum_and_difference(four_of(&u, |q| q.rest), four_of(&v, |q| q.rest));
        let slope = sum_and_difference(four_of(&u, |q| q.slope), four_of(&v, |q| q.slope));
        EdgeQuadric::new([diagonal[0], rest[0], slope[0]], [diagonal[1], rest[1], slope[1]], half)
    }

    /// The sum at both ends of an edge, around a place given from the middle.
    #[inline]
    pub(super) fn merged(edge: &EdgeQuadric<f32>, [x, y, z]: [f32; 3]) -> Self {
        let [xx, yy, zz, xy, xz, yz] = edge.a;
        let moved = product(edge.a, [x, y, z]);
        Self {
            diagonal: f32x4::new([xx, yy, zz, edge.weight]),
            rest: f32x4::new([xy, xz, yz, edge.at([x, y, z]).max(0.0)]),
            slope: f32x4::new([edge.b[0] + moved[0], edge.b[1] + moved[1], edge.b[2] + moved[2], 0.0]),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn vector(range: f32) -> impl Strategy<Value = [f32; 3]> {
        prop::array::uniform3(-range..range)
    }

    /// Planes through a point, in single precision around it and in double precision around the origin.
    fn planes(normals: &[[f32; 3]], point: DVec3) -> (LocalPlanes, Quadric) {
        let (mut local, mut wide) = (LocalPlanes::default(), Quadric::default());
        for &n in normals {
            let length_sq = dot(n, n);
            let weight = length_sq.sqrt() / 2.0;
            local += LocalPlanes::of_face(n, weight, length_sq);
            wide += Quadric::plane(DVec3::from(n.map(f64::from)).normalize(), point, f64::from(weight));
        }
        (local, wide)
    }

    fn normals() -> impl Strategy<Value = Vec<[f32; 3]>> {
        let normal = vector(1.0).prop_filter("no direction", |&n| dot(n, n) > 1e-3);
        prop::collection::vec(normal, 3..8)
    }

    proptest! {
        #[test]
        fn double_precision_says_the_same(
            u in normals(), v in normals(), center in vector(100.0), half in vector(0.5), off in vector(1.0), next in vector(0.5),
        ) {
            prop_assume!(dot(half, half) > 1e-3);
            let double = |v: [f32; 3]| DVec3::from(v.map(f64::from));
            let [center, wide_half, wide_off] = [center, half, off].map(double);
            let (local_u, wide_u) = planes(&u, center - wide_half);
            let (local_v, wide_v) = planes(&v, center + wide_half);
            let (local, wide) = (LocalPlanes::of_edge(&local_u, &local_v, half), wide_u + wide_v);
            let close = |a: f32, b: f64| (f64::from(a) - b).abs() <= 1e-4 * (b.abs() + wide.weight);
            prop_assert!(close(local.at(off), wide.at(center + wide_off)));
            prop_assert!(close(local.mean(local.at(off)) * local.weight, wide.at(center + wide_off)));
            // merged somewhere, and merged again
            let merged = LocalQuadric::merged(&local, off);
            let there = center + wide_off;
            prop_assert!((merged.around(there).at(center) - wide.at(center)).abs() <= 1e-3 * (1.0 + wide.at(center)));
            let pair = LocalQuadric::of_edge(&merged, &LocalQuadric::from(local_v), next);
            let middle = there + double(next);
            let (local_w, wide_w) = planes(&v, middle + double(next));
            prop_assert!((f64::from(pair.at(off)) - (wide + wide_w).at(middle + wide_off)).abs() <= 1e-3 * (1.0 + wide.weight) * 10.0);
            prop_assert_eq!(local_w.diagonal.to_array(), local_v.diagonal.to_array());
            // no place nearby is better than the best
            let place = local.place(half, PlacementKind::Optimal);
            let noise = 1e-4 * local.weight;
            prop_assert!(place.end.is_some() || place.value <= local.at([0.0; 3]) + noise);
            prop_assert!(place.value <= local.at(half) + noise && place.value <= local.at(scaled(half, -1.0)) + noise);
        }

        #[test]
        fn four_lanes_are_four_times_one(
            ends in prop::collection::vec((normals(), normals(), vector(0.5), vector(0.5)), 4),
        ) {
            let mut all = Vec::new();
            let mut halves = [[0.0; 4]; 3];
            for (i, (u, v, half, off)) in ends.iter().enumerate() {
                let pair = |n: &[[f32; 3]]| planes(n, DVec3::ZERO).0;
                let merged = LocalQuadric::merged(&LocalPlanes::of_edge(&pair(u), &pair(v), *half), *off);
                all.extend([merged, LocalQuadric::from(pair(v))]);
                (0..3).for_each(|k| halves[k][i] = half[k]);
            }
            let half = axes(|k| f32x4::new(halves[k]));
            let four = LocalQuadric::of_edges(&all, &[[0, 1], [2, 3], [4, 5], [6, 7]], half);
            let (place, value, is_near) = four.optima(half);
            for i in 0..4 {
                let half = axes(|k| halves[k][i]);
                let one = LocalQuadric::of_edge(&all[2 * i], &all[2 * i + 1], half);
                let (expected, least) = one.optimum();
                prop_assert_eq!(axes(|k| place[k].to_array()[i]), expected);
                prop_assert_eq!(value.to_array()[i], least);
                let near = dot(expected, expected) <= 4.0 * REACH * REACH * dot(half, half);
                prop_assert_eq!(is_near >> i & 1 == 1, near);
            }
        }
    }
}
