//! Planes of the faces in several poses (Mohr and Gleicher 2003; DeCoro and Rusinkiewicz 2005; seed 000, 6.1.4).

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

use super::metric::EdgeContext;
use super::quadric::Quadric;
use crate::Mesh;
use crate::skin::Pose;
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::Frame;

/// Quadrics of the faces as they are now, in each of some poses.
///
/// A vertex moves by an affine map in each pose, whatever does it: joints, morph targets, or a node. The map of a merged
/// vertex lies between those of its ends, as its weights do; so what a collapse costs in a pose is known exactly: the
/// distances of the merged vertex, moved by its own map, to the planes around both ends, moved by theirs. Seen from where
/// vertices are stored that is a quadric again, `T' Q T` summed over the poses, and all else in the simplifier works on it as
/// on any other.
#[derive(Debug)]
pub(super) struct Posed {
    /// How much each pose counts; the sum is 1.
    shares: Vec<f64>,
    /// Of each vertex, the map in each pose, in the frame.
    maps: Vec<Map>,
    /// Of each vertex, the planes of the faces around it in each pose, which all go through it.
    forms: Vec<Form>,
}

/// An affine map: three rows of a matrix with the translation at the end of each.
type Map = [f32; 12];

/// Sum of `weight n n'` over some planes: xx, xy, xz, yy, yz, zz; and of the weights.
type Form = [f32; 7];

fn linear(map: &Map) -> DMat3 {
    let m = map.map(f64::from);
    DMat3::from_cols_array(&[m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]])
}

fn moved(map: &Map, p: DVec3) -> DVec3 {
    linear(map) * p + DVec3::new(f64::from(map[3]), f64::from(map[7]), f64::from(map[11]))
}

fn between(a: &Map, b: &Map, t: f32) -> Map {
    std::array::from_fn(|i| if t == 1.0 { b[i] } else { a[i] + (b[i] - a[i]) * t })
}

