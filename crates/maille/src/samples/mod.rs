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
mod statue;
#[cfg(test)]
mod testing;

pub use mechanical::mechanical;
pub use rig::{Channel, Character, Clip, Joint, Keys, Skeleton};
pub use statue::statue;
