//! `maille bench metrics`: every metric and placement on one model.

use std::path::{Path, PathBuf};

use maille::measure::{AttributeDeviation, Comparison, compare_attributes, distances_at_vertices};
use maille::refit::RefitOptions;
use maille::simplify::{AttributeWeights, MetricKind, PlacementKind, SimplifyOptions, Target};
use maille_io::AssetOptions;
use serde_json::{Value, json};

use super::report::{Report, markdown};
use crate::args::{Level, MetricsArgs, UpAxis};
use crate::commands::collapse::{by_name, name_of};
use crate::commands::report::{
    Card, HeatScale, Look, Model, ReportFiles, Shot, Studio, Trial, Trials, attributes_json, curve_json, escape,
};
use crate::commands::simplify::stop_name;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

const VIEW: (f32, f32) = (30.0, 12.0);

/// A metric, a placement, and whether vertices are fitted to the original in the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Way {
    metric: MetricKind,
    placement: PlacementKind,
    is_fitted: bool,
}

/// What one way made of one level.
pub(super) struct Outcome {
    pub(super) way: Way,
    /// Triangles asked for.
    pub(super) target: usize,
    pub(super) trial: Trial,
    pub(super) attributes: Vec<AttributeDeviation>,
}

/// Where results go beside stdout.
enum Files {
    Nowhere,
    Page(ReportFiles),
    Markdown(PathBuf),
}

pub(crate) fn run(args: &MetricsArgs) -> Result<(), Failure> {
    let files = Files::new(args)?;
    let session = Session::start(&args.common)?;
    let original = session.read(&args.input)?;
    let surface = original.flattened();
    let trials = Trials {
        session: &session,
        path: &args.input,
        original: &original,
        surface: &surface,
        samples: args.samples,
        repeat: args.repeat,
    };
    let targets = targets(args, original.triangle_count())?;
    let levels = compare_all(&trials, &ways(args), &targets)?;
    let figures = || json(args, &trials, &levels, &files.told());
    match &files {
        Files::Nowhere => {}
        Files::Markdown(path) => {
            session.write_bytes(markdown(&levels, &trials).as_bytes(), path)?;
        }
        Files::Page(place) => {
            let coarsest = levels.iter().min_by_key(|level| level[0].target).expect("there is a level");
            let (cards, scale) = pictures(&trials, args, coarsest)?;
            let report = Report {
                levels: &levels,
                trials: &trials,
                cards: &cards,
                scale,
                size: args.size,
                pictured: coarsest[0].target,
            };
            place.write(&session, &report.html(), &figures())?;
        }
    }
    session.result(figures, || text(args, &trials, &levels, &files))
}

impl Files {
    /// Refuses what cannot be written, before any work is done.
    fn new(args: &MetricsArgs) -> Result<Self, Failure> {
        let Some(path) = &args.output else { return Ok(Self::Nowhere) };
        let is = |extension: &str| path.extension().is_some_and(|own| own.eq_ignore_ascii_case(extension));
        if is("md") {
            crate::commands::refuse_folder(path, "metrics.md")?;
            Session::check_place(path)?;
            return Ok(Self::Markdown(path.clone()));
        }
        if is("html") {
            return Ok(Self::Page(ReportFiles::new(path, &[&args.input])?));
        }
        Err(Failure::Usage(format!("{}: the name must end in .html or .md", path.display())))
    }

    fn told(&self) -> Vec<&Path> {
        match self {
            Self::Nowhere => Vec::new(),
            Self::Page(files) => files.files().to_vec(),
            Self::Markdown(path) => vec![path],
        }
    }
}

impl Way {
    pub(super) fn metric(self) -> &'static str {
        name_of(&MetricKind::NAMES, &self.metric)
    }

    pub(super) fn placement(self) -> String {
        let fitted = if self.is_fitted { ", fitted" } else { "" };
        format!("{}{fitted}", name_of(&PlacementKind::NAMES, &self.placement))
    }

    /// Short: the placement only where it is not the usual one.
    pub(super) fn name(self) -> String {
        match (self.placement == self.metric.usual_placement(), self.is_fitted) {
            (true, false) => self.metric().to_owned(),
            (true, true) => format!("{}, fitted", self.metric()),
            (false, _) => format!("{}, {}", self.metric(), self.placement()),
        }
    }
}

