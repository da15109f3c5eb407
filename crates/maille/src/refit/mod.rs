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
use crate::measure::{Bvh, ClosestPoint, Searcher, SurfaceSampler};
use crate::{Control, Mesh};
use least_squares::{Fit, Row};

/// How to [`refit`].
#[derive(Debug, Clone, PartialEq)]
pub struct RefitOptions {
    /// How often nearest points are looked for anew. The first round gains most.
    pub rounds: u32,
    /// Points of the original to each vertex of the simplified mesh, but four to each triangle of the original at most.
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
/// Cost: [`rounds`](RefitOptions::rounds) + 1 searches for each sample, about a microsecond each on one core; some 120 bytes
/// per sample.
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
    let count = (mesh.vertex_count() as f64 * options.samples_per_vertex).ceil() as u64;
    let count = count.min((MOST_PER_TRIANGLE * original.triangle_count()) as u64);
    let sampler = SurfaceSampler::new(original, there.triangles_in_space_order(), options.seed);
    let samples = in_chunks(count as usize, |range| {
        let samples = sampler.samples(count, range.start as u64..range.end as u64);
        samples.map(|sample| Sample { point: sample.point, normal: normal_of(original, sample.triangle) }).collect()
    });
    // fitted to as well, vertices would pull the surface outwards; but largest distances are mostly there
    let vertices = vertices(original, there.triangles_in_space_order());
    let fixed = fixed_vertices(mesh, &options.fixed);
    let mut found = nearest(mesh, &samples);
    let mut far = nearest(mesh, &vertices);
    let before = Errors::of(mesh, &there, &found, &far);
    (report.rms_before, report.max_before) = (before.rms, before.max);
    (report.rms_after, report.max_after) = (before.rms, before.max);
    let mut moved = Moved::new(mesh);
    for round in 1..=options.rounds {
        tell(round)?;
        moved.add(&moves(&moved.mesh(mesh), &samples, &found, &fixed), mesh);
        if round < options.rounds {
            follow(&moved.mesh(mesh), &samples, &mut found);
        }
    }
    let mut result = moved.mesh(mesh);
    found = nearest(&result, &samples);
    far = nearest(&result, &vertices);
    let mut after = Errors::of(&result, &there, &found, &far);
    for _ in 0..HELD_BACK {
        if after.max <= before.max {
            mesh.positions = result.positions;
            (report.rms_after, report.max_after) = (after.rms, after.max);
            break;
        }
        tell(options.rounds)?;
        moved.take_back(mesh, &after.vertices_beyond(before.max, &before, mesh));
        let held = moved.mesh(mesh);
        let has_moved = |v: u32| held.positions[v as usize] != result.positions[v as usize];
        let is_stale = |t: usize| mesh.triangle_vertices(t).into_iter().any(has_moved);
        let stale: Vec<bool> = (0..mesh.triangle_count()).into_par_iter().map(is_stale).collect();
        let own = Bvh::new(&held);
        search_stale(&own, &samples, &mut found, &stale);
        search_stale(&own, &vertices, &mut far, &stale);
        drop(own);
        after = after.updated(&held, &there, &found, &far, &stale, has_moved);
        result = held;
    }
    Ok(report)
}

/// Most samples for each triangle of the original: of what is flat, more say little more. At half of the triangles, where
/// it counts, 16 samples to a vertex take half of the time of 30 and leave 1 % more error.
const MOST_PER_TRIANGLE: usize = 4;

/// How often moves are taken back where the largest distance has grown, before all are.
const HELD_BACK: usize = 4;

/// A point of the original, and the normal there.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: DVec3,
    normal: DVec3,
}

fn normal_of(mesh: &Mesh, triangle: u32) -> DVec3 {
    let [a, b, c] = mesh.triangle_points(triangle as usize);
    (b - a).cross(c - a).normalize_or_zero()
}

/// The vertices that triangles use, in the order in which these name them first.
fn vertices(mesh: &Mesh, order: impl Iterator<Item = u32>) -> Vec<Sample> {
    let mut known = vec![false; mesh.vertex_count()];
    let vertices = order.flat_map(|t| mesh.triangle_vertices(t as usize));
    let new = vertices.filter(|&v| !std::mem::replace(&mut known[v as usize], true));
    new.map(|v| Sample { point: glam::Vec3::from(mesh.positions[v as usize]).as_dvec3(), normal: DVec3::ZERO })
        .collect()
}

