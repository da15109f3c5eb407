//! `maille repair`

use std::path::{Path, PathBuf};

use maille::mesh::WeldOptions;
use maille::repair::{NAMES, Repair, RepairReport, diagnose, repair};
use maille_io::{Asset, ReadOptions, WriteOptions};
use serde_json::{Map, Value, json};

use crate::args::RepairArgs;
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;

pub(crate) fn run(args: &RepairArgs) -> Result<(), Failure> {
    let path = super::destination(&args.input, &args.destination)?;
    if args.weld_tolerance.is_some() && !chosen(args).iter().any(|repair| matches!(repair, Repair::Weld(_))) {
        return Err(Failure::Usage("--weld-tolerance needs the repair 'weld' among --only".to_owned()));
    }
    let session = Session::start(&args.common)?;
    let mut asset = session.read(&args.input)?;
    let repairs = repairs(args, &asset);
    let spinner = session.spinner("repairing");
    let reports: Vec<RepairReport> = asset.meshes.iter_mut().map(|named| repair(&mut named.mesh, &repairs)).collect();
    drop(spinner);
    session.checkpoint()?;
    if asset.triangle_count() == 0 {
        let problem = "no triangle is left after the repairs, so nothing was written (choose fewer with --only)";
        return Err(Failure::about(&args.input, problem));
    }
    let mut written = session.write(&asset, &path, &WriteOptions::default())?;
    let mut warnings = std::mem::take(&mut asset.warnings);
    warnings.append(&mut written.warnings);
    let triangles = asset.triangle_count();
    // what counts is what the next program finds, and readers join equal positions where a format says no more
    let again = maille_io::read(&path, &ReadOptions::default()).unwrap_or(asset);
    let done = Done {
        input: &args.input,
        files: written.files,
        counts: total(&reports),
        remaining: remaining(&again),
        triangles,
    };
    if done.has_lost_cuts() {
        session.warn(&path, &[LOST_CUTS.to_owned()]);
        warnings.push(LOST_CUTS.to_owned());
    }
    session.result(|| done.json(&repairs, &warnings), || done.text())
}

/// Why what was cut is not, in the file.
const LOST_CUTS: &str = "the surface was cut where more than two sides meet, but in this format readers join vertices at \
     equal positions again (.obj keeps them apart)";

/// The repairs asked for, as the options name them.
fn chosen(args: &RepairArgs) -> Vec<Repair> {
    match &args.only {
        Some(only) => only.clone(),
        None if args.all => NAMES.iter().map(|(_, repair, _)| *repair).collect(),
        None => Repair::STANDARD.to_vec(),
    }
}

/// The repairs asked for, with the tolerance in units of the model.
fn repairs(args: &RepairArgs, asset: &Asset) -> Vec<Repair> {
    let tolerance = args.weld_tolerance.map(|tolerance| tolerance.in_units(super::diagonal(asset)));
    let mut repairs = chosen(args);
    for repair in &mut repairs {
        if let (Repair::Weld(options), Some(tolerance)) = (repair, tolerance) {
            *options = WeldOptions { tolerance, ..*options };
        }
    }
    repairs
}

fn total(reports: &[RepairReport]) -> Vec<(&'static str, usize)> {
    let mut sums = RepairReport::default().counts();
    for report in reports {
        sums.iter_mut().zip(report.counts()).for_each(|(sum, (_, count))| sum.1 += count);
    }
    sums.to_vec()
}

/// Defects of all meshes of a file, and how many.
fn remaining(asset: &Asset) -> Vec<(&'static str, usize)> {
    let mut sums: Vec<(&'static str, usize)> = Vec::new();
    for defect in asset.meshes.iter().flat_map(|named| diagnose(&named.mesh).defects()) {
        match sums.iter_mut().find(|(name, _)| *name == defect.name) {
            Some((_, sum)) => *sum += defect.count,
            None => sums.push((defect.name, defect.count)),
        }
    }
    sums
}

/// What has been done, ready to be told.
struct Done<'a> {
    input: &'a Path,
    files: Vec<PathBuf>,
    counts: Vec<(&'static str, usize)>,
    remaining: Vec<(&'static str, usize)>,
    triangles: usize,
}

impl Done<'_> {
    /// Whether vertices were split that are one again in the file.
    fn has_lost_cuts(&self) -> bool {
        let has_split = self.counts.iter().any(|&(name, count)| name == "vertices_added" && count > 0);
        has_split && self.remaining.iter().any(|(name, _)| name.starts_with("non-manifold"))
    }

    fn json(&self, repairs: &[Repair], warnings: &[String]) -> Value {
        let object = |pairs: &[(&'static str, usize)]| {
            pairs.iter().map(|&(name, count)| (name.to_owned(), count.into())).collect::<Map<String, Value>>()
        };
        json!({
            "input": self.input.display().to_string(),
            "output": self.files[0].display().to_string(),
            "files": output::paths(&self.files),
            "repairs": repairs.iter().map(Repair::name).collect::<Vec<_>>(),
            "triangles": self.triangles,
            "changes": object(&self.counts),
            "remaining": object(&self.remaining),
            "warnings": warnings,
        })
    }

    fn text(&self) -> String {
        let mut listing = Listing::default();
        let changes: Vec<_> = self.counts.iter().filter(|(_, count)| *count > 0).collect();
        listing.heading(match changes.is_empty() {
            true => format!("{}: nothing to repair", self.input.display()),
            false => format!("{}: repaired", self.input.display()),
        });
        for (name, count) in changes {
            listing.line(name.replace('_', " "), output::count(*count));
        }
        for (name, count) in &self.remaining {
            listing.line("still there", format!("{} {name}", output::count(*count)));
        }
        let triangles = output::count(self.triangles);
        listing.line("wrote", format!("{}, {triangles} triangles", output::written(&self.files)));
        listing.text()
    }
}
