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
use crate::measure::triangle::{at, closest_on_triangle};
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
/// [round](RefitOptions::rounds); some 130 bytes per sample.
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
    let Samples { samples, at_once, is_few } = Samples::new(mesh, original, there.triangles_in_space_order(), options);
    // fitted to as well, vertices would pull the surface outwards; but largest distances are mostly there
    let (vertices, of_sample) = vertices(original, there.triangles_in_space_order(), samples.len());
    let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
    let sides = Sides::new(&triangles);
    let fixed = sides.fixed_vertices(&triangles, mesh.vertex_count(), &options.fixed);
    let (mut found, mut far) = first_nearest(mesh, &sides, (&samples, at_once), (&vertices, &of_sample));
    let before = Errors::of(mesh, &there, [&found, &far], &samples, None);
    (report.rms_before, report.max_before) = (before.rms, before.max);
    (report.rms_after, report.max_after) = (before.rms, before.max);
    let mut moved = Moved::new(mesh);
    for round in 1..=options.rounds {
        tell(round)?;
        moved.add(&moves(&triangles, &samples, &found, &fixed), mesh);
        if round < options.rounds {
            follow_samples(&moved.mesh(mesh), &sides, &samples, &mut found, is_few);
        }
    }
    let mut result = moved.mesh(mesh);
    follow_samples(&result, &sides, &samples, &mut found, is_few);
    follow(&result, &sides, &vertices, &mut far);
    let mut is_exact = false;
    let mut after = Errors::of(&result, &there, [&found, &far], &samples, Some(&before));
    for _ in 0..=HELD_BACK {
        if after.max <= before.max {
            mesh.positions = result.positions;
            (report.rms_after, report.max_after) = (after.rms, after.max);
            break;
        }
        tell(options.rounds)?;
        if !is_exact {
            // what was followed may be nearer to another triangle
            let here = Bvh::new(&result);
            let is_far = |found: &ClosestPoint| found.distance_sq > before.max * before.max;
            search_again(&here, &samples, &mut found, is_far);
            search_again(&here, &vertices, &mut far, is_far);
            drop(here);
            after = Errors::of(&result, &there, [&found, &far], &samples, Some(&after));
            is_exact = true;
            continue;
        }
        moved.take_back(mesh, &after.vertices_beyond(before.max, &before, mesh));
        let held = moved.mesh(mesh);
        let has_moved = |v: u32| held.positions[v as usize] != result.positions[v as usize];
        let is_stale = |t: usize| mesh.triangle_vertices(t).into_iter().any(has_moved);
        let stale: Vec<bool> = (0..mesh.triangle_count()).into_par_iter().map(is_stale).collect();
        let own = Bvh::new(&held);
        let is_stale = |found: &ClosestPoint| stale[found.triangle as usize];
        search_again(&own, &samples, &mut found, is_stale);
        search_again(&own, &vertices, &mut far, is_stale);
        drop(own);
        after = after.updated(&held, &there, [&found, &far], &samples, &stale, has_moved);
        result = held;
    }
    Ok(report)
}

/// Points of the original to fit to.
struct Samples {
    samples: Vec<Sample>,
    /// So many after one another lie on the same triangle.
    at_once: usize,
    /// Fewer than triangles.
    is_few: bool,
}

impl Samples {
    /// Of each triangle the same where that is not too many, as rules for integrals want them, else at random.
    fn new(mesh: &Mesh, original: &Mesh, order: impl ExactSizeIterator<Item = u32>, options: &RefitOptions) -> Self {
        let wanted = mesh.vertex_count() as f64 * options.samples_per_vertex;
        let per_triangle = wanted / original.triangle_count() as f64;
        let rule: &[[f64; 3]] = if per_triangle >= 2.0 {
            &THREE_POINTS
        } else if per_triangle >= 0.5 {
            &[[1.0 / 3.0; 3]]
        } else {
            let count = wanted.ceil() as u64;
            let sampler = SurfaceSampler::new(original, order, options.seed);
            let samples = in_chunks(count as usize, |range| {
                let samples = sampler.samples(count, range.start as u64..range.end as u64);
                let normal = |triangle: u32| scaled_normal(original, triangle).normalize_or_zero();
                samples.map(|s| Sample { point: s.point, normal: normal(s.triangle), weight: 1.0 }).collect()
            });
            return Self { samples, at_once: 1, is_few: true };
        };
        let order: Vec<u32> = order.collect();
        let samples = in_chunks(order.len(), |range| {
            let of_triangle = |&t: &u32| {
                let (corners, scaled) = (original.triangle_points(t as usize), scaled_normal(original, t));
                let (normal, weight) = (scaled.normalize_or_zero(), scaled.length());
                rule.iter().map(move |&place| Sample { point: at(corners, place), normal, weight })
            };
            order[range].iter().flat_map(of_triangle).collect()
        });
        Self { samples, at_once: rule.len(), is_few: false }
    }
}

