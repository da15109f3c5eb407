//! Vertices that are to be joined although no edge joins them (Garland and Heckbert 1997, 4.1).

use glam::DVec3;

/// All pairs of positions closer than a distance, each once, in rising order.
///
/// Sorts the positions into a grid of that spacing and looks at neighbouring cells: n log n as long as few positions
/// share a cell. At most 16 pairs are kept for each position, its nearest, so that a distance that is far too large
/// costs time but not memory.
pub(super) fn close_pairs(positions: &[[f32; 3]], distance: f64) -> Vec<[u32; 2]> {
    const MOST: usize = 16;
    let point = |v: u32| glam::Vec3::from(positions[v as usize]).as_dvec3();
    let all = || (0..positions.len() as u32).map(point);
    let (low, high) = all().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    // much finer cells could not be numbered, and hold no fewer positions
    let spacing = distance.max((high - low).max_element() / f64::from(1 << 30)).max(f64::MIN_POSITIVE);
    let cell = |p: DVec3| ((p - low) / spacing).floor().to_array().map(|x| x as i64);
    let mut order: Vec<([i64; 3], u32)> = (0..positions.len() as u32).map(|v| (cell(point(v)), v)).collect();
    order.sort_unstable();
    let after = |v: u32, wanted: [i64; 3]| {
        let start = order.partition_point(|&entry| entry <= (wanted, v));
        order[start..].iter().take_while(move |&&(cell, _)| cell == wanted).map(|&(_, w)| w)
    };
    let mut pairs = Vec::new();
    let mut near: Vec<(f64, u32)> = Vec::new();
    for &(home, v) in &order {
        near.clear();
        for offset in 0..27 {
            let step = [offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1];
            let others = after(v, [0, 1, 2].map(|k| home[k] + step[k]));
            let close = others.map(|w| (point(v).distance_squared(point(w)), w));
            near.extend(close.filter(|&(d, _)| d <= distance * distance).take(64 * MOST));
        }
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        pairs.extend(near.iter().take(MOST).map(|&(_, w)| [v, w]));
    }
    pairs.sort_unstable();
    pairs
}
