use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use proptest::prelude::*;

use super::lattice::distinct;
use super::*;
use crate::measure::{CompareOptions, compare};
use crate::mesh::{Attribute, Semantic, shapes};
use crate::zoo::zoo;

fn to(triangles: usize, method: ClusterMethod) -> ClusterOptions {
    ClusterOptions { triangles: Some(triangles), method, ..ClusterOptions::default() }
}

fn methods() -> impl Iterator<Item = ClusterMethod> {
    ClusterMethod::NAMES.into_iter().map(|(_, method)| method)
}

fn clustered(mesh: &Mesh, options: &ClusterOptions) -> (Mesh, ClusterReport) {
    let mut mesh = mesh.clone();
    let report = cluster(&mut mesh, options, Control::default()).unwrap();
    mesh.check().unwrap();
    mesh.check_finite().unwrap();
    assert_eq!(report.triangles_out, mesh.triangle_count());
    (mesh, report)
}

/// No triangle names a vertex twice, none is there twice, and no vertex is without one.
fn assert_clean(mesh: &Mesh) {
    let mut seen = HashSet::new();
    let mut used = vec![false; mesh.vertex_count()];
    for t in 0..mesh.triangle_count() {
        let mut vertices = mesh.triangle_vertices(t);
        assert!(distinct(vertices));
        vertices.iter().for_each(|&v| used[v as usize] = true);
        let lowest = (0..3).min_by_key(|&i| vertices[i]).unwrap_or(0);
        vertices.rotate_left(lowest);
        assert!(seen.insert(vertices), "{vertices:?} twice");
    }
    assert!(used.iter().all(|&used| used));
}

#[test]
fn every_method_comes_near_below_the_target() {
    for (mesh, name) in [(shapes::sphere(5), "sphere"), (shapes::torus(2.0, 0.5, 120, 60), "torus")] {
        for method in methods() {
            for target in [2000, 500, 100] {
                let (found, report) = clustered(&mesh, &to(target, method));
                let count = found.triangle_count();
                assert!(count <= target && 10 * count >= 8 * target, "{name} {method:?}: {count} of {target}");
                assert!(report.error > 0.0 && report.error <= 2.0 * report.cell_size, "{report:?}");
                assert_clean(&found);
            }
        }
    }
}

#[test]
fn quadrics_are_the_most_accurate() {
    let mesh = shapes::torus(2.0, 0.5, 240, 120);
    let rms = |method| {
        let (found, _) = clustered(&mesh, &to(3000, method));
        let options = CompareOptions { samples: 20_000, ..CompareOptions::default() };
        let found = compare(&mesh, &found, &options, Control::default()).unwrap();
        found.forward.rms.max(found.backward.rms)
    };
    let quadric = rms(ClusterMethod::Quadric);
    for other in [ClusterMethod::Vertex, ClusterMethod::Mean, ClusterMethod::FloatingCells] {
        assert!(quadric < 0.8 * rms(other), "{other:?}");
    }
}

#[test]
fn vertices_that_stand_for_their_cells_are_of_the_original() {
    let mesh = shapes::torus(2.0, 0.5, 60, 30);
    for method in [ClusterMethod::Vertex, ClusterMethod::FloatingCells] {
        let (found, _) = clustered(&mesh, &to(600, method));
        assert!(found.positions.iter().all(|p| mesh.positions.contains(p)));
    }
}

#[test]
fn a_flat_face_stays_flat() {
    let mesh = shapes::grid(40);
    let flat = |mesh: &Mesh| mesh.positions.iter().all(|p| p[2].abs() < 1e-6);
    assert!(flat(&mesh));
    for method in methods() {
        let (found, _) = clustered(&mesh, &to(300, method));
        assert!(flat(&found), "{method:?}");
    }
}

#[test]
fn the_largest_error_bounds_how_far_vertices_move() {
    let mesh = shapes::torus(2.0, 0.5, 120, 60);
    for method in methods() {
        let options = ClusterOptions { max_error: Some(0.25), method, ..ClusterOptions::default() };
        let (found, report) = clustered(&mesh, &options);
        assert!(report.error <= 0.25 && report.error > 0.08, "{method:?}: {report:?}");
        assert!(found.triangle_count() < mesh.triangle_count() / 2);
        // before the number of triangles
        let (both, _) = clustered(&mesh, &ClusterOptions { triangles: Some(4), ..options });
        assert_eq!(both, found);
    }
}

#[test]
fn locked_vertices_stay_and_stay_alone() {
    let mesh = shapes::sphere(5);
    let locked: Vec<bool> = mesh.positions.iter().map(|p| p[2] > 0.9).collect();
    let kept: Vec<[f32; 3]> = mesh.positions.iter().copied().filter(|p| p[2] > 0.9).collect();
    for method in methods() {
        let (found, _) = clustered(&mesh, &ClusterOptions { locked: locked.clone(), ..to(1500, method) });
        assert!(kept.iter().all(|p| found.positions.contains(p)), "{method:?}");
        assert!(found.triangle_count() <= 1500);
    }
}

