//! What a surface is as a whole: boundary loops, components, genus, orientability; and closing its holes.

use super::edges::deal;
use super::{CornerId, CornerTable, FaceId, UnionFind, VertexId};

const NONE: u32 = u32::MAX;

/// The loops of half-edges without twin.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BoundaryLoops {
    half_edges: Vec<CornerId>,
    /// Where each loop ends in `half_edges`.
    ends: Vec<u32>,
}

impl BoundaryLoops {
    /// Number of loops.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are none: the surface is closed.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The loops by their lowest half-edge. Each starts there and follows the half-edges, the surface on the left.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[CornerId]> {
        let start = |i: usize| if i == 0 { 0 } else { self.ends[i - 1] as usize };
        (0..self.len()).map(move |i| &self.half_edges[start(i)..self.ends[i] as usize])
    }
}

/// A component of the surface cut along all edges that are not manifold: always an orientable surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Component {
    /// Number of faces.
    pub faces: u32,
    /// Number of vertices; one where several fans meet counts once for each.
    pub vertices: u32,
    /// Number of edges.
    pub edges: u32,
    /// Number of boundary loops.
    pub boundary_loops: u32,
}

impl Component {
    /// Vertices - edges + faces.
    pub fn euler_characteristic(&self) -> i64 {
        i64::from(self.vertices) - i64::from(self.edges) + i64::from(self.faces)
    }

    /// Number of handles: 0 for a sphere or a disk, 1 for a torus.
    pub fn genus(&self) -> u32 {
        // an orientable surface has characteristic 2 - 2 genus - loops
        ((2 - self.euler_characteristic() - i64::from(self.boundary_loops)) / 2) as u32
    }
}

/// The components of a surface.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Components {
    of_face: Vec<u32>,
    list: Vec<Component>,
}

impl Components {
    /// The components, by their lowest face.
    pub fn list(&self) -> &[Component] {
        &self.list
    }

    /// Which component a face belongs to, `None` for a degenerate face.
    pub fn of_face(&self, face: FaceId) -> Option<usize> {
        Some(self.of_face[face.index()]).filter(|&c| c != NONE).map(|c| c as usize)
    }
}

/// A way to wind all faces alike, as far as there is one.
#[derive(Debug, Clone, Default)]
pub(crate) struct Orientation {
    /// The components of the cut surface.
    pub(crate) components: Components,
    /// For each component, whether its faces must turn to agree with the first component of its surface.
    pub(crate) turned: Vec<bool>,
    /// For each component, which surface it is part of: components joined by edges of inconsistent winding.
    pub(crate) surface: Vec<u32>,
    /// For each surface, whether all can be made to agree.
    pub(crate) orientable: Vec<bool>,
}

/// A triangle list without boundary, from [`CornerTable::close_holes`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClosedSurface {
    /// The faces of the table, then the dummies.
    pub faces: Vec<[u32; 3]>,
    /// Number of vertices with the dummies.
    pub vertex_count: usize,
    /// The first dummy vertex: the number of vertices before.
    pub first_dummy_vertex: u32,
    /// The first dummy face: the number of faces before.
    pub first_dummy_face: u32,
}

impl ClosedSurface {
    /// Whether a vertex was made to close a hole.
    pub fn is_dummy_vertex(&self, vertex: VertexId) -> bool {
        vertex.0 >= self.first_dummy_vertex
    }

    /// Whether a face was made to close a hole.
    pub fn is_dummy_face(&self, face: FaceId) -> bool {
        face.0 >= self.first_dummy_face
    }
}

impl CornerTable {
    /// The loops of half-edges without twin. Where several fans meet at a vertex, loops keep to their fan. Linear.
    pub fn boundary_loops(&self) -> BoundaryLoops {
        let mut loops = BoundaryLoops::default();
        let mut seen = vec![false; self.corner_count()];
        for start in self.corners() {
            if seen[start.index()] || !self.is_boundary(start) {
                continue;
            }
            let mut half_edge = start;
            while !seen[half_edge.index()] {
                seen[half_edge.index()] = true;
                loops.half_edges.push(half_edge);
                half_edge = self.next_on_boundary(half_edge);
            }
            loops.ends.push(loops.half_edges.len() as u32);
        }
        loops
    }

    /// The half-edge after this one on its boundary loop.
    fn next_on_boundary(&self, half_edge: CornerId) -> CornerId {
        // swing clockwise around the target to the other end of the fan
        let mut corner = self.next(half_edge);
        while let Some(right) = self.swing_right(corner) {
            corner = right;
        }
        corner
    }

    /// The components of the surface: faces joined across manifold edges. Linear.
    pub fn components(&self) -> Components {
        self.components_with(&self.boundary_loops())
    }

