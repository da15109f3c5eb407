//! The editable structure behind edge collapse: triangles with linked one-rings, any input accepted.

use glam::DVec3;

use super::edge_star::EdgeStar;
use crate::prefetch::prefetch;

/// "None" in the index arrays.
const NONE: u32 = u32::MAX;

/// One triangle: its vertices, the next corner around each of them, and the edge opposite to each.
///
/// ```text
///              vertex[2]
///                 /\
///        edge[1] /  \ edge[0]          corner k of face f has the id 4 f + k;
///               /    \                 next[k]: another corner at vertex[k], in no
///   vertex[0]  /______\ vertex[1]      special order: non-manifold one-rings are
///              edge[2]                 lists like any other
/// ```
///
/// 36 bytes that one step around a vertex needs together; a removed face has `vertex[0] == NONE`.
#[derive(Debug, Clone, Copy)]
struct Face {
    vertex: [u32; 3],
    next: [u32; 3],
    edge: [u32; 3],
}

/// A face seen from one of its vertices `v`: the face is (v, x, y) in its own orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RingFace {
    /// Index of the face.
    pub face: u32,
    /// Which corner of the face `v` is: 0, 1 or 2.
    pub corner: u8,
    /// The vertex after `v`.
    pub x: u32,
    /// The vertex before `v`.
    pub y: u32,
    /// Edge between `v` and `x`.
    pub edge_x: u32,
    /// Edge between `v` and `y`.
    pub edge_y: u32,
}

/// Coordinates in which the simplifier computes: the model moved to its centre and scaled to an extent between a half
/// and 1.
///
/// Tolerances then mean the same for a molecule and a mountain; errors are scaled back with [`Frame::unit`]. Scaling is
/// by a power of two, which rounds nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    center: DVec3,
    /// Length in model units of 1 in this frame.
    unit: f64,
    /// One over it.
    scale: f64,
}

impl Frame {
    /// The frame of a set of finite points.
    pub fn of(positions: &[[f32; 3]]) -> Self {
        let point = |p: &[f32; 3]| glam::Vec3::from(*p).as_dvec3();
        let (low, high) = positions
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(point(p)), high.max(point(p))));
        let extent = (high - low).max_element();
        if extent > 0.0 && extent.is_finite() {
            let unit = extent.log2().ceil().exp2();
            Self { center: (low + high) / 2.0, unit, scale: 1.0 / unit }
        } else {
            Self { center: if low.is_finite() { low } else { DVec3::ZERO }, unit: 1.0, scale: 1.0 }
        }
    }

    /// The origin, in model units.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Length in model units of 1 in this frame.
    pub fn unit(&self) -> f64 {
        self.unit
    }

    /// From model units.
    #[inline]
    pub fn enter(&self, p: [f32; 3]) -> DVec3 {
        (glam::Vec3::from(p).as_dvec3() - self.center) * self.scale
    }

    /// To model units, rounded to what a mesh stores.
    #[inline]
    pub fn leave(&self, p: DVec3) -> [f32; 3] {
        let most = DVec3::splat(f64::from(f32::MAX));
        (p * self.unit + self.center).clamp(-most, most).as_vec3().to_array()
    }
}

/// Triangles under edge collapse: every vertex knows its faces, every edge its two ends.
///
/// Accepts any triangles: edges with three faces and more, vertices with several fans, both windings (seed 000,
/// 3.4.1). Triangles that name a vertex twice have no area and are left out. Costs 36 bytes per face and 8 per edge
/// and vertex; a collapse costs as much as the one-rings of its two ends.
#[derive(Debug, Clone)]
pub struct CollapseMesh {
    frame: Frame,
    positions: Vec<[f32; 3]>,
    faces: Vec<Face>,
    first_corner: Vec<u32>,
    ends: Vec<[u32; 2]>,
    /// Edges without faces, by vertex: pairs to be joined. Empty when there are none.
    pairs: Vec<Vec<u32>>,
    live_faces: usize,
}

/// What a collapse did to the edges; reused from collapse to collapse.
#[derive(Debug, Default)]
pub struct CollapseEffect {
    /// Edges that are no more: the collapsed one and those that became equal to another.
    pub removed_edges: Vec<u32>,
    /// Those of them that became equal to another edge, with the other.
    pub merged_edges: Vec<(u32, u32)>,
    /// Edges at the merged vertex.
    pub edges: Vec<u32>,
    /// The other ends of [`edges`](Self::edges).
    pub neighbors: Vec<u32>,
}

/// How many marks fit into the short list of [`Marks`].
const FEW: usize = 32;

