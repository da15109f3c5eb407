//! The command line: every option, its help and its type, in one place. Help, man pages and completions come from
//! here. What an option means for the work is decided in [`commands`](crate::commands).

mod collapse;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use maille::cluster::ClusterMethod;
use maille::repair::{self, ParseRepairError, Repair};
use maille::simplify::{MetricKind, Order, PlacementKind, QuadricMemory, TopologyPolicy};

pub(crate) use self::collapse::{CollapseArgs, Normals, Preset, Turn, Weights};

const AFTER_HELP: &str = "\
Exit codes:
  0  done
  1  refused: the message on stderr names the file, and nothing is left behind
  2  wrong usage

Formats, found by content when read and by extension when written:
  glTF 2.0 (.gltf, .glb), PLY (.ply), Wavefront OBJ (.obj), STL (.stl), OFF (.off)
  progressive meshes (.mpm): made by `maille progressive`; all commands read the finest level

Begin with:
  maille demo                                 a report with pictures, in a browser
  maille simplify model.glb -o small.glb --ratio 10%
  maille compare model.glb small.glb";

/// Simplifies, converts, compares, repairs and inspects triangle meshes.
#[derive(Debug, Parser)]
#[command(name = "maille", version, after_long_help = AFTER_HELP, max_term_width = 110, arg_required_else_help = true)]
#[command(propagate_version = true, infer_subcommands = false)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Info(InfoArgs),
    Convert(ConvertArgs),
    Sample(SampleArgs),
    Simplify(Box<SimplifyArgs>),
    Lod(Box<LodArgs>),
    Progressive(Box<ProgressiveArgs>),
    Compare(CompareArgs),
    Bench(BenchArgs),
    Repair(RepairArgs),
    Render(RenderArgs),
    Demo(DemoArgs),
    Completions(CompletionsArgs),
    Man(ManArgs),
}

/// What every command that works on files understands.
#[derive(Debug, Args, Clone, Default)]
pub(crate) struct Common {
    /// Threads to use; default: all cores. The result does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "General")]
    pub(crate) threads: Option<u16>,
    /// Prints the results as one JSON object, the last line on stdout.
    #[arg(long, help_heading = "General")]
    pub(crate) json: bool,
    /// Prints nothing but errors, and the results where --json asks for them.
    #[arg(long, short, help_heading = "General")]
    pub(crate) quiet: bool,
}

/// Where the result of a command goes.
#[derive(Debug, Args, Clone)]
#[group(required = true, multiple = false)]
pub(crate) struct Destination {
    /// The file to write; its extension names the format.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// Replaces the input with the result.
    #[arg(long)]
    pub(crate) in_place: bool,
}

/// Tells what a file holds and what is wrong with it.
///
/// Meshes, instances, triangles, vertices (positions) and wedges (a vertex with the attributes of one smooth sector),
/// attributes and their ranges, materials, morph targets, skins, size, area, volume, topology, and every defect that
/// `maille repair` knows.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille info model.glb\n  maille info scan.ply --json")]
pub(crate) struct InfoArgs {
    /// The file to look into.
    pub(crate) file: PathBuf,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Writes a file in another format.
///
/// What both formats can hold is kept: a GLB written as GLTF keeps its scene, materials, skins and animations. Formats
/// without a scene get the meshes where they stand, posed at rest.
#[derive(Debug, Args)]
#[command(
    after_long_help = "Examples:\n  maille convert model.obj -o model.glb\n  maille convert scan.ply --in-place --text"
)]
pub(crate) struct ConvertArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    #[command(flatten)]
    pub(crate) destination: Destination,
    /// Text instead of binary (PLY, STL); OBJ, OFF and .gltf are text anyway, GLB is not.
    #[arg(long)]
    pub(crate) text: bool,
    /// Takes one level of a file with levels of detail, alone: 0 is the original.
    #[arg(long, value_name = "K")]
    pub(crate) level: Option<usize>,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Makes a model in code: no downloads needed.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille sample --list\n  maille sample statue -o statue.glb\n  \
    maille sample statue -o statue.ply --triangles 1000000")]
pub(crate) struct SampleArgs {
    /// Which model; `--list` tells them all.
    #[arg(required_unless_present = "list")]
    pub(crate) name: Option<String>,
    /// The file to write; its extension names the format.
    #[arg(short, long, value_name = "FILE", required_unless_present = "list")]
    pub(crate) output: Option<PathBuf>,
    /// About how many triangles it should have.
    #[arg(long, value_name = "N", value_parser = parse_count, allow_hyphen_values = true)]
    pub(crate) triangles: Option<usize>,
    /// Lists the models and what they are good for.
    #[arg(long)]
    pub(crate) list: bool,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// How many triangles are to be left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Level {
    Triangles(usize),
    Share(f64),
}

