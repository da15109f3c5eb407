//! glTF 2.0 and GLB.
//!
//! The JSON of a file is kept as it is, together with its buffers ([`Document`]); meshes are decoded from it, and on
//! writing only the accessors of meshes that have changed are replaced. So everything that is not mesh (materials,
//! textures, skins, animations, extensions that nobody has heard of) comes out as it went in.
//!
//! The way in: [`container`] (GLB, URIs) → [`meshopt`] and [`draco`] (what is compressed becomes plain) →
//! [`accessor`] → [`primitive`] (meshes), [`scene`] (where they stand) and [`animation`] (how they move). The way out: [`compose`] (which parts to
//! replace) → [`encode`] (values to bytes) → [`package`] (one buffer, one file or several). [`fresh`] makes documents
//! for meshes that come from elsewhere, [`character`] for animated samples.

mod accessor;
mod animation;
mod character;
mod compose;
mod container;
mod draco;
mod encode;
mod fresh;
mod json;
mod levels;
mod lod;
mod look;
mod meshopt;
mod package;
mod primitive;
mod scene;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use maille::Mesh;
use serde_json::Value;

use crate::asset::Source;
use crate::left_out::{count, looks};
use crate::output::Output;
use crate::{Asset, LodChain, NamedMesh, ReadError, ReadOptions, WriteError, WriteOptions};
pub use animation::Animation;
pub(crate) use animation::Rig;
use compose::Form;
use json::{Checked, Fault, Within, extension, index, list, required_index, text};
pub(crate) use levels::split_levels;

/// Extensions that Maille understands, or that do not touch the geometry.
const KNOWN: [&str; 7] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "MSFT_lod",
];
const KNOWN_FAMILIES: [&str; 4] = ["KHR_materials_", "KHR_texture_", "KHR_animation_", "EXT_texture_"];

/// A glTF whose compressed parts have been made plain: the JSON, and what its buffers hold.
#[derive(Debug)]
pub(crate) struct Document {
    json: Value,
    buffers: Vec<Vec<u8>>,
    views: Vec<View>,
    /// Where relative URIs start from.
    folder: Option<PathBuf>,
}

/// A range of a buffer, checked to lie within it.
#[derive(Debug, Clone, Copy)]
struct View {
    buffer: usize,
    start: usize,
    end: usize,
    stride: Option<usize>,
}

impl Document {
    /// Takes a JSON and the content of its buffers, and checks what everything else relies on.
    fn new(json: Value, buffers: Vec<Vec<u8>>, folder: Option<&Path>) -> Checked<Self> {
        for key in
            ["accessors", "bufferViews", "meshes", "nodes", "scenes", "skins", "animations", "images", "materials"]
        {
            check_objects(&json, key)?;
        }
        for (i, mesh) in list(&json, "meshes")?.iter().enumerate() {
            check_objects(mesh, "primitives").within_item("meshes", i)?;
        }
        let views = list(&json, "bufferViews")?.iter().enumerate();
        let views = views.map(|(i, view)| View::new(view, &buffers).within_item("bufferViews", i));
        let views = views.collect::<Checked<_>>()?;
        Ok(Self { json, buffers, views, folder: folder.map(Path::to_owned) })
    }

    /// A top-level array, empty when absent; [`new`](Self::new) has checked that it is one.
    fn list(&self, key: &str) -> &[Value] {
        self.json.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
    }

    /// How many entries each list has that a user asks for.
    pub(crate) fn contents(&self) -> Vec<(&'static str, usize)> {
        let keys = ["scenes", "nodes", "materials", "textures", "images", "skins", "animations", "cameras"];
        keys.map(|key| (key, self.list(key).len())).into_iter().filter(|&(_, count)| count > 0).collect()
    }

    /// What the document holds beside triangles and where they stand, in words. The material that Maille gives to bare
    /// meshes is not worth a word.
    pub(crate) fn beyond_meshes(&self) -> Vec<String> {
        let bare = fresh::material("");
        let materials = self.list("materials").iter().filter(|&material| *material != bare).count();
        let lights = extension(&self.json, "KHR_lights_punctual").and_then(|e| e.get("lights")?.as_array());
        let primitives = self.list("meshes").iter().flat_map(|mesh| list(mesh, "primitives").unwrap_or_default());
        let is_other = |primitive: &&Value| {
            let mode = primitive::mode(primitive);
            primitive.get("attributes").is_some() && mode.is_ok_and(|mode| mode == primitive::Mode::Other)
        };
        let others = [
            (self.list("skins").len(), "skin"),
            (self.list("animations").len(), "animation"),
            (self.list("cameras").len(), "camera"),
            (lights.map_or(0, Vec::len), "light"),
            (primitives.filter(is_other).count(), "point or line primitive"),
        ];
        let others = others.into_iter().filter(|&(n, _)| n > 0).map(|(n, what)| count(n, what));
        looks(materials, self.list("textures").len()).into_iter().chain(others).collect()
    }

