//! STL, text and binary.
//!
//! Corners at exactly equal positions are welded: an STL has no other way to say that triangles meet. Facet normals
//! follow from the corners and are not kept. Colours in the attribute bytes (VisCAM and Materialise conventions) become
//! a triangle attribute.

use std::io::Write;

use maille::mesh::{ComponentType, Storage, Values, WeldOptions};
use maille::{Attribute, Mesh, Semantic};
use rayon::prelude::*;

use crate::asset::Asset;
use crate::flatten::flattened;
use crate::input::Input;
use crate::output::{Output, Stream};
use crate::settle::{Rounding, settled};
use crate::text::{Words, push_number, show};
use crate::triangulate::Polygons;
use crate::{Place, ReadError, ReadOptions, WriteError, WriteOptions};

/// Bytes of a triangle in a binary file: normal, corners, attribute.
const RECORD: usize = 50;
/// Bytes before the first triangle.
const HEADER: usize = 84;

/// Whether the length is exactly that of a binary STL with the number of triangles that the header claims.
pub(crate) fn has_binary_length(bytes: &[u8]) -> bool {
    claimed_length(bytes) == Some(bytes.len() as u64)
}

fn claimed_length(bytes: &[u8]) -> Option<u64> {
    let count = u32::from_le_bytes(*bytes.get(80..HEADER)?.first_chunk()?);
    Some(HEADER as u64 + RECORD as u64 * u64::from(count))
}

/// Reads an STL file.
pub(crate) fn read(input: &Input<'_>, options: &ReadOptions) -> Result<Asset, ReadError> {
    // a corner takes 12 bytes, its wedge and its place in a triangle 4 each; a corner in text has 14 bytes at least
    let needed = 20 * 3 * (input.len() / RECORD) as u64;
    if needed > options.max_bytes {
        let message = format!("the arrays would take up to {needed} bytes, the limit is {}", options.max_bytes);
        return Err(ReadError::new(message).with_remedy("raise the limit"));
    }
    let (name, mut mesh, warnings) =
        if !has_binary_length(input) && is_text(input) { read_text(input)? } else { read_binary(input)? };
    mesh.weld(&WeldOptions::EXACT_WITH_WEDGES);
    settled(&name, mesh, warnings)
}

fn is_text(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    let is_solid = start.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    is_solid && !start[..start.len().min(1024)].contains(&0)
}

