//! `maille demo`: the main jobs on built-in models, with a report.

mod character;
mod history;
mod report;

use std::path::Path;
use std::time::Instant;

use maille::measure::{Comparison, distances_at_vertices};
use maille::samples;
use maille::simplify::{SimplifyOptions, Target};
use maille_io::{Asset, AssetOptions, WriteOptions};
use serde_json::json;

use self::character::Character;
use super::report::{Card, HeatScale, Look, Model, Shot, Studio, Trials, count, percent};
use crate::args::DemoArgs;
use crate::failure::Failure;
use crate::output;
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
    let original = carve(&session)?;
    let studio = Studio::new(&original, false, &[VIEW], PICTURE);
    let trials = Trials {
        session: &session,
        path: Path::new("statue"),
        original: &original,
        surface: &studio.surface,
        samples: SAMPLES,
        repeat: 1,
    };
    let scale = scale(&studio);
    let demo = Demo { trials, studio: &studio, scale, folder: &args.output };
    let mut levels = vec![demo.original()?];
    for (i, percent) in PERCENTS.into_iter().enumerate() {
        session.progress("simplifying, measuring and drawing", i as f32 / PERCENTS.len() as f32);
        levels.push(demo.level(percent)?);
    }
    let spinner = session.spinner("moving a character");
    let character = Character::run(&session, &args.output)?;
    drop(spinner);
    let history = history::run(&session)?;
    let report = report::Report { levels: &levels, character: &character, history: &history, samples: SAMPLES, scale };
    let path = args.output.join("report.html");
    session.write_bytes(report.html().as_bytes(), &path)?;
    let seconds = start.elapsed().as_secs_f64();
    let json = || {
        json!({
            "report": path.display().to_string(),
            "seconds": seconds,
            "levels": levels.iter().map(Level::json).collect::<Vec<_>>(),
            "character": character.json(),
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

fn carve(session: &Session) -> Result<Asset, Failure> {
    let spinner = session.spinner("carving the statue");
    let original = Asset::from_mesh("statue", samples::statue(TRIANGLES));
    drop(spinner);
    session.checkpoint()?;
    Ok(original)
}

fn scale(studio: &Studio<'_>) -> HeatScale {
    let diagonal = studio.surface.diagonal();
    HeatScale { low: Some(COLDEST * diagonal), high: HOTTEST * diagonal, diagonal: Some(diagonal) }
}

/// What all levels share.
struct Demo<'a> {
    trials: Trials<'a>,
    studio: &'a Studio<'a>,
    scale: HeatScale,
    folder: &'a Path,
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
    card: Card,
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

impl Demo<'_> {
    fn original(&self) -> Result<Level, Failure> {
        let (surface, file) = (self.trials.surface, "statue.glb");
        let bytes = self.write(self.trials.original, file)?;
        let nowhere = vec![0.0; surface.vertex_count()];
        let triangles = surface.triangle_count();
        let card = self.card(&self.studio.original, &nowhere, triangles, "the original");
        Ok(Level { percent: 100, file: file.to_owned(), bytes, triangles, seconds: None, comparison: None, card })
    }

    fn level(&self, share: u32) -> Result<Level, Failure> {
        let (session, surface) = (self.trials.session, self.trials.surface);
        let triangles = Some(surface.triangle_count() * share as usize / 100);
        let target = Target { triangles, max_error: None };
        let simplify = SimplifyOptions { target, ..SimplifyOptions::default() };
        let trial = self.trials.run(&AssetOptions { simplify, ..AssetOptions::default() })?;
        let file = format!("statue-{share}.glb");
        let bytes = self.write(&trial.asset, &file)?;
        let distances = distances_at_vertices(surface, &trial.surface(), session.quiet_control());
        let distances = distances.map_err(|error| self.trials.failure(&error))?;
        let c = &trial.comparison;
        let caption = format!("mean error {}", percent(c.relative(c.mean())));
        let triangles = trial.report.triangles_out;
        let card = self.card(&self.studio.model(&trial.asset), &distances, triangles, &caption);
        session.cancelled()?;
        let (seconds, comparison) = (Some(trial.seconds), Some(trial.comparison));
        Ok(Level { percent: share, file, bytes, triangles, seconds, comparison, card })
    }

    /// Writes a level; gives the size of its file.
    fn write(&self, asset: &Asset, file: &str) -> Result<u64, Failure> {
        let path = self.folder.join(file);
        self.trials.session.write(asset, &path, &WriteOptions::default())?;
        Ok(std::fs::metadata(path).map_or(0, |meta| meta.len()))
    }

    /// Draws a level, and the original coloured by its distances to it.
    fn card(&self, model: &Model, distances: &[f32], triangles: usize, caption: &str) -> Card {
        let shot =
            |look, what: &str, png| Shot { look, alt: format!("{what} of the statue with {triangles} triangles"), png };
        let heat = self.studio.heat(&self.studio.original, self.trials.surface, distances, &self.scale);
        let mut shots = vec![
            shot(Look::Shaded, "Shaded picture", self.studio.picture(model, 0, Look::Shaded)),
            shot(Look::Wireframe, "Wireframe", self.studio.picture(model, 0, Look::Wireframe)),
        ];
        shots.extend(heat.into_iter().map(|png| shot(Look::Error, "Distance map", png)));
        Card { shots, caption: format!("<b>{}</b> triangles<br>{caption}", count(triangles)) }
    }
}

/// What stops work on a model of our own: Ctrl-C, or a fault of ours.
fn failed(session: &Session, error: impl std::fmt::Display) -> Failure {
    match session.cancelled() {
        Err(cancelled) => cancelled,
        Ok(()) => Failure::Refused(format!("the demo failed: {error}")),
    }
}
