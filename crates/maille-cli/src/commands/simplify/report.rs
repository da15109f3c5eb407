//! The report of a simplification (`--report`): what is gathered for it, the page and the JSON.

use std::path::Path;
use std::time::Instant;

use maille::Mesh;
use maille::measure::{
    AttributeDeviation, CompareError, CompareOptions, Comparison, Deviation, Figures, compare, compare_attributes,
    distances_at_vertices,
};
use maille::simplify::{MetricKind, Order, PlacementKind, Stop, Target, TopologyPolicy};
use maille_io::{Asset, AssetOptions, AssetReport, world_scales};
use serde_json::{Value, json};

use super::{Done, preset_name};
use crate::args::{Level, SimplifyArgs, UpAxis};
use crate::commands::collapse::{by_name, name_of};
use crate::commands::report::{
    Bars, Card, Gallery, HeatScale, Look, Page, ReportFiles, Series, Shot, Studio, Trials, angle_bins, attributes_json,
    attributes_rows, bar, command_line, comparison_json, count, curve_json, escape, facts, histogram, log_log, percent,
    settings, table,
};
use crate::failure::Failure;
use crate::output::{bytes, distance, number, seconds};
use crate::session::Session;

/// From where the pictures are taken: name, degrees around the vertical axis, and above the horizon.
const VIEWS: [(&str, (f32, f32)); 3] = [("front", (30.0, 12.0)), ("back", (210.0, 12.0)), ("above", (30.0, 55.0))];
/// Samples behind attributes, all parts together, and each point of a curve.
const FEWER_SAMPLES: u64 = 200_000;
/// Fewest samples of a part.
const FEWEST_SAMPLES: u64 = 2000;
/// Where errors are plotted, as multiples of the triangles that are left.
const AROUND: [f64; 5] = [8.0, 4.0, 2.0, 0.5, 0.25];
/// Fewest triangles at which errors are plotted.
const FEWEST_TRIANGLES: usize = 8;
/// Seconds below which a part of a stage is not worth a row.
const SHORTEST: f64 = 5e-5;
/// Rows beyond which a table is folded.
const MANY_ROWS: usize = 12;

/// All that the report tells and that the work itself does not know.
pub(super) struct Evidence {
    files: ReportFiles,
    comparison: Comparison,
    attributes: Vec<AttributeDeviation>,
    parts: Vec<Part>,
    /// Shares of triangles by their smallest angle, before and after.
    angles: [Vec<f64>; 2],
    curves: Vec<Curve>,
    cards: Vec<Card>,
    scale: HeatScale,
    input_bytes: Option<u64>,
    cost: Cost,
}

/// One distinct mesh of the asset; distances in world units.
struct Part {
    name: String,
    before: usize,
    after: usize,
    /// The metric's estimate.
    estimate: f64,
    /// Mean, root mean square and largest distance, and mean angle of the normals; `None` if nothing is left of it.
    measured: Option<[f64; 4]>,
}

/// Errors of one metric at several numbers of triangles, as JSON tells them.
struct Curve {
    metric: &'static str,
    points: Vec<Value>,
}

/// Seconds that the report itself took.
#[derive(Default)]
struct Cost {
    measuring: f64,
    curves: f64,
    drawing: f64,
}

/// What is compared.
struct Pair<'a> {
    session: &'a Session,
    args: &'a SimplifyArgs,
    options: &'a AssetOptions,
    report: &'a AssetReport,
    original: &'a Asset,
    result: &'a Asset,
}

