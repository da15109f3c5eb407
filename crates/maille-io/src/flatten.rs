//! One mesh out of an asset, for formats that hold no more than one; and rows of vertices out of wedges, for formats
//! that know no wedges.

use std::borrow::Cow;

use glam::{DMat3, DMat4, DVec3, Vec3};
use maille::mesh::Values;
use maille::{Attribute, Mesh, Semantic};

use crate::{Asset, Instance, NamedMesh};

/// Everything that is drawn, as one mesh in world space at rest, with its attributes. Free when that is one mesh where
/// it stands.
pub(crate) fn flattened(asset: &Asset) -> Cow<'_, Mesh> {
    match &asset.instances[..] {
        [] if asset.meshes.len() == 1 => Cow::Borrowed(&asset.meshes[0].mesh),
        [only] if only.transform == DMat4::IDENTITY && only.is_rigid() => Cow::Borrowed(&asset.meshes[only.mesh].mesh),
        [] => {
            let still = |mesh| Instance { mesh, ..Instance::default() };
            Cow::Owned(merged(asset, &(0..asset.meshes.len()).map(still).collect::<Vec<_>>()))
        }
        instances => Cow::Owned(merged(asset, instances)),
    }
}

fn merged(asset: &Asset, instances: &[Instance]) -> Mesh {
    let meshes = || instances.iter().map(|i| &asset.meshes[i.mesh].mesh);
    let mut out = Mesh::default();
    for instance in instances {
        append_geometry(&mut out, &asset.meshes[instance.mesh].mesh, instance);
    }
    append_materials(&mut out, asset, instances);
    out.wedge_attributes = union(&meshes(), |m| (&m.wedge_attributes, m.wedge_count()));
    out.vertex_attributes = union(&meshes(), |m| (&m.vertex_attributes, m.vertex_count()));
    out.triangle_attributes = union(&meshes(), |m| (&m.triangle_attributes, m.triangle_count()));
    let mut first = 0;
    for instance in instances {
        let mesh = &asset.meshes[instance.mesh].mesh;
        turn_directions(&mut out.wedge_attributes, first, mesh, instance);
        first += mesh.wedge_count();
    }
    out
}

fn append_geometry(out: &mut Mesh, mesh: &Mesh, instance: &Instance) {
    let (first_vertex, first_wedge) = (out.positions.len() as u32, out.wedge_vertices.len() as u32);
    let still = |p: &[f32; 3]| instance.transform.transform_point3(Vec3::from(*p).as_dvec3()).as_vec3().to_array();
    out.positions.extend(mesh.positions.iter().map(still));
    if !instance.is_rigid() {
        for (wedge, &vertex) in mesh.wedge_vertices.iter().enumerate() {
            let posed = instance.posed_wedge(mesh, wedge);
            out.positions[(first_vertex + vertex) as usize] = posed.as_vec3().to_array();
        }
    }
    out.wedge_vertices.extend(mesh.wedge_vertices.iter().map(|v| first_vertex + v));
    let mirrored = instance.joint_matrices.is_none() && instance.transform.determinant() < 0.0;
    let facing = |[a, b, c]: [u32; 3]| if mirrored { [a, c, b] } else { [a, b, c] };
    out.triangles.extend(mesh.triangles.iter().map(|&t| facing(t).map(|w| first_wedge + w)));
}

/// Joins slots of equal names; nameless ones of different meshes stay apart.
fn append_materials(out: &mut Mesh, asset: &Asset, instances: &[Instance]) {
    let blank = |m: &NamedMesh| m.mesh.triangle_materials.is_empty() && m.mesh.material_names.is_empty();
    if asset.meshes.iter().all(blank) {
        return;
    }
    let mut slots_of: Vec<Option<Vec<u32>>> = vec![None; asset.meshes.len()];
    for instance in instances {
        let mesh = &asset.meshes[instance.mesh].mesh;
        let slots = slots_of[instance.mesh].get_or_insert_with(|| new_slots(&mut out.material_names, mesh));
        out.triangle_materials.extend((0..mesh.triangle_count()).map(|t| slots[mesh.triangle_material(t) as usize]));
    }
}

fn new_slots(names: &mut Vec<String>, mesh: &Mesh) -> Vec<u32> {
    let used = mesh.triangle_materials.iter().map(|&slot| slot as usize + 1).max().unwrap_or(1);
    let slot_of = |slot| {
        let name = mesh.material_names.get(slot).map_or("", String::as_str);
        let known = names.iter().position(|n| !name.is_empty() && n == name);
        known.unwrap_or_else(|| {
            names.push(name.to_owned());
            names.len() - 1
        }) as u32
    };
    (0..used.max(mesh.material_names.len())).map(slot_of).collect()
}

