//! Chains of levels (`MSFT_lod`), read back: the document as it was without them, and what each level is.

use std::collections::BTreeSet;

use maille::Mesh;
use serde_json::{Value, json};

use super::accessor::Accessor;
use super::compose::without_meshes;
use super::json::{
    Checked, Fault, Within, as_index, index, list, number_list, remove, remove_extension, text, undeclare,
};
use super::lod::{COVERAGE, ERRORS, MSFT_LOD};
use super::primitive::material_name;
use super::{Budget, Document, asset_of};
use crate::asset::Source;
use crate::lod::LINES;
use crate::{Asset, LodLevel};

/// The name of the morph target that takes a level to the next one.
const GEOMORPH: &str = "geomorph";
/// What the names of attributes begin with that tell where a level goes.
const MORPH_ATTRIBUTES: &str = "_MORPH_";

/// The levels of an asset's nodes: the asset without them, and the levels.
pub(crate) fn split_levels(asset: &Asset) -> Option<Result<(Asset, Vec<LodLevel>), String>> {
    let Source::Gltf(document) = &asset.source else { return None };
    document.has_levels().then(|| document.split_levels(asset).map_err(|fault| fault.to_string()))
}

impl Document {
    fn split_levels(&self, asset: &Asset) -> Checked<(Asset, Vec<LodLevel>)> {
        let (of_meshes, level_nodes) = self.levels_of_meshes()?;
        let count = of_meshes.iter().map(Vec::len).max().unwrap_or(0);
        let meshes_of_levels: BTreeSet<usize> = of_meshes.iter().flatten().copied().collect();
        let kept_nodes = (0..self.list("nodes").len()).filter(|node| !level_nodes.contains(node));
        let drawn: BTreeSet<usize> =
            kept_nodes.filter_map(|node| index(&self.list("nodes")[node], "mesh").ok().flatten()).collect();
        let removed: Vec<bool> = (0..self.list("meshes").len())
            .map(|mesh| meshes_of_levels.contains(&mesh) && !drawn.contains(&mesh))
            .collect();
        let level = |k: usize| {
            let mesh = |original: usize| {
                let levels = &of_meshes[original];
                let number = levels.get(k).or(levels.last()).copied().unwrap_or(original);
                self.as_level(number, original, &asset.meshes[number].mesh)
            };
            let originals = (0..removed.len()).filter(|&i| !removed[i]);
            LodLevel { meshes: originals.map(mesh).collect(), ..LodLevel::default() }
        };
        let mut levels: Vec<LodLevel> = (0..count).map(level).collect();
        let mut copy = Self { json: self.json.clone(), ..self.shared() };
        let mut narrowed = BTreeSet::new();
        let kept = (0..removed.len()).filter(|&mesh| !removed[mesh]);
        let stale: Vec<usize> = kept.flat_map(|mesh| copy.forget_ways(mesh, &mut narrowed)).collect();
        copy.json = without_meshes(&copy, &removed, &stale);
        copy.remove_nodes(&level_nodes);
        let copy = Self::new(copy.json, copy.buffers, copy.folder.as_deref())?;
        let mut unlimited = Budget { left: u64::MAX };
        let whole = asset_of(copy, &mut unlimited, asset.warnings.clone())?;
        let draws = whole.draws();
        let errors = self.errors(whole.merged_positions().diagonal());
        levels.iter_mut().zip(errors).for_each(|(level, error)| level.error = error);
        for level in &mut levels {
            level.triangles = level.meshes.iter().zip(&draws).map(|(mesh, draws)| mesh.triangle_count() * draws).sum();
        }
        Ok((whole, levels))
    }

    /// The meshes of the levels of each mesh, finest first, and all nodes that are levels.
    fn levels_of_meshes(&self) -> Checked<(Vec<Vec<usize>>, BTreeSet<usize>)> {
        let (nodes, meshes) = (self.list("nodes"), self.list("meshes"));
        let mesh_of = |node: usize| {
            let json = nodes.get(node).ok_or_else(|| Fault::new(format!("node {node} does not exist")))?;
            let other = || Fault::new(format!("node {node} has no mesh of its own, so it is no level of one"));
            index(json, "mesh")?.filter(|&mesh| mesh < meshes.len()).ok_or_else(other)
        };
        let mut of_meshes: Vec<Vec<usize>> = vec![Vec::new(); meshes.len()];
        let mut level_nodes = BTreeSet::new();
        for (i, node) in nodes.iter().enumerate() {
            let Some(extension) = super::extension(node, MSFT_LOD) else { continue };
            let read = || {
                let mesh = mesh_of(i)?;
                let ids = list(extension, "ids")?.iter().map(as_index).collect::<Checked<Vec<usize>>>()?;
                let levels = ids.iter().map(|&id| mesh_of(id)).collect::<Checked<Vec<usize>>>()?;
                Ok((mesh, ids, levels))
            };
            let (mesh, ids, levels) = read().within(MSFT_LOD).within("extensions").within_item("nodes", i)?;
            level_nodes.extend(ids);
            if of_meshes[mesh].is_empty() {
                of_meshes[mesh] = levels;
            }
        }
        let lists_more = |&&id: &&usize| super::extension(&nodes[id], MSFT_LOD).is_some();
        match level_nodes.iter().find(lists_more) {
            Some(id) => Err(Fault::new("a level lists levels itself")).within_item("nodes", *id),
            None => Ok((of_meshes, level_nodes)),
        }
    }

