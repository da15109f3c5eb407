//! Reading: pieces joined into a mesh.

use std::collections::HashMap;
use std::hash::Hash;
use std::ops::Range;
use std::path::{Component, Path};

use maille::mesh::{ComponentType, Storage, Values};
use maille::{Attribute, Mesh, Semantic};
use rayon::prelude::*;

use super::parse::{Event, NONE, Piece, parse};
use super::{GROUP, ObjSource, Part, SMOOTHING};
use crate::asset::Source;
use crate::input::Input;
use crate::settle::{Rounding, settled};
use crate::triangulate::Polygons;
use crate::wedges::WedgeTable;
use crate::{Asset, Place, ReadError, ReadOptions};

/// Bytes of a piece, more or less. Fixed, so that nothing depends on the number of threads.
const PIECE: usize = 1 << 20;

/// Largest MTL that is carried along.
const MTL_LIMIT: u64 = 16 << 20;

/// Reads an OBJ file; `folder` is where its MTL is looked for.
pub(crate) fn read(input: &Input<'_>, folder: Option<&Path>, options: &ReadOptions) -> Result<Asset, ReadError> {
    let ranges = cut(input);
    let parsed: Vec<_> = ranges
        .par_iter()
        .map(|range| {
            let piece = parse(&input[range.clone()]);
            input.release(range.clone());
            piece
        })
        .collect();
    let mut pieces = Vec::with_capacity(parsed.len());
    for (piece, range) in parsed.into_iter().zip(ranges) {
        let place = |at: usize| Place::Line(line_of(&input[..range.start + at]));
        pieces.push(piece.map_err(|fault| ReadError::new(fault.message).at(place(fault.at)))?);
    }
    let mut joined = Joined::new(&pieces);
    joined.check_memory(options)?;
    let states = States::of(&pieces);
    let polygons = joined.polygons(&pieces).map_err(|(face, message)| {
        ReadError::new(message)
            .at(face_line(input, face).map_or(Place::Part(format!("face {}", face + 1)), Place::Line))
    })?;
    let mut warnings = joined.warnings();
    let libraries = states.libraries.clone();
    drop(pieces);
    let (mut mesh, rounding) = (joined.mesh, joined.rounding);
    let source = states.apply(&mut mesh, polygons, &mut warnings);
    warnings.extend(rounding.warning(&mesh));
    let mtl = read_libraries(folder, &libraries, &mut warnings);
    let mut asset = settled("", mesh, warnings)?;
    asset.source = Source::Obj(Box::new(ObjSource { parts: source, mtl }));
    Ok(asset)
}

/// Ranges that end behind a line that is not continued.
fn cut(bytes: &[u8]) -> Vec<Range<usize>> {
    let (mut ranges, mut start) = (Vec::new(), 0);
    while start < bytes.len() {
        let mut end = (start + PIECE).min(bytes.len());
        while end < bytes.len() {
            let is_end = bytes[end - 1] == b'\n' || (bytes[end - 1] == b'\r' && bytes[end] != b'\n');
            if is_end && !bytes[..end].trim_ascii_end().ends_with(b"\\") {
                break;
            }
            end += 1;
        }
        ranges.push(start..end);
        start = end;
    }
    ranges
}

/// The number of the line that begins after `before`.
fn line_of(before: &[u8]) -> u64 {
    let ends = |(i, &b): (usize, &u8)| b == b'\n' || (b == b'\r' && before.get(i + 1) != Some(&b'\n'));
    1 + before.iter().enumerate().filter(|&at| ends(at)).count() as u64
}

/// The line of a face, counted among faces from 0. Goes through the file again: only for errors.
fn face_line(bytes: &[u8], face: usize) -> Option<u64> {
    let mut at = 0;
    let mut faces = 0;
    for line in bytes.split_inclusive(|&b| b == b'\n' || b == b'\r') {
        let word = line.trim_ascii_start().split(u8::is_ascii_whitespace).next().unwrap_or_default();
        if matches!(word, b"f" | b"fo") {
            if faces == face {
                return Some(line_of(&bytes[..at]));
            }
            faces += 1;
        }
        at += line.len();
    }
    None
}

/// All pieces together, faces apart.
struct Joined {
    mesh: Mesh,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    colors: Vec<[f32; 3]>,
    corners: usize,
    rounding: Rounding,
    left_out: usize,
    free_form: usize,
    lacking: [usize; 2],
}

impl Joined {
    fn new(pieces: &[Piece]) -> Self {
        let mut joined = Self {
            mesh: Mesh::default(),
            uvs: pieces.iter().flat_map(|p| &p.uvs).copied().collect(),
            normals: pieces.iter().flat_map(|p| &p.normals).copied().collect(),
            colors: Vec::new(),
            corners: pieces.iter().map(|p| p.corners.len()).sum(),
            rounding: pieces.iter().fold(Rounding::default(), |all, p| all.join(p.rounding)),
            left_out: pieces.iter().map(|p| p.left_out).sum(),
            free_form: pieces.iter().map(|p| p.free_form).sum(),
            lacking: [0; 2],
        };
        for piece in pieces {
            joined.mesh.positions.extend_from_slice(&piece.positions);
            if !piece.colors.is_empty() {
                joined.colors.resize(joined.mesh.positions.len() - piece.positions.len(), [1.0; 3]);
                joined.colors.extend_from_slice(&piece.colors);
            }
        }
        if !joined.colors.is_empty() {
            joined.colors.resize(joined.mesh.positions.len(), [1.0; 3]);
        }
        joined
    }

