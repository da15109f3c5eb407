//! `maille lod`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use maille_io::{
    Asset, Format, GeomorphForm, LevelTarget, LodChain, LodOptions, Pixels, PoseSet, WriteOptions, lod_chain,
};
use serde_json::{Value, json};

use super::collapse::{self, refusal};
use crate::args::{Level, Levels, LodArgs, LodLevel, Preset};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;
use crate::stages::Ledger;

/// Triangles that a level of `auto` has at least.
const FEWEST: usize = 100;
/// Levels of `auto=screen`: the last is for a model of 8 lines.
const SCREENS: i32 = 8;
/// Poses that stand for all clips, or for all that a rig may take, where the user does not say how many.
const POSES: usize = 16;
/// The vertical field of view behind distances, in degrees.
const FIELD_OF_VIEW: f64 = 60.0;

pub(crate) fn run(args: &LodArgs) -> Result<(), Failure> {
    super::check_output(&args.output)?;
    let in_one_file = !args.split_files && matches!(Format::from_path(&args.output), Some(Format::Gltf | Format::Glb));
    if args.named_nodes && !in_one_file {
        return Err(Failure::Usage(
            "--named-nodes is for .glb and .gltf; other formats get a file to each level".into(),
        ));
    }
    let session = Session::start(&args.common)?;
    let mut ledger = Ledger::new(false);
    let (asset, targets) = ledger.stage("read", |_| read(args, &session))?;
    let poses = poses(args.poses.as_deref(), &asset)?;
    let is_best = args.collapse.preset == Preset::Best;
    let fits = is_best || poses != PoseSet::Bind && !args.collapse.no_self_intersections;
    let options = LodOptions {
        collapse: collapse::options(&args.collapse, &asset)?,
        levels: targets,
        refit: args.refit.unwrap_or(fits),
        poses,
        geomorph: GeomorphForm {
            target: matches!(args.geomorph.as_deref(), Some("target" | "both")),
            attributes: matches!(args.geomorph.as_deref(), Some("attributes" | "both")),
            merge_weights: args.merge_weights,
        },
        pixels: Pixels(args.pixels),
    };
    let count = 1 + options.levels.len();
    let paths = if in_one_file { vec![args.output.clone()] } else { paths(&args.output).take(count).collect() };
    let inputs = || std::iter::once(&args.input).chain(args.edited.iter().map(|(_, path)| path));
    if let Some(path) = paths.iter().find(|path| inputs().any(|input| super::is_same_file(input, path))) {
        let message = "this is an input; give another name to keep it";
        return Err(Failure::Usage(format!("{}: {message}", path.display())));
    }
    let chain = ledger.stage("levels", |times| {
        let control = session.control();
        lod_chain(&asset, &options, control.with_times(times)).map_err(|error| refusal(&args.input, &error))
    })?;
    session.checkpoint()?;
    let warnings = missed(args, &chain, &options.levels);
    warnings.iter().for_each(|warning| session.note(warning));
    let form = WriteOptions { strips: args.strips, ..WriteOptions::default() };
    let files = ledger.stage("write", |_| -> Result<_, Failure> {
        if in_one_file {
            let whole = if args.named_nodes { asset.with_named_levels(&chain) } else { asset.with_levels(&chain) };
            return Ok(session.write(&whole, &args.output, &form)?.files);
        }
        let original = match chain.original.as_slice() {
            [] => asset.clone(),
            _ => asset.at_level(&maille_io::LodLevel { meshes: chain.original.clone(), ..Default::default() }),
        };
        let mut files = session.write(&original, &paths[0], &form)?.files;
        for (level, path) in chain.levels.iter().zip(&paths[1..]) {
            files.extend(session.write(&asset.at_level(level), path, &form)?.files);
        }
        Ok(files)
    })?;
    let done = Done { chain, asset, files, ledger, warnings };
    session.result(|| done.json(args, &session), || done.text(args))
}

