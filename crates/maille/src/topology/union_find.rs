//! Disjoint sets of `u32` elements.

/// Disjoint sets whose name is their lowest element, whatever the order of the unions.
///
/// Path halving without ranks: O(log n) amortised, close to linear in practice, 4 bytes per element.
#[derive(Debug, Clone)]
pub(crate) struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// `count` sets of one element.
    pub(crate) fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// Sets given by a member for each element that is not above it.
    pub(crate) fn from_targets(parent: Vec<u32>) -> Self {
        debug_assert!(parent.iter().enumerate().all(|(i, &p)| p as usize <= i));
        Self { parent }
    }

    /// Lowest element of the set.
    pub(crate) fn find(&mut self, mut element: u32) -> u32 {
        while self.parent[element as usize] != element {
            let parent = self.parent[element as usize];
            self.parent[element as usize] = self.parent[parent as usize];
            element = parent;
        }
        element
    }

    /// Unites two sets; false if they were one already.
    pub(crate) fn union(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
        a != b
    }

    /// For each element the lowest of its set.
    pub(crate) fn into_roots(mut self) -> Vec<u32> {
        for i in 0..self.parent.len() {
            // parents are never above their children, so this one points to its root already
            self.parent[i] = self.parent[self.parent[i] as usize];
        }
        self.parent
    }
}
