//! Cells: who is in them, what their triangles say, where their vertex goes.

use std::ops::Range;

use glam::{DMat3, DVec3, Vec3, Vec3A, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::Input;
use super::lattice::{Lattice, distinct};

/// The cell of a wedge that no triangle names.
pub(super) const NONE: u32 = u32::MAX;

/// A wedge: its place in units of cells, and its cell. Together, as who wants one wants the other.
#[derive(Debug, Clone, Copy)]
#[repr(align(16))]
pub(super) struct Corner {
    place: Vec3,
    pub(super) cell: u32,
}

/// Flag in the name of the cell of a locked vertex, which is its own; the other bits name the vertex.
pub(super) const LOCKED: u64 = 1 << 63;

/// Puts every wedge in its cell. Cells are numbered as they are met; returned are their names, too.
pub(super) fn assign(input: &Input<'_>, lattice: Lattice, expected: usize) -> (Vec<Corner>, Vec<u64>) {
    let mut table = Table::with_room_for(expected);
    let mut corners = Vec::with_capacity(input.points.len());
    for (wedge, (&point, &used)) in input.points.iter().zip(&input.used).enumerate() {
        let place = lattice.place(point);
        let cell = if !used {
            NONE
        } else if input.is_locked(wedge) {
            table.number(LOCKED | u64::from(input.mesh.wedge_vertices[wedge]))
        } else {
            table.number(Lattice::cell(place))
        };
        corners.push(Corner { place: place.into(), cell });
    }
    (corners, table.names)
}

/// Numbers of cells by their names: open addressing.
pub(super) struct Table {
    slots: Vec<u32>,
    pub(super) names: Vec<u64>,
}

impl Table {
    pub(super) fn with_room_for(cells: usize) -> Self {
        Self { slots: vec![NONE; (2 * cells).next_power_of_two().max(64)], names: Vec::with_capacity(cells) }
    }

    /// The slot of a name, or the one where it would go.
    #[inline]
    fn slot(&self, name: u64) -> usize {
        let shift = u64::BITS - self.slots.len().trailing_zeros();
        let mut slot = (name.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> shift) as usize;
        while self.slots[slot] != NONE && self.names[self.slots[slot] as usize] != name {
            slot = (slot + 1) & (self.slots.len() - 1);
        }
        slot
    }

    /// The number of a cell, if it has one.
    pub(super) fn get(&self, name: u64) -> Option<u32> {
        Some(self.slots[self.slot(name)]).filter(|&cell| cell != NONE)
    }

    /// The number of a cell, the next one if it is new.
    #[inline]
    pub(super) fn number(&mut self, name: u64) -> u32 {
        let slot = self.slot(name);
        if self.slots[slot] != NONE {
            return self.slots[slot];
        }
        let cell = self.names.len() as u32;
        self.slots[slot] = cell;
        self.names.push(name);
        if 2 * self.names.len() > self.slots.len() {
            self.grow();
        }
        cell
    }

    #[cold]
    fn grow(&mut self) {
        self.slots = vec![NONE; 2 * self.slots.len()];
        for cell in 0..self.names.len() {
            let slot = self.slot(self.names[cell]);
            self.slots[slot] = cell as u32;
        }
    }
}

/// Sums over the triangles at a cell, each weighted by its area, in units of cells from the centre of the cell. One cache
/// line.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Sums {
    /// The quadric: for each plane `n . x = d` the rows of `n (n, -d)'`. The constant is not needed.
    planes: [Vec4; 3],
    /// Corners in the cell, and what they weigh.
    corners: Vec4,
}

/// What a corner weighs whose triangles have no area, so that a cell full of them still has a mean.
const LEAST_WEIGHT: f32 = 1e-12;

/// How strongly an optimum is pulled to the mean of its cell, relative to the planes: what decides along directions in which
/// these decide little. Lindstrom cuts eigenvalues below 1e-3 of the largest off, to the same end; this bends softly. Of
/// 1e-5 to 1e-2 the best on igea and the dragon.
const PULL: f64 = 1e-4;

impl Sums {
    /// Adds the plane through a place, seen from the centre of its cell, and the corners of a triangle that are in the cell.
    /// `normal` is as long as the plane weighs, `unit` the same direction of length 1.
    #[inline]
    fn add_plane(&mut self, normal: Vec3A, unit: Vec3A, within: Vec3A, corners: Vec4) {
        let plane = normal.extend(-normal.dot(within));
        self.planes[0] += plane * unit.x;
        self.planes[1] += plane * unit.y;
        self.planes[2] += plane * unit.z;
        self.corners += corners;
    }

