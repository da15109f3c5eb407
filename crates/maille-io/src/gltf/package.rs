//! One buffer for everything that a document uses, and the file or files that it makes.

use std::io::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::compose::{Composed, Content};
use super::container::{BIN_CHUNK, JSON_CHUNK, MAGIC, relative_path};
use super::json::{remove, text};
use super::{Document, View};
use crate::WriteError;
use crate::output::Output;

/// Ranges of the old buffers move by multiples of this, so that whatever they hold stays aligned.
const ALIGNMENT: usize = 8;

/// The binary part, piece by piece.
struct Binary<'a> {
    pieces: Vec<(usize, Piece<'a>)>,
    length: usize,
}

enum Piece<'a> {
    Old(&'a [u8]),
    New(Vec<u8>),
}

impl Piece<'_> {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Old(bytes) => bytes,
            Self::New(bytes) => bytes,
        }
    }
}

impl<'a> Binary<'a> {
    /// Appends a piece at the next offset that equals `phase` modulo [`ALIGNMENT`]; the offset.
    fn push(&mut self, piece: Piece<'a>, phase: usize) -> usize {
        let offset = self.length + (phase + ALIGNMENT - self.length % ALIGNMENT) % ALIGNMENT;
        self.length = offset + piece.bytes().len();
        self.pieces.push((offset, piece));
        offset
    }

    fn write(&self, target: &mut impl Write) -> std::io::Result<()> {
        let mut at = 0;
        for (offset, piece) in &self.pieces {
            target.write_all(&[0; ALIGNMENT][..offset - at])?;
            target.write_all(piece.bytes())?;
            at = offset + piece.bytes().len();
        }
        Ok(())
    }
}

/// Writes a composed document as GLB, or as JSON with its buffer beside it.
///
/// In a GLB, images in files of their own become part of the file; beside JSON they are copied, unless they are there
/// already. An image that cannot be found stays a reference.
pub(super) fn write(
    composed: Composed,
    document: &Document,
    glb: bool,
    output: &mut Output<'_>,
) -> Result<(), WriteError> {
    if glb {
        let mut stream = output.main()?;
        write_glb(composed, document, &mut stream)?;
        output.finish(stream)
    } else {
        let Composed { mut json, views } = composed;
        let binary = pack(&mut json, views, document);
        copy_images(&mut json, document, output)?;
        let stem =
            output.target().file_stem().map_or_else(|| "mesh".into(), |stem| stem.to_string_lossy().into_owned());
        let name = format!("{stem}.bin");
        declare_buffer(&mut json, binary.length, Some(&name));
        if binary.length > 0 {
            let mut stream = output.beside(&name)?;
            binary.write(&mut stream)?;
            output.finish(stream)?;
        }
        let mut stream = output.main()?;
        serde_json::to_writer_pretty(&mut stream, &json).map_err(std::io::Error::from)?;
        output.finish(stream)
    }
}

/// The bytes of a composed document as GLB.
pub(super) fn glb(composed: Composed, document: &Document) -> Result<Vec<u8>, WriteError> {
    let mut bytes = Vec::new();
    write_glb(composed, document, &mut bytes)?;
    Ok(bytes)
}

/// Lays out the content of all buffer views in one buffer. Kept ranges that overlap stay one range.
fn pack<'a>(json: &mut Value, views: Vec<Content>, document: &'a Document) -> Binary<'a> {
    let mut kept: Vec<View> =
        views.iter().filter_map(|content| if let Content::Kept(view) = content { Some(*view) } else { None }).collect();
    kept.sort_by_key(|view| (view.buffer, view.start, view.end));
    let mut ranges: Vec<View> = Vec::new();
    for view in kept {
        match ranges.last_mut() {
            Some(last) if last.buffer == view.buffer && view.start <= last.end => last.end = last.end.max(view.end),
            _ => ranges.push(view),
        }
    }
    let mut binary = Binary { pieces: Vec::new(), length: 0 };
    let place = |range: &View| {
        binary.push(Piece::Old(&document.buffers[range.buffer][range.start..range.end]), range.start % ALIGNMENT)
    };
    let offsets: Vec<usize> = ranges.iter().map(place).collect();
    let mut spare = None;
    for (i, content) in views.into_iter().enumerate() {
        let offset = match content {
            Content::Kept(view) => {
                let range = ranges.partition_point(|r| (r.buffer, r.start) <= (view.buffer, view.start)) - 1;
                offsets[range] + view.start - ranges[range].start
            }
            Content::New(bytes) => binary.push(Piece::New(bytes), 0),
            Content::Free => *spare.get_or_insert_with(|| binary.push(Piece::New(vec![0; 4]), 0)),
        };
        place_view(&mut json["bufferViews"][i], offset);
    }
    binary
}

fn place_view(view: &mut Value, offset: usize) {
    view["buffer"] = json!(0);
    if offset > 0 || view.get("byteOffset").is_some() {
        view["byteOffset"] = json!(offset);
    }
}

