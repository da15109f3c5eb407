//! `KHR_draco_mesh_compression`: compressed primitives become plain ones.
//!
//! Where the extension is not required and the plain data is in the file, too, that is used instead.

use std::collections::BTreeSet;

use maille::mesh::ComponentType;
use serde_json::{Value, json};

#[cfg(feature = "draco")]
use super::accessor::width;
use super::accessor::{Layout, Shape, component_code, refresh_bounds};
use super::encode::Target;
use super::json::{
    Checked, Fault, Within, as_index, extension, index, list, members, remove, remove_extension, required_index,
    undeclare,
};
use super::{Budget, View};

const NAME: &str = "KHR_draco_mesh_compression";

/// Most elements that one compressed byte may stand for. Draco codes a triangle of a regular mesh in as little
/// as a bit or two and repeated attributes in nothing; beyond this the claim is a trap.
#[cfg(feature = "draco")]
const MOST_INFLATION: u64 = 4096;

/// Replaces every compressed primitive by a plain one, whose data lies in buffers of its own. Its buffer views take the
/// places of those that held the compressed data, and further ones at the end.
pub(super) fn decompress(json: &mut Value, buffers: &mut Vec<Vec<u8>>, budget: &mut Budget) -> Checked<()> {
    let mut plain = Plain { free: BTreeSet::new(), used: BTreeSet::new(), buffers };
    let mut decoded = Vec::new();
    for (i, mesh) in list(json, "meshes")?.iter().enumerate() {
        for (k, primitive) in list(mesh, "primitives").within_item("meshes", i)?.iter().enumerate() {
            let arrays = decode_primitive(json, primitive, &mut plain, budget);
            let arrays = arrays.within_item("primitives", k).within_item("meshes", i)?;
            decoded.extend(arrays.map(|arrays| (i, k, arrays)));
        }
    }
    for (i, k, arrays) in decoded {
        let primitive = &mut json["meshes"][i]["primitives"][k];
        remove_extension(primitive, NAME);
        if !arrays.is_empty() {
            remove(primitive, "mode");
        }
        for array in arrays {
            store(json, array, &mut plain).within_item("primitives", k).within_item("meshes", i)?;
        }
    }
    let views: Vec<usize> = plain.used.into_iter().collect();
    undeclare(json, NAME);
    refresh_bounds(json, buffers, &views)
}

/// Where decompressed data goes.
struct Plain<'a> {
    /// Buffer views whose data has been decompressed.
    free: BTreeSet<usize>,
    /// Buffer views of decompressed data.
    used: BTreeSet<usize>,
    buffers: &'a mut Vec<Vec<u8>>,
}

/// The arrays of a primitive if it is compressed; none if it is, but its plain data is in the file, too.
fn decode_primitive(
    json: &Value,
    primitive: &Value,
    plain: &mut Plain<'_>,
    budget: &mut Budget,
) -> Checked<Option<Vec<Array>>> {
    let Some(compressed) = extension(primitive, NAME) else { return Ok(None) };
    if has_plain_data(json, primitive)? {
        return Ok(Some(Vec::new()));
    }
    let decode = || {
        let number = required_index(compressed, "bufferView")?;
        let views = list(json, "bufferViews")?;
        let view = views.get(number).ok_or_else(|| Fault::new(format!("buffer view {number} does not exist")))?;
        let view = View::new(view, plain.buffers)?;
        let arrays = decode(&plain.buffers[view.buffer][view.start..view.end], compressed)?;
        Ok((number, arrays))
    };
    let (view, mut arrays) = decode().within(NAME).within("extensions")?;
    budget.spend(arrays.iter().map(|array| array.bytes.len() as u64).sum())?;
    plain.free.insert(view);
    for array in &mut arrays {
        array.accessor = match &array.name {
            Some(name) => required_index(&primitive["attributes"], name).within("attributes")?,
            None => required_index(primitive, "indices")?,
        };
    }
    Ok(Some(arrays))
}

/// Lets the accessor of an array show its data.
fn store(json: &mut Value, array: Array, plain: &mut Plain<'_>) -> Checked<()> {
    let layout = Layout { component: array.component, normalized: false, shape: array.shape };
    let buffer = json!({ "byteLength": array.bytes.len() });
    let mut view = json!({ "buffer": plain.buffers.len(), "byteLength": array.bytes.len() });
    if array.name.is_some() {
        view["byteStride"] = json!(layout.stride());
    }
    view["target"] = json!(if array.name.is_some() { Target::Vertices } else { Target::Indices } as u32);
    let buffers = json.get_mut("buffers").and_then(Value::as_array_mut);
    buffers.ok_or_else(|| Fault::new("there are no buffers"))?.push(buffer);
    plain.buffers.push(array.bytes);
    let views = json.get_mut("bufferViews").and_then(Value::as_array_mut);
    let views = views.ok_or_else(|| Fault::new("there are no buffer views"))?;
    let number = match plain.free.pop_first() {
        Some(number) => {
            views[number] = view;
            number
        }
        None => {
            views.push(view);
            views.len() - 1
        }
    };
    plain.used.insert(number);
    let accessor = json.get_mut("accessors").and_then(|accessors| accessors.get_mut(array.accessor));
    let Some(accessor) = accessor.and_then(Value::as_object_mut) else {
        return Err(Fault::new(format!("accessor {} does not exist", array.accessor)));
    };
    accessor.insert("bufferView".to_owned(), json!(number));
    accessor.insert("componentType".to_owned(), json!(component_code(array.component)));
    accessor.insert("count".to_owned(), json!(array.count));
    accessor.insert("type".to_owned(), json!(array.shape.name()));
    accessor.shift_remove("byteOffset");
    Ok(())
}

