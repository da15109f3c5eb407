//! Meshes in poses.

use glam::{DAffine3, DMat4, DVec3, Vec3};
use rayon::prelude::*;

use crate::mesh::{Attribute, Mesh, MorphTarget, Semantic};

/// What moves a mesh away from where its vertices are stored, at one moment: the matrices of its joints, and how far its
/// morph targets are on.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// With a skin: of each joint, its world matrix times its inverse bind matrix. Empty for a mesh without one.
    pub joint_matrices: Vec<DMat4>,
    /// Without a skin: from the mesh's space to the world's.
    pub transform: DMat4,
    /// How far each morph target is on; what is missing is off.
    pub morph_weights: Vec<f32>,
    /// How much the pose counts among others.
    pub share: f64,
}

impl Default for Pose {
    /// Everything where it is stored.
    fn default() -> Self {
        Self { joint_matrices: Vec::new(), transform: DMat4::IDENTITY, morph_weights: Vec::new(), share: 1.0 }
    }
}

impl Pose {
    /// How each vertex moves: linear blend skinning after morph targets, both as the first wedge of the vertex has them
    /// (were wedges of a vertex to differ, the surface would tear). A vertex of no weight stays where it is, as in
    /// viewers.
    pub fn vertex_maps(&self, mesh: &Mesh) -> Vec<DAffine3> {
        let mut wedge_of = vec![u32::MAX; mesh.vertex_count()];
        for (w, &v) in mesh.wedge_vertices.iter().enumerate().rev() {
            wedge_of[v as usize] = w as u32;
        }
        let skin = Influences::of(mesh);
        let morphs = self.active_morphs(mesh);
        let map_of = |&wedge: &u32| {
            if wedge == u32::MAX {
                return DAffine3::IDENTITY; // no triangle uses it
            }
            let matrix =
                if self.joint_matrices.is_empty() { self.transform } else { skin.blend(wedge, &self.joint_matrices) };
            let offset: DVec3 = morphs
                .iter()
                .map(|&(deltas, weight)| Vec3::from_slice(&deltas[3 * wedge as usize..]).as_dvec3() * weight)
                .sum();
            DAffine3::from_mat4(matrix) * DAffine3::from_translation(offset)
        };
        wedge_of.par_iter().map(map_of).collect()
    }

    /// Position deltas of the morph targets that are on, and how far.
    fn active_morphs<'a>(&self, mesh: &'a Mesh) -> Vec<(&'a [f32], f64)> {
        let deltas = |target: &'a MorphTarget| {
            target.attributes.iter().find(|a| a.semantic == Semantic::Position).and_then(Attribute::as_f32)
        };
        let all = mesh.morph_targets.iter().zip(&self.morph_weights).filter(|&(_, &weight)| weight != 0.0);
        all.filter_map(|(target, &weight)| Some((deltas(target)?, f64::from(weight)))).collect()
    }
}

/// The joints that move each wedge, and by how much: all sets of `JOINTS_n` and `WEIGHTS_n`.
#[derive(Debug)]
pub struct Influences<'a>(Vec<(&'a [u32], &'a [f32])>);

impl<'a> Influences<'a> {
    /// Those of a mesh; none if it has no skin.
    pub fn of(mesh: &'a Mesh) -> Self {
        let set = |n| {
            let joints = mesh.wedge_attribute(&Semantic::Joints(n)).filter(|a| a.components == 4)?;
            let weights = mesh.wedge_attribute(&Semantic::Weights(n)).filter(|a| a.components == 4)?;
            Some((joints.as_u32()?, weights.as_f32()?))
        };
        Self((0..).map_while(set).collect())
    }

    /// Whether there are any.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The joints of a wedge that have a weight, with it.
    ///
    /// # Panics
    /// If there is no such wedge.
    pub fn of_wedge(&self, wedge: u32) -> impl Iterator<Item = (u32, f32)> + Clone + '_ {
        let at = 4 * wedge as usize..4 * wedge as usize + 4;
        let set = move |&(joints, weights): &(&'a [u32], &'a [f32])| {
            joints[at.clone()].iter().copied().zip(weights[at.clone()].iter().copied())
        };
        self.0.iter().flat_map(set).filter(|&(_, weight)| weight > 0.0)
    }

    /// The mean of the joints' matrices by weight; the identity where nothing has weight.
    ///
    /// # Panics
    /// If there is no such wedge.
    pub fn blend(&self, wedge: u32, matrices: &[DMat4]) -> DMat4 {
        let (mut sum, mut total) = (DMat4::ZERO, 0.0);
        for (joint, weight) in self.of_wedge(wedge) {
            if let Some(matrix) = matrices.get(joint as usize) {
                sum += *matrix * f64::from(weight);
                total += f64::from(weight);
            }
        }
        if total > 0.0 { sum * total.recip() } else { DMat4::IDENTITY }
    }
}
