//! `maille convert`

use maille_io::WriteOptions;
use serde_json::json;

use crate::args::ConvertArgs;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

pub(crate) fn run(args: &ConvertArgs) -> Result<(), Failure> {
    super::check_output(&args.output)?;
    let session = Session::start(&args.common)?;
    let asset = session.read(&args.input)?;
    session.write(&asset, &args.output, &WriteOptions { text: args.text, ..WriteOptions::default() })?;
    if args.common.json {
        return Ok(output::print_json(&json!({
            "input": args.input.display().to_string(),
            "output": args.output.display().to_string(),
            "meshes": asset.meshes.len(),
            "triangles": asset.triangle_count(),
            "warnings": asset.warnings,
        }))?);
    }
    let triangles = output::count(asset.triangle_count());
    Ok(output::print(&format!("wrote {}, {triangles} triangles\n", output::written(&args.output)))?)
}
