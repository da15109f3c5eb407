//! Every repair leaves none of its defect, on the zoo and on random triangles, and does nothing where there is none.

use proptest::prelude::*;

use super::*;
use crate::mesh::{Attribute, MorphTarget, Semantic, shapes};
use crate::topology::CornerTable;
use crate::zoo::{Specimen, grid_with_hole, zoo};

fn points(count: u32) -> Vec<[f32; 3]> {
    (0..count).map(|i| [(i as f32).cos(), (i as f32 * 2.0).sin(), 0.1 * i as f32]).collect()
}

fn volume(mesh: &Mesh) -> f64 {
    (0..mesh.triangle_count()).map(|t| mesh.triangle_points(t)).map(|[a, b, c]| a.cross(b).dot(c) / 6.0).sum()
}

#[test]
fn diagnosis_of_the_zoo_is_what_is_known() {
    for Specimen { name, mesh, euler, components, orientable, boundary_edges, .. } in zoo() {
        let found = diagnose(&mesh);
        assert_eq!(found.euler_characteristic, euler, "{name}");
        assert_eq!(found.components, components as usize, "{name}");
        assert_eq!(found.orientable, orientable, "{name}");
        assert_eq!(found.boundary_edges, boundary_edges as usize, "{name}");
    }
    let found = diagnose(&grid_with_hole());
    assert_eq!((found.boundary_loops, found.genus, found.closed), (2, Some(0), false));
    let found = diagnose(&crate::zoo::moebius(9));
    assert_eq!((found.boundary_loops, found.genus, found.orientable), (1, None, false));
    let found = diagnose(&shapes::torus(2.0, 0.5, 20, 10));
    assert_eq!((found.boundary_loops, found.genus, found.closed), (0, Some(1), true));
    assert_eq!(found.defects().count(), 0);
}

#[test]
fn what_is_sound_stays_as_it_is() {
    for mesh in [shapes::sphere(2), shapes::grid(3), grid_with_hole(), shapes::torus(2.0, 0.5, 9, 7)] {
        let mut mended = mesh.clone();
        repair(&mut mended, &[Repair::DropUnreferenced]);
        let before = mended.clone();
        assert!(repair(&mut mended, &NAMES.map(|(_, repair, _)| repair)).is_unchanged());
        assert_eq!(mended, before);
    }
}

#[test]
fn names_are_read_back() {
    for (name, repair, _) in NAMES {
        assert_eq!(name.parse(), Ok(repair));
        assert_eq!(repair.name(), name);
    }
    let weld = Repair::Weld(WeldOptions { tolerance: 1e-3, wedge_tolerance: None });
    assert_eq!("weld=1e-3".parse(), Ok(weld));
    for bad in ["weld=-1", "weld=nan", "weld=", "drop-degenerate=1"] {
        assert!(matches!(bad.parse::<Repair>(), Err(ParseRepairError::BadValue { .. })), "{bad}");
    }
    assert!("mend".parse::<Repair>().unwrap_err().to_string().contains("unify-winding"));
}

#[test]
fn non_finite_goes_with_its_triangles_or_to_zero() {
    let mut mesh = shapes::tetrahedron();
    mesh.positions[3][1] = f32::INFINITY;
    mesh.wedge_attributes = vec![Attribute::new_f32(Semantic::Color(0), 3, (0..12).map(|i| i as f32).collect())];
    mesh.wedge_attributes[0].as_f32_mut().unwrap()[1] = f32::NAN;
    let attributes = vec![Attribute::new_f32(Semantic::Position, 3, vec![f32::NEG_INFINITY; 12])];
    mesh.morph_targets = vec![MorphTarget { name: "m".into(), attributes }];
    assert_eq!((diagnose(&mesh).non_finite_positions, diagnose(&mesh).non_finite_attributes), (1, 5));
    assert!(mesh.check_finite().is_err());
    let report = repair(&mut mesh, &[Repair::DropNonFinite]);
    assert_eq!((report.non_finite_vertices_dropped, report.non_finite_triangles_dropped), (1, 3));
    assert_eq!(report.non_finite_values_zeroed, 13);
    assert_eq!((mesh.check(), mesh.check_finite()), (Ok(()), Ok(())));
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(mesh.wedge_attributes[0].as_f32().unwrap(), [0., 0., 2., 3., 4., 5., 6., 7., 8.]);
}

