//! glTF 2.0 and GLB.

use std::path::Path;

use crate::output::Output;
use crate::{Asset, ReadError, ReadOptions, WriteError, WriteOptions};

/// Reads glTF JSON or GLB (told apart by the first bytes). `base` is the folder that relative URIs start from; without
/// one only embedded buffers can be read.
pub(crate) fn read(_bytes: &[u8], _base: Option<&Path>, _options: &ReadOptions) -> Result<Asset, ReadError> {
    Err(ReadError::new("glTF cannot be read yet"))
}

/// Writes glTF JSON with its buffers beside it, or one GLB.
pub(crate) fn write(
    _asset: &Asset,
    _binary: bool,
    _output: &mut Output<'_>,
    _options: &WriteOptions,
) -> Result<(), WriteError> {
    Err(WriteError::new("glTF cannot be written yet"))
}