/// A triangle soup.
fn soup(positions: Vec<[f32; 3]>) -> Mesh {
    let count = positions.len() as u32;
    let triangles = (0..count / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Mesh { positions, wedge_vertices: (0..count).collect(), triangles, ..Mesh::default() }
}

fn read_binary(input: &Input<'_>) -> Result<(String, Mesh, Vec<String>), ReadError> {
    let Some(length) = claimed_length(input) else {
        let message = format!("a binary STL has at least {HEADER} bytes, found {}", input.len());
        return Err(ReadError::new(message).at(Place::Byte(input.len() as u64)));
    };
    let count = (length - HEADER as u64) / RECORD as u64;
    if length > input.len() as u64 {
        let message =
            format!("the header claims {count} triangles, {length} bytes, but the file has {} bytes", input.len());
        let remedy = "the file has been cut short: fetch it again";
        return Err(ReadError::new(message).at(Place::Byte(80)).with_remedy(remedy));
    }
    if count > u64::from(u32::MAX / 3 - 1) {
        return Err(ReadError::new(format!("{count} triangles are more than 32-bit indices can name")));
    }
    let mut warnings = Vec::new();
    if length < input.len() as u64 {
        warnings.push(format!("{} bytes behind the last triangle were left out", input.len() as u64 - length));
    }
    let records = &input[HEADER..length as usize];
    let mut positions = vec![[0.0; 3]; 3 * count as usize];
    for (block, out) in records.chunks(RECORD << 18).zip(positions.chunks_mut(3 << 18)) {
        out.par_chunks_exact_mut(3).zip(block.par_chunks_exact(RECORD)).with_min_len(1024).for_each(|(out, record)| {
            for (value, bytes) in out.as_flattened_mut().iter_mut().zip(record[12..48].as_chunks::<4>().0) {
                *value = f32::from_le_bytes(*bytes);
            }
        });
        let start = block.as_ptr() as usize - input.as_ptr() as usize;
        input.release(start..start + block.len());
    }
    let mut mesh = soup(positions);
    mesh.triangle_attributes.extend(colors(&input[..80], records));
    Ok((String::new(), mesh, warnings))
}

/// Five bits each of red, green and blue in the attribute bytes. VisCAM sets the highest bit where there is a colour;
/// Materialise announces itself in the header, clears the bit there, and has red and blue the other way round.
fn colors(header: &[u8], records: &[u8]) -> Option<Attribute> {
    let is_materialise = header.windows(6).any(|w| w == b"COLOR=");
    let attributes = || records.chunks_exact(RECORD).map(|r| u16::from_le_bytes([r[48], r[49]]));
    // other programs put anything there: only if all that is not 0 is marked, it means colours
    let marked = || attributes().all(|a| a == 0 || a & 0x8000 != 0) && attributes().any(|a| a != 0);
    if !(is_materialise || marked()) {
        return None;
    }
    let own = |a: u16| (a & 0x8000 != 0) != is_materialise;
    let channel = |a: u16, shift: u16| f32::from(a >> shift & 31) / 31.0;
    let color = |a: u16| match (own(a), is_materialise) {
        (false, _) => [1.0; 3],
        (true, true) => [0, 5, 10].map(|shift| channel(a, shift)),
        (true, false) => [10, 5, 0].map(|shift| channel(a, shift)),
    };
    Some(Attribute {
        semantic: Semantic::Color(0),
        components: 3,
        values: Values::F32(attributes().flat_map(color).collect()),
        storage: Storage { component: ComponentType::U8, normalized: true, srgb: true },
    })
}

fn read_text(input: &Input<'_>) -> Result<(String, Mesh, Vec<String>), ReadError> {
    let mut words = Words::new(input, 1, false);
    let (mut name, mut positions, mut polygons) = (None, Vec::new(), Polygons::default());
    let (mut rounding, mut warnings) = (Rounding::default(), Vec::new());
    let mut ended = false;
    while let Some(word) = words.next() {
        match word.to_ascii_lowercase().as_slice() {
            b"solid" => {
                let text = String::from_utf8_lossy(words.rest_of_line()).into_owned();
                name.get_or_insert(text);
                ended = false;
            }
            b"endsolid" => {
                words.skip_line();
                ended = true;
            }
            b"facet" => read_facet(&mut words, &mut positions, &mut polygons, &mut rounding)?,
            _ => return Err(words.error(format!("expected 'facet' or 'endsolid', found '{}'", show(word)))),
        }
    }
    if !ended {
        warnings.push("the last solid has no end: the file may have been cut short".into());
    }
    let mut mesh = soup(positions);
    let split = polygons.triangulate(|corner| mesh.positions[corner as usize]);
    mesh.triangles = split.triangles;
    if split.left_out > 0 {
        warnings.push(format!("{} facets of fewer than three corners were left out", split.left_out));
    }
    warnings.extend(rounding.warning(&mesh));
    Ok((name.unwrap_or_default(), mesh, warnings))
}

/// Reads from behind `facet` to `endfacet`.
fn read_facet(
    words: &mut Words<'_>,
    positions: &mut Vec<[f32; 3]>,
    polygons: &mut Polygons,
    rounding: &mut Rounding,
) -> Result<(), ReadError> {
    loop {
        let Some(word) = words.next() else {
            let error = words.error("the file ends within a facet");
            return Err(error.with_remedy("the file has been cut short: fetch it again"));
        };
        match word.to_ascii_lowercase().as_slice() {
            b"normal" => {
                // implied by the corners; some writers leave it empty or write what is no number
                for _ in 0..3 {
                    words.next_in_line();
                }
            }
            b"outer" | b"loop" => {}
            b"vertex" => {
                let mut position = [0.0; 3];
                for value in &mut position {
                    *value = rounding.round(words.number("a coordinate")?);
                }
                polygons.push_corner(positions.len() as u32);
                positions.push(position);
            }
            b"endloop" => polygons.end_open_polygon(),
            b"endfacet" => {
                polygons.end_open_polygon();
                return Ok(());
            }
            _ => return Err(words.error(format!("expected 'vertex' or 'endfacet', found '{}'", show(word)))),
        }
    }
}

/// Writes an STL file: binary, or text if wanted. Everything but positions and the colours of triangles is lost.
pub(crate) fn write(asset: &Asset, output: &mut Output<'_>, options: &WriteOptions) -> Result<(), WriteError> {
    let mesh = flattened(asset);
    let mut stream = output.main()?;
    if options.text {
        write_text(&mut stream, &mesh)?;
    } else {
        write_binary(&mut stream, &mesh)?;
    }
    output.finish(stream)
}

/// The unit normal of a triangle, 0 if it has no area.
fn normal(mesh: &Mesh, triangle: usize) -> [f32; 3] {
    let [a, b, c] = mesh.triangle_points(triangle);
    (b - a).cross(c - a).normalize_or_zero().as_vec3().to_array()
}

fn corners(mesh: &Mesh, triangle: usize) -> [[f32; 3]; 3] {
    mesh.triangle_vertices(triangle).map(|v| mesh.positions[v as usize])
}

fn write_binary(stream: &mut Stream<'_>, mesh: &Mesh) -> Result<(), WriteError> {
    let Ok(count) = u32::try_from(mesh.triangle_count()) else {
        let error = WriteError::new("an STL holds no more than 2^32 - 1 triangles");
        return Err(error.with_remedy("write .ply, or simplify it first"));
    };
    let colors = mesh.triangle_attributes.iter().find(|a| a.semantic == Semantic::Color(0) && a.components >= 3);
    let colors = colors.and_then(|a| Some((a.as_f32()?, a.components)));
    let mut header = [b' '; 80];
    let text = b"binary STL, written by Maille";
    header[..text.len()].copy_from_slice(text);
    stream.write_all(&header)?;
    stream.write_all(&count.to_le_bytes())?;
    for triangle in 0..mesh.triangle_count() {
        let mut record = [0; RECORD];
        let values = std::iter::once(normal(mesh, triangle)).chain(corners(mesh, triangle)).flatten();
        for (bytes, value) in record.as_chunks_mut::<4>().0.iter_mut().zip(values) {
            *bytes = value.to_le_bytes();
        }
        if let Some((values, components)) = colors {
            let bits = values[triangle * components..][..3]
                .iter()
                .fold(1, |bits: u16, &value| bits << 5 | (value.clamp(0.0, 1.0) * 31.0).round() as u16);
            record[48..].copy_from_slice(&bits.to_le_bytes());
        }
        stream.write_all(&record)?;
    }
    Ok(())
}

fn write_text(stream: &mut Stream<'_>, mesh: &Mesh) -> Result<(), WriteError> {
    writeln!(stream, "solid maille")?;
    let mut text = Vec::new();
    let push = |text: &mut Vec<u8>, start: &str, values: [f32; 3]| {
        text.extend_from_slice(start.as_bytes());
        for value in values {
            text.push(b' ');
            push_number(text, value);
        }
        text.push(b'\n');
    };
    for triangle in 0..mesh.triangle_count() {
        text.clear();
        push(&mut text, "facet normal", normal(mesh, triangle));
        text.extend_from_slice(b"outer loop\n");
        for corner in corners(mesh, triangle) {
            push(&mut text, "vertex", corner);
        }
        text.extend_from_slice(b"endloop\nendfacet\n");
        stream.write_all(&text)?;
    }
    writeln!(stream, "endsolid maille")?;
    Ok(())
}
