//! Which wedge the corners of triangles have, through collapses.

use super::legality::Collapse;
use crate::topology::collapse_mesh::RingFace;

/// The wedges of the corners of triangles.
///
/// A vanishing face brings its wedge at the one end and its wedge at the other together: these become one, and with
/// them all wedges that hang on the same continuity. What no vanishing face joins stays apart:
///
/// ```text
///        x                    x            C0 = C1 and C2 = C3: smooth from the left
///      / | \                  |            face to the right one, so after the collapse
///    C0 C1  C2 C3    =>    C0 | C3         C0 and C3 are one wedge; otherwise the edge
///     a-----b                 v            from v to x becomes a seam
/// ```
#[derive(Debug, Clone, Default)]
pub(super) struct Corners {
    /// Triangles over wedges; `None` when each vertex has one wedge, of its own number.
    triangles: Option<Vec<[u32; 3]>>,
    groups: Groups,
}

/// Which wedges become one: a small union-find over the wedges of the vanishing faces.
#[derive(Debug, Clone, Default)]
struct Groups {
    /// (wedge of the kept vertex, wedge of the removed vertex) of each vanishing face.
    pairs: Vec<(u32, u32)>,
    /// All wedges of the pairs, sorted.
    wedges: Vec<u32>,
    /// For each of `wedges`, the place of one that it is equal to, nearer to the root.
    parent: Vec<u32>,
}

impl Groups {
    fn find(&self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            i = self.parent[i as usize];
        }
        i
    }

    fn place(&self, wedge: u32) -> Option<u32> {
        self.wedges.binary_search(&wedge).ok().map(|i| i as u32)
    }

    fn join(&mut self) {
        self.wedges.clear();
        self.wedges.extend(self.pairs.iter().flat_map(|&(a, b)| [a, b]));
        self.wedges.sort_unstable();
        self.wedges.dedup();
        self.parent.clear();
        self.parent.extend(0..self.wedges.len() as u32);
        for &(a, b) in &self.pairs {
            let root = |wedge| self.find(self.place(wedge).expect("all wedges of the pairs are listed"));
            let (a, b) = (root(a), root(b));
            self.parent[a.max(b) as usize] = a.min(b);
        }
    }
}

impl Corners {
    /// The corners of a mesh. `triangles` are over wedges, `wedge_vertices` tells the vertex of each wedge.
    pub(super) fn new(triangles: Vec<[u32; 3]>, wedge_vertices: &[u32]) -> Self {
        let plain = wedge_vertices.iter().enumerate().all(|(w, &v)| w == v as usize);
        Self { triangles: (!plain).then_some(triangles), groups: Groups::default() }
    }

    /// Whether each vertex has one wedge, of its own number.
    #[inline]
    pub(super) fn are_plain(&self) -> bool {
        self.triangles.is_none()
    }

    /// The wedges of a triangle, whose vertices are given.
    #[inline]
    pub(super) fn of(&self, triangle: usize, vertices: [u32; 3]) -> [u32; 3] {
        self.triangles.as_ref().map_or(vertices, |triangles| triangles[triangle])
    }

    /// The wedge of the corner of a face that lies at a vertex.
    #[inline]
    pub(super) fn at(&self, face: &RingFace, vertex: u32) -> u32 {
        self.triangles.as_ref().map_or(vertex, |triangles| triangles[face.face as usize][face.corner as usize])
    }

    /// The wedges of the two other corners of a face, x and y.
    #[inline]
    pub(super) fn opposite(&self, face: &RingFace) -> [u32; 2] {
        let corner = face.corner as usize;
        match &self.triangles {
            None => [face.x, face.y],
            Some(triangles) => {
                let wedges = triangles[face.face as usize];
                [wedges[(corner + 1) % 3], wedges[(corner + 2) % 3]]
            }
        }
    }

    /// A collapse is about to be made: the corners that stay name the wedges that theirs become.
    pub(super) fn merge(&mut self, collapse: &Collapse<'_>) {
        let groups = &mut self.groups;
        let star = &collapse.star;
        groups.pairs.clear();
        let Some(triangles) = &mut self.triangles else {
            groups.pairs.push((star.kept, star.removed));
            return;
        };
        for face in star.kept_ring.iter().filter(|face| star.kills(face)) {
            let other = if face.x == star.removed { face.corner + 1 } else { face.corner + 2 } % 3;
            let wedges = triangles[face.face as usize];
            groups.pairs.push((wedges[face.corner as usize], wedges[other as usize]));
        }
        groups.join();
        for face in star.kept_ring.iter().chain(star.removed_ring).filter(|face| !star.kills(face)) {
            let wedge = &mut triangles[face.face as usize][face.corner as usize];
            if let Some(place) = groups.place(*wedge) {
                *wedge = groups.wedges[groups.find(place) as usize];
            }
        }
    }

    /// The wedges of the kept and the removed vertex in each face that the last collapse took away.
    pub(super) fn pairs(&self) -> &[(u32, u32)] {
        &self.groups.pairs
    }

    /// What a wedge of one of the [`pairs`](Self::pairs) has become; `None` for a wedge of none of them.
    pub(super) fn merged(&self, wedge: u32) -> Option<u32> {
        if self.are_plain() {
            let &(kept, removed) = self.groups.pairs.first()?;
            return (wedge == kept || wedge == removed).then_some(kept);
        }
        self.groups.place(wedge).map(|i| self.groups.wedges[self.groups.find(i) as usize])
    }
}
