//! `maille sample`

use std::path::Path;

use maille::samples::Sample;
use maille_io::WriteOptions;
use serde_json::json;

use crate::args::SampleArgs;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

/// Smallest and largest number of triangles that can be asked for.
const FEWEST: usize = 100;
const MOST: usize = 100_000_000;
/// How far the number may be from the one asked for without a word.
const TOLERANCE: f64 = 0.25;

pub(crate) fn run(args: &SampleArgs) -> Result<(), Failure> {
    match (&args.name, &args.output) {
        (Some(name), Some(path)) if !args.list => make(args, name, path),
        _ => list(args),
    }
}

fn list(args: &SampleArgs) -> Result<(), Failure> {
    if args.common.json {
        return Ok(output::print_json(&json!({ "names": Sample::ALL.map(Sample::name) }))?);
    }
    let rows = Sample::ALL.iter().map(|sample| format!("{:<12} {}\n", sample.name(), sample.about()));
    Ok(output::print(&rows.collect::<String>())?)
}

fn make(args: &SampleArgs, name: &str, path: &Path) -> Result<(), Failure> {
    let Some(sample) = Sample::from_name(name) else {
        let known = Sample::ALL.map(Sample::name).join(", ");
        return Err(Failure::Usage(format!("there is no sample '{name}'; there are {known}")));
    };
    super::check_output(path)?;
    let session = Session::start(&args.common)?;
    let spinner = session.spinner(&format!("making the {name}"));
    let wanted = args.triangles.unwrap_or(sample.default_triangles());
    let asset = maille_io::sample(sample, wanted.clamp(FEWEST, MOST));
    drop(spinner);
    let triangles = asset.triangle_count();
    if args.triangles.is_some() && wanted.abs_diff(triangles) as f64 > TOLERANCE * wanted as f64 {
        let (wanted, triangles) = (output::count(wanted), output::count(triangles));
        session.note(&format!("{wanted} triangles are asked for, but the {name} is made of {triangles}"));
    }
    let written = session.write(&asset, path, &WriteOptions::default())?;
    let json = || {
        json!({
            "name": name,
            "output": path.display().to_string(),
            "files": output::paths(&written.files),
            "triangles": triangles,
            "vertices": asset.meshes.iter().map(|named| named.mesh.vertex_count()).sum::<usize>(),
            "warnings": written.warnings,
        })
    };
    let text = || format!("wrote {}, {} triangles\n", output::written(&written.files), output::count(triangles));
    session.result(json, text)
}
