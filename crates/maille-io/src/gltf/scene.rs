//! Where the meshes stand: nodes, skins, and instancing, at rest and posed.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3};
use maille::skin::Property;
use serde_json::Value;

use super::accessor::{Accessor, Shape};
use super::json::{Checked, Fault, Within, as_index, extension, index, list, members, number_list, numbers};
use super::{Budget, Document};
use crate::Instance;

/// Everything that says where the meshes of the default scene stand (the first one if none is named; all nodes if there
/// are no scenes), decoded.
#[derive(Debug)]
pub(super) struct Scene {
    tree: Tree,
    /// Of each node, at rest.
    pub(super) locals: Vec<Local>,
    skins: Vec<Skin>,
    places: Vec<Place>,
}

impl Scene {
    pub(super) fn new(document: &Document, budget: &mut Budget) -> Checked<Self> {
        let nodes = document.list("nodes");
        let tree = Tree::new(nodes)?;
        let local = |(i, node): (usize, &Value)| Local::new(node).within_item("nodes", i);
        let locals = nodes.iter().enumerate().map(local).collect::<Checked<_>>()?;
        let skin = |(i, skin): (usize, &Value)| Skin::new(document, skin).within_item("skins", i);
        let skins: Vec<Skin> = document.list("skins").iter().enumerate().map(skin).collect::<Checked<_>>()?;
        let mut places = Vec::new();
        if nodes.is_empty() {
            // a file of meshes only: nothing says where they stand
            places.extend((0..document.list("meshes").len()).map(Place::of_mesh));
        }
        for node in tree.drawn(document)? {
            places.extend(Place::new(document, node, skins.len(), budget).within_item("nodes", node)?);
        }
        Ok(Self { tree, locals, skins, places })
    }

    /// The nodes that are joints of some skin.
    pub(super) fn joints(&self) -> BTreeSet<usize> {
        self.skins.iter().flat_map(|skin| &skin.joints).copied().collect()
    }

    /// Every appearance of a mesh at rest.
    pub(super) fn instances(&self) -> Vec<Instance> {
        self.posed(&self.locals, |_| None)
    }

    /// Every appearance of a mesh when the nodes stand at `locals`. `weights` gives those of a node's morph targets, where
    /// they are not those at rest.
    pub(super) fn posed<'w>(&self, locals: &[Local], weights: impl Fn(usize) -> Option<&'w [f32]>) -> Vec<Instance> {
        let world = self.tree.world_matrices(locals);
        let skins: Vec<Arc<[DMat4]>> = self.skins.iter().map(|skin| skin.joint_matrices(&world)).collect();
        let mut instances = Vec::new();
        for place in &self.places {
            let world = place.node.map_or(DMat4::IDENTITY, |node| world[node]);
            let weights = place.node.and_then(&weights).unwrap_or(&place.morph_weights);
            instances.extend(place.transforms.iter().map(|local| Instance {
                mesh: place.mesh,
                transform: world * *local,
                joint_matrices: place.skin.map(|skin| skins[skin].clone()),
                morph_weights: weights.to_vec(),
            }));
        }
        instances
    }
}

/// The hierarchy of the nodes, checked to be one.
#[derive(Debug)]
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

    fn world_matrices(&self, locals: &[Local]) -> Vec<DMat4> {
        let mut world = vec![DMat4::IDENTITY; locals.len()];
        for &node in &self.order {
            let local = locals[node].matrix();
            world[node] = self.parents[node].map_or(local, |parent| world[parent] * local);
        }
        world
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

/// A node's own transform.
#[derive(Debug, Clone, Copy)]
pub(super) enum Local {
    Matrix(DMat4),
    Parts(Parts),
}

/// First scaled, then rotated, then moved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parts {
    translation: DVec3,
    rotation: DQuat,
    scale: DVec3,
}

impl Local {
    fn new(node: &Value) -> Checked<Self> {
        if let Some(matrix) = numbers::<16>(node, "matrix")? {
            return Ok(Self::Matrix(DMat4::from_cols_array(&matrix)));
        }
        let translation = numbers::<3>(node, "translation")?.unwrap_or([0.0; 3]);
        let rotation = numbers::<4>(node, "rotation")?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let scale = numbers::<3>(node, "scale")?.unwrap_or([1.0; 3]);
        let rotation = DQuat::from_array(rotation);
        Ok(Self::Parts(Parts { translation: translation.into(), rotation, scale: scale.into() }))
    }

    fn matrix(&self) -> DMat4 {
        match self {
            Self::Matrix(matrix) => *matrix,
            Self::Parts(parts) => parts.matrix(),
        }
    }

    /// The same but for one property, as far as there are parts.
    pub(super) fn with(self, property: &Property) -> Self {
        let Some(mut parts) = self.parts() else { return self };
        match property {
            Property::Translation(translation) => parts.translation = *translation,
            Property::Rotation(rotation) => parts.rotation = *rotation,
            Property::Scale(scale) => parts.scale = *scale,
            Property::Weights(_) => {}
        }
        Self::Parts(parts)
    }

