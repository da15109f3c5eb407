//! The largest distance between two surfaces, proven: branch and bound over the triangles of one of them.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::DVec3;
use rayon::prelude::*;

use super::bvh::{Bvh, Searcher};
use super::chunks::map_chunks;
use super::compare::{CompareError, Side, Watch, check};
use super::cover::{Leftovers, covered, distance_above};
use crate::control::Cancelled;
use crate::{Control, Mesh};

/// How to look for the largest distance.
#[derive(Debug, Clone, PartialEq)]
pub struct ExactOptions {
    /// Width of the proven interval, as a share of the diagonal of the box around A. Below some 1e-12 it is limited by the
    /// rounding of `f64`.
    pub tolerance: f64,
    /// Most pieces of triangles that wait at a time, some 100 bytes each. When there are more, those with the lowest upper
    /// bounds are given up: the interval stays proven but gets wider than asked for.
    pub queue: usize,
}

impl Default for ExactOptions {
    fn default() -> Self {
        Self { tolerance: 1e-6, queue: 1 << 21 }
    }
}

/// A largest distance from a surface to another, between two proven bounds, in model units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProvenDistance {
    /// The largest distance is not smaller: [`from`](Self::from) is that far away.
    pub lower: f64,
    /// The largest distance is not larger.
    pub upper: f64,
    /// The point of this surface that was found farthest from the other one.
    pub from: [f64; 3],
    /// The point of the other surface nearest to [`from`](Self::from).
    pub to: [f64; 3],
    /// Nearest points that were looked for.
    pub searches: u64,
    /// Whether the bounds are as near each other as was asked for.
    pub converged: bool,
}

/// The largest distances between two surfaces, both ways, proven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactComparison {
    /// From A to B.
    pub forward: ProvenDistance,
    /// From B to A.
    pub backward: ProvenDistance,
    /// Length of the diagonal of the box around A's triangles.
    pub diagonal: f64,
    /// Width of the interval that was asked for, in model units.
    pub tolerance: f64,
}

impl ExactComparison {
    /// The Hausdorff distance is not smaller.
    pub fn lower(&self) -> f64 {
        self.forward.lower.max(self.backward.lower)
    }

    /// The Hausdorff distance is not larger.
    pub fn upper(&self) -> f64 {
        self.forward.upper.max(self.backward.upper)
    }

    /// Whether both directions are as narrow as was asked for.
    pub fn converged(&self) -> bool {
        self.forward.converged && self.backward.converged
    }
}

/// The Hausdorff distance of two surfaces, both ways, as proven intervals.
///
/// All vertices of one surface give a lower bound. Then each of its triangles is either shown not to hold any point farther
/// than that (and the tolerance), or cut into smaller ones whose corners may raise the lower bound: those that may be
/// farthest first. What shows it, the cheapest first, `d` being the distances of the corners:
///
/// - the least of `d` plus the longest edge there; the largest of `d` plus the radius of the circles around the corners
///   that cover the triangle;
/// - the largest distance of the corners from one triangle of the other surface, that of one of the corners: the distance
///   from a convex set is convex;
/// - the same for the two sides of a plane between the nearest points of two corners;
/// - the overlay: all triangles near enough are laid over the piece along its normal; none of it may be left uncovered,
///   and over each of them the corners of the common polygon tell. So surfaces that coincide or run parallel end at once,
///   however different their triangles are.
///
/// Bounds are computed in `f64` from `f32` positions, upper ones always as distances from a point that is known to be on
/// the other surface; a share of 2^-44 of the largest coordinate is added to them and taken from the lower ones, more than
/// all roundings together for triangles that are no needles beyond one to a million. The boxes of the search are rounded
/// outwards ([`Bvh`]). The result is the same for any number of threads.
///
/// Degenerate triangles count as the segments and points that they are.
///
/// Cost: one search for each vertex of both surfaces, and for surfaces near each other about as many again; without an
/// upper limit where surfaces follow each other at a distance along all of their length but run neither parallel nor over
/// each other (there the square root of the tolerance counts). Memory: [`queue`](ExactOptions::queue).
///
/// # Errors
/// As [`compare`](super::compare), and for a tolerance that is negative or NaN.
///
/// # References
/// Sacht and Jacobson, "Cascading upper bounds for triangle soup Pompeiu-Hausdorff distance", 2024; Kang, Yang, Wu and Yang,
/// "Fast and accurate evaluation of Hausdorff distance", 2018. We differ: the overlay in place of their last bounds, batches
/// whose bounds do not depend on threads, and rounding accounted for.
///
/// # Examples
/// ```
/// use maille::{Control, measure::{ExactOptions, hausdorff}, mesh::shapes};
/// let (fine, coarse) = (shapes::sphere(5), shapes::sphere(3));
/// let proven = hausdorff(&fine, &coarse, &ExactOptions::default(), Control::default())?;
/// assert!(proven.converged() && proven.upper() - proven.lower() <= proven.tolerance);
/// # Ok::<(), maille::measure::CompareError>(())
/// ```
pub fn hausdorff(
    a: &Mesh,
    b: &Mesh,
    options: &ExactOptions,
    control: Control<'_>,
) -> Result<ExactComparison, CompareError> {
    check_options(options)?;
    check(a, Side::A)?;
    check(b, Side::B)?;
    control.report("preparing", 0.0);
    let (ground_a, ground_b) = (Ground::new(a), Ground::new(b));
    let diagonal = ground_a.bvh.diagonal();
    let rounding = rounding(&[a, b]);
    let tolerance = (options.tolerance * diagonal).max(8.0 * rounding);
    let one_way = |from: &Ground<'_>, to: &Ground<'_>, stage| {
        let goal = Goal::Width(tolerance);
        Proof { from, to, goal, rounding, queue: options.queue, gather: false, enough: usize::MAX }
            .run(&Watch::new(control, stage))
    };
    let forward = one_way(&ground_a, &ground_b, "proving from A to B")?.distance;
    let backward = one_way(&ground_b, &ground_a, "proving from B to A")?.distance;
    Ok(ExactComparison { forward, backward, diagonal, tolerance })
}

