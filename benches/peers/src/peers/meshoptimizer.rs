//! meshoptimizer, through the crate `meshopt`, without a limit on the error.

use anyhow::Result;
use maille::Mesh;
use meshopt::{SimplifyOptions, VertexDataAdapter};

use crate::inputs::compact;
use crate::memory::{Cost, measure};
use crate::peer::Peer;

/// One of the ways to call it.
#[derive(Debug, Clone, Copy)]
pub enum Meshoptimizer {
    /// Vertices stay where they are.
    Subset,
    /// Vertices move to where the error is least.
    Update,
    /// `Update` again and again, each time to half of the triangles at the most: slower, and nearer to the original.
    Halvings,
}

impl Meshoptimizer {
    pub const ALL: [Self; 3] = [Self::Subset, Self::Update, Self::Halvings];
}

impl Peer for Meshoptimizer {
    fn name(&self) -> &str {
        match self {
            Self::Subset => "meshopt",
            Self::Update => "meshopt-update",
            Self::Halvings => "meshopt-halvings",
        }
    }

    fn version(&self) -> &str {
        "0.7.0"
    }

    fn simplify(&self, mesh: &Mesh, triangles: usize) -> Result<(Mesh, Cost)> {
        let (mut positions, mut indices) = (mesh.positions.clone(), mesh.triangles.as_flattened().to_vec());
        let target = 3 * triangles;
        let ((), cost) = measure(|| match self {
            Self::Subset => subset(&mut indices, &positions, target),
            Self::Update => update(&mut indices, &mut positions, target),
            Self::Halvings => halvings(&mut indices, &mut positions, target),
        });
        let (triangles, _) = indices.as_chunks::<3>();
        Ok((compact(&positions, triangles.to_vec())?, cost))
    }
}

fn subset(indices: &mut Vec<u32>, positions: &[[f32; 3]], target: usize) {
    let vertices = VertexDataAdapter::new(meshopt::typed_to_bytes(positions), size_of::<[f32; 3]>(), 0);
    let vertices = vertices.expect("the length is a multiple of the stride");
    *indices = meshopt::simplify(indices, &vertices, target, f32::MAX, SimplifyOptions::None, None);
}

fn update(indices: &mut Vec<u32>, positions: &mut [[f32; 3]], target: usize) {
    let options = SimplifyOptions::None;
    let left =
        meshopt::simplify_with_update(indices, positions, &mut [], &[], 0, None, target, f32::MAX, options, None);
    indices.truncate(left);
}

fn halvings(indices: &mut Vec<u32>, positions: &mut Vec<[f32; 3]>, target: usize) {
    while indices.len() > target {
        let before = indices.len();
        update(indices, positions, target.max(before / 6 * 3));
        if indices.len() == before {
            break;
        }
        let used = meshopt::optimize_vertex_fetch_in_place(indices, positions);
        positions.truncate(used);
    }
}
