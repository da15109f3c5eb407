//! The faces around every vertex, one vertex after the other in memory, in parts that change independently.

use std::ops::Range;

use rayon::prelude::*;

/// A face (v, x, y) seen from its vertex v.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Spoke {
    /// Four times the face, plus which of its corners v is; [`NO_CORNER`] where faces are not followed.
    pub(crate) corner: u32,
    /// The vertex after v.
    pub(crate) x: u32,
    /// The vertex before v.
    pub(crate) y: u32,
}

/// The corner of faces that nobody follows.
pub(crate) const NO_CORNER: u32 = u32::MAX;

/// Where the fan of a vertex is.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    first: u32,
    /// Number of entries, and whether they are no ring but a [list](FansPart).
    len: u32,
}

impl Slot {
    const LIST: u32 = 1 << 31;

    #[inline]
    fn len(self) -> usize {
        (self.len & !Self::LIST) as usize
    }

    #[inline]
    fn range(self) -> Range<usize> {
        self.first as usize..self.first as usize + self.len()
    }

    #[inline]
    fn is_ring(self) -> bool {
        self.len & Self::LIST == 0
    }
}

/// How vertices are cut into parts: all of one size but the first, which may be smaller, and the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Cut {
    /// Vertices of the first part.
    first: usize,
    /// Vertices of every other one: two to this power.
    bits: u32,
}

impl Cut {
    /// All in one part.
    pub(crate) fn one(vertices: usize) -> Self {
        Self { first: vertices.max(1), bits: u32::BITS }
    }

    /// Parts of `1 << bits` vertices; if they are shifted, the first has half as many.
    pub(crate) fn new(bits: u32, is_shifted: bool) -> Self {
        Self { first: (1 << bits) / if is_shifted { 2 } else { 1 }, bits }
    }

    /// Vertices of every part but the first and the last.
    #[inline]
    fn size(self) -> usize {
        1 << self.bits
    }

    /// The ranges of so many vertices.
    fn ranges(self, vertices: usize) -> Vec<Range<usize>> {
        let starts = std::iter::once(0).chain((self.first..).step_by(self.size())).take_while(move |&v| v < vertices);
        starts.map(move |v| v..vertices.min(if v == 0 { self.first } else { v + self.size() })).collect()
    }

    #[inline]
    fn part_of(self, vertex: u32) -> usize {
        (vertex as usize + self.size() - self.first) >> self.bits
    }
}

/// All faces around all vertices.
#[derive(Debug)]
pub(crate) struct Fans {
    cut: Cut,
    pub(crate) parts: Vec<FansPart>,
}

/// The fans of a range of vertices.
///
/// Most are rings: the neighbours of a vertex in the order of the faces between them, which go once around it. An entry
/// stands for the face of its neighbour and the next one. All others are lists with two entries for each face.
#[derive(Debug)]
pub(crate) struct FansPart {
    /// The first vertex.
    pub(crate) start: u32,
    slots: Vec<Slot>,
    neighbors: Vec<u32>,
    /// Of each entry, the corner of its face; empty where faces are not followed.
    corners: Vec<u32>,
}

/// Faces around a vertex up to which they may be a ring.
pub(crate) const MOST_FACES: usize = 24;

/// The ring that two vertices of an edge will have when they are one.
#[derive(Debug)]
pub(crate) struct MergedRing {
    neighbors: [u32; Self::ROOM],
    corners: [u32; Self::ROOM],
    /// Number of neighbours.
    pub(crate) len: usize,
    /// So many faces are at the vertex that stays, the others at the one that goes.
    pub(crate) kept_faces: usize,
}

impl Default for MergedRing {
    fn default() -> Self {
        Self { neighbors: [0; Self::ROOM], corners: [NO_CORNER; Self::ROOM], len: 0, kept_faces: 0 }
    }
}

impl MergedRing {
    /// A power of two, so that no place is out of range.
    pub(crate) const ROOM: usize = (2 * MOST_FACES).next_power_of_two();

