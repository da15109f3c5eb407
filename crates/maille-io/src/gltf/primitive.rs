//! From the primitives of a glTF mesh to a [`Mesh`].

use maille::mesh::{MorphTarget, Storage, Values};
use maille::{Attribute, Mesh, Semantic};
use serde_json::Value;

use super::accessor::{Accessor, Shape};
use super::json::{Checked, Fault, Within, as_index, index, list, members, text};
use super::{Budget, Document};

/// What a primitive draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    /// Points and lines, and what has no positions: passed through.
    Other,
    Triangles,
    Strip,
    Fan,
}

/// What a primitive draws, as far as it concerns meshes.
pub(super) fn mode(primitive: &Value) -> Checked<Mode> {
    if primitive.get("attributes").and_then(|attributes| attributes.get("POSITION")).is_none() {
        return Ok(Mode::Other);
    }
    Ok(match index(primitive, "mode")?.unwrap_or(4) {
        0..=3 => Mode::Other,
        4 => Mode::Triangles,
        5 => Mode::Strip,
        6 => Mode::Fan,
        other => return Err(Fault::new(format!("unknown mode {other}"))).within("mode"),
    })
}

/// The meaning of an attribute name.
pub(super) fn semantic_of(name: &str) -> Semantic {
    let set = |prefix: &str| {
        let number: u32 = name.strip_prefix(prefix)?.parse().ok()?;
        (name == format!("{prefix}{number}")).then_some(number)
    };
    match name {
        "POSITION" => Semantic::Position,
        "NORMAL" => Semantic::Normal,
        "TANGENT" => Semantic::Tangent,
        _ => (set("TEXCOORD_").map(Semantic::TexCoord))
            .or_else(|| set("COLOR_").map(Semantic::Color))
            .or_else(|| set("JOINTS_").map(Semantic::Joints))
            .or_else(|| set("WEIGHTS_").map(Semantic::Weights))
            .unwrap_or_else(|| Semantic::Custom(name.to_owned())),
    }
}

/// The names of a mesh's morph targets, as far as it gives any.
fn target_names(mesh: &Value) -> Vec<&str> {
    let names = mesh.get("extras").and_then(|extras| extras.get("targetNames")).and_then(Value::as_array);
    names.into_iter().flatten().map(|name| name.as_str().unwrap_or_default()).collect()
}

/// Decodes a mesh; also gives sentences on what was odd, which begin with the place below the mesh.
pub(super) fn read_mesh(document: &Document, json: &Value, budget: &mut Budget) -> Checked<(Mesh, Vec<String>)> {
    let mut warnings = Vec::new();
    let mut parts = Vec::new();
    let primitives = list(json, "primitives")?;
    for (i, primitive) in primitives.iter().enumerate() {
        if mode(primitive).within_item("primitives", i)? != Mode::Other {
            let mut part = Part::read(document, primitive, i as u32, budget).within_item("primitives", i)?;
            warnings.extend(part.warnings.drain(..).map(|odd| format!("primitives[{i}]: {odd}")));
            parts.push(part);
        }
    }
    let mut mesh = join(parts, &target_names(json))?;
    if primitives.len() > 1 || !mesh.triangle_materials.is_empty() {
        mesh.material_names = primitives.iter().map(|primitive| material_name(document, primitive)).collect();
    }
    Ok((mesh, warnings))
}

/// The name of the material of a primitive: that which it has, or its number; empty without a material.
pub(super) fn material_name(document: &Document, primitive: &Value) -> String {
    let Ok(Some(number)) = index(primitive, "material") else { return String::new() };
    match document.list("materials").get(number).map_or("", |material| text(material, "name")) {
        "" => format!("material {number}"),
        name => name.to_owned(),
    }
}

/// One primitive, decoded: only the vertices that its triangles use.
struct Part {
    slot: u32,
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    attributes: Vec<Attribute>,
    targets: Vec<Vec<Attribute>>,
    warnings: Vec<String>,
}

impl Part {
    fn read(document: &Document, primitive: &Value, slot: u32, budget: &mut Budget) -> Checked<Self> {
        let attributes = members(primitive, "attributes")?;
        let positions = accessor(document, &primitive["attributes"], "POSITION").within("attributes")?;
        let count = positions.count;
        let mut warnings = Vec::new();
        let corners = corners(document, primitive, count, budget, &mut warnings)?;
        let triangles = triangles(&corners, mode(primitive)?, &mut warnings);
        drop(corners);

        let mut vertices = Vertices::used_by(triangles, count);
        budget.spend(vertices.kept.len() as u64 * 12)?;
        let points: Vec<[f32; 3]> = positions.floats(Some(&vertices.kept)).as_chunks::<3>().0.to_vec();
        let points = vertices.drop_non_finite(points, &mut warnings);

        let mut reader = AttributeReader { document, kept: &vertices.kept, count, budget };
        let attributes = attributes.into_iter().filter(|&(name, _)| name != "POSITION");
        let attributes = attributes.map(|(name, value)| reader.read(name, value, false).within(name));
        let attributes = attributes.collect::<Checked<_>>().within("attributes")?;
        let targets = list(primitive, "targets")?.iter().enumerate().map(|(i, target)| {
            let deltas = target.as_object().into_iter().flatten();
            deltas
                .map(|(name, value)| reader.read(name, value, true).within(name))
                .collect::<Checked<_>>()
                .within_item("targets", i)
        });
        let targets = targets.collect::<Checked<_>>()?;
        Ok(Self { slot, positions: points, triangles: vertices.triangles, attributes, targets, warnings })
    }
}

