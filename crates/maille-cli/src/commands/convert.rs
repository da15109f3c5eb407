//! `maille convert`

use maille_io::{Format, WriteOptions};
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
    let asset = session.read(&args.input)?;
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
