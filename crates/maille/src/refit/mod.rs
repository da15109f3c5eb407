//! Vertices of a simplified mesh, moved to where its surface fits the original best.
//!
//! Edge collapse places each vertex once, by planes of the neighbourhood of that moment. When all is done, the triangles
//! that are left may fit better: [`refit`] takes points of the original, finds the nearest points of the simplified
//! surface, and moves all vertices at once so that the distances become least in the sense of least squares; a few times,
//! as the nearest points change. Connectivity and attributes stay.

mod least_squares;
#[cfg(test)]
mod tests;

use glam::DVec3;
use rayon::prelude::*;

use crate::control::Cancelled;
use crate::measure::triangle::{at, closest_on_triangle, scaled_normal};
use crate::measure::{Bvh, ClosestPoint, Searcher, SurfaceSampler};
use crate::{Control, Mesh};
use least_squares::{Fit, Row};

/// How to [`refit`].
#[derive(Debug, Clone, PartialEq)]
pub struct RefitOptions {
    /// How often nearest points are looked for anew. The first round gains most.
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
        Self { rounds: 3, samples_per_vertex: 30.0, seed: 0, fixed: Vec::new() }
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
/// No triangle turns by more than 60 degrees, and the largest distance measured, both ways, does not grow: where it would,
/// vertices stay where they were. The result does not depend on the number of threads. Meshes without triangles stay as
/// they are.
///
/// Cost: a search for each sample, about a microsecond on one core, and a fraction of that in each
/// [round](RefitOptions::rounds); some 60 bytes per triangle of the original and 500 per triangle of the mesh.
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
    let points = Points::new(mesh, original, there.triangles_in_space_order(), options);
    let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
    let sides = Sides::new(&triangles);
    let fixed = sides.fixed_vertices(&triangles, mesh.vertex_count(), &options.fixed);
    let first = points.first_nearest(mesh, &sides);
    let before = Errors::of(mesh, &there, &points, &first, None);
    (report.rms_before, report.max_before) = (before.rms, before.max);
    (report.rms_after, report.max_after) = (before.rms, before.max);
    let mut nearest = first.clone();
    let mut moved = Moved::new(mesh);
    for round in 1..=options.rounds {
        tell(round)?;
        let moves = moves(&moved.mesh(mesh), &triangles, &points, &nearest[..points.samples], &fixed);
        moved.add(&moves, mesh);
        let count = if round < options.rounds { points.samples } else { points.len() };
        points.follow(&moved.mesh(mesh), &sides, &mut nearest[..count]);
    }
    let mut result = moved.mesh(mesh);
    let mut is_exact = false;
    let mut after = Errors::of(&result, &there, &points, &nearest, Some((&before, &|_| true)));
    for _ in 0..=HELD_BACK {
        if after.max <= before.max {
            mesh.positions = result.positions;
            (report.rms_after, report.max_after) = (after.rms, after.max);
            break;
        }
        tell(options.rounds)?;
        if !is_exact {
            // what was followed may be nearer to another triangle
            let most = before.max * before.max;
            let is_far = |p: DVec3, t: u32| on_triangle(&result, t, p).distance_sq > most;
            points.search_again(&Bvh::new(&result), &mut nearest, is_far);
            after = Errors::of(&result, &there, &points, &nearest, Some((&after, &|_| false)));
            is_exact = true;
            continue;
        }
        moved.take_back(mesh, &after.vertices_beyond(before.max, &result, &points, [&nearest, &first]));
        let held = moved.mesh(mesh);
        let has_moved = |v: u32| held.positions[v as usize] != result.positions[v as usize];
        let stale: Vec<bool> = triangles.par_iter().map(|corners| corners.iter().any(|&v| has_moved(v))).collect();
        points.search_again(&Bvh::new(&held), &mut nearest, |_, t| stale[t as usize]);
        let vertices = mesh.vertex_count();
        let is_stale = |i: usize| if i < vertices { has_moved(i as u32) } else { stale[i - vertices] };
        after = Errors::of(&held, &there, &points, &nearest, Some((&after, &is_stale)));
        result = held;
    }
    Ok(report)
}

