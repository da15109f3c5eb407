//! Vertices of a simplified mesh, moved to where its surface fits the original best.
//!
//! Edge collapse places each vertex once, by planes of the neighbourhood of that moment. When all is done, the triangles
//! that are left may fit better: [`refit`] takes points of the original, finds the nearest points of the simplified
//! surface, and moves all vertices at once so that the distances become least in the sense of least squares; a few times,
//! as the nearest points change. Connectivity and attributes stay.

mod least_squares;
mod posed;
#[cfg(test)]
mod posed_tests;
#[cfg(test)]
mod tests;

use glam::DVec3;
use rayon::prelude::*;

use crate::control::Cancelled;
use crate::measure::triangle::{at, closest_on_triangle, scaled_normal};
use crate::measure::{Bvh, ClosestPoint, SurfaceSampler};
use crate::{Control, Mesh};
use least_squares::{Fit, OnTriangle, Row};
pub use posed::{PosedRefitOptions, PosedRefitReport, refit_in_poses};

/// How to [`refit`].
#[derive(Debug, Clone, PartialEq)]
pub struct RefitOptions {
    /// How often nearest points are looked for anew. The first round gains most; after the second little is left.
    pub rounds: u32,
    /// Points of the original to each vertex of the simplified mesh, more or less: where that is half a point to each
    /// triangle of the original or more, each has one or three, by its area.
    pub samples_per_vertex: f64,
    /// Moves the samples.
    pub seed: u64,
    /// One entry per vertex of the simplified mesh: vertices that must stay. Empty: none. Vertices on open borders stay
    /// anyway.
    pub fixed: Vec<bool>,
}

impl Default for RefitOptions {
    fn default() -> Self {
        Self { rounds: 2, samples_per_vertex: 30.0, seed: 0, fixed: Vec::new() }
    }
}

/// What [`refit`] did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefitReport {
    /// Root mean square distance of the samples from the simplified surface before, in model units.
    pub rms_before: f64,
    /// The same after.
    pub rms_after: f64,
    /// Largest distance, of the samples from the simplified surface and of points of this from the original, before.
    pub max_before: f64,
    /// The same after: never larger.
    pub max_after: f64,
}

