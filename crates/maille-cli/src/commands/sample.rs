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
    let asset = maille_io::sample(sample, args.triangles.unwrap_or(sample.default_triangles()).clamp(FEWEST, MOST));
    drop(spinner);
    session.write(&asset, path, &WriteOptions::default())?;
    if args.common.json {
        return Ok(output::print_json(&json!({
            "name": name,
            "output": path.display().to_string(),
            "triangles": asset.triangle_count(),
            "vertices": asset.meshes.iter().map(|named| named.mesh.vertex_count()).sum::<usize>(),
        }))?);
    }
    let triangles = output::count(asset.triangle_count());
    Ok(output::print(&format!("wrote {}, {triangles} triangles\n", output::written(path)))?)
}