/// Samples or points in a piece of work.
const CHUNK: usize = 1 << 13;

/// The results of all chunks, one after the other.
fn in_chunks<T: Clone + Send>(count: usize, work: impl Fn(std::ops::Range<usize>) -> Vec<T> + Sync) -> Vec<T> {
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(|i| work(i * CHUNK..count.min((i + 1) * CHUNK)));
    chunks.collect::<Vec<_>>().concat()
}

/// The points of the mesh that are nearest to the samples.
fn nearest(mesh: &Mesh, samples: &[Sample]) -> Vec<ClosestPoint> {
    let here = Bvh::new(mesh);
    in_chunks(samples.len(), |range| {
        let mut searcher = here.searcher();
        let closest = |sample: &Sample| searcher.closest(sample.point).expect("there are triangles");
        samples[range].iter().map(closest).collect()
    })
}

/// Brings the nearest points up to date after a round of moves: what lies above the inside of the triangle that was nearest
/// stays with it, which is right but for folds; the rest is looked for anew. Good enough to fit to, not to measure.
fn follow(mesh: &Mesh, samples: &[Sample], found: &mut [ClosestPoint]) {
    let here = Bvh::new(mesh);
    samples.par_chunks(CHUNK).zip(found.par_chunks_mut(CHUNK)).for_each(|(samples, found)| {
        let mut searcher = here.searcher();
        for (sample, found) in samples.iter().zip(found) {
            let corners = mesh.triangle_points(found.triangle as usize);
            match above(corners, sample.point) {
                Some((barycentric, point)) => {
                    let distance_sq = point.distance_squared(sample.point);
                    *found = ClosestPoint { barycentric, point, distance_sq, ..*found };
                }
                None => *found = searcher.closest(sample.point).expect("there are triangles"),
            }
        }
    });
}

/// Where the foot of the perpendicular from p is in a triangle, if it is inside.
fn above([a, b, c]: [DVec3; 3], p: DVec3) -> Option<([f64; 3], DVec3)> {
    let (x, y, q) = (b - a, c - a, p - a);
    let (xx, xy, yy) = (x.length_squared(), x.dot(y), y.length_squared());
    let determinant = xx * yy - xy * xy;
    let (qx, qy) = (q.dot(x), q.dot(y));
    let (v, w) = (yy * qx - xy * qy, xx * qy - xy * qx);
    if v < 0.0 || w < 0.0 || v + w > determinant || determinant <= f64::EPSILON * xx * yy {
        return None;
    }
    let (v, w) = (v / determinant, w / determinant);
    Some(([1.0 - v - w, v, w], a + x * v + y * w))
}

/// Looks anew for the nearest points that lie on stale triangles. Those that keep theirs are as near as before, or nearer.
fn search_stale(here: &Bvh<'_>, samples: &[Sample], found: &mut [ClosestPoint], stale: &[bool]) {
    samples.par_chunks(CHUNK).zip(found.par_chunks_mut(CHUNK)).for_each(|(samples, found)| {
        let mut searcher = here.searcher();
        for (sample, found) in samples.iter().zip(found).filter(|(_, found)| stale[found.triangle as usize]) {
            *found = searcher.closest(sample.point).expect("there are triangles");
        }
    });
}

/// Vertices that stay: by wish, and on edges that do not have two triangles.
fn fixed_vertices(mesh: &Mesh, wanted: &[bool]) -> Vec<bool> {
    let mut fixed = wanted.to_vec();
    fixed.resize(mesh.vertex_count(), false);
    let edge = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
    let triangles = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t));
    let mut edges: Vec<u64> = triangles.flat_map(|[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)]).collect();
    edges.par_sort_unstable();
    for same in edges.chunk_by(|a, b| a == b).filter(|same| same.len() != 2) {
        for v in [same[0] >> 32, same[0] & u64::from(u32::MAX)] {
            fixed[v as usize] = true;
        }
    }
    fixed
}

