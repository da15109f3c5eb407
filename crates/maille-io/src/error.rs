//! Errors that name the file, the place and the remedy.

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Where in a file something is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Place {
    /// A line of a text file, from 1.
    Line(u64),
    /// A byte offset.
    Byte(u64),
    /// A part of a structured file, such as `meshes[3].primitives[0].indices` of a glTF.
    Part(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
            Self::Part(part) => f.write_str(part),
        }
    }
}

/// What can be done about an error of the system.
fn remedy_for(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::NotFound => "check the name and the folder",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "check the permissions, or use another folder",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "make room, or use another disk",
        ErrorKind::NotADirectory | ErrorKind::AlreadyExists => "a part of the path is a file where a folder is needed",
        _ => "check the disk and the connection to it, and try again",
    }
}

macro_rules! file_error {
    ($(#[$doc:meta])* $name:ident, $verb:literal) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub struct $name {
            path: Option<PathBuf>,
            place: Option<Place>,
            message: String,
            remedy: Option<String>,
            source: Option<std::io::Error>,
        }

        impl $name {
            /// An error with a message: what was found and what was expected, lower case, no full stop.
            pub fn new(message: impl Into<String>) -> Self {
                Self { path: None, place: None, message: message.into(), remedy: None, source: None }
            }

            /// Adds the file.
            #[must_use]
            pub fn at_path(mut self, path: &Path) -> Self {
                self.path = Some(path.to_owned());
                self
            }

            /// Adds the place in the file, unless one is known already.
            #[must_use]
            pub fn at(mut self, place: Place) -> Self {
                self.place.get_or_insert(place);
                self
            }

            /// Adds what the user can do about it.
            #[must_use]
            pub fn with_remedy(mut self, remedy: impl Into<String>) -> Self {
                self.remedy = Some(remedy.into());
                self
            }

            /// The file, where it is known.
            pub fn path(&self) -> Option<&Path> {
                self.path.as_deref()
            }
        }

        impl From<std::io::Error> for $name {
            fn from(source: std::io::Error) -> Self {
                let remedy = remedy_for(source.kind()).to_owned();
                Self { source: Some(source), remedy: Some(remedy), ..Self::new("") }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "cannot {}", $verb)?;
                if let Some(path) = &self.path {
                    write!(f, " {}", path.display())?;
                }
                if let Some(place) = &self.place {
                    write!(f, ", {place}")?;
                }
                match &self.source {
                    Some(source) => write!(f, ": {source}")?,
                    None => write!(f, ": {}", self.message)?,
                }
                match &self.remedy {
                    Some(remedy) => write!(f, " ({remedy})"),
                    None => Ok(()),
                }
            }
        }

        impl std::error::Error for $name {
            fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
                self.source.as_ref().map(|source| source as _)
            }
        }
    };
}

file_error!(
    /// A file that cannot be read.
    ReadError,
    "read"
);
file_error!(
    /// A file that cannot be written.
    WriteError,
    "write"
);

impl ReadError {
    /// Adds what the user can do about it where nothing better is known.
    pub(crate) fn or_damaged(mut self) -> Self {
        self.remedy.get_or_insert_with(|| "the file is damaged: fetch it again, or export it anew".to_owned());
        self
    }
}
