//! Marching cubes over a signed distance, only where the surface is.
//!
//! Space is halved in eight until blocks of 8 x 8 x 8 cells are left, and what the distance at a centre proves empty is
//! skipped: time and memory go with the area of the surface, not with the volume of the grid. The triangles of each
//! sign pattern are derived, not tabled by hand: on a face with two inside corners across a diagonal the inside is cut
//! apart, always, so neighbouring cells agree; and no diagonal runs within a face of the cell. Hence every edge has two
//! triangles and every vertex one fan: the result is a closed 2-manifold whatever the function.
//!
//! Lorensen and Cline 1987; the consistent treatment of ambiguous faces as in Bloomenthal 1994.

use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::noise;

/// Cells along a block's edge.
const SIDE: usize = 8;
/// Samples along a block's edge.
const SAMPLES: usize = SIDE + 1;

/// What to extract.
pub(super) struct Isosurface<F> {
    /// Signed distance, negative inside; changes by at most the distance gone.
    pub(super) distance: F,
    /// A box that the surface lies strictly within.
    pub(super) low: Vec3,
    /// The opposite corner of the box.
    pub(super) high: Vec3,
    /// Scan noise: random error of the distance at each grid point, as a share of the cell's size.
    pub(super) noise: f32,
}

/// Positions and triangles, counter-clockwise from outside.
#[derive(Default)]
pub(super) struct Surface {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// One block's share: the vertices on the grid edges that start in it, and the triangles of its cells.
struct Block {
    /// Edge numbers within the block, ascending.
    edges: Vec<u16>,
    positions: Vec<[f32; 3]>,
    /// Each corner: which neighbour owns the edge (3 bits, +x +y +z) above 16 bits of edge number.
    triangles: Vec<[u32; 3]>,
    /// Which of the blocks in the directions of [`ACROSS`] the surface goes on in.
    goes_on: [bool; 6],
}

/// Directions to the blocks across a block's faces.
const ACROSS: [IVec3; 6] = [IVec3::NEG_X, IVec3::X, IVec3::NEG_Y, IVec3::Y, IVec3::NEG_Z, IVec3::Z];

impl<F: Fn(Vec3) -> f32 + Sync> Isosurface<F> {
    /// The surface with about `wanted` triangles (within a few percent unless that is too few to show the shape), only
    /// its largest component.
    pub(super) fn with_triangles(&self, wanted: usize) -> Surface {
        // the number of triangles goes with the square of the grid: measure on a coarse one, then correct
        let mut step = (self.high - self.low).length() / 40.0;
        let mut surface = self.extract(step);
        for _ in 0..8 {
            let found = surface.triangles.len().max(1);
            if found.abs_diff(wanted) <= wanted / 25 {
                break;
            }
            // fine detail adds area, so large counts are approached by way of a sixteenth
            let goal = wanted.clamp(found / 16, found * 16).max(1);
            step *= (found as f32 / goal as f32).sqrt();
            drop(surface);
            surface = self.extract(step);
        }
        surface
    }

    /// The surface on a grid of cells of size `step`.
    pub(super) fn extract(&self, step: f32) -> Surface {
        // the origin is half a cell off, so that flat parts at round coordinates do not fall on grid planes
        let origin = self.low - 1.5 * step;
        let cells = ((self.high - origin) / step).max_element() as usize + 2;
        let blocks = cells.div_ceil(SIDE).next_power_of_two() as i32;
        let grid = Grid { surface: self, origin, step };
        let mut found = Vec::new();
        let mut next = grid.near_surface(IVec3::ZERO, blocks);
        while !next.is_empty() {
            let blocks = next.into_par_iter().map(|at| (at, grid.march(at)));
            found.par_extend(blocks.filter(|(_, block)| !(block.edges.is_empty() && block.triangles.is_empty())));
            next = missing(&found);
        }
        largest_component(link(&found))
    }
}

struct Grid<'a, F> {
    surface: &'a Isosurface<F>,
    origin: Vec3,
    step: f32,
}

