//! Wavefront OBJ, with the MTL beside it.
//!
//! Written by hand: `tobj` makes a model of every object and group, forgets groups, smoothing groups and the text of
//! the MTL, and reads on one thread. Here the text is cut into pieces at line ends, parsed on all threads, and joined
//! in order: the result does not depend on the number of threads.
//!
//! What becomes what:
//! - `v` are vertices; a wedge is a vertex with certain values (not indices) of `vt` and `vn`, so that files that
//!   write them anew for every face still have no seams. Vertex colours behind the coordinates are taken as sRGB.
//! - `usemtl` makes material slots. The MTL is kept as text and written beside an OBJ again.
//! - `o`/`g` and `s` become the triangle attributes `group` (labels) and `smoothing`, and are written back.
//! - Lines, points and free-form surfaces are left out, with a warning.

mod parse;
mod read;
mod write;

use maille::Semantic;

use crate::left_out::looks;

pub(crate) use read::read;
pub(crate) use write::write;

/// What an OBJ file holds beside its mesh.
#[derive(Debug, Clone, Default)]
pub(crate) struct ObjSource {
    /// Object and group that each label of the attribute `group` stands for.
    parts: Vec<Part>,
    /// The text of the material libraries.
    mtl: Vec<u8>,
}

/// Names of the object and group that a face belongs to.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
struct Part {
    object: String,
    group: String,
}

/// Name of the triangle attribute with the group labels.
const GROUP: &str = "group";
/// Name of the triangle attribute with the smoothing groups.
const SMOOTHING: &str = "smoothing";

impl ObjSource {
    /// What the material libraries say, in words.
    pub(crate) fn looks(&self) -> Option<String> {
        let statements = || self.mtl.split(|&b| b == b'\n').map(<[u8]>::trim_ascii_start);
        let number = |starts: fn(&[u8]) -> bool| statements().filter(|line| starts(line)).count();
        looks(number(|line| line.starts_with(b"newmtl")), number(|line| line.starts_with(b"map_")))
    }
}

/// Whether an attribute of triangles is one that OBJ has statements for.
pub(crate) fn holds_at_triangles(semantic: &Semantic) -> bool {
    matches!(semantic, Semantic::Custom(name) if name == GROUP || name == SMOOTHING)
}
