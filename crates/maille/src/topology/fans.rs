//! The faces around every vertex, one vertex after the other in memory.

use rayon::prelude::*;

/// No vertex.
const NONE: u32 = u32::MAX;

/// Vertices whose fans are one piece of memory: two to this power.
const PIECE_BITS: u32 = 11;

/// Vertices whose fans are one piece of memory.
pub(crate) const PIECE: usize = 1 << PIECE_BITS;

/// A face (v, x, y) seen from its vertex v.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Spoke {
    /// Four times the face, plus which of its corners v is.
    pub(crate) corner: u32,
    /// The vertex after v.
    pub(crate) x: u32,
    /// The vertex before v.
    pub(crate) y: u32,
    /// What the edge from v to x costs; if one of them has taken in another since that was found out, below zero; zero
    /// when it is not known.
    pub(crate) cost: f32,
}

/// All faces around all vertices: fast to walk, costly to change, so that many changes are made at once.
#[derive(Debug, Default)]
pub(crate) struct Fans {
    pub(crate) pieces: Vec<Piece>,
}

/// The fans of [`PIECE`] vertices, in the last piece fewer.
#[derive(Debug, Default)]
pub(crate) struct Piece {
    /// Of each vertex the place of its first spoke, and one more.
    first: Vec<u32>,
    spokes: Vec<Spoke>,
}

/// Fans of neighbouring pieces.
#[derive(Debug)]
pub(crate) struct FansPart<'a> {
    /// The first vertex.
    pub(crate) start: u32,
    pub(crate) pieces: &'a mut [Piece],
}

/// Pairs of vertices that become one: each vertex has at most one partner, and the lower of both stays.
#[derive(Debug)]
pub(crate) struct Pairing(Vec<u32>);

/// A part of a [`Pairing`].
#[derive(Debug)]
pub(crate) struct PairingPart<'a> {
    /// The first vertex.
    pub(crate) start: u32,
    pub(crate) partners: &'a mut [u32],
}

impl Pairing {
    /// No pairs yet.
    pub(crate) fn new(vertices: usize) -> Self {
        Self(vec![NONE; vertices])
    }

    /// Forgets all pairs.
    pub(crate) fn clear(&mut self) {
        self.0.fill(NONE);
    }

    /// The partners of all vertices.
    pub(crate) fn partners_mut(&mut self) -> &mut [u32] {
        &mut self.0
    }
}

impl PairingPart<'_> {
    /// Whether a vertex has a partner.
    #[inline]
    pub(crate) fn is_taken(&self, vertex: u32) -> bool {
        self.partners[(vertex - self.start) as usize] != NONE
    }

    /// What a vertex is now.
    #[inline]
    pub(crate) fn now(&self, vertex: u32) -> u32 {
        vertex.min(self.partners[(vertex - self.start) as usize])
    }

    /// Makes two vertices one.
    #[inline]
    pub(crate) fn pair(&mut self, [a, b]: [u32; 2]) {
        self.partners[(a - self.start) as usize] = b;
        self.partners[(b - self.start) as usize] = a;
    }
}

impl Piece {
    pub(crate) fn spokes(&self) -> &[Spoke] {
        &self.spokes
    }

    #[inline]
    fn around(&self, place: usize) -> &[Spoke] {
        &self.spokes[self.first[place] as usize..self.first[place + 1] as usize]
    }
}

impl FansPart<'_> {
    /// The faces around a vertex of the part.
    #[inline]
    pub(crate) fn around(&self, vertex: u32) -> &[Spoke] {
        let place = (vertex - self.start) as usize;
        self.pieces[place >> PIECE_BITS].around(place & (PIECE - 1))
    }

    /// Edges whose known cost is not above a bound, or not known: the lower end, and the number of its spoke.
    pub(crate) fn edges_up_to(&self, most: f32) -> Vec<(u32, usize)> {
        let mut edges = Vec::new();
        for (piece, start) in self.pieces.iter().zip((self.start..).step_by(PIECE)) {
            for (bounds, v) in piece.first.windows(2).zip(start..) {
                for (i, spoke) in piece.spokes[bounds[0] as usize..bounds[1] as usize].iter().enumerate() {
                    if spoke.x > v && spoke.cost.abs() <= most {
                        edges.push((v, i));
                    }
                }
            }
        }
        edges
    }

    /// The faces around a vertex of the part.
    #[inline]
    pub(crate) fn around_mut(&mut self, vertex: u32) -> &mut [Spoke] {
        let place = (vertex - self.start) as usize;
        let Piece { first, spokes } = &mut self.pieces[place >> PIECE_BITS];
        let place = place & (PIECE - 1);
        &mut spokes[first[place] as usize..first[place + 1] as usize]
    }
}