impl Level {
    /// The number for a model of `total` triangles.
    pub(crate) fn of(self, total: usize) -> usize {
        match self {
            Self::Triangles(count) => count,
            Self::Share(share) => (share * total as f64).round().max(1.0) as usize,
        }
    }
}

/// A distance, in units of the model or as a share of the diagonal of its bounding box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Distance {
    Units(f64),
    OfDiagonal(f64),
}

impl Distance {
    pub(crate) fn in_units(self, diagonal: f64) -> f64 {
        match self {
            Self::Units(units) => units,
            Self::OfDiagonal(share) => share * diagonal,
        }
    }
}

/// Reduces the number of triangles, by edge collapse or by vertex clustering.
///
/// At least one target is needed; of several, the first one reached stops the work. Everything that is not geometry
/// (materials, textures, skins, animations, extensions) stays as it is, attributes follow the collapses.
///
/// A file with several meshes is one asset: each distinct mesh is simplified once, and a number of triangles is shared
/// out over the meshes where the next collapse costs least (--budget).
#[derive(Debug, Args)]
#[command(after_long_help = SIMPLIFY_EXAMPLES)]
#[command(group = clap::ArgGroup::new("target").required(true).multiple(true))]
pub(crate) struct SimplifyArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    #[command(flatten)]
    pub(crate) destination: Destination,

    /// Stop at this many triangles; those of a mesh that is drawn several times count as often.
    #[arg(long, value_name = "N", group = "target", conflicts_with = "ratio", value_parser = parse_count,
        allow_hyphen_values = true, help_heading = "Target")]
    pub(crate) triangles: Option<usize>,
    /// Stop at this share of the triangles: 0.1 or 10%.
    #[arg(long, value_name = "R", group = "target", value_parser = parse_ratio, allow_hyphen_values = true,
        help_heading = "Target")]
    pub(crate) ratio: Option<f64>,
    /// Stop before the error would exceed this distance: in model units, or as a share of the diagonal of the
    /// bounding box (0.1%). The error is the metric's estimate; --certify proves it.
    #[arg(long, value_name = "E", group = "target", value_parser = parse_distance,
        allow_hyphen_values = true, help_heading = "Target")]
    pub(crate) max_error: Option<Distance>,
    /// Proves that no point of the result is farther from the original than --max-error, nor any of the original from the
    /// result. Several simplifications and proofs, so ten to twenty times the time.
    #[arg(long, requires = "max_error", help_heading = "Target")]
    pub(crate) certify: bool,

    /// How the triangles are shared out over the meshes of a file. error: so that the next collapse would cost the same in
    /// all of them; proportional: to each the same share of its own.
    #[arg(long, value_name = "WAY", value_parser = ["error", "proportional"], default_value = "error",
        help_heading = "Target")]
    pub(crate) budget: String,

    /// How vertices become fewer. collapse: edges collapse one by one; the others cluster vertices, many times as fast, with
    /// a larger error and any topology: quadric-clustering (Lindstrom), vertex-clustering (Rossignac and Borrel),
    /// mean-clustering, floating-cells (Low and Tan). Clustering knows targets, --importance, --lock and --refit, and
    /// nothing of metrics, placements and constraints. Default: collapse.
    #[arg(long, value_name = "NAME", value_parser = named(&METHODS), help_heading = "Method")]
    pub(crate) method: Option<String>,
    /// Cluster vertices first, to this many times the wanted triangles, and collapse the rest: for very large files.
    #[arg(long, value_name = "TIMES", value_parser = parse_multiple, help_heading = "Method")]
    pub(crate) cluster_first: Option<f64>,
    /// In which order edges collapse. exact: the cheapest first; spatial: while many are left, costs within a factor of
    /// 1.5 count as equal, and near edges follow each other; passes: while very many are left, all cores take cheap edges
    /// that do not touch one another, then as spatial. Default: passes.
    #[arg(long, value_name = "ORDER", value_parser = ORDERS, help_heading = "Method")]
    pub(crate) order: Option<String>,
    /// Whether the vertices that are left are fitted to the original in the end: a smaller error for one to five times as
    /// much time more. Default: yes with --preset best.
    #[arg(long, value_name = "yes|no", num_args = 0..=1, default_missing_value = "yes", require_equals = true,
        conflicts_with = "no_self_intersections",
        value_parser = clap::builder::BoolishValueParser::new(), help_heading = "Method")]
    pub(crate) refit: Option<bool>,
    #[command(flatten)]
    pub(crate) collapse: CollapseArgs,

    /// Writes a report, too: one HTML file with pictures before and after, distances as colours, measured errors, shape of
    /// the triangles, time and memory; and the same figures as JSON beside it (FILE with .json). That costs about six more
    /// simplifications, and some seconds to measure and to draw.
    #[arg(long, value_name = "FILE", help_heading = "Report")]
    pub(crate) report: Option<PathBuf>,
    /// Metrics whose errors over the number of triangles the report plots beside those of the chosen one; each costs as
    /// many simplifications again.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = named(&METRICS), requires = "report",
        help_heading = "Report")]
    pub(crate) report_metrics: Vec<String>,
    /// Where errors are plotted: numbers of triangles, or shares such as 10%; each costs a simplification. Default: 8, 4
    /// and 2 times what is left, a half and a quarter of it.
    #[arg(long, value_name = "LEVEL,...", value_delimiter = ',', value_parser = parse_level, requires = "report",
        help_heading = "Report")]
    pub(crate) report_levels: Option<Vec<Level>>,
    /// Which axis of the file points up in the pictures.
    #[arg(long, value_enum, value_name = "AXIS", default_value_t = UpAxis::Y, requires = "report",
        help_heading = "Report")]
    pub(crate) report_up: UpAxis,
    /// Size of its pictures in pixels.
    #[arg(long, value_name = "WxH", default_value = "480x480", value_parser = parse_size, requires = "report",
        help_heading = "Report")]
    pub(crate) report_size: (u32, u32),

    #[command(flatten)]
    pub(crate) common: Common,
}

