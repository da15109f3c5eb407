//! Skeletons and the clips that move them.
//!
//! Plain data in the terms of glTF: a joint stands where its translation, rotation and scale put it within its parent's
//! space; a mesh refers to joints by index in its [`Joints`](crate::Semantic::Joints) attributes. What moves is computed
//! in double precision.

mod choice;
mod made_up;
mod pose;

pub use choice::PoseChoice;
pub use made_up::MadeUpPose;
pub use pose::{Influences, Pose};

use glam::{DMat4, DQuat, DVec3};

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

/// One property of one joint over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Index of the joint.
    pub joint: usize,
    /// Times of the keys in seconds, ascending.
    pub times: Vec<f32>,
    /// The way from each key to the next.
    pub interpolation: Interpolation,
    /// The property at each time.
    pub keys: Keys,
}

/// The way from a key to the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Each key holds until the next one.
    Step,
    /// A straight line; for rotations the shortest arc, at constant speed.
    #[default]
    Linear,
    /// A cubic Hermite spline. To each time belong three entries of the keys: the tangent at which the curve arrives (per
    /// second), the value, and the tangent at which it leaves. Rotations are made unit afterwards.
    CubicSpline,
}

impl Interpolation {
    /// Entries of the keys that belong to one time.
    pub fn entries(self) -> usize {
        if self == Self::CubicSpline { 3 } else { 1 }
    }
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
    /// How far each morph target is on, of the mesh that hangs on the joint; all targets of the first entry, then all of
    /// the second.
    Weights(Vec<f32>),
}

impl Keys {
    /// Which property it is, as a number.
    pub fn number(&self) -> usize {
        match self {
            Self::Translation(_) => 0,
            Self::Rotation(_) => 1,
            Self::Scale(_) => 2,
            Self::Weights(_) => 3,
        }
    }
}

/// An animated property at one time.
#[derive(Debug, Clone, PartialEq)]
pub enum Property {
    /// As [`Joint::translation`].
    Translation(DVec3),
    /// As [`Joint::rotation`], of unit length.
    Rotation(DQuat),
    /// As [`Joint::scale`].
    Scale(DVec3),
    /// Of each morph target.
    Weights(Vec<f64>),
}

impl Property {
    /// The middle of the range that some values of one property lie in: of each number, that between its extremes; of
    /// rotations, half way between the two that seem farthest apart. `None` if there are none.
    pub fn middle(values: &[Self]) -> Option<Self> {
        let rotations =
            || values.iter().filter_map(|value| if let Self::Rotation(q) = value { Some(*q) } else { None });
        let vectors = || {
            values.iter().filter_map(|value| match value {
                Self::Translation(v) | Self::Scale(v) => Some(*v),
                _ => None,
            })
        };
        let centre = |vectors: &mut dyn Iterator<Item = DVec3>| {
            let (low, high) = vectors.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            (low + high) / 2.0
        };
        Some(match values.first()? {
            Self::Translation(_) => Self::Translation(centre(&mut vectors())),
            Self::Scale(_) => Self::Scale(centre(&mut vectors())),
            Self::Rotation(first) => {
                let farthest_from = |q: DQuat| rotations().min_by(|a, b| q.dot(*a).abs().total_cmp(&q.dot(*b).abs()));
                let one = farthest_from(*first)?;
                let other = farthest_from(one)?;
                Self::Rotation(one.slerp(other, 0.5))
            }
            Self::Weights(first) => {
                let of = |target: usize| {
                    let weights = values.iter().filter_map(move |value| match value {
                        Self::Weights(weights) => weights.get(target).copied(),
                        _ => None,
                    });
                    let (low, high) =
                        weights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), w| (l.min(w), h.max(w)));
                    (low + high) / 2.0
                };
                Self::Weights((0..first.len()).map(of).collect())
            }
        })
    }
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
    pub fn posed(&self, clip: &Clip, seconds: f64) -> Self {
        let mut posed = self.clone();
        for channel in &clip.channels {
            let joint = &mut posed.joints[channel.joint];
            match channel.at(seconds) {
                Some(Property::Translation(at)) => joint.translation = at.as_vec3().to_array(),
                Some(Property::Rotation(at)) => joint.rotation = at.as_quat().to_array(),
                Some(Property::Scale(at)) => joint.scale = at.as_vec3().to_array(),
                // a skeleton has no meshes
                Some(Property::Weights(_)) | None => {}
            }
        }
        posed
    }
}

