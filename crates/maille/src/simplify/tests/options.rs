//! Options that make no sense, meshes that hardly are any, and what the report says.

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::mesh::MeshError;
use crate::topology::CornerTable;

fn refused_option(mesh: &Mesh, options: &SimplifyOptions) -> &'static str {
    let mut result = mesh.clone();
    match simplify(&mut result, options, Control::default()) {
        Err(SimplifyError::InvalidOption { name, reason }) => {
            assert!(!reason.is_empty() && result == *mesh, "{name}");
            name
        }
        other => panic!("{options:?} gave {other:?}"),
    }
}

#[test]
fn options_that_make_no_sense_are_refused_by_name() {
    let mesh = shapes::sphere(1);
    let count = mesh.vertex_count();
    let bad = [f64::NAN, -1.0, f64::INFINITY, f64::NEG_INFINITY];
    assert_eq!(refused_option(&mesh, &SimplifyOptions::default()), "target");
    for x in [f64::NAN, -1.0, f64::NEG_INFINITY] {
        assert_eq!(refused_option(&mesh, &within(x)), "max_error");
    }
    for x in bad {
        assert_eq!(refused_option(&mesh, &SimplifyOptions { constraint_weight: x, ..to(9) }), "constraint_weight");
        assert_eq!(refused_option(&mesh, &SimplifyOptions { join_distance: Some(x), ..to(9) }), "join_distance");
        assert_eq!(refused_option(&mesh, &SimplifyOptions { max_normal_turn: Some(x), ..to(9) }), "max_normal_turn");
        let importance = vec![x as f32; count];
        assert_eq!(refused_option(&mesh, &SimplifyOptions { importance, ..to(9) }), "importance");
    }
    for x in [f64::NAN, -0.1, 1.1, f64::INFINITY] {
        assert_eq!(refused_option(&mesh, &SimplifyOptions { min_quality: Some(x), ..to(9) }), "min_quality");
    }
    assert_eq!(refused_option(&mesh, &SimplifyOptions { max_normal_turn: Some(3.2), ..to(9) }), "max_normal_turn");
    assert_eq!(refused_option(&mesh, &SimplifyOptions { valence: Some((5, 4)), ..to(9) }), "valence");
    assert_eq!(refused_option(&mesh, &SimplifyOptions { max_influences: Some(0), ..to(9) }), "max_influences");
    assert_eq!(refused_option(&mesh, &SimplifyOptions { locked: vec![true; count - 1], ..to(9) }), "locked");
    assert_eq!(refused_option(&mesh, &SimplifyOptions { importance: vec![1.0; count + 1], ..to(9) }), "importance");
}

#[test]
fn broken_meshes_are_refused_and_unchanged() {
    let mut not_finite = shapes::sphere(1);
    not_finite.positions[3][1] = f32::NAN;
    let error = simplify(&mut not_finite, &to(4), Control::default()).unwrap_err();
    assert_eq!(error, SimplifyError::NotFinite { vertex: 3 });
    let mut out_of_range = shapes::sphere(1);
    out_of_range.triangles[5][0] = 1000;
    let error = simplify(&mut out_of_range, &to(4), Control::default()).unwrap_err();
    assert!(matches!(error, SimplifyError::Mesh(MeshError::WedgeOutOfRange { triangle: 5, wedge: 1000, .. })));
}

#[test]
fn nothing_stays_nothing() {
    for mesh in [Mesh::default(), Mesh::from_triangles(vec![[1.0; 3]; 4], vec![]).unwrap()] {
        let (result, report) = reduced(&mesh, &to(10));
        assert_eq!((result, report.stopped, report.collapses), (Mesh::default(), Stop::Triangles, 0));
        assert_eq!(reduced(&mesh, &within(1.0)).1.stopped, Stop::Exhausted, "no number was asked for");
    }
}

#[test]
fn enough_is_enough() {
    let mesh = shapes::sphere(2);
    for target in [mesh.triangle_count(), mesh.triangle_count() + 1, usize::MAX] {
        let (result, report) = reduced(&mesh, &to(target));
        assert_eq!((report.stopped, report.collapses, report.error), (Stop::Triangles, 0, 0.0));
        assert_eq!(position_bits(&result), position_bits(&mesh));
    }
}

