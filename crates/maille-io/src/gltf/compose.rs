//! Which parts of a document to replace: the accessors of meshes that have changed.
//!
//! All indices stay as they are, since extensions that Maille does not know may refer to anything by index. New
//! accessors and buffer views take the places of those that only the old data of the changed meshes used; where fewer
//! are needed, a place in the middle gets a placeholder of a few bytes, and places at the end go.

use std::collections::VecDeque;

use maille::mesh::ComponentType;
use maille::{Mesh, Semantic};
use serde_json::{Map, Value, json};

use super::accessor::{Accessor, Layout, Shape};
use super::encode::{Encoded, EncodedPrimitive, Plan, PlannedAttribute, encode_primitive, fits};
use super::json::{as_index, declares, index, undeclare};
use super::primitive::{Mode, mode, read_mesh, semantic_of};
use super::{Budget, Document, View};
use crate::{NamedMesh, WriteError};

/// The mode of a primitive that is a strip.
const TRIANGLE_STRIP: u32 = 5;
const QUANTIZATION: &str = "KHR_mesh_quantization";

/// A document ready to be packed.
pub(super) struct Composed {
    pub(super) json: Value,
    /// What each buffer view of the JSON shows.
    pub(super) views: Vec<Content>,
}

/// The content of a buffer view.
pub(super) enum Content {
    /// A range of the document's buffers.
    Kept(View),
    New(Vec<u8>),
    /// Nobody uses it.
    Free,
}

/// How meshes are put into a document.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Form {
    /// Triangles become strips, where that takes fewer indices.
    pub(super) strips: bool,
    /// A primitive whose triangles have all gone, while others of its mesh have some, stays, with a triangle that draws
    /// nothing: primitives keep their numbers and how their attributes are stored.
    pub(super) keeps_emptied: bool,
}

/// Puts meshes into a document.
pub(super) fn compose(document: &Document, meshes: &[NamedMesh], form: Form) -> Result<Composed, WriteError> {
    let known = document.list("meshes").len();
    if meshes.len() != known {
        return Err(WriteError::new(format!("the asset has {} meshes where its glTF has {known}", meshes.len()))
            .with_remedy("keep one entry for each mesh that was read"));
    }
    let originals = meshes.iter().zip(document.list("meshes")).map(|(new, old)| replaced(document, new, old));
    let originals: Vec<Option<Mesh>> = originals.collect();
    let mut composer = Composer { form, ..Composer::new(document, &originals) };
    for (i, (new, original)) in meshes.iter().zip(&originals).enumerate() {
        if new.name != super::text(&document.list("meshes")[i], "name") {
            composer.json["meshes"][i]["name"] = json!(new.name);
        }
        if let Some(original) = original {
            composer.replace(i, &new.mesh, original)?;
        }
    }
    if originals.iter().any(Option::is_some) {
        composer.finish();
    }
    Ok(Composed { json: composer.json, views: composer.views })
}

/// The JSON of a document without some of its meshes, and what only they used or only `stale` accessors, which it names no more;
/// meshes that come after one are renumbered. Nothing is to draw those that go.
pub(super) fn without_meshes(document: &Document, removed: &[bool], stale: &[usize]) -> Value {
    let gone: Vec<Option<Mesh>> = removed.iter().map(|&removed| removed.then(Mesh::default)).collect();
    let mut users = Users::of(document, &gone);
    mark(&mut users.old_accessors, stale.iter().copied());
    let mut composer = Composer::new(document, &[]);
    composer.free_old_data(users);
    composer.finish();
    let mut json = composer.json;
    let mut number = 0;
    let numbers: Vec<Option<usize>> =
        removed.iter().map(|&removed| (!removed).then(|| (number, number += 1).0)).collect();
    for node in json.get_mut("nodes").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(mesh) = index(node, "mesh").ok().flatten() {
            match numbers.get(mesh).copied().flatten() {
                Some(number) => node["mesh"] = json!(number),
                None => super::json::remove(node, "mesh"),
            }
        }
    }
    if let Some(meshes) = json.get_mut("meshes").and_then(Value::as_array_mut) {
        let mut removed = removed.iter();
        meshes.retain(|_| !removed.next().is_some_and(|&removed| removed));
    }
    json
}

