//! What properties mean, by their names.

use maille::Semantic;
use maille::mesh::ComponentType;

use super::header::{Kind, Property};

/// Where a scalar property belongs.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Role {
    /// A coordinate.
    Position(usize),
    /// A component of an attribute.
    Part { semantic: Semantic, slot: usize },
    /// The material slot of a face.
    Material,
    /// A list.
    List,
}

/// Names that make an attribute together; those behind the number needed may be absent.
const GROUPS: [(&[&str], usize, Semantic); 8] = [
    (&["x", "y", "z"], 3, Semantic::Position),
    (&["nx", "ny", "nz"], 3, Semantic::Normal),
    (&["red", "green", "blue", "alpha"], 3, Semantic::Color(0)),
    (&["diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"], 3, Semantic::Color(0)),
    (&["r", "g", "b", "a"], 3, Semantic::Color(0)),
    (&["s", "t"], 2, Semantic::TexCoord(0)),
    (&["u", "v"], 2, Semantic::TexCoord(0)),
    (&["texture_u", "texture_v"], 2, Semantic::TexCoord(0)),
];

/// The roles of the vertex properties.
pub(super) fn vertex_roles(properties: &[Property]) -> Vec<Role> {
    roles(properties, &GROUPS)
}

/// The roles of the face properties: colours, materials, and anything else by its name.
pub(super) fn face_roles(properties: &[Property]) -> Vec<Role> {
    let mut roles = roles(properties, &GROUPS[2..5]);
    let is_material = |p: &Property| matches!(p.name.as_str(), "texnumber" | "material_index");
    if let Some(material) = properties.iter().position(is_material).filter(|&i| roles[i] != Role::List) {
        roles[material] = Role::Material;
    }
    roles
}

fn roles(properties: &[Property], groups: &[(&[&str], usize, Semantic)]) -> Vec<Role> {
    let custom = |p: &Property| match p.kind {
        Kind::Scalar(_) => Role::Part { semantic: Semantic::Custom(p.name.clone()), slot: 0 },
        Kind::List { .. } => Role::List,
    };
    let mut roles: Vec<Role> = properties.iter().map(custom).collect();
    let mut taken = Vec::new();
    for (names, needed, semantic) in groups {
        let found = |name: &&str| properties.iter().position(|p| p.name == *name && fits(p.kind, semantic));
        let places: Vec<usize> = names.iter().map_while(found).collect();
        if places.len() < *needed || taken.contains(semantic) {
            continue;
        }
        taken.push(semantic.clone());
        for (slot, place) in places.into_iter().enumerate() {
            roles[place] = match semantic {
                Semantic::Position => Role::Position(slot),
                _ => Role::Part { semantic: semantic.clone(), slot },
            };
        }
    }
    roles
}

/// Whether a type can stand for a meaning: normals and texture coordinates are real numbers.
fn fits(kind: Kind, semantic: &Semantic) -> bool {
    match kind {
        Kind::Scalar(ty) => {
            matches!(semantic, Semantic::Position | Semantic::Color(_))
                || matches!(ty, ComponentType::F32 | ComponentType::F64)
        }
        Kind::List { .. } => false,
    }
}

/// The number in the file that stands for 1.
pub(super) fn unit(semantic: &Semantic, ty: ComponentType) -> f32 {
    match (semantic, ty) {
        (Semantic::Color(_), ComponentType::U16 | ComponentType::I16) => 65_535.0,
        (Semantic::Color(_), ComponentType::F32 | ComponentType::F64) => 1.0,
        // files that give colours as int or char mean 0 to 255, too
        (Semantic::Color(_), _) => 255.0,
        _ => 1.0,
    }
}