    /// The neighbours. The first and the one at [`kept_faces`](Self::kept_faces) are those of both vertices.
    #[inline]
    pub(crate) fn neighbors(&self) -> &[u32] {
        &self.neighbors[..self.len]
    }
}

impl FansPart {
    /// Number of vertices.
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    /// The vertices.
    pub(crate) fn vertices(&self) -> Range<u32> {
        self.start..self.start + self.slots.len() as u32
    }

    #[inline]
    fn slot(&self, vertex: u32) -> Slot {
        self.slots[(vertex - self.start) as usize]
    }

    /// The neighbours of a vertex in order, if faces go once around it.
    #[inline]
    pub(crate) fn ring(&self, vertex: u32) -> Option<&[u32]> {
        let slot = self.slot(vertex);
        slot.is_ring().then(|| &self.neighbors[slot.range()])
    }

    /// The faces around a vertex of the part.
    #[inline]
    pub(crate) fn around(&self, vertex: u32) -> impl Iterator<Item = Spoke> {
        let slot = self.slot(vertex);
        let entries = &self.neighbors[slot.range()];
        let corner = move |i: usize| self.corners.get(slot.first as usize + i).copied().unwrap_or(NO_CORNER);
        let step = if slot.is_ring() { 1 } else { 2 };
        (0..entries.len()).step_by(step).map(move |i| {
            let y = if i + 1 < entries.len() { entries[i + 1] } else { entries[0] };
            Spoke { corner: corner(i), x: entries[i], y }
        })
    }

    /// Number of faces around a vertex.
    #[inline]
    fn face_count(&self, slot: Slot) -> usize {
        if slot.is_ring() { slot.len() } else { slot.len() / 2 }
    }

    /// The ring that two neighbours will have when they are one; false if they have no rings, or not two faces in common.
    #[inline]
    pub(crate) fn merged_ring(&self, kept: u32, removed: u32, merged: &mut MergedRing) -> bool {
        let (kept_slot, removed_slot) = (self.slot(kept), self.slot(removed));
        let fits = |slot: Slot| slot.is_ring() && slot.len() <= MOST_FACES && slot.len() > 2;
        if !fits(kept_slot) || !fits(removed_slot) {
            return false;
        }
        let (k, r) = (&self.neighbors[kept_slot.range()], &self.neighbors[removed_slot.range()]);
        let place = |ring: &[u32], v: u32| ring.iter().position(|&w| w == v);
        let (Some(i), Some(j)) = (place(k, removed), place(r, kept)) else { return false };
        let (k_after, k_before) = (next(i, k.len()), if i == 0 { k.len() - 1 } else { i - 1 });
        let (r_after, r_before) = (next(j, r.len()), if j == 0 { r.len() - 1 } else { j - 1 });
        if k[k_after] != r[r_before] || k[k_before] != r[r_after] {
            return false;
        }
        let mut len = 0;
        // from the vertex after the edge all around to the one before it, then on around the other end
        for (slot, first, count) in [(kept_slot, k_after, k.len() - 2), (removed_slot, r_after, r.len() - 2)] {
            let ring = &self.neighbors[slot.range()];
            let mut n = first;
            for merged in &mut merged.neighbors[len..len + count] {
                *merged = ring[n];
                n = next(n, ring.len());
            }
            if let Some(corners) = self.corners.get(slot.range()) {
                let mut n = first;
                for merged in &mut merged.corners[len..len + count] {
                    *merged = corners[n];
                    n = next(n, ring.len());
                }
            }
            len += count;
        }
        (merged.len, merged.kept_faces) = (len, k.len() - 2);
        true
    }

