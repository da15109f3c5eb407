//! The corner table: all adjacency of a triangle list in two arrays.

use super::edges::{EdgeKind, for_each_edge, is_degenerate, next, prev};
use super::{CornerId, FaceId, UnionFind, VertexId};
use crate::Mesh;

const NONE: u32 = u32::MAX;

/// Read-only connectivity of a triangle list with implicit half-edges.
///
/// ```text
///               prev(c)                  corner c = 3 f + i is corner i of face f
///              /      \                  the half-edge c leaves vertex(c) for vertex(next(c))
///             /        \
///            /    f     \                the edge that c faces joins next(c) and prev(c);
///           c ---------> next(c)         opposite(c) faces it from the other side
///            \    c     /
///             \ twin(c)/                 twin(c) runs along the same edge, back
///              \      /
///           opposite(prev(c))
/// ```
///
/// Only *manifold* edges join faces: those at which exactly two faces meet that run through it in opposite directions.
/// At all other edges (boundary, non-manifold, inconsistent winding) [`opposite`](Self::opposite) is `None`, and the
/// surface is as if cut there; [`report`](Self::report) counts them. So any list of triangles has a corner table, and
/// following it never goes astray.
///
/// The corners at a vertex fall into *fans*: runs of faces joined across manifold edges, counter-clockwise. An inner
/// vertex has one closed fan, a boundary vertex one open fan that starts at its clockwise end; a vertex where several
/// sheets touch has several ([`fans`](Self::fans)). Circulators go through all of them, fan by fan. Faces that name a
/// vertex twice keep their place in the list but take part in nothing: no opposites, in no fan, no boundary.
///
/// Memory: 24 bytes per face and 4 per vertex; [`build`](Self::build) needs another 24 per face for a while.
///
/// # References
/// Rossignac, Safonova, Szymczak: 3D compression made simple: Edgebreaker on a corner table, SMI 2001. We add fans,
/// for input that is not manifold.
///
/// # Examples
/// ```
/// use maille::{mesh::shapes, topology::{CornerTable, VertexId}};
/// let table = CornerTable::of_vertices(&shapes::tetrahedron());
/// let ring: Vec<_> = table.vertex_vertices(VertexId(0)).collect();
/// assert_eq!(format!("{ring:?}"), "[v1, v2, v3]");
/// assert_eq!(table.euler_characteristic(), 2);
/// ```
#[derive(Debug, Clone)]
pub struct CornerTable {
    pub(super) faces: Vec<[u32; 3]>,
    opposite: Vec<u32>,
    /// First corner of the fan that holds the lowest corner of each vertex.
    first_corner: Vec<u32>,
    /// Vertex and first corner of all other fans, sorted.
    extra_fans: Vec<(u32, u32)>,
    /// The two half-edges of each edge whose faces disagree in winding.
    inconsistent: Vec<[u32; 2]>,
    report: TopologyReport,
}

/// What a triangle list is made of, and what keeps it from being a manifold surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TopologyReport {
    /// Pairs of vertices joined by a face.
    pub edges: u32,
    /// Edges with one face.
    pub boundary_edges: u32,
    /// Edges with three faces or more.
    pub non_manifold_edges: u32,
    /// Edges with two faces that run through it in the same direction.
    pub inconsistent_edges: u32,
    /// Vertices around which the faces form several fans, counting fans that meet at an inconsistent edge as one.
    pub non_manifold_vertices: u32,
    /// Vertices without (proper) faces.
    pub isolated_vertices: u32,
    /// Faces that name a vertex twice.
    pub degenerate_faces: u32,
}

impl TopologyReport {
    /// Whether every edge has one face or two and every vertex at most one fan. Winding is not asked for.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_vertices == 0
    }
}

