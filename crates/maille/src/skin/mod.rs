//! Skeletons and the clips that move them.
//!
//! Plain data in the terms of glTF: a joint stands where its translation, rotation and scale put it within its parent's
//! space; a mesh refers to joints by index in its [`Joints`](crate::Semantic::Joints) attributes. What moves is computed
//! in double precision.

use glam::{DMat4, DQuat, DVec3, Quat, Vec3};

/// A hierarchy of joints.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Skeleton {
    /// The joints, in any order.
    pub joints: Vec<Joint>,
}

/// A joint relative to its parent: first scaled, then rotated, then moved.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// The joint that it hangs on, `None` for a root.
    pub parent: Option<usize>,
    /// Where it is, in model units.
    pub translation: [f32; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Factors along the axes.
    pub scale: [f32; 3],
}

/// A movement.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Clip {
    /// Its name.
    pub name: String,
    /// What moves; what no channel names rests.
    pub channels: Vec<Channel>,
}

/// One property of one joint over time, interpolated linearly (rotations: on the shortest arc).
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Index of the joint.
    pub joint: usize,
    /// Times of the keys in seconds, ascending.
    pub times: Vec<f32>,
    /// The property at each time.
    pub keys: Keys,
}

/// Values of an animated property, in place of those at rest.
#[derive(Debug, Clone, PartialEq)]
pub enum Keys {
    /// As [`Joint::translation`].
    Translation(Vec<[f32; 3]>),
    /// As [`Joint::rotation`].
    Rotation(Vec<[f32; 4]>),
    /// As [`Joint::scale`].
    Scale(Vec<[f32; 3]>),
}

impl Default for Joint {
    fn default() -> Self {
        Self {
            name: String::new(),
            parent: None,
            translation: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            scale: [1.0; 3],
        }
    }
}

impl Joint {
    /// From its own space to its parent's.
    pub fn matrix(&self) -> DMat4 {
        let rotation = DQuat::from_array(self.rotation.map(f64::from));
        let [scale, translation] = [self.scale, self.translation].map(|v| DVec3::from(v.map(f64::from)));
        DMat4::from_scale_rotation_translation(scale, rotation, translation)
    }
}

impl Skeleton {
    /// From each joint's space to the world's.
    ///
    /// # Panics
    /// If a joint's parent does not exist or a joint is its own ancestor.
    pub fn world_matrices(&self) -> Vec<DMat4> {
        let mut worlds: Vec<Option<DMat4>> = vec![None; self.joints.len()];
        for joint in 0..self.joints.len() {
            // up to a root or to what is known, then down again
            let mut chain = Vec::new();
            let mut next = Some(joint);
            while let Some(at) = next.filter(|&at| worlds[at].is_none()) {
                assert!(chain.len() < self.joints.len(), "joint {joint} is its own ancestor");
                chain.push(at);
                next = self.joints[at].parent;
            }
            let mut world = next.and_then(|at| worlds[at]).unwrap_or(DMat4::IDENTITY);
            for at in chain.into_iter().rev() {
                world *= self.joints[at].matrix();
                worlds[at] = Some(world);
            }
        }
        worlds.into_iter().map(|world| world.expect("every joint was visited")).collect()
    }

    /// From the model's space to each joint's at rest: the inverses of [`world_matrices`](Self::world_matrices).
    ///
    /// # Panics
    /// As [`world_matrices`](Self::world_matrices).
    pub fn inverse_bind_matrices(&self) -> Vec<DMat4> {
        self.world_matrices().iter().map(DMat4::inverse).collect()
    }