const SIMPLIFY_EXAMPLES: &str = "\
Examples:
  maille simplify statue.ply -o small.ply --ratio 10%
  maille simplify character.glb -o lod1.glb --triangles 5000 --json
  maille simplify terrain.obj -o out.obj --max-error 0.1% --boundary lock
  maille simplify scan.ply -o within.ply --max-error 0.2% --certify
  maille simplify painted.ply -o out.ply --ratio 0.05 --importance COLOR_0
  maille simplify huge.ply -o preview.ply --triangles 100000 --preset fastest
  maille simplify huge.ply -o out.ply --triangles 100000 --cluster-first 8
  maille simplify scan.ply -o small.ply --ratio 5% --report report.html --report-metrics qem,sem

Attributes are named as `maille info` lists them, or as glTF does (COLOR_0, _IMPORTANCE).";

/// Makes a chain of levels of detail.
///
/// Each mesh of the file is simplified once, all the way, and the levels are moments of that: each level of a skinned
/// character moves with the same skeleton and the same clips. A glTF gets the levels beside the original, as
/// nodes that MSFT_lod lists; other formats get a file to each level (NAME_LOD1.ply and so on).
#[derive(Debug, Args)]
#[command(after_long_help = LOD_EXAMPLES)]
pub(crate) struct LodArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    /// The file to write; its extension names the format.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// What the levels are, the original left out: shares of the triangles such as 10%, or numbers; error=E: as few triangles
    /// as leave that error by the metric's estimate, in units or as a share of the diagonal (error=0.1%); screen=S: as few as
    /// are enough where the model covers so much of the height of a picture (screen=25%). auto: half of the triangles each
    /// time, as long as that leaves 100; auto=screen: good enough for the full height of a picture, a half of it, and so on.
    /// Default: auto; of a file that has levels, those.
    #[arg(long, value_name = "LEVEL,...", value_parser = parse_levels)]
    pub(crate) levels: Option<Levels>,
    /// Takes level K from a file, in which it has been edited by hand, say. Meshes, materials and joints are known by their
    /// names. May be given several times.
    #[arg(long, value_name = "K=FILE", value_parser = parse_edited)]
    pub(crate) edited: Vec<(usize, PathBuf)>,
    /// Error in pixels, in a picture of 1080 lines, that a level may have where it is switched to.
    #[arg(long, value_name = "PX", default_value_t = 1.0, value_parser = parse_positive)]
    pub(crate) pixels: f64,
    /// In which poses the surface is looked at. clips, or clips=N: in N poses (default 16) that stand for all clips; extreme, or
    /// extreme=N: in N poses of joints and morph targets that are made up, for rigs without clips; middle: with all that
    /// clips move in the middle of its range; CLIP@SECONDS: at a moment of a clip; rest: as the file shows it; bind: as the
    /// vertices are stored. Default: clips, where there are some; else extreme, where something moves; else bind.
    #[arg(long, value_name = "POSES")]
    pub(crate) poses: Option<String>,
    /// Whether the vertices of each level are fitted to the original: their places and, if poses are looked at, the weights of
    /// their joints. Default: yes where poses are looked at.
    #[arg(long, value_name = "yes|no", num_args = 0..=1, default_missing_value = "yes", require_equals = true,
        conflicts_with = "no_self_intersections",
        value_parser = clap::builder::BoolishValueParser::new())]
    pub(crate) refit: Option<bool>,
    /// Tells how each level, the original among them, goes over into the next. target: by a morph target named `geomorph`, which
    /// any viewer of glTF can play; attributes: by vertex attributes _MORPH_POSITION and so on, for engines that morph in a
    /// shader; both. Meshes are then written in the order of their levels.
    #[arg(long, value_name = "FORM", num_args = 0..=1, default_missing_value = "target", require_equals = true,
        value_parser = ["target", "attributes", "both"])]
    pub(crate) geomorph: Option<String>,
    /// Gives every vertex the joints and weights of what it becomes, from the coarsest level up to the original: then
    /// the morph target is exact in every pose, but finer levels move less finely.
    #[arg(long, requires = "geomorph")]
    pub(crate) merge_weights: bool,
    /// Writes the triangles of levels as strips: about two indices to a triangle in place of three.
    #[arg(long)]
    pub(crate) strips: bool,
    /// Writes a file to each level also where one glTF could hold all.
    #[arg(long)]
    pub(crate) split_files: bool,
    /// Puts all levels into the scene, named NAME_LOD0, NAME_LOD1 and so on, for engines that know levels by their names.
    #[arg(long, conflicts_with = "split_files")]
    pub(crate) named_nodes: bool,
    #[command(flatten)]
    pub(crate) collapse: CollapseArgs,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// The levels of a chain.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Levels {
    /// Half of the triangles each time.
    Halves,
    /// Half of the height of the picture each time.
    Screens,
    These(Vec<LodLevel>),
}

