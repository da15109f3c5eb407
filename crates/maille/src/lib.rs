//! Multiresolution triangle meshes: the computing core of Maille.
//!
//! A [`Mesh`] is what files and GPUs want: positions, triangles over wedges, named attributes. From it one builds
//! working structures ([`topology`]), finds and mends what is wrong with it ([`mod@repair`]), simplifies by edge collapse
//! ([`simplify`](mod@simplify); [`certified`] with a proven bound), and measures how far two surfaces are apart ([`measure`]);
//! [`scene`] tells which level of detail to draw. Everything here is pure computation: no files (see the crate
//! `maille-io`), no GPU, no printing.
//!
//! Start with [`Mesh`], then [`simplify()`](simplify::simplify) and [`measure::compare`].

pub mod certified;
pub mod cluster;
pub mod color;
pub mod control;
pub mod lod;
pub mod measure;
pub mod mesh;
mod prefetch;
pub mod progressive;
mod radix;
pub mod refit;
pub mod repair;
pub mod samples;
pub mod scene;
pub mod simplify;
pub mod skin;
pub mod topology;
#[cfg(test)]
mod zoo;

pub use control::{Control, StageTimes};
pub use mesh::{Attribute, Mesh, Semantic};
