//! OBJ.

use std::path::Path;

use crate::input::Input;
use crate::output::Output;
use crate::{Asset, ReadError, ReadOptions, WriteError, WriteOptions};

pub(crate) fn read(_input: &Input<'_>, _folder: Option<&Path>, _options: &ReadOptions) -> Result<Asset, ReadError> {
    Err(ReadError::new("OBJ cannot be read yet"))
}

pub(crate) fn write(_asset: &Asset, _output: &mut Output<'_>, _options: &WriteOptions) -> Result<(), WriteError> {
    Err(WriteError::new("OBJ cannot be written yet"))
}