impl Evidence {
    /// Reads the original once more, so that no copy of it counted as memory of the work, measures and draws.
    pub(super) fn gather(
        session: &Session,
        args: &SimplifyArgs,
        files: ReportFiles,
        options: &AssetOptions,
        report: &AssetReport,
        result: &Asset,
    ) -> Result<Self, Failure> {
        let original = session.open(&args.input)?;
        let pair = Pair { session, args, options, report, original: &original, result };
        let views = VIEWS.map(|view| view.1);
        let mut cost = Cost::default();

        let start = Instant::now();
        let (before, after) = (original.flattened(), result.flattened());
        let sampling = CompareOptions::default();
        let comparison = compare(&before, &after, &sampling, session.control()).map_err(|e| pair.failure(&e))?;
        let attributes = pair.attributes(&before, &after)?;
        let parts = pair.parts()?;
        let angles = [angle_bins(&before), angle_bins(&after)];
        let there = distances_at_vertices(&before, &after, session.control()).map_err(|e| pair.failure(&e))?;
        let back = distances_at_vertices(&after, &before, session.control()).map_err(|e| pair.failure(&e))?;
        session.checkpoint()?;
        cost.measuring = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let curves = pair.curves(&before, &comparison)?;
        session.checkpoint()?;
        cost.curves = start.elapsed().as_secs_f64();

        let start = Instant::now();
        session.progress("drawing", 0.0);
        let studio = Studio::new(&original, args.report_up == UpAxis::Z, &views, args.report_size);
        let scale = HeatScale::covering(&there);
        let cards = pair.cards(&studio, &after, [&there, &back], &scale)?;
        session.checkpoint()?;
        cost.drawing = start.elapsed().as_secs_f64();

        let input_bytes = std::fs::metadata(&args.input).ok().map(|meta| meta.len());
        Ok(Self { files, comparison, attributes, parts, angles, curves, cards, scale, input_bytes, cost })
    }

    /// Writes the page and the JSON, and tells it to those who ask what was written.
    pub(super) fn write(
        self,
        session: &Session,
        args: &SimplifyArgs,
        done: &mut Done,
        asset: &Asset,
    ) -> Result<(), Failure> {
        done.told = self.files.files().map(Path::to_owned).to_vec();
        let page = Teller { evidence: &self, args, done, threads: session.threads() }.page();
        let mut figures = done.json(args, session, asset);
        if let Value::Object(object) = &mut figures {
            let own = self.json();
            object.extend(own.as_object().into_iter().flatten().map(|(key, value)| (key.clone(), value.clone())));
        }
        self.files.write(session, &page, &figures)
    }

    fn json(&self) -> Value {
        let mut measured = comparison_json(&self.comparison);
        let sampling = CompareOptions::default();
        measured.insert("samples".to_owned(), sampling.samples.into());
        measured.insert("seed".to_owned(), sampling.seed.into());
        let part = |part: &Part| {
            let figure = |i: usize| part.measured.map(|measured| measured[i]);
            json!({
                "name": part.name,
                "triangles_in": part.before,
                "triangles_out": part.after,
                "error": part.estimate,
                "mean": figure(0),
                "rms": figure(1),
                "max": figure(2),
                "normal_deg": figure(3),
            })
        };
        let curve = |curve: &Curve| json!({ "metric": curve.metric, "points": curve.points });
        json!({
            "command": command_line(),
            "measured": measured,
            "attributes": attributes_json(&self.attributes),
            "parts": self.parts.iter().map(part).collect::<Vec<_>>(),
            "smallest_angles": { "bin_deg": 5, "before": self.angles[0], "after": self.angles[1] },
            "curves": self.curves.iter().map(curve).collect::<Vec<_>>(),
            "report_seconds": {
                "measuring": self.cost.measuring, "curves": self.cost.curves, "drawing": self.cost.drawing,
            },
        })
    }
}

