//! Surfaces looked at in poses.

use glam::{DMat4, DQuat, DVec3};

use super::*;
use crate::measure::{CompareOptions, compare};
use crate::skin::Pose;

fn in_poses(mesh: &Mesh, triangles: usize, poses: Vec<Pose>) -> Mesh {
    let options = SimplifyOptions { poses, ..to(triangles) };
    reduced(mesh, &options).0
}

fn rms(a: &Mesh, b: &Mesh) -> f64 {
    let options = CompareOptions { samples: 20_000, ..CompareOptions::default() };
    let compared = compare(a, b, &options, Control::default()).expect("there are triangles");
    compared.forward.rms.max(compared.backward.rms)
}

fn turned(by: DMat4) -> Pose {
    Pose { transform: by, ..Pose::default() }
}

#[test]
fn a_pose_that_moves_all_alike_changes_nothing() {
    let mesh = dented_torus();
    let (plain, _) = reduced(&mesh, &to(600));
    let expected = rms(&mesh, &plain);
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.2);
    let there = DMat4::from_scale_rotation_translation(DVec3::splat(7.0), turn, DVec3::new(30.0, -5.0, 2.0));
    for poses in [vec![turned(DMat4::IDENTITY)], vec![turned(there)], vec![turned(DMat4::IDENTITY), turned(there)]] {
        let posed = rms(&mesh, &in_poses(&mesh, 600, poses));
        assert!((posed / expected - 1.0).abs() < 0.02, "{posed} instead of {expected}");
    }
}

#[test]
fn planes_seen_at_rest_are_the_planes() {
    let mesh = dented_torus();
    let frame = Frame::of(&mesh.positions);
    let options = to(10);
    let quadric = quadric_options(&options, || 1.0).expect("it is a quadric metric");
    let faces = order::faces_of(&mesh);
    let posed = Posed::new(&mesh, &frame, &[turned(DMat4::IDENTITY)]);
    let (mut plain, mut posed) = (QuadricMetric::new(quadric), QuadricMetric::new(quadric).in_poses(Some(posed)));
    let features = Features::default();
    plain.prepare(&faces, &features);
    posed.prepare(&faces, &features);
    for edge in 0..faces.edge_count() as u32 {
        let ends = faces.ends(edge);
        let edge = EdgeContext { ends, points: ends.map(|v| faces.point(v)), anchor: Anchor::Free };
        let [a, b] = [&plain, &posed].map(|metric| metric.evaluate(&faces, &features, &edge).expect("it may collapse"));
        // planes are stored in single precision
        let length = edge.points[0].distance(edge.points[1]);
        assert!((a.cost / b.cost - 1.0).abs() < 1e-2 && a.position.distance(b.position) < 1e-3 * length, "{a:?} {b:?}");
    }
}

#[test]
fn poses_that_make_no_sense_are_refused() {
    let mesh = shapes::sphere(2);
    let refused = |options: SimplifyOptions| {
        let refused = simplify(&mut mesh.clone(), &options, Control::default());
        assert!(matches!(refused, Err(SimplifyError::InvalidOption { name: "poses", .. })), "{refused:?}");
    };
    let at_rest = || vec![Pose::default()];
    refused(SimplifyOptions { poses: vec![Pose { share: f64::NAN, ..Pose::default() }], ..to(20) });
    refused(SimplifyOptions { poses: vec![Pose { share: 0.0, ..Pose::default() }], ..to(20) });
    refused(SimplifyOptions { poses: vec![turned(DMat4::NAN)], ..to(20) });
    refused(SimplifyOptions { poses: at_rest(), metric: MetricKind::LindstromTurk, ..to(20) });
    refused(SimplifyOptions { poses: at_rest(), quadric_weight: QuadricWeight::Angle, ..to(20) });
}