impl Clip {
    /// Time of the first key, in seconds; 0 without keys.
    pub fn start(&self) -> f64 {
        self.channels.iter().filter_map(|channel| channel.times.first()).copied().reduce(f32::min).unwrap_or(0.0).into()
    }

    /// Time of the last key, in seconds; 0 without keys.
    pub fn end(&self) -> f64 {
        self.channels.iter().filter_map(|channel| channel.times.last()).copied().reduce(f32::max).unwrap_or(0.0).into()
    }
}

impl Channel {
    /// The property at a time; before the first key and after the last one, those hold. `None` without keys.
    ///
    /// # Panics
    /// If there are fewer keys than times.
    pub fn at(&self, seconds: f64) -> Option<Property> {
        let moment = self.moment(seconds)?;
        Some(match &self.keys {
            Keys::Translation(keys) => Property::Translation(self.vector(keys, &moment)),
            Keys::Scale(keys) => Property::Scale(self.vector(keys, &moment)),
            Keys::Rotation(keys) => Property::Rotation(self.rotation(keys, &moment)),
            Keys::Weights(keys) => {
                let targets = keys.len() / (self.times.len() * self.interpolation.entries());
                let weight = |target| self.number(&moment, |entry| keys[entry * targets + target]);
                Property::Weights((0..targets).map(weight).collect())
            }
        })
    }

    fn moment(&self, seconds: f64) -> Option<Moment> {
        let last = self.times.len().checked_sub(1)?;
        let passed = self.times.partition_point(|&time| f64::from(time) <= seconds);
        let (low, high) = (passed.saturating_sub(1), passed.min(last));
        let span = f64::from(self.times[high]) - f64::from(self.times[low]);
        let share = if span > 0.0 { (seconds - f64::from(self.times[low])) / span } else { 0.0 };
        Some(Moment { low, high, span, share })
    }

    fn vector(&self, keys: &[[f32; 3]], moment: &Moment) -> DVec3 {
        DVec3::from([0, 1, 2].map(|axis| self.number(moment, |entry| keys[entry][axis])))
    }

    fn rotation(&self, keys: &[[f32; 4]], moment: &Moment) -> DQuat {
        // keys of few bits miss unit length by their rounding
        let unit = |q: [f64; 4]| normalized(DQuat::from_array(q));
        match self.interpolation {
            Interpolation::Linear => {
                let [from, to] = [moment.low, moment.high].map(|key| unit(keys[key].map(f64::from)));
                from.slerp(to, moment.share)
            }
            _ => unit([0, 1, 2, 3].map(|axis| self.number(moment, |entry| keys[entry][axis]))),
        }
    }

    /// One number of the property, by its entries in the keys.
    fn number(&self, moment: &Moment, entry: impl Fn(usize) -> f32) -> f64 {
        let &Moment { low, high, span, share: t } = moment;
        let entry = |number: usize| f64::from(entry(number));
        match self.interpolation {
            Interpolation::Step => entry(low),
            Interpolation::Linear => (1.0 - t) * entry(low) + t * entry(high),
            Interpolation::CubicSpline => {
                let (leaving, arriving) = (span * entry(3 * low + 2), span * entry(3 * high));
                let near_low = (1.0 - t) * (1.0 - t) * ((1.0 + 2.0 * t) * entry(3 * low + 1) + t * leaving);
                near_low + t * t * ((3.0 - 2.0 * t) * entry(3 * high + 1) - (1.0 - t) * arriving)
            }
        }
    }
}

/// Where a time lies among the keys.
struct Moment {
    /// The last key that is not after the time, and the next one; the same outside the keys.
    low: usize,
    high: usize,
    /// Seconds from one to the other.
    span: f64,
    /// Share of the way that has passed.
    share: f64,
}

