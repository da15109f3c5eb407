//! The outside of a glTF: GLB chunks, buffers in data URIs and in files.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use serde_json::Value;

use super::json::{Checked, Fault, Within, extension, list, required_index, text};

pub(super) const MAGIC: &[u8; 4] = b"glTF";
pub(super) const JSON_CHUNK: &[u8; 4] = b"JSON";
pub(super) const BIN_CHUNK: &[u8; 4] = b"BIN\0";

const CUT: &str = "it has been cut short: fetch it again";

/// Splits a GLB, or takes JSON as it is: the document and the binary chunk.
pub(super) fn open<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Checked<(Value, Option<&'a [u8]>)> {
    if !bytes.starts_with(MAGIC) {
        return Ok((parse(bytes)?, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes(b.try_into().expect("four bytes")));
    let cut = || Fault::new("the file is cut off within its header").with_remedy(CUT);
    let header = |at: usize| word(at).ok_or_else(cut).within("GLB header");
    let (version, length) = (header(4)?, header(8)? as usize);
    if version != 2 {
        return Err(Fault::new(format!("GLB version {version}, expected 2"))
            .with_remedy("convert it to glTF 2.0 with the program that made it"))
        .within("GLB header");
    }
    if length > bytes.len() {
        let message = format!("the file should have {length} bytes but has {}", bytes.len());
        return Err(Fault::new(message).with_remedy(CUT)).within("GLB header");
    }
    if length < bytes.len() {
        warnings.push(format!("{} bytes after the end of the GLB were left out", bytes.len() - length));
    }
    let chunks = chunks(&bytes[..length]).within("GLB chunks")?;
    let mut chunks = chunks.into_iter();
    let json = match chunks.next() {
        Some((kind, content)) if kind == JSON_CHUNK => parse(content)?,
        _ => return Err(Fault::new("the first chunk of the GLB is not JSON")).within("GLB chunks"),
    };
    let mut binary = None;
    for (place, (kind, content)) in chunks.enumerate() {
        if place == 0 && kind == BIN_CHUNK {
            binary = Some(content);
        } else {
            warnings.push("a GLB chunk of unknown type was left out".to_owned());
        }
    }
    Ok((json, binary))
}

/// The chunks of a GLB: type and content.
fn chunks(glb: &[u8]) -> Checked<Vec<(&[u8], &[u8])>> {
    let mut chunks = Vec::new();
    let mut rest = glb.get(12..).ok_or_else(|| Fault::new("the GLB is shorter than its header"))?;
    while !rest.is_empty() {
        let (head, body) = rest.split_at_checked(8).ok_or_else(|| Fault::new("a GLB chunk header is cut off"))?;
        let length = u32::from_le_bytes(head[..4].try_into().expect("four bytes")) as usize;
        let content = body
            .get(..length)
            .ok_or_else(|| Fault::new(format!("a GLB chunk claims {length} bytes where {} are left", body.len())))?;
        chunks.push((&head[4..], content));
        rest = &body[length..];
    }
    Ok(chunks)
}

fn parse(text: &[u8]) -> Checked<Value> {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let json: Value = serde_json::from_slice(text).map_err(|e| Fault::new(format!("no valid JSON: {e}")))?;
    let version = json.get("asset").and_then(|asset| asset.get("version")).and_then(Value::as_str);
    match version {
        Some(version) if version.split('.').next() == Some("2") => Ok(json),
        Some(version) => Err(Fault::new(format!("glTF version '{version}', expected 2.x"))
            .with_remedy("convert it to glTF 2.0 with the program that made it"))
        .within("asset"),
        None => Err(Fault::new("no version, so this is no glTF 2.0")).within("asset"),
    }
}

/// The content of every buffer, as long as its JSON says.
///
/// A buffer that stands in for compressed data only (a fallback of the meshopt extensions) stays empty.
pub(super) fn load_buffers(json: &Value, binary: Option<&[u8]>, folder: Option<&Path>) -> Checked<Vec<Vec<u8>>> {
    let load =
        |(i, buffer): (usize, &Value)| load_buffer(buffer, binary.filter(|_| i == 0), folder).within_item("buffers", i);
    list(json, "buffers")?.iter().enumerate().map(load).collect()
}

fn load_buffer(buffer: &Value, binary: Option<&[u8]>, folder: Option<&Path>) -> Checked<Vec<u8>> {
    let length = required_index(buffer, "byteLength")?;
    let uri = text(buffer, "uri");
    let too_short = |found: usize| Fault::new(format!("byteLength is {length}, but there are only {found} bytes"));
    if uri.is_empty() {
        return match binary {
            Some(bytes) => bytes.get(..length).map(<[u8]>::to_vec).ok_or_else(|| too_short(bytes.len())),
            None if is_fallback(buffer) => Ok(Vec::new()),
            None => Err(Fault::new("there is neither a uri nor a binary chunk")),
        };
    }
    let mut bytes = if uri.starts_with("data:") { decode_data_uri(uri)? } else { read_file(uri, folder, length)? };
    if bytes.len() < length {
        return Err(too_short(bytes.len()));
    }
    bytes.truncate(length);
    Ok(bytes)
}

fn is_fallback(buffer: &Value) -> bool {
    super::meshopt::NAMES
        .iter()
        .any(|name| extension(buffer, name).and_then(|e| e.get("fallback")).and_then(Value::as_bool).unwrap_or(false))
}

/// The bytes in a `data:` URI.
pub(super) fn decode_data_uri(uri: &str) -> Checked<Vec<u8>> {
    let (head, body) = uri.split_once(',').ok_or_else(|| Fault::new("a data URI without a comma"))?;
    if !head.ends_with(";base64") {
        return Ok(percent_decoded(body));
    }
    let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let engine = GeneralPurpose::new(&base64::alphabet::STANDARD, config);
    engine.decode(body).map_err(|e| Fault::new(format!("no valid base64: {e}")))
}

/// At most `limit` bytes of the file that a relative URI names.
fn read_file(uri: &str, folder: Option<&Path>, limit: usize) -> Checked<Vec<u8>> {
    let unreachable = "only buffers inside the file can be read here: give the path of the glTF, or a GLB";
    let folder =
        folder.ok_or_else(|| Fault::new(format!("the data is in the file '{uri}'")).with_remedy(unreachable))?;
    let path = folder.join(relative_path(uri)?);
    let missing = |e: std::io::Error| {
        Fault::new(format!("cannot read {}: {e}", path.display())).with_remedy("keep the files of a glTF together")
    };
    let file = File::open(&path).map_err(missing)?;
    let mut bytes = Vec::new();
    file.take(limit as u64).read_to_end(&mut bytes).map_err(missing)?;
    Ok(bytes)
}

/// The path that a relative URI names; none that leaves the folder of the glTF.
pub(super) fn relative_path(uri: &str) -> Checked<PathBuf> {
    let outside = || {
        Fault::new(format!("'{uri}' is not a path below the folder of the glTF"))
            .with_remedy("move the file there and name it by a relative path")
    };
    let path = String::from_utf8(percent_decoded(uri)).map(PathBuf::from).map_err(|_| outside())?;
    let stays = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if stays && !uri.contains("://") && !path.as_os_str().is_empty() { Ok(path) } else { Err(outside()) }
}

fn percent_decoded(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let hex = |at: usize| bytes.get(at).and_then(|&b| char::from(b).to_digit(16));
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], hex(at + 1), hex(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                decoded.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    decoded
}
