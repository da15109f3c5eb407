//! `maille demo`: the main job on a built-in model, with a report.

mod history;
mod plot;
mod report;

use std::path::Path;
use std::time::Instant;

use maille::measure::{CompareOptions, Comparison, compare, distances_at_vertices, heatmap};
use maille::simplify::SimplifyOptions;
use maille::{Mesh, samples};
use maille_io::{Asset, AssetOptions, WriteOptions, simplify_asset};
use serde_json::json;

use crate::args::DemoArgs;
use crate::failure::Failure;
use crate::output;
use crate::render::{Backdrop, Camera, Frame, Lighting, Scene, Style, draw};
use crate::session::Session;

/// Triangles of the statue: enough to be worth simplifying, few enough for an old laptop.
const TRIANGLES: usize = 100_000;
const PERCENTS: [u32; 5] = [50, 25, 10, 3, 1];
const SAMPLES: u64 = 300_000;
/// Pictures of the report, in pixels: drawn at half the size, so that they stay sharp on fine screens.
const PICTURE: (u32, u32) = (400, 560);
const VIEW: (f32, f32) = (-35.0, 10.0);
/// The decades of the error scale, as shares of the diagonal.
const COLDEST: f64 = 1e-6;
const HOTTEST: f64 = 1e-2;

pub(crate) fn run(args: &DemoArgs) -> Result<(), Failure> {
    let session = Session::start(&args.common)?;
    super::make_folder(&args.output)?;
    let start = Instant::now();
    let studio = Studio::new(&session)?;
    let name = "statue.glb";
    session.write(&studio.original, &args.output.join(name), &WriteOptions::default())?;
    let first = studio.original_level(name, &args.output);
    let mut levels = vec![first];
    for (i, percent) in PERCENTS.into_iter().enumerate() {
        session.progress("simplifying, measuring and drawing", i as f32 / PERCENTS.len() as f32);
        levels.push(studio.level(&session, percent, &args.output)?);
    }
    let history = history::run(&session)?;
    let report = report::Report { levels: &levels, history: &history, samples: SAMPLES };
    let path = args.output.join("report.html");
    session.write_bytes(report.html().as_bytes(), &path)?;
    let seconds = start.elapsed().as_secs_f64();
    let json = || {
        json!({
            "report": path.display().to_string(),
            "seconds": seconds,
            "levels": levels.iter().map(Level::json).collect::<Vec<_>>(),
        })
    };
    session.result(json, || summary(&levels, &path, seconds))
}

fn summary(levels: &[Level], path: &Path, seconds: f64) -> String {
    let mut rows = vec![["triangles", "file", "time", "mean", "RMS", "maximum"].map(str::to_owned).to_vec()];
    rows.extend(levels.iter().map(|level| {
        let percent = |distance: fn(&Comparison) -> f64| match &level.comparison {
            Some(c) => format!("{}%", output::number(100.0 * c.relative(distance(c)))),
            None => String::new(),
        };
        vec![
            output::count(level.triangles),
            output::bytes(level.bytes),
            level.seconds.map_or(String::new(), output::seconds),
            percent(Comparison::mean),
            percent(Comparison::rms),
            percent(Comparison::max),
        ]
    }));
    let table = output::table(&rows);
    let path = path.display();
    format!("{table}\nDistances are in percent of the diagonal.\nDone in {seconds:.1} s. Open {path} in a browser.\n")
}

/// The model, and what all its pictures share.
struct Studio {
    original: Asset,
    frame: Frame,
    camera: Camera,
    scene: Scene,
    lighting: Lighting,
}

/// One level of detail, measured and drawn.
struct Level {
    percent: u32,
    file: String,
    bytes: u64,
    triangles: usize,
    /// Of the simplification; `None` for the original.
    seconds: Option<f64>,
    /// With the original; `None` for the original itself.
    comparison: Option<Comparison>,
    pictures: Pictures,
}

/// PNG files.
struct Pictures {
    shaded: Vec<u8>,
    wireframe: Vec<u8>,
    error: Vec<u8>,
}

impl Level {
    fn json(&self) -> serde_json::Value {
        let c = self.comparison.as_ref();
        json!({
            "file": self.file,
            "bytes": self.bytes,
            "triangles": self.triangles,
            "seconds": self.seconds,
            "mean": c.map(Comparison::mean),
            "rms": c.map(Comparison::rms),
            "max": c.map(Comparison::max),
            "diagonal": c.map(|c| c.diagonal),
        })
    }
}

