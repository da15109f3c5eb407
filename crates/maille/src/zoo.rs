//! Meshes good and bad, each with what is known about it, for the tests of every room.

use crate::{Mesh, mesh::shapes};

/// A mesh and the facts that any analysis must find.
pub(crate) struct Specimen {
    pub(crate) name: &'static str,
    pub(crate) mesh: Mesh,
    /// Vertices in use - edges + proper faces.
    pub(crate) euler: i64,
    /// Faces joined by shared edges of any kind, degenerate ones left out.
    pub(crate) components: u32,
    pub(crate) boundary_edges: u32,
    pub(crate) non_manifold_edges: u32,
    pub(crate) non_manifold_vertices: u32,
    pub(crate) inconsistent_edges: u32,
    pub(crate) orientable: bool,
}

fn of(vertices: u32, triangles: &[[u32; 3]]) -> Mesh {
    // on a screw line, so that no three points are in a row
    let point = |i: u32| [(i as f32).cos(), (i as f32).sin(), 0.1 * i as f32];
    Mesh::from_triangles((0..vertices).map(point).collect(), triangles.to_vec()).expect("indices are in range")
}

/// A grid of 4 x 4 quads without the 2 x 2 in its middle.
pub(crate) fn grid_with_hole() -> Mesh {
    let mut mesh = shapes::grid(4);
    let inside = |x: f32| (0.3..0.7).contains(&x);
    let centre = |t: usize| mesh.triangle_points(t).iter().sum::<glam::DVec3>().as_vec3() / 3.0;
    let keep: Vec<u32> = (0..32).filter(|&t| !(inside(centre(t as usize).x) && inside(centre(t as usize).y))).collect();
    mesh.gather_triangles(&keep);
    mesh
}

/// A band of `steps` quads with a half twist.
pub(crate) fn moebius(steps: u32) -> Mesh {
    let point = |i: u32| {
        let angle = std::f32::consts::TAU * (i / 2) as f32 / steps as f32;
        let side = if i.is_multiple_of(2) { 0.3 } else { -0.3 };
        let radius = 1.0 + side * (angle / 2.0).cos();
        [radius * angle.cos(), radius * angle.sin(), side * (angle / 2.0).sin()]
    };
    let end = |i: u32| if i < 2 * steps { i } else { (i + 1) % 2 };
    let quads = (0..steps).map(|s| [2 * s, 2 * s + 1, end(2 * s + 2), end(2 * s + 3)]);
    let triangles = quads.flat_map(|[a, b, c, d]| [[a, b, c], [c, b, d]]).collect();
    Mesh::from_triangles((0..2 * steps).map(point).collect(), triangles).expect("indices are in range")
}

/// All of them.
pub(crate) fn zoo() -> Vec<Specimen> {
    let good = |name, mesh, euler, boundary_edges| Specimen {
        name,
        mesh,
        euler,
        components: 1,
        boundary_edges,
        non_manifold_edges: 0,
        non_manifold_vertices: 0,
        inconsistent_edges: 0,
        orientable: true,
    };
    let mut isolated = shapes::tetrahedron();
    isolated.positions.extend([[5.0; 3], [6.0; 3]]);
    let mut soup = shapes::cube();
    soup.unweld();
    vec![
        Specimen { components: 0, ..good("empty", Mesh::default(), 0, 0) },
        Specimen { components: 0, ..good("points only", of(3, &[]), 0, 0) },
        good("triangle", of(3, &[[0, 1, 2]]), 1, 3),
        good("tetrahedron", shapes::tetrahedron(), 2, 0),
        good("cube", shapes::cube(), 2, 0),
        good("sphere", shapes::sphere(2), 2, 0),
        good("torus", shapes::torus(2.0, 0.5, 12, 8), 0, 0),
        good("grid", shapes::grid(5), 1, 20),
        good("grid with hole", grid_with_hole(), 0, 24),
        good("isolated vertices", isolated, 2, 0),
        good("strip", of(6, &[[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]]), 1, 6),
        good("open fan", of(5, &[[0, 1, 2], [0, 2, 3], [0, 3, 4]]), 1, 5),
        good("pillow", of(3, &[[0, 1, 2], [0, 2, 1]]), 2, 0),
        Specimen { components: 12, ..good("soup", soup, 12, 36) },
        Specimen { inconsistent_edges: 1, orientable: false, ..good("moebius band", moebius(7), 0, 14) },
        Specimen {
            inconsistent_edges: 1,
            ..good("two faces wound against each other", of(4, &[[0, 1, 2], [1, 2, 3]]), 1, 4)
        },
        Specimen {
            components: 2,
            non_manifold_vertices: 1,
            ..good(
                "two cones at a vertex",
                of(7, &[[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 4, 5], [0, 5, 6], [0, 6, 4]]),
                1,
                6,
            )
        },
        Specimen {
            components: 2,
            non_manifold_vertices: 1,
            ..good(
                "two tetrahedra at a vertex",
                of(7, &[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2], [0, 4, 5], [0, 6, 4], [0, 5, 6], [4, 6, 5]]),
                3,
                0,
            )
        },
        Specimen {
            non_manifold_edges: 1,
            non_manifold_vertices: 2,
            ..good("three faces on an edge", of(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]), 1, 6)
        },
        Specimen {
            non_manifold_edges: 1,
            non_manifold_vertices: 2,
            ..good(
                "two tetrahedra at an edge",
                of(6, &[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2], [0, 1, 4], [0, 5, 1], [0, 4, 5], [1, 5, 4]]),
                3,
                0,
            )
        },
        Specimen {
            inconsistent_edges: 3,
            orientable: true,
            ..good("same face twice", of(3, &[[0, 1, 2], [1, 2, 0]]), 2, 0)
        },
        Specimen {
            non_manifold_edges: 3,
            non_manifold_vertices: 3,
            ..good(
                "a face of a tetrahedron twice",
                of(4, &[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2], [3, 2, 1]]),
                3,
                0,
            )
        },
        good("degenerate faces", of(5, &[[0, 1, 2], [0, 0, 1], [3, 3, 3], [4, 0, 4], [2, 1, 3]]), 1, 4),
    ]
}
