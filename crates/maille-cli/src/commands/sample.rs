//! `maille sample`

use std::path::Path;

use maille::samples;
use maille_io::{Asset, WriteOptions};
use serde_json::json;

use crate::args::SampleArgs;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

/// A model that is made in code.
struct Model {
    name: &'static str,
    about: &'static str,
    /// Triangles, unless the user asks for another number.
    triangles: usize,
    make: fn(usize) -> Asset,
}

const MODELS: [Model; 2] = [
    Model {
        name: "statue",
        about: "a scanned cat on a plinth: one closed surface with fine noise, any size",
        triangles: 100_000,
        make: |triangles| Asset::from_mesh("statue", samples::statue(triangles)),
    },
    Model {
        name: "mechanical",
        about: "a gear on a ribbed flange: flat and round faces, sharp edges, holes, long triangles",
        triangles: 30_000,
        make: |triangles| Asset::from_mesh("mechanical", samples::mechanical(triangles)),
    },
];

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
        return Ok(output::print_json(&json!({ "names": MODELS.map(|model| model.name) }))?);
    }
    let rows = MODELS.iter().map(|model| format!("{:<12} {}\n", model.name, model.about));
    Ok(output::print(&rows.collect::<String>())?)
}

fn make(args: &SampleArgs, name: &str, path: &Path) -> Result<(), Failure> {
    let Some(model) = MODELS.iter().find(|model| model.name == name) else {
        let known = MODELS.map(|model| model.name).join(", ");
        return Err(Failure::Usage(format!("there is no sample '{name}'; there are {known}")));
    };
    super::check_output(path)?;
    let session = Session::start(&args.common)?;
    let spinner = session.spinner(&format!("making the {name}"));
    let asset = (model.make)(args.triangles.unwrap_or(model.triangles).clamp(FEWEST, MOST));
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