/// The mesh as the document has it, if the new one differs. Decoding it once more is exact, costs no memory between
/// reading and writing, and cannot go wrong after it went right once.
fn replaced(document: &Document, new: &NamedMesh, old: &Value) -> Option<Mesh> {
    let mut unlimited = Budget { left: u64::MAX };
    let original = read_mesh(document, old, &mut unlimited).map(|(mesh, _)| mesh).unwrap_or_default();
    (original != new.mesh).then_some(original)
}

/// A document under work.
struct Composer<'a> {
    document: &'a Document,
    json: Value,
    views: Vec<Content>,
    free_accessors: VecDeque<usize>,
    free_views: VecDeque<usize>,
    form: Form,
}

impl<'a> Composer<'a> {
    fn new(document: &'a Document, originals: &[Option<Mesh>]) -> Self {
        let mut composer = Self {
            document,
            json: document.json.clone(),
            views: document.views.iter().copied().map(Content::Kept).collect(),
            free_accessors: VecDeque::new(),
            free_views: VecDeque::new(),
            form: Form::default(),
        };
        if originals.iter().any(Option::is_some) {
            composer.free_old_data(Users::of(document, originals));
        }
        composer
    }

    /// Finds the accessors, and then the buffer views, that nothing uses but the old data of changed meshes.
    fn free_old_data(&mut self, users: Users) {
        let accessors = self.document.list("accessors");
        let free = |i: &usize| users.old_accessors[*i] && !users.live_accessors[*i];
        let (freed, kept): (Vec<usize>, Vec<usize>) = (0..accessors.len()).partition(free);
        let mut live = users.live_views;
        mark(&mut live, kept.iter().flat_map(|&i| views_of(&accessors[i])));
        let mut old = vec![false; live.len()];
        mark(&mut old, freed.iter().flat_map(|&i| views_of(&accessors[i])));
        self.free_views = (0..live.len()).filter(|&view| old[view] && !live[view]).collect();
        self.free_views.iter().for_each(|&view| self.views[view] = Content::Free);
        self.free_accessors = freed.into();
    }

    /// Writes the primitives of a mesh anew.
    fn replace(&mut self, number: usize, mesh: &Mesh, original: &Mesh) -> Result<(), WriteError> {
        mesh.check().map_err(|e| {
            WriteError::new(format!("mesh {number} is not valid: {e}"))
                .with_remedy("indices must be in range, and lengths agree")
        })?;
        let document = self.document;
        let primitives = document.list("meshes")[number].get("primitives").and_then(Value::as_array);
        let primitives = primitives.map_or(&[][..], Vec::as_slice);
        let blank = json!({});
        let template = |slot: usize| primitives.get(slot).unwrap_or(&blank);
        let quantized = declares(&document.json, QUANTIZATION);
        let grids = position_grids(document, primitives, mesh, quantized);
        let mut written = Vec::new();
        for (slot, triangles) in triangles_by_slot(mesh, primitives.len()).iter().enumerate() {
            let passed_on = primitives
                .get(slot)
                .is_some_and(|p| mode(p).unwrap_or(Mode::Other) == Mode::Other && p.get("attributes").is_some());
            if passed_on {
                written.push(template(slot).clone());
            }
            if !triangles.is_empty() {
                let template = if passed_on { &blank } else { template(slot) };
                let plan = plan(document, primitives, template, mesh, grids.get(slot).copied().flatten(), quantized);
                let encoded = encode_primitive(mesh, triangles, &plan, self.form.strips);
                written.push(self.add_primitive(template, encoded));
            } else if self.form.keeps_emptied && !passed_on {
                let old = (0..original.triangle_count()).find(|&t| original.triangle_material(t) as usize == slot);
                written.extend(old.map(|triangle| self.point_without_surface(primitives, original, triangle)));
            }
        }
        if written.is_empty() {
            if original.triangles.is_empty() {
                let message = format!("mesh {number} has no triangles, and a glTF mesh must have some");
                return Err(WriteError::new(message).with_remedy("remove the mesh and what refers to it"));
            }
            written.push(self.point_without_surface(primitives, original, 0));
        }
        self.json["meshes"][number]["primitives"] = Value::Array(written);
        Ok(())
    }

