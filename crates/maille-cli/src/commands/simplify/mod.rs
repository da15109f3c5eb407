//! `maille simplify`

mod report;

use std::cmp::Reverse;
use std::path::{Path, PathBuf};

use maille::cluster::ClusterMethod;
use maille::refit::RefitOptions;
use maille::simplify::{
    AttributeMetricKind, AttributeWeights, ColorSpace, EdgePolicy, MetricKind, Order, PlacementKind, QuadricMemory,
    Refusals, SimplifyError, SimplifyOptions, Stop, TopologyPolicy,
};
use maille_io::{Asset, AssetOptions, AssetReport, Budget, ProcessError, WriteOptions, Written, simplify_asset};
use serde_json::{Value, json};

use self::report::Evidence;
use super::report::ReportFiles;
use crate::args::{Normals, Preset, SimplifyArgs, Turn, Weights};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;
use crate::stages::Ledger;

pub(crate) fn run(args: &SimplifyArgs) -> Result<(), Failure> {
    let path = super::destination(&args.input, &args.destination)?;
    check_method(args)?;
    let files = match &args.report {
        Some(report) => Some(ReportFiles::new(report, &[&args.input, &path])?),
        None => None,
    };
    let session = Session::start(&args.common)?;
    let mut ledger = Ledger::new(files.is_some());
    let mut asset = ledger.stage("read", |_| session.read(&args.input))?;
    let diagonal = super::diagonal(&asset);
    let options = options(args, &asset, diagonal);
    let report = ledger.stage("simplify", |times| {
        let control = session.control();
        simplify_asset(&mut asset, &options, control.with_times(times)).map_err(|error| refusal(&args.input, &error))
    })?;
    session.checkpoint()?;
    // before anything is written: what fails in a report leaves nothing behind
    let evidence = match files {
        Some(files) => Some(Evidence::gather(&session, args, files, &options, &report, &asset)?),
        None => None,
    };
    let written = ledger.stage("write", |_| session.write(&asset, &path, &WriteOptions::default()))?;
    let mut done = Done {
        report,
        ledger,
        diagonal,
        cluster: options.cluster,
        options: options.simplify,
        path,
        written,
        told: Vec::new(),
    };
    if let Some(evidence) = evidence {
        evidence.write(&session, args, &mut done, &asset)?;
    }
    session.result(|| done.json(args, &session, &asset), || done.text(args))
}

/// The way to cluster vertices, `None` to collapse edges.
fn cluster_method(args: &SimplifyArgs) -> Option<ClusterMethod> {
    match args.method.as_deref() {
        Some(name) => by_name(&ClusterMethod::NAMES, name),
        None => (args.preset == Preset::Fastest).then(ClusterMethod::default),
    }
}

/// Whether attributes count in the metric.
fn attributes_count(args: &SimplifyArgs) -> bool {
    args.attributes.unwrap_or(args.metric.is_none() || !args.attribute_weight.is_empty())
}

/// Refuses options that clustering cannot heed, or the surface alone.
fn check_method(args: &SimplifyArgs) -> Result<(), Failure> {
    let Some(method) = cluster_method(args) else {
        let of_attributes = [
            ("--color-space", args.color_space != "rgb"),
            ("--attribute-metric", args.attribute_metric != "gradients"),
        ];
        if let Some((option, _)) = of_attributes.iter().find(|(_, given)| *given && !attributes_count(args)) {
            let reason = "is for attributes that count, here the surface alone does; add --attributes";
            return Err(Failure::Usage(format!("{option} {reason}")));
        }
        return Ok(());
    };
    let of_collapses = [
        ("--cluster-first", args.cluster_first.is_some()),
        ("--metric", args.metric.is_some()),
        ("--placement", args.placement.is_some()),
        ("--order", args.order.is_some()),
        ("--weights", args.weights != Weights::Area),
        ("--boundary", args.boundary.is_some()),
        ("--seams", args.seams.is_some()),
        ("--material-borders", args.material_borders.is_some()),
        ("--constraint-weight", args.constraint_weight != 1.0),
        ("--topology", args.topology.is_some()),
        ("--max-normal-turn", args.max_normal_turn != Turn(Some(75.0))),
        ("--valence", args.valence.is_some()),
        ("--min-quality", args.min_quality.is_some()),
        ("--join-distance", args.join_distance.is_some()),
        ("--normals", args.normals != Normals::Interpolate),
        ("--max-influences", args.max_influences.is_some()),
        ("--color-space", args.color_space != "rgb"),
        ("--attribute-metric", args.attribute_metric != "gradients"),
        ("--attributes", args.attributes.is_some()),
        ("--attribute-weight", !args.attribute_weight.is_empty()),
        ("--max-texel-error", args.max_texel_error.is_some()),
        ("--texture-may-fold", args.texture_may_fold),
        ("--max-normal-deviation", args.max_normal_deviation != Turn(None)),
        ("--silhouette-weight", args.silhouette_weight != 0.0),
        ("--no-self-intersections", args.no_self_intersections),
        ("--certify", args.certify),
    ];
    match of_collapses.iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((option, _)) => {
            let name = name_of(&ClusterMethod::NAMES, &method);
            Err(Failure::Usage(format!(
                "{option} is for edge collapse, {name} (--method, --preset) is none; leave out one or the other"
            )))
        }
    }
}

