//! How much each joint moves each vertex.

use glam::Vec3;
use rayon::prelude::*;

use super::Neighbours;
use super::body::Body;
use super::rig;
use crate::samples::isosurface::Surface;

/// Weights are multiples of this, so that they sum to exactly 1 in any order.
const UNIT: f32 = 1.0 / 65_536.0;

/// The four joints of each vertex and their weights.
///
/// A vertex belongs to the joint whose parts are nearest, and to the joints next to that one in the skeleton as far as
/// their parts are nearly as near: hence an arm that hangs beside the torso does not pull it. A few rounds of averaging
/// along the surface round off what is left of borders.
pub(super) fn weights(body: &Body, surface: &Surface) -> (Vec<[u32; 4]>, Vec<[f32; 4]>) {
    let related = Related::new();
    let raw = |&p: &[f32; 3]| vertex_weights(body, &related, p.into());
    let mut weights: Vec<[f32; rig::COUNT]> = surface.positions.par_iter().map(raw).collect();
    let neighbours = Neighbours::new(surface);
    for _ in 0..4 {
        let average = |v: usize| {
            let ring = neighbours.of(v);
            std::array::from_fn(|joint| {
                let sum: f32 = ring.iter().map(|&w| weights[w as usize][joint]).sum();
                0.5 * weights[v][joint] + 0.5 * sum / ring.len() as f32
            })
        };
        weights = (0..weights.len()).into_par_iter().map(average).collect();
    }
    weights.par_iter().map(four_largest).unzip()
}

/// Which joints may share a vertex: parent and child, grandparent and grandchild in the trunk, children of one joint.
struct Related {
    may_share: Vec<[bool; rig::COUNT]>,
}

impl Related {
    fn new() -> Self {
        let near = |a: usize, b: usize| a == b || rig::parent(a) == Some(b) || rig::parent(b) == Some(a);
        let is_middle = |joint: usize| rig::twin(joint) == joint;
        let share = |a: usize, b: usize| {
            let two_steps = (0..rig::COUNT).any(|c| near(a, c) && near(c, b));
            // the hips do not join the thighs to one another, nor the chest the arms
            near(a, b) || two_steps && (is_middle(a) || is_middle(b) || rig::twin(a) != b)
        };
        Self { may_share: (0..rig::COUNT).map(|a| std::array::from_fn(|b| share(a, b))).collect() }
    }
}

/// Over what difference of distances a joint's hold fades, in metres.
fn softness(joint: usize) -> f32 {
    let name = rig::skeleton_name(joint);
    match name {
        "fingers" | "finger_tips" | "thumb" => 0.012,
        "hand" | "toes" => 0.025,
        "foot" | "forearm" | "upper_arm" | "head" => 0.038,
        _ => 0.050,
    }
}

fn vertex_weights(body: &Body, related: &Related, p: Vec3) -> [f32; rig::COUNT] {
    let distances: [f32; rig::COUNT] = std::array::from_fn(|joint| body.joint_distance(joint, p));
    let nearest = (0..rig::COUNT).min_by(|&a, &b| distances[a].total_cmp(&distances[b])).expect("there are joints");
    let mut weights: [f32; rig::COUNT] = std::array::from_fn(|joint| {
        if !related.may_share[nearest][joint] {
            return 0.0;
        }
        let reach = softness(joint).min(softness(nearest));
        let share = (1.0 - (distances[joint] - distances[nearest]) / reach).max(0.0);
        share * share
    });
    let total: f32 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= total);
    weights
}

/// The four largest weights, in whole units that sum to 1; places without weight name joint 0.
fn four_largest(weights: &[f32; rig::COUNT]) -> ([u32; 4], [f32; 4]) {
    let mut order: Vec<usize> = (0..rig::COUNT).collect();
    order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]).then(a.cmp(&b)));
    let total: f32 = order[..4].iter().map(|&joint| weights[joint]).sum();
    let mut units = [0.0; 4];
    for k in 1..4 {
        units[k] = (weights[order[k]] / total / UNIT).round();
    }
    units[0] = 1.0 / UNIT - units[1] - units[2] - units[3];
    let joints = std::array::from_fn(|k| if units[k] > 0.0 { order[k] as u32 } else { 0 });
    (joints, units.map(|unit| unit * UNIT))
}
