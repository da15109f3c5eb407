//! The `maille` command: parse, call the libraries, print.
//!
//! [`args`] defines the command line, [`commands`] has one module to each command. What they share: [`session`]
//! (threads, progress, Ctrl-C, reading and writing), [`output`] (results on stdout), [`failure`] (exit codes).

mod args;
mod commands;
mod failure;
mod output;
mod progress;
mod render;
mod session;
mod stages;
mod system;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    let cli = args::Cli::parse();
    failure::exit_code_of(|| commands::run(cli))
}
