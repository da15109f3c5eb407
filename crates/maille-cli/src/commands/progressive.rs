//! `maille progressive`

use maille::progressive::ProgressiveMesh;
use maille_io::{Format, ProgressiveAsset, WriteOptions, Written, order_for_display};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::collapse::{self, refusal};
use super::lod::poses;
use crate::args::{Level, ProgressiveArgs};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;
use crate::stages::Ledger;

pub(crate) fn run(args: &ProgressiveArgs) -> Result<(), Failure> {
    let level = args.triangles.map(Level::Triangles).or(args.ratio.map(Level::Share));
    let usage = |message: &str| Err(Failure::Usage(format!("{}: {message}", args.output.display())));
    let makes = Format::from_path(&args.output) == Some(Format::Mpm);
    if makes {
        super::refuse_folder(&args.output, "model.mpm")?;
    } else {
        super::check_output(&args.output)?;
    }
    match level {
        Some(_) if makes => return usage("--triangles and --ratio cut a level; name a file for it, such as level.glb"),
        None if !makes => return usage("a level is wanted (--triangles, --ratio), or an .mpm that holds them all"),
        _ if super::is_same_file(&args.input, &args.output) => {
            return usage("this is the input; give another name to keep it");
        }
        _ => {}
    }
    let session = Session::start(&args.common)?;
    let is_progressive = maille_io::detect(&args.input)? == Format::Mpm;
    match (level, is_progressive) {
        (None, false) => make(args, &session),
        (Some(level), true) => cut(args, level, &session),
        (None, true) => {
            Err(Failure::about(&args.input, "this is a progressive mesh already (maille info tells of it)"))
        }
        (Some(_), false) => {
            let message = "this is no progressive mesh (make one with -o NAME.mpm, or use maille simplify)";
            Err(Failure::about(&args.input, message))
        }
    }
}

/// Makes a progressive mesh.
fn make(args: &ProgressiveArgs, session: &Session) -> Result<(), Failure> {
    let mut ledger = Ledger::new(false);
    let asset = ledger.stage("read", |_| session.read(&args.input))?;
    let asset = super::without_levels(asset, session);
    let poses = poses(args.poses.as_deref(), &asset)?;
    let options = collapse::options(&args.collapse, &asset)?;
    let (triangles, mut warnings) = (asset.drawn_triangle_count(), asset.warnings.clone());
    let progressive = ledger.stage("simplify", |times| {
        let control = session.control().with_times(times);
        let made = ProgressiveAsset::new(asset, &options, &poses, control);
        made.map_err(|error| refusal(&args.input, &error))
    })?;
    let written = ledger.stage("write", |_| session.write_progressive(&progressive, &args.output))?;
    let facts = ProgressiveFacts::of(&progressive);
    if facts.finest < triangles {
        let degenerate = output::count(triangles - facts.finest);
        warnings.push(format!("{degenerate} triangles were left out: they name a vertex twice"));
        session.warn(&args.input, &warnings[warnings.len() - 1..]);
    }
    let json = || {
        let mut json = common_json(args, session, &ledger, &written, &warnings);
        json["triangles_in"] = json!(triangles);
        json["progressive"] = facts.json();
        json
    };
    let text = || {
        let mut listing = Listing::default();
        listing.heading(format!("{}: {} triangles", args.input.display(), output::count(triangles)));
        facts.describe(&mut listing);
        listing.line("time", output::seconds(ledger.seconds("simplify")));
        listing.line("written", output::written(&written.files));
        listing.text()
    };
    session.result(json, text)
}

