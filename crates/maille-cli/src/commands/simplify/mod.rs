//! `maille simplify`

mod report;

use std::cmp::Reverse;
use std::path::PathBuf;

use maille::cluster::ClusterMethod;
use maille::refit::RefitOptions;
use maille::simplify::{EdgePolicy, MetricKind, Order, PlacementKind, Refusals, SimplifyOptions, Stop};
use maille_io::{Asset, AssetOptions, AssetReport, Budget, WriteOptions, Written, simplify_asset};
use serde_json::{Value, json};

use self::report::Evidence;
use super::collapse::{self, by_name, name_of, refusal};
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
    let asset = ledger.stage("read", |_| session.read(&args.input))?;
    let mut asset = super::without_levels(asset, &session);
    let diagonal = super::diagonal(&asset);
    let options = options(args, &asset, diagonal)?;
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
        None => (args.collapse.preset == Preset::Fastest).then(ClusterMethod::default),
    }
}

/// Refuses options that clustering cannot heed, or the surface alone.
fn check_method(args: &SimplifyArgs) -> Result<(), Failure> {
    let collapsing = &args.collapse;
    let Some(method) = cluster_method(args) else {
        return collapse::check(collapsing);
    };
    let of_collapses = [
        ("--cluster-first", args.cluster_first.is_some()),
        ("--metric", collapsing.metric.is_some()),
        ("--placement", collapsing.placement.is_some()),
        ("--order", args.order.is_some()),
        ("--weights", collapsing.weights != Weights::Area),
        ("--boundary", collapsing.boundary.is_some()),
        ("--seams", collapsing.seams.is_some()),
        ("--material-borders", collapsing.material_borders.is_some()),
        ("--constraint-weight", collapsing.constraint_weight != 1.0),
        ("--topology", collapsing.topology.is_some()),
        ("--max-normal-turn", collapsing.max_normal_turn != Turn(Some(75.0))),
        ("--valence", collapsing.valence.is_some()),
        ("--min-quality", collapsing.min_quality.is_some()),
        ("--join-distance", collapsing.join_distance.is_some()),
        ("--normals", collapsing.normals != Normals::Interpolate),
        ("--max-influences", collapsing.max_influences.is_some()),
        ("--color-space", collapsing.color_space != "rgb"),
        ("--attribute-metric", collapsing.attribute_metric != "gradients"),
        ("--attributes", collapsing.attributes.is_some()),
        ("--attribute-weight", !collapsing.attribute_weight.is_empty()),
        ("--max-texel-error", collapsing.max_texel_error.is_some()),
        ("--texture-may-fold", collapsing.texture_may_fold),
        ("--max-normal-deviation", collapsing.max_normal_deviation != Turn(None)),
        ("--silhouette-weight", collapsing.silhouette_weight != 0.0),
        ("--no-self-intersections", collapsing.no_self_intersections),
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
fn options(args: &SimplifyArgs, asset: &Asset, diagonal: f64) -> Result<AssetOptions, Failure> {
    let collapsing = &args.collapse;
    let mut simplify = collapse::simplify_options(collapsing, diagonal);
    let by_ratio = |ratio: f64| (ratio * asset.drawn_triangle_count() as f64).round().max(1.0) as usize;
    simplify.target.triangles = args.triangles.or(args.ratio.map(by_ratio));
    simplify.target.max_error = args.max_error.map(|error| error.in_units(diagonal));
    if let Some(order) = args.order.as_deref().and_then(|name| by_name(&Order::NAMES, name)) {
        simplify.order = order;
    }
    simplify.cluster_first = args.cluster_first;
    let is_best = collapsing.preset == Preset::Best;
    let refit = args.refit.unwrap_or(is_best && !collapsing.no_self_intersections);
    Ok(AssetOptions {
        simplify,
        cluster: cluster_method(args),
        weld: collapsing.preset == Preset::Aggressive,
        budget: if args.budget == "proportional" { Budget::Proportional } else { Budget::Error },
        roles: collapse::roles(collapsing)?,
        refit: refit.then(RefitOptions::default),
        certify: args.certify,
    })
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
            "preset": preset_name(args.collapse.preset),
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
    use maille::simplify::TopologyPolicy;

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
        let mut found = options(&parsed("--ratio 50%"), &asset, 2.0).expect("no files are named").simplify;
        found.max_normal_turn = expected.max_normal_turn; // degrees to radians rounds
        assert_eq!(found, expected);
    }

    #[test]
    fn options_override_parts_of_the_preset() {
        let asset = Asset::from_mesh("cube", maille::mesh::shapes::cube());
        let line = "--max-error 1% --preset aggressive --metric qem --placement midpoint --boundary lock \
                    --max-normal-turn off --valence 4..11";
        let found = options(&parsed(line), &asset, 2.0).expect("no files are named").simplify;
        assert_eq!(found.target.max_error, Some(0.02));
        assert_eq!((found.metric, found.placement), (MetricKind::Quadric, PlacementKind::Midpoint));
        assert_eq!((found.boundary, found.seams), (EdgePolicy::Lock, EdgePolicy::Hold));
        assert_eq!((found.max_normal_turn, found.valence), (None, Some((4, 11))));
        assert_eq!(found.topology, TopologyPolicy::Free);
    }
}
