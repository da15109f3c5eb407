//! Whether a piece of a surface lies over triangles of another one that are near enough: the last and sharpest of the
//! bounds of [`exact`](super::exact).

use glam::{DVec2, DVec3};

use super::triangle::{OnTriangle, at, closest_on_triangle};

/// Most corners of a polygon that is left over.
const CORNERS: usize = 12;
/// Most polygons that are left over at a time.
const PIECES: usize = 24;

/// Memory for the polygons that are left over, before and after a triangle has covered some of them.
#[derive(Debug, Default)]
pub(super) struct Leftovers {
    now: Vec<Polygon>,
    next: Vec<Polygon>,
}

/// A convex polygon in the plane, wound counterclockwise.
#[derive(Debug, Clone, Copy)]
struct Polygon {
    points: [DVec2; CORNERS],
    len: usize,
}

impl Polygon {
    const EMPTY: Self = Self { points: [DVec2::ZERO; CORNERS], len: 0 };

    fn points(&self) -> &[DVec2] {
        &self.points[..self.len]
    }

    fn push(&mut self, p: DVec2) -> Option<()> {
        *self.points.get_mut(self.len)? = p;
        self.len += 1;
        Some(())
    }

    fn is_beside(&self, line: &Line) -> bool {
        self.points().iter().all(|&p| line.side(p) < 0.0)
    }

    /// Cuts along a line: what is on its positive side, and on it, stays; what is on the negative one goes to `beyond`, if
    /// that is wanted. `None` when a polygon gets too many corners.
    fn cut(&mut self, line: &Line, mut beyond: Option<&mut Self>) -> Option<()> {
        let mut values = [0.0; CORNERS];
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for (value, &p) in values.iter_mut().zip(&self.points[..self.len]) {
            *value = line.side(p);
            (low, high) = (low.min(*value), high.max(*value));
        }
        if let Some(beyond) = &mut beyond {
            beyond.len = 0;
        }
        if low >= 0.0 {
            return Some(());
        }
        if high < 0.0 {
            if let Some(beyond) = beyond {
                *beyond = *self;
            }
            self.len = 0;
            return Some(());
        }
        let (points, len) = (self.points, self.len);
        self.len = 0;
        for i in 0..len {
            let next = if i + 1 == len { 0 } else { i + 1 };
            let (here, there) = (values[i], values[next]);
            if here >= 0.0 {
                self.push(points[i])?;
            } else if let Some(beyond) = &mut beyond {
                beyond.push(points[i])?;
            }
            if (here < 0.0) != (there < 0.0) {
                let cut = points[i].lerp(points[next], here / (here - there));
                self.push(cut)?;
                if let Some(beyond) = &mut beyond {
                    beyond.push(cut)?;
                }
            }
        }
        Some(())
    }
}

/// A line in the plane: points on its left are on its positive side.
#[derive(Debug, Clone, Copy)]
struct Line {
    /// Unit normal, to the left.
    normal: DVec2,
    offset: f64,
}

impl Line {
    fn side(&self, p: DVec2) -> f64 {
        self.normal.dot(p) + self.offset
    }
}

fn bounds(points: &[DVec2]) -> (DVec2, DVec2) {
    points.iter().fold((DVec2::MAX, DVec2::MIN), |(low, high), &p| (low.min(p), high.max(p)))
}

/// Distance of a point from a triangle, never too small: that of a point of it, whichever was found.
pub(super) fn distance_above(p: DVec3, corners: [DVec3; 3]) -> f64 {
    let (weights, _): OnTriangle = closest_on_triangle(p, corners);
    p.distance(at(corners, weights))
}