/// The attributes that any of the meshes has, one mesh after the other. Where a mesh lacks one: white for colours,
/// 0 for the rest.
fn union<'a>(
    meshes: &(impl Iterator<Item = &'a Mesh> + Clone),
    group: impl Fn(&'a Mesh) -> (&'a Vec<Attribute>, usize),
) -> Vec<Attribute> {
    let mut out: Vec<Attribute> = Vec::new();
    for attribute in meshes.clone().flat_map(|m| group(m).0) {
        match out.iter_mut().find(|a| a.semantic == attribute.semantic) {
            Some(known) => known.components = known.components.max(attribute.components),
            None => {
                let values = match &attribute.values {
                    Values::F32(_) => Values::F32(Vec::new()),
                    Values::U32(_) => Values::U32(Vec::new()),
                };
                out.push(Attribute { values, ..attribute.clone() });
            }
        }
    }
    for attribute in &mut out {
        for mesh in meshes.clone() {
            let (group, count) = group(mesh);
            append_values(attribute, group.iter().find(|a| a.semantic == attribute.semantic), count);
        }
    }
    out
}

fn append_values(out: &mut Attribute, from: Option<&Attribute>, count: usize) {
    let components = out.components;
    let blank = if matches!(out.semantic, Semantic::Color(_)) { 1.0 } else { 0.0 };
    match (&mut out.values, from.map(|a| (&a.values, a))) {
        (Values::F32(to), Some((Values::F32(values), a))) => {
            let values = if matches!(a.semantic, Semantic::Color(_)) && a.storage.srgb != out.storage.srgb {
                Cow::Owned(crate::color::recoded(values, a.components, out.storage.srgb))
            } else {
                Cow::Borrowed(&values[..])
            };
            for element in values.chunks_exact(a.components) {
                to.extend((0..components).map(|k| element.get(k).copied().unwrap_or(blank)));
            }
        }
        (Values::U32(to), Some((Values::U32(values), a))) => {
            for element in values.chunks_exact(a.components) {
                to.extend((0..components).map(|k| element.get(k).copied().unwrap_or(0)));
            }
        }
        (Values::F32(to), _) => to.resize(to.len() + count * components, blank),
        (Values::U32(to), _) => to.resize(to.len() + count * components, 0),
    }
}

/// Turns normals and tangents as their instance stands.
fn turn_directions(attributes: &mut [Attribute], first: usize, mesh: &Mesh, instance: &Instance) {
    for attribute in attributes {
        let components = attribute.components;
        let (is_normal, is_tangent) = (attribute.semantic == Semantic::Normal, attribute.semantic == Semantic::Tangent);
        let Some(values) = attribute.as_f32_mut().filter(|_| (is_normal || is_tangent) && components >= 3) else {
            continue;
        };
        for wedge in 0..mesh.wedge_count() {
            let linear = DMat3::from_mat4(instance.wedge_matrix(mesh, wedge));
            // the cofactor matrix turns normals as the inverse transpose does, and exists for singular ones, too
            let cofactor = DMat3::from_cols(
                linear.y_axis.cross(linear.z_axis),
                linear.z_axis.cross(linear.x_axis),
                linear.x_axis.cross(linear.y_axis),
            ) * linear.determinant().signum();
            let value = &mut values[(first + wedge) * components..][..3];
            let old = DVec3::new(value[0].into(), value[1].into(), value[2].into());
            let new = if is_normal { cofactor * old } else { linear * old };
            value.copy_from_slice(&new.normalize_or(old).as_vec3().to_array());
        }
    }
}

/// Vertices for a file that knows no wedges: one for each vertex of the mesh where all its wedges agree, else one for
/// each wedge.
pub(crate) struct Rows<'a> {
    mesh: &'a Mesh,
    /// The first wedge of each vertex, `u32::MAX` for vertices that none uses; `None`: a row is a wedge.
    first_wedges: Option<Vec<u32>>,
}