    /// Makes `removed` and `kept` one, with the ring that was made for that; the faces at both are no more. All vertices
    /// around both must be in the part.
    #[inline]
    pub(crate) fn merge(&mut self, kept: u32, removed: u32, merged: &MergedRing) {
        let (kept_slot, removed_slot) = (self.slot(kept), self.slot(removed));
        let len = merged.len;
        for (i, &neighbor) in merged.neighbors().iter().enumerate() {
            if i == 0 || i == merged.kept_faces {
                self.drop_around(neighbor, removed, kept);
            } else if i > merged.kept_faces {
                self.rename_around(neighbor, removed, kept);
            }
        }
        let first = if len <= kept_slot.len() {
            kept_slot.first
        } else if len <= removed_slot.len() {
            removed_slot.first
        } else {
            let end = self.neighbors.len();
            self.neighbors.resize(end + len, 0);
            if !self.corners.is_empty() {
                self.corners.resize(end + len, NO_CORNER);
            }
            end as u32
        };
        let range = first as usize..first as usize + len;
        self.neighbors[range.clone()].copy_from_slice(merged.neighbors());
        if !self.corners.is_empty() {
            self.corners[range].copy_from_slice(&merged.corners[..len]);
        }
        self.slots[(kept - self.start) as usize] = Slot { first, len: len as u32 };
        self.slots[(removed - self.start) as usize].len = 0;
    }

    /// Gives a neighbour of a vertex its new name.
    #[inline]
    fn rename_around(&mut self, vertex: u32, old: u32, new: u32) {
        let range = self.slot(vertex).range();
        for neighbor in &mut self.neighbors[range] {
            *neighbor = if *neighbor == old { new } else { *neighbor };
        }
    }

    /// Takes a vertex out of the fan of a neighbour, which has a face with both `old` and `new`: another name for `old`
    /// in its other faces.
    #[inline]
    fn drop_around(&mut self, vertex: u32, old: u32, new: u32) {
        let slot = self.slot(vertex);
        if !slot.is_ring() {
            return self.drop_in_list(vertex, old, new);
        }
        let ring = &mut self.neighbors[slot.range()];
        let Some(place) = ring.iter().position(|&v| v == old) else { return };
        let is_before = ring[next(place, ring.len())] == new;
        for i in place + 1..ring.len() {
            ring[i - 1] = ring[i];
        }
        if !self.corners.is_empty() {
            let corners = &mut self.corners[slot.range()];
            // the face of both goes: that of `old` if it comes before `new`, else that of `new`
            if !is_before {
                corners[if place == 0 { corners.len() - 1 } else { place - 1 }] = corners[place];
            }
            corners.copy_within(place + 1.., place);
        }
        self.slots[(vertex - self.start) as usize].len -= 1;
    }

    #[cold]
    fn drop_in_list(&mut self, vertex: u32, old: u32, new: u32) {
        self.rename_around(vertex, old, new);
        let Slot { first, .. } = self.slot(vertex);
        let mut len = self.slot(vertex).len();
        let mut i = 0;
        while i < len {
            let (this, last) = (first as usize + i, first as usize + len - 2);
            if self.neighbors[this] != self.neighbors[this + 1] {
                i += 2;
                continue;
            }
            self.neighbors.copy_within(last..last + 2, this);
            if !self.corners.is_empty() {
                self.corners.copy_within(last..last + 2, this);
            }
            len -= 2;
        }
        self.slots[(vertex - self.start) as usize].len = len as u32 | Slot::LIST;
    }

    /// Vertices that have faces.
    fn live(&self) -> impl Iterator<Item = u32> {
        self.vertices().zip(&self.slots).filter(|(_, slot)| slot.len() > 0).map(|(v, _)| v)
    }

    /// The faces whose lowest vertex is in the part.
    fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        let lowest = |v: u32| self.around(v).filter(move |spoke| v < spoke.x && v < spoke.y);
        self.live().flat_map(move |v| lowest(v).map(move |spoke| [v, spoke.x, spoke.y]))
    }

    /// Takes over the fan of another vertex.
    fn push(&mut self, ring_or_list: Slot, neighbors: impl Iterator<Item = u32>, corners: &[u32]) {
        let first = self.neighbors.len() as u32;
        self.neighbors.extend(neighbors);
        self.corners.extend_from_slice(corners);
        self.slots.push(Slot { first, ..ring_or_list });
    }
}

#[inline]
fn next(i: usize, len: usize) -> usize {
    if i + 1 == len { 0 } else { i + 1 }
}

