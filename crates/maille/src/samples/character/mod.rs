//! A person who walks: mesh, skeleton, weights and clips.

mod body;
mod gait;
mod paint;
mod rig;
mod weights;

use glam::Vec3;
use rayon::prelude::*;

use self::body::Body;
use super::isosurface::{Isosurface, Surface};
use crate::Mesh;
use crate::mesh::{Attribute, Semantic};
use crate::skin::{Clip, Skeleton};

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

/// A person of about `triangles` triangles (at least some 4,000), 1.77 m tall: a closed manifold, arms half raised.
///
/// Normals, vertex colours (linear: skin, hair, shirt, trousers, shoes), and at most four joints to a vertex whose
/// weights sum to exactly 1. The skeleton has 28 joints; the clips "walk", "run" and "idle" loop in place.
///
/// Hands and face have smaller triangles than the rest.
pub fn character(triangles: usize) -> Character {
    let skeleton = rig::skeleton();
    let body = Body::new();
    let mesh = skinned_mesh(&body, triangles.max(4000));
    let clips = gait::clips(&skeleton);
    Character { mesh, skeleton, clips, texture_png: None }
}

fn skinned_mesh(body: &Body, triangles: usize) -> Mesh {
    let mut surface = extract(body, triangles);
    relax(body, &mut surface);
    paint::snap_to_borders(body, &mut surface);
    let normal = |&p: &[f32; 3]| gradient(body, p.into()).normalize().to_array();
    let normals: Vec<[f32; 3]> = surface.positions.par_iter().map(normal).collect();
    let (joints, weights) = weights::weights(body, &surface);
    let painted = paint::paint(body, &surface);
    let wedges = painted.wedge_vertices;
    let normals = Attribute::new_f32(Semantic::Normal, 3, per_wedge(&wedges, &normals));
    let colors = Attribute::new_f32(Semantic::Color(0), 3, painted.colors.into_flattened());
    let joints = Attribute::new_u32(Semantic::Joints(0), 4, per_wedge(&wedges, &joints));
    let weights = Attribute::new_f32(Semantic::Weights(0), 4, per_wedge(&wedges, &weights));
    Mesh {
        positions: surface.positions,
        triangles: painted.triangles,
        wedge_attributes: vec![normals, colors, joints, weights],
        wedge_vertices: wedges,
        ..Mesh::default()
    }
}

/// The values of the wedges' vertices, one after the other.
fn per_wedge<T: Copy, const N: usize>(wedge_vertices: &[u32], values: &[[T; N]]) -> Vec<T> {
    wedge_vertices.iter().flat_map(|&vertex| values[vertex as usize]).collect()
}

/// Extracts the surface in a space where hands and head are larger, and takes it back.
fn extract(body: &Body, triangles: usize) -> Surface {
    let distance = |p: Vec3| body.distance(lens::to_body(p)) / lens::STRETCH;
    let (low, high) = (Vec3::new(-0.85, -0.02, -0.25), Vec3::new(0.85, 1.82, 0.30));
    let mut surface = Isosurface { distance, low, high, noise: 0.0 }.with_triangles(triangles);
    for p in &mut surface.positions {
        *p = lens::to_body((*p).into()).to_array();
    }
    surface
}

/// Evens out the triangles: vertices slide towards the middle of their neighbours, on the surface.
fn relax(body: &Body, surface: &mut Surface) {
    const ROUNDS: usize = 6;
    let neighbours = Neighbours::new(surface);
    for _ in 0..ROUNDS {
        let positions = &surface.positions;
        let slid = |v: usize| {
            let p = Vec3::from(positions[v]);
            let ring = neighbours.of(v);
            let sum: Vec3 = ring.iter().map(|&w| Vec3::from(positions[w as usize])).sum();
            let normal = gradient(body, p).normalize_or_zero();
            let way = sum / ring.len() as f32 - p;
            onto_surface(body, p + 0.6 * (way - normal * normal.dot(way))).to_array()
        };
        surface.positions = (0..positions.len()).into_par_iter().map(slid).collect();
    }
}