/// What the options mean for this asset.
fn options(args: &SimplifyArgs, asset: &Asset, diagonal: f64) -> AssetOptions {
    let mut simplify = preset(args.preset);
    let by_ratio = |ratio: f64| (ratio * asset.drawn_triangle_count() as f64).round().max(1.0) as usize;
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
    simplify.memory = args.memory.as_deref().and_then(|name| by_name(&QuadricMemory::NAMES, name));
    simplify.position_sigma = args.position_sigma.unwrap_or(simplify.position_sigma);
    simplify.normal_sigma = args.normal_sigma.unwrap_or(simplify.normal_sigma);
    simplify.line_weight = args.line_weight.unwrap_or(simplify.line_weight);
    simplify.silhouette_weight = args.silhouette_weight;
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
    simplify.max_normal_deviation = args.max_normal_deviation.0.map(f64::to_radians);
    simplify.valence = args.valence;
    simplify.min_quality = args.min_quality;
    simplify.no_self_intersections = args.no_self_intersections;
    let near = (args.preset == Preset::Aggressive).then_some(NEAR_PARTS * diagonal);
    simplify.join_distance = args.join_distance.map(|distance| distance.in_units(diagonal)).or(near);
    simplify.normals = args.normals.into();
    simplify.max_influences = args.max_influences;
    if !attributes_count(args) {
        simplify.attributes = AttributeWeights::NONE;
    }
    simplify.attribute_metric = by_name(&AttributeMetricKind::NAMES, &args.attribute_metric).unwrap_or_default();
    simplify.color_space = by_name(&ColorSpace::NAMES, &args.color_space).unwrap_or_default();
    simplify.texture_may_fold = args.texture_may_fold;
    let refit =
        args.refit.unwrap_or(args.preset == Preset::Best && !args.no_self_intersections).then(RefitOptions::default);
    let attribute_weights = args.attribute_weight.clone();
    let budget = if args.budget == "proportional" { Budget::Proportional } else { Budget::Error };
    simplify.cluster_first = args.cluster_first;
    AssetOptions {
        simplify,
        cluster: cluster_method(args),
        weld: args.preset == Preset::Aggressive,
        budget,
        attribute_weights,
        max_texel_error: args.max_texel_error,
        importance: args.importance.clone(),
        lock: args.lock.clone(),
        refit,
        certify: args.certify,
    }
}

/// Share of the diagonal within which the aggressive preset joins parts.
const NEAR_PARTS: f64 = 0.001;

/// The bundle of options that a preset stands for.
pub(crate) fn preset(preset: Preset) -> SimplifyOptions {
    let balanced = SimplifyOptions::default();
    match preset {
        // clusters, unless --method says otherwise
        Preset::Fastest | Preset::Balanced => balanced,
        Preset::Fast => SimplifyOptions { metric: MetricKind::ConstrainedQuadric, ..balanced },
        Preset::Best => balanced,
        Preset::Aggressive => SimplifyOptions {
            boundary: EdgePolicy::Hold,
            topology: TopologyPolicy::Free,
            join_parts_only: true,
            ..balanced
        },
    }
}

pub(crate) fn by_name<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(known, _)| *known == name).map(|&(_, value)| value)
}

pub(crate) fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    names.iter().find(|(_, known)| known == value).map_or("", |&(name, _)| name)
}

/// Why a file could not be simplified, for the user.
pub(crate) fn refusal(path: &Path, error: &ProcessError) -> Failure {
    let path = path.display();
    match error {
        ProcessError::Mesh { error: SimplifyError::Cancelled(_), .. } => Failure::Cancelled,
        ProcessError::Mesh { error: SimplifyError::NotFinite { .. }, .. } => {
            Failure::Refused(format!("cannot simplify {path}: {error} (maille repair {path} -o OUT --all)"))
        }
        ProcessError::NoTexture => {
            Failure::Refused(format!("cannot simplify {path}: {error} (leave out --max-texel-error)"))
        }
        _ => Failure::Refused(format!("cannot simplify {path}: {error}")),
    }
}

