//! Counting what is wrong with a mesh.

use super::Repair;
use super::triangles::{
    attributes, for_each_duplicate, has_no_area, is_finite, non_finite_elements, references, unite_at_edge,
    vertex_triangles, zero_normals,
};
use crate::Mesh;
use crate::topology::edges::next;
use crate::topology::{CornerTable, FaceId, UnionFind};

/// What a mesh is made of and what is wrong with it. See [`diagnose`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Diagnosis {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of wedges.
    pub wedges: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of edges: pairs of vertices joined by a triangle that is not degenerate.
    pub edges: usize,
    /// Vertices at infinity or not a number.
    pub non_finite_positions: usize,
    /// Elements of attributes and morph targets with such a value.
    pub non_finite_attributes: usize,
    /// Wedges with a normal of zero.
    pub zero_normals: usize,
    /// Triangles that name a vertex twice.
    pub degenerate_triangles: usize,
    /// Other triangles without area ([`Repair::DropZeroArea`] says when).
    pub zero_area_triangles: usize,
    /// Triangles with the vertices and the winding of an earlier one.
    pub duplicate_triangles: usize,
    /// Triangles with the vertices of an earlier one in opposite winding.
    pub opposite_duplicates: usize,
    /// Edges of three triangles or more.
    pub non_manifold_edges: usize,
    /// Vertices where several sheets touch.
    pub non_manifold_vertices: usize,
    /// Edges of two triangles whose windings disagree.
    pub inconsistent_edges: usize,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Loops of boundary edges; two that touch at a vertex count as one.
    pub boundary_loops: usize,
    /// Vertices that no triangle refers to.
    pub unreferenced_vertices: usize,
    /// Wedges that no triangle refers to.
    pub unreferenced_wedges: usize,
    /// Sets of triangles joined by edges, degenerate ones left out.
    pub components: usize,
    /// Vertices in use - edges + triangles, degenerate ones left out.
    pub euler_characteristic: i64,
    /// Number of handles of all components together, if the surface is manifold and wound consistently.
    pub genus: Option<u32>,
    /// Whether all triangles can be wound to agree.
    pub orientable: bool,
    /// Whether there are triangles and no boundary edge.
    pub closed: bool,
}

/// A kind of defect that a mesh has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Defect {
    /// What is wrong, in words: "degenerate triangles".
    pub name: &'static str,
    /// How often.
    pub count: usize,
    /// What mends it, if anything does.
    pub remedy: Option<Repair>,
}

impl Diagnosis {
    /// Whether every edge has at most two triangles and every vertex one fan of them.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_vertices == 0
    }

    /// The defects that there are, the gravest first, each with its remedy. An open boundary, needles without area and
    /// two-sided triangles are not among them: they may be meant.
    pub fn defects(&self) -> impl Iterator<Item = Defect> + use<> {
        let unwound = if self.orientable { Some(Repair::UnifyWinding) } else { None };
        let all = [
            ("vertices that are not finite", self.non_finite_positions, Some(Repair::DropNonFinite)),
            ("attributes that are not finite", self.non_finite_attributes, Some(Repair::DropNonFinite)),
            ("degenerate triangles", self.degenerate_triangles, Some(Repair::DropDegenerate)),
            ("duplicate triangles", self.duplicate_triangles, Some(Repair::DropDuplicates)),
            ("non-manifold edges", self.non_manifold_edges, Some(Repair::SplitNonManifold)),
            ("non-manifold vertices", self.non_manifold_vertices, Some(Repair::SplitNonManifold)),
            ("edges of inconsistent winding", self.inconsistent_edges, unwound),
            ("unreferenced vertices", self.unreferenced_vertices, Some(Repair::DropUnreferenced)),
            ("unreferenced wedges", self.unreferenced_wedges, Some(Repair::DropUnreferenced)),
        ];
        let defects = all.map(|(name, count, remedy)| Defect { name, count, remedy });
        defects.into_iter().filter(|defect| defect.count > 0)
    }
}

