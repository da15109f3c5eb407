//! `maille bench`: ways of working compared on a model of the user's.

mod metrics;
mod popping;
mod popping_report;
mod report;

use crate::args::{Bench, BenchArgs};
use crate::failure::Failure;

pub(crate) fn run(args: &BenchArgs) -> Result<(), Failure> {
    match &args.what {
        Bench::Metrics(args) => metrics::run(args),
        Bench::Popping(args) => popping::run(args),
    }
}
