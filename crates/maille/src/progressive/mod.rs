//! Progressive meshes: one mesh at any number of triangles, back and forth, exactly.

mod attributes;
mod build;
mod bytes;
mod check;
#[cfg(test)]
mod tests;

pub use bytes::DecodeError;

use std::ops::Range;

use crate::lod::Correspondence;
use crate::mesh::{Attribute, Mesh, Values};
use crate::prefetch::prefetch;
use crate::simplify::Lifted;
use attributes::{Attributes, Table};

/// How many steps ahead memory is fetched.
const AHEAD: usize = 8;

/// A mesh and all the edge collapses that take it to a base mesh, each of which can be undone by a vertex split
/// (Hoppe, SIGGRAPH 1996; seed 000, 4.1.1).
///
/// Vertices, wedges and triangles are numbered by how long they live: those of every level are the first ones of their
/// arrays, so that a GPU draws any level from one buffer. What a step changes besides is in small tables: the corners of
/// triangles that get another wedge, the position of the vertex that stays, attributes that were blended. Steps exchange what
/// the tables hold with what the arrays hold, so going to the base and back gives the same bits.
///
/// Memory beyond the mesh: about 56 bytes per collapse, and the attributes that it has changed.
///
/// # Examples
/// ```
/// use maille::progressive::ProgressiveMesh;
/// let sphere = maille::mesh::shapes::sphere(4);
/// let (mut progressive, _) = ProgressiveMesh::new(sphere, &Default::default(), Default::default())?;
/// progressive.seek_triangles(500);
/// assert_eq!(progressive.triangles().len(), 500);
/// let coarse = progressive.to_mesh();
/// progressive.seek(0);
/// assert_eq!(progressive.triangles().len(), 2048);
/// progressive.seek_triangles(500);
/// assert_eq!(progressive.to_mesh(), coarse);
/// # Ok::<(), maille::simplify::SimplifyError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ProgressiveMesh {
    /// All there ever is, but for attributes of wedges and vertices. Positions and corners are those of the level; what is
    /// beyond its counts is as it will be when it comes up.
    mesh: Mesh,
    /// Those attributes, likewise.
    attributes: Attributes,
    /// Attributes that are told as those of vertices.
    lifted: Lifted,
    log: CollapseLog,
    /// How many collapses have been made.
    at: usize,
}

/// How many of the first vertices, wedges and triangles a level has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Counts {
    /// Vertices.
    pub vertices: u32,
    /// Wedges.
    pub wedges: u32,
    /// Triangles.
    pub triangles: u32,
}

/// What the collapses of a [`ProgressiveMesh`] change. Vertices and wedges go in the order of their numbers, the last one
/// first; so most of what there is to know of a collapse is found by the number of what goes.
#[derive(Debug, Clone, PartialEq, Default)]
struct CollapseLog {
    /// Triangles before the first collapse and after each.
    triangles: Vec<u32>,
    /// Wedges.
    wedges: Vec<u32>,
    /// Vertices; empty where these are always as many as wedges.
    vertices: Vec<u32>,
    /// Error of each collapse, in model units.
    errors: Vec<f32>,
    /// What each collapse costs, as the metric of the simplifier has it; never less than the one before.
    costs: Vec<f32>,
    /// The collapses that come with the one before: no level ends between the two.
    followers: Vec<u32>,
    /// For each collapse, where the vertex that stays is on the other side of it.
    positions: Vec<[f32; 3]>,
    /// The vertex that each vertex merges into; itself, if its last triangle goes before it has merged.
    vertex_parents: Vec<u32>,
    /// The wedge that takes over the corners of each wedge; itself, if it has none to give.
    wedge_parents: Vec<u32>,
    /// Where the corners that each wedge gives away end.
    corner_ends: Vec<u32>,
    /// Three times the triangle, and the corner.
    corners: Vec<u32>,
    /// Where the wedges end whose attributes each collapse changes; empty if there are no attributes.
    changed_ends: Vec<u32>,
    changed: Vec<u32>,
    /// What the attributes of those wedges are on the other side of the collapse.
    rows: Table,
    /// For each collapse, what the attributes of the vertex that stays are on the other side.
    vertex_rows: Table,
}