/// Puts the faces around a vertex into the order of a ring that begins at its lowest vertex, whatever order the faces
/// came in; false if they are none.
fn order_ring(fan: &mut [Spoke]) -> bool {
    if fan.len() > MOST_FACES || fan.len() < 3 {
        return false;
    }
    let lowest = (0..fan.len()).min_by_key(|&i| fan[i].x).unwrap_or(0);
    fan.swap(0, lowest);
    for i in 1..fan.len() {
        let wanted = fan[i - 1].y;
        let Some(found) = fan[i..].iter().position(|spoke| spoke.x == wanted) else { return false };
        fan.swap(i, i + found);
    }
    let is_twice = |i: usize| fan[..i].iter().any(|spoke| spoke.x == fan[i].x);
    fan[fan.len() - 1].y == fan[0].x && !(1..fan.len()).any(is_twice)
}

impl Fans {
    /// The fans of triangles; those that name a vertex twice are left out. `follow` tells whether their numbers are kept.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]], cut: Cut, follow: bool) -> Self {
        let ranges = cut.ranges(vertices);
        let whole = |[a, b, c]: [u32; 3]| a != b && b != c && c != a;
        // the triangles of each part: those with a corner in it
        let parts_of = |triangle: [u32; 3]| {
            let [a, b, c] = triangle.map(|v| cut.part_of(v));
            let count = if whole(triangle) { 1 + usize::from(b != a) + usize::from(c != a && c != b) } else { 0 };
            [a, if b != a { b } else { c }, c].into_iter().take(count)
        };
        let mut firsts = vec![0_usize; ranges.len() + 1];
        for part in triangles.iter().flat_map(|&triangle| parts_of(triangle)) {
            firsts[part + 1] += 1;
        }
        for i in 1..firsts.len() {
            firsts[i] += firsts[i - 1];
        }
        let mut members = vec![0_u32; firsts[ranges.len()]];
        let mut places = firsts.clone();
        for (face, &triangle) in triangles.iter().enumerate() {
            for part in parts_of(triangle) {
                members[places[part]] = face as u32;
                places[part] += 1;
            }
        }
        let part = |(i, range): (usize, Range<usize>)| {
            Self::new_part(range, &members[firsts[i]..firsts[i + 1]], triangles, follow)
        };
        Self { cut, parts: ranges.into_par_iter().enumerate().map(part).collect() }
    }

    fn new_part(range: Range<usize>, members: &[u32], triangles: &[[u32; 3]], follow: bool) -> FansPart {
        let place = |v: u32| (v as usize).wrapping_sub(range.start);
        let mut ends = vec![0_u32; range.len() + 1];
        let corners = || members.iter().flat_map(|&face| triangles[face as usize]).map(place);
        for v in corners().filter(|&v| v < range.len()) {
            ends[v + 1] += 1;
        }
        for i in 1..ends.len() {
            ends[i] += ends[i - 1];
        }
        let mut spokes = vec![Spoke::default(); ends[range.len()] as usize];
        for &face in members {
            let triangle = triangles[face as usize];
            for k in 0..3 {
                if let Some(end) = ends[..range.len()].get_mut(place(triangle[k])) {
                    let [x, y] = [triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
                    spokes[*end as usize] = Spoke { corner: face * 4 + k as u32, x, y };
                    *end += 1;
                }
            }
        }
        let room = spokes.len() + spokes.len() * 3 / 4;
        let mut part = FansPart {
            start: range.start as u32,
            slots: Vec::with_capacity(range.len()),
            neighbors: Vec::with_capacity(room),
            corners: Vec::with_capacity(if follow { room } else { 0 }),
        };
        let mut start = 0;
        for &end in &ends[..range.len()] {
            let fan = &mut spokes[start as usize..end as usize];
            start = end;
            let first = part.neighbors.len() as u32;
            let len = if fan.is_empty() {
                0
            } else if order_ring(fan) {
                part.neighbors.extend(fan.iter().map(|spoke| spoke.x));
                if follow {
                    part.corners.extend(fan.iter().map(|spoke| spoke.corner));
                }
                fan.len() as u32
            } else {
                fan.sort_unstable_by_key(|spoke| (spoke.x, spoke.y, spoke.corner));
                part.neighbors.extend(fan.iter().flat_map(|spoke| [spoke.x, spoke.y]));
                if follow {
                    part.corners.extend(fan.iter().flat_map(|spoke| [spoke.corner; 2]));
                }
                (2 * fan.len() as u32) | Slot::LIST
            };
            part.slots.push(Slot { first, len });
        }
        part
    }

    /// How the vertices are cut into parts.
    pub(crate) fn cut(&self) -> Cut {
        self.cut
    }

    fn part_of(&self, vertex: u32) -> &FansPart {
        &self.parts[self.cut.part_of(vertex)]
    }

    /// The faces around a vertex.
    pub(crate) fn around(&self, vertex: u32) -> impl Iterator<Item = Spoke> {
        self.part_of(vertex).around(vertex)
    }

    /// Number of faces.
    pub(crate) fn face_count(&self) -> usize {
        let count = |part: &FansPart| part.slots.iter().map(|&slot| part.face_count(slot)).sum::<usize>();
        self.parts.par_iter().map(count).sum::<usize>() / 3
    }

    /// The vertices that have faces, in their order.
    pub(crate) fn live(&self) -> Vec<u32> {
        self.parts.par_iter().flat_map_iter(FansPart::live).collect()
    }

    /// The same fans with new names: `vertices` are those that have faces, and get their places in it as names.
    pub(crate) fn renamed(&self, vertices: &[u32], cut: Cut) -> Self {
        let mut names = vec![u32::MAX; self.parts.iter().map(FansPart::len).sum()];
        for (new, &old) in (0..).zip(vertices) {
            names[old as usize] = new;
        }
        let part = |range: Range<usize>| {
            let olds = &vertices[range.clone()];
            let count: usize = olds.iter().map(|&v| self.part_of(v).slot(v).len()).sum();
            let follow = self.parts.iter().any(|part| !part.corners.is_empty());
            let room = count + count * 3 / 4;
            let mut new = FansPart {
                start: range.start as u32,
                slots: Vec::with_capacity(range.len()),
                neighbors: Vec::with_capacity(room),
                corners: Vec::with_capacity(if follow { room } else { 0 }),
            };
            for &v in olds {
                let old = self.part_of(v);
                let slot = old.slot(v);
                let neighbors = old.neighbors[slot.range()].iter().map(|&v| names[v as usize]);
                new.push(slot, neighbors, old.corners.get(slot.range()).unwrap_or_default());
            }
            new
        };
        Self { cut, parts: cut.ranges(vertices.len()).into_par_iter().map(part).collect() }
    }

    /// All faces, each at its lowest vertex.
    pub(crate) fn triangles(&self) -> Vec<[u32; 3]> {
        self.parts.par_iter().flat_map_iter(FansPart::triangles).collect()
    }

    /// Triangles by their numbers, where faces are followed, of vertices given by `name`; those that are no more name
    /// vertex 0 three times.
    pub(crate) fn followed(&self, count: usize, name: impl Fn(u32) -> u32) -> Vec<[u32; 3]> {
        let mut triangles = vec![[0; 3]; count];
        for (part, v) in self.parts.iter().flat_map(|part| part.live().map(move |v| (part, v))) {
            for spoke in part.around(v) {
                triangles[(spoke.corner / 4) as usize][(spoke.corner % 4) as usize] = name(v);
            }
        }
        triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    /// The faces around each vertex, in an order of their own.
    fn sorted(fans: &Fans, vertices: usize) -> Vec<Vec<Spoke>> {
        let around = |v| {
            let mut faces: Vec<Spoke> = fans.around(v).collect();
            faces.sort_unstable_by_key(|face| face.corner);
            faces
        };
        (0..vertices as u32).map(around).collect()
    }

    /// A surface with a border, a hole, and an edge of three faces.
    fn sheet() -> (usize, Vec<[u32; 3]>) {
        let mesh = shapes::grid(40);
        let mut triangles = mesh.triangles;
        triangles.swap_remove(700);
        triangles.push([500, 501, 3]);
        (mesh.positions.len(), triangles)
    }

    #[test]
    fn merging_is_building_anew_with_merged_names() {
        let torus = shapes::torus(2.0, 0.7, 90, 60);
        for (vertices, mut triangles) in [(torus.vertex_count(), torus.triangles), sheet()] {
            let cut = Cut::new(10, true);
            let mut fans = Fans::new(vertices, &triangles, cut, true);
            assert_eq!(fans.face_count(), triangles.len());
            assert_eq!(fans.followed(triangles.len(), |v| v), triangles);
            let mut ring = MergedRing::default();
            let mut merged = 0;
            for part in &mut fans.parts {
                for v in part.vertices().step_by(3) {
                    let Some(&x) = part.ring(v).and_then(|ring| ring.first()) else { continue };
                    let inside = |w: &u32| part.vertices().contains(w);
                    if !inside(&x) || !part.merged_ring(v, x, &mut ring) || !ring.neighbors().iter().all(inside) {
                        continue;
                    }
                    let mut around = ring.neighbors().to_vec();
                    around.sort_unstable();
                    if around.windows(2).any(|two| two[0] == two[1]) {
                        continue; // the ends have more neighbours in common
                    }
                    part.merge(v, x, &ring);
                    triangles.iter_mut().flatten().filter(|w| **w == x).for_each(|w| *w = v);
                    merged += 1;
                }
            }
            assert!(merged > 100, "{merged}");
            let again = Fans::new(vertices, &triangles, cut, true);
            assert_eq!(sorted(&fans, vertices), sorted(&again, vertices));
            assert_eq!(fans.face_count() * 3, sorted(&fans, vertices).iter().map(Vec::len).sum::<usize>());

            let live = fans.live();
            assert_eq!(live.len() + merged, vertices);
            let renamed = fans.renamed(&live, Cut::new(9, false));
            let old = |v: u32| live[v as usize];
            assert_eq!(renamed.followed(triangles.len(), old), fans.followed(triangles.len(), |v| v));
            let lowest_first = |mut triangle: [u32; 3]| {
                let lowest = (0..3).min_by_key(|&k| triangle[k]).unwrap_or(0);
                triangle.rotate_left(lowest);
                triangle
            };
            let all = |triangles: &[[u32; 3]]| {
                let whole = triangles.iter().filter(|[a, b, c]| a != b && b != c && c != a);
                let mut all: Vec<_> = whole.map(|&triangle| lowest_first(triangle)).collect();
                all.sort_unstable();
                all
            };
            assert_eq!(all(&renamed.triangles().iter().map(|t| t.map(old)).collect::<Vec<_>>()), all(&triangles));
        }
    }

    #[test]
    fn only_what_faces_go_once_around_is_a_ring() {
        let is_ring = |triangles: &[[u32; 3]]| {
            let fans = Fans::new(9, triangles, Cut::one(9), false);
            fans.parts[0].ring(0).is_some_and(|ring| !ring.is_empty())
        };
        let cone = [[0, 1, 2], [0, 2, 3], [0, 3, 1]];
        let other = [[0, 4, 5], [0, 5, 6], [0, 6, 4]];
        assert!(is_ring(&cone));
        assert!(!is_ring(&cone[..2]), "open");
        assert!(!is_ring(&[cone, other].concat()), "two cones");
        assert!(!is_ring(&[&cone[..], &cone[..]].concat()), "twice around");
        assert!(!is_ring(&[[0, 1, 2], [0, 2, 3], [0, 1, 3]]), "wound differently");
    }

    #[test]
    fn triangles_without_area_are_left_out() {
        let fans = Fans::new(4, &[[0, 1, 1], [1, 2, 3]], Cut::one(4), true);
        assert_eq!([fans.face_count(), fans.around(0).count(), fans.around(1).count()], [1, 0, 1]);
        assert_eq!(fans.followed(2, |v| v), [[0, 0, 0], [1, 2, 3]]);
    }
}
