//! The priority queue of collapses.
//!
//! The theses keep edges in a binary heap with the position of each edge beside it (seed 000, 4.2.1; seed 001, 4.3.3).
//! That was measured first: on a million edges and more, most of the time goes into cache misses on the way down the
//! heap and in the table of positions. This queue gives the same order and the same updates in constant amortised
//! time plus sorting: entries wait unsorted in buckets of similar cost, and only the bucket that is due gets sorted.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::options::Order;
use crate::prefetch::prefetch;
use crate::radix::sort_by_bits;

/// Cost of an edge that is not in the queue; no cost has these bits.
const ABSENT: u32 = u32::MAX;

/// Bits of an `f32` cost below those that choose its bucket: 8 bits of exponent and 1 of mantissa, so that the costs in
/// a bucket differ by a factor of 1.5 at most.
const BUCKET_SHIFT: u32 = 22;

/// Edges below which order by space gains no time: all that they need is in the cache.
const FEW: usize = 1 << 15;

/// Edges in order of cost, lowest first; any edge may be added, changed or removed at any time. In [`Order::Exact`] ties
/// go by the lower edge; in [`Order::Spatial`] so do all costs of a bucket as long as there are many edges, and what
/// comes for the due bucket while it is worked on waits for its next round.
///
/// Costs are non-negative `f32`, whose bits sort like the numbers. An entry packs a cost above its edge into 64 bits.
/// What an edge costs now is kept beside; entries that say something else are out of date and skipped when they come
/// up. When more entries are out of date than not, all are made anew.
///
/// ```text
///   due: sorted, taken from its end      late, next: what came for the due bucket or an earlier one
///   buckets: [ . ][ . ][due][ ### ][ # ][ ######## ]...   by the upper bits of the cost
/// ```
#[derive(Debug, Default)]
pub(super) struct Queue {
    /// Bits of the cost of each edge, or [`ABSENT`].
    costs: Vec<u32>,
    buckets: Vec<Vec<u64>>,
    /// The bucket in `due`; those before it are empty.
    current: usize,
    due: Vec<u64>,
    /// In exact order.
    late: BinaryHeap<Reverse<u64>>,
    /// In spatial order.
    next: Vec<u64>,
    /// For sorting.
    scratch: Vec<u64>,
    order: Order,
    /// Number of edges in the queue below which the order is exact in any case.
    few: usize,
    /// Number of entries, those out of date among them.
    entries: usize,
    /// Number of edges in the queue.
    live: usize,
}

fn bits_of(cost: f64) -> u32 {
    // negative costs are rounding noise; NaN comes last
    let cost = if cost > 0.0 {
        cost as f32
    } else if cost.is_nan() {
        f32::INFINITY
    } else {
        0.0
    };
    cost.to_bits()
}

fn entry(bits: u32, edge: u32) -> u64 {
    u64::from(bits) << 32 | u64::from(edge)
}

fn bucket(bits: u32) -> usize {
    (bits >> BUCKET_SHIFT) as usize
}

impl Queue {
    /// A queue of the edges 0, 1, ...: one cost each, `None` to leave the edge out. Linear.
    pub(super) fn new(costs: impl Iterator<Item = Option<f64>>, order: Order) -> Self {
        let costs = costs.map(|c| c.map_or(ABSENT, bits_of)).collect();
        let mut queue = Self { costs, order, few: FEW, ..Self::default() };
        queue.rebuild();
        queue
    }

    /// Fills the buckets from the costs.
    fn rebuild(&mut self) {
        let count = bucket(f32::INFINITY.to_bits()) + 1;
        let mut sizes = vec![0; count];
        for &bits in self.costs.iter().filter(|&&bits| bits != ABSENT) {
            sizes[bucket(bits)] += 1;
        }
        self.buckets = sizes.iter().map(|&size| Vec::with_capacity(size)).collect();
        for (edge, bits) in self.costs.iter().copied().enumerate().filter(|&(_, bits)| bits != ABSENT) {
            self.buckets[bucket(bits)].push(entry(bits, edge as u32));
        }
        self.due.clear();
        self.late.clear();
        self.next.clear();
        self.current = 0;
        self.live = sizes.iter().sum();
        self.entries = self.live;
        self.advance();
    }

    /// Makes the lowest bucket that holds something the due one, once the due one is used up.
    fn advance(&mut self) {
        while self.due.is_empty() && self.late.is_empty() {
            if !self.next.is_empty() {
                std::mem::swap(&mut self.due, &mut self.next);
            } else if self.current < self.buckets.len() {
                self.due = std::mem::take(&mut self.buckets[self.current]);
                self.current += 1;
            } else {
                return;
            }
            if self.is_exact() {
                self.due.sort_unstable_by_key(|&entry| Reverse(entry));
            } else {
                sort_by_bits(&mut self.due, 0, &mut self.scratch);
                self.due.reverse();
            }
        }
    }

    /// Whether costs decide alone at present.
    fn is_exact(&self) -> bool {
        self.order == Order::Exact || self.live < self.few
    }

    /// The first entry, out of date or not.
    fn first(&self) -> Option<u64> {
        match (self.due.last(), self.late.peek()) {
            (Some(&due), Some(&Reverse(late))) => Some(due.min(late)),
            (due, late) => due.copied().or(late.map(|late| late.0)),
        }
    }

    fn drop_first(&mut self) {
        match (self.due.last(), self.late.peek()) {
            (Some(due), late) if late.is_none_or(|late| *due < late.0) => self.due.pop(),
            _ => self.late.pop().map(|late| late.0),
        };
        self.entries -= 1;
        self.advance();
    }

