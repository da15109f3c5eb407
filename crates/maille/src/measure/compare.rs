//! The distance between two surfaces, by sampling.

use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;

use super::bvh::{Bvh, ClosestPoint, Searcher};
use super::chunks::{map_chunks, sum};
use super::figures::{Figures, area};
use super::sample::SurfaceSampler;
use super::triangle::scaled_normal;
use crate::control::Cancelled;
use crate::mesh::MeshError;
use crate::{Control, Mesh};

/// How to compare.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareOptions {
    /// Samples on each of the two surfaces, spread evenly over its area. The figures of two runs with different seeds
    /// differ by far less than a percent with the default.
    pub samples: u64,
    /// Moves the samples.
    pub seed: u64,
    /// Also looks for the maximum from points along all edges, as densely as from the samples. Vertices always count.
    pub edges: bool,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { samples: 1_000_000, seed: 0, edges: false }
    }
}

/// How far two surfaces are apart, both ways, and how each of them is.
///
/// All lengths are in model units; [`relative`](Self::relative) turns them into shares of the diagonal.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// From A to B.
    pub forward: Deviation,
    /// From B to A.
    pub backward: Deviation,
    /// Length of the diagonal of the box around A's triangles.
    pub diagonal: f64,
    /// Figures of A.
    pub a: Figures,
    /// Figures of B.
    pub b: Figures,
}

impl Comparison {
    /// Mean distance: the larger of both directions.
    pub fn mean(&self) -> f64 {
        self.forward.mean.max(self.backward.mean)
    }

    /// Root mean square distance: the larger of both directions.
    pub fn rms(&self) -> f64 {
        self.forward.rms.max(self.backward.rms)
    }

    /// Hausdorff distance as far as the samples show it: the larger of both directions.
    pub fn max(&self) -> f64 {
        self.forward.max.max(self.backward.max)
    }

    /// Mean angle between the normals, in degrees: the larger of both directions.
    pub fn normal_deg(&self) -> f64 {
        self.forward.normal.mean_deg.max(self.backward.normal.mean_deg)
    }

    /// A distance as a share of [`diagonal`](Self::diagonal); infinite or NaN when A has no extent.
    pub fn relative(&self, distance: f64) -> f64 {
        distance / self.diagonal
    }
}

/// One-sided distance from a surface to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Mean over the area.
    pub mean: f64,
    /// Root of the mean square over the area.
    pub rms: f64,
    /// Largest over all samples and all vertices (and edges, if asked for).
    pub max: f64,
    /// The point of this surface that is farthest from the other one.
    pub max_from: [f64; 3],
    /// The point of the other surface nearest to [`max_from`](Self::max_from).
    pub max_to: [f64; 3],
    /// Angles between the two surfaces.
    pub normal: NormalDeviation,
    /// Number of samples behind the means.
    pub samples: u64,
    /// Number of other points (vertices, points on edges) behind the maximum.
    pub extra_points: u64,
}

/// Angles between the normals of the triangles at corresponding points, by winding: 180 degrees is a surface turned
/// inside out. Points where either triangle has no area are left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalDeviation {
    /// Mean over the area, in degrees.
    pub mean_deg: f64,
    /// Root of the mean square, in degrees.
    pub rms_deg: f64,
    /// Largest over the samples, in degrees.
    pub max_deg: f64,
    /// Share of the area whose counterpart faces the other way.
    pub flipped_share: f64,
}

/// One of the two meshes compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say all")]
pub enum Side {
    A,
    B,
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::A => "first",
            Self::B => "second",
        })
    }
}

