//! The OFF family of Geomview: `[ST][C][N]OFF`, text and binary.
//!
//! Vertices become wedges one to one, with normals (N), colours (C, sRGB) and texture coordinates (ST). Colours of
//! faces become a triangle attribute. Colours are bytes if any is above 1. Not read: points of four or more dimensions
//! (`4`, `n`), colour map indices.

use std::io::Write;

use maille::mesh::{ComponentType, Storage, Values};
use maille::{Attribute, Mesh, Semantic};

use crate::asset::Asset;
use crate::color::recoded;
use crate::flatten::{Rows, flattened};
use crate::input::Input;
use crate::output::{Output, Stream};
use crate::settle::{Rounding, settled};
use crate::text::{Words, parse_f64, push_number, show};
use crate::triangulate::Polygons;
use crate::{Place, ReadError, ReadOptions, WriteError, WriteOptions};

/// What the keyword says of the vertices.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Kind {
    normals: bool,
    colors: bool,
    uvs: bool,
}

/// Whether a word is one of the keywords of the family, `[ST][C][N][4][n]OFF`.
pub(crate) fn is_keyword(word: &[u8]) -> bool {
    parse_keyword(word).is_some()
}

/// The kind of vertices, and whether they have more than three dimensions.
fn parse_keyword(word: &[u8]) -> Option<(Kind, bool)> {
    let mut rest = word.strip_suffix(b"OFF")?;
    let mut take = |prefix: &[u8]| match rest.strip_prefix(prefix) {
        Some(tail) => {
            rest = tail;
            true
        }
        None => false,
    };
    let kind = Kind { uvs: take(b"ST"), colors: take(b"C"), normals: take(b"N") };
    let (four, any) = (take(b"4"), take(b"n"));
    rest.is_empty().then_some((kind, four || any))
}

/// What has been read.
#[derive(Default)]
struct Parts {
    positions: Vec<[f32; 3]>,
    normals: Vec<f32>,
    colors: Vec<[f32; 4]>,
    has_alpha: bool,
    uvs: Vec<f32>,
    polygons: Polygons,
    /// As long as there are polygons, or empty.
    face_colors: Vec<[f32; 4]>,
    face_alpha: bool,
    rounding: Rounding,
}

/// Reads an OFF file.
pub(crate) fn read(input: &Input<'_>, options: &ReadOptions) -> Result<Asset, ReadError> {
    // the least text of a value, "0 ", becomes 4 bytes, and a corner takes up to 20
    let needed = 10 * input.len() as u64;
    if needed > options.max_bytes {
        let message = format!("the arrays could take {needed} bytes, the limit is {}", options.max_bytes);
        return Err(ReadError::new(message).with_remedy("raise the limit"));
    }
    let text = input.strip_prefix(b"\xef\xbb\xbf").unwrap_or(input);
    let mut words = Words::new(text, 1, true);
    let mut ahead = words.clone();
    let first = ahead.next().unwrap_or_default();
    let kind = match parse_keyword(first) {
        Some((_, true)) => {
            let error = ahead.error(format!("'{}' holds points of more than three dimensions", show(first)));
            return Err(error.with_remedy("project them to three first"));
        }
        Some((kind, false)) => {
            words = ahead.clone();
            if ahead.next_in_line() == Some(b"BINARY") {
                ahead.skip_line();
                // the line ends with \n, the bytes begin behind it
                let start = (ahead.position() + 1).min(text.len());
                return read_binary(text, start, kind)?.into_asset();
            }
            kind
        }
        // the keyword may be absent
        None => Kind::default(),
    };
    read_text(&mut words, kind)?.into_asset()
}

fn read_text(words: &mut Words<'_>, kind: Kind) -> Result<Parts, ReadError> {
    let mut parts = Parts::default();
    let vertices = words.count("the number of vertices")?;
    let faces = words.count("the number of faces")?;
    // the number of edges is of no use, and some writers leave it out
    while words.next_in_line().is_some() {}
    // a coordinate and what separates it take two bytes, a face of no corners, too
    let least = vertices.saturating_mul(6).saturating_add(faces.saturating_mul(2)).saturating_sub(1);
    if least > words.remaining() as u64 || vertices >= u64::from(u32::MAX) {
        let message =
            format!("{vertices} vertices and {faces} faces are claimed, but {} bytes follow", words.remaining());
        return Err(words.error(message).with_remedy("the file has been cut short: fetch it again"));
    }
    let channels = if kind.colors { count_channels(words, kind) } else { 0 };
    parts.has_alpha = channels == 4;
    for _ in 0..vertices {
        parts.vertex(words, kind, channels)?;
    }
    for _ in 0..faces {
        parts.face(words)?;
    }
    Ok(parts)
}

