//! Where the meshes stand: nodes, skins, and instancing, at rest.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

use super::accessor::{Accessor, Shape};
use super::json::{Checked, Fault, Within, as_index, extension, index, list, members, number_list, numbers};
use super::{Budget, Document};
use crate::Instance;

/// Every appearance of a mesh in the default scene (the first one if none is named; all nodes if there are no scenes).
pub(super) fn instances(document: &Document, budget: &mut Budget) -> Checked<Vec<Instance>> {
    let meshes = document.list("meshes");
    let nodes = document.list("nodes");
    if nodes.is_empty() {
        // a file of meshes only: nothing says where they stand
        return Ok((0..meshes.len()).map(|mesh| Instance { mesh, ..Instance::default() }).collect());
    }
    let tree = Tree::new(nodes)?;
    let world = tree.world_matrices(nodes)?;
    let skins = document.list("skins").iter().enumerate();
    let skins = skins.map(|(i, skin)| joint_matrices(document, skin, &world).within_item("skins", i));
    let skins: Vec<Arc<[DMat4]>> = skins.collect::<Checked<_>>()?;
    let mut instances = Vec::new();
    for node in tree.drawn(document)? {
        let place = instances_at(document, &nodes[node], world[node], &skins, budget).within_item("nodes", node)?;
        instances.extend(place);
    }
    Ok(instances)
}

/// The hierarchy of the nodes, checked to be one.
struct Tree {
    children: Vec<Vec<usize>>,
    roots: Vec<usize>,
    /// All nodes, parents before their children.
    order: Vec<usize>,
    parents: Vec<Option<usize>>,
}

impl Tree {
    fn new(nodes: &[Value]) -> Checked<Self> {
        let mut parents = vec![None; nodes.len()];
        let mut children = Vec::with_capacity(nodes.len());
        for (i, node) in nodes.iter().enumerate() {
            let adopt = |(at, child): (usize, &Value)| {
                let mut adopt = || {
                    let child = as_index(child)?;
                    match parents.get_mut(child) {
                        None => Err(Fault::new(format!("node {child} does not exist; there are {}", nodes.len()))),
                        Some(Some(other)) => {
                            Err(Fault::new(format!("node {child} is a child of node {other} already")))
                        }
                        Some(parent) => {
                            *parent = Some(i);
                            Ok(child)
                        }
                    }
                };
                adopt().within_item("children", at)
            };
            let adopted: Checked<_> =
                list(node, "children").and_then(|list| list.iter().enumerate().map(adopt).collect());
            children.push(adopted.within_item("nodes", i)?);
        }
        let roots: Vec<usize> = (0..nodes.len()).filter(|&node| parents[node].is_none()).collect();
        let mut tree = Self { children, roots, order: Vec::new(), parents };
        tree.order = tree.below(&tree.roots);
        if tree.order.len() < nodes.len() {
            let mut reached = vec![false; nodes.len()];
            tree.order.iter().for_each(|&node| reached[node] = true);
            let lost = reached.iter().position(|reached| !reached).unwrap_or(0);
            return Err(Fault::new("the node is its own ancestor")).within_item("nodes", lost);
        }
        Ok(tree)
    }

    /// The given nodes and all below them, parents first, each once: every node has one parent, so that only the given
    /// ones could come twice.
    fn below(&self, tops: &[usize]) -> Vec<usize> {
        let mut seen = vec![false; self.children.len()];
        let mut stack: Vec<usize> = tops.iter().rev().copied().collect();
        let mut order = Vec::new();
        while let Some(node) = stack.pop() {
            if !std::mem::replace(&mut seen[node], true) {
                order.push(node);
                stack.extend(self.children[node].iter().rev());
            }
        }
        order
    }

    fn world_matrices(&self, nodes: &[Value]) -> Checked<Vec<DMat4>> {
        let mut world = vec![DMat4::IDENTITY; nodes.len()];
        for &node in &self.order {
            let local = local_matrix(&nodes[node]).within_item("nodes", node)?;
            world[node] = self.parents[node].map_or(local, |parent| world[parent] * local);
        }
        Ok(world)
    }

    /// The nodes of the scene to show.
    fn drawn(&self, document: &Document) -> Checked<Vec<usize>> {
        let scenes = document.list("scenes");
        let chosen = index(&document.json, "scene")?;
        let Some(scene) = scenes.get(chosen.unwrap_or(0)) else {
            return match chosen {
                Some(chosen) => Err(Fault::new(format!("scene {chosen} does not exist"))).within("scene"),
                None => Ok(self.order.clone()),
            };
        };
        let top = |(at, node): (usize, &Value)| {
            let exists = |&node: &usize| node < self.children.len();
            let node = as_index(node).and_then(|node| {
                Some(node).filter(exists).ok_or_else(|| Fault::new(format!("node {node} does not exist")))
            });
            node.within_item("nodes", at)
        };
        let tops: Checked<Vec<usize>> =
            list(scene, "nodes").and_then(|nodes| nodes.iter().enumerate().map(top).collect());
        Ok(self.below(&tops.within_item("scenes", chosen.unwrap_or(0))?))
    }
}

