//! Slow and plain checks of triangle meshes, for the tests of the samples.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;

/// Every directed edge once, its opposite once, and one fan around each vertex.
pub(super) fn assert_closed_manifold(triangles: &[[u32; 3]]) {
    let mut next_around: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
    for &[a, b, c] in triangles {
        for [v, from, to] in [[a, b, c], [b, c, a], [c, a, b]] {
            let twice = next_around.entry(v).or_default().insert(from, to);
            assert!(twice.is_none(), "two triangles have the edge {v} {from} in the same direction");
        }
    }
    for (v, ring) in &next_around {
        let (&start, _) = ring.first_key_value().expect("a ring has an entry");
        let mut at = start;
        for step in 1..=ring.len() {
            at = *ring.get(&at).unwrap_or_else(|| panic!("the edge {v} {at} is open"));
            assert_eq!(at == start, step == ring.len(), "vertex {v} has several fans");
        }
    }
}

/// Euler characteristic of the used vertices, edges and triangles.
pub(super) fn euler(triangles: &[[u32; 3]]) -> i64 {
    let vertices: BTreeSet<u32> = triangles.iter().flatten().copied().collect();
    let sides = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let edges: BTreeSet<(u32, u32)> = sides.map(|(a, b)| (a.min(b), a.max(b))).collect();
    vertices.len() as i64 - edges.len() as i64 + triangles.len() as i64
}

/// Number of connected components of the used vertices.
pub(super) fn components(triangles: &[[u32; 3]]) -> usize {
    let mut neighbours: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &[a, b, c] in triangles {
        for (a, b) in [(a, b), (b, c), (c, a)] {
            neighbours.entry(a).or_default().push(b);
            neighbours.entry(b).or_default().push(a);
        }
    }
    let mut count = 0;
    while let Some((&start, _)) = neighbours.first_key_value() {
        count += 1;
        let mut stack = vec![start];
        while let Some(v) = stack.pop() {
            stack.extend(neighbours.remove(&v).unwrap_or_default());
        }
    }
    count
}

/// Signed volume, positive when the triangles face outwards.
pub(super) fn volume(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
    let point = |v: u32| Vec3::from(positions[v as usize]).as_dvec3();
    triangles.iter().map(|&[a, b, c]| point(a).dot(point(b).cross(point(c))) / 6.0).sum()
}