/// Moves the vertices of a simplified mesh so that its surface fits the original best.
///
/// Vertices slide along the surface to where they serve best; little where there are attributes, whose values stay.
/// No triangle turns by more than 60 degrees, and the largest distance measured, both ways, does not grow: where it would,
/// vertices stay where they were. The result does not depend on the number of threads. Meshes without triangles stay as
/// they are.
///
/// Cost: a search for each triangle of the original, about a microsecond on one core, and a fraction of that for each sample
/// in each [round](RefitOptions::rounds); some 60 bytes per triangle of the original and 300 per triangle of the mesh.
///
/// # Panics
/// If `fixed` has another length than the mesh has vertices, or positions are not finite.
///
/// # Errors
/// [`Cancelled`]; the mesh is unchanged then.
///
/// # References
/// Hoppe et al., "Mesh optimization", SIGGRAPH 1993 (fitting vertices with the connectivity given); Marinov and Kobbelt,
/// "Optimization methods for scattered data approximation with subdivision surfaces", 2005 (distances along normals count
/// more than along the surface).
pub fn refit(
    mesh: &mut Mesh,
    original: &Mesh,
    options: &RefitOptions,
    control: Control<'_>,
) -> Result<RefitReport, Cancelled> {
    assert!(options.fixed.is_empty() || options.fixed.len() == mesh.vertex_count(), "one entry per vertex");
    let mut report = RefitReport { rms_before: 0.0, rms_after: 0.0, max_before: 0.0, max_after: 0.0 };
    if mesh.triangles.is_empty() || original.triangles.is_empty() {
        return Ok(report);
    }
    let tell = |round: u32| {
        control.report("fitting to the original", round as f32 / (options.rounds + 1) as f32);
        if control.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    };
    tell(0)?;
    let there = Bvh::new(original);
    let (vertices, sorted) = spatially_sorted(mesh);
    let triangles = &*sorted.triangles;
    let first = Surface { positions: &sorted.positions, triangles };
    let points = Points::new(first, original, &there, options);
    let sides = Sides::new(triangles);
    let fixed = sides.fixed_vertices(triangles, vertices.iter().map(|&v| options.fixed.get(v as usize) == Some(&true)));
    let (mut nearest, forward) = points.first_nearest(first, &sides);
    let parts = Parts::of_each(original.triangle_count() / triangles.len());
    let before = Errors { forward, backward: Backward::of(first, &there, parts, forward.most_sq) };
    (report.rms_before, report.max_before) = (before.rms(), before.max());
    (report.rms_after, report.max_after) = (before.rms(), before.max());
    let along = if mesh.wedge_attributes.is_empty() && mesh.vertex_attributes.is_empty() {
        ALONG
    } else {
        ALONG_WITH_ATTRIBUTES
    };
    let mut moved = Moved::new(first);
    let mut forward = forward;
    for round in 1..=options.rounds {
        tell(round)?;
        let moves = moves(moved.surface(first), &points, &nearest[..points.samples], &before.backward, &fixed, along);
        moved.add(&moves, first);
        let count = if round < options.rounds { points.samples } else { points.len() };
        forward = points.follow(moved.surface(first), &sides, &mut nearest[..count]);
    }
    let mut after = before.after(moved.surface(first), &there, forward, before.max_sq());
    if after.max_sq() > before.max_sq() {
        // what was followed may be nearer to another triangle
        let is_far = |found: &ClosestPoint| found.distance_sq > before.max_sq();
        after.forward = points.search_again(moved.surface(first), &mut nearest, is_far);
    }
    for _ in 0..HELD_BACK {
        if after.max_sq() <= before.max_sq() {
            break;
        }
        tell(options.rounds)?;
        let beyond = after.vertices_beyond(before.max_sq(), &points, &nearest, [first, moved.surface(first)], &sides);
        let stale = moved.take_back(&beyond, first);
        let is_stale = |found: &ClosestPoint| triangles[found.triangle as usize].iter().any(|&v| stale[v as usize]);
        let forward = points.search_again(moved.surface(first), &mut nearest, is_stale);
        after = after.after(moved.surface(first), &there, forward, before.max_sq());
    }
    if after.max_sq() <= before.max_sq() {
        for (&v, &position) in vertices.iter().zip(&moved.positions) {
            mesh.positions[v as usize] = position;
        }
        (report.rms_after, report.max_after) = (after.rms(), after.max());
    }
    Ok(report)
}

/// The triangles and vertices of a mesh in the order of a space-filling curve, so that what is near is near in memory, and
/// the names that its vertices had.
fn spatially_sorted(mesh: &Mesh) -> (Vec<u32>, Mesh) {
    let triangles = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
    let mut sorted = Mesh::from_triangles(mesh.positions.clone(), triangles).expect("they are those of a mesh");
    (sorted.sort_spatially(), sorted)
}

/// Triangles between vertices.
#[derive(Debug, Clone, Copy)]
struct Surface<'a> {
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
}

impl<'a> Surface<'a> {
    fn hierarchy(self) -> Bvh<'a> {
        Bvh::of_triangles(self.positions, self.triangles)
    }

    #[inline]
    fn vertex(self, v: u32) -> DVec3 {
        glam::Vec3::from(self.positions[v as usize]).as_dvec3()
    }

    #[inline]
    fn corners(self, triangle: u32) -> [DVec3; 3] {
        let [a, b, c] = self.triangles[triangle as usize];
        [self.vertex(a), self.vertex(b), self.vertex(c)]
    }

    /// The point of a triangle that is nearest to `p`.
    #[inline]
    fn nearest(self, triangle: u32, p: DVec3) -> ClosestPoint {
        let corners = self.corners(triangle);
        let (barycentric, distance_sq) = closest_on_triangle(p, corners);
        ClosestPoint { triangle, barycentric, point: at(corners, barycentric), distance_sq }
    }
}