#[test]
fn the_first_target_reached_stops() {
    let mesh = dented_torus();
    let both = |triangles, max_error| SimplifyOptions {
        target: Target { triangles: Some(triangles), max_error: Some(max_error) },
        ..SimplifyOptions::default()
    };
    let (_, report) = reduced(&mesh, &both(500, f64::INFINITY));
    assert_eq!((report.stopped, report.triangles_out), (Stop::Triangles, 500));
    let (_, report) = reduced(&mesh, &both(4, 0.01));
    assert_eq!(report.stopped, Stop::MaxError);
    assert!(report.error <= 0.01 && report.triangles_out > 4);
}

#[test]
fn what_cannot_be_reduced_says_so() {
    let preserve = SimplifyOptions { topology: TopologyPolicy::Preserve, ..to(1) };
    let (result, report) = reduced(&shapes::tetrahedron(), &preserve);
    assert_eq!((result.triangle_count(), report.stopped), (4, Stop::NoLegalCollapse));
    assert!(report.refused.topology + report.refused.fold_over > 0);
    let free = |options| SimplifyOptions { topology: TopologyPolicy::Free, max_normal_turn: None, ..options };
    let (result, report) = reduced(&shapes::tetrahedron(), &free(to(0)));
    assert_eq!((result.triangle_count(), report.stopped), (0, Stop::Triangles));
    for options in [to(1), within(f64::INFINITY)] {
        let (result, report) = reduced(&shapes::tetrahedron(), &free(options));
        assert_eq!((result.triangle_count(), report.stopped), (2, Stop::NoLegalCollapse), "something stays");
    }
}

#[test]
fn a_triangle_alone_stays_or_goes() {
    let mesh = Mesh::from_triangles(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
    for (metric, placement, way) in every_way() {
        for (name, topology) in TopologyPolicy::NAMES {
            let (result, report) = reduced(&mesh, &SimplifyOptions { metric, placement, topology, ..to(0) });
            let expected = match topology {
                TopologyPolicy::Preserve => (1, Stop::NoLegalCollapse, 0),
                _ => (0, Stop::Triangles, 1),
            };
            assert_eq!((result.triangle_count(), report.stopped, report.collapses), expected, "{way}, {name}");
        }
    }
}

#[test]
fn meshes_without_extent_go_through() {
    let mut point = shapes::sphere(2);
    point.positions.fill([3.0, -2.0, 1.0]);
    let mut line = shapes::sphere(2);
    line.positions.iter_mut().for_each(|p| *p = [p[0], 0.0, 0.0]);
    let repeated = Mesh::from_triangles(vec![[0.0; 3], [1.0; 3]], vec![[0, 0, 1], [1, 1, 1]]).unwrap();
    for (metric, placement, way) in every_way() {
        for mesh in [&point, &line] {
            let topology = TopologyPolicy::Preserve;
            let (result, report) = reduced(mesh, &SimplifyOptions { metric, placement, topology, ..to(20) });
            assert!(result.triangle_count() <= 20 || report.stopped == Stop::NoLegalCollapse, "{way}: {report:?}");
            assert_eq!(CornerTable::of_vertices(&result).euler_characteristic(), 2, "{way}");
        }
        let (result, _) = reduced(&repeated, &SimplifyOptions { metric, placement, ..to(20) });
        assert_eq!(result, Mesh::default(), "{way}: triangles that name a vertex twice are dropped");
    }
}

#[test]
fn any_scale_and_offset_will_do() {
    let plain = dented_torus();
    let expected = reduced(&plain, &to(300)).1.error;
    for scale in [1e-38, 1e-9, 1e9, 1e38] {
        for (metric, placement, way) in every_way() {
            let mut mesh = plain.clone();
            mesh.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= scale);
            let (_, report) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(300) });
            assert_eq!(report.triangles_out, 300, "{way}, {scale}");
        }
        let mut mesh = plain.clone();
        mesh.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= scale);
        let error = reduced(&mesh, &to(300)).1.error / f64::from(scale);
        assert!((error / expected - 1.0).abs() < 0.05, "{error} instead of {expected}");
    }
    // far from the origin, f32 leaves a grid of a few hundred steps
    let mut far = plain.clone();
    far.positions.as_flattened_mut().iter_mut().for_each(|x| *x += 100_000.0);
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&far, &SimplifyOptions { metric, placement, ..to(400) });
        assert!(result.triangle_count() < 800, "{way}");
        let (low, high) = result.bounds().unwrap();
        assert!(low.iter().all(|x| *x > 99_996.0) && high.iter().all(|x| *x < 100_004.0), "{way}");
    }
}

