//! Borders, seams, materials, locks, importance, joining, valence, quality, topology.

use super::*;
use crate::measure::{area, boundary_length};
use crate::topology::CornerTable;

/// The upper and the lower half of a sphere, with a border each at the same places.
fn half_spheres() -> Mesh {
    let whole = shapes::sphere(3);
    let upper = |t: &usize| whole.triangle_points(*t).iter().map(|p| p.z).sum::<f64>() > 0.0;
    let mut names = BTreeMap::new();
    let mut mesh = Mesh::default();
    for t in 0..whole.triangle_count() {
        let triangle = whole.triangle_vertices(t).map(|v| {
            *names.entry((upper(&t), v)).or_insert_with(|| {
                mesh.positions.push(whole.positions[v as usize]);
                mesh.positions.len() as u32 - 1
            })
        });
        mesh.triangles.push(triangle);
    }
    mesh.wedge_vertices = (0..mesh.positions.len() as u32).collect();
    mesh
}

fn contains_all(mesh: &Mesh, wanted: impl IntoIterator<Item = [f32; 3]>) -> bool {
    let there = position_bits(mesh);
    wanted.into_iter().all(|p| there.binary_search(&p.map(f32::to_bits)).is_ok())
}

#[test]
fn locked_borders_keep_every_vertex_and_free_ones_shrink() {
    let mesh = terrain(16);
    let border = mesh.positions.iter().copied().filter(|p| p[..2].iter().any(|x| *x == 0.0 || *x == 1.0));
    let border: Vec<_> = border.collect();
    for (metric, placement, way) in every_way() {
        let with = |boundary| reduced(&mesh, &SimplifyOptions { metric, placement, boundary, ..to(100) }).0;
        assert!(contains_all(&with(EdgePolicy::Lock), border.iter().copied()), "{way}");
        assert!(!contains_all(&with(EdgePolicy::Preserve), border.iter().copied()), "{way}");
    }
    let sheet = shapes::grid(16);
    let with = |boundary| {
        let options = SimplifyOptions { metric: MetricKind::Quadric, boundary, ..to(40) };
        area(&reduced(&sheet, &options).0)
    };
    assert!(with(EdgePolicy::Free) < 0.9, "without constraint planes a sheet may shrink for nothing");
    let kept = with(EdgePolicy::Preserve);
    assert!(kept > 0.9, "{kept}: a preserved border is not pulled off, whatever the metric");
}

#[test]
fn preserved_borders_are_not_pulled_off_without_constraint_planes() {
    let mesh = shapes::grid(10);
    for metric in [MetricKind::ShortestEdge, MetricKind::Quadric, MetricKind::MemorylessQuadric] {
        for (name, placement) in PlacementKind::NAMES {
            let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(60) });
            let table = CornerTable::of_vertices(&result);
            let on_border = table.corners().filter(|&c| table.is_boundary(c)).map(|c| table.vertex(c).0);
            for p in on_border.map(|v| result.positions[v as usize]) {
                // corners may be cut by a step, not more
                let inside = p[..2].iter().map(|x| x.min(1.0 - x)).fold(f32::INFINITY, f32::min);
                assert!(inside < 0.11, "{metric:?}, {name}: {p:?} is on the border now");
            }
        }
    }
}

#[test]
fn seams_lock_preserve_and_close() {
    let mesh = cylinder(24, 16);
    let seam = (0..=16).map(|j| mesh.positions[24 * j]);
    let locked = SimplifyOptions { seams: EdgePolicy::Lock, ..to(150) };
    assert!(contains_all(&reduced(&mesh, &locked).0, seam.clone()));
    assert!(!contains_all(&reduced(&mesh, &to(150)).0, seam));
}

