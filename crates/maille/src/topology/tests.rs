//! The corner table against a search through all faces, on the zoo and on random triangles.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::edges::is_degenerate;
use super::*;
use crate::zoo::zoo;

/// Faces at each edge by search: half-edge corners by (lower, upper) vertex.
fn edges_by_search(faces: &[[u32; 3]]) -> BTreeMap<(u32, u32), Vec<u32>> {
    let mut edges = BTreeMap::<_, Vec<u32>>::new();
    for (f, face) in faces.iter().enumerate().filter(|(_, face)| !is_degenerate(face)) {
        for i in 0..3 {
            let (a, b) = (face[i], face[(i + 1) % 3]);
            edges.entry((a.min(b), a.max(b))).or_default().push((3 * f + i) as u32);
        }
    }
    edges
}

fn sorted<T: Ord>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut items: Vec<_> = items.into_iter().collect();
    items.sort();
    items
}

/// Every adjacency of the table must be what a search through all faces finds.
fn assert_agrees_with_search(faces: &[[u32; 3]], vertex_count: usize) {
    let table = CornerTable::build(faces.to_vec(), vertex_count).unwrap();
    let edges = edges_by_search(faces);
    let proper = || (0..faces.len()).filter(|&f| !is_degenerate(&faces[f]));
    let source = |h: u32| faces[h as usize / 3][h as usize % 3];
    let twin = |h: u32| {
        let (a, b) = (source(h), source(if h % 3 == 2 { h - 2 } else { h + 1 }));
        match edges[&(a.min(b), a.max(b))][..] {
            [g, k] if source(g) != source(k) => Some(if g == h { k } else { g }),
            _ => None,
        }
    };
    for h in proper().flat_map(|f| 3 * f as u32..3 * f as u32 + 3) {
        assert_eq!(table.twin(CornerId(h)).map(|t| t.0), twin(h), "twin of c{h}");
        assert_eq!(table.is_boundary(CornerId(h)), twin(h).is_none());
        assert!(table.opposite(CornerId(h)).is_none_or(|o| table.opposite(o) == Some(CornerId(h))));
    }
    for f in table.faces() {
        let around =
            if is_degenerate(&faces[f.index()]) { vec![] } else { (0..3).filter_map(|i| twin(3 * f.0 + i)).collect() };
        assert_eq!(table.face_faces(f).collect::<Vec<_>>(), around.iter().map(|h| FaceId(h / 3)).collect::<Vec<_>>());
        assert_eq!(table.face_vertices(f).map(|v| v.0), faces[f.index()]);
        assert_eq!(table.face_half_edges(f).map(|h| table.vertex(h)), table.face_vertices(f));
    }
    for v in table.vertices() {
        let at =
            sorted(proper().flat_map(|f| 3 * f as u32..3 * f as u32 + 3).filter(|&c| source(c) == v.0).map(CornerId));
        assert_eq!(sorted(table.vertex_outgoing(v)), at);
        assert!(table.vertex_outgoing(v).all(|h| table.vertex(h) == v));
        assert_eq!(sorted(table.vertex_incoming(v)), sorted(at.iter().map(|&c| table.prev(c))));
        assert!(table.vertex_incoming(v).all(|h| table.target(h) == v));
        assert_eq!(sorted(table.vertex_faces(v)), at.iter().map(|c| FaceId(c.0 / 3)).collect::<Vec<_>>());
        let near = edges.keys().filter(|e| e.0 == v.0 || e.1 == v.0).map(|e| VertexId(e.0 + e.1 - v.0));
        let near: BTreeSet<_> = near.collect();
        assert_eq!(table.vertex_vertices(v).collect::<BTreeSet<_>>(), near);
        if table.fans(v).count() <= 1 {
            assert_eq!(table.valence(v), near.len(), "each neighbour of {v:?} once");
        }
        assert_fans_are_in_order(&table, v);
    }
    let report = table.report();
    assert_eq!(report.edges as usize, edges.len());
    assert_eq!(report.boundary_edges as usize, edges.values().filter(|e| e.len() == 1).count());
    assert_eq!(report.non_manifold_edges as usize, edges.values().filter(|e| e.len() > 2).count());
    assert_eq!(report.non_manifold_vertices, non_manifold_vertices_by_search(faces, vertex_count));
    assert_loops_are_closed(&table);
    assert_components_are_surfaces(&table);
}

fn assert_fans_are_in_order(table: &CornerTable, v: VertexId) {
    for fan in table.fans(v) {
        let corners: Vec<_> = fan.corners().collect();
        for pair in corners.windows(2) {
            assert_eq!(table.swing_left(pair[0]), Some(pair[1]));
            assert_eq!(table.swing_right(pair[1]), Some(pair[0]));
        }
        let back = table.swing_left(corners[corners.len() - 1]);
        assert_eq!(back, fan.is_closed().then_some(corners[0]));
        assert_eq!(table.swing_right(corners[0]).is_none(), !fan.is_closed());
        assert_eq!(fan.vertices().count(), corners.len() + usize::from(!fan.is_closed()));
    }
}