    /// The skeleton as a clip holds it at a time; before the first key and after the last one, those hold.
    ///
    /// # Panics
    /// If a channel names a joint that does not exist or has another number of keys than of times.
    #[must_use]
    pub fn posed(&self, clip: &Clip, seconds: f32) -> Self {
        let mut posed = self.clone();
        for channel in clip.channels.iter().filter(|channel| !channel.times.is_empty()) {
            let joint = &mut posed.joints[channel.joint];
            let (low, high, t) = channel.between(seconds);
            let linear = |keys: &[[f32; 3]]| Vec3::from(keys[low]).lerp(Vec3::from(keys[high]), t).to_array();
            match &channel.keys {
                Keys::Translation(keys) => joint.translation = linear(keys),
                Keys::Scale(keys) => joint.scale = linear(keys),
                Keys::Rotation(keys) => {
                    let [from, to] = [low, high].map(|key| Quat::from_array(keys[key]));
                    joint.rotation = from.slerp(to, t).to_array();
                }
            }
        }
        posed
    }
}

impl Clip {
    /// Time of the last key, in seconds; 0 without keys.
    pub fn duration(&self) -> f32 {
        self.channels.iter().filter_map(|channel| channel.times.last()).fold(0.0, |last, &time| last.max(time))
    }
}

impl Channel {
    /// The keys before and after a time, and the share of the way from one to the other.
    fn between(&self, seconds: f32) -> (usize, usize, f32) {
        let last = self.times.len() - 1;
        let high = self.times.partition_point(|&time| time <= seconds).clamp(1.min(last), last);
        let low = high.saturating_sub(1);
        let span = self.times[high] - self.times[low];
        let t = if span > 0.0 { ((seconds - self.times[low]) / span).clamp(0.0, 1.0) } else { 0.0 };
        (low, high, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> Skeleton {
        let joint = |parent, translation| Joint { parent, translation, ..Joint::default() };
        // the child stands before its parent in the list
        Skeleton { joints: vec![joint(Some(1), [1.0, 0.0, 0.0]), joint(None, [0.0, 2.0, 0.0])] }
    }

    fn turn(times: &[f32], angles: &[f32]) -> Clip {
        let keys = Keys::Rotation(angles.iter().map(|&a| Quat::from_rotation_z(a).to_array()).collect());
        Clip { name: "turn".into(), channels: vec![Channel { joint: 1, times: times.to_vec(), keys }] }
    }

    #[test]
    fn children_follow_their_parents() {
        let skeleton = arm();
        let tip = |seconds| {
            let clip = turn(&[1.0, 2.0], &[0.0, std::f32::consts::FRAC_PI_2]);
            skeleton.posed(&clip, seconds).world_matrices()[0].transform_point3(DVec3::ZERO)
        };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(tip(0.0).distance(DVec3::new(1.0, 2.0, 0.0)) < 1e-6);
        assert!(tip(1.5).distance(DVec3::new(half, 2.0 + half, 0.0)) < 1e-6);
        assert!(tip(9.0).distance(DVec3::new(0.0, 3.0, 0.0)) < 1e-6);
    }

    #[test]
    fn rotations_take_the_shortest_arc() {
        // the second key is the same as a small negative angle, written with the opposite sign
        let mut clip = turn(&[0.0, 1.0], &[0.2, -0.2]);
        let Keys::Rotation(keys) = &mut clip.channels[0].keys else { unreachable!() };
        keys[1] = keys[1].map(|c| -c);
        let tip = arm().posed(&clip, 0.5).world_matrices()[0].transform_point3(DVec3::ZERO);
        assert!(tip.distance(DVec3::new(1.0, 2.0, 0.0)) < 1e-6);
    }

    #[test]
    fn inverse_binds_undo_the_rest_pose() {
        let skeleton = arm();
        for (world, inverse) in skeleton.world_matrices().iter().zip(skeleton.inverse_bind_matrices()) {
            assert!((*world * inverse).abs_diff_eq(DMat4::IDENTITY, 1e-12));
        }
    }

    #[test]
    #[should_panic(expected = "its own ancestor")]
    fn a_cycle_of_joints_is_refused() {
        let mut skeleton = arm();
        skeleton.joints[1].parent = Some(0);
        skeleton.world_matrices();
    }

    #[test]
    fn one_key_holds_for_ever() {
        let clip = turn(&[0.5], &[0.3]);
        assert_eq!(arm().posed(&clip, 0.0), arm().posed(&clip, 7.0));
        assert_eq!(clip.duration(), 0.5);
    }
}