/// Points of the original: those to fit to, the samples, and the vertices. Fitted to as well, these would pull the surface
/// outwards; but largest distances are mostly there.
///
/// What can be found out again is not kept: there may be several points to a triangle.
struct Points<'a> {
    original: &'a Mesh,
    /// Of the original.
    there: &'a Bvh<'a>,
    /// Number of samples.
    samples: usize,
    source: Source,
    /// What the samples count, of twice the area of the original.
    density: f64,
    /// The vertices that triangles use, in the order in which these name them first.
    vertices: Vec<u32>,
    /// Of each of them, a sample that is not far.
    near: Vec<u32>,
}

/// Where samples come from.
enum Source {
    /// The same places of each triangle, by its area; triangles in the order of the leaves of the hierarchy.
    Rule(&'static [[f64; 3]]),
    /// At random: fewer than triangles.
    Random(Vec<Sample>),
}

impl<'a> Points<'a> {
    fn new(mesh: Surface<'_>, original: &'a Mesh, there: &'a Bvh<'a>, options: &RefitOptions) -> Self {
        let wanted = mesh.positions.len() as f64 * options.samples_per_vertex;
        let order = there.triangles_in_space_order();
        let count = order.len();
        let per_triangle = wanted / count as f64;
        let (source, samples, density) = if per_triangle >= 0.5 {
            let places: &[[f64; 3]] = if per_triangle >= 2.0 { &THREE_POINTS } else { &[[1.0 / 3.0; 3]] };
            (Source::Rule(places), count * places.len(), places.len() as f64)
        } else {
            let samples = random(original, order.collect(), wanted, options);
            let area = |place| scaled_normal(there.corners(place)).length();
            let number = samples.len();
            (Source::Random(samples), number, number as f64 / (0..count as u32).map(area).sum::<f64>())
        };
        let mut known = vec![false; original.vertex_count()];
        let corners = there.triangles_in_space_order().enumerate().flat_map(|(i, t)| {
            let [a, b, c] = original.triangle_vertices(t as usize);
            [(a, i), (b, i), (c, i)]
        });
        let new = corners.filter(|&(v, _)| !std::mem::replace(&mut known[v as usize], true));
        let (vertices, near) = new.map(|(v, i)| (v, (i * samples / count) as u32)).unzip();
        Self { original, there, samples, source, density, vertices, near }
    }

    /// Number of samples and vertices.
    fn len(&self) -> usize {
        self.samples + self.vertices.len()
    }

    /// A sample.
    #[inline]
    fn sample(&self, i: usize) -> Sample {
        match &self.source {
            Source::Rule(places) => {
                let corners = self.there.corners((i / places.len()) as u32);
                let scaled = scaled_normal(corners);
                let normal = scaled.normalize_or_zero();
                Sample { point: at(corners, places[i % places.len()]), normal, weight: scaled.length() }
            }
            Source::Random(samples) => samples[i],
        }
    }

    /// A sample and what it counts or, after them, a vertex, which does not count.
    #[inline]
    fn point(&self, i: usize) -> (DVec3, f64) {
        match &self.source {
            _ if i >= self.samples => (vertex(self.original, self.vertices[i - self.samples]), 0.0),
            Source::Rule(places) => {
                let corners = self.there.corners((i / places.len()) as u32);
                (at(corners, places[i % places.len()]), scaled_normal(corners).length())
            }
            Source::Random(samples) => (samples[i].point, samples[i].weight),
        }
    }

