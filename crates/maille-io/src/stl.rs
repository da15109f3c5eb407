//! STL.

use crate::input::Input;
use crate::output::Output;
use crate::{Asset, ReadError, ReadOptions, WriteError, WriteOptions};

pub(crate) fn read(_input: &Input<'_>, _options: &ReadOptions) -> Result<Asset, ReadError> {
    Err(ReadError::new("STL cannot be read yet"))
}

pub(crate) fn write(_asset: &Asset, _output: &mut Output<'_>, _options: &WriteOptions) -> Result<(), WriteError> {
    Err(WriteError::new("STL cannot be written yet"))
}

/// Whether the length is exactly that of a binary STL with the number of triangles that the header claims.
pub(crate) fn has_binary_length(bytes: &[u8]) -> bool {
    let Some(count) = bytes.get(80..84) else { return false };
    let count = u32::from_le_bytes([count[0], count[1], count[2], count[3]]);
    bytes.len() as u64 == 84 + 50 * u64::from(count)
}
