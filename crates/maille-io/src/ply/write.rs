//! Writing.

use std::borrow::Cow;
use std::io::Write;

use maille::mesh::{ComponentType, Values};
use maille::{Attribute, Mesh, Semantic};
use rayon::prelude::*;

use super::body::{Rows, real};
use super::header::{Element, Kind, Property, size_of, type_name};
use super::roles::{Role, face_roles, unit, vertex_roles};
use super::{PlySource, in_words};
use crate::asset::Source;
use crate::color::recoded;
use crate::flatten::{self, flattened};
use crate::output::{Output, Stream};
use crate::text::push_number;
use crate::{Asset, WriteError, WriteOptions};

/// Rows made at a time.
const BLOCK: usize = 1 << 16;

/// Writes a PLY file: binary little endian, or text if wanted.
pub(crate) fn write(asset: &Asset, output: &mut Output<'_>, options: &WriteOptions) -> Result<(), WriteError> {
    let mesh = flattened(asset);
    let source = match &asset.source {
        Source::Ply(source) => Some(&**source),
        _ => None,
    };
    let aside = |s: &Semantic| source.is_some_and(PlySource::has_face_uvs) && *s == Semantic::TexCoord(0);
    let rows = flatten::Rows::new(&mesh, aside);
    // texture coordinates stay in the faces only where that spares vertices
    let face_uvs = mesh.wedge_attribute(&Semantic::TexCoord(0)).filter(|a| rows.are_vertices() && aside(&a.semantic));
    let sheet = Sheet { mesh: &mesh, rows: &rows, source, face_uvs: face_uvs.and_then(Attribute::as_f32) };
    let (vertices, faces) = (sheet.vertex_columns(), sheet.face_columns());
    let mut stream = output.main()?;
    sheet.write_header(&mut stream, options, &vertices, &faces)?;
    sheet.write_vertices(&mut stream, options, &vertices)?;
    sheet.write_faces(&mut stream, options, &faces)?;
    for (element, bytes) in sheet.others() {
        write_other(&mut stream, options, element, bytes)?;
    }
    output.finish(stream)?;
    for (element, _) in sheet.outdated() {
        output.warn(format!("left out: {}, which names vertices by numbers of before", in_words(element)));
    }
    Ok(())
}

impl PlySource {
    fn has_face_uvs(&self) -> bool {
        self.face.iter().any(|p| p.name == "texcoord" && !p.kind.is_scalar())
    }
}

/// Everything that goes into one file.
struct Sheet<'a> {
    mesh: &'a Mesh,
    rows: &'a flatten::Rows<'a>,
    source: Option<&'a PlySource>,
    /// Texture coordinates by wedge, where they go into the faces.
    face_uvs: Option<&'a [f32]>,
}

/// A scalar property and where its values come from.
struct Column<'a> {
    name: String,
    ty: ComponentType,
    from: From<'a>,
}