/// A node's own transform: a matrix, or translation, rotation and scale.
fn local_matrix(node: &Value) -> Checked<DMat4> {
    if let Some(matrix) = numbers::<16>(node, "matrix")? {
        return Ok(DMat4::from_cols_array(&matrix));
    }
    let translation = numbers::<3>(node, "translation")?.unwrap_or([0.0; 3]);
    let rotation = numbers::<4>(node, "rotation")?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let scale = numbers::<3>(node, "scale")?.unwrap_or([1.0; 3]);
    Ok(compose(translation.into(), DQuat::from_array(rotation), scale.into()))
}

fn compose(translation: DVec3, rotation: DQuat, scale: DVec3) -> DMat4 {
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    DMat4::from_scale_rotation_translation(scale, rotation, translation)
}

/// The appearances of the mesh of one node: one, or as many as its instancing extension says.
fn instances_at(
    document: &Document,
    node: &Value,
    world: DMat4,
    skins: &[Arc<[DMat4]>],
    budget: &mut Budget,
) -> Checked<Vec<Instance>> {
    let meshes = document.list("meshes");
    let Some(mesh) = index(node, "mesh")? else { return Ok(Vec::new()) };
    let Some(json) = meshes.get(mesh) else {
        return Err(Fault::new(format!("mesh {mesh} does not exist; there are {}", meshes.len()))).within("mesh");
    };
    let own = number_list(node, "weights")?;
    let weights = if own.is_empty() { number_list(json, "weights").within_item("meshes", mesh)? } else { own };
    let joint_matrices = match index(node, "skin")? {
        Some(skin) => {
            let missing = || Fault::new(format!("skin {skin} does not exist; there are {}", skins.len()));
            Some(skins.get(skin).cloned().ok_or_else(missing).within("skin")?)
        }
        None => None,
    };
    let morph_weights: Vec<f32> = weights.into_iter().map(|weight| weight as f32).collect();
    let each = size_of::<Instance>() + size_of_val(morph_weights.as_slice());
    let transforms = match extension(node, "EXT_mesh_gpu_instancing") {
        Some(extension) => instance_matrices(document, extension, each, budget)
            .within("EXT_mesh_gpu_instancing")
            .within("extensions")?,
        None => vec![DMat4::IDENTITY],
    };
    let instance = |local: DMat4| Instance {
        mesh,
        transform: world * local,
        joint_matrices: joint_matrices.clone(),
        morph_weights: morph_weights.clone(),
    };
    Ok(transforms.into_iter().map(instance).collect())
}

/// World matrix of each joint times its inverse bind matrix.
fn joint_matrices(document: &Document, skin: &Value, world: &[DMat4]) -> Checked<Arc<[DMat4]>> {
    let joint = |(at, joint): (usize, &Value)| {
        let node = as_index(joint)?;
        let matrix = world.get(node).ok_or_else(|| Fault::new(format!("node {node} does not exist")));
        matrix.copied().within_item("joints", at)
    };
    let joints: Arc<[DMat4]> = list(skin, "joints")?.iter().enumerate().map(joint).collect::<Checked<_>>()?;
    let Some(number) = index(skin, "inverseBindMatrices")? else { return Ok(joints) };
    let inverses = || {
        let accessor = Accessor::new(document, number)?;
        if accessor.layout.shape != Shape::Mat4 || accessor.count < joints.len() {
            return Err(Fault::new(format!("expected {} matrices", joints.len())));
        }
        let values = accessor.floats(None);
        Ok(values.as_chunks::<16>().0.iter().map(|m| DMat4::from_cols_array(&m.map(f64::from))).collect::<Vec<_>>())
    };
    let inverses = inverses().within("inverseBindMatrices")?;
    Ok(joints.iter().zip(inverses).map(|(&joint, inverse)| joint * inverse).collect())
}

/// The local transforms of `EXT_mesh_gpu_instancing`; `each` instance will take so many bytes.
fn instance_matrices(document: &Document, extension: &Value, each: usize, budget: &mut Budget) -> Checked<Vec<DMat4>> {
    let (mut translations, mut rotations, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let mut count = None;
    for (name, value) in members(extension, "attributes")? {
        let (target, shape) = match name {
            "TRANSLATION" => (&mut translations, Shape::Vec3),
            "ROTATION" => (&mut rotations, Shape::Vec4),
            "SCALE" => (&mut scales, Shape::Vec3),
            _ => continue,
        };
        let accessor = as_index(value).and_then(|number| Accessor::new(document, number)).within(name)?;
        if accessor.layout.shape != shape || accessor.count != *count.get_or_insert(accessor.count) {
            return Err(Fault::new("the attributes do not agree in type and number")).within(name);
        }
        budget.spend((accessor.count * (each + 4 * shape.components())) as u64)?;
        *target = accessor.floats(None);
    }
    let vector = |values: &[f32], i: usize, default: f64| match values.get(3 * i..3 * i + 3) {
        Some(v) => DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2])),
        None => DVec3::splat(default),
    };
    let rotation = |i: usize| match rotations.get(4 * i..4 * i + 4) {
        Some(q) => DQuat::from_array([q[0], q[1], q[2], q[3]].map(f64::from)),
        None => DQuat::IDENTITY,
    };
    let count = count.unwrap_or(0);
    Ok((0..count).map(|i| compose(vector(&translations, i, 0.0), rotation(i), vector(&scales, i, 1.0))).collect())
}
