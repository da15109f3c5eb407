//! Gradients of attributes over the surface.

use glam::DVec3;
use rayon::prelude::*;

use super::carried::{Carried, Channels, Ends, Group};
use crate::mesh::Mesh;
use crate::simplify::features::Features;
use crate::simplify::legality::Collapse;
use crate::simplify::metric::{Candidate, EdgeContext, Metric, QuadricMetric, Update};
use crate::simplify::options::SimplifyOptions;
use crate::simplify::quadric::Quadric;
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::{Frame, RingFace};

/// Least squared sine of a corner as far as the slope of an attribute goes: in a needle the values of two corners that
/// nearly touch say nothing about it.
const NEEDLE: f64 = 1e-3;

/// Name of the wedge in a vertex of several.
const SEVERAL: u32 = u32::MAX;

/// Quadrics of the surface and of the attributes on it (Hoppe, "New quadric metric for simplifying meshes with appearance
/// attributes", IEEE Visualization 1999).
///
/// On each face an attribute is a linear function of the position, constant across the face: `s(p) = s_v + g . (p - v)`
/// seen from its corner v. A merged wedge at p with the value s has the error `sum of area (s(p) - s)^2` over the faces
/// around the wedges that it stands for. For each p the best s is the mean of the predictions, by area; with that put in,
/// what is left is a quadric of p alone, so that the placement needs one 3x3 solve however many channels there are
/// (Hoppe and Marschner, MSR-TR-2000-64). It is added to the quadric of the surface, times the square of the weight.
///
/// Attribute quadrics are memoryless, those of the faces as they are: functions that reach far beyond the face that they
/// come from predict nothing. Relative to the vertex and its value, of a wedge only the sums of `area`, of `area g` to each
/// channel and of `area g g'` to each attribute are kept.
///
/// Wedges share values attribute by attribute: a seam of the texture is no crease of the normals.
#[derive(Debug)]
pub(in crate::simplify) struct AttributeMetric {
    surface: QuadricMetric,
    pub(in crate::simplify) carried: Carried,
    /// The sums of each wedge: area, `area g` of each channel, `area g g'` of each attribute; slopes are weighted.
    sums: Vec<f32>,
    /// The wedge of each vertex, [`SEVERAL`] where there are more; empty where each has the one of its number.
    wedge_of: Vec<u32>,
    /// Scratch space.
    slopes: Vec<(DVec3, f64)>,
    predicted: Vec<f64>,
}

impl AttributeMetric {
    /// The metric for a mesh whose positions will be in a [`CollapseMesh`] with that frame; `None` if no attribute counts.
    pub(in crate::simplify) fn new(
        surface: QuadricMetric,
        mesh: &Mesh,
        frame: &Frame,
        options: &SimplifyOptions,
    ) -> Option<Self> {
        Some(Self {
            surface,
            carried: Carried::new(mesh, frame, options)?,
            sums: Vec::new(),
            wedge_of: Vec::new(),
            slopes: Vec::new(),
            predicted: Vec::new(),
        })
    }

    #[inline]
    fn stride(&self) -> usize {
        1 + 3 * self.carried.channels + 6 * self.carried.attributes.len()
    }