/// Whether all accessors of a primitive have data besides the compressed one.
fn has_plain_data(json: &Value, primitive: &Value) -> Checked<bool> {
    let accessors = list(json, "accessors")?;
    let mut numbers: Vec<usize> = index(primitive, "indices")?.into_iter().collect();
    for (name, value) in members(primitive, "attributes")? {
        numbers.push(as_index(value).within(name).within("attributes")?);
    }
    Ok(numbers.iter().all(|&i| accessors.get(i).is_some_and(|accessor| accessor.get("bufferView").is_some())))
}

/// The content of one accessor.
struct Array {
    /// Name of the attribute, `None` for the indices.
    name: Option<String>,
    /// Which accessor it belongs to.
    accessor: usize,
    count: usize,
    shape: Shape,
    component: ComponentType,
    bytes: Vec<u8>,
}

#[cfg(not(feature = "draco"))]
fn decode(_bytes: &[u8], _extension: &Value) -> Checked<Vec<Array>> {
    Err(Fault::new("this build of Maille cannot decode Draco")
        .with_remedy("build it with the feature 'draco', or decompress the file with gltf-transform first"))
}

/// Decodes a stream. The decoder is young: should it panic on a broken stream, that is caught and told as an error.
#[cfg(feature = "draco")]
fn decode(bytes: &[u8], extension: &Value) -> Checked<Vec<Array>> {
    const REMEDY: &str = "decompress the file with gltf-transform first";
    check_claims(bytes)?;
    let decoded = std::panic::catch_unwind(|| draco_oxide_decoder::Decoder::new().decode_mesh(bytes));
    let mesh = match decoded {
        Ok(Ok(mesh)) => mesh,
        Ok(Err(error)) => return Err(Fault::new(error.to_string()).with_remedy(REMEDY)),
        Err(_) => {
            return Err(Fault::new("the decoder gave up on a stream that seems to be damaged").with_remedy(REMEDY));
        }
    };
    let corners: Vec<u32> = mesh.faces.iter().flatten().map(|&point| usize::from(point) as u32).collect();
    let mut arrays = Vec::new();
    for (name, value) in members(extension, "attributes")? {
        let id = as_index(value).within(name).within("attributes")?;
        let attribute = mesh.attributes.iter().find(|attribute| attribute.get_id().as_usize() == id);
        let attribute = attribute.ok_or_else(|| Fault::new(format!("the stream has no attribute {id}")));
        let array = attribute.and_then(|attribute| expand(name, attribute));
        arrays.push(array.within(name).within("attributes")?);
    }
    let bytes = corners.iter().flat_map(|corner| corner.to_le_bytes()).collect();
    let indices = Array {
        name: None,
        accessor: 0,
        count: corners.len(),
        shape: Shape::Scalar,
        component: ComponentType::U32,
        bytes,
    };
    arrays.push(indices);
    Ok(arrays)
}

/// Refuses a stream whose head claims more elements than its bytes can stand for.
#[cfg(feature = "draco")]
fn check_claims(bytes: &[u8]) -> Checked<()> {
    const HEADER: usize = 11;
    let cut = || Fault::new("the compressed data is cut off");
    let (head, mut rest) = bytes.split_at_checked(HEADER).ok_or_else(cut)?;
    let (is_edgebreaker, has_metadata) = (head[8] == 1, head[10] & 0x80 != 0);
    if has_metadata {
        return Ok(()); // which comes first and is of any length; glTF encoders write none
    }
    let mut varint = |skip: usize| {
        rest = rest.get(skip..)?;
        let end = rest.iter().position(|byte| byte & 0x80 == 0).filter(|&end| end < 9)?;
        let value = rest[..=end].iter().rev().fold(0u64, |value, byte| value << 7 | u64::from(byte & 0x7f));
        rest = &rest[end + 1..];
        Some(value)
    };
    let claims = [varint(usize::from(is_edgebreaker)), varint(0)];
    for claim in claims {
        let claim = claim.ok_or_else(cut)?;
        if claim > MOST_INFLATION * bytes.len() as u64 {
            return Err(Fault::new(format!("{} bytes cannot hold {claim} elements", bytes.len())));
        }
    }
    Ok(())
}

/// An attribute of a decoded mesh, one value for each point.
#[cfg(feature = "draco")]
fn expand(name: &str, attribute: &draco_oxide_core::attribute::Attribute) -> Checked<Array> {
    use draco_oxide_core::attribute::ComponentDataType as Draco;
    let component = match attribute.get_component_type() {
        Draco::I8 => ComponentType::I8,
        Draco::U8 => ComponentType::U8,
        Draco::I16 => ComponentType::I16,
        Draco::U16 => ComponentType::U16,
        Draco::U32 => ComponentType::U32,
        Draco::F32 => ComponentType::F32,
        other => return Err(Fault::new(format!("scalars of type {other:?}, which glTF does not have"))),
    };
    let shape = match attribute.get_num_components() {
        1 => Shape::Scalar,
        2 => Shape::Vec2,
        3 => Shape::Vec3,
        4 => Shape::Vec4,
        other => return Err(Fault::new(format!("elements of {other} scalars"))),
    };
    let (count, values) = (attribute.len(), attribute.get_data_as_bytes());
    let layout = Layout { component, normalized: false, shape };
    let size = shape.components() * width(component);
    let mut bytes = Vec::with_capacity(count * layout.stride());
    for point in 0..count {
        let value = usize::from(attribute.get_unique_val_idx(point.into()));
        let value = values.get(value * size..).and_then(|rest| rest.get(..size));
        bytes.extend_from_slice(value.ok_or_else(|| Fault::new("a point refers to no value"))?);
        bytes.resize((point + 1) * layout.stride(), 0);
    }
    Ok(Array { name: Some(name.to_owned()), accessor: 0, count, shape, component, bytes })
}
