//! Laws that hold for every metric and every placement.

use proptest::prelude::*;

use super::*;
use crate::measure::{CompareOptions, Comparison, area, boundary_length, compare, volume};
use crate::topology::CornerTable;
use crate::zoo::{grid_with_hole, zoo};

pub(super) fn measured(a: &Mesh, b: &Mesh) -> Comparison {
    let options = CompareOptions { samples: 4_000, ..CompareOptions::default() };
    compare(a, b, &options, Control::default()).expect("neither is empty")
}

fn smallest_area(mesh: &Mesh) -> f64 {
    let area = |t| {
        let [a, b, c] = mesh.triangle_points(t);
        (b - a).cross(c - a).length()
    };
    (0..mesh.triangle_count()).map(area).fold(f64::INFINITY, f64::min)
}

#[test]
fn the_whole_zoo_goes_through_every_metric_and_placement() {
    for specimen in zoo() {
        let proper = CornerTable::of_vertices(&specimen.mesh).report().degenerate_faces == 0;
        for (metric, placement, way) in every_way() {
            let half = specimen.mesh.triangle_count() / 2;
            let targets = [0, half].into_iter().flat_map(|n| TopologyPolicy::NAMES.map(|(_, topology)| (n, topology)));
            for (target, topology) in targets {
                let options = SimplifyOptions { metric, placement, topology, ..to(target) };
                let (result, report) = reduced(&specimen.mesh, &options);
                let what = format!("{}, {way}, {topology:?}, to {target}", specimen.name);
                assert_eq!(report.stopped == Stop::Triangles, result.triangle_count() <= target, "{what}: {report:?}");
                assert!(!proper || smallest_area(&result) > 0.0, "{what}: a triangle without area");
                let table = CornerTable::of_vertices(&result);
                if topology == TopologyPolicy::Preserve {
                    assert_eq!(table.euler_characteristic(), specimen.euler, "{what}");
                }
                if topology != TopologyPolicy::Free {
                    assert!(table.report().non_manifold_edges <= specimen.non_manifold_edges, "{what}");
                    assert!(table.report().non_manifold_vertices <= specimen.non_manifold_vertices, "{what}");
                }
            }
        }
    }
}

