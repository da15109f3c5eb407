//! Progressive meshes in a file of their own: `.mpm`.
//!
//! ```text
//!  0  magic          89 4D 50 4D 0D 0A 1A 0A
//!  8  u32 version    1
//! 12  u32 CRC-32     of all that follows
//! 16  u64 length     of the file
//! 24  u32 meshes     how many
//! 28  u32 scene      0: it came as a glTF; 1: it was made for the meshes
//! 32  u64 length     of the GLB
//! 40  GLB            the asset, its meshes at the coarsest level
//!     then for each of its meshes:
//!     f64, f64       factors on errors and costs, to world units
//!     u64 length
//!     ...            ProgressiveMesh::to_bytes
//! ```
//!
//! All numbers are little-endian. What stands before a mesh is enough to show the asset at its coarsest.

use std::io::Write;
use std::path::Path;

use maille::progressive::{DecodeError, ProgressiveMesh};
use rayon::prelude::*;

use crate::asset::Source;
use crate::output::Output;
use crate::progressive::{Part, ProgressiveAsset};
use crate::{Asset, Format, NamedMesh, Place, ReadError, ReadOptions, WriteError, WriteOptions, gltf, left_out};

/// As that of PNG, it tells of transfers that strip a bit or change the ends of lines.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MPM\r\n\x1a\n";
const VERSION: u32 = 1;
/// What the checksum is of begins here.
const CHECKED_FROM: usize = 16;

/// Reads a file. Relative URIs of its glTF start from `folder`.
pub(crate) fn read(bytes: &[u8], folder: Option<&Path>, options: &ReadOptions) -> Result<ProgressiveAsset, ReadError> {
    let mut rest = Rest { bytes, at: 0 };
    if rest.take::<8>()? != *MAGIC {
        return Err(ReadError::new("this is no progressive mesh of Maille").at(Place::Byte(0)));
    }
    let version = rest.u32()?;
    if version != VERSION {
        let message = format!("version {version} of the format, expected {VERSION}");
        return Err(ReadError::new(message).at(Place::Byte(8)).with_remedy("read it with a newer Maille"));
    }
    let (checksum, length) = (rest.u32()?, rest.u64()?);
    if length != bytes.len() as u64 {
        let message = format!("the file has {} bytes, and should have {length}", bytes.len());
        return Err(ReadError::new(message).at(Place::Byte(16)));
    }
    if crc32fast::hash(&bytes[CHECKED_FROM..]) != checksum {
        return Err(ReadError::new("the checksum is not that of the content").at(Place::Byte(12)));
    }
    let (count, is_made) = (rest.u32()? as usize, rest.u32()?);
    if is_made > 1 {
        return Err(ReadError::new(format!("scene {is_made}, expected 0 or 1")).at(Place::Byte(28)));
    }
    let glb = rest.section()?;
    let scene = gltf::read(glb, folder, options)?;
    if scene.meshes.len() != count {
        let message = format!("{count} progressive meshes for {} meshes of the glTF", scene.meshes.len());
        return Err(ReadError::new(message).at(Place::Byte(24)));
    }
    let sections = (0..count).map(|_| Ok((rest.scale()?, rest.scale()?, rest.at, rest.section()?)));
    let sections: Vec<_> = sections.collect::<Result<_, ReadError>>()?;
    if rest.at != bytes.len() {
        return Err(ReadError::new(format!("{} bytes after the end", bytes.len() - rest.at)).at(rest.place()));
    }
    let draws = scene.draws();
    let part = |(index, (error_scale, cost_scale, at, bytes)): (usize, (f64, f64, usize, &[u8]))| {
        let mesh = ProgressiveMesh::from_bytes(bytes).map_err(|error| fault(index, at + 8, &error))?;
        check_slots(&mesh, &scene, index)?;
        Ok(Part { mesh, error_scale, cost_scale, draws: draws[index] })
    };
    let parts: Vec<Part> = sections.into_par_iter().enumerate().map(part).collect::<Result<_, ReadError>>()?;
    let source = if is_made == 1 { Source::None } else { scene.source.clone() };
    Ok(ProgressiveAsset::of_parts(Asset { source, ..scene }, parts))
}

