//! Sample meshes made in code: what a newcomer sees first, and what tests and benchmarks run on without any download.
//!
//! All are in metres, y up, facing +z, and deterministic: the same arguments give the same bits on every run and with
//! any number of threads.

mod distance;
mod isosurface;
mod mechanical;
mod noise;
mod part;
mod rig;
mod sample;
mod statue;
mod terrain;
#[cfg(test)]
mod testing;
mod vase;

pub use mechanical::mechanical;
pub use rig::{Channel, Character, Clip, Joint, Keys, Skeleton};
pub use sample::Sample;
pub use statue::statue;
pub use terrain::terrain;
pub use vase::vase;
