//! The uniform grid: which cell a point is in, and how many triangles a grid leaves.

use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

use super::Input;
use super::search::{Found, Search};

/// Most cells along an axis: so that single precision still has seven bits for the place within a cell.
const MOST_CELLS: f64 = 65_536.0;
/// While the search is far from its goal it looks at one triangle in this many, if these are [`ENOUGH`].
const STRIDE: usize = 16;
/// Triangles of a sample. Where a tenth of them survives, the estimate is off by 2 %.
const ENOUGH: usize = 1 << 14;
/// Elements in a piece of parallel work.
const CHUNK: usize = 1 << 16;

/// Distance of the two points of a cell that are furthest apart, in units of the spacing.
pub(super) const WIDEST: f64 = 1.118_033_988_749_895;

/// A body-centred cubic lattice: the points with whole coordinates, and the middles of the cubes between them. Cells are
/// what is nearest to one of its points: truncated octahedra, of half the volume of a cube.
///
/// One of its points is the low corner of the bounding box, so that flat sides of the model run through the middle of
/// cells, not where rounding decides.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    low: Vec3A,
    /// Cubes to a unit of the model.
    scale: f32,
}

/// Added to a float from -1 to 2^22, it leaves the nearest integer in the low bits, without branch and conversion.
const ROUND: f32 = (1 << 23) as f32;
const AXIS_BITS: u32 = 21;
const AXIS_MASK: u32 = (1 << AXIS_BITS) - 1;

impl Lattice {
    /// `cells` along the largest extent.
    pub(super) fn new(bounds: Bounds, cells: f64) -> Self {
        let scale = if bounds.extent > 0.0 { cells / bounds.extent } else { 0.0 };
        Self { low: bounds.low.into(), scale: scale as f32 }
    }

    /// A point in units of cells, from the low corner.
    #[inline]
    pub(super) fn place(&self, point: [f32; 3]) -> Vec3A {
        (Vec3A::from(point) - self.low) * self.scale
    }

    /// Back to the model.
    pub(super) fn point(&self, place: DVec3) -> DVec3 {
        place / f64::from(self.scale) + Vec3::from(self.low).as_dvec3()
    }

    /// From the centre of the cell that a place is in.
    #[inline]
    pub(super) fn within(place: Vec3A) -> Vec3A {
        let whole = place - ((place + ROUND) - ROUND);
        // beyond the facets between the two kinds of points; a branch would go wrong every other time
        let step = if whole.abs().element_sum() > 0.75 { 0.5 } else { 0.0 };
        whole - Vec3A::splat(step).copysign(whole)
    }

    /// How far out in its cell a place is: 0 in the centre, 1 on the surface. A convex function.
    pub(super) fn reach(within: DVec3) -> f64 {
        let within = within.abs();
        (2.0 * within.max_element()).max(within.element_sum() / 0.75)
    }

    /// Twice the centre of the cell that a place is in, as floats with the integer in their low bits, from 1 on.
    #[inline]
    fn doubled_centre(place: Vec3A) -> [u32; 3] {
        ((place - Self::within(place)) * 2.0 + (ROUND + 1.0)).to_array().map(f32::to_bits)
    }

    /// The cell that a place is in.
    #[inline]
    pub(super) fn cell(place: Vec3A) -> u64 {
        let [x, y, z] = Self::doubled_centre(place).map(|x| u64::from(x & AXIS_MASK));
        x | y << AXIS_BITS | z << (2 * AXIS_BITS)
    }

    /// The centre of a cell.
    pub(super) fn centre(cell: u64) -> DVec3 {
        let along = |axis: u32| f64::from((cell >> (axis * AXIS_BITS)) as u32 & AXIS_MASK);
        (DVec3::new(along(0), along(1), along(2)) - 1.0) * 0.5
    }

    /// As [`cell`](Self::cell), but cells hundreds of steps apart may share it: good enough to count.
    #[inline]
    fn short_cell(place: Vec3A) -> u32 {
        let [x, y, z] = Self::doubled_centre(place);
        x.wrapping_add(y << 11).wrapping_add(z << 22)
    }
}

/// The box around all points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) low: Vec3,
    /// Its longest side.
    pub(super) extent: f64,
}

impl Bounds {
    /// Around the points in use.
    pub(super) fn of(points: &[[f32; 3]], used: &[bool]) -> Self {
        let none = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        let with = |(low, high): (Vec3A, Vec3A), (&p, _): (&[f32; 3], &bool)| (low.min(p.into()), high.max(p.into()));
        let (low, high) = points.iter().zip(used).filter(|&(_, &used)| used).fold(none, with);
        let extent = (Vec3::from(high).as_dvec3() - Vec3::from(low).as_dvec3()).max_element();
        if extent >= 0.0 { Self { low: low.into(), extent } } else { Self { low: Vec3::ZERO, extent: 0.0 } }
    }
}

/// The finest grid, in cells along the largest extent, that leaves at most `wanted` triangles, doubles counted; or the
/// one of the `fewest` cells, if that leaves more.
///
/// A sample of the triangles says about where it is; passes over all of them, two or three as a rule, say where exactly.
pub(super) fn finest(input: &Input<'_>, wanted: usize, fewest: f64) -> Found {
    let triangles = &input.mesh.triangles;
    let within = (fewest.min(MOST_CELLS), MOST_CELLS);
    // a surface of n cells to a side has some 3 n^2 cells of two triangles
    let mut guess = (wanted as f64 / 6.0).sqrt();
    if triangles.len() / STRIDE >= ENOUGH {
        let few = sample(input);
        let survivors = |cells: f64| {
            let lattice = Lattice::new(input.bounds, cells);
            few.iter().filter(|corners| distinct(corners.map(|p| Lattice::short_cell(lattice.place(p))))).count()
        };
        let wanted = (wanted as f64 * few.len() as f64 / triangles.len() as f64) as usize;
        guess = Search { wanted, guess, within, near: 0.98 }.run(survivors).cells;
    }
    let mut names = vec![0; input.points.len()];
    Search { wanted, guess, within, near: 0.995 }.run(|cells| {
        name_cells(&mut names, input, Lattice::new(input.bounds, cells));
        let survives = |t: &&[u32; 3]| distinct(t.map(|wedge| names[wedge as usize]));
        triangles.par_chunks(CHUNK).map(|chunk| chunk.iter().filter(survives).count()).sum()
    })
}

/// The corners of some triangles, spread evenly over the list but not in step with it.
fn sample(input: &Input<'_>) -> Vec<[[f32; 3]; 3]> {
    let jitter = |i: usize| ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize % STRIDE;
    let triangles = input.mesh.triangles.chunks_exact(STRIDE).enumerate().map(|(i, chunk)| chunk[jitter(i)]);
    triangles.map(|t| t.map(|wedge| input.points[wedge as usize])).collect()
}

fn name_cells(names: &mut [u32], input: &Input<'_>, lattice: Lattice) {
    let chunks = names.par_chunks_mut(CHUNK).zip(input.points.par_chunks(CHUNK));
    chunks.for_each(|(names, points)| {
        let each = names.iter_mut().zip(points);
        each.for_each(|(name, &point)| *name = Lattice::short_cell(lattice.place(point)));
    });
    if !input.locked.is_empty() {
        let vertices = &input.mesh.wedge_vertices;
        let own = names.iter_mut().zip(vertices).filter(|&(_, &vertex)| input.locked[vertex as usize]);
        own.for_each(|(name, &vertex)| *name = !vertex);
    }
}

#[inline]
pub(super) fn distinct([a, b, c]: [u32; 3]) -> bool {
    (a != b) & (b != c) & (c != a)
}
