//! Writing.

use std::collections::HashMap;
use std::hash::Hash;
use std::io::Write;

use maille::{Mesh, Semantic};

use super::{GROUP, ObjSource, Part, SMOOTHING};
use crate::asset::Source;
use crate::color::recoded;
use crate::flatten::flattened;
use crate::output::{Output, Stream};
use crate::text::push_number;
use crate::{Asset, WriteError, WriteOptions};

/// Writes an OBJ file, and the MTL beside it where there is one.
pub(crate) fn write(asset: &Asset, output: &mut Output<'_>, _options: &WriteOptions) -> Result<(), WriteError> {
    let mesh = flattened(asset);
    let blank = ObjSource::default();
    let source = match &asset.source {
        Source::Obj(source) => source,
        _ => &blank,
    };
    let mut stream = output.main()?;
    if !source.mtl.is_empty() {
        let name = output.target().with_extension("mtl");
        let name = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
        writeln!(stream, "mtllib {name}")?;
        let mut mtl = output.beside(&name)?;
        mtl.write_all(&source.mtl)?;
        output.finish(mtl)?;
    }
    write_vertices(&mut stream, &mesh)?;
    let uvs = write_distinct::<2>(&mut stream, "vt", &mesh, &Semantic::TexCoord(0), false)?;
    let normals = write_distinct::<3>(&mut stream, "vn", &mesh, &Semantic::Normal, true)?;
    write_faces(&mut stream, &mesh, source, &uvs, &normals)?;
    output.finish(stream)
}

/// Positions, with the colour of the first wedge of each vertex.
fn write_vertices(stream: &mut Stream<'_>, mesh: &Mesh) -> Result<(), WriteError> {
    let colors = vertex_colors(mesh);
    let mut line = Vec::new();
    for (vertex, position) in mesh.positions.iter().enumerate() {
        push_line(&mut line, "v", position);
        if let Some(color) = colors.get(vertex) {
            line.pop();
            push_line_rest(&mut line, color);
        }
        stream.write_all(&line)?;
    }
    Ok(())
}

fn vertex_colors(mesh: &Mesh) -> Vec<[f32; 3]> {
    let Some(attribute) = mesh.wedge_attribute(&Semantic::Color(0)).filter(|a| a.components >= 3) else {
        return Vec::new();
    };
    let Some(values) = attribute.as_f32() else { return Vec::new() };
    let converted = (!attribute.storage.srgb).then(|| recoded(values, attribute.components, true));
    let values = converted.as_deref().unwrap_or(values);
    let mut colors = vec![[1.0; 3]; mesh.vertex_count()];
    for (wedge, &vertex) in mesh.wedge_vertices.iter().enumerate().rev() {
        colors[vertex as usize].copy_from_slice(&values[wedge * attribute.components..][..3]);
    }
    colors
}

/// Writes the distinct values of an attribute; returns the number of each wedge's value, from 1 (0: it has none).
fn write_distinct<const N: usize>(
    stream: &mut Stream<'_>,
    keyword: &str,
    mesh: &Mesh,
    semantic: &Semantic,
    zero_is_none: bool,
) -> Result<Vec<usize>, WriteError>
where
    [u32; N]: Hash + Eq,
{
    let attribute = mesh.wedge_attribute(semantic).filter(|a| a.components == N);
    let Some(values) = attribute.and_then(|a| a.as_f32()) else { return Ok(Vec::new()) };
    // only looked up, never gone through: its order does not matter
    let mut known: HashMap<[u32; N], usize> = HashMap::new();
    let (mut numbers, mut line) = (Vec::with_capacity(mesh.wedge_count()), Vec::new());
    for value in values.as_chunks::<N>().0 {
        if zero_is_none && value.iter().all(|&x| x == 0.0) {
            numbers.push(0);
            continue;
        }
        let next = known.len() + 1;
        let number = *known.entry(value.map(f32::to_bits)).or_insert(next);
        if number == next {
            push_line(&mut line, keyword, value);
            stream.write_all(&line)?;
        }
        numbers.push(number);
    }
    Ok(numbers)
}