/// Colours have four channels by the book, and three in many files: the first line tells.
fn count_channels(words: &Words<'_>, kind: Kind) -> usize {
    let mut line = words.clone();
    let mut count = usize::from(line.next().is_some());
    while line.next_in_line().is_some() {
        count += 1;
    }
    let others = 3 + if kind.normals { 3 } else { 0 } + if kind.uvs { 2 } else { 0 };
    if count == others + 3 { 3 } else { 4 }
}

impl Parts {
    /// `x y z [nx ny nz] [r g b a] [s t]`.
    fn vertex(&mut self, words: &mut Words<'_>, kind: Kind, channels: usize) -> Result<(), ReadError> {
        let mut position = [0.0; 3];
        for value in &mut position {
            *value = self.rounding.round(words.number("a coordinate")?);
        }
        self.positions.push(position);
        if kind.normals {
            for _ in 0..3 {
                self.normals.push(words.number("a component of a normal")? as f32);
            }
        }
        if kind.colors {
            let mut color = [1.0; 4];
            for value in &mut color[..channels] {
                *value = words.number("a colour")? as f32;
            }
            self.colors.push(color);
        }
        if kind.uvs {
            for _ in 0..2 {
                self.uvs.push(words.number("a texture coordinate")? as f32);
            }
        }
        Ok(())
    }

    /// `n i1 ... in`, then up to four numbers of colour on the same line.
    fn face(&mut self, words: &mut Words<'_>) -> Result<(), ReadError> {
        let corners = words.count("the number of corners of a face")?;
        for _ in 0..corners {
            let index = words.count("the index of a vertex")?;
            self.corner(index).map_err(|message| words.error(message))?;
        }
        self.polygons.end_polygon();
        let (mut color, mut channels) = ([1.0; 4], 0);
        while let Some(word) = words.next_in_line() {
            let value =
                parse_f64(word).ok_or_else(|| words.error(format!("expected a colour, found '{}'", show(word))))?;
            if channels < 4 {
                color[channels] = value as f32;
            }
            channels += 1;
        }
        self.face_color(color, channels);
        Ok(())
    }

    fn corner(&mut self, index: u64) -> Result<(), String> {
        if index >= self.positions.len() as u64 {
            return Err(format!("a face refers to vertex {index}, but there are {}", self.positions.len()));
        }
        self.polygons.push_corner(index as u32);
        Ok(())
    }

    /// A single number is an index into a colour map, which no file brings along.
    fn face_color(&mut self, mut color: [f32; 4], channels: usize) {
        if channels < 3 {
            color = [f32::NAN; 4];
        }
        self.face_alpha |= channels >= 4;
        if channels >= 3 && self.face_colors.is_empty() {
            self.face_colors.resize(self.polygons.len() - 1, [f32::NAN; 4]);
        }
        if channels >= 3 || !self.face_colors.is_empty() {
            self.face_colors.push(color);
        }
    }

    fn into_asset(self) -> Result<Asset, ReadError> {
        let count = self.positions.len() as u32;
        let mut mesh = Mesh { wedge_vertices: (0..count).collect(), positions: self.positions, ..Mesh::default() };
        if !self.normals.is_empty() {
            mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, self.normals));
        }
        if !self.colors.is_empty() {
            mesh.wedge_attributes.push(color_attribute(&self.colors, self.has_alpha));
        }
        if !self.uvs.is_empty() {
            mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, self.uvs));
        }
        let mut warnings = Vec::new();
        let split = self.polygons.triangulate(|vertex| mesh.positions[vertex as usize]);
        mesh.triangles = split.triangles;
        if split.left_out > 0 {
            warnings.push(format!("{} faces of fewer than three corners were left out", split.left_out));
        }
        if !self.face_colors.is_empty() {
            let mut colors = color_attribute(&self.face_colors, self.face_alpha);
            if let Some(sources) = &split.sources {
                colors.gather(sources);
            }
            mesh.triangle_attributes.push(colors);
        }
        warnings.extend(self.rounding.warning(&mesh));
        settled("", mesh, warnings)
    }
}

