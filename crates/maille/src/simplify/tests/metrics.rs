//! The metrics one by one: what each promises beyond what all promise.

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::measure::area;
use crate::mesh::shapes;
use crate::topology::collapse_mesh::RingFace;
use crate::topology::{CornerTable, EdgeStar};

/// Sees every collapse and asks something of it.
struct Witness<F>(F);

impl<F: FnMut(&Collapse<'_>)> Observer for Witness<F> {
    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        (self.0)(collapse);
    }
}

fn faces_of(mesh: &Mesh) -> CollapseMesh {
    let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
    CollapseMesh::new(&mesh.positions, triangles.into_iter())
}

fn features_of(mesh: &Mesh, faces: &CollapseMesh, options: &SimplifyOptions) -> Features {
    Features::new(&WedgeMerger::new(mesh.clone(), options), faces, options)
}

/// Every edge of a mesh with its candidate by Lindstrom and Turk.
fn candidates(mesh: &Mesh, placement: PlacementKind) -> Vec<(EdgeContext, Candidate, CollapseMesh)> {
    let faces = faces_of(mesh);
    let options = SimplifyOptions { metric: MetricKind::LindstromTurk, ..to(1) };
    let features = features_of(mesh, &faces, &options);
    let mut metric = LindstromTurk::new(placement, 1.0, true);
    metric.prepare(&faces, &features);
    let edges = (0..faces.edge_count() as u32).filter_map(|edge| {
        let ends = faces.ends(edge);
        let anchor = features.anchor(edge, ends).ok()?;
        let context = EdgeContext { ends, points: ends.map(|v| faces.point(v)), anchor };
        let candidate = metric.evaluate(&faces, &features, &context).expect("it forbids nothing");
        Some((context, candidate, faces.clone()))
    });
    edges.collect()
}

/// Six times the volume between the faces around an edge, each once, and the same faces with the ends at p.
fn volume_between(faces: &CollapseMesh, ends: [u32; 2], p: DVec3) -> f64 {
    let rings = ends.map(|v| faces.faces_around(v).collect::<Vec<_>>());
    let second = rings[1].iter().filter(|face| face.x != ends[0] && face.y != ends[0]);
    let all = rings[0].iter().map(|face| (ends[0], face)).chain(second.map(|face| (ends[1], face)));
    all.map(|(v, face)| {
        let [a, x, y] = [v, face.x, face.y].map(|v| faces.point(v));
        (x - a).cross(y - a).dot(p - a)
    })
    .sum()
}

#[test]
fn lindstrom_turk_keeps_the_volume_at_every_edge() {
    for mesh in [shapes::sphere(3), dented_torus()] {
        let all = candidates(&mesh, PlacementKind::OptimalVolume);
        assert!(!all.is_empty());
        let mut kept = 0;
        for (context, candidate, faces) in &all {
            let volume = volume_between(faces, context.ends, candidate.position);
            kept += usize::from(volume.abs() < 1e-12);
        }
        // all but where the point would be out of reach
        assert!(kept * 50 >= all.len() * 49, "{kept} of {}", all.len());
    }
}

#[test]
fn lindstrom_turk_costs_squared_volumes() {
    let mesh = dented_torus();
    for (context, candidate, faces) in candidates(&mesh, PlacementKind::Midpoint).iter().step_by(37) {
        let rings = context.ends.map(|v| faces.faces_around(v).collect::<Vec<_>>());
        let [a, b] = context.ends;
        let second = rings[1].iter().filter(|face| face.x != a && face.y != a).map(|face| (b, face));
        let sum: f64 = rings[0]
            .iter()
            .map(|face| (a, face))
            .chain(second)
            .map(|(v, face)| {
                let [p, x, y] = [v, face.x, face.y].map(|v| faces.point(v));
                ((x - p).cross(y - p).dot(candidate.position - p) / 6.0).powi(2)
            })
            .sum();
        assert!((candidate.cost / sum - 1.0).abs() < 1e-6, "{} for {sum}", candidate.cost);
    }
}

/// A flat sheet with eight shallow waves around it: a border that turns at every vertex.
fn wavy_sheet() -> Mesh {
    let mut mesh = shapes::grid(24);
    for p in &mut mesh.positions {
        let (x, y) = (p[0] - 0.5, p[1] - 0.5);
        let reach = 1.0 + 0.1 * (8.0 * y.atan2(x)).sin();
        (p[0], p[1]) = (x * reach, y * reach);
    }
    mesh
}