/// Why two meshes could not be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// An option makes no sense.
    #[error("option {name}: {reason}")]
    InvalidOption {
        /// Its name.
        name: &'static str,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// A mesh has no triangles.
    #[error("the {side} mesh has no triangles")]
    Empty {
        /// Which.
        side: Side,
    },
    /// A triangle has a corner that is nowhere.
    #[error("the {side} mesh has a position that is not finite at vertex {vertex}, which triangle {triangle} uses")]
    NotFinite {
        /// Which mesh.
        side: Side,
        /// Which triangle.
        triangle: u32,
        /// Which of its vertices.
        vertex: u32,
    },
    /// A mesh breaks an invariant.
    #[error("the {side} mesh: {error}")]
    Mesh {
        /// Which.
        side: Side,
        /// What is wrong with it.
        error: MeshError,
    },
    /// The work was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Measures the distance between two surfaces, both ways, as Metro does: from samples of each to the nearest point of the
/// other, which is exact.
///
/// Means are taken over the samples, so over the area; the maximum also over all vertices that a triangle uses. The
/// result is the same, to the bit, for any number of threads, and works for any scale and offset.
///
/// Cost: one search per sample and vertex, about a microsecond each on one core when the surfaces are near each other;
/// some 60 bytes per triangle of both meshes.
///
/// # Errors
/// [`CompareError`] for no samples, meshes that are empty, break their invariants or have triangles with positions that
/// are not finite, and on cancellation.
///
/// # References
/// Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998. We differ: strata of equal area
/// with a low-discrepancy sequence in place of random points, and a box hierarchy in place of a grid.
///
/// # Examples
/// ```
/// use maille::{Control, measure::{CompareOptions, compare}, mesh::shapes};
/// let (fine, coarse) = (shapes::sphere(5), shapes::sphere(3));
/// let options = CompareOptions { samples: 10_000, ..CompareOptions::default() };
/// let comparison = compare(&fine, &coarse, &options, Control::default())?;
/// assert!(comparison.max() < 0.02 && comparison.mean() < comparison.rms());
/// # Ok::<(), maille::measure::CompareError>(())
/// ```
pub fn compare(a: &Mesh, b: &Mesh, options: &CompareOptions, control: Control<'_>) -> Result<Comparison, CompareError> {
    if options.samples == 0 {
        return Err(CompareError::InvalidOption { name: "samples", reason: "must be at least 1" });
    }
    check(a, Side::A)?;
    check(b, Side::B)?;
    control.report("preparing", 0.0);
    let surface_a = Surface::new(a);
    let surface_b = Surface::new(b);
    control.report("preparing", 0.5);
    let (figures_a, figures_b) = (Figures::of(a), Figures::of(b));
    control.report("preparing", 1.0);
    Ok(Comparison {
        forward: surface_a.deviation_from(&surface_b, options, &Watch::new(control, "measuring from A to B"))?,
        backward: surface_b.deviation_from(&surface_a, options, &Watch::new(control, "measuring from B to A"))?,
        diagonal: surface_a.bvh.diagonal(),
        a: figures_a,
        b: figures_b,
    })
}

/// Distance of every vertex of `a` from the surface of `b`, in model units; of vertices that no triangle uses, too.
///
/// # Errors
/// As [`compare`].
pub fn distances_at_vertices(a: &Mesh, b: &Mesh, control: Control<'_>) -> Result<Vec<f32>, CompareError> {
    check(a, Side::A)?;
    check(b, Side::B)?;
    let bvh = Bvh::new(b);
    let count = a.vertex_count();
    let watch = Watch::new(control, "measuring vertices");
    let chunks = map_chunks(count, |range| {
        let work = range.len();
        let mut searcher = bvh.searcher();
        let distance = |v: usize| nearest(&mut searcher, position(a, v as u32)).distance_sq.sqrt() as f32;
        watch.run(work, count, || range.map(distance).collect::<Vec<f32>>())
    });
    let chunks = chunks.into_iter().collect::<Result<Vec<_>, Cancelled>>()?;
    Ok(chunks.concat())
}

fn check(mesh: &Mesh, side: Side) -> Result<(), CompareError> {
    mesh.check().map_err(|error| CompareError::Mesh { side, error })?;
    if mesh.triangles.is_empty() {
        return Err(CompareError::Empty { side });
    }
    let is_finite = |v: u32| mesh.positions[v as usize].iter().all(|x| x.is_finite());
    for triangle in 0..mesh.triangle_count() {
        if let Some(&vertex) = mesh.triangle_vertices(triangle).iter().find(|&&v| !is_finite(v)) {
            return Err(CompareError::NotFinite { side, triangle: triangle as u32, vertex });
        }
    }
    Ok(())
}

fn position(mesh: &Mesh, vertex: u32) -> DVec3 {
    glam::Vec3::from(mesh.positions[vertex as usize]).as_dvec3()
}

fn nearest(searcher: &mut Searcher<'_>, p: DVec3) -> ClosestPoint {
    searcher.closest(p).expect("the mesh has triangles, all of them finite: checked before")
}

/// Tells of the progress of work done on many threads, and of the wish to stop it.
struct Watch<'c> {
    control: Control<'c>,
    stage: &'static str,
    done: AtomicUsize,
    turn: Mutex<()>,
}

