//! `KHR_draco_mesh_compression`: compressed primitives become plain ones.
//!
//! Where the extension is not required and the plain data is in the file, too, that is used instead.

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

/// Replaces every compressed primitive by a plain one, whose data lies in buffers of its own.
pub(super) fn decompress(json: &mut Value, buffers: &mut Vec<Vec<u8>>, budget: &mut Budget) -> Checked<()> {
    let mut plain = Plain { views: Vec::new(), buffers };
    for mesh in 0..list(json, "meshes")?.len() {
        for primitive in 0..list(&json["meshes"][mesh], "primitives").within_item("meshes", mesh)?.len() {
            let done = decompress_primitive(json, mesh, primitive, &mut plain, budget);
            done.within_item("primitives", primitive).within_item("meshes", mesh)?;
        }
    }
    let views = plain.views;
    undeclare(json, NAME);
    refresh_bounds(json, buffers, &views)
}

/// Where decompressed data goes.
struct Plain<'a> {
    views: Vec<usize>,
    buffers: &'a mut Vec<Vec<u8>>,
}

impl Plain<'_> {
    /// Adds a buffer with a view of the whole of it.
    fn add(&mut self, json: &mut Value, bytes: Vec<u8>, stride: Option<usize>) -> Checked<usize> {
        let mut push = |key: &str, value: Value| match json.get_mut(key).and_then(Value::as_array_mut) {
            Some(list) => {
                list.push(value);
                Ok(list.len() - 1)
            }
            None => Err(Fault::new("there are no buffers")),
        };
        let buffer = push("buffers", json!({ "byteLength": bytes.len() }))?;
        let mut view = json!({ "buffer": buffer, "byteLength": bytes.len() });
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        view["target"] = json!(if stride.is_some() { Target::Vertices } else { Target::Indices } as u32);
        let view = push("bufferViews", view)?;
        self.buffers.push(bytes);
        self.views.push(view);
        Ok(view)
    }
}

fn decompress_primitive(
    json: &mut Value,
    mesh: usize,
    number: usize,
    plain: &mut Plain<'_>,
    budget: &mut Budget,
) -> Checked<()> {
    let primitive = &json["meshes"][mesh]["primitives"][number];
    let Some(compressed) = extension(primitive, NAME) else { return Ok(()) };
    if !has_plain_data(json, primitive)? {
        let decode = || {
            let view = required_index(compressed, "bufferView")?;
            let views = list(json, "bufferViews")?;
            let view = views.get(view).ok_or_else(|| Fault::new(format!("buffer view {view} does not exist")))?;
            let view = View::new(view, plain.buffers)?;
            decode(&plain.buffers[view.buffer][view.start..view.end], compressed)
        };
        let decoded = decode().within(NAME).within("extensions")?;
        budget.spend(decoded.arrays.iter().map(|array| array.bytes.len() as u64).sum())?;
        let primitive = primitive.clone();
        for array in decoded.arrays {
            let accessor = match array.name.as_deref() {
                Some(name) => index(&primitive["attributes"], name).within("attributes")?,
                None => index(&primitive, "indices")?,
            };
            let Some(accessor) = accessor else {
                let name = array.name.as_deref().unwrap_or("indices");
                return Err(Fault::new(format!("'{name}' is compressed but has no accessor")));
            };
            let stride = Layout { component: array.component, normalized: false, shape: array.shape }.stride();
            let view = plain.add(json, array.bytes, array.name.as_ref().map(|_| stride))?;
            let accessor = json["accessors"].get_mut(accessor);
            let accessor =
                accessor.ok_or_else(|| Fault::new("a compressed attribute whose accessor does not exist"))?;
            accessor["bufferView"] = json!(view);
            accessor["componentType"] = json!(component_code(array.component));
            accessor["count"] = json!(array.count);
            accessor["type"] = json!(array.shape.name());
            remove(accessor, "byteOffset");
        }
        let primitive = &mut json["meshes"][mesh]["primitives"][number];
        remove(primitive, "mode");
    }
    remove_extension(&mut json["meshes"][mesh]["primitives"][number], NAME);
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

/// The arrays of a decompressed primitive.
struct Decoded {
    arrays: Vec<Array>,
}

/// The content of one accessor.
struct Array {
    /// Name of the attribute, `None` for the indices.
    name: Option<String>,
    count: usize,
    shape: Shape,
    component: ComponentType,
    bytes: Vec<u8>,
}

#[cfg(not(feature = "draco"))]
fn decode(_bytes: &[u8], _extension: &Value) -> Checked<Decoded> {
    Err(Fault::new("this build of Maille cannot decode Draco")
        .with_remedy("build it with the feature 'draco', or decompress the file with gltf-transform first"))
}

/// Decodes a stream. The decoder is young: should it panic on a broken stream, that is caught and told as an error.
#[cfg(feature = "draco")]
fn decode(bytes: &[u8], extension: &Value) -> Checked<Decoded> {
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
    let indices =
        Array { name: None, count: corners.len(), shape: Shape::Scalar, component: ComponentType::U32, bytes };
    arrays.push(indices);
    Ok(Decoded { arrays })
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
    Ok(Array { name: Some(name.to_owned()), count, shape, component, bytes })
}