impl<'a> Rows<'a> {
    /// Rows that keep every attribute but those that `aside` names (the file stores them in another way).
    pub(crate) fn new(mesh: &'a Mesh, aside: impl Fn(&Semantic) -> bool) -> Self {
        let wedges = &mesh.wedge_vertices;
        let identical = wedges.len() == mesh.vertex_count() && wedges.iter().enumerate().all(|(i, &v)| i == v as usize);
        if identical {
            return Self { mesh, first_wedges: None };
        }
        let mut first = vec![u32::MAX; mesh.vertex_count()];
        for (wedge, &vertex) in wedges.iter().enumerate() {
            let first = &mut first[vertex as usize];
            *first = (*first).min(wedge as u32);
        }
        let agrees = |a: &Attribute| {
            let c = a.components;
            let mut pairs = wedges.iter().enumerate().map(|(w, &v)| (w * c, first[v as usize] as usize * c));
            match &a.values {
                Values::F32(x) => pairs.all(|(w, f)| (0..c).all(|k| x[w + k].to_bits() == x[f + k].to_bits())),
                Values::U32(x) => pairs.all(|(w, f)| x[w..w + c] == x[f..f + c]),
            }
        };
        let joined = mesh.wedge_attributes.iter().filter(|a| !aside(&a.semantic)).all(agrees);
        Self { mesh, first_wedges: joined.then_some(first) }
    }

    /// Number of rows.
    pub(crate) fn len(&self) -> usize {
        if self.first_wedges.is_some() { self.mesh.vertex_count() } else { self.mesh.wedge_count() }
    }

    /// Whether a row stands for a vertex with all its wedges.
    pub(crate) fn are_vertices(&self) -> bool {
        self.first_wedges.is_some()
    }

    /// The vertex of a row.
    pub(crate) fn vertex(&self, row: usize) -> usize {
        if self.first_wedges.is_some() { row } else { self.mesh.wedge_vertices[row] as usize }
    }

    /// A wedge of a row, if any triangle may use it.
    pub(crate) fn wedge(&self, row: usize) -> Option<usize> {
        match &self.first_wedges {
            Some(first) => (first[row] != u32::MAX).then_some(first[row] as usize),
            None => Some(row),
        }
    }

    /// The rows of a triangle.
    pub(crate) fn triangle(&self, triangle: usize) -> [u32; 3] {
        let wedges = self.mesh.triangles[triangle];
        if self.first_wedges.is_some() { wedges.map(|w| self.mesh.wedge_vertices[w as usize]) } else { wedges }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use maille::mesh::shapes;

    #[test]
    fn instances_are_merged_where_they_stand_with_their_normals_turned() {
        let mut mesh = shapes::grid(1);
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, [0.0, 0.0, 1.0].repeat(4)));
        let mut plain = shapes::cube();
        plain.triangle_materials = vec![1; 12];
        plain.material_names = vec!["red".into(), "blue".into()];
        let at = |mesh, transform| Instance { mesh, transform, ..Instance::default() };
        let asset = Asset {
            meshes: [mesh, plain].map(|mesh| NamedMesh { name: String::new(), mesh }).into(),
            instances: vec![
                at(0, DMat4::from_rotation_x(std::f64::consts::FRAC_PI_2)),
                at(0, DMat4::from_scale(DVec3::new(1.0, 1.0, -2.0))),
                at(1, DMat4::from_translation(DVec3::X)),
            ],
            ..Asset::default()
        };
        let flat = flattened(&asset);
        flat.check().unwrap();
        let normals = flat.wedge_attribute(&Semantic::Normal).unwrap().as_f32().unwrap();
        for (normal, expected) in [(&normals[..3], [0.0, -1.0, 0.0]), (&normals[12..15], [0.0, 0.0, -1.0])] {
            assert!(normal.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{normal:?}");
        }
        assert_eq!(normals[24..], [0.0; 24]);
        // mirrored triangles are wound the other way, so that they still face along their normals
        let [a, b, c] = flat.triangle_points(2);
        assert!((b - a).cross(c - a).z < 0.0);
        assert_eq!(flat.triangle_material(3), 0);
        assert_eq!(flat.material_names[flat.triangle_material(4) as usize], "blue");
    }

    #[test]
    fn rows_are_vertices_exactly_when_their_wedges_agree() {
        let mut mesh = shapes::tetrahedron();
        mesh.wedge_vertices = vec![0, 1, 2, 3, 3];
        mesh.triangles[3][2] = 4;
        let mut uv = Attribute::new_f32(Semantic::TexCoord(0), 2, vec![0.5; 10]);
        mesh.wedge_attributes = vec![uv.clone()];
        assert!(Rows::new(&mesh, |_| false).are_vertices());
        uv.as_f32_mut().unwrap()[9] = 0.75;
        mesh.wedge_attributes = vec![uv];
        let rows = Rows::new(&mesh, |_| false);
        assert_eq!((rows.len(), rows.triangle(3)), (5, mesh.triangles[3]));
        let rows = Rows::new(&mesh, |s| *s == Semantic::TexCoord(0));
        assert_eq!((rows.len(), rows.triangle(3)), (4, mesh.triangle_vertices(3)));
    }
}
