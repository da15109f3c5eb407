//! Simple shapes made in code, for tests, examples and benchmarks: closed forms are known for all of them.

use super::Mesh;

fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh::from_triangles(positions, triangles).expect("generated indices are in range")
}

/// A regular tetrahedron inscribed in the cube from -1 to 1, 4 triangles.
pub fn tetrahedron() -> Mesh {
    let positions = vec![[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    mesh(positions, vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
}

/// The cube from -1 to 1, 12 triangles, 8 vertices.
pub fn cube() -> Mesh {
    let positions = (0..8).map(|i| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 1.0 } else { -1.0 })).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    mesh(positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
}

/// A flat grid over the unit square at z = 0, open, `2 * steps * steps` triangles.
pub fn grid(steps: u32) -> Mesh {
    let at = |i: u32| i as f32 / steps as f32;
    let positions = (0..=steps).flat_map(|y| (0..=steps).map(move |x| [at(x), at(y), 0.0])).collect();
    let quads = (0..steps).flat_map(|y| (0..steps).map(move |x| y * (steps + 1) + x));
    let below = steps + 1;
    mesh(positions, quads.flat_map(|i| [[i, i + 1, i + below + 1], [i, i + below + 1, i + below]]).collect())
}

/// A torus about the z axis, closed, genus 1, `2 * around * across` triangles.
pub fn torus(major: f32, minor: f32, around: u32, across: u32) -> Mesh {
    let point = |i: u32, j: u32| {
        let (u, v) =
            (std::f32::consts::TAU * i as f32 / around as f32, std::f32::consts::TAU * j as f32 / across as f32);
        let radius = major + minor * v.cos();
        [radius * u.cos(), radius * u.sin(), minor * v.sin()]
    };
    let positions = (0..around).flat_map(|i| (0..across).map(move |j| point(i, j))).collect();
    let id = |i: u32, j: u32| i % around * across + j % across;
    let quads = (0..around).flat_map(|i| (0..across).map(move |j| (i, j)));
    let split = |(i, j): (u32, u32)| {
        let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    mesh(positions, quads.flat_map(split).collect())
}

/// A unit sphere from an octahedron whose triangles are split in four `levels` times: `8 * 4^levels` triangles.
pub fn sphere(levels: u32) -> Mesh {
    let mut positions: Vec<[f32; 3]> =
        vec![[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let sum = glam::Vec3::from(positions[a as usize]) + glam::Vec3::from(positions[b as usize]);
                positions.push(sum.normalize().into());
                positions.len() as u32 - 1
            })
        };
        triangles = (triangles.iter())
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    mesh(positions, triangles)
}
