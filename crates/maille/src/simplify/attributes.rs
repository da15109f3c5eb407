//! Attributes in the metric: normals, colours, texture coordinates and whatever else wedges carry.

use glam::DVec3;
use rayon::prelude::*;

use super::corners::Corners;
use super::features::Features;
use super::legality::Collapse;
use super::metric::{Candidate, EdgeContext, Metric, QuadricMetric, QuadricOptions, Update};
use super::options::{AttributeError, ColorSpace, SimplifyOptions};
use super::quadric::Quadric;
use crate::color::{from_lab, to_lab, to_linear, to_srgb};
use crate::mesh::{Attribute, Mesh, Semantic, Values};
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::{Frame, RingFace};

/// What a difference of 1 counts, as a distance in extents of the mesh, where the user does not say: normals are a
/// fiftieth, and so on. By measurement on textured and coloured models: with these, each attribute is nearer to the
/// original than meshoptimizer's, and the distance rises least.
const NORMAL: f64 = 0.02;
const COLOR: f64 = 0.025;
/// Texture coordinates count as the distance on the surface by which the texture has slipped, times this.
const SLIP: f64 = 0.5;
/// Other attributes, over their whole range.
const RANGE: f64 = 0.05;

/// Least squared sine of a corner as far as the slope of an attribute goes: in a needle the values of two corners that
/// nearly touch say nothing about it.
const NEEDLE: f64 = 1e-3;

/// Name of the wedge in a vertex of several.
const SEVERAL: u32 = u32::MAX;

/// The scalars that one attribute puts into the metric.
#[derive(Debug)]
struct Channels {
    /// Which attribute of the mesh.
    semantic: Semantic,
    /// Which scalars of a wedge.
    first: usize,
    count: usize,
    /// Where its squares are in the sums of a wedge.
    squares: usize,
    /// For colours in [`ColorSpace::Lab`]: whether they are stored on the curve of screens.
    lab: Option<bool>,
    /// What a difference of 1 counts, as a distance in the frame.
    weight: f64,
    /// Largest root of the mean squared difference that a collapse has made, in units of the attribute.
    error: f64,
}

impl Channels {
    fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.count
    }

    fn is_texture(&self) -> bool {
        matches!(self.semantic, Semantic::TexCoord(_)) && self.count == 2
    }

    fn is_normal(&self) -> bool {
        self.semantic == Semantic::Normal && self.count == 3
    }
}

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
/// Wedges that the vanishing faces join share a value ([`Corners`]); and so do, attribute by attribute, wedges of one vertex
/// whose values are equal: a seam of the texture is no crease of the normals.
#[derive(Debug)]
pub(super) struct AttributeMetric {
    surface: QuadricMetric,
    /// Length of the frame's 1 in model units.
    unit: f64,
    corners: Corners,
    attributes: Vec<Channels>,
    /// Scalars of a wedge.
    channels: usize,
    /// Value of each channel of each wedge.
    values: Vec<f32>,
    /// Whether the values of a wedge are other than they were.
    changed: Vec<bool>,
    /// Weight of each channel.
    weights: Vec<f64>,
    /// The sums of each wedge: area, `area g` of each channel, `area g g'` of each attribute; slopes are weighted.
    sums: Vec<f32>,
    /// The wedge of each vertex, [`SEVERAL`] where there are more; empty where each has the one of its number.
    wedge_of: Vec<u32>,
    /// Whether a collapse may turn triangles over in the texture.
    texture_may_fold: bool,
    /// Most squared error of texture coordinates.
    texture_limit_sq: Option<f64>,
    /// Squared error that the texture coordinates of each wedge have gathered: steps add up like independent errors.
    /// Empty if there is no limit.
    texture_drift_sq: Vec<f32>,
    /// Values of the wedges around the collapse about to be made.
    pending: Pending,
}

