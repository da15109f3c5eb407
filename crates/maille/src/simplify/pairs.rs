//! Vertices that are to be joined although no edge joins them (Garland and Heckbert 1997, 4.1).

use glam::DVec3;

/// All pairs of positions closer than a distance, each once, in rising order.
///
/// Sorts the positions into a grid of that spacing and looks at neighbouring cells: n log n as long as few positions
/// share a cell. At most 16 pairs are kept for each position, its nearest, so that a distance that is far too large
/// costs time but not memory. Of a cell that holds very many, only the first are looked at. Vertices of the same part are
/// not paired, if `parts` gives the part of each; around what is all of one part, nothing is looked at.
pub(super) fn close_pairs(positions: &[[f32; 3]], distance: f64, parts: Option<&[u32]>) -> Vec<[u32; 2]> {
    const MOST: usize = 16;
    const MOST_IN_CELL: usize = 4096;
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
        order[start..].iter().take_while(move |&&(cell, _)| cell == wanted).map(|&(_, w)| w).take(MOST_IN_CELL)
    };
    // how far the run of cells of one part goes on from each place of the order
    let same_part = |v: u32, w: u32| parts.is_some_and(|parts| parts[v as usize] == parts[w as usize]);
    let mut run_end = vec![order.len(); if parts.is_some() { order.len() } else { 0 }];
    for i in (0..run_end.len().saturating_sub(1)).rev() {
        run_end[i] = if same_part(order[i].1, order[i + 1].1) { run_end[i + 1] } else { i + 1 };
    }
    let is_all_of_part = |v: u32, wanted: [i64; 3]| {
        let start = order.partition_point(|&(cell, _)| cell < wanted);
        order.get(start).is_none_or(|&(cell, first)| {
            cell != wanted
                || same_part(v, first)
                    && run_end.get(start).is_some_and(|&end| order.get(end).is_none_or(|&(cell, _)| cell != wanted))
        })
    };
    let mut pairs = Vec::new();
    let mut near: Vec<(f64, u32)> = Vec::new();
    for &(home, v) in &order {
        near.clear();
        for offset in 0..27 {
            let step = [offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1];
            let wanted = [0, 1, 2].map(|k| home[k] + step[k]);
            if parts.is_some() && is_all_of_part(v, wanted) {
                continue;
            }
            let others = after(v, wanted).filter(|&w| !same_part(v, w));
            let close = others.map(|w| (point(v).distance_squared(point(w)), w));
            near.extend(close.filter(|&(d, _)| d <= distance * distance).take(64 * MOST));
        }
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        pairs.extend(near.iter().take(MOST).map(|&(_, w)| [v, w]));
    }
    pairs.sort_unstable();
    pairs
}
