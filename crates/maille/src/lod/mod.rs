//! Between two levels of detail: which part of the one becomes which of the other, and the shapes on the way.
//!
//! A [`Correspondence`] tells for each wedge of a finer level which wedge of a coarser level it becomes. A
//! [`Geomorph`] is prepared from it once and then gives the finer level on its way to the coarser one, at any moment:
//! nothing pops when levels change. A [`SkinnedGeomorph`] does the same for levels that a skeleton moves.
//!
//! Source: J. Houle, Simplification et morphisme en temps réel de modèles articulés, 2000, chapter 5; geomorphs come
//! from H. Hoppe, Progressive meshes, SIGGRAPH 1996.

mod closest;
pub mod correspondence;
pub mod geomorph;
mod paths;
pub mod skinned;
#[cfg(test)]
mod tests;
mod texture;

pub use correspondence::{Correspondence, CorrespondenceError, Target};
pub use geomorph::{
    ColorInterpolation, Geomorph, GeomorphError, GeomorphOptions, Level, MorphedMesh, NormalInterpolation,
};
pub use skinned::{JointMatrix, Posed, SkinError, SkinnedGeomorph, joint_matrix};