/// Number of pieces that hang together, be it at a vertex.
fn pieces(mesh: &Mesh) -> usize {
    let mut sets = UnionFind::new(mesh.vertex_count());
    let proper = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t));
    let proper: Vec<_> = proper.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    proper.iter().for_each(|&[a, b, c]| {
        sets.union(a, b);
        sets.union(b, c);
    });
    let roots = sets.into_roots();
    proper.iter().map(|face| roots[face[0] as usize]).collect::<std::collections::BTreeSet<_>>().len()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn random_triangles_keep_their_topology(faces in prop::collection::vec(prop::array::uniform3(0u32..9), 0..20)) {
        let point = |i: u32| [noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)];
        let mesh = Mesh::from_triangles((0..9).map(point).collect(), faces).unwrap();
        for max_normal_turn in [None, Some(1.3)] {
            let topology = TopologyPolicy::Preserve;
            let (result, report) = reduced(&mesh, &SimplifyOptions { max_normal_turn, topology, ..to(0) });
            prop_assert_eq!(report.stopped == Stop::Triangles, result.triangle_count() == 0);
            let (before, after) = (CornerTable::of_vertices(&mesh), CornerTable::of_vertices(&result));
            prop_assert_eq!(after.euler_characteristic(), before.euler_characteristic());
            prop_assert_eq!(pieces(&result), pieces(&mesh));
            prop_assert!(after.report().non_manifold_edges <= before.report().non_manifold_edges);
        }
    }

    #[test]
    fn manifolds_stay_manifold_unless_anything_goes(
        gone in prop::collection::vec(any::<prop::sample::Index>(), 0..12),
        closed in any::<bool>(),
        target in 0usize..20,
    ) {
        let mut mesh = if closed { shapes::torus(2.0, 0.7, 7, 5) } else { terrain(5) };
        for index in gone {
            mesh.triangles.swap_remove(index.index(mesh.triangles.len()));
        }
        let before = CornerTable::of_vertices(&mesh);
        prop_assume!(before.report().is_manifold());
        for topology in [TopologyPolicy::Preserve, TopologyPolicy::Manifold] {
            let options =
                SimplifyOptions { topology, max_normal_turn: None, boundary: EdgePolicy::Free, ..to(target) };
            let table = CornerTable::of_vertices(&reduced(&mesh, &options).0);
            prop_assert!(table.report().is_manifold(), "{topology:?}: {:?}", table.report());
            prop_assert_eq!(table.report().inconsistent_edges, 0);
            if topology == TopologyPolicy::Preserve {
                prop_assert_eq!(table.boundary_loops().len(), before.boundary_loops().len());
                prop_assert_eq!(table.euler_characteristic(), before.euler_characteristic());
            }
        }
    }

    #[test]
    fn random_triangles_collapse_to_nothing_without_tests(
        faces in prop::collection::vec(prop::array::uniform3(0u32..9), 1..20),
    ) {
        let point = |i: u32| [noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)];
        let mesh = Mesh::from_triangles((0..9).map(point).collect(), faces).unwrap();
        let free = SimplifyOptions {
            topology: TopologyPolicy::Free,
            max_normal_turn: None,
            boundary: EdgePolicy::Free,
            ..to(0)
        };
        let (result, report) = reduced(&mesh, &free);
        prop_assert_eq!((result.triangle_count(), report.stopped), (0, Stop::Triangles));
        prop_assert!(report.collapses < 9, "a collapse takes a vertex: {}", report.collapses);
    }

    #[test]
    fn new_names_of_vertices_and_triangles_change_nothing(seed in any::<u32>()) {
        let mesh = dented_torus();
        let shuffled = |count: usize, salt: u32| {
            let mut order: Vec<u32> = (0..count as u32).collect();
            order.sort_by_key(|&i| noise(seed ^ salt ^ i).to_bits());
            order
        };
        let vertices = shuffled(mesh.vertex_count(), 0);
        let mut names = vec![0; vertices.len()];
        (0..).zip(&vertices).for_each(|(new, &old)| names[old as usize] = new);
        let positions = vertices.iter().map(|&v| mesh.positions[v as usize]).collect();
        let triangles = shuffled(mesh.triangle_count(), 0x5555).into_iter().map(|t| {
            let [a, b, c] = mesh.triangles[t as usize].map(|v| names[v as usize]);
            if t % 2 == 0 { [b, c, a] } else { [a, b, c] }
        });
        let renamed = Mesh::from_triangles(positions, triangles.collect()).unwrap();
        let ((_, one), (_, other)) = (reduced(&mesh, &to(500)), reduced(&renamed, &to(500)));
        prop_assert_eq!((one.triangles_out, one.stopped), (other.triangles_out, other.stopped));
        prop_assert!((one.error / other.error).ln().abs() < 0.05, "{} and {}", one.error, other.error);
    }
}

#[test]
fn closed_surfaces_stay_closed_and_near() {
    for (metric, placement, way) in every_way() {
        for (mesh, euler, target) in [(shapes::sphere(3), 2, 120), (dented_torus(), 0, 400)] {
            let options = SimplifyOptions { metric, placement, ..to(target) };
            let (result, report) = reduced(&mesh, &options);
            assert_eq!((report.stopped, result.triangle_count()), (Stop::Triangles, target), "{way}");
            let table = CornerTable::of_vertices(&result);
            assert!(table.is_closed() && table.report().is_manifold(), "{way}");
            assert_eq!(table.euler_characteristic(), euler, "{way}");
            let (distance, shrunk) = (measured(&mesh, &result).max(), volume(&result) / volume(&mesh));
            // shortest edges know nothing of the surface
            let (near, least) = if metric == MetricKind::ShortestEdge { (0.6, 0.5) } else { (0.15, 0.8) };
            assert!(distance < near, "{way}: {distance}");
            assert!((least..1.1).contains(&shrunk), "{way}: {shrunk} of the volume");
        }
    }
}

