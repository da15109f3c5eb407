use glam::DQuat;

use super::posed::*;
use super::*;
use crate::mesh::{Attribute, Semantic};
use crate::simplify::{SimplifyOptions, Target, simplify};
use crate::skin::{Influences, Pose};

/// A bent arm: a tube along x whose far half follows a second joint at the middle, with soft weights in between.
fn arm() -> Mesh {
    let (rings, around) = (60_u32, 24_u32);
    let mut mesh = Mesh::default();
    let mut weights = Vec::new();
    for i in 0..=rings {
        for j in 0..around {
            let x = 4.0 * i as f32 / rings as f32 - 2.0;
            let angle = std::f32::consts::TAU * j as f32 / around as f32;
            let radius = 0.4 + 0.05 * (3.0 * angle + x).sin();
            mesh.positions.push([x, radius * angle.cos(), radius * angle.sin()]);
            let far = ((x + 0.5) / 1.0).clamp(0.0, 1.0);
            weights.extend([1.0 - far, far, 0.0, 0.0]);
        }
    }
    for i in 0..rings {
        for j in 0..around {
            let [a, b] = [i * around + j, i * around + (j + 1) % around];
            mesh.triangles.extend([[a, b, a + around], [a + around, b, b + around]]);
        }
    }
    mesh.wedge_vertices = (0..mesh.positions.len() as u32).collect();
    let joints = [0, 1, 0, 0].repeat(mesh.positions.len());
    mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Joints(0), 4, joints));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Weights(0), 4, weights));
    mesh
}

/// The second joint turned by some angles.
fn bent(angles: &[f64]) -> Vec<Pose> {
    let pose = |&angle: &f64| Pose {
        joint_matrices: vec![glam::DMat4::IDENTITY, glam::DMat4::from_quat(DQuat::from_rotation_z(angle))],
        ..Pose::default()
    };
    angles.iter().map(pose).collect()
}

fn simplified(mesh: &Mesh, triangles: usize, poses: &[Pose]) -> Mesh {
    let target = Target { triangles: Some(triangles), ..Target::default() };
    let options = SimplifyOptions { target, poses: poses.to_vec(), ..SimplifyOptions::default() };
    let mut result = mesh.clone();
    simplify(&mut result, &options, Control::default()).expect("the options make sense");
    result
}

/// Root mean square distance in poses that were not looked at.
fn unseen(original: &Mesh, mesh: &Mesh) -> f64 {
    use crate::measure::{CompareOptions, compare};
    let poses = bent(&[0.4, 0.9, 1.3, -0.7]);
    let posed = |mesh: &Mesh, pose: &Pose| {
        let maps = pose.vertex_maps(mesh);
        let mut posed = mesh.clone();
        for (p, map) in posed.positions.iter_mut().zip(maps) {
            *p = map.transform_point3(glam::Vec3::from(*p).as_dvec3()).as_vec3().to_array();
        }
        posed
    };
    let options = CompareOptions { samples: 20_000, ..CompareOptions::default() };
    let error = |pose: &Pose| {
        let compared = compare(&posed(original, pose), &posed(mesh, pose), &options, Control::default());
        let compared = compared.expect("there are triangles");
        compared.forward.rms.max(compared.backward.rms)
    };
    (poses.iter().map(|pose| error(pose).powi(2)).sum::<f64>() / poses.len() as f64).sqrt()
}

#[test]
fn poses_and_fitting_bring_a_bending_arm_nearer() {
    let original = arm();
    let poses = bent(&[0.0, 0.6, 1.1, 1.5, -1.0]);
    let at_rest = simplified(&original, 280, &[]);
    let in_poses = simplified(&original, 280, &poses);
    let mut fitted = in_poses.clone();
    let report = refit_in_poses(&mut fitted, &original, &poses, &PosedRefitOptions::default(), Control::default())
        .expect("nobody cancels");
    assert!(report.rms_after < 0.9 * report.rms_before, "{report:?}");
    let [at_rest, in_poses, fitted] = [&at_rest, &in_poses, &fitted].map(|mesh| unseen(&original, mesh));
    assert!(in_poses < 0.8 * at_rest, "{in_poses} in poses, {at_rest} at rest");
    assert!(fitted < 0.95 * in_poses, "{fitted} fitted, {in_poses} before");
}

#[test]
fn weights_stay_weights() {
    let original = arm();
    let poses = bent(&[0.0, 0.8, 1.4]);
    let mut mesh = simplified(&original, 200, &poses);
    let before = mesh.clone();
    refit_in_poses(&mut mesh, &original, &poses, &PosedRefitOptions::default(), Control::default())
        .expect("nobody cancels");
    assert_ne!(mesh, before);
    let skin = Influences::of(&mesh);
    for wedge in 0..mesh.wedge_count() as u32 {
        let all: Vec<(u32, f32)> = skin.of_wedge(wedge).collect();
        assert!((all.iter().map(|(_, weight)| weight).sum::<f32>() - 1.0).abs() < 1e-5, "{all:?}");
        assert!(all.len() <= 2 && all.iter().all(|&(joint, weight)| joint < 2 && weight >= 0.0), "{all:?}");
    }
    // nobody asks for weights: they stay
    let mut still = before.clone();
    let options = PosedRefitOptions { weights: false, ..PosedRefitOptions::default() };
    refit_in_poses(&mut still, &original, &poses, &options, Control::default()).expect("nobody cancels");
    assert_eq!(still.wedge_attributes, before.wedge_attributes);
    assert_ne!(still.positions, before.positions);
}

#[test]
fn what_is_fixed_stays() {
    let original = arm();
    let poses = bent(&[0.0, 1.0]);
    let mut mesh = simplified(&original, 300, &poses);
    let (still, before) = (mesh.clone(), mesh.positions.clone());
    let fixed: Vec<bool> = (0..mesh.vertex_count()).map(|v| v % 3 == 0).collect();
    let options = PosedRefitOptions { fixed: fixed.clone(), ..PosedRefitOptions::default() };
    refit_in_poses(&mut mesh, &original, &poses, &options, Control::default()).expect("nobody cancels");
    for (v, _) in fixed.iter().enumerate().filter(|(_, fixed)| **fixed) {
        assert_eq!(mesh.positions[v], before[v]);
    }
    let weights = |mesh: &Mesh, v: usize| -> Vec<(u32, f32)> { Influences::of(mesh).of_wedge(v as u32).collect() };
    let kept = (0..fixed.len()).filter(|&v| fixed[v]).all(|v| weights(&mesh, v) == weights(&still, v));
    assert!(kept, "weights, too");
    assert_ne!(mesh.positions, before);
}

#[test]
fn fitting_is_the_same_on_any_number_of_threads() {
    let original = arm();
    let poses = bent(&[0.0, 0.7, 1.4]);
    let mesh = simplified(&original, 240, &poses);
    let fitted = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        let mut mesh = mesh.clone();
        let report = pool.install(|| {
            refit_in_poses(&mut mesh, &original, &poses, &PosedRefitOptions::default(), Control::default())
        });
        (mesh, report.expect("nobody cancels"))
    };
    assert_eq!(fitted(1), fitted(3));
}

#[test]
fn without_poses_nothing_happens() {
    let original = arm();
    let mut mesh = simplified(&original, 240, &[]);
    let before = mesh.clone();
    let report = refit_in_poses(&mut mesh, &original, &[], &PosedRefitOptions::default(), Control::default());
    assert_eq!(report, Ok(PosedRefitReport::default()));
    assert_eq!(mesh, before);
}
