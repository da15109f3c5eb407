//! From the values of a mesh to the bytes of accessors that keep the rules of glTF: unit normals, weights that sum to
//! one, indices as small as they go, elements at multiples of four bytes.

use maille::mesh::{ComponentType, MorphTarget, Storage, Values};
use maille::{Attribute, Mesh, Semantic};
use serde_json::{Value, json};

use super::accessor::{Layout, Shape, bounds_of, component_code};
use crate::color::recoded;

/// What a buffer view is for, by glTF's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Target {
    Vertices = 34962,
    Indices = 34963,
}

/// The content of a new accessor.
pub(super) struct Encoded {
    layout: Layout,
    count: usize,
    target: Target,
    /// Smallest and largest element, where glTF asks for them.
    bounds: Option<(Vec<Value>, Vec<Value>)>,
    pub(super) bytes: Vec<u8>,
}

impl Encoded {
    /// Vertex data.
    fn floats(layout: Layout, values: &[f32]) -> Self {
        let stride = layout.stride();
        let offsets = layout.offsets();
        let elements = values.chunks_exact(layout.shape.components());
        let count = elements.len();
        let mut bytes = vec![0; count * stride];
        for (element, target) in elements.zip(bytes.chunks_exact_mut(stride)) {
            for (&value, &offset) in element.iter().zip(&offsets) {
                put(layout, value, &mut target[offset..]);
            }
        }
        Self { layout, count, target: Target::Vertices, bounds: None, bytes }
    }

    /// Vertex data of labels, which all fit `component`.
    fn labels(component: ComponentType, shape: Shape, values: &[u32]) -> Self {
        let layout = Layout { component, normalized: false, shape };
        let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
        Self::floats(layout, &values)
    }

    fn with_bounds(mut self, values: &[f32]) -> Self {
        let stored: Vec<f32> = match self.layout.component {
            ComponentType::F32 => values.to_vec(),
            _ => values.iter().map(|&value| stored_integer(self.layout, value) as f32).collect(),
        };
        self.bounds = Some(bounds_of(&stored, self.layout.shape.components(), self.layout.component));
        self
    }

    /// Vertex indices: 16 bits as long as all stay below 65535, which would end a strip.
    fn indices(corners: &[u32], vertices: usize) -> Self {
        let narrow = vertices <= usize::from(u16::MAX);
        let bytes = if narrow {
            corners.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect()
        } else {
            corners.iter().flat_map(|i| i.to_le_bytes()).collect()
        };
        let component = if narrow { ComponentType::U16 } else { ComponentType::U32 };
        let layout = Layout { component, normalized: false, shape: Shape::Scalar };
        Self { layout, count: corners.len(), target: Target::Indices, bounds: None, bytes }
    }

    /// The JSON of the accessor, over all of buffer view `view`.
    pub(super) fn accessor(&self, view: usize) -> Value {
        let component = component_code(self.layout.component).expect("only layouts that glTF knows are encoded");
        let mut json = json!({ "bufferView": view, "componentType": component });
        if self.layout.normalized {
            json["normalized"] = json!(true);
        }
        json["count"] = json!(self.count);
        json["type"] = json!(self.layout.shape.name());
        if let Some((low, high)) = &self.bounds {
            json["min"] = json!(low);
            json["max"] = json!(high);
        }
        json
    }

    /// The JSON of the buffer view, without its place in the buffer.
    pub(super) fn view(&self) -> Value {
        let mut json = json!({ "buffer": 0, "byteOffset": 0, "byteLength": self.bytes.len() });
        let stride = self.layout.stride();
        if self.target == Target::Vertices && stride != self.layout.size() {
            json["byteStride"] = json!(stride);
        }
        json["target"] = json!(self.target as u32);
        json
    }
}

/// Range of the integers of a component type.
fn range(component: ComponentType) -> (f64, f64) {
    match component {
        ComponentType::I8 => (-128.0, 127.0),
        ComponentType::U8 => (0.0, 255.0),
        ComponentType::I16 => (-32768.0, 32767.0),
        ComponentType::U16 => (0.0, 65535.0),
        ComponentType::I32 => (-2147483648.0, 2147483647.0),
        ComponentType::U32 => (0.0, 4294967295.0),
        ComponentType::F32 | ComponentType::F64 => (f64::MIN, f64::MAX),
    }
}