fn check_options(options: &ExactOptions) -> Result<(), CompareError> {
    if options.tolerance >= 0.0 && options.tolerance.is_finite() {
        Ok(())
    } else {
        Err(CompareError::InvalidOption { name: "tolerance", reason: "must be finite and not negative" })
    }
}

/// What rounding may do to a distance.
pub(crate) fn rounding(meshes: &[&Mesh]) -> f64 {
    let largest = |mesh: &Mesh| {
        let used = (0..mesh.triangle_count()).into_par_iter().flat_map_iter(|t| mesh.triangle_points(t));
        used.map(|p| p.abs().max_element()).reduce(|| 0.0, f64::max)
    };
    meshes.iter().map(|mesh| largest(mesh)).fold(0.0, f64::max) * (-44_f64).exp2()
}

/// A surface to search in and to walk over.
pub(crate) struct Ground<'m> {
    mesh: &'m Mesh,
    bvh: Bvh<'m>,
    /// The vertices that triangles use, neighbours mostly next to each other.
    vertices: Vec<u32>,
    /// The triangles, in the order of the hierarchy.
    triangles: Vec<u32>,
}

impl<'m> Ground<'m> {
    /// Prepares a mesh whose triangles have finite corners.
    pub(crate) fn new(mesh: &'m Mesh) -> Self {
        let bvh = Bvh::new(mesh);
        let triangles: Vec<u32> = bvh.triangles_in_space_order().collect();
        let mut is_new = vec![true; mesh.vertex_count()];
        let corners = triangles.iter().flat_map(|&t| mesh.triangle_vertices(t as usize));
        let vertices = corners.filter(|&v| std::mem::replace(&mut is_new[v as usize], false)).collect();
        Self { mesh, bvh, vertices, triangles }
    }
}

/// What is to be shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Goal {
    /// The largest distance, within an interval of this width.
    Width(f64),
    /// That no distance is larger than `most`; distances within `doubt` below count as larger.
    Within {
        /// The largest distance that is right.
        most: f64,
        /// By how much less is asked for, so that the answer never takes long.
        doubt: f64,
    },
}

/// Where a surface is too far from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spot {
    /// A triangle of this surface.
    pub(crate) from: u32,
    /// The triangle of the other surface nearest to the point that is too far.
    pub(crate) to: u32,
    /// How far that is.
    pub(crate) distance: f64,
}

/// What has been shown.
#[derive(Debug)]
pub(crate) struct Shown {
    pub(crate) distance: ProvenDistance,
    /// Where it is too far; empty for [`Goal::Width`].
    pub(crate) spots: Vec<Spot>,
    /// The triangle nearest to each vertex, `u32::MAX` for vertices that no triangle uses; empty unless failures are
    /// gathered.
    pub(crate) nearest: Vec<u32>,
}

/// A proof that goes over one surface and searches in the other.
pub(crate) struct Proof<'g, 'm> {
    pub(crate) from: &'g Ground<'m>,
    pub(crate) to: &'g Ground<'m>,
    pub(crate) goal: Goal,
    pub(crate) rounding: f64,
    /// See [`ExactOptions::queue`].
    pub(crate) queue: usize,
    /// Whether all triangles that are too far are wanted, or any.
    pub(crate) gather: bool,
    /// When so many have been found to be too far, none is cut more than about once in search of others.
    pub(crate) enough: usize,
}

