//! Reading.

use std::borrow::Cow;

use maille::mesh::{ComponentType, Storage, Values, WeldOptions};
use maille::{Attribute, Mesh, Semantic};
use rayon::prelude::*;

use super::body::{Column, Rows, fill_f32, fill_u32, integer, real, to_binary, to_little_endian};
use super::header::{Element, Encoding, Header, Kind, Property, size_of};
use super::roles::{Role, face_roles, unit, vertex_roles};
use super::{PlySource, TEXTURE_NOTE};
use crate::asset::Source;
use crate::input::Input;
use crate::settle::{Rounding, settled};
use crate::text::Words;
use crate::triangulate::Polygons;
use crate::wedges::WedgeTable;
use crate::{Asset, Place, ReadError, ReadOptions};

/// Bytes of rows decoded before their pages are given back.
const BLOCK: usize = 16 << 20;

/// Reads a PLY file.
pub(crate) fn read(input: &Input<'_>, options: &ReadOptions) -> Result<Asset, ReadError> {
    let header = Header::parse(input)?;
    let mut reader = Reader::new(input, options, &header);
    let mut words = Words::new(&input[header.body..], header.lines + 1, false);
    let mut at = header.body;
    for element in &header.elements {
        if header.encoding == Encoding::Ascii {
            let bytes = to_binary(&mut words, element)?;
            reader.element(element, Rows { bytes: &bytes, big_endian: false, offset: None })?;
        } else {
            let big_endian = header.encoding == Encoding::BigEndian;
            at += reader.element(element, Rows { bytes: &input[at..], big_endian, offset: Some(at) })?;
        }
    }
    reader.into_asset(header)
}

/// What has been read so far.
struct Reader<'a> {
    input: &'a Input<'a>,
    options: &'a ReadOptions,
    /// As the header claims: faces may stand before vertices.
    vertex_count: u64,
    mesh: Mesh,
    has_vertices: bool,
    faces: Faces,
    source_vertex: Vec<Property>,
    source_face: Vec<Property>,
    others: Vec<(Element, Vec<u8>)>,
    rounding: Rounding,
    warnings: Vec<String>,
}

/// Faces before they are triangles of the mesh.
#[derive(Default)]
struct Faces {
    seen: bool,
    /// Set where all faces are triangles; then `polygons` is empty.
    triangles: Vec<[u32; 3]>,
    polygons: Polygons,
    /// Texture coordinates of the corners of `polygons`, empty where the file has none.
    corner_uvs: Vec<[f32; 2]>,
    attributes: Vec<Attribute>,
    materials: Vec<u32>,
}

impl<'a> Reader<'a> {
    fn new(input: &'a Input<'a>, options: &'a ReadOptions, header: &Header) -> Self {
        let vertex_count = header.elements.iter().find(|e| e.name == "vertex").map_or(0, |e| e.count);
        Self {
            input,
            options,
            vertex_count,
            mesh: Mesh::default(),
            has_vertices: false,
            faces: Faces::default(),
            source_vertex: Vec::new(),
            source_face: Vec::new(),
            others: Vec::new(),
            rounding: Rounding::default(),
            warnings: Vec::new(),
        }
    }

    /// Reads the rows of an element and returns their length in bytes.
    fn element(&mut self, element: &Element, rows: Rows<'_>) -> Result<usize, ReadError> {
        let count = rows.check_count(element)?;
        match element.name.as_str() {
            "vertex" if !self.has_vertices => self.vertices(element, rows, count),
            "face" if !self.faces.seen => self.faces(element, rows, count),
            "tristrips" if !self.faces.seen => self.strips(element, rows, count),
            _ => self.other(element, rows, count),
        }
    }

    fn check_memory(&self, bytes: u64) -> Result<(), ReadError> {
        if bytes <= self.options.max_bytes {
            return Ok(());
        }
        let message = format!("the arrays would take {bytes} bytes, the limit is {}", self.options.max_bytes);
        Err(ReadError::new(message).with_remedy("raise the limit"))
    }