/// The accessor that a member names.
fn accessor<'a>(document: &'a Document, object: &Value, key: &str) -> Checked<Accessor<'a>> {
    let number = super::json::required_index(object, key)?;
    let accessor = Accessor::new(document, number).within(key)?;
    if key == "POSITION" && accessor.layout.shape != Shape::Vec3 {
        return Err(Fault::new(format!("positions of type {}, expected VEC3", accessor.layout.shape.name())))
            .within(key);
    }
    Ok(accessor)
}

/// The vertices that the primitive names one after the other, checked to exist.
fn corners(
    document: &Document,
    primitive: &Value,
    vertices: usize,
    budget: &mut Budget,
    warnings: &mut Vec<String>,
) -> Checked<Vec<u32>> {
    let Some(number) = index(primitive, "indices")? else {
        budget.spend(vertices as u64 * 4)?;
        return Ok((0..vertices as u32).collect());
    };
    let mut read = || {
        let accessor = Accessor::new(document, number)?;
        if accessor.layout.shape != Shape::Scalar {
            return Err(Fault::new(format!("indices of type {}, expected SCALAR", accessor.layout.shape.name())));
        }
        budget.spend(accessor.count as u64 * 4)?;
        let indices = accessor.integers(None).ok_or_else(|| Fault::new("the indices are not unsigned integers"))?;
        match indices.iter().position(|&index| index as usize >= vertices) {
            Some(place) => Err(Fault::new(format!(
                "index {} at {place} is beyond the {vertices} vertices of the primitive",
                indices[place]
            ))),
            None => Ok(indices),
        }
    };
    let indices = read().within("indices")?;
    if indices.is_empty() {
        warnings.push("there are no indices".to_owned());
    }
    Ok(indices)
}

/// Lists of three; strips and fans are resolved, and the degenerate triangles that stitch strips together left out.
fn triangles(corners: &[u32], mode: Mode, warnings: &mut Vec<String>) -> Vec<[u32; 3]> {
    let stitch = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
    match mode {
        Mode::Strip => {
            // every second triangle is turned round, so that all wind the same way
            let windows = corners.array_windows::<3>().enumerate();
            let turned = windows.map(|(i, &[a, b, c])| if i % 2 == 0 { [a, b, c] } else { [a, c, b] });
            turned.filter(|t| !stitch(t)).collect()
        }
        Mode::Fan => {
            let rim = corners.get(1..).unwrap_or_default().array_windows::<2>();
            rim.map(|&[a, b]| [a, b, corners[0]]).filter(|t| !stitch(t)).collect()
        }
        Mode::Triangles | Mode::Other => {
            let (triangles, rest) = corners.as_chunks::<3>();
            if !rest.is_empty() {
                warnings.push(format!("{} corners after the last whole triangle were left out", rest.len()));
            }
            triangles.to_vec()
        }
    }
}

/// The vertices of a primitive that are kept, and the triangles over them.
struct Vertices {
    /// Indices into the accessors, ascending.
    kept: Vec<u32>,
    triangles: Vec<[u32; 3]>,
}

impl Vertices {
    /// Keeps what the triangles use: vertices that nobody uses belong to no surface, and several primitives may share
    /// one large accessor.
    fn used_by(mut triangles: Vec<[u32; 3]>, count: usize) -> Self {
        const UNUSED: u32 = u32::MAX;
        let mut places = vec![UNUSED; count];
        triangles.iter().flatten().for_each(|&vertex| places[vertex as usize] = 0);
        let kept: Vec<u32> = (0..count as u32).filter(|&vertex| places[vertex as usize] != UNUSED).collect();
        for (place, &vertex) in kept.iter().enumerate() {
            places[vertex as usize] = place as u32;
        }
        triangles.iter_mut().flatten().for_each(|vertex| *vertex = places[*vertex as usize]);
        Self { kept, triangles }
    }