/// What is to be compared: all metrics at their usual placement, the default metric at all placements, and fitted; or as
/// asked for.
fn ways(args: &MetricsArgs) -> Vec<Way> {
    let metrics: Vec<MetricKind> = match args.metrics.as_slice() {
        [] => MetricKind::NAMES.into_iter().map(|(_, metric)| metric).collect(),
        names => names.iter().filter_map(|name| by_name(&MetricKind::NAMES, name)).collect(),
    };
    let placements: Vec<PlacementKind> =
        args.placements.iter().filter_map(|name| by_name(&PlacementKind::NAMES, name)).collect();
    let all = PlacementKind::NAMES.into_iter().map(|(_, placement)| placement);
    let mut ways: Vec<Way> = Vec::new();
    for metric in metrics {
        let of_this: Vec<PlacementKind> = match placements.is_empty() {
            true if metric == MetricKind::default() => all.clone().collect(),
            true => vec![metric.usual_placement()],
            false => placements.clone(),
        };
        for placement in of_this {
            let way = Way { metric, placement, is_fitted: false };
            if !ways.contains(&way) {
                ways.push(way);
            }
        }
    }
    if args.metrics.is_empty() && placements.is_empty() {
        let metric = MetricKind::default();
        ways.push(Way { metric, placement: metric.usual_placement(), is_fitted: true });
    }
    ways
}

/// Numbers of triangles, in the order given, each once.
fn targets(args: &MetricsArgs, total: usize) -> Result<Vec<usize>, Failure> {
    let mut targets: Vec<usize> = Vec::new();
    for target in args.levels.iter().map(|level: &Level| level.of(total)) {
        if target >= total {
            let problem = format!("--levels: there are {total} triangles, so {target} leave nothing to do");
            return Err(Failure::about(&args.input, problem));
        }
        if !targets.contains(&target) {
            targets.push(target);
        }
    }
    Ok(targets)
}

/// All ways at all levels; at each level sorted by the root mean square distance.
fn compare_all(trials: &Trials<'_>, ways: &[Way], targets: &[usize]) -> Result<Vec<Vec<Outcome>>, Failure> {
    let steps = (ways.len() * targets.len()) as f32;
    let mut levels = Vec::new();
    for (l, &target) in targets.iter().enumerate() {
        let mut level = Vec::new();
        for (w, &way) in ways.iter().enumerate() {
            trials.session.progress("comparing", (l * ways.len() + w) as f32 / steps);
            trials.session.cancelled()?;
            level.push(outcome(trials, way, target)?);
        }
        level.sort_by(|a, b| a.trial.comparison.rms().total_cmp(&b.trial.comparison.rms()));
        levels.push(level);
    }
    trials.session.checkpoint()?;
    Ok(levels)
}

fn outcome(trials: &Trials<'_>, way: Way, target: usize) -> Result<Outcome, Failure> {
    let simplify = SimplifyOptions {
        target: Target { triangles: Some(target), max_error: None },
        metric: way.metric,
        placement: way.placement,
        // metrics of the surface are compared: what attributes do is the same with each
        attributes: AttributeWeights::NONE,
        ..SimplifyOptions::default()
    };
    let refit = way.is_fitted.then(RefitOptions::default);
    let trial = trials.run(&AssetOptions { simplify, refit, ..AssetOptions::default() })?;
    let control = trials.session.quiet_control();
    let attributes = compare_attributes(trials.surface, &trial.surface(), &trials.sampling(), control);
    let attributes = attributes.map_err(|error| trials.failure(&error))?;
    Ok(Outcome { way, target, trial, attributes })
}

