//! Poses of rigs that come without clips.

use glam::{DQuat, DVec3};

use crate::mesh::mix;

/// Largest turn of a joint.
const LARGEST_TURN: f64 = std::f64::consts::FRAC_PI_3;
/// Share of the morph targets that are on in a pose.
const SHARE_ON: f64 = 0.25;

/// Poses that a rig may take, for one that comes without clips: each joint is turned from where it rests, each
/// about an axis of its own, by up to 60 degrees; and some of the morph targets are on.
///
/// The same number gives the same pose, always.
///
/// # Examples
/// ```
/// let pose = maille::skin::MadeUpPose(3);
/// assert_eq!(pose.turn(7), maille::skin::MadeUpPose(3).turn(7));
/// assert_ne!(pose.turn(7), pose.turn(8));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MadeUpPose(
    /// Which of all.
    pub u64,
);

impl MadeUpPose {
    /// How far a joint is turned about its own origin, in its own space.
    pub fn turn(self, joint: usize) -> DQuat {
        let [x, y, z] = [0, 1, 2].map(|axis| self.random(joint, axis));
        // even over the sphere (Archimedes)
        let (height, around) = (2.0 * x - 1.0, std::f64::consts::TAU * y);
        let flat = (1.0 - height * height).sqrt();
        let axis = DVec3::new(flat * around.cos(), flat * around.sin(), height);
        DQuat::from_axis_angle(axis, LARGEST_TURN * z)
    }

    /// How far a morph target is on, of those of an object.
    pub fn morph_weight(self, object: usize, target: usize) -> f64 {
        let [is_on, weight] = [0, 1].map(|which| self.random(object, 3 + 2 * target as u64 + which));
        if is_on < SHARE_ON { 0.5 + 0.5 * weight } else { 0.0 }
    }

    /// Evenly between 0 and 1.
    fn random(self, object: usize, which: u64) -> f64 {
        let bits = mix(mix(mix(self.0, object as u64), which), 0x9e37_79b9_7f4a_7c15);
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_even_and_limited() {
        let turns: Vec<DQuat> = (0..4000).map(|i| MadeUpPose(i % 40).turn(i as usize / 40)).collect();
        let mean: DVec3 = turns.iter().map(|q| q.to_scaled_axis()).sum::<DVec3>() / turns.len() as f64;
        assert!(mean.length() < 0.03, "no direction is preferred: {mean}");
        let angles: Vec<f64> = turns.iter().map(|q| q.to_axis_angle().1).collect();
        assert!(angles.iter().all(|&angle| angle <= LARGEST_TURN + 1e-9));
        let mean = angles.iter().sum::<f64>() / angles.len() as f64;
        assert!((mean / LARGEST_TURN - 0.5).abs() < 0.02, "{mean}");
    }

    #[test]
    fn a_quarter_of_the_morph_targets_is_on() {
        let weights: Vec<f64> = (0..4000).map(|i| MadeUpPose(i / 50).morph_weight(0, i as usize % 50)).collect();
        let on = weights.iter().filter(|&&weight| weight > 0.0).count();
        assert!((900..1100).contains(&on), "{on}");
        assert!(weights.iter().all(|&weight| weight == 0.0 || (0.5..=1.0).contains(&weight)));
    }
}
