//! Maille beside its peers: time, memory and error on the same meshes, in one run.
//!
//! ```text
//! cargo run --release -- simplify            # ours, meshoptimizer and what Python has, on samples and models
//! cargo run --release -- scaling             # time and memory from 10 thousand to 10 million triangles
//! cargo run --release -- thesis              # the metrics of seed 000 beside the times of the year 2000
//! ```
//!
//! This is a workspace of its own, so that neither the build nor the tests of Maille need the peers. Figures for keeps go
//! to `benches/records`; its README says how.

mod inputs;
mod memory;
mod ours;
mod peer;
mod peers;
mod row;
mod scaling;
mod simplify;
mod thesis;

use clap::{Parser, Subcommand};

/// Maille beside its peers: time, memory and error on the same meshes, in one run.
#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Simplify(simplify::Args),
    Scaling(scaling::Args),
    Thesis(thesis::Args),
}

fn main() -> anyhow::Result<()> {
    memory::count_meshoptimizer();
    match Args::parse().command {
        Command::Simplify(args) => simplify::run(&args),
        Command::Scaling(args) => scaling::run(&args),
        Command::Thesis(args) => thesis::run(&args),
    }
}