/// Why there is no corner table of a triangle list.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TopologyError {
    /// A face refers to a vertex that does not exist.
    #[error("face {face:?} refers to vertex {index}, but there are only {vertices}")]
    IndexOutOfRange {
        /// Which face.
        face: FaceId,
        /// What it refers to.
        index: u32,
        /// How many there are.
        vertices: usize,
    },
    /// More corners or vertices than 32-bit indices can name.
    #[error("{count} {what} are more than 32-bit indices can name")]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
    },
}

/// A run of faces around a vertex, joined across manifold edges.
#[derive(Debug, Clone, Copy)]
pub struct Fan<'a> {
    table: &'a CornerTable,
    start: CornerId,
}

impl<'a> Fan<'a> {
    /// Its corners at the vertex, counter-clockwise; from the clockwise end if it is open.
    pub fn corners(self) -> impl Iterator<Item = CornerId> + 'a {
        let Self { table, start } = self;
        std::iter::successors(Some(start), move |&c| table.swing_left(c).filter(|&c| c != start))
    }

    /// The vertices that share an edge of the fan with its vertex, counter-clockwise.
    pub fn vertices(self) -> impl Iterator<Item = VertexId> + 'a {
        let table = self.table;
        self.corners().flat_map(move |c| {
            let end = table.swing_left(c).is_none().then(|| table.vertex(table.prev(c)));
            std::iter::once(table.vertex(table.next(c))).chain(end)
        })
    }

    /// Whether it goes all the way round.
    pub fn is_closed(self) -> bool {
        self.table.swing_right(self.start).is_some()
    }

    /// Its first corner.
    pub fn start(self) -> CornerId {
        self.start
    }
}

/// Construction.
impl CornerTable {
    /// The connectivity of triangles over `vertex_count` vertices.
    ///
    /// Linear time but for sorting the edges around each vertex.
    ///
    /// # Errors
    /// [`TopologyError`] if an index is out of range or there are more than 2^32 - 2 corners or vertices.
    pub fn build(faces: Vec<[u32; 3]>, vertex_count: usize) -> Result<Self, TopologyError> {
        for (what, count) in [("corners", faces.len().saturating_mul(3)), ("vertices", vertex_count)] {
            if count >= NONE as usize {
                return Err(TopologyError::TooMany { what, count });
            }
        }
        let outside = |face: &[u32; 3]| face.iter().find(|&&v| v as usize >= vertex_count).copied();
        if let Some((face, index)) = (0..).zip(&faces).find_map(|(f, face)| Some((FaceId(f), outside(face)?))) {
            return Err(TopologyError::IndexOutOfRange { face, index, vertices: vertex_count });
        }
        Ok(Self::build_observed(faces, vertex_count, |_| ()))
    }

    /// The connectivity of a mesh over its vertices: seams in attributes do not show.
    ///
    /// # Panics
    /// If [`Mesh::check`] fails.
    pub fn of_vertices(mesh: &Mesh) -> Self {
        let faces = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
        Self::build(faces, mesh.vertex_count()).expect("a mesh has its indices in range")
    }

    /// The connectivity of a mesh over its wedges: a seam in any attribute is a boundary.
    ///
    /// # Panics
    /// If [`Mesh::check`] fails.
    pub fn of_wedges(mesh: &Mesh) -> Self {
        Self::build(mesh.triangles.clone(), mesh.wedge_count()).expect("a mesh has its indices in range")
    }

    /// [`build`](Self::build) for indices known to be good, showing the half-edges of each edge to `observe`.
    pub(crate) fn build_observed(faces: Vec<[u32; 3]>, vertex_count: usize, mut observe: impl FnMut(&[u32])) -> Self {
        let mut opposite = vec![NONE; 3 * faces.len()];
        let mut inconsistent = Vec::new();
        let mut report = TopologyReport::default();
        for_each_edge(&faces, vertex_count, |kind, half_edges| {
            report.edges += 1;
            match kind {
                EdgeKind::Boundary => report.boundary_edges += 1,
                EdgeKind::NonManifold => report.non_manifold_edges += 1,
                EdgeKind::Inconsistent(a, b) => inconsistent.push([a, b]),
                EdgeKind::Manifold(a, b) => {
                    opposite[prev(a) as usize] = prev(b);
                    opposite[prev(b) as usize] = prev(a);
                }
            }
            observe(half_edges);
        });
        let first_corner = vec![NONE; vertex_count];
        let mut table = Self { faces, opposite, first_corner, extra_fans: Vec::new(), inconsistent, report };
        table.find_fans();
        table.complete_report();
        table
    }