    /// The same buffers with another JSON, which is to be filled in.
    fn shared(&self) -> Self {
        let (buffers, views, folder) = (self.buffers.clone(), self.views.clone(), self.folder.clone());
        Self { json: Value::Null, buffers, views, folder }
    }

    /// The bytes of a buffer view and its stride.
    fn view(&self, number: usize) -> Checked<(&[u8], Option<usize>)> {
        let missing = || Fault::new(format!("buffer view {number} does not exist; there are {}", self.views.len()));
        let view = self.views.get(number).ok_or_else(missing)?;
        Ok((&self.buffers[view.buffer][view.start..view.end], view.stride))
    }

    /// How many material slots a mesh may name: a primitive or a material to each.
    pub(crate) fn slot_limit(&self, mesh: usize) -> usize {
        let primitives = self.list("meshes").get(mesh).and_then(|mesh| mesh.get("primitives")?.as_array());
        primitives.map_or(0, Vec::len).max(self.list("materials").len()).max(1)
    }

    /// Bytes in all buffers.
    fn byte_count(&self) -> usize {
        self.buffers.iter().map(Vec::len).sum()
    }
}

/// That a member is an array of objects, or absent.
fn check_objects(object: &Value, key: &str) -> Checked<()> {
    match list(object, key)?.iter().position(|item| !item.is_object()) {
        Some(i) => Err(Fault::new("expected an object")).within_item(key, i),
        None => Ok(()),
    }
}

impl View {
    fn new(json: &Value, buffers: &[Vec<u8>]) -> Checked<Self> {
        let buffer = required_index(json, "buffer")?;
        let bytes = buffers.get(buffer).ok_or_else(|| Fault::new(format!("buffer {buffer} does not exist")))?;
        let (start, length) = (index(json, "byteOffset")?.unwrap_or(0), required_index(json, "byteLength")?);
        let end = start.checked_add(length).filter(|&end| end <= bytes.len());
        let end = end.ok_or_else(|| {
            Fault::new(format!("{length} bytes from {start} reach beyond buffer {buffer}, which has {}", bytes.len()))
        })?;
        let stride = index(json, "byteStride")?;
        if stride == Some(0) {
            return Err(Fault::new("a stride of 0")).within("byteStride");
        }
        Ok(Self { buffer, start, end, stride })
    }
}

/// What decoding may still spend.
struct Budget {
    left: u64,
}

impl Budget {
    /// No honest file holds a thousand times what it weighs, so that a small one cannot ask for all there is.
    fn new(file_bytes: usize, options: &ReadOptions) -> Self {
        Self { left: options.max_bytes.min((256 << 20) + 1000 * file_bytes as u64) }
    }

    fn spend(&mut self, bytes: u64) -> Checked<()> {
        self.left = self.left.checked_sub(bytes).ok_or_else(|| {
            Fault::new("the arrays of the file take more memory than allowed")
                .with_remedy("raise the limit of the reader")
        })?;
        Ok(())
    }
}

/// Reads glTF JSON or GLB (told apart by the first bytes). `base` is the folder that relative URIs start from; without
/// one only embedded buffers can be read.
///
/// Each glTF mesh becomes one [`NamedMesh`]: all its triangle primitives together, the material slot of a triangle
/// being the index of its primitive. A wedge is a glTF vertex that some triangle uses; vertices are found by joining
/// equal positions. Points and lines stay in the private part.
pub(crate) fn read(bytes: &[u8], base: Option<&Path>, options: &ReadOptions) -> Result<Asset, ReadError> {
    Ok(read_document(bytes, base, options)?)
}