#[test]
fn importance_draws_vertices() {
    let mesh = shapes::grid(20);
    let important = 9 * 21 + 9;
    let mut importance = vec![1.0; mesh.vertex_count()];
    importance[important] = 1000.0;
    let options = ClusterOptions { importance, ..to(60, ClusterMethod::FloatingCells) };
    // where all edges go straight on, nothing weighs anything: bend it
    let mut lifted = mesh.clone();
    lifted.positions.iter_mut().for_each(|p| p[2] = 0.2 * (5.0 * p[0]).sin() * (5.0 * p[1]).cos());
    let (found, _) = clustered(&lifted, &options);
    assert!(found.positions.contains(&lifted.positions[important]));
}

#[test]
fn materials_seams_and_attributes_follow() {
    // two materials and a seam at x = 0.5, where u jumps
    let mut mesh = shapes::grid(32);
    mesh.unweld();
    let x = |w: u32| mesh.positions[mesh.wedge_vertices[w as usize] as usize][0];
    let right: Vec<bool> = mesh.triangles.iter().map(|t| t.map(x).iter().sum::<f32>() > 1.5).collect();
    let uv = (0..mesh.wedge_count()).flat_map(|w| [mesh.positions[w][0] + if right[w / 3] { 10.0 } else { 0.0 }, 1.0]);
    let uv: Vec<f32> = uv.collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, [0.0, 0.0, 1.0].repeat(mesh.wedge_count())));
    mesh.triangle_materials = right.iter().map(|&right| u32::from(right)).collect();
    let heights = mesh.positions.iter().map(|p| p[1]).collect();
    mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("y".into()), 1, heights));
    mesh.weld(&crate::mesh::WeldOptions::EXACT_WITH_WEDGES);
    for method in methods() {
        let (found, report) = clustered(&mesh, &to(200, method));
        assert!(found.wedge_count() > found.vertex_count() && found.wedge_count() < found.vertex_count() * 3 / 2);
        let uv = found.wedge_attributes[0].as_f32().unwrap();
        for (t, wedges) in found.triangles.iter().enumerate() {
            let side = if found.triangle_material(t) == 1 { 10.0 } else { 0.0 };
            for &wedge in wedges {
                let point = found.positions[found.wedge_vertices[wedge as usize] as usize];
                let u = uv[2 * wedge as usize] - side;
                assert!((u - point[0]).abs() < report.cell_size as f32, "{method:?}: {u} at {point:?}");
            }
        }
        let normals = found.wedge_attributes[1].as_f32().unwrap();
        assert!(normals.chunks_exact(3).all(|n| n == [0.0, 0.0, 1.0]));
        let y = found.vertex_attributes[0].as_f32().unwrap();
        assert!(found.positions.iter().zip(y).all(|(p, y)| (p[1] - y).abs() < report.cell_size as f32));
    }
}

#[test]
fn joints_keep_weights_that_sum_to_one() {
    let mut mesh = shapes::sphere(4);
    let count = mesh.wedge_count();
    mesh.wedge_attributes.push(Attribute::new_u32(
        Semantic::Joints(0),
        4,
        (0..count as u32).flat_map(|w| [w % 7, 8, 0, 0]).collect(),
    ));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Weights(0), 4, [0.75, 0.25, 0.0, 0.0].repeat(count)));
    let (found, _) = clustered(&mesh, &to(300, ClusterMethod::Quadric));
    assert!(found.wedge_attributes[1].as_f32().unwrap().chunks_exact(4).all(|w| w == [0.75, 0.25, 0.0, 0.0]));
    assert!(found.wedge_attributes[0].as_u32().unwrap().chunks_exact(4).all(|j| j[0] < 7 && j[1] == 8));
}

#[test]
fn the_same_bytes_with_any_number_of_threads() {
    let mesh = shapes::torus(2.0, 0.5, 700, 400);
    for (method, target) in methods().zip([20_000, 1500, 3000, 1500]) {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| clustered(&mesh, &to(target, method)))
        };
        assert_eq!(with(1), with(5), "{method:?}");
    }
}

#[test]
fn anything_of_the_zoo_is_taken() {
    for specimen in zoo() {
        for method in methods() {
            for target in 1..specimen.mesh.triangle_count() {
                let (found, report) = clustered(&specimen.mesh, &to(target, method));
                assert_clean(&found);
                assert!(report.triangles_out <= report.triangles_in, "{} {method:?}", specimen.name);
            }
        }
    }
}

