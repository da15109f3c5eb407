//! One module to each command: meaning of the options, calls into the libraries, results.

mod bench;
mod collapse;
mod compare;
mod completions;
mod convert;
mod demo;
mod info;
mod lod;
mod man;
mod progressive;
mod render;
mod repair;
mod report;
mod sample;
mod simplify;

use std::path::{Path, PathBuf};

use maille_io::{Asset, Format, WriteError};

use crate::args::{Cli, Command, Destination};
use crate::failure::Failure;
use crate::session::Session;

/// Runs what the command line asks for.
pub(crate) fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Info(args) => info::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Simplify(args) => simplify::run(&args),
        Command::Lod(args) => lod::run(&args),
        Command::Progressive(args) => progressive::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Repair(args) => repair::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}

/// The file to write. The input is replaced only where that is asked for: whoever simplifies a file onto itself by
/// mistake has lost the original.
fn destination(input: &Path, destination: &Destination) -> Result<PathBuf, Failure> {
    let Some(output) = &destination.output else {
        check_output(input)?;
        return Ok(input.to_owned());
    };
    check_output(output)?;
    if is_same_file(input, output) {
        let message = "this is the input; give --in-place instead of -o to replace it, or another name to keep it";
        return Err(Failure::Usage(format!("{}: {message}", output.display())));
    }
    Ok(output.clone())
}

/// Whether two paths, links followed, lead to one existing file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let resolved = |path: &Path| std::fs::canonicalize(path).ok();
    resolved(a).is_some_and(|a| Some(a) == resolved(b))
}

/// Makes a folder for results, where there is none.
fn make_folder(path: &Path) -> Result<(), Failure> {
    if path.is_file() {
        let error = WriteError::new("this is a file, but a folder is needed").with_remedy("name another with -o");
        return Err(error.at_path(path).into());
    }
    std::fs::create_dir_all(path).map_err(|error| Failure::writing(path, error))
}

/// Refuses an output that no writer takes, before any work is done.
fn check_output(path: &Path) -> Result<(), Failure> {
    refuse_folder(path, "model.glb")?;
    match Format::from_path(path) {
        Some(Format::Mpm) => {
            let message = "a progressive mesh is made by `maille progressive`";
            Err(Failure::Usage(format!("{}: {message}", path.display())))
        }
        Some(_) => Ok(()),
        None => {
            let levels = Format::EXTENSIONS.iter().filter(|(_, format)| *format != Format::Mpm);
            let known: Vec<String> = levels.map(|(name, _)| format!(".{name}")).collect();
            let known = known.join(", ");
            Err(Failure::Usage(format!("{}: the extension names no format; use one of {known}", path.display())))
        }
    }
}

/// Refuses a folder where a file is to be written.
fn refuse_folder(path: &Path, example: &str) -> Result<(), Failure> {
    if path.is_dir() {
        let remedy = format!("name a file in it, such as {}", path.join(example).display());
        return Err(WriteError::new("this is a folder").with_remedy(remedy).at_path(path).into());
    }
    Ok(())
}

/// The asset without levels of detail, which are told to be left out: they are of the original.
pub(crate) fn without_levels(asset: Asset, session: &Session) -> Asset {
    match asset.split_levels() {
        Some(Ok((whole, levels))) => {
            let count = levels.len();
            session.note(&format!("the {count} levels of detail of the file are left out: they are of the original"));
            whole
        }
        _ => asset,
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