    fn vertices(&mut self, element: &Element, rows: Rows<'_>, count: usize) -> Result<usize, ReadError> {
        self.has_vertices = true;
        self.source_vertex = element.properties.clone();
        let table = Table::new(element, rows, count)?;
        if table.properties.len() < element.properties.len() {
            self.warnings.push("lists in the vertices are not kept".into());
        }
        let roles = vertex_roles(&table.properties);
        if (0..3).any(|k| !roles.contains(&Role::Position(k))) {
            let error = ReadError::new("the vertices have no coordinates x, y and z");
            return Err(error.at(Place::Part("element vertex".into())));
        }
        let columns = columns(&table.properties, &roles);
        self.check_memory(count as u64 * (4 * columns.len() as u64 + 4))?;
        self.mesh.positions = vec![[0.0; 3]; count];
        self.mesh.wedge_vertices = (0..count as u32).collect();
        self.mesh.wedge_attributes = attributes(&columns, count);
        for block in table.blocks() {
            let positions = self.mesh.positions[block.rows.clone()].as_flattened_mut();
            for (role, column) in &columns {
                if let Role::Position(_) = role {
                    fill_f32(positions, 3, block.bytes, table.stride, *column, table.big_endian);
                    self.rounding = self.rounding.join(rounding_of(&block, &table, *column));
                }
            }
            fill_attributes(&mut self.mesh.wedge_attributes, &columns, &block, &table);
            self.release(rows, block.range);
        }
        Ok(table.length)
    }

    fn release(&self, rows: Rows<'_>, range: std::ops::Range<usize>) {
        if let Some(offset) = rows.offset {
            self.input.release(offset + range.start..offset + range.end);
        }
    }

    fn faces(&mut self, element: &Element, rows: Rows<'_>, count: usize) -> Result<usize, ReadError> {
        self.faces.seen = true;
        self.source_face = element.properties.clone();
        let is_list = |p: &&Property| matches!(p.kind, Kind::List { .. });
        let named = |p: &Property| matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
        let lists = element.properties.iter().filter(is_list);
        let Some(list) = lists.clone().find(|p| named(p)).or_else(|| lists.clone().next()) else {
            let error = ReadError::new("the faces have no list 'vertex_indices'");
            return Err(error.at(Place::Part("element face".into())));
        };
        self.check_memory(count as u64 * 12)?;
        if let Some(length) = self.triangle_rows(element, rows, count) {
            return Ok(length);
        }
        self.polygon_rows(element, rows, count, list)
    }

    /// Reads faces if they are all triangles of one layout, a byte and three 32-bit indices with or without scalars
    /// beside them, and all in range; leaves everything else to [`polygon_rows`](Self::polygon_rows).
    fn triangle_rows(&mut self, element: &Element, rows: Rows<'_>, count: usize) -> Option<usize> {
        let lists = || element.properties.iter().filter(|p| matches!(p.kind, Kind::List { .. }));
        let kind = lists().next()?.kind;
        let Kind::List { count: ComponentType::U8 | ComponentType::I8, item: ComponentType::I32 | ComponentType::U32 } =
            kind
        else {
            return None;
        };
        let stride = element.least_stride() + 12;
        if lists().count() != 1 || rows.bytes.len() / stride < count {
            return None;
        }
        let roles = face_roles(&element.properties);
        let columns = columns(&element.properties, &roles);
        let list_at: usize =
            element.properties.iter().take_while(|p| p.kind != kind).map(|p| p.kind.least_size()).sum();
        let table = Table {
            bytes: Cow::Borrowed(&rows.bytes[..count * stride]),
            big_endian: rows.big_endian,
            stride,
            properties: element.properties.clone(),
            length: count * stride,
        };
        let mut triangles = vec![[0; 3]; count];
        self.prepare_face_attributes(&columns, count);
        for block in table.blocks() {
            let out = &mut triangles[block.rows.clone()];
            if !load_triangles(out, &block, &table, list_at, self.vertex_count) {
                return None;
            }
            self.fill_face_attributes(&columns, &block, &table);
            self.release(rows, block.range);
        }
        self.faces.triangles = triangles;
        Some(table.length)
    }

