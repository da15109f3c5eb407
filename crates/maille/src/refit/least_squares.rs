//! The sparse least-squares problem of one round, solved by conjugate gradients.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// What staying counts, of what the samples of a vertex count: for vertices with few samples.
const STAY: f32 = 1e-4;

/// Most steps of the conjugate gradients, and the share of the residual at which they end. The matrix is about as well
/// conditioned as a mass matrix with its blocks on the diagonal for preconditioner: ten steps do.
const STEPS: usize = 12;
const ENOUGH: f64 = 1e-3;

/// A sample: the point `weights` of its triangle should move by `wanted`, above all along `normal`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub(super) weights: [f64; 3],
    pub(super) normal: DVec3,
    pub(super) wanted: DVec3,
    /// What it counts.
    pub(super) weight: f64,
    /// What a distance along the surface counts, of one along the normal.
    pub(super) along: f64,
}

/// A symmetric matrix: xx, yy, zz, xy, xz, yz. There are many, and they steer the steps, not where these end.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Symmetric([f32; 6]);

impl Symmetric {
    #[inline]
    fn add(&mut self, Self(other): &Self, factor: f32) {
        for (sum, x) in self.0.iter_mut().zip(other) {
            *sum += x * factor;
        }
    }

    #[inline]
    fn times(&self, v: DVec3) -> DVec3 {
        let [xx, yy, zz, xy, xz, yz] = self.0.map(f64::from);
        DVec3::new(xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z)
    }

    fn inverse(&self) -> Self {
        let [xx, yy, zz, xy, xz, yz] = self.0.map(f64::from);
        let m = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]).inverse();
        Self([m.x_axis.x, m.y_axis.y, m.z_axis.z, m.y_axis.x, m.z_axis.x, m.z_axis.y].map(|x| x as f32))
    }
}

/// What all samples of a triangle come to: blocks of the matrix for its corners 0, 1 and 2 and the pairs 01, 12 and 20, and
/// what they want of each corner.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct OnTriangle {
    corners: [Symmetric; 3],
    sides: [Symmetric; 3],
    wanted: [DVec3; 3],
}

impl OnTriangle {
    #[inline]
    pub(super) fn add(&mut self, row: &Row) {
        let n = row.normal;
        let [along, across] = [row.weight * row.along, row.weight * (1.0 - row.along)];
        let m = n * across;
        let counts = [m.x * n.x + along, m.y * n.y + along, m.z * n.z + along, m.x * n.y, m.x * n.z, m.y * n.z];
        let counts = Symmetric(counts.map(|x| x as f32));
        let wanted = m * n.dot(row.wanted) + row.wanted * along;
        for k in 0..3 {
            let (this, next) = (row.weights[k], row.weights[(k + 1) % 3]);
            self.corners[k].add(&counts, (this * this) as f32);
            self.sides[k].add(&counts, (this * next) as f32);
            self.wanted[k] += wanted * this;
        }
    }
}

/// The equations of all vertices: as many blocks as there are edges, whatever the number of samples.
pub(super) struct Fit {
    /// Those of [`CHUNK`] vertices each, the last of fewer.
    chunks: Vec<Equations>,
}

/// The equations of some vertices.
#[derive(Default)]
struct Equations {
    /// Of each vertex the end of its blocks.
    ends: Vec<u32>,
    /// The blocks beside the diagonal, and the vertices that they belong to.
    blocks: Vec<(u32, Symmetric)>,
    diagonal: Vec<Symmetric>,
    /// What undoes the blocks of the diagonal; zero for vertices that stay.
    inverse: Vec<Symmetric>,
    wanted: Vec<DVec3>,
}

/// Vertices in a piece of work.
const CHUNK: usize = 1 << 11;

