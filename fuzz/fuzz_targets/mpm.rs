//! Progressive meshes: any bytes give sound levels, from the finest to the base, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use maille_io::{ProgressiveAsset, ReadOptions};

fuzz_target!(|bytes: &[u8]| {
    // length and checksum are made right: no fuzzer would get past them
    let mut bytes = bytes.to_vec();
    if bytes.len() >= 24 {
        let length = (bytes.len() as u64).to_le_bytes();
        bytes[16..24].copy_from_slice(&length);
        let checksum = crc32fast::hash(&bytes[16..]);
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
    }
    let options = ReadOptions { max_bytes: 1 << 28 };
    if let Ok(mut progressive) = ProgressiveAsset::read_bytes(&bytes, &options) {
        let finest = vec![0; progressive.meshes().len()];
        let base: Vec<usize> = progressive.meshes().map(|mesh| mesh.collapse_count()).collect();
        for collapses in [&base, &finest, &progressive.collapses_for(50)] {
            for mesh in &progressive.level(collapses).meshes {
                mesh.mesh.check().expect("levels are sound");
            }
        }
    }
});
