//! Passes before the queue: meshes large enough for them, and what has to hold all the same.

use super::*;
use crate::measure::{CompareOptions, compare};
use crate::topology::CornerTable;

/// 64,800 triangles in several parts, with dents, so that no two collapses cost the same.
fn large_torus() -> Mesh {
    let mut mesh = shapes::torus(2.0, 0.7, 240, 135);
    for (i, x) in (0..).zip(mesh.positions.as_flattened_mut()) {
        *x += 0.004 * noise(i);
    }
    mesh
}

fn in_passes(triangles: usize) -> SimplifyOptions {
    SimplifyOptions { order: Order::Passes, ..to(triangles) }
}

#[test]
fn passes_lose_hardly_anything_to_the_exact_order() {
    let mesh = large_torus();
    let rms = |options: &SimplifyOptions| {
        let (result, _) = reduced(&mesh, options);
        let samples = CompareOptions { samples: 100_000, ..CompareOptions::default() };
        compare(&mesh, &result, &samples, Control::default()).expect("neither is empty").rms()
    };
    for metric in [MetricKind::HybridQuadric, MetricKind::ConstrainedQuadric, MetricKind::ConstrainedMemorylessQuadric]
    {
        let passes = SimplifyOptions { metric, ..in_passes(3_000) };
        let exact = SimplifyOptions { order: Order::Exact, ..passes.clone() };
        let ratio = rms(&passes) / rms(&exact);
        // measured: 0.99 to 1.03
        assert!((0.9..1.06).contains(&ratio), "{metric:?}: {ratio}");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let mesh = large_torus();
    let with_threads = |threads, metric| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| reduced(&mesh, &SimplifyOptions { metric, silhouette_weight: 0.2, ..in_passes(6_000) }).0)
    };
    for metric in [MetricKind::HybridQuadric, MetricKind::ConstrainedQuadric, MetricKind::NormalizedQuadric] {
        assert!(with_threads(1, metric) == with_threads(3, metric), "{metric:?}");
    }
}

#[test]
fn an_observer_sees_every_collapse_and_changes_nothing() {
    let mut mesh = large_torus();
    // the attribute is merged, but does not count
    let options = SimplifyOptions { attributes: AttributeWeights::NONE, ..in_passes(6_000) };
    let (plain, report) = reduced(&mesh, &options);
    // two triangles vanish in each collapse
    assert_eq!(report.collapses, (mesh.triangle_count() - plain.triangle_count()) as u64 / 2);
    let x = mesh.positions.iter().map(|p| p[0]).collect();
    mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("x".into()), 1, x));
    let (watched, _) = reduced(&mesh, &options);
    assert!(watched.positions == plain.positions);
    let sorted = |mesh: &Mesh| {
        let mut all: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
        for t in &mut all {
            let lowest = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
            t.rotate_left(lowest);
        }
        all.sort_unstable();
        all
    };
    assert!(sorted(&watched) == sorted(&plain));
    let x = watched.vertex_attributes[0].as_f32().unwrap();
    let off = watched.positions.iter().zip(x).map(|(p, x)| (p[0] - x).abs()).fold(0.0, f32::max);
    assert!(off < 0.1, "{off} on triangles of 0.3");
}

#[test]
fn a_closed_surface_stays_what_it_is() {
    let mesh = large_torus();
    let (result, report) = reduced(&mesh, &in_passes(2_000));
    assert_eq!((result.triangle_count(), report.stopped), (2_000, Stop::Triangles));
    let table = CornerTable::of_vertices(&result);
    assert_eq!(table.euler_characteristic(), 0);
    assert_eq!((table.report().non_manifold_edges, table.report().non_manifold_vertices), (0, 0));
    assert_eq!(table.boundary_loops().len(), 0);
}

#[test]
fn a_largest_error_holds() {
    let mesh = large_torus();
    let (result, report) = reduced(&mesh, &SimplifyOptions { order: Order::Passes, ..within(0.01) });
    assert!(report.stopped == Stop::MaxError && report.error <= 0.01 && result.triangle_count() < 16_000, "{report:?}");
}

