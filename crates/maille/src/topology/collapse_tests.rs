//! The collapse structure against a search through all faces, on random triangles however broken.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::EdgeStar;
use super::collapse_mesh::{CollapseEffect, CollapseMesh, Marks};
use super::edges::is_degenerate;
use crate::mesh::shapes;
use crate::zoo::zoo;

/// What the structure should hold, as a plain list of triangles.
struct Naive {
    faces: Vec<Option<[u32; 3]>>,
    pairs: BTreeSet<[u32; 2]>,
}

fn pair(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

impl Naive {
    fn new(faces: &[[u32; 3]]) -> Self {
        let faces = faces.iter().map(|face| (!is_degenerate(face)).then_some(*face)).collect();
        Self { faces, pairs: BTreeSet::new() }
    }

    fn collapse(&mut self, kept: u32, removed: u32) {
        let rename = |v: u32| if v == removed { kept } else { v };
        for face in &mut self.faces {
            *face = face.map(|f| f.map(rename)).filter(|f| !is_degenerate(f));
        }
        let renamed = self.pairs.iter().map(|p| pair(rename(p[0]), rename(p[1])));
        self.pairs = renamed.filter(|p| p[0] != p[1]).collect();
        let sides = self.sides();
        self.pairs.retain(|p| !sides.contains_key(p));
    }

    /// The faces at each pair of joined vertices.
    fn sides(&self) -> BTreeMap<[u32; 2], Vec<u32>> {
        let mut sides = BTreeMap::<_, Vec<u32>>::new();
        for (f, face) in (0..).zip(&self.faces) {
            for k in 0..face.map_or(0, |_| 3) {
                let face = face.expect("only whole faces are looked at");
                sides.entry(pair(face[k], face[(k + 1) % 3])).or_default().push(f);
            }
        }
        sides
    }
}

fn assert_agree(mesh: &CollapseMesh, naive: &Naive) {
    let faces: Vec<_> = (0..mesh.face_count()).map(|f| mesh.face(f)).collect();
    assert_eq!(faces, naive.faces);
    assert_eq!(mesh.live_face_count(), naive.faces.iter().flatten().count());
    for v in 0..mesh.vertex_count() as u32 {
        let mut ring: Vec<_> = mesh.faces_around(v).collect();
        ring.sort_by_key(|face| face.face);
        let at = |f: &u32| naive.faces[*f as usize].is_some_and(|face| face.contains(&v));
        let expected: Vec<u32> = (0..mesh.face_count() as u32).filter(at).collect();
        assert_eq!(ring.iter().map(|face| face.face).collect::<Vec<_>>(), expected, "faces around {v}");
        for seen in ring {
            let (face, k) = (mesh.face(seen.face as usize).unwrap(), seen.corner as usize);
            assert_eq!([face[k], face[(k + 1) % 3], face[(k + 2) % 3]], [v, seen.x, seen.y]);
            assert_eq!(mesh.ends(seen.edge_x).into_iter().collect::<BTreeSet<_>>(), BTreeSet::from([v, seen.x]));
            assert_eq!(mesh.ends(seen.edge_y).into_iter().collect::<BTreeSet<_>>(), BTreeSet::from([v, seen.y]));
        }
    }
    // every edge that lives joins two vertices of a face or a pair, and none is there twice
    let live = (0..mesh.edge_count() as u32).filter(|&e| mesh.has_edge(e));
    let mut joined: Vec<_> = live.map(|e| pair(mesh.ends(e)[0], mesh.ends(e)[1])).collect();
    joined.sort_unstable();
    let expected: BTreeSet<_> = naive.sides().into_keys().chain(naive.pairs.iter().copied()).collect();
    assert_eq!(joined, expected.into_iter().collect::<Vec<_>>());
    for (f, edges) in (0..mesh.face_count()).filter_map(|f| Some((f, mesh.face_edges(f)?))) {
        let face = mesh.face(f).unwrap();
        for k in 0..3 {
            let ends = mesh.ends(edges[k]);
            assert_eq!(pair(ends[0], ends[1]), pair(face[(k + 1) % 3], face[(k + 2) % 3]), "edge {k} of face {f}");
        }
    }
}

/// Collapses an edge and compares what is told of it with what has changed.
fn collapse(mesh: &mut CollapseMesh, edge: u32, swap: bool, marks: &mut Marks) -> CollapseEffect {
    let [a, b] = mesh.ends(edge);
    let [kept, removed] = if swap { [b, a] } else { [a, b] };
    let (mut kept_ring, mut removed_ring, mut effect) = (vec![], vec![], CollapseEffect::default());
    mesh.ring(kept, &mut kept_ring);
    mesh.ring(removed, &mut removed_ring);
    let before: Vec<u32> = (0..mesh.edge_count() as u32).filter(|&e| mesh.has_edge(e)).collect();
    mesh.collapse(&EdgeStar::new(edge, [kept, removed], &kept_ring, &removed_ring), [0.5; 3], marks, &mut effect);
    let gone: BTreeSet<u32> = before.into_iter().filter(|&e| !mesh.has_edge(e)).collect();
    assert_eq!(effect.removed_edges.len(), gone.len());
    assert_eq!(effect.removed_edges.iter().copied().collect::<BTreeSet<_>>(), gone);
    assert!(effect.merged_edges.iter().all(|(e, into)| gone.contains(e) && mesh.has_edge(*into)));
    let at_kept = |e: &u32| mesh.has_edge(*e) && mesh.ends(*e).contains(&kept);
    let touched: BTreeSet<u32> = (0..mesh.edge_count() as u32).filter(at_kept).collect();
    assert_eq!(effect.edges.len(), touched.len());
    assert_eq!(effect.edges.iter().copied().collect::<BTreeSet<_>>(), touched);
    for (&e, &n) in effect.edges.iter().zip(&effect.neighbors) {
        assert_eq!(pair(mesh.ends(e)[0], mesh.ends(e)[1]), pair(kept, n));
    }
    assert_eq!(mesh.position(kept), [0.5; 3]);
    effect
}

fn collapse_all(faces: &[[u32; 3]], vertices: usize, pairs: &[[u32; 2]], choices: &[(prop::sample::Index, bool)]) {
    let positions: Vec<[f32; 3]> = (0..vertices).map(|v| [v as f32, 0.0, 0.0]).collect();
    let mut mesh = CollapseMesh::new(&positions, faces.iter().copied());
    let mut naive = Naive::new(faces);
    mesh.add_pairs(pairs);
    let sides = naive.sides();
    naive.pairs = pairs.iter().map(|p| pair(p[0], p[1])).filter(|p| p[0] != p[1] && !sides.contains_key(p)).collect();
    let mut marks = Marks::new(vertices);
    assert_agree(&mesh, &naive);
    for (choice, swap) in choices {
        let live: Vec<u32> = (0..mesh.edge_count() as u32).filter(|&e| mesh.has_edge(e)).collect();
        if live.is_empty() {
            break;
        }
        let edge = live[choice.index(live.len())];
        let [a, b] = mesh.ends(edge);
        let [kept, removed] = if *swap { [b, a] } else { [a, b] };
        collapse(&mut mesh, edge, *swap, &mut marks);
        naive.collapse(kept, removed);
        assert_agree(&mesh, &naive);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn random_collapses_of_random_triangles_agree_with_a_search(
        faces in prop::collection::vec(prop::array::uniform3(0u32..10), 0..25),
        choices in prop::collection::vec(any::<(prop::sample::Index, bool)>(), 10),
    ) {
        collapse_all(&faces, 10, &[], &choices);
    }

    #[test]
    fn random_collapses_with_pairs_to_be_joined_agree_with_a_search(
        faces in prop::collection::vec(prop::array::uniform3(0u32..12), 0..12),
        pairs in prop::collection::vec(prop::array::uniform2(0u32..12), 0..12),
        choices in prop::collection::vec(any::<(prop::sample::Index, bool)>(), 12),
    ) {
        collapse_all(&faces, 12, &pairs, &choices);
    }
}

/// The faces of a closed surface of spheres or tori, some of them wound the other way.
fn closed(wide: bool, flipped: &[prop::sample::Index]) -> (Vec<[u32; 3]>, usize) {
    let mesh = if wide { shapes::torus(1.0, 0.3, 7, 5) } else { shapes::sphere(2) };
    let mut faces: Vec<_> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
    for index in flipped {
        index.get_mut(&mut faces).swap(0, 1);
    }
    (faces, mesh.vertex_count())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn random_collapses_of_closed_surfaces_agree_with_a_search(
        wide in any::<bool>(),
        flipped in prop::collection::vec(any::<prop::sample::Index>(), 0..4),
        choices in prop::collection::vec(any::<(prop::sample::Index, bool)>(), 25),
    ) {
        let (faces, vertices) = closed(wide, &flipped);
        collapse_all(&faces, vertices, &[], &choices);
    }
}

#[test]
fn only_plain_stars_are_regular() {
    let is_regular = |faces: &[[u32; 3]], [kept, removed]: [u32; 2]| {
        let vertices = 1 + *faces.iter().flatten().max().unwrap();
        let mesh = CollapseMesh::new(&vec![[0.0; 3]; vertices as usize], faces.iter().copied());
        let rings = [kept, removed].map(|v| mesh.faces_around(v).collect::<Vec<_>>());
        EdgeStar::new(0, [kept, removed], &rings[0], &rings[1]).is_regular()
    };
    let octahedron = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]];
    assert!(is_regular(&octahedron, [0, 1]));
    assert!(!is_regular(&octahedron[1..], [0, 1]), "a border");
    let mut flipped = octahedron;
    flipped[4].swap(0, 1);
    assert!(!is_regular(&flipped, [0, 1]), "a face wound the other way");
    let tetrahedron = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]];
    assert!(!is_regular(&tetrahedron, [0, 1]), "apexes with a face at either end");
    // two tetrahedra face to face: their common face is gone, its edges are the neck
    let neck = [[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 4], [2, 1, 4], [0, 2, 4]];
    assert!(!is_regular(&neck, [0, 1]), "a neighbour in common that no face joins to the edge");
}