impl Equations {
    /// Adds a vertex, from its corners of triangles.
    fn add<'a>(
        &mut self,
        corners: &[u32],
        triangles: &[[u32; 3]],
        on_triangle: impl Fn(usize) -> &'a OnTriangle,
        is_fixed: bool,
    ) {
        let (mut diagonal, mut wanted, start) = (Symmetric::default(), DVec3::ZERO, self.blocks.len());
        for &corner in corners {
            let (t, k) = (corner as usize / 3, corner as usize % 3);
            let on = on_triangle(t);
            diagonal.add(&on.corners[k], 1.0);
            wanted += on.wanted[k];
            for (other, side) in [((k + 1) % 3, k), ((k + 2) % 3, (k + 2) % 3)] {
                let neighbor = triangles[t][other];
                match self.blocks[start..].iter_mut().find(|(known, _)| *known == neighbor) {
                    Some((_, block)) => block.add(&on.sides[side], 1.0),
                    None => self.blocks.push((neighbor, on.sides[side])),
                }
            }
        }
        // the blocks of a row sum up to what all of its samples count, by what they count for the vertex
        let mut sum = diagonal;
        self.blocks[start..].iter().for_each(|(_, block)| sum.add(block, 1.0));
        let weight = sum.0[0] + sum.0[1] + sum.0[2];
        diagonal.0[..3].iter_mut().for_each(|x| *x += STAY * weight);
        let moves = !is_fixed && weight > 0.0;
        self.inverse.push(if moves { diagonal.inverse() } else { Symmetric::default() });
        self.wanted.push(if moves { wanted } else { DVec3::ZERO });
        self.diagonal.push(diagonal);
        self.ends.push(self.blocks.len() as u32);
    }

    /// What the vertices from `first` on come to, for vectors at all vertices.
    fn times<'a>(&'a self, first: usize, x: &'a [DVec3]) -> impl Iterator<Item = DVec3> + 'a {
        let mut start = 0;
        self.ends.iter().enumerate().map(move |(i, &end)| {
            let blocks = &self.blocks[std::mem::replace(&mut start, end as usize)..end as usize];
            if self.inverse[i] == Symmetric::default() {
                return DVec3::ZERO;
            }
            let others = blocks.iter().map(|(other, block)| block.times(x[*other as usize]));
            self.diagonal[i].times(x[first + i]) + others.sum::<DVec3>()
        })
    }
}

impl Fit {
    /// The equations of triangles, but for vertices that are fixed. `on` names the triangle of each sample, `rows` adds what
    /// belongs to a triangle, given the numbers of its samples.
    pub(super) fn new(
        triangles: &[[u32; 3]],
        on: impl Iterator<Item = u32> + Clone,
        rows: impl Fn(u32, &[u32], &mut OnTriangle) + Sync,
        fixed: &[bool],
    ) -> Self {
        let by_triangle = grouped(triangles.len(), on);
        let on_triangle = |t: usize| {
            let mut sum = OnTriangle::default();
            rows(t as u32, by_triangle.of(t), &mut sum);
            sum
        };
        // corners as three times the triangle, plus the number of the corner
        let by_vertex = grouped(fixed.len(), triangles.iter().flatten().copied());
        // what is on a triangle is added up for each chunk that has one of its corners: most are in one chunk only, where
        // vertices are in an order that keeps neighbours together, and kept for all it would be the largest part of memory
        let chunk = |ranks: &mut Vec<u32>, start: usize| {
            let mut equations = Equations::default();
            let (mut known, mut sums) = (Vec::new(), Vec::new());
            for (v, &is_fixed) in fixed.iter().enumerate().skip(start).take(CHUNK) {
                let corners = by_vertex.of(v);
                for t in corners.iter().map(|corner| corner / 3) {
                    if known.get(ranks[t as usize] as usize) != Some(&t) {
                        ranks[t as usize] = known.len() as u32;
                        known.push(t);
                        sums.push(on_triangle(t as usize));
                    }
                }
                equations.add(corners, triangles, |t| &sums[ranks[t] as usize], is_fixed);
            }
            equations
        };
        let chunks = (0..fixed.len()).into_par_iter().step_by(CHUNK);
        Self { chunks: chunks.map_init(|| vec![0; triangles.len()], chunk).collect() }
    }

    fn times_matrix(&self, x: &[DVec3]) -> Vec<DVec3> {
        let chunks = self.chunks.par_iter().enumerate();
        chunks.flat_map_iter(|(i, equations)| equations.times(i * CHUNK, x)).collect()
    }

