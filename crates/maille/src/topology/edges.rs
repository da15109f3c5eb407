//! Pairing half-edges: which faces meet at each edge.

/// Corner after `c` in its face.
pub(crate) fn next(c: u32) -> u32 {
    if c % 3 == 2 { c - 2 } else { c + 1 }
}

/// Corner before `c` in its face.
pub(crate) fn prev(c: u32) -> u32 {
    if c.is_multiple_of(3) { c + 2 } else { c - 1 }
}

/// Whether a face names a vertex twice. Such a face has no edges worth the name and takes part in nothing.
pub(crate) fn is_degenerate(&[a, b, c]: &[u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// How the faces at an edge meet. Half-edges are named by the corner that they leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum EdgeKind {
    /// One face.
    Boundary,
    /// Two faces that run through the edge in opposite directions.
    Manifold(u32, u32),
    /// Two faces that run through the edge in the same direction.
    Inconsistent(u32, u32),
    /// Three faces or more.
    NonManifold,
}

/// Calls `visit` once for each edge, by lower then upper vertex, with its half-edges in ascending order.
///
/// Half-edges are dealt to their lower vertex by a counting sort, then each hand is sorted by the upper one: linear but
/// for the sorting of the hands, 24 bytes per face.
pub(crate) fn for_each_edge(faces: &[[u32; 3]], vertex_count: usize, mut visit: impl FnMut(EdgeKind, &[u32])) {
    let vertices = faces.as_flattened();
    let ends = |c: u32| (vertices[c as usize], vertices[next(c) as usize]);
    let half_edges = || {
        let proper = (0u32..).zip(faces).filter(|(_, face)| !is_degenerate(face));
        proper.flat_map(|(f, _)| 3 * f..3 * f + 3)
    };
    let hands = deal(
        vertex_count,
        || half_edges().map(|c| (ends(c).0.min(ends(c).1), c)),
        |c| u64::from(ends(c).0.max(ends(c).1)) << 32 | u64::from(c),
    );
    let (starts, mut cards) = hands;
    let mut corners = Vec::new();
    for v in 0..vertex_count {
        let hand = &mut cards[starts[v] as usize..starts[v + 1] as usize];
        hand.sort_unstable();
        for edge in hand.chunk_by(|a, b| a >> 32 == b >> 32) {
            corners.clear();
            corners.extend(edge.iter().map(|&card| card as u32));
            let kind = match corners[..] {
                [_] => EdgeKind::Boundary,
                [a, b] if ends(a) == ends(b) => EdgeKind::Inconsistent(a, b),
                [a, b] => EdgeKind::Manifold(a, b),
                _ => EdgeKind::NonManifold,
            };
            visit(kind, &corners);
        }
    }
}

/// Counting sort of items into `bins`: where each bin starts (one more entry than bins) and the items, as `card` maps
/// them, bin by bin in their order.
pub(crate) fn deal<I: Iterator<Item = (u32, u32)>, T: Copy + Default>(
    bins: usize,
    items: impl Fn() -> I,
    card: impl Fn(u32) -> T,
) -> (Vec<u32>, Vec<T>) {
    let mut starts = vec![0u32; bins + 1];
    for (bin, _) in items() {
        starts[bin as usize + 1] += 1;
    }
    for bin in 0..bins {
        starts[bin + 1] += starts[bin];
    }
    let mut cards = vec![T::default(); starts[bins] as usize];
    for (bin, item) in items() {
        cards[starts[bin as usize] as usize] = card(item);
        starts[bin as usize] += 1;
    }
    // every start has moved to its end, which is the start of the next bin
    starts.rotate_right(1);
    starts[0] = 0;
    (starts, cards)
}
