use super::*;
use crate::Control;
use crate::lod::{Correspondence, Geomorph, GeomorphOptions, MorphedMesh, Target as End};
use crate::mesh::{Semantic, shapes};
use crate::samples;
use crate::simplify::{MetricKind, PlacementKind, SimplifyOptions, Stop, Target, TopologyPolicy, simplify};
use crate::zoo::zoo;

/// What a mesh draws: each triangle by the bits of its corners, from the least corner on, sorted.
fn drawn(mesh: &Mesh) -> Vec<Vec<u32>> {
    fn bits(attribute: &Attribute, element: u32, into: &mut Vec<u32>) {
        let range = element as usize * attribute.components..(element as usize + 1) * attribute.components;
        match &attribute.values {
            Values::F32(values) => into.extend(values[range].iter().map(|x| x.to_bits())),
            Values::U32(values) => into.extend_from_slice(&values[range]),
        }
    }
    let corner = |wedge: u32| {
        let vertex = mesh.wedge_vertices[wedge as usize];
        let mut all: Vec<u32> = mesh.positions[vertex as usize].iter().map(|x| x.to_bits()).collect();
        let morphs = mesh.morph_targets.iter().flat_map(|target| &target.attributes);
        mesh.wedge_attributes.iter().chain(morphs).for_each(|a| bits(a, wedge, &mut all));
        mesh.vertex_attributes.iter().for_each(|a| bits(a, vertex, &mut all));
        all
    };
    let mut triangles: Vec<Vec<u32>> = (0..mesh.triangle_count())
        .map(|t| {
            let mut corners = mesh.triangles[t].map(corner);
            let least = (0..3).min_by_key(|&k| corners[k].clone()).expect("there are three");
            corners.rotate_left(least);
            let mut all = corners.concat();
            all.push(mesh.triangle_material(t));
            mesh.triangle_attributes.iter().for_each(|a| bits(a, t as u32, &mut all));
            all
        })
        .collect();
    triangles.sort();
    triangles
}

/// Without triangles that name a vertex twice.
fn whole(mesh: &Mesh) -> Mesh {
    let mut mesh = mesh.clone();
    let keep: Vec<u32> = (0..mesh.triangle_count() as u32)
        .filter(|&t| {
            let [a, b, c] = mesh.triangle_vertices(t as usize);
            a != b && b != c && c != a
        })
        .collect();
    mesh.gather_triangles(&keep);
    mesh
}

fn progressive(mesh: &Mesh, options: &SimplifyOptions) -> ProgressiveMesh {
    let (progressive, report) =
        ProgressiveMesh::new(mesh.clone(), options, Control::default()).expect("the options make sense");
    assert_eq!(report.collapses as usize, progressive.collapse_count());
    assert_eq!(report.triangles_out, progressive.triangles().len());
    progressive
}

fn all_meshes() -> Vec<(String, Mesh)> {
    let mut meshes: Vec<(String, Mesh)> = zoo().into_iter().map(|s| (s.name.to_owned(), s.mesh)).collect();
    let character = samples::character(3000).mesh;
    meshes.push(("character".into(), character));
    meshes.push(("vase".into(), samples::vase(3000)));
    meshes.push(("terrain".into(), samples::terrain(2000)));
    meshes.push(("mechanical".into(), samples::mechanical(2000)));
    meshes
}

/// Ways of simplifying that change different things.
fn ways() -> [SimplifyOptions; 3] {
    let base = SimplifyOptions::default();
    [
        SimplifyOptions { topology: TopologyPolicy::Free, ..base.clone() },
        SimplifyOptions { metric: MetricKind::ShortestEdge, placement: PlacementKind::Midpoint, ..base.clone() },
        SimplifyOptions { placement: PlacementKind::Subset, metric: MetricKind::Quadric, ..base },
    ]
}

#[test]
fn to_the_base_and_back_is_the_identity() {
    for (name, mesh) in all_meshes() {
        for options in ways() {
            let base = progressive(&mesh, &options);
            let mut moved = base.clone();
            moved.seek(0);
            let finest = moved.to_mesh();
            finest.check().expect("levels keep the invariants");
            assert_eq!(drawn(&finest), drawn(&whole(&mesh)), "{name}: the finest level is the mesh");
            let there = moved.clone();
            moved.seek(usize::MAX);
            assert!(moved == base, "{name}: back at the base");
            moved.seek(0);
            assert!(moved == there, "{name}: back at the finest");
        }
    }
}