/// A triangle that is part of one of the surface.
#[derive(Debug, Clone, Copy)]
struct Piece {
    corners: [DVec3; 3],
    /// Distances of the corners, each from the triangle of the other surface whose place follows.
    distances: [f64; 3],
    places: [u32; 3],
    /// The triangle that it is part of.
    whole: u32,
    /// No point of it is farther than this.
    upper: f64,
}

/// A piece that waits: the farthest first, ties by number.
struct Waiting {
    piece: Piece,
    number: u64,
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.piece.upper.total_cmp(&other.piece.upper).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

/// Pieces looked at between two updates of the bounds, and by one thread at a time.
const BATCH: usize = 4096;
const SHARE: usize = 32;
/// Most triangles that are laid over a piece.
const OVERLAY: usize = 48;
/// A piece this many times as long as its shortest edge is cut across its longest.
const SLENDER: f64 = 2.5;

/// Memory that the overlay uses again and again.
#[derive(Debug, Default)]
struct Scratch {
    places: Vec<u32>,
    leftovers: Leftovers,
}

/// What a part of the work has found.
#[derive(Debug, Default)]
struct Found {
    /// The farthest point yet: its distance, and the point.
    farthest: Option<(f64, DVec3)>,
    pieces: Vec<Piece>,
    spots: Vec<Spot>,
    /// Largest bound of what is done with.
    done: f64,
    searches: u64,
}

impl Found {
    fn see(&mut self, distance: f64, point: DVec3) {
        if self.farthest.is_none_or(|(most, _)| distance > most) {
            self.farthest = Some((distance, point));
        }
    }

    /// Takes over all but the pieces.
    fn take(&mut self, other: &mut Self) {
        if let Some((distance, point)) = other.farthest {
            self.see(distance, point);
        }
        self.spots.append(&mut other.spots);
        self.done = self.done.max(other.done);
        self.searches += other.searches;
    }
}

impl Proof<'_, '_> {
    /// Goes on until the goal is reached, or shown to be out of reach.
    pub(crate) fn run(&self, watch: &Watch<'_>) -> Result<Shown, Cancelled> {
        let (mut all, nearest) = self.at_vertices(watch)?;
        let mut queue = BinaryHeap::new();
        let mut number = 0_u64;
        let mut given_up = 0.0_f64;
        let mut failed = vec![false; if self.gather { self.from.mesh.triangle_count() } else { 0 }];
        let mut add = |found: Vec<Piece>, queue: &mut BinaryHeap<Waiting>| {
            for piece in found {
                queue.push(Waiting { piece, number });
                number += 1;
            }
        };
        if self.goes_on(&all) {
            let most = self.most(&all);
            let triangles = self.from.triangles.len();
            let parts = map_chunks(triangles, |range| {
                watch.run(range.len(), self.from.vertices.len() + triangles, || {
                    let mut found = Found::default();
                    for &triangle in &self.from.triangles[range] {
                        self.look_at_triangle(triangle, &nearest, most, &mut found);
                    }
                    found
                })
            });
            for part in parts {
                let mut part = part?;
                all.take(&mut part);
                add(part.pieces, &mut queue);
            }
        }
        let name = |&(place, _): &(u32, f64)| match place {
            u32::MAX => place,
            _ => self.to.bvh.triangle_at(place),
        };
        let names = if self.gather { nearest.iter().map(name).collect() } else { Vec::new() };
        drop(nearest);
        let mut seen = 0;
        // as many batches as it takes to look at everything once
        let mut batches = queue.len().div_ceil(BATCH);
        while self.goes_on(&all) && (all.spots.len() <= self.enough || batches > 0) {
            batches = batches.saturating_sub(1);
            for spot in &all.spots[seen..] {
                if let Some(failed) = failed.get_mut(spot.from as usize) {
                    *failed = true;
                }
            }
            seen = all.spots.len();
            let most = self.most(&all);
            let mut batch = Vec::with_capacity(BATCH);
            while batch.len() < BATCH
                && let Some(Waiting { piece, .. }) = queue.peek()
            {
                if piece.upper <= most {
                    all.done = all.done.max(piece.upper);
                    queue.clear();
                } else if let Some(Waiting { piece, .. }) = queue.pop()
                    && !failed.get(piece.whole as usize).is_some_and(|&failed| failed)
                {
                    batch.push(piece);
                }
            }
            if batch.is_empty() {
                break;
            }
            if watch.is_cancelled() {
                return Err(Cancelled);
            }
            // neighbours next to each other: the nearest triangle of one is a good guess for the other
            batch.sort_by_key(|piece| piece.places[0]);
            let mut parts: Vec<Found> = batch.par_chunks(SHARE).map(|pieces| self.look_at(pieces, most)).collect();
            for part in &mut parts {
                all.take(part);
                add(std::mem::take(&mut part.pieces), &mut queue);
            }
            if queue.len() > self.queue.max(2 * BATCH) {
                let mut sorted = queue.into_sorted_vec();
                let rest = sorted.split_off(sorted.len() / 2);
                given_up = given_up.max(sorted.last().map_or(0.0, |waiting| waiting.piece.upper));
                queue = rest.into();
            }
        }
        watch.finish();
        Ok(self.shown(all, given_up, &queue, names))
    }

