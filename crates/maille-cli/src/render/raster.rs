//! Which triangle is seen at each sample: a z-buffer with exact coverage.

use glam::Vec3;
use rayon::prelude::*;

/// No triangle.
pub(crate) const NOTHING: u32 = u32::MAX;
/// Subpixel bits: edges are compared in whole numbers, so that neighbours share every sample exactly once.
const SUBPIXEL: f32 = 256.0;
/// Beyond this many samples outside, points are pulled in, so that products of coordinates fit 64 bits.
const FAR_OUT: f32 = 1e6;
/// Rows that one task draws.
const BAND: usize = 32;

/// A triangle and its nearness for each sample.
pub(crate) struct Visible {
    pub(crate) width: usize,
    pub(crate) triangle: Vec<u32>,
    pub(crate) nearness: Vec<f32>,
}

/// Draws triangles over projected points (x, y in samples, y down; z grows towards the viewer).
pub(crate) fn visible(points: &[Vec3], triangles: &[[u32; 3]], width: usize, height: usize) -> Visible {
    let bands = height.div_ceil(BAND);
    let members = sorted_into_bands(points, triangles, width, height, bands);
    let mut result =
        Visible { width, triangle: vec![NOTHING; width * height], nearness: vec![f32::NEG_INFINITY; width * height] };
    let ids = result.triangle.par_chunks_mut(BAND * width);
    let nearness = result.nearness.par_chunks_mut(BAND * width);
    ids.zip(nearness).zip(&members).enumerate().for_each(|(band, ((ids, nearness), members))| {
        let mut target = Band { first_row: band * BAND, width, rows: ids.len() / width };
        for &t in members {
            let corners = triangles[t as usize].map(|v| points[v as usize]);
            target.cover(corners, |place, z| {
                // the first triangle wins a tie, whatever the order of the bands
                if z > nearness[place] {
                    (nearness[place], ids[place]) = (z, t);
                }
            });
        }
    });
    result
}

/// Nearness alone, drawn by one thread: for depth maps, which are made many at a time.
pub(crate) fn depth_map(points: &[Vec3], triangles: &[[u32; 3]], side: usize) -> Vec<f32> {
    let mut nearness = vec![f32::NEG_INFINITY; side * side];
    let mut target = Band { first_row: 0, width: side, rows: side };
    for triangle in triangles {
        let corners = triangle.map(|v| points[v as usize]);
        target.cover(corners, |place, z| nearness[place] = nearness[place].max(z));
    }
    nearness
}

fn sorted_into_bands(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    width: usize,
    height: usize,
    bands: usize,
) -> Vec<Vec<u32>> {
    let mut members = vec![Vec::new(); bands];
    for (t, triangle) in triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| points[v as usize]);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let outside = high.x < 0.0 || high.y < 0.0 || low.x > width as f32 || low.y > height as f32;
        if outside || !(a.is_finite() && b.is_finite() && c.is_finite()) {
            continue;
        }
        let last = (high.y as usize / BAND).min(bands - 1);
        for member in &mut members[low.y.max(0.0) as usize / BAND..=last] {
            member.push(t as u32);
        }
    }
    members
}

struct Band {
    first_row: usize,
    width: usize,
    rows: usize,
}

