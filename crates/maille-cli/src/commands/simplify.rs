//! `maille simplify`

use std::cmp::Reverse;
use std::path::PathBuf;
use std::time::Instant;

use maille::refit::RefitOptions;
use maille::simplify::{
    EdgePolicy, MetricKind, Order, PlacementKind, Refusals, SimplifyError, SimplifyOptions, Stop, TopologyPolicy,
};
use maille_io::{Asset, AssetOptions, AssetReport, ProcessError, WriteOptions, Written, simplify_asset};
use serde_json::{Value, json};

use crate::args::{Preset, SimplifyArgs};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;
use crate::system;

pub(crate) fn run(args: &SimplifyArgs) -> Result<(), Failure> {
    let path = super::destination(&args.input, &args.destination)?;
    let session = Session::start(&args.common)?;
    let mut asset = session.read(&args.input)?;
    let diagonal = super::diagonal(&asset);
    let options = options(args, &asset, diagonal);
    let start = Instant::now();
    let report = simplify_asset(&mut asset, &options, session.control()).map_err(|error| refusal(args, &error))?;
    let seconds = start.elapsed().as_secs_f64();
    session.checkpoint()?;
    let written = session.write(&asset, &path, &WriteOptions::default())?;
    let done = Done { report, seconds, diagonal, options: options.simplify, path, written };
    session.result(|| done.json(args, &session, &asset), || done.text(args))
}

/// What the options mean for this asset.
fn options(args: &SimplifyArgs, asset: &Asset, diagonal: f64) -> AssetOptions {
    let mut simplify = preset(args.preset);
    let by_ratio = |ratio: f64| (ratio * asset.triangle_count() as f64).round().max(1.0) as usize;
    simplify.target.triangles = args.triangles.or(args.ratio.map(by_ratio));
    simplify.target.max_error = args.max_error.map(|error| error.in_units(diagonal));
    if let Some(metric) = args.metric.as_deref().and_then(|name| by_name(&MetricKind::NAMES, name)) {
        simplify.metric = metric;
    }
    if let Some(placement) = args.placement.as_deref().and_then(|name| by_name(&PlacementKind::NAMES, name)) {
        simplify.placement = placement;
    }
    if let Some(order) = args.order.as_deref().and_then(|name| by_name(&Order::NAMES, name)) {
        simplify.order = order;
    }
    simplify.quadric_weight = args.weights.into();
    for (place, given) in [
        (&mut simplify.boundary, args.boundary),
        (&mut simplify.seams, args.seams),
        (&mut simplify.material_borders, args.material_borders),
    ] {
        if let Some(policy) = given {
            *place = policy.into();
        }
    }
    simplify.constraint_weight = args.constraint_weight;
    if let Some(topology) = args.topology.as_deref().and_then(|name| by_name(&TopologyPolicy::NAMES, name)) {
        simplify.topology = topology;
    }
    simplify.max_normal_turn = args.max_normal_turn.0.map(f64::to_radians);
    simplify.valence = args.valence;
    simplify.min_quality = args.min_quality;
    simplify.no_self_intersections = args.no_self_intersections;
    simplify.join_distance = args.join_distance.map(|distance| distance.in_units(diagonal));
    simplify.normals = args.normals.into();
    simplify.max_influences = args.max_influences;
    let refit =
        args.refit.unwrap_or(args.preset == Preset::Best && !args.no_self_intersections).then(RefitOptions::default);
    AssetOptions {
        simplify,
        importance: args.importance.clone(),
        lock: args.lock.clone(),
        refit,
        certify: args.certify,
    }
}

/// The bundle of options that a preset stands for.
pub(crate) fn preset(preset: Preset) -> SimplifyOptions {
    let balanced = SimplifyOptions::default();
    match preset {
        Preset::Balanced => balanced,
        Preset::Fast => SimplifyOptions { metric: MetricKind::ConstrainedQuadric, ..balanced },
        Preset::Best => SimplifyOptions { order: Order::Exact, ..balanced },
        Preset::Aggressive => SimplifyOptions {
            boundary: EdgePolicy::Free,
            seams: EdgePolicy::Free,
            material_borders: EdgePolicy::Free,
            topology: TopologyPolicy::Free,
            ..balanced
        },
    }
}

fn by_name<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(known, _)| *known == name).map(|&(_, value)| value)
}

fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    names.iter().find(|(_, known)| known == value).map_or("", |&(name, _)| name)
}