    /// The same, turned about its own origin before it is where it is, as far as there are parts.
    pub(super) fn turned(self, turn: DQuat) -> Self {
        let Some(parts) = self.parts() else { return self };
        Self::Parts(Parts { rotation: parts.rotation * turn, ..parts })
    }

    /// Translation, rotation and scale; `None` for a matrix that has none.
    pub(super) fn parts(&self) -> Option<Parts> {
        match self {
            Self::Parts(parts) => Some(*parts),
            Self::Matrix(matrix) => {
                let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
                let is_whole = scale.is_finite() && rotation.is_finite() && translation.is_finite();
                is_whole.then_some(Parts { translation, rotation, scale })
            }
        }
    }
}

impl Parts {
    fn matrix(&self) -> DMat4 {
        let Self { translation, rotation, scale } = *self;
        let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
        DMat4::from_scale_rotation_translation(scale, rotation, translation)
    }
}

/// The appearances of the mesh of one node: one, or as many as its instancing extension says.
#[derive(Debug)]
struct Place {
    /// `None` in a file without nodes.
    node: Option<usize>,
    mesh: usize,
    skin: Option<usize>,
    /// At rest.
    morph_weights: Vec<f32>,
    /// Of each appearance, within the node.
    transforms: Vec<DMat4>,
}

impl Place {
    fn of_mesh(mesh: usize) -> Self {
        Self { node: None, mesh, skin: None, morph_weights: Vec::new(), transforms: vec![DMat4::IDENTITY] }
    }

    /// `None` for a node without a mesh.
    fn new(document: &Document, number: usize, skins: usize, budget: &mut Budget) -> Checked<Option<Self>> {
        let (node, meshes) = (&document.list("nodes")[number], document.list("meshes"));
        let Some(mesh) = index(node, "mesh")? else { return Ok(None) };
        let Some(json) = meshes.get(mesh) else {
            return Err(Fault::new(format!("mesh {mesh} does not exist; there are {}", meshes.len()))).within("mesh");
        };
        let own = number_list(node, "weights")?;
        let weights = if own.is_empty() { number_list(json, "weights").within_item("meshes", mesh)? } else { own };
        let skin = index(node, "skin")?;
        if let Some(skin) = skin.filter(|&skin| skin >= skins) {
            return Err(Fault::new(format!("skin {skin} does not exist; there are {skins}"))).within("skin");
        }
        let morph_weights: Vec<f32> = weights.into_iter().map(|weight| weight as f32).collect();
        let each = size_of::<Instance>() + size_of_val(morph_weights.as_slice());
        let transforms = match extension(node, "EXT_mesh_gpu_instancing") {
            Some(extension) => instance_matrices(document, extension, each, budget)
                .within("EXT_mesh_gpu_instancing")
                .within("extensions")?,
            None => vec![DMat4::IDENTITY],
        };
        Ok(Some(Self { node: Some(number), mesh, skin, morph_weights, transforms }))
    }
}

#[derive(Debug)]
struct Skin {
    joints: Vec<usize>,
    /// From the mesh's space to each joint's; none: they are the same.
    inverse_binds: Vec<DMat4>,
}

impl Skin {
    fn new(document: &Document, skin: &Value) -> Checked<Self> {
        let nodes = document.list("nodes").len();
        let joint = |(at, joint): (usize, &Value)| {
            let node = as_index(joint)?;
            let exists = if node < nodes { Ok(node) } else { Err(Fault::new(format!("node {node} does not exist"))) };
            exists.within_item("joints", at)
        };
        let joints: Vec<usize> = list(skin, "joints")?.iter().enumerate().map(joint).collect::<Checked<_>>()?;
        let Some(number) = index(skin, "inverseBindMatrices")? else {
            return Ok(Self { joints, inverse_binds: Vec::new() });
        };
        let inverses = || {
            let accessor = Accessor::new(document, number)?;
            if accessor.layout.shape != Shape::Mat4 || accessor.count < joints.len() {
                return Err(Fault::new(format!("expected {} matrices", joints.len())));
            }
            let values = accessor.floats(None);
            Ok(values.as_chunks::<16>().0.iter().map(|m| DMat4::from_cols_array(&m.map(f64::from))).collect())
        };
        let inverse_binds = inverses().within("inverseBindMatrices")?;
        Ok(Self { joints, inverse_binds })
    }

    /// World matrix of each joint times its inverse bind matrix.
    fn joint_matrices(&self, world: &[DMat4]) -> Arc<[DMat4]> {
        let matrix = |(i, &joint): (usize, &usize)| match self.inverse_binds.get(i) {
            Some(inverse) => world[joint] * *inverse,
            None => world[joint],
        };
        self.joints.iter().enumerate().map(matrix).collect()
    }
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
    let parts = |i: usize| Parts {
        translation: vector(&translations, i, 0.0),
        rotation: rotation(i),
        scale: vector(&scales, i, 1.0),
    };
    Ok((0..count).map(|i| parts(i).matrix()).collect())
}
