//! `maille bench`: ways of working compared on a model of the user's.

mod metrics;
mod report;

use crate::args::{Bench, BenchArgs};
use crate::failure::Failure;

pub(crate) fn run(args: &BenchArgs) -> Result<(), Failure> {
    match &args.what {
        Bench::Metrics(args) => metrics::run(args),
    }
}
