//! How the nodes move.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::DQuat;
use maille::skin::{Channel, Clip, Interpolation, Keys, Property};
use serde_json::Value;

use super::accessor::{Accessor, Layout, Shape};
use super::json::{Checked, Fault, Within, index, list, required_index, text};
use super::scene::Scene;
use super::{Budget, Document};
use crate::Instance;

/// A clip of an asset that can be sampled at any number of times.
#[derive(Debug)]
pub struct Animation {
    scene: Scene,
    clip: Clip,
}

impl Animation {
    /// Of a document that has been read, with one of its clips.
    pub(crate) fn new(document: &Document, clip: Clip) -> Self {
        let mut unlimited = Budget { left: u64::MAX };
        let scene = Scene::new(document, &mut unlimited).expect("the document has been read before");
        Self { scene, clip }
    }

    /// Every appearance of a mesh as the clip holds it at a time in seconds: those of [`Asset::instances`] as they were
    /// read, in the same order. Before the first key and after the last one, those hold; what no channel names rests.
    ///
    /// [`Asset::instances`]: crate::Asset::instances
    pub fn instances_at(&self, seconds: f64) -> Vec<Instance> {
        let mut locals = self.scene.locals.clone();
        let mut weights = vec![None; locals.len()];
        for channel in &self.clip.channels {
            let node = channel.joint;
            match channel.at(seconds) {
                Some(Property::Weights(on)) => {
                    weights[node] = Some(on.into_iter().map(|weight| weight as f32).collect::<Vec<f32>>());
                }
                Some(property) => locals[node] = locals[node].with(&property),
                None => {}
            }
        }
        self.scene.posed(&locals, |node| weights[node].as_deref())
    }
}

/// The joints of an asset, to be turned at will.
#[derive(Debug)]
pub(crate) struct Rig {
    scene: Scene,
}

impl Rig {
    /// Of a document that has been read.
    pub(crate) fn new(document: &Document) -> Self {
        let mut unlimited = Budget { left: u64::MAX };
        Self { scene: Scene::new(document, &mut unlimited).expect("the document has been read before") }
    }

    /// Every appearance of a mesh with each joint turned from where it rests, by what `turn` says of its number.
    pub(crate) fn turned(&self, turn: impl Fn(usize) -> DQuat) -> Vec<Instance> {
        let mut locals = self.scene.locals.clone();
        for joint in self.scene.joints() {
            locals[joint] = locals[joint].turned(turn(joint));
        }
        self.scene.posed(&locals, |_| None)
    }

    /// Every appearance of a mesh with all that clips move in the middle of the range in which they move it, which frames at
    /// `times` of each tell.
    pub(crate) fn centered(&self, clips: &[Clip], times: impl Fn(&Clip) -> Vec<f64>) -> Vec<Instance> {
        let mut seen: BTreeMap<(usize, usize), Vec<Property>> = BTreeMap::new();
        for clip in clips {
            let times = times(clip);
            for channel in &clip.channels {
                let own = seen.entry((channel.joint, channel.keys.number())).or_default();
                own.extend(times.iter().filter_map(|&seconds| channel.at(seconds)));
            }
        }
        let mut locals = self.scene.locals.clone();
        let mut weights = vec![None; locals.len()];
        for ((node, _), range) in &seen {
            match Property::middle(range) {
                Some(Property::Weights(on)) => {
                    weights[*node] = Some(on.into_iter().map(|weight| weight as f32).collect::<Vec<f32>>());
                }
                Some(property) => locals[*node] = locals[*node].with(&property),
                None => {}
            }
        }
        self.scene.posed(&locals, |node| weights[node].as_deref())
    }
}

/// All clips of a document. Channels that are broken are left out, with a word in `warnings` for each clip that has some.
pub(super) fn clips(
    document: &Document,
    scene: &Scene,
    budget: &mut Budget,
    warnings: &mut Vec<String>,
) -> Arc<[Clip]> {
    let clip = |(number, json): (usize, &Value)| {
        let name = match text(json, "name") {
            "" => format!("clip {number}"),
            name => name.to_owned(),
        };
        let mut channels = Vec::new();
        let mut faults = Vec::new();
        match list(json, "channels") {
            Err(fault) => faults.push(fault),
            Ok(list) => {
                for (at, channel) in list.iter().enumerate() {
                    match read_channel(document, scene, json, channel, budget).within_item("channels", at) {
                        Ok(channel) => channels.extend(channel),
                        Err(fault) => faults.push(fault),
                    }
                }
            }
        }
        if let Some(first) = faults.first() {
            let more = if faults.len() > 1 { format!(" (and {} more)", faults.len() - 1) } else { String::new() };
            warnings.push(format!("channels of the clip '{name}' are left out: animations[{number}].{first}{more}"));
        }
        Clip { name, channels }
    };
    document.list("animations").iter().enumerate().map(clip).collect()
}

