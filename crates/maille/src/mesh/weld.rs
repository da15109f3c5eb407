//! Merging vertices that coincide, wedges that agree, and the way back.

use std::hash::BuildHasher;

use rayon::slice::ParallelSliceMut;

use super::{Attribute, Mesh, Values};
use crate::topology::UnionFind;

/// Which vertices and wedges [`Mesh::weld`] merges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeldOptions {
    /// Largest distance between two vertices that are merged, in model units. 0 merges only equal positions (bit by
    /// bit, except that -0 equals 0), and so do numbers below it and NaN.
    pub tolerance: f64,
    /// Also merges wedges of one vertex whose attributes and morph targets all agree: every float within this absolute
    /// difference (0: the same bits), every integer the same. `None` leaves the wedges alone.
    pub wedge_tolerance: Option<f32>,
}

impl WeldOptions {
    /// Equal positions; wedges stay as they are. What readers of formats with wedges (glTF) need.
    pub const EXACT: Self = Self { tolerance: 0.0, wedge_tolerance: None };
    /// Equal positions, and wedges that agree bit by bit. What readers of triangle soups (STL) need.
    pub const EXACT_WITH_WEDGES: Self = Self { tolerance: 0.0, wedge_tolerance: Some(0.0) };
}

impl Default for WeldOptions {
    fn default() -> Self {
        Self::EXACT
    }
}

/// What [`Mesh::weld`] changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WeldReport {
    /// Vertices that went into another one.
    pub vertices_merged: usize,
    /// Wedges that went into another one.
    pub wedges_merged: usize,
}

impl Mesh {
    /// Merges vertices at the same place and, if asked, wedges of one vertex that agree.
    ///
    /// With a tolerance, merging is transitive: a chain of vertices, each within the tolerance of the next, becomes one
    /// vertex. The lowest index of a group survives with its position and vertex attributes, so the result does not
    /// depend on anything but the input; survivors keep their order. Triangles keep their number and order: those that
    /// collapse are left for [`repair`](crate::repair). Vertices that are not finite merge only if their bits are equal.
    /// A tolerance below 2^-30 of the largest extent is too fine for `f32` and merges equal positions only.
    ///
    /// Wedges within a tolerance merge greedily: each into the first of the last 64 kept ones of its vertex that
    /// agrees with it.
    ///
    /// Cost: linear and some 12 bytes per vertex for equal positions; O(n log n) and some 36 bytes per vertex with a
    /// tolerance.
    ///
    /// ```
    /// use maille::{Mesh, mesh::WeldOptions};
    /// let corners = vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 1., 0.], [1., 0., 0.], [1., 1., 0.]];
    /// let mut soup = Mesh::from_triangles(corners, vec![[0, 1, 2], [3, 4, 5]])?;
    /// let report = soup.weld(&WeldOptions::EXACT);
    /// assert_eq!((report.vertices_merged, soup.vertex_count(), soup.wedge_count()), (2, 4, 6));
    /// # Ok::<(), maille::mesh::MeshError>(())
    /// ```
    pub fn weld(&mut self, options: &WeldOptions) -> WeldReport {
        let mut target = equal_positions(&self.positions);
        if options.tolerance > 0.0 {
            target = near_positions(&self.positions, target, options.tolerance);
        }
        WeldReport {
            vertices_merged: self.merge_vertices(target),
            wedges_merged: options.wedge_tolerance.map_or(0, |tolerance| self.weld_wedges(tolerance)),
        }
    }

    /// Gives every corner of every triangle a wedge and a vertex of its own: corner `i` of triangle `t` is then wedge
    /// and vertex `3 t + i`. Vertices and wedges without triangle are dropped.
    ///
    /// [`weld`](Self::weld) with [`WeldOptions::EXACT_WITH_WEDGES`] is the way back.
    pub fn unweld(&mut self) {
        self.gather_wedges(self.triangles.as_flattened().to_vec().as_slice());
        let vertices = std::mem::take(&mut self.wedge_vertices);
        self.gather_vertices(&vertices);
        self.wedge_vertices = (0..vertices.len() as u32).collect();
        for (t, triangle) in self.triangles.iter_mut().enumerate() {
            let first = 3 * t as u32;
            *triangle = [first, first + 1, first + 2];
        }
    }