    fn shown(&self, all: Found, given_up: f64, queue: &BinaryHeap<Waiting>, nearest: Vec<u32>) -> Shown {
        let (found, from) = all.farthest.expect("there are vertices");
        let waiting = queue.peek().map_or(0.0, |waiting| waiting.piece.upper);
        // where it is too far, not all has been looked at
        let unseen = if all.spots.is_empty() { 0.0 } else { f64::INFINITY };
        let upper = found.max(all.done).max(given_up).max(waiting).max(unseen) + self.rounding;
        let lower = (found - self.rounding).max(0.0);
        let to = self.to.bvh.closest(from).expect("the mesh has triangles").point;
        let converged = match self.goal {
            Goal::Width(width) => upper - lower <= width,
            Goal::Within { most, .. } => upper <= most,
        };
        let distance = ProvenDistance {
            lower,
            upper,
            from: from.to_array(),
            to: to.to_array(),
            searches: all.searches,
            converged,
        };
        Shown { distance, spots: all.spots, nearest }
    }

    /// A piece whose upper bound is not above this needs no further look.
    fn most(&self, all: &Found) -> f64 {
        match self.goal {
            Goal::Width(width) => all.farthest.map_or(0.0, |(most, _)| most) + width - 2.0 * self.rounding,
            Goal::Within { most, .. } => most - self.rounding,
        }
    }

    /// Whether the goal may still be reached, or failures are to be gathered.
    fn goes_on(&self, all: &Found) -> bool {
        self.gather || all.spots.is_empty()
    }

    /// Whether a distance is one that the goal forbids.
    fn is_too_far(&self, distance: f64) -> bool {
        matches!(self.goal, Goal::Within { most, doubt } if distance > most - doubt)
    }

    /// The nearest triangle and distance of each vertex, by vertex.
    fn at_vertices(&self, watch: &Watch<'_>) -> Result<(Found, Vec<(u32, f64)>), Cancelled> {
        let vertices = &self.from.vertices;
        let total = vertices.len() + self.from.triangles.len();
        let parts = map_chunks(vertices.len(), |range| {
            watch.run(range.len(), total, || {
                let mut searcher = self.to.bvh.searcher();
                let mut found = Found::default();
                let nearest = vertices[range].iter().map(|&v| {
                    let p = glam::Vec3::from(self.from.mesh.positions[v as usize]).as_dvec3();
                    let guess = searcher.last_place();
                    self.search(&mut searcher, p, guess, &mut found)
                });
                let nearest: Vec<(u32, f64)> = nearest.collect();
                (found, nearest)
            })
        });
        let mut all = Found::default();
        let mut nearest = vec![(u32::MAX, 0.0); self.from.mesh.vertex_count()];
        let mut order = vertices.iter();
        for part in parts {
            let (mut found, distances) = part?;
            all.take(&mut found);
            for (distance, &v) in distances.into_iter().zip(&mut order) {
                nearest[v as usize] = distance;
            }
        }
        if !self.gather {
            // one is enough: of a vertex that is too far, any triangle
            let vertex = vertices.iter().find(|&&v| self.is_too_far(nearest[v as usize].1));
            if let Some(&vertex) = vertex {
                let has = |&&t: &&u32| self.from.mesh.triangle_vertices(t as usize).contains(&vertex);
                let from = *self.from.triangles.iter().find(has).expect("triangles use it");
                let (place, distance) = nearest[vertex as usize];
                all.spots.push(Spot { from, to: self.to.bvh.triangle_at(place), distance });
            }
        }
        Ok((all, nearest))
    }

    fn search(&self, searcher: &mut Searcher<'_>, p: DVec3, guess: u32, found: &mut Found) -> (u32, f64) {
        let (place, distance_sq) = searcher.close_place(p, guess, 0.0).expect("there are triangles, all is finite");
        let distance = distance_sq.sqrt();
        found.searches += 1;
        found.see(distance, p);
        (place, distance)
    }

    /// A whole triangle, of which the corners are known.
    fn look_at_triangle(&self, triangle: u32, nearest: &[(u32, f64)], most: f64, found: &mut Found) {
        let at = self.from.mesh.triangle_vertices(triangle as usize).map(|v| nearest[v as usize]);
        let mut piece = Piece {
            corners: self.from.mesh.triangle_points(triangle as usize),
            distances: at.map(|(_, distance)| distance),
            places: at.map(|(place, _)| place),
            whole: triangle,
            upper: f64::INFINITY,
        };
        self.keep(&mut piece, most, found);
    }