#[test]
fn held_seams_stay_straight_and_do_not_block() {
    let mesh = cylinder(24, 16);
    let (held, report) = reduced(&mesh, &to(60));
    assert_eq!(report.stopped, Stop::Triangles);
    // where two wedges meet at a vertex, that vertex is on the seam still
    let mut wedges = vec![0; held.vertex_count()];
    held.wedge_vertices.iter().for_each(|&v| wedges[v as usize] += 1);
    let on_seam = |v: &usize| wedges[*v] > 1;
    assert!((0..held.vertex_count()).filter(on_seam).count() >= 2);
    assert!((0..held.vertex_count()).filter(on_seam).all(|v| held.positions[v][1].abs() < 0.05));
    // a chart for every triangle: with nothing but seams, only a policy that may cross them reaches the target
    let mut patchwork = shapes::sphere(3);
    patchwork.wedge_vertices = (0..patchwork.triangle_count()).flat_map(|t| patchwork.triangle_vertices(t)).collect();
    patchwork.triangles = (0..patchwork.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let uv = (0..patchwork.wedge_vertices.len() as u32 * 2).map(noise).collect();
    patchwork.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    assert_eq!(reduced(&patchwork, &to(100)).1.stopped, Stop::Triangles);
    let preserved = SimplifyOptions { seams: EdgePolicy::Preserve, ..to(100) };
    assert_eq!(reduced(&patchwork, &preserved).1.stopped, Stop::NoLegalCollapse);
}

#[test]
fn materials_keep_their_areas() {
    let mut mesh = shapes::grid(16);
    let side = |mesh: &Mesh, t| u32::from(mesh.triangle_points(t).iter().map(|p| p.x).sum::<f64>() > 1.5);
    mesh.triangle_materials = (0..mesh.triangle_count()).map(|t| side(&mesh, t)).collect();
    let (result, report) = reduced(&mesh, &to(8));
    assert!(result.triangle_count() <= 16 && report.error < 1e-6, "{report:?}");
    assert!((0..result.triangle_count()).all(|t| side(&result, t) == result.triangle_material(t)));
    let mut left = result.clone();
    left.retain_triangles(|t| result.triangle_material(t as usize) == 0);
    assert!((area(&left) - 0.5).abs() < 1e-5 && (boundary_length(&left) - 3.0).abs() < 1e-5);
    let locked = SimplifyOptions { material_borders: EdgePolicy::Lock, ..to(8) };
    assert!(contains_all(&reduced(&mesh, &locked).0, (0..=16).map(|i| [0.5, i as f32 / 16.0, 0.0])));
}

#[test]
fn locked_vertices_stay() {
    let mut mesh = dented_torus();
    mesh.positions.reverse(); // so that the order in memory is not that in space
    let last = mesh.vertex_count() as u32 - 1;
    mesh.triangles.iter_mut().flatten().for_each(|v| *v = last - *v);
    let locked: Vec<bool> = (0..mesh.vertex_count()).map(|v| v % 23 == 0).collect();
    let places: Vec<_> = mesh.positions.iter().zip(&locked).filter(|(_, locked)| **locked).map(|(p, _)| *p).collect();
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, locked: locked.clone(), ..to(300) });
        assert!(contains_all(&result, places.iter().copied()), "{way}");
    }
}

#[test]
fn a_mesh_that_is_all_locked_says_so() {
    let mesh = shapes::sphere(2);
    let (result, report) = reduced(&mesh, &SimplifyOptions { locked: vec![true; mesh.vertex_count()], ..to(10) });
    assert_eq!((result.triangle_count(), report.stopped), (mesh.triangle_count(), Stop::NoLegalCollapse));
    assert_eq!((report.collapses, report.refused.locked), (0, 192), "every edge was refused once");
}

#[test]
fn what_matters_keeps_more_triangles() {
    let mesh = terrain(32);
    let importance: Vec<f32> = mesh.positions.iter().map(|p| if p[0] < 0.5 { 100.0 } else { 1.0 }).collect();
    let left = |mesh: &Mesh| (0..mesh.triangle_count()).filter(|&t| mesh.triangle_points(t)[0].x < 0.5).count();
    for (metric, placement, way) in every_way() {
        let even = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(400) }).0;
        let options = SimplifyOptions { metric, placement, importance: importance.clone(), ..to(400) };
        let uneven = reduced(&mesh, &options).0;
        assert!(
            left(&uneven) * 2 > left(&even) * 3 || left(&uneven) > 330,
            "{way}: {} of {}",
            left(&uneven),
            left(&even)
        );
    }
}

#[test]
fn one_importance_for_all_changes_nothing() {
    let mesh = dented_torus();
    let with = |importance: f32| {
        let importance = vec![importance; mesh.vertex_count()];
        let (mesh, mut report) = reduced(&mesh, &SimplifyOptions { importance, ..to(300) });
        report.curve.clear(); // costs are as many times as high
        (mesh, report)
    };
    let mut plain = reduced(&mesh, &to(300));
    plain.1.curve.clear();
    assert!(with(1.0) == plain && with(16.0) == plain);
}

#[test]
fn close_halves_join() {
    let mesh = half_spheres();
    assert_eq!(CornerTable::of_vertices(&mesh).components().list().len(), 2);
    for boundary in [EdgePolicy::Preserve, EdgePolicy::Free] {
        for distance in [0.0, 1e-3] {
            let (result, report) =
                reduced(&mesh, &SimplifyOptions { join_distance: Some(distance), boundary, ..to(200) });
            assert_eq!((result.triangle_count(), report.stopped), (200, Stop::Triangles));
            let table = CornerTable::of_vertices(&result);
            assert!(table.is_closed(), "{boundary:?}, {distance}: the halves have joined");
            assert_eq!((table.euler_characteristic(), table.components().list().len()), (2, 1));
        }
    }
    let apart = CornerTable::of_vertices(&reduced(&mesh, &to(200)).0).components().list().len();
    assert_eq!(apart, 2, "not unasked");
}