/// A rule that is exact for quadratic functions, as squared distances are where one triangle lies on another.
const THREE_POINTS: [[f64; 3]; 3] = {
    const A: f64 = 2.0 / 3.0;
    const B: f64 = 1.0 / 6.0;
    [[A, B, B], [B, A, B], [B, B, A]]
};

/// How often moves are taken back where the largest distance has grown, before all are.
const HELD_BACK: usize = 4;

/// A point of the original, and the normal there.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: DVec3,
    normal: DVec3,
    /// What it counts.
    weight: f64,
}

fn scaled_normal(mesh: &Mesh, triangle: u32) -> DVec3 {
    let [a, b, c] = mesh.triangle_points(triangle as usize);
    (b - a).cross(c - a)
}

/// The vertices that triangles use, in the order in which these name them first; and of each, a sample that is not far if
/// there are so many in the same order.
fn vertices(mesh: &Mesh, order: impl ExactSizeIterator<Item = u32>, samples: usize) -> (Vec<Sample>, Vec<u32>) {
    let mut known = vec![false; mesh.vertex_count()];
    let triangles = order.len();
    let corners = order.enumerate().flat_map(|(i, t)| mesh.triangle_vertices(t as usize).map(|v| (i, v)));
    let new = corners.filter(|&(_, v)| !std::mem::replace(&mut known[v as usize], true));
    let sample = |v: u32| Sample { point: vertex(mesh, v as usize), normal: DVec3::ZERO, weight: 0.0 };
    new.map(|(i, v)| (sample(v), (i * samples / triangles) as u32)).unzip()
}

/// Samples or points in a piece of work.
const CHUNK: usize = 1 << 13;

/// The results of all chunks, one after the other.
fn in_chunks<T: Clone + Send>(count: usize, work: impl Fn(std::ops::Range<usize>) -> Vec<T> + Sync) -> Vec<T> {
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(|i| work(i * CHUNK..count.min((i + 1) * CHUNK)));
    chunks.collect::<Vec<_>>().concat()
}

/// The points of the mesh that are nearest to the samples, `at_once` of which lie on one triangle of the original, and to
/// vertices that lie near given samples.
///
/// One search serves several points, which are [followed](follow) from there. Those that are further away by that than
/// the rest are searched for themselves, so that the largest distance of all is the true one.
fn first_nearest(
    mesh: &Mesh,
    sides: &Sides,
    (samples, at_once): (&[Sample], usize),
    (vertices, of_sample): (&[Sample], &[u32]),
) -> (Vec<ClosestPoint>, Vec<ClosestPoint>) {
    let here = Bvh::new(mesh);
    let mut found = in_chunks(samples.len() / at_once, |range| {
        let mut searcher = here.searcher();
        let several = |i: usize| {
            let closest = searcher.closest(samples[i * at_once].point).expect("there are triangles");
            std::iter::repeat_n(closest, at_once)
        };
        range.flat_map(several).collect()
    });
    let most = found.iter().step_by(at_once).map(|found| found.distance_sq).fold(0.0, f64::max);
    let mut far: Vec<ClosestPoint> = of_sample.iter().map(|&i| found[i as usize]).collect();
    if at_once > 1 {
        follow(mesh, sides, samples, &mut found);
    }
    follow(mesh, sides, vertices, &mut far);
    let is_far = |found: &ClosestPoint| found.distance_sq > most;
    search_again(&here, samples, &mut found, is_far);
    search_again(&here, vertices, &mut far, is_far);
    (found, far)
}

/// Brings the nearest points up to date after vertices have moved: from the triangle that was nearest, over sides to
/// neighbours as long as these are nearer. Good enough to fit to; what is nearest may be missed at folds, so the distances
/// found are never too small.
fn follow(mesh: &Mesh, sides: &Sides, samples: &[Sample], found: &mut [ClosestPoint]) {
    samples.par_chunks(CHUNK).zip(found.par_chunks_mut(CHUNK)).for_each(|(samples, found)| {
        for (sample, found) in samples.iter().zip(found) {
            let mut best = on_triangle(mesh, found.triangle, sample.point);
            for _ in 0..MOST_STEPS {
                let before = best.triangle;
                for (corner, &weight) in best.barycentric.clone().iter().enumerate() {
                    // the point is on the side opposite to the corner
                    let neighbor = sides.opposite[before as usize][corner];
                    if weight > 0.0 || neighbor == u32::MAX {
                        continue;
                    }
                    let other = on_triangle(mesh, neighbor, sample.point);
                    if other.distance_sq < best.distance_sq {
                        best = other;
                    }
                }
                if best.triangle == before {
                    break;
                }
            }
            *found = best;
        }
    });
}

/// As [`follow`]; where samples are few, what is at the side of a triangle then is searched for.
fn follow_samples(mesh: &Mesh, sides: &Sides, samples: &[Sample], found: &mut [ClosestPoint], is_few: bool) {
    follow(mesh, sides, samples, found);
    if is_few {
        search_again(&Bvh::new(mesh), samples, found, |found| found.barycentric.contains(&0.0));
    }
}