    /// Looks closer at pieces: with the overlay, or by cutting them.
    fn look_at(&self, pieces: &[Piece], most: f64) -> Found {
        let mut found = Found::default();
        let mut searcher = self.to.bvh.searcher();
        let mut scratch = Scratch::default();
        for piece in pieces {
            if let Some(upper) = self.overlay(piece, most, &mut scratch) {
                found.done = found.done.max(upper);
                continue;
            }
            self.cut(piece, most, &mut searcher, &mut found);
        }
        found
    }

    /// Done with a piece, or kept for later.
    fn keep(&self, piece: &mut Piece, most: f64, found: &mut Found) {
        if let Some(corner) = (0..3).find(|&i| self.is_too_far(piece.distances[i])) {
            let to = self.to.bvh.triangle_at(piece.places[corner]);
            found.spots.push(Spot { from: piece.whole, to, distance: piece.distances[corner] });
            return;
        }
        piece.upper = self.upper(piece, most).min(piece.upper);
        if piece.upper <= most {
            found.done = found.done.max(piece.upper);
        } else {
            found.pieces.push(*piece);
        }
    }

    /// Cuts a piece in four, or in two across its longest edge.
    fn cut(&self, piece: &Piece, most: f64, searcher: &mut Searcher<'_>, found: &mut Found) {
        let [a, b, c] = piece.corners;
        let lengths_sq = [b.distance_squared(c), c.distance_squared(a), a.distance_squared(b)];
        let longest = (1..3).fold(0, |most, i| if lengths_sq[i] > lengths_sq[most] { i } else { most });
        let shortest_sq = lengths_sq[0].min(lengths_sq[1]).min(lengths_sq[2]);
        let mut middle = |k: usize| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let p = (piece.corners[i] + piece.corners[j]) * 0.5;
            let (place, distance) = self.search(searcher, p, piece.places[i], found);
            (p, distance, place)
        };
        let part = |points: [(DVec3, f64, u32); 3]| Piece {
            corners: points.map(|(p, ..)| p),
            distances: points.map(|(_, distance, _)| distance),
            places: points.map(|(.., place)| place),
            ..*piece
        };
        let corner = |k: usize| (piece.corners[k], piece.distances[k], piece.places[k]);
        if lengths_sq[longest] > SLENDER * SLENDER * shortest_sq {
            let m = middle(longest);
            let [i, j] = [1, 2].map(|step| corner((longest + step) % 3));
            let top = corner(longest);
            for points in [[top, i, m], [top, m, j]] {
                self.keep(&mut part(points), most, found);
            }
        } else {
            let [x, y, z] = [0, 1, 2].map(&mut middle);
            let [a, b, c] = [0, 1, 2].map(corner);
            for points in [[a, z, y], [z, b, x], [y, x, c], [x, y, z]] {
                self.keep(&mut part(points), most, found);
            }
        }
    }

    /// A bound of the distances of all points of a piece; no better one is looked for than `most`.
    fn upper(&self, piece: &Piece, most: f64) -> f64 {
        let [a, b, c] = piece.corners;
        let lengths = [b.distance(c), c.distance(a), a.distance(b)];
        let d = piece.distances;
        let largest = d[0].max(d[1]).max(d[2]);
        let near_corner = |i: usize| d[i] + lengths[(i + 1) % 3].max(lengths[(i + 2) % 3]);
        let upper = near_corner(0).min(near_corner(1)).min(near_corner(2)).min(largest + covering_radius(lengths));
        if upper <= most {
            return upper;
        }
        let [p, q, r] = piece.places;
        let triangles = piece.places.map(|place| self.to.bvh.corners(place));
        let from_one = |i: usize| piece.corners.iter().map(|&v| distance_above(v, triangles[i])).fold(0.0, f64::max);
        let mut upper = upper.min(from_one(0));
        if q != p {
            upper = upper.min(from_one(1));
        }
        if r != p && r != q {
            upper = upper.min(from_one(2));
        }
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            if upper > most && piece.places[i] != piece.places[j] {
                upper = upper.min(from_two(
                    piece.corners,
                    [piece.corners[i], piece.corners[j]],
                    [triangles[i], triangles[j]],
                ));
            }
        }
        upper
    }

    /// See [`covered`].
    fn overlay(&self, piece: &Piece, most: f64, scratch: &mut Scratch) -> Option<f64> {
        let [a, b, c] = piece.corners;
        let largest = piece.distances.into_iter().fold(0.0, f64::max);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let normal = (b - a).cross(c - a).try_normalize()?;
        // a point as far beside a triangle as this is still near enough
        let margin = 0.7 * (most * most - largest * largest).max(0.0).sqrt();
        let reach = normal.abs() * most.min(1.25 * largest + 0.1 * longest) + margin.min(0.1 * longest);
        let near = [a.min(b).min(c) - reach, a.max(b).max(c) + reach];
        // what lies over the piece, and not only over the box around it
        let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| ((to - from).cross(normal).normalize_or_zero(), from));
        let is_over = |triangle: [DVec3; 3]| {
            sides.iter().all(|&(outwards, from)| triangle.iter().any(|p| (p - from).dot(outwards) <= margin))
        };
        if !self.to.bvh.gather(near, is_over, OVERLAY, &mut scratch.places) {
            return None;
        }
        let others = scratch.places.iter().map(|&place| self.to.bvh.corners(place));
        covered(piece.corners, others, most, margin, &mut scratch.leftovers)
    }
}