#[test]
fn odd_sizes_and_leftovers_do_no_harm() {
    let sphere = shapes::sphere(4);
    let (expected, _) = clustered(&sphere, &to(300, ClusterMethod::Quadric));
    for unit in [2.0_f32.powi(110), 2.0_f32.powi(-110)] {
        let mut mesh = sphere.clone();
        mesh.positions.iter_mut().flatten().for_each(|x| *x *= unit);
        let (found, _) = clustered(&mesh, &to(300, ClusterMethod::Quadric));
        assert_eq!(found.triangle_count(), expected.triangle_count());
        let back = found.positions.iter().map(|p| p.map(|x| x / unit));
        assert!(back.zip(&expected.positions).all(|(a, b)| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-4)));
    }
    // vertices without triangle are neither heard nor seen
    let mut mesh = sphere;
    mesh.positions.push([1e6; 3]);
    mesh.wedge_vertices.push(mesh.positions.len() as u32 - 1);
    assert_eq!(clustered(&mesh, &to(300, ClusterMethod::Quadric)).0, expected);
}

#[test]
fn what_makes_no_sense_is_refused_and_changes_nothing() {
    let sphere = shapes::sphere(3);
    let mut mesh = sphere.clone();
    let mut refused = |options: &ClusterOptions, control: Control<'_>| {
        let error = cluster(&mut mesh, options, control).unwrap_err();
        assert_eq!(mesh, sphere);
        error
    };
    let fine = to(20, ClusterMethod::Quadric);
    for options in [
        ClusterOptions::default(),
        ClusterOptions { max_error: Some(f64::NAN), ..fine.clone() },
        ClusterOptions { locked: vec![true], ..fine.clone() },
        ClusterOptions { importance: vec![-1.0; sphere.vertex_count()], ..fine.clone() },
    ] {
        assert!(matches!(refused(&options, Control::default()), ClusterError::InvalidOption { .. }));
    }
    let stop = AtomicBool::new(true);
    assert_eq!(refused(&fine, Control::new(None, Some(&stop))), ClusterError::Cancelled(Cancelled));
    let mut broken = sphere.clone();
    broken.positions[7][1] = f32::NAN;
    assert_eq!(cluster(&mut broken, &fine, Control::default()), Err(ClusterError::NotFinite { vertex: 7 }));
    let mut broken = sphere;
    broken.triangles[3][0] = 1 << 20;
    assert!(matches!(cluster(&mut broken, &fine, Control::default()), Err(ClusterError::Mesh(_))));
}

#[test]
fn enough_is_left_alone() {
    let mesh = shapes::cube();
    let (found, report) = clustered(&mesh, &to(12, ClusterMethod::Quadric));
    assert_eq!((found, report.error), (mesh, 0.0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_soup_stays_within_a_cell_of_where_it_was(
        points in prop::collection::vec(prop::array::uniform3(prop_oneof![Just(0.0_f32), -1.0..1.0_f32]), 3..60),
        corners in prop::collection::vec(0_u32..60, 3..300),
        share in 0.0..1.0_f64,
        kind in 0..4_usize,
    ) {
        let count = points.len() as u32;
        let triangles: Vec<[u32; 3]> = corners.as_chunks().0.iter().map(|t: &[u32; 3]| t.map(|v| v % count)).collect();
        let target = (share * triangles.len() as f64) as usize;
        let mesh = Mesh::from_triangles(points, triangles).unwrap();
        let (found, report) = clustered(&mesh, &to(target, ClusterMethod::NAMES[kind].1));
        if target < mesh.triangle_count() {
            assert_clean(&found);
        }
        prop_assert!(report.error <= 1.2 * report.cell_size + 1e-6);
        // each corner that is left is within the error of one of the original
        let near = |p: &[f32; 3]| mesh.positions.iter().any(|&q| {
            Vec3::from(*p).as_dvec3().distance(Vec3::from(q).as_dvec3()) <= report.error + 1e-6
        });
        prop_assert!(found.positions.iter().all(near));
    }

    #[test]
    fn the_reach_of_the_nearest_lattice_point_is_at_most_one(x in 0.0..50.0_f32, y in 0.0..50.0_f32, z in 0.0..50.0_f32) {
        let place = glam::Vec3A::new(x, y, z);
        let within = Lattice::within(place).as_dvec3();
        prop_assert!(Lattice::reach(within) <= 1.0 + 1e-5 && within.length() <= lattice::WIDEST / 2.0 + 1e-5);
        // and it is a point of the lattice, the one that the name of the cell gives
        let centre = Lattice::centre(Lattice::cell(place));
        prop_assert!((centre + within - place.as_dvec3()).length() < 1e-4);
        let doubled = centre * 2.0;
        prop_assert!(doubled == doubled.round());
        prop_assert!(doubled.to_array().iter().all(|d| d.rem_euclid(2.0) == doubled.x.rem_euclid(2.0)));
    }
}