impl Studio {
    fn new(session: &Session) -> Result<Self, Failure> {
        let spinner = session.spinner("carving the statue");
        let original = Asset::from_mesh("statue", samples::statue(TRIANGLES));
        let frame = Frame::around(&original, false);
        let scene = Scene::new(&original, &frame);
        let camera = Camera::framing(&scene.points, PICTURE, VIEW.0, VIEW.1);
        let lighting = Lighting::new(&scene, &camera);
        drop(spinner);
        session.checkpoint()?;
        Ok(Self { original, frame, camera, scene, lighting })
    }

    fn mesh(&self) -> &Mesh {
        &self.original.meshes[0].mesh
    }

    fn original_level(&self, file: &str, folder: &Path) -> Level {
        let nowhere = vec![0.0; self.mesh().vertex_count()];
        Level {
            percent: 100,
            file: file.to_owned(),
            bytes: file_size(&folder.join(file)),
            triangles: self.mesh().triangle_count(),
            seconds: None,
            comparison: None,
            pictures: self.pictures(&self.scene, &self.lighting, &nowhere),
        }
    }

    fn level(&self, session: &Session, percent: u32, folder: &Path) -> Result<Level, Failure> {
        let mut asset = self.original.clone();
        let mut simplify = SimplifyOptions::default();
        simplify.target.triangles = Some(self.mesh().triangle_count() * percent as usize / 100);
        let start = Instant::now();
        let options = AssetOptions { simplify, ..AssetOptions::default() };
        simplify_asset(&mut asset, &options, session.quiet_control()).map_err(|error| failed(session, error))?;
        let seconds = start.elapsed().as_secs_f64();
        let file = format!("statue-{percent}.glb");
        session.write(&asset, &folder.join(&file), &WriteOptions::default())?;

        let (a, b) = (self.mesh(), &asset.meshes[0].mesh);
        let measure = CompareOptions { samples: SAMPLES, ..CompareOptions::default() };
        let comparison = compare(a, b, &measure, session.quiet_control()).map_err(|error| failed(session, error))?;
        let distances = distances_at_vertices(a, b, session.quiet_control()).map_err(|error| failed(session, error))?;
        let scene = Scene::new(&asset, &self.frame);
        let lighting = Lighting::new(&scene, &self.camera);
        session.cancelled()?;
        Ok(Level {
            percent,
            bytes: file_size(&folder.join(&file)),
            file,
            triangles: b.triangle_count(),
            seconds: Some(seconds),
            comparison: Some(comparison),
            pictures: self.pictures(&scene, &lighting, &distances),
        })
    }

    /// Draws a level, and the original coloured by its distances to it.
    fn pictures(&self, scene: &Scene, lighting: &Lighting, distances: &[f32]) -> Pictures {
        let style = Style { flat: false, wireframe: false, clay: true, backdrop: Backdrop::Transparent };
        let png =
            |scene: &Scene, lighting: &Lighting, style: Style| draw(scene, lighting, &self.camera, &style).to_png();
        let coloured = Asset::from_mesh("error", heatmap(self.mesh(), &self.heat(distances), [0.0, 1.0]));
        let coloured = Scene::new(&coloured, &self.frame);
        Pictures {
            shaded: png(scene, lighting, style),
            wireframe: png(scene, lighting, Style { wireframe: true, flat: true, ..style }),
            error: png(&coloured, &self.lighting, Style { clay: false, ..style }),
        }
    }

    /// Places of distances on the logarithmic scale of the report, 0 to 1.
    fn heat(&self, distances: &[f32]) -> Vec<f32> {
        let diagonal = self.mesh().diagonal();
        let share = |&distance: &f32| {
            let relative = (f64::from(distance) / diagonal).max(COLDEST);
            ((relative / COLDEST).ln() / (HOTTEST / COLDEST).ln()) as f32
        };
        distances.iter().map(share).collect()
    }
}

fn file_size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |meta| meta.len())
}

/// What stops work on a model of our own: Ctrl-C, or a fault of ours.
fn failed(session: &Session, error: impl std::fmt::Display) -> Failure {
    match session.cancelled() {
        Err(cancelled) => cancelled,
        Ok(()) => Failure::Refused(format!("the demo failed: {error}")),
    }
}