fn read_document(bytes: &[u8], base: Option<&Path>, options: &ReadOptions) -> Checked<Asset> {
    let mut warnings = Vec::new();
    let (mut json, binary) = container::open(bytes, &mut warnings)?;
    warn_of_unknown(&json, &mut warnings);
    let mut buffers = container::load_buffers(&json, binary, base)?;
    let size = bytes.len() + buffers.iter().map(Vec::len).sum::<usize>();
    let mut budget = Budget::new(size, options);
    meshopt::decompress(&mut json, &mut buffers, &mut budget)?;
    draco::decompress(&mut json, &mut buffers, &mut budget)?;
    asset_of(Document::new(json, buffers, base)?, &mut budget, warnings)
}

/// Decodes the meshes of a document and finds where they stand.
fn asset_of(document: Document, budget: &mut Budget, mut warnings: Vec<String>) -> Checked<Asset> {
    let mut meshes = Vec::new();
    for (i, json) in document.list("meshes").iter().enumerate() {
        let (mesh, odd) = primitive::read_mesh(&document, json, budget).within_item("meshes", i)?;
        warnings.extend(odd.into_iter().map(|odd| format!("meshes[{i}].{odd}")));
        meshes.push(NamedMesh { name: text(json, "name").to_owned(), mesh });
    }
    let scene = scene::Scene::new(&document, budget)?;
    let clips = animation::clips(&document, &scene, budget, &mut warnings);
    Ok(Asset { meshes, instances: scene.instances(), clips, warnings, source: Source::Gltf(Arc::new(document)) })
}

fn warn_of_unknown(json: &Value, warnings: &mut Vec<String>) {
    let required = json.get("extensionsRequired").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for name in required.iter().filter_map(Value::as_str) {
        if !KNOWN.contains(&name) && !KNOWN_FAMILIES.iter().any(|family| name.starts_with(family)) {
            warnings
                .push(format!("the file requires the extension {name}, which is passed on without being understood"));
        }
    }
}

/// The asset as a glTF whose nodes list levels of detail; or, if they are to be known by name, has nodes for them.
pub(crate) fn with_levels(asset: &Asset, chain: &LodChain, by_name: bool) -> Asset {
    let (document, meshes) = match &asset.source {
        Source::Gltf(document) => document.with_levels(&asset.meshes, chain, by_name),
        _ => fresh::document_for(asset).with_levels(&fresh::with_normals(&asset.meshes), chain, by_name),
    };
    Asset { meshes, source: Source::Gltf(Arc::new(document)), ..asset.clone() }
}

/// An asset with other meshes in place of its own, as they are at a level of detail.
pub(crate) fn at_level(asset: &Asset, meshes: &[Mesh]) -> Asset {
    let mut level = asset.clone();
    level.meshes.iter_mut().zip(meshes).for_each(|(named, mesh)| named.mesh = mesh.clone());
    if let Source::Gltf(document) = &asset.source {
        let has_more = |(old, new): (&NamedMesh, &Mesh)| new.morph_targets.len() > old.mesh.morph_targets.len();
        if asset.meshes.iter().zip(meshes).any(has_more) {
            level.source = Source::Gltf(Arc::new(document.at_level(meshes)));
        }
    }
    level
}

/// Writes glTF JSON with its buffers beside it, or one GLB.
///
/// An asset that was a glTF keeps all that is not mesh. For any other one, a document is made: a node for each instance,
/// a material for each slot, smooth normals where there are none.
pub(crate) fn write(
    asset: &Asset,
    binary: bool,
    output: &mut Output<'_>,
    options: &WriteOptions,
) -> Result<(), WriteError> {
    let form = Form { strips: options.strips, ..Form::default() };
    let mut put = |document: &Document, meshes: &[NamedMesh]| {
        package::write(compose::compose(document, meshes, form)?, document, binary, output)
    };
    match &asset.source {
        Source::Gltf(document) => put(document, &asset.meshes),
        _ => put(&fresh::document_for(asset), &fresh::with_normals(&asset.meshes)),
    }
}

/// A GLB of an asset with other meshes in the places of its own. Each primitive of a glTF stays, even without triangles, so
/// that the original meshes fit into what [`read`] makes of it.
pub(crate) fn glb(asset: &Asset, meshes: &[NamedMesh]) -> Result<Vec<u8>, WriteError> {
    let form = Form { keeps_emptied: true, ..Form::default() };
    let put =
        |document: &Document, meshes: &[NamedMesh]| package::glb(compose::compose(document, meshes, form)?, document);
    match &asset.source {
        Source::Gltf(document) => put(document, meshes),
        _ => put(&fresh::document_for(asset), &fresh::with_normals(meshes)),
    }
}