    /// What stands for a mesh or a primitive whose triangles have all gone: a mesh must have a primitive, and nodes, skins,
    /// animations and unknown extensions may refer to it. One of the old triangles, its corners all on one vertex, draws
    /// nothing and keeps them all valid.
    fn point_without_surface(&mut self, primitives: &[Value], original: &Mesh, triangle: usize) -> Value {
        let slot = original.triangle_material(triangle) as usize;
        let mut point = original.clone();
        point.triangles = vec![[original.triangles[triangle][0]; 3]];
        point.triangle_materials = vec![slot as u32];
        point.triangle_attributes.clear();
        let quantized = declares(&self.document.json, QUANTIZATION);
        let grids = position_grids(self.document, primitives, &point, quantized);
        let plan = plan(self.document, primitives, &primitives[slot], &point, grids[slot], quantized);
        let encoded = encode_primitive(&point, &[0], &plan, false);
        self.add_primitive(&primitives[slot], encoded)
    }

    /// A primitive with new accessors and everything else as in the old one.
    fn add_primitive(&mut self, template: &Value, encoded: EncodedPrimitive) -> Value {
        let mut primitive = template.clone();
        primitive["attributes"] = self.add_accessors(encoded.attributes);
        primitive["indices"] = json!(self.add_accessor(encoded.indices));
        match encoded.is_strip {
            true => primitive["mode"] = json!(TRIANGLE_STRIP),
            false => super::json::remove(&mut primitive, "mode"),
        }
        super::json::remove(&mut primitive, "targets");
        if !encoded.targets.is_empty() {
            let targets = encoded.targets.into_iter().map(|target| self.add_accessors(target));
            primitive["targets"] = Value::Array(targets.collect());
        }
        primitive
    }

    fn add_accessors(&mut self, encoded: Vec<(String, Encoded)>) -> Value {
        let mut map = Map::new();
        for (name, encoded) in encoded {
            let number = self.add_accessor(encoded);
            map.insert(name, json!(number));
        }
        Value::Object(map)
    }

    fn add_accessor(&mut self, encoded: Encoded) -> usize {
        let view = place(&mut self.json, "bufferViews", &mut self.free_views, encoded.view());
        let accessor = place(&mut self.json, "accessors", &mut self.free_accessors, encoded.accessor(view));
        let content = Content::New(encoded.bytes);
        match self.views.get_mut(view) {
            Some(old) => *old = content,
            None => self.views.push(content),
        }
        accessor
    }

    /// Tidies up what is left free, and the list of extensions.
    fn finish(&mut self) {
        let accessor = json!({ "componentType": 5121, "count": 1, "type": "SCALAR" });
        retire(&mut self.json, "accessors", &mut self.free_accessors, &accessor);
        let view = json!({ "buffer": 0, "byteLength": 4 });
        retire(&mut self.json, "bufferViews", &mut self.free_views, &view);
        let views = self.json.get("bufferViews").and_then(Value::as_array).map_or(0, Vec::len);
        self.views.truncate(views);
        if declares(&self.json, QUANTIZATION) && !uses_quantization(&self.json) {
            undeclare(&mut self.json, QUANTIZATION);
        }
    }
}

/// Puts an entry into the first free place of a top-level list, or at its end; the index.
fn place(json: &mut Value, key: &str, free: &mut VecDeque<usize>, entry: Value) -> usize {
    if !json.get(key).is_some_and(Value::is_array) {
        json[key] = json!([]);
    }
    let list = json[key].as_array_mut().expect("made an array above");
    match free.pop_front() {
        Some(number) => {
            list[number] = entry;
            number
        }
        None => {
            list.push(entry);
            list.len() - 1
        }
    }
}

/// Takes free entries off the end of a list and puts a placeholder in the others.
fn retire(json: &mut Value, key: &str, free: &mut VecDeque<usize>, placeholder: &Value) {
    let Some(list) = json.get_mut(key).and_then(Value::as_array_mut) else { return };
    while free.back().is_some_and(|&last| last + 1 == list.len()) {
        free.pop_back();
        list.pop();
    }
    free.iter().for_each(|&number| list[number] = placeholder.clone());
    if list.is_empty() {
        super::json::remove(json, key);
    }
}

fn mark(marks: &mut [bool], numbers: impl IntoIterator<Item = usize>) {
    for number in numbers {
        if let Some(mark) = marks.get_mut(number) {
            *mark = true;
        }
    }
}

/// Who uses what in a document.
struct Users {
    /// Used by triangles that are to be replaced.
    old_accessors: Vec<bool>,
    /// Used by anything else.
    live_accessors: Vec<bool>,
    /// Used by something else than accessors.
    live_views: Vec<bool>,
}