    /// Merges every vertex into the one that `target` names (not above it, and its own target), and returns how many
    /// vanished.
    fn merge_vertices(&mut self, mut target: Vec<u32>) -> usize {
        let kept = number_survivors(&mut target);
        let merged = self.vertex_count() - kept.len();
        if merged > 0 {
            self.gather_vertices(&kept);
            for vertex in &mut self.wedge_vertices {
                *vertex = target[*vertex as usize];
            }
        }
        merged
    }

    fn weld_wedges(&mut self, tolerance: f32) -> usize {
        let mut target = self.equal_wedges();
        if tolerance > 0.0 {
            self.near_wedges(&mut target, tolerance);
        }
        let kept = number_survivors(&mut target);
        let merged = self.wedge_count() - kept.len();
        if merged > 0 {
            self.gather_wedges(&kept);
            for wedge in self.triangles.as_flattened_mut() {
                *wedge = target[*wedge as usize];
            }
        }
        merged
    }

    /// Everything that distinguishes two wedges of one vertex.
    fn wedge_data(&self) -> impl Iterator<Item = &Attribute> {
        self.wedge_attributes.iter().chain(self.morph_targets.iter().flat_map(|morph| &morph.attributes))
    }

    /// For each wedge the first one with the same vertex and the same bits in all attributes.
    fn equal_wedges(&self) -> Vec<u32> {
        let seed = random_seed();
        let mut hashes: Vec<u64> = self.wedge_vertices.iter().map(|&v| mix(seed, u64::from(v))).collect();
        for attribute in self.wedge_data() {
            let each = |element: &mut dyn Iterator<Item = u32>, hash: u64| element.fold(hash, |h, x| mix(h, x.into()));
            for (i, hash) in hashes.iter_mut().enumerate() {
                let range = i * attribute.components..(i + 1) * attribute.components;
                *hash = match &attribute.values {
                    Values::F32(values) => each(&mut values[range].iter().map(|x| x.to_bits()), *hash),
                    Values::U32(values) => each(&mut values[range].iter().copied(), *hash),
                };
            }
        }
        let same = |a: u32, b: u32| {
            self.wedge_vertices[a as usize] == self.wedge_vertices[b as usize]
                && self.wedge_data().all(|attribute| agree(attribute, a, b, 0.0))
        };
        first_equals(self.wedge_count(), |i| hashes[i as usize], same)
    }

    /// Sends each wedge that is its own target to an earlier one of the same vertex that agrees within the tolerance.
    fn near_wedges(&self, target: &mut [u32], tolerance: f32) {
        // bounds the work at a vertex with very many wedges; real ones have a dozen
        const LOOK_BACK: usize = 64;
        let mut last = vec![NONE; self.vertex_count()];
        let mut previous = vec![NONE; self.wedge_count()];
        for wedge in 0..self.wedge_count() as u32 {
            let w = wedge as usize;
            if target[w] != wedge {
                target[w] = target[target[w] as usize];
                continue;
            }
            let last = &mut last[self.wedge_vertices[w] as usize];
            let link = |&kept: &u32| Some(previous[kept as usize]).filter(|&p| p != NONE);
            let chain = std::iter::successors(Some(*last).filter(|&w| w != NONE), link).take(LOOK_BACK);
            let near = |&kept: &u32| self.wedge_data().all(|attribute| agree(attribute, kept, wedge, tolerance));
            // the lowest of those that agree: the chain runs from the highest to the lowest
            if let Some(found) = chain.filter(near).last() {
                target[w] = found;
            } else {
                previous[w] = *last;
                *last = wedge;
            }
        }
    }
}

const NONE: u32 = u32::MAX;

/// Whether two elements of an attribute have the same bits or floats closer than the tolerance.
fn agree(attribute: &Attribute, a: u32, b: u32, tolerance: f32) -> bool {
    let n = attribute.components;
    let (a, b) = (a as usize * n, b as usize * n);
    match &attribute.values {
        Values::F32(values) => {
            let near =
                |(x, y): (&f32, &f32)| x.to_bits() == y.to_bits() || tolerance > 0.0 && (x - y).abs() <= tolerance;
            values[a..a + n].iter().zip(&values[b..b + n]).all(near)
        }
        Values::U32(values) => values[a..a + n] == values[b..b + n],
    }
}

