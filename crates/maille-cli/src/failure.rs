//! How a command ends: exit codes and messages.

use std::io::Write;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::process::ExitCode;

use maille_io::{ReadError, WriteError};

/// Why a command did not do what it was asked for.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The command line makes no sense: exit code 2.
    Usage(String),
    /// A file, or what is in it, is not fit for the work: exit code 1.
    Refused(String),
    /// The user pressed Ctrl-C: exit code 1.
    Cancelled,
    /// Whoever reads our stdout went away: not our failure, exit code 0.
    Closed,
}

impl Failure {
    /// A refusal that names a file.
    pub(crate) fn about(path: &Path, problem: impl std::fmt::Display) -> Self {
        Self::Refused(format!("{}: {problem}", path.display()))
    }

    /// The same kind of error for a file that could not be written by other means than `maille_io`.
    pub(crate) fn writing(path: &Path, error: std::io::Error) -> Self {
        WriteError::from(error).at_path(path).into()
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        Self::Refused(error.to_string())
    }
}

impl From<WriteError> for Failure {
    fn from(error: WriteError) -> Self {
        Self::Refused(error.to_string())
    }
}

/// For errors of stdout; files name their path with [`Failure::writing`].
impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::BrokenPipe => Self::Closed,
            _ => Self::Refused(format!("cannot write to stdout: {error}")),
        }
    }
}

/// Runs a command and says how it ended, on stderr where something went wrong.
pub(crate) fn exit_code_of(command: impl FnOnce() -> Result<(), Failure>) -> ExitCode {
    panic::set_hook(Box::new(report_panic));
    // unwinding, not aborting, so that temporary files are removed on the way
    match panic::catch_unwind(AssertUnwindSafe(command)) {
        Ok(Ok(()) | Err(Failure::Closed)) => ExitCode::SUCCESS,
        Ok(Err(Failure::Usage(message))) => {
            say(&format!("{message}\nFor more information, try '--help'."));
            ExitCode::from(2)
        }
        Ok(Err(Failure::Refused(message))) => {
            say(&message);
            ExitCode::from(1)
        }
        Ok(Err(Failure::Cancelled)) => {
            say("stopped by Ctrl-C; nothing was written");
            ExitCode::from(1)
        }
        Err(_) => ExitCode::from(1),
    }
}

fn report_panic(info: &panic::PanicHookInfo<'_>) {
    let message = info.payload_as_str().unwrap_or("no message");
    let place = info.location().map(|place| format!(" ({}:{})", place.file(), place.line())).unwrap_or_default();
    let command: Vec<String> = std::env::args().skip(1).collect();
    say(&format!(
        "internal error{place}: {message}\n\
         This is a fault of maille {}, not yours: please report it with this message and the command\n  maille {}",
        env!("CARGO_PKG_VERSION"),
        command.join(" ")
    ));
}

/// One message to the user on stderr; a closed stderr is nobody's fault.
pub(crate) fn say(message: &str) {
    let _ = writeln!(std::io::stderr(), "maille: {message}");
}