/// The original, and what each level is to be.
fn read(args: &LodArgs, session: &Session) -> Result<(Asset, Vec<LevelTarget>), Failure> {
    let asset = session.read(&args.input)?;
    let (asset, mut targets) = match (asset.split_levels(), &args.levels) {
        (Some(Err(reason)), _) => {
            let message = format!("its levels of detail cannot be told from the rest: {reason}");
            return Err(Failure::about(&args.input, &message));
        }
        (Some(Ok((whole, kept))), None) => {
            let geomorphs = if args.geomorph.is_some() { "" } else { ", without geomorphs (--geomorph makes them)" };
            let count = kept.len();
            session.note(&format!("the {count} levels of the file are kept{geomorphs}; --levels makes them anew"));
            let target = |level: maille_io::LodLevel| {
                let error = (level.error > 0.0).then_some(level.error);
                LevelTarget::Meshes { meshes: level.meshes, error }
            };
            (whole, kept.into_iter().map(target).collect())
        }
        (Some(Ok((whole, kept))), Some(levels)) => {
            session.note(&format!("the {} levels that the file has are made anew", kept.len()));
            let targets = targets(levels, &whole)?;
            (whole, targets)
        }
        (None, levels) => {
            let targets = targets(levels.as_ref().unwrap_or(&Levels::Halves), &asset)?;
            (asset, targets)
        }
    };
    for (level, path) in &args.edited {
        let count = targets.len();
        let place = targets.get_mut(level - 1).ok_or_else(|| {
            Failure::Usage(format!("--edited: there is no level {level}; there are {count} (0 is the original)"))
        })?;
        let file = session.read(path)?;
        let meshes = asset.level_from(&file);
        let refused = |reason: String| Failure::about(path, format!("it cannot be level {level}: {reason}"));
        *place = LevelTarget::Meshes { meshes: meshes.map_err(refused)?, error: None };
    }
    Ok((asset, targets))
}

/// What each level is to be that `--levels` asks for.
pub(super) fn targets(levels: &Levels, asset: &Asset) -> Result<Vec<LevelTarget>, Failure> {
    let total = asset.drawn_triangle_count();
    let diagonal = super::diagonal(asset);
    match levels {
        Levels::Halves => {
            let halves = std::iter::successors(Some(total / 2), |level| Some(level / 2));
            Ok(halves.take_while(|&n| n >= FEWEST).map(LevelTarget::Triangles).collect())
        }
        Levels::Screens => Ok((0..SCREENS).map(|k| LevelTarget::Screen(0.5_f64.powi(k))).collect()),
        Levels::These(levels) => {
            let target = |level: &LodLevel| match level {
                LodLevel::Triangles(level) => LevelTarget::Triangles(level.of(total)),
                LodLevel::Error(error) => LevelTarget::Error(error.in_units(diagonal)),
                LodLevel::Screen(share) => LevelTarget::Screen(*share),
            };
            let counts = |level: &LodLevel| match level {
                LodLevel::Triangles(level) => Some(Level::of(*level, total)),
                _ => None,
            };
            let counts: Vec<usize> = levels.iter().filter_map(counts).collect();
            if counts.windows(2).any(|pair| pair[0] <= pair[1]) {
                return Err(Failure::Usage(
                    "--levels: each level must have fewer triangles than the one before".into(),
                ));
            }
            Ok(levels.iter().map(target).collect())
        }
    }
}

/// Which levels are not as they were wanted, in words.
fn missed(args: &LodArgs, chain: &LodChain, targets: &[LevelTarget]) -> Vec<String> {
    let made: BTreeMap<usize, usize> = chain.levels.iter().enumerate().map(|(k, level)| (level.target, k)).collect();
    let is_asked = matches!(args.levels, Some(Levels::These(_)));
    let missed = |(target, wanted): (usize, &LevelTarget)| match (made.get(&target), wanted) {
        (None, _) if is_asked => {
            Some(format!("wanted level {} is left out: it is no coarser than the one before", target + 1))
        }
        (Some(&k), LevelTarget::Triangles(wanted)) if chain.levels[k].triangles > *wanted => {
            let (found, wanted) = (output::count(chain.levels[k].triangles), output::count(*wanted));
            Some(format!("level {} has {found} triangles, not {wanted}: no more may collapse", k + 1))
        }
        _ => None,
    };
    targets.iter().enumerate().filter_map(missed).collect()
}