impl CollapseLog {
    #[inline]
    fn counts(&self, collapses: usize) -> Counts {
        let wedges = self.wedges[collapses];
        let vertices = self.vertices.get(collapses).copied().unwrap_or(wedges);
        Counts { vertices, wedges, triangles: self.triangles[collapses] }
    }

    /// The wedges that a collapse takes away.
    #[inline]
    fn wedges_of(&self, step: usize) -> Range<u32> {
        self.wedges[step + 1]..self.wedges[step]
    }

    /// The vertex that stays in a collapse: the one into which the last vertex merges.
    #[inline]
    fn kept(&self, step: usize) -> u32 {
        self.vertex_parents[self.counts(step).vertices as usize - 1]
    }
}

/// The elements that belong to number i, if each number's end is known.
#[inline]
fn range_of(ends: &[u32], i: usize) -> Range<usize> {
    let start = if i == 0 { 0 } else { ends[i - 1] };
    start as usize..ends[i] as usize
}

impl ProgressiveMesh {
    /// Number of collapses from the finest level to the base.
    pub fn collapse_count(&self) -> usize {
        self.log.errors.len()
    }

    /// How many collapses have been made: 0 at the finest level.
    pub fn position(&self) -> usize {
        self.at
    }

    /// How much a level has, after some collapses.
    ///
    /// # Panics
    /// If there are not so many collapses.
    pub fn counts_at(&self, collapses: usize) -> Counts {
        self.log.counts(collapses)
    }

    /// How much the level has that the mesh is at.
    pub fn counts(&self) -> Counts {
        self.log.counts(self.at)
    }

    /// How many collapses lead to the finest level of at most so many triangles; to the base, if even that has more.
    pub fn collapses_to(&self, triangles: usize) -> usize {
        let enough = self.log.triangles.partition_point(|&count| count as usize > triangles);
        self.whole(enough.min(self.collapse_count()))
    }

    /// As many collapses, and those that come with the last one of them: what it leaves is no surface (two triangles back to
    /// back).
    pub fn whole(&self, mut collapses: usize) -> usize {
        while self.log.followers.binary_search(&(collapses as u32)).is_ok() {
            collapses += 1;
        }
        collapses
    }

    /// How many levels there are: all numbers of collapses but those that [`whole`](Self::whole) passes by.
    pub fn level_count(&self) -> usize {
        self.collapse_count() + 1 - self.log.followers.len()
    }

    /// Largest error of the first collapses, by the estimate of the metric, in model units: 0 at the finest level.
    ///
    /// # Panics
    /// If there are not so many collapses.
    pub fn error_at(&self, collapses: usize) -> f64 {
        collapses.checked_sub(1).map_or(0.0, |last| f64::from(self.log.errors[last]))
    }

    /// What each collapse costs by the metric, never less than the one before, in model units to the power that is
    /// [`MetricKind::cost_power`](crate::simplify::MetricKind::cost_power). Of several meshes that were simplified alike,
    /// levels of equal cost belong together.
    pub fn costs(&self) -> &[f32] {
        &self.log.costs
    }

    /// Bytes that it takes to make and undo all collapses, beyond the mesh.
    pub fn log_bytes(&self) -> usize {
        let log = &self.log;
        let rows = log.rows.words.len() + log.vertex_rows.words.len();
        let words = [&log.vertex_parents, &log.wedge_parents, &log.corner_ends, &log.corners, &log.followers]
            .into_iter()
            .chain([&log.changed_ends, &log.changed, &log.triangles, &log.wedges, &log.vertices])
            .map(Vec::len)
            .sum::<usize>();
        4 * (words + rows + log.errors.len() + log.costs.len() + 3 * log.positions.len())
    }

    /// How many material slots there are up to the highest that a triangle names.
    pub fn material_slots(&self) -> usize {
        self.mesh.triangle_materials.iter().max().map_or(1, |&slot| slot as usize + 1)
    }