/// Marks on a few vertices, wiped in no time.
///
/// One-rings are small: up to 32 marks are a list that is searched, which stays in the nearest cache; a table over all
/// vertices would cost a cache miss for most of them. Only larger rings use the table, which is made when the first
/// comes along.
#[derive(Debug)]
pub struct Marks {
    /// The marked vertices and their values, as long as they are few.
    vertices: [u32; FEW],
    values: [u32; FEW],
    /// How many they are; more than [`FEW`] when the table is in use.
    len: usize,
    /// (epoch, value) of each vertex; empty until it is needed.
    table: Vec<[u32; 2]>,
    epoch: u32,
    vertex_count: usize,
}

impl Marks {
    /// No marks on `vertices` vertices.
    pub fn new(vertices: usize) -> Self {
        let (few, none) = ([0; FEW], Vec::new());
        Self { vertices: few, values: few, len: 0, table: none, epoch: 0, vertex_count: vertices }
    }

    /// Wipes all marks.
    #[inline]
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Marks a vertex with a value; returns the value it had.
    #[inline]
    pub fn set(&mut self, vertex: u32, value: u32) -> Option<u32> {
        if self.len > FEW {
            return self.set_in_table(vertex, value);
        }
        match self.place(vertex) {
            Some(i) => Some(std::mem::replace(&mut self.values[i], value)),
            None if self.len < FEW => {
                self.vertices[self.len] = vertex;
                self.values[self.len] = value;
                self.len += 1;
                None
            }
            None => {
                self.move_to_table();
                self.set_in_table(vertex, value)
            }
        }
    }

    /// The value of a mark.
    #[inline]
    pub fn get(&self, vertex: u32) -> Option<u32> {
        if self.len > FEW {
            let [epoch, value] = self.table[vertex as usize];
            return (epoch == self.epoch).then_some(value);
        }
        self.place(vertex).map(|i| self.values[i])
    }

    #[inline]
    fn place(&self, vertex: u32) -> Option<usize> {
        // eight at a time without a branch between them: where a vertex is found is hard to predict
        self.vertices[..self.len].chunks(8).enumerate().find_map(|(i, chunk)| {
            let found = chunk.iter().enumerate().fold(0_u32, |found, (k, &v)| found | u32::from(v == vertex) << k);
            (found != 0).then(|| 8 * i + found.trailing_zeros() as usize)
        })
    }

    #[cold]
    fn move_to_table(&mut self) {
        if self.table.is_empty() || self.epoch == u32::MAX {
            self.table = vec![[0, 0]; self.vertex_count];
            self.epoch = 0;
        }
        self.epoch += 1;
        for (&vertex, &value) in self.vertices.iter().zip(&self.values) {
            self.table[vertex as usize] = [self.epoch, value];
        }
        self.len = FEW + 1;
    }

    fn set_in_table(&mut self, vertex: u32, value: u32) -> Option<u32> {
        let [epoch, before] = std::mem::replace(&mut self.table[vertex as usize], [self.epoch, value]);
        (epoch == self.epoch).then_some(before)
    }
}

impl CollapseMesh {
    /// Builds the structure in linear time. Faces keep the indices of `triangles`.
    ///
    /// # Panics
    /// If a triangle names a vertex that does not exist, or there are 2^30 triangles and more.
    pub fn new(positions: &[[f32; 3]], triangles: impl ExactSizeIterator<Item = [u32; 3]>) -> Self {
        Self::in_frame(Frame::of(positions), positions.to_vec(), triangles)
    }

    /// As [`new`](Self::new), in a frame that was chosen before.
    pub(crate) fn in_frame(
        frame: Frame,
        positions: Vec<[f32; 3]>,
        triangles: impl ExactSizeIterator<Item = [u32; 3]>,
    ) -> Self {
        assert!(triangles.len() < 1 << 30, "face corners must fit into 32 bits");
        let mut mesh = Self {
            frame,
            first_corner: vec![NONE; positions.len()],
            positions,
            faces: Vec::with_capacity(triangles.len()),
            ends: Vec::new(),
            pairs: Vec::new(),
            live_faces: 0,
        };
        for vertex in triangles {
            let [a, b, c] = vertex;
            let whole = a != b && b != c && c != a;
            let vertex = if whole { vertex } else { [NONE; 3] };
            mesh.live_faces += usize::from(whole);
            mesh.faces.push(Face { vertex, next: [NONE; 3], edge: [NONE; 3] });
        }
        // backwards, so that the lists name the corners in rising order
        for f in (0..mesh.faces.len()).rev() {
            let face = &mut mesh.faces[f];
            for k in 0..3 {
                if face.vertex[0] != NONE {
                    let first = &mut mesh.first_corner[face.vertex[k] as usize];
                    face.next[k] = std::mem::replace(first, (f * 4 + k) as u32);
                }
            }
        }
        mesh.number_edges();
        mesh
    }

