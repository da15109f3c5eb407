//! Levels of detail in glTF: `MSFT_lod` on nodes.
//!
//! A level is a node of its own that no scene names, with a mesh of its own; the node it stands in for lists it. Skins, materials
//! and clips are shared. Since such a node has neither the children nor the movements of the one it replaces, a node that
//! has children or is moved by a clip hands its mesh to a new child first.

use std::collections::HashSet;

use maille::Mesh;
use serde_json::{Value, json};

use super::json::{declare, extension, index, remove, remove_extension, text};
use super::{Document, View};
use crate::{LodChain, NamedMesh};

pub(super) const MSFT_LOD: &str = "MSFT_lod";
pub(super) const COVERAGE: &str = "MSFT_screencoverage";
/// Beside the coverages, which end at the full height of a picture: the error of each level, in world units.
pub(super) const ERRORS: &str = "MAILLE_lod_errors";
const INSTANCING: &str = "EXT_mesh_gpu_instancing";

impl Document {
    /// Whether nodes list levels.
    pub(crate) fn has_levels(&self) -> bool {
        self.list("nodes").iter().any(|node| extension(node, MSFT_LOD).is_some())
    }

    /// The document for its meshes as they are at a level: with the names of morph targets that are new.
    pub(super) fn at_level(&self, meshes: &[Mesh]) -> Self {
        let mut copy = Self { json: self.json.clone(), ..self.shared() };
        let mut widened = HashSet::new();
        meshes.iter().enumerate().for_each(|(i, mesh)| copy.add_target_names(i, mesh, &mut widened));
        copy
    }

    /// The document with nodes and meshes for the levels of its meshes, and all meshes, in its order: `meshes` and then
    /// those of the levels. Nodes list their levels; or these stand beside them, known by their names.
    pub(super) fn with_levels(&self, meshes: &[NamedMesh], chain: &LodChain, by_name: bool) -> (Self, Vec<NamedMesh>) {
        let mut json = self.json.clone();
        let mut all = meshes.to_vec();
        for (named, mesh) in all.iter_mut().zip(&chain.original) {
            named.mesh = mesh.clone();
        }
        let has_levels: Vec<bool> = meshes.iter().map(|named| named.mesh.triangle_count() > 0).collect();
        let mut numbers: Vec<Vec<usize>> = vec![Vec::new(); meshes.len()];
        for (k, level) in chain.levels.iter().enumerate() {
            for (i, mesh) in level.meshes.iter().enumerate().filter(|&(i, _)| has_levels[i]) {
                numbers[i].push(all.len());
                all.push(NamedMesh { name: level_name(&meshes[i].name, k + 1), mesh: mesh.clone() });
                let copy = json["meshes"][i].clone();
                json["meshes"].as_array_mut().expect("documents have meshes").push(copy);
            }
        }
        let mut copy = Self { json, ..self.shared() };
        let mut widened = HashSet::new();
        for (i, named) in all.iter().enumerate() {
            copy.add_target_names(i, &named.mesh, &mut widened);
        }
        let mut json = copy.json;
        let moved = moved_nodes(&json);
        let coverage = chain.screen_coverage();
        let errors: Vec<f64> = chain.levels.iter().map(|level| level.error).collect();
        let told = (!by_name).then_some((coverage.as_slice(), errors.as_slice()));
        for node in 0..self.list("nodes").len() {
            let Some(levels) = index(&json["nodes"][node], "mesh").ok().flatten().and_then(|mesh| numbers.get(mesh))
            else {
                continue;
            };
            if !levels.is_empty() {
                add_levels(&mut json, node, levels, moved.contains(&node), told);
            }
        }
        if by_name {
            let drawn = all.iter_mut().zip(&has_levels).filter(|(_, has_levels)| **has_levels);
            drawn.for_each(|(named, _)| named.name = level_name(&named.name, 0));
        } else {
            declare(&mut json, MSFT_LOD);
        }
        (Self { json, ..copy }, all)
    }

    /// Lets a mesh have one more morph target than the document knows, if it has: its name where viewers look for it, and a
    /// zero wherever the document tells how far its targets are on.
    fn add_target_names(&mut self, number: usize, mesh: &Mesh, widened: &mut HashSet<(usize, usize)>) {
        let json = &mut self.json["meshes"][number];
        let known = json["primitives"][0].get("targets").and_then(Value::as_array).map_or(0, Vec::len);
        if mesh.morph_targets.len() <= known {
            return;
        }
        if json.get("extras").is_none_or(Value::is_object) {
            let names: Vec<&str> = mesh.morph_targets.iter().map(|target| target.name.as_str()).collect();
            json["extras"]["targetNames"] = json!(names);
        }
        let nodes = self.json["nodes"].as_array_mut().into_iter().flatten();
        let drawn = nodes.enumerate().filter(|(_, node)| index(node, "mesh").ok().flatten() == Some(number));
        let drawn: Vec<usize> = drawn
            .map(|(i, node)| {
                append_zero(node);
                i
            })
            .collect();
        append_zero(&mut self.json["meshes"][number]);
        if known > 0 {
            for sampler in self.samplers_of_weights(&drawn) {
                if widened.insert(sampler) {
                    // one may serve several meshes
                    self.rewrite_output(sampler, |values| {
                        values.chunks_exact(known).flat_map(|key| key.iter().copied().chain([0.0])).collect()
                    });
                }
            }
        }
    }