    fn find_fans(&mut self) {
        let mut seen = vec![0u64; self.corner_count().div_ceil(64)];
        for f in (0..self.face_count() as u32).filter(|&f| !is_degenerate(&self.faces[f as usize])) {
            for c in (3 * f..3 * f + 3).map(CornerId) {
                if seen[c.index() / 64] >> (c.0 % 64) & 1 == 1 {
                    continue;
                }
                let start = self.fan_start(c);
                let fan = Fan { table: self, start };
                fan.corners().for_each(|c| seen[c.index() / 64] |= 1 << (c.0 % 64));
                let vertex = self.vertex(c);
                match &mut self.first_corner[vertex.index()] {
                    first if *first == NONE => *first = start.0,
                    _ => self.extra_fans.push((vertex.0, start.0)),
                }
            }
        }
        self.extra_fans.sort_unstable();
        self.extra_fans.shrink_to_fit();
    }

    fn complete_report(&mut self) {
        self.report.inconsistent_edges = self.inconsistent.len() as u32;
        self.report.isolated_vertices = self.first_corner.iter().filter(|&&c| c == NONE).count() as u32;
        self.report.degenerate_faces = self.faces.iter().filter(|face| is_degenerate(face)).count() as u32;
        let sheets = self.sheets();
        let several = |sheets: &&[Sheet]| sheets.iter().any(|sheet| sheet.number > 0);
        self.report.non_manifold_vertices = sheets.chunk_by(|a, b| a.vertex == b.vertex).filter(several).count() as u32;
    }

    /// The fan's first corner, from any other.
    fn fan_start(&self, corner: CornerId) -> CornerId {
        let mut start = corner;
        while let Some(right) = self.swing_right(start).filter(|&right| right != corner) {
            start = right;
        }
        if self.swing_right(start).is_some() { corner } else { start }
    }

    /// The fans of all vertices that have several, grouped into the sheets that remain when faces joined by an edge of
    /// inconsistent winding count as joined. By vertex; the first fan of a vertex is of sheet 0.
    pub(crate) fn sheets(&self) -> Vec<Sheet> {
        let vertices = self.extra_fans.chunk_by(|a, b| a.0 == b.0);
        let fans = vertices.flat_map(|fans| {
            let first = (fans[0].0, self.first_corner[fans[0].0 as usize]);
            std::iter::once(first).chain(fans.iter().copied())
        });
        let mut sheets: Vec<_> = fans.map(|(vertex, start)| Sheet { vertex, start, number: 0 }).collect();
        let mut by_start: Vec<u32> = (0..sheets.len() as u32).collect();
        by_start.sort_unstable_by_key(|&i| sheets[i as usize].start);
        let fan_of = |c: u32| {
            let start = self.fan_start(CornerId(c)).0;
            by_start.binary_search_by_key(&start, |&i| sheets[i as usize].start).ok().map(|at| by_start[at])
        };
        let mut sets = UnionFind::new(sheets.len());
        for &[a, b] in &self.inconsistent {
            for (a, b) in [(a, b), (next(a), next(b))] {
                // no fan is found where the vertex has only one
                if let (Some(a), Some(b)) = (fan_of(a), fan_of(b)) {
                    sets.union(a, b);
                }
            }
        }
        let roots = sets.into_roots();
        let mut numbered = 0;
        for i in 0..sheets.len() {
            if i == 0 || sheets[i - 1].vertex != sheets[i].vertex {
                numbered = 0;
            }
            let root = roots[i] as usize;
            sheets[i].number = if root == i { numbered } else { sheets[root].number };
            numbered += u32::from(root == i);
        }
        sheets
    }
}