    /// Positions of the vertices of the level.
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.mesh.positions[..self.counts().vertices as usize]
    }

    /// Triangles of the level, over wedges.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.mesh.triangles[..self.counts().triangles as usize]
    }

    /// Goes to the finest level of at most so many triangles, or to the base.
    pub fn seek_triangles(&mut self, triangles: usize) {
        self.seek(self.collapses_to(triangles));
    }

    /// Goes to the level after some collapses (or to the base, if there are not so many): cost is linear in the steps there.
    pub fn seek(&mut self, collapses: usize) {
        let collapses = collapses.min(self.collapse_count());
        while self.at < collapses {
            if self.at + AHEAD < collapses {
                self.prefetch(self.at + AHEAD);
            }
            self.collapse(self.at);
            self.at += 1;
        }
        while self.at > collapses {
            self.at -= 1;
            if self.at >= collapses + AHEAD {
                self.prefetch(self.at - AHEAD);
            }
            self.split(self.at);
        }
    }

    /// Makes a collapse.
    fn collapse(&mut self, step: usize) {
        for wedge in self.log.wedges_of(step) {
            self.rename_corners(wedge, self.log.wedge_parents[wedge as usize]);
        }
        self.exchange(step);
    }

    /// Undoes a collapse.
    fn split(&mut self, step: usize) {
        for wedge in self.log.wedges_of(step) {
            self.rename_corners(wedge, wedge);
        }
        self.exchange(step);
    }

    #[inline]
    fn rename_corners(&mut self, of: u32, wedge: u32) {
        let corners = self.mesh.triangles.as_flattened_mut();
        for &corner in &self.log.corners[range_of(&self.log.corner_ends, of as usize)] {
            corners[corner as usize] = wedge;
        }
    }

    /// Exchanges positions and attributes with those on the other side of a collapse.
    #[inline]
    fn exchange(&mut self, step: usize) {
        let log = &mut self.log;
        let kept = log.kept(step);
        std::mem::swap(&mut self.mesh.positions[kept as usize], &mut log.positions[step]);
        if !log.changed_ends.is_empty() {
            let range = range_of(&log.changed_ends, step);
            self.attributes.wedge_values.exchange(&log.changed[range.clone()], &mut log.rows, range.start);
        }
        if !self.attributes.vertices.is_empty() {
            self.attributes.vertex_values.exchange(&[kept], &mut log.vertex_rows, step);
        }
    }

    /// Has the processor fetch what a step will change. What is near on the surface is anywhere in the arrays, which are in the
    /// order of lifetimes: without this, a mesh of a million triangles goes at two thirds of the speed.
    #[inline]
    fn prefetch(&self, step: usize) {
        let log = &self.log;
        prefetch(&self.mesh.positions, log.kept(step) as usize);
        for wedge in log.wedges_of(step) {
            for &corner in &log.corners[range_of(&log.corner_ends, wedge as usize)] {
                prefetch(&self.mesh.triangles, corner as usize / 3);
            }
        }
        if !log.changed_ends.is_empty() {
            self.attributes.wedge_values.prefetch(&log.changed[range_of(&log.changed_ends, step)]);
        }
    }

    /// The level as a mesh of its own. Linear in the finest level.
    pub fn to_mesh(&self) -> Mesh {
        let counts = self.counts();
        let [vertices, wedges, triangles] =
            [counts.vertices, counts.wedges, counts.triangles].map(|count| count as usize);
        let vertex = self.vertices_at(self.at);
        let mut mesh = Mesh {
            positions: self.mesh.positions[..vertices].to_vec(),
            wedge_vertices: self.mesh.wedge_vertices[..wedges].iter().map(|&v| vertex[v as usize]).collect(),
            triangles: self.mesh.triangles[..triangles].to_vec(),
            triangle_attributes: self.mesh.triangle_attributes.iter().map(|a| first_of(a, triangles)).collect(),
            triangle_materials: self.mesh.triangle_materials.iter().copied().take(triangles).collect(),
            material_names: self.mesh.material_names.clone(),
            ..Mesh::default()
        };
        self.attributes.give_to(&mut mesh, counts);
        self.lifted.put_back(&mut mesh);
        mesh
    }

    /// Which wedge of a level each wedge of a finer one becomes (seed 000, 5.2), where the levels are those after `finer` and
    /// `coarser` collapses; goes to the coarser one. `meshes` are what [`to_mesh`](Self::to_mesh) has given for both, in that
    /// order, with their wedges where they were; other values may have changed.
    ///
    /// A wedge whose triangles have all vanished before its corners went to another one becomes, of those at its vertex, the
    /// one whose attributes are most alike; if the vertex is there no more, it ends at the last point that there was.
    /// Linear in the finest level.
    ///
    /// # Panics
    /// If there are not so many collapses, `finer` is more than `coarser`, or the meshes are not of these levels.
    pub fn correspondence(&mut self, [finer, coarser]: [usize; 2], meshes: [&Mesh; 2]) -> Correspondence {
        assert!(finer <= coarser, "the finer level comes first");
        self.seek(coarser);
        let [from, to] = [finer, coarser].map(|at| self.log.counts(at));
        assert_eq!([from.wedges, to.wedges].map(|n| n as usize), meshes.map(Mesh::wedge_count), "meshes of the levels");
        let merged = self.followed(&self.log.wedge_parents, to.wedges);
        let vertices = self.vertices_at(coarser);
        let at_vertex = WedgesOfVertices::new(meshes[1]);
        let mut vanishing: Vec<[f32; 3]> = Vec::new();
        let mut vanished = std::collections::HashMap::new();
        let target = |wedge: u32| {
            let merged = merged[wedge as usize];
            if merged < to.wedges {
                return merged;
            }
            let vertex = vertices[self.mesh.wedge_vertices[wedge as usize] as usize];
            if vertex < to.vertices {
                return at_vertex.most_alike(vertex, meshes, wedge);
            }
            *vanished.entry(vertex).or_insert_with(|| {
                vanishing.push(self.mesh.positions[vertex as usize]);
                to.wedges + vanishing.len() as u32 - 1
            })
        };
        let wedges = (0..from.wedges).map(target).collect();
        Correspondence { wedges, vanishing, coarser_wedges: to.wedges }
    }

    /// The vertex that each vertex of the finest level has become part of after some collapses; of a part of the surface that
    /// is no more, the last vertex of it that there was.
    fn vertices_at(&self, collapses: usize) -> Vec<u32> {
        self.followed(&self.log.vertex_parents, self.log.counts(collapses).vertices)
    }

    /// Where each number leads that is not below `count`. Parents have lower numbers than children.
    fn followed(&self, parents: &[u32], count: u32) -> Vec<u32> {
        let mut found: Vec<u32> = Vec::with_capacity(parents.len());
        for (i, &parent) in (0..).zip(parents) {
            found.push(if i < count || parent == i { i } else { found[parent as usize] });
        }
        found
    }
}