fn refusal(args: &SimplifyArgs, error: &ProcessError) -> Failure {
    match error {
        ProcessError::Mesh { error: SimplifyError::Cancelled(_), .. } => Failure::Cancelled,
        ProcessError::Mesh { error: SimplifyError::NotFinite { .. }, .. } => {
            let remedy = format!("maille repair {} -o OUT --all", args.input.display());
            Failure::Refused(format!("cannot simplify {}: {error} ({remedy})", args.input.display()))
        }
        _ => Failure::Refused(format!("cannot simplify {}: {error}", args.input.display())),
    }
}

/// What has been done, ready to be told.
struct Done {
    report: AssetReport,
    seconds: f64,
    diagonal: f64,
    options: SimplifyOptions,
    path: PathBuf,
    written: Written,
}

/// A constraint that refused collapses.
struct Barrier {
    refused: u64,
    what: String,
    remedy: String,
}

impl Done {
    fn json(&self, args: &SimplifyArgs, session: &Session, asset: &Asset) -> Value {
        let report = &self.report;
        let refits = report.refits.iter().map(|refit| {
            json!({
                "rms_before": refit.rms_before, "rms_after": refit.rms_after,
                "max_before": refit.max_before, "max_after": refit.max_after,
            })
        });
        let refits: Vec<Value> = refits.collect();
        json!({
            "input": args.input.display().to_string(),
            "output": self.path.display().to_string(),
            "files": output::paths(&self.written.files),
            "triangles_in": report.triangles_in,
            "triangles_out": report.triangles_out,
            "seconds": self.seconds,
            "threads": session.threads(),
            "peak_bytes": system::peak_bytes(),
            "stopped": stop_name(report.stopped),
            "error": report.error,
            "max_error_proven": report.max_error_proven,
            "max_error_found": report.max_error_found,
            "diagonal": self.diagonal,
            "collapses": report.collapses,
            "refit": refits,
            "refused": refusals(&report.refused).into_iter().collect::<serde_json::Map<_, _>>(),
            "preset": preset_name(args.preset),
            "metric": name_of(&MetricKind::NAMES, &self.options.metric),
            "placement": name_of(&PlacementKind::NAMES, &self.options.placement),
            "meshes": report.meshes.len(),
            "warnings": ([&asset.warnings[..], &self.written.warnings[..]].concat()),
        })
    }

    fn text(&self, args: &SimplifyArgs) -> String {
        let report = &self.report;
        let mut listing = Listing::default();
        let (before, after) = (output::count(report.triangles_in), output::count(report.triangles_out));
        listing.heading(format!("{}: {before} -> {after} triangles", args.input.display()));
        listing.line("time", output::seconds(self.seconds));
        listing.line("stopped", explanation(report.stopped));
        listing.line("error", format!("{}, as the metric estimates", output::distance(report.error, self.diagonal)));
        if let (Some(proven), Some(found)) = (report.max_error_proven, report.max_error_found) {
            let distance = output::distance(proven, self.diagonal);
            listing.line("proven", format!("no point of either surface is farther from the other than {distance}"));
            listing
                .line("farthest", format!("{}, as far as the proof has seen", output::distance(found, self.diagonal)));
        }
        if let [refit] = report.refits.as_slice() {
            let [before, after] = [refit.rms_before, refit.rms_after].map(|rms| output::distance(rms, self.diagonal));
            listing.line("fitted", format!("root mean square distance {before} -> {after}"));
        }
        let barriers = self.barriers();
        let refused: Vec<String> =
            barriers.iter().map(|b| format!("{} {}", output::count(b.refused), b.what)).collect();
        if !refused.is_empty() {
            listing.line("refused", format!("collapses: {}", refused.join(", ")));
        }
        if report.stopped == Stop::NoLegalCollapse {
            barriers.iter().for_each(|barrier| listing.line("remedy", barrier.remedy.clone()));
        }
        listing.line("wrote", output::written(&self.written.files));
        if !args.destination.in_place {
            listing.line("measure", format!("maille compare {} {}", args.input.display(), self.path.display()));
        }
        listing.text()
    }

