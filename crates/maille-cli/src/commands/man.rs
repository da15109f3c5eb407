//! `maille man`

use clap::CommandFactory;
use clap_mangen::Man;

use crate::args::{Cli, ManArgs};
use crate::failure::Failure;
use crate::output;

pub(crate) fn run(args: &ManArgs) -> Result<(), Failure> {
    match &args.output {
        Some(folder) => {
            super::make_folder(folder)?;
            clap_mangen::generate_to(Cli::command(), folder).map_err(|error| Failure::writing(folder, error))
        }
        None => {
            let mut page = Vec::new();
            Man::new(Cli::command()).render(&mut page)?;
            Ok(output::print(&String::from_utf8_lossy(&page))?)
        }
    }
}