/// What a level of a chain is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum LodLevel {
    Triangles(Level),
    Error(Distance),
    /// Share of the height of a picture.
    Screen(f64),
}

const LOD_EXAMPLES: &str = "\
Examples:
  maille lod character.glb -o levels.glb
  maille lod character.glb -o levels.glb --levels 50%,25%,10%,3%
  maille lod character.glb -o levels.glb --levels error=0.1%,error=1% --poses walk@0.5
  maille lod levels.glb -o mended.glb --edited 2=by-hand.glb --geomorph
  maille lod scan.ply -o scan.ply --levels 10%,1%";

/// Makes a progressive mesh, or cuts a level out of one.
///
/// Each mesh of the file is simplified once, all the way, and what every collapse changes is kept (.mpm): afterwards a level
/// of any number of triangles costs milliseconds. A file with several meshes is one asset, whose meshes get to a level at
/// the same cost. Nodes, materials, skins and clips are in the file, too.
#[derive(Debug, Args)]
#[command(after_long_help = PROGRESSIVE_EXAMPLES)]
pub(crate) struct ProgressiveArgs {
    /// The file to read: a model, or the .mpm to cut a level out of.
    pub(crate) input: PathBuf,
    /// The file to write: an .mpm, or a level in the format that the extension names.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Cut the finest level of at most so many triangles; those of a mesh that is drawn several times count as often.
    #[arg(long, value_name = "N", conflicts_with = "ratio", value_parser = parse_count, allow_hyphen_values = true)]
    pub(crate) triangles: Option<usize>,
    /// Cut the level of this share of the triangles: 0.1 or 10%.
    #[arg(long, value_name = "R", value_parser = parse_ratio, allow_hyphen_values = true)]
    pub(crate) ratio: Option<f64>,
    /// In which poses the surface is looked at when a progressive mesh is made, as for `maille lod`.
    #[arg(long, value_name = "POSES", conflicts_with_all = ["triangles", "ratio"])]
    pub(crate) poses: Option<String>,
    #[command(flatten)]
    pub(crate) collapse: CollapseArgs,
    #[command(flatten)]
    pub(crate) common: Common,
}

const PROGRESSIVE_EXAMPLES: &str = "\
Examples:
  maille progressive helmet.glb -o helmet.mpm
  maille progressive helmet.mpm -o level.glb --triangles 5000
  maille progressive helmet.mpm -o level.glb --ratio 10%
  maille info helmet.mpm
  maille convert helmet.mpm -o finest.glb";

/// Measures how far two surfaces are apart.
///
/// Points are sampled evenly over each surface, and the distance of each to the nearest point of the other surface is
/// taken: mean, root mean square and maximum, both ways; the symmetric figure is the larger of both. Whole assets are
/// compared as they stand, posed at rest or (--animated) by their clips. Distances are in units of the file and in percent
/// of the diagonal of A.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille compare original.ply small.ply\n  \
    maille compare a.glb b.glb --samples 5000000 --json\n  maille compare original.ply small.ply --exact\n  \
    maille compare a.ply b.ply --heatmap error.glb\n  \
    maille compare character.glb lod1.glb --animated --report motion.html")]
