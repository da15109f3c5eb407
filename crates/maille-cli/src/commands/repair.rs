//! `maille repair`

use maille::mesh::WeldOptions;
use maille::repair::{NAMES, Repair, RepairReport, diagnose, repair};
use maille_io::Asset;
use maille_io::WriteOptions;
use serde_json::{Map, Value, json};

use crate::args::RepairArgs;
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;

pub(crate) fn run(args: &RepairArgs) -> Result<(), Failure> {
    super::check_output(&args.output)?;
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
        return Err(Failure::about(&args.input, "no triangle is left after the repairs; nothing was written"));
    }
    session.write(&asset, &args.output, &WriteOptions::default())?;
    let done = Done { counts: total(&reports), remaining: remaining(&asset), triangles: asset.triangle_count() };
    match args.common.json {
        true => output::print_json(&done.json(args, &repairs))?,
        false => output::print(&done.text(args))?,
    }
    Ok(())
}

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

/// Defects of all meshes that are still there, and how many.
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
struct Done {
    counts: Vec<(&'static str, usize)>,
    remaining: Vec<(&'static str, usize)>,
    triangles: usize,
}

impl Done {
    fn json(&self, args: &RepairArgs, repairs: &[Repair]) -> Value {
        let object = |pairs: &[(&'static str, usize)]| {
            pairs.iter().map(|&(name, count)| (name.to_owned(), count.into())).collect::<Map<String, Value>>()
        };
        json!({
            "input": args.input.display().to_string(),
            "output": args.output.display().to_string(),
            "repairs": repairs.iter().map(Repair::name).collect::<Vec<_>>(),
            "triangles": self.triangles,
            "changes": object(&self.counts),
            "remaining": object(&self.remaining),
        })
    }

    fn text(&self, args: &RepairArgs) -> String {
        let mut listing = Listing::default();
        let changes: Vec<_> = self.counts.iter().filter(|(_, count)| *count > 0).collect();
        listing.heading(match changes.is_empty() {
            true => format!("{}: nothing to repair", args.input.display()),
            false => format!("{}: repaired", args.input.display()),
        });
        for (name, count) in changes {
            listing.line(name.replace('_', " "), output::count(*count));
        }
        for (name, count) in &self.remaining {
            listing.line("still there", format!("{} {name}", output::count(*count)));
        }
        listing
            .line("wrote", format!("{}, {} triangles", output::written(&args.output), output::count(self.triangles)));
        listing.text()
    }
}