impl Posed {
    /// The poses of a mesh whose positions will be in that frame. Poses are scaled so that the surface has as much area in
    /// them, in the mean, as it has where its vertices are stored.
    pub(super) fn new(mesh: &Mesh, frame: &Frame, poses: &[Pose]) -> Self {
        let total: f64 = poses.iter().map(|pose| pose.share).sum();
        let shares: Vec<f64> = poses.iter().map(|pose| pose.share / total).collect();
        let points: Vec<DVec3> = mesh.positions.iter().map(|&p| frame.enter(p)).collect();
        let area = |point: &(dyn Fn(u32) -> DVec3 + Sync)| -> f64 {
            let twice = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|w| point(mesh.wedge_vertices[w as usize]));
                (b - a).cross(c - a).length()
            };
            mesh.triangles.iter().map(twice).sum()
        };
        let at_rest = area(&|v| points[v as usize]);
        let (mut maps, mut posed_area) = (Vec::with_capacity(poses.len()), 0.0);
        for (pose, share) in poses.iter().zip(&shares) {
            let mut maps_of_pose = pose.vertex_maps(mesh);
            maps_of_pose.iter_mut().for_each(|map| *map = framed(map, frame));
            posed_area += share * area(&|v| maps_of_pose[v as usize].transform_point3(points[v as usize]));
            maps.push(maps_of_pose);
        }
        let ratio = (at_rest / posed_area).sqrt();
        let scale = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        let mut of_vertices = vec![[0.0; 12]; mesh.vertex_count() * poses.len()];
        for (k, maps) in maps.iter().enumerate() {
            // where the poses stand does not matter, only how exactly they are stored
            let sum: DVec3 = maps.iter().zip(&points).map(|(map, &p)| map.transform_point3(p)).sum();
            let center = sum / maps.len().max(1) as f64;
            for (v, map) in maps.iter().enumerate() {
                let (m, t) = (map.matrix3 * scale, (map.translation - center) * scale);
                let rows = [m.row(0).extend(t.x), m.row(1).extend(t.y), m.row(2).extend(t.z)];
                let place = &mut of_vertices[v * poses.len() + k];
                place.as_chunks_mut().0.iter_mut().zip(rows).for_each(|(to, row)| *to = row.as_vec4().to_array());
            }
        }
        Self { shares, maps: of_vertices, forms: Vec::new() }
    }

    fn maps_of(&self, vertex: u32) -> &[Map] {
        &self.maps[vertex as usize * self.shares.len()..][..self.shares.len()]
    }

    fn forms_of(&self, vertex: u32) -> &[Form] {
        &self.forms[vertex as usize * self.shares.len()..][..self.shares.len()]
    }

    /// Computes the planes around all vertices.
    pub(super) fn prepare(&mut self, mesh: &CollapseMesh) {
        let mut forms = vec![[0.0; 7]; self.maps.len()];
        let each = forms.par_chunks_exact_mut(self.shares.len()).zip(0..mesh.vertex_count() as u32);
        each.for_each(|(forms, vertex)| self.add_planes(mesh, vertex, forms));
        self.forms = forms;
    }

    /// Computes the planes around a vertex anew.
    pub(super) fn rebuild(&mut self, mesh: &CollapseMesh, vertex: u32) {
        let count = self.shares.len();
        let mut forms = std::mem::take(&mut self.forms);
        let own = &mut forms[vertex as usize * count..][..count];
        own.fill([0.0; 7]);
        self.add_planes(mesh, vertex, own);
        self.forms = forms;
    }

    fn add_planes(&self, mesh: &CollapseMesh, vertex: u32, forms: &mut [Form]) {
        let point = mesh.point(vertex);
        for face in mesh.faces_around(vertex) {
            let others = [face.x, face.y].map(|w| (mesh.point(w), self.maps_of(w)));
            for (k, (form, map)) in forms.iter_mut().zip(self.maps_of(vertex)).enumerate() {
                let p = moved(map, point);
                let [x, y] = others.map(|(q, maps)| moved(&maps[k], q) - p);
                let n = x.cross(y);
                let length = n.length();
                if length > 0.0 {
                    let u = n / (2.0 * length); // the area is half the length
                    let sums = [u.x * n.x, u.x * n.y, u.x * n.z, u.y * n.y, u.y * n.z, u.z * n.z, length / 2.0];
                    form.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x as f32);
                }
            }
        }
    }

    /// The planes around both ends of an edge, as a vertex sees them that is part `t` on the way from the first end to the
    /// second.
    pub(super) fn around(&self, edge: &EdgeContext, t: f64) -> Quadric {
        let [a, b] = edge.points;
        let middle = (a + b) / 2.0;
        let mut sum = Sum::ZERO;
        let ends = edge.ends.map(|v| (self.maps_of(v), self.forms_of(v)));
        for (k, &share) in self.shares.iter().enumerate() {
            let maps = ends.map(|(maps, _)| &maps[k]);
            let map = between(maps[0], maps[1], t as f32);
            let seen_from = moved(&map, middle);
            let r = linear(&map);
            for ((_, forms), (own, p)) in ends.iter().zip(maps.into_iter().zip([a, b])) {
                sum.add(&forms[k], r, seen_from - moved(own, p), share);
            }
        }
        Quadric::centered(sum.a, sum.b, sum.c, middle, sum.weight)
    }

    /// The planes around a vertex, as it sees them itself.
    pub(super) fn around_vertex(&self, vertex: u32, point: DVec3) -> Quadric {
        let mut sum = Sum::ZERO;
        for ((map, form), &share) in self.maps_of(vertex).iter().zip(self.forms_of(vertex)).zip(&self.shares) {
            sum.add(form, linear(map), DVec3::ZERO, share);
        }
        Quadric::centered(sum.a, sum.b, sum.c, point, sum.weight)
    }

    /// A vertex is about to merge into another, and to lie part `t` on the way to it.
    pub(super) fn merge(&mut self, kept: u32, removed: u32, t: f32) {
        let count = self.shares.len();
        for k in 0..count {
            let [a, b] = [kept, removed].map(|v| self.maps[v as usize * count + k]);
            self.maps[kept as usize * count + k] = between(&a, &b, t);
        }
    }
}

/// A map between points in the frame.
fn framed(map: &DAffine3, frame: &Frame) -> DAffine3 {
    let center = frame.center();
    DAffine3 { matrix3: map.matrix3, translation: (map.transform_point3(center) - center) / frame.unit() }
}

/// A quadric about a point, under construction.
struct Sum {
    a: DMat3,
    b: DVec3,
    c: f64,
    weight: f64,
}

impl Sum {
    const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, c: 0.0, weight: 0.0 };

    /// Adds planes through a point, as seen through a linear map from where the origin is `d` away from that point.
    fn add(&mut self, form: &Form, r: DMat3, d: DVec3, share: f64) {
        let [xx, xy, xz, yy, yz, zz, weight] = form.map(f64::from);
        let m = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]) * share;
        let from = r.transpose();
        let md = m * d;
        self.a += from * m * r;
        self.b += from * md;
        self.c += md.dot(d);
        self.weight += weight * share;
    }
}
