//! Correspondences by nearest points.

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Correspondence;
use crate::Mesh;
use crate::measure::Bvh;
use crate::mesh::{MeshError, Semantic};
use crate::topology::UnionFind;
use crate::topology::edges::deal;

/// Vertices searched for one after the other, each with the answer of the one before as its first guess.
const CHUNK: usize = 4096;

pub(super) fn closest(finer: &Mesh, coarser: &Mesh) -> Result<Correspondence, MeshError> {
    finer.check()?;
    coarser.check()?;
    let nearest = nearest_vertices(finer, coarser);
    let wedges_of = WedgesOfVertices::new(coarser);
    let fields = shared_fields(finer, coarser);
    let mut points = VanishingPoints::new(finer, coarser);
    let wedges = (finer.wedge_vertices.iter().zip(0..))
        .map(|(&v, wedge)| match nearest[v as usize] {
            Some(vertex) => best_wedge(&fields, wedge, wedges_of.get(vertex)),
            None => points.of(v),
        })
        .collect();
    Ok(Correspondence { wedges, vanishing: points.points, coarser_wedges: coarser.wedge_count() as u32 })
}

/// For each vertex of the finer level the vertex of the coarser one that it goes to; `None` where there is none.
fn nearest_vertices(finer: &Mesh, coarser: &Mesh) -> Vec<Option<u32>> {
    let bvh = Bvh::new(coarser);
    let chunk = |positions: &[[f32; 3]]| -> Vec<Option<u32>> {
        let mut searcher = bvh.searcher();
        let nearest = |&p: &[f32; 3]| {
            let found = searcher.closest(Vec3::from(p).as_dvec3())?;
            let [a, b, c] = found.barycentric;
            let corner = if a >= b && a >= c { 0 } else { 1 + usize::from(b < c) };
            Some(coarser.triangle_vertices(found.triangle as usize)[corner])
        };
        positions.iter().map(nearest).collect()
    };
    finer.positions.par_chunks(CHUNK).flat_map_iter(chunk).collect()
}

/// The wedges of each vertex that triangles use, in ascending order.
struct WedgesOfVertices {
    starts: Vec<u32>,
    wedges: Vec<u32>,
}

impl WedgesOfVertices {
    fn new(mesh: &Mesh) -> Self {
        let mut is_used = vec![false; mesh.wedge_count()];
        mesh.triangles.as_flattened().iter().for_each(|&wedge| is_used[wedge as usize] = true);
        let used = || (mesh.wedge_vertices.iter().zip(0_u32..)).filter(|&(_, wedge)| is_used[wedge as usize]);
        let (starts, wedges) = deal(mesh.vertex_count(), || used().map(|(&v, wedge)| (v, wedge)), |wedge| wedge);
        Self { starts, wedges }
    }

    fn get(&self, vertex: u32) -> &[u32] {
        &self.wedges[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}

/// A float attribute of both levels, one element per wedge.
type SharedField<'m> = (usize, &'m [f32], &'m [f32]);

fn shared_fields<'m>(finer: &'m Mesh, coarser: &'m Mesh) -> Vec<SharedField<'m>> {
    let shared = |mine: &'m crate::Attribute| {
        let other = coarser.wedge_attribute(&mine.semantic).filter(|other| other.components == mine.components)?;
        Some((mine.components, mine.as_f32()?, other.as_f32()?))
    };
    let counts = |semantic: &Semantic| matches!(semantic, Semantic::Normal | Semantic::TexCoord(_));
    finer.wedge_attributes.iter().filter(|mine| counts(&mine.semantic)).filter_map(shared).collect()
}

/// The wedge among `candidates` whose attributes differ least.
fn best_wedge(fields: &[SharedField<'_>], wedge: usize, candidates: &[u32]) -> u32 {
    let difference = |&candidate: &u32| -> f64 {
        let one = |&(n, mine, other): &SharedField<'_>| {
            let pairs = mine[wedge * n..][..n].iter().zip(&other[candidate as usize * n..][..n]);
            pairs.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>()
        };
        fields.iter().map(one).sum()
    };
    let least = candidates.iter().min_by(|a, b| difference(a).total_cmp(&difference(b)));
    *least.expect("a vertex that triangles have has a wedge")
}

/// Points that parts without counterpart shrink to, made as they are asked for.
struct VanishingPoints<'m> {
    finer: &'m Mesh,
    coarser_wedges: u32,
    /// A number for the part that each vertex belongs to, and its middle; empty where only odd vertices vanish.
    parts: (Vec<u32>, Vec<[f32; 3]>),
    /// Where in `points` the point of a part (true) or of a vertex on its own is.
    places: BTreeMap<(bool, u32), u32>,
    points: Vec<[f32; 3]>,
}

impl<'m> VanishingPoints<'m> {
    fn new(finer: &'m Mesh, coarser: &Mesh) -> Self {
        let coarser_wedges = coarser.wedge_count() as u32;
        let parts = if coarser.triangles.is_empty() { parts(finer) } else { (Vec::new(), Vec::new()) };
        Self { finer, coarser_wedges, parts, places: BTreeMap::new(), points: Vec::new() }
    }

    /// Target of the wedges of a vertex.
    fn of(&mut self, vertex: u32) -> u32 {
        let own = self.finer.positions[vertex as usize];
        let is_finite = own.iter().all(|x| x.is_finite());
        let (key, point) = match self.parts.0.get(vertex as usize) {
            Some(&part) if is_finite => ((true, part), self.parts.1[part as usize]),
            _ => ((false, vertex), own),
        };
        let next = self.points.len() as u32;
        let place = *self.places.entry(key).or_insert(next);
        if place == next {
            self.points.push(point);
        }
        self.coarser_wedges + place
    }
}

/// For each vertex the lowest one of its part (what triangles join), and for those the mean of the part's vertices.
fn parts(mesh: &Mesh) -> (Vec<u32>, Vec<[f32; 3]>) {
    let mut sets = UnionFind::new(mesh.vertex_count());
    for triangle in 0..mesh.triangle_count() {
        let [a, b, c] = mesh.triangle_vertices(triangle);
        sets.union(a, b);
        sets.union(a, c);
    }
    let roots = sets.into_roots();
    let mut sums = vec![(DVec3::ZERO, 0.0); mesh.vertex_count()];
    for (&root, &p) in roots.iter().zip(&mesh.positions) {
        let p = Vec3::from(p);
        if p.is_finite() {
            let (sum, count) = &mut sums[root as usize];
            *sum += p.as_dvec3();
            *count += 1.0;
        }
    }
    let mean = |&(sum, count): &(DVec3, f64)| (sum / f64::max(count, 1.0)).as_vec3().into();
    (roots, sums.iter().map(mean).collect())
}
