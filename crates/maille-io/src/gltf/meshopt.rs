//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: compressed buffer views become plain ones.

use meshopt::ffi;
use serde_json::{Value, json};

use super::Budget;
use super::accessor::refresh_bounds;
use super::json::{
    Checked, Fault, Within, extension, index, list, remove, remove_extension, required_index, text, undeclare,
};

/// The names of the extension: the registered one, and its successor with a newer bitstream and one more filter.
pub(super) const NAMES: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// No codec of the extension makes one byte stand for more than this many (a control byte of the vertex codec, for 256
/// vertices of 4 bytes); a larger claim is refused before anything is allocated.
const MOST_INFLATION: usize = 1024;

/// Replaces every compressed buffer view by a plain one in a buffer of its own.
pub(super) fn decompress(json: &mut Value, buffers: &mut Vec<Vec<u8>>, budget: &mut Budget) -> Checked<()> {
    let mut decoded = Vec::new();
    for (i, view) in list(json, "bufferViews")?.iter().enumerate() {
        if let Some((name, extension)) = NAMES.iter().find_map(|name| Some((name, extension(view, name)?))) {
            let bytes = decode(extension, view, buffers, budget).within(name).within("extensions");
            decoded.push((i, bytes.within_item("bufferViews", i)?));
        }
    }
    let views: Vec<usize> = decoded.iter().map(|&(i, _)| i).collect();
    for (i, bytes) in decoded {
        let view = &mut json["bufferViews"][i];
        NAMES.iter().for_each(|name| remove_extension(view, name));
        remove(view, "byteOffset");
        view["buffer"] = json!(buffers.len());
        if let Some(list) = json["buffers"].as_array_mut() {
            list.push(json!({ "byteLength": bytes.len() }));
        }
        buffers.push(bytes);
    }
    for buffer in json.get_mut("buffers").and_then(Value::as_array_mut).into_iter().flatten() {
        NAMES.iter().for_each(|name| remove_extension(buffer, name));
    }
    NAMES.iter().for_each(|name| undeclare(json, name));
    refresh_bounds(json, buffers, &views)
}

/// What a compressed buffer view says about itself.
struct Compressed<'a> {
    bytes: &'a [u8],
    count: usize,
    stride: usize,
    filter: &'a str,
}

fn decode(extension: &Value, view: &Value, buffers: &[Vec<u8>], budget: &mut Budget) -> Checked<Vec<u8>> {
    let slice = super::View::new(extension, buffers)?;
    let compressed = Compressed {
        bytes: &buffers[slice.buffer][slice.start..slice.end],
        count: required_index(extension, "count")?,
        stride: required_index(extension, "byteStride")?,
        filter: extension.get("filter").and_then(Value::as_str).unwrap_or("NONE"),
    };
    let Compressed { bytes, count, stride, filter } = compressed;
    let size = count.checked_mul(stride).filter(|&size| size <= MOST_INFLATION.saturating_mul(bytes.len() + 1));
    let size = size
        .ok_or_else(|| Fault::new(format!("{} bytes cannot hold {count} elements of {stride} bytes", bytes.len())))?;
    if index(view, "byteLength")? != Some(size) {
        return Err(Fault::new(format!("the view should have a byteLength of {size}")));
    }
    budget.spend(size as u64)?;
    let mode = text(extension, "mode");
    match mode {
        "ATTRIBUTES" => decode_attributes(&compressed),
        "TRIANGLES" | "INDICES" if filter != "NONE" => Err(Fault::new(format!("filter '{filter}' on indices"))),
        "TRIANGLES" if count % 3 != 0 => Err(Fault::new(format!("{count} indices are no triangles"))),
        "TRIANGLES" | "INDICES" if stride == 2 => decode_indices::<u16>(mode, bytes, count, |i| i.to_le_bytes()),
        "TRIANGLES" | "INDICES" if stride == 4 => decode_indices::<u32>(mode, bytes, count, |i| i.to_le_bytes()),
        "TRIANGLES" | "INDICES" => Err(Fault::new(format!("indices of {stride} bytes"))),
        other => Err(Fault::new(format!("unknown mode '{other}'"))),
    }
}

fn broken(what: &str) -> Fault {
    Fault::new(format!("the compressed {what} are damaged"))
}

fn decode_indices<T>(
    mode: &str,
    bytes: &[u8],
    count: usize,
    to_bytes: impl Fn(&T) -> <T as Bytes>::Array,
) -> Checked<Vec<u8>>
where
    T: Bytes + meshopt::IndexType + Clone + Default,
{
    // at least one byte for each triangle or index
    let least = if mode == "TRIANGLES" { count / 3 } else { count };
    if bytes.len() < least {
        return Err(broken("indices"));
    }
    let decoded = match mode {
        "TRIANGLES" => meshopt::decode_index_buffer::<T>(bytes, count),
        _ => meshopt::decode_index_sequence::<T>(bytes, count),
    };
    let indices = decoded.map_err(|_| broken("indices"))?;
    Ok(indices.iter().flat_map(to_bytes).collect())
}

/// Integers that have a fixed number of bytes.
trait Bytes {
    type Array: IntoIterator<Item = u8>;
}

impl Bytes for u16 {
    type Array = [u8; 2];
}

impl Bytes for u32 {
    type Array = [u8; 4];
}

fn decode_attributes(compressed: &Compressed<'_>) -> Checked<Vec<u8>> {
    let &Compressed { bytes, count, stride, filter } = compressed;
    if stride == 0 || stride > 256 || stride % 4 != 0 {
        return Err(Fault::new(format!("elements of {stride} bytes")));
    }
    let strides: &[usize] = match filter {
        "NONE" | "EXPONENTIAL" => &[stride],
        "OCTAHEDRAL" | "COLOR" => &[4, 8],
        "QUATERNION" => &[8],
        other => return Err(Fault::new(format!("unknown filter '{other}'"))),
    };
    if !strides.contains(&stride) {
        return Err(Fault::new(format!("filter '{filter}' on elements of {stride} bytes")));
    }
    let mut words = vec![0u32; count * stride / 4];
    let target = words.as_mut_ptr().cast();
    // SAFETY: `target` has room for `count` elements of `stride` bytes, stride is a multiple of 4 up to 256 as the
    // function asserts, and it reads no further than the given length of the source, whatever that contains.
    let code = unsafe { ffi::meshopt_decodeVertexBuffer(target, count, stride, bytes.as_ptr(), bytes.len()) };
    if code != 0 {
        return Err(broken("attributes"));
    }
    let filter = match filter {
        "OCTAHEDRAL" => ffi::meshopt_decodeFilterOct,
        "QUATERNION" => ffi::meshopt_decodeFilterQuat,
        "EXPONENTIAL" => ffi::meshopt_decodeFilterExp,
        "COLOR" => ffi::meshopt_decodeFilterColor,
        _ => return Ok(bytes_of(&words)),
    };
    // SAFETY: the filters change the same `count` elements of `stride` bytes in place; the memory is aligned for 32-bit
    // values, and the stride is one that the filter accepts.
    unsafe { filter(words.as_mut_ptr().cast(), count, stride) };
    Ok(bytes_of(&words))
}

fn bytes_of(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_ne_bytes()).collect()
}