    /// The triangles of the mesh that are nearest to all points, and the distances.
    ///
    /// One search serves the samples on one triangle of the original, and the vertices near them: they are
    /// [followed](Self::follow) from there. Those that are further away by that than the rest are searched for
    /// themselves, so that the largest distance of all is the true one.
    fn first_nearest(&self, mesh: Surface<'_>, sides: &Sides) -> (Vec<u32>, Forward) {
        let here = mesh.hierarchy();
        let at_once = match &self.source {
            Source::Rule(places) => places.len(),
            Source::Random(_) => 1,
        };
        let mut nearest = vec![0; self.len()];
        let (of_samples, of_vertices) = nearest.split_at_mut(self.samples);
        let chunks = of_samples.par_chunks_mut(CHUNK * at_once).enumerate().map(|(chunk, nearest)| {
            let mut searcher = here.searcher();
            let mut most = 0.0_f64;
            for (i, nearest) in nearest.chunks_exact_mut(at_once).enumerate() {
                let (point, _) = self.point((chunk * CHUNK + i) * at_once);
                let found = searcher.closest(point).expect("there are triangles");
                nearest.fill(found.triangle);
                most = most.max(found.distance_sq);
            }
            most
        });
        let most = chunks.reduce(|| 0.0, f64::max);
        of_vertices.par_iter_mut().zip(&self.near).for_each(|(nearest, &near)| *nearest = of_samples[near as usize]);
        let forward = self.find_again(&mut nearest, || {
            let mut searcher = here.searcher();
            let mut search = move |p| searcher.closest(p).expect("there are triangles");
            move |p, from| {
                let found = sides.walk(mesh, from, p);
                if found.distance_sq > most { search(p) } else { found }
            }
        });
        (nearest, forward)
    }

    /// Brings the nearest triangles of the first points up to date after vertices have moved. Good enough to fit to; what
    /// is nearest may be missed at folds, so the distances found are never too small.
    fn follow(&self, mesh: Surface<'_>, sides: &Sides, nearest: &mut [u32]) -> Forward {
        match self.source {
            Source::Rule(_) => self.find_again(nearest, || |p, from| sides.walk(mesh, from, p)),
            // few, so that each may be looked at again that has come to the side of a triangle
            Source::Random(_) => {
                self.find_again(nearest, || |p, from| sides.walk(mesh, from, p));
                self.search_again(mesh, nearest, |found| found.barycentric.contains(&0.0))
            }
        }
    }

    /// Looks anew for the triangles nearest to some of the first points. (Those on triangles that have not moved are as near
    /// as before, or nearer.)
    fn search_again(
        &self,
        mesh: Surface<'_>,
        nearest: &mut [u32],
        which: impl Fn(&ClosestPoint) -> bool + Sync,
    ) -> Forward {
        let here = mesh.hierarchy();
        self.find_again(nearest, || {
            let mut searcher = here.searcher();
            let which = &which;
            move |p, known| {
                let found = mesh.nearest(known, p);
                if which(&found) { searcher.closest(p).expect("there are triangles") } else { found }
            }
        })
    }