/// Replaces the list of buffers by the one that all views lie in; its name and extras stay those of the first.
fn declare_buffer(json: &mut Value, length: usize, file: Option<&str>) {
    if length == 0 {
        remove(json, "buffers");
        return;
    }
    let mut buffer = json.get("buffers").and_then(|buffers| buffers.get(0)).cloned().unwrap_or_else(|| json!({}));
    remove(&mut buffer, "uri");
    if let Some(file) = file {
        buffer["uri"] = json!(percent_encoded(file));
    }
    buffer["byteLength"] = json!(length);
    json["buffers"] = json!([buffer]);
}

fn write_glb(composed: Composed, document: &Document, target: &mut impl Write) -> Result<(), WriteError> {
    let Composed { mut json, views } = composed;
    let mut binary = pack(&mut json, views, document);
    embed_images(&mut json, document, &mut binary);
    let body = binary.length.next_multiple_of(4);
    declare_buffer(&mut json, body, None);
    let mut text = serde_json::to_vec(&json).map_err(std::io::Error::from)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + if body > 0 { 8 + body } else { 0 };
    let Ok(total) = u32::try_from(total) else {
        return Err(WriteError::new("a GLB cannot be larger than 4 GiB")
            .with_remedy("write .gltf, which has its data in a file beside it"));
    };
    target.write_all(MAGIC)?;
    target.write_all(&2u32.to_le_bytes())?;
    target.write_all(&total.to_le_bytes())?;
    target.write_all(&(text.len() as u32).to_le_bytes())?;
    target.write_all(JSON_CHUNK)?;
    target.write_all(&text)?;
    if body > 0 {
        target.write_all(&(body as u32).to_le_bytes())?;
        target.write_all(BIN_CHUNK)?;
        binary.write(target)?;
        target.write_all(&[0; 4][..body - binary.length])?;
    }
    Ok(())
}

/// The images that lie in files below the folder of the document: index, relative path, content.
fn files_of_images(json: &Value, document: &Document) -> Vec<(usize, std::path::PathBuf, Vec<u8>)> {
    let images = json.get("images").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let read = |(i, image): (usize, &Value)| {
        let uri = text(image, "uri");
        let folder = document.folder.as_ref().filter(|_| !uri.is_empty() && !uri.starts_with("data:"))?;
        let path = relative_path(uri).ok()?;
        let content = std::fs::read(folder.join(&path)).ok()?;
        Some((i, path, content))
    };
    images.iter().enumerate().filter_map(read).collect()
}

fn embed_images(json: &mut Value, document: &Document, binary: &mut Binary<'_>) {
    for (i, _, content) in files_of_images(json, document) {
        let Some(mime) = mime_type(&content) else { continue };
        let length = content.len();
        let offset = binary.push(Piece::New(content), 0);
        if json.get("bufferViews").is_none() {
            json["bufferViews"] = json!([]);
        }
        let views = json["bufferViews"].as_array_mut().expect("reading has checked the list");
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
        let view = views.len() - 1;
        let image = &mut json["images"][i];
        remove(image, "uri");
        image["bufferView"] = json!(view);
        image["mimeType"] = json!(mime);
    }
}

/// What kind of image the bytes are, by their signature.
fn mime_type(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("image/png"),
        [0xff, 0xd8, ..] => Some("image/jpeg"),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some("image/webp"),
        [0xab, b'K', b'T', b'X', b' ', b'2', b'0', ..] => Some("image/ktx2"),
        _ => None,
    }
}

/// Copies images beside a target in another folder; there they lie flat, under their own names as far as those differ.
fn copy_images(json: &mut Value, document: &Document, output: &mut Output<'_>) -> Result<(), WriteError> {
    let folder =
        |path: &Path| std::fs::canonicalize(if path.as_os_str().is_empty() { Path::new(".") } else { path }).ok();
    let target = output.target().parent().and_then(folder);
    if target.is_some() && target == document.folder.as_deref().and_then(folder) {
        return Ok(());
    }
    let mut names: Vec<(std::path::PathBuf, String)> = Vec::new();
    for (i, path, content) in files_of_images(json, document) {
        let known = names.iter().find(|(other, _)| *other == path).map(|(_, name)| name.clone());
        let name = match known {
            Some(name) => name,
            None => {
                let own = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
                let taken = names.iter().any(|(_, name)| *name == own);
                let name = if taken { format!("{i}-{own}") } else { own };
                let is_there = std::fs::read(output.target().with_file_name(&name)).is_ok_and(|old| old == content);
                if !is_there {
                    let mut stream = output.beside(&name)?;
                    stream.write_all(&content)?;
                    output.finish(stream)?;
                }
                names.push((path, name.clone()));
                name
            }
        };
        json["images"][i]["uri"] = json!(percent_encoded(&name));
    }
    Ok(())
}

/// A file name as a relative URI.
fn percent_encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    name.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}