/// Counts the defects of a mesh and what its surface is, over vertices: seams of attributes do not show. A triangle soup
/// that was not welded is all boundary.
///
/// Cost: linear but for sorting the edges around each vertex; some 52 bytes per triangle for a while.
///
/// # Panics
/// If [`Mesh::check`] fails.
pub fn diagnose(mesh: &Mesh) -> Diagnosis {
    let (used_wedges, used_vertices) = references(mesh);
    let unused = |used: &[bool]| used.iter().filter(|&&used| !used).count();
    let mut diagnosis = Diagnosis {
        vertices: mesh.vertex_count(),
        wedges: mesh.wedge_count(),
        triangles: mesh.triangle_count(),
        non_finite_positions: mesh.positions.iter().filter(|p| !is_finite(p)).count(),
        non_finite_attributes: attributes(mesh).map(non_finite_elements).sum(),
        zero_normals: zero_normals(mesh),
        unreferenced_vertices: unused(&used_vertices),
        unreferenced_wedges: unused(&used_wedges),
        ..Diagnosis::default()
    };
    let triangles = vertex_triangles(mesh);
    for_each_duplicate(&triangles, mesh.vertex_count(), |duplicate| {
        diagnosis.duplicate_triangles += usize::from(duplicate.repeats);
        diagnosis.opposite_duplicates += usize::from(duplicate.opposes && !duplicate.repeats);
    });
    diagnose_surface(mesh, triangles, &mut diagnosis);
    diagnosis
}

fn diagnose_surface(mesh: &Mesh, triangles: Vec<[u32; 3]>, diagnosis: &mut Diagnosis) {
    let mut components = UnionFind::new(triangles.len());
    let mut boundary = Vec::new();
    let table = CornerTable::build_observed(triangles, mesh.vertex_count(), |half_edges| {
        unite_at_edge(&mut components, half_edges);
        if let &[half_edge] = half_edges {
            boundary.push(half_edge);
        }
    });
    let proper = |t: usize| !table.is_degenerate(FaceId(t as u32));
    let roots = components.into_roots();
    diagnosis.components = (0..roots.len()).filter(|&t| roots[t] as usize == t && proper(t)).count();
    let no_area = |&t: &usize| proper(t) && has_no_area(mesh, t);
    diagnosis.zero_area_triangles = (0..mesh.triangle_count()).filter(no_area).count();
    diagnosis.boundary_loops = count_loops(mesh, &boundary);

    let report = table.report();
    diagnosis.edges = report.edges as usize;
    diagnosis.degenerate_triangles = report.degenerate_faces as usize;
    diagnosis.non_manifold_edges = report.non_manifold_edges as usize;
    diagnosis.non_manifold_vertices = report.non_manifold_vertices as usize;
    diagnosis.inconsistent_edges = report.inconsistent_edges as usize;
    diagnosis.boundary_edges = report.boundary_edges as usize;
    diagnosis.euler_characteristic = table.euler_characteristic();
    diagnosis.genus = table.genus();
    diagnosis.orientable = table.is_orientable();
    diagnosis.closed = report.edges > 0 && report.boundary_edges == 0;
}

/// Connected pieces of the boundary. Unlike the loops of the corner table these do not run along cut edges.
fn count_loops(mesh: &Mesh, boundary: &[u32]) -> usize {
    let vertex = |corner: u32| mesh.wedge_vertices[mesh.triangles.as_flattened()[corner as usize] as usize];
    let mut pieces = UnionFind::new(if boundary.is_empty() { 0 } else { mesh.vertex_count() });
    // a tree has one edge fewer than vertices, so pieces = vertices - unions
    let mut on_boundary = vec![false; if boundary.is_empty() { 0 } else { mesh.vertex_count() }];
    let (mut vertices, mut unions) = (0, 0);
    for &half_edge in boundary {
        let ends = [vertex(half_edge), vertex(next(half_edge))];
        for end in ends {
            vertices += usize::from(!std::mem::replace(&mut on_boundary[end as usize], true));
        }
        unions += usize::from(pieces.union(ends[0], ends[1]));
    }
    vertices - unions
}
