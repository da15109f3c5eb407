//! The sparse least-squares problem of one round, solved by conjugate gradients.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// What a distance along the surface counts, of one along the normal.
const ALONG: f64 = 0.05;

/// What staying counts, of what the samples of a vertex count: for vertices with few samples.
const STAY: f64 = 1e-3;

/// Most steps of the conjugate gradients, and the share of the residual at which they end. The matrix is about as well
/// conditioned as a mass matrix with its lumped form for preconditioner: a dozen steps do.
const STEPS: usize = 16;
const ENOUGH: f64 = 1e-3;

/// A sample: the point `weights` of a triangle should move by `wanted`, above all along `normal`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub(super) vertices: [u32; 3],
    pub(super) weights: [f64; 3],
    pub(super) normal: DVec3,
    pub(super) wanted: DVec3,
}

impl Row {
    /// A vector, weighted by its direction.
    fn weigh(&self, v: DVec3) -> DVec3 {
        let along = self.normal * self.normal.dot(v);
        along + (v - along) * ALONG
    }
}

/// All samples, and at which vertices they pull.
pub(super) struct Fit<'a> {
    rows: &'a [Row],
    /// Of each vertex the place of its first pull, and one more.
    first: Vec<u32>,
    /// Rows, with the number of the corner.
    pulls: Vec<(u32, u8)>,
    /// What undoes the lumped matrix at each vertex; zero for vertices that stay.
    inverse: Vec<DMat3>,
    /// What staying counts for each vertex.
    stay: Vec<f64>,
}

impl<'a> Fit<'a> {
    pub(super) fn new(rows: &'a [Row], fixed: &[bool]) -> Self {
        let mut first = vec![0_u32; fixed.len() + 1];
        for v in rows.iter().flat_map(|row| row.vertices) {
            first[v as usize + 1] += 1;
        }
        for v in 0..fixed.len() {
            first[v + 1] += first[v];
        }
        let mut next = first.clone();
        let mut pulls = vec![(0, 0); 3 * rows.len()];
        for (i, row) in (0..).zip(rows) {
            for (k, v) in (0..).zip(row.vertices) {
                pulls[next[v as usize] as usize] = (i, k);
                next[v as usize] += 1;
            }
        }
        let mut fit = Self { rows, first, pulls, inverse: Vec::new(), stay: Vec::new() };
        let lumped = |v: usize| {
            let (mut normals, mut weight) = (DMat3::ZERO, 0.0);
            for (row, w) in fit.pulls_at(v) {
                let n = row.normal;
                normals += DMat3::from_cols(n * n.x, n * n.y, n * n.z) * (w * (1.0 - ALONG));
                weight += w;
            }
            let stay = STAY * weight;
            let matrix = normals + DMat3::from_diagonal(DVec3::splat(weight * ALONG + stay));
            let moves = !fixed[v] && weight > 0.0;
            (if moves { matrix.inverse() } else { DMat3::ZERO }, stay)
        };
        let (inverse, stay) = (0..fixed.len()).into_par_iter().map(lumped).unzip();
        (fit.inverse, fit.stay) = (inverse, stay);
        fit
    }

    fn pulls_at(&self, v: usize) -> impl Iterator<Item = (&Row, f64)> {
        let pulls = &self.pulls[self.first[v] as usize..self.first[v + 1] as usize];
        pulls.iter().map(|&(row, k)| {
            let row = &self.rows[row as usize];
            (row, row.weights[k as usize])
        })
    }

    /// What vectors at the samples come to at the vertices, nothing where they stay.
    fn gather(&self, at_rows: &[DVec3], at_vertices: impl Fn(usize) -> DVec3 + Sync) -> Vec<DVec3> {
        let gathered = |v: usize| {
            if self.inverse[v] == DMat3::ZERO {
                return DVec3::ZERO;
            }
            let pulls = &self.pulls[self.first[v] as usize..self.first[v + 1] as usize];
            let pull = |&(row, k): &(u32, u8)| at_rows[row as usize] * self.rows[row as usize].weights[k as usize];
            pulls.iter().map(pull).sum::<DVec3>() + at_vertices(v)
        };
        (0..self.inverse.len()).into_par_iter().map(gathered).collect()
    }

    fn times_matrix(&self, x: &[DVec3]) -> Vec<DVec3> {
        let moved = |row: &Row| {
            let corners = row.vertices.into_iter().zip(row.weights);
            row.weigh(corners.map(|(v, w)| x[v as usize] * w).sum())
        };
        let at_rows: Vec<DVec3> = self.rows.par_iter().map(moved).collect();
        self.gather(&at_rows, |v| x[v] * self.stay[v])
    }

    /// The moves of all vertices.
    pub(super) fn solve(&self) -> Vec<DVec3> {
        let wanted: Vec<DVec3> = self.rows.par_iter().map(|row| row.weigh(row.wanted)).collect();
        let mut residual = self.gather(&wanted, |_| DVec3::ZERO);
        let mut x = vec![DVec3::ZERO; residual.len()];
        let precondition =
            |r: &[DVec3]| -> Vec<DVec3> { r.par_iter().zip(&self.inverse).map(|(&r, &m)| m * r).collect() };
        let mut direction = precondition(&residual);
        let mut strength = dot(&residual, &direction);
        let enough = strength * ENOUGH * ENOUGH;
        for _ in 0..STEPS {
            if strength <= enough {
                break;
            }
            let image = self.times_matrix(&direction);
            let step = strength / dot(&direction, &image);
            x.iter_mut().zip(&direction).for_each(|(x, d)| *x += *d * step);
            residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= *i * step);
            let better = precondition(&residual);
            let now = dot(&residual, &better);
            let turn = now / strength;
            strength = now;
            direction = better.iter().zip(&direction).map(|(b, d)| *b + *d * turn).collect();
        }
        x
    }
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
                Row { vertices: [0, 1, 2], weights, normal, wanted }
            })
            .collect();
        let moves = Fit::new(&rows, &[false; 3]).solve();
        for (corner, by) in corners.iter().zip(moves) {
            let p = *corner + by;
            assert!((p.z - 1.0 - p.x).abs() < 5e-3, "{p}");
        }
        assert_eq!(Fit::new(&rows, &[true; 3]).solve(), [DVec3::ZERO; 3]);
    }
}
