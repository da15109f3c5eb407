//! Which of many poses are worth looking at.

use glam::DVec3;

use crate::mesh::mix;

/// How many distances between points tell poses apart.
const PAIRS: u64 = 1024;
/// Least difference between poses that are told apart, as a share of the mean distance between points.
const ALIKE: f64 = 1e-3;

/// A few of many poses that stand for all (seed 000, 6.1.4: extreme poses).
///
/// Each next one is the pose most unlike those chosen so far (farthest-point choice, Gonzalez 1985), and counts as much as
/// all that are more like it than like the others. Poses are alike if some points of the surface are equally far from each
/// other in both: where the model stands and which way it faces does not matter.
///
/// # Examples
/// ```
/// use glam::DVec3;
/// let mut choice = maille::skin::PoseChoice::new(2);
/// for stretch in [1.0, 1.1, 3.0, 1.05] {
///     choice.add(&[DVec3::ZERO, DVec3::X * stretch], 1.0);
/// }
/// assert_eq!(choice.choose(2), [(1, 0.75), (2, 0.25)]);
/// ```
#[derive(Debug)]
pub struct PoseChoice {
    pairs: Vec<[u32; 2]>,
    /// To each pose, one after the other, the distance of each pair.
    looks: Vec<f64>,
    shares: Vec<f64>,
}

impl PoseChoice {
    /// Nothing to choose from yet; each pose will be told by so many points, of which some hundreds are enough.
    pub fn new(points: usize) -> Self {
        let place = |seed, i| (mix(seed, i) % points.max(1) as u64) as u32;
        let pairs = (0..PAIRS).map(|i| [place(1, i), place(2, i)]).filter(|[a, b]| a != b).collect();
        Self { pairs, looks: Vec::new(), shares: Vec::new() }
    }

    /// Adds a pose: where the points are in it, and how much it counts.
    ///
    /// # Panics
    /// If these are fewer points than were announced.
    pub fn add(&mut self, points: &[DVec3], share: f64) {
        self.looks.extend(self.pairs.iter().map(|pair| {
            let [a, b] = pair.map(|i| points[i as usize]);
            a.distance(b)
        }));
        self.shares.push(share);
    }

    /// The numbers of at most `most` poses that stand for all, in the order in which they were added, and how much each
    /// counts; the sum is 1. Fewer, if what is left is like those chosen, to a thousandth of the size of the model. The
    /// first choice is the pose nearest to the mean. Linear in the number of poses times `most`.
    pub fn choose(&self, most: usize) -> Vec<(usize, f64)> {
        let total: f64 = self.shares.iter().sum();
        if total <= 0.0 || most == 0 {
            return Vec::new();
        }
        let mut mean = vec![0.0; self.pairs.len()];
        for (i, share) in self.shares.iter().enumerate() {
            mean.iter_mut().zip(self.look(i)).for_each(|(mean, x)| *mean += share / total * x);
        }
        let size = mean.iter().sum::<f64>() / mean.len().max(1) as f64;
        let from_mean: Vec<f64> = (0..self.shares.len()).map(|i| distance(self.look(i), &mean)).collect();
        let mut chosen: Vec<usize> = Vec::new();
        let mut nearest = vec![(f64::INFINITY, 0); self.shares.len()];
        let counted = || (0..self.shares.len()).filter(|&i| self.shares[i] > 0.0);
        let mut next = counted().min_by(|&a, &b| from_mean[a].total_cmp(&from_mean[b]));
        while let Some(pose) = next.filter(|_| chosen.len() < most) {
            for i in counted() {
                let distance = distance(self.look(i), self.look(pose));
                if distance < nearest[i].0 {
                    nearest[i] = (distance, chosen.len());
                }
            }
            chosen.push(pose);
            let farthest = counted().max_by(|&a, &b| nearest[a].0.total_cmp(&nearest[b].0).then(b.cmp(&a)));
            next = farthest.filter(|&i| nearest[i].0 > ALIKE * size);
        }
        let mut counts = vec![0.0; chosen.len()];
        counted().for_each(|i| counts[nearest[i].1] += self.shares[i] / total);
        let mut all: Vec<(usize, f64)> = chosen.into_iter().zip(counts).collect();
        all.sort_by_key(|&(pose, _)| pose);
        all
    }

    fn look(&self, pose: usize) -> &[f64] {
        &self.looks[pose * self.pairs.len()..][..self.pairs.len()]
    }
}

/// Root of the mean squared difference.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len().max(1) as f64).sqrt()
}