    fn add(&mut self, other: &Self) {
        (0..3).for_each(|row| self.planes[row] += other.planes[row]);
        self.corners += other.corners;
    }

    /// The mean of the corners, seen from the centre of the cell.
    pub(super) fn mean(&self) -> DVec3 {
        let weight = f64::from(self.corners.w);
        if weight > 0.0 { self.corners.xyz().as_dvec3() / weight } else { DVec3::ZERO }
    }

    /// Where the quadric is least, as near to the mean as the planes leave open, within the cell.
    pub(super) fn optimum(&self) -> DVec3 {
        let mean = self.mean();
        // symmetric, so rows are columns
        let [a, b, c] = self.planes.map(|row| row.xyz().as_dvec3());
        let planes = DMat3::from_cols(a, b, c);
        let gradient = planes * mean + DVec3::from(self.planes.map(|row| f64::from(row.w)));
        let pulled = planes + DMat3::from_diagonal(DVec3::splat(PULL * (a.x + b.y + c.z)));
        let best = mean - pulled.inverse() * gradient;
        let (inside, outside) = (Lattice::reach(mean), Lattice::reach(best));
        if !outside.is_finite() {
            mean
        } else if outside <= 1.0 {
            best
        } else {
            // not beyond the surface of the cell, as its reach is convex
            mean.lerp(best, ((1.0 - inside) / (outside - inside)).max(0.0))
        }
    }
}

/// Sums up the triangles at each cell, and lists those with corners in three cells.
///
/// Pieces of the list are summed on their own and added in order. Their number depends on nothing but the sizes, so that the
/// sums do not depend on the threads.
pub(super) fn sum_up(input: &Input<'_>, corners: &[Corner], cells: usize) -> (Vec<Sums>, Vec<u32>) {
    let count = input.mesh.triangle_count();
    let pieces = (count / (8 * cells.max(1))).clamp(1, 16);
    let bound = |piece: usize| count * piece / pieces;
    let parts: Vec<_> = (0..pieces)
        .into_par_iter()
        .map(|piece| sum_up_range(input, corners, cells, bound(piece)..bound(piece + 1)))
        .collect();
    let mut parts = parts.into_iter();
    let (mut sums, mut survivors) = parts.next().expect("there is at least one piece");
    for (more, others) in parts {
        sums.par_iter_mut().zip(&more).for_each(|(sum, more)| sum.add(more));
        survivors.extend(others);
    }
    (sums, survivors)
}

fn sum_up_range(input: &Input<'_>, corners: &[Corner], cells: usize, range: Range<usize>) -> (Vec<Sums>, Vec<u32>) {
    let mut sums = vec![Sums::default(); cells];
    let mut survivors = Vec::new();
    for (wedges, t) in input.mesh.triangles[range.clone()].iter().zip(range.start as u32..) {
        let three = wedges.map(|wedge| corners[wedge as usize]);
        let [a, b, c] = three.map(|corner| Vec3A::from(corner.place));
        let mut normal = (b - a).cross(c - a);
        if !input.importance.is_empty() {
            normal *= importance(input, wedges);
        }
        let weight = normal.length() + LEAST_WEIGHT;
        let unit = normal / weight;
        let cells = three.map(|corner| corner.cell);
        if cells[0] == cells[1] && cells[1] == cells[2] {
            // most are like this where much vanishes: three corners at once
            let within = Lattice::within(a);
            let corners = (within * 3.0 + (b - a) + (c - a)).extend(3.0) * weight;
            sums[cells[0] as usize].add_plane(3.0 * normal, unit, within, corners);
            continue;
        }
        for (cell, place) in cells.into_iter().zip([a, b, c]) {
            let within = Lattice::within(place);
            sums[cell as usize].add_plane(normal, unit, within, within.extend(1.0) * weight);
        }
        if distinct(cells) {
            survivors.push(t);
        }
    }
    (sums, survivors)
}

/// The largest of the three corners.
fn importance(input: &Input<'_>, wedges: &[u32; 3]) -> f32 {
    let of = |wedge: u32| input.importance[input.mesh.wedge_vertices[wedge as usize] as usize];
    wedges.iter().map(|&wedge| of(wedge)).fold(0.0, f32::max)
}
