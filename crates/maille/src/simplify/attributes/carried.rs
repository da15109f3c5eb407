//! What wedges carry while edges collapse, and which of them share it.

use glam::DVec3;

use crate::color::{from_lab, to_lab, to_linear, to_srgb};
use crate::mesh::{Attribute, Mesh, Semantic, Values};
use crate::simplify::corners::Corners;
use crate::simplify::legality::Collapse;
use crate::simplify::metric::EdgeContext;
use crate::simplify::options::{AttributeError, ColorSpace, SimplifyOptions};
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

/// The scalars that one attribute puts into the metric.
#[derive(Debug)]
pub(super) struct Channels {
    /// Which attribute of the mesh.
    semantic: Semantic,
    /// Which scalars of a wedge.
    pub(super) first: usize,
    pub(super) count: usize,
    /// For colours in [`ColorSpace::Lab`]: whether they are stored on the curve of screens.
    lab: Option<bool>,
    /// What a difference of 1 counts, as a distance in the frame.
    pub(super) weight: f64,
    /// Largest root of the mean squared difference that a collapse has made, in units of the attribute.
    error: f64,
}

impl Channels {
    pub(super) fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.count
    }

    pub(super) fn is_texture(&self) -> bool {
        matches!(self.semantic, Semantic::TexCoord(_)) && self.count == 2
    }

    fn is_normal(&self) -> bool {
        self.semantic == Semantic::Normal && self.count == 3
    }
}

/// The attributes of all wedges that the metric counts.
///
/// Wedges that the vanishing faces join share a value ([`Corners`]); and so do wedges of one vertex whose values are equal.
#[derive(Debug)]
pub(in crate::simplify) struct Carried {
    /// Length of the frame's 1 in model units.
    unit: f64,
    pub(super) corners: Corners,
    pub(super) attributes: Vec<Channels>,
    /// Scalars of a wedge.
    pub(super) channels: usize,
    /// Value of each channel of each wedge.
    pub(super) values: Vec<f32>,
    /// Whether the values of a wedge are other than they were.
    changed: Vec<bool>,
    /// Weight of each channel.
    pub(super) weights: Vec<f64>,
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
pub(super) struct Pending {
    wedges: Vec<u32>,
    /// All channels of each wedge.
    values: Vec<f32>,
    /// Of each attribute.
    pub(super) errors: Vec<f64>,
    /// Squared error that the texture coordinates of each wedge will have gathered; empty if there is no limit.
    texture_drift_sq: Vec<f32>,
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
pub(super) struct Ends {
    /// Each wedge once, and the end that it is at.
    pub(super) wedges: Vec<(u32, u8)>,
    /// Which two of them a vanishing face joins.
    pairs: Vec<[u8; 2]>,
}

/// Wedges at the ends of an edge that share a value.
#[derive(Clone, Copy)]
pub(super) struct Group<'a> {
    ends: &'a Ends,
    /// To each wedge, the first of those that it shares with.
    label: &'a [u8],
    first: usize,
}

impl<'a> Group<'a> {
    /// All groups, of wedges labelled by [`Carried::shared`].
    pub(super) fn all(ends: &'a Ends, label: &'a [u8]) -> impl Iterator<Item = Self> {
        let first = (0..label.len()).filter(|&i| usize::from(label[i]) == i);
        first.map(move |first| Self { ends, label, first })
    }

    /// Places of the members among the wedges.
    fn places(self) -> impl Iterator<Item = usize> + Clone + use<'a> {
        (self.first..self.label.len()).filter(move |&i| usize::from(self.label[i]) == self.first)
    }

    /// Each wedge and the end that it is at.
    pub(super) fn members(self) -> impl Iterator<Item = (u32, u8)> + Clone + use<'a> {
        self.places().map(move |i| self.ends.wedges[i])
    }
}