/// The integer that stands for a value, before it is cut to its range.
fn unclamped_integer(layout: Layout, value: f32) -> f64 {
    let (_, highest) = range(layout.component);
    (f64::from(value) * if layout.normalized { highest } else { 1.0 }).round()
}

fn stored_integer(layout: Layout, value: f32) -> f64 {
    let (lowest, highest) = range(layout.component);
    // -128 and -32768 stand for the same fraction as their neighbours, which are the ones to write
    let lowest = if layout.normalized && lowest < 0.0 { -highest } else { lowest };
    unclamped_integer(layout, value).clamp(lowest, highest)
}

fn put(layout: Layout, value: f32, target: &mut [u8]) {
    let integer = || stored_integer(layout, value) as i64;
    match layout.component {
        ComponentType::I8 | ComponentType::U8 => target[0] = integer() as u8,
        ComponentType::I16 | ComponentType::U16 => target[..2].copy_from_slice(&(integer() as u16).to_le_bytes()),
        ComponentType::I32 | ComponentType::U32 => target[..4].copy_from_slice(&(integer() as u32).to_le_bytes()),
        ComponentType::F32 | ComponentType::F64 => target[..4].copy_from_slice(&value.to_le_bytes()),
    }
}

/// Whether integers of a layout can stand for all values, but for rounding.
pub(super) fn fits(layout: Layout, mut values: impl Iterator<Item = f32>) -> bool {
    let (lowest, highest) = range(layout.component);
    values.all(|value| (lowest..=highest).contains(&unclamped_integer(layout, value)))
}

/// How one primitive is to be written.
pub(super) struct Plan<'a> {
    /// Its attributes; the positions are always written, first.
    pub(super) attributes: Vec<PlannedAttribute<'a>>,
    /// The same for each morph target.
    pub(super) targets: Vec<Vec<(String, &'a Semantic)>>,
    /// How positions are stored.
    pub(super) positions: Layout,
    /// Whether integers may be used where glTF alone asks for floats (`KHR_mesh_quantization`).
    pub(super) quantized: bool,
}

/// An attribute to write.
pub(super) struct PlannedAttribute<'a> {
    pub(super) name: String,
    pub(super) semantic: &'a Semantic,
    /// The shape that it had, which tells four scalars in a row from those of a matrix.
    pub(super) shape: Option<Shape>,
}

/// The new accessors of a primitive.
pub(super) struct EncodedPrimitive {
    pub(super) indices: Encoded,
    /// A strip of triangles, not a list.
    pub(super) is_strip: bool,
    pub(super) attributes: Vec<(String, Encoded)>,
    pub(super) targets: Vec<Vec<(String, Encoded)>>,
}

/// Encodes some triangles of a mesh as a primitive; as a strip if that is wanted and takes fewer indices.
pub(super) fn encode_primitive(mesh: &Mesh, triangles: &[u32], plan: &Plan<'_>, strips: bool) -> EncodedPrimitive {
    let corners: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
    let mut wedges = corners.clone();
    wedges.sort_unstable();
    wedges.dedup();
    let place = |wedge: &u32| wedges.binary_search(wedge).expect("the list holds every corner") as u32;
    let corners: Vec<u32> = corners.iter().map(place).collect();
    let vertices: Vec<u32> = wedges.iter().map(|&w| mesh.wedge_vertices[w as usize]).collect();
    let points: Vec<f32> = vertices.iter().flat_map(|&v| mesh.positions[v as usize]).collect();

    let mut picked: Vec<Picked<'_>> = Vec::new();
    for planned in &plan.attributes {
        let find = |list: &[Attribute], elements: &[u32]| {
            list.iter().find(|a| a.semantic == *planned.semantic).map(|a| pick(a, elements))
        };
        let found = find(&mesh.wedge_attributes, &wedges).or_else(|| find(&mesh.vertex_attributes, &vertices));
        picked.extend(found.map(|attribute| Picked { planned, attribute }));
    }
    repair_directions(&mut picked, &points, &corners);
    repair_weights(&mut picked);
    let positions = Encoded::floats(plan.positions, &points).with_bounds(&points);
    let mut attributes = vec![("POSITION".to_owned(), positions)];
    for Picked { planned, attribute } in &picked {
        attributes.extend(encode_attribute(&planned.name, attribute, planned.shape, plan.quantized));
    }
    let targets = plan.targets.iter().zip(&mesh.morph_targets);
    let targets = targets.map(|(names, target)| encode_target(names, target, &wedges, plan)).collect();
    // glTF has no index that ends a strip: triangles without area lead to the next one
    let strip = strips.then(|| meshopt::stripify(&corners, wedges.len(), 0).ok()).flatten();
    let strip = strip.filter(|strip| strip.len() < corners.len());
    let indices = Encoded::indices(strip.as_deref().unwrap_or(&corners), wedges.len());
    EncodedPrimitive { indices, is_strip: strip.is_some(), attributes, targets }
}