/// Triangles that [`follow`] goes on to.
const MOST_STEPS: usize = 16;

fn on_triangle(mesh: &Mesh, triangle: u32, p: DVec3) -> ClosestPoint {
    let corners = mesh.triangle_points(triangle as usize);
    let (barycentric, distance_sq) = closest_on_triangle(p, corners);
    ClosestPoint { triangle, barycentric, point: at(corners, barycentric), distance_sq }
}

/// Looks anew for some of the nearest points. (Those on triangles that have not moved are as near as before, or nearer.)
fn search_again(
    here: &Bvh<'_>,
    samples: &[Sample],
    found: &mut [ClosestPoint],
    which: impl Fn(&ClosestPoint) -> bool + Sync,
) {
    samples.par_chunks(CHUNK).zip(found.par_chunks_mut(CHUNK)).for_each(|(samples, found)| {
        let mut searcher = here.searcher();
        for (sample, found) in samples.iter().zip(found).filter(|(_, found)| which(found)) {
            *found = searcher.closest(sample.point).expect("there are triangles");
        }
    });
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
fn moves(triangles: &[[u32; 3]], samples: &[Sample], found: &[ClosestPoint], fixed: &[bool]) -> Vec<DVec3> {
    let row = |i: usize| Row {
        weights: found[i].barycentric,
        normal: samples[i].normal,
        wanted: samples[i].point - found[i].point,
        weight: samples[i].weight,
    };
    Fit::new(triangles, found.iter().map(|found| found.triangle), row, fixed).solve()
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
    /// Of each vertex of the mesh, and of the middle of each of its triangles: squared distance from the original, and the
    /// place of the triangle there.
    backward: Vec<(f64, u32)>,
}

impl Errors {
    /// `found` are the nearest points of samples and of vertices of the original, `before` what was known before the
    /// vertices moved.
    fn of(
        mesh: &Mesh,
        there: &Bvh<'_>,
        found: [&[ClosestPoint]; 2],
        samples: &[Sample],
        before: Option<&Self>,
    ) -> Self {
        let guess = |i: usize| before.map(|before| before.backward[i].1);
        let vertices = mesh.vertex_count();
        let backward = in_chunks(vertices + mesh.triangle_count(), |range| {
            let mut searcher = there.searcher();
            let point = |i: usize| if i < vertices { vertex(mesh, i) } else { middle(mesh, i - vertices) };
            range.map(|i| nearest_place(&mut searcher, point(i), guess(i))).collect()
        });
        Self::summed(found, samples, backward)
    }

    /// The same after some vertices have moved, and with them the triangles that are stale.
    fn updated(
        &self,
        mesh: &Mesh,
        there: &Bvh<'_>,
        found: [&[ClosestPoint]; 2],
        samples: &[Sample],
        stale: &[bool],
        has_moved: impl Fn(u32) -> bool + Sync,
    ) -> Self {
        let vertices = mesh.vertex_count();
        let backward = in_chunks(self.backward.len(), |range| {
            let mut searcher = there.searcher();
            let place = |i: usize| {
                let known = self.backward[i];
                let point = if i < vertices {
                    has_moved(i as u32).then(|| vertex(mesh, i))
                } else {
                    stale[i - vertices].then(|| middle(mesh, i - vertices))
                };
                point.map_or(known, |point| nearest_place(&mut searcher, point, Some(known.1)))
            };
            range.map(place).collect()
        });
        Self::summed(found, samples, backward)
    }

    fn summed([found, far]: [&[ClosestPoint]; 2], samples: &[Sample], backward: Vec<(f64, u32)>) -> Self {
        let squares = found.iter().zip(samples).map(|(found, sample)| found.distance_sq * sample.weight);
        let weight: f64 = samples.iter().map(|sample| sample.weight).sum();
        let rms = (squares.sum::<f64>() / weight.max(f64::MIN_POSITIVE)).sqrt();
        let forward: Vec<_> = found.iter().chain(far).map(|found| (found.distance_sq, found.triangle)).collect();
        let max = forward.iter().chain(&backward).map(|&(distance_sq, _)| distance_sq).fold(0.0, f64::max).sqrt();
        Self { rms, max, forward, backward }
    }

    /// Vertices of the mesh that are further away than `most`, or corners of a triangle that is or that is nearest to a point
    /// that is; `before` are the errors before the moves, whose nearest triangles count, too.
    fn vertices_beyond(&self, most: f64, before: &Self, mesh: &Mesh) -> Vec<u32> {
        let is_far = |distance_sq: f64| distance_sq > most * most;
        let far = self.forward.iter().zip(&before.forward).filter(|((now, _), _)| is_far(*now));
        let forward = far.flat_map(|(&(_, now), &(_, then))| [now, then]);
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