/// The radius of circles around the corners of a triangle that cover it: that of the circle through them if all angles are
/// acute, else half of the longest edge.
fn covering_radius(lengths: [f64; 3]) -> f64 {
    let [a, b, c] = lengths;
    let longest = a.max(b).max(c);
    let (a_sq, b_sq, c_sq) = (a * a, b * b, c * c);
    let sum_sq = a_sq + b_sq + c_sq;
    if sum_sq <= 2.0 * longest * longest {
        return 0.5 * longest;
    }
    // Heron, from the squares: 16 area^2. The factor is for its rounding.
    let area_sq = 2.0 * (a_sq * b_sq + b_sq * c_sq + c_sq * a_sq) - (a_sq * a_sq + b_sq * b_sq + c_sq * c_sq);
    if area_sq > 1e-9 * sum_sq * sum_sq { (a * b * c / area_sq.sqrt() * 1.000_001).min(longest) } else { longest }
}

/// A bound of the distances of a piece, cut by the plane between the points of two triangles nearest to two of its points.
fn from_two(corners: [DVec3; 3], near: [DVec3; 2], triangles: [[DVec3; 3]; 2]) -> f64 {
    let foot = |k: usize| {
        let (weights, _) = super::triangle::closest_on_triangle(near[k], triangles[k]);
        super::triangle::at(triangles[k], weights)
    };
    let (first, second) = (foot(0), foot(1));
    let (middle, normal) = ((first + second) * 0.5, second - first);
    let sides = corners.map(|p| (p - middle).dot(normal));
    let mut upper = 0.0_f64;
    for i in 0..3 {
        let j = (i + 1) % 3;
        let own = usize::from(sides[i] > 0.0);
        upper = upper.max(distance_above(corners[i], triangles[own]));
        if (sides[i] > 0.0) != (sides[j] > 0.0) {
            let cut = corners[i].lerp(corners[j], sides[i] / (sides[i] - sides[j]));
            upper = upper.max(distance_above(cut, triangles[0])).max(distance_above(cut, triangles[1]));
        }
    }
    upper
}

#[cfg(test)]
mod tests {
    use super::super::{CompareOptions, SurfaceSampler, compare};
    use super::*;
    use crate::mesh::shapes;
    use proptest::prelude::*;

    fn moved(mut mesh: Mesh, place: impl Fn(DVec3) -> DVec3) -> Mesh {
        for p in &mut mesh.positions {
            *p = place(glam::Vec3::from(*p).as_dvec3()).as_vec3().into();
        }
        mesh
    }

    fn prove(a: &Mesh, b: &Mesh) -> ExactComparison {
        let proven = hausdorff(a, b, &ExactOptions::default(), Control::default()).expect("both meshes are sound");
        assert!(proven.converged() && proven.upper() - proven.lower() <= proven.tolerance, "{proven:?}");
        for side in [proven.forward, proven.backward] {
            assert!(side.lower <= side.upper && side.upper - side.lower <= proven.tolerance);
        }
        proven
    }

    fn assert_holds(side: &ProvenDistance, expected: f64, searches: u64) {
        assert!(side.lower <= expected && expected <= side.upper, "{expected} is not in {side:?}");
        assert!(side.searches <= searches, "{side:?}");
    }

    #[test]
    fn parallel_squares_of_other_triangles() {
        let (square, above) = (shapes::grid(50), moved(shapes::grid(37), |p| p + DVec3::new(0.0, 0.0, 0.25)));
        let proven = prove(&square, &above);
        assert_holds(&proven.forward, 0.25, 4000);
        assert_holds(&proven.backward, 0.25, 4000);
    }

    #[test]
    fn surfaces_that_coincide_end_quickly() {
        let flat = |n| shapes::grid(n);
        let sphere = shapes::sphere(5);
        for (a, b) in [(flat(50), flat(37)), (flat(3), flat(64)), (sphere.clone(), sphere)] {
            let proven = prove(&a, &b);
            let most = 4 * (a.vertex_count() + b.vertex_count()) as u64;
            assert_holds(&proven.forward, 0.0, most);
            assert_holds(&proven.backward, 0.0, most);
        }
    }