enum From<'a> {
    Position(usize),
    Material,
    Floats { values: Cow<'a, [f32]>, components: usize, slot: usize, unit: f32, by_vertex: bool },
    Labels { values: &'a [u32], components: usize, slot: usize, by_vertex: bool },
}

impl<'a> Sheet<'a> {
    fn vertex_columns(&self) -> Vec<Column<'a>> {
        let mesh = self.mesh;
        let attributes = mesh.wedge_attributes.iter().map(|a| (a, false));
        let attributes: Vec<_> = (attributes.chain(mesh.vertex_attributes.iter().map(|a| (a, true))))
            .filter(|(a, _)| self.face_uvs.is_none() || a.semantic != Semantic::TexCoord(0))
            .collect();
        let mut columns = Vec::new();
        let properties = self.source.map_or(&[][..], |s| &s.vertex);
        for (property, role) in properties.iter().zip(vertex_roles(properties)) {
            columns.extend(kept_column(property, &role, &attributes));
        }
        for axis in 0..3 {
            if !columns.iter().any(|c| matches!(c.from, From::Position(k) if k == axis)) {
                let name = ["x", "y", "z"][axis].to_owned();
                columns.insert(axis, Column { name, ty: ComponentType::F32, from: From::Position(axis) });
            }
        }
        add_new_columns(&mut columns, properties, &vertex_roles(properties), &attributes);
        columns
    }

    fn face_columns(&self) -> Vec<Column<'a>> {
        let attributes: Vec<_> = self.mesh.triangle_attributes.iter().map(|a| (a, false)).collect();
        let properties = self.source.map_or(&[][..], |s| &s.face);
        let roles = face_roles(properties);
        let mut columns = Vec::new();
        for (property, role) in properties.iter().zip(&roles) {
            columns.extend(kept_column(property, role, &attributes));
        }
        add_new_columns(&mut columns, properties, &roles, &attributes);
        if !self.mesh.triangle_materials.is_empty() {
            if !columns.iter().any(|c| matches!(c.from, From::Material)) {
                let name = "material_index".to_owned();
                columns.push(Column { name, ty: ComponentType::I32, from: From::Material });
            }
        } else {
            columns.retain(|c| !matches!(c.from, From::Material));
        }
        columns
    }

    /// Elements that are still right.
    fn others(&self) -> impl Iterator<Item = &'a (Element, Vec<u8>)> {
        self.elements(|is_outdated| !is_outdated)
    }

    /// Elements that refer to vertices, once these are no longer the ones they knew.
    fn outdated(&self) -> impl Iterator<Item = &'a (Element, Vec<u8>)> {
        self.elements(|is_outdated| is_outdated)
    }

    fn elements(&self, wanted: fn(bool) -> bool) -> impl Iterator<Item = &'a (Element, Vec<u8>)> {
        let same_vertices = self.source.is_some_and(|s| s.vertex_count == self.rows.len());
        let refers = |e: &Element| e.properties.iter().any(|p| p.name.starts_with("vertex"));
        let others = self.source.map_or(&[][..], |s| &s.others);
        others.iter().filter(move |(element, _)| wanted(!same_vertices && refers(element)))
    }

    fn write_header(
        &self,
        stream: &mut Stream<'_>,
        options: &WriteOptions,
        vertices: &[Column<'_>],
        faces: &[Column<'_>],
    ) -> Result<(), WriteError> {
        let sized = self.source.is_some_and(|s| s.sized_names);
        let name = |ty| type_name(ty, sized);
        let encoding = if options.text { "ascii" } else { "binary_little_endian" };
        writeln!(stream, "ply\nformat {encoding} 1.0")?;
        for note in self.source.map_or(&[][..], |s| &s.notes) {
            writeln!(stream, "{note}")?;
        }
        writeln!(stream, "element vertex {}", self.rows.len())?;
        for column in vertices {
            writeln!(stream, "property {} {}", name(column.ty), column.name)?;
        }
        let (uchar, int, float) = (name(ComponentType::U8), name(self.index_type()), name(ComponentType::F32));
        let known = |p: &&Property| p.name == "vertex_index" && !p.kind.is_scalar();
        let list = self.source.and_then(|s| s.face.iter().find(known)).map_or("vertex_indices", |p| &p.name);
        writeln!(stream, "element face {}\nproperty list {uchar} {int} {list}", self.mesh.triangle_count())?;
        if self.face_uvs.is_some() {
            writeln!(stream, "property list {uchar} {float} texcoord")?;
        }
        for column in faces {
            writeln!(stream, "property {} {}", name(column.ty), column.name)?;
        }
        for (element, _) in self.others() {
            writeln!(stream, "element {} {}", element.name, element.count)?;
            for property in &element.properties {
                match property.kind {
                    Kind::Scalar(ty) => writeln!(stream, "property {} {}", name(ty), property.name)?,
                    Kind::List { count, item } => {
                        writeln!(stream, "property list {} {} {}", name(count), name(item), property.name)?;
                    }
                }
            }
        }
        writeln!(stream, "end_header")?;
        Ok(())
    }

    /// As the file that was read had it, else `int`, the only one that all readers know.
    fn index_type(&self) -> ComponentType {
        let is_unsigned = |p: &Property| matches!(p.kind, Kind::List { item: ComponentType::U32, .. });
        let was_unsigned = self.source.is_some_and(|s| s.face.iter().any(is_unsigned));
        if was_unsigned || self.rows.len() > i32::MAX as usize { ComponentType::U32 } else { ComponentType::I32 }
    }

    fn write_vertices(
        &self,
        stream: &mut Stream<'_>,
        options: &WriteOptions,
        columns: &[Column<'_>],
    ) -> Result<(), WriteError> {
        let kinds: Vec<Kind> = columns.iter().map(|c| Kind::Scalar(c.ty)).collect();
        let stride = columns.iter().map(|c| size_of(c.ty)).sum();
        write_rows(stream, options, &kinds, self.rows.len(), stride, |row, mut out| {
            let (vertex, wedge) = (self.rows.vertex(row), self.rows.wedge(row));
            for column in columns {
                out = column.store(out, self, vertex, wedge);
            }
        })
    }

    fn write_faces(
        &self,
        stream: &mut Stream<'_>,
        options: &WriteOptions,
        columns: &[Column<'_>],
    ) -> Result<(), WriteError> {
        let list = |item| Kind::List { count: ComponentType::U8, item };
        let mut kinds = vec![list(self.index_type())];
        kinds.extend(self.face_uvs.map(|_| list(ComponentType::F32)));
        kinds.extend(columns.iter().map(|c| Kind::Scalar(c.ty)));
        let lists = 13 + self.face_uvs.map_or(0, |_| 25);
        let stride = lists + columns.iter().map(|c| size_of(c.ty)).sum::<usize>();
        write_rows(stream, options, &kinds, self.mesh.triangle_count(), stride, |row, out| {
            let (indices, mut out) = out.split_at_mut(13);
            indices[0] = 3;
            for (bytes, vertex) in indices[1..].chunks_exact_mut(4).zip(self.rows.triangle(row)) {
                bytes.copy_from_slice(&vertex.to_le_bytes());
            }
            if let Some(uvs) = self.face_uvs {
                let (list, rest) = out.split_at_mut(25);
                list[0] = 6;
                let corners = self.mesh.triangles[row].iter().flat_map(|&w| &uvs[2 * w as usize..][..2]);
                for (bytes, value) in list[1..].chunks_exact_mut(4).zip(corners) {
                    bytes.copy_from_slice(&value.to_le_bytes());
                }
                out = rest;
            }
            for column in columns {
                out = column.store(out, self, row, Some(row));
            }
        })
    }
}

/// A column of the file that was read, if its values are still there.
fn kept_column<'a>(property: &Property, role: &Role, attributes: &[(&'a Attribute, bool)]) -> Option<Column<'a>> {
    let Kind::Scalar(ty) = property.kind else { return None };
    let name = property.name.clone();
    match role {
        // what was an integer no longer is
        Role::Position(axis) => {
            let ty = if ty == ComponentType::F64 { ty } else { ComponentType::F32 };
            Some(Column { name, ty, from: From::Position(*axis) })
        }
        Role::Material => Some(Column { name, ty, from: From::Material }),
        Role::Part { semantic, slot } => {
            let &(attribute, by_vertex) = attributes.iter().find(|(a, _)| a.semantic == *semantic)?;
            // char colours held bytes all along
            let ty = match (semantic, ty) {
                (Semantic::Color(_), ComponentType::I8) => ComponentType::U8,
                (Semantic::Color(_), ComponentType::I16) => ComponentType::U16,
                _ => ty,
            };
            (*slot < attribute.components).then(|| column_of(name, ty, attribute, *slot, by_vertex))
        }
        Role::List => None,
    }
}