    /// Leaves out the triangles that have a corner nowhere, and gives the positions of the vertices kept then.
    fn drop_non_finite(&mut self, points: Vec<[f32; 3]>, warnings: &mut Vec<String>) -> Vec<[f32; 3]> {
        let finite: Vec<bool> = points.iter().map(|p| p.iter().all(|x| x.is_finite())).collect();
        if finite.iter().all(|&finite| finite) {
            return points;
        }
        let before = self.triangles.len();
        self.triangles.retain(|t| t.iter().all(|&vertex| finite[vertex as usize]));
        let dropped = before - self.triangles.len();
        warnings.push(format!("{dropped} triangles with positions that are not finite were left out"));
        let Self { kept: places, triangles } = Self::used_by(std::mem::take(&mut self.triangles), points.len());
        self.triangles = triangles;
        self.kept = places.iter().map(|&place| self.kept[place as usize]).collect();
        places.iter().map(|&place| points[place as usize]).collect()
    }
}

/// Decodes attributes for the vertices that are kept.
struct AttributeReader<'a> {
    document: &'a Document,
    kept: &'a [u32],
    count: usize,
    budget: &'a mut Budget,
}

impl AttributeReader<'_> {
    fn read(&mut self, name: &str, value: &Value, delta: bool) -> Checked<Attribute> {
        let accessor = Accessor::new(self.document, as_index(value)?)?;
        if accessor.count != self.count {
            return Err(Fault::new(format!("{} elements for {} positions", accessor.count, self.count)));
        }
        let semantic = semantic_of(name);
        check_shape(&semantic, accessor.layout.shape, delta)?;
        self.budget.spend(accessor.scalars(self.kept.len()) * 4)?;
        let layout = accessor.layout;
        let storage = Storage { component: layout.component, normalized: layout.normalized, srgb: false };
        let is_label = match semantic {
            Semantic::Joints(_) => true,
            Semantic::Custom(_) => !layout.normalized,
            _ => false,
        };
        let labels = if is_label { accessor.integers(Some(self.kept)) } else { None };
        let values = match (labels, &semantic) {
            (Some(labels), _) => Values::U32(labels),
            (None, Semantic::Joints(_)) => return Err(Fault::new("the joints are not unsigned integers")),
            (None, _) => Values::F32(accessor.floats(Some(self.kept))),
        };
        Ok(Attribute { semantic, components: layout.shape.components(), values, storage })
    }
}

fn check_shape(semantic: &Semantic, shape: Shape, delta: bool) -> Checked<()> {
    let expected: &[Shape] = match semantic {
        Semantic::Position | Semantic::Normal => &[Shape::Vec3],
        Semantic::Tangent if delta => &[Shape::Vec3],
        Semantic::Tangent | Semantic::Joints(_) | Semantic::Weights(_) => &[Shape::Vec4],
        Semantic::TexCoord(_) => &[Shape::Vec2],
        Semantic::Color(_) => &[Shape::Vec3, Shape::Vec4],
        Semantic::Custom(_) => return Ok(()),
    };
    if expected.contains(&shape) {
        return Ok(());
    }
    Err(Fault::new(format!("elements of type {}, expected {}", shape.name(), expected[0].name())))
}

/// All parts as one mesh.
fn join(mut parts: Vec<Part>, names: &[&str]) -> Checked<Mesh> {
    let wedges: usize = parts.iter().map(|part| part.positions.len()).sum();
    let corners: usize = parts.iter().map(|part| part.triangles.len() * 3).sum();
    if wedges.max(corners) >= u32::MAX as usize {
        return Err(Fault::new("the primitives together are more than 32-bit indices can name"));
    }
    let mut mesh = Mesh::default();
    if parts.iter().any(|part| part.slot != 0 && !part.triangles.is_empty()) {
        let slots = parts.iter().flat_map(|part| std::iter::repeat_n(part.slot, part.triangles.len()));
        mesh.triangle_materials = slots.collect();
    }
    let counts: Vec<usize> = parts.iter().map(|part| part.positions.len()).collect();
    let attributes = parts.iter_mut().map(|part| std::mem::take(&mut part.attributes)).collect();
    mesh.wedge_attributes = concatenate(attributes, &counts, false);
    let targets = parts.iter().map(|part| part.targets.len()).max().unwrap_or(0);
    for target in 0..targets {
        let deltas = parts.iter_mut().map(|part| part.targets.get_mut(target).map(std::mem::take).unwrap_or_default());
        let attributes = concatenate(deltas.collect(), &counts, true);
        mesh.morph_targets
            .push(MorphTarget { name: names.get(target).copied().unwrap_or_default().to_owned(), attributes });
    }
    let mut positions = Vec::with_capacity(wedges);
    mesh.triangles.reserve_exact(corners / 3);
    for part in parts {
        let first = positions.len() as u32;
        mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|vertex| first + vertex)));
        positions.extend(part.positions);
    }
    (mesh.wedge_vertices, mesh.positions) = weld(&positions);
    Ok(mesh)
}