/// The error of a mesh whose bytes begin at an offset.
fn fault(mesh: usize, start: usize, error: &DecodeError) -> ReadError {
    match error {
        DecodeError::Bytes { at, what } => ReadError::new(what.clone()).at(Place::Byte((start + at) as u64)),
        other => ReadError::new(other.to_string()).at(Place::Part(format!("progressive mesh {mesh}"))),
    }
}

/// Slots of materials are of the glTF: work is done for each up to the highest, so that it must not be out of all measure.
fn check_slots(mesh: &ProgressiveMesh, scene: &Asset, index: usize) -> Result<(), ReadError> {
    let Source::Gltf(document) = &scene.source else { unreachable!("it has been read as one") };
    let (slots, limit) = (mesh.material_slots(), document.slot_limit(index));
    if slots <= limit {
        return Ok(());
    }
    let message = format!("a triangle has the material {}, but there are only {limit}", slots - 1);
    Err(ReadError::new(message).at(Place::Part(format!("progressive mesh {index}"))))
}

/// Writes a file.
pub(crate) fn write(progressive: &ProgressiveAsset, output: &mut Output<'_>) -> Result<(), WriteError> {
    let parts = &progressive.parts;
    let coarsest: Vec<usize> = parts.iter().map(Part::most_collapses).collect();
    let is_made = !matches!(progressive.asset.source, Source::Gltf(_));
    let mut levels = progressive.clone();
    let meshes: Vec<NamedMesh> = levels.level(&coarsest).meshes;
    // a scene is made for all materials, also those that the coarsest level has lost
    let asset = if is_made { levels.finest() } else { progressive.asset.clone() };
    let glb = gltf::glb(&asset, &meshes)?;
    left_out::left_out(&asset, Format::Mpm, &WriteOptions::default()).into_iter().for_each(|line| output.warn(line));
    drop(levels);
    let encoded: Vec<Vec<u8>> = parts.par_iter().map(|part| part.mesh.to_bytes()).collect();
    let mut pieces: Vec<Vec<u8>> = Vec::with_capacity(2 + 2 * parts.len());
    let length = 40 + glb.len() + encoded.iter().map(|bytes| 24 + bytes.len()).sum::<usize>();
    let mut header = (length as u64).to_le_bytes().to_vec();
    header.extend((parts.len() as u32).to_le_bytes());
    header.extend(u32::from(is_made).to_le_bytes());
    header.extend((glb.len() as u64).to_le_bytes());
    pieces.extend([header, glb]);
    for (part, bytes) in parts.iter().zip(encoded) {
        let scales = [part.error_scale, part.cost_scale].into_iter().flat_map(f64::to_le_bytes);
        pieces.push(scales.chain((bytes.len() as u64).to_le_bytes()).collect());
        pieces.push(bytes);
    }
    let mut checksum = crc32fast::Hasher::new();
    pieces.iter().for_each(|piece| checksum.update(piece));
    let mut stream = output.main()?;
    stream.write_all(MAGIC)?;
    stream.write_all(&VERSION.to_le_bytes())?;
    stream.write_all(&checksum.finalize().to_le_bytes())?;
    for piece in &pieces {
        stream.write_all(piece)?;
    }
    output.finish(stream)
}

/// What is left of a file.
struct Rest<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Rest<'a> {
    fn place(&self) -> Place {
        Place::Byte(self.at as u64)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], ReadError> {
        let taken = self.slice(N as u64)?;
        Ok(taken.try_into().expect("as many as were asked for"))
    }

    fn slice(&mut self, length: u64) -> Result<&'a [u8], ReadError> {
        let rest = &self.bytes[self.at..];
        let taken = usize::try_from(length).ok().and_then(|length| rest.get(..length));
        let taken = taken.ok_or_else(|| {
            ReadError::new(format!("{length} bytes are announced, but there are only {}", rest.len())).at(self.place())
        })?;
        self.at += taken.len();
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32, ReadError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, ReadError> {
        self.take().map(u64::from_le_bytes)
    }

    /// A length and as many bytes.
    fn section(&mut self) -> Result<&'a [u8], ReadError> {
        let length = self.u64()?;
        self.slice(length)
    }

    fn scale(&mut self) -> Result<f64, ReadError> {
        let place = self.place();
        let scale = self.take().map(f64::from_le_bytes)?;
        match scale.is_finite() && scale >= 0.0 {
            true => Ok(scale),
            false => Err(ReadError::new(format!("a scale of {scale}")).at(place)),
        }
    }
}