    /// The moves of all vertices.
    pub(super) fn solve(&self) -> Vec<DVec3> {
        let wanted = self.chunks.iter().flat_map(|equations| &equations.wanted).copied().collect();
        let precondition = |r: &[DVec3]| -> Vec<DVec3> {
            let inverse = self.chunks.iter().flat_map(|equations| &equations.inverse);
            r.iter().zip(inverse).map(|(&r, m)| m.times(r)).collect()
        };
        conjugate_gradients(|x| self.times_matrix(x), precondition, wanted)
    }
}

/// Solves a symmetric system from nothing, given the product with its matrix and something near the product with the inverse
/// of that.
pub(super) fn conjugate_gradients(
    times: impl Fn(&[DVec3]) -> Vec<DVec3>,
    precondition: impl Fn(&[DVec3]) -> Vec<DVec3>,
    mut residual: Vec<DVec3>,
) -> Vec<DVec3> {
    let mut x = vec![DVec3::ZERO; residual.len()];
    let mut direction = precondition(&residual);
    let mut strength = dot(&residual, &direction);
    let enough = strength * ENOUGH * ENOUGH;
    for _ in 0..STEPS {
        if strength <= enough {
            break;
        }
        let image = times(&direction);
        let step = strength / dot(&direction, &image);
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += *d * step);
        residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= *i * step);
        let better = precondition(&residual);
        let now = dot(&residual, &better);
        let turn = now / strength;
        strength = now;
        direction.iter_mut().zip(&better).for_each(|(d, b)| *d = *b + *d * turn);
    }
    x
}

/// Items by the group that each belongs to.
struct Groups {
    /// Of each group the place of its first item, and one more.
    first: Vec<u32>,
    items: Vec<u32>,
}

impl Groups {
    fn of(&self, group: usize) -> &[u32] {
        &self.items[self.first[group] as usize..self.first[group + 1] as usize]
    }
}

/// Sorts the numbers of items by their groups, in linear time; those of a group keep their order.
fn grouped(groups: usize, of: impl Iterator<Item = u32> + Clone) -> Groups {
    let mut first = vec![0_u32; groups + 1];
    let mut count = 0;
    for group in of.clone() {
        first[group as usize + 1] += 1;
        count += 1;
    }
    for group in 0..groups {
        first[group + 1] += first[group];
    }
    let mut next = first.clone();
    let mut items = vec![0; count];
    for (item, group) in (0..).zip(of) {
        items[next[group as usize] as usize] = item;
        next[group as usize] += 1;
    }
    Groups { first, items }
}

/// In the order of the vectors, whatever the number of threads.
fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_triangle_goes_where_its_samples_want() {
        // samples all over a triangle in the plane z = 0 want it in the plane z = 1 + x
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let normal = DVec3::new(-1.0, 0.0, 1.0).normalize();
        let rows: Vec<Row> = (0..100)
            .map(|i| {
                let (u, v) = (f64::from(i % 10) / 9.0, f64::from(i / 10) / 9.0);
                let weights = if u + v > 1.0 { [u + v - 1.0, 1.0 - u, 1.0 - v] } else { [1.0 - u - v, u, v] };
                let p: DVec3 = corners.iter().zip(weights).map(|(c, w)| *c * w).sum();
                let wanted = normal * normal.dot(DVec3::new(0.0, 0.0, 1.0 + p.x));
                Row { weights, normal, wanted, weight: 1.0, along: 1e-4 }
            })
            .collect();
        let all = |_, samples: &[u32], sum: &mut OnTriangle| samples.iter().for_each(|&i| sum.add(&rows[i as usize]));
        let fit = |fixed: &[bool]| Fit::new(&[[0, 1, 2]], rows.iter().map(|_| 0), all, fixed);
        let moves = fit(&[false; 3]).solve();
        for (corner, by) in corners.iter().zip(moves) {
            let p = *corner + by;
            assert!((p.z - 1.0 - p.x).abs() < 5e-3, "{p}");
        }
        assert_eq!(fit(&[true; 3]).solve(), [DVec3::ZERO; 3]);
    }
}