impl Outcome {
    /// Share of the surface whose counterpart faces the other way.
    pub(super) fn flipped(&self) -> f64 {
        let c = &self.trial.comparison;
        c.forward.normal.flipped_share.max(c.backward.normal.flipped_share)
    }

    fn json(&self) -> Value {
        let mut object = json!({
            "metric": self.way.metric(),
            "placement": name_of(&PlacementKind::NAMES, &self.way.placement),
            "fitted": self.way.is_fitted,
            "target": self.target,
        });
        let c = &self.trial.comparison;
        let more = json!({
            "stopped": stop_name(self.trial.report.stopped),
            "normal_deg": c.normal_deg(),
            "flipped_share": self.flipped(),
            "mean_angle_deg": c.b.quality.mean_angle_deg,
            "mean_shape": c.b.quality.mean_shape,
            "bad_share": c.b.quality.bad_share,
            "degenerate": c.b.quality.degenerate,
            "attributes": attributes_json(&self.attributes),
        });
        if let Value::Object(object) = &mut object {
            for part in [curve_json(&self.trial), more] {
                object.extend(part.as_object().into_iter().flatten().map(|(key, value)| (key.clone(), value.clone())));
            }
        }
        object
    }
}

fn json(args: &MetricsArgs, trials: &Trials<'_>, levels: &[Vec<Outcome>], files: &[&Path]) -> Value {
    json!({
        "input": args.input.display().to_string(),
        "triangles": trials.original.triangle_count(),
        "diagonal": trials.surface.diagonal(),
        "results": levels.iter().flatten().map(Outcome::json).collect::<Vec<_>>(),
        "samples": args.samples,
        "repeat": args.repeat,
        "threads": trials.session.threads(),
        "files": output::paths(files),
        "warnings": trials.original.warnings,
    })
}

/// Heads of the columns that all tables have, and their cells. Errors are in millionths of the diagonal.
pub(super) const HEAD: [&str; 9] =
    ["metric", "placement", "time", "mean", "RMS", "largest", "normals", "below 10°", "flipped"];

pub(super) fn cells(outcome: &Outcome) -> Vec<String> {
    let c = &outcome.trial.comparison;
    let millionths = |distance: f64| output::number(round(1e6 * c.relative(distance)));
    let share = |share: f64| format!("{} %", output::number(round(100.0 * share)));
    vec![
        outcome.way.metric().to_owned(),
        outcome.way.placement(),
        output::seconds(outcome.trial.seconds),
        millionths(c.mean()),
        millionths(c.rms()),
        millionths(c.max()),
        format!("{:.2}°", c.normal_deg()),
        share(c.b.quality.bad_share),
        share(outcome.flipped()),
    ]
}

/// Three digits: more are noise of the sampling.
fn round(x: f64) -> f64 {
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    let unit = 10_f64.powf(x.abs().log10().floor() - 2.0);
    (x / unit).round() * unit
}

/// What a level is called: its triangles, and their share.
pub(super) fn level_name(level: &[Outcome], trials: &Trials<'_>) -> String {
    let (target, total) = (level[0].target, trials.original.triangle_count());
    format!(
        "{} of {} triangles ({} %)",
        output::count(target),
        output::count(total),
        output::number(round(100.0 * target as f64 / total as f64))
    )
}

/// Which attributes differ, and the means of their differences, in the order of the head.
pub(super) fn attribute_heads(levels: &[Vec<Outcome>]) -> Vec<String> {
    let first = levels.first().and_then(|level| level.first());
    first.map_or(Vec::new(), |outcome| outcome.attributes.iter().map(|a| format!("Δ {}", a.semantic)).collect())
}

pub(super) fn attribute_cells(outcome: &Outcome) -> Vec<String> {
    outcome.attributes.iter().map(|a| output::number(round(a.rms))).collect()
}

