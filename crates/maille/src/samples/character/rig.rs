//! The skeleton at rest: all joints aligned with the world, arms half raised.

use glam::{DVec3, Vec3};

use crate::skin::{Joint, Skeleton};

/// Name, parent and place in the world, metres; those ending in `_l` have a twin on the right.
const JOINTS: [(&str, &str, [f32; 3]); 17] = [
    ("hips", "", [0.0, 0.960, 0.0]),
    ("spine", "hips", [0.0, 1.060, 0.0]),
    ("chest", "spine", [0.0, 1.190, -0.005]),
    ("upper_chest", "chest", [0.0, 1.310, -0.010]),
    ("neck", "upper_chest", [0.0, 1.460, -0.015]),
    ("head", "neck", [0.0, 1.550, 0.0]),
    ("clavicle_l", "upper_chest", [0.025, 1.410, 0.0]),
    ("upper_arm_l", "clavicle_l", [0.168, 1.395, -0.015]),
    ("forearm_l", "upper_arm_l", [0.365, 1.218, -0.020]),
    ("hand_l", "forearm_l", [0.545, 1.056, 0.005]),
    ("fingers_l", "hand_l", [0.612, 0.996, 0.012]),
    ("finger_tips_l", "fingers_l", [0.648, 0.963, 0.014]),
    ("thumb_l", "hand_l", [0.570, 1.032, 0.042]),
    ("thigh_l", "hips", [0.092, 0.925, 0.0]),
    ("shin_l", "thigh_l", [0.100, 0.505, 0.008]),
    ("foot_l", "shin_l", [0.105, 0.090, -0.025]),
    ("toes_l", "foot_l", [0.113, 0.028, 0.105]),
];

/// Number of joints: those in the middle, then the left ones, then the right ones.
pub(super) const COUNT: usize = 28;
const MIDDLE: usize = 6;

/// Index of a joint.
pub(super) fn joint(name: &str) -> usize {
    let (base, is_right) = name.strip_suffix("_r").map_or((name, false), |base| (base, true));
    let matches = |(known, ..): &&(&str, &str, [f32; 3])| {
        *known == name || is_right && known.strip_suffix("_l").is_some_and(|known| known == base)
    };
    let place = JOINTS.iter().position(|entry| matches(&entry)).expect("the name is one of the table's");
    if is_right { place + JOINTS.len() - MIDDLE } else { place }
}

/// The joint on the other side; a middle one is its own twin.
pub(super) fn twin(joint: usize) -> usize {
    let left = JOINTS.len() - MIDDLE;
    match joint {
        0..MIDDLE => joint,
        _ if joint < JOINTS.len() => joint + left,
        _ => joint - left,
    }
}

/// Where a joint stands at rest.
pub(super) fn place(joint: usize) -> Vec3 {
    if joint < JOINTS.len() {
        return Vec3::from(JOINTS[joint].2);
    }
    let [x, y, z] = JOINTS[twin(joint)].2;
    Vec3::new(-x, y, z)
}

/// The parent of a joint.
pub(super) fn parent(joint_index: usize) -> Option<usize> {
    let is_right = joint_index >= JOINTS.len();
    let (_, parent, _) = JOINTS[if is_right { twin(joint_index) } else { joint_index }];
    let parent = if parent.is_empty() { None } else { Some(joint(parent)) };
    parent.map(|parent| if is_right { twin(parent) } else { parent })
}

pub(super) fn skeleton() -> Skeleton {
    let joint = |index: usize| {
        let (left, ..) = JOINTS[if index < JOINTS.len() { index } else { twin(index) }];
        let name = match left.strip_suffix("_l") {
            Some(base) if index >= JOINTS.len() => format!("{base}_r"),
            _ => left.to_owned(),
        };
        let parent = parent(index);
        let translation = (place(index) - parent.map_or(Vec3::ZERO, place)).to_array();
        Joint { name, parent, translation, ..Joint::default() }
    };
    Skeleton { joints: (0..COUNT).map(joint).collect() }
}

/// Points of the left sole at rest and the joint that carries them: heel, ball, tip of the toes.
const SOLE: [(&str, [f64; 3]); 4] = [
    ("foot_l", [0.105, 0.0, -0.080]),
    ("foot_l", [0.113, 0.0, 0.085]),
    ("toes_l", [0.113, 0.0, 0.110]),
    ("toes_l", [0.116, 0.004, 0.175]),
];

/// Height of the lowest point of either sole.
pub(super) fn lowest_point(skeleton: &Skeleton) -> f64 {
    let worlds = skeleton.world_matrices();
    let height = |(name, [x, y, z]): &(&str, [f64; 3]), is_right: bool| {
        let left = joint(name);
        let (joint, x) = if is_right { (twin(left), -x) } else { (left, *x) };
        let local = DVec3::new(x, *y, *z) - place(joint).as_dvec3();
        worlds[joint].transform_point3(local).y
    };
    let heights = SOLE.iter().flat_map(|point| [height(point, false), height(point, true)]);
    heights.fold(f64::INFINITY, f64::min)
}

/// Name of a joint without its side.
pub(super) fn skeleton_name(joint: usize) -> &'static str {
    let (name, ..) = JOINTS[if joint < JOINTS.len() { joint } else { twin(joint) }];
    name.strip_suffix("_l").unwrap_or(name)
}