/// Vertices whose faces, joined where two share an edge at the vertex and no third does, fall apart.
fn non_manifold_vertices_by_search(faces: &[[u32; 3]], vertex_count: usize) -> u32 {
    let edges = edges_by_search(faces);
    let broken = |&v: &u32| {
        let mut sets = UnionFind::new(faces.len());
        for (_, uses) in edges.iter().filter(|(e, uses)| (e.0 == v || e.1 == v) && uses.len() == 2) {
            sets.union(uses[0] / 3, uses[1] / 3);
        }
        let roots = sets.into_roots();
        let at = (0..faces.len()).filter(|&f| !is_degenerate(&faces[f]) && faces[f].contains(&v));
        at.map(|f| roots[f]).collect::<BTreeSet<_>>().len() > 1
    };
    (0..vertex_count as u32).filter(broken).count() as u32
}

fn assert_loops_are_closed(table: &CornerTable) {
    let loops = table.boundary_loops();
    let mut all = Vec::new();
    for half_edges in loops.iter() {
        for (i, &h) in half_edges.iter().enumerate() {
            assert!(table.is_boundary(h));
            assert_eq!(table.target(h), table.vertex(half_edges[(i + 1) % half_edges.len()]));
        }
        all.extend_from_slice(half_edges);
    }
    assert_eq!(sorted(all), table.corners().filter(|&h| table.is_boundary(h)).collect::<Vec<_>>());
}

fn assert_components_are_surfaces(table: &CornerTable) {
    let components = table.components();
    assert_eq!(
        components.list().iter().map(|c| c.faces).sum::<u32>() + table.report().degenerate_faces,
        table.face_count() as u32
    );
    for component in components.list() {
        let twice_genus = 2 - component.euler_characteristic() - i64::from(component.boundary_loops);
        assert!(twice_genus >= 0 && twice_genus % 2 == 0, "{component:?}");
    }
}

#[test]
fn the_zoo_agrees_with_a_search_and_with_what_is_known() {
    for specimen in zoo() {
        let mesh = &specimen.mesh;
        let table = CornerTable::of_vertices(mesh);
        assert_agrees_with_search(&table.faces, mesh.vertex_count());
        let (name, report) = (specimen.name, table.report());
        assert_eq!(table.euler_characteristic(), specimen.euler, "{name}");
        assert_eq!(report.boundary_edges, specimen.boundary_edges, "{name}");
        assert_eq!(report.non_manifold_edges, specimen.non_manifold_edges, "{name}");
        assert_eq!(report.non_manifold_vertices, specimen.non_manifold_vertices, "{name}");
        assert_eq!(report.inconsistent_edges, specimen.inconsistent_edges, "{name}");
        assert_eq!(table.is_orientable(), specimen.orientable, "{name}");
        assert_agrees_with_search(&mesh.triangles, mesh.wedge_count());
    }
}

#[test]
fn genus_and_loops_are_those_of_the_shape() {
    let facts = |name: &str| {
        let table = CornerTable::of_vertices(&zoo().into_iter().find(|s| s.name == name).unwrap().mesh);
        (table.genus(), table.boundary_loops().len(), table.is_closed())
    };
    assert_eq!(facts("sphere"), (Some(0), 0, true));
    assert_eq!(facts("torus"), (Some(1), 0, true));
    assert_eq!(facts("grid"), (Some(0), 1, false));
    assert_eq!(facts("grid with hole"), (Some(0), 2, false));
    assert_eq!(facts("soup"), (Some(0), 12, false));
    assert_eq!(facts("moebius band").0, None);
    assert_eq!(facts("two cones at a vertex").0, None);
}

#[test]
fn closing_holes_gives_a_closed_surface_with_a_dummy_for_each() {
    for specimen in zoo() {
        let table = CornerTable::of_vertices(&specimen.mesh);
        let closed = table.close_holes();
        let again = CornerTable::build(closed.faces.clone(), closed.vertex_count).unwrap();
        assert_eq!(closed.vertex_count - table.vertex_count(), table.boundary_loops().len());
        if !table.report().is_manifold() || table.report().inconsistent_edges > 0 {
            continue;
        }
        assert!(again.is_closed() && again.report().is_manifold(), "{}", specimen.name);
        assert_eq!(again.genus(), table.genus());
        for (v, half_edges) in (closed.first_dummy_vertex..).zip(table.boundary_loops().iter()) {
            assert!(closed.is_dummy_vertex(VertexId(v)));
            assert_eq!(again.valence(VertexId(v)), half_edges.len());
            assert!(again.vertex_faces(VertexId(v)).all(|f| closed.is_dummy_face(f)));
        }
    }
}

#[test]
fn bad_indices_are_an_error() {
    let error = CornerTable::build(vec![[0, 1, 2], [0, 3, 1]], 3).unwrap_err();
    assert_eq!(error, TopologyError::IndexOutOfRange { face: FaceId(1), index: 3, vertices: 3 });
    assert_eq!(error.to_string(), "face f1 refers to vertex 3, but there are only 3");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn random_triangles_agree_with_a_search(
        faces in prop::collection::vec(prop::array::uniform3(0u32..9), 0..24),
    ) {
        assert_agrees_with_search(&faces, 9);
    }
}