#[test]
fn every_level_is_what_simplification_gives() {
    for (name, mesh) in all_meshes() {
        let mut progressive = progressive(&mesh, &SimplifyOptions::default());
        let most = mesh.triangle_count();
        for triangles in [most, most / 2, 7, most / 10, most / 3, 1].map(|n| n.max(1)) {
            progressive.seek_triangles(triangles);
            let mut simplified = mesh.clone();
            let target = Target { triangles: Some(triangles), ..Target::default() };
            let options = SimplifyOptions { target, ..SimplifyOptions::default() };
            let report = simplify(&mut simplified, &options, Control::default()).expect("the options make sense");
            if report.stopped != Stop::Triangles || progressive.triangles().is_empty() {
                continue; // simplification keeps the last triangles
            }
            let level = progressive.to_mesh();
            level.check().expect("levels keep the invariants");
            assert_eq!(drawn(&level), drawn(&simplified), "{name} at {triangles}");
            assert_eq!(level.wedge_count(), simplified.wedge_count(), "{name} at {triangles}: no wedge is left over");
            assert_eq!(
                level.vertex_count(),
                simplified.vertex_count(),
                "{name} at {triangles}: no vertex is left over"
            );
        }
    }
}

#[test]
fn counts_fall_and_errors_rise() {
    let progressive = progressive(&samples::vase(3000), &SimplifyOptions::default());
    let levels: Vec<Counts> = (0..=progressive.collapse_count()).map(|at| progressive.counts_at(at)).collect();
    for pair in levels.windows(2) {
        assert!(pair[0].triangles >= pair[1].triangles && pair[0].wedges >= pair[1].wedges);
        assert!(pair[0].vertices > pair[1].vertices, "each collapse takes a vertex away");
    }
    let errors: Vec<f64> = (0..=progressive.collapse_count()).map(|at| progressive.error_at(at)).collect();
    assert!(errors.is_sorted() && progressive.costs().is_sorted());
    assert_eq!(progressive.collapses_to(usize::MAX), 0);
    assert_eq!(progressive.collapses_to(0), progressive.collapse_count());
}

#[test]
fn what_cannot_be_undone_is_refused() {
    for options in [
        SimplifyOptions { cluster_first: Some(3.0), ..SimplifyOptions::default() },
        SimplifyOptions { normals: crate::simplify::NormalPolicy::Recompute, ..SimplifyOptions::default() },
    ] {
        let refused = ProgressiveMesh::new(shapes::sphere(2), &options, Control::default());
        assert!(matches!(refused, Err(crate::simplify::SimplifyError::InvalidOption { .. })));
    }
}

#[test]
fn attributes_of_vertices_follow() {
    let mut mesh = shapes::sphere(3);
    let values = mesh.positions.iter().map(|p| p[0] * p[1]).collect();
    mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("quality".into()), 1, values));
    mesh.vertex_attributes.push(Attribute::new_u32(Semantic::Custom("label".into()), 1, (0..258).collect()));
    let mut progressive = progressive(&mesh, &SimplifyOptions::default());
    progressive.seek(0);
    assert_eq!(drawn(&progressive.to_mesh()), drawn(&mesh));
}

/// What a mesh draws, with attributes of vertices left out, each wedge replaced by the one that it becomes; what has no
/// area any more is not drawn.
fn drawn_as(finer: &Mesh, coarser: &Mesh, correspondence: &Correspondence) -> Vec<Vec<u32>> {
    let become_of = |w: u32| match correspondence.target(w) {
        End::Wedge(w) => Some(w),
        End::Point(_) => None,
    };
    let mut result = coarser.clone();
    let is_drawn = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|w| coarser.wedge_vertices[w as usize]);
        a != b && b != c && c != a
    };
    let ends = (0..finer.triangle_count()).filter_map(|t| {
        let [a, b, c] = finer.triangles[t].map(become_of);
        Some((t as u32, [a?, b?, c?])).filter(|(_, t)| is_drawn(t))
    });
    let (kept, triangles): (Vec<u32>, Vec<[u32; 3]>) = ends.unzip();
    let mut of_finer = finer.clone();
    of_finer.gather_triangles(&kept);
    result.triangles = triangles;
    result.triangle_materials = of_finer.triangle_materials;
    result.triangle_attributes = of_finer.triangle_attributes;
    drawn(&result)
}