#[test]
fn duplicates_are_told_apart_by_winding_and_the_first_stays() {
    let triangles = vec![[0, 1, 2], [2, 1, 3], [1, 0, 2], [1, 2, 0], [2, 1, 0], [0, 1, 4]];
    let mesh =
        Mesh { triangle_materials: vec![0, 1, 2, 3, 4, 5], ..Mesh::from_triangles(points(5), triangles).unwrap() };
    let found = diagnose(&mesh);
    assert_eq!((found.duplicate_triangles, found.opposite_duplicates), (2, 1));
    let mut same = mesh.clone();
    assert_eq!(repair(&mut same, &[Repair::DropDuplicates]).duplicates_dropped, 2);
    assert_eq!(same.triangle_materials, [0, 1, 2, 5]);
    let mut opposite = mesh;
    assert_eq!(repair(&mut opposite, &[Repair::DropOppositeDuplicates]).opposite_duplicates_dropped, 2);
    assert_eq!(opposite.triangle_materials, [0, 1, 3, 5]);
}

#[test]
fn needles_have_no_area_and_small_triangles_do() {
    let positions =
        vec![[0.0; 3], [0.1, 0.2, 0.0], [0.3, 0.6, 0.0], [1e-20, 0.0, 0.0], [0.0, 1e-20, 0.0], [f32::NAN; 3]];
    let triangles = vec![[0, 1, 2], [0, 3, 4], [0, 1, 3], [0, 1, 5]];
    let mut mesh = Mesh::from_triangles(positions, triangles).unwrap();
    assert_eq!(diagnose(&mesh).zero_area_triangles, 2);
    assert_eq!(repair(&mut mesh, &[Repair::DropZeroArea]).zero_area_dropped, 2);
    assert_eq!(mesh.triangles, [[0, 3, 4], [0, 1, 5]]);
}

#[test]
fn splitting_adds_only_what_it_must() {
    let added = |name: &str| {
        let mut mesh = zoo().into_iter().find(|s| s.name == name).unwrap().mesh;
        let report = repair(&mut mesh, &[Repair::SplitNonManifold]);
        assert_eq!(mesh.check(), Ok(()));
        (report.vertices_added, report.wedges_added)
    };
    assert_eq!(added("two cones at a vertex"), (1, 1));
    assert_eq!(added("two tetrahedra at an edge"), (2, 2));
    assert_eq!(added("three faces on an edge"), (4, 4));
    assert_eq!(added("moebius band"), (0, 0));
    assert_eq!(added("two faces wound against each other"), (0, 0));
}

#[test]
fn splitting_takes_the_wedges_of_a_seam_along() {
    let mut mesh = zoo().into_iter().find(|s| s.name == "two cones at a vertex").unwrap().mesh;
    // the apex has a wedge for each cone already
    mesh.wedge_vertices.push(0);
    for triangle in &mut mesh.triangles[3..] {
        triangle[0] = 7;
    }
    let report = repair(&mut mesh, &[Repair::SplitNonManifold]);
    assert_eq!((report.vertices_added, report.wedges_added), (1, 0));
    assert_eq!((mesh.wedge_vertices[0], mesh.wedge_vertices[7]), (0, 7));
}

#[test]
fn winding_is_unified_by_majority_and_outwards_if_closed() {
    let turn = |mesh: &Mesh, which: &[usize]| {
        let mut mesh = mesh.clone();
        which.iter().for_each(|&t| mesh.triangles[t].swap(1, 2));
        mesh
    };
    let grid = shapes::grid(3);
    let mut mesh = turn(&grid, &[0, 4, 5, 11]);
    assert_eq!(repair(&mut mesh, &[Repair::UnifyWinding]).triangles_turned, 4);
    assert_eq!(CornerTable::of_vertices(&mesh).report().inconsistent_edges, 0);
    assert!(mesh.triangles.iter().zip(&grid.triangles).all(|(a, b)| a == b));
    let sphere = shapes::sphere(1);
    let most: Vec<usize> = (0..30).collect();
    let mut mesh = turn(&sphere, &most);
    assert_eq!(repair(&mut mesh, &[Repair::UnifyWinding]).triangles_turned, 30);
    assert_eq!(volume(&mesh), volume(&sphere));
    let mut mesh = turn(&sphere, &(0..32).collect::<Vec<_>>());
    assert!(repair(&mut mesh, &[Repair::UnifyWinding]).is_unchanged(), "it may be a cavity");
    assert_eq!(repair(&mut mesh, &[Repair::OrientOutward]).triangles_turned, 32);
    assert_eq!(volume(&mesh), volume(&sphere));
    let mut mesh = crate::zoo::moebius(8);
    let report = repair(&mut mesh, &[Repair::UnifyWinding]);
    assert_eq!((report.triangles_turned, report.non_orientable_surfaces), (0, 1));
}

