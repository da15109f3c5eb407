//! The faces around an edge that is about to collapse.

use super::collapse_mesh::RingFace;

/// The faces around both ends of an edge: `removed` is to merge into `kept`.
#[derive(Debug, Clone, Copy)]
pub struct EdgeStar<'a> {
    /// The edge.
    pub edge: u32,
    /// The vertex that stays, by name.
    pub kept: u32,
    /// The vertex that goes.
    pub removed: u32,
    /// Faces around `kept` before.
    pub kept_ring: &'a [RingFace],
    /// Faces around `removed` before.
    pub removed_ring: &'a [RingFace],
    is_regular: bool,
}

impl<'a> EdgeStar<'a> {
    /// The star of an edge from the rings of its ends: what [`CollapseMesh::ring`](super::CollapseMesh::ring) gives.
    #[inline]
    pub fn new(
        edge: u32,
        [kept, removed]: [u32; 2],
        kept_ring: &'a [RingFace],
        removed_ring: &'a [RingFace],
    ) -> EdgeStar<'a> {
        let is_regular = is_regular(removed, kept_ring, removed_ring);
        EdgeStar { edge, kept, removed, kept_ring, removed_ring, is_regular }
    }

    /// The star of an edge whose ends are known to have faces all around them, wound alike. The edge has no number.
    #[inline]
    pub(crate) fn on_closed_surface(
        [kept, removed]: [u32; 2],
        kept_ring: &'a [RingFace],
        removed_ring: &'a [RingFace],
    ) -> EdgeStar<'a> {
        let is_regular = kept_ring.len() <= MOST
            && removed_ring.len() <= MOST
            && kept_ring.len() + removed_ring.len() > 6
            && Around::of(kept_ring).count(&Around::of(removed_ring)) == 2;
        EdgeStar { edge: u32::MAX, kept, removed, kept_ring, removed_ring, is_regular }
    }

    /// Whether a face around one end is at the other end, too, and vanishes.
    #[inline]
    pub fn kills(&self, face: &RingFace) -> bool {
        let both = [self.kept, self.removed];
        both.contains(&face.x) || both.contains(&face.y)
    }

    /// Whether the surface goes all around both ends with faces wound alike, and the ends have but two neighbours in
    /// common, the two that the vanishing faces join to the edge, without a face of their own at either end.
    ///
    /// That is the link condition where it matters, and what nearly every edge of a scan is like; tests and collapse
    /// have a short way for it. `false` says nothing: rings of more than 24 faces are not looked at.
    #[inline]
    pub fn is_regular(&self) -> bool {
        self.is_regular
    }
}

/// Faces around an end up to which [`EdgeStar::is_regular`] looks.
pub(crate) const MOST: usize = 24;

fn is_regular(removed: u32, kept_ring: &[RingFace], removed_ring: &[RingFace]) -> bool {
    let closed = |ring: &[RingFace]| Around::closed(ring.iter().map(|face| [face.x, face.y]));
    let (Some(around_kept), Some(around_removed)) = (closed(kept_ring), closed(removed_ring)) else {
        return false;
    };
    let mut apexes = [u32::MAX; 2];
    let mut dying = 0;
    for face in kept_ring {
        // selected without branches: which faces vanish is hard to predict
        let (before, after) = (face.y == removed, face.x == removed);
        apexes[0] = if after { face.y } else { apexes[0] };
        apexes[1] = if before { face.x } else { apexes[1] };
        dying += u32::from(before) + u32::from(after);
    }
    let is_apex = |v: u32| (v == apexes[0]) | (v == apexes[1]);
    let joins_apexes = kept_ring.iter().fold(false, |any, face| any | (is_apex(face.x) & is_apex(face.y)));
    // the apexes are neighbours of both
    dying == 2 && apexes[0] != apexes[1] && !joins_apexes && around_kept.count(&around_removed) == 2
}

/// The neighbours of a vertex, each once.
pub(crate) struct Around {
    vertices: [u32; MOST],
    len: usize,
}

impl Around {
    /// The vertex after the middle of each of at most [`MOST`] faces.
    #[inline]
    fn of(ring: &[RingFace]) -> Self {
        let mut around = Self { vertices: [u32::MAX; MOST], len: ring.len() };
        for (vertex, face) in around.vertices.iter_mut().zip(ring) {
            *vertex = face.x;
        }
        around
    }

    /// These, at most [`MOST`].
    #[inline]
    pub(crate) fn of_ring(ring: &[u32]) -> Self {
        let mut around = Self { vertices: [u32::MAX; MOST], len: ring.len() };
        for (vertex, &v) in around.vertices.iter_mut().zip(ring) {
            *vertex = v;
        }
        around
    }

    /// The neighbours of a vertex that faces go all around, wound alike; `None` when that is not so, when there are more
    /// than [`MOST`], or when an edge has more than two faces. Faces are given by the vertices after and before theirs.
    #[inline]
    pub(crate) fn closed(faces: impl ExactSizeIterator<Item = [u32; 2]>) -> Option<Self> {
        if faces.len() > MOST {
            return None;
        }
        let mut around = Self { vertices: [u32::MAX; MOST], len: faces.len() };
        let mut open = 0_u64;
        for (vertex, [x, y]) in around.vertices.iter_mut().zip(faces) {
            *vertex = x;
            // zero in the end where every neighbour comes as often after a face's vertex as before it
            open = open.wrapping_add(mixed(x)).wrapping_sub(mixed(y));
        }
        (open == 0 && around.count(&around) == around.len as u32).then_some(around)
    }

    /// How many pairs of equal vertices there are in two lists. Compared eight at a time without branches.
    #[inline]
    pub(crate) fn count(&self, other: &Self) -> u32 {
        let mut equal = [0; 8];
        for &v in &other.vertices[..other.len] {
            for eight in self.vertices.as_chunks::<8>().0.iter().take(self.len.div_ceil(8)) {
                for (equal, &w) in equal.iter_mut().zip(eight) {
                    *equal += u32::from(v == w);
                }
            }
        }
        equal.iter().sum()
    }
}

/// Spreads a number over 64 bits, so that sums of different numbers differ.
#[inline]
fn mixed(v: u32) -> u64 {
    let product = (u64::from(v) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (product ^ product >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93)
}