/// The wedges at each vertex of a mesh.
struct WedgesOfVertices {
    /// Of each vertex the place of its first wedge, and one more.
    first: Vec<u32>,
    wedges: Vec<u32>,
}

impl WedgesOfVertices {
    fn new(mesh: &Mesh) -> Self {
        let mut first = vec![0_u32; mesh.vertex_count() + 1];
        mesh.wedge_vertices.iter().for_each(|&v| first[v as usize + 1] += 1);
        (0..mesh.vertex_count()).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut wedges = vec![0; mesh.wedge_count()];
        for (w, &v) in (0..).zip(&mesh.wedge_vertices) {
            wedges[next[v as usize] as usize] = w;
            next[v as usize] += 1;
        }
        Self { first, wedges }
    }

    /// The wedge of a vertex of the second mesh whose attributes are most like those of a wedge of the first.
    fn most_alike(&self, vertex: u32, [finer, coarser]: [&Mesh; 2], wedge: u32) -> u32 {
        let range = self.first[vertex as usize] as usize..self.first[vertex as usize + 1] as usize;
        let difference = |other: u32| -> f64 {
            let pairs = finer.wedge_attributes.iter().zip(&coarser.wedge_attributes);
            let floats = pairs.filter_map(|(a, b)| Some((a.as_f32()?, b.as_f32()?, a.components)));
            let differences = floats.flat_map(|(a, b, n)| {
                let (a, b) = (&a[wedge as usize * n..][..n], &b[other as usize * n..][..n]);
                a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2))
            });
            differences.sum()
        };
        let wedges = self.wedges[range].iter().copied();
        wedges.min_by(|&a, &b| difference(a).total_cmp(&difference(b))).expect("every vertex of a level has a wedge")
    }
}

/// The first elements of an attribute.
fn first_of(attribute: &Attribute, count: usize) -> Attribute {
    let end = count * attribute.components;
    let values = match &attribute.values {
        Values::F32(values) => Values::F32(values[..end].to_vec()),
        Values::U32(values) => Values::U32(values[..end].to_vec()),
    };
    Attribute { semantic: attribute.semantic.clone(), values, ..*attribute }
}