    /// Gives every pair of joined vertices one edge, in the order of their lower vertices.
    fn number_edges(&mut self) {
        let mut marks = Marks::new(self.positions.len());
        self.ends.reserve(self.live_faces * 3 / 2);
        for v in 0..self.positions.len() as u32 {
            marks.clear();
            let mut corner = self.first_corner[v as usize];
            while corner != NONE {
                let (f, k) = ((corner / 4) as usize, (corner % 4) as usize);
                // the edge to the next vertex is opposite to the previous corner, and the other way round
                for (other, opposite) in [((k + 1) % 3, (k + 2) % 3), ((k + 2) % 3, (k + 1) % 3)] {
                    let n = self.faces[f].vertex[other];
                    if n > v {
                        let edge = marks.get(n).unwrap_or_else(|| {
                            self.ends.push([v, n]);
                            self.ends.len() as u32 - 1
                        });
                        marks.set(n, edge);
                        self.faces[f].edge[opposite] = edge;
                    }
                }
                corner = self.faces[f].next[k];
            }
        }
    }

    /// Adds edges without faces between vertices that are to be joined; pairs with an edge already are left out.
    pub fn add_pairs(&mut self, pairs: &[[u32; 2]]) {
        let mut ring = Vec::new();
        for &[a, b] in pairs {
            self.ring(a, &mut ring);
            let known = |edges: &[u32]| edges.iter().any(|&e| self.ends[e as usize].contains(&b));
            let joined = ring.iter().any(|face| face.x == b || face.y == b);
            if a == b || joined || self.pairs.get(a as usize).is_some_and(|edges| known(edges)) {
                continue;
            }
            self.pairs.resize(self.positions.len(), Vec::new());
            let edge = self.ends.len() as u32;
            self.ends.push([a, b]);
            self.pairs[a as usize].push(edge);
            self.pairs[b as usize].push(edge);
        }
    }

    /// The frame of [`point`](Self::point).
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Number of vertices, those collapsed away among them.
    pub fn vertex_count(&self) -> usize {
        self.positions.len()
    }

    /// Number of faces that are left.
    pub fn live_face_count(&self) -> usize {
        self.live_faces
    }

    /// Number of edges, those that are no more among them.
    pub fn edge_count(&self) -> usize {
        self.ends.len()
    }

    /// Number of faces, those that are no more among them.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Vertices of a face, `None` when it is no more.
    #[inline]
    pub fn face(&self, face: usize) -> Option<[u32; 3]> {
        let vertex = self.faces[face].vertex;
        (vertex[0] != NONE).then_some(vertex)
    }

    /// Edges of a face, each opposite to the vertex of the same place; `None` when the face is no more.
    #[inline]
    pub fn face_edges(&self, face: usize) -> Option<[u32; 3]> {
        self.face(face).map(|_| self.faces[face].edge)
    }

    /// The two ends of an edge.
    #[inline]
    pub fn ends(&self, edge: u32) -> [u32; 2] {
        self.ends[edge as usize]
    }

    /// Position of a vertex in model units.
    #[inline]
    pub fn position(&self, vertex: u32) -> [f32; 3] {
        self.positions[vertex as usize]
    }

    /// Position of a vertex in the unit [`frame`](Self::frame).
    #[inline]
    pub fn point(&self, vertex: u32) -> DVec3 {
        self.frame.enter(self.positions[vertex as usize])
    }