impl<F: Fn(Vec3) -> f32 + Sync> Grid<'_, F> {
    fn point(&self, p: IVec3) -> Vec3 {
        self.origin + self.step * p.as_vec3()
    }

    /// The blocks that the surface may pass, of the cube of `size` blocks at block `at`; in Morton order.
    fn near_surface(&self, at: IVec3, size: i32) -> Vec<IVec3> {
        let half = 0.5 * self.step * (size * SIDE as i32) as f32;
        let centre = self.point(at * SIDE as i32) + half;
        // half the diagonal of the cube, what noise can shift, and a little for rounding
        let reach = (half * 1.7321 + self.surface.noise * self.step) * 1.001;
        if (self.surface.distance)(centre).abs() > reach {
            return Vec::new();
        }
        if size == 1 {
            return vec![at];
        }
        let child = |i: i32| at + IVec3::new(i & 1, i >> 1 & 1, i >> 2) * (size / 2);
        if size >= 8 {
            return (0..8).into_par_iter().flat_map_iter(|i| self.near_surface(child(i), size / 2)).collect();
        }
        (0..8).flat_map(|i| self.near_surface(child(i), size / 2)).collect()
    }

    fn sample(&self, p: IVec3) -> f32 {
        let value = (self.surface.distance)(self.point(p));
        if self.surface.noise == 0.0 {
            return value;
        }
        value + self.surface.noise * self.step * noise::signed_unit(noise::hash(p.to_array(), 0))
    }

    fn march(&self, at: IVec3) -> Block {
        let base = at * SIDE as i32;
        let values = self.block_samples(base);
        let goes_on = ACROSS.map(|face| is_cut(&values, face));
        let mut block = Block { edges: Vec::new(), positions: Vec::new(), triangles: Vec::new(), goes_on };
        for cell in 0..SIDE * SIDE * SIDE {
            let [x, y, z] = [cell % SIDE, cell / SIDE % SIDE, cell / SIDE / SIDE];
            let sample = |i: usize| values[((z + (i >> 2)) * SAMPLES + y + (i >> 1 & 1)) * SAMPLES + x + (i & 1)];
            self.cut_edges(base, cell, [sample(0), sample(1), sample(2), sample(4)], &mut block);
            let inside = (0..8).fold(0, |bits, i| bits | usize::from(sample(i) < 0.0) << i);
            let cut = |edge: u8| owner([x, y, z], usize::from(edge));
            block.triangles.extend(PATTERNS[inside].iter().map(|t| t.map(cut)));
        }
        block
    }

    /// The samples of a block, x fastest. Those that are farther than a cell from the surface need only the right sign,
    /// so what one sample proves about the next ones in its row is not evaluated again. The ends of the rows always are:
    /// the next block has them, too, and must see the same signs even where the distance is a little too steep.
    fn block_samples(&self, base: IVec3) -> [f32; SAMPLES * SAMPLES * SAMPLES] {
        let mut values = [0.0_f32; SAMPLES * SAMPLES * SAMPLES];
        for (i, row) in values.chunks_exact_mut(SAMPLES).enumerate() {
            let start = base + IVec3::new(0, (i % SAMPLES) as i32, (i / SAMPLES) as i32);
            let mut x = 0;
            while x < SAMPLES {
                let value = self.sample(start + IVec3::X * x as i32);
                let known = (value.abs() / self.step - 1.0 - 2.0 * self.surface.noise).clamp(0.0, SAMPLES as f32);
                let end = (x + 1 + known as usize).min(SAMPLES - 1).max(x + 1);
                row[x..end].fill(value);
                x = end;
            }
        }
        values
    }

    /// Adds the vertices on the three edges that start at a cell's first corner.
    fn cut_edges(&self, base: IVec3, cell: usize, [from, ends @ ..]: [f32; 4], block: &mut Block) {
        let corner = base + IVec3::new((cell % SIDE) as i32, (cell / SIDE % SIDE) as i32, (cell / SIDE / SIDE) as i32);
        for (axis, to) in ends.into_iter().enumerate() {
            if (from < 0.0) == (to < 0.0) {
                continue;
            }
            // away from the ends, so that no triangle is a point
            let t = (from / (from - to)).clamp(0.02, 0.98);
            let mut position = self.point(corner);
            position[axis] += t * self.step;
            block.edges.push((3 * cell + axis) as u16);
            block.positions.push(position.to_array());
        }
    }
}

/// Whether the samples of a block on one of its faces have both signs.
fn is_cut(values: &[f32; SAMPLES * SAMPLES * SAMPLES], face: IVec3) -> bool {
    let (axis, side) = if face.x != 0 {
        (0, face.x)
    } else if face.y != 0 {
        (1, face.y)
    } else {
        (2, face.z)
    };
    let plane = if side > 0 { SIDE } else { 0 };
    let mut inside = (values.iter().enumerate())
        .filter(|(i, _)| [i % SAMPLES, i / SAMPLES % SAMPLES, i / SAMPLES / SAMPLES][axis] == plane)
        .map(|(_, &value)| value < 0.0);
    let first = inside.next();
    inside.any(|other| Some(other) != first)
}