impl Pair<'_> {
    fn failure(&self, error: &CompareError) -> Failure {
        match error {
            CompareError::Cancelled(_) => Failure::Cancelled,
            error => Failure::about(&self.args.input, format!("the report cannot measure the result: {error}")),
        }
    }

    fn attributes(&self, before: &Mesh, after: &Mesh) -> Result<Vec<AttributeDeviation>, Failure> {
        let sampling = CompareOptions { samples: FEWER_SAMPLES, ..CompareOptions::default() };
        compare_attributes(before, after, &sampling, self.session.control()).map_err(|error| self.failure(&error))
    }

    fn parts(&self) -> Result<Vec<Part>, Failure> {
        let scales = world_scales(self.original);
        let total = self.original.triangle_count().max(1);
        let mut parts = Vec::new();
        for (i, (before, after)) in self.original.meshes.iter().zip(&self.result.meshes).enumerate() {
            let count = before.mesh.triangle_count();
            if count == 0 {
                continue;
            }
            let samples = (FEWER_SAMPLES * count as u64 / total as u64).max(FEWEST_SAMPLES);
            let sampling = CompareOptions { samples, ..CompareOptions::default() };
            let measured = match compare(&before.mesh, &after.mesh, &sampling, self.session.quiet_control()) {
                Ok(c) => Some([c.mean() * scales[i], c.rms() * scales[i], c.max() * scales[i], c.normal_deg()]),
                Err(CompareError::Empty { .. }) => None,
                Err(error) => return Err(self.failure(&error)),
            };
            let name = if before.name.is_empty() { format!("mesh {i}") } else { before.name.clone() };
            let estimate = self.report.meshes[i].error * scales[i];
            parts.push(Part { name, before: count, after: after.mesh.triangle_count(), estimate, measured });
        }
        Ok(parts)
    }

    /// Errors at several numbers of triangles, for the metric of the work and those asked for besides.
    fn curves(&self, before: &Mesh, comparison: &Comparison) -> Result<Vec<Curve>, Failure> {
        let trials = Trials {
            session: self.session,
            path: &self.args.input,
            original: self.original,
            surface: before,
            samples: FEWER_SAMPLES,
            repeat: 1,
        };
        let chosen = self.options.simplify.metric;
        let asked = self.args.report_metrics.iter().filter_map(|name| by_name(&MetricKind::NAMES, name));
        let mut metrics = vec![chosen];
        asked.for_each(|metric| {
            if !metrics.contains(&metric) {
                metrics.push(metric);
            }
        });
        let levels = self.levels();
        let steps = (metrics.len() * levels.len()).max(1) as f32;
        let mut curves = Vec::new();
        for (m, &metric) in metrics.iter().enumerate() {
            let mut points = Vec::new();
            let mut levels = levels.clone();
            if metric == chosen {
                points.push(json!({
                    "triangles": self.report.triangles_out,
                    "seconds": Value::Null,
                    "mean": comparison.mean(),
                    "rms": comparison.rms(),
                    "max": comparison.max(),
                }));
                levels.retain(|&level| level != self.report.triangles_out);
            }
            for (l, &triangles) in levels.iter().enumerate() {
                self.session.progress("errors over triangles", (m * levels.len() + l) as f32 / steps);
                let mut options = self.options.clone();
                options.simplify.metric = metric;
                options.simplify.target = Target { triangles: Some(triangles), max_error: None };
                points.push(curve_json(&trials.run(&options)?));
            }
            points.sort_by_key(|point| point["triangles"].as_u64());
            curves.push(Curve { metric: name_of(&MetricKind::NAMES, &metric), points });
        }
        Ok(curves)
    }

    /// Numbers of triangles at which errors are plotted, besides that of the result.
    fn levels(&self) -> Vec<usize> {
        let (total, left) = (self.report.triangles_in, self.report.triangles_out);
        let around = AROUND.map(|factor| (factor * left as f64) as usize);
        let fewest = FEWEST_TRIANGLES * self.original.meshes.len().max(1);
        let fits = |level: &usize| *level >= fewest && (*level as f64) < 0.95 * total as f64;
        let mut levels: Vec<usize> = match &self.args.report_levels {
            Some(levels) => levels.iter().map(|level: &Level| level.of(total)).filter(|&level| level < total).collect(),
            None => around.into_iter().filter(fits).collect(),
        };
        if !self.args.report_metrics.is_empty() && !levels.contains(&left) {
            levels.push(left);
        }
        levels.sort_unstable();
        levels.dedup();
        levels
    }

    /// Before and after, from all views.
    fn cards(
        &self,
        studio: &Studio<'_>,
        after: &Mesh,
        distances: [&[f32]; 2],
        scale: &HeatScale,
    ) -> Result<Vec<Card>, Failure> {
        let result = studio.model(self.result);
        let models = [&studio.original, &result];
        let mut looks = vec![Look::Shaded, Look::Wireframe];
        if studio.has_colours() {
            looks.push(Look::Colours);
        }
        let heat = [
            studio.heat(models[0], &studio.surface, distances[0], scale),
            studio.heat(models[1], after, distances[1], scale),
        ];
        let counts = [self.report.triangles_in, self.report.triangles_out];
        let mut cards = Vec::new();
        for (v, (view, _)) in VIEWS.into_iter().enumerate() {
            for (side, when) in ["Before", "After"].into_iter().enumerate() {
                self.session.progress("drawing", cards.len() as f32 / (2 * VIEWS.len()) as f32);
                self.session.cancelled()?;
                let triangles = count(counts[side]);
                let alt = |look: Look| format!("{}: {when}, from the {view}, {triangles} triangles", look.name());
                let picture = |&look: &Look| Shot { look, alt: alt(look), png: studio.picture(models[side], v, look) };
                let mut shots: Vec<Shot> = looks.iter().map(picture).collect();
                shots.push(Shot { look: Look::Error, alt: alt(Look::Error), png: heat[side][v].clone() });
                let from = if view == "above" { "from above".to_owned() } else { format!("from the {view}") };
                cards.push(Card { shots, caption: format!("<b>{when}</b> {from}<br>{triangles} triangles") });
            }
        }
        Ok(cards)
    }
}