    /// Finds the triangles nearest to the first points anew, each from the one known, and adds up the distances.
    fn find_again<F: FnMut(DVec3, u32) -> ClosestPoint>(
        &self,
        nearest: &mut [u32],
        finder: impl Fn() -> F + Sync,
    ) -> Forward {
        let chunks = nearest.par_chunks_mut(CHUNK).enumerate().map(|(chunk, nearest)| {
            let mut find = finder();
            let mut sum = Forward::default();
            for (i, nearest) in (chunk * CHUNK..).zip(nearest) {
                let (point, weight) = self.point(i);
                let found = find(point, *nearest);
                *nearest = found.triangle;
                sum.add(Forward { squares: found.distance_sq * weight, weights: weight, most_sq: found.distance_sq });
            }
            sum
        });
        // piece by piece, so that the number of threads does not matter
        chunks.collect::<Vec<_>>().into_iter().fold(Forward::default(), |mut sum, piece| {
            sum.add(piece);
            sum
        })
    }
}

/// Distances of points from the mesh.
#[derive(Debug, Clone, Copy, Default)]
struct Forward {
    /// Of the samples, by what they count.
    squares: f64,
    weights: f64,
    most_sq: f64,
}

impl Forward {
    #[inline]
    fn add(&mut self, other: Self) {
        self.squares += other.squares;
        self.weights += other.weights;
        self.most_sq = self.most_sq.max(other.most_sq);
    }
}

fn random(original: &Mesh, triangles: Vec<u32>, wanted: f64, options: &RefitOptions) -> Vec<Sample> {
    let count = wanted.ceil() as u64;
    let sampler = SurfaceSampler::new(original, triangles, options.seed);
    in_chunks(count as usize, |range| {
        let normal = |t: u32| scaled_normal(original.triangle_points(t as usize)).normalize_or_zero();
        let samples = sampler.samples(count, range.start as u64..range.end as u64);
        samples.map(|s| Sample { point: s.point, normal: normal(s.triangle), weight: 1.0 }).collect()
    })
}

/// A rule that is exact for quadratic functions, as squared distances are where one triangle lies on another.
const THREE_POINTS: [[f64; 3]; 3] = {
    const A: f64 = 2.0 / 3.0;
    const B: f64 = 1.0 / 6.0;
    [[A, B, B], [B, A, B], [B, B, A]]
};

/// How often moves are taken back where the largest distance has grown, before all are.
const HELD_BACK: usize = 4;

/// A point of the original to fit to, and the normal there.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: DVec3,
    normal: DVec3,
    /// What it counts.
    weight: f64,
}

/// Points in a piece of work.
const CHUNK: usize = 1 << 13;

/// The results of all chunks, one after the other.
fn in_chunks<T: Clone + Send>(count: usize, work: impl Fn(std::ops::Range<usize>) -> Vec<T> + Sync) -> Vec<T> {
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(|i| work(i * CHUNK..count.min((i + 1) * CHUNK)));
    chunks.collect::<Vec<_>>().concat()
}

/// Triangles that [`Sides::walk`] goes on to.
const MOST_STEPS: usize = 16;

/// What lies beyond the sides of triangles.
struct Sides {
    /// Of each triangle, the one beyond the side opposite to each corner; none for sides that do not have two triangles.
    opposite: Vec<[u32; 3]>,
}

impl Sides {
    fn new(triangles: &[[u32; 3]]) -> Self {
        let mut opposite = vec![[u32::MAX; 3]; triangles.len()];
        let edge = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
        let sides = |(t, &[a, b, c]): (usize, &[u32; 3])| {
            let t = t as u32;
            [(edge(b, c), t, 0_u8), (edge(c, a), t, 1), (edge(a, b), t, 2)]
        };
        let mut edges: Vec<(u64, u32, u8)> = triangles.iter().enumerate().flat_map(sides).collect();
        edges.par_sort_unstable();
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            if let &[(_, t, k), (_, u, l)] = same {
                opposite[t as usize][k as usize] = u;
                opposite[u as usize][l as usize] = t;
            }
        }
        Self { opposite }
    }

    /// From a triangle over sides to neighbours as long as these are nearer to a point.
    #[inline]
    fn walk(&self, mesh: Surface<'_>, from: u32, p: DVec3) -> ClosestPoint {
        let mut best = mesh.nearest(from, p);
        for _ in 0..MOST_STEPS {
            let ClosestPoint { triangle: here, barycentric, .. } = best;
            for (corner, &weight) in barycentric.iter().enumerate() {
                // zero: the point is on the side opposite to the corner
                let neighbor = self.opposite[here as usize][corner];
                if weight > 0.0 || neighbor == u32::MAX {
                    continue;
                }
                let other = mesh.nearest(neighbor, p);
                if other.distance_sq < best.distance_sq {
                    best = other;
                }
            }
            if best.triangle == here {
                break;
            }
        }
        best
    }

    /// Vertices that stay: by wish, and on sides without a neighbour.
    fn fixed_vertices(&self, triangles: &[[u32; 3]], wanted: impl Iterator<Item = bool>) -> Vec<bool> {
        let mut fixed: Vec<bool> = wanted.collect();
        for (triangle, opposite) in triangles.iter().zip(&self.opposite) {
            for k in (0..3).filter(|&k| opposite[k] == u32::MAX) {
                fixed[triangle[(k + 1) % 3] as usize] = true;
                fixed[triangle[(k + 2) % 3] as usize] = true;
            }
        }
        fixed
    }
}

