//! Files in and out of Maille: glTF 2.0 and GLB, PLY, OBJ, STL, OFF, and progressive meshes.
//!
//! [`read`] finds the format by content and gives an [`Asset`]: its meshes, each once, where they are drawn, and
//! (kept inside) everything that is not mesh. [`write`](fn@write) picks the format by the extension, writes to a temporary file
//! beside the target and renames it, so that no reader ever sees half a file.

mod asset;
mod color;
mod display;
mod edited;
mod error;
mod flatten;
mod format;
mod gltf;
mod input;
mod left_out;
mod lod;
mod look;
mod mpm;
mod obj;
mod off;
mod output;
mod ply;
mod poses;
mod process;
mod progressive;
mod roles;
mod sample;
mod settle;
mod stl;
mod text;
mod triangulate;
mod wedges;

pub use asset::{Asset, Instance, NamedMesh};
pub use display::order_for_display;
pub use error::{Place, ReadError, WriteError};
pub use format::Format;
pub use gltf::Animation;
pub use lod::{GeomorphForm, LevelTarget, LodChain, LodLevel, LodOptions, Pixels, lod_chain};
pub use look::{Look, Texture};
pub use output::Written;
pub use poses::{PoseSet, poses_of};
pub use process::{AssetOptions, AssetReport, Budget, ProcessError, simplify_asset, world_scales};
pub use progressive::{CollapseOptions, ProgressiveAsset};
pub use roles::{AttributeRoles, Mask, MaskImage, find_attribute};
pub use sample::sample;

use std::path::Path;

use maille::Control;

use input::Input;
use output::Output;

/// What a reader may spend before it refuses.
#[derive(Debug, Clone)]
pub struct ReadOptions {
    /// Most bytes that the arrays of the result may take together. Sizes claimed by a header are compared with what
    /// the file can hold before anything is allocated; this limit is for what inflates (sparse accessors, compression).
    pub max_bytes: u64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { max_bytes: 64 << 30 }
    }
}

/// How to write.
#[derive(Debug, Clone, Default)]
pub struct WriteOptions {
    /// PLY, STL: text instead of binary.
    pub text: bool,
    /// OFF: binary instead of text. Few programs read it.
    pub binary_off: bool,
    /// glTF: the triangles of meshes that have changed as strips, where that takes fewer indices.
    pub strips: bool,
}

/// Reads a file of any known format, found by its content; the extension only decides where content leaves a doubt.
///
/// Large files are mapped into memory and parsed in place.
///
/// # Errors
/// [`ReadError`], with the path, the place in the file and what could be done.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Asset, ReadError> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let read = || decode(&Input::open(path)?, Format::from_path(path), Some(folder), options);
    read().map_err(|error| error.at_path(path))
}

/// The format of a file, as [`read`] finds it.
///
/// # Errors
/// [`ReadError`] if the file cannot be opened or is of no format that Maille knows.
pub fn detect(path: &Path) -> Result<Format, ReadError> {
    let find = || format_of(&Input::open(path)?, Format::from_path(path));
    find().map_err(|error: ReadError| error.at_path(path))
}

/// Reads a file that is in memory already. What it refers to by name (buffers of a glTF, the MTL of an OBJ) is not
/// looked for.
///
/// # Errors
/// [`ReadError`], with the place and what could be done.
pub fn read_bytes(bytes: &[u8], hint: Option<Format>, options: &ReadOptions) -> Result<Asset, ReadError> {
    decode(&Input::Given(bytes), hint, None, options)
}

fn format_of(input: &Input<'_>, hint: Option<Format>) -> Result<Format, ReadError> {
    if input.is_empty() {
        return Err(ReadError::new("the file is empty").with_remedy("fetch it again, or export it anew"));
    }
    Format::detect(input, hint).ok_or_else(|| {
        ReadError::new("the content is of no format that Maille knows")
            .with_remedy("convert it to glTF, GLB, PLY, OBJ, STL or OFF")
    })
}

fn decode(
    input: &Input<'_>,
    hint: Option<Format>,
    folder: Option<&Path>,
    options: &ReadOptions,
) -> Result<Asset, ReadError> {
    let asset = decode_format(input, hint, folder, options);
    asset.map_err(ReadError::or_damaged)
}

fn decode_format(
    input: &Input<'_>,
    hint: Option<Format>,
    folder: Option<&Path>,
    options: &ReadOptions,
) -> Result<Asset, ReadError> {
    let asset = match format_of(input, hint)? {
        Format::Gltf | Format::Glb => gltf::read(input, folder, options)?,
        Format::Ply => ply::read(input, options)?,
        Format::Obj => obj::read(input, folder, options)?,
        Format::Stl => stl::read(input, options)?,
        Format::Off => off::read(input, options)?,
        Format::Mpm => mpm::read(input, folder, options)?.finest(),
    };
    if asset.triangle_count() == 0 {
        let remedy = "Maille works on surfaces; point clouds need a surface reconstruction first";
        return Err(ReadError::new("the file holds no triangles").with_remedy(remedy));
    }
    Ok(asset)
}

/// Writes a file in the format that the extension of `path` names.
///
/// The files (some formats make several) are written under temporary names in the same folder and renamed at the end:
/// nobody ever sees half a file, and an error or a panic leaves nothing behind. What is returned names them all, and says
/// what the format could not hold.
///
/// # Errors
/// [`WriteError`], with the path and what could be done.
pub fn write(asset: &Asset, path: &Path, options: &WriteOptions) -> Result<Written, WriteError> {
    write_with(asset, path, options, Control::default())
}

/// [`write`](fn@write) that can be cancelled: once `control` says so it fails, and leaves nothing behind.
///
/// # Errors
/// [`WriteError`], with the path and what could be done.
pub fn write_with(
    asset: &Asset,
    path: &Path,
    options: &WriteOptions,
    control: Control<'_>,
) -> Result<Written, WriteError> {
    let write = || {
        let Some(format) = Format::from_path(path) else {
            let message = "the extension names no format that Maille writes";
            return Err(WriteError::new(message).with_remedy("use .glb, .gltf, .ply, .obj, .stl or .off"));
        };
        let mut output = Output::new(path, control)?;
        left_out::left_out(asset, format, options).into_iter().for_each(|warning| output.warn(warning));
        match format {
            Format::Gltf | Format::Glb => gltf::write(asset, format == Format::Glb, &mut output, options)?,
            Format::Ply => ply::write(asset, &mut output, options)?,
            Format::Obj => obj::write(asset, &mut output, options)?,
            Format::Stl => stl::write(asset, &mut output, options)?,
            Format::Off => off::write(asset, &mut output, options)?,
            Format::Mpm => {
                let error = WriteError::new("an asset at one level is not a progressive mesh");
                return Err(error.with_remedy("make one with `maille progressive`, or ProgressiveAsset"));
            }
        }
        output.commit()
    };
    write().map_err(|error| error.at_path(path))
}
