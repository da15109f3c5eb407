//! A bound on how far normals may turn from those of the original.

use glam::{DVec3, Vec3};

use super::legality::Collapse;
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::RingFace;

/// Directions within an angle of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cone {
    axis: Vec3,
    /// In radians; negative: no direction at all.
    angle: f32,
}

/// What rounding may add to an angle.
const ROUNDING: f64 = 1e-6;

impl Cone {
    const EMPTY: Self = Self { axis: Vec3::ZERO, angle: -1.0 };

    fn of(normal: DVec3) -> Self {
        normal.try_normalize().map_or(Self::EMPTY, |axis| Self { axis: axis.as_vec3(), angle: 0.0 })
    }

    fn is_empty(&self) -> bool {
        self.angle < 0.0
    }

    /// A cone around both, the least one of those whose axis lies between the two.
    fn joined(&self, other: &Self) -> Self {
        if self.is_empty() || other.is_empty() {
            return if self.is_empty() { *other } else { *self };
        }
        // as stored they are not quite of length 1, which shows in `across` where the two are nearly opposite
        let (a, b) = (self.axis.as_dvec3().normalize(), other.axis.as_dvec3().normalize());
        let (near, far) = (f64::from(self.angle), f64::from(other.angle));
        let between = angle_between(a, b);
        if between + far <= near {
            return *self;
        }
        if between + near <= far {
            return *other;
        }
        let angle = (near + far + between) / 2.0;
        let across = (b - a * a.dot(b)).normalize_or_zero();
        let turn = angle - near;
        let axis = a * turn.cos() + across * turn.sin();
        Self { axis: axis.as_vec3(), angle: (angle + ROUNDING) as f32 }
    }

    /// The largest angle between a direction and one in the cone.
    fn reach(&self, direction: DVec3) -> f64 {
        angle_between(self.axis.as_dvec3(), direction) + f64::from(self.angle)
    }
}

fn angle_between(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// Of each face, the normals of the original faces that it stands for: the normal cones of Cohen et al. (Simplification
/// Envelopes, 1996; Appearance-Preserving Simplification, 1998), carried along instead of measured anew.
///
/// A face stands for itself. When a collapse takes it, the faces that close the gap stand for all that it stood for: those
/// with an edge from the merged vertex to its apex, in each fan the neighbour; if there are none, all around the merged
/// vertex.
///
/// Guaranteed: no face that a collapse changes has a normal that deviates by more than the bound from that of any
/// original face it stands for, and every original face has one that stands for it, unless its part of the surface
/// has vanished as a whole. Not guaranteed: that the face that stands for a point of the original is the one nearest to it
/// (faces that slide along the surface leave what they stood for).
#[derive(Debug)]
pub(super) struct NormalCones {
    cones: Vec<Cone>,
    /// Largest deviation, in radians.
    most: f64,
}

impl NormalCones {
    pub(super) fn new(mesh: &CollapseMesh, most: f64) -> Self {
        let cone = |face| {
            mesh.face(face).map_or(Cone::EMPTY, |corners| {
                let [a, b, c] = corners.map(|v| mesh.point(v));
                Cone::of((b - a).cross(c - a))
            })
        };
        Self { cones: (0..mesh.face_count()).map(cone).collect(), most }
    }

    /// Whether all faces that a collapse changes stay within the bound.
    pub(super) fn allow(&self, mesh: &CollapseMesh, collapse: &Collapse<'_>) -> bool {
        let target = mesh.frame().enter(collapse.position);
        self.heirs(collapse).all(|(face, cone)| {
            let normal = (mesh.point(face.x) - target).cross(mesh.point(face.y) - target);
            cone.is_empty() || normal != DVec3::ZERO && cone.reach(normal) <= self.most
        })
    }

    /// A collapse is about to be made.
    pub(super) fn commit(&mut self, collapse: &Collapse<'_>) {
        let cones: Vec<(u32, Cone)> = self.heirs(collapse).map(|(face, cone)| (face.face, cone)).collect();
        cones.into_iter().for_each(|(face, cone)| self.cones[face as usize] = cone);
    }

    /// The faces that stay, with the cone of all that they will stand for.
    fn heirs<'a>(&'a self, collapse: &'a Collapse<'_>) -> impl Iterator<Item = (&'a RingFace, Cone)> {
        let star = &collapse.star;
        let staying = move || star.kept_ring.iter().chain(star.removed_ring).filter(move |face| !star.kills(face));
        let apex = |face: &RingFace| if face.x == star.removed { face.y } else { face.x };
        let killed: Vec<(u32, Cone)> = star
            .kept_ring
            .iter()
            .filter(|face| star.kills(face))
            .map(|face| {
                let apex = apex(face);
                let has_heir = staying().any(|heir| heir.x == apex || heir.y == apex);
                // u32::MAX: everyone's
                (if has_heir { apex } else { u32::MAX }, self.cones[face.face as usize])
            })
            .collect();
        staying().map(move |face| {
            let inherits = |&&(apex, _): &&(u32, Cone)| apex == u32::MAX || apex == face.x || apex == face.y;
            let cone =
                killed.iter().filter(inherits).fold(self.cones[face.face as usize], |all, (_, one)| all.joined(one));
            (face, cone)
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0_f64, -1.0..1.0, -1.0..1.0]
            .prop_map(DVec3::from)
            .prop_filter("too short", |v| v.length() > 0.1)
            .prop_map(DVec3::normalize)
    }

    proptest! {
        #[test]
        fn joined_cones_hold_all_that_is_in_either(directions in prop::collection::vec(direction(), 1..12)) {
            let all = directions.iter().fold(Cone::EMPTY, |all, &d| all.joined(&Cone::of(d)));
            for d in directions {
                let off = angle_between(all.axis.as_dvec3(), d);
                prop_assert!(off <= f64::from(all.angle) + 1e-5, "{off} of {}", all.angle);
            }
        }
    }

    #[test]
    fn a_cone_inside_another_adds_nothing() {
        let wide = Cone { axis: Vec3::Z, angle: 1.0 };
        let narrow = Cone { axis: Vec3::new(0.6, 0.0, 0.8), angle: 0.1 };
        assert_eq!((wide.joined(&narrow), narrow.joined(&wide)), (wide, wide));
        assert_eq!((wide.joined(&Cone::EMPTY), Cone::EMPTY.joined(&wide)), (wide, wide));
        assert!((wide.reach(DVec3::X) - std::f64::consts::FRAC_PI_2 - 1.0).abs() < 1e-6);
    }
}