#[test]
fn what_corresponds_ends_as_the_coarser_level() {
    for (name, mesh) in all_meshes() {
        let mut progressive = progressive(&mesh, &SimplifyOptions::default());
        let last = progressive.collapse_count();
        let places = [0, last / 3, last / 3, 2 * last / 3, last].map(|at| progressive.whole(at));
        let levels = places.map(|at| {
            progressive.seek(at);
            progressive.to_mesh()
        });
        let mut chain = Correspondence::identity(levels[0].wedge_count() as u32);
        for i in 1..places.len() {
            let next = progressive.correspondence([places[i - 1], places[i]], [&levels[i - 1], &levels[i]]);
            next.check(&levels[i - 1], &levels[i]).expect("it fits both");
            assert_eq!(drawn_as(&levels[i - 1], &levels[i], &next), drawn(&levels[i]), "{name}: level {i}");
            chain = chain.then(&next);
            assert_eq!(drawn_as(&levels[0], &levels[i], &chain), drawn(&levels[i]), "{name}: from the finest to {i}");
        }
    }
}

#[test]
fn a_morph_ends_as_the_coarser_level() {
    let mesh = samples::vase(3000);
    let mut progressive = progressive(&mesh, &SimplifyOptions::default());
    progressive.seek(0);
    let finer = progressive.to_mesh();
    let at = progressive.collapses_to(400);
    progressive.seek(at);
    let coarser = progressive.to_mesh();
    let correspondence = progressive.correspondence([0, at], [&finer, &coarser]);
    let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).expect("they fit");
    let mut morphed = MorphedMesh::new(&finer);
    geomorph.morph(1.0, &mut morphed);
    let (start, end) = (MorphedMesh::new(&finer), MorphedMesh::new(&coarser));
    for (w, &p) in (0..).zip(&morphed.positions) {
        match correspondence.target(w) {
            End::Wedge(target) => assert_eq!(p, end.positions[target as usize]),
            End::Point(point) => assert_eq!(p, point),
        }
    }
    geomorph.morph(0.0, &mut morphed);
    assert_eq!(morphed, start);
}

#[test]
fn the_log_of_a_bare_mesh_takes_little() {
    let progressive = progressive(&shapes::sphere(5), &SimplifyOptions::default());
    let each = progressive.log_bytes() as f64 / progressive.collapse_count() as f64;
    assert!(each <= 60.0, "{each} bytes per collapse");
}

/// A small mesh of every kind: seams, materials, joints, morph targets, attributes of vertices and triangles, at some level.
fn with_everything() -> ProgressiveMesh {
    let mut mesh = samples::vase(600);
    let (count, wedges) = (mesh.vertex_count(), mesh.wedge_count());
    mesh.set_wedge_attribute(Attribute::new_u32(Semantic::Joints(0), 4, [0, 1, 2, 3].repeat(wedges)));
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Weights(0), 4, [0.4, 0.3, 0.2, 0.1].repeat(wedges)));
    mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("heat".into()), 1, vec![0.5; count]));
    mesh.vertex_attributes.push(Attribute::new_u32(
        Semantic::Custom("label".into()),
        2,
        (0..2 * count as u32).collect(),
    ));
    let triangles = mesh.triangle_count();
    mesh.triangle_attributes.push(Attribute::new_u32(
        Semantic::Custom("part".into()),
        1,
        (0..triangles as u32).collect(),
    ));
    mesh.triangle_materials = (0..triangles as u32).map(|t| t % 3).collect();
    mesh.material_names = vec!["skin".into(), String::new(), "shirt".into()];
    let deltas = Attribute::new_f32(Semantic::Position, 3, vec![0.25; 3 * wedges]);
    mesh.morph_targets.push(crate::mesh::MorphTarget { name: "smile".into(), attributes: vec![deltas] });
    let mut progressive = progressive(&mesh, &SimplifyOptions::default());
    progressive.seek_triangles(triangles / 2);
    progressive
}