/// What a collapse about to be made does to the wedges around it, and scratch space.
#[derive(Debug, Default)]
struct Pending {
    wedges: Vec<u32>,
    /// All channels of each wedge.
    values: Vec<f32>,
    /// Of each attribute.
    errors: Vec<f64>,
    /// Squared error that the texture coordinates of each wedge will have gathered; empty if there is no limit.
    texture_drift_sq: Vec<f32>,
    slopes: Vec<(DVec3, f64)>,
    value: Vec<f32>,
}

impl Pending {
    fn clear(&mut self) {
        self.wedges.clear();
        self.values.clear();
        self.errors.clear();
        self.texture_drift_sq.clear();
    }
}

/// The wedges at the ends of an edge.
#[derive(Debug, Default)]
struct Ends {
    /// Each wedge once, and the end that it is at.
    wedges: Vec<(u32, u8)>,
    /// Which two of them a vanishing face joins.
    pairs: Vec<[u8; 2]>,
}

impl AttributeMetric {
    /// The metric for a mesh whose positions will be in a [`CollapseMesh`] with that frame; `None` if no attribute counts.
    pub(super) fn new(surface: QuadricOptions, mesh: &Mesh, frame: &Frame, options: &SimplifyOptions) -> Option<Self> {
        let mut attributes = Vec::new();
        let mut channels = 0;
        for attribute in &mesh.wedge_attributes {
            let factor = options.attributes.factor_of(&attribute.semantic);
            let weight = factor * automatic_weight(attribute, mesh, frame);
            if weight > 0.0 && weight.is_finite() {
                let count = attribute.components;
                let semantic = attribute.semantic.clone();
                let is_lab = options.color_space == ColorSpace::Lab;
                let lab =
                    (is_lab && matches!(semantic, Semantic::Color(_)) && count >= 3).then_some(attribute.storage.srgb);
                attributes.push(Channels { semantic, first: channels, count, squares: 0, lab, weight, error: 0.0 });
                channels += count;
            }
        }
        for (i, attribute) in attributes.iter_mut().enumerate() {
            attribute.squares = 1 + 3 * channels + 6 * i;
        }
        if attributes.is_empty() {
            return None;
        }
        let mut metric = Self {
            surface: QuadricMetric::new(surface),
            unit: frame.unit(),
            corners: Corners::new(mesh.triangles.clone(), &mesh.wedge_vertices),
            weights: attributes.iter().flat_map(|a| std::iter::repeat_n(a.weight, a.count)).collect(),
            values: vec![0.0; mesh.wedge_count() * channels],
            changed: vec![false; mesh.wedge_count()],
            sums: Vec::new(),
            wedge_of: Vec::new(),
            texture_may_fold: options.texture_may_fold,
            texture_limit_sq: options.max_texture_error.map(|most| most * most),
            texture_drift_sq: vec![0.0; if options.max_texture_error.is_some() { mesh.wedge_count() } else { 0 }],
            pending: Pending::default(),
            attributes,
            channels,
        };
        metric.take_values(mesh);
        Some(metric)
    }

    fn take_values(&mut self, mesh: &Mesh) {
        for attribute in &self.attributes {
            let source = mesh.wedge_attribute(&attribute.semantic).and_then(Attribute::as_f32);
            let Some(source) = source else { continue };
            for (w, from) in source.chunks_exact(attribute.count).enumerate() {
                let into = &mut self.values[w * self.channels..][attribute.range()];
                into.copy_from_slice(from);
                if attribute.is_normal() {
                    let length = glam::Vec3::from_slice(from).length();
                    // files hold other lengths, too, which would count as weights when normals are interpolated
                    if length.is_normal() && (length - 1.0).abs() > 1e-2 {
                        into.iter_mut().for_each(|x| *x /= length);
                        self.changed[w] = true;
                    }
                }
                if let (Some(srgb), Some(color)) = (attribute.lab, into.first_chunk_mut()) {
                    let light = if srgb { color.map(to_linear) } else { *color };
                    *color = to_lab(light);
                }
                // what is not a number must not spread
                into.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
            }
        }
    }