    /// A new accessor of single floats.
    pub(super) fn push_floats(&mut self, bytes: Vec<u8>) -> usize {
        let (length, count) = (bytes.len(), bytes.len() / 4);
        push(&mut self.json, "buffers", json!({ "byteLength": length }));
        let view = json!({ "buffer": self.buffers.len(), "byteOffset": 0, "byteLength": length });
        let view = push(&mut self.json, "bufferViews", view);
        self.views.push(View { buffer: self.buffers.len(), start: 0, end: length, stride: None });
        self.buffers.push(bytes);
        push(
            &mut self.json,
            "accessors",
            json!({ "bufferView": view, "componentType": 5126, "count": count, "type": "SCALAR" }),
        )
    }
}

/// Adds an entry to a top-level list, and tells its number.
fn push(json: &mut Value, key: &str, entry: Value) -> usize {
    let list = json[key].as_array_mut().expect("the document has such a list");
    list.push(entry);
    list.len() - 1
}

/// One more morph target of a mesh or node is off.
fn append_zero(object: &mut Value) {
    if let Some(weights) = object.get_mut("weights").and_then(Value::as_array_mut) {
        weights.push(json!(0.0));
    }
}

/// The name of a level, as engines know it.
pub(super) fn level_name(name: &str, level: usize) -> String {
    format!("{name}_LOD{level}")
}

/// The nodes whose place, rotation or scale a clip changes.
fn moved_nodes(json: &Value) -> HashSet<usize> {
    let channels = channels_of(json);
    let moves = channels.filter(|channel| text(&channel["target"], "path") != "weights");
    moves.filter_map(|channel| index(&channel["target"], "node").ok().flatten()).collect()
}

fn channels_of(json: &Value) -> impl Iterator<Item = &Value> {
    let animations = json.get("animations").and_then(Value::as_array).into_iter().flatten();
    animations.flat_map(|animation| animation.get("channels").and_then(Value::as_array).into_iter().flatten())
}

/// Adds nodes for the levels of a node's mesh, given by their numbers: listed by the node with their coverages and errors, or
/// beside it if these are not told.
fn add_levels(json: &mut Value, node: usize, levels: &[usize], is_moved: bool, told: Option<(&[f64], &[f64])>) {
    let has_children = json["nodes"][node].get("children").is_some();
    let carrier = if is_moved || has_children { hand_mesh_down(json, node) } else { node };
    let name = match text(&json["nodes"][carrier], "name") {
        "" => text(&json["meshes"][levels[0]], "name").to_owned(), // still that of the original
        name => name.to_owned(),
    };
    let mut ids = Vec::new();
    for (k, &mesh) in levels.iter().enumerate() {
        let mut level = json["nodes"][carrier].clone();
        level["mesh"] = json!(mesh);
        if !name.is_empty() || told.is_none() {
            level["name"] = json!(level_name(&name, k + 1));
        }
        remove(&mut level, "camera");
        let id = push(json, "nodes", level);
        move_weights(json, carrier, id, true);
        ids.push(id);
    }
    let Some((coverage, errors)) = told else {
        json["nodes"][carrier]["name"] = json!(level_name(&name, 0));
        add_beside(json, carrier, &ids);
        return;
    };
    let carrier = &mut json["nodes"][carrier];
    carrier["extensions"][MSFT_LOD] = json!({ "ids": ids });
    if carrier.get("extras").is_none_or(Value::is_object) {
        carrier["extras"][COVERAGE] = json!(coverage);
        carrier["extras"][ERRORS] = json!(errors);
    }
}

/// Adds nodes wherever one is listed: among the children of its parent, or in scenes.
fn add_beside(json: &mut Value, node: usize, added: &[usize]) {
    for (key, members) in [("scenes", "nodes"), ("nodes", "children")] {
        for owner in json.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten() {
            let Some(numbers) = owner.get_mut(members).and_then(Value::as_array_mut) else { continue };
            if numbers.iter().any(|number| number == node) {
                numbers.extend(added.iter().map(|&id| json!(id)));
            }
        }
    }
}

/// Gives the mesh of a node to a new child of it, which stands where the node does.
fn hand_mesh_down(json: &mut Value, node: usize) -> usize {
    let mut child = json!({});
    for key in ["name", "mesh", "skin", "weights"] {
        if let Some(value) = json["nodes"][node].get(key) {
            child[key] = value.clone();
        }
    }
    if let Some(instancing) = extension(&json["nodes"][node], INSTANCING).cloned() {
        child["extensions"][INSTANCING] = instancing;
        remove_extension(&mut json["nodes"][node], INSTANCING);
    }
    for key in ["mesh", "skin", "weights"] {
        remove(&mut json["nodes"][node], key);
    }
    let child = push(json, "nodes", child);
    move_weights(json, node, child, false);
    let parent = &mut json["nodes"][node];
    match parent.get_mut("children").and_then(Value::as_array_mut) {
        Some(children) => children.push(json!(child)),
        None => parent["children"] = json!([child]),
    }
    child
}

/// Lets the channels that turn morph targets of a node on and off act on another one, or on both.
fn move_weights(json: &mut Value, from: usize, to: usize, on_both: bool) {
    let animations = json.get_mut("animations").and_then(Value::as_array_mut).into_iter().flatten();
    for channels in animations.filter_map(|animation| animation.get_mut("channels")?.as_array_mut()) {
        let mut copies = Vec::new();
        for channel in channels.iter_mut() {
            let target = &channel["target"];
            let acts = text(target, "path") == "weights" && index(target, "node").ok().flatten() == Some(from);
            if acts && on_both {
                let mut copy = channel.clone();
                copy["target"]["node"] = json!(to);
                copies.push(copy);
            } else if acts {
                channel["target"]["node"] = json!(to);
            }
        }
        channels.append(&mut copies);
    }
}
