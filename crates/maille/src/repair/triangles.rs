//! Repairs and counts that look at elements one by one or in groups of equals.

use super::RepairReport;
use crate::mesh::Attribute;
use crate::topology::UnionFind;
use crate::topology::edges::{deal, for_each_edge, is_degenerate};
use crate::{Mesh, Semantic};

/// The triangles of a mesh over its vertices.
pub(super) fn vertex_triangles(mesh: &Mesh) -> Vec<[u32; 3]> {
    (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect()
}

pub(super) fn is_finite(position: &[f32; 3]) -> bool {
    position.iter().all(|x| x.is_finite())
}

/// All attributes of a mesh, with morph targets.
pub(super) fn attributes(mesh: &Mesh) -> impl Iterator<Item = &Attribute> {
    let morphs = mesh.morph_targets.iter().flat_map(|target| &target.attributes);
    mesh.vertex_attributes.iter().chain(&mesh.wedge_attributes).chain(&mesh.triangle_attributes).chain(morphs)
}

pub(super) fn drop_non_finite(mesh: &mut Mesh, report: &mut RepairReport) {
    report.non_finite_values_zeroed += zero_non_finite(mesh);
    let bad: Vec<bool> = mesh.positions.iter().map(|p| !is_finite(p)).collect();
    if !bad.contains(&true) {
        return;
    }
    let bad_wedge: Vec<bool> = mesh.wedge_vertices.iter().map(|&v| bad[v as usize]).collect();
    let bad_triangle = |triangle: &[u32; 3]| triangle.iter().any(|&w| bad_wedge[w as usize]);
    let bad_triangles: Vec<bool> = mesh.triangles.iter().map(bad_triangle).collect();
    report.non_finite_triangles_dropped += mesh.retain_triangles(|t| !bad_triangles[t as usize]);
    mesh.retain_wedges(|w| !bad_wedge[w as usize]);
    report.non_finite_vertices_dropped += mesh.retain_vertices(|v| !bad[v as usize]);
}

fn zero_non_finite(mesh: &mut Mesh) -> usize {
    let morphs = mesh.morph_targets.iter_mut().flat_map(|target| &mut target.attributes);
    let groups = [&mut mesh.vertex_attributes, &mut mesh.wedge_attributes, &mut mesh.triangle_attributes];
    let values = groups.into_iter().flatten().chain(morphs).filter_map(Attribute::as_f32_mut).flatten();
    values.filter(|x| !x.is_finite()).map(|x| *x = 0.0).count()
}

pub(super) fn drop_degenerate(mesh: &mut Mesh) -> usize {
    let bad: Vec<bool> = (0..mesh.triangle_count()).map(|t| is_degenerate(&mesh.triangle_vertices(t))).collect();
    mesh.retain_triangles(|t| !bad[t as usize])
}

pub(super) fn drop_zero_area(mesh: &mut Mesh) -> usize {
    let bad: Vec<bool> = (0..mesh.triangle_count()).map(|t| has_no_area(mesh, t)).collect();
    mesh.retain_triangles(|t| !bad[t as usize])
}

/// Whether the height of a triangle is less than 2^-24 of its longest edge. False if it is not finite.
pub(super) fn has_no_area(mesh: &Mesh, triangle: usize) -> bool {
    let [a, b, c] = mesh.triangle_points(triangle);
    let longest_sq = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    (b - a).cross(c - a).length() <= longest_sq * (0.5 * f64::from(f32::EPSILON))
}

/// A triangle whose vertices an earlier one has, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Duplicate {
    pub(super) triangle: u32,
    /// An earlier one has the same winding.
    pub(super) repeats: bool,
    /// The first of them has the opposite winding.
    pub(super) opposes: bool,
}