fn text(args: &MetricsArgs, trials: &Trials<'_>, levels: &[Vec<Outcome>], files: &Files) -> String {
    let mut text = String::new();
    for level in levels {
        text += &format!("{}: {}\n", args.input.display(), level_name(level, trials));
        let mut rows = vec![HEAD.map(str::to_owned).to_vec()];
        rows[0].extend(attribute_heads(levels));
        rows.extend(level.iter().map(|outcome| [cells(outcome), attribute_cells(outcome)].concat()));
        text += &output::table(&rows);
        text.push('\n');
    }
    text += &format!("{}\n", meaning(trials, levels));
    let files = files.told();
    if files.is_empty() { text } else { format!("wrote {}\n{text}", output::written(&files)) }
}

/// What the figures of the tables are.
pub(super) fn meaning(trials: &Trials<'_>, levels: &[Vec<Outcome>]) -> String {
    let attributes = match attribute_heads(levels).is_empty() {
        true => "",
        false => " Δ: root mean square difference of an attribute.",
    };
    format!(
        "Distances: millionths of the diagonal, {} points on each surface. Time: the fastest of {} on {} thread{}. Normals: \
         mean angle. Below 10°: triangles with so small an angle. Flipped: surface that faces the other way.{attributes}",
        output::count(trials.samples),
        trials.repeat,
        trials.session.threads(),
        if trials.session.threads() == 1 { "" } else { "s" }
    )
}

/// The original and what each way made of it, drawn by the same camera.
fn pictures(trials: &Trials<'_>, args: &MetricsArgs, level: &[Outcome]) -> Result<(Vec<Card>, HeatScale), Failure> {
    let session = trials.session;
    session.progress("drawing", 0.0);
    let studio = Studio::new(trials.original, args.up == UpAxis::Z, &[VIEW], args.size);
    let mut distances = Vec::new();
    for outcome in level {
        let found = distances_at_vertices(trials.surface, &outcome.trial.surface(), session.quiet_control());
        distances.push(found.map_err(|error| trials.failure(&error))?);
    }
    // the middle one of the scales that would suit each: what is worse than that is told by its yellow
    let mut scales: Vec<HeatScale> = distances.iter().map(HeatScale::covering).collect();
    scales.sort_by(|a, b| a.high.total_cmp(&b.high));
    let scale = scales[scales.len() / 2];
    let diagonal = trials.surface.diagonal();
    let scale = HeatScale { diagonal: (diagonal > 0.0).then_some(diagonal), ..scale };
    let nowhere = vec![0.0; trials.surface.vertex_count()];
    let mut cards = vec![card(
        &studio,
        &studio.original,
        &nowhere,
        &scale,
        "the original",
        &format!("{} triangles", output::count(trials.original.triangle_count())),
    )];
    for (i, (outcome, distances)) in level.iter().zip(&distances).enumerate() {
        session.progress("drawing", (i + 1) as f32 / (level.len() + 1) as f32);
        session.cancelled()?;
        let model = studio.model(&outcome.trial.asset);
        cards.push(card(&studio, &model, distances, &scale, &outcome.way.name(), &caption(&outcome.trial)));
    }
    session.checkpoint()?;
    Ok((cards, scale))
}

fn caption(trial: &Trial) -> String {
    let c: &Comparison = &trial.comparison;
    format!("RMS {}", output::number(round(1e6 * c.relative(c.rms()))))
}

/// The model in all looks; the distances are those of the original's vertices.
fn card(studio: &Studio<'_>, model: &Model, distances: &[f32], scale: &HeatScale, name: &str, below: &str) -> Card {
    let mut looks = vec![Look::Shaded, Look::Wireframe];
    if studio.has_colours() {
        looks.push(Look::Colours);
    }
    let alt = |look: Look| format!("{}: {name}", look.name());
    let mut shots: Vec<Shot> =
        looks.into_iter().map(|look| Shot { look, alt: alt(look), png: studio.picture(model, 0, look) }).collect();
    let heat = studio.heat(&studio.original, &studio.surface, distances, scale);
    shots.extend(heat.into_iter().map(|png| Shot { look: Look::Error, alt: alt(Look::Error), png }));
    Card { shots, caption: format!("<b>{}</b><br>{below}", escape(name)) }
}