    fn prepare_face_attributes(&mut self, columns: &[(Role, Column)], count: usize) {
        self.faces.attributes = attributes(columns, count);
        let has_materials = columns.iter().any(|(role, _)| *role == Role::Material);
        self.faces.materials = if has_materials { vec![0; count] } else { Vec::new() };
    }

    fn fill_face_attributes(&mut self, columns: &[(Role, Column)], block: &Block<'_>, table: &Table<'_>) {
        fill_attributes(&mut self.faces.attributes, columns, block, table);
        if let Some((_, column)) = columns.iter().find(|(role, _)| *role == Role::Material) {
            let materials = &mut self.faces.materials[block.rows.clone()];
            fill_u32(materials, 1, block.bytes, table.stride, *column, table.big_endian);
        }
    }

    /// Reads faces of any layout.
    fn polygon_rows(
        &mut self,
        element: &Element,
        rows: Rows<'_>,
        count: usize,
        list: &Property,
    ) -> Result<usize, ReadError> {
        let mut cursor = rows.cursor(element);
        let mut scalars = Vec::new();
        for _ in 0..count {
            let first = self.faces.polygons.corners().len();
            let mut uvs: Option<(&[u8], usize, ComponentType)> = None;
            for property in &element.properties {
                match property.kind {
                    Kind::Scalar(ty) => scalars.extend_from_slice(cursor.scalar(ty)?),
                    Kind::List { count, item } => {
                        let (items, length) = cursor.list(count, item)?;
                        if property == list {
                            for bytes in items.chunks_exact(size_of(item)) {
                                let vertex = integer(bytes, item, rows.big_endian);
                                self.faces.polygons.push_corner(self.vertex(vertex).map_err(|e| cursor.error(e))?);
                            }
                        } else if property.name == "texcoord" {
                            uvs = Some((items, length, item));
                        }
                    }
                }
            }
            self.faces.polygons.end_polygon();
            cursor.end_row();
            if let Some((items, length, ty)) = uvs {
                let corners = self.faces.polygons.corners().len() - first;
                // some writers leave the list empty where a face has no texture
                let complete = length == 2 * corners;
                let mut values = items.chunks_exact(size_of(ty)).map(|b| real(b, ty, rows.big_endian) as f32);
                let mut next = || if complete { values.next().unwrap_or(0.0) } else { 0.0 };
                self.faces.corner_uvs.extend((0..corners).map(|_| [next(), next()]));
            }
        }
        self.warn_of_lists(element, list);
        let properties: Vec<_> = element.properties.iter().filter(|p| p.kind.is_scalar()).cloned().collect();
        let columns = columns(&properties, &face_roles(&properties));
        let stride = properties.iter().map(|p| p.kind.least_size()).sum();
        self.prepare_face_attributes(&columns, count);
        let table = Table { bytes: scalars.into(), big_endian: rows.big_endian, stride, properties, length: 0 };
        for block in table.blocks() {
            self.fill_face_attributes(&columns, &block, &table);
        }
        Ok(cursor.position())
    }

    fn warn_of_lists(&mut self, element: &Element, list: &Property) {
        for property in &element.properties {
            if !property.kind.is_scalar() && property != list && property.name != "texcoord" {
                self.warnings.push(format!("the list '{}' of the faces is not kept", property.name));
            }
        }
    }

    fn vertex(&self, index: i64) -> Result<u32, String> {
        let in_range = u64::try_from(index).is_ok_and(|index| index < self.vertex_count);
        if in_range {
            return Ok(index as u32);
        }
        Err(format!("vertex {index} does not exist, there are {}", self.vertex_count))
    }

