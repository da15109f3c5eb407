//! glTF files of the public model set: read, written, and read again.

use std::path::PathBuf;

use maille_io::{Asset, ReadOptions, read};

/// The GLB files of `MAILLE_MODELS`; none, said plainly, where it is not set.
fn models() -> Vec<PathBuf> {
    let Some(folder) = std::env::var_os("MAILLE_MODELS") else {
        eprintln!("MAILLE_MODELS is not set: the tests on real models are left out");
        return Vec::new();
    };
    let folders = ["textured", "skinned"].map(|name| PathBuf::from(&folder).join(name));
    let entries =
        folders.iter().flat_map(|folder| std::fs::read_dir(folder).expect("the folder of models can be read"));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry can be read").path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "glb"));
    files.sort();
    files
}

fn read_model(path: &PathBuf) -> Asset {
    read(path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn every_model_is_read() {
    for path in models() {
        let asset = read_model(&path);
        assert!(asset.triangle_count() > 0, "{} has triangles", path.display());
        for mesh in &asset.meshes {
            mesh.mesh.check().expect("what is read is valid");
            eprintln!(
                "{}: {} {} wedges {} vertices {} triangles, slots {:?}",
                path.display(),
                mesh.name,
                mesh.mesh.wedge_count(),
                mesh.mesh.vertex_count(),
                mesh.mesh.triangle_count(),
                mesh.mesh.material_names.len()
            );
        }
        let bounds = asset.merged_positions().bounds().expect("something is drawn");
        eprintln!("{} {:?} {:?}", asset.triangle_count(), bounds, asset.warnings);
    }
}
