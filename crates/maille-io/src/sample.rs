//! The samples of the library as assets.

use maille::samples::{self, Sample};

use crate::Asset;

/// A sample of about `triangles` triangles, as if it had been read from a file; the character with its skeleton and
/// clips.
pub fn sample(sample: Sample, triangles: usize) -> Asset {
    let mesh = match sample {
        Sample::Character => return Asset::from_character(sample.name(), &samples::character(triangles)),
        Sample::Statue => samples::statue(triangles),
        Sample::Mechanical => samples::mechanical(triangles),
        Sample::Terrain => samples::terrain(triangles),
        Sample::Vase => samples::vase(triangles),
    };
    Asset::from_mesh(sample.name(), mesh)
}
