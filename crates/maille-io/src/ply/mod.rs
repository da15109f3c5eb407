//! PLY: text and both binaries, with any properties.
//!
//! Written by hand: `ply-rs-bw` builds a hash map for every row, many times the memory of the arrays that we want, and
//! cannot hand on rows it does not know. Here text is first turned into binary rows, so that there is one decoder, and
//! binary rows go straight from the mapped file into the final arrays, pages being given back as they are read.
//!
//! What becomes what:
//! - Rows of `vertex` are vertices. Their properties (normals, colours, texture coordinates, and whatever else, each
//!   scalar under its own name) become *wedge* attributes, one wedge to each vertex, so that everything is found where
//!   glTF has it and is interpolated. 32-bit integers are labels; smaller integers are quantities.
//! - Where rows have normals or texture coordinates, those at equal positions are wedges of one vertex: so do other
//!   formats' seams look in a PLY. Rows without either are never joined.
//! - Texture coordinates in the faces (`texcoord` lists, as MeshLab writes them) make more wedges.
//! - Polygons and strips become triangles; properties of faces become triangle attributes, `texnumber` or
//!   `material_index` the material.
//! - Notes, other elements, the order and types of properties are kept and written back. Elements that refer to
//!   vertices are left out once the number of vertices has changed.

mod body;
mod header;
mod read;
mod roles;
mod write;

pub(crate) use read::read;
pub(crate) use write::write;

use crate::left_out::{count, looks};
use header::{Element, Property};

/// What a PLY file holds beside its mesh.
#[derive(Debug, Clone)]
pub(crate) struct PlySource {
    /// Comment and `obj_info` lines, whole.
    notes: Vec<String>,
    /// Properties of the vertices, for their order and types.
    vertex: Vec<Property>,
    /// Properties of the faces, likewise.
    face: Vec<Property>,
    /// Rows of `vertex`.
    vertex_count: usize,
    /// Elements that mean nothing to us, with their rows in little endian.
    others: Vec<(Element, Vec<u8>)>,
    /// The number that the file gives each material slot.
    materials: Vec<u32>,
    sized_names: bool,
}

/// What precedes the name of an image in the comments of MeshLab.
const TEXTURE_NOTE: &str = "comment TextureFile ";

impl PlySource {
    /// What the file holds beside its mesh, in words.
    pub(crate) fn beyond_mesh(&self) -> Vec<String> {
        let textures = self.notes.iter().filter(|note| note.starts_with(TEXTURE_NOTE)).count();
        let elements = self.others.iter().map(|(element, _)| in_words(element));
        looks(0, textures).into_iter().chain(elements).collect()
    }
}

fn in_words(element: &Element) -> String {
    format!("{} of the element '{}'", count(element.count as usize, "row"), element.name)
}