/// Points of the original: those to fit to, the samples, and the vertices. Fitted to as well, these would pull the surface
/// outwards; but largest distances are mostly there.
///
/// What can be found out again is not kept: there may be several points to a triangle.
struct Points<'a> {
    original: &'a Mesh,
    /// Number of samples.
    samples: usize,
    source: Source,
    /// The vertices that triangles use, in the order in which these name them first.
    vertices: Vec<u32>,
    /// Of each of them, a sample that is not far.
    near: Vec<u32>,
}

/// Where samples come from.
enum Source {
    /// The same places of each triangle, by its area.
    Rule { triangles: Vec<u32>, places: &'static [[f64; 3]] },
    /// At random: fewer than triangles.
    Random(Vec<Sample>),
}

impl<'a> Points<'a> {
    /// `order` names all triangles of the original, those near one another together.
    fn new(mesh: &Mesh, original: &'a Mesh, order: impl ExactSizeIterator<Item = u32>, options: &RefitOptions) -> Self {
        let wanted = mesh.vertex_count() as f64 * options.samples_per_vertex;
        let per_triangle = wanted / original.triangle_count() as f64;
        let triangles: Vec<u32> = order.collect();
        let rule = |triangles| Source::Rule {
            triangles,
            places: if per_triangle >= 2.0 { &THREE_POINTS } else { &[[1.0 / 3.0; 3]] },
        };
        let mut known = vec![false; original.vertex_count()];
        let corners = triangles.iter().enumerate().flat_map(|(i, &t)| {
            let corners = original.triangle_vertices(t as usize);
            corners.map(|v| (v, i))
        });
        let new = corners.filter(|&(v, _)| !std::mem::replace(&mut known[v as usize], true));
        let (vertices, near): (Vec<u32>, Vec<usize>) = new.unzip();
        let count = triangles.len();
        let source = if per_triangle >= 0.5 { rule(triangles) } else { random(original, triangles, wanted, options) };
        let samples = source.len();
        let near = near.into_iter().map(|i| (i * samples / count) as u32).collect();
        Self { original, samples, source, vertices, near }
    }

    /// Number of samples and vertices.
    fn len(&self) -> usize {
        self.samples + self.vertices.len()
    }

    /// A sample.
    #[inline]
    fn sample(&self, i: usize) -> Sample {
        match &self.source {
            Source::Rule { triangles, places } => {
                let corners = self.original.triangle_points(triangles[i / places.len()] as usize);
                let scaled = scaled_normal(corners);
                let normal = scaled.normalize_or_zero();
                Sample { point: at(corners, places[i % places.len()]), normal, weight: scaled.length() }
            }
            Source::Random(samples) => samples[i],
        }
    }

    /// A sample or, after them, a vertex.
    #[inline]
    fn point(&self, i: usize) -> DVec3 {
        match &self.source {
            _ if i >= self.samples => vertex(self.original, self.vertices[i - self.samples] as usize),
            Source::Rule { triangles, places } => {
                let corners = self.original.triangle_points(triangles[i / places.len()] as usize);
                at(corners, places[i % places.len()])
            }
            Source::Random(samples) => samples[i].point,
        }
    }

    /// The triangles of the mesh that are nearest to all points.
    ///
    /// One search serves the samples on one triangle of the original, and the vertices near them: they are
    /// [followed](Self::follow) from there. Those that are further away by that than the rest are searched for
    /// themselves, so that the largest distance of all is the true one.
    fn first_nearest(&self, mesh: &Mesh, sides: &Sides) -> Vec<u32> {
        let here = Bvh::new(mesh);
        let at_once = match &self.source {
            Source::Rule { places, .. } => places.len(),
            Source::Random(_) => 1,
        };
        let searched = in_chunks(self.samples / at_once, |range| {
            let mut searcher = here.searcher();
            let closest = |i: usize| searcher.closest(self.point(i * at_once)).expect("there are triangles");
            range.map(closest).map(|found| (found.triangle, found.distance_sq)).collect()
        });
        let most = searched.iter().map(|&(_, distance_sq)| distance_sq).fold(0.0, f64::max);
        let samples = (0..self.samples).map(|i| searched[i / at_once].0);
        let vertices = self.near.iter().map(|&i| searched[i as usize / at_once].0);
        let mut nearest: Vec<u32> = samples.chain(vertices).collect();
        drop(searched);
        self.walk(mesh, sides, &mut nearest);
        self.search_again(&here, &mut nearest, |p, t| on_triangle(mesh, t, p).distance_sq > most);
        nearest
    }