#[test]
fn what_is_not_plain_is_left_to_the_queue() {
    let mut mesh = terrain(180);
    // a seam along the middle: each half has its own colour
    mesh.triangle_materials = (0..mesh.triangle_count() as u32)
        .map(|t| u32::from(mesh.triangle_points(t as usize).iter().all(|p| p.x <= 0.5)))
        .collect();
    let locked: Vec<bool> = mesh.positions.iter().map(|p| p[0] > 0.25 && p[0] < 0.3 && p[1] < 0.1).collect();
    let corners: Vec<[f32; 3]> = (0..locked.len()).filter(|&v| locked[v]).map(|v| mesh.positions[v]).collect();
    let options = SimplifyOptions { locked, material_borders: EdgePolicy::Preserve, ..in_passes(3_000) };
    let (result, _) = reduced(&mesh, &options);
    assert!(corners.iter().all(|p| result.positions.contains(p)), "locked vertices stay");
    let area = |material: u32| -> f64 {
        let flat = |t: usize| {
            let [a, b, c] = result.triangle_points(t).map(|p| p.truncate());
            (b - a).perp_dot(c - a).abs() / 2.0
        };
        (0..result.triangle_count()).filter(|&t| result.triangle_material(t) == material).map(flat).sum()
    };
    assert!((area(0) - 0.5).abs() < 0.002 && (area(1) - 0.5).abs() < 0.002, "{} {}", area(0), area(1));
}

#[test]
fn coordinates_as_large_and_as_small_as_there_are_do_no_harm() {
    for scale in [1e38_f32, 1e-38, 1e-44] {
        for metric in [MetricKind::HybridQuadric, MetricKind::ConstrainedQuadric] {
            let mut mesh = large_torus();
            mesh.positions.as_flattened_mut().iter_mut().for_each(|x| *x *= scale);
            let (result, _) = reduced(&mesh, &SimplifyOptions { metric, ..in_passes(6_000) });
            assert!(result.positions.as_flattened().iter().all(|x| x.is_finite()), "{scale}");
            assert!(result.triangle_count() <= 6_000 || scale < 1e-40, "{scale}: {}", result.triangle_count());
        }
    }
}

#[test]
fn cancelling_stops_between_passes() {
    let mut mesh = large_torus();
    let flag = std::sync::atomic::AtomicBool::new(false);
    let cancel = |stage: &str, done: f32| {
        if stage == "collapsing edges" && done > 0.0 {
            flag.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    };
    let before = mesh.clone();
    let control = Control::new(Some(&cancel), Some(&flag));
    assert!(matches!(simplify(&mut mesh, &in_passes(2_000), control), Err(SimplifyError::Cancelled(_))));
    assert_eq!(mesh, before);
}

#[test]
fn clustering_first_reaches_the_target_and_keeps_locks_and_errors() {
    let mesh = shapes::torus(2.0, 0.5, 200, 100);
    let options = SimplifyOptions { cluster_first: Some(4.0), ..to(1000) };
    let (first, report) = reduced(&mesh, &options);
    // where clusters left an edge of three triangles, a collapse takes an odd number of them
    assert!((998..=1000).contains(&report.triangles_out));
    assert_eq!((report.triangles_in, report.stopped), (40_000, Stop::Triangles));
    assert!(report.collapses < 2000 && report.error > 0.0);
    let locked: Vec<bool> = mesh.positions.iter().map(|p| p[0] > 2.45).collect();
    let kept = || mesh.positions.iter().zip(&locked).filter(|(_, locked)| **locked).map(|(p, _)| p);
    let (result, _) = reduced(&mesh, &SimplifyOptions { locked: locked.clone(), ..options.clone() });
    assert!(kept().count() > 20 && kept().all(|p| result.positions.contains(p)));
    assert!(!kept().all(|p| first.positions.contains(p)));
    let target = Target { triangles: Some(100), max_error: Some(0.05) };
    let (_, report) = reduced(&mesh, &SimplifyOptions { target, ..options.clone() });
    assert!(report.stopped == Stop::MaxError && report.error <= 0.05, "{report:?}");
    let nonsense = SimplifyOptions { cluster_first: Some(1.0), ..options };
    let refused = simplify(&mut mesh.clone(), &nonsense, Control::default());
    assert!(matches!(refused, Err(SimplifyError::InvalidOption { name: "cluster_first", .. })));
}