/// Faces, with the state they stand in wherever it changes.
fn write_faces(
    stream: &mut Stream<'_>,
    mesh: &Mesh,
    source: &ObjSource,
    uvs: &[usize],
    normals: &[usize],
) -> Result<(), WriteError> {
    let labels = |name: &str| {
        let attribute = mesh.triangle_attributes.iter().find(|a| a.semantic == Semantic::Custom(name.to_owned()));
        attribute.and_then(|a| a.as_u32()).filter(|values| values.len() == mesh.triangle_count())
    };
    let (groups, smoothing) = (labels(GROUP), labels(SMOOTHING));
    let has_materials = !mesh.triangle_materials.is_empty() || !mesh.material_names.is_empty();
    let (mut part, mut material, mut smooth) = (Part::default(), None, 0);
    let mut line = Vec::new();
    for (triangle, wedges) in mesh.triangles.iter().enumerate() {
        if let Some(groups) = groups {
            let new = part_of(source, groups[triangle]);
            write_part(stream, &part, &new)?;
            part = new;
        }
        let slot = mesh.triangle_material(triangle);
        if has_materials && material != Some(slot) {
            write_material(stream, mesh, slot, material.is_none())?;
            material = Some(slot);
        }
        if let Some(group) = smoothing.map(|values| values[triangle]).filter(|&group| group != smooth) {
            writeln!(stream, "s {group}")?;
            smooth = group;
        }
        line.clear();
        line.push(b'f');
        for &wedge in wedges {
            push_corner(&mut line, mesh, wedge as usize, uvs, normals);
        }
        line.push(b'\n');
        stream.write_all(&line)?;
    }
    Ok(())
}

fn push_corner(line: &mut Vec<u8>, mesh: &Mesh, wedge: usize, uvs: &[usize], normals: &[usize]) {
    let number = |numbers: &[usize]| numbers.get(wedge).copied().unwrap_or(0);
    let vertex = mesh.wedge_vertices[wedge] + 1;
    let written = match (number(uvs), number(normals)) {
        (0, 0) => write!(line, " {vertex}"),
        (uv, 0) => write!(line, " {vertex}/{uv}"),
        (0, normal) => write!(line, " {vertex}//{normal}"),
        (uv, normal) => write!(line, " {vertex}/{uv}/{normal}"),
    };
    written.expect("writing into memory does not fail");
}

/// What a label stands for; labels that no file named are numbers.
fn part_of(source: &ObjSource, label: u32) -> Part {
    let numbered = || Part { object: String::new(), group: format!("group_{label}") };
    source.parts.get(label as usize).cloned().unwrap_or_else(numbered)
}

fn write_part(stream: &mut Stream<'_>, old: &Part, new: &Part) -> Result<(), WriteError> {
    if new.object != old.object {
        writeln!(stream, "o {}", new.object)?;
    }
    // a new object begins without a group
    let group = if new.object != old.object { "" } else { &old.group };
    if new.group != group {
        writeln!(stream, "g {}", new.group)?;
    }
    Ok(())
}

fn write_material(stream: &mut Stream<'_>, mesh: &Mesh, slot: u32, is_first: bool) -> Result<(), WriteError> {
    match mesh.material_names.get(slot as usize).map(String::as_str) {
        Some("") if is_first => {}
        None | Some("") => writeln!(stream, "usemtl material_{slot}")?,
        Some(name) => writeln!(stream, "usemtl {name}")?,
    }
    Ok(())
}

fn push_line(line: &mut Vec<u8>, keyword: &str, values: &[f32]) {
    line.clear();
    line.extend_from_slice(keyword.as_bytes());
    push_line_rest(line, values);
}

fn push_line_rest(line: &mut Vec<u8>, values: &[f32]) {
    for &value in values {
        line.push(b' ');
        push_number(line, value);
    }
    line.push(b'\n');
}