    /// What refused collapses, the most first, in words, with the option that relaxes it.
    fn barriers(&self) -> Vec<Barrier> {
        let refused = &self.report.refused;
        let barrier = |refused, what: &str, remedy: &str| Barrier { refused, what: what.into(), remedy: remedy.into() };
        let (preserved, relaxed) = self.edges_under(EdgePolicy::Preserve);
        let (_, unlocked) = self.edges_under(EdgePolicy::Lock);
        let unlocked = if unlocked.is_empty() { "fewer vertices under --lock".to_owned() } else { unlocked };
        let all = [
            barrier(refused.topology, "for the topology", "--topology free, or --preset aggressive"),
            barrier(refused.fold_over, "for fold-over", "a larger --max-normal-turn, or --preset aggressive"),
            barrier(refused.border, &format!("that would tear {preserved}"), &relaxed),
            barrier(refused.locked, "between locked vertices", &unlocked),
            barrier(refused.valence, "for the valence", "a wider --valence"),
            barrier(refused.quality, "for the quality of triangles", "a lower --min-quality"),
            barrier(refused.self_intersections, "for self-intersections", "without --no-self-intersections"),
        ];
        let mut found: Vec<Barrier> = all.into_iter().filter(|barrier| barrier.refused > 0).collect();
        found.sort_by_key(|barrier| Reverse(barrier.refused));
        found
    }

    /// The edges that a policy is for, in words, and the options that relax it.
    fn edges_under(&self, wanted: EdgePolicy) -> (String, String) {
        let policies = [
            (self.options.boundary, "open borders", "--boundary"),
            (self.options.seams, "seams", "--seams"),
            (self.options.material_borders, "material borders", "--material-borders"),
        ];
        let chosen = policies.into_iter().filter(|(policy, ..)| *policy == wanted);
        let (edges, options): (Vec<&str>, Vec<String>) =
            chosen.map(|(_, edges, option)| (edges, format!("{option} hold (or free)"))).unzip();
        (edges.join(", "), options.join(", "))
    }
}

fn refusals(refused: &Refusals) -> [(String, Value); 7] {
    [
        ("topology", refused.topology),
        ("fold_over", refused.fold_over),
        ("border", refused.border),
        ("locked", refused.locked),
        ("valence", refused.valence),
        ("quality", refused.quality),
        ("self_intersections", refused.self_intersections),
    ]
    .map(|(name, n)| (name.to_owned(), n.into()))
}

fn stop_name(stop: Stop) -> &'static str {
    match stop {
        Stop::Triangles => "triangles",
        Stop::MaxError => "max_error",
        Stop::NoLegalCollapse => "no_legal_collapse",
        Stop::Exhausted => "exhausted",
        _ => "other",
    }
}

fn explanation(stop: Stop) -> &'static str {
    match stop {
        Stop::Triangles => "the number of triangles is reached",
        Stop::MaxError => "the next collapse would exceed the largest error",
        Stop::NoLegalCollapse => "the constraints forbid every collapse that is left",
        Stop::Exhausted => "no edge is left",
        _ => "for another reason",
    }
}

fn preset_name(preset: Preset) -> String {
    use clap::ValueEnum;
    preset.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Cli, Command};

    fn parsed(line: &str) -> Box<SimplifyArgs> {
        let words = ["maille", "simplify", "in.ply", "-o", "out.ply"].into_iter().chain(line.split_whitespace());
        match Cli::parse_from(words).command {
            Command::Simplify(args) => args,
            other => panic!("parsed as {other:?}"),
        }
    }

    #[test]
    fn balanced_is_the_library_default() {
        let asset = Asset::from_mesh("cube", maille::mesh::shapes::cube());
        let mut expected = SimplifyOptions::default();
        expected.target.triangles = Some(6);
        let mut found = options(&parsed("--ratio 50%"), &asset, 2.0).simplify;
        found.max_normal_turn = expected.max_normal_turn; // degrees to radians rounds
        assert_eq!(found, expected);
    }

    #[test]
    fn options_override_parts_of_the_preset() {
        let asset = Asset::from_mesh("cube", maille::mesh::shapes::cube());
        let line = "--max-error 1% --preset aggressive --metric qem --placement midpoint --boundary lock \
                    --max-normal-turn off --valence 4..11";
        let found = options(&parsed(line), &asset, 2.0).simplify;
        assert_eq!(found.target.max_error, Some(0.02));
        assert_eq!((found.metric, found.placement), (MetricKind::Quadric, PlacementKind::Midpoint));
        assert_eq!((found.boundary, found.seams), (EdgePolicy::Lock, EdgePolicy::Free));
        assert_eq!((found.max_normal_turn, found.valence), (None, Some((4, 11))));
        assert_eq!(found.topology, TopologyPolicy::Free);
    }
}