/// Turns it all into HTML.
struct Teller<'a> {
    evidence: &'a Evidence,
    args: &'a SimplifyArgs,
    done: &'a Done,
    threads: usize,
}

impl Teller<'_> {
    fn page(&self) -> String {
        let report = &self.done.report;
        let name = self.args.input.file_name().unwrap_or_default().to_string_lossy();
        let heading = format!("{name}: {} to {} triangles", count(report.triangles_in), count(report.triangles_out));
        let mut page = Page::new(&heading, &heading, &self.lead());
        page.add(&self.facts());
        let evidence = self.evidence;
        let cards: Vec<&Card> = evidence.cards.iter().collect();
        page.add(&Gallery { cards: &cards, pairs: true, size: self.args.report_size, scale: evidence.scale }.html());
        page.section("How far it is from the original", &self.errors());
        page.section("Error over triangles", &self.curves());
        page.section("Shape of the triangles", &self.shapes());
        page.section("What stopped it", &self.stopped());
        page.section("Time and memory", &self.stages());
        page.section("How it was made", &self.settings());
        page.finish(&format!("The same figures as JSON: {}.", escape(&file_name(self.evidence.files.files()[1]))))
    }

    fn lead(&self) -> String {
        let c = &self.evidence.comparison;
        format!(
            "The simplified surface is {} from the original in the root mean square, {} at most; {}.",
            self.distance(c.rms()),
            self.distance(c.max()),
            self.done.explanation()
        )
    }

    fn distance(&self, d: f64) -> String {
        distance(d, self.evidence.comparison.diagonal)
    }

    fn facts(&self) -> String {
        let (report, c) = (&self.done.report, &self.evidence.comparison);
        let with = |value: String, small: String| format!("{value}<small>{small}</small>");
        let share = |d: f64| {
            if c.diagonal > 0.0 { format!("{} of the diagonal", percent(c.relative(d))) } else { String::new() }
        };
        let left = report.triangles_out as f64 / report.triangles_in.max(1) as f64;
        let size = |path: &Path| std::fs::metadata(path).map(|meta| meta.len()).unwrap_or(0);
        let output: u64 = self.done.written.files.iter().map(|path| size(path)).sum();
        let mut all = vec![
            (
                "Triangles",
                with(count(report.triangles_out), format!("{} of {}", percent(left), count(report.triangles_in))),
            ),
            ("Distance, RMS", with(number(c.rms()), share(c.rms()))),
            ("Distance, largest", with(number(c.max()), share(c.max()))),
            ("Normals, mean", with(format!("{}°", number(c.normal_deg())), "angle between the surfaces".to_owned())),
            ("Simplified in", with(seconds(self.done.ledger.seconds("simplify")), format!("{} threads", self.threads))),
        ];
        if let Some(peak) = self.done.ledger.peak_bytes() {
            all.push(("Most memory", with(bytes(peak), "of the whole process".to_owned())));
        }
        let before = self.evidence.input_bytes.map(|n| format!("from {}", bytes(n)));
        all.push(("File", with(bytes(output), before.unwrap_or_default())));
        facts(&all)
    }

    fn errors(&self) -> String {
        let c = &self.evidence.comparison;
        let row = |name: &str, both: f64, pick: fn(&Deviation) -> f64| {
            let share = if c.diagonal > 0.0 { percent(c.relative(both)) } else { String::new() };
            vec![name.to_owned(), number(both), share, number(pick(&c.forward)), number(pick(&c.backward))]
        };
        let degrees = |name: &str, both: f64, pick: fn(&Deviation) -> f64| {
            let angle = |x: f64| format!("{}°", number(x));
            vec![name.to_owned(), angle(both), String::new(), angle(pick(&c.forward)), angle(pick(&c.backward))]
        };
        let larger = |pick: fn(&Deviation) -> f64| pick(&c.forward).max(pick(&c.backward));
        let normal_max: fn(&Deviation) -> f64 = |d| d.normal.max_deg;
        let flipped: fn(&Deviation) -> f64 = |d| d.normal.flipped_share;
        let rows = [
            row("Distance, mean", c.mean(), |d| d.mean),
            row("Distance, root mean square", c.rms(), |d| d.rms),
            row("Distance, largest", c.max(), |d| d.max),
            degrees("Normals, mean", c.normal_deg(), |d| d.normal.mean_deg),
            degrees("Normals, largest", larger(normal_max), normal_max),
            [
                vec!["Facing the other way".to_owned(), percent(larger(flipped)), String::new()],
                [&c.forward, &c.backward].map(|d| percent(flipped(d))).to_vec(),
            ]
            .concat(),
        ];
        let caption = format!(
            "Geometry: {} points on each surface. Distances in units of the model; both: the larger of the two directions.",
            count(c.forward.samples)
        );
        let mut html = table(&caption, &["", "Both", "Of the diagonal", "Before to after", "After to before"], &rows);
        if !self.evidence.attributes.is_empty() {
            let caption = "Attributes: difference to the original at corresponding points. Beside seams the nearest point \
                           may lie on their other side, so that the largest one tells little there.";
            let rows = attributes_rows(&self.evidence.attributes);
            html += &table(caption, &["", "Mean", "RMS", "Largest"], &rows);
        }
        html + &self.parts()
    }

    fn parts(&self) -> String {
        let parts = &self.evidence.parts;
        if parts.len() < 2 {
            return String::new();
        }
        let row = |part: &Part| {
            let mut cells = vec![escape(&part.name), count(part.before), count(part.after)];
            match part.measured {
                Some([mean, rms, max, normal]) => {
                    cells.extend([mean, rms, max].map(number));
                    cells.push(format!("{}°", number(normal)));
                }
                None => cells.extend(["gone", "", "", ""].map(str::to_owned)),
            }
            cells
        };
        let caption =
            "Meshes of the asset, each measured on its own; distances in world units, where it is drawn largest.";
        let head = ["Mesh", "Before", "After", "Mean", "RMS", "Largest", "Normals"];
        let html = table(caption, &head, &parts.iter().map(row).collect::<Vec<_>>());
        match parts.len() > MANY_ROWS {
            true => format!("<details><summary>{} meshes, each by itself</summary>\n{html}</details>\n", parts.len()),
            false => html,
        }
    }

    fn curves(&self) -> String {
        let curves = &self.evidence.curves;
        let series = |curve: &Curve, key: &str, name: String| Series {
            name,
            points: (curve.points.iter())
                .filter_map(|point| Some((point["triangles"].as_f64()?, point[key].as_f64()?)))
                .filter(|point| point.1 > 0.0)
                .collect(),
        };
        let scrolling = |svg: String| format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n");
        let plot = |series: &[Series], what: &str| {
            let alt = format!("{what} over the number of triangles, logarithmic");
            scrolling(log_log(series, "triangles", &format!("{what}, units of the model"), &alt))
        };
        let plots = match curves.as_slice() {
            [only] => {
                let names = [("rms", "RMS"), ("max", "largest")];
                plot(&names.map(|(key, name)| series(only, key, name.to_owned())), "distance")
            }
            several => {
                let of = |key: &str| -> Vec<Series> {
                    several.iter().map(|curve| series(curve, key, curve.metric.to_owned())).collect()
                };
                let plots = [plot(&of("rms"), "RMS distance"), plot(&of("max"), "largest distance")];
                plots.concat()
            }
        };
        let row = |curve: &Curve, point: &Value| {
            let figure = |key: &str| point[key].as_f64().map_or(String::new(), number);
            let time = point["seconds"].as_f64().map_or_else(|| "the result".to_owned(), seconds);
            let triangles = count(point["triangles"].as_u64().unwrap_or(0));
            vec![curve.metric.to_owned(), triangles, figure("mean"), figure("rms"), figure("max"), time]
        };
        let rows: Vec<Vec<String>> =
            curves.iter().flat_map(|curve| curve.points.iter().map(move |point| row(curve, point))).collect();
        let caption = format!(
            "Each from the original, with the options of the result but for metric and target; {} samples, distances in units \
             of the model.",
            count(FEWER_SAMPLES)
        );
        let head = ["Metric", "Triangles", "Mean", "RMS", "Largest", "Time"];
        let figures = table(&caption, &head, &rows);
        match curves.len() {
            1 => format!("<div class=\"columns\">\n{plots}{figures}</div>\n"),
            _ => format!(
                "<div class=\"columns\">\n{plots}</div>\n<details><summary>As a table</summary>\n{figures}</details>\n"
            ),
        }
    }

    fn shapes(&self) -> String {
        let c = &self.evidence.comparison;
        let row = |name: &str, pick: &dyn Fn(&Figures) -> String| vec![name.to_owned(), pick(&c.a), pick(&c.b)];
        let rows = [
            row("Smallest angle, mean", &|f| format!("{}°", number(f.quality.mean_angle_deg))),
            row("Smallest angle, least", &|f| format!("{}°", number(f.quality.min_angle_deg))),
            row("Below 10°", &|f| percent(f.quality.bad_share)),
            row("Shape, mean (equilateral: 1)", &|f| number(f.quality.mean_shape)),
            row("Aspect, mean (equilateral: 1)", &|f| number(f.quality.mean_aspect)),
            row("Without area", &|f| count(f.quality.degenerate)),
            row("Area", &|f| number(f.area)),
            row("Volume", &|f| number(f.volume)),
            row("Components", &|f| count(f.components)),
            row("Open border, length", &|f| number(f.boundary_length)),
            row("Edges of more than two triangles", &|f| count(f.non_manifold_edges)),
        ];
        let names = ["before", "after"].into_iter().zip(&self.evidence.angles);
        let bars: Vec<Bars> =
            names.map(|(name, shares)| Bars { name: name.to_owned(), shares: shares.clone() }).collect();
        let edges: Vec<String> = (0..=12).map(|i| format!("{}°", 5 * i)).collect();
        let what = "Histogram: shares of the triangles by their smallest angle, before and after";
        format!(
            "<div class=\"columns\">\n<div class=\"scroll\" tabindex=\"0\">{}</div>\n{}</div>\n",
            histogram(&bars, &edges, "smallest angle of the triangle", what),
            table("The surface before and after", &["", "Before", "After"], &rows)
        )
    }

    fn stopped(&self) -> String {
        let report = &self.done.report;
        let mut html = format!(
            "<p>The work ended because {}. {} edges collapsed; the largest error of one, as the metric estimates, is {}.</p>\n",
            self.done.explanation(),
            count(report.collapses),
            self.distance(report.error)
        );
        let barriers = self.done.barriers();
        if barriers.is_empty() {
            return html + "<p>No constraint refused a collapse.</p>\n";
        }
        let rows: Vec<Vec<String>> =
            (barriers.iter()).map(|b| vec![words(&b.what), count(b.refused), words(&b.remedy)]).collect();
        let caption = match report.stopped {
            Stop::Triangles => "Collapses that constraints refused on the way; the target was reached all the same.",
            _ => "Collapses that constraints refused, and the options that relax them.",
        };
        html += &table(caption, &["Refused", "Collapses", "Relaxed by"], &rows);
        html
    }

    fn stages(&self) -> String {
        let total: f64 = self.done.ledger.stages().iter().map(|stage| stage.seconds).sum();
        let time = |s: f64| bar(&seconds(s), s / total.max(f64::MIN_POSITIVE));
        let mut rows = Vec::new();
        for stage in self.done.ledger.stages() {
            let peak = stage.peak_bytes.map_or(String::new(), bytes);
            rows.push(vec![stage.name.to_owned(), time(stage.seconds), peak]);
            let part = |&(name, s): &(&str, f64)| {
                vec![format!("<span class=\"part\">{}</span>", stage_name(name)), time(s), String::new()]
            };
            rows.extend(stage.parts.iter().filter(|part| part.1 >= SHORTEST).map(part));
        }
        let caption = "Time by the clock, and most memory of the process meanwhile. What is indented is part of what is above \
                       it, added up over meshes, several of which are worked on at the same time.";
        let Cost { measuring, curves, drawing } = &self.evidence.cost;
        format!(
            "{}<p class=\"note\">Not counted: this report, {} to measure, {} for the errors over triangles, {} to draw.</p>\n",
            table(caption, &["Stage", "Time", "Most memory"], &rows),
            seconds(*measuring),
            seconds(*curves),
            seconds(*drawing)
        )
    }

    fn settings(&self) -> String {
        let options = &self.done.options;
        let policy = |policy| format!("{policy:?}").to_lowercase();
        let all = [
            ("preset", preset_name(self.args.collapse.preset)),
            ("metric", name_of(&MetricKind::NAMES, &options.metric).to_owned()),
            ("placement", name_of(&PlacementKind::NAMES, &options.placement).to_owned()),
            ("order", name_of(&Order::NAMES, &options.order).to_owned()),
            ("weights", format!("{:?}", options.quadric_weight).to_lowercase()),
            ("fitted in the end", if self.done.report.refits.is_empty() { "no" } else { "yes" }.to_owned()),
            ("topology", name_of(&TopologyPolicy::NAMES, &options.topology).to_owned()),
            ("open borders", policy(options.boundary)),
            ("seams", policy(options.seams)),
            ("material borders", policy(options.material_borders)),
            ("constraint weight", number(options.constraint_weight)),
            (
                "largest turn of a normal",
                options.max_normal_turn.map_or("any".to_owned(), |turn| format!("{}°", number(turn.to_degrees()))),
            ),
            ("valence", options.valence.map_or("any".to_owned(), |(low, high)| format!("{low} to {high}"))),
            ("least quality", options.min_quality.map_or("any".to_owned(), number)),
            ("normals", format!("{:?}", options.normals).to_lowercase()),
            ("threads", self.threads.to_string()),
        ];
        let folded = settings("All settings", &all);
        format!("<pre><code>{}</code></pre>\n{folded}", escape(&command_line()))
    }
}

/// A cell whose text may wrap.
fn words(text: &str) -> String {
    format!("<span class=\"words\">{}</span>", escape(text))
}

/// What a stage of the simplification does.
fn stage_name(stage: &str) -> &str {
    match stage {
        "sorting" => "sorting along a curve through space",
        "preparing" => "building structures",
        "passes" => "collapses in passes",
        "queue" => "collapses from the queue",
        "finishing" => "back into a mesh",
        "fitting" => "fitting to the original",
        other => other,
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