    /// The errors of the levels in world units, as far as the first node with levels tells them: itself, or by the screen
    /// coverages at which they are a pixel. As far as they make sense.
    fn errors(&self, diameter: f64) -> Vec<f64> {
        let told = |key: &'static str| {
            let told = |node: &Value| number_list(node.get("extras")?, key).ok().filter(|told| !told.is_empty());
            self.list("nodes").iter().find_map(told)
        };
        let by_coverage =
            || told(COVERAGE).unwrap_or_default().iter().map(|coverage| diameter / (LINES * coverage)).collect();
        let errors: Vec<f64> = told(ERRORS).unwrap_or_else(by_coverage);
        errors.into_iter().take_while(|&error| error > 0.0 && error.is_finite()).collect()
    }

    /// A mesh of the document in place of another: the materials of its triangles are slots of that one.
    fn as_level(&self, number: usize, original: usize, mesh: &Mesh) -> Mesh {
        let materials = |mesh: usize| -> Vec<Option<usize>> {
            let primitives = list(&self.list("meshes")[mesh], "primitives").unwrap_or_default();
            primitives.iter().map(|primitive| index(primitive, "material").ok().flatten()).collect()
        };
        let (own, theirs) = (materials(number), materials(original));
        let slot_of = |slot: usize| {
            let same = |material: &Option<usize>| own.get(slot) == Some(material);
            theirs.iter().position(same).unwrap_or(slot) as u32
        };
        let mut level = mesh.clone();
        strip(&mut level, is_geomorph_last(&self.list("meshes")[number]));
        let slots: Vec<u32> =
            (0..level.triangle_count()).map(|t| slot_of(level.triangle_material(t) as usize)).collect();
        level.triangle_materials = if slots.iter().all(|&slot| slot == 0) { Vec::new() } else { slots };
        level
    }

    /// The names of a mesh's materials, by slot.
    pub(crate) fn slot_names(&self, mesh: usize) -> Vec<String> {
        let primitives = list(&self.list("meshes")[mesh], "primitives").unwrap_or_default();
        primitives.iter().map(|primitive| material_name(self, primitive)).collect()
    }

    /// The names of the joints that move a mesh, by number; those without one are called after their nodes.
    pub(crate) fn joint_names(&self, mesh: usize) -> Vec<String> {
        let nodes = self.list("nodes");
        let draws = |node: &&Value| index(node, "mesh").ok().flatten() == Some(mesh);
        let skin = nodes.iter().filter(draws).find_map(|node| index(node, "skin").ok().flatten());
        let joints = skin.and_then(|skin| list(self.list("skins").get(skin)?, "joints").ok()).unwrap_or_default();
        let name = |joint: &Value| {
            let node = as_index(joint).unwrap_or(usize::MAX);
            match nodes.get(node).map_or("", |node| text(node, "name")) {
                "" => format!("node {node}"),
                name => name.to_owned(),
            }
        };
        joints.iter().map(name).collect()
    }

    /// Takes away nodes, those that others come after only as far as they draw something.
    fn remove_nodes(&mut self, removed: &BTreeSet<usize>) {
        let is_removed = |value: &Value| as_index(value).is_ok_and(|node| removed.contains(&node));
        let lists = [("scenes", "nodes"), ("nodes", "children")];
        for (key, members) in lists {
            for owner in self.json.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten() {
                let Some(numbers) = owner.get_mut(members).and_then(Value::as_array_mut) else { continue };
                numbers.retain(|number| !is_removed(number));
                if numbers.is_empty() {
                    remove(owner, members); // an empty list is not valid
                }
            }
        }
        for animation in self.json.get_mut("animations").and_then(Value::as_array_mut).into_iter().flatten() {
            if let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) {
                channels.retain(|channel| !channel["target"].get("node").is_some_and(is_removed));
            }
        }
        let nodes = self.json["nodes"].as_array_mut().expect("nodes have levels");
        for node in nodes.iter_mut() {
            remove_extension(node, MSFT_LOD);
            if let Some(extras) = node.get_mut("extras") {
                remove(extras, COVERAGE);
                remove(extras, ERRORS);
                if extras.as_object().is_some_and(serde_json::Map::is_empty) {
                    remove(node, "extras");
                }
            }
        }
        removed.iter().for_each(|&node| nodes[node] = json!({}));
        while nodes.len().checked_sub(1).is_some_and(|last| removed.contains(&last)) {
            nodes.pop();
        }
        let has_levels = |material: &Value| super::extension(material, MSFT_LOD).is_some();
        if !self.list("materials").iter().any(has_levels) {
            undeclare(&mut self.json, MSFT_LOD);
        }
    }

    /// Takes away what takes a mesh to its next level; the accessors that it was in. Samplers that tell of it no more are
    /// `narrowed`.
    fn forget_ways(&mut self, number: usize, narrowed: &mut BTreeSet<(usize, usize)>) -> Vec<usize> {
        let has_geomorph = is_geomorph_last(&self.list("meshes")[number]);
        let mut stale = Vec::new();
        let mut targets = 0;
        let primitives = self.json["meshes"][number].get_mut("primitives").and_then(Value::as_array_mut);
        for primitive in primitives.into_iter().flatten() {
            if let Some(attributes) = primitive.get_mut("attributes").and_then(Value::as_object_mut) {
                attributes.retain(|name, accessor| {
                    let is_way = name.starts_with(MORPH_ATTRIBUTES);
                    stale.extend(as_index(accessor).ok().filter(|_| is_way));
                    !is_way
                });
            }
            if has_geomorph {
                targets = list(primitive, "targets").map_or(0, <[Value]>::len);
                let accessors = pop(primitive, "targets");
                let accessors = accessors.as_ref().and_then(Value::as_object).into_iter().flatten();
                stale.extend(accessors.filter_map(|(_, accessor)| as_index(accessor).ok()));
            }
        }
        if has_geomorph {
            stale.extend(self.forget_weight(number, targets, narrowed));
        }
        stale
    }

    /// Takes back what was said of the last morph target of a mesh: its name, and the places where it is off.
    fn forget_weight(&mut self, number: usize, targets: usize, narrowed: &mut BTreeSet<(usize, usize)>) -> Vec<usize> {
        let mesh = &mut self.json["meshes"][number];
        pop(mesh, "weights");
        if let Some(extras) = mesh.get_mut("extras") {
            pop(extras, "targetNames");
            if extras.as_object().is_some_and(serde_json::Map::is_empty) {
                remove(mesh, "extras");
            }
        }
        let nodes = self.json["nodes"].as_array_mut().into_iter().flatten().enumerate();
        let drawn = nodes.filter(|(_, node)| index(node, "mesh").ok().flatten() == Some(number));
        let drawn: Vec<usize> = drawn.map(|(i, node)| (pop(node, "weights"), i).1).collect();
        let mut samplers = if targets > 1 { self.samplers_of_weights(&drawn) } else { BTreeSet::new() };
        samplers.retain(|&sampler| narrowed.insert(sampler)); // one may serve several meshes
        let narrow = |values: &[f32]| -> Vec<f32> {
            values.chunks_exact(targets).flat_map(|key| &key[..targets - 1]).copied().collect()
        };
        samplers.into_iter().filter_map(|sampler| self.rewrite_output(sampler, narrow)).collect()
    }

    /// The samplers, each once, that tell how far the morph targets of some nodes are on: by animation and number.
    pub(super) fn samplers_of_weights(&self, nodes: &[usize]) -> BTreeSet<(usize, usize)> {
        let mut samplers = BTreeSet::new();
        for (a, animation) in self.list("animations").iter().enumerate() {
            for channel in list(animation, "channels").unwrap_or_default() {
                let target = &channel["target"];
                let node = index(target, "node").ok().flatten();
                let acts = text(target, "path") == "weights" && node.is_some_and(|node| nodes.contains(&node));
                samplers.extend(index(channel, "sampler").ok().flatten().filter(|_| acts).map(|sampler| (a, sampler)));
            }
        }
        samplers
    }

    /// Gives a sampler other values; the accessor that it had. One that cannot be read is of no use as it is, and stays.
    pub(super) fn rewrite_output(
        &mut self,
        (a, sampler): (usize, usize),
        change: impl Fn(&[f32]) -> Vec<f32>,
    ) -> Option<usize> {
        let output = index(&self.json["animations"][a]["samplers"][sampler], "output").ok().flatten()?;
        let values = change(&Accessor::new(self, output).ok()?.floats(None));
        let number = self.push_floats(values.iter().flat_map(|x| x.to_le_bytes()).collect());
        self.json["animations"][a]["samplers"][sampler]["output"] = json!(number);
        Some(output)
    }
}

/// Takes the last item out of a list, and the list out of its object if it is then empty.
fn pop(object: &mut Value, key: &str) -> Option<Value> {
    let items = object.get_mut(key)?.as_array_mut()?;
    let last = items.pop();
    if items.is_empty() {
        remove(object, key);
    }
    last
}

/// Whether the last morph target of a mesh takes it to its next level.
fn is_geomorph_last(mesh: &Value) -> bool {
    let names = mesh.get("extras").and_then(|extras| extras.get("targetNames")).and_then(Value::as_array);
    names.and_then(|names| names.last()).is_some_and(|name| name == GEOMORPH)
}

/// Takes away what takes a mesh to its next level.
fn strip(mesh: &mut Mesh, has_geomorph: bool) {
    if has_geomorph {
        mesh.morph_targets.pop();
    }
    mesh.wedge_attributes.retain(|attribute| !attribute.semantic.gltf_name().starts_with(MORPH_ATTRIBUTES));
}