    /// Brings the nearest triangles of the first points up to date after vertices have moved. Good enough to fit to; what
    /// is nearest may be missed at folds, so the distances found are never too small.
    fn follow(&self, mesh: &Mesh, sides: &Sides, nearest: &mut [u32]) {
        self.walk(mesh, sides, nearest);
        if let Source::Random(_) = self.source {
            // few, so that each may be looked at again that has come to the side of a triangle
            let samples = nearest.len().min(self.samples);
            let is_at_side = |p: DVec3, t: u32| on_triangle(mesh, t, p).barycentric.contains(&0.0);
            self.search_again(&Bvh::new(mesh), &mut nearest[..samples], is_at_side);
        }
    }

    /// From triangles over sides to neighbours as long as these are nearer.
    fn walk(&self, mesh: &Mesh, sides: &Sides, nearest: &mut [u32]) {
        nearest.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, nearest)| {
            for (i, nearest) in nearest.iter_mut().enumerate() {
                *nearest = sides.walk(mesh, *nearest, self.point(chunk * CHUNK + i));
            }
        });
    }

    /// Looks anew for the triangles nearest to some of the first points. (Those on triangles that have not moved are as near
    /// as before, or nearer.)
    fn search_again(&self, here: &Bvh<'_>, nearest: &mut [u32], which: impl Fn(DVec3, u32) -> bool + Sync) {
        nearest.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, nearest)| {
            let mut searcher = here.searcher();
            for (i, nearest) in nearest.iter_mut().enumerate() {
                let point = self.point(chunk * CHUNK + i);
                if which(point, *nearest) {
                    *nearest = searcher.closest(point).expect("there are triangles").triangle;
                }
            }
        });
    }
}

impl Source {
    fn len(&self) -> usize {
        match self {
            Self::Rule { triangles, places } => triangles.len() * places.len(),
            Self::Random(samples) => samples.len(),
        }
    }
}

fn random(original: &Mesh, triangles: Vec<u32>, wanted: f64, options: &RefitOptions) -> Source {
    let count = wanted.ceil() as u64;
    let sampler = SurfaceSampler::new(original, triangles, options.seed);
    Source::Random(in_chunks(count as usize, |range| {
        let normal = |t: u32| scaled_normal(original.triangle_points(t as usize)).normalize_or_zero();
        let samples = sampler.samples(count, range.start as u64..range.end as u64);
        samples.map(|s| Sample { point: s.point, normal: normal(s.triangle), weight: 1.0 }).collect()
    }))
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

/// Samples or points in a piece of work.
const CHUNK: usize = 1 << 13;

/// The results of all chunks, one after the other.
fn in_chunks<T: Clone + Send>(count: usize, work: impl Fn(std::ops::Range<usize>) -> Vec<T> + Sync) -> Vec<T> {
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(|i| work(i * CHUNK..count.min((i + 1) * CHUNK)));
    chunks.collect::<Vec<_>>().concat()
}

/// Triangles that [`Sides::walk`] goes on to.
const MOST_STEPS: usize = 16;

fn on_triangle(mesh: &Mesh, triangle: u32, p: DVec3) -> ClosestPoint {
    let corners = mesh.triangle_points(triangle as usize);
    let (barycentric, distance_sq) = closest_on_triangle(p, corners);
    ClosestPoint { triangle, barycentric, point: at(corners, barycentric), distance_sq }
}

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
    fn walk(&self, mesh: &Mesh, triangle: u32, p: DVec3) -> u32 {
        let mut best = on_triangle(mesh, triangle, p);
        for _ in 0..MOST_STEPS {
            let ClosestPoint { triangle: here, barycentric, .. } = best;
            for (corner, &weight) in barycentric.iter().enumerate() {
                // zero: the point is on the side opposite to the corner
                let neighbor = self.opposite[here as usize][corner];
                if weight > 0.0 || neighbor == u32::MAX {
                    continue;
                }
                let other = on_triangle(mesh, neighbor, p);
                if other.distance_sq < best.distance_sq {
                    best = other;
                }
            }
            if best.triangle == here {
                break;
            }
        }
        best.triangle
    }

    /// Vertices that stay: by wish, and on sides without a neighbour.
    fn fixed_vertices(&self, triangles: &[[u32; 3]], vertices: usize, wanted: &[bool]) -> Vec<bool> {
        let mut fixed = wanted.to_vec();
        fixed.resize(vertices, false);
        for (triangle, opposite) in triangles.iter().zip(&self.opposite) {
            for k in (0..3).filter(|&k| opposite[k] == u32::MAX) {
                fixed[triangle[(k + 1) % 3] as usize] = true;
                fixed[triangle[(k + 2) % 3] as usize] = true;
            }
        }
        fixed
    }
}