#[test]
fn the_volume_stays_with_the_placement_that_keeps_it() {
    let mesh = shapes::sphere(4);
    let change = |placement| {
        let (result, _) = reduced(&mesh, &SimplifyOptions { placement, ..to(200) });
        (volume(&result) / volume(&mesh) - 1.0).abs()
    };
    let kept = change(PlacementKind::OptimalVolume);
    // not exactly, as it may cost only so much
    assert!(kept < 0.02 && kept < 0.5 * change(PlacementKind::Subset), "{kept}");
}

#[test]
fn a_flat_sheet_with_a_locked_border_loses_its_inside_for_nothing() {
    let mesh = shapes::grid(12);
    for (metric, placement, way) in every_way() {
        let options = SimplifyOptions { metric, placement, boundary: EdgePolicy::Lock, ..to(46) };
        let (result, report) = reduced(&mesh, &options);
        assert!(result.triangle_count() < 80, "{way}: {report:?}");
        // what is assumed to be uncertain, or to be held, is part of the error
        let assumes = [
            MetricKind::ShortestEdge,
            MetricKind::ProbabilisticPlane,
            MetricKind::ProbabilisticTriangle,
            MetricKind::LineQuadrics,
        ];
        assert!(assumes.contains(&metric) || report.error < 1e-6, "{way}: {report:?}");
        assert!((area(&result) - 1.0).abs() < 1e-6 && (boundary_length(&result) - 4.0).abs() < 1e-6, "{way}");
        assert!(result.positions.iter().all(|p| p[2] == 0.0), "{way}");
        let on_border = |p: &&[f32; 3]| p[..2].iter().any(|x| *x == 0.0 || *x == 1.0);
        assert_eq!(result.positions.iter().filter(on_border).count(), 48, "{way}");
    }
}

#[test]
fn what_leaves_no_trace_goes_first() {
    // one half is flat, the other so uneven as single precision is on a slope: quadrics cannot tell them apart
    let mut mesh = shapes::grid(40);
    for (i, p) in (0..).zip(&mut mesh.positions).filter(|(_, p)| p[0] > 0.5) {
        p[2] = 5e-8 * (noise(i) + 0.1);
    }
    let uneven = |mesh: &Mesh| mesh.positions.iter().filter(|p| p[2] != 0.0).count();
    for metric in [MetricKind::HybridQuadric, MetricKind::Quadric, MetricKind::ConstrainedMemorylessQuadric] {
        let (small, report) = reduced(&mesh, &SimplifyOptions { metric, ..to(2400) });
        assert_eq!(report.stopped, Stop::Triangles);
        // costs are still costs: a very short uneven edge may come before the longest flat ones
        let [left, all] = [&small, &mesh].map(uneven);
        assert!(left * 100 >= all * 99, "{metric:?}: {left} of {all}");
        assert!(smallest_area(&small) > 0.0);
    }
}

#[test]
fn constraint_planes_keep_the_outline_of_a_flat_sheet() {
    let mesh = shapes::grid(12);
    let constrained = [
        MetricKind::ConstrainedQuadric,
        MetricKind::ConstrainedMemorylessQuadric,
        MetricKind::HybridQuadric,
        MetricKind::NormalizedQuadric,
    ];
    for (metric, placement, way) in every_way() {
        if !constrained.contains(&metric) || placement == PlacementKind::Midpoint {
            continue;
        }
        let (result, report) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(4) });
        assert!(result.triangle_count() <= 8, "{way}: {report:?}");
        assert!(report.error < 1e-6, "{way}: {report:?}");
        assert!((area(&result) - 1.0).abs() < 1e-5 && (boundary_length(&result) - 4.0).abs() < 1e-5, "{way}");
    }
}

#[test]
fn holes_stay() {
    for (metric, placement, way) in every_way() {
        let topology = TopologyPolicy::Preserve;
        let (result, _) = reduced(&grid_with_hole(), &SimplifyOptions { metric, placement, topology, ..to(0) });
        let table = CornerTable::of_vertices(&result);
        assert_eq!((table.boundary_loops().len(), table.euler_characteristic()), (2, 0), "{way}");
    }
}