/// A fan of a vertex with several, and which of the sheets that touch there it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sheet {
    /// The vertex.
    pub(crate) vertex: u32,
    /// First corner of the fan.
    pub(crate) start: u32,
    /// Number of the sheet among those of the vertex.
    pub(crate) number: u32,
}

/// Elements.
impl CornerTable {
    /// Number of vertices, isolated ones included.
    pub fn vertex_count(&self) -> usize {
        self.first_corner.len()
    }

    /// Number of faces, degenerate ones included.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Number of corners: three per face.
    pub fn corner_count(&self) -> usize {
        self.opposite.len()
    }

    /// All vertices.
    pub fn vertices(&self) -> impl ExactSizeIterator<Item = VertexId> + use<> {
        (0..self.vertex_count() as u32).map(VertexId)
    }

    /// All faces.
    pub fn faces(&self) -> impl ExactSizeIterator<Item = FaceId> + use<> {
        (0..self.face_count() as u32).map(FaceId)
    }

    /// All corners, and so all half-edges.
    pub fn corners(&self) -> impl ExactSizeIterator<Item = CornerId> + use<> {
        (0..self.corner_count() as u32).map(CornerId)
    }

    /// One half-edge of each edge of the surface: of two twins the lower one. A non-manifold or inconsistent edge comes
    /// once for each face.
    pub fn edges(&self) -> impl Iterator<Item = CornerId> + '_ {
        let proper = self.corners().filter(|&h| !self.is_degenerate(self.face(h)));
        proper.filter(|&h| self.twin(h).is_none_or(|twin| h < twin))
    }

    /// What the list is made of and what is wrong with it.
    pub fn report(&self) -> &TopologyReport {
        &self.report
    }

    /// Whether a face names a vertex twice.
    pub fn is_degenerate(&self, face: FaceId) -> bool {
        is_degenerate(&self.faces[face.index()])
    }
}

/// Steps.
impl CornerTable {
    /// Vertex at a corner: the source of the half-edge.
    pub fn vertex(&self, corner: CornerId) -> VertexId {
        VertexId(self.faces.as_flattened()[corner.index()])
    }

    /// Vertex that the half-edge runs to.
    pub fn target(&self, half_edge: CornerId) -> VertexId {
        self.vertex(self.next(half_edge))
    }

    /// Face of a corner.
    pub fn face(&self, corner: CornerId) -> FaceId {
        FaceId(corner.0 / 3)
    }

    /// Next corner of the face, counter-clockwise.
    pub fn next(&self, corner: CornerId) -> CornerId {
        CornerId(next(corner.0))
    }

    /// Previous corner of the face.
    pub fn prev(&self, corner: CornerId) -> CornerId {
        CornerId(prev(corner.0))
    }

    /// The corner that faces the same edge from the other side, `None` unless the edge is manifold.
    pub fn opposite(&self, corner: CornerId) -> Option<CornerId> {
        Some(self.opposite[corner.index()]).filter(|&c| c != NONE).map(CornerId)
    }

    /// The half-edge that runs back along the same edge, `None` unless the edge is manifold.
    pub fn twin(&self, half_edge: CornerId) -> Option<CornerId> {
        self.opposite(self.prev(half_edge)).map(|c| self.next(c))
    }

    /// Next corner counter-clockwise around the same vertex.
    pub fn swing_left(&self, corner: CornerId) -> Option<CornerId> {
        self.opposite(self.next(corner)).map(|c| self.next(c))
    }

    /// Next corner clockwise around the same vertex.
    pub fn swing_right(&self, corner: CornerId) -> Option<CornerId> {
        self.opposite(self.prev(corner)).map(|c| self.prev(c))
    }