#[test]
fn the_largest_numbers_do_not_overflow() {
    let mut mesh = dented_torus();
    let (low, high) = mesh.bounds().unwrap();
    for p in &mut mesh.positions {
        *p = [0, 1, 2]
            .map(|k| (((p[k] - low[k]) / (high[k] - low[k]) * 2.0 - 1.0) * f32::MAX).clamp(-f32::MAX, f32::MAX));
    }
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, max_normal_turn: None, ..to(60) });
        assert_eq!(result.triangle_count(), 60, "{way}");
    }
    let extreme = SimplifyOptions { constraint_weight: f64::MAX, ..to(100) };
    reduced(&terrain(12), &extreme);
    reduced(&terrain(12), &SimplifyOptions { importance: vec![f32::MAX; 169], ..to(100) });
    reduced(&terrain(12), &SimplifyOptions { importance: vec![0.0; 169], ..to(100) });
}

#[test]
fn any_join_distance_ends() {
    let mesh = dented_torus();
    for distance in [0.0, f64::MIN_POSITIVE, 1e-30, 0.01, 1e3, f64::MAX] {
        reduced(&mesh, &SimplifyOptions { join_distance: Some(distance), ..to(300) });
    }
}

#[test]
fn cancelling_leaves_the_mesh_alone() {
    let mesh = dented_torus();
    let stop = AtomicBool::new(false);
    let progress = |_: &str, done: f32| {
        assert!((0.0..=1.0).contains(&done));
        stop.store(true, Ordering::Relaxed);
    };
    let mut result = mesh.clone();
    let error = simplify(&mut result, &to(100), Control::new(Some(&progress), Some(&stop))).unwrap_err();
    assert!(matches!(error, SimplifyError::Cancelled(_)) && result == mesh);
}

#[test]
fn many_triangles_at_one_place_do_not_take_for_ever() {
    const COUNT: u32 = 100_000;
    let rim = |i: u32| {
        let angle = std::f32::consts::TAU * i as f32 / COUNT as f32;
        [angle.cos(), angle.sin(), 0.001 * noise(i)]
    };
    let positions: Vec<_> = std::iter::once([0.0, 0.0, 0.5]).chain((0..COUNT).map(rim)).collect();
    let fan = (0..COUNT).map(|i| [0, 1 + i, 1 + (i + 1) % COUNT]).collect();
    let fan = Mesh::from_triangles(positions.clone(), fan).unwrap();
    let mut unwelded_wedges = fan.clone();
    unwelded_wedges.wedge_vertices = fan.triangles.iter().flatten().copied().collect();
    unwelded_wedges.triangles = (0..COUNT).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let uv = (0..6 * COUNT).map(noise).collect();
    unwelded_wedges.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    let book = (0..COUNT - 1).map(|i| [0, 1, 2 + i]).collect();
    // as many faces on one edge: testing every collapse of the 200 000 other edges would be quadratic
    let book = Mesh::from_triangles(positions, book).unwrap();
    for (name, mesh) in [("fan", fan), ("wedges", unwelded_wedges), ("book", book)] {
        for topology in [TopologyPolicy::Preserve, TopologyPolicy::Free] {
            let (_, report) = reduced(&mesh, &SimplifyOptions { topology, ..to(100) });
            assert_eq!(report.stopped == Stop::Triangles, name != "book", "{name}: {report:?}");
        }
    }
}