    fn components_with(&self, loops: &BoundaryLoops) -> Components {
        let mut sets = UnionFind::new(self.face_count());
        for corner in self.corners() {
            if let Some(opposite) = self.opposite(corner) {
                sets.union(corner.0 / 3, opposite.0 / 3);
            }
        }
        let mut of_face = sets.into_roots();
        let mut list: Vec<Component> = Vec::new();
        for face in self.faces() {
            let root = of_face[face.index()];
            of_face[face.index()] = if self.is_degenerate(face) {
                NONE
            } else if root == face.0 {
                list.push(Component::default());
                list.len() as u32 - 1
            } else {
                of_face[root as usize]
            };
        }
        let component = |corner: CornerId| of_face[corner.index() / 3] as usize;
        for vertex in self.vertices() {
            self.fans(vertex).for_each(|fan| list[component(fan.start())].vertices += 1);
        }
        for edge in self.edges() {
            list[component(edge)].edges += 1;
        }
        for boundary in loops.iter() {
            list[component(boundary[0])].boundary_loops += 1;
        }
        for &c in of_face.iter().filter(|&&c| c != NONE) {
            list[c as usize].faces += 1;
        }
        Components { of_face, list }
    }

    /// Vertices - edges + faces of the list as it is, without isolated vertices and degenerate faces.
    pub fn euler_characteristic(&self) -> i64 {
        let report = self.report();
        let vertices = self.vertex_count() as i64 - i64::from(report.isolated_vertices);
        let faces = self.face_count() as i64 - i64::from(report.degenerate_faces);
        vertices - i64::from(report.edges) + faces
    }

    /// Number of handles of all components together; `None` unless the surface is manifold and wound consistently.
    pub fn genus(&self) -> Option<u32> {
        let report = self.report();
        let proper = report.is_manifold() && report.inconsistent_edges == 0;
        proper.then(|| self.components().list().iter().map(Component::genus).sum())
    }

    /// Whether the faces can be wound so that all agree at every edge of two faces. Linear.
    pub fn is_orientable(&self) -> bool {
        self.inconsistent_edges().is_empty() || self.orientation().orientable.iter().all(|&yes| yes)
    }

    /// Whether every edge has exactly two faces.
    pub fn is_closed(&self) -> bool {
        self.report().boundary_edges == 0 && self.report().non_manifold_edges == 0
    }

    /// How to wind all faces alike: components agree within themselves, so it is enough to colour the graph of those
    /// that disagree at an edge with two colours.
    pub(crate) fn orientation(&self) -> Orientation {
        let components = self.components();
        let count = components.list.len();
        let ends = |edge: &[u32; 2]| edge.map(|h| components.of_face[h as usize / 3]);
        let pairs = || self.inconsistent_edges().iter().map(ends).flat_map(|[a, b]| [(a, b), (b, a)]);
        let (starts, neighbours) = deal(count, pairs, |b| b);
        let mut surface = vec![NONE; count];
        let mut turned = vec![false; count];
        let mut orientable = Vec::new();
        let mut stack = Vec::new();
        for first in 0..count {
            if surface[first] != NONE {
                continue;
            }
            let number = orientable.len() as u32;
            orientable.push(true);
            surface[first] = number;
            stack.push(first);
            while let Some(a) = stack.pop() {
                for &b in &neighbours[starts[a] as usize..starts[a + 1] as usize] {
                    let b = b as usize;
                    if surface[b] == NONE {
                        (surface[b], turned[b]) = (number, !turned[a]);
                        stack.push(b);
                    } else if turned[b] == turned[a] {
                        orientable[number as usize] = false;
                    }
                }
            }
        }
        Orientation { components, turned, surface, orientable }
    }

    /// Closes every boundary loop by a dummy vertex joined to all its edges (seed 001, 4.3.2, `closeBorders`).
    ///
    /// Dummy vertices follow the others in the order of the loops, dummy faces likewise, each with its dummy as the
    /// last corner. If the surface is manifold and wound consistently, the result is, too, and closed. (Cut edges are
    /// loops here: split non-manifold input first.)
    ///
    /// # Panics
    /// If the result would have more than 2^32 - 2 corners.
    pub fn close_holes(&self) -> ClosedSurface {
        let loops = self.boundary_loops();
        let [first_dummy_vertex, first_dummy_face] = [self.vertex_count(), self.face_count()].map(|n| n as u32);
        let fans = loops.iter().zip(first_dummy_vertex..);
        let dummies = fans.flat_map(|(half_edges, dummy)| {
            half_edges.iter().map(move |&h| [self.target(h).0, self.vertex(h).0, dummy])
        });
        let faces: Vec<_> = self.faces.iter().copied().chain(dummies).collect();
        assert!(faces.len() < NONE as usize / 3, "32-bit indices name all corners of the closed surface");
        let vertex_count = self.vertex_count() + loops.len();
        ClosedSurface { faces, vertex_count, first_dummy_vertex, first_dummy_face }
    }
}