#[test]
fn lindstrom_turk_keeps_the_area_inside_a_flat_border() {
    let mesh = wavy_sheet();
    let (mut kept, mut all) = (0, 0);
    for (context, candidate, faces) in candidates(&mesh, PlacementKind::OptimalVolume) {
        // what the faces around the edge cover, before and after
        let p = candidate.position;
        let [a, b] = context.ends;
        let second = faces.faces_around(b).filter(|face| face.x != a && face.y != a).map(|face| (b, face));
        let star: Vec<_> = faces.faces_around(a).map(|face| (a, face)).chain(second).collect();
        let covered = |moved: bool| -> f64 {
            let area = |&(v, face): &(u32, RingFace)| {
                let at = |w: u32| if moved && (w == a || w == b) { p } else { faces.point(w) };
                let [o, x, y] = [v, face.x, face.y].map(at);
                (x - o).cross(y - o).z / 2.0
            };
            star.iter().map(area).sum()
        };
        let (before, after) = (covered(false), covered(true));
        all += 1;
        kept += usize::from((before - after).abs() < 1e-9 * before);
    }
    // all but at sharp corners, where the point would be out of reach
    assert!(kept * 100 >= all * 95, "{kept} of {all}");
    for boundary in [EdgePolicy::Preserve, EdgePolicy::Hold] {
        for target in [400, 100] {
            let options = SimplifyOptions { metric: MetricKind::LindstromTurk, boundary, ..to(target) };
            let (result, report) = reduced(&mesh, &options);
            assert_eq!(report.stopped, Stop::Triangles);
            let ratio = area(&result) / area(&mesh);
            assert!((ratio - 1.0).abs() < 1e-3, "{boundary:?}, {target}: {ratio}");
            assert!(result.positions.iter().all(|p| p[2].abs() < 1e-6));
        }
    }
}

#[test]
fn lindstrom_turk_takes_any_input() {
    let mut three = shapes::grid(6);
    // a third sheet on an edge inside, wound the other way round, and a lonely triangle
    let far = three.vertex_count() as u32;
    three.positions.extend([[0.5, 0.5, 1.0], [3.0, 3.0, 3.0], [3.0, 4.0, 3.0], [4.0, 3.0, 3.0]]);
    let triangles: Vec<[u32; 3]> = (0..three.triangle_count()).map(|t| three.triangle_vertices(t)).collect();
    let [a, b, _] = triangles[20];
    let all = triangles.into_iter().chain([[a, b, far], [far + 1, far + 2, far + 3], [a, a, b]]).collect();
    let mesh = Mesh::from_triangles(three.positions, all).expect("indices are in range");
    for (name, placement) in PlacementKind::NAMES {
        for topology in [TopologyPolicy::Preserve, TopologyPolicy::Manifold, TopologyPolicy::Free] {
            let metric = MetricKind::LindstromTurk;
            let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, topology, ..to(8) });
            assert!(result.triangle_count() < 40, "{name}, {topology:?}: {}", result.triangle_count());
        }
    }
}

#[test]
fn a_hub_of_many_faces_does_not_take_for_ever() {
    let rim = 40_000_u32;
    let point = |i: u32| {
        let angle = std::f32::consts::TAU * i as f32 / rim as f32;
        [angle.cos(), angle.sin(), 0.01 * noise(i)]
    };
    let positions = std::iter::once([0.0, 0.0, 1.0]).chain((0..rim).map(point)).collect();
    let triangles = (0..rim).map(|i| [0, 1 + i, 1 + (i + 1) % rim]).collect();
    let mesh = Mesh::from_triangles(positions, triangles).expect("indices are in range");
    let start = std::time::Instant::now();
    reduced(&mesh, &SimplifyOptions { metric: MetricKind::LindstromTurk, ..to(10_000) });
    assert!(start.elapsed().as_secs() < 60, "{:?}", start.elapsed());
}

#[test]
fn normalized_costs_are_the_quadric_over_its_weight() {
    let mesh = dented_torus();
    let faces = faces_of(&mesh);
    let features = Features::default();
    let options = QuadricOptions {
        face: FaceQuadric::Plane,
        line: 0.0,
        weight: QuadricWeight::Area,
        placement: PlacementKind::Midpoint,
        constraint: None,
        memory: QuadricMemory::Summed,
        normalized: true,
    };
    let mut metric = QuadricMetric::new(options);
    metric.prepare(&faces, &features);
    for edge in (0..faces.edge_count() as u32).step_by(31) {
        let ends = faces.ends(edge);
        let context = EdgeContext { ends, points: ends.map(|v| faces.point(v)), anchor: Anchor::Free };
        let candidate = metric.evaluate(&faces, &features, &context).expect("it forbids nothing");
        let (mut squares, mut weights) = (0.0, 0.0);
        for v in ends {
            for face in faces.faces_around(v) {
                let [a, x, y] = [v, face.x, face.y].map(|v| faces.point(v));
                let scaled = (x - a).cross(y - a);
                squares += scaled.normalize().dot(candidate.position - a).powi(2) * scaled.length() / 2.0;
                weights += scaled.length() / 2.0;
            }
        }
        let mean = squares / weights;
        assert!((candidate.cost / mean - 1.0).abs() < 1e-6, "{} for {mean}", candidate.cost);
    }
}