    fn check_memory(&self, options: &ReadOptions) -> Result<(), ReadError> {
        let bytes = 44 * self.corners as u64 + 32 * self.mesh.positions.len() as u64;
        if bytes <= options.max_bytes {
            return Ok(());
        }
        let message = format!("the arrays would take {bytes} bytes, the limit is {}", options.max_bytes);
        Err(ReadError::new(message).with_remedy("raise the limit"))
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.left_out > 0 {
            warnings.push(format!("{} lines and points were left out", self.left_out));
        }
        if self.free_form > 0 {
            warnings.push(format!("{} free-form curves or surfaces were left out", self.free_form));
        }
        for (kind, name) in [(0, "texture coordinates"), (1, "normals")] {
            let there = [!self.uvs.is_empty(), !self.normals.is_empty()][kind];
            if there && self.lacking[kind] > 0 {
                warnings.push(format!("{} corners have no {name} and were given zeros", self.lacking[kind]));
            }
        }
        warnings
    }

    /// Makes wedges and the faces over them. An error names the face.
    fn polygons(&mut self, pieces: &[Piece]) -> Result<Polygons, (usize, String)> {
        let counts = [self.mesh.positions.len(), self.uvs.len(), self.normals.len()];
        let mut wedges = Wedges::new(self);
        let (mut polygons, mut before) = (Polygons::default(), [0; 3]);
        for piece in pieces {
            let mut start = 0;
            for &end in &piece.face_ends {
                for corner in &piece.corners[start..end] {
                    let indices = [0, 1, 2].map(|kind| corner.index(kind, before[kind]));
                    for kind in 0..3 {
                        let in_range = (0..counts[kind] as i64).contains(&indices[kind]);
                        if !in_range && (indices[kind] != NONE || kind == 0) {
                            let name = ["vertex", "texture coordinate", "normal"][kind];
                            let message = format!(
                                "a face refers to {name} {}, but there are {}",
                                indices[kind].saturating_add(1),
                                counts[kind]
                            );
                            return Err((polygons.len(), message));
                        }
                    }
                    polygons.push_corner(wedges.wedge(indices));
                }
                polygons.end_polygon();
                start = end;
            }
            let here = [piece.positions.len(), piece.uvs.len(), piece.normals.len()];
            before = [0, 1, 2].map(|kind| before[kind] + here[kind]);
        }
        let Wedges { table, lacking, .. } = wedges;
        self.lacking = lacking;
        self.set_wedges(table);
        Ok(polygons)
    }

    fn set_wedges(&mut self, table: Option<WedgeTable<[u32; 5]>>) {
        let vertex_count = self.mesh.positions.len() as u32;
        let Some(table) = table else {
            self.mesh.wedge_vertices = (0..vertex_count).collect();
            self.set_colors();
            return;
        };
        let part = |range: Range<usize>| table.keys().flat_map(move |key| key[range.clone()].to_vec());
        if !self.uvs.is_empty() {
            let values = part(0..2).map(f32::from_bits).collect();
            self.mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, values));
        }
        if !self.normals.is_empty() {
            let values = part(2..5).map(f32::from_bits).collect();
            self.mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, values));
        }
        self.mesh.wedge_vertices = table.into_vertices();
        self.set_colors();
    }

    fn set_colors(&mut self) {
        if self.colors.is_empty() {
            return;
        }
        // some scanners write bytes
        let bytes = self.colors.as_flattened().iter().any(|&value| value > 1.0);
        let unit = if bytes { 255.0 } else { 1.0 };
        let component = if bytes { ComponentType::U8 } else { ComponentType::F32 };
        let values = self.mesh.wedge_vertices.iter().flat_map(|&v| self.colors[v as usize].map(|value| value / unit));
        self.mesh.wedge_attributes.push(Attribute {
            semantic: Semantic::Color(0),
            components: 3,
            values: Values::F32(values.collect()),
            storage: Storage { component, normalized: bytes, srgb: true },
        });
    }
}

/// Finds wedges by the values of their attributes.
struct Wedges<'a> {
    uvs: &'a [[f32; 2]],
    normals: &'a [[f32; 3]],
    /// `None` where no corner has attributes of its own.
    table: Option<WedgeTable<[u32; 5]>>,
    /// Corners without texture coordinates and without normals.
    lacking: [usize; 2],
}

impl<'a> Wedges<'a> {
    fn new(joined: &'a Joined) -> Self {
        let plain = joined.uvs.is_empty() && joined.normals.is_empty();
        let table = (!plain).then(|| WedgeTable::new(joined.mesh.positions.len()));
        Self { uvs: &joined.uvs, normals: &joined.normals, table, lacking: [0; 2] }
    }

