//! Plain data of an animated character.

use crate::Mesh;

/// A skinned mesh that can move.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Character {
    /// The surface in its rest pose, in model space, with joints and weights.
    pub mesh: Mesh,
    /// What moves it; the joint attributes of the mesh are indices into it.
    pub skeleton: Skeleton,
    /// Its movements.
    pub clips: Vec<Clip>,
    /// Colour over texture coordinate set 0, a PNG file.
    pub texture_png: Option<Vec<u8>>,
}

/// A hierarchy of joints.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Skeleton {
    /// The joints, in any order.
    pub joints: Vec<Joint>,
}

/// A joint at rest, relative to its parent: first scaled, then rotated, then moved.
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
