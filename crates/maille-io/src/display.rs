//! The order in which a graphics card likes to have triangles and vertices.

use maille::Mesh;
use meshopt::VertexDataAdapter;

/// How much worse the use of the vertex cache may get for less overdraw.
const OVERDRAW: f32 = 1.05;

/// Puts the triangles of each material in an order that uses the vertex cache well and draws outer parts first, and the
/// wedges and vertices in the order in which triangles name them. What the mesh draws stays the same.
///
/// Returns the number that each wedge had before. Everything must be in use: wedges that no triangle names go.
pub fn order_for_display(mesh: &mut Mesh) -> Vec<u32> {
    let points: Vec<[f32; 3]> = mesh.wedge_vertices.iter().map(|&v| mesh.positions[v as usize]).collect();
    let mut order: Vec<u32> = (0..mesh.triangle_count() as u32).collect();
    order.sort_by_key(|&t| mesh.triangle_material(t as usize)); // stable
    let mut corners = Vec::with_capacity(3 * order.len());
    let mut sources = Vec::with_capacity(order.len());
    for of_material in order.chunk_by(|&a, &b| mesh.triangle_material(a as usize) == mesh.triangle_material(b as usize))
    {
        let mut indices: Vec<u32> = of_material.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
        meshopt::optimize_vertex_cache_in_place(&mut indices, points.len());
        let bytes = bytes_of(&points);
        if let Ok(adapter) = VertexDataAdapter::new(&bytes, 12, 0) {
            meshopt::optimize_overdraw_in_place(&mut indices, &adapter, OVERDRAW);
        }
        sources.extend(found_again(mesh, of_material, &indices));
        corners.extend(indices);
    }
    let remap = meshopt::optimize_vertex_fetch_remap(&corners, points.len());
    let mut wedges = vec![u32::MAX; remap.iter().filter(|&&new| new != u32::MAX).count()];
    for (old, &new) in (0..).zip(&remap).filter(|(_, new)| **new != u32::MAX) {
        wedges[new as usize] = old;
    }
    mesh.reorder(&sources, &corners, &wedges);
    wedges
}

fn bytes_of(points: &[[f32; 3]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|x| x.to_ne_bytes()).collect()
}

/// Which triangles of the mesh are drawn by indices that are those of some of them in another order.
fn found_again(mesh: &Mesh, triangles: &[u32], indices: &[u32]) -> Vec<u32> {
    let key = |mut corners: [u32; 3]| {
        let least = (0..3).min_by_key(|&k| corners[k]).expect("there are three");
        corners.rotate_left(least);
        corners
    };
    let sorted = |keys: Vec<[u32; 3]>| {
        let mut places: Vec<u32> = (0..keys.len() as u32).collect();
        places.sort_by_key(|&place| keys[place as usize]);
        places
    };
    let before = sorted(triangles.iter().map(|&t| key(mesh.triangles[t as usize])).collect());
    let after = sorted(indices.as_chunks().0.iter().map(|&corners| key(corners)).collect());
    let mut found = vec![0; triangles.len()];
    before.into_iter().zip(after).for_each(|(before, after)| found[after as usize] = triangles[before as usize]);
    found
}