    #[test]
    fn a_cube_moved_by_half_its_side() {
        let proven = prove(&shapes::cube(), &moved(shapes::cube(), |p| p + DVec3::X));
        assert_holds(&proven.forward, 1.0, 20_000);
        assert_holds(&proven.backward, 1.0, 20_000);
    }

    #[test]
    fn a_cube_and_the_sphere_within() {
        // the corners are the farthest of the cube; of a sphere of triangles, every point is within its circle
        let (cube, sphere) = (shapes::cube(), shapes::sphere(6));
        let proven = prove(&cube, &sphere);
        let corner = 3_f64.sqrt() - 1.0;
        assert!((proven.forward.lower - corner).abs() < 1e-3 && proven.forward.lower >= corner - 1e-6);
        // of the sphere, the directions of the corners: their distance from the faces is 1 - 1 / sqrt(3)
        let inner = 1.0 - 1.0 / 3_f64.sqrt();
        assert!((proven.backward.upper - inner).abs() < 1e-3, "{proven:?}");
    }

    #[test]
    fn a_maximum_in_the_middle_of_a_triangle_is_found() {
        // the middle of the large square is farthest from a frame around it; samples come near, the proof is there
        let square = moved(shapes::grid(1), |p| p * 2.0 - DVec3::new(1.0, 1.0, 0.0));
        let mut frame = moved(shapes::grid(8), |p| p * 2.0 - DVec3::new(1.0, 1.0, 0.0));
        let inner = |t: &[u32; 3]| {
            let points = t.map(|w| frame.positions[frame.wedge_vertices[w as usize] as usize]);
            let middle = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f32>() / 3.0);
            middle.iter().all(|x| x.abs() < 0.5)
        };
        let kept: Vec<_> = frame.triangles.iter().copied().filter(|t| !inner(t)).collect();
        frame.triangles = kept;
        let proven = prove(&square, &frame);
        assert_holds(&proven.forward, 0.5, 100_000);
        assert_holds(&proven.backward, 0.0, 2000);
    }

    #[test]
    fn a_strip_beyond_the_border_is_as_far_as_it_is_wide() {
        let wide = moved(shapes::grid(10), |p| p * DVec3::new(1.125, 1.0, 1.0));
        let proven = prove(&wide, &shapes::grid(9));
        assert_holds(&proven.forward, 0.125, 20_000);
        assert_holds(&proven.backward, 0.0, 2000);
    }

    #[test]
    fn scale_and_place_do_not_matter() {
        let (a, b) = (shapes::torus(3.0, 1.0, 60, 30), shapes::torus(3.0, 1.0, 20, 10));
        let plain = prove(&a, &b);
        for scale in [1e-30, 1e-9, 1e9, 1e30] {
            let scaled = prove(&moved(a.clone(), |p| p * scale), &moved(b.clone(), |p| p * scale));
            assert!((scaled.upper() / scale / plain.upper() - 1.0).abs() < 1e-4);
        }
        let far = |p: DVec3| p + DVec3::new(65536.0, -65536.0, 0.0);
        let far = prove(&moved(a, far), &moved(b, far));
        assert!((far.upper() / plain.upper() - 1.0).abs() < 0.05);
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let (a, b) = (shapes::torus(3.0, 1.0, 200, 100), shapes::torus(3.0, 1.0, 90, 30));
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be had");
            pool.install(|| prove(&a, &b))
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn with_a_short_queue_the_interval_is_wider_and_says_so() {
        let (a, b) = (shapes::torus(3.0, 1.0, 60, 60), shapes::sphere(5));
        let options = ExactOptions { tolerance: 1e-12, queue: 1 };
        let proven = hausdorff(&a, &b, &options, Control::default()).expect("both meshes are sound");
        let narrow = prove(&a, &b);
        assert!(proven.lower() <= narrow.upper() && proven.upper() >= narrow.lower());
        assert_eq!(proven.converged(), proven.upper() - proven.lower() <= proven.tolerance);
    }

    #[test]
    fn one_point_is_as_far_as_it_is() {
        let point = |x: f32| Mesh::from_triangles(vec![[x, 0.0, 0.0]], vec![[0, 0, 0]]).expect("the index is in range");
        let proven = prove(&point(1.0), &point(3.0));
        assert_holds(&proven.forward, 2.0, 10);
        assert_holds(&prove(&point(1.0), &point(1.0)).forward, 0.0, 10);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let cube = shapes::cube();
        let error = |a: &Mesh, b: &Mesh, tolerance| {
            let options = ExactOptions { tolerance, ..ExactOptions::default() };
            hausdorff(a, b, &options, Control::default()).expect_err("refused")
        };
        assert_eq!(error(&cube, &Mesh::default(), 0.1), CompareError::Empty { side: Side::B });
        let mut broken = shapes::cube();
        broken.positions[5][1] = f32::NAN;
        assert!(matches!(error(&broken, &cube, 0.1), CompareError::NotFinite { side: Side::A, vertex: 5, .. }));
        for tolerance in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(error(&cube, &cube, tolerance), CompareError::InvalidOption { name: "tolerance", .. }));
        }
        let stop = std::sync::atomic::AtomicBool::new(true);
        let stopped = hausdorff(&cube, &cube, &ExactOptions::default(), Control::new(None, Some(&stop)));
        assert_eq!(stopped, Err(CompareError::Cancelled(Cancelled)));
    }

    /// A bound in terms of a given one, and whether it must hold.
    fn within(a: &Mesh, b: &Mesh, most: f64, gather: bool) -> Shown {
        let (from, to) = (Ground::new(a), Ground::new(b));
        let rounding = rounding(&[a, b]);
        let goal = Goal::Within { most, doubt: (1e-4 * most).max(8.0 * rounding) };
        let proof = Proof { from: &from, to: &to, goal, rounding, queue: 1 << 20, gather, enough: usize::MAX };
        proof.run(&Watch::new(Control::default(), "")).expect("nobody cancels")
    }

    #[test]
    fn a_bound_is_shown_to_hold_or_not_to() {
        let (a, b) = (shapes::torus(3.0, 1.0, 60, 30), shapes::torus(3.0, 1.0, 20, 10));
        let proven = prove(&a, &b).forward;
        let holds = within(&a, &b, proven.upper * 1.001, false);
        assert!(holds.distance.converged && holds.spots.is_empty() && holds.distance.upper <= proven.upper * 1.001);
        let fails = within(&a, &b, proven.lower * 0.9, false);
        assert!(!fails.distance.converged && !fails.spots.is_empty());
        let all = within(&a, &b, proven.lower * 0.9, true);
        assert!(all.spots.len() >= fails.spots.len());
        assert!(all.spots.iter().all(|spot| spot.distance > proven.lower * 0.89));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn no_sample_is_beyond_the_bounds_of_any_soup(
            positions in prop::collection::vec(prop::array::uniform3(-2i8..=2), 1..20),
            corners in prop::collection::vec(prop::array::uniform3(any::<u32>()), 1..40),
            offset in prop_oneof![Just(0.0_f32), Just(1e5), Just(-0.3)],
        ) {
            let count = positions.len() as u32;
            let positions = positions.into_iter().map(|p| p.map(|x| f32::from(x) + offset)).collect();
            let triangles = corners.into_iter().map(|t| t.map(|c| c % count)).collect();
            let mesh = Mesh::from_triangles(positions, triangles).expect("indices are taken modulo");
            let other = moved(shapes::sphere(1), |p| p + DVec3::splat(f64::from(offset)));
            let proven = prove(&mesh, &other);
            let options = CompareOptions { samples: 2000, edges: true, ..CompareOptions::default() };
            let sampled = compare(&mesh, &other, &options, Control::default()).expect("nothing is refused");
            prop_assert!(sampled.forward.max <= proven.forward.upper && sampled.backward.max <= proven.backward.upper);
            for (side, to) in [(&proven.forward, &other), (&proven.backward, &mesh)] {
                let distance_sq = Bvh::new(to).closest(DVec3::from(side.from)).expect("there are triangles").distance_sq;
                prop_assert!(distance_sq.sqrt() >= side.lower && distance_sq.sqrt() <= side.upper);
            }
            let itself = prove(&mesh, &mesh);
            prop_assert!(itself.upper() <= itself.tolerance);
        }

        #[test]
        fn dense_samples_of_wild_triangles_come_near_the_bounds(
            a in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f32), 3),
            b in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f32), 9),
        ) {
            let mesh = |points: Vec<[f32; 3]>| {
                let triangles = (0..points.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
                Mesh::from_triangles(points, triangles).expect("indices are in range")
            };
            let (a, b) = (mesh(a), mesh(b));
            let proven = prove(&a, &b);
            let bvh = Bvh::new(&b);
            let samples = 20_000;
            let sampler = SurfaceSampler::new(&a, 0..1, 0);
            let distance = |p: DVec3| bvh.closest(p).expect("there are triangles").distance_sq.sqrt();
            let found = sampler.samples(samples, 0..samples).map(|s| distance(s.point)).fold(0.0, f64::max);
            prop_assert!(found <= proven.forward.upper);
            // samples are some 0.02 apart
            prop_assert!(found >= proven.forward.lower - 0.05);
        }
    }
}