    /// Reads triangle strips: every index makes a triangle with the two before it, in turn left- and right-handed;
    /// a negative index begins a new strip. Triangles that only turn the strip (two corners equal) are left out.
    fn strips(&mut self, element: &Element, rows: Rows<'_>, count: usize) -> Result<usize, ReadError> {
        self.faces.seen = true;
        let mut cursor = rows.cursor(element);
        for _ in 0..count {
            for property in &element.properties {
                let (items, length, item) = match property.kind {
                    Kind::Scalar(ty) => (cursor.scalar(ty).map(|_| &[][..])?, 0, ty),
                    Kind::List { count, item } => {
                        let (items, length) = cursor.list(count, item)?;
                        (items, length, item)
                    }
                };
                self.check_memory(length as u64 * 12)?;
                let mut strip: (usize, [u32; 2]) = (0, [0; 2]);
                for bytes in items.chunks_exact(size_of(item)) {
                    let index = integer(bytes, item, rows.big_endian);
                    if index < 0 {
                        strip.0 = 0;
                        continue;
                    }
                    let (length, [a, b]) = strip;
                    let c = self.vertex(index).map_err(|e| cursor.error(e))?;
                    if length >= 2 && a != b && b != c && c != a {
                        self.faces.triangles.push(if length % 2 == 0 { [a, b, c] } else { [a, c, b] });
                    }
                    strip = (length + 1, [b, c]);
                }
            }
            cursor.end_row();
        }
        Ok(cursor.position())
    }

    /// Keeps an element that means nothing to us.
    fn other(&mut self, element: &Element, rows: Rows<'_>, count: usize) -> Result<usize, ReadError> {
        let length = match element.stride() {
            Some(stride) => stride * count,
            None => {
                let mut cursor = rows.cursor(element);
                for _ in 0..count {
                    for property in &element.properties {
                        match property.kind {
                            Kind::Scalar(ty) => drop(cursor.scalar(ty)?),
                            Kind::List { count, item } => drop(cursor.list(count, item)?),
                        }
                    }
                    cursor.end_row();
                }
                cursor.position()
            }
        };
        let bytes = &rows.bytes[..length];
        let kept = if rows.big_endian { to_little_endian(bytes, element)? } else { bytes.to_vec() };
        self.others.push((element.clone(), kept));
        Ok(length)
    }

    fn into_asset(mut self, header: Header) -> Result<Asset, ReadError> {
        if !self.has_vertices {
            return Err(ReadError::new("the file has no element 'vertex'").at(Place::Part("header".into())));
        }
        let materials = self.finish_faces(&header.notes);
        self.warnings.extend(self.rounding.warning(&self.mesh));
        let vertex_count = self.mesh.vertex_count();
        let mut asset = settled("", self.mesh, self.warnings)?;
        asset.source = Source::Ply(Box::new(PlySource {
            notes: header.notes,
            vertex: self.source_vertex,
            face: self.source_face,
            vertex_count,
            others: self.others,
            materials,
            sized_names: header.sized_names,
        }));
        Ok(asset)
    }

    /// Makes triangles of the faces; returns the number that the file gives each material slot.
    fn finish_faces(&mut self, notes: &[String]) -> Vec<u32> {
        let mut faces = std::mem::take(&mut self.faces);
        let mut numbers = faces.materials.clone();
        numbers.sort_unstable();
        numbers.dedup();
        for number in &mut faces.materials {
            *number = numbers.partition_point(|n| n < number) as u32;
        }
        self.mesh.material_names = texture_names(notes, &numbers);
        if faces.polygons.len() > 0 {
            self.split_wedges(&mut faces);
            let (positions, wedges) = (&self.mesh.positions, &self.mesh.wedge_vertices);
            let split = faces.polygons.triangulate(|w| positions[wedges[w as usize] as usize]);
            if let Some(sources) = split.sources {
                faces.attributes.iter_mut().for_each(|a| a.gather(&sources));
                if !faces.materials.is_empty() {
                    faces.materials = sources.iter().map(|&face| faces.materials[face as usize]).collect();
                }
            }
            if split.left_out > 0 {
                self.warnings.push(format!("{} faces of fewer than three corners were left out", split.left_out));
            }
            faces.triangles = split.triangles;
        }
        self.mesh.triangles = faces.triangles;
        self.mesh.triangle_attributes = faces.attributes;
        self.mesh.triangle_materials = faces.materials;
        // a row for each side of a seam is the only way in which vertices of a PLY can have several normals or texture
        // coordinates; rows without either are left as they are, be they joined or not
        let has_seams = |a: &Attribute| matches!(a.semantic, Semantic::Normal | Semantic::TexCoord(_));
        if faces.corner_uvs.is_empty() && self.mesh.wedge_attributes.iter().any(has_seams) {
            self.mesh.weld(&WeldOptions::EXACT);
        }
        numbers
    }