/// Columns for what the file that was read did not have.
fn add_new_columns<'a>(
    columns: &mut Vec<Column<'a>>,
    properties: &[Property],
    roles: &[Role],
    attributes: &[(&'a Attribute, bool)],
) {
    for &(attribute, by_vertex) in attributes {
        let ty = new_type(attribute);
        for slot in 0..attribute.components {
            let known = |role: &Role| *role == Role::Part { semantic: attribute.semantic.clone(), slot };
            if !roles.iter().any(known) {
                let mut name = new_name(&attribute.semantic, slot, attribute.components);
                while columns.iter().any(|c| c.name == name) || properties.iter().any(|p| p.name == name) {
                    name.push('_');
                }
                columns.push(column_of(name, ty, attribute, slot, by_vertex));
            }
        }
    }
}

fn column_of(name: String, ty: ComponentType, attribute: &Attribute, slot: usize, by_vertex: bool) -> Column<'_> {
    let components = attribute.components;
    let from = match &attribute.values {
        Values::U32(values) => From::Labels { values, components, slot, by_vertex },
        Values::F32(values) => {
            let is_color = matches!(attribute.semantic, Semantic::Color(_));
            let values = if is_color && !attribute.storage.srgb && slot < 3 {
                Cow::Owned(recoded(values, components, true))
            } else {
                Cow::Borrowed(&values[..])
            };
            From::Floats { values, components, slot, unit: unit(&attribute.semantic, ty), by_vertex }
        }
    };
    Column { name, ty, from }
}

