//! glTF and GLB: any bytes give sound meshes, which can be posed, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use maille_io::{Format, ReadOptions, read_bytes};

fuzz_target!(|bytes: &[u8]| {
    let options = ReadOptions { max_bytes: 1 << 28 };
    if let Ok(asset) = read_bytes(bytes, Some(Format::Glb), &options) {
        for mesh in &asset.meshes {
            mesh.mesh.check().expect("what is read is sound");
        }
        let _ = asset.merged_positions();
        for (number, clip) in asset.clips().iter().enumerate().take(4) {
            let posed = asset.animation(number).instances_at((clip.start() + clip.end()) / 2.0);
            assert_eq!(posed.len(), asset.instances.len());
        }
    }
});
