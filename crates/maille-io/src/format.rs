//! The formats, and how a file's format is found from its first bytes.

use std::path::Path;

use crate::{mpm, off, stl};

/// A file format that Maille reads and writes; what is read from [`Mpm`](Self::Mpm) is its finest level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Format {
    /// glTF 2.0 as JSON, with its buffers embedded or beside it.
    Gltf,
    /// glTF 2.0 in one binary file.
    Glb,
    /// Polygon file format (Stanford), text or binary.
    Ply,
    /// Wavefront OBJ, with its MTL beside it.
    Obj,
    /// Stereolithography, text or binary.
    Stl,
    /// The OFF family of Geomview.
    Off,
    /// Progressive meshes: an asset with all its levels ([`ProgressiveAsset`](crate::ProgressiveAsset)).
    Mpm,
}

/// Bytes looked at when a text format is guessed.
const LOOK: usize = 1 << 16;

const OBJ_STATEMENTS: [&str; 14] =
    ["v", "vt", "vn", "vp", "f", "fo", "l", "p", "g", "o", "s", "usemtl", "mtllib", "usemap"];

impl Format {
    /// All formats, with their usual extensions.
    pub const EXTENSIONS: [(&'static str, Self); 7] = [
        ("gltf", Self::Gltf),
        ("glb", Self::Glb),
        ("ply", Self::Ply),
        ("obj", Self::Obj),
        ("stl", Self::Stl),
        ("off", Self::Off),
        ("mpm", Self::Mpm),
    ];

    /// The format that the extension of a path names, in any case; `None` if it names none of ours.
    pub fn from_path(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?;
        Self::EXTENSIONS.iter().find(|(name, _)| extension.eq_ignore_ascii_case(name)).map(|&(_, format)| format)
    }

    /// The format of a file by its content; where that leaves a doubt, `hint` (from the extension) decides.
    ///
    /// `bytes` is the whole file: a binary STL is known by its length, whatever its header says.
    pub fn detect(bytes: &[u8], hint: Option<Self>) -> Option<Self> {
        Self::by_magic(bytes).or_else(|| Self::by_statements(bytes, hint)).or(hint)
    }

    /// What the first bytes or the length prove.
    fn by_magic(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"glTF") {
            return Some(Self::Glb);
        }
        if bytes.starts_with(b"ply") && bytes.get(3).is_some_and(u8::is_ascii_whitespace) {
            return Some(Self::Ply);
        }
        if bytes.starts_with(mpm::MAGIC) {
            return Some(Self::Mpm);
        }
        if stl::has_binary_length(bytes) {
            return Some(Self::Stl);
        }
        None
    }

    /// What the words at the start of a text tell.
    fn by_statements(bytes: &[u8], hint: Option<Self>) -> Option<Self> {
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let text = text.trim_ascii_start();
        let text = &text[..text.len().min(LOOK)];
        if text.first() == Some(&b'{') {
            return Some(Self::Gltf);
        }
        let first = statements(text).next().unwrap_or_default();
        if off::is_keyword(first) {
            return Some(Self::Off);
        }
        if first.eq_ignore_ascii_case(b"solid") && hint != Some(Self::Obj) {
            return Some(Self::Stl);
        }
        looks_like_obj(text).then_some(Self::Obj)
    }
}

/// First words of the lines, without comments and blank lines.
fn statements(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    let lines = text.split(|&b| b == b'\n' || b == b'\r').map(first_word);
    lines.filter(|word| !word.is_empty() && !word.starts_with(b"#"))
}

/// Whether nearly all lines are statements of OBJ (writers add their own, and lines may be continued).
fn looks_like_obj(text: &[u8]) -> bool {
    let (mut known, mut all) = (0_u32, 0_u32);
    for word in statements(text) {
        all += 1;
        known += u32::from(OBJ_STATEMENTS.iter().any(|s| s.as_bytes() == word));
    }
    !text.contains(&0) && known > 0 && known >= all - all / 4
}

fn first_word(line: &[u8]) -> &[u8] {
    line.trim_ascii_start().split(u8::is_ascii_whitespace).next().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_decides_whatever_the_extension_says() {
        let found = |text: &str| Format::detect(text.as_bytes(), Some(Format::Stl));
        assert_eq!(found("ply\nformat ascii 1.0\n"), Some(Format::Ply));
        assert_eq!(found("glTF\x02\0\0\0"), Some(Format::Glb));
        assert_eq!(Format::detect(b"\x89MPM\r\n\x1a\n", None), Some(Format::Mpm));
        assert_eq!(found("\u{feff} \n{\"asset\":{}}"), Some(Format::Gltf));
        assert_eq!(found("# by hand\nOFF\n3 1 0\n"), Some(Format::Off));
        assert_eq!(found("STCN4OFF\n"), Some(Format::Off));
        assert_eq!(found("COFF 3 1 0\n"), Some(Format::Off));
        assert_eq!(found("# by hand\nmtllib a.mtl\no thing\nv 0 0 0\nnonsense\nf 1 1 1\n"), Some(Format::Obj));
        assert_eq!(Format::detect(b"solid cube\nfacet normal 0 0 1\n", None), Some(Format::Stl));
    }

    #[test]
    fn binary_stl_is_known_by_its_length_even_when_its_header_begins_with_solid() {
        let mut bytes = b"solid but binary".to_vec();
        bytes.resize(80, b' ');
        bytes.extend_from_slice(&2_u32.to_le_bytes());
        bytes.resize(84 + 100, 1);
        assert_eq!(Format::detect(&bytes, Some(Format::Obj)), Some(Format::Stl));
    }

    #[test]
    fn the_extension_decides_only_where_content_does_not() {
        let noise: Vec<u8> = (0..999_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        assert_eq!(Format::detect(&noise, None), None);
        assert_eq!(Format::detect(&noise, Some(Format::Off)), Some(Format::Off));
        assert_eq!(Format::from_path(Path::new("a/b.PLY")), Some(Format::Ply));
        assert_eq!(Format::from_path(Path::new("a/b.blend")), None);
    }
}
