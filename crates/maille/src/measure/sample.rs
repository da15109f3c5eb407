//! Points spread evenly over a surface.

use glam::DVec3;

use super::triangle::{at, scaled_normal};
use crate::Mesh;

/// Steps of the additive recurrence in the unit square: powers of 1/g with g^3 = g + 1, whose discrepancy is low for
/// every number of points (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018). The same with a third
/// power for the stratum was tried: its error in the square is two to three times as large.
const SQUARE_STEPS: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
/// The same in one dimension, for the place within the stratum: the golden section.
const STRATUM_STEP: f64 = 0.618_033_988_749_894_9;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceSample {
    /// The triangle it lies on.
    pub triangle: u32,
    /// Its weights at the triangle's corners, with sum 1.
    pub barycentric: [f64; 3],
    /// Where it is, in model units.
    pub point: DVec3,
}

/// Samples spread over a surface in proportion to its area.
///
/// The triangles are laid end to end, each as long as its area, and the whole is cut into as many equal strata as there
/// are samples; the place within the stratum and within the triangle follows a low-discrepancy sequence that the seed
/// shifts. So every sample can be had on its own, and sample follows sample in the order of the triangles given.
///
/// If no triangle has an area, all count the same. Cost: 12 bytes per triangle; a sample takes O(log n) time.
#[derive(Debug)]
pub struct SurfaceSampler<'m> {
    mesh: &'m Mesh,
    order: Vec<u32>,
    /// Area of the triangles up to and with each one, in `order`.
    areas: Vec<f64>,
    shift: [f64; 3],
}

impl<'m> SurfaceSampler<'m> {
    /// Prepares to sample the triangles named by `order`, whose corners must be finite.
    ///
    /// # Panics
    /// If a triangle named does not exist.
    pub fn new(mesh: &'m Mesh, order: impl IntoIterator<Item = u32>, seed: u64) -> Self {
        let order: Vec<u32> = order.into_iter().collect();
        let cumulated = |size: &dyn Fn(u32) -> f64| -> Vec<f64> {
            let add = |sum: &mut f64, &triangle: &u32| {
                *sum += size(triangle);
                Some(*sum)
            };
            order.iter().scan(0.0, add).collect()
        };
        let mut areas = cumulated(&|t| 0.5 * scaled_normal(mesh.triangle_points(t as usize)).length());
        if areas.last().is_some_and(|&total| total <= 0.0) {
            areas = cumulated(&|_| 1.0);
        }
        let shift = [1, 2, 3].map(|i| (hash(seed.wrapping_add(i)) >> 11) as f64 * (-53f64).exp2());
        Self { mesh, order, areas, shift }
    }

    /// The samples `range` of a set of `count`; none if there are no triangles.
    pub fn samples(&self, count: u64, range: std::ops::Range<u64>) -> impl Iterator<Item = SurfaceSample> + '_ {
        let total = self.areas.last().copied().unwrap_or(0.0);
        let range = if self.order.is_empty() { 0..0 } else { range };
        let mut place = None;
        range.map(move |i| {
            let [u, v] = [0, 1].map(|k| (self.shift[k] + i as f64 * SQUARE_STEPS[k]).fract());
            let jitter = (self.shift[2] + i as f64 * STRATUM_STEP).fract();
            let wanted = (i as f64 + jitter) / count as f64 * total;
            let mut at_place = place.unwrap_or_else(|| self.areas.partition_point(|&area| area <= wanted));
            while at_place + 1 < self.areas.len() && self.areas[at_place] <= wanted {
                at_place += 1;
            }
            // rounding may put the last one beyond the end
            let at_place = at_place.min(self.areas.len() - 1);
            place = Some(at_place);
            self.sample_on(self.order[at_place], u, v)
        })
    }

    /// The point of a triangle that a point of the unit square is folded onto.
    fn sample_on(&self, triangle: u32, u: f64, v: f64) -> SurfaceSample {
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let barycentric = [1.0 - u - v, u, v];
        let point = at(self.mesh.triangle_points(triangle as usize), barycentric);
        SurfaceSample { triangle, barycentric, point }
    }
}

/// Scrambles a number (the finaliser of splitmix64).
fn hash(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn all(mesh: &Mesh, count: u64, seed: u64) -> Vec<SurfaceSample> {
        let sampler = SurfaceSampler::new(mesh, 0..mesh.triangle_count() as u32, seed);
        sampler.samples(count, 0..count).collect()
    }

    #[test]
    fn triangles_get_samples_by_their_area() {
        let mesh = shapes::torus(3.0, 1.0, 40, 20);
        let area = |t: usize| 0.5 * scaled_normal(mesh.triangle_points(t)).length();
        let total: f64 = (0..mesh.triangle_count()).map(area).sum();
        let mut counts = vec![0.0; mesh.triangle_count()];
        for sample in all(&mesh, 100_000, 7) {
            counts[sample.triangle as usize] += 1.0;
        }
        for (t, count) in counts.iter().enumerate() {
            assert!((count - area(t) / total * 1e5).abs() <= 2.0, "triangle {t}: {count}");
        }
    }

    #[test]
    fn samples_cover_a_square_evenly() {
        // the mean of a smooth function over n samples is off by far less than the 1/sqrt(n) of random points
        let samples = all(&shapes::grid(1), 4096, 0);
        let mean = |f: &dyn Fn(DVec3) -> f64| samples.iter().map(|s| f(s.point)).sum::<f64>() / 4096.0;
        assert!((mean(&|p| p.x) - 0.5).abs() < 1e-3);
        assert!((mean(&|p| p.x * p.y) - 0.25).abs() < 1e-3);
        assert!((mean(&|p| p.y * p.y) - 1.0 / 3.0).abs() < 1e-3);
    }

    #[test]
    fn pieces_of_a_set_are_the_set() {
        let mesh = shapes::sphere(3);
        let sampler = SurfaceSampler::new(&mesh, (0..mesh.triangle_count() as u32).rev(), 1);
        let whole: Vec<_> = sampler.samples(1000, 0..1000).collect();
        let pieces: Vec<_> = (0..10).flat_map(|i| sampler.samples(1000, i * 100..(i + 1) * 100)).collect();
        assert_eq!(whole, pieces);
    }

    #[test]
    fn the_seed_moves_the_samples() {
        let mesh = shapes::cube();
        assert_ne!(all(&mesh, 10, 0), all(&mesh, 10, 1));
        assert_eq!(all(&mesh, 10, 1), all(&mesh, 10, 1));
    }

    #[test]
    fn no_area_and_no_triangles() {
        let mut line = shapes::tetrahedron();
        line.positions = (0..4).map(|i| [i as f32, 0.0, 0.0]).collect();
        let mut triangles: Vec<_> = all(&line, 8, 0).iter().map(|s| s.triangle).collect();
        triangles.dedup();
        assert_eq!(triangles, [0, 1, 2, 3]);
        assert!(all(&Mesh::default(), 8, 0).is_empty());
    }
}
