//! Edges of a mesh as a sorted list: no adjacency, but counts and lengths.

use rayon::prelude::*;

use super::chunks::sum;
use crate::Mesh;

/// Every edge and how many triangles it has.
pub(super) struct Edges {
    /// Sides of all triangles, the lesser vertex in the high half; equal ones follow each other.
    sides: Vec<u64>,
    /// Where in `sides` each edge begins.
    starts: Vec<u32>,
}

impl Edges {
    /// The edges of all triangles with three different vertices.
    pub(super) fn of(mesh: &Mesh) -> Self {
        let side = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
        let mut sides: Vec<u64> = (0..mesh.triangle_count())
            .into_par_iter()
            .map(|t| mesh.triangle_vertices(t))
            .filter(|&[a, b, c]| a != b && b != c && c != a)
            .flat_map_iter(|[a, b, c]| [side(a, b), side(b, c), side(c, a)])
            .collect();
        sides.par_sort_unstable();
        let is_start = |&i: &u32| i == 0 || sides[i as usize - 1] != sides[i as usize];
        let starts = (0..sides.len() as u32).filter(is_start).collect();
        Self { sides, starts }
    }

    /// How many triangles they come from.
    pub(super) fn triangles(&self) -> usize {
        self.sides.len() / 3
    }

    /// How many edges there are.
    pub(super) fn len(&self) -> usize {
        self.starts.len()
    }

    /// How many edges have a number of triangles that is wanted.
    pub(super) fn count(&self, wanted: impl Fn(u32) -> bool) -> u32 {
        (0..self.len()).filter(|&i| wanted(self.valence(i))).count() as u32
    }

    /// Length of all edges with one triangle, in model units.
    pub(super) fn boundary_length(&self, mesh: &Mesh) -> f64 {
        let point = |v: u64| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3();
        sum(self.len(), |i| {
            let side = self.sides[self.starts[i] as usize];
            if self.valence(i) == 1 { point(side >> 32).distance(point(side & 0xffff_ffff)) } else { 0.0 }
        })
    }

    /// Vertices minus edges plus triangles.
    pub(super) fn euler_characteristic(&self, mesh: &Mesh) -> i64 {
        let mut is_used = vec![false; mesh.vertex_count()];
        for side in &self.sides {
            is_used[(side >> 32) as usize] = true;
            is_used[(side & 0xffff_ffff) as usize] = true;
        }
        let vertices = is_used.iter().filter(|&&used| used).count();
        vertices as i64 - self.len() as i64 + self.triangles() as i64
    }

    /// How many triangles an edge has.
    fn valence(&self, edge: usize) -> u32 {
        let end = self.starts.get(edge + 1).map_or(self.sides.len() as u32, |&next| next);
        end - self.starts[edge]
    }
}
