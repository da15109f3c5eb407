//! glTF files of the public model set: read, written, and read again.

#![expect(clippy::print_stderr, reason = "says what is left out")]

use std::path::{Path, PathBuf};

use maille::Attribute;
use maille_io::{Asset, ReadOptions, WriteOptions, read, write};

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

fn read_model(path: &Path) -> Asset {
    read(path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// Writes to a temporary file and reads that; with `MAILLE_KEEP` set, a copy stays there for other programs to check.
fn round_trip(asset: &Asset, name: &str) -> Asset {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join(name);
    write(asset, &path, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    if let Some(keep) = std::env::var_os("MAILLE_KEEP") {
        for entry in std::fs::read_dir(folder.path()).expect("the folder can be read") {
            let entry = entry.expect("an entry can be read");
            std::fs::copy(entry.path(), PathBuf::from(&keep).join(entry.file_name())).expect("the copy can be written");
        }
    }
    read_model(&path)
}

fn file_name(path: &Path) -> String {
    path.file_name().expect("models have names").to_string_lossy().into_owned()
}

#[test]
fn models_are_valid_and_drawn_somewhere() {
    for path in models() {
        let asset = read_model(&path);
        for mesh in &asset.meshes {
            mesh.mesh.check().expect("what is read is valid");
        }
        assert!(asset.merged_positions().diagonal() > 0.0, "{} is drawn", path.display());
    }
}

#[test]
fn what_is_not_changed_comes_back_equal() {
    for path in models() {
        let asset = read_model(&path);
        for name in [file_name(&path), file_name(&path).replace(".glb", ".gltf")] {
            let again = round_trip(&asset, &format!("same-{name}"));
            assert_eq!(asset.meshes.len(), again.meshes.len(), "{}", path.display());
            for (a, b) in asset.meshes.iter().zip(&again.meshes) {
                assert!(a.mesh == b.mesh, "mesh '{}' of {}", a.name, path.display());
            }
            assert_eq!(asset.instances.len(), again.instances.len());
        }
    }
}

#[test]
fn a_changed_mesh_comes_back_as_it_was_written() {
    for path in models() {
        let mut asset = read_model(&path);
        for mesh in &mut asset.meshes {
            let keep = mesh.mesh.triangle_count().div_ceil(2);
            mesh.mesh.triangles.truncate(keep);
            if !mesh.mesh.triangle_materials.is_empty() {
                mesh.mesh.triangle_materials.truncate(keep);
            }
        }
        let again = round_trip(&asset, &format!("half-{}", file_name(&path)));
        for (a, b) in asset.meshes.iter().zip(&again.meshes) {
            let what = format!("mesh '{}' of {}", a.name, path.display());
            assert_eq!(a.mesh.triangle_count(), b.mesh.triangle_count(), "{what}");
            for triangle in 0..a.mesh.triangle_count() {
                assert_eq!(a.mesh.triangle_points(triangle), b.mesh.triangle_points(triangle), "{what}");
            }
            // attributes of primitives that have lost all their triangles go with them
            let known = |attribute: &Attribute| a.mesh.wedge_attribute(&attribute.semantic).is_some();
            assert!(b.mesh.wedge_attributes.iter().all(known), "{what}");
        }
    }
}