/// What has been done, ready to be told.
struct Done {
    report: AssetReport,
    ledger: Ledger,
    diagonal: f64,
    cluster: Option<ClusterMethod>,
    options: SimplifyOptions,
    path: PathBuf,
    written: Written,
    /// The files of the report.
    told: Vec<PathBuf>,
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
        let attributes = report.attributes.iter().map(|attribute| {
            json!({ "name": attribute.semantic.to_string(), "weight": attribute.weight, "error": attribute.error })
        });
        let attributes: Vec<Value> = attributes.collect();
        json!({
            "input": args.input.display().to_string(),
            "output": self.path.display().to_string(),
            "files": ([output::paths(&self.written.files), output::paths(&self.told)].concat()),
            "report": self.told.first().map(|path| path.display().to_string()),
            "triangles_in": report.triangles_in,
            "triangles_out": report.triangles_out,
            "seconds": self.ledger.seconds("simplify"),
            "stages": self.ledger.json(),
            "threads": session.threads(),
            "peak_bytes": self.ledger.peak_bytes(),
            "stopped": stop_name(report.stopped),
            "error": report.error,
            "max_error_proven": report.max_error_proven,
            "max_error_found": report.max_error_found,
            "diagonal": self.diagonal,
            "attributes": attributes,
            "collapses": report.collapses,
            "refit": refits,
            "refused": refusals(&report.refused).into_iter().collect::<serde_json::Map<_, _>>(),
            "preset": preset_name(args.preset),
            "method": self.cluster.map_or("collapse", |method| name_of(&ClusterMethod::NAMES, &method)),
            "metric": self.of_collapses(name_of(&MetricKind::NAMES, &self.options.metric)),
            "placement": self.of_collapses(name_of(&PlacementKind::NAMES, &self.options.placement)),
            "meshes": report.meshes.len(),
            "warnings": ([&asset.warnings[..], &self.written.warnings[..]].concat()),
        })
    }

    /// What only collapses have, null with clustering.
    fn of_collapses(&self, name: &str) -> Value {
        if self.cluster.is_none() { name.into() } else { Value::Null }
    }

    fn text(&self, args: &SimplifyArgs) -> String {
        let report = &self.report;
        let mut listing = Listing::default();
        let (before, after) = (output::count(report.triangles_in), output::count(report.triangles_out));
        listing.heading(format!("{}: {before} -> {after} triangles", args.input.display()));
        listing.line("time", output::seconds(self.ledger.seconds("simplify")));
        listing.line("stopped", self.explanation());
        let meaning = match (self.cluster, self.options.cluster_first) {
            (Some(_), _) => "as far as a vertex moved",
            (None, Some(_)) => "as far as clustering moved a vertex, and as the metric estimates",
            (None, None) => "as the metric estimates",
        };
        listing.line("error", format!("{}, {meaning}", output::distance(report.error, self.diagonal)));
        if let (Some(proven), Some(found)) = (report.max_error_proven, report.max_error_found) {
            let distance = output::distance(proven, self.diagonal);
            listing.line("proven", format!("no point of either surface is farther from the other than {distance}"));
            listing
                .line("farthest", format!("{}, as far as the proof has seen", output::distance(found, self.diagonal)));
        }
        for attribute in &report.attributes {
            let worth = output::distance(attribute.weight, self.diagonal);
            let told = format!("{:.3} at most, as the metric estimates; 1 counts as {worth}", attribute.error);
            listing.line(attribute.semantic.to_string(), told);
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
        if !self.told.is_empty() {
            listing.line("report", output::written(&self.told));
        }
        if !args.destination.in_place {
            listing.line("measure", format!("maille compare {} {}", args.input.display(), self.path.display()));
        }
        listing.text()
    }

    fn explanation(&self) -> &'static str {
        match (self.report.stopped, self.cluster) {
            (Stop::Triangles, _) => "the number of triangles is reached",
            (Stop::MaxError, None) => "the next collapse would exceed the largest error",
            (Stop::MaxError, Some(_)) => "larger cells would exceed the largest error",
            (Stop::NoLegalCollapse, _) => "the constraints forbid every collapse that is left",
            (Stop::Exhausted, None) => "no edge is left",
            (Stop::Exhausted, Some(_)) => "larger cells leave no triangle",
            _ => "for another reason",
        }
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
            barrier(refused.normal_deviation, "for the original normals", "a larger --max-normal-deviation"),
            barrier(refused.border, &format!("that would tear {preserved}"), &relaxed),
            barrier(refused.locked, "between locked vertices", &unlocked),
            barrier(refused.valence, "for the valence", "a wider --valence"),
            barrier(refused.quality, "for the quality of triangles", "a lower --min-quality"),
            barrier(refused.texture, "for the texture", "--texture-may-fold, or a larger --max-texel-error"),
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

fn refusals(refused: &Refusals) -> [(String, Value); 9] {
    [
        ("topology", refused.topology),
        ("fold_over", refused.fold_over),
        ("normal_deviation", refused.normal_deviation),
        ("border", refused.border),
        ("locked", refused.locked),
        ("valence", refused.valence),
        ("quality", refused.quality),
        ("texture", refused.texture),
        ("self_intersections", refused.self_intersections),
    ]
    .map(|(name, n)| (name.to_owned(), n.into()))
}

pub(crate) fn stop_name(stop: Stop) -> &'static str {
    match stop {
        Stop::Triangles => "triangles",
        Stop::MaxError => "max_error",
        Stop::NoLegalCollapse => "no_legal_collapse",
        Stop::Exhausted => "exhausted",
        _ => "other",
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
        assert_eq!((found.boundary, found.seams), (EdgePolicy::Lock, EdgePolicy::Hold));
        assert_eq!((found.max_normal_turn, found.valence), (None, Some((4, 11))));
        assert_eq!(found.topology, TopologyPolicy::Free);
    }
}
