//! Documents for meshes that do not come from a glTF.

use std::borrow::Cow;

use glam::DMat4;
use maille::mesh::NormalOptions;
use maille::{Mesh, Semantic};
use serde_json::{Value, json};

use super::Document;
use crate::{Asset, Instance, NamedMesh};

/// A document with a place for each mesh of an asset, still empty: nodes where the instances stand, a material for each
/// slot.
pub(super) fn document_for(asset: &Asset) -> Document {
    let mut materials = Vec::new();
    let meshes: Vec<Value> = asset.meshes.iter().map(|named| mesh_for(named, &mut materials)).collect();
    let once: Vec<Instance>;
    let instances = if asset.instances.is_empty() {
        once = (0..asset.meshes.len()).map(|mesh| Instance { mesh, ..Instance::default() }).collect();
        &once
    } else {
        &asset.instances
    };
    let nodes: Vec<Value> = instances.iter().map(|instance| node_for(instance, &asset.meshes)).collect();
    let mut json = json!({
        "asset": { "version": "2.0", "generator": generator() },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
    });
    if !materials.is_empty() {
        json["materials"] = Value::Array(materials);
    }
    Document { json, buffers: Vec::new(), views: Vec::new(), folder: None }
}

pub(super) fn generator() -> &'static str {
    concat!("maille ", env!("CARGO_PKG_VERSION"))
}

fn mesh_for(named: &NamedMesh, materials: &mut Vec<Value>) -> Value {
    let mesh = &named.mesh;
    let slots = mesh.triangle_materials.iter().map(|&slot| slot as usize + 1).max().unwrap_or(1);
    let first = materials.len();
    let primitive = |slot: usize| json!({ "material": first + slot });
    let primitives: Vec<Value> = (0..slots).map(primitive).collect();
    materials.extend((0..slots).map(|slot| material(mesh.material_names.get(slot).map_or("", String::as_str))));
    let mut json = json!({ "primitives": primitives });
    if !named.name.is_empty() {
        json["name"] = json!(named.name);
    }
    let names: Vec<&str> = mesh.morph_targets.iter().map(|target| target.name.as_str()).collect();
    if names.iter().any(|name| !name.is_empty()) {
        json["extras"] = json!({ "targetNames": names });
    }
    json
}

/// A dull grey-white surface, which shows shape and lets vertex colours be seen as they are.
pub(super) fn material(name: &str) -> Value {
    let mut json = json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.8 } });
    if !name.is_empty() {
        json["name"] = json!(name);
    }
    json
}

fn node_for(instance: &Instance, meshes: &[NamedMesh]) -> Value {
    let mut json = json!({ "mesh": instance.mesh });
    let name = &meshes[instance.mesh].name;
    if !name.is_empty() {
        json["name"] = json!(name);
    }
    if instance.transform != DMat4::IDENTITY {
        json["matrix"] = json!(instance.transform.to_cols_array());
    }
    if !instance.morph_weights.is_empty() {
        json["weights"] = json!(instance.morph_weights);
    }
    json
}

/// The meshes, each with normals: viewers would shade it flat without. Computed ones are smooth everywhere, since a
/// crease would divide wedges that the user has as one.
pub(super) fn with_normals(meshes: &[NamedMesh]) -> Cow<'_, [NamedMesh]> {
    let lacks = |mesh: &Mesh| {
        let attributes = mesh.wedge_attributes.iter().chain(&mesh.vertex_attributes);
        !attributes.into_iter().any(|attribute| attribute.semantic == Semantic::Normal)
    };
    if !meshes.iter().any(|named| lacks(&named.mesh)) {
        return Cow::Borrowed(meshes);
    }
    let mut meshes = meshes.to_vec();
    for named in meshes.iter_mut().filter(|named| lacks(&named.mesh)) {
        named.mesh.compute_normals(&NormalOptions::default());
    }
    Cow::Owned(meshes)
}
