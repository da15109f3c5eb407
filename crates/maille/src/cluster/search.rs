//! The search for a grid: counts grow about with the square of the cells along a side, and not quite steadily.

/// Most counts; a bracket that closes by bisection has closed by then.
const PASSES: u32 = 24;
/// Counts after which the search bisects, whatever the power law says.
const GUIDED: u32 = 8;
/// How far apart the ends of a bracket are, relatively, when it is no use to go on.
const CLOSED: f64 = 1e-5;

/// What a search found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    /// Cells along the largest extent.
    pub(super) cells: f64,
    /// What they leave: not more than what was wanted, unless everything tried that leaves anything leaves more.
    pub(super) count: usize,
}

/// A search for the most cells that leave no more than a number of triangles.
pub(super) struct Search {
    pub(super) wanted: usize,
    /// Where to begin.
    pub(super) guess: f64,
    /// Fewest and most cells.
    pub(super) within: (f64, f64),
    /// The share of what is wanted that is good enough.
    pub(super) near: f64,
}

impl Search {
    /// Counts, time and again.
    pub(super) fn run(&self, mut count: impl FnMut(f64) -> usize) -> Found {
        let wanted = self.wanted as f64;
        // between what is good enough and what is too much
        let goal = wanted * (1.0 + self.near) / 2.0;
        let (fewest, most) = self.within;
        let (mut under, mut over): (Option<Found>, Option<Found>) = (None, None);
        let mut cells = self.guess.clamp(fewest.max(0.5).min(most), most);
        for pass in 0..PASSES {
            let last = Found { cells, count: count(cells) };
            if last.count <= self.wanted {
                under = Some(last);
                if last.count as f64 >= wanted * self.near || cells >= most {
                    break;
                }
            } else {
                over = Some(last);
                if cells <= fewest {
                    break;
                }
            }
            cells = match (under, over) {
                (Some(low), Some(high)) if high.cells < low.cells * (1.0 + CLOSED) => break,
                (Some(low), Some(high)) if pass >= GUIDED || low.count == 0 => (low.cells * high.cells).sqrt(),
                (Some(low), Some(high)) => {
                    // where the power law through both meets the goal, a little inside
                    let step = high.cells / low.cells;
                    let share = (goal / low.count as f64).ln() / (high.count as f64 / low.count as f64).ln();
                    low.cells * step.powf(share.clamp(0.02, 0.98))
                }
                _ => last.cells * (goal / last.count.max(1) as f64).sqrt().clamp(0.25, 4.0),
            };
            cells = cells.clamp(fewest, most);
            if cells < 1e-3 {
                break;
            }
        }
        // rather too many than none
        let some = under.filter(|found| found.count > 0 || self.wanted == 0);
        some.or(over).or(under).expect("something was counted")
    }
}