/// The blocks that the surface goes on in but that are not there, in a fixed order: where the distance is steeper than it
/// should be, a block may have been taken for empty.
fn missing(blocks: &[(IVec3, Block)]) -> Vec<IVec3> {
    let there: HashSet<IVec3> = blocks.iter().map(|(at, _)| *at).collect();
    let across = |(at, block): &(IVec3, Block)| {
        let goes_on = block.goes_on;
        let at = *at;
        (0..6).filter(move |&i| goes_on[i]).map(move |i| at + ACROSS[i])
    };
    let mut missing: Vec<IVec3> = blocks.iter().flat_map(across).filter(|at| !there.contains(at)).collect();
    missing.sort_unstable_by_key(|at| at.to_array());
    missing.dedup();
    missing
}

/// Who owns an edge of a cell, and its number there.
fn owner(cell: [usize; 3], edge: usize) -> u32 {
    let corner = edge_corner(edge);
    let mut neighbour = 0;
    let mut number = 0;
    for axis in [2, 1, 0] {
        let at = cell[axis] + (corner >> axis & 1);
        neighbour |= (at / SIDE) << axis;
        number = number * SIDE + at % SIDE;
    }
    (neighbour << 16 | (3 * number + edge / 4)) as u32
}

/// Joins the blocks: edge numbers become vertex indices.
fn link(blocks: &[(IVec3, Block)]) -> Surface {
    let mut firsts = Vec::with_capacity(blocks.len());
    let mut vertices = 0;
    for (_, block) in blocks {
        firsts.push(vertices);
        vertices += block.edges.len() as u32;
    }
    let places: HashMap<IVec3, usize> = blocks.iter().enumerate().map(|(i, (at, _))| (*at, i)).collect();
    let resolve = |(at, block): &(IVec3, Block)| -> Vec<[u32; 3]> {
        let near = |i: i32| places.get(&(*at + IVec3::new(i & 1, i >> 1 & 1, i >> 2))).copied();
        let near: [Option<usize>; 8] = std::array::from_fn(|i| near(i as i32));
        let vertex = |corner: u32| {
            let place = near[(corner >> 16) as usize].expect("a block whose edge is cut is near the surface");
            let found = blocks[place].1.edges.binary_search(&(corner as u16));
            firsts[place] + found.expect("both sides of an edge see the same signs") as u32
        };
        block.triangles.iter().map(|t| t.map(vertex)).collect()
    };
    let triangles: Vec<Vec<[u32; 3]>> = blocks.par_iter().map(resolve).collect();
    let positions: Vec<[f32; 3]> = blocks.iter().flat_map(|(_, block)| &block.positions).copied().collect();
    Surface { positions, triangles: triangles.concat() }
}