/// Puts the attributes of the parts one after the other; where a part lacks one, a neutral value stands.
fn concatenate(parts: Vec<Vec<Attribute>>, counts: &[usize], delta: bool) -> Vec<Attribute> {
    if parts.len() == 1 {
        return parts.into_iter().next().unwrap_or_default();
    }
    let mut joined: Vec<Attribute> = Vec::new();
    for attribute in parts.iter().flatten() {
        match joined.iter_mut().find(|known| known.semantic == attribute.semantic) {
            Some(known) => widen(known, attribute),
            None => joined.push(empty_like(attribute)),
        }
    }
    for target in &mut joined {
        for (part, &count) in parts.iter().zip(counts) {
            append(target, part.iter().find(|a| a.semantic == target.semantic), count, delta);
        }
    }
    joined
}

fn empty_like(attribute: &Attribute) -> Attribute {
    let values = match attribute.values {
        Values::F32(_) => Values::F32(Vec::new()),
        Values::U32(_) => Values::U32(Vec::new()),
    };
    Attribute { semantic: attribute.semantic.clone(), values, ..*attribute }
}

/// Makes room in a still empty attribute for what another part stores under its name.
fn widen(known: &mut Attribute, other: &Attribute) {
    known.components = known.components.max(other.components);
    let both_labels = known.as_u32().is_some() && other.as_u32().is_some();
    if !both_labels {
        known.values = Values::F32(Vec::new());
    }
    if known.storage != other.storage {
        known.storage = match (both_labels, known.storage.component, other.storage.component) {
            (true, a, b) => Storage { component: a.max(b), ..known.storage },
            (false, ..) => Storage::F32,
        };
    }
}

/// Appends `count` elements of `source`, or neutral ones.
fn append(target: &mut Attribute, source: Option<&Attribute>, count: usize, delta: bool) {
    let components = target.components;
    match (&mut target.values, source.map(|source| (source.components, &source.values))) {
        (Values::U32(all), Some((width, Values::U32(values)))) => extend(all, values, width, components, 0),
        (Values::U32(all), _) => all.resize(all.len() + count * components, 0),
        (Values::F32(all), Some((width, Values::F32(values)))) => extend(all, values, width, components, 1.0),
        (Values::F32(all), Some((width, Values::U32(values)))) => {
            let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            extend(all, &values, width, components, 0.0);
        }
        (Values::F32(all), None) => {
            let neutral = if delta { [0.0; 4] } else { neutral(&target.semantic) };
            let element = (0..components).map(|i| neutral.get(i).copied().unwrap_or(0.0));
            all.extend((0..count).flat_map(|_| element.clone()));
        }
    }
}

/// Appends elements, each filled up with `fill` (the alpha of a colour that has none).
fn extend<T: Copy>(all: &mut Vec<T>, values: &[T], width: usize, components: usize, fill: T) {
    if width == components {
        all.extend_from_slice(values);
        return;
    }
    for element in values.chunks_exact(width) {
        all.extend_from_slice(element);
        all.extend(std::iter::repeat_n(fill, components - width));
    }
}

/// What stands for an attribute where a primitive has none.
fn neutral(semantic: &Semantic) -> [f32; 4] {
    match semantic {
        Semantic::Normal => [0.0, 0.0, 1.0, 0.0],
        Semantic::Tangent => [1.0, 0.0, 0.0, 1.0],
        Semantic::Color(_) => [1.0; 4],
        _ => [0.0; 4],
    }
}

/// Joins equal positions: the vertex of each wedge, and the positions in the order of their first wedges.
///
/// Linear time: an open hash table over the bits.
pub(crate) fn weld(points: &[[f32; 3]]) -> (Vec<u32>, Vec<[f32; 3]>) {
    const FREE: u32 = u32::MAX;
    let mask = (points.len() * 2).next_power_of_two() - 1;
    let mut table = vec![FREE; mask + 1];
    let mut positions: Vec<[f32; 3]> = Vec::new();
    let place = |p: &[f32; 3]| {
        // adding zero makes both zeros the same
        p.iter().fold(0u64, |hash, x| {
            (hash ^ u64::from((x + 0.0).to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
        }) as usize
    };
    let vertex_of = |p: &[f32; 3]| {
        let mut slot = place(p) & mask;
        loop {
            match table[slot] {
                FREE => {
                    table[slot] = positions.len() as u32;
                    positions.push(*p);
                    return table[slot];
                }
                vertex if positions[vertex as usize] == *p => return vertex,
                _ => slot = (slot + 1) & mask,
            }
        }
    };
    let vertices = points.iter().map(vertex_of).collect();
    (vertices, positions)
}
