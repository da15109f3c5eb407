//! Which vertices matter: Rossignac and Borrel's grading.

use glam::Vec3;
use rayon::prelude::*;

use crate::Mesh;

/// Edges at a vertex that are compared pair by pair; more are rare, and would take quadratic time.
const MOST_EDGES: usize = 64;

/// The longest edge at each vertex times `cos(t / 2)`, t the largest angle between two of its edges (the chance to be on a
/// silhouette, by Low and Tan), times the importance given.
pub(super) fn weights(mesh: &Mesh, importance: &[f32]) -> Vec<f32> {
    let triangles = || (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t));
    // the neighbours of each vertex, those of all in one list
    let mut ends = vec![0_u32; mesh.vertex_count() + 1];
    triangles().flatten().for_each(|v| ends[v as usize + 1] += 2);
    (1..ends.len()).for_each(|v| ends[v] += ends[v - 1]);
    let mut neighbours = vec![0; ends[mesh.vertex_count()] as usize];
    let mut next = ends.clone();
    for [a, b, c] in triangles() {
        for (v, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            let at = next[v as usize] as usize;
            neighbours[at..at + 2].copy_from_slice(&others);
            next[v as usize] += 2;
        }
    }
    let weight = |v: usize| {
        let own = neighbours[ends[v] as usize..ends[v + 1] as usize].iter().take(2 * MOST_EDGES);
        let point = |v: usize| Vec3::from(mesh.positions[v]).as_dvec3();
        let edges = own.map(|&other| point(other as usize) - point(v)).filter(|edge| edge.length_squared() > 0.0);
        let edges: Vec<glam::DVec3> = edges.collect();
        let longest = edges.iter().map(|edge| edge.length()).fold(0.0, f64::max);
        let directions: Vec<Vec3> = edges.iter().map(|edge| edge.normalize().as_vec3()).collect();
        let cosines = directions.iter().enumerate().flat_map(|(i, a)| directions[..i].iter().map(move |b| a.dot(*b)));
        let widest = cosines.fold(1.0, f32::min);
        (longest as f32) * (0.5 * (1.0 + widest)).max(0.0).sqrt() * importance.get(v).copied().unwrap_or(1.0)
    };
    (0..mesh.vertex_count()).into_par_iter().map(weight).collect()
}