impl Fans {
    /// The fans of triangles; those that name a vertex twice are left out. Spokes are in the order of the triangles.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let whole = |&(_, [a, b, c]): &(usize, [u32; 3])| a != b && b != c && c != a;
        let triangles = triangles.iter().copied().enumerate().filter(whole);
        let mut counts = vec![0_u32; vertices];
        for v in triangles.clone().flat_map(|(_, triangle)| triangle) {
            counts[v as usize] += 1;
        }
        let piece = |counts: &mut [u32]| {
            // from counts to starts
            let mut end = 0;
            for count in &mut *counts {
                end += std::mem::replace(count, end);
            }
            let first = counts.iter().copied().chain([end]).collect();
            Piece { first, spokes: vec![Spoke::default(); end as usize] }
        };
        let mut pieces: Vec<Piece> = counts.par_chunks_mut(PIECE).map(piece).collect();
        let mut next = counts;
        for (face, triangle) in triangles {
            for k in 0..3 {
                let v = triangle[k] as usize;
                let [x, y] = [triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
                let spoke = Spoke { corner: (face * 4 + k) as u32, x, y, cost: 0.0 };
                pieces[v >> PIECE_BITS].spokes[next[v] as usize] = spoke;
                next[v] += 1;
            }
        }
        Self { pieces }
    }

    /// The faces around a vertex.
    #[inline]
    pub(crate) fn around(&self, vertex: u32) -> &[Spoke] {
        self.pieces[vertex as usize >> PIECE_BITS].around(vertex as usize & (PIECE - 1))
    }

    /// Number of faces.
    pub(crate) fn face_count(&self) -> usize {
        self.pieces.iter().map(|piece| piece.spokes.len()).sum::<usize>() / 3
    }

    /// Triangles by their numbers; those that are no more name vertex 0 three times.
    pub(crate) fn triangles(&self, count: usize) -> Vec<[u32; 3]> {
        let mut triangles = vec![[0; 3]; count];
        for (piece, v) in self.pieces.iter().zip((0..).step_by(PIECE)) {
            for (place, v) in (0..piece.first.len() - 1).zip(v..) {
                for spoke in piece.around(place) {
                    triangles[(spoke.corner / 4) as usize][(spoke.corner % 4) as usize] = v;
                }
            }
        }
        triangles
    }

    /// The fans after pairs of vertices have become one: faces at both are no more.
    pub(crate) fn merged(&self, pairing: &Pairing) -> Self {
        let piece = |(i, piece): (usize, &Piece)| self.merged_piece(piece, (i * PIECE) as u32, pairing);
        Self { pieces: self.pieces.par_iter().enumerate().map(piece).collect() }
    }

    fn merged_piece(&self, piece: &Piece, start: u32, pairing: &Pairing) -> Piece {
        let partners = pairing.0.as_slice();
        let now = |vertex: u32| vertex.min(partners[vertex as usize]);
        let mut spokes = vec![Spoke::default(); piece.spokes.len() + piece.spokes.len() / 4];
        let mut first = Vec::with_capacity(piece.first.len());
        let mut count = 0;
        for (place, v) in (0..piece.first.len() - 1).zip(start..) {
            first.push(count as u32);
            let partner = partners[v as usize];
            if partner < v {
                continue;
            }
            let mut add = |around: &[Spoke]| {
                if spokes.len() < count + around.len() {
                    spokes.resize(2 * (count + around.len()), Spoke::default());
                }
                let places = &mut spokes[count..count + around.len()];
                let mut n = 0;
                for spoke in around {
                    let (x, y) = (now(spoke.x), now(spoke.y));
                    let is_old = (partner != NONE) | (partners[spoke.x as usize] != NONE);
                    places[n] = Spoke { x, y, cost: if is_old { -spoke.cost.abs() } else { spoke.cost }, ..*spoke };
                    // without a branch: which faces stay is hard to predict
                    n += usize::from((x != y) & (x != v) & (y != v));
                }
                count += n;
            };
            add(piece.around(place));
            if partner != NONE {
                add(self.around(partner));
            }
        }
        first.push(count as u32);
        Piece { first, spokes: spokes[..count].to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn sorted(fans: &Fans, vertices: u32) -> Vec<Vec<[u32; 3]>> {
        let around = |v| {
            let mut faces: Vec<_> = fans.around(v).iter().map(|face| [face.corner, face.x, face.y]).collect();
            faces.sort_unstable();
            faces
        };
        (0..vertices).map(around).collect()
    }

    #[test]
    fn merging_is_building_anew_with_merged_names() {
        let mesh = shapes::torus(2.0, 0.7, 90, 60); // in several pieces
        let (vertices, mut triangles) = (mesh.vertex_count() as u32, mesh.triangles.clone());
        let fans = Fans::new(vertices as usize, &triangles);
        assert_eq!(fans.face_count(), triangles.len());
        assert_eq!(fans.triangles(triangles.len()), triangles);
        let mut pairing = Pairing::new(vertices as usize);
        let mut part = PairingPart { start: 0, partners: pairing.partners_mut() };
        for &[a, b, _] in triangles.iter().step_by(7) {
            if !part.is_taken(a) && !part.is_taken(b) {
                part.pair([a, b]);
            }
        }
        triangles.iter_mut().flatten().for_each(|v| *v = part.now(*v));
        let merged = fans.merged(&pairing);
        assert_eq!(sorted(&merged, vertices), sorted(&Fans::new(vertices as usize, &triangles), vertices));
        assert!(merged.face_count() < fans.face_count());
    }

    #[test]
    fn triangles_without_area_are_left_out() {
        let fans = Fans::new(4, &[[0, 1, 1], [1, 2, 3]]);
        assert_eq!((fans.face_count(), fans.around(0).len(), fans.around(1).len()), (1, 0, 1));
        assert_eq!(fans.triangles(2), [[0, 0, 0], [1, 2, 3]]);
    }
}