impl<'c> Watch<'c> {
    fn new(control: Control<'c>, stage: &'static str) -> Self {
        Self { control, stage, done: AtomicUsize::new(0), turn: Mutex::new(()) }
    }

    /// Does a piece of the work, `size` of `total`, unless the whole is cancelled.
    fn run<T>(&self, size: usize, total: usize, work: impl FnOnce() -> T) -> Result<T, Cancelled> {
        if self.control.is_cancelled() {
            return Err(Cancelled);
        }
        let result = work();
        let done = self.done.fetch_add(size, Ordering::Relaxed) + size;
        // one thread at a time; whoever finds another one reporting has nothing newer to say
        if let Ok(_turn) = self.turn.try_lock() {
            self.control.report(self.stage, done as f32 / total as f32);
        }
        Ok(result)
    }
}

/// A mesh and its box hierarchy.
struct Surface<'m> {
    mesh: &'m Mesh,
    bvh: Bvh<'m>,
}

impl<'m> Surface<'m> {
    fn new(mesh: &'m Mesh) -> Self {
        Self { mesh, bvh: Bvh::new(mesh) }
    }

    fn normal(&self, triangle: u32) -> DVec3 {
        scaled_normal(self.mesh.triangle_points(triangle as usize))
    }

    /// Distance of this surface from another one.
    fn deviation_from(&self, to: &Self, options: &CompareOptions, watch: &Watch<'_>) -> Result<Deviation, Cancelled> {
        let vertices = self.vertices_in_space_order();
        let edges = if options.edges { Some(EdgePoints::new(self, options.samples)) } else { None };
        let samples = usize::try_from(options.samples).unwrap_or(usize::MAX);
        let total = samples + vertices.len() + edges.as_ref().map_or(0, |edges| edges.order.len());
        let sampler = SurfaceSampler::new(self.mesh, self.bvh.triangles_in_space_order(), options.seed);
        let measure = |count: usize, tally: &(dyn Fn(Range<usize>, &mut Searcher<'_>, &mut Tally) + Sync)| {
            let parts = map_chunks(count, |range| {
                watch.run(range.len(), total, || {
                    let mut part = Tally::default();
                    tally(range, &mut to.bvh.searcher(), &mut part);
                    part
                })
            });
            parts.into_iter().try_fold(Tally::default(), |sum, part| Ok(sum.plus(&part?)))
        };
        let by_area = measure(samples, &|range, searcher, tally| {
            for sample in sampler.samples(options.samples, range.start as u64..range.end as u64) {
                let found = nearest(searcher, sample.point);
                tally.add(sample.point, &found);
                tally.add_normals(self.normal(sample.triangle), to.normal(found.triangle));
            }
        })?;
        let mut extra = measure(vertices.len(), &|range, searcher, tally| {
            for &vertex in &vertices[range] {
                let p = position(self.mesh, vertex);
                tally.add(p, &nearest(searcher, p));
            }
        })?;
        if let Some(edges) = edges {
            let on_edges = measure(edges.order.len(), &|range, searcher, tally| {
                for &triangle in &edges.order[range] {
                    edges.for_each_point(triangle, |p| tally.add(p, &nearest(searcher, p)));
                }
            })?;
            extra = extra.plus(&on_edges);
        }
        Ok(by_area.into_deviation(&extra))
    }

    /// The vertices that triangles use, neighbours mostly next to each other.
    fn vertices_in_space_order(&self) -> Vec<u32> {
        let mut is_new = vec![true; self.mesh.vertex_count()];
        let mut vertices = Vec::new();
        for triangle in self.bvh.triangles_in_space_order() {
            for vertex in self.mesh.triangle_vertices(triangle as usize) {
                if std::mem::replace(&mut is_new[vertex as usize], false) {
                    vertices.push(vertex);
                }
            }
        }
        vertices
    }
}

/// Points along the sides of triangles.
struct EdgePoints<'m> {
    mesh: &'m Mesh,
    order: Vec<u32>,
    /// Length of a side that one point stands for.
    spacing: f64,
}