pub(crate) struct CompareArgs {
    /// The original.
    pub(crate) a: PathBuf,
    /// What is compared with it.
    pub(crate) b: PathBuf,
    /// Points sampled on each surface. Default: 1 000 000; with --animated 100 000 in each frame.
    #[arg(long, value_name = "N", value_parser = parse_samples)]
    pub(crate) samples: Option<u64>,
    /// Seed of the sampling: the same seed gives the same figures, with any number of threads.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Looks for the maximum along all edges, too.
    #[arg(long)]
    pub(crate) edges: bool,
    /// Proves the maximum instead of sampling it: the true one lies between two bounds that are as near each other as
    /// --tolerance says, and what is told is the upper one.
    #[arg(long, conflicts_with = "edges")]
    pub(crate) exact: bool,
    /// How near the bounds of --exact are to be: units, or a share of the diagonal of A. Default: 0.0001%.
    #[arg(long, value_name = "D", value_parser = parse_distance, requires = "exact")]
    pub(crate) tolerance: Option<Distance>,
    /// Writes A coloured by its distance to B, from dark violet (none) to yellow (the most); not as STL, which has no
    /// colours at vertices.
    #[arg(long, value_name = "FILE")]
    pub(crate) heatmap: Option<PathBuf>,
    /// The distance that is yellow, in units or as a share of the diagonal; default: the largest.
    #[arg(long, value_name = "D", value_parser = parse_distance, requires = "heatmap")]
    pub(crate) heatmap_max: Option<Distance>,
    /// Measures over the animation clips that both files have, in frames spread evenly over each, and at rest.
    #[arg(long, conflicts_with_all = ["exact", "heatmap"], help_heading = "Animation")]
    pub(crate) animated: bool,
    /// Frames in each clip. Default: 24 over all clips together, but at least 2 in each.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), requires = "animated",
        help_heading = "Animation")]
    pub(crate) frames: Option<u32>,
    /// Writes a report, too: one HTML file with the distances over time, and the same figures as JSON beside it (FILE with
    /// .json).
    #[arg(long, value_name = "FILE", requires = "animated", help_heading = "Animation")]
    pub(crate) report: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Compares ways of working on a model of yours.
#[derive(Debug, Args)]
#[command(
    arg_required_else_help = true,
    after_long_help = "Examples:\n  maille bench metrics model.glb -o metrics.html\n  \
        maille bench popping model.glb -o popping.html"
)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    pub(crate) what: Bench,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    Metrics(MetricsArgs),
    Popping(PoppingArgs),
}

/// Compares metrics and placements on a model: time, measured errors, shape of the triangles, pictures.
///
/// Without --metrics and --placements: all metrics where they place best, and the default metric with all placements. The
/// other options of `simplify` are at their defaults. Each way simplifies the model to each level, from the original, and
/// is measured against it; the table is sorted by the root mean square distance.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille bench metrics model.glb\n  \
    maille bench metrics scan.ply --levels 10%,1000 --metrics qem,qem-hybrid -o metrics.html\n  \
    maille bench metrics scan.ply --threads 1 --repeat 5 -o metrics.md")]
pub(crate) struct MetricsArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    /// What to simplify to: shares such as 10%, or numbers of triangles.
    #[arg(long, value_name = "LEVEL,...", value_delimiter = ',', value_parser = parse_level, default_value = "50%,10%,1%")]
    pub(crate) levels: Vec<Level>,
    /// Only these metrics.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = named(&METRICS))]
    pub(crate) metrics: Vec<String>,
    /// These placements with every metric.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = named(&PLACEMENTS))]
    pub(crate) placements: Vec<String>,
    /// How often each is timed; the fastest turn counts.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) repeat: u32,
    /// Points sampled on each surface.
    #[arg(long, value_name = "N", default_value_t = 200_000, value_parser = parse_samples)]
    pub(crate) samples: u64,
    /// Also writes a report: .html with plots and pictures, and the figures as .json beside it; or .md, the table alone.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// Which axis of the file points up in the pictures.
    #[arg(long, value_enum, value_name = "AXIS", default_value_t = UpAxis::Y)]
    pub(crate) up: UpAxis,
    /// Size of the pictures in pixels.
    #[arg(long, value_name = "WxH", default_value = "420x420", value_parser = parse_size)]
    pub(crate) size: (u32, u32),
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Measures with pictures how much levels of detail pop where they are switched, with geomorphs and without.
///
/// Makes the chain of levels as `maille lod` does and looks at each switch from directions all around the model, where the error
/// of the coarser level is --pixels in a picture of 1080 lines. The largest change of a pixel from one frame to the next is
/// taken, over the frames of a geomorph and over a cut; nothing else moves. Without normals, a model is given some.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille bench popping model.glb\n  \
    maille bench popping character.glb --levels 50%,10% --frames 15 -o popping.html\n  \
    maille bench popping character.glb --morph-target")]