#[test]
fn the_zoo_collapses_away_edge_by_edge() {
    for specimen in zoo() {
        let corners = specimen.mesh.triangles.iter().map(|t| t.map(|w| specimen.mesh.wedge_vertices[w as usize]));
        let faces: Vec<_> = corners.collect();
        let mut mesh = CollapseMesh::new(&specimen.mesh.positions, faces.iter().copied());
        let mut naive = Naive::new(&faces);
        let mut marks = Marks::new(mesh.vertex_count());
        while let Some(edge) = (0..mesh.edge_count() as u32).find(|&e| mesh.has_edge(e)) {
            let [kept, removed] = mesh.ends(edge);
            collapse(&mut mesh, edge, false, &mut marks);
            naive.collapse(kept, removed);
            assert_agree(&mesh, &naive);
        }
        assert_eq!(mesh.live_face_count(), 0, "{}", specimen.name);
    }
}

#[test]
fn an_edge_goes_with_its_last_face() {
    let mut mesh = CollapseMesh::new(&[[0.0; 3], [1.0; 3], [2.0; 3]], [[0, 1, 2]].into_iter());
    let effect = collapse(&mut mesh, 0, false, &mut Marks::new(3));
    assert!((0..3).all(|e| !mesh.has_edge(e)));
    assert!(effect.edges.is_empty() && effect.neighbors.is_empty());
}

#[test]
fn marks_survive_the_end_of_their_epochs() {
    let mut marks = Marks::new(2);
    marks.clear();
    assert_eq!((marks.set(1, 7), marks.get(1), marks.get(0)), (None, Some(7), None));
    assert_eq!(marks.set(1, 8), Some(7));
    marks.clear();
    assert_eq!(marks.get(1), None);
}