/// Turns "merge into" (an index not above the own one, and its own target) into new indices, and returns the old
/// index of each new one.
fn number_survivors(target: &mut [u32]) -> Vec<u32> {
    let mut kept = Vec::with_capacity(target.iter().enumerate().filter(|&(i, &t)| t as usize == i).count());
    for i in 0..target.len() {
        if target[i] as usize == i {
            target[i] = kept.len() as u32;
            kept.push(i as u32);
        } else {
            // the target is lower, so it has its new index already
            target[i] = target[target[i] as usize];
        }
    }
    kept
}

/// A seed that differs from run to run, so that no file can be made to collide on purpose. No result depends on it:
/// only which slots are probed does.
pub(crate) fn random_seed() -> u64 {
    std::hash::RandomState::new().hash_one(0)
}

/// Folds a number into a hash by a 128-bit product (as wyhash does).
pub(crate) fn mix(hash: u64, x: u64) -> u64 {
    let product = u128::from(hash ^ 0xa076_1d64_78bd_642f) * u128::from(x ^ 0xe703_7ed1_a0b4_28db);
    (product >> 64) as u64 ^ product as u64 ^ hash.rotate_left(23)
}

/// For each of `count` elements the first one equal to it, itself if there is none before.
///
/// Open addressing over `u32` ids: 5.3 to 10.7 bytes per element.
pub(crate) fn first_equals(count: usize, hash: impl Fn(u32) -> u64, equal: impl Fn(u32, u32) -> bool) -> Vec<u32> {
    let slots = (count + count / 3 + 1).next_power_of_two();
    let mut table = vec![NONE; slots];
    (0..count as u32)
        .map(|i| {
            let mut slot = hash(i) as usize & (slots - 1);
            loop {
                match table[slot] {
                    NONE => {
                        table[slot] = i;
                        return i;
                    }
                    first if equal(first, i) => return first,
                    _ => slot = (slot + 1) & (slots - 1),
                }
            }
        })
        .collect()
}

/// For each position the first one equal to it.
fn equal_positions(positions: &[[f32; 3]]) -> Vec<u32> {
    let seed = random_seed();
    // adding 0 turns -0 into 0
    let bits = |i: u32| positions[i as usize].map(|x| (x + 0.0).to_bits());
    let hash = |i| {
        let [x, y, z] = bits(i).map(u64::from);
        mix(mix(seed, x | y << 32), z)
    };
    first_equals(positions.len(), hash, |a, b| bits(a) == bits(b))
}

/// Unites positions within the tolerance of each other, starting from those that are equal.
///
/// A grid of cells whose diagonal is the tolerance: what shares a cell is united without looking; two cells within
/// reach (two steps along each axis) are compared point by point until they are united. Nearest offsets go first, so
/// that a tolerance far too large costs no more than a small one. Cells are kept sorted and each offset is one sweep of
/// two pointers: no table, no random access.
fn near_positions(positions: &[[f32; 3]], equal: Vec<u32>, tolerance: f64) -> Vec<u32> {
    let Some(grid) = Grid::new(positions, tolerance) else { return equal };
    let mut cells: Vec<u128> = (0..positions.len() as u32)
        .filter(|&i| equal[i as usize] == i)
        .filter_map(|i| grid.cell(positions[i as usize]).map(|cell| cell << 32 | u128::from(i)))
        .collect();
    cells.par_sort_unstable();
    let mut sets = UnionFind::from_targets(equal);
    let groups: Vec<&[u128]> = cells.chunk_by(|a, b| a >> 32 == b >> 32).collect();
    for group in &groups {
        group.iter().for_each(|&entry| _ = sets.union(group[0] as u32, entry as u32));
    }
    let point = |entry: u128| glam::Vec3::from(positions[entry as u32 as usize]).as_dvec3();
    let limit = tolerance * tolerance;
    for offset in neighbour_offsets() {
        let mut j = 0;
        for group in &groups {
            let wanted = (group[0] >> 32) as i128 + offset;
            while j < groups.len() && ((groups[j][0] >> 32) as i128) < wanted {
                j += 1;
            }
            let Some(other) = groups.get(j).filter(|other| (other[0] >> 32) as i128 == wanted) else { continue };
            if sets.find(group[0] as u32) == sets.find(other[0] as u32) {
                continue;
            }
            let near = |a: u128| other.iter().any(|&b| point(a).distance_squared(point(b)) <= limit);
            if group.iter().any(|&a| near(a)) {
                sets.union(group[0] as u32, other[0] as u32);
            }
        }
    }
    sets.into_roots()
}