/// The moves that make the distances of the samples from their nearest points least.
fn moves(mesh: &Mesh, samples: &[Sample], found: &[ClosestPoint], fixed: &[bool]) -> Vec<DVec3> {
    let row = |(sample, found): (&Sample, &ClosestPoint)| Row {
        vertices: mesh.triangle_vertices(found.triangle as usize),
        weights: found.barycentric,
        normal: sample.normal,
        wanted: sample.point - found.point,
    };
    let rows: Vec<Row> = samples.par_iter().zip(found).map(row).collect();
    Fit::new(&rows, fixed).solve()
}

/// Distances both ways.
#[derive(Debug)]
struct Errors {
    /// Root mean square distance of the samples.
    rms: f64,
    /// Largest distance of a sample, of a vertex of the original, or of a point of the mesh.
    max: f64,
    /// Of each sample and vertex of the original: squared distance and triangle.
    forward: Vec<(f64, u32)>,
    /// Of each vertex of the mesh, and of the middle of each of its triangles: squared distance.
    backward: Vec<f64>,
}

impl Errors {
    fn of(mesh: &Mesh, there: &Bvh<'_>, samples: &[ClosestPoint], vertices: &[ClosestPoint]) -> Self {
        let mut backward = distances_sq(there, mesh.vertex_count(), |v| Some(vertex(mesh, v)));
        backward.extend(distances_sq(there, mesh.triangle_count(), |t| Some(middle(mesh, t))));
        Self::summed(samples, vertices, backward.into_iter().map(|found| found.unwrap_or(0.0)).collect())
    }

    /// The same after some vertices have moved, and with them the triangles that are stale.
    fn updated(
        &self,
        mesh: &Mesh,
        there: &Bvh<'_>,
        samples: &[ClosestPoint],
        vertices: &[ClosestPoint],
        stale: &[bool],
        has_moved: impl Fn(u32) -> bool + Sync,
    ) -> Self {
        let moved = |v: usize| has_moved(v as u32).then(|| vertex(mesh, v));
        let mut backward = distances_sq(there, mesh.vertex_count(), moved);
        backward.extend(distances_sq(there, mesh.triangle_count(), |t| stale[t].then(|| middle(mesh, t))));
        let backward = backward.into_iter().zip(&self.backward).map(|(now, then)| now.unwrap_or(*then)).collect();
        Self::summed(samples, vertices, backward)
    }

    fn summed(samples: &[ClosestPoint], vertices: &[ClosestPoint], backward: Vec<f64>) -> Self {
        let sum: f64 = samples.iter().map(|found| found.distance_sq).sum();
        let forward: Vec<_> = samples.iter().chain(vertices).map(|found| (found.distance_sq, found.triangle)).collect();
        let all = forward.iter().map(|&(distance_sq, _)| distance_sq).chain(backward.iter().copied());
        let max = all.fold(0.0, f64::max).sqrt();
        Self { rms: (sum / samples.len() as f64).sqrt(), max, forward, backward }
    }

    /// Vertices of the mesh that are further away than `most`, or corners of a triangle that is or that is nearest to a point
    /// that is; `before` are the errors before the moves, whose nearest triangles count, too.
    fn vertices_beyond(&self, most: f64, before: &Self, mesh: &Mesh) -> Vec<u32> {
        let is_far = |distance_sq: f64| distance_sq > most * most;
        let far = self.forward.iter().zip(&before.forward).filter(|((now, _), _)| is_far(*now));
        let forward = far.flat_map(|(&(_, now), &(_, then))| [now, then]);
        let (vertices, middles) = self.backward.split_at(mesh.vertex_count());
        let numbers = |distances: &[f64]| -> Vec<u32> {
            (0..).zip(distances).filter(|(_, now)| is_far(**now)).map(|(i, _)| i).collect()
        };
        let corners = forward.chain(numbers(middles)).flat_map(|t| mesh.triangle_vertices(t as usize));
        corners.chain(numbers(vertices)).collect()
    }
}

/// Squared distances of points from the original, of those that are given.
fn distances_sq(there: &Bvh<'_>, count: usize, point: impl Fn(usize) -> Option<DVec3> + Sync) -> Vec<Option<f64>> {
    in_chunks(count, |range| {
        let mut searcher = there.searcher();
        let distance_sq =
            |p: DVec3, searcher: &mut Searcher<'_>| searcher.closest(p).map_or(0.0, |found| found.distance_sq);
        range.map(|i| point(i).map(|p| distance_sq(p, &mut searcher))).collect()
    })
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
