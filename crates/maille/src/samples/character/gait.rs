//! Walking, running and standing, in place.
//!
//! Hip, knee and ankle follow the angles that gait laboratories measure (Winter, "Biomechanics and motor control of
//! human movement", for walking; Novacheck 1998 for running), rounded; the height of the hips follows from the feet
//! touching the ground.

use glam::{Quat, Vec3};

use super::rig;
use crate::samples::noise::turn;
use crate::skin::{Channel, Clip, Interpolation, Keys, Skeleton};

/// Keys to a cycle; one more closes it.
const KEYS: usize = 32;

/// Angles of a leg in degrees at each tenth of its cycle, which starts when the heel strikes: flexion of hip and knee,
/// and of ankle and toes towards the shin.
struct Gait {
    hip: [f32; 10],
    knee: [f32; 10],
    ankle: [f32; 10],
    toes: [f32; 10],
    seconds: f32,
    /// Forward and backward swing of the upper arm, and the middle and swing of the elbow's flexion.
    arm: f32,
    elbow: [f32; 2],
    /// Turn of the hips, sway of the hips (metres), lean of the trunk.
    twist: f32,
    sway: f32,
    lean: f32,
    /// When a leg is off the ground although the other one is, too: from here to the other's strike, and how high.
    flight: Option<(f32, f32)>,
}

const WALK: Gait = Gait {
    hip: [27.0, 25.0, 17.0, 8.0, -2.0, -9.0, -5.0, 11.0, 24.0, 29.0],
    knee: [4.0, 15.0, 16.0, 9.0, 5.0, 12.0, 36.0, 60.0, 50.0, 18.0],
    ankle: [2.0, -5.0, 3.0, 8.0, 11.0, 6.0, -17.0, -6.0, 3.0, 4.0],
    toes: [8.0, 0.0, 0.0, 0.0, 8.0, 24.0, 26.0, 4.0, 4.0, 8.0],
    seconds: 1.08,
    arm: 22.0,
    elbow: [22.0, 12.0],
    twist: 6.0,
    sway: 0.018,
    lean: 2.0,
    flight: None,
};

const RUN: Gait = Gait {
    hip: [34.0, 30.0, 18.0, 4.0, -8.0, -7.0, 12.0, 36.0, 50.0, 44.0],
    knee: [20.0, 38.0, 40.0, 26.0, 16.0, 36.0, 80.0, 108.0, 88.0, 40.0],
    ankle: [8.0, 16.0, 18.0, 4.0, -24.0, -20.0, -8.0, 2.0, 6.0, 8.0],
    toes: [2.0, 0.0, 4.0, 24.0, 24.0, 4.0, 0.0, 0.0, 2.0, 4.0],
    seconds: 0.70,
    arm: 42.0,
    elbow: [88.0, 16.0],
    twist: 9.0,
    sway: 0.010,
    lean: 9.0,
    flight: Some((0.38, 0.06)),
};

/// All clips.
pub(super) fn clips(skeleton: &Skeleton) -> Vec<Clip> {
    vec![
        clip("walk", WALK.seconds, skeleton, |phase| WALK.pose(skeleton, phase)),
        clip("run", RUN.seconds, skeleton, |phase| RUN.pose(skeleton, phase)),
        clip("idle", 4.0, skeleton, |phase| idle(skeleton, phase)),
    ]
}

/// Rotations of the joints about their rest, and where the hips are.
struct Stance {
    rotations: [Quat; rig::COUNT],
    hips: Vec3,
}

impl Stance {
    fn new() -> Self {
        Self { rotations: [Quat::IDENTITY; rig::COUNT], hips: rig::place(rig::joint("hips")) }
    }

    fn set(&mut self, joint: &str, rotation: Quat) {
        self.rotations[rig::joint(joint)] = rotation;
    }

    /// The skeleton in this stance.
    fn applied(&self, skeleton: &Skeleton) -> Skeleton {
        let mut posed = skeleton.clone();
        for (joint, rotation) in posed.joints.iter_mut().zip(&self.rotations) {
            joint.rotation = rotation.to_array();
        }
        posed.joints[rig::joint("hips")].translation = self.hips.to_array();
        posed
    }