    /// The faces around a vertex, in no special order.
    #[inline]
    pub fn faces_around(&self, vertex: u32) -> impl Iterator<Item = RingFace> + '_ {
        let mut corner = self.first_corner[vertex as usize];
        std::iter::from_fn(move || {
            while corner != NONE {
                let (f, k) = (corner / 4, (corner % 4) as usize);
                let face = &self.faces[f as usize];
                corner = face.next[k];
                if face.vertex[0] != NONE {
                    return Some(ring_face(f, k, face));
                }
            }
            None
        })
    }

    /// Writes the faces around a vertex into `ring`.
    #[inline]
    pub fn ring(&self, vertex: u32, ring: &mut Vec<RingFace>) {
        ring.clear();
        for face in self.faces_around(vertex) {
            ring.push(face);
        }
    }

    /// Edges without faces at a vertex.
    pub fn pairs_at(&self, vertex: u32) -> &[u32] {
        self.pairs.get(vertex as usize).map_or(&[], Vec::as_slice)
    }

    /// Merges the ends of an edge: `removed` becomes `kept`, which moves to `position`; faces at both are no more.
    ///
    /// The star must be that of the edge as it is now; `marks` is scratch.
    pub fn collapse(
        &mut self,
        star: &EdgeStar<'_>,
        position: [f32; 3],
        marks: &mut Marks,
        effect: &mut CollapseEffect,
    ) {
        effect.removed_edges.clear();
        effect.merged_edges.clear();
        effect.edges.clear();
        effect.neighbors.clear();
        effect.removed_edges.push(star.edge);
        self.positions[star.kept as usize] = position;
        if star.is_regular() && self.pairs.is_empty() {
            self.merge_regular(star, effect);
        } else {
            self.merge(star, marks, effect);
        }
    }

    /// The part of [`collapse`](Self::collapse) that merges regular stars: every neighbour is `x` of one face around an
    /// end, and only the two apexes are neighbours of both.
    fn merge_regular(&mut self, star: &EdgeStar<'_>, effect: &mut CollapseEffect) {
        let &EdgeStar { kept, removed, kept_ring, removed_ring, .. } = star;
        let mut first = NONE;
        // the edges from `kept` to the apexes
        let (mut left, mut right) = ((NONE, NONE), (NONE, NONE));
        for ring in kept_ring {
            if ring.x == removed {
                left = (ring.y, ring.edge_y);
                self.faces[ring.face as usize].vertex = [NONE; 3];
                continue;
            }
            effect.edges.push(ring.edge_x);
            effect.neighbors.push(ring.x);
            let face = &mut self.faces[ring.face as usize];
            if ring.y == removed {
                right = (ring.x, ring.edge_x);
                face.vertex = [NONE; 3];
                continue;
            }
            face.next[ring.corner as usize] = first;
            first = ring.face * 4 + u32::from(ring.corner);
        }
        self.live_faces -= 2;
        let apex_edge = |v: u32| {
            let second = if v == right.0 { right.1 } else { NONE };
            if v == left.0 { left.1 } else { second }
        };
        for ring in removed_ring {
            let known = apex_edge(ring.x);
            if known != NONE {
                self.retire(ring.edge_x, Some(known), effect);
            } else if ring.x != kept {
                self.ends[ring.edge_x as usize] = [kept, ring.x];
                effect.edges.push(ring.edge_x);
                effect.neighbors.push(ring.x);
            }
            if ring.x == kept || ring.y == kept {
                continue;
            }
            let k = ring.corner as usize;
            let face = &mut self.faces[ring.face as usize];
            face.vertex[k] = kept;
            face.next[k] = first;
            first = ring.face * 4 + k as u32;
            // the edge to x is opposite to the corner before k, the edge to y to the one after
            if known != NONE {
                face.edge[(k + 2) % 3] = known;
            }
            let known = apex_edge(ring.y);
            if known != NONE {
                face.edge[(k + 1) % 3] = known;
            }
        }
        self.close(star, first);
    }

    /// Names the faces of the merged vertex and takes the other and the edge out.
    fn close(&mut self, star: &EdgeStar<'_>, first: u32) {
        self.first_corner[star.kept as usize] = first;
        self.first_corner[star.removed as usize] = NONE;
        self.ends[star.edge as usize] = [NONE; 2];
    }

    /// The part of [`collapse`](Self::collapse) that merges any star.
    fn merge(&mut self, star: &EdgeStar<'_>, marks: &mut Marks, effect: &mut CollapseEffect) {
        let &EdgeStar { kept, removed, kept_ring, removed_ring, .. } = star;
        marks.clear();
        let mut note = |n: u32, e: u32, effect: &mut CollapseEffect| {
            let known = marks.get(n);
            if known.is_none() {
                marks.set(n, e);
                effect.edges.push(e);
                effect.neighbors.push(n);
            }
            known
        };
        let mut first = NONE;
        for ring in kept_ring {
            let face = &mut self.faces[ring.face as usize];
            if ring.x == removed || ring.y == removed {
                face.vertex = [NONE; 3];
                self.live_faces -= 1;
                continue;
            }
            face.next[ring.corner as usize] = first;
            first = ring.face * 4 + u32::from(ring.corner);
            note(ring.x, ring.edge_x, effect);
            note(ring.y, ring.edge_y, effect);
        }
        for ring in removed_ring.iter().filter(|ring| ring.x != kept && ring.y != kept) {
            let face = &mut self.faces[ring.face as usize];
            let k = ring.corner as usize;
            face.vertex[k] = kept;
            face.next[k] = first;
            first = ring.face * 4 + k as u32;
            // the edge to x is opposite to the corner before k, the edge to y to the one after
            for (n, e, opposite) in [(ring.x, ring.edge_x, (k + 2) % 3), (ring.y, ring.edge_y, (k + 1) % 3)] {
                match note(n, e, effect) {
                    Some(known) if known != e => {
                        self.faces[ring.face as usize].edge[opposite] = known;
                        self.retire(e, Some(known), effect);
                    }
                    Some(_) => {}
                    None => self.ends[e as usize] = [kept, n],
                }
            }
        }
        // the other edges of the faces that are no more: equal to one that is left, or gone with their last face
        let dead = |ring: &&RingFace| [ring.x, ring.y].iter().any(|v| *v == kept || *v == removed);
        for ring in kept_ring.iter().chain(removed_ring).filter(dead) {
            for (n, e) in [(ring.x, ring.edge_x), (ring.y, ring.edge_y)] {
                if n != kept && n != removed && marks.get(n) != Some(e) {
                    self.retire(e, marks.get(n), effect);
                }
            }
        }
        self.close(star, first);
        if !self.pairs.is_empty() {
            self.merge_pairs(kept, removed, marks, effect);
        }
    }

    /// Takes an edge out, once; `into` is the edge that it has become equal to.
    fn retire(&mut self, edge: u32, into: Option<u32>, effect: &mut CollapseEffect) {
        if self.has_edge(edge) {
            self.ends[edge as usize] = [NONE; 2];
            effect.removed_edges.push(edge);
            effect.merged_edges.extend(into.map(|into| (edge, into)));
        }
    }

    /// The part of [`collapse`](Self::collapse) that concerns edges without faces.
    fn merge_pairs(&mut self, kept: u32, removed: u32, marks: &mut Marks, effect: &mut CollapseEffect) {
        let mut all = std::mem::take(&mut self.pairs[kept as usize]);
        all.append(&mut self.pairs[removed as usize]);
        all.retain(|&e| {
            let ends = &mut self.ends[e as usize];
            if ends[0] == NONE {
                return false;
            }
            let other = if ends[0] == kept || ends[0] == removed { ends[1] } else { ends[0] };
            let repeated = other == kept || other == removed || marks.get(other).is_some_and(|known| known != e);
            if repeated {
                *ends = [NONE; 2];
                effect.removed_edges.push(e);
                return false;
            }
            *ends = [kept, other];
            if marks.set(other, e).is_none() {
                effect.edges.push(e);
                effect.neighbors.push(other);
            }
            true
        });
        all.sort_unstable();
        all.dedup();
        self.pairs[kept as usize] = all;
    }

    /// Starts loading what [`ends`](Self::ends) needs.
    #[inline]
    pub(crate) fn prefetch_edge(&self, edge: u32) {
        prefetch(&self.ends, edge as usize);
    }

    /// Starts loading what [`point`](Self::point) needs, and where the faces around the vertex begin.
    #[inline]
    pub(crate) fn prefetch_vertex(&self, vertex: u32) {
        prefetch(&self.positions, vertex as usize);
        prefetch(&self.first_corner, vertex as usize);
    }

    /// Starts loading one of the faces around a vertex: the first, or the one after `step` others, whose predecessors
    /// should be there already.
    #[inline]
    pub(crate) fn prefetch_ring(&self, vertex: u32, step: usize) {
        let Some(&first) = self.first_corner.get(vertex as usize) else { return };
        let mut corner = first;
        for _ in 0..step {
            let Some(face) = self.faces.get((corner / 4) as usize) else { return };
            corner = face.next[(corner % 4) as usize];
        }
        prefetch(&self.faces, (corner / 4) as usize);
    }

    /// Whether an edge still exists.
    #[inline]
    pub fn has_edge(&self, edge: u32) -> bool {
        self.ends[edge as usize][0] != NONE
    }

    /// The positions as they are, those of vertices collapsed away among them.
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    /// The positions, those of vertices collapsed away among them.
    pub fn into_positions(self) -> Vec<[f32; 3]> {
        self.positions
    }
}

#[inline]
fn ring_face(f: u32, k: usize, face: &Face) -> RingFace {
    let (next, previous) = ((k + 1) % 3, (k + 2) % 3);
    RingFace {
        face: f,
        corner: k as u8,
        x: face.vertex[next],
        y: face.vertex[previous],
        edge_x: face.edge[previous],
        edge_y: face.edge[next],
    }
}
