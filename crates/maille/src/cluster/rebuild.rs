//! The mesh of the cells: triangles, wedges, attributes.

use rayon::prelude::*;

use super::cells::NONE;
use super::{ClusterMethod, ClusterOptions, Clusters, Input};
use crate::mesh::{first_equals, mix, random_seed};
use crate::topology::UnionFind;
use crate::{Attribute, Mesh, Semantic};

/// The triangles that are left, of those with the same three cells and the same orientation the first.
pub(super) fn without_doubles(input: &Input<'_>, clusters: &Clusters) -> Vec<u32> {
    let cells = |&t: &u32| {
        let [a, b, c] = input.mesh.triangles[t as usize].map(|wedge| clusters.cells[wedge as usize]);
        // the lowest first
        if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        }
    };
    let keys: Vec<[u32; 3]> = clusters.survivors.par_iter().map(cells).collect();
    let seed = random_seed();
    let hash = |i: u32| {
        let [a, b, c] = keys[i as usize].map(u64::from);
        mix(mix(seed, a << 32 | b), c)
    };
    let first = first_equals(keys.len(), hash, |i, j| keys[i as usize] == keys[j as usize]);
    let kept = first.iter().zip(0..).filter(|&(&first, i)| first == i);
    kept.map(|(&i, _)| clusters.survivors[i as usize]).collect()
}

/// The mesh of the triangles that are left, and the vertex of each cell, `NONE` if it has no triangle.
pub(super) fn rebuild(
    input: &Input<'_>,
    clusters: &Clusters,
    kept: &[u32],
    options: &ClusterOptions,
) -> (Mesh, Vec<u32>) {
    let mesh = input.mesh;
    let has_wedges = !mesh.wedge_attributes.is_empty() || !mesh.morph_targets.is_empty();
    let groups = has_wedges.then(|| groups(input, clusters));
    let groups = groups.as_ref().unwrap_or(&clusters.cells);
    let group_count = if has_wedges { mesh.wedge_count() } else { clusters.positions.len() };
    let mut wedge_of_group = Numbers::new(group_count);
    let mut vertex_of_cell = Numbers::new(clusters.positions.len());
    let mut result = Mesh { material_names: mesh.material_names.clone(), ..Mesh::default() };
    let mut number = |wedge: u32| {
        let cell = clusters.cells[wedge as usize];
        let vertex = vertex_of_cell.number(cell);
        if vertex as usize == result.positions.len() {
            result.positions.push(clusters.positions[cell as usize]);
        }
        let new = wedge_of_group.number(groups[wedge as usize]);
        if new as usize == result.wedge_vertices.len() {
            result.wedge_vertices.push(vertex);
        }
        new
    };
    result.triangles = kept.iter().map(|&t| mesh.triangles[t as usize].map(&mut number)).collect();
    if !mesh.triangle_materials.is_empty() {
        result.triangle_materials = kept.iter().map(|&t| mesh.triangle_materials[t as usize]).collect();
    }
    result.triangle_attributes = gathered(&mesh.triangle_attributes, kept);
    let averaged = matches!(options.method, ClusterMethod::Mean | ClusterMethod::Quadric);
    if has_wedges {
        let members = |w: usize| (w as u32, wedge_of_group.of(groups[w]));
        let merged = Merged::new(input, clusters, result.wedge_count(), averaged, (0..groups.len()).map(members));
        result.wedge_attributes = mesh.wedge_attributes.iter().map(|a| merged.attribute(a, true)).collect();
        result.morph_targets = mesh.morph_targets.clone();
        for target in &mut result.morph_targets {
            target.attributes.iter_mut().for_each(|a| *a = merged.attribute(a, false));
        }
    }
    if !mesh.vertex_attributes.is_empty() {
        let members = |w: usize| (w as u32, vertex_of_cell.of(clusters.cells[w]));
        let mut merged =
            Merged::new(input, clusters, result.vertex_count(), averaged, (0..clusters.cells.len()).map(members));
        merged.speak_of_vertices(mesh);
        result.vertex_attributes = mesh.vertex_attributes.iter().map(|a| merged.attribute(a, true)).collect();
    }
    (result, vertex_of_cell.numbers)
}