pub(crate) struct PoppingArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    /// What the levels have of the triangles, as in `maille lod`.
    #[arg(long, value_name = "LEVEL,...", value_parser = parse_levels, default_value = "auto")]
    pub(crate) levels: Levels,
    /// In which poses the surface is looked at while it is simplified, as in `maille lod`; it is drawn at rest.
    #[arg(long, value_name = "POSES")]
    pub(crate) poses: Option<String>,
    /// Takes the morph target that `maille lod --geomorph` writes, as a viewer of glTF shows it, instead of a geomorph of all
    /// attributes: joints and weights are those of the finer level up to the switch.
    #[arg(long)]
    pub(crate) morph_target: bool,
    /// Directions to look from, spread evenly over the sphere.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(crate) views: u16,
    /// Frames of a geomorph: 30 are half a second at 60 to the second.
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(crate) frames: u16,
    /// Error in pixels at which levels are switched.
    #[arg(long, value_name = "PX", default_value_t = 1.0, value_parser = parse_positive)]
    pub(crate) pixels: f64,
    /// Most pixels of a picture, up to 512x512: a window onto the middle of a screen of 1080 lines; what is smaller there gets a
    /// smaller one.
    #[arg(long, value_name = "WxH", default_value = "200x200", value_parser = parse_window)]
    pub(crate) size: (u32, u32),
    /// Also writes a report with plots and pictures (.html), and the figures as .json beside it.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Mends defects, one named repair after the other, and tells what each changed.
///
/// Without --all or --only it does what takes nothing away that could be meant: what is not finite, equal positions,
/// degenerate and repeated triangles, edges of more than two triangles, winding, leftovers.
#[derive(Debug, Args)]
#[command(after_long_help = repair_help())]
pub(crate) struct RepairArgs {
    /// The file to read.
    pub(crate) input: PathBuf,
    #[command(flatten)]
    pub(crate) destination: Destination,
    /// All repairs, in the order below.
    #[arg(long, conflicts_with = "only")]
    pub(crate) all: bool,
    /// Only these repairs, in this order.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = parse_repair)]
    pub(crate) only: Option<Vec<Repair>>,
    /// Weld vertices that are this close: units of the mesh, or a share of the diagonal. Default: equal positions.
    #[arg(long, value_name = "D", value_parser = parse_distance)]
    pub(crate) weld_tolerance: Option<Distance>,
    #[command(flatten)]
    pub(crate) common: Common,
}

fn repair_help() -> String {
    let line = |&(name, repair, what): &(&str, Repair, &str)| {
        let standard = Repair::STANDARD.iter().any(|known| known.name() == repair.name());
        format!("  {name:<24} {} {what}\n", if standard { '*' } else { ' ' })
    };
    let table: String = repair::NAMES.iter().map(line).collect();
    format!(
        "Repairs (* done without --all and --only):\n{table}\nExamples:\n  \
         maille repair scan.stl -o clean.ply\n  \
         maille repair soup.ply -o welded.ply --only weld,drop-degenerate --weld-tolerance 0.01%\n  \
         maille repair scan.ply -o parts.ply --only drop-small-components=500"
    )
}

/// Draws a picture of a model, without a graphics card.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille render statue.ply -o statue.png\n  \
    maille render small.glb -o wire.png --wireframe --view 45,10 --size 800x800")]