    #[inline]
    fn sums_of(&self, wedge: u32) -> Sums<'_> {
        Sums(&self.sums[wedge as usize * self.stride()..][..self.stride()])
    }

    /// The wedge of a vertex that has but one.
    #[inline]
    fn only_wedge(&self, vertex: u32) -> Option<u32> {
        if self.wedge_of.is_empty() {
            return Some(vertex);
        }
        Some(self.wedge_of[vertex as usize]).filter(|&wedge| wedge != SEVERAL)
    }

    /// Computes the sums of the wedges of a vertex from its faces.
    fn rebuild(&mut self, mesh: &CollapseMesh, vertex: u32) {
        let stride = self.stride();
        let mut only = None;
        for face in mesh.faces_around(vertex) {
            let wedge = self.carried.corners.at(&face, vertex);
            self.sums[wedge as usize * stride..][..stride].fill(0.0);
            only = Some(if only.is_none_or(|only| only == wedge) { wedge } else { SEVERAL });
        }
        if let (Some(place), Some(only)) = (self.wedge_of.get_mut(vertex as usize), only) {
            *place = only;
        }
        let mut sums = std::mem::take(&mut self.sums);
        for face in mesh.faces_around(vertex) {
            let wedge = self.carried.corners.at(&face, vertex);
            self.add_face(mesh, vertex, &face, &mut sums[wedge as usize * stride..][..stride]);
        }
        self.sums = sums;
    }

    /// Adds what a face around a vertex says to the sums of its wedge there.
    #[inline]
    fn add_face(&self, mesh: &CollapseMesh, vertex: u32, face: &RingFace, sums: &mut [f32]) {
        let v = mesh.point(vertex);
        let [x, y] = [face.x, face.y].map(|w| mesh.point(w) - v);
        let (xx, xy, yy) = (x.length_squared(), x.dot(y), y.length_squared());
        let squared = xx * yy;
        let determinant = (squared - xy * xy).max(0.0);
        if determinant <= 0.0 {
            return;
        }
        let area = determinant.sqrt() / 2.0;
        let scale = 1.0 / determinant.max(NEEDLE * squared);
        let (to_x, to_y) = ((x * yy - y * xy) * scale, (y * xx - x * xy) * scale);
        let [wx, wy] = self.carried.corners.opposite(face).map(|w| w as usize * self.carried.channels);
        let wv = self.carried.corners.at(face, vertex) as usize * self.carried.channels;
        let (slopes, squares) = sums.split_at_mut(1 + 3 * self.carried.channels);
        slopes[0] += area as f32;
        for (attribute, squares) in self.carried.attributes.iter().zip(squares.chunks_exact_mut(6)) {
            for j in attribute.range() {
                let value = self.carried.values[wv + j];
                let steps = [wx, wy].map(|w| f64::from(self.carried.values[w + j] - value));
                let slope = (to_x * steps[0] + to_y * steps[1]) * self.carried.weights[j];
                let weighted = slope * area;
                let sum = &mut slopes[1 + 3 * j..][..3];
                sum.iter_mut().zip(weighted.to_array()).for_each(|(sum, x)| *sum += x as f32);
                let [a, b] = [weighted, slope];
                let products = [a.x * b.x, a.x * b.y, a.x * b.z, a.y * b.y, a.y * b.z, a.z * b.z];
                squares.iter_mut().zip(products).for_each(|(sum, x)| *sum += x as f32);
            }
        }
    }

    /// Adds to a quadric what an attribute costs, if some wedges share its value; their area. `tell` hears slope and
    /// offset of each channel: at p, the best value is that of the first wedge and `(slope . p + offset) / area`, weighted.
    fn add_group(
        &self,
        q: &mut Quadric,
        (number, attribute): (usize, &Channels),
        members: &(impl Iterator<Item = (u32, u8)> + Clone),
        points: [DVec3; 2],
        mut tell: impl FnMut((DVec3, f64)),
    ) -> f64 {
        let Some((reference, _)) = members.clone().next() else { return 0.0 };
        let squares = 1 + 3 * self.carried.channels + 6 * number;
        members.clone().for_each(|(wedge, end)| {
            q.add_form(self.sums_of(wedge).squares(squares), points[usize::from(end)]);
        });
        let area: f64 = members.clone().map(|(wedge, _)| self.sums_of(wedge).area()).sum();
        let per_area = if area > 0.0 { 1.0 / area } else { 0.0 };
        for j in attribute.range() {
            let (mut slope, mut offset) = (DVec3::ZERO, 0.0);
            for (wedge, end) in members.clone() {
                let sums = self.sums_of(wedge);
                let own = sums.slope(j);
                let level = own.dot(points[end as usize]);
                let step = f64::from(self.carried.value(wedge, j) - self.carried.value(reference, j))
                    * self.carried.weights[j];
                slope += own;
                offset += sums.area() * step - level;
                if step != 0.0 {
                    q.add_linear(own * step, step * (sums.area() * step / 2.0 - level));
                }
            }
            q.add_square(slope, offset, -per_area);
            tell((slope, offset));
        }
        area
    }

    /// What the attributes add to the quadric of an edge.
    #[inline]
    pub(in crate::simplify) fn quadric(&self, mesh: &CollapseMesh, edge: &EdgeContext) -> Quadric {
        let mut q = Quadric::default();
        if let [Some(a), Some(b)] = edge.ends.map(|v| self.only_wedge(v)) {
            let both = [(a, 0), (b, 1)];
            for attribute in self.carried.attributes.iter().enumerate() {
                self.add_group(&mut q, attribute, &both.into_iter(), edge.points, |_| {});
            }
            return q;
        }
        let ends = self.carried.ends(edge.ends.map(|v| mesh.faces_around(v)), edge.ends);
        self.add_all(&mut q, &ends, edge.points);
        q
    }

    fn add_all(&self, q: &mut Quadric, ends: &Ends, points: [DVec3; 2]) {
        for (number, attribute) in self.carried.attributes.iter().enumerate() {
            let label = self.carried.shared(attribute.range(), ends);
            for group in Group::all(ends, &label) {
                self.add_group(q, (number, attribute), &group.members(), points, |_| {});
            }
        }
    }

    /// Finds the values of all wedges around a collapse to a place, and the error of each attribute; false if it breaks the
    /// limits of the texture.
    fn predict(&mut self, edge: &EdgeContext, rings: [&[RingFace]; 2], place: DVec3) -> bool {
        let ends = self.carried.ends(rings.map(|ring| ring.iter().copied()), edge.ends);
        let mut pending = self.carried.start(&ends);
        let (mut slopes, mut predicted) = (std::mem::take(&mut self.slopes), std::mem::take(&mut self.predicted));
        for (number, attribute) in self.carried.attributes.iter().enumerate() {
            let label = self.carried.shared(attribute.range(), &ends);
            let (mut squared, mut area) = (0.0, 0.0);
            for group in Group::all(&ends, &label) {
                let mut q = Quadric::default();
                slopes.clear();
                let members = group.members();
                let tell = |slope| slopes.push(slope);
                let group_area = self.add_group(&mut q, (number, attribute), &members, edge.points, tell);
                let group_squared = q.at(place).max(0.0);
                squared += group_squared;
                area += group_area;
                if attribute.is_texture() && group_area > 0.0 {
                    let step_sq = group_squared / (group_area * attribute.weight * attribute.weight);
                    self.carried.slip(&mut pending, group, step_sq);
                }
                predicted.clear();
                let reference = members.clone().next().map_or(0, |(wedge, _)| wedge);
                predicted.extend(attribute.range().zip(&slopes).map(|(j, &(slope, offset))| {
                    let step = (slope.dot(place) + offset) / (group_area * self.carried.weights[j]);
                    f64::from(self.carried.value(reference, j)) + step
                }));
                let known = (group_area > 0.0).then_some(&*predicted);
                self.carried.settle(&mut pending, attribute, group, (edge, rings, place), known);
            }
            pending.errors.push(if area > 0.0 { (squared / area).sqrt() / attribute.weight } else { 0.0 });
        }
        (self.slopes, self.predicted) = (slopes, predicted);
        self.carried.accepts(pending, edge, rings)
    }
}