/// For each wedge one that stands for all of its cell that triangles within the cell join to it: the smooth sectors of the
/// cell. Across a seam none does.
fn groups(input: &Input<'_>, clusters: &Clusters) -> Vec<u32> {
    let mut sets = UnionFind::new(input.mesh.wedge_count());
    for &[a, b, c] in &input.mesh.triangles {
        for (one, other) in [(a, b), (b, c), (c, a)] {
            if clusters.cells[one as usize] == clusters.cells[other as usize] {
                sets.union(one, other);
            }
        }
    }
    sets.into_roots()
}

fn gathered(attributes: &[Attribute], source: &[u32]) -> Vec<Attribute> {
    let mut gathered = attributes.to_vec();
    gathered.iter_mut().for_each(|attribute| attribute.gather(source));
    gathered
}

/// New numbers, given out as they are asked for.
struct Numbers {
    numbers: Vec<u32>,
    next: u32,
}

impl Numbers {
    fn new(count: usize) -> Self {
        Self { numbers: vec![NONE; count], next: 0 }
    }

    fn number(&mut self, old: u32) -> u32 {
        let number = &mut self.numbers[old as usize];
        if *number == NONE {
            *number = self.next;
            self.next += 1;
        }
        *number
    }

    /// `NONE` for what has no number, or is none.
    fn of(&self, old: u32) -> u32 {
        self.numbers.get(old as usize).copied().unwrap_or(NONE)
    }
}

/// Which old elements became which new ones, for attributes.
struct Merged {
    /// Old and new element of each pair.
    members: Vec<(u32, u32)>,
    /// For each new element the old one nearest to where it is.
    nearest: Vec<u32>,
    averaged: bool,
}

impl Merged {
    /// `members` are wedges and new elements.
    fn new(
        input: &Input<'_>,
        clusters: &Clusters,
        count: usize,
        averaged: bool,
        members: impl Iterator<Item = (u32, u32)>,
    ) -> Self {
        let members: Vec<(u32, u32)> = members.filter(|&(_, new)| new != NONE).collect();
        let mut nearest = vec![(f64::INFINITY, 0); count];
        for &(wedge, new) in &members {
            let there = glam::Vec3::from(clusters.positions[clusters.cells[wedge as usize] as usize]).as_dvec3();
            let here = input.mesh.positions[input.mesh.wedge_vertices[wedge as usize] as usize];
            let distance = there.distance_squared(glam::Vec3::from(here).as_dvec3());
            let best = &mut nearest[new as usize];
            if distance < best.0 {
                *best = (distance, wedge);
            }
        }
        Self { members, nearest: nearest.into_iter().map(|(_, wedge)| wedge).collect(), averaged }
    }

    /// From wedges to their vertices.
    fn speak_of_vertices(&mut self, mesh: &Mesh) {
        let old = self.members.iter_mut().map(|(old, _)| old).chain(&mut self.nearest);
        old.for_each(|old| *old = mesh.wedge_vertices[*old as usize]);
    }

    /// The attribute of the new elements. Directions become unit; those of morph targets are differences, and do not.
    fn attribute(&self, attribute: &Attribute, unit: bool) -> Attribute {
        let mut result = attribute.clone();
        result.gather(&self.nearest);
        let components = attribute.components;
        let (Some(old), Some(new)) = (attribute.as_f32(), result.as_f32_mut()) else { return result };
        if !self.averaged || matches!(attribute.semantic, Semantic::Weights(_)) {
            return result;
        }
        let mut sums = vec![0.0_f64; new.len()];
        let mut counts = vec![0_u32; self.nearest.len()];
        for &(from, to) in &self.members {
            let (from, to) = (from as usize, to as usize);
            counts[to] += 1;
            let sum = &mut sums[to * components..][..components];
            sum.iter_mut().zip(&old[from * components..]).for_each(|(sum, &x)| *sum += f64::from(x));
        }
        let direction = unit && matches!(attribute.semantic, Semantic::Normal | Semantic::Tangent) && components >= 3;
        for ((sum, count), new) in sums.chunks_exact(components).zip(counts).zip(new.chunks_exact_mut(components)) {
            // the sign of a tangent's bitangent is that of the nearest
            let averaged = if direction { 3 } else { components };
            let length = sum[..averaged].iter().map(|x| x * x).sum::<f64>().sqrt();
            let by = if direction { length } else { f64::from(count) };
            // opposite directions have no mean
            if !direction || length > 1e-3 * f64::from(count) {
                new.iter_mut().zip(sum).take(averaged).for_each(|(new, sum)| *new = (sum / by) as f32);
            }
        }
        result
    }
}