#[test]
fn without_noise_and_lines_the_metrics_are_that_of_garland_and_heckbert() {
    let mesh = dented_torus();
    let plain = reduced(&mesh, &SimplifyOptions { metric: MetricKind::ConstrainedQuadric, ..to(400) }).0;
    let none = SimplifyOptions { position_sigma: 0.0, normal_sigma: 0.0, line_weight: 0.0, ..to(400) };
    let lines = reduced(&mesh, &SimplifyOptions { metric: MetricKind::LineQuadrics, ..none.clone() }).0;
    assert!(lines == plain);
    for metric in [MetricKind::ProbabilisticPlane, MetricKind::ProbabilisticTriangle] {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, ..none.clone() });
        let distance = laws::measured(&plain, &result).rms();
        assert!(distance < 0.02, "{metric:?}: {distance}"); // rounding decides among equals
    }
}

#[test]
fn memory_is_that_of_the_metric_unless_it_is_chosen() {
    let mesh = dented_torus();
    let of = |metric, memory| reduced(&mesh, &SimplifyOptions { metric, memory, ..to(400) }).0;
    let named = [
        (MetricKind::ConstrainedQuadric, QuadricMemory::Summed),
        (MetricKind::ConstrainedMemorylessQuadric, QuadricMemory::Rebuilt),
        (MetricKind::HybridQuadric, QuadricMemory::Both),
    ];
    for (metric, memory) in named {
        let expected = of(metric, None);
        for (other, _) in named {
            assert!(of(other, Some(memory)) == expected, "{other:?} with {memory:?}");
        }
    }
}

/// A bumpy sheet whose triangles are long and thin.
fn needles() -> Mesh {
    let mut mesh = shapes::grid(40);
    for (i, p) in (0..).zip(&mut mesh.positions) {
        p[1] *= 0.05;
        p[2] = 0.02 * (9.0 * p[0]).sin() + 1e-4 * noise(i);
    }
    mesh
}

#[test]
fn noise_and_lines_make_better_triangles() {
    let mesh = needles();
    let quality = |metric| {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, ..to(400) });
        let of = |t| {
            let [a, b, c] =
                result.triangle_vertices(t).map(|v| glam::Vec3::from(result.positions[v as usize]).as_dvec3());
            triangle_quality(a, b, c)
        };
        (0..result.triangle_count()).map(of).sum::<f64>() / result.triangle_count() as f64
    };
    let plain = quality(MetricKind::ConstrainedQuadric);
    for metric in [MetricKind::ProbabilisticPlane, MetricKind::LineQuadrics] {
        let better = quality(metric);
        assert!(better > plain, "{metric:?}: {better} for {plain}");
    }
}

/// The angle between each original normal and that of the triangle which stands for it, by brute force: who stands for
/// whom is carried along as sets.
fn largest_deviation(mesh: &Mesh, most: f64, target: usize) -> (f64, Outcome) {
    let mut faces = faces_of(mesh);
    let options = to(target);
    let mut features = features_of(mesh, &faces, &options);
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
    let original: Vec<DVec3> = (0..faces.face_count())
        .map(|f| faces.face(f).map_or(DVec3::ZERO, |corners| normal(corners.map(|v| faces.point(v)))))
        .collect();
    let mut stands_for: Vec<Vec<u32>> = (0..original.len() as u32).map(|f| vec![f]).collect();
    let mut witness = Witness(|collapse: &Collapse<'_>| {
        let star: &EdgeStar<'_> = &collapse.star;
        let rings = || star.kept_ring.iter().chain(star.removed_ring);
        let killed: Vec<_> = star.kept_ring.iter().filter(|face| star.kills(face)).copied().collect();
        for dead in killed {
            let apex = if dead.x == star.removed { dead.y } else { dead.x };
            let gone = std::mem::take(&mut stands_for[dead.face as usize]);
            for heir in rings().filter(|face| !star.kills(face) && (face.x == apex || face.y == apex)) {
                stands_for[heir.face as usize].extend(&gone);
            }
        }
    });
    let limits = Limits {
        topology: TopologyPolicy::Preserve,
        parts_may_go: false,
        min_normal_cos: Some(0.2),
        max_normal_deviation: Some(most),
        valence: None,
        min_quality: None,
        max_error_sq: None,
        no_self_intersections: false,
    };
    let request = Request { order: Order::Exact, target_faces: target, limits, importance: &[], strictness: &[] };
    let mut metric = LindstromTurk::new(PlacementKind::OptimalVolume, 1.0, true);
    let outcome =
        collapse_edges(&mut faces, &mut metric, &mut features, &mut witness, &request, Control::default()).unwrap();
    let mut largest = 0.0_f64;
    for (f, originals) in stands_for.iter().enumerate() {
        let Some(corners) = faces.face(f) else { continue };
        let now = normal(corners.map(|v| faces.point(v)));
        for &old in originals {
            let old = original[old as usize];
            largest = largest.max(now.cross(old).length().atan2(now.dot(old)));
        }
    }
    (largest, outcome)
}