/// Colours go as bytes, which all programs read, unless they are finer; everything else as it was stored.
fn new_type(attribute: &Attribute) -> ComponentType {
    let storage = attribute.storage;
    match (&attribute.semantic, &attribute.values) {
        (Semantic::Color(_), _) if storage.component == ComponentType::U16 && storage.srgb => ComponentType::U16,
        (Semantic::Color(_), _) => ComponentType::U8,
        (Semantic::Custom(_), _) if !storage.normalized => storage.component,
        (_, Values::F32(_)) => ComponentType::F32,
        (_, Values::U32(_)) => ComponentType::U32,
    }
}

/// The usual names where there are any.
fn new_name(semantic: &Semantic, slot: usize, components: usize) -> String {
    let letter = |letters: &[&str]| letters.get(slot).map_or_else(|| slot.to_string(), |&l| l.to_owned());
    match semantic {
        Semantic::Position => letter(&["x", "y", "z"]),
        Semantic::Normal => letter(&["nx", "ny", "nz"]),
        Semantic::Tangent => letter(&["tx", "ty", "tz", "tw"]),
        Semantic::Color(0) => letter(&["red", "green", "blue", "alpha"]),
        Semantic::Color(n) => format!("color{n}_{}", letter(&["red", "green", "blue", "alpha"])),
        Semantic::TexCoord(0) => letter(&["s", "t"]),
        Semantic::TexCoord(n) => format!("texcoord{n}_{}", letter(&["s", "t"])),
        Semantic::Joints(n) => format!("joints{n}_{slot}"),
        Semantic::Weights(n) => format!("weights{n}_{slot}"),
        Semantic::Custom(name) => {
            // a name of a PLY property is one word
            let name: String = name.split_whitespace().collect::<Vec<_>>().join("_");
            let name = if name.is_empty() { "custom".to_owned() } else { name };
            if components == 1 { name } else { format!("{name}_{slot}") }
        }
    }
}

impl Column<'_> {
    /// Writes the value of one row and returns the space behind it.
    fn store<'o>(&self, out: &'o mut [u8], sheet: &Sheet<'_>, vertex: usize, wedge: Option<usize>) -> &'o mut [u8] {
        let (out, rest) = out.split_at_mut(size_of(self.ty));
        let element = |by_vertex: bool| if by_vertex { Some(vertex) } else { wedge };
        match &self.from {
            From::Position(axis) => store_real(out, self.ty, sheet.mesh.positions[vertex][*axis]),
            From::Material => {
                let slot = sheet.mesh.triangle_material(vertex);
                let numbers = sheet.source.map_or(&[][..], |s| &s.materials);
                store_label(out, self.ty, numbers.get(slot as usize).copied().unwrap_or(slot));
            }
            From::Floats { values, components, slot, unit, by_vertex } => {
                let value = element(*by_vertex).map_or(0.0, |e| values[e * components + slot]);
                store_real(out, self.ty, value * unit);
            }
            From::Labels { values, components, slot, by_vertex } => {
                store_label(out, self.ty, element(*by_vertex).map_or(0, |e| values[e * components + slot]));
            }
        }
        rest
    }
}