#[test]
fn bytes_bring_back_every_level() {
    let mut meshes: Vec<(String, ProgressiveMesh)> = Vec::new();
    for (name, mesh) in all_meshes() {
        meshes.extend(ways().iter().map(|options| (name.clone(), progressive(&mesh, options))));
    }
    meshes.push(("everything".into(), with_everything()));
    for (name, mut mesh) in meshes {
        for at in [mesh.collapse_count(), mesh.collapse_count() / 2, 0] {
            mesh.seek(at);
            let mut again = ProgressiveMesh::from_bytes(&mesh.to_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(again == mesh, "{name} after {at} collapses");
            again.seek(mesh.collapse_count() / 3);
            let mut level = mesh.clone();
            level.seek(mesh.collapse_count() / 3);
            assert_eq!(again.to_mesh(), level.to_mesh(), "{name}");
        }
    }
}

#[test]
fn bytes_do_not_depend_on_the_level_but_for_its_word() {
    let mut mesh = with_everything();
    let mut bytes = mesh.to_bytes();
    mesh.seek(0);
    bytes[4..8].fill(0);
    assert!(mesh.to_bytes() == bytes);
}

#[test]
fn bytes_that_end_elsewhere_are_refused() {
    let bytes = progressive(&shapes::sphere(2), &SimplifyOptions::default()).to_bytes();
    for end in 0..bytes.len() {
        assert!(ProgressiveMesh::from_bytes(&bytes[..end]).is_err(), "{end} of {} bytes", bytes.len());
    }
    let longer = [&bytes[..], &[0; 4]].concat();
    let refused = ProgressiveMesh::from_bytes(&longer).expect_err("there is too much");
    assert_eq!(refused.to_string(), format!("byte {}: 4 bytes after the end", bytes.len()));
}

/// Everything that can be done with a mesh that was read.
fn use_all(mut mesh: ProgressiveMesh) {
    let last = mesh.collapse_count();
    let read = mesh.clone();
    let mut levels = Vec::new();
    for at in [0, last / 3, last, last / 2, last, 0] {
        let at = mesh.whole(at);
        mesh.seek(at);
        let level = mesh.to_mesh();
        level.check().expect("levels keep the invariants");
        levels.push(level);
        assert!(mesh.error_at(at) >= 0.0 && mesh.collapses_to(at) <= last);
    }
    let finest = &levels[5];
    assert_eq!(drawn(&levels[0]), drawn(finest), "the way back is exact");
    mesh.correspondence([0, last], [finest, &levels[2]]).check(finest, &levels[2]).expect("it fits both");
    mesh.seek(read.position());
    // attributes may be no numbers, which are not equal to themselves
    assert!(mesh.to_bytes() == read.to_bytes());
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(4000))]
    #[test]
    fn mangled_bytes_give_a_sound_mesh_or_an_error(
        of_all in proptest::bool::ANY,
        changes in proptest::collection::vec((0.0..1.0_f64, 0..6_u8, proptest::num::u32::ANY), 1..4),
    ) {
        use std::sync::OnceLock;
        static BYTES: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
        let bytes = BYTES.get_or_init(|| {
            [progressive(&shapes::sphere(1), &SimplifyOptions::default()).to_bytes(), with_everything().to_bytes()]
        });
        let mut bytes = bytes[usize::from(of_all)].clone();
        for (place, kind, noise) in changes {
            let word = (place * (bytes.len() / 4) as f64) as usize * 4;
            let old = u32::from_le_bytes(bytes[word..word + 4].try_into().expect("four bytes"));
            let new = match kind {
                0 => noise,
                1 => noise % 16,
                2 => old.wrapping_add(1),
                3 => old.wrapping_sub(1),
                4 => old ^ 1 << (noise % 32),
                // what stands elsewhere is of the right size more often than not
                _ => {
                    let other = noise as usize % (bytes.len() / 4) * 4;
                    u32::from_le_bytes(bytes[other..other + 4].try_into().expect("four bytes"))
                }
            };
            bytes[word..word + 4].copy_from_slice(&new.to_le_bytes());
        }
        if let Ok(mesh) = ProgressiveMesh::from_bytes(&bytes) {
            use_all(mesh);
        }
    }
}
