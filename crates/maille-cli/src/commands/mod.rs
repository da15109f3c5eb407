//! One module to each command: meaning of the options, calls into the libraries, results.

mod compare;
mod completions;
mod convert;
mod demo;
mod info;
mod man;
mod render;
mod repair;
mod sample;
mod simplify;

use std::path::Path;

use maille_io::{Asset, Format};

use crate::args::{Cli, Command};
use crate::failure::Failure;

/// Runs what the command line asks for.
pub(crate) fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Info(args) => info::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Simplify(args) => simplify::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Repair(args) => repair::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}

/// Refuses an output that no writer takes, before any work is done.
fn check_output(path: &Path) -> Result<(), Failure> {
    match Format::from_path(path) {
        Some(_) => Ok(()),
        None => {
            let known: Vec<String> = Format::EXTENSIONS.iter().map(|(name, _)| format!(".{name}")).collect();
            let known = known.join(", ");
            Err(Failure::Usage(format!("{}: the extension names no format; use one of {known}", path.display())))
        }
    }
}

/// Length of the diagonal of the box around everything an asset draws, posed at rest.
fn diagonal(asset: &Asset) -> f64 {
    asset.flattened().diagonal()
}

/// The usual name of a format.
fn format_name(format: Format) -> &'static str {
    Format::EXTENSIONS.iter().find(|(_, known)| *known == format).map_or("unknown", |(name, _)| *name)
}
