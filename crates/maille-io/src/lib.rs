//! Files in and out of Maille: glTF 2.0 and GLB, PLY, OBJ, STL and OFF.
//!
//! [`read`] finds the format by content and gives an [`Asset`]: its meshes, each once, where they are drawn, and
//! (kept inside) everything that is not mesh. [`write`](fn@write) picks the format by the extension, writes to a temporary file
//! beside the target and renames it, so that no reader ever sees half a file.

mod asset;
mod error;

pub use asset::{Asset, Instance, NamedMesh};
pub use error::{ReadError, WriteError};

use std::path::Path;

/// What a reader may spend before it refuses.
#[derive(Debug, Clone)]
pub struct ReadOptions {
    /// Most bytes that the arrays of the result may take together. Sizes claimed by a header are compared with what
    /// the file can hold before anything is allocated; this limit is for what inflates (sparse accessors, compression).
    pub max_bytes: u64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { max_bytes: 64 << 30 }
    }
}

/// How to write.
#[derive(Debug, Clone, Default)]
pub struct WriteOptions {
    /// PLY, OFF: text instead of binary. Text is the only form of OBJ.
    pub text: bool,
}

/// Reads a file of any known format, found by its content.
///
/// # Errors
/// [`ReadError`], with the path, the place in the file and what could be done.
pub fn read(path: &Path, _options: &ReadOptions) -> Result<Asset, ReadError> {
    Err(ReadError::new("no reader yet").at_path(path))
}

/// Writes a file in the format that the extension of `path` names.
///
/// # Errors
/// [`WriteError`], with the path; nothing is left behind then.
pub fn write(_asset: &Asset, path: &Path, _options: &WriteOptions) -> Result<(), WriteError> {
    Err(WriteError::new("no writer yet").at_path(path))
}
