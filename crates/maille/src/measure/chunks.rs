//! Parallel sums that do not depend on the number of threads.

use std::ops::Range;

use rayon::prelude::*;

/// Elements worked on in one go. Fixed, so that sums are always made of the same parts in the same order.
const CHUNK: usize = 4096;

/// What `work` makes of each chunk of `0..count`, in order.
pub(super) fn map_chunks<T: Send>(count: usize, work: impl Fn(Range<usize>) -> T + Sync) -> Vec<T> {
    let chunk = |i: usize| work(i * CHUNK..((i + 1) * CHUNK).min(count));
    (0..count.div_ceil(CHUNK)).into_par_iter().map(chunk).collect()
}

/// The sum of a value of each of `0..count`.
pub(super) fn sum(count: usize, value: impl Fn(usize) -> f64 + Sync) -> f64 {
    map_chunks(count, |range| range.map(&value).sum::<f64>()).into_iter().sum()
}