pub(crate) struct RenderArgs {
    /// The file to draw.
    pub(crate) file: PathBuf,
    /// The picture to write (PNG).
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Size in pixels.
    #[arg(long, value_name = "WxH", default_value = "960x960", value_parser = parse_size)]
    pub(crate) size: (u32, u32),
    /// From where: degrees around the vertical axis, and above the horizon.
    #[arg(long, value_name = "YAW,PITCH", default_value = "30,12", value_parser = parse_view, allow_hyphen_values = true)]
    pub(crate) view: (f32, f32),
    /// Which axis of the file points up.
    #[arg(long, value_enum, default_value_t = UpAxis::Y)]
    pub(crate) up: UpAxis,
    /// Draws the edges of the triangles, too.
    #[arg(long)]
    pub(crate) wireframe: bool,
    /// One normal to each triangle: shows the facets.
    #[arg(long)]
    pub(crate) flat: bool,
    /// Plain clay instead of the model's colours and textures.
    #[arg(long)]
    pub(crate) clay: bool,
    /// What is behind it.
    #[arg(long, value_enum, default_value_t = Background::Studio)]
    pub(crate) background: Background,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Runs the main jobs on built-in models and writes a report with pictures.
///
/// Simplifies a statue to several levels and measures each against the original; makes levels of detail of a character,
/// measures them over its clips and shows one melt into the next. Writes the levels as .glb files and `report.html`, one file
/// that opens in any browser and asks for nothing from the network.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille demo\n  maille demo -o /tmp/demo")]
pub(crate) struct DemoArgs {
    /// The folder to write to; it is made when absent.
    #[arg(short, long, value_name = "DIR", default_value = "maille-demo")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Prints the completions of a shell.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  \
    maille completions bash > ~/.local/share/bash-completion/completions/maille\n  \
    maille completions zsh > ~/.zfunc/_maille\n  \
    maille completions fish > ~/.config/fish/completions/maille.fish")]
pub(crate) struct CompletionsArgs {
    /// Which shell.
    pub(crate) shell: Shell,
}

/// Prints the manual page, or writes one page to each command.
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  maille man | man -l -\n  maille man -o /usr/local/share/man/man1")]
pub(crate) struct ManArgs {
    /// A folder for all pages; it is made when absent. Default: the main page on stdout.
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum UpAxis {
    Y,
    Z,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Background {
    /// A soft grey room
    Studio,
    /// Nothing, with the shadow kept
    Transparent,
}

const METRICS: [&str; MetricKind::NAMES.len()] = names(MetricKind::NAMES);
const METHODS: [&str; 1 + ClusterMethod::NAMES.len()] = {
    let [a, b, c, d] = names(ClusterMethod::NAMES);
    ["collapse", a, b, c, d]
};
const ORDERS: [&str; Order::NAMES.len()] = names(Order::NAMES);
const MEMORIES: [&str; QuadricMemory::NAMES.len()] = names(QuadricMemory::NAMES);
const TOPOLOGIES: [&str; TopologyPolicy::NAMES.len()] = names(TopologyPolicy::NAMES);
const PLACEMENTS: [&str; PlacementKind::NAMES.len()] = names(PlacementKind::NAMES);

const fn names<T: Copy, const N: usize>(pairs: [(&'static str, T); N]) -> [&'static str; N] {
    let mut names = [""; N];
    let mut i = 0;
    while i < N {
        names[i] = pairs[i].0;
        i += 1;
    }
    names
}

fn named(names: &'static [&'static str]) -> clap::builder::PossibleValuesParser {
    names.into()
}

fn parse_number(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| format!("'{text}' is not a number"))
}

fn parse_weight(text: &str) -> Result<(String, f64), String> {
    let (name, factor) = text.rsplit_once('=').ok_or("an attribute and a factor are wanted: normal=2")?;
    Ok((name.trim().to_owned(), parse_non_negative(factor)?))
}

fn parse_non_negative(text: &str) -> Result<f64, String> {
    parse_number(text).and_then(|x| if x >= 0.0 { Ok(x) } else { Err("it must not be negative".into()) })
}

fn parse_multiple(text: &str) -> Result<f64, String> {
    parse_number(text).and_then(|x| if x > 1.0 { Ok(x) } else { Err("it must be more than 1".into()) })
}

fn parse_unit(text: &str) -> Result<f64, String> {
    parse_number(text).and_then(|x| if (0.0..=1.0).contains(&x) { Ok(x) } else { Err("it must be 0 to 1".into()) })
}

fn parse_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) | Err(_) => Err("it must be a whole number from 1 on".into()),
        Ok(count) => Ok(count),
    }
}

fn parse_ratio(text: &str) -> Result<f64, String> {
    let ratio = match text.strip_suffix('%') {
        Some(percent) => parse_number(percent)? / 100.0,
        None => parse_number(text)?,
    };
    let is_share = ratio > 0.0 && ratio <= 1.0;
    if is_share { Ok(ratio) } else { Err("it must be above 0 and at most 1, or above 0% and at most 100%".into()) }
}

fn parse_levels(text: &str) -> Result<Levels, String> {
    match text {
        "auto" => Ok(Levels::Halves),
        "auto=screen" => Ok(Levels::Screens),
        _ => text.split(',').map(|level| parse_lod_level(level.trim())).collect::<Result<_, _>>().map(Levels::These),
    }
}

fn parse_lod_level(text: &str) -> Result<LodLevel, String> {
    match text.split_once('=') {
        None => parse_level(text).map(LodLevel::Triangles).map_err(|_| {
            "levels are shares (10%), numbers of triangles, error=E or screen=S; auto and auto=screen stand alone"
                .to_owned()
        }),
        Some(("error", error)) => parse_distance(error).map(LodLevel::Error),
        Some(("screen", share)) => parse_ratio(share).map(LodLevel::Screen),
        Some((kind, _)) => Err(format!("'{kind}' is no kind of level; there are error=E and screen=S")),
    }
}

fn parse_edited(text: &str) -> Result<(usize, PathBuf), String> {
    let (level, path) = text.split_once('=').ok_or("a level and a file are wanted: 2=FILE")?;
    Ok((parse_count(level)?, path.into()))
}

fn parse_positive(text: &str) -> Result<f64, String> {
    parse_number(text).ok().filter(|&x| x > 0.0).ok_or_else(|| "it must be a number above 0".to_owned())
}

fn parse_level(text: &str) -> Result<Level, String> {
    let is_share = text.contains(['%', '.']);
    if is_share { parse_ratio(text).map(Level::Share) } else { parse_count(text).map(Level::Triangles) }
}

fn parse_distance(text: &str) -> Result<Distance, String> {
    match text.strip_suffix('%') {
        Some(percent) => Ok(Distance::OfDiagonal(parse_non_negative(percent)? / 100.0)),
        None => Ok(Distance::Units(parse_non_negative(text)?)),
    }
}

fn parse_turn(text: &str) -> Result<Turn, String> {
    match text {
        "off" => Ok(Turn(None)),
        _ => match parse_number(text)? {
            degrees if (0.0..=180.0).contains(&degrees) => Ok(Turn(Some(degrees))),
            _ => Err("it must be 0 to 180 degrees, or off".into()),
        },
    }
}

fn parse_repair(text: &str) -> Result<Repair, ParseRepairError> {
    text.parse()
}

fn parse_range(text: &str) -> Result<(u32, u32), String> {
    let (low, high) = text.split_once("..").ok_or("it must look like 4..11")?;
    let number = |text: &str| text.parse::<u32>().map_err(|_| format!("'{text}' is not a whole number"));
    match (number(low)?, number(high)?) {
        (low, high) if low <= high => Ok((low, high)),
        _ => Err("the lower bound must not exceed the upper one".into()),
    }
}

fn parse_samples(text: &str) -> Result<u64, String> {
    let count: u64 = text.replace('_', "").parse().map_err(|_| format!("'{text}' is not a whole number"))?;
    if (1..=2_000_000_000).contains(&count) { Ok(count) } else { Err("it must be 1 to 2 000 000 000".into()) }
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let (width, height) = text.split_once('x').ok_or("it must look like 960x960")?;
    let side = |text: &str| {
        let side = text.parse().map_err(|_| format!("'{text}' is not a whole number"))?;
        if (16..=8192).contains(&side) { Ok(side) } else { Err("sides must be 16 to 8192 pixels".to_owned()) }
    };
    Ok((side(width)?, side(height)?))
}

/// The size of a picture of which each pixel has hundreds of samples in memory.
fn parse_window(text: &str) -> Result<(u32, u32), String> {
    match parse_size(text)? {
        (width, height) if width.max(height) > 512 => Err("it must be 512x512 at most".into()),
        size => Ok(size),
    }
}

fn parse_view(text: &str) -> Result<(f32, f32), String> {
    let (yaw, pitch) = text.split_once(',').ok_or("it must look like 30,12")?;
    let (yaw, pitch) = (parse_number(yaw)?, parse_number(pitch)?);
    if pitch.abs() > 89.0 {
        return Err("the second angle must be -89 to 89 degrees".into());
    }
    Ok((yaw as f32, pitch as f32))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn definitions_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn distances_take_units_and_percent() {
        assert_eq!(parse_distance("0.5"), Ok(Distance::Units(0.5)));
        assert_eq!(parse_distance("50%"), Ok(Distance::OfDiagonal(0.5)));
        assert_eq!(Distance::OfDiagonal(0.5).in_units(4.0), 2.0);
        assert!(parse_distance("-1").is_err() && parse_distance("nan").is_err() && parse_distance("inf%").is_err());
    }

    #[test]
    fn ratios_take_shares_and_percent() {
        assert_eq!(parse_ratio("0.1"), Ok(0.1));
        assert_eq!(parse_ratio("10%"), Ok(0.1));
        assert!(parse_ratio("1.5").is_err() && parse_ratio("0").is_err() && parse_ratio("x").is_err());
    }

    #[test]
    fn levels_are_shares_or_counts() {
        assert_eq!(parse_level("10%"), Ok(Level::Share(0.1)));
        assert_eq!(parse_level("0.25").map(|level| level.of(1000)), Ok(250));
        assert_eq!(parse_level("500").map(|level| level.of(1000)), Ok(500));
        assert!(parse_level("0").is_err() && parse_level("200%").is_err() && parse_level("few").is_err());
    }

    #[test]
    fn ranges_and_sizes_are_checked() {
        assert_eq!(parse_range("4..11"), Ok((4, 11)));
        assert!(parse_range("11..4").is_err() && parse_range("4").is_err());
        assert_eq!(parse_size("640x480"), Ok((640, 480)));
        assert!(parse_size("0x480").is_err() && parse_size("640").is_err());
        assert!(parse_view("30,90").is_err());
    }
}