/// The values of an attribute for one primitive.
struct Picked<'a> {
    planned: &'a PlannedAttribute<'a>,
    attribute: Attribute,
}

/// Some elements of an attribute.
fn pick(attribute: &Attribute, elements: &[u32]) -> Attribute {
    fn gathered<T: Copy>(values: &[T], components: usize, elements: &[u32]) -> Vec<T> {
        elements.iter().flat_map(|&i| &values[i as usize * components..][..components]).copied().collect()
    }
    let values = match &attribute.values {
        Values::F32(values) => {
            let mut values = gathered(values, attribute.components, elements);
            values.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = 0.0);
            Values::F32(values)
        }
        Values::U32(values) => Values::U32(gathered(values, attribute.components, elements)),
    };
    Attribute { semantic: attribute.semantic.clone(), values, ..*attribute }
}

fn encode_target(
    names: &[(String, &Semantic)],
    target: &MorphTarget,
    wedges: &[u32],
    plan: &Plan<'_>,
) -> Vec<(String, Encoded)> {
    let encode = |(name, semantic): &(String, &Semantic)| {
        let attribute = pick(target.attributes.iter().find(|a| a.semantic == **semantic)?, wedges);
        let values = attribute.as_f32()?;
        let shape = shape_of(attribute.components)?;
        let layout = Layout { component: attribute.storage.component, normalized: attribute.storage.normalized, shape };
        let allowed = match attribute.semantic {
            Semantic::Position | Semantic::Normal | Semantic::Tangent => plan.quantized && is_signed(layout),
            _ => layout.normalized,
        };
        let layout = if allowed && fits(layout, values.iter().copied()) { layout } else { Layout::floats(shape) };
        let encoded = Encoded::floats(layout, values);
        let encoded = if attribute.semantic == Semantic::Position { encoded.with_bounds(values) } else { encoded };
        Some((name.clone(), encoded))
    };
    names.iter().filter_map(encode).collect()
}

fn is_signed(layout: Layout) -> bool {
    matches!(layout.component, ComponentType::I8 | ComponentType::I16)
}

fn shape_of(components: usize) -> Option<Shape> {
    Some(match components {
        1 => Shape::Scalar,
        2 => Shape::Vec2,
        3 => Shape::Vec3,
        4 => Shape::Vec4,
        9 => Shape::Mat3,
        16 => Shape::Mat4,
        _ => return None,
    })
}

/// One attribute as accessors: one, or one for each component where glTF has no type for so many.
fn encode_attribute(
    name: &str,
    attribute: &Attribute,
    shape: Option<Shape>,
    quantized: bool,
) -> Vec<(String, Encoded)> {
    let old_shape = shape.filter(|shape| shape.components() == attribute.components);
    let Some(shape) = old_shape.or_else(|| shape_of(attribute.components)) else {
        let scalar = |i: usize| {
            let single = Attribute { components: 1, values: component_of(attribute, i), ..attribute.clone() };
            encode_attribute(&format!("{name}_{i}"), &single, None, quantized)
        };
        return (0..attribute.components).flat_map(scalar).collect();
    };
    let encoded = match &attribute.values {
        Values::U32(labels) => encode_labels(labels, shape, attribute),
        Values::F32(values) if attribute.storage.srgb && matches!(attribute.semantic, Semantic::Color(_)) => {
            let linear = recoded(values, attribute.components, false);
            // 16 bits hold every linear value that 8 bits of sRGB can name
            let integers = attribute.storage.component != ComponentType::F32;
            let layout = Layout { component: ComponentType::U16, normalized: true, shape };
            let fits = integers && fits(layout, linear.iter().copied());
            Encoded::floats(if fits { layout } else { Layout::floats(shape) }, &linear)
        }
        Values::F32(values) => {
            let layout = stored_layout(attribute, shape, quantized);
            let layout = if fits(layout, values.iter().copied()) { layout } else { Layout::floats(shape) };
            Encoded::floats(layout, values)
        }
    };
    vec![(name.to_owned(), encoded)]
}