    /// Lifts or lowers the hips until the lowest foot is at a height.
    fn grounded(mut self, skeleton: &Skeleton, height: f32) -> Self {
        self.hips.y += height - rig::lowest_point(&self.applied(skeleton)) as f32;
        self
    }
}

/// Samples a cycle; joints that never turn get no channel.
fn clip(name: &str, seconds: f32, skeleton: &Skeleton, stance: impl Fn(f32) -> Stance) -> Clip {
    let mut stances: Vec<Stance> = (0..KEYS).map(|key| stance(key as f32 / KEYS as f32)).collect();
    stances.push(stance(0.0));
    let times: Vec<f32> = (0..=KEYS).map(|key| seconds * key as f32 / KEYS as f32).collect();
    let hips = Keys::Translation(stances.iter().map(|stance| stance.hips.to_array()).collect());
    let channel = |joint, keys| Channel { joint, times: times.clone(), interpolation: Interpolation::Linear, keys };
    let mut channels = vec![channel(rig::joint("hips"), hips)];
    for joint in 0..skeleton.joints.len() {
        let rotations: Vec<[f32; 4]> = stances.iter().map(|stance| stance.rotations[joint].to_array()).collect();
        if rotations.iter().any(|rotation| *rotation != Quat::IDENTITY.to_array()) {
            channels.push(channel(joint, Keys::Rotation(rotations)));
        }
    }
    Clip { name: name.to_owned(), channels }
}

/// A rotation by degrees.
fn turned(axis: Vec3, degrees: f32) -> Quat {
    let (cos, sin) = turn(f64::from(degrees) / 720.0);
    let v = axis.normalize() * sin as f32;
    Quat::from_xyzw(v.x, v.y, v.z, cos as f32)
}

/// Cosine and sine of a phase, 1 being a cycle.
fn cos_sin(phase: f32) -> (f32, f32) {
    let (cos, sin) = turn(f64::from(phase));
    (cos as f32, sin as f32)
}

/// A periodic Catmull-Rom curve through ten values.
fn periodic(values: &[f32; 10], phase: f32) -> f32 {
    let x = phase.rem_euclid(1.0) * 10.0;
    let (base, t) = (x.floor() as usize, x - x.floor());
    let [a, b, c, d] = [9, 0, 1, 2].map(|k| values[(base + k) % 10]);
    b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
}

/// Sides: name and sign of x.
const SIDES: [(&str, f32); 2] = [("l", 1.0), ("r", -1.0)];

impl Gait {
    /// The stance at a phase; at 0 the left heel strikes.
    fn pose(&self, skeleton: &Skeleton, phase: f32) -> Stance {
        let mut stance = Stance::new();
        let (cos, sin) = cos_sin(phase);
        // the hips turn with the leading leg and sink on the swinging side; the shoulders turn against them
        let turn_y = |share: f32| turned(Vec3::Y, share * self.twist * cos);
        let roll = turned(Vec3::Z, 3.0 * sin);
        stance.set("hips", turn_y(-1.0) * roll * turned(Vec3::X, 0.5 * self.lean));
        stance.set("spine", turn_y(0.7) * turned(Vec3::Z, -2.0 * sin) * turned(Vec3::X, 0.3 * self.lean));
        stance.set("chest", turn_y(0.7) * turned(Vec3::Z, -1.5 * sin) * turned(Vec3::X, 0.2 * self.lean));
        stance.set("upper_chest", turn_y(0.6));
        stance.set("neck", turn_y(-0.5) * turned(Vec3::X, -0.3 * self.lean));
        stance.set("head", turn_y(-0.5) * turned(Vec3::X, -0.5 * self.lean + 1.5 * cos_sin(2.0 * phase).0));
        for (side, sign) in SIDES {
            let own = if sign > 0.0 { phase } else { phase + 0.5 };
            self.leg(&mut stance, side, own);
            self.arm(&mut stance, side, sign, own);
        }
        stance.hips.x += self.sway * sin;
        stance.grounded(skeleton, self.flight_height(phase))
    }

