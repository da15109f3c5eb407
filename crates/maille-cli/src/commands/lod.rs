//! `maille lod`

use std::path::{Path, PathBuf};

use maille::simplify::SimplifyOptions;
use maille_io::{Asset, Format, LodChain, LodOptions, PoseSet, WriteOptions, lod_chain};
use serde_json::{Value, json};

use super::simplify::refusal;
use crate::args::{Levels, LodArgs};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;
use crate::stages::Ledger;

/// Triangles that a level of `auto` has at least.
const FEWEST: usize = 100;
/// Poses that stand for all clips, where the user does not say how many.
const POSES: usize = 16;

pub(crate) fn run(args: &LodArgs) -> Result<(), Failure> {
    super::check_output(&args.output)?;
    let in_one_file = !args.split_files && matches!(Format::from_path(&args.output), Some(Format::Gltf | Format::Glb));
    let session = Session::start(&args.common)?;
    let mut ledger = Ledger::new(false);
    let asset = ledger.stage("read", |_| session.read(&args.input))?;
    if asset.has_levels() {
        let message = "the file has levels of detail already (make the chain of the original)";
        return Err(Failure::about(&args.input, message));
    }
    let poses = poses(args.poses.as_deref(), &asset)?;
    let options = LodOptions {
        simplify: SimplifyOptions::default(),
        levels: levels(&args.levels, asset.drawn_triangle_count())?,
        refit: args.refit.unwrap_or(poses != PoseSet::Bind),
        poses,
        geomorph: args.geomorph,
    };
    let count = 1 + options.levels.len();
    let paths = if in_one_file { vec![args.output.clone()] } else { paths(&args.output).take(count).collect() };
    if let Some(path) = paths.iter().find(|path| super::is_same_file(&args.input, path)) {
        let message = "this is the input; give another name to keep it";
        return Err(Failure::Usage(format!("{}: {message}", path.display())));
    }
    let chain = ledger.stage("levels", |times| {
        let control = session.control();
        lod_chain(&asset, &options, control.with_times(times)).map_err(|error| refusal(&args.input, &error))
    })?;
    session.checkpoint()?;
    for (k, (level, wanted)) in chain.levels.iter().zip(&options.levels).enumerate() {
        if level.triangles > *wanted {
            let (found, wanted) = (output::count(level.triangles), output::count(*wanted));
            session.note(&format!("level {} has {found} triangles, not {wanted}: no more may collapse", k + 1));
        }
    }
    let files = ledger.stage("write", |_| -> Result<_, Failure> {
        if in_one_file {
            let written = session.write(&asset.with_levels(&chain), &args.output, &WriteOptions::default())?;
            return Ok(written.files);
        }
        let mut files = Vec::new();
        for (level, path) in std::iter::once(None).chain(chain.levels.iter().map(Some)).zip(&paths) {
            let asset = level.map_or_else(|| asset.clone(), |level| asset.at_level(level));
            files.extend(session.write(&asset, path, &WriteOptions::default())?.files);
        }
        Ok(files)
    })?;
    let done = Done { chain, asset, files, ledger };
    session.result(|| done.json(args, &session), || done.text(args))
}

/// The files of the levels, the original first.
fn paths(output: &Path) -> impl Iterator<Item = PathBuf> + '_ {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = output.extension().unwrap_or_default().to_string_lossy().into_owned();
    (0..).map(move |level| output.with_file_name(format!("{stem}_LOD{level}.{extension}")))
}

/// The triangles of each level that `--levels` asks for.
pub(super) fn levels(levels: &Levels, total: usize) -> Result<Vec<usize>, Failure> {
    match levels {
        Levels::Auto => {
            Ok(std::iter::successors(Some(total / 2), |level| Some(level / 2)).take_while(|&n| n >= FEWEST).collect())
        }
        Levels::These(levels) => {
            let levels: Vec<usize> = levels.iter().map(|level| level.of(total)).collect();
            if levels.windows(2).any(|pair| pair[0] <= pair[1]) {
                return Err(Failure::Usage(
                    "--levels: each level must have fewer triangles than the one before".into(),
                ));
            }
            Ok(levels)
        }
    }
}

/// The poses that `--poses` asks for.
pub(super) fn poses(text: Option<&str>, asset: &Asset) -> Result<PoseSet, Failure> {
    let refuse = |message: String| Err(Failure::Usage(format!("--poses: {message}")));
    let has_clips = !asset.clips().is_empty();
    let Some(text) = text else {
        return Ok(if has_clips { PoseSet::Clips { most: POSES } } else { PoseSet::Bind });
    };
    let names = || asset.clips().iter().map(|clip| clip.name.as_str()).collect::<Vec<_>>().join(", ");
    match text.split_once('=') {
        _ if text == "bind" => Ok(PoseSet::Bind),
        _ if text == "rest" => Ok(PoseSet::Rest),
        _ if !has_clips => refuse("the file has no clips; bind and rest are what there is".into()),
        _ if text == "clips" => Ok(PoseSet::Clips { most: POSES }),
        Some(("clips", number)) => match number.parse() {
            Ok(most) if most > 0 => Ok(PoseSet::Clips { most }),
            _ => refuse(format!("'{number}' is no number of poses")),
        },
        _ => {
            let moment = text.rsplit_once('@').and_then(|(name, seconds)| {
                let clip = asset.clips().iter().position(|clip| clip.name == name)?;
                Some((clip, seconds.parse::<f64>().ok().filter(|seconds| seconds.is_finite())?))
            });
            match moment {
                Some((clip, seconds)) => Ok(PoseSet::Frame { clip, seconds }),
                None => refuse(format!(
                    "'{text}' is none of clips, clips=N, bind, rest and CLIP@SECONDS; the clips are: {}",
                    names()
                )),
            }
        }
    }
}

struct Done {
    chain: LodChain,
    asset: Asset,
    files: Vec<PathBuf>,
    ledger: Ledger,
}

impl Done {
    fn json(&self, args: &LodArgs, session: &Session) -> Value {
        let coverage = self.chain.screen_coverage();
        let levels = self.chain.levels.iter().zip(&coverage).map(|(level, coverage)| {
            json!({ "triangles": level.triangles, "error": level.error, "screen_coverage": coverage })
        });
        let levels: Vec<Value> = levels.collect();
        json!({
            "input": args.input.display().to_string(),
            "output": args.output.display().to_string(),
            "files": output::paths(&self.files),
            "triangles_in": self.asset.drawn_triangle_count(),
            "levels": levels,
            "diagonal": self.chain.diameter,
            "seconds": self.ledger.seconds("levels"),
            "stages": self.ledger.json(),
            "threads": session.threads(),
            "peak_bytes": self.ledger.peak_bytes(),
        })
    }

    fn text(&self, args: &LodArgs) -> String {
        let mut listing = Listing::default();
        let triangles = output::count(self.asset.drawn_triangle_count());
        listing.heading(format!("{}: {triangles} triangles", args.input.display()));
        for (k, (level, coverage)) in self.chain.levels.iter().zip(self.chain.screen_coverage()).enumerate() {
            let error = output::distance(level.error, self.chain.diameter);
            let told = format!(
                "{} triangles, error {error} as the metric estimates; good below {:.3} % of the picture's height",
                output::count(level.triangles),
                100.0 * coverage
            );
            listing.line(format!("level {}", k + 1), told);
        }
        listing.line("time", output::seconds(self.ledger.seconds("levels")));
        listing.line("written", output::paths(&self.files).join(", "));
        listing.text()
    }
}