#[test]
fn no_triangle_deviates_from_the_normals_that_it_stands_for() {
    for mesh in [shapes::sphere(4), dented_torus()] {
        for degrees in [10.0_f64, 30.0, 60.0] {
            let most = degrees.to_radians();
            let (largest, outcome) = largest_deviation(&mesh, most, 0);
            assert!(largest <= most + 1e-4, "{} of {degrees}", largest.to_degrees());
            assert!(outcome.refused.normal_deviation > 0 && outcome.collapses > 20, "{outcome:?}");
        }
    }
}

#[test]
fn deviations_add_up_where_turns_do_not() {
    let mesh = shapes::sphere(4);
    let free = reduced(&mesh, &SimplifyOptions { max_normal_turn: Some(0.5), ..to(8) });
    let bound = reduced(&mesh, &SimplifyOptions { max_normal_deviation: Some(0.5), ..to(8) });
    assert_eq!(bound.1.stopped, Stop::NoLegalCollapse);
    assert!(bound.0.triangle_count() > 2 * free.0.triangle_count(), "{:?} {:?}", bound.1, free.1);
    let flat = shapes::grid(12);
    let (result, report) = reduced(&flat, &SimplifyOptions { max_normal_deviation: Some(0.01), ..to(4) });
    assert!(result.triangle_count() <= 8, "{report:?}");
}

#[test]
fn silhouettes_get_more_of_the_triangles() {
    let mut mesh = shapes::sphere(5);
    mesh.positions.iter_mut().for_each(|p| p[0] *= 4.0);
    let at_tips = |silhouette_weight| {
        let (result, _) = reduced(&mesh, &SimplifyOptions { silhouette_weight, ..to(500) });
        result.positions.iter().filter(|p| p[0].abs() > 3.5).count()
    };
    let (plain, weighted) = (at_tips(0.0), at_tips(4.0));
    assert!(weighted > plain, "{weighted} for {plain}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// Turned in space, the cost and the place are turned, whatever the axes.
    #[test]
    fn lindstrom_turk_knows_no_axes(angle in 0.1..3.0_f64, x in -1.0..1.0_f64, y in -1.0..1.0_f64) {
        let mesh = dented_torus();
        let turn = glam::DQuat::from_axis_angle(DVec3::new(x, y, 0.7).normalize(), angle);
        let mut turned = mesh.clone();
        for p in &mut turned.positions {
            *p = (turn * glam::Vec3::from(*p).as_dvec3()).as_vec3().to_array();
        }
        let (one, other) =
            (candidates(&mesh, PlacementKind::OptimalVolume), candidates(&turned, PlacementKind::OptimalVolume));
        let unit = |faces: &CollapseMesh| faces.frame().unit();
        let mut same = 0;
        for ((_, a, here), (_, b, there)) in one.iter().zip(&other) {
            let [p, q] = [(a, here), (b, there)].map(|(c, faces)| glam::Vec3::from(faces.frame().leave(c.position)).as_dvec3());
            let [a, b] = [(a, here), (b, there)].map(|(c, faces)| c.cost * unit(faces).powi(6));
            same += usize::from((turn * p).distance(q) < 1e-3 && (a - b).abs() < 1e-3 * a.max(b));
        }
        prop_assert!(same * 100 >= one.len() * 98, "{} of {}", same, one.len());
        prop_assert!(CornerTable::of_vertices(&mesh).is_closed());
    }
}