fn component_of(attribute: &Attribute, component: usize) -> Values {
    fn column<T: Copy>(values: &[T], component: usize, components: usize) -> Vec<T> {
        values.iter().skip(component).step_by(components).copied().collect()
    }
    match &attribute.values {
        Values::F32(values) => Values::F32(column(values, component, attribute.components)),
        Values::U32(values) => Values::U32(column(values, component, attribute.components)),
    }
}

/// Labels in the integers that they came in, wider ones if they have grown, and floats where glTF has none so wide.
fn encode_labels(labels: &[u32], shape: Shape, attribute: &Attribute) -> Encoded {
    let largest = labels.iter().max().copied().unwrap_or(0);
    let bytes = largest <= u32::from(u8::MAX) && attribute.storage.component != ComponentType::U16;
    match largest {
        _ if bytes => Encoded::labels(ComponentType::U8, shape, labels),
        0..=0xffff => Encoded::labels(ComponentType::U16, shape, labels),
        _ => Encoded::labels(ComponentType::F32, shape, labels),
    }
}

/// How an attribute was stored, if glTF allows that for its meaning, else as floats.
fn stored_layout(attribute: &Attribute, shape: Shape, quantized: bool) -> Layout {
    let Storage { component, normalized, .. } = attribute.storage;
    let layout = Layout { component, normalized, shape };
    let unsigned = matches!(component, ComponentType::U8 | ComponentType::U16);
    let allowed = match attribute.semantic {
        Semantic::Position => false,
        Semantic::Normal | Semantic::Tangent => quantized && normalized && is_signed(layout),
        Semantic::TexCoord(_) => (normalized && unsigned) || (quantized && (unsigned || is_signed(layout))),
        Semantic::Color(_) | Semantic::Weights(_) => normalized && unsigned,
        Semantic::Joints(_) => false,
        Semantic::Custom(_) => unsigned || is_signed(layout),
    };
    if allowed { layout } else { Layout::floats(shape) }
}

/// Makes normals unit vectors, and tangents unit vectors with a sign; where there is no direction at all, a normal gets
/// that of its triangles and a tangent any one across its normal.
fn repair_directions(attributes: &mut [Picked<'_>], points: &[f32], corners: &[u32]) {
    let mut normals: Option<Vec<f32>> = None;
    let find = |attributes: &[Picked<'_>], semantic| attributes.iter().position(|a| a.attribute.semantic == semantic);
    if let Some(i) = find(attributes, Semantic::Normal)
        && let (3, Some(values)) = (attributes[i].attribute.components, attributes[i].attribute.as_f32_mut())
    {
        let mut computed: Option<Vec<glam::Vec3>> = None;
        for (vertex, normal) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let unit = unit(*normal).unwrap_or_else(|| {
                let computed = computed.get_or_insert_with(|| vertex_normals(points, corners));
                unit(computed[vertex].to_array()).unwrap_or([0.0, 0.0, 1.0])
            });
            *normal = unit;
        }
        normals = Some(values.clone());
    }
    if let Some(i) = find(attributes, Semantic::Tangent)
        && let (4, Some(values)) = (attributes[i].attribute.components, attributes[i].attribute.as_f32_mut())
    {
        for (vertex, tangent) in values.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            let normal = normals.as_ref().map_or(glam::Vec3::Z, |n| glam::Vec3::from_slice(&n[3 * vertex..]));
            let [x, y, z, w] = *tangent;
            let [x, y, z] = unit([x, y, z]).unwrap_or_else(|| normal.any_orthonormal_vector().to_array());
            *tangent = [x, y, z, if w < 0.0 { -1.0 } else { 1.0 }];
        }
    }
}

/// A vector scaled to length one, computed so that the rounded result is as near to it as it can be.
fn unit(vector: [f32; 3]) -> Option<[f32; 3]> {
    let wide = glam::Vec3::from(vector).as_dvec3();
    wide.try_normalize().map(|unit| unit.as_vec3().to_array())
}