/// Stores a quantity; integers are rounded and kept in their range.
fn store_real(out: &mut [u8], ty: ComponentType, value: f32) {
    match ty {
        ComponentType::F32 => out.copy_from_slice(&value.to_le_bytes()),
        ComponentType::F64 => out.copy_from_slice(&f64::from(value).to_le_bytes()),
        ComponentType::I8 => out.copy_from_slice(&(value.round() as i8).to_le_bytes()),
        ComponentType::U8 => out.copy_from_slice(&(value.round() as u8).to_le_bytes()),
        ComponentType::I16 => out.copy_from_slice(&(value.round() as i16).to_le_bytes()),
        ComponentType::U16 => out.copy_from_slice(&(value.round() as u16).to_le_bytes()),
        ComponentType::I32 => out.copy_from_slice(&(value.round() as i32).to_le_bytes()),
        ComponentType::U32 => out.copy_from_slice(&(value.round() as u32).to_le_bytes()),
    }
}

/// Stores a label: 32-bit integers bit by bit.
fn store_label(out: &mut [u8], ty: ComponentType, value: u32) {
    match ty {
        ComponentType::F32 => out.copy_from_slice(&(value as f32).to_le_bytes()),
        ComponentType::F64 => out.copy_from_slice(&f64::from(value).to_le_bytes()),
        _ => out.copy_from_slice(&value.to_le_bytes()[..size_of(ty)]),
    }
}

/// Writes rows of equal length, made on all threads.
fn write_rows(
    stream: &mut Stream<'_>,
    options: &WriteOptions,
    kinds: &[Kind],
    count: usize,
    stride: usize,
    fill: impl Fn(usize, &mut [u8]) + Sync,
) -> Result<(), WriteError> {
    let mut bytes = vec![0; stride * BLOCK.min(count)];
    for start in (0..count).step_by(BLOCK) {
        let block = &mut bytes[..stride * BLOCK.min(count - start)];
        block.par_chunks_exact_mut(stride).with_min_len(1024).enumerate().for_each(|(i, row)| fill(start + i, row));
        write_block(stream, options, kinds, block)?;
    }
    Ok(())
}

fn write_other(
    stream: &mut Stream<'_>,
    options: &WriteOptions,
    element: &Element,
    bytes: &[u8],
) -> Result<(), WriteError> {
    let kinds: Vec<Kind> = element.properties.iter().map(|p| p.kind).collect();
    write_block(stream, options, &kinds, bytes)
}

/// Writes binary rows as they are or as text.
fn write_block(
    stream: &mut Stream<'_>,
    options: &WriteOptions,
    kinds: &[Kind],
    bytes: &[u8],
) -> Result<(), WriteError> {
    if !options.text {
        return Ok(stream.write_all(bytes)?);
    }
    let properties = kinds.iter().map(|&kind| Property { name: String::new(), kind }).collect();
    let element = Element { name: String::new(), count: 0, properties };
    let mut cursor = Rows { bytes, big_endian: false, offset: None }.cursor(&element);
    let short = |_| WriteError::new("rows are incomplete");
    let mut line = Vec::new();
    while cursor.position() < bytes.len() {
        line.clear();
        for &kind in kinds {
            match kind {
                Kind::Scalar(ty) => push_value(&mut line, cursor.scalar(ty).map_err(short)?, ty),
                Kind::List { count, item } => {
                    let (items, length) = cursor.list(count, item).map_err(short)?;
                    push_number(&mut line, length as f64);
                    line.push(b' ');
                    items.chunks_exact(size_of(item)).for_each(|value| push_value(&mut line, value, item));
                }
            }
        }
        if let Some(last) = line.last_mut() {
            *last = b'\n';
        }
        stream.write_all(&line)?;
    }
    Ok(())
}

/// Appends a value and a blank.
fn push_value(line: &mut Vec<u8>, bytes: &[u8], ty: ComponentType) {
    match ty {
        // the shortest digits that give the same single-precision number
        ComponentType::F32 => push_number(line, real(bytes, ty, false) as f32),
        _ => push_number(line, real(bytes, ty, false)),
    }
    line.push(b' ');
}