/// The largest distance of a triangle from others, bounded from above by `most`, if that can be shown: every part of it
/// lies over (along its normal, or beside by at most `margin`) a triangle from which that part is at most so far.
///
/// The distance from one triangle is a convex function, so that the corners of a part tell. What is covered is cut away
/// from the piece; nothing must be left. The margin keeps rounding from leaving slivers between neighbours.
pub(super) fn covered(
    piece: [DVec3; 3],
    others: impl Iterator<Item = [DVec3; 3]>,
    most: f64,
    margin: f64,
    Leftovers { now, next }: &mut Leftovers,
) -> Option<f64> {
    let origin = piece[0];
    let [along, across] = [piece[1] - origin, piece[2] - origin];
    let normal = along.cross(across).try_normalize()?;
    let x = along.try_normalize()?;
    let y = normal.cross(x);
    let flat = |p: DVec3| DVec2::new((p - origin).dot(x), (p - origin).dot(y));
    let lifted = |p: DVec2| origin + x * p.x + y * p.y;
    let mut whole = Polygon::EMPTY;
    piece.iter().for_each(|&p| whole.push(flat(p)).expect("three corners fit"));
    let whole_box = bounds(whole.points());
    now.clear();
    now.push(whole);
    let mut bound = 0.0_f64;
    for other in others {
        let mut shadow = other.map(flat);
        let (low, high) = bounds(&shadow);
        if (low - margin).cmpgt(whole_box.1).any() || (high + margin).cmplt(whole_box.0).any() {
            continue;
        }
        let area = (shadow[1] - shadow[0]).perp_dot(shadow[2] - shadow[0]);
        if area < 0.0 {
            shadow.swap(1, 2);
        }
        let directions = [0, 1, 2].map(|k| (shadow[(k + 1) % 3] - shadow[k]).normalize_or_zero());
        if area == 0.0 || directions.contains(&DVec2::ZERO) {
            continue;
        }
        // so that the region grows by no more than the margin at its sharpest corner, too
        let half_sine = |k: usize| ((1.0 + directions[k].dot(directions[(k + 1) % 3])) * 0.5).max(0.0).sqrt();
        let margin = margin * half_sine(0).min(half_sine(1)).min(half_sine(2));
        let lines = [0, 1, 2].map(|k| {
            let normal = directions[k].perp();
            Line { normal, offset: margin - normal.dot(shadow[k]) }
        });
        if lines.iter().any(|line| whole.is_beside(line)) {
            continue;
        }
        let mut over = whole;
        for line in &lines {
            over.cut(line, None)?;
        }
        let distance = |&p: &DVec2| distance_above(lifted(p), other);
        let farthest = over.points().iter().map(distance).fold(0.0, f64::max);
        if over.len == 0 || farthest > most {
            continue;
        }
        bound = bound.max(farthest);
        next.clear();
        for polygon in now.iter() {
            // whole where it is beside the triangle: cutting it would only make more of it
            if lines.iter().any(|line| polygon.is_beside(line)) {
                next.push(*polygon);
                continue;
            }
            let mut rest = *polygon;
            for line in &lines {
                let mut beyond = Polygon::EMPTY;
                rest.cut(line, Some(&mut beyond))?;
                if beyond.len > 0 {
                    next.push(beyond);
                }
            }
        }
        std::mem::swap(now, next);
        if now.is_empty() {
            return Some(bound);
        }
        if now.len() > PIECES {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(points: [[f64; 3]; 3]) -> [DVec3; 3] {
        points.map(DVec3::from)
    }

    #[test]
    fn a_triangle_over_a_fan_is_as_far_as_the_farthest_corner_of_the_overlay() {
        let piece = triangle([[0.1, 0.1, 0.5], [0.9, 0.2, 0.5], [0.4, 0.8, 0.5]]);
        let middle = [0.5, 0.5, 0.0];
        let ring = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let fan: Vec<_> = (0..4).map(|i| triangle([middle, ring[i], ring[(i + 1) % 4]])).collect();
        let covered = |piece, others: &[[DVec3; 3]], most| {
            covered(piece, others.iter().copied(), most, 1e-9, &mut Leftovers::default())
        };
        let bound = covered(piece, &fan, 0.6).expect("the fan covers it");
        assert!((bound - 0.5).abs() < 1e-9, "{bound}");
        assert!(covered(piece, &fan, 0.4).is_none(), "too far");
        assert!(covered(piece, &fan[..3], 0.6).is_none(), "a quarter is missing");
    }

    #[test]
    fn what_stands_upright_or_has_no_area_covers_nothing() {
        let piece = triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let wall = triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        let mut left = Leftovers::default();
        assert!(covered(piece, [wall].into_iter(), 10.0, 0.0, &mut left).is_none());
        assert!(covered(wall.map(|p| p * DVec3::X), [piece].into_iter(), 10.0, 0.1, &mut left).is_none());
    }
}