    fn leg(&self, stance: &mut Stance, side: &str, phase: f32) {
        let mut bend = |joint: &str, degrees: f32| stance.set(&format!("{joint}_{side}"), turned(Vec3::X, degrees));
        // the hips lean with the trunk, the legs do not
        bend("thigh", -periodic(&self.hip, phase) - 0.5 * self.lean);
        bend("shin", periodic(&self.knee, phase));
        bend("foot", -periodic(&self.ankle, phase));
        bend("toes", -periodic(&self.toes, phase));
    }

    fn arm(&self, stance: &mut Stance, side: &str, sign: f32, phase: f32) {
        // arms swing against the legs of their side
        let swing = -cos_sin(phase).0;
        let elbow = self.elbow[0] + self.elbow[1] * swing;
        let forward = turned(Vec3::X, -self.arm * swing + 0.25 * self.elbow[0] * 0.3);
        hang_arm(stance, side, sign, forward, elbow);
        stance.set(&format!("clavicle_{side}"), turned(Vec3::Y, -sign * 4.0 * swing));
    }

    /// How high both feet are off the ground.
    fn flight_height(&self, phase: f32) -> f32 {
        let Some((start, height)) = self.flight else { return 0.0 };
        let within = (phase.rem_euclid(0.5) - start) / (0.5 - start);
        if within < 0.0 { 0.0 } else { height * 4.0 * within * (1.0 - within) }
    }
}

/// Lowers an arm beside the body, swings it, and bends elbow and fingers.
fn hang_arm(stance: &mut Stance, side: &str, sign: f32, swing: Quat, elbow: f32) {
    let down = turned(Vec3::Z, -sign * 38.0);
    stance.set(&format!("upper_arm_{side}"), swing * down);
    // the elbow bends forward: about the axis from the arm's direction to +z
    let [shoulder, hinge] = ["upper_arm", "forearm"].map(|name| rig::place(rig::joint(&format!("{name}_{side}"))));
    stance.set(&format!("forearm_{side}"), turned((hinge - shoulder).cross(Vec3::Z), elbow));
    let curl = |degrees: f32| turned(Vec3::Z, -sign * degrees);
    stance.set(&format!("hand_{side}"), curl(6.0));
    stance.set(&format!("fingers_{side}"), curl(12.0 + 0.35 * elbow));
    stance.set(&format!("finger_tips_{side}"), curl(14.0 + 0.5 * elbow));
    stance.set(&format!("thumb_{side}"), turned(Vec3::Y, sign * 0.2 * elbow));
}

/// Standing and breathing.
fn idle(skeleton: &Skeleton, phase: f32) -> Stance {
    let mut stance = Stance::new();
    let (cos, sin) = cos_sin(phase);
    let breath = 1.2 * (1.0 - cos);
    stance.hips.x += 0.008 * sin;
    stance.set("hips", turned(Vec3::Z, -0.6 * sin));
    stance.set("spine", turned(Vec3::Z, 0.8 * sin) * turned(Vec3::X, 1.0));
    stance.set("chest", turned(Vec3::X, -0.5 * breath));
    stance.set("upper_chest", turned(Vec3::X, -0.5 * breath));
    stance.set("neck", turned(Vec3::X, 0.4 * breath));
    stance.set("head", turned(Vec3::Y, 5.0 * sin) * turned(Vec3::X, 0.5 * breath));
    for (side, sign) in SIDES {
        stance.set(&format!("clavicle_{side}"), turned(Vec3::Z, sign * 0.8 * breath));
        hang_arm(&mut stance, side, sign, turned(Vec3::X, -2.0 - 1.5 * sin), 14.0 + breath);
        // the legs stay where they stand
        stance.set(&format!("thigh_{side}"), turned(Vec3::Z, 0.9 * sin));
        stance.set(&format!("foot_{side}"), turned(Vec3::Z, -0.3 * sin));
    }
    stance.grounded(skeleton, 0.0)
}
