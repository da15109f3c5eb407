//! Texture coordinates on their way: which may move over the texture, and which would sweep across it.
//!
//! A wedge that goes to one in another part of the atlas must not take the straight way: in between, it would show what
//! is painted for other places. Its step is told from a proper one by what the surface explains: over a distance on the
//! surface, texture coordinates change by about that distance times the density of the texture around.

use glam::{Vec2, Vec3};

use super::Correspondence;
use super::paths::Way;
use crate::Mesh;

/// How many times longer than the density around explains a step may be. Densities are those of whole triangles, and a
/// step in space cuts corners that the surface and its chart go around.
const LONGER: f32 = 2.0;

/// What the triangles around a wedge say of its texture.
#[derive(Debug, Clone, Copy, Default)]
struct Around {
    /// Largest change of texture coordinates along an edge, over the length of that: sides of the texture per model
    /// unit.
    density: f32,
    /// Largest change along an edge, in sides of the texture.
    reach: f32,
}

/// Tells how texture coordinates may move.
pub(super) struct TextureSteps {
    finer: Vec<Around>,
    coarser: Vec<Around>,
    /// Of each wedge of the finer level, whether a triangle at it is still there in the coarser one.
    survives: Vec<bool>,
}

impl TextureSteps {
    /// `finer_uv` and `coarser_uv` give the texture coordinates of wedges.
    pub(super) fn new(
        [finer, coarser]: [&Mesh; 2],
        correspondence: &Correspondence,
        finer_uv: impl Fn(u32) -> Vec2,
        coarser_uv: impl Fn(u32) -> Vec2,
    ) -> Self {
        Self {
            finer: around(finer, finer_uv),
            coarser: around(coarser, coarser_uv),
            survives: survives(finer, coarser, correspondence),
        }
    }

    /// How a wedge goes to its target, given its steps in space and over the texture.
    ///
    /// Straight, if the step over the texture is at most twice what the step in space explains by the density around,
    /// and one edge more (for values that were fitted anew in the same place). What is longer jumps in the middle,
    /// together with the other corners of its triangle; or at the very end if all its triangles shrink to nothing on
    /// the way: these then never show the other place.
    pub(super) fn way(&self, wedge: u32, target: u32, step: f32, uv_step: f32) -> Way {
        let (here, there) = (self.finer[wedge as usize], self.coarser[target as usize]);
        let explained = LONGER * here.density.max(there.density) * step + here.reach;
        match uv_step > explained {
            false => Way::Straight,
            true if self.survives[wedge as usize] => Way::Switch,
            true => Way::Hold,
        }
    }
}

fn around(mesh: &Mesh, uv: impl Fn(u32) -> Vec2) -> Vec<Around> {
    let mut around = vec![Around::default(); mesh.wedge_count()];
    for triangle in &mesh.triangles {
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            let [a, b] = [triangle[i], triangle[j]];
            let length = position(mesh, a).distance(position(mesh, b));
            let reach = uv(a).distance(uv(b));
            // edges without length tell no density
            let density = if length > 0.0 { reach / length } else { 0.0 };
            for wedge in [a, b] {
                let here = &mut around[wedge as usize];
                *here = Around { density: here.density.max(density), reach: here.reach.max(reach) };
            }
        }
    }
    around
}

pub(super) fn position(mesh: &Mesh, wedge: u32) -> Vec3 {
    mesh.positions[mesh.wedge_vertices[wedge as usize] as usize].into()
}

fn survives(finer: &Mesh, coarser: &Mesh, correspondence: &Correspondence) -> Vec<bool> {
    let mut survives = vec![false; finer.wedge_count()];
    let vertex = |wedge: u32| {
        let target = correspondence.wedges[wedge as usize];
        coarser.wedge_vertices.get(target as usize).copied()
    };
    for triangle in &finer.triangles {
        if let [Some(a), Some(b), Some(c)] = triangle.map(vertex)
            && a != b
            && b != c
            && c != a
        {
            triangle.iter().for_each(|&wedge| survives[wedge as usize] = true);
        }
    }
    survives
}
