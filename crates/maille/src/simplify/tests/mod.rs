//! What simplification promises, tested through its doors.

mod appearance;
mod attributes;
mod constraints;
mod laws;
mod metrics;
mod options;
mod order;
mod passes;
mod poses;

use std::collections::BTreeMap;

use super::*;
use crate::Control;
use crate::mesh::{Attribute, Semantic, shapes};

/// Options for a number of triangles.
fn to(triangles: usize) -> SimplifyOptions {
    SimplifyOptions { target: Target { triangles: Some(triangles), ..Target::default() }, ..SimplifyOptions::default() }
}

/// Options for a largest error.
fn within(max_error: f64) -> SimplifyOptions {
    let target = Target { max_error: Some(max_error), ..Target::default() };
    SimplifyOptions { target, ..SimplifyOptions::default() }
}

/// Simplifies a copy and checks what holds for every result.
fn reduced(mesh: &Mesh, options: &SimplifyOptions) -> (Mesh, SimplifyReport) {
    let mut result = mesh.clone();
    let report = simplify(&mut result, options, Control::default()).expect("the options make sense");
    result.check().expect("the result keeps the invariants");
    result.check_finite().expect("finite in, finite out");
    assert_eq!((report.triangles_in, report.triangles_out), (mesh.triangle_count(), result.triangle_count()));
    assert!(report.error.is_finite() && report.error >= 0.0, "{report:?}");
    let mut used = (vec![false; result.vertex_count()], vec![false; result.wedge_count()]);
    for (t, wedges) in result.triangles.iter().enumerate() {
        let [a, b, c] = result.triangle_vertices(t);
        assert!(a != b && b != c && c != a, "triangle {t} names a vertex twice");
        wedges.iter().for_each(|&w| used.1[w as usize] = true);
        [a, b, c].iter().for_each(|&v| used.0[v as usize] = true);
    }
    assert!(used.0.into_iter().chain(used.1).all(|used| used), "nothing is left over");
    (result, report)
}

/// Every metric with every placement.
fn every_way() -> impl Iterator<Item = (MetricKind, PlacementKind, String)> {
    let pairs = MetricKind::NAMES.into_iter().flat_map(|m| PlacementKind::NAMES.into_iter().map(move |p| (m, p)));
    pairs.map(|((metric, metric_kind), (placement, kind))| (metric_kind, kind, format!("{metric}, {placement}")))
}

/// A number from 0 to 1 that looks random.
fn noise(seed: u32) -> f32 {
    let mut x = seed.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    x = (x ^ x >> 15).wrapping_mul(0x2c1b_3c6d);
    x = (x ^ x >> 12).wrapping_mul(0x297a_2d39);
    (x ^ x >> 15) as f32 / u32::MAX as f32
}

/// A torus with dents, so that no two collapses cost the same; 2 x 48 x 24 triangles. Its coordinates are multiples
/// of 2^-12.
fn dented_torus() -> Mesh {
    let mut mesh = shapes::torus(2.0, 0.7, 48, 24);
    for (i, x) in (0..).zip(mesh.positions.as_flattened_mut()) {
        *x = ((*x + 0.03 * noise(i)) * 4096.0).round() / 4096.0;
    }
    mesh
}

/// Hills over the unit square.
fn terrain(steps: u32) -> Mesh {
    let mut mesh = shapes::grid(steps);
    for (i, p) in (0..).zip(&mut mesh.positions) {
        p[2] = 0.05 * (9.0 * p[0]).sin() * (7.0 * p[1]).cos() + 0.01 * noise(i);
    }
    mesh
}

/// The cube from 0 to `steps`, each side a grid, with the normals of its sides: three wedges at each corner.
fn flat_cube(steps: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let mut known = BTreeMap::new();
    let mut normals = Vec::new();
    for (axis, far) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
        let first = mesh.wedge_vertices.len() as u32;
        for (j, i) in (0..=steps).flat_map(|j| (0..=steps).map(move |i| (j, i))) {
            let mut p = [0; 3];
            p[axis] = if far { steps } else { 0 };
            p[(axis + 1) % 3] = i;
            p[(axis + 2) % 3] = j;
            let vertex = *known.entry(p).or_insert_with(|| {
                mesh.positions.push(p.map(|x| x as f32));
                mesh.positions.len() as u32 - 1
            });
            mesh.wedge_vertices.push(vertex);
            normals.extend((0..3).map(|k| {
                if k != axis {
                    0.0
                } else if far {
                    1.0
                } else {
                    -1.0
                }
            }));
        }
        for (j, i) in (0..steps).flat_map(|j| (0..steps).map(move |i| (j, i))) {
            let [a, b, c, d] =
                [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| first + j * (steps + 1) + i);
            mesh.triangles.extend(if far { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, normals));
    mesh
}

/// The side of a cylinder of radius 1 and height 1 with texture coordinates (angle / turn, height): two wedges at each
/// vertex of the seam.
fn cylinder(around: u32, up: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let mut uv = Vec::new();
    for (j, i) in (0..=up).flat_map(|j| (0..=around).map(move |i| (j, i))) {
        let angle = std::f32::consts::TAU * i as f32 / around as f32;
        if i < around {
            mesh.positions.push([angle.cos(), angle.sin(), j as f32 / up as f32]);
        }
        mesh.wedge_vertices.push(j * around + i % around);
        uv.extend([i as f32 / around as f32, j as f32 / up as f32]);
    }
    let across = around + 1;
    let quads = (0..up).flat_map(|j| (0..around).map(move |i| j * across + i));
    mesh.triangles = quads.flat_map(|a| [[a, a + 1, a + across + 1], [a, a + across + 1, a + across]]).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    mesh
}

/// The values of a float attribute at a wedge.
fn value(attribute: &Attribute, wedge: usize) -> &[f32] {
    &attribute.as_f32().expect("a float attribute")[wedge * attribute.components..][..attribute.components]
}

/// Bits of all positions, sorted.
fn position_bits(mesh: &Mesh) -> Vec<[u32; 3]> {
    let mut all: Vec<_> = mesh.positions.iter().map(|p| p.map(f32::to_bits)).collect();
    all.sort_unstable();
    all
}
