//! The PLY, OBJ, STL and OFF files of the public model set, damaged ones among them: read, written in every format,
//! and read again.

use std::path::PathBuf;

use maille::Mesh;
use maille_io::{ReadOptions, WriteOptions, read, write};

/// Files of the set that hold nothing of use, or an index that is out of range.
const REFUSED: [&str; 2] = ["empty.stl", "synth_fandisk_index_out_of_range.ply"];

/// The files of some folders of `MAILLE_MODELS`; none, said plainly, where it is not set.
#[expect(clippy::print_stderr, reason = "a test that is left out says so")]
fn models(folders: &[&str]) -> Vec<PathBuf> {
    let Some(root) = std::env::var_os("MAILLE_MODELS") else {
        eprintln!("MAILLE_MODELS is not set: the tests on real models are left out");
        return Vec::new();
    };
    let folders = folders.iter().map(|name| PathBuf::from(&root).join(name));
    let entries = folders.flat_map(|folder| std::fs::read_dir(folder).expect("the folder of models can be read"));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry can be read").path()).collect();
    files.sort();
    files
}

fn name_of(path: &std::path::Path) -> String {
    path.file_name().expect("a file of a folder has a name").to_string_lossy().into_owned()
}

fn assert_sound(mesh: &Mesh, name: &str) {
    assert_eq!(mesh.check(), Ok(()), "{name}");
    assert!(mesh.triangle_count() > 0 && mesh.positions.as_flattened().iter().all(|x| x.is_finite()), "{name}");
    let values = mesh.wedge_attributes.iter().filter_map(|a| a.as_f32());
    assert!(values.flatten().all(|x| x.is_finite()), "{name}");
}

#[test]
fn all_models_are_read_and_survive_every_format() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for path in models(&["dirty", "static"]) {
        let name = name_of(&path);
        let asset = match read(&path, &ReadOptions::default()) {
            Ok(asset) => asset,
            Err(error) => {
                assert!(REFUSED.contains(&name.as_str()), "{error}");
                assert!(error.to_string().contains(&name), "{error}");
                continue;
            }
        };
        assert!(!REFUSED.contains(&name.as_str()), "{name}");
        assert_eq!(asset.meshes.len(), 1);
        assert_sound(&asset.meshes[0].mesh, &name);
        for target in ["a.ply", "a.obj", "a.stl", "a.off"] {
            let target = folder.path().join(target);
            write(&asset, &target, &WriteOptions::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
            let back = read(&target, &ReadOptions::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_sound(&back.meshes[0].mesh, &name);
            let corners = |mesh: &Mesh| (0..mesh.triangle_count()).map(|t| mesh.triangle_points(t)).collect::<Vec<_>>();
            assert_eq!(corners(&back.meshes[0].mesh), corners(&asset.meshes[0].mesh), "{name} as {}", target.display());
        }
    }
}

#[test]
fn light_fields_come_back_byte_by_byte() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for path in models(&["lightfield"]) {
        let asset = read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        let target = folder.path().join(name_of(&path));
        write(&asset, &target, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        let bytes = |path| std::fs::read(path).expect("it has just been read or written");
        assert!(bytes(&target) == bytes(&path), "{}", path.display());
    }
}