/// The files of the levels, the original first.
fn paths(output: &Path) -> impl Iterator<Item = PathBuf> + '_ {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = output.extension().unwrap_or_default().to_string_lossy().into_owned();
    (0..).map(move |level| output.with_file_name(format!("{stem}_LOD{level}.{extension}")))
}

/// The poses that `--poses` asks for.
pub(super) fn poses(text: Option<&str>, asset: &Asset) -> Result<PoseSet, Failure> {
    let refuse = |message: String| Err(Failure::Usage(format!("--poses: {message}")));
    let clips = asset.clips();
    let Some(text) = text else {
        return Ok(match (clips.is_empty(), asset.is_articulated()) {
            (false, _) => PoseSet::Clips { most: POSES },
            (true, true) => PoseSet::Extreme { most: POSES },
            (true, false) => PoseSet::Bind,
        });
    };
    let (kind, number) = text.split_once('=').map_or((text, None), |(kind, number)| (kind, Some(number)));
    let most = match number.map(str::parse) {
        None => POSES,
        Some(Ok(most)) if most > 0 && matches!(kind, "clips" | "extreme") => most,
        _ => return refuse(format!("'{text}' is no number of poses: clips=16, extreme=16")),
    };
    let moment = || {
        let (name, seconds) = text.rsplit_once('@')?;
        let clip = clips.iter().position(|clip| clip.name == name)?;
        Some(PoseSet::Frame { clip, seconds: seconds.parse().ok().filter(|seconds: &f64| seconds.is_finite())? })
    };
    match kind {
        "bind" => Ok(PoseSet::Bind),
        "rest" => Ok(PoseSet::Rest),
        "extreme" => Ok(PoseSet::Extreme { most }),
        _ if clips.is_empty() => refuse("the file has no clips; extreme, bind and rest are what there is".into()),
        "clips" => Ok(PoseSet::Clips { most }),
        "middle" => Ok(PoseSet::Middle),
        _ => moment().map_or_else(
            || {
                let names: Vec<&str> = clips.iter().map(|clip| clip.name.as_str()).collect();
                let known = "clips, clips=N, extreme, extreme=N, middle, bind, rest and CLIP@SECONDS";
                refuse(format!("'{text}' is none of {known}; the clips are: {}", names.join(", ")))
            },
            Ok,
        ),
    }
}

struct Done {
    chain: LodChain,
    asset: Asset,
    files: Vec<PathBuf>,
    ledger: Ledger,
    warnings: Vec<String>,
}

impl Done {
    fn json(&self, args: &LodArgs, session: &Session) -> Value {
        let coverage = self.chain.screen_coverage();
        let levels = self.chain.levels.iter().zip(&coverage).map(|(level, coverage)| {
            json!({
                "triangles": level.triangles,
                "error": level.error,
                "screen_coverage": coverage,
                "switch": self.chain.switch_distance(level, FIELD_OF_VIEW.to_radians()),
                "residual": level.residual,
            })
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
            "warnings": ([&self.asset.warnings[..], &self.warnings].concat()),
        })
    }

    fn text(&self, args: &LodArgs) -> String {
        let mut listing = Listing::default();
        let triangles = output::count(self.asset.drawn_triangle_count());
        listing.heading(format!("{}: {triangles} triangles", args.input.display()));
        for (k, (level, coverage)) in self.chain.levels.iter().zip(self.chain.screen_coverage()).enumerate() {
            let error = output::distance(level.error, self.chain.diameter);
            let mut told = format!(
                "{} triangles, error {error}; good below {:.3} % of the picture's height",
                output::count(level.triangles),
                100.0 * coverage
            );
            if let Some(residual) = level.residual.filter(|&residual| residual > 0.0) {
                let residual = output::distance(residual, self.chain.diameter);
                told += &format!("; in poses, the morph to it ends up to {residual} off");
            }
            listing.line(format!("level {}", k + 1), told);
        }
        listing.line("time", output::seconds(self.ledger.seconds("levels")));
        listing.line("written", output::paths(&self.files).join(", "));
        listing.text()
    }
}
