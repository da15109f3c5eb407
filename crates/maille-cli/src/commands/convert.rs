//! `maille convert`

use std::path::Path;

use maille_io::{Asset, Format, WriteOptions};
use serde_json::json;

use crate::args::ConvertArgs;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

pub(crate) fn run(args: &ConvertArgs) -> Result<(), Failure> {
    let path = super::destination(&args.input, &args.destination)?;
    if args.text && Format::from_path(&path) == Some(Format::Glb) {
        let message = "--text: a GLB is always binary; write .gltf for text";
        return Err(Failure::Usage(format!("{}: {message}", path.display())));
    }
    let session = Session::start(&args.common)?;
    let asset = match args.level {
        None => {
            let asset = session.read(&args.input)?;
            let holds_levels = matches!(Format::from_path(&path), Some(Format::Glb | Format::Gltf));
            if holds_levels { asset } else { super::without_levels(asset, &session) }
        }
        Some(level) => at_level(session.read(&args.input)?, level, &args.input)?,
    };
    let written = session.write(&asset, &path, &WriteOptions { text: args.text, ..WriteOptions::default() })?;
    let json = || {
        json!({
            "input": args.input.display().to_string(),
            "output": path.display().to_string(),
            "files": output::paths(&written.files),
            "meshes": asset.meshes.len(),
            "triangles": asset.triangle_count(),
            "warnings": ([&asset.warnings[..], &written.warnings[..]].concat()),
        })
    };
    let triangles = output::count(asset.triangle_count());
    session.result(json, || format!("wrote {}, {triangles} triangles\n", output::written(&written.files)))
}

/// One level of a chain, 0 being the original.
fn at_level(asset: Asset, level: usize, path: &Path) -> Result<Asset, Failure> {
    let split = asset.split_levels().unwrap_or_else(|| Ok((asset, Vec::new())));
    let (whole, levels) = split.map_err(|reason| Failure::about(path, reason))?;
    let count = levels.len();
    match level.checked_sub(1) {
        None => Ok(whole),
        Some(k) => match levels.get(k) {
            Some(level) => Ok(whole.at_level(level)),
            None => Err(Failure::Usage(format!(
                "--level: there is no level {level}; there are {count} (0 is the original)"
            ))),
        },
    }
}