    /// Makes wedges of vertices whose corners differ in texture coordinates.
    fn split_wedges(&mut self, faces: &mut Faces) {
        if faces.corner_uvs.is_empty() {
            return;
        }
        let mut table = WedgeTable::new(self.mesh.vertex_count());
        for (corner, uv) in faces.polygons.corners_mut().iter_mut().zip(&faces.corner_uvs) {
            *corner = table.wedge(*corner, uv.map(f32::to_bits));
        }
        let uvs = table.keys().flatten().map(f32::from_bits).collect();
        self.mesh.wedge_vertices = table.into_vertices();
        let wedge_vertices = &self.mesh.wedge_vertices;
        self.mesh.wedge_attributes.iter_mut().for_each(|a| a.gather(wedge_vertices));
        self.mesh.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, uvs));
    }
}

/// The names of the textures that material numbers stand for (MeshLab: `comment TextureFile NAME`, counted from 0).
fn texture_names(notes: &[String], numbers: &[u32]) -> Vec<String> {
    let textures: Vec<&str> = notes.iter().filter_map(|note| note.strip_prefix(TEXTURE_NOTE)).collect();
    let name = |&number: &u32| textures.get(number as usize).map_or(String::new(), |name| name.trim().to_owned());
    let names: Vec<String> = numbers.iter().map(name).collect();
    if names.iter().all(String::is_empty) { Vec::new() } else { names }
}

/// Rows that are all equally long.
struct Table<'a> {
    bytes: Cow<'a, [u8]>,
    big_endian: bool,
    stride: usize,
    properties: Vec<Property>,
    /// Bytes that the rows take in the file.
    length: usize,
}

/// Some rows of a table.
struct Block<'a> {
    rows: std::ops::Range<usize>,
    bytes: &'a [u8],
    range: std::ops::Range<usize>,
}

impl<'a> Table<'a> {
    /// The scalars of an element: its rows where they stand, or copies without the lists.
    fn new(element: &Element, rows: Rows<'a>, count: usize) -> Result<Self, ReadError> {
        let big_endian = rows.big_endian;
        if let Some(stride) = element.stride() {
            let (length, properties) = (count * stride, element.properties.clone());
            return Ok(Self { bytes: Cow::Borrowed(&rows.bytes[..length]), big_endian, stride, properties, length });
        }
        let (mut cursor, mut scalars) = (rows.cursor(element), Vec::new());
        for _ in 0..count {
            for property in &element.properties {
                match property.kind {
                    Kind::Scalar(ty) => scalars.extend_from_slice(cursor.scalar(ty)?),
                    Kind::List { count, item } => drop(cursor.list(count, item)?),
                }
            }
            cursor.end_row();
        }
        let properties: Vec<_> = element.properties.iter().filter(|p| p.kind.is_scalar()).cloned().collect();
        let stride = properties.iter().map(|p| p.kind.least_size()).sum();
        Ok(Self { bytes: scalars.into(), big_endian, stride, properties, length: cursor.position() })
    }

    /// The rows in blocks of moderate size.
    fn blocks(&self) -> impl Iterator<Item = Block<'_>> {
        let (stride, count) = (self.stride.max(1), self.bytes.len() / self.stride.max(1));
        let step = (BLOCK / stride).max(1);
        (0..count).step_by(step).map(move |start| {
            let rows = start..(start + step).min(count);
            let range = rows.start * stride..rows.end * stride;
            Block { rows, bytes: &self.bytes[range.clone()], range }
        })
    }
}

/// The scalar properties with where they stand in a row, lists taken as those of triangles (see
/// [`Reader::triangle_rows`]).
fn columns(properties: &[Property], roles: &[Role]) -> Vec<(Role, Column)> {
    let mut offset = 0;
    let mut columns = Vec::new();
    for (property, role) in properties.iter().zip(roles) {
        let Kind::Scalar(ty) = property.kind else {
            offset += 1 + 12;
            continue;
        };
        let (slot, unit) = match role {
            Role::Position(slot) => (*slot, 1.0),
            Role::Part { semantic, slot } => (*slot, unit(semantic, ty)),
            Role::Material | Role::List => (0, 1.0),
        };
        columns.push((role.clone(), Column { offset, ty, unit, slot }));
        offset += size_of(ty);
    }
    columns
}