impl Carried {
    /// What a mesh carries whose positions will be in that frame; `None` if no attribute counts.
    pub(super) fn new(mesh: &Mesh, frame: &Frame, options: &SimplifyOptions) -> Option<Self> {
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
                attributes.push(Channels { semantic, first: channels, count, lab, weight, error: 0.0 });
                channels += count;
            }
        }
        if attributes.is_empty() {
            return None;
        }
        let mut carried = Self {
            unit: frame.unit(),
            corners: Corners::new(mesh.triangles.clone(), &mesh.wedge_vertices),
            weights: attributes.iter().flat_map(|a| std::iter::repeat_n(a.weight, a.count)).collect(),
            values: vec![0.0; mesh.wedge_count() * channels],
            changed: vec![false; mesh.wedge_count()],
            texture_may_fold: options.texture_may_fold,
            texture_limit_sq: options.max_texture_error.map(|most| most * most),
            texture_drift_sq: vec![0.0; if options.max_texture_error.is_some() { mesh.wedge_count() } else { 0 }],
            pending: Pending::default(),
            attributes,
            channels,
        };
        carried.take_values(mesh);
        Some(carried)
    }

    pub(super) fn wedge_count(&self) -> usize {
        self.changed.len()
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

    /// Writes the values of all wedges that have changed into a mesh with the same wedges.
    pub(in crate::simplify) fn give_all_values(&self, mesh: &mut Mesh) {
        let all: Vec<u32> = (0..self.wedge_count() as u32).collect();
        self.give_values(&all, mesh);
    }

    /// Writes the values of those of some wedges that have changed into a mesh with the same wedges.
    pub(in crate::simplify) fn give_values(&self, wedges: &[u32], mesh: &mut Mesh) {
        for attribute in &self.attributes {
            let into = mesh.wedge_attributes.iter_mut().find(|a| a.semantic == attribute.semantic);
            let Some(into) = into.and_then(Attribute::as_f32_mut) else { continue };
            for w in wedges.iter().map(|&w| w as usize).filter(|&w| self.changed[w]) {
                let into = &mut into[w * attribute.count..][..attribute.count];
                into.copy_from_slice(&self.values[w * self.channels..][attribute.range()]);
                if let (Some(srgb), Some(color)) = (attribute.lab, into.first_chunk_mut()) {
                    let light = from_lab(*color);
                    *color = if srgb { light.map(to_srgb) } else { light };
                }
            }
        }
    }

    /// What collapses have done to the attributes.
    pub(in crate::simplify) fn errors(&self) -> Vec<AttributeError> {
        let told = |a: &Channels| AttributeError {
            semantic: a.semantic.clone(),
            weight: a.weight * self.unit,
            error: a.error,
        };
        self.attributes.iter().map(told).collect()
    }

    #[inline]
    pub(super) fn value(&self, wedge: u32, channel: usize) -> f32 {
        self.values[wedge as usize * self.channels + channel]
    }

    /// The wedges around the collapse that was settled last.
    pub(super) fn pending_wedges(&self) -> &[u32] {
        &self.pending.wedges
    }

    /// The wedges at both ends of an edge.
    pub(super) fn ends(&self, rings: [impl Iterator<Item = RingFace>; 2], ends: [u32; 2]) -> Ends {
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

    /// Which of the wedges share their values in a range of channels: to each, the first of those that it shares with.
    pub(super) fn shared(&self, channels: std::ops::Range<usize>, ends: &Ends) -> Vec<u8> {
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
            let same = |other: u32| channels.clone().all(|c| self.value(other, c) == self.value(wedge, c));
            if let Some(i) = (0..j).find(|&i| ends.wedges[i].1 == end && same(ends.wedges[i].0)) {
                join(i as u8, j as u8, &mut label);
            }
        }
        label
    }

    /// Starts over with what the wedges around a collapse will be worth.
    pub(super) fn start(&mut self, ends: &Ends) -> Pending {
        let mut pending = std::mem::take(&mut self.pending);
        pending.clear();
        pending.wedges.extend(ends.wedges.iter().map(|&(wedge, _)| wedge));
        pending.values.resize(ends.wedges.len() * self.channels, 0.0);
        let limited = if self.texture_drift_sq.is_empty() { 0 } else { ends.wedges.len() };
        pending.texture_drift_sq.resize(limited, 0.0);
        pending
    }

    /// Notes the value of an attribute that a group of wedges will have after a collapse to a place: what is predicted for
    /// each channel, within what is around, or what is at the end that is kept.
    pub(super) fn settle(
        &self,
        pending: &mut Pending,
        attribute: &Channels,
        group: Group<'_>,
        (edge, rings, place): (&EdgeContext, [&[RingFace]; 2], DVec3),
        predicted: Option<&[f64]>,
    ) {
        let members = group.members();
        let (reference, _) = group.ends.wedges[group.first];
        let kept_end = edge.points.iter().position(|&end| end == place);
        let at_end = kept_end.and_then(|end| members.clone().find(|&(_, e)| usize::from(e) == end));
        pending.value.clear();
        for (k, j) in attribute.range().enumerate() {
            pending.value.push(match (at_end, predicted) {
                (Some((wedge, _)), _) => self.value(wedge, j), // to the bit
                (None, Some(predicted)) => {
                    let [low, high] = self.reach(j, &members, rings, edge.ends);
                    (predicted[k] as f32).clamp(low, high)
                }
                (None, None) => self.value(reference, j),
            });
        }
        if attribute.is_normal() && at_end.is_none() {
            let mean = glam::Vec3::from_slice(&pending.value);
            let fallback =
                || glam::Vec3::from_slice(&self.values[reference as usize * self.channels + attribute.first..]);
            pending.value.copy_from_slice(&mean.try_normalize().unwrap_or_else(fallback).to_array());
        }
        for i in group.places() {
            pending.values[i * self.channels..][attribute.range()].copy_from_slice(&pending.value);
        }
    }

    /// Notes how far texture coordinates of a group of wedges slip, if there is a limit: squared, in their own units.
    pub(super) fn slip(&self, pending: &mut Pending, group: Group<'_>, step_sq: f64) {
        if pending.texture_drift_sq.is_empty() {
            return;
        }
        let before = group.members().map(|(w, _)| self.texture_drift_sq[w as usize]).fold(0.0, f32::max);
        for i in group.places() {
            let gathered = &mut pending.texture_drift_sq[i];
            *gathered = gathered.max(before + step_sq as f32);
        }
    }

    /// Whether a collapse that has been settled keeps to the limits of the texture.
    pub(super) fn accepts(&mut self, pending: Pending, edge: &EdgeContext, rings: [&[RingFace]; 2]) -> bool {
        self.pending = pending;
        let gathered = self.pending.texture_drift_sq.iter().copied().fold(0.0, f32::max);
        let is_off = self.texture_limit_sq.is_some_and(|most| f64::from(gathered) > most);
        !is_off && (self.texture_may_fold || !self.folds_texture(edge, rings))
    }

    /// The collapse that was settled last is about to be made.
    pub(super) fn on_collapse(&mut self, collapse: &Collapse<'_>) {
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