/// Area-weighted normals of vertices.
fn vertex_normals(points: &[f32], corners: &[u32]) -> Vec<glam::Vec3> {
    let point = |vertex: u32| glam::Vec3::from_slice(&points[3 * vertex as usize..]);
    let mut normals = vec![glam::Vec3::ZERO; points.len() / 3];
    for &[a, b, c] in corners.as_chunks::<3>().0 {
        let normal = (point(b) - point(a)).cross(point(c) - point(a));
        [a, b, c].iter().for_each(|&vertex| normals[vertex as usize] += normal);
    }
    normals
}

/// Makes the weights of each vertex sum to one, exactly in the integers that they are stored in; a joint named twice
/// counts once, and one without weight is joint 0, as glTF asks.
fn repair_weights(attributes: &mut [Picked<'_>]) {
    let mut sets = Vec::new();
    for set in 0.. {
        let find = |semantic| {
            attributes.iter().map(|a| &a.attribute).position(|a| a.semantic == semantic && a.components == 4)
        };
        match (find(Semantic::Joints(set)), find(Semantic::Weights(set))) {
            (Some(joints), Some(weights)) => sets.push((joints, weights)),
            _ => break,
        }
    }
    let Some(&(_, first)) = sets.first() else { return };
    let Storage { component, normalized, .. } = attributes[first].attribute.storage;
    let steps = match component {
        ComponentType::U8 if normalized => Some(255),
        ComponentType::U16 if normalized => Some(65535),
        _ => None,
    };
    if sets.iter().any(|&(_, weights)| attributes[weights].attribute.storage != attributes[first].attribute.storage) {
        // sets of different precision cannot sum up exactly together
        sets.iter().for_each(|&(_, weights)| attributes[weights].attribute.storage = Storage::F32);
    }
    let steps = steps.filter(|_| attributes[first].attribute.storage.component == component);
    let mut influences: Vec<(u32, f64)> = Vec::with_capacity(4 * sets.len());
    for vertex in 0..attributes[first].attribute.len() {
        influences.clear();
        for &(joints, weights) in &sets {
            let joints = attributes[joints]
                .attribute
                .as_u32()
                .map_or([0; 4], |j| j[4 * vertex..][..4].try_into().expect("four"));
            let weights = attributes[weights]
                .attribute
                .as_f32()
                .map_or([0.0; 4], |w| w[4 * vertex..][..4].try_into().expect("four"));
            influences.extend(joints.into_iter().zip(weights.map(f64::from)));
        }
        settle(&mut influences, steps);
        for (set, four) in influences.as_chunks::<4>().0.iter().enumerate() {
            let (joints, weights) = sets[set];
            if let Values::U32(all) = &mut attributes[joints].attribute.values {
                all[4 * vertex..][..4].copy_from_slice(&four.map(|(joint, _)| joint));
            }
            if let Some(all) = attributes[weights].attribute.as_f32_mut() {
                all[4 * vertex..][..4].copy_from_slice(&four.map(|(_, weight)| weight as f32));
            }
        }
    }
}

/// Makes the weights of one vertex sum to one, in `steps` equal steps if given.
fn settle(influences: &mut [(u32, f64)], steps: Option<u32>) {
    for i in 0..influences.len() {
        if influences[i].1.is_nan() || influences[i].1 <= 0.0 {
            influences[i].1 = 0.0;
        } else if let Some(known) = (0..i).find(|&k| influences[k].0 == influences[i].0 && influences[k].1 > 0.0) {
            influences[known].1 += std::mem::take(&mut influences[i].1);
        }
    }
    let total: f64 = influences.iter().map(|&(_, weight)| weight).sum();
    if total > 0.0 {
        influences.iter_mut().for_each(|(_, weight)| *weight /= total);
    } else {
        influences[0].1 = 1.0;
    }
    let grid = |weight: f64| match steps {
        Some(steps) => (weight * f64::from(steps)).round() / f64::from(steps),
        None => f64::from(weight as f32),
    };
    influences.iter_mut().for_each(|(_, weight)| *weight = grid(*weight));
    // what rounding has lost or gained goes to the largest, where it matters least
    let largest = (0..influences.len()).rev().max_by(|&a, &b| influences[a].1.total_cmp(&influences[b].1)).unwrap_or(0);
    let others: f64 = (0..influences.len()).filter(|&i| i != largest).map(|i| influences[i].1).sum();
    influences[largest].1 = grid(1.0 - others);
    influences.iter_mut().filter(|(_, weight)| *weight == 0.0).for_each(|(joint, _)| *joint = 0);
}