#[test]
fn valences_stay_in_their_range() {
    let mesh = shapes::sphere(4);
    let valences = |mesh: &Mesh| {
        let table = CornerTable::of_vertices(mesh);
        table.vertices().map(|v| table.valence(v)).collect::<Vec<_>>()
    };
    for (low, high) in [(4, 7), (4, 11)] {
        for (metric, placement, way) in every_way() {
            let options = SimplifyOptions { metric, placement, valence: Some((low, high)), ..to(300) };
            let (result, _) = reduced(&mesh, &options);
            assert!(result.triangle_count() < 800, "{way}");
            assert!(valences(&result).iter().all(|&n| (low as usize..=high as usize).contains(&n)), "{way}");
        }
    }
}

#[test]
fn triangles_stay_well_shaped() {
    let mesh = shapes::sphere(4);
    let worst = |mesh: &Mesh| {
        let quality = |t| {
            let [a, b, c] = mesh.triangle_points(t);
            triangle_quality(a, b, c)
        };
        (0..mesh.triangle_count()).map(quality).fold(1.0, f64::min)
    };
    assert!(worst(&mesh) > 0.6);
    for (metric, placement, way) in every_way() {
        let (result, report) =
            reduced(&mesh, &SimplifyOptions { metric, placement, min_quality: Some(0.5), ..to(300) });
        assert!(result.triangle_count() < 800, "{way}: {report:?}");
        assert!(worst(&result) > 0.5 - 1e-6, "{way}: {}", worst(&result));
    }
}

#[test]
fn only_the_link_condition_keeps_a_thin_handle() {
    let mesh = shapes::torus(2.0, 0.1, 24, 4);
    let topology = TopologyPolicy::Preserve;
    let options = SimplifyOptions { metric: MetricKind::ShortestEdge, max_normal_turn: None, topology, ..to(4) };
    let (kept, report) = reduced(&mesh, &options);
    let table = CornerTable::of_vertices(&kept);
    assert!(table.report().is_manifold() && table.is_closed() && table.euler_characteristic() == 0);
    assert_eq!(report.stopped, Stop::NoLegalCollapse);
    assert!(report.refused.topology > 0);
    let (free, report) = reduced(&mesh, &SimplifyOptions { topology: TopologyPolicy::Free, ..options });
    assert!(free.triangle_count() <= 4 && report.stopped == Stop::Triangles);
    assert_eq!(report.refused, Refusals::default());
}

#[test]
fn bridges_between_three_parts_stay() {
    // a triangle whose corners hang on three tetrahedra: its edges all are open, and it must not vanish
    let part =
        |first: u32| [[first, first + 1, first + 2], [first, first + 3, first + 1], [first, first + 2, first + 3]];
    let mut triangles: Vec<[u32; 3]> = [0, 4, 8].into_iter().flat_map(part).collect();
    triangles.push([0, 4, 8]);
    let point = |i: u32| [noise(3 * i) + (i / 4 * 9) as f32, noise(3 * i + 1), noise(3 * i + 2)];
    let mut mesh = Mesh::from_triangles((0..12).map(point).collect(), triangles).unwrap();
    for v in [0, 4, 8] {
        mesh.positions[v] = [4.0 + noise(v as u32), noise(v as u32 + 50), 0.1];
    }
    let topology = TopologyPolicy::Preserve;
    let options = SimplifyOptions { max_normal_turn: None, boundary: EdgePolicy::Free, topology, ..to(0) };
    let (result, _) = reduced(&mesh, &options);
    assert_eq!(
        CornerTable::of_vertices(&result).components().list().len(),
        CornerTable::of_vertices(&mesh).components().list().len()
    );
    assert_eq!(
        CornerTable::of_vertices(&result).euler_characteristic(),
        CornerTable::of_vertices(&mesh).euler_characteristic()
    );
}

#[test]
fn locked_vertices_keep_a_face_when_their_part_could_go() {
    let triangle = Mesh::from_triangles(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
    let ear = Mesh::from_triangles(
        vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.5]],
        vec![[0, 1, 2], [2, 1, 3]],
    );
    for mesh in [triangle, ear.unwrap(), shapes::tetrahedron(), shapes::sphere(1)] {
        for lock in 0..mesh.vertex_count() {
            let mut locked = vec![false; mesh.vertex_count()];
            locked[lock] = true;
            for (name, topology) in TopologyPolicy::NAMES {
                let options = SimplifyOptions { topology, max_normal_turn: None, boundary: EdgePolicy::Free, ..to(0) };
                let gone = reduced(&mesh, &options).0;
                assert_eq!(gone.triangle_count() == 0, topology != TopologyPolicy::Preserve, "{name}");
                let (kept, report) = reduced(&mesh, &SimplifyOptions { locked: locked.clone(), ..options });
                assert!(contains_all(&kept, [mesh.positions[lock]]), "{name}: {report:?}");
            }
        }
    }
}