#[test]
fn scaling_by_powers_of_two_scales_the_result_bit_by_bit() {
    let mesh = dented_torus();
    for (metric, placement, way) in every_way() {
        for scale in [0.5_f32.powi(40), 4.0, 2.0_f32.powi(60)] {
            let options = SimplifyOptions { metric, placement, ..to(300) };
            let mut scaled = mesh.clone();
            scaled.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= scale);
            let ((mut one, small), (other, large)) = (reduced(&mesh, &options), reduced(&scaled, &options));
            one.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= scale);
            assert!(one == other, "{way}, scaled by {scale}");
            assert_eq!(small.error * f64::from(scale), large.error, "{way}");
            assert_eq!((small.collapses, small.refused), (large.collapses, large.refused), "{way}");
        }
    }
}

#[test]
fn moving_moves_the_result() {
    let mesh = dented_torus();
    let offset = [4.0, -8.0, 16.0];
    let moved = |mesh: &Mesh| {
        let mut mesh = mesh.clone();
        mesh.positions.iter_mut().for_each(|p| *p = [0, 1, 2].map(|k| p[k] + offset[k]));
        mesh
    };
    for (metric, placement, way) in every_way() {
        let options = SimplifyOptions { metric, placement, ..to(300) };
        let ((one, here), (other, there)) = (reduced(&mesh, &options), reduced(&moved(&mesh), &options));
        if placement == PlacementKind::Subset {
            assert!(moved(&one) == other, "{way}: ends of edges are exact");
            assert_eq!(here, there, "{way}");
        }
        assert_eq!(here.triangles_out, there.triangles_out, "{way}");
        assert!((here.error / there.error).ln().abs() < 0.1, "{way}: {} and {}", here.error, there.error);
    }
}

#[test]
fn the_number_of_threads_does_not_show() {
    let mesh = shapes::sphere(5);
    for metric in MetricKind::NAMES.map(|(_, metric)| metric) {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| reduced(&mesh, &SimplifyOptions { metric, ..to(1000) }))
        };
        let one = run(1);
        for threads in [2, 4] {
            let other = run(threads);
            assert!(position_bits(&one.0) == position_bits(&other.0) && one == other, "{metric:?}, {threads} threads");
        }
    }
}

#[test]
fn fewer_triangles_mean_more_error() {
    let mesh = dented_torus();
    for (metric, placement, way) in every_way() {
        let at = |target| reduced(&mesh, &SimplifyOptions { metric, placement, ..to(target) });
        let mut last = (0.0, 0.0);
        for target in [1200, 600, 300, 150] {
            let (result, report) = at(target);
            let rms = measured(&mesh, &result).rms();
            assert!(report.error >= last.0 && rms > last.1, "{way}, {target}: {} {rms} after {last:?}", report.error);
            last = (report.error, rms);
        }
    }
}

#[test]
fn the_wanted_error_bounds_the_measured_distance() {
    // a quadric's error is a mean over planes: measured distances stay within a small factor of it
    const FACTOR: f64 = 6.0;
    for (mesh, error) in [(shapes::sphere(4), 0.01), (dented_torus(), 0.03), (terrain(40), 0.01)] {
        for (metric, placement, way) in every_way() {
            // shortest edges are as far off as they are long
            let error = if metric == MetricKind::ShortestEdge { 10.0 * error } else { error };
            let (result, report) = reduced(&mesh, &SimplifyOptions { metric, placement, ..within(error) });
            assert_eq!(report.stopped, Stop::MaxError, "{way}");
            assert!(report.error <= error && result.triangle_count() < mesh.triangle_count(), "{way}: {report:?}");
            let comparison = measured(&mesh, &result);
            // without constraint planes nothing speaks for the corners of a border
            let cuts_corners = [MetricKind::Quadric, MetricKind::MemorylessQuadric].contains(&metric);
            if cuts_corners && !CornerTable::of_vertices(&mesh).is_closed() {
                continue;
            }
            assert!(comparison.max() < FACTOR * error, "{way}: {} for {error}", comparison.max());
        }
    }
}