    fn wedge(&mut self, [v, t, n]: [i64; 3]) -> u32 {
        let Some(table) = &mut self.table else { return v as u32 };
        let mut key = [0; 5];
        match t {
            NONE => self.lacking[0] += 1,
            t => key[..2].copy_from_slice(&self.uvs[t as usize].map(f32::to_bits)),
        }
        match n {
            NONE => self.lacking[1] += 1,
            n => key[2..].copy_from_slice(&self.normals[n as usize].map(f32::to_bits)),
        }
        table.wedge(v as u32, key)
    }
}

/// What the state of the file makes of each face.
#[derive(Default)]
struct States {
    parts: Vec<Part>,
    materials: Vec<String>,
    libraries: Vec<String>,
    /// Part, material and smoothing group of each face.
    faces: Vec<[u32; 3]>,
}

impl States {
    fn of(pieces: &[Piece]) -> Self {
        let mut states = Self::default();
        let (mut parts, mut materials) = (Labels::new(), Labels::new());
        let (mut part, mut material, mut smoothing) = (Part::default(), String::new(), 0);
        for piece in pieces {
            let ends = piece.events.iter().map(|&(face, _)| face).chain([piece.face_ends.len()]);
            let events = std::iter::once(None).chain(piece.events.iter().map(|(_, event)| Some(event)));
            let mut start = 0;
            for (event, end) in events.zip(ends) {
                match event {
                    None => {}
                    Some(Event::Object(name)) => part = Part { object: name.clone(), group: String::new() },
                    Some(Event::Group(name)) => part.group.clone_from(name),
                    Some(Event::Material(name)) => material.clone_from(name),
                    Some(Event::Smoothing(group)) => smoothing = *group,
                    Some(Event::Library(name)) => states.libraries.push(name.clone()),
                }
                if end > start {
                    let labels = [parts.of(&part), materials.of(&material), smoothing];
                    states.faces.resize(states.faces.len() + end - start, labels);
                }
                start = end;
            }
        }
        (states.parts, states.materials) = (parts.list, materials.list);
        states
    }

    /// Splits the faces into triangles of the mesh; returns what the group labels stand for.
    fn apply(mut self, mesh: &mut Mesh, polygons: Polygons, warnings: &mut Vec<String>) -> Vec<Part> {
        let (positions, wedges) = (&mesh.positions, &mesh.wedge_vertices);
        let split = polygons.triangulate(|w| positions[wedges[w as usize] as usize]);
        mesh.triangles = split.triangles;
        if split.left_out > 0 {
            warnings.push(format!("{} faces of fewer than three corners were left out", split.left_out));
        }
        if let Some(sources) = split.sources {
            self.faces = sources.iter().map(|&face| self.faces[face as usize]).collect();
        }
        let column = |kind: usize| self.faces.iter().map(|labels| labels[kind]).collect::<Vec<_>>();
        let label = |name: &str, kind| Attribute::new_u32(Semantic::Custom(name.to_owned()), 1, column(kind));
        if self.parts.iter().any(|part| *part != Part::default()) {
            mesh.triangle_attributes.push(label(GROUP, 0));
        }
        if self.faces.iter().any(|labels| labels[2] != 0) {
            mesh.triangle_attributes.push(label(SMOOTHING, 2));
        }
        if self.materials.len() > 1 {
            mesh.triangle_materials = column(1);
        }
        if self.materials.iter().any(|name| !name.is_empty()) {
            mesh.material_names = self.materials;
        }
        self.parts
    }
}

/// Distinct values, numbered by first appearance.
struct Labels<T> {
    list: Vec<T>,
    numbers: HashMap<T, u32>,
}

impl<T: Eq + Hash + Clone> Labels<T> {
    fn new() -> Self {
        Self { list: Vec::new(), numbers: HashMap::new() }
    }

    /// The number of a value.
    fn of(&mut self, value: &T) -> u32 {
        if let Some(&known) = self.numbers.get(value) {
            return known;
        }
        let new = self.list.len() as u32;
        self.list.push(value.clone());
        self.numbers.insert(value.clone(), new);
        new
    }
}

/// The text of the material libraries that can be found.
fn read_libraries(folder: Option<&Path>, names: &[String], warnings: &mut Vec<String>) -> Vec<u8> {
    let mut text = Vec::new();
    for (i, name) in names.iter().enumerate() {
        let Some(folder) = folder.filter(|_| !names[..i].contains(name)) else { continue };
        let path = Path::new(name);
        // a file that comes from elsewhere does not choose what is read: only what lies beside or below it
        let is_inside =
            !name.is_empty() && path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        let path = folder.join(path);
        let is_small = std::fs::metadata(&path).is_ok_and(|meta| meta.is_file() && meta.len() <= MTL_LIMIT);
        match std::fs::read(&path) {
            Ok(bytes) if is_inside && is_small => {
                text.extend_from_slice(&bytes);
                if !bytes.ends_with(b"\n") {
                    text.push(b'\n');
                }
            }
            _ => {
                let message = format!("the material library '{name}' could not be read; only material names are kept");
                warnings.push(message);
            }
        }
    }
    text
}