/// `None` for channels that move no node.
fn read_channel(
    document: &Document,
    scene: &Scene,
    animation: &Value,
    channel: &Value,
    budget: &mut Budget,
) -> Checked<Option<Channel>> {
    let target = channel.get("target").ok_or_else(|| Fault::new("'target' is missing"))?;
    let Some(node) = index(target, "node").within("target")? else { return Ok(None) };
    let property = Target::new(document, scene, node, text(target, "path")).within("target")?;
    let samplers = list(animation, "samplers")?;
    let number = required_index(channel, "sampler")?;
    let missing = || Fault::new(format!("sampler {number} does not exist; there are {}", samplers.len()));
    let sampler = samplers.get(number).ok_or_else(missing)?;
    read_keys(document, property, sampler, budget)
        .map(|(times, interpolation, keys)| Some(Channel { joint: node, times, interpolation, keys }))
        .within_item("samplers", number)
}

/// The property that a channel moves.
#[derive(Clone, Copy, PartialEq)]
enum Target {
    Translation,
    Rotation,
    Scale,
    /// Of so many morph targets.
    Weights(usize),
}

impl Target {
    fn new(document: &Document, scene: &Scene, node: usize, path: &str) -> Checked<Self> {
        let Some(local) = scene.locals.get(node) else {
            return Err(Fault::new(format!("node {node} does not exist; there are {}", scene.locals.len())));
        };
        let target = match path {
            "translation" => Self::Translation,
            "rotation" => Self::Rotation,
            "scale" => Self::Scale,
            "weights" => Self::Weights(morph_target_count(document, node)?),
            other => return Err(Fault::new(format!("unknown path '{other}'"))),
        };
        match target {
            Self::Weights(0) => Err(Fault::new(format!("node {node} has no morph targets"))),
            Self::Translation | Self::Rotation | Self::Scale if local.parts().is_none() => {
                Err(Fault::new(format!("the matrix of node {node} has no rotation and scale that could move")))
            }
            _ => Ok(target),
        }
    }
}

/// Morph targets of the mesh of a node: the same number in all its primitives.
fn morph_target_count(document: &Document, node: usize) -> Checked<usize> {
    let Some(mesh) = index(&document.list("nodes")[node], "mesh")? else { return Ok(0) };
    let Some(mesh) = document.list("meshes").get(mesh) else { return Ok(0) };
    list(mesh, "primitives")?.first().map_or(Ok(0), |primitive| Ok(list(primitive, "targets")?.len()))
}

fn read_keys(
    document: &Document,
    target: Target,
    sampler: &Value,
    budget: &mut Budget,
) -> Checked<(Vec<f32>, Interpolation, Keys)> {
    let interpolation = match text(sampler, "interpolation") {
        "" | "LINEAR" => Interpolation::Linear,
        "STEP" => Interpolation::Step,
        "CUBICSPLINE" => Interpolation::CubicSpline,
        other => return Err(Fault::new(format!("unknown interpolation '{other}'"))),
    };
    let accessor = |key| required_index(sampler, key).and_then(|number| Accessor::new(document, number)).within(key);
    let (input, output) = (accessor("input")?, accessor("output")?);
    if input.layout != Layout::floats(Shape::Scalar) || input.count == 0 {
        return Err(Fault::new("expected times in seconds, as floats")).within("input");
    }
    let (shape, each) = match target {
        Target::Translation | Target::Scale => (Shape::Vec3, 1),
        Target::Rotation => (Shape::Vec4, 1),
        Target::Weights(targets) => (Shape::Scalar, targets),
    };
    let expected = input.count.saturating_mul(interpolation.entries()).saturating_mul(each);
    if output.layout.shape != shape || output.count != expected {
        let found = format!("found {} of type {}", output.count, output.layout.shape.name());
        return Err(Fault::new(format!("expected {expected} of type {}, {found}", shape.name()))).within("output");
    }
    budget.spend(size_of::<f32>() as u64 * (input.scalars(input.count) + output.scalars(output.count)))?;
    let times = input.floats(None);
    if !times.iter().all(|time| time.is_finite()) || !times.is_sorted() {
        return Err(Fault::new("the times do not ascend")).within("input");
    }
    let values = output.floats(None);
    if !values.iter().all(|value| value.is_finite()) {
        return Err(Fault::new("not all values are finite")).within("output");
    }
    let keys = match target {
        Target::Translation => Keys::Translation(values.as_chunks().0.to_vec()),
        Target::Rotation => Keys::Rotation(values.as_chunks().0.to_vec()),
        Target::Scale => Keys::Scale(values.as_chunks().0.to_vec()),
        Target::Weights(_) => Keys::Weights(values),
    };
    Ok((times, interpolation, keys))
}