    /// Writes the values of the wedges that have changed into a mesh with the same wedges.
    pub(super) fn give_values(&self, mesh: &mut Mesh) {
        for attribute in &self.attributes {
            let into = mesh.wedge_attributes.iter_mut().find(|a| a.semantic == attribute.semantic);
            let Some(into) = into.and_then(Attribute::as_f32_mut) else { continue };
            for (w, into) in into.chunks_exact_mut(attribute.count).enumerate().filter(|&(w, _)| self.changed[w]) {
                into.copy_from_slice(&self.values[w * self.channels..][attribute.range()]);
                if let (Some(srgb), Some(color)) = (attribute.lab, into.first_chunk_mut()) {
                    let light = from_lab(*color);
                    *color = if srgb { light.map(to_srgb) } else { light };
                }
            }
        }
    }

    /// What collapses have done to the attributes.
    pub(super) fn errors(&self) -> Vec<AttributeError> {
        let told = |a: &Channels| AttributeError {
            semantic: a.semantic.clone(),
            weight: a.weight * self.unit,
            error: a.error,
        };
        self.attributes.iter().map(told).collect()
    }

    #[inline]
    fn stride(&self) -> usize {
        1 + 3 * self.channels + 6 * self.attributes.len()
    }

    #[inline]
    fn sums_of(&self, wedge: u32) -> Sums<'_> {
        Sums(&self.sums[wedge as usize * self.stride()..][..self.stride()])
    }

    #[inline]
    fn value(&self, wedge: u32, channel: usize) -> f32 {
        self.values[wedge as usize * self.channels + channel]
    }

    fn same(&self, attribute: &Channels, v: u32, w: u32) -> bool {
        attribute.range().all(|j| self.value(v, j) == self.value(w, j))
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
            let wedge = self.corners.at(&face, vertex);
            self.sums[wedge as usize * stride..][..stride].fill(0.0);
            only = Some(if only.is_none_or(|only| only == wedge) { wedge } else { SEVERAL });
        }
        if let (Some(place), Some(only)) = (self.wedge_of.get_mut(vertex as usize), only) {
            *place = only;
        }
        let mut sums = std::mem::take(&mut self.sums);
        for face in mesh.faces_around(vertex) {
            let wedge = self.corners.at(&face, vertex);
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
        let [wx, wy] = self.corners.opposite(face).map(|w| w as usize * self.channels);
        let wv = self.corners.at(face, vertex) as usize * self.channels;
        let (slopes, squares) = sums.split_at_mut(1 + 3 * self.channels);
        slopes[0] += area as f32;
        for (attribute, squares) in self.attributes.iter().zip(squares.chunks_exact_mut(6)) {
            for j in attribute.range() {
                let value = self.values[wv + j];
                let steps = [wx, wy].map(|w| f64::from(self.values[w + j] - value));
                let slope = (to_x * steps[0] + to_y * steps[1]) * self.weights[j];
                let weighted = slope * area;
                let sum = &mut slopes[1 + 3 * j..][..3];
                sum.iter_mut().zip(weighted.to_array()).for_each(|(sum, x)| *sum += x as f32);
                let [a, b] = [weighted, slope];
                let products = [a.x * b.x, a.x * b.y, a.x * b.z, a.y * b.y, a.y * b.z, a.z * b.z];
                squares.iter_mut().zip(products).for_each(|(sum, x)| *sum += x as f32);
            }
        }
    }

    /// The wedges at both ends of an edge.
    fn ends(&self, rings: [impl Iterator<Item = RingFace>; 2], ends: [u32; 2]) -> Ends {
        let mut found = Ends::default();
        let place = |wedge: u32, end: u8, wedges: &mut Vec<(u32, u8)>| {
            let known = wedges.iter().position(|&known| known == (wedge, end));
            known.unwrap_or_else(|| {
                wedges.push((wedge, end));
                wedges.len() - 1
            }) as u8
        };
        for (end, ring) in rings.into_iter().enumerate() {
            for face in ring.take(usize::from(u8::MAX) / 2) {
                let i = place(self.corners.at(&face, ends[end]), end as u8, &mut found.wedges);
                let others = self.corners.opposite(&face);
                if let (0, Some(k)) = (end, [face.x, face.y].iter().position(|&v| v == ends[1])) {
                    let j = place(others[k], 1, &mut found.wedges);
                    found.pairs.push([i, j]);
                }
            }
        }
        found
    }

    /// Which of the wedges share their value of an attribute: to each, the first of those that it shares with.
    fn shared(&self, attribute: &Channels, ends: &Ends) -> Vec<u8> {
        let mut label: Vec<u8> = (0..ends.wedges.len() as u8).collect();
        let join = |i: u8, j: u8, label: &mut Vec<u8>| {
            let (low, high) = (label[i as usize].min(label[j as usize]), label[i as usize].max(label[j as usize]));
            if low != high {
                label.iter_mut().filter(|x| **x == high).for_each(|x| *x = low);
            }
        };
        for &[i, j] in &ends.pairs {
            join(i, j, &mut label);
        }
        for j in 1..ends.wedges.len() {
            let (wedge, end) = ends.wedges[j];
            let equal = |&i: &usize| ends.wedges[i].1 == end && self.same(attribute, ends.wedges[i].0, wedge);
            if let Some(i) = (0..j).find(equal) {
                join(i as u8, j as u8, &mut label);
            }
        }
        label
    }

    /// Adds to a quadric what an attribute costs, if some wedges share its value; their area. `tell` hears slope and
    /// offset of each channel: at p, the best value is that of the first wedge and `(slope . p + offset) / area`, weighted.
    fn add_group(
        &self,
        q: &mut Quadric,
        attribute: &Channels,
        members: &(impl Iterator<Item = (u32, u8)> + Clone),
        points: [DVec3; 2],
        mut tell: impl FnMut((DVec3, f64)),
    ) -> f64 {
        let Some((reference, _)) = members.clone().next() else { return 0.0 };
        members.clone().for_each(|(wedge, end)| {
            q.add_form(self.sums_of(wedge).squares(attribute.squares), points[usize::from(end)]);
        });
        let area: f64 = members.clone().map(|(wedge, _)| self.sums_of(wedge).area()).sum();
        let per_area = if area > 0.0 { 1.0 / area } else { 0.0 };
        for j in attribute.range() {
            let (mut slope, mut offset) = (DVec3::ZERO, 0.0);
            for (wedge, end) in members.clone() {
                let sums = self.sums_of(wedge);
                let own = sums.slope(j);
                let level = own.dot(points[end as usize]);
                let step = f64::from(self.value(wedge, j) - self.value(reference, j)) * self.weights[j];
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
    pub(super) fn quadric(&self, mesh: &CollapseMesh, edge: &EdgeContext) -> Quadric {
        let mut q = Quadric::default();
        if let [Some(a), Some(b)] = edge.ends.map(|v| self.only_wedge(v)) {
            let both = [(a, 0), (b, 1)];
            for attribute in &self.attributes {
                self.add_group(&mut q, attribute, &both.into_iter(), edge.points, |_| {});
            }
            return q;
        }
        let ends = self.ends(edge.ends.map(|v| mesh.faces_around(v)), edge.ends);
        self.add_all(&mut q, &ends, edge.points);
        q
    }

    fn add_all(&self, q: &mut Quadric, ends: &Ends, points: [DVec3; 2]) {
        for attribute in &self.attributes {
            let label = self.shared(attribute, ends);
            for first in (0..label.len()).filter(|&i| usize::from(label[i]) == i) {
                let members = (first..label.len()).filter(|&i| usize::from(label[i]) == first).map(|i| ends.wedges[i]);
                self.add_group(q, attribute, &members, points, |_| {});
            }
        }
    }

    /// Finds the values of all wedges around a collapse to a place, and the error of each attribute.
    fn predict(&mut self, edge: &EdgeContext, rings: [&[RingFace]; 2], place: DVec3) {
        let ends = self.ends(rings.map(|ring| ring.iter().copied()), edge.ends);
        let mut pending = std::mem::take(&mut self.pending);
        pending.clear();
        pending.wedges.extend(ends.wedges.iter().map(|&(wedge, _)| wedge));
        pending.values.resize(ends.wedges.len() * self.channels, 0.0);
        let limited = if self.texture_drift_sq.is_empty() { 0 } else { ends.wedges.len() };
        pending.texture_drift_sq.resize(limited, 0.0);
        let kept_end = edge.points.iter().position(|&end| end == place);
        for attribute in &self.attributes {
            let label = self.shared(attribute, &ends);
            let (mut squared, mut area) = (0.0, 0.0);
            for first in (0..label.len()).filter(|&i| usize::from(label[i]) == i) {
                let places = (first..label.len()).filter(|&i| usize::from(label[i]) == first);
                let members = places.clone().map(|i| ends.wedges[i]);
                let (reference, _) = ends.wedges[first];
                let mut q = Quadric::default();
                pending.slopes.clear();
                let group_area =
                    self.add_group(&mut q, attribute, &members, edge.points, |slope| pending.slopes.push(slope));
                let group_squared = q.at(place).max(0.0);
                squared += group_squared;
                area += group_area;
                if limited > 0 && attribute.is_texture() && group_area > 0.0 {
                    let step = group_squared / (group_area * attribute.weight * attribute.weight);
                    let before = members.clone().map(|(w, _)| self.texture_drift_sq[w as usize]).fold(0.0, f32::max);
                    for i in places.clone() {
                        let gathered = &mut pending.texture_drift_sq[i];
                        *gathered = gathered.max(before + step as f32);
                    }
                }
                let at_end = kept_end.and_then(|end| members.clone().find(|&(_, e)| usize::from(e) == end));
                pending.value.clear();
                for (j, &(slope, offset)) in attribute.range().zip(&pending.slopes) {
                    pending.value.push(match at_end {
                        Some((wedge, _)) => self.value(wedge, j), // to the bit
                        None if group_area > 0.0 => {
                            let step = (slope.dot(place) + offset) / (group_area * self.weights[j]);
                            let [low, high] = self.reach(j, &members, rings, edge.ends);
                            ((f64::from(self.value(reference, j)) + step) as f32).clamp(low, high)
                        }
                        None => self.value(reference, j),
                    });
                }
                if attribute.is_normal() && at_end.is_none() {
                    let mean = glam::Vec3::from_slice(&pending.value);
                    let fallback =
                        || glam::Vec3::from_slice(&self.values[reference as usize * self.channels + attribute.first..]);
                    pending.value.copy_from_slice(&mean.try_normalize().unwrap_or_else(fallback).to_array());
                }
                for i in places {
                    pending.values[i * self.channels..][attribute.range()].copy_from_slice(&pending.value);
                }
            }
            pending.errors.push(if area > 0.0 { (squared / area).sqrt() / attribute.weight } else { 0.0 });
        }
        self.pending = pending;
    }

    /// Least and largest value of a channel on the faces around some wedges.
    fn reach(
        &self,
        channel: usize,
        wedges: &(impl Iterator<Item = (u32, u8)> + Clone),
        rings: [&[RingFace]; 2],
        ends: [u32; 2],
    ) -> [f32; 2] {
        let mut reach = [f32::INFINITY, f32::NEG_INFINITY];
        for (end, ring) in rings.into_iter().enumerate() {
            for face in ring {
                let own = self.corners.at(face, ends[end]);
                if wedges.clone().any(|member| member == (own, end as u8)) {
                    let [x, y] = self.corners.opposite(face);
                    for value in [own, x, y].map(|w| self.value(w, channel)) {
                        reach = [reach[0].min(value), reach[1].max(value)];
                    }
                }
            }
        }
        reach
    }

    /// Whether a triangle that stays would be turned over in the texture.
    fn folds_texture(&self, edge: &EdgeContext, rings: [&[RingFace]; 2]) -> bool {
        self.attributes.iter().filter(|a| a.is_texture()).any(|attribute| {
            rings.into_iter().enumerate().any(|(end, ring)| {
                ring.iter().filter(|face| face.x != edge.ends[1 - end] && face.y != edge.ends[1 - end]).any(|face| {
                    let own = self.corners.at(face, edge.ends[end]);
                    let Some(i) = self.pending.wedges.iter().position(|&w| w == own) else { return false };
                    let moved = &self.pending.values[i * self.channels + attribute.first..][..2];
                    let place = |w: u32| [0, 1].map(|k| f64::from(self.value(w, attribute.first + k)));
                    let [x, y] = self.corners.opposite(face).map(place);
                    let area = |[u, v]: [f64; 2]| (x[0] - u) * (y[1] - v) - (x[1] - v) * (y[0] - u);
                    let (before, after) = (area(place(own)), area([f64::from(moved[0]), f64::from(moved[1])]));
                    before * after < 0.0
                })
            })
        })
    }
}

/// What a difference of 1 counts, as a distance in the frame; 0 for what is never interpolated.
fn automatic_weight(attribute: &Attribute, mesh: &Mesh, frame: &Frame) -> f64 {
    let Values::F32(values) = &attribute.values else { return 0.0 };
    match attribute.semantic {
        Semantic::Normal => NORMAL,
        Semantic::Color(_) => COLOR,
        Semantic::TexCoord(_) => SLIP * texture_scale(values, attribute.components, mesh) / frame.unit(),
        Semantic::Custom(_) => {
            let finite = values.iter().copied().filter(|x| x.is_finite());
            let [low, high] = finite.fold([f32::INFINITY, f32::NEG_INFINITY], |[l, h], x| [l.min(x), h.max(x)]);
            let range = f64::from(high) - f64::from(low);
            if range > 0.0 { RANGE / range } else { 0.0 }
        }
        Semantic::Position | Semantic::Tangent | Semantic::Joints(_) | Semantic::Weights(_) => 0.0,
    }
}

/// Length on the surface, in model units, of a step of 1 in the texture: the root of the ratio of the areas.
fn texture_scale(values: &[f32], components: usize, mesh: &Mesh) -> f64 {
    if components != 2 {
        return 0.0;
    }
    let (mut surface, mut texture) = (0.0, 0.0);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = mesh.triangle_points(t);
        let [s, t, u] = triangle.map(|w| glam::Vec2::from_slice(&values[2 * w as usize..]).as_dvec2());
        let in_texture = (t - s).perp_dot(u - s).abs();
        if in_texture.is_finite() {
            surface += (b - a).cross(c - a).length();
            texture += in_texture;
        }
    }
    if texture > 0.0 { (surface / texture).sqrt() } else { 0.0 }
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
        let mut sums = vec![0.0; self.changed.len() * self.stride()];
        if self.corners.are_plain() {
            sums.par_chunks_exact_mut(self.stride()).zip(0..mesh.vertex_count() as u32).for_each(|(sums, vertex)| {
                mesh.faces_around(vertex).for_each(|face| self.add_face(mesh, vertex, &face, sums));
            });
        }
        self.sums = sums;
        if !self.corners.are_plain() {
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
        self.predict(edge, rings, place);
        let gathered = self.pending.texture_drift_sq.iter().copied().fold(0.0, f32::max);
        let is_off = self.texture_limit_sq.is_some_and(|most| f64::from(gathered) > most);
        (!is_off && (self.texture_may_fold || !self.folds_texture(edge, rings))).then_some(place)
    }

    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        self.corners.merge(collapse);
        for (i, &wedge) in self.pending.wedges.iter().enumerate() {
            let into = self.corners.merged(wedge).unwrap_or(wedge) as usize;
            let values = &self.pending.values[i * self.channels..][..self.channels];
            self.values[into * self.channels..][..self.channels].copy_from_slice(values);
            self.changed[into] = true;
            if let Some(&gathered) = self.pending.texture_drift_sq.get(i) {
                self.texture_drift_sq[into] = self.texture_drift_sq[into].max(gathered);
            }
        }
        for (attribute, &error) in self.attributes.iter_mut().zip(&self.pending.errors) {
            attribute.error = attribute.error.max(error);
        }
        self.pending.clear();
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
