//! A document for an animated character made in code.

use glam::{DMat4, DQuat, Vec3};
use maille::samples::Character;
use maille::skin::{Channel, Clip, Interpolation, Joint, Keys};
use serde_json::{Value, json};

use super::accessor::Shape;
use super::fresh::generator;
use super::json::Checked;
use super::scene::Scene;
use super::{Document, animation};
use crate::asset::Source;
use crate::{Asset, NamedMesh};

/// Where the joints begin among the nodes; before them stands the mesh.
const FIRST_JOINT: usize = 1;

impl Asset {
    /// An asset of a character, which is written as glTF with its skeleton, clips and texture.
    ///
    /// # Panics
    /// If a channel or a joint refers to a joint that does not exist, joints are their own ancestors, or a channel does
    /// not have as many keys as times.
    pub fn from_character(name: &str, character: &Character) -> Self {
        let document = document_for(name, character).expect("the views of the document are laid out here");
        let mut unlimited = super::Budget { left: u64::MAX };
        let scene = Scene::new(&document, &mut unlimited).expect("the joints form a hierarchy");
        let mut warnings = Vec::new();
        let clips = animation::clips(&document, &scene, &mut unlimited, &mut warnings);
        Self {
            meshes: vec![NamedMesh { name: name.to_owned(), mesh: character.mesh.clone() }],
            instances: scene.instances(),
            clips,
            warnings,
            source: Source::Gltf(std::sync::Arc::new(document)),
        }
    }
}

/// Everything but the mesh, which has an empty primitive for each material slot.
fn document_for(name: &str, character: &Character) -> Checked<Document> {
    let joints = &character.skeleton.joints;
    let slots = character.mesh.triangle_materials.iter().max().map_or(1, |&last| last + 1);
    let mut data = Data::default();
    let animations: Vec<Value> = character.clips.iter().map(|clip| animation(clip, &mut data)).collect();
    let inverse_binds: Vec<f32> = (0..joints.len()).flat_map(|joint| inverse_bind(joints, joint)).collect();
    let inverse_binds = data.floats(Shape::Mat4, &inverse_binds, false);
    let roots = (0..joints.len()).filter(|&joint| joints[joint].parent.is_none()).map(|joint| FIRST_JOINT + joint);
    let mut nodes = vec![json!({ "name": name, "mesh": 0, "skin": 0 })];
    nodes.extend((0..joints.len()).map(|joint| node(joints, joint)));
    let mut material =
        json!({ "name": name, "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.8 } });
    let mut json = json!({
        "asset": { "version": "2.0", "generator": generator() },
        "scene": 0,
        "scenes": [{ "nodes": std::iter::once(0).chain(roots).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": [{ "name": name, "primitives": vec![json!({ "material": 0 }); slots as usize] }],
        "skins": [{
            "inverseBindMatrices": inverse_binds,
            "joints": (0..joints.len()).map(|joint| FIRST_JOINT + joint).collect::<Vec<_>>(),
        }],
    });
    if !animations.is_empty() {
        json["animations"] = Value::Array(animations);
    }
    if let Some(png) = &character.texture_png {
        material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
        json["textures"] = json!([{ "source": 0 }]);
        json["images"] = json!([{ "bufferView": data.view(png), "mimeType": "image/png" }]);
    }
    json["materials"] = json!([material]);
    json["accessors"] = Value::Array(data.accessors);
    json["bufferViews"] = Value::Array(data.views);
    json["buffers"] = json!([{ "byteLength": data.bytes.len() }]);
    Document::new(json, vec![data.bytes], None)
}

/// What goes into the buffer.
#[derive(Default)]
struct Data {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    /// Arrays of times with their accessors: many channels have the same.
    times: Vec<(Vec<f32>, usize)>,
}

impl Data {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn floats(&mut self, shape: Shape, values: &[f32], with_bounds: bool) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let count = values.len() / shape.components();
        let mut accessor = json!({ "bufferView": view, "componentType": 5126, "count": count, "type": shape.name() });
        if with_bounds {
            let extreme = |pick: fn(f32, f32) -> f32| values.iter().copied().reduce(pick).unwrap_or(0.0);
            accessor["min"] = json!([extreme(f32::min)]);
            accessor["max"] = json!([extreme(f32::max)]);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn times(&mut self, times: &[f32]) -> usize {
        if let Some((_, known)) = self.times.iter().find(|(other, _)| other == times) {
            return *known;
        }
        let accessor = self.floats(Shape::Scalar, times, true);
        self.times.push((times.to_vec(), accessor));
        accessor
    }
}

fn node(joints: &[Joint], number: usize) -> Value {
    let joint = &joints[number];
    let mut json = json!({ "name": joint.name });
    if joint.translation != [0.0; 3] {
        json["translation"] = json!(joint.translation);
    }
    if joint.rotation != [0.0, 0.0, 0.0, 1.0] {
        json["rotation"] = json!(joint.rotation);
    }
    if joint.scale != [1.0; 3] {
        json["scale"] = json!(joint.scale);
    }
    let is_child = |&child: &usize| joints[child].parent == Some(number);
    let children: Vec<usize> = (0..joints.len()).filter(is_child).map(|child| FIRST_JOINT + child).collect();
    if !children.is_empty() {
        json["children"] = json!(children);
    }
    json
}

/// From model space to the space of a joint at rest, by columns.
fn inverse_bind(joints: &[Joint], number: usize) -> [f32; 16] {
    let mut world = DMat4::IDENTITY;
    let mut next = Some(number);
    for _ in 0..=joints.len() {
        let Some(joint) = next else { break };
        let Joint { parent, translation, rotation, scale, .. } = &joints[joint];
        let rotation = DQuat::from_array(rotation.map(f64::from)).normalize();
        let [translation, scale] = [translation, scale].map(|v| Vec3::from(*v).as_dvec3());
        world = DMat4::from_scale_rotation_translation(scale, rotation, translation) * world;
        next = *parent;
    }
    assert!(next.is_none(), "joint {number} is its own ancestor");
    let mut columns = world.inverse().as_mat4().to_cols_array();
    // glTF asks for exactly this last row
    [columns[3], columns[7], columns[11], columns[15]] = [0.0, 0.0, 0.0, 1.0];
    columns
}

fn animation(clip: &Clip, data: &mut Data) -> Value {
    let mut samplers = Vec::new();
    let mut channels = Vec::new();
    for Channel { joint, times, interpolation, keys } in &clip.channels {
        let (path, shape, values) = match keys {
            Keys::Translation(keys) => ("translation", Shape::Vec3, keys.as_flattened()),
            Keys::Rotation(keys) => ("rotation", Shape::Vec4, keys.as_flattened()),
            Keys::Scale(keys) => ("scale", Shape::Vec3, keys.as_flattened()),
            // a character has no morph targets
            Keys::Weights(_) => continue,
        };
        let entries = times.len() * interpolation.entries();
        assert_eq!(entries * shape.components(), values.len(), "clip '{}' has a key for each time", clip.name);
        let interpolation = match interpolation {
            Interpolation::Step => "STEP",
            Interpolation::Linear => "LINEAR",
            Interpolation::CubicSpline => "CUBICSPLINE",
        };
        let (input, output) = (data.times(times), data.floats(shape, values, false));
        channels.push(json!({ "sampler": samplers.len(), "target": { "node": FIRST_JOINT + joint, "path": path } }));
        samplers.push(json!({ "input": input, "output": output, "interpolation": interpolation }));
    }
    json!({ "name": clip.name, "channels": channels, "samplers": samplers })
}
