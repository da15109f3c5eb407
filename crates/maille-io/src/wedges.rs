//! Wedges out of corners that name a vertex and, apart from it, attributes.

use std::collections::HashMap;
use std::hash::Hash;

/// Finds the wedge of a vertex with certain attributes, or makes it. Numbers go by first appearance.
pub(crate) struct WedgeTable<K> {
    /// The first wedges of each vertex, as a chain: nearly all vertices have but few.
    heads: Vec<u32>,
    /// Of each wedge: its attributes' key and the next wedge of the chain.
    wedges: Vec<(K, u32)>,
    vertices: Vec<u32>,
    /// Wedges of vertices whose chain is full; only looked up, so that its order does not matter.
    crowd: HashMap<(u32, K), u32>,
}

const NONE: u32 = u32::MAX;
/// Longest chain.
const CHAIN: usize = 32;

impl<K: Copy + Eq + Hash> WedgeTable<K> {
    pub(crate) fn new(vertex_count: usize) -> Self {
        Self { heads: vec![NONE; vertex_count], wedges: Vec::new(), vertices: Vec::new(), crowd: HashMap::new() }
    }

    /// The wedge of a vertex (which must exist) with the key.
    pub(crate) fn wedge(&mut self, vertex: u32, key: K) -> u32 {
        let head = self.heads[vertex as usize];
        let (mut at, mut steps) = (head, 0);
        while at != NONE {
            let (known, next) = self.wedges[at as usize];
            if known == key {
                return at;
            }
            (at, steps) = (next, steps + 1);
        }
        let new = self.wedges.len() as u32;
        if steps < CHAIN {
            self.heads[vertex as usize] = new;
        } else if let Some(&known) = self.crowd.get(&(vertex, key)) {
            return known;
        } else {
            self.crowd.insert((vertex, key), new);
        }
        self.wedges.push((key, head));
        self.vertices.push(vertex);
        new
    }

    /// The keys of all wedges.
    pub(crate) fn keys(&self) -> impl ExactSizeIterator<Item = K> {
        self.wedges.iter().map(|&(key, _)| key)
    }

    /// The vertex of each wedge.
    pub(crate) fn into_vertices(self) -> Vec<u32> {
        self.vertices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_keys_share_a_wedge_only_at_the_same_vertex() {
        let mut table = WedgeTable::new(3);
        let found = [(2, 'a'), (0, 'a'), (2, 'b'), (2, 'a'), (0, 'a')].map(|(v, key)| table.wedge(v, key));
        assert_eq!(found, [0, 1, 2, 0, 1]);
        assert_eq!(table.keys().collect::<String>(), "aab");
        assert_eq!(table.into_vertices(), [2, 0, 2]);
    }

    #[test]
    fn crowded_vertices_find_all_their_wedges_again() {
        let mut table = WedgeTable::new(1);
        for _ in 0..2 {
            for key in 0..500_u32 {
                assert_eq!(table.wedge(0, key), key);
            }
        }
        assert_eq!(table.keys().len(), 500);
    }
}