    /// The edge that is first in order, and its cost as stored (rounded to `f32`).
    pub(super) fn peek(&mut self) -> Option<(u32, f64)> {
        loop {
            let first = self.first()?;
            let (bits, edge) = ((first >> 32) as u32, first as u32);
            if self.costs[edge as usize] == bits {
                return Some((edge, f64::from(f32::from_bits(bits))));
            }
            self.drop_first();
        }
    }

    /// The edge of the entry that will come up after `ahead` others if nothing changes, as far as that is known. It may
    /// be out of date.
    #[inline]
    pub(super) fn upcoming(&self, ahead: usize) -> Option<u32> {
        self.due.len().checked_sub(ahead + 1).map(|i| self.due[i] as u32)
    }

    /// As [`upcoming`](Self::upcoming), with the cost as stored; `None` when the entry is out of date.
    #[inline]
    pub(super) fn upcoming_cost(&self, ahead: usize) -> Option<(u32, f64)> {
        let entry = self.due[self.due.len().checked_sub(ahead + 1)?];
        let (bits, edge) = ((entry >> 32) as u32, entry as u32);
        (self.costs[edge as usize] == bits).then(|| (edge, f64::from(f32::from_bits(bits))))
    }

    /// Starts loading what [`peek`](Self::peek) needs to know about an edge.
    #[inline]
    pub(super) fn prefetch(&self, edge: u32) {
        prefetch(&self.costs, edge as usize);
    }

    /// Whether an edge is in the queue.
    pub(super) fn contains(&self, edge: u32) -> bool {
        self.costs[edge as usize] != ABSENT
    }

    /// Gives an edge a cost, whether it is in the queue or not.
    pub(super) fn set(&mut self, edge: u32, cost: f64) {
        let bits = bits_of(cost);
        let before = std::mem::replace(&mut self.costs[edge as usize], bits);
        if before == bits {
            return;
        }
        self.live += usize::from(before == ABSENT);
        self.entries += 1;
        if bucket(bits) < self.current {
            if self.is_exact() {
                self.late.push(Reverse(entry(bits, edge)));
            } else {
                self.next.push(entry(bits, edge));
            }
        } else {
            self.buckets[bucket(bits)].push(entry(bits, edge));
        }
        // what is due may have been used up by removals only
        if self.first().is_none() {
            self.advance();
        }
        if self.entries > 3 * self.live + 1024 {
            self.rebuild();
        }
    }

    /// Takes an edge out; nothing happens when it is not in.
    pub(super) fn remove(&mut self, edge: u32) {
        let before = std::mem::replace(&mut self.costs[edge as usize], ABSENT);
        self.live -= usize::from(before != ABSENT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The slow version: a list that is searched each time.
    #[derive(Default)]
    struct Naive(Vec<(u32, f64)>);

    impl Naive {
        fn remove(&mut self, edge: u32) {
            self.0.retain(|&(e, _)| e != edge);
        }
        fn peek(&self) -> Option<(u32, f64)> {
            self.0.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
        }
    }

    proptest! {
        #[test]
        fn agrees_with_a_searched_list(
            start in prop::collection::vec(prop::option::of(0u8..9), 0..40),
            edits in prop::collection::vec((0usize..40, prop::option::of(0u8..9)), 0..200),
        ) {
            let mut queue = Queue::new(start.iter().map(|c| c.map(f64::from)), Order::Exact);
            let with_cost = |(edge, cost): (usize, &Option<u8>)| cost.map(|cost| (edge as u32, f64::from(cost)));
            let mut naive = Naive(start.iter().enumerate().filter_map(with_cost).collect());
            for (edge, cost) in edits.into_iter().filter(|&(edge, _)| edge < start.len()) {
                naive.remove(edge as u32);
                match cost {
                    Some(cost) => {
                        queue.set(edge as u32, f64::from(cost));
                        naive.0.push((edge as u32, f64::from(cost)));
                    }
                    None => queue.remove(edge as u32),
                }
                prop_assert_eq!(queue.peek(), naive.peek());
                prop_assert_eq!(queue.contains(edge as u32), cost.is_some());
            }
            while let Some((edge, cost)) = queue.peek() {
                prop_assert_eq!(Some((edge, cost)), naive.peek());
                queue.remove(edge);
                naive.remove(edge);
            }
            prop_assert!(naive.0.is_empty());
        }
    }

    #[test]
    fn spatial_order_goes_by_edge_among_similar_costs() {
        let mut queue = Queue::new([9.0, 1.3, 1.0, 2.0, 1.05].map(Some).into_iter(), Order::Spatial);
        queue.few = 0;
        queue.rebuild();
        let mut order = vec![];
        while let Some((edge, _)) = queue.peek() {
            order.push(edge);
            queue.remove(edge);
            if edge == 1 {
                queue.set(0, 1.0); // late for this round of the bucket, early for the next bucket
            }
        }
        assert_eq!(order, [1, 2, 4, 0, 3]);
    }

    #[test]
    fn costs_that_are_no_numbers_come_last() {
        let mut queue = Queue::new([Some(f64::NAN), Some(1e30), Some(-1e-20)].into_iter(), Order::Exact);
        assert_eq!(queue.peek(), Some((2, 0.0)));
        let mut order = vec![];
        while let Some((edge, _)) = queue.peek() {
            order.push(edge);
            queue.remove(edge);
        }
        assert_eq!(order, [2, 1, 0]);
    }
}
