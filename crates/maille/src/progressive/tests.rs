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