/// Colours as the file has them, of 0 to 255 if any is above 1; what has none (NaN) is white.
fn color_attribute(colors: &[[f32; 4]], has_alpha: bool) -> Attribute {
    let components = if has_alpha { 4 } else { 3 };
    let bytes = colors.iter().flat_map(|color| &color[..components]).any(|&value| value > 1.0);
    let unit = if bytes { 255.0 } else { 1.0 };
    let value = |value: f32| if value.is_nan() { 1.0 } else { value / unit };
    let values = colors.iter().flat_map(|color| color[..components].iter().map(|&v| value(v))).collect();
    let component = if bytes { ComponentType::U8 } else { ComponentType::F32 };
    let storage = Storage { component, normalized: bytes, srgb: true };
    Attribute { semantic: Semantic::Color(0), components, values: Values::F32(values), storage }
}

/// Big-endian words of a binary OFF.
struct Binary<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Binary<'_> {
    fn word(&mut self) -> Result<[u8; 4], ReadError> {
        let rest = &self.bytes[self.at..];
        let Some(word) = rest.first_chunk() else {
            let error = ReadError::new("the file ends too early").at(Place::Byte(self.at as u64));
            return Err(error.with_remedy("it has been cut short: fetch it again"));
        };
        self.at += 4;
        Ok(*word)
    }

    fn float(&mut self) -> Result<f32, ReadError> {
        self.word().map(f32::from_be_bytes)
    }

    fn count(&mut self) -> Result<u32, ReadError> {
        let count = self.word().map(i32::from_be_bytes)?;
        let negative = || ReadError::new(format!("a count is {count}")).at(Place::Byte(self.at as u64 - 4));
        u32::try_from(count).map_err(|_| negative())
    }
}

fn read_binary(bytes: &[u8], start: usize, kind: Kind) -> Result<Parts, ReadError> {
    let mut binary = Binary { bytes, at: start };
    let mut parts = Parts { has_alpha: true, ..Parts::default() };
    let (vertices, faces, _edges) = (binary.count()?, binary.count()?, binary.count()?);
    let needed = 12 * u64::from(vertices) + 8 * u64::from(faces);
    let left = (bytes.len() - binary.at) as u64;
    if needed > left {
        let message = format!("{vertices} vertices and {faces} faces are claimed, but only {left} bytes follow");
        let error = ReadError::new(message).at(Place::Byte(start as u64));
        return Err(error.with_remedy("the file has been cut short: fetch it again"));
    }
    for _ in 0..vertices {
        parts.positions.push([binary.float()?, binary.float()?, binary.float()?]);
        if kind.normals {
            parts.normals.extend([binary.float()?, binary.float()?, binary.float()?]);
        }
        if kind.colors {
            parts.colors.push([binary.float()?, binary.float()?, binary.float()?, binary.float()?]);
        }
        if kind.uvs {
            parts.uvs.extend([binary.float()?, binary.float()?]);
        }
    }
    for _ in 0..faces {
        for _ in 0..binary.count()? {
            let index = binary.count()?;
            parts.corner(index.into()).map_err(|m| ReadError::new(m).at(Place::Byte(binary.at as u64 - 4)))?;
        }
        parts.polygons.end_polygon();
        let channels = binary.count()? as usize;
        let mut color = [1.0; 4];
        for value in &mut color[..channels.min(4)] {
            *value = binary.float()?;
        }
        for _ in 4..channels {
            binary.word()?;
        }
        parts.face_color(color, channels);
    }
    Ok(parts)
}

/// Writes an OFF file with what its family can hold: normals, colours, texture coordinates, colours of faces.
pub(crate) fn write(asset: &Asset, output: &mut Output<'_>, options: &WriteOptions) -> Result<(), WriteError> {
    let mesh = flattened(asset);
    let held = [Semantic::Normal, Semantic::Color(0), Semantic::TexCoord(0)];
    let rows = Rows::new(&mesh, |semantic| !held.contains(semantic));
    let mut stream = output.main()?;
    let mut sink = Sink { stream: &mut stream, line: Vec::new(), binary: options.binary_off };
    write_all(&mut sink, &mesh, &rows)?;
    output.finish(stream)
}

/// Takes numbers in either form.
struct Sink<'a, 'b> {
    stream: &'a mut Stream<'b>,
    line: Vec<u8>,
    binary: bool,
}