impl Band {
    /// Calls `hit` with the place in the band and the nearness of every sample that a triangle covers.
    fn cover(&mut self, corners: [Vec3; 3], mut hit: impl FnMut(usize, f32)) {
        let fixed = |x: f32| (x.clamp(-FAR_OUT, FAR_OUT) * SUBPIXEL).round() as i64;
        let mut corners = corners;
        let [a, b, c] = corners.map(|p| (fixed(p.x), fixed(p.y)));
        let area = (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        if area == 0 {
            return;
        }
        if area < 0 {
            corners.swap(1, 2);
        }
        let fixed_corners = corners.map(|p| (fixed(p.x), fixed(p.y)));
        let Some((columns, rows)) = self.samples_within(&fixed_corners) else { return };
        let edges = [0, 1, 2].map(|i| Edge::new(fixed_corners[(i + 1) % 3], fixed_corners[(i + 2) % 3]));
        let scale = 1.0 / area.abs() as f32;
        for row in rows {
            let y = center(self.first_row + row);
            for column in columns.clone() {
                let x = center(column);
                let [a, b, c] = [edges[0].side(x, y), edges[1].side(x, y), edges[2].side(x, y)];
                if edges[0].has_within(a) && edges[1].has_within(b) && edges[2].has_within(c) {
                    let z = (a as f32 * corners[0].z + b as f32 * corners[1].z + c as f32 * corners[2].z) * scale;
                    hit(row * self.width + column, z);
                }
            }
        }
    }

    /// Columns and rows (of the band) whose samples lie in the box around three points.
    fn samples_within(&self, points: &[(i64, i64); 3]) -> Option<(std::ops::Range<usize>, std::ops::Range<usize>)> {
        let range = |values: [i64; 3], offset: usize, count: usize| {
            let unit = SUBPIXEL as i64;
            let low = values.iter().min().copied().unwrap_or(0) - unit / 2 - offset as i64 * unit;
            let high = values.iter().max().copied().unwrap_or(0) - unit / 2 - offset as i64 * unit;
            let first = low.div_euclid(unit).clamp(0, count as i64) as usize;
            let end = (high.div_euclid(unit) + 1).clamp(0, count as i64) as usize;
            (first < end).then_some(first..end)
        };
        let columns = range(points.map(|p| p.0), 0, self.width)?;
        Some((columns, range(points.map(|p| p.1), self.first_row, self.rows)?))
    }
}

/// The centre of a sample in subpixels.
fn center(index: usize) -> i64 {
    index as i64 * SUBPIXEL as i64 + SUBPIXEL as i64 / 2
}

/// A directed edge with the triangle on its positive side.
struct Edge {
    from: (i64, i64),
    direction: (i64, i64),
    /// Of two triangles at an edge, the one where this holds owns the samples on it.
    owns_its_points: bool,
}

impl Edge {
    fn new(from: (i64, i64), to: (i64, i64)) -> Self {
        let direction = (to.0 - from.0, to.1 - from.1);
        let owns_its_points = direction.1 < 0 || (direction.1 == 0 && direction.0 > 0);
        Self { from, direction, owns_its_points }
    }

    /// Whether a point on this side belongs to the triangle.
    #[inline]
    fn has_within(&self, side: i64) -> bool {
        side > 0 || (side == 0 && self.owns_its_points)
    }

    #[inline]
    fn side(&self, x: i64, y: i64) -> i64 {
        self.direction.0 * (y - self.from.1) - self.direction.1 * (x - self.from.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_share_every_sample_exactly_once() {
        // a fan around a point that is a sample itself, edges through samples: the hardest case
        let center = Vec3::new(10.5, 10.5, 1.0);
        let around = [(2.5, 2.5), (18.5, 2.5), (18.5, 18.5), (2.5, 18.5), (2.5, 10.5)];
        let points: Vec<Vec3> = std::iter::once(center).chain(around.map(|(x, y)| Vec3::new(x, y, 1.0))).collect();
        let mut hits = vec![0; 400];
        for i in 0..5 {
            let corners = [points[0], points[1 + i], points[1 + (i + 1) % 5]];
            Band { first_row: 0, width: 20, rows: 20 }.cover(corners, |place, _| hits[place] += 1);
        }
        for (place, &n) in hits.iter().enumerate() {
            let (x, y) = (place % 20, place / 20);
            if (3..18).contains(&x) && (3..18).contains(&y) {
                assert_eq!(n, 1, "sample {x}, {y}");
            }
        }
    }

    #[test]
    fn the_nearer_triangle_is_seen() {
        let square = |z: f32| [(0.0, 0.0), (64.0, 0.0), (64.0, 64.0), (0.0, 64.0)].map(|(x, y)| Vec3::new(x, y, z));
        let points: Vec<Vec3> = square(1.0).into_iter().chain(square(2.0)).collect();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]];
        let seen = visible(&points, &triangles, 64, 64);
        assert!(seen.triangle.iter().all(|&t| t == 2 || t == 3));
        assert!(seen.nearness.iter().all(|&z| (z - 2.0).abs() < 1e-5));
    }
}