/// The attributes that columns make together, zeroed.
fn attributes(columns: &[(Role, Column)], count: usize) -> Vec<Attribute> {
    let mut attributes: Vec<Attribute> = Vec::new();
    for (role, column) in columns {
        let Role::Part { semantic, slot } = role else { continue };
        match attributes.iter_mut().find(|a| a.semantic == *semantic) {
            Some(attribute) => attribute.components = attribute.components.max(slot + 1),
            None => attributes.push(Attribute {
                semantic: semantic.clone(),
                components: slot + 1,
                values: empty_values(semantic, column.ty),
                storage: storage(semantic, column.ty),
            }),
        }
    }
    for attribute in &mut attributes {
        let length = count * attribute.components;
        match &mut attribute.values {
            Values::F32(values) => *values = vec![0.0; length],
            Values::U32(values) => *values = vec![0; length],
        }
    }
    attributes
}

/// 32-bit integers are labels, all else are quantities.
fn empty_values(semantic: &Semantic, ty: ComponentType) -> Values {
    match (semantic, ty) {
        (Semantic::Custom(_), ComponentType::I32 | ComponentType::U32) => Values::U32(Vec::new()),
        _ => Values::F32(Vec::new()),
    }
}

fn storage(semantic: &Semantic, ty: ComponentType) -> Storage {
    let Semantic::Color(_) = semantic else {
        return Storage { component: ty, normalized: false, srgb: false };
    };
    let component = match ty {
        ComponentType::F32 | ComponentType::F64 => ComponentType::F32,
        ComponentType::U16 | ComponentType::I16 => ComponentType::U16,
        _ => ComponentType::U8,
    };
    Storage { component, normalized: component != ComponentType::F32, srgb: true }
}

fn fill_attributes(attributes: &mut [Attribute], columns: &[(Role, Column)], block: &Block<'_>, table: &Table<'_>) {
    for (role, column) in columns {
        let Role::Part { semantic, .. } = role else { continue };
        let attribute = attributes.iter_mut().find(|a| a.semantic == *semantic).expect("made from the same columns");
        let components = attribute.components;
        let range = block.rows.start * components..block.rows.end * components;
        match &mut attribute.values {
            Values::F32(v) => fill_f32(&mut v[range], components, block.bytes, table.stride, *column, table.big_endian),
            Values::U32(v) => fill_u32(&mut v[range], components, block.bytes, table.stride, *column, table.big_endian),
        }
    }
}

/// What double-precision coordinates lose.
fn rounding_of(block: &Block<'_>, table: &Table<'_>, column: Column) -> Rounding {
    if column.ty != ComponentType::F64 {
        return Rounding::default();
    }
    let mut rounding = Rounding::default();
    for row in block.bytes.chunks_exact(table.stride) {
        rounding.round(real(&row[column.offset..], column.ty, table.big_endian));
    }
    rounding
}

/// Loads rows of triangles; `false` if a row is no triangle or names a vertex that does not exist.
fn load_triangles(
    out: &mut [[u32; 3]],
    block: &Block<'_>,
    table: &Table<'_>,
    list_at: usize,
    vertex_count: u64,
) -> bool {
    const ROWS: usize = 1 << 14;
    let limit = vertex_count.min(u64::from(u32::MAX)) as u32;
    let load = |bytes: &[u8]| {
        let bytes = *bytes.first_chunk().expect("a row of a triangle holds three indices");
        if table.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    };
    let chunks = out.par_chunks_mut(ROWS).zip(block.bytes.par_chunks(ROWS * table.stride));
    chunks.all(|(out, rows)| {
        let mut good = true;
        for (triangle, row) in out.iter_mut().zip(rows.chunks_exact(table.stride)) {
            let list = &row[list_at..list_at + 13];
            *triangle = [load(&list[1..]), load(&list[5..]), load(&list[9..])];
            good &= list[0] == 3 && triangle.iter().all(|&index| index < limit);
        }
        good
    })
}
