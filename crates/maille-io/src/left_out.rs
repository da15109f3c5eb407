//! What a format cannot hold of an asset. It is said whenever a file is written: nothing gets lost in silence.

use maille::{Attribute, Semantic};

use crate::asset::Source;
use crate::{Asset, Format, WriteOptions};

const GLTF: &str = ".glb and .gltf";
/// Attributes named in a message; more are only counted.
const NAMED: usize = 4;

/// One sentence for each kind of thing that a file of this format has no place for, with the formats that have one.
pub(crate) fn left_out(asset: &Asset, format: Format, options: &WriteOptions) -> Vec<String> {
    let is_gltf = matches!(format, Format::Gltf | Format::Glb | Format::Mpm);
    let (beyond_meshes, keeper) = match &asset.source {
        Source::Gltf(document) if !is_gltf => (document.beyond_meshes(), GLTF),
        Source::Ply(source) if format != Format::Ply => (source.beyond_mesh(), ".ply"),
        Source::Obj(source) if format != Format::Obj => (source.looks().into_iter().collect(), ".obj"),
        _ => (Vec::new(), ""),
    };
    let mut lost: Vec<(String, &str)> = beyond_meshes.into_iter().map(|what| (what, keeper)).collect();
    if !is_gltf {
        lost.extend(arrangement(asset).into_iter().map(|what| (what, GLTF)));
    }
    let meshes = || asset.meshes.iter().map(|named| &named.mesh);
    if matches!(format, Format::Stl | Format::Off) && meshes().any(|mesh| !mesh.triangle_materials.is_empty()) {
        lost.push(("the materials of triangles".to_owned(), ".glb, .gltf, .ply and .obj"));
    }
    let of_vertices = meshes().flat_map(|mesh| mesh.wedge_attributes.iter().chain(&mesh.vertex_attributes));
    let attributes = named(of_vertices, |semantic| holds_at_vertices(format, semantic));
    lost.extend(attributes.map(|names| (names, ".glb, .gltf and .ply")));
    let of_triangles = meshes().flat_map(|mesh| &mesh.triangle_attributes);
    let attributes = named(of_triangles, |semantic| holds_at_triangles(format, options, semantic));
    lost.extend(attributes.map(|names| (format!("{names} of triangles"), ".ply")));
    lost.into_iter().map(|(what, keepers)| format!("left out: {what} (kept by {keepers})")).collect()
}

/// What becomes of several meshes, places and shapes once there is one mesh at rest.
fn arrangement(asset: &Asset) -> Vec<String> {
    let mut is_drawn = vec![asset.instances.is_empty(); asset.meshes.len()];
    asset.instances.iter().for_each(|instance| is_drawn[instance.mesh] = true);
    let drawn = is_drawn.iter().filter(|&&drawn| drawn).count();
    let (hidden, places) = (asset.meshes.len() - drawn, asset.instances.len().max(drawn));
    let targets = asset.meshes.iter().map(|named| named.mesh.morph_targets.len()).max().unwrap_or(0);
    let mut lost = Vec::new();
    if hidden > 0 {
        lost.push(format!("{} that the scene does not draw", count(hidden, "mesh")));
    }
    if places > 1 {
        lost.push(format!("the division into {} at {}", count(drawn, "mesh"), count(places, "place")));
    }
    if targets > 0 {
        lost.push(count(targets, "morph target"));
    }
    lost
}

/// A number of things in words.
pub(crate) fn count(n: usize, what: &str) -> String {
    let ending = match n {
        1 => "",
        _ if what.ends_with('h') => "es",
        _ => "s",
    };
    format!("{n} {what}{ending}")
}

/// Materials and the textures on them in words.
pub(crate) fn looks(materials: usize, textures: usize) -> Option<String> {
    match (materials, textures) {
        (0, 0) => None,
        (0, _) => Some(count(textures, "texture")),
        (_, 0) => Some(format!("the look of {}", count(materials, "material"))),
        _ => Some(format!("the look of {} with {}", count(materials, "material"), count(textures, "texture"))),
    }
}

/// The attributes that a format does not hold, each once.
fn named<'a>(attributes: impl Iterator<Item = &'a Attribute>, holds: impl Fn(&Semantic) -> bool) -> Option<String> {
    let mut names: Vec<String> = Vec::new();
    for attribute in attributes.filter(|attribute| !holds(&attribute.semantic)) {
        let name = attribute.semantic.to_string();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let more = names.len().saturating_sub(NAMED);
    let shown = names[..names.len() - more].join(", ");
    match (names.len(), more) {
        (0, _) => None,
        (1, _) => Some(format!("the attribute {shown}")),
        (_, 0) => Some(format!("the attributes {shown}")),
        _ => Some(format!("the attributes {shown} and {more} more")),
    }
}

fn holds_at_vertices(format: Format, semantic: &Semantic) -> bool {
    match format {
        Format::Gltf | Format::Glb | Format::Ply | Format::Mpm => true,
        Format::Obj | Format::Off => {
            matches!(semantic, Semantic::Normal | Semantic::TexCoord(0) | Semantic::Color(0))
        }
        Format::Stl => false,
    }
}

fn holds_at_triangles(format: Format, options: &WriteOptions, semantic: &Semantic) -> bool {
    match format {
        Format::Ply | Format::Mpm => true,
        Format::Obj => crate::obj::holds_at_triangles(semantic),
        Format::Stl => *semantic == Semantic::Color(0) && !options.text,
        Format::Off => *semantic == Semantic::Color(0),
        Format::Gltf | Format::Glb => false,
    }
}