#[test]
fn small_components_and_what_nothing_refers_to_go() {
    let mut mesh = shapes::sphere(1);
    mesh.positions.extend(points(4));
    mesh.wedge_vertices.extend(18..22);
    mesh.triangles.push([18, 19, 20]);
    let report = repair(&mut mesh, &[Repair::DropSmallComponents { min_triangles: 2 }, Repair::DropUnreferenced]);
    assert_eq!((report.small_components_dropped, report.small_component_triangles_dropped), (1, 1));
    assert_eq!((report.unreferenced_vertices_dropped, report.unreferenced_wedges_dropped), (4, 4));
    assert_eq!(mesh, shapes::sphere(1));
}

fn soups() -> impl Strategy<Value = Mesh> {
    let triangles = prop::collection::vec(prop::array::uniform3(0u32..12), 0..24);
    (triangles, prop::collection::vec(0u32..9, 12)).prop_map(|(triangles, wedge_vertices)| Mesh {
        wedge_vertices,
        ..Mesh { positions: points(9), triangles, ..Mesh::default() }
    })
}

fn assert_mended(mut mesh: Mesh) -> Result<(), TestCaseError> {
    let corners = |mesh: &Mesh| (0..mesh.triangle_count()).map(|t| mesh.triangle_points(t)).collect::<Vec<_>>();
    let before = (corners(&mesh), diagnose(&mesh));
    repair(&mut mesh, &[Repair::SplitNonManifold]);
    let found = diagnose(&mesh);
    prop_assert_eq!(mesh.check(), Ok(()));
    prop_assert_eq!((found.non_manifold_edges, found.non_manifold_vertices), (0, 0));
    prop_assert_eq!(found.degenerate_triangles, before.1.degenerate_triangles);
    prop_assert_eq!(corners(&mesh), before.0);
    let non_orientable = repair(&mut mesh, &[Repair::UnifyWinding]).non_orientable_surfaces;
    let found = diagnose(&mesh);
    prop_assert_eq!(found.orientable, non_orientable == 0);
    prop_assert!(found.inconsistent_edges == 0 || non_orientable > 0);
    repair(&mut mesh, &Repair::STANDARD);
    prop_assert!(diagnose(&mesh).defects().all(|defect| defect.remedy.is_none()));
    Ok(())
}

#[test]
fn the_zoo_is_mended() {
    zoo().into_iter().for_each(|specimen| assert_mended(specimen.mesh).unwrap());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn random_triangles_are_mended(mesh in soups()) {
        assert_mended(mesh)?;
    }

    #[test]
    fn drops_leave_none_of_their_defect(mesh in soups()) {
        let after = |repairs: &[Repair]| {
            let mut mesh = mesh.clone();
            repair(&mut mesh, repairs);
            diagnose(&mesh)
        };
        prop_assert_eq!(after(&[Repair::DropDegenerate]).degenerate_triangles, 0);
        prop_assert_eq!(after(&[Repair::DropDegenerate, Repair::DropZeroArea]).zero_area_triangles, 0);
        prop_assert_eq!(after(&[Repair::DropDuplicates]).duplicate_triangles, 0);
        let found = after(&[Repair::DropOppositeDuplicates]);
        prop_assert_eq!(found.opposite_duplicates, 0);
        let found = after(&[Repair::DropUnreferenced]);
        prop_assert_eq!((found.unreferenced_vertices, found.unreferenced_wedges), (0, 0));
    }
}