/// The moves that make the distances of the samples from their nearest points least.
fn moves(mesh: &Mesh, triangles: &[[u32; 3]], points: &Points<'_>, nearest: &[u32], fixed: &[bool]) -> Vec<DVec3> {
    let row = |i: usize| {
        let Sample { point, normal, weight } = points.sample(i);
        let found = on_triangle(mesh, nearest[i], point);
        Row { weights: found.barycentric, normal, wanted: point - found.point, weight }
    };
    Fit::new(triangles, nearest.iter().copied(), row, fixed).solve()
}

/// Distances both ways.
#[derive(Debug)]
struct Errors {
    /// Root mean square distance of the samples.
    rms: f64,
    /// Largest distance of a sample, of a vertex of the original, or of a point of the mesh.
    max: f64,
    /// Of each vertex of the mesh, and of the middle of each of its triangles: squared distance from the original, and the
    /// place of the triangle there.
    backward: Vec<(f64, u32)>,
}

/// What was known before vertices moved, and which of [`Errors::backward`] have to be looked for anew.
type Before<'a> = (&'a Errors, &'a (dyn Fn(usize) -> bool + Sync));

impl Errors {
    fn of(mesh: &Mesh, there: &Bvh<'_>, points: &Points<'_>, nearest: &[u32], before: Option<Before<'_>>) -> Self {
        let vertices = mesh.vertex_count();
        let backward = in_chunks(vertices + mesh.triangle_count(), |range| {
            let mut searcher = there.searcher();
            let point = |i: usize| if i < vertices { vertex(mesh, i) } else { middle(mesh, i - vertices) };
            let place = |i: usize| match before {
                Some((before, is_stale)) if !is_stale(i) => before.backward[i],
                _ => nearest_place(&mut searcher, point(i), before.map(|(before, _)| before.backward[i].1)),
            };
            range.map(place).collect()
        });
        // sums of pieces, so that the number of threads does not matter
        let pieces = in_chunks(nearest.len(), |range| {
            let (mut squares, mut weights, mut most) = (0.0, 0.0, 0.0_f64);
            for i in range {
                let distance_sq = on_triangle(mesh, nearest[i], points.point(i)).distance_sq;
                most = most.max(distance_sq);
                if i < points.samples {
                    let weight = points.sample(i).weight;
                    squares += distance_sq * weight;
                    weights += weight;
                }
            }
            vec![(squares, weights, most)]
        });
        let (mut squares, mut weights, mut most) = (0.0, f64::MIN_POSITIVE, 0.0_f64);
        for piece in pieces {
            (squares, weights, most) = (squares + piece.0, weights + piece.1, most.max(piece.2));
        }
        most = backward.iter().fold(most, |most, &(distance_sq, _)| most.max(distance_sq));
        Self { rms: (squares / weights).sqrt(), max: most.sqrt(), backward }
    }

