//! Wedges out of corners that name a vertex and, apart from it, attributes.

/// Finds the wedge of a vertex with certain attributes, or makes it. Numbers go by first appearance.
pub(crate) struct WedgeTable<K> {
    /// The newest wedge of each vertex.
    heads: Vec<u32>,
    /// Of each wedge: its attributes' key and the next older wedge of its vertex.
    wedges: Vec<(K, u32)>,
    vertices: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl<K: Copy + PartialEq> WedgeTable<K> {
    pub(crate) fn new(vertex_count: usize) -> Self {
        Self { heads: vec![NONE; vertex_count], wedges: Vec::new(), vertices: Vec::new() }
    }

    /// The wedge of a vertex (which must exist) with the key.
    pub(crate) fn wedge(&mut self, vertex: u32, key: K) -> u32 {
        let head = self.heads[vertex as usize];
        let mut at = head;
        while at != NONE {
            let (known, next) = self.wedges[at as usize];
            if known == key {
                return at;
            }
            at = next;
        }
        let new = self.wedges.len() as u32;
        self.wedges.push((key, head));
        self.vertices.push(vertex);
        self.heads[vertex as usize] = new;
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
}