/// Calls `visit` for every triangle whose vertices an earlier one has; degenerate ones are passed over.
///
/// Triangles are dealt to their lowest vertex and sorted there: 4 bytes per triangle and vertex.
pub(super) fn for_each_duplicate(triangles: &[[u32; 3]], vertex_count: usize, mut visit: impl FnMut(Duplicate)) {
    let lowest_first = |t: u32| {
        let [a, b, c] = triangles[t as usize];
        if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        }
    };
    let key = |t: u32| {
        let [_, b, c] = lowest_first(t);
        (b.min(c), b.max(c), t)
    };
    let proper = || (0..triangles.len() as u32).filter(|&t| !is_degenerate(&triangles[t as usize]));
    let (starts, mut dealt) = deal(vertex_count, || proper().map(|t| (lowest_first(t)[0], t)), |t| t);
    for v in 0..vertex_count {
        let hand = &mut dealt[starts[v] as usize..starts[v + 1] as usize];
        hand.sort_unstable_by_key(|&t| key(t));
        for equals in hand.chunk_by(|&a, &b| (key(a).0, key(a).1) == (key(b).0, key(b).1)) {
            let rises = |t: u32| lowest_first(t)[1] < lowest_first(t)[2];
            let first = rises(equals[0]);
            let mut opposite_seen = false;
            for &triangle in &equals[1..] {
                let opposes = rises(triangle) != first;
                visit(Duplicate { triangle, repeats: !opposes || opposite_seen, opposes });
                opposite_seen |= opposes;
            }
        }
    }
}

pub(super) fn drop_duplicates(mesh: &mut Mesh, unwanted: impl Fn(Duplicate) -> bool) -> usize {
    let mut bad = vec![false; mesh.triangle_count()];
    for_each_duplicate(&vertex_triangles(mesh), mesh.vertex_count(), |duplicate| {
        bad[duplicate.triangle as usize] = unwanted(duplicate);
    });
    mesh.retain_triangles(|t| !bad[t as usize])
}

/// Unites the triangles that share an edge, given its half-edges.
pub(super) fn unite_at_edge(components: &mut UnionFind, half_edges: &[u32]) {
    half_edges.windows(2).for_each(|pair| _ = components.union(pair[0] / 3, pair[1] / 3));
}

pub(super) fn drop_small_components(mesh: &mut Mesh, min_triangles: u32) -> (usize, usize) {
    let triangles = vertex_triangles(mesh);
    let mut components = UnionFind::new(triangles.len());
    for_each_edge(&triangles, mesh.vertex_count(), |_, half_edges| unite_at_edge(&mut components, half_edges));
    let roots = components.into_roots();
    let mut sizes = vec![0u32; triangles.len()];
    roots.iter().for_each(|&root| sizes[root as usize] += 1);
    // degenerate triangles are of no component
    let small = |t: usize| sizes[roots[t] as usize] < min_triangles && !is_degenerate(&triangles[t]);
    let count = (0..triangles.len()).filter(|&t| roots[t] as usize == t && small(t)).count();
    (count, mesh.retain_triangles(|t| !small(t as usize)))
}

/// For each wedge whether a triangle, and for each vertex whether such a wedge refers to it.
pub(super) fn references(mesh: &Mesh) -> (Vec<bool>, Vec<bool>) {
    let mut wedges = vec![false; mesh.wedge_count()];
    let mut vertices = vec![false; mesh.vertex_count()];
    for &wedge in mesh.triangles.as_flattened() {
        wedges[wedge as usize] = true;
        vertices[mesh.wedge_vertices[wedge as usize] as usize] = true;
    }
    (wedges, vertices)
}

pub(super) fn drop_unreferenced(mesh: &mut Mesh) -> (usize, usize) {
    let (used_wedges, used_vertices) = references(mesh);
    let wedges = mesh.retain_wedges(|w| used_wedges[w as usize]);
    (mesh.retain_vertices(|v| used_vertices[v as usize]), wedges)
}

/// Number of elements that are not finite, in attributes of floats.
pub(super) fn non_finite_elements(attribute: &Attribute) -> usize {
    let elements = attribute.as_f32().map(|values| values.chunks_exact(attribute.components));
    elements.map_or(0, |elements| elements.filter(|x| !x.iter().all(|x| x.is_finite())).count())
}

/// Number of zero normals: they light nothing.
pub(super) fn zero_normals(mesh: &Mesh) -> usize {
    let normals = mesh.wedge_attribute(&Semantic::Normal).and_then(Attribute::as_f32);
    normals.map_or(0, |values| values.chunks_exact(3).filter(|n| n.iter().all(|&x| x == 0.0)).count())
}
