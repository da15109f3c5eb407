//! Order of vertices, wedges and triangles in memory.

use glam::Vec3;
use rayon::prelude::*;

use super::Mesh;
use crate::radix::sort_by_bits;

/// Bits per axis of the grid whose cells are numbered along the curve.
const BITS: u32 = 10;

impl Mesh {
    /// Renumbers vertices along a space-filling curve (Morton's), wedges by their vertices, triangles by their lowest
    /// vertex. Returns for each vertex the number it had before.
    ///
    /// What is near in space is then near in memory: on shuffled input, algorithms that walk from neighbour to
    /// neighbour run several times as fast. Not finite positions come last. Linear.
    pub fn sort_spatially(&mut self) -> Vec<u32> {
        let vertices = curve_order(&self.positions);
        let vertex_ranks = ranks(&vertices);
        for v in &mut self.wedge_vertices {
            *v = vertex_ranks[*v as usize];
        }
        self.gather_vertices(&vertices);
        let wedges = sorted_by_key(self.wedge_count(), |w| self.wedge_vertices[w]);
        let wedge_ranks = ranks(&wedges);
        self.gather_wedges(&wedges);
        for w in self.triangles.iter_mut().flatten() {
            *w = wedge_ranks[*w as usize];
        }
        // wedges are sorted by vertex, so the lowest wedge stands for the lowest vertex
        let triangles = sorted_by_key(self.triangle_count(), |t| {
            let [a, b, c] = self.triangles[t];
            a.min(b).min(c)
        });
        self.gather_triangles(&triangles);
        vertices
    }
}

/// Positions in the order in which the curve visits them.
pub(crate) fn curve_order(positions: &[[f32; 3]]) -> Vec<u32> {
    let finite = positions.iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite());
    let (low, high) = finite.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let extent = (high.as_dvec3() - low.as_dvec3()).max_element();
    let scale = if extent > 0.0 { f64::from((1_u32 << BITS) - 1) / extent } else { 0.0 };
    sorted_by_key(positions.len(), |v| {
        let p = Vec3::from(positions[v]);
        if !p.is_finite() {
            return u32::MAX;
        }
        let cell = (p.as_dvec3() - low.as_dvec3()) * scale;
        spread(cell.x as u32) | spread(cell.y as u32) << 1 | spread(cell.z as u32) << 2
    })
}

/// Puts two zero bits after each of the lowest ten bits.
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00ff;
    let x = (x | x << 8) & 0x0300_f00f;
    let x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}

/// 0 to `count`, sorted by a key; equal keys keep their order.
fn sorted_by_key(count: usize, key: impl Fn(usize) -> u32 + Sync) -> Vec<u32> {
    let mut entries: Vec<u64> = (0..count).into_par_iter().map(|i| u64::from(key(i)) << 32 | i as u64).collect();
    if !entries.is_sorted() {
        sort_by_bits(&mut entries, 32, &mut Vec::new());
    }
    entries.into_iter().map(|entry| entry as u32).collect()
}

/// The place of each element in an order.
pub(crate) fn ranks(order: &[u32]) -> Vec<u32> {
    let mut ranks = vec![0; order.len()];
    for (rank, &i) in order.iter().enumerate() {
        ranks[i as usize] = rank as u32;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Attribute, Semantic, shapes};

    #[test]
    fn spread_leaves_room_for_two_more_axes() {
        assert_eq!(spread(0b11_1111_1111), 0b1001_0010_0100_1001_0010_0100_1001);
        assert_eq!(spread(0b10_0000_0001), 1 << 27 | 1);
    }

    #[test]
    fn sorting_changes_names_only() {
        let mut mesh = shapes::torus(1.0, 0.3, 24, 12);
        let labels = (0..mesh.wedge_count()).map(|w| mesh.positions[mesh.wedge_vertices[w] as usize][0]).collect();
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Custom("x".into()), 1, labels));
        let before = mesh.clone();
        let order = mesh.sort_spatially();
        mesh.check().unwrap();
        let corners = |mesh: &Mesh| {
            let mut all: Vec<[[u32; 3]; 3]> = (0..mesh.triangle_count())
                .map(|t| mesh.triangle_vertices(t).map(|v| mesh.positions[v as usize].map(f32::to_bits)))
                .collect();
            all.sort_unstable();
            all
        };
        assert_eq!(corners(&mesh), corners(&before));
        assert!(order.iter().enumerate().all(|(v, &old)| mesh.positions[v] == before.positions[old as usize]));
        let x = mesh.wedge_attributes[0].as_f32().unwrap();
        assert!((0..mesh.wedge_count()).all(|w| x[w] == mesh.positions[mesh.wedge_vertices[w] as usize][0]));
    }
}