impl Sink<'_, '_> {
    fn float(&mut self, value: f32) {
        if self.binary {
            self.line.extend_from_slice(&value.to_be_bytes());
        } else {
            push_number(&mut self.line, value);
            self.line.push(b' ');
        }
    }

    fn count(&mut self, value: u32) {
        if self.binary {
            self.line.extend_from_slice(&value.to_be_bytes());
        } else {
            push_number(&mut self.line, value);
            self.line.push(b' ');
        }
    }

    /// A colour; in text those that were bytes are bytes again.
    fn color(&mut self, color: [f32; 4], bytes: bool) {
        for value in color {
            if bytes && !self.binary {
                self.count((value.clamp(0.0, 1.0) * 255.0).round() as u32);
            } else {
                self.float(value);
            }
        }
    }

    fn end_line(&mut self) -> Result<(), WriteError> {
        if let Some(last) = self.line.last_mut().filter(|_| !self.binary) {
            *last = b'\n';
        }
        self.stream.write_all(&self.line)?;
        self.line.clear();
        Ok(())
    }
}

/// Colours to be written, on the sRGB curve.
struct Colors {
    values: Vec<f32>,
    components: usize,
    bytes: bool,
}

impl Colors {
    fn of(attributes: &[Attribute]) -> Option<Self> {
        let attribute = attributes.iter().find(|a| a.semantic == Semantic::Color(0) && a.components >= 3)?;
        let (values, components) = (attribute.as_f32()?, attribute.components);
        let values = if attribute.storage.srgb { values.to_vec() } else { recoded(values, components, true) };
        Some(Self { values, components, bytes: attribute.storage.component == ComponentType::U8 })
    }

    fn get(&self, element: usize) -> [f32; 4] {
        let mut color = [1.0; 4];
        let stored = &self.values[element * self.components..][..self.components.min(4)];
        color[..stored.len()].copy_from_slice(stored);
        color
    }
}

fn write_all(sink: &mut Sink<'_, '_>, mesh: &Mesh, rows: &Rows<'_>) -> Result<(), WriteError> {
    let floats = |semantic: Semantic, components: usize| {
        let attribute = mesh.wedge_attribute(&semantic).filter(|a| a.components == components);
        attribute.and_then(Attribute::as_f32)
    };
    let (normals, uvs) = (floats(Semantic::Normal, 3), floats(Semantic::TexCoord(0), 2));
    let (colors, face_colors) = (Colors::of(&mesh.wedge_attributes), Colors::of(&mesh.triangle_attributes));
    let prefix = |there: bool, name: &'static str| if there { name } else { "" };
    let keyword = [prefix(uvs.is_some(), "ST"), prefix(colors.is_some(), "C"), prefix(normals.is_some(), "N")];
    writeln!(sink.stream, "{}OFF{}", keyword.concat(), prefix(sink.binary, " BINARY"))?;
    for count in [rows.len(), mesh.triangle_count(), 0] {
        let too_many = || WriteError::new("an OFF holds no more than 2^32 - 1 vertices and faces");
        let count = u32::try_from(count).map_err(|_| too_many().with_remedy("write .ply, or simplify it first"));
        sink.count(count?);
    }
    sink.end_line()?;
    for row in 0..rows.len() {
        let wedge = rows.wedge(row);
        mesh.positions[rows.vertex(row)].iter().for_each(|&x| sink.float(x));
        if let Some(values) = normals {
            (0..3).for_each(|k| sink.float(wedge.map_or(0.0, |w| values[3 * w + k])));
        }
        if let Some(colors) = &colors {
            sink.color(wedge.map_or([1.0; 4], |w| colors.get(w)), colors.bytes);
        }
        if let Some(values) = uvs {
            (0..2).for_each(|k| sink.float(wedge.map_or(0.0, |w| values[2 * w + k])));
        }
        sink.end_line()?;
    }
    for triangle in 0..mesh.triangle_count() {
        sink.count(3);
        rows.triangle(triangle).into_iter().for_each(|v| sink.count(v));
        if sink.binary {
            sink.count(if face_colors.is_some() { 4 } else { 0 });
        }
        if let Some(colors) = &face_colors {
            sink.color(colors.get(triangle), colors.bytes);
        }
        sink.end_line()?;
    }
    Ok(())
}
