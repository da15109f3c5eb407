//! Floating cells (Low and Tan 1997): cubes centred on vertices, the heaviest first.

use std::cmp::Reverse;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cells::{LOCKED, NONE, Table};
use super::lattice::{self, distinct};
use super::search::Search;
use super::weights::weights;
use super::{Clusters, Input};

/// Most grid cells along an axis that have names.
const MOST_CELLS: f64 = 1_000_000.0;
/// Bits of a name for each axis.
const AXIS_BITS: u32 = 21;

/// Gathers vertices so that at most `wanted` triangles are left, doubles counted, or as the largest error says.
pub(super) fn clusters(input: &Input<'_>, wanted: usize, max_error: Option<f64>) -> Clusters {
    let floating = Floating::new(input);
    // a corner of a cube is the place furthest from its centre
    let fewest = max_error.map_or(0.0, |error| 3.0_f64.sqrt() / 2.0 * input.bounds.extent / error);
    let uniform = lattice::finest(input, wanted, 0.0);
    let within = (fewest.min(MOST_CELLS), MOST_CELLS);
    let search = Search { wanted, guess: uniform.cells, within, near: 0.98 };
    let found = search.run(|cells| floating.survivors(&floating.assign(cells).0).count());
    let (cells, centres) = floating.assign(found.cells);
    Clusters {
        survivors: floating.survivors(&cells).collect(),
        positions: centres.iter().map(|&vertex| input.mesh.positions[vertex as usize]).collect(),
        cells,
        cell_size: input.bounds.extent / found.cells / input.unit,
    }
}

struct Floating<'a> {
    input: &'a Input<'a>,
    /// A wedge in use of each vertex, the heaviest vertex first, locked ones before all.
    order: Vec<u32>,
}

impl<'a> Floating<'a> {
    fn new(input: &'a Input<'a>) -> Self {
        let vertices = &input.mesh.wedge_vertices;
        let weights = weights(input.mesh, input.importance);
        let mut wedge_of = vec![NONE; input.mesh.vertex_count()];
        let used = (0..input.points.len()).rev().filter(|&wedge| input.used[wedge]);
        used.for_each(|wedge| wedge_of[vertices[wedge] as usize] = wedge as u32);
        let mut order: Vec<u32> = wedge_of.into_iter().filter(|&wedge| wedge != NONE).collect();
        order.par_sort_by_key(|&wedge| {
            let vertex = vertices[wedge as usize];
            // positive floats are in the order of their bits
            (Reverse((input.is_locked(wedge as usize), weights[vertex as usize].to_bits())), vertex)
        });
        Self { input, order }
    }

    /// The cell of each wedge, and the vertex in the centre of each cell, for cubes of which so many fit along the largest
    /// extent.
    fn assign(&self, cells: f64) -> (Vec<u32>, Vec<u32>) {
        let input = self.input;
        let half = if input.bounds.extent > 0.0 { input.bounds.extent / cells / 2.0 } else { 1.0 };
        let low = input.bounds.low.as_dvec3();
        let place = |wedge: u32| (Vec3::from(input.points[wedge as usize]).as_dvec3() - low) / half;
        let vertex = |wedge: u32| input.mesh.wedge_vertices[wedge as usize];
        // cubes of half their side hold one centre each at most, as that has all others in its cell
        let mut table = Table::with_room_for(self.order.len() / 16);
        let mut centres: Vec<(DVec3, u32)> = Vec::new();
        for &wedge in &self.order {
            let place = place(wedge);
            if input.is_locked(wedge as usize) {
                table.number(LOCKED | u64::from(vertex(wedge)));
            } else if around(&table, place).any(|cell| is_in(place, centres[cell as usize].0)) {
                continue;
            } else {
                table.number(name(place.floor()));
            }
            centres.push((place, vertex(wedge)));
        }
        let cell_of = |wedge: usize| {
            if !input.used[wedge] {
                return NONE;
            }
            if input.is_locked(wedge) {
                return table.get(LOCKED | u64::from(vertex(wedge as u32))).expect("locked vertices come first");
            }
            let place = place(wedge as u32);
            let distance = |cell: u32| place.distance_squared(centres[cell as usize].0);
            let candidates = around(&table, place).filter(|&cell| is_in(place, centres[cell as usize].0));
            let nearest = candidates.min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
            nearest.expect("who is in no cell is the centre of one")
        };
        let cells = (0..input.points.len()).into_par_iter().map(cell_of).collect();
        (cells, centres.into_iter().map(|(_, vertex)| vertex).collect())
    }

    fn survivors(&self, cells: &[u32]) -> impl Iterator<Item = u32> {
        let triangles = self.input.mesh.triangles.iter().zip(0..);
        triangles.filter(|(t, _)| distinct(t.map(|wedge| cells[wedge as usize]))).map(|(_, i)| i)
    }
}

/// Whether a place is in the cell about a centre; half a side is 1.
fn is_in(place: DVec3, centre: DVec3) -> bool {
    (place - centre).abs().max_element() <= 1.0
}

/// The cells whose centres are in the cubes around a place.
fn around(table: &Table, place: DVec3) -> impl Iterator<Item = u32> {
    let base = place.floor();
    let step = |i: i32| f64::from(i - 1);
    let cubes = (0..27).map(move |i| base + DVec3::new(step(i % 3), step(i / 3 % 3), step(i / 9)));
    cubes.filter_map(|cube| table.get(name(cube)))
}

fn name(cube: DVec3) -> u64 {
    // from 1, as a neighbour of the first is asked for
    let [x, y, z] = cube.to_array().map(|x| (x + 1.0) as u64);
    x | y << AXIS_BITS | z << (2 * AXIS_BITS)
}
