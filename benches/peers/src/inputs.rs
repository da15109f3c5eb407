//! The meshes to run on: samples made in code, and files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use maille::Mesh;
use maille::mesh::WeldOptions;
use maille::samples::Sample;
use maille_io::{Format, ReadOptions};

/// What runs without any download when no input is named.
const SAMPLES: [&str; 2] = ["statue:1000000", "mechanical:250000"];

/// A mesh of positions and triangles only, and what to call it.
pub struct Input {
    pub name: String,
    pub mesh: Mesh,
}

/// The inputs named on the command line (files, folders, `SAMPLE` or `SAMPLE:TRIANGLES`); without any, the samples and
/// the folder `static` of `MAILLE_MODELS`.
pub fn names(given: &[String]) -> Result<Vec<String>> {
    let mut names: Vec<String> = given.to_vec();
    if names.is_empty() {
        names.extend(SAMPLES.map(str::to_owned));
        match std::env::var("MAILLE_MODELS") {
            Ok(models) => names.push(format!("{models}/static")),
            Err(_) => eprintln!("MAILLE_MODELS is not set: the real models are left out"),
        }
    }
    let mut all = Vec::new();
    for name in names {
        if Path::new(&name).is_dir() {
            all.extend(files(Path::new(&name))?);
        } else {
            all.push(name);
        }
    }
    Ok(all)
}

/// Makes or reads one of the inputs.
pub fn open(name: &str) -> Result<Input> {
    let path = Path::new(name);
    if !path.is_file() {
        return sample(name);
    }
    let asset = maille_io::read(path, &ReadOptions::default())?;
    let mesh = plain(asset.merged_positions()).with_context(|| name.to_owned())?;
    let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    Ok(Input { name, mesh })
}

fn files(folder: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    paths.retain(|path| path.is_file() && Format::from_path(path).is_some());
    paths.sort();
    Ok(paths.iter().map(|path| path.to_string_lossy().into_owned()).collect())
}

fn sample(name: &str) -> Result<Input> {
    let (kind, triangles) = match name.split_once(':') {
        Some((kind, count)) => (kind, Some(count.parse().with_context(|| format!("{name}: the number of triangles"))?)),
        None => (name, None),
    };
    let sample = Sample::from_name(kind).with_context(|| format!("{name} is neither a file nor a sample"))?;
    let asset = maille_io::sample(sample, triangles.unwrap_or(sample.default_triangles()));
    Ok(Input { name: kind.to_owned(), mesh: plain(asset.merged_positions())? })
}

/// What all simplifiers understand: joined positions and triangles of three different ones, nothing else.
fn plain(mut mesh: Mesh) -> Result<Mesh> {
    mesh.check_finite()?;
    mesh.weld(&WeldOptions::EXACT);
    let corners = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t));
    let triangles: Vec<_> = corners.filter(|&[a, b, c]| a != b && b != c && c != a).collect();
    ensure!(!triangles.is_empty(), "there are no triangles");
    compact(&mesh.positions, triangles)
}

/// Positions and triangles without those positions that no triangle uses, in the order in which they are used.
pub fn compact(positions: &[[f32; 3]], mut triangles: Vec<[u32; 3]>) -> Result<Mesh> {
    const UNSEEN: u32 = u32::MAX;
    let mut renumber = vec![UNSEEN; positions.len()];
    let mut kept = Vec::new();
    for vertex in triangles.as_flattened_mut() {
        let new = renumber.get_mut(*vertex as usize).context("a triangle names a vertex that is not there")?;
        if *new == UNSEEN {
            *new = kept.len() as u32;
            kept.push(positions[*vertex as usize]);
        }
        *vertex = *new;
    }
    Ok(Mesh::from_triangles(kept, triangles)?)
}