impl Users {
    fn of(document: &Document, originals: &[Option<Mesh>]) -> Self {
        let accessors = document.list("accessors").len();
        let mut users = Self {
            old_accessors: vec![false; accessors],
            live_accessors: vec![false; accessors],
            live_views: vec![false; document.views.len()],
        };
        for (mesh, original) in document.list("meshes").iter().zip(originals) {
            for primitive in items(mesh, "primitives") {
                let is_old = original.is_some() && mode(primitive).unwrap_or(Mode::Other) != Mode::Other;
                let marks = if is_old { &mut users.old_accessors } else { &mut users.live_accessors };
                mark(marks, accessors_of(primitive));
            }
        }
        for sampler in document.list("animations").iter().flat_map(|animation| items(animation, "samplers")) {
            mark(&mut users.live_accessors, numbers_at(sampler, &["input", "output"]));
        }
        for skin in document.list("skins") {
            mark(&mut users.live_accessors, numbers_at(skin, &["inverseBindMatrices"]));
        }
        for image in document.list("images") {
            mark(&mut users.live_views, numbers_at(image, &["bufferView"]));
        }
        users.search_extensions(&document.json, false);
        users
    }

    /// Whatever in an extension looks like a reference to an accessor or a buffer view is taken for one.
    fn search_extensions(&mut self, value: &Value, inside: bool) {
        match value {
            Value::Object(map) => {
                for (key, value) in map {
                    match key.as_str() {
                        "attributes" if inside => mark(&mut self.live_accessors, values_of(value)),
                        "accessor" if inside => mark(&mut self.live_accessors, as_index(value).ok()),
                        "bufferView" if inside => mark(&mut self.live_views, as_index(value).ok()),
                        "extras" => {}
                        key => self.search_extensions(value, inside || key == "extensions"),
                    }
                }
            }
            Value::Array(items) => items.iter().for_each(|item| self.search_extensions(item, inside)),
            _ => {}
        }
    }
}

fn items<'a>(object: &'a Value, key: &str) -> &'a [Value] {
    object.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

fn numbers_at<'a>(object: &'a Value, keys: &'a [&str]) -> impl Iterator<Item = usize> + 'a {
    keys.iter().filter_map(|key| index(object, key).ok().flatten())
}

fn values_of(object: &Value) -> impl Iterator<Item = usize> + '_ {
    object.as_object().into_iter().flatten().filter_map(|(_, value)| as_index(value).ok())
}

fn accessors_of(primitive: &Value) -> Vec<usize> {
    let attributes = primitive.get("attributes").into_iter().chain(items(primitive, "targets"));
    attributes.flat_map(values_of).chain(numbers_at(primitive, &["indices"])).collect()
}

fn views_of(accessor: &Value) -> Vec<usize> {
    let sparse = accessor.get("sparse");
    let parts = ["indices", "values"].into_iter().filter_map(|key| sparse?.get(key));
    [accessor].into_iter().chain(parts).flat_map(|part| numbers_at(part, &["bufferView"])).collect()
}

/// The triangles of each slot, as many slots as there are primitives or more.
fn triangles_by_slot(mesh: &Mesh, primitives: usize) -> Vec<Vec<u32>> {
    let slots = mesh.triangle_materials.iter().map(|&slot| slot as usize + 1).max().unwrap_or(1);
    let mut triangles = vec![Vec::new(); slots.max(primitives)];
    for triangle in 0..mesh.triangle_count() {
        triangles[mesh.triangle_material(triangle) as usize].push(triangle as u32);
    }
    triangles
}

/// How an attribute of a primitive was stored.
fn layout_of(document: &Document, primitive: &Value, name: &str) -> Option<Layout> {
    let number = index(primitive.get("attributes")?, name).ok()??;
    Accessor::layout_of(document.list("accessors").get(number)?).ok()
}

/// The integer grid of the positions of each primitive, `None` for floats. Either all primitives that had one keep it
/// or none does: they would part at their common borders.
fn position_grids(document: &Document, primitives: &[Value], mesh: &Mesh, quantized: bool) -> Vec<Option<Layout>> {
    let grid = |primitive| layout_of(document, primitive, "POSITION").filter(|l| l.component != ComponentType::F32);
    let grids: Vec<Option<Layout>> = primitives.iter().map(grid).collect();
    let all_fit = grids.iter().flatten().all(|&layout| fits(layout, mesh.positions.iter().flatten().copied()));
    if quantized && all_fit { grids } else { vec![None; primitives.len()] }
}