/// Keeps the component with the most vertices: no crumbs, no bubbles inside.
fn largest_component(surface: Surface) -> Surface {
    let mut parent: Vec<u32> = (0..surface.positions.len() as u32).collect();
    let root = |parent: &mut [u32], mut v: u32| {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    };
    for &[a, b, c] in &surface.triangles {
        for (a, b) in [(a, b), (b, c)] {
            let (a, b) = (root(&mut parent, a), root(&mut parent, b));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut sizes = vec![0_u32; parent.len()];
    for v in 0..parent.len() as u32 {
        sizes[root(&mut parent, v) as usize] += 1;
    }
    let largest = (0..sizes.len()).max_by_key(|&i| (sizes[i], std::cmp::Reverse(i))).unwrap_or(0);
    if sizes.get(largest).is_none_or(|&size| size as usize == parent.len()) {
        return surface;
    }
    let mut new_ids = vec![u32::MAX; parent.len()];
    let mut positions = Vec::with_capacity(sizes[largest] as usize);
    for (v, new_id) in new_ids.iter_mut().enumerate() {
        if root(&mut parent, v as u32) as usize == largest {
            *new_id = positions.len() as u32;
            positions.push(surface.positions[v]);
        }
    }
    let kept = surface.triangles.iter().filter(|t| new_ids[t[0] as usize] != u32::MAX);
    let triangles = kept.map(|t| t.map(|v| new_ids[v as usize])).collect();
    Surface { positions, triangles }
}

/// The triangles of each of the 256 sign patterns, over the cell's edges.
///
/// Corner i lies at (i & 1, i >> 1 & 1, i >> 2). Edges are numbered axis by axis, see [`edge_corner`].
static PATTERNS: LazyLock<Vec<Vec<[u8; 3]>>> = LazyLock::new(|| (0..256).map(pattern).collect());

/// The corner at which an edge starts; the edge goes along axis `edge / 4`.
fn edge_corner(edge: usize) -> usize {
    let (axis, k) = (edge / 4, edge % 4);
    // the two bits of k are those of the corner that are not the axis's
    let low = k & ((1 << axis) - 1);
    (k >> axis) << (axis + 1) | low
}

/// The edge between two corners that differ in one bit.
fn edge_between(a: usize, b: usize) -> usize {
    let axis = (a ^ b).trailing_zeros() as usize;
    let corner = a & b;
    4 * axis + (corner >> (axis + 1) << axis | corner & ((1 << axis) - 1))
}

/// The six faces as corners, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

fn pattern(inside: usize) -> Vec<[u8; 3]> {
    let is_inside = |corner: usize| inside >> corner & 1 == 1;
    // on each face, from the edge where the walk around it enters the inside to where it leaves
    let mut next = [None; 12];
    for face in FACES {
        for i in (0..4).filter(|&i| !is_inside(face[i]) && is_inside(face[(i + 1) % 4])) {
            let run = (1..4).take_while(|k| is_inside(face[(i + k) % 4])).count();
            let leave = edge_between(face[(i + run) % 4], face[(i + run + 1) % 4]);
            next[edge_between(face[i], face[(i + 1) % 4])] = Some(leave);
        }
    }
    let mut triangles = Vec::new();
    for start in 0..12 {
        let mut polygon = Vec::new();
        let mut edge = start;
        while let Some(following) = next[edge].take() {
            polygon.push(edge as u8);
            edge = following;
        }
        if polygon.len() >= 3 {
            triangles.extend(triangulate(&polygon).expect("every pattern has a triangulation off its faces"));
        }
    }
    triangles
}

/// Cuts a polygon over a cell's edges along diagonals of which none lies in a face of the cell.
fn triangulate(polygon: &[u8]) -> Option<Vec<[u8; 3]>> {
    let last = polygon.len() - 1;
    if last < 2 {
        return Some(Vec::new());
    }
    let allowed = |i: usize, k: usize| k - i < 2 || !share_face(polygon[i], polygon[k]);
    (1..last).filter(|&k| allowed(0, k) && allowed(k, last)).find_map(|k| {
        let mut triangles = triangulate(&polygon[..=k])?;
        triangles.push([polygon[0], polygon[k], polygon[last]]);
        triangles.extend(triangulate(&polygon[k..])?);
        Some(triangles)
    })
}

fn share_face(a: u8, b: u8) -> bool {
    let on = |edge: u8, face: &[usize; 4]| {
        let from = edge_corner(usize::from(edge));
        face.contains(&from) && face.contains(&(from | 1 << (edge / 4)))
    };
    FACES.iter().any(|face| on(a, face) && on(b, face))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::testing;

    #[test]
    fn every_pattern_can_be_triangulated_off_the_faces() {
        let counts: Vec<usize> = (0..256).map(|inside| pattern(inside).len()).collect();
        assert_eq!((counts[0], counts[1], counts[0b1111], counts[255]), (0, 1, 2, 0));
        for edge in 0..12 {
            let from = edge_corner(edge);
            assert_eq!(edge_between(from, from | 1 << (edge / 4)), edge);
        }
    }

    #[test]
    fn sphere_is_round_and_faces_outwards() {
        let sphere =
            Isosurface { distance: |p: Vec3| p.length() - 1.0, low: Vec3::splat(-1.0), high: Vec3::ONE, noise: 0.0 };
        let surface = sphere.with_triangles(20_000);
        assert!(surface.triangles.len().abs_diff(20_000) < 1000);
        assert_eq!(testing::euler(&surface.triangles), 2);
        assert!(surface.positions.iter().all(|&p| (Vec3::from(p).length() - 1.0).abs() < 2e-3));
        let volume = testing::volume(&surface.positions, &surface.triangles);
        assert!((volume / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01, "{volume}");
    }

    #[test]
    fn rough_noise_still_gives_a_closed_manifold() {
        // every sign pattern occurs, ambiguous ones too
        let distance = |p: Vec3| 0.4 * (noise::gradient(p * 2.0, 3) * 0.2).max(p.abs().max_element() - 1.0);
        let rough = Isosurface { distance, low: Vec3::splat(-1.0), high: Vec3::ONE, noise: 0.6 };
        let surface = rough.extract(0.06);
        assert!(surface.triangles.len() > 5000);
        testing::assert_closed_manifold(&surface.triangles);
    }

    #[test]
    fn distance_that_is_too_steep_still_gives_a_closed_manifold() {
        for slope in [1.2, 1.5, 2.0] {
            let distance = |p: Vec3| slope * (p.length() - 1.0);
            let steep = Isosurface { distance, low: Vec3::splat(-1.0), high: Vec3::ONE, noise: 0.1 };
            let surface = steep.extract(0.02);
            testing::assert_closed_manifold(&surface.triangles);
            assert_eq!(testing::euler(&surface.triangles), 2, "slope {slope}");
        }
    }
}
