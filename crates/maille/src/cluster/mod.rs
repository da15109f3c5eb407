//! Vertex clustering: for meshes so large, or in such a hurry, that edge collapse takes too long.
//!
//! Vertices that are near one another become one, whatever the topology: those in one cell of a grid. Triangles whose
//! corners are then no longer in three cells vanish, and so do repeated ones. [`cluster`] finds the grid that leaves the
//! wanted number of triangles.
//!
//! | file | holds |
//! |---|---|
//! | `lattice` | the uniform grid, and how many triangles one leaves |
//! | `search` | the search for a grid |
//! | `cells` | who is in a cell, the sums over its triangles, where its vertex goes |
//! | `weights` | which vertices matter (Rossignac and Borrel's grading) |
//! | `floating` | cells about the vertices that matter most |
//! | `rebuild` | the mesh of the cells: triangles, wedges, attributes |

mod cells;
mod floating;
mod lattice;
mod rebuild;
mod search;
#[cfg(test)]
mod tests;
mod weights;

use std::borrow::Cow;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::control::Cancelled;
use crate::mesh::MeshError;
use crate::{Control, Mesh};
use cells::{LOCKED, NONE};
use lattice::{Bounds, Lattice};

/// How vertices are gathered, and which place stands for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum ClusterMethod {
    /// A uniform grid; the vertex of the largest weight stands for all in its cell (Rossignac and Borrel 1993; seed 000,
    /// 2.2.1). Weights are the length of the longest edge times `cos(t / 2)`, t the largest angle between two edges
    /// (Low and Tan 1997): large features and sharp ones.
    Vertex,
    /// A uniform grid and the mean of the corners in each cell, weighted by the area of their triangles.
    Mean,
    /// Cells centred on vertices, that of the largest weight first, which also stands for all in its cell; a vertex in
    /// several cells goes to the nearest (Low and Tan 1997; seed 000, 2.5.1). Slower, and less at the mercy of the grid.
    FloatingCells,
    /// A uniform grid and the place nearest to the planes of all triangles at the cell (Lindstrom 2000): as fast as the mean,
    /// and by far the most accurate.
    #[default]
    Quadric,
}

impl ClusterMethod {
    /// All methods with the names the command line gives them.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("vertex-clustering", Self::Vertex),
        ("mean-clustering", Self::Mean),
        ("floating-cells", Self::FloatingCells),
        ("quadric-clustering", Self::Quadric),
    ];
}

/// How to [`cluster`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ClusterOptions {
    /// The largest number of triangles to be left; the result is as near below it as a grid gets. At least this or
    /// `max_error` must be given.
    pub triangles: Option<usize>,
    /// No vertex moves further than this, in model units: it bounds the cells, and goes before `triangles`.
    pub max_error: Option<f64>,
    /// How vertices are gathered, and which place stands for them.
    pub method: ClusterMethod,
    /// One entry per vertex: vertices that must stay, and with which none is merged. Empty: none.
    pub locked: Vec<bool>,
    /// One factor per vertex on its weight, or on that of its triangles (0 or more; 1 is neutral). Empty: all 1.
    pub importance: Vec<f32>,
}

/// What [`cluster`] did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClusterReport {
    /// Triangles before.
    pub triangles_in: usize,
    /// Triangles after. More than were asked for if `max_error` forbids it, or if all coarser grids tried leave nothing.
    pub triangles_out: usize,
    /// Spacing of the cells, in model units; 0 if nothing was to be done.
    pub cell_size: f64,
    /// How far a vertex moved at most, in model units.
    pub error: f64,
}