/// The nearby point of the surface, by two Newton steps along the gradient.
fn onto_surface(body: &Body, mut p: Vec3) -> Vec3 {
    for _ in 0..2 {
        let slope = gradient(body, p);
        let back = body.distance(p) / slope.length_squared().max(0.25);
        p -= slope * back.clamp(-0.01, 0.01);
    }
    p
}

/// Gradient of the distance by central differences.
fn gradient(body: &Body, p: Vec3) -> Vec3 {
    const STEP: f32 = 1e-3;
    let along = |axis: Vec3| (body.distance(p + axis * STEP) - body.distance(p - axis * STEP)) / (2.0 * STEP);
    Vec3::new(along(Vec3::X), along(Vec3::Y), along(Vec3::Z))
}

/// The vertices around each vertex.
struct Neighbours {
    starts: Vec<u32>,
    around: Vec<u32>,
}

impl Neighbours {
    /// Of a closed surface: each edge is seen once from either end.
    fn new(surface: &Surface) -> Self {
        let mut starts = vec![0_u32; surface.positions.len() + 1];
        for &[a, b, c] in &surface.triangles {
            for v in [a, b, c] {
                starts[v as usize + 1] += 1;
            }
        }
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        let mut places = starts.clone();
        let mut around = vec![0; 3 * surface.triangles.len()];
        for &[a, b, c] in &surface.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                around[places[from as usize] as usize] = to;
                places[from as usize] += 1;
            }
        }
        Self { starts, around }
    }

    fn of(&self, vertex: usize) -> &[u32] {
        &self.around[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

/// The space in which the surface is extracted: it shows hands and head larger, so that they get smaller triangles.
mod lens {
    use glam::Vec3;

    /// Most that a distance grows from extraction space to the body's.
    pub(super) const STRETCH: f32 = 2.4;
    /// Centre (left side), radius, and how much smaller than elsewhere cells are at the centre.
    const LENSES: [(Vec3, f32, f32); 2] =
        [(Vec3::new(0.605, 0.985, 0.020), 0.21, 0.42), (Vec3::new(0.0, 1.640, 0.060), 0.25, 0.30)];

    /// From extraction space to the body's: identity outside the lenses, and continuous.
    pub(super) fn to_body(p: Vec3) -> Vec3 {
        let m = Vec3::new(p.x.abs(), p.y, p.z);
        for (centre, radius, scale) in LENSES {
            let from = m - centre;
            let share = from.length_squared() / (radius * radius);
            if share < 1.0 {
                let q = centre + from * (scale + (1.0 - scale) * share);
                return Vec3::new(q.x.copysign(p.x), q.y, q.z);
            }
        }
        p
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::samples::testing;
    use crate::skin::Keys;

    #[test]
    fn character_is_one_closed_manifold_of_the_size_asked_for() {
        for wanted in [12_000, 30_000] {
            let mesh = skinned_mesh(&Body::new(), wanted);
            mesh.check().unwrap();
            assert!(mesh.triangle_count().abs_diff(wanted) <= wanted / 10, "{}", mesh.triangle_count());
            let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
            testing::assert_closed_manifold(&triangles);
            assert_eq!(testing::euler(&triangles), 2, "neither handles nor crumbs");
            let litres = 1e3 * testing::volume(&mesh.positions, &triangles);
            assert!((50.0..110.0).contains(&litres), "{litres} l");
        }
    }

    #[test]
    fn weights_sum_to_one_and_name_joints() {
        let character = character(10_000);
        let joints = character.mesh.wedge_attribute(&Semantic::Joints(0)).unwrap().as_u32().unwrap();
        let weights = character.mesh.wedge_attribute(&Semantic::Weights(0)).unwrap().as_f32().unwrap();
        assert!(character.skeleton.joints.len() >= 20);
        assert!(joints.iter().all(|&joint| (joint as usize) < character.skeleton.joints.len()));
        for (i, set) in weights.chunks_exact(4).enumerate() {
            assert_eq!(set.iter().sum::<f32>(), 1.0);
            assert!(set.iter().all(|w| (0.0..=1.0).contains(w)));
            // a joint is named once, and unused places name joint 0
            for k in 0..4 {
                let joint = joints[4 * i + k];
                assert!(set[k] > 0.0 || joint == 0);
                assert!((0..k).all(|j| set[j] == 0.0 || set[k] == 0.0 || joints[4 * i + j] != joint));
            }
        }
    }

    #[test]
    fn limbs_leave_the_torso_and_the_other_side_alone() {
        let character = character(10_000);
        let joints = character.mesh.wedge_attribute(&Semantic::Joints(0)).unwrap().as_u32().unwrap();
        let weights = character.mesh.wedge_attribute(&Semantic::Weights(0)).unwrap().as_f32().unwrap();
        for (i, &vertex) in character.mesh.wedge_vertices.iter().enumerate() {
            let p = character.mesh.positions[vertex as usize];
            for k in (4 * i..4 * i + 4).filter(|&k| weights[k] > 0.05) {
                let name = &character.skeleton.joints[joints[k] as usize].name;
                let is_limb = ["arm", "hand", "finger", "thumb", "thigh", "shin", "foot", "toe"]
                    .iter()
                    .any(|part| name.contains(part));
                if is_limb {
                    let side = if name.ends_with("_l") { p[0] } else { -p[0] };
                    assert!(side > -0.035, "{name} moves {p:?}");
                }
                if name.contains("arm") || name.contains("hand") {
                    assert!(p[0].abs() > 0.06, "{name} moves {p:?}");
                }
            }
        }
    }

    #[test]
    fn clips_loop_and_keep_the_feet_on_the_ground() {
        let skeleton = rig::skeleton();
        let clips = gait::clips(&skeleton);
        assert_eq!(clips.iter().map(|clip| clip.name.as_str()).collect::<Vec<_>>(), ["walk", "run", "idle"]);
        for clip in &clips {
            for channel in &clip.channels {
                assert!(channel.times.len() >= 24 && channel.times.is_sorted());
                match &channel.keys {
                    Keys::Translation(keys) | Keys::Scale(keys) => assert_eq!(keys.first(), keys.last()),
                    Keys::Rotation(keys) => {
                        assert_eq!(keys.first(), keys.last());
                        assert!(keys.iter().all(|q| (q.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-5));
                    }
                    Keys::Weights(_) => panic!("the body has no morph targets"),
                }
            }
            let lowest: Vec<f64> =
                (0..48).map(|i| rig::lowest_point(&skeleton.posed(clip, clip.end() * f64::from(i) / 48.0))).collect();
            let (least, most) =
                (lowest.iter().copied().fold(1.0, f64::min), lowest.iter().copied().fold(0.0, f64::max));
            assert!(least > -0.012, "{} sinks {least}", clip.name);
            assert_eq!(most > 0.03, clip.name == "run", "{} flies {most}", clip.name);
        }
    }

    #[test]
    fn both_feet_swing_forward_in_turn() {
        let skeleton = rig::skeleton();
        let clips = gait::clips(&skeleton);
        let foot = |name: &str, share: f64| {
            let posed = skeleton.posed(&clips[0], clips[0].end() * share);
            let joint = skeleton.joints.iter().position(|joint| joint.name == name).unwrap();
            posed.world_matrices()[joint].transform_point3(DVec3::ZERO).z
        };
        for share in [0.0, 0.2, 0.4] {
            // the gait is symmetric: half a cycle later the other foot is where this one was
            assert!((foot("foot_l", share) - foot("foot_r", share + 0.5)).abs() < 0.01);
        }
        assert!(foot("foot_l", 0.0) > foot("foot_r", 0.0) + 0.3);
    }
}