/// Cuts a level out of a progressive mesh.
fn cut(args: &ProgressiveArgs, level: Level, session: &Session) -> Result<(), Failure> {
    let mut ledger = Ledger::new(false);
    let mut progressive = ledger.stage("read", |_| session.open_progressive(&args.input))?;
    session.warn(&args.input, progressive.warnings());
    let warnings = progressive.warnings().to_vec();
    let finest = ProgressiveFacts::of(&progressive).finest;
    let wanted = level.of(finest);
    let diagonal = super::diagonal(&progressive.finest());
    let (asset, collapses) = ledger.stage("level", |_| {
        let collapses = progressive.collapses_for(wanted);
        let mut asset = progressive.level(&collapses);
        asset.meshes.par_iter_mut().for_each(|named| drop(order_for_display(&mut named.mesh)));
        session.checkpoint()?;
        Ok((asset, collapses))
    })?;
    let (triangles, error) = (asset.drawn_triangle_count(), progressive.error_at(&collapses));
    if triangles > wanted {
        let (found, wanted) = (output::count(triangles), output::count(wanted));
        session.note(&format!("the level has {found} triangles, not {wanted}: no more may collapse"));
    }
    let written = ledger.stage("write", |_| session.write(&asset, &args.output, &WriteOptions::default()))?;
    let json = || {
        let mut json = common_json(args, session, &ledger, &written, &warnings);
        json["triangles_in"] = json!(finest);
        json["triangles_out"] = json!(triangles);
        json["error"] = json!(error);
        json
    };
    let text = || {
        let mut listing = Listing::default();
        listing.heading(format!("{}: {} triangles", args.input.display(), output::count(finest)));
        listing.line("level", format!("{} triangles", output::count(triangles)));
        listing.line("error", format!("{} as the metric estimates", output::distance(error, diagonal)));
        listing.line("time", output::seconds(ledger.seconds("level")));
        listing.line("written", output::written(&written.files));
        listing.text()
    };
    session.result(json, text)
}

fn common_json(
    args: &ProgressiveArgs,
    session: &Session,
    ledger: &Ledger,
    written: &Written,
    warnings: &[String],
) -> Value {
    json!({
        "input": args.input.display().to_string(),
        "output": args.output.display().to_string(),
        "files": output::paths(&written.files),
        "stages": ledger.json(),
        "threads": session.threads(),
        "peak_bytes": ledger.peak_bytes(),
        "warnings": ([warnings, &written.warnings].concat()),
    })
}

/// What there is to tell of a progressive mesh.
pub(super) struct ProgressiveFacts {
    /// Triangles drawn at the finest and at the coarsest level.
    finest: usize,
    coarsest: usize,
    collapses: usize,
    /// Numbers of collapses at which a mesh may stop, those of all meshes together.
    levels: usize,
    log_bytes: usize,
}

impl ProgressiveFacts {
    pub(super) fn of(progressive: &ProgressiveAsset) -> Self {
        let sum = |of: fn(&ProgressiveMesh) -> usize| progressive.meshes().map(of).sum();
        let drawn = |triangles: usize| {
            let collapses = progressive.collapses_for(triangles);
            progressive.drawn_triangle_count_at(&collapses)
        };
        Self {
            finest: progressive.drawn_triangle_count_at(&vec![0; progressive.meshes().len()]),
            coarsest: drawn(0),
            collapses: sum(ProgressiveMesh::collapse_count),
            levels: sum(ProgressiveMesh::level_count),
            log_bytes: sum(ProgressiveMesh::log_bytes),
        }
    }

    fn bytes_per_collapse(&self) -> f64 {
        self.log_bytes as f64 / self.collapses.max(1) as f64
    }

    pub(super) fn json(&self) -> Value {
        json!({
            "triangles_finest": self.finest,
            "triangles_coarsest": self.coarsest,
            "collapses": self.collapses,
            "levels": self.levels,
            "log_bytes": self.log_bytes,
            "bytes_per_collapse": self.bytes_per_collapse(),
        })
    }

    pub(super) fn describe(&self, listing: &mut Listing) {
        let count = |n: usize| output::count(n);
        listing.line(
            "levels",
            format!("{}, from {} to {} triangles", count(self.levels), count(self.finest), count(self.coarsest)),
        );
        let each = output::number(self.bytes_per_collapse());
        listing.line("collapses", format!("{}, {each} bytes each", count(self.collapses)));
    }
}