impl<'m> EdgePoints<'m> {
    /// Spaces the points on each side twice as far as the samples of the area lie apart (an edge has two sides), but so
    /// that they are not more than the samples and one to each side.
    fn new(surface: &Surface<'m>, samples: u64) -> Self {
        let mesh = surface.mesh;
        let length = sum(mesh.triangle_count(), |t| {
            let [a, b, c] = mesh.triangle_points(t);
            a.distance(b) + b.distance(c) + c.distance(a)
        });
        let spacing = (2.0 * (area(mesh) / samples as f64).sqrt()).max(length / samples as f64);
        Self { mesh, order: surface.bvh.triangles_in_space_order().collect(), spacing }
    }

    /// Calls `visit` for the points on the three sides of a triangle.
    ///
    /// They lie at the first quarter of equal pieces: the two triangles of an edge walk it in opposite directions, and
    /// so take different points.
    fn for_each_point(&self, triangle: u32, mut visit: impl FnMut(DVec3)) {
        let [a, b, c] = self.mesh.triangle_points(triangle as usize);
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let pieces = (from.distance(to) / self.spacing).ceil().max(1.0);
            for i in 0..pieces as u64 {
                visit(from.lerp(to, (i as f64 + 0.25) / pieces));
            }
        }
    }
}

/// Sums over points.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    points: u64,
    sum: f64,
    sum_sq: f64,
    max_sq: f64,
    max_from: DVec3,
    max_to: DVec3,
    angles: AngleTally,
}

/// Sums over angles, in radians.
#[derive(Debug, Clone, Copy, Default)]
struct AngleTally {
    points: u64,
    sum: f64,
    sum_sq: f64,
    max: f64,
    flipped: u64,
}

impl Tally {
    fn add(&mut self, from: DVec3, found: &ClosestPoint) {
        if self.points == 0 || found.distance_sq > self.max_sq {
            (self.max_sq, self.max_from, self.max_to) = (found.distance_sq, from, found.point);
        }
        self.points += 1;
        self.sum += found.distance_sq.sqrt();
        self.sum_sq += found.distance_sq;
    }

    fn add_normals(&mut self, a: DVec3, b: DVec3) {
        // by the tangent: exact for small angles, where the cosine is not
        let (sine, cosine) = (a.cross(b).length(), a.dot(b));
        if sine == 0.0 && cosine == 0.0 {
            return;
        }
        let angle = sine.atan2(cosine);
        self.angles.points += 1;
        self.angles.sum += angle;
        self.angles.sum_sq += angle * angle;
        self.angles.max = self.angles.max.max(angle);
        self.angles.flipped += u64::from(cosine < 0.0);
    }

    fn plus(&self, other: &Self) -> Self {
        let is_farther = other.points > 0 && (self.points == 0 || other.max_sq > self.max_sq);
        let farther = if is_farther { other } else { self };
        let (a, b) = (&self.angles, &other.angles);
        Self {
            points: self.points + other.points,
            sum: self.sum + other.sum,
            sum_sq: self.sum_sq + other.sum_sq,
            max_sq: farther.max_sq,
            max_from: farther.max_from,
            max_to: farther.max_to,
            angles: AngleTally {
                points: a.points + b.points,
                sum: a.sum + b.sum,
                sum_sq: a.sum_sq + b.sum_sq,
                max: a.max.max(b.max),
                flipped: a.flipped + b.flipped,
            },
        }
    }

    /// The means of these points and the maximum of these and others.
    fn into_deviation(self, extra: &Self) -> Deviation {
        let both = self.plus(extra);
        let points = self.points as f64;
        let angles = &self.angles;
        let angle_points = angles.points.max(1) as f64;
        Deviation {
            mean: self.sum / points,
            rms: (self.sum_sq / points).sqrt(),
            max: both.max_sq.sqrt(),
            max_from: both.max_from.to_array(),
            max_to: both.max_to.to_array(),
            normal: NormalDeviation {
                mean_deg: (angles.sum / angle_points).to_degrees(),
                rms_deg: (angles.sum_sq / angle_points).sqrt().to_degrees(),
                max_deg: angles.max.to_degrees(),
                flipped_share: angles.flipped as f64 / angle_points,
            },
            samples: self.points,
            extra_points: extra.points,
        }
    }
}