/// The unit quaternion of a rotation; none for one without direction.
fn normalized(rotation: DQuat) -> DQuat {
    if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY }
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    fn arm() -> Skeleton {
        let joint = |parent, translation| Joint { parent, translation, ..Joint::default() };
        // the child stands before its parent in the list
        Skeleton { joints: vec![joint(Some(1), [1.0, 0.0, 0.0]), joint(None, [0.0, 2.0, 0.0])] }
    }

    fn turn(times: &[f32], angles: &[f32]) -> Clip {
        let keys = Keys::Rotation(angles.iter().map(|&a| Quat::from_rotation_z(a).to_array()).collect());
        Clip { name: "turn".into(), channels: vec![channel(times, Interpolation::Linear, keys)] }
    }

    fn channel(times: &[f32], interpolation: Interpolation, keys: Keys) -> Channel {
        Channel { joint: 1, times: times.to_vec(), interpolation, keys }
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
        assert_eq!((clip.start(), clip.end()), (0.5, 0.5));
    }

    #[test]
    fn steps_hold_until_the_next_key() {
        let keys = Keys::Scale(vec![[1.0; 3], [2.0; 3], [3.0; 3]]);
        let channel = channel(&[1.0, 2.0, 3.0], Interpolation::Step, keys);
        let at = |seconds| channel.at(seconds);
        for (seconds, scale) in [(0.0, 1.0), (1.9, 1.0), (2.0, 2.0), (2.9, 2.0), (3.0, 3.0), (9.0, 3.0)] {
            assert_eq!(at(seconds), Some(Property::Scale(DVec3::splat(scale))), "at {seconds} s");
        }
    }

    #[test]
    fn a_cubic_spline_is_exact_for_cubics() {
        // x = t^3 - 2 t, with its derivative, at keys that are unevenly apart
        let times = [0.0, 0.5, 2.0_f32];
        let (x, slope) = (|t: f32| t * t * t - 2.0 * t, |t: f32| 3.0 * t * t - 2.0);
        let entries: Vec<[f32; 3]> = times.iter().flat_map(|&t| [slope(t), x(t), slope(t)].map(|v| [v; 3])).collect();
        let moving = channel(&times, Interpolation::CubicSpline, Keys::Translation(entries.clone()));
        let weights = entries.iter().flat_map(|&[v, ..]| [v, 2.0 * v]).collect();
        let morphing = channel(&times, Interpolation::CubicSpline, Keys::Weights(weights));
        for i in 0..=20 {
            let t = f64::from(i) / 10.0;
            let expected = t * t * t - 2.0 * t;
            let (Some(Property::Translation(at)), Some(Property::Weights(on))) = (moving.at(t), morphing.at(t)) else {
                panic!("the properties are not those of the keys");
            };
            assert!((at - DVec3::splat(expected)).length() < 1e-12, "{at} at {t} s");
            assert!((on[0] - expected).abs() < 1e-12 && (on[1] - 2.0 * expected).abs() < 1e-12);
        }
    }

    #[test]
    fn rotations_are_unit_whatever_the_keys_are() {
        let lengths = |interpolation, keys| {
            let channel = channel(&[0.0, 1.0], interpolation, Keys::Rotation(keys));
            let length = |i| match channel.at(f64::from(i) / 4.0) {
                Some(Property::Rotation(rotation)) => rotation.length(),
                _ => f64::NAN,
            };
            (0..=4).map(length).collect::<Vec<f64>>()
        };
        let quarter = [[0.0; 4], [0.0, 0.0, 0.0, 2.0], [0.0; 4], [0.0; 4], [0.0, 3.0, 0.0, 0.0], [0.0; 4]];
        for lengths in [
            lengths(Interpolation::CubicSpline, quarter.to_vec()),
            lengths(Interpolation::Linear, vec![quarter[1], quarter[4]]),
            lengths(Interpolation::Step, vec![quarter[1], [0.0; 4]]),
        ] {
            assert!(lengths.iter().all(|length| (length - 1.0).abs() < 1e-12), "{lengths:?}");
        }
    }

    #[test]
    fn keys_at_equal_times_are_a_jump() {
        let keys = Keys::Translation(vec![[0.0; 3], [1.0; 3], [5.0; 3], [6.0; 3]]);
        let channel = channel(&[0.0, 1.0, 1.0, 2.0], Interpolation::Linear, keys);
        assert_eq!(channel.at(0.5), Some(Property::Translation(DVec3::splat(0.5))));
        assert_eq!(channel.at(1.0), Some(Property::Translation(DVec3::splat(5.0))));
        assert_eq!(Channel { times: vec![], ..channel }.at(1.0), None);
    }
}
