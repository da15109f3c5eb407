//! The priority queue of collapses: an addressable heap (seed 000, 4.2.1; seed 001, 4.3.3).

const NONE: u32 = u32::MAX;

/// Children per node. Four share half a cache line, and the heap is half as deep as a binary one.
const ARITY: usize = 4;

/// Edges in order of cost, lowest first; ties by the lower edge.
///
/// An entry packs the cost (a non-negative `f32`, whose bits sort like the number) above the edge into 64 bits, so
/// that one comparison orders by both and the order does not depend on history. The position of each edge in the heap
/// is stored: raising, lowering and removing any edge costs O(log n).
#[derive(Debug, Default)]
pub(super) struct Queue {
    heap: Vec<u64>,
    position: Vec<u32>,
}

fn entry(cost: f64, edge: u32) -> u64 {
    // negative costs are rounding noise; NaN sorts last
    let cost = if cost > 0.0 {
        cost as f32
    } else if cost.is_nan() {
        f32::INFINITY
    } else {
        0.0
    };
    u64::from(cost.to_bits()) << 32 | u64::from(edge)
}

fn edge_of(entry: u64) -> u32 {
    entry as u32
}

fn cost_of(entry: u64) -> f64 {
    f64::from(f32::from_bits((entry >> 32) as u32))
}

impl Queue {
    /// A queue of the edges 0, 1, ...: one cost each, `None` to leave the edge out. Linear.
    pub(super) fn new(costs: impl ExactSizeIterator<Item = Option<f64>>) -> Self {
        let mut queue = Self { heap: Vec::with_capacity(costs.len()), position: vec![NONE; costs.len()] };
        for (edge, cost) in costs.enumerate() {
            queue.heap.extend(cost.map(|cost| entry(cost, edge as u32)));
        }
        for (i, &e) in queue.heap.iter().enumerate() {
            queue.position[edge_of(e) as usize] = i as u32;
        }
        for i in (0..queue.heap.len().div_ceil(ARITY)).rev() {
            queue.sift_down(i);
        }
        queue
    }

    /// The edge of least cost, and its cost as stored (rounded to `f32`).
    pub(super) fn peek(&self) -> Option<(u32, f64)> {
        self.heap.first().map(|&e| (edge_of(e), cost_of(e)))
    }

    /// Whether an edge is in the queue.
    pub(super) fn contains(&self, edge: u32) -> bool {
        self.position[edge as usize] != NONE
    }

    /// Gives an edge a cost, whether it is in the queue or not.
    pub(super) fn set(&mut self, edge: u32, cost: f64) {
        let new = entry(cost, edge);
        let mut i = self.position[edge as usize] as usize;
        if i == NONE as usize {
            i = self.heap.len();
            self.heap.push(new);
            self.sift_up(i);
        } else if new < self.heap[i] {
            self.heap[i] = new;
            self.sift_up(i);
        } else {
            self.heap[i] = new;
            self.sift_down(i);
        }
    }

    /// Takes an edge out; nothing happens when it is not in.
    pub(super) fn remove(&mut self, edge: u32) {
        let i = std::mem::replace(&mut self.position[edge as usize], NONE) as usize;
        if i == NONE as usize {
            return;
        }
        let last = self.heap.pop().expect("an edge with a position is in the heap");
        if i < self.heap.len() {
            let before = std::mem::replace(&mut self.heap[i], last);
            if last < before { self.sift_up(i) } else { self.sift_down(i) }
        }
    }

    fn place(&mut self, i: usize, entry: u64) {
        self.heap[i] = entry;
        self.position[edge_of(entry) as usize] = i as u32;
    }

    fn sift_up(&mut self, mut i: usize) {
        let moving = self.heap[i];
        while i > 0 {
            let parent = (i - 1) / ARITY;
            if self.heap[parent] <= moving {
                break;
            }
            self.place(i, self.heap[parent]);
            i = parent;
        }
        self.place(i, moving);
    }

    fn sift_down(&mut self, mut i: usize) {
        let moving = self.heap[i];
        loop {
            let first = i * ARITY + 1;
            let children = self.heap.get(first..(first + ARITY).min(self.heap.len())).unwrap_or(&[]);
            let Some((least, &child)) = children.iter().enumerate().min_by_key(|&(_, &child)| child) else { break };
            if moving <= child {
                break;
            }
            self.place(i, child);
            i = first + least;
        }
        self.place(i, moving);
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
            let mut queue = Queue::new(start.iter().map(|c| c.map(f64::from)));
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
    fn costs_that_are_no_numbers_come_last() {
        let queue = Queue::new([Some(f64::NAN), Some(1e30), Some(-1e-20)].into_iter());
        assert_eq!(queue.peek(), Some((2, 0.0)));
        let mut order = vec![];
        let mut queue = queue;
        while let Some((edge, _)) = queue.peek() {
            order.push(edge);
            queue.remove(edge);
        }
        assert_eq!(order, [2, 1, 0]);
    }
}