/// Which attributes a primitive gets: those that it had, and those that are new to the mesh as a whole; what stands in
/// for an attribute that it lacked is left out again.
fn plan<'a>(
    document: &Document,
    primitives: &[Value],
    template: &Value,
    mesh: &'a Mesh,
    grid: Option<Layout>,
    quantized: bool,
) -> Plan<'a> {
    let had = |primitive: &Value, semantic: &Semantic| named(primitive.get("attributes"), semantic);
    let semantics = mesh.wedge_attributes.iter().chain(&mesh.vertex_attributes).map(|a| &a.semantic);
    let name = |semantic: &Semantic| match had(template, semantic) {
        Some(name) => Some(name),
        None if primitives.iter().any(|p| had(p, semantic).is_some()) && template.get("attributes").is_some() => None,
        None => Some(new_name(semantic)),
    };
    let attributes = semantics.filter_map(|semantic| {
        let name = name(semantic)?;
        let shape = layout_of(document, template, &name).map(|layout| layout.shape);
        Some(PlannedAttribute { name, semantic, shape })
    });
    let attributes: Vec<PlannedAttribute<'_>> = attributes.collect();
    // nothing can be added to what is not there
    let has = |semantic: &Semantic| {
        *semantic == Semantic::Position || attributes.iter().any(|planned| planned.semantic == semantic)
    };
    let old_targets = items(template, "targets");
    let known = primitives.iter().map(|p| items(p, "targets").len()).max().unwrap_or(0);
    let is_new = known == 0;
    let targets = mesh.morph_targets.iter().enumerate().map(|(i, target)| {
        let semantics = target.attributes.iter().map(|a| &a.semantic);
        let name = |semantic| match named(old_targets.get(i), semantic) {
            None if i >= known => Some((new_name(semantic), semantic)).filter(|(_, semantic)| has(semantic)),
            name => name.map(|name| (name, semantic)),
        };
        semantics.filter_map(name).collect()
    });
    let with_targets = is_new || !old_targets.is_empty();
    let targets = if with_targets { targets.collect() } else { Vec::new() };
    Plan { attributes, targets, positions: grid.unwrap_or(Layout::floats(Shape::Vec3)), quantized }
}

/// The name that an object of accessors has for a meaning.
fn named(attributes: Option<&Value>, semantic: &Semantic) -> Option<String> {
    let names = attributes?.as_object()?.keys();
    names.into_iter().find(|name| semantic_of(name) == *semantic).cloned()
}

/// The name in glTF of an attribute that comes from elsewhere.
fn new_name(semantic: &Semantic) -> String {
    match semantic {
        // names of one's own begin with an underscore
        Semantic::Custom(name) if name.starts_with('_') => name.to_uppercase(),
        Semantic::Custom(name) => format!("_{}", name.to_uppercase()),
        known => known.gltf_name().into_owned(),
    }
}

/// Whether any vertex data needs `KHR_mesh_quantization`.
fn uses_quantization(json: &Value) -> bool {
    let accessor = |number: usize| json.get("accessors").and_then(|list| list.get(number));
    let needs = |name: &str, value: &Value, is_delta: bool| {
        let layout = as_index(value).ok().and_then(accessor).and_then(|a| Accessor::layout_of(a).ok());
        let Some(Layout { component, normalized, .. }) = layout else { return false };
        let plain = matches!(component, ComponentType::U8 | ComponentType::U16) && normalized;
        match semantic_of(name) {
            _ if component == ComponentType::F32 => false,
            Semantic::Position | Semantic::Normal | Semantic::Tangent => true,
            Semantic::TexCoord(_) => !plain,
            _ => is_delta && !plain,
        }
    };
    let any = |object: Option<&Value>, is_delta: bool| {
        let members = object.and_then(Value::as_object).into_iter().flatten();
        members.into_iter().any(|(name, value)| needs(name, value, is_delta))
    };
    items(json, "meshes").iter().flat_map(|mesh| items(mesh, "primitives")).any(|primitive| {
        any(primitive.get("attributes"), false)
            || items(primitive, "targets").iter().any(|target| any(Some(target), true))
    })
}