/// The moves that make the distances of the samples from their nearest points least, and those of the mesh from the
/// original where samples do not tell: on triangles that span what the original does not have, or has further away, few
/// points are nearest to a sample.
fn moves(
    mesh: Surface<'_>,
    points: &Points<'_>,
    nearest: &[u32],
    backward: &Backward,
    fixed: &[bool],
    along: f64,
) -> Vec<DVec3> {
    let rows = |t: u32, samples: &[u32], sum: &mut OnTriangle| {
        let corners = mesh.corners(t);
        let mut covered = 0.0;
        for &i in samples {
            let Sample { point, normal, weight } = points.sample(i as usize);
            let (weights, _) = closest_on_triangle(point, corners);
            sum.add(&Row { weights, normal, wanted: point - at(corners, weights), weight, along });
            covered += weight;
        }
        let uncovered = scaled_normal(corners).length() * points.density - covered;
        if uncovered > COVERED * covered {
            let parts = backward.parts;
            let mut searcher = points.there.searcher();
            for part in 0..parts.count() {
                let weights = parts.middle(part);
                let (point, guess) = (at(corners, weights), backward.places[backward.place_of(mesh, t, part)]);
                let Some((place, distance_sq)) = searcher.close_place(point, guess, 0.0) else { continue };
                let there = points.there.corners(place);
                let wanted = at(there, closest_on_triangle(point, there).0) - point;
                let normal = if distance_sq > 0.0 { wanted } else { scaled_normal(there) }.normalize_or_zero();
                sum.add(&Row { weights, normal, wanted, weight: uncovered / parts.count() as f64, along });
            }
        }
    };
    Fit::new(mesh.triangles, nearest.iter().copied(), rows, fixed).solve()
}

/// What a distance along the surface counts, of one along the normal.
const ALONG: f64 = 1e-4;
/// The same where there are attributes: they go with their vertices, so these should slide little. By measurement: with 0.05
/// errors of textures double, with 1 a quarter less is gained in distance.
const ALONG_WITH_ATTRIBUTES: f64 = 0.3;

/// The part of a triangle's area that samples may leave uncovered, of what they cover.
const COVERED: f64 = 0.1;

/// Distances both ways.
#[derive(Debug)]
struct Errors {
    forward: Forward,
    backward: Backward,
}

impl Errors {
    /// What the errors are after vertices have moved. Only `known_sq`, a squared distance, is compared with.
    fn after(&self, mesh: Surface<'_>, there: &Bvh<'_>, forward: Forward, known_sq: f64) -> Self {
        let mut backward = self.backward.clone();
        backward.update(mesh, there, forward.most_sq.min(known_sq));
        Self { forward, backward }
    }