    /// Vertices of the mesh that are further away than `most`, or corners of a triangle that is or that is nearest to a point
    /// that is, now or before the moves.
    fn vertices_beyond(&self, most: f64, mesh: &Mesh, points: &Points<'_>, nearest: [&[u32]; 2]) -> Vec<u32> {
        let is_far = |distance_sq: f64| distance_sq > most * most;
        let far = in_chunks(points.len(), |range| {
            range.filter(|&i| is_far(on_triangle(mesh, nearest[0][i], points.point(i)).distance_sq)).collect()
        });
        let forward = far.into_iter().flat_map(|i| nearest.map(|nearest| nearest[i]));
        let (vertices, middles) = self.backward.split_at(mesh.vertex_count());
        let numbers = |distances: &[(f64, u32)]| -> Vec<u32> {
            (0..).zip(distances).filter(|(_, now)| is_far(now.0)).map(|(i, _)| i).collect()
        };
        let corners = forward.chain(numbers(middles)).flat_map(|t| mesh.triangle_vertices(t as usize));
        corners.chain(numbers(vertices)).collect()
    }
}

/// The squared distance of a point from the original, and the place of the nearest triangle; `guess` is such a place.
fn nearest_place(searcher: &mut Searcher<'_>, point: DVec3, guess: Option<u32>) -> (f64, u32) {
    let guess = guess.unwrap_or_else(|| searcher.last_place());
    searcher.closest_place(point, guess).map_or((0.0, 0), |(place, distance_sq)| (distance_sq, place))
}

fn vertex(mesh: &Mesh, v: usize) -> DVec3 {
    glam::Vec3::from(mesh.positions[v]).as_dvec3()
}

fn middle(mesh: &Mesh, t: usize) -> DVec3 {
    mesh.triangle_points(t).into_iter().sum::<DVec3>() / 3.0
}

/// Where the vertices of a mesh have gone.
struct Moved {
    /// From where they were at first.
    by: Vec<DVec3>,
}

impl Moved {
    fn new(mesh: &Mesh) -> Self {
        Self { by: vec![DVec3::ZERO; mesh.vertex_count()] }
    }

    fn position(&self, mesh: &Mesh, v: u32) -> glam::Vec3 {
        let most = DVec3::splat(f64::from(f32::MAX));
        (glam::Vec3::from(mesh.positions[v as usize]).as_dvec3() + self.by[v as usize]).clamp(-most, most).as_vec3()
    }

    /// The mesh with its vertices where they have gone; without attributes.
    fn mesh(&self, mesh: &Mesh) -> Mesh {
        Mesh {
            positions: (0..mesh.vertex_count() as u32).map(|v| self.position(mesh, v).to_array()).collect(),
            wedge_vertices: mesh.wedge_vertices.clone(),
            triangles: mesh.triangles.clone(),
            ..Mesh::default()
        }
    }

    /// Moves on, as far as no triangle turns too far.
    fn add(&mut self, moves: &[DVec3], mesh: &Mesh) {
        self.by.iter_mut().zip(moves).for_each(|(by, more)| *by += *more);
        self.turn_back(mesh);
    }

    /// Takes back half of the moves at triangles that have turned by more than 60 degrees, and all in the end.
    fn turn_back(&mut self, mesh: &Mesh) {
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let mut halved = vec![0_u8; self.by.len()];
        loop {
            let is_bad = |t: &usize| {
                let vertices = mesh.triangle_vertices(*t);
                if vertices.iter().all(|&v| self.by[v as usize] == DVec3::ZERO) {
                    return false;
                }
                let before = normal(mesh.triangle_points(*t));
                let after = normal(vertices.map(|v| self.position(mesh, v).as_dvec3()));
                before.dot(after) <= 0.5 * (before.length_squared() * after.length_squared()).sqrt()
            };
            let bad: Vec<usize> = (0..mesh.triangle_count()).into_par_iter().filter(is_bad).collect();
            if bad.is_empty() {
                return;
            }
            let mut vertices: Vec<u32> = bad.into_iter().flat_map(|t| mesh.triangle_vertices(t)).collect();
            vertices.sort_unstable();
            vertices.dedup();
            for v in vertices {
                halved[v as usize] += 1;
                self.by[v as usize] *= if halved[v as usize] > 3 { 0.0 } else { 0.5 };
            }
        }
    }

    /// Takes all moves of some vertices back.
    fn take_back(&mut self, mesh: &Mesh, vertices: &[u32]) {
        for &v in vertices {
            self.by[v as usize] = DVec3::ZERO;
        }
        self.turn_back(mesh);
    }
}