/// Steps to the cells that may hold a point within the tolerance, half of them (the other half looks back), nearest
/// first, in the units of [`Grid::cell`].
fn neighbour_offsets() -> Vec<i128> {
    let steps = (-2..=2i32).flat_map(|z| (-2..=2i32).flat_map(move |y| (-2..=2i32).map(move |x| [z, y, x])));
    let mut steps: Vec<_> = steps.filter(|&step| step > [0; 3]).collect();
    steps.sort_by_key(|step| step.map(|x| x * x).iter().sum::<i32>());
    steps.into_iter().map(|step| step.iter().fold(0, |key, &x| (key << 32) + i128::from(x))).collect()
}

/// Maps positions to cells, packed in 32 bits per axis.
struct Grid {
    low: [f32; 3],
    size: f64,
}

impl Grid {
    /// `None` when the cells would be too many to be numbered.
    fn new(positions: &[[f32; 3]], tolerance: f64) -> Option<Self> {
        let finite = positions.iter().filter(|p| p.iter().all(|x| x.is_finite()));
        let start = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let (low, high) = finite
            .fold(start, |(low, high), p| ([0, 1, 2].map(|i| p[i].min(low[i])), [0, 1, 2].map(|i| p[i].max(high[i]))));
        // a hair below, so that two points of a cell are within the tolerance in spite of rounding
        let size = tolerance / 3f64.sqrt() * (1.0 - 1e-9);
        let fits = (0..3).all(|i| (f64::from(high[i]) - f64::from(low[i])) / size < f64::from(1 << 30));
        fits.then_some(Self { low, size })
    }