/// The sums of a wedge.
#[derive(Clone, Copy)]
struct Sums<'a>(&'a [f32]);

impl Sums<'_> {
    fn area(self) -> f64 {
        f64::from(self.0[0])
    }

    fn slope(self, channel: usize) -> DVec3 {
        glam::Vec3::from_slice(&self.0[1 + 3 * channel..]).as_dvec3()
    }

    /// Of an attribute, given by its place after the slopes of all channels.
    fn squares(self, place: usize) -> [f64; 6] {
        std::array::from_fn(|i| f64::from(self.0[place + i]))
    }
}

impl Metric for AttributeMetric {
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features) {
        self.surface.prepare(mesh, features);
        let mut sums = vec![0.0; self.carried.wedge_count() * self.stride()];
        if self.carried.corners.are_plain() {
            sums.par_chunks_exact_mut(self.stride()).zip(0..mesh.vertex_count() as u32).for_each(|(sums, vertex)| {
                mesh.faces_around(vertex).for_each(|face| self.add_face(mesh, vertex, &face, sums));
            });
        }
        self.sums = sums;
        if !self.carried.corners.are_plain() {
            self.wedge_of = vec![SEVERAL; mesh.vertex_count()];
            (0..mesh.vertex_count() as u32).for_each(|vertex| self.rebuild(mesh, vertex));
        }
    }

    #[inline]
    fn evaluate(&self, mesh: &CollapseMesh, _: &Features, edge: &EdgeContext) -> Option<Candidate> {
        Some(self.surface.evaluate_with(&self.quadric(mesh, edge), edge))
    }

    fn refine(
        &mut self,
        mesh: &CollapseMesh,
        edge: &EdgeContext,
        candidate: &Candidate,
        rings: [&[RingFace]; 2],
    ) -> Option<DVec3> {
        let place = self.surface.refine_with(&self.quadric(mesh, edge), mesh, edge, candidate.position, rings);
        self.predict(edge, rings, place).then_some(place)
    }

    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        self.carried.on_collapse(collapse);
        self.surface.on_collapse(collapse);
    }

    fn give_values(&self, wedges: &[u32], mesh: &mut Mesh) {
        self.carried.give_values(wedges, mesh);
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features) {
        self.surface.commit(mesh, kept, removed, neighbors, features);
        for &vertex in std::iter::once(&kept).chain(neighbors) {
            if self.surface.is_patient_with(mesh, vertex) {
                self.rebuild(mesh, vertex);
            }
        }
    }

    fn update(&self) -> Update {
        Update::AtVertexThenRing
    }

    #[inline]
    fn prefetch(&self, vertex: u32) {
        self.surface.prefetch(vertex);
    }
}
