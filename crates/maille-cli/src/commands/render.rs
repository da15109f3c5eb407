//! `maille render`

use serde_json::json;

use crate::args::{Background, RenderArgs, UpAxis};
use crate::failure::Failure;
use crate::output;
use crate::render::{Backdrop, Camera, Frame, Lighting, Scene, Style, draw};
use crate::session::Session;

pub(crate) fn run(args: &RenderArgs) -> Result<(), Failure> {
    if args.output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("png")) {
        return Err(Failure::Usage(format!(
            "{}: pictures are PNG, so the name must end in .png",
            args.output.display()
        )));
    }
    let session = Session::start(&args.common)?;
    let asset = session.read(&args.file)?;
    let scene = Scene::new(&asset, &Frame::around(&asset, args.up == UpAxis::Z));
    let camera = Camera::framing(&scene.points, args.size, args.view.0, args.view.1);
    session.checkpoint()?;
    let lighting = Lighting::new(&scene, &camera);
    session.checkpoint()?;
    let style = Style {
        flat: args.flat,
        wireframe: args.wireframe,
        clay: args.clay,
        backdrop: match args.background {
            Background::Studio => Backdrop::Studio,
            Background::Transparent => Backdrop::Transparent,
        },
    };
    let picture = draw(&scene, &lighting, &camera, &style);
    session.write_bytes(&picture.to_png(), &args.output)?;
    let json = || {
        json!({
            "input": args.file.display().to_string(),
            "output": args.output.display().to_string(),
            "width": picture.width,
            "height": picture.height,
            "triangles": scene.triangles.len(),
        })
    };
    session.result(json, || format!("wrote {}\n", output::written(&[&args.output])))
}
