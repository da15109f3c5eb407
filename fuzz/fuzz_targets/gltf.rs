//! glTF and GLB: any bytes give sound meshes, which can be posed and parted from their levels of detail, or an error.
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
        if let Some(Ok((whole, levels))) = asset.split_levels() {
            let meshes = levels.iter().flat_map(|level| &level.meshes);
            meshes.for_each(|mesh| mesh.check().expect("levels are sound"));
            assert!(levels.iter().all(|level| level.meshes.len() == whole.meshes.len()));
        }
    }
});