    /// First corner of the first fan of a vertex, `None` if it is isolated.
    pub fn corner(&self, vertex: VertexId) -> Option<CornerId> {
        Some(self.first_corner[vertex.index()]).filter(|&c| c != NONE).map(CornerId)
    }
}

/// Circulators, in the order of seed 001, 4.3.2. All go counter-clockwise.
impl CornerTable {
    /// The fans of a vertex: none if it is isolated, one if the surface is manifold there. The one with the lowest
    /// corner comes first, the others by their first corner.
    pub fn fans(&self, vertex: VertexId) -> impl Iterator<Item = Fan<'_>> {
        let from = self.extra_fans.partition_point(|&(v, _)| v < vertex.0);
        let extra = self.extra_fans[from..].iter().take_while(move |&&(v, _)| v == vertex.0);
        self.corner(vertex).into_iter().chain(extra.map(|&(_, c)| CornerId(c))).map(|start| Fan { table: self, start })
    }

    /// The fan that starts at a corner.
    pub(crate) fn fan_from(&self, start: CornerId) -> Fan<'_> {
        Fan { table: self, start }
    }

    /// The two half-edges of each edge whose faces disagree in winding.
    pub(crate) fn inconsistent_edges(&self) -> &[[u32; 2]] {
        &self.inconsistent
    }

    /// The vertices that share an edge with a vertex, each once if the surface is manifold there. Otherwise one at the
    /// end of several fans comes several times.
    pub fn vertex_vertices(&self, vertex: VertexId) -> impl Iterator<Item = VertexId> + '_ {
        self.fans(vertex).flat_map(Fan::vertices)
    }

    /// The half-edges that end at a vertex. The boundary has half-edges on the side of its faces only.
    pub fn vertex_incoming(&self, vertex: VertexId) -> impl Iterator<Item = CornerId> + '_ {
        self.vertex_outgoing(vertex).map(|c| self.prev(c))
    }

    /// The half-edges that leave a vertex: its corners.
    pub fn vertex_outgoing(&self, vertex: VertexId) -> impl Iterator<Item = CornerId> + '_ {
        self.fans(vertex).flat_map(Fan::corners)
    }

    /// The faces around a vertex.
    pub fn vertex_faces(&self, vertex: VertexId) -> impl Iterator<Item = FaceId> + '_ {
        self.vertex_outgoing(vertex).map(|c| self.face(c))
    }

    /// The vertices of a face.
    pub fn face_vertices(&self, face: FaceId) -> [VertexId; 3] {
        self.faces[face.index()].map(VertexId)
    }

    /// The half-edges of a face: its corners.
    pub fn face_half_edges(&self, face: FaceId) -> [CornerId; 3] {
        [0, 1, 2].map(|i| CornerId(3 * face.0 + i))
    }

    /// The faces that share a manifold edge with a face, in the order of its half-edges.
    pub fn face_faces(&self, face: FaceId) -> impl Iterator<Item = FaceId> + '_ {
        self.face_half_edges(face).into_iter().filter_map(|h| self.twin(h)).map(|twin| self.face(twin))
    }

    /// Number of vertices that share an edge with a vertex, as [`vertex_vertices`](Self::vertex_vertices) counts.
    pub fn valence(&self, vertex: VertexId) -> usize {
        self.vertex_vertices(vertex).count()
    }

    /// Whether a half-edge has no twin: its edge is a boundary, non-manifold or inconsistent.
    pub fn is_boundary(&self, half_edge: CornerId) -> bool {
        self.opposite(self.prev(half_edge)).is_none() && !self.is_degenerate(self.face(half_edge))
    }

    /// Whether a fan of the vertex is open.
    pub fn is_boundary_vertex(&self, vertex: VertexId) -> bool {
        self.fans(vertex).any(|fan| !fan.is_closed())
    }
}