    fn cell(&self, position: [f32; 3]) -> Option<u128> {
        if !position.iter().all(|x| x.is_finite()) {
            return None;
        }
        // from 2, so that a step back from the first cell stays in its own 32 bits
        let along = |i: usize| ((f64::from(position[i]) - f64::from(self.low[i])) / self.size) as u128 + 2;
        Some(along(2) << 64 | along(1) << 32 | along(0))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mesh::{MorphTarget, Semantic, shapes};

    /// Positions of all corners: what welding equal positions must not change.
    fn corner_positions(mesh: &Mesh) -> Vec<[f32; 3]> {
        (0..mesh.triangle_count())
            .flat_map(|t| mesh.triangle_vertices(t))
            .map(|v| mesh.positions[v as usize].map(|x| x + 0.0))
            .collect()
    }

    #[test]
    fn exact_weld_closes_a_soup_and_keeps_its_wedges() {
        let mut mesh = shapes::sphere(2);
        let whole = mesh.clone();
        mesh.unweld();
        assert_eq!((mesh.vertex_count(), mesh.wedge_count()), (384, 384));
        mesh.positions[5] = mesh.positions[5].map(|x| if x == 0.0 { -0.0 } else { x });
        let report = mesh.weld(&WeldOptions::EXACT);
        assert_eq!((mesh.vertex_count(), mesh.wedge_count()), (66, 384));
        assert_eq!(report, WeldReport { vertices_merged: 318, wedges_merged: 0 });
        assert_eq!(corner_positions(&mesh), corner_positions(&whole));
        assert_eq!(mesh.weld(&WeldOptions::EXACT_WITH_WEDGES).wedges_merged, 318);
        assert_eq!(mesh.check(), Ok(()));
    }

    #[test]
    fn wedges_that_differ_in_any_attribute_or_morph_stay_apart() {
        let mut mesh = shapes::grid(1);
        mesh.unweld();
        let uv = |x: f32| {
            Attribute::new_f32(Semantic::TexCoord(0), 2, vec![0.5, 0.5, 0., 0., 0., 0., 0.5, x, 0., 0., 0., 0.])
        };
        mesh.wedge_attributes = vec![uv(0.5)];
        let mut seamed = mesh.clone();
        seamed.wedge_attributes = vec![uv(0.6)];
        let mut morphed = mesh.clone();
        let mut delta = vec![0.0; 18];
        delta[0] = 1.0;
        let attributes = vec![Attribute::new_f32(Semantic::Position, 3, delta)];
        morphed.morph_targets = vec![MorphTarget { name: String::new(), attributes }];
        let merged = |mut mesh: Mesh, tolerance| {
            mesh.weld(&WeldOptions { tolerance: 0.0, wedge_tolerance: Some(tolerance) }).wedges_merged
        };
        assert_eq!(merged(mesh, 0.0), 2);
        assert_eq!((merged(seamed.clone(), 0.0), merged(seamed, 0.11)), (1, 2));
        assert_eq!(merged(morphed, 0.5), 1);
    }

    #[test]
    fn tolerance_is_a_distance_and_merging_is_transitive() {
        let line = |gap: f32| (0..5).map(|i| [0.0, i as f32 * gap, 0.0]).collect::<Vec<_>>();
        let weld = |positions, tolerance| {
            let mut mesh = Mesh::from_triangles(positions, vec![]).unwrap();
            mesh.weld(&WeldOptions { tolerance, wedge_tolerance: None });
            mesh.positions
        };
        assert_eq!(weld(line(1.0), 0.999).len(), 5);
        assert_eq!(weld(line(1.0), 1.0), [[0.0; 3]]);
        assert_eq!(weld(vec![[1.0, 1.0, 1.0], [0.0; 3]], 1.72).len(), 2);
        assert_eq!(weld(vec![[1.0, 1.0, 1.0], [0.0; 3]], 1.74), [[1.0, 1.0, 1.0]]);
        let odd = [[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0], [0.0; 3], [1e30, 0.0, 0.0], [1e-3, 0.0, 0.0]];
        assert_eq!(weld(odd.to_vec(), 1e-2).len(), 5, "the grid would be too fine");
        assert_eq!(weld(odd.to_vec(), 1e29).len(), 4);
    }

    #[test]
    fn a_tolerance_beyond_the_model_merges_all_in_linear_time() {
        let mut mesh = shapes::torus(2.0, 0.5, 300, 200);
        mesh.weld(&WeldOptions { tolerance: 10.0, wedge_tolerance: None });
        assert_eq!(mesh.vertex_count(), 1);
    }

    fn points() -> impl Strategy<Value = Vec<[f32; 3]>> {
        let coordinate = prop_oneof![Just(0.0f32), Just(-0.0), Just(1.0), -1.0..1.0f32];
        prop::collection::vec([coordinate.clone(), coordinate.clone(), coordinate], 0..60)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn near_positions_agree_with_all_pairs(points in points(), tolerance in 0.0..0.8f64) {
            let mut sets = UnionFind::new(points.len());
            let at = |i: usize| glam::Vec3::from(points[i]).as_dvec3();
            for i in 0..points.len() {
                for j in 0..i {
                    if at(i).distance_squared(at(j)) <= tolerance * tolerance {
                        sets.union(i as u32, j as u32);
                    }
                }
            }
            let expected: Vec<_> = sets.into_roots().iter().enumerate().filter(|&(i, &r)| i as u32 == r).map(|(i, _)| points[i]).collect();
            let mut mesh = Mesh::from_triangles(points, vec![]).unwrap();
            mesh.weld(&WeldOptions { tolerance, wedge_tolerance: None });
            prop_assert_eq!(mesh.positions, expected);
        }

        #[test]
        fn weld_is_idempotent_and_restores_what_unweld_took_apart(
            points in points(), corners in prop::collection::vec(0u32..60, 0..90),
        ) {
            let count = points.len() as u32;
            let triangles = if count == 0 { vec![] } else {
                corners.as_chunks().0.iter().map(|t: &[u32; 3]| t.map(|v| v % count)).collect()
            };
            let mut mesh = Mesh::from_triangles(points, triangles).unwrap();
            mesh.wedge_attributes = vec![Attribute::new_u32(Semantic::Joints(0), 1, (0..count).map(|i| i % 3).collect())];
            let before = corner_positions(&mesh);
            mesh.unweld();
            mesh.weld(&WeldOptions::EXACT_WITH_WEDGES);
            prop_assert_eq!(corner_positions(&mesh), before);
            let once = mesh.clone();
            prop_assert_eq!(mesh.weld(&WeldOptions::EXACT_WITH_WEDGES), WeldReport::default());
            prop_assert_eq!(&mesh, &once);
            mesh.unweld();
            mesh.weld(&WeldOptions::EXACT_WITH_WEDGES);
            prop_assert_eq!(mesh, once);
        }
    }
}