    /// Root mean square distance of the samples.
    fn rms(&self) -> f64 {
        (self.forward.squares / self.forward.weights.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Largest squared distance of a sample, of a vertex of the original, or of a point of the mesh.
    fn max_sq(&self) -> f64 {
        self.forward.most_sq.max(self.backward.most_sq)
    }

    fn max(&self) -> f64 {
        self.max_sq().sqrt()
    }

    /// Vertices further than `most_sq`, or corners of a triangle that is or that is nearest to a point that is, before the
    /// moves or after them.
    fn vertices_beyond(
        &self,
        most_sq: f64,
        points: &Points<'_>,
        nearest: &[u32],
        [before, after]: [Surface<'_>; 2],
        sides: &Sides,
    ) -> Vec<u32> {
        let forward = in_chunks(points.len(), |range| {
            let far = range.map(|i| (nearest[i], points.point(i).0));
            let far = far.filter(|&(t, p)| after.nearest(t, p).distance_sq > most_sq);
            far.flat_map(|(t, p)| [t, sides.walk(before, t, p).triangle]).collect()
        });
        let Backward { parts, places, .. } = &self.backward;
        let backward = in_chunks(places.len(), |range| {
            let is_far =
                |i: &usize| closest_on_triangle(parts.point(after, *i), points.there.corners(places[*i])).1 > most_sq;
            range.filter(is_far).collect()
        });
        let vertices = after.positions.len();
        let (of_vertices, inside): (Vec<usize>, Vec<usize>) = backward.into_iter().partition(|&i| i < vertices);
        let far_triangles = inside.into_iter().map(|i| (i - vertices) / parts.count());
        let far_triangles = forward.into_iter().map(|t| t as usize).chain(far_triangles);
        let corners = far_triangles.flat_map(|t| after.triangles[t]);
        corners.chain(of_vertices.into_iter().map(|v| v as u32)).collect()
    }
}

/// Distances of points of the mesh from the original.
#[derive(Debug, Clone)]
struct Backward {
    /// Triangles are looked at in the middles of their parts.
    parts: Parts,
    /// Of each vertex of the mesh, and of the parts of each of its triangles: the place of the nearest triangle of the
    /// original, or of one that is near enough.
    places: Vec<u32>,
    most_sq: f64,
}

impl Backward {
    /// Squared distances up to `enough_sq` are of no interest.
    fn of(mesh: Surface<'_>, there: &Bvh<'_>, parts: Parts, enough_sq: f64) -> Self {
        let count = mesh.positions.len() + mesh.triangles.len() * parts.count();
        let mut backward = Self { parts, places: vec![u32::MAX; count], most_sq: 0.0 };
        backward.update(mesh, there, enough_sq);
        backward
    }

    /// Looks anew for what is near enough.
    fn update(&mut self, mesh: Surface<'_>, there: &Bvh<'_>, enough_sq: f64) {
        let parts = self.parts;
        let chunks = self.places.par_chunks_mut(CHUNK).enumerate().map(|(chunk, places)| {
            let mut searcher = there.searcher();
            let mut most_sq = 0.0_f64;
            for (i, place) in (chunk * CHUNK..).zip(places) {
                let guess = if *place == u32::MAX { searcher.last_place() } else { *place };
                let found = searcher.close_place(parts.point(mesh, i), guess, enough_sq);
                let (found, distance_sq) = found.unwrap_or((0, 0.0));
                *place = found;
                most_sq = most_sq.max(distance_sq);
            }
            most_sq
        });
        self.most_sq = chunks.reduce(|| 0.0, f64::max);
    }

    fn place_of(&self, mesh: Surface<'_>, triangle: u32, part: usize) -> usize {
        mesh.positions.len() + triangle as usize * self.parts.count() + part
    }
}

/// Triangles in equal parts: so many to a side.
#[derive(Debug, Clone, Copy)]
struct Parts(usize);

impl Parts {
    /// So many that there are about half as many parts as triangles of the original.
    fn of_each(triangles_of_original: usize) -> Self {
        Self((triangles_of_original / 2).isqrt().clamp(1, 6))
    }

    fn count(self) -> usize {
        self.0 * self.0
    }

    /// The middle of a part, in barycentric coordinates.
    fn middle(self, part: usize) -> [f64; 3] {
        // rows of 1, 3, 5, ... parts, every other one upside down
        let row = part.isqrt();
        let (column, is_upside_down) = ((part - row * row) / 2, (part - row * row) % 2);
        let v = (3 * (row - column) + 1 - 2 * is_upside_down) as f64 / (3 * self.0) as f64;
        let w = (3 * column + 1 + is_upside_down) as f64 / (3 * self.0) as f64;
        [1.0 - v - w, v, w]
    }

    /// A vertex of the mesh or, after them, the middle of a part of a triangle.
    fn point(self, mesh: Surface<'_>, i: usize) -> DVec3 {
        match i.checked_sub(mesh.positions.len()) {
            None => mesh.vertex(i as u32),
            Some(i) => at(mesh.corners((i / self.count()) as u32), self.middle(i % self.count())),
        }
    }
}

fn vertex(mesh: &Mesh, v: u32) -> DVec3 {
    glam::Vec3::from(mesh.positions[v as usize]).as_dvec3()
}

/// Where the vertices of a mesh have gone.
struct Moved {
    /// From where they were at first.
    by: Vec<DVec3>,
    /// To.
    positions: Vec<[f32; 3]>,
}

impl Moved {
    fn new(mesh: Surface<'_>) -> Self {
        Self { by: vec![DVec3::ZERO; mesh.positions.len()], positions: mesh.positions.to_vec() }
    }

    fn surface<'a>(&'a self, first: Surface<'a>) -> Surface<'a> {
        Surface { positions: &self.positions, ..first }
    }

    /// Moves on, as far as no triangle turns too far.
    fn add(&mut self, moves: &[DVec3], first: Surface<'_>) {
        let moving: Vec<u32> = (0..).zip(moves).filter(|(_, by)| **by != DVec3::ZERO).map(|(v, _)| v).collect();
        self.by.iter_mut().zip(moves).for_each(|(by, more)| *by += *more);
        self.turn_back(moving, first);
    }

    /// Takes all moves of some vertices back; says of which vertices the position has changed.
    fn take_back(&mut self, vertices: &[u32], first: Surface<'_>) -> Vec<bool> {
        let before = self.positions.clone();
        vertices.iter().for_each(|&v| self.by[v as usize] = DVec3::ZERO);
        self.turn_back(vertices.to_vec(), first);
        before.iter().zip(&self.positions).map(|(p, q)| p != q).collect()
    }

    /// Puts vertices where they have gone, but takes back half of the moves at triangles that have turned by more than 60
    /// degrees, and all in the end.
    fn turn_back(&mut self, mut changed: Vec<u32>, first: Surface<'_>) {
        let mut halved = vec![0_u8; self.by.len()];
        let mut is_changed = vec![false; self.by.len()];
        let most = DVec3::splat(f64::from(f32::MAX));
        while !changed.is_empty() {
            for &v in &changed {
                let to = (first.vertex(v) + self.by[v as usize]).clamp(-most, most);
                self.positions[v as usize] = to.as_vec3().to_array();
                is_changed[v as usize] = true;
            }
            let now = self.surface(first);
            let is_bad = |t: &u32| {
                let corners = first.triangles[*t as usize];
                let is_new = |&v: &u32| is_changed[v as usize];
                let is_away = |&v: &u32| self.by[v as usize] != DVec3::ZERO;
                if !corners.iter().any(is_new) || !corners.iter().any(is_away) {
                    return false;
                }
                let [before, after] = [first, now].map(|surface| scaled_normal(surface.corners(*t)));
                before.dot(after) <= 0.5 * (before.length_squared() * after.length_squared()).sqrt()
            };
            let bad: Vec<u32> = (0..first.triangles.len() as u32).into_par_iter().filter(is_bad).collect();
            changed.iter().for_each(|&v| is_changed[v as usize] = false);
            changed = bad.into_iter().flat_map(|t| first.triangles[t as usize]).collect();
            changed.sort_unstable();
            changed.dedup();
            for &v in &changed {
                halved[v as usize] += 1;
                self.by[v as usize] *= if halved[v as usize] > 3 { 0.0 } else { 0.5 };
            }
        }
    }
}