/// Why clustering refused to start, or did not end.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// An option makes no sense.
    #[error("option {name}: {reason}")]
    InvalidOption {
        /// Its name.
        name: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The mesh breaks an invariant.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A position is not finite.
    #[error("vertex {vertex} is not finite; repair the mesh first")]
    NotFinite {
        /// Which vertex.
        vertex: usize,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Reduces a triangle mesh by vertex clustering.
///
/// Any triangles will do, and what comes out may be non-manifold, as vertices merge whether or not there is an edge between
/// them. Cells of the uniform grid are truncated octahedra about the points of a body-centred lattice, not cubes: they are
/// rounder, which takes a quarter off the error. Triangles keep their materials and attributes. Wedges of a cell become
/// one where triangles within the cell join them, so seams stay; their attributes are averaged (quadrics, mean) or those of
/// the vertex that stands for the cell; joints and their weights are those of the nearest wedge.
///
/// The result does not depend on the number of threads. It has no unused vertices, and its triangles keep their order. A mesh
/// that has no more triangles than wanted stays as it is.
///
/// Cost: linear, some 560 instructions a triangle where a tenth is left (`meshopt_simplifySloppy`: 390; floating cells: far
/// more), and some 40 bytes per triangle.
///
/// # Errors
/// [`ClusterError`] for options that make no sense, a mesh that breaks its invariants, or cancellation; the mesh is
/// unchanged then.
///
/// # References
/// Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993; Low and Tan, "Model
/// simplification using vertex-clustering", I3D 1997; Lindstrom, "Out-of-core simplification of large polygonal models",
/// SIGGRAPH 2000; seed 000, 2.2.1; seed 001, 2.2.1. We differ in the lattice, weight quadrics by area and not by its square, and
/// pull optima to the mean of the cell instead of cutting small eigenvalues off.
///
/// # Examples
/// ```
/// use maille::cluster::{ClusterOptions, cluster};
/// let mut mesh = maille::mesh::shapes::sphere(5);
/// let options = ClusterOptions { triangles: Some(500), ..Default::default() };
/// let report = cluster(&mut mesh, &options, Default::default())?;
/// assert!((450..=500).contains(&mesh.triangle_count()));
/// assert!(report.error < 1.2 * report.cell_size);
/// # Ok::<(), maille::cluster::ClusterError>(())
/// ```
pub fn cluster(mesh: &mut Mesh, options: &ClusterOptions, control: Control<'_>) -> Result<ClusterReport, ClusterError> {
    cluster_mapped(mesh, options, control).map(|(report, _)| report)
}

/// As [`cluster`]; also tells for each vertex the one that it is now part of, `u32::MAX` if that has no triangle. Nothing is
/// told if nothing was done.
pub(crate) fn cluster_mapped(
    mesh: &mut Mesh,
    options: &ClusterOptions,
    control: Control<'_>,
) -> Result<(ClusterReport, Vec<u32>), ClusterError> {
    mesh.check()?;
    check_options(mesh, options)?;
    let triangles_in = mesh.triangle_count();
    let mut report = ClusterReport { triangles_in, triangles_out: triangles_in, cell_size: 0.0, error: 0.0 };
    let target = options.triangles.unwrap_or(0);
    if target >= triangles_in {
        return Ok((report, Vec::new()));
    }
    let input = Input::new(mesh, options);
    let tell = |done: f32| {
        control.report("clustering", done);
        if control.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    };
    let mut wanted = target;
    let mut best: Option<(Clusters, Vec<u32>)> = None;
    for round in 0..ROUNDS {
        tell(round as f32 / (ROUNDS + 1) as f32)?;
        let clusters = input.clusters(wanted, options);
        let kept = rebuild::without_doubles(&input, &clusters);
        let (left, doubles) = (kept.len(), clusters.survivors.len() - kept.len());
        if best.is_some() && left > target {
            break;
        }
        best = Some((clusters, kept));
        // the grid was chosen with doubles in the count
        if left == 0 || left as f64 > NEAR_TARGET * target as f64 || doubles == 0 {
            break;
        }
        wanted = (wanted as f64 * target as f64 / left as f64) as usize;
    }
    let (clusters, kept) = best.expect("there is at least one round");
    tell(ROUNDS as f32 / (ROUNDS + 1) as f32)?;
    report.triangles_out = kept.len();
    report.cell_size = clusters.cell_size;
    report.error = clusters.error(&input);
    let (rebuilt, vertex_of_cell) = rebuild::rebuild(&input, &clusters, &kept, options);
    let mut map = vec![NONE; mesh.vertex_count()];
    for (&vertex, &cell) in mesh.wedge_vertices.iter().zip(&clusters.cells).filter(|&(_, &cell)| cell != NONE) {
        map[vertex as usize] = vertex_of_cell[cell as usize];
    }
    *mesh = rebuilt;
    Ok((report, map))
}

/// How often the grid is made finer because of repeated triangles, which do not count in the end.
const ROUNDS: u32 = 3;
/// The share of the target that is near enough.
const NEAR_TARGET: f64 = 0.98;

/// What clustering works on.
struct Input<'a> {
    mesh: &'a Mesh,
    /// Position of each wedge, times `unit`.
    points: Cow<'a, [[f32; 3]]>,
    /// A power of two that keeps products of lengths away from the ends of single precision; 1 but for odd models.
    unit: f64,
    /// Whether a triangle names the wedge.
    used: Vec<bool>,
    /// Around the wedges in use.
    bounds: Bounds,
    locked: &'a [bool],
    importance: &'a [f32],
}

/// Who is together, and where.
struct Clusters {
    /// Cell of each wedge; `NONE` for those that no triangle names.
    cells: Vec<u32>,
    /// Of each cell, in model units.
    positions: Vec<[f32; 3]>,
    /// Triangles with corners in three cells.
    survivors: Vec<u32>,
    cell_size: f64,
}

impl<'a> Input<'a> {
    fn new(mesh: &'a Mesh, options: &'a ClusterOptions) -> Self {
        let mut used = vec![false; mesh.wedge_count()];
        mesh.triangles.as_flattened().iter().for_each(|&wedge| used[wedge as usize] = true);
        let of_wedge = |&vertex: &u32| mesh.positions[vertex as usize];
        let in_order = mesh.wedge_count() == mesh.vertex_count()
            && mesh.wedge_vertices.iter().zip(0..).all(|(&vertex, wedge)| vertex == wedge);
        let mut points = if in_order {
            Cow::Borrowed(mesh.positions.as_slice())
        } else {
            Cow::Owned(mesh.wedge_vertices.iter().map(of_wedge).collect())
        };
        let mut bounds = Bounds::of(&points, &used);
        let mut unit = 1.0;
        if bounds.extent > 0.0 && !(1e-20..1e20).contains(&bounds.extent) {
            unit = (-bounds.extent.log2().ceil()).exp2();
            let scaled = |p: &[f32; 3]| p.map(|x| (f64::from(x) * unit) as f32);
            points = Cow::Owned(points.iter().map(scaled).collect());
            bounds = Bounds::of(&points, &used);
        }
        Self { mesh, points, unit, used, bounds, locked: &options.locked, importance: &options.importance }
    }

    fn is_locked(&self, wedge: usize) -> bool {
        !self.locked.is_empty() && self.locked[self.mesh.wedge_vertices[wedge] as usize]
    }

    /// Gathers vertices so that at most `wanted` triangles have corners in three cells, doubles counted, or as the largest
    /// error says.
    fn clusters(&self, wanted: usize, options: &ClusterOptions) -> Clusters {
        let max_error = options.max_error.map(|error| error * self.unit);
        if options.method == ClusterMethod::FloatingCells {
            return floating::clusters(self, wanted, max_error);
        }
        let fewest = max_error.map_or(0.0, |error| lattice::WIDEST * self.bounds.extent / error);
        let found = lattice::finest(self, wanted, fewest);
        let lattice = Lattice::new(self.bounds, found.cells);
        let (corners, names) = cells::assign(self, lattice, found.count / 2);
        let (sums, survivors) = cells::sum_up(self, &corners, names.len());
        let cells: Vec<u32> = corners.into_iter().map(|corner| corner.cell).collect();
        let positions = if options.method == ClusterMethod::Vertex {
            self.heaviest(&cells, names.len())
        } else {
            let place = |(sums, &name): (&cells::Sums, &u64)| {
                if name & LOCKED != 0 {
                    return self.mesh.positions[(name ^ LOCKED) as usize];
                }
                let within = if options.method == ClusterMethod::Mean { sums.mean() } else { sums.optimum() };
                self.leave(lattice.point(Lattice::centre(name) + within))
            };
            sums.par_iter().zip(&names).map(place).collect()
        };
        Clusters { cells, positions, survivors, cell_size: self.bounds.extent / found.cells / self.unit }
    }

    /// The vertex of the largest weight in each cell; the first of equal ones.
    fn heaviest(&self, cells: &[u32], count: usize) -> Vec<[f32; 3]> {
        let weights = weights::weights(self.mesh, self.importance);
        let mut best = vec![(-1.0_f32, 0_u32); count];
        for (&cell, &vertex) in cells.iter().zip(&self.mesh.wedge_vertices).filter(|&(&cell, _)| cell != NONE) {
            let (best, weight) = (&mut best[cell as usize], weights[vertex as usize]);
            if weight > best.0 {
                *best = (weight, vertex);
            }
        }
        best.into_iter().map(|(_, vertex)| self.mesh.positions[vertex as usize]).collect()
    }

    /// To model units, rounded to what a mesh stores.
    fn leave(&self, point: DVec3) -> [f32; 3] {
        let most = DVec3::splat(f64::from(f32::MAX));
        (point / self.unit).clamp(-most, most).as_vec3().to_array()
    }
}

impl Clusters {
    /// How far a vertex is at most from the place that stands for it.
    fn error(&self, input: &Input<'_>) -> f64 {
        let moved = |(&cell, &vertex): (&u32, &u32)| {
            if cell == NONE {
                return 0.0;
            }
            let point = |p: [f32; 3]| Vec3::from(p).as_dvec3();
            point(self.positions[cell as usize]).distance(point(input.mesh.positions[vertex as usize]))
        };
        self.cells.par_iter().zip(&input.mesh.wedge_vertices).map(moved).reduce(|| 0.0, f64::max)
    }
}

fn check_options(mesh: &Mesh, options: &ClusterOptions) -> Result<(), ClusterError> {
    let invalid = |name, reason: &str| Err(ClusterError::InvalidOption { name, reason: reason.to_owned() });
    if options.triangles.is_none() && options.max_error.is_none() {
        return invalid("triangles", "neither a triangle count nor an error is given");
    }
    if !options.max_error.is_none_or(|e| e >= 0.0) {
        return invalid("max_error", "must not be negative or NaN");
    }
    let per_vertex = [("locked", options.locked.len()), ("importance", options.importance.len())];
    if let Some((name, _)) = per_vertex.into_iter().find(|&(_, n)| n != 0 && n != mesh.vertex_count()) {
        return invalid(name, "needs one entry per vertex, or none at all");
    }
    if !options.importance.iter().all(|&x| x >= 0.0 && x.is_finite()) {
        return invalid("importance", "must be finite and not negative");
    }
    match mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        Some(vertex) => Err(ClusterError::NotFinite { vertex }),
        None => Ok(()),
    }
}
