//! Every file in the folder that `MAILLE_MODELS` names, damaged ones too: read, simplify, write, read again, compare.
//! Nothing may panic; what is not damaged must go all the way.

#![expect(clippy::print_stderr, reason = "a test that tells what it did and what it left out")]

use std::path::{Path, PathBuf};

use maille::Control;
use maille::measure::{CompareOptions, compare};
use maille::progressive::ProgressiveMesh;
use maille_io::{
    Asset, AssetOptions, Format, Instance, PoseSet, ProgressiveAsset, ReadOptions, WriteOptions, simplify_asset,
};

const PERCENTS: [usize; 3] = [50, 10, 1];

#[test]
fn every_model_goes_all_the_way() {
    let Some(folder) = std::env::var_os("MAILLE_MODELS").map(PathBuf::from) else {
        eprintln!("left out: MAILLE_MODELS is not set to a folder of models");
        return;
    };
    let mut files = Vec::new();
    collect(&folder, &mut files);
    assert!(!files.is_empty(), "{} holds no models", folder.display());
    let scratch = tempfile::tempdir().expect("the system has a folder for temporary files");
    let mut failures = Vec::new();
    for file in &files {
        let start = std::time::Instant::now();
        let name = file.strip_prefix(&folder).unwrap_or(file).display().to_string();
        let outcome = all_the_way(file, scratch.path());
        eprintln!(
            "{name}: {}, {:.1} s",
            outcome.as_ref().map_or_else(|e| e.as_str(), |_| "ok"),
            start.elapsed().as_secs_f64()
        );
        if let Err(problem) = outcome
            && !name.starts_with("dirty")
        {
            failures.push(format!("{name}: {problem}"));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Triangles of the largest models whose progressive meshes are looked at: all the set would take a quarter of an hour.
const MOST_TRIANGLES: usize = 60_000;

#[test]
fn progressive_meshes_go_to_the_base_and_back_exactly() {
    let Some(folder) = std::env::var_os("MAILLE_MODELS").map(PathBuf::from) else {
        eprintln!("left out: MAILLE_MODELS is not set to a folder of models");
        return;
    };
    let mut files = Vec::new();
    collect(&folder, &mut files);
    assert!(!files.is_empty(), "{} holds no models", folder.display());
    for file in files {
        let name = file.strip_prefix(&folder).unwrap_or(&file).display().to_string();
        let asset = match maille_io::read(&file, &ReadOptions::default()) {
            Ok(asset) => asset,
            Err(error) => {
                eprintln!("left out: {error}");
                continue;
            }
        };
        let triangles = asset.triangle_count();
        if triangles > MOST_TRIANGLES {
            eprintln!("left out: {name} ({triangles} triangles)");
            continue;
        }
        let made = ProgressiveAsset::new(asset, &Default::default(), &PoseSet::Bind, Control::default());
        let made = made.unwrap_or_else(|error| panic!("{name}: {error}"));
        for mesh in made.meshes() {
            let mut moved = mesh.clone();
            moved.seek(0);
            let finest = moved.to_mesh();
            moved.seek(usize::MAX);
            assert!(moved == *mesh, "{name}: there and back");
            moved.seek(0);
            assert!(moved.to_mesh() == finest, "{name}: the finest level again");
            let again = ProgressiveMesh::from_bytes(&moved.to_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(again == moved, "{name}: by its bytes");
        }
    }
}

/// Files with an extension of ours, below a folder, in the order of their names.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("the folder can be listed").path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, files);
        } else if Format::from_path(&path).is_some() {
            files.push(path);
        }
    }
}

fn all_the_way(file: &Path, scratch: &Path) -> Result<(), String> {
    let read = |path: &Path| maille_io::read(path, &ReadOptions::default()).map_err(|error| error.to_string());
    let original = read(file)?;
    let before = original.triangle_count();
    for percent in PERCENTS {
        let mut asset = original.clone();
        let mut options = AssetOptions::default();
        options.simplify.target.triangles = Some(before * percent / 100);
        let report =
            simplify_asset(&mut asset, &options, Control::default()).map_err(|error| format!("simplify: {error}"))?;
        assert_eq!(report.triangles_out, asset.drawn_triangle_count(), "{}", file.display());
        if asset.triangle_count() == 0 {
            continue;
        }
        let written = scratch.join("written").with_extension(file.extension().unwrap_or_default());
        maille_io::write(&asset, &written, &WriteOptions::default()).map_err(|error| error.to_string())?;
        let is_gltf = matches!(Format::from_path(&written), Some(Format::Glb | Format::Gltf));
        check(&original, &asset, &read(&written)?, is_gltf).map_err(|problem| format!("at {percent} %: {problem}"))?;
    }
    Ok(())
}

/// What was read again is what was written, and not far from the original.
fn check(original: &Asset, written: &Asset, again: &Asset, is_gltf: bool) -> Result<(), String> {
    // glTF has no mesh without triangles: one that lost them all is written as a triangle without area
    let gone = |instance: &&Instance| written.meshes[instance.mesh].mesh.triangle_count() == 0;
    let gone = if is_gltf { written.instances.iter().filter(gone).count() } else { 0 };
    let drawn = |asset: &Asset| asset.flattened().triangle_count();
    if drawn(again) != drawn(written) + gone {
        return Err(format!("{} triangles written, {} read again", drawn(written), drawn(again)));
    }
    let options = CompareOptions { samples: 2000, ..CompareOptions::default() };
    let comparison = compare(&original.flattened(), &again.flattened(), &options, Control::default());
    let comparison = comparison.map_err(|error| format!("compare: {error}"))?;
    let far = comparison.relative(comparison.mean());
    // a percent of a triangle soup may be anywhere within its box, but not beyond
    if far.is_finite() && far <= 1.0 { Ok(()) } else { Err(format!("the mean distance is {far} of the diagonal")) }
}
