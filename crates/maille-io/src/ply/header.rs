//! The header of a PLY file.

use maille::mesh::ComponentType;

use crate::text::{parse_int, show};
use crate::{Place, ReadError};

/// How the body is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// What stands before the body.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    /// The lines of comments and `obj_info`, whole.
    pub(super) notes: Vec<String>,
    pub(super) elements: Vec<Element>,
    /// Whether types are named by their size (`float32`), as some readers insist, and not as in C (`float`).
    pub(super) sized_names: bool,
    /// Where the body begins.
    pub(super) body: usize,
    /// Number of lines of the header.
    pub(super) lines: u64,
}

/// A kind of rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    /// Number of rows, as claimed.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

/// A column of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

/// Type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(ComponentType),
    List { count: ComponentType, item: ComponentType },
}

impl Kind {
    pub(super) fn is_scalar(self) -> bool {
        matches!(self, Self::Scalar(_))
    }

    /// Bytes in a binary row: of a list, those of its length.
    pub(super) fn least_size(self) -> usize {
        match self {
            Self::Scalar(ty) | Self::List { count: ty, .. } => size_of(ty),
        }
    }
}

impl Element {
    /// Bytes of a row in a binary body, `None` if there are lists.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().all(|p| p.kind.is_scalar()).then(|| self.least_stride())
    }

    /// Fewest bytes of a row in a binary body.
    pub(super) fn least_stride(&self) -> usize {
        self.properties.iter().map(|p| p.kind.least_size()).sum()
    }
}

/// Bytes of a scalar.
pub(super) fn size_of(ty: ComponentType) -> usize {
    match ty {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::I32 | ComponentType::U32 | ComponentType::F32 => 4,
        ComponentType::F64 => 8,
    }
}

/// Types with their two names.
const TYPE_NAMES: [(ComponentType, &str, &str); 8] = [
    (ComponentType::I8, "char", "int8"),
    (ComponentType::U8, "uchar", "uint8"),
    (ComponentType::I16, "short", "int16"),
    (ComponentType::U16, "ushort", "uint16"),
    (ComponentType::I32, "int", "int32"),
    (ComponentType::U32, "uint", "uint32"),
    (ComponentType::F32, "float", "float32"),
    (ComponentType::F64, "double", "float64"),
];

/// The name of a type, by size or as in C.
pub(super) fn type_name(ty: ComponentType, sized: bool) -> &'static str {
    let (_, plain, by_size) = TYPE_NAMES.iter().find(|(known, ..)| *known == ty).expect("the table has all types");
    if sized { by_size } else { plain }
}

impl Header {
    /// Parses the header at the start of a file.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, ReadError> {
        let mut header = Self {
            encoding: Encoding::Ascii,
            notes: Vec::new(),
            elements: Vec::new(),
            sized_names: false,
            body: 0,
            lines: 0,
        };
        let mut has_format = false;
        let mut lines = Lines { bytes, at: 0 };
        while let Some(line) = lines.next() {
            header.lines += 1;
            header.body = lines.at;
            let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
            match words[..] {
                [b"end_header"] if has_format => return Ok(header),
                [b"end_header"] => return Err(header.error("the header names no format")),
                [b"format", name, _version] => {
                    header.encoding = header.encoding_of(name)?;
                    has_format = true;
                }
                [b"comment" | b"obj_info", ..] => header.notes.push(String::from_utf8_lossy(line).into_owned()),
                [b"element", name, count] => header.add_element(name, count)?,
                [b"property", b"list", count, item, name] => {
                    let kind = Kind::List { count: header.count_type(count)?, item: header.type_of(item)? };
                    header.add_property(name, kind)?;
                }
                [b"property", ty, name] => {
                    let kind = Kind::Scalar(header.type_of(ty)?);
                    header.add_property(name, kind)?;
                }
                [] => {}
                [b"ply"] if header.lines == 1 => {}
                _ => return Err(header.error(format!("'{}' is no statement of a PLY header", show(line)))),
            }
        }
        Err(header.error("the file ends within its header").with_remedy("it has been cut short: fetch it again"))
    }

    fn error(&self, message: impl Into<String>) -> ReadError {
        ReadError::new(message).at(Place::Line(self.lines))
    }

    fn encoding_of(&self, name: &[u8]) -> Result<Encoding, ReadError> {
        match name {
            b"ascii" => Ok(Encoding::Ascii),
            b"binary_little_endian" => Ok(Encoding::LittleEndian),
            b"binary_big_endian" => Ok(Encoding::BigEndian),
            _ => Err(self
                .error(format!("format '{}' is none of ascii, binary_little_endian, binary_big_endian", show(name)))),
        }
    }

    fn type_of(&mut self, name: &[u8]) -> Result<ComponentType, ReadError> {
        for (ty, plain, sized) in TYPE_NAMES {
            if name == plain.as_bytes() || name == sized.as_bytes() {
                self.sized_names |= name == sized.as_bytes();
                return Ok(ty);
            }
        }
        Err(self.error(format!("'{}' is no type of PLY", show(name))))
    }

    fn count_type(&mut self, name: &[u8]) -> Result<ComponentType, ReadError> {
        match self.type_of(name)? {
            ComponentType::F32 | ComponentType::F64 => Err(self.error("the length of a list must be an integer")),
            ty => Ok(ty),
        }
    }

    fn add_element(&mut self, name: &[u8], count: &[u8]) -> Result<(), ReadError> {
        let Some(count) = parse_int(count) else {
            return Err(self.error(format!("'{}' is no number of rows", show(count))));
        };
        let name = String::from_utf8_lossy(name).into_owned();
        self.elements.push(Element { name, count, properties: Vec::new() });
        Ok(())
    }

    fn add_property(&mut self, name: &[u8], kind: Kind) -> Result<(), ReadError> {
        let name = String::from_utf8_lossy(name).into_owned();
        match self.elements.last_mut() {
            Some(element) => element.properties.push(Property { name, kind }),
            None => return Err(self.error("a property stands before any element")),
        }
        Ok(())
    }
}

/// Lines ended by `\n`, `\r\n` or, in old files, `\r`.
struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&b| b == b'\n' || b == b'\r')?;
        let end = if rest[length..].starts_with(b"\r\n") { 2 } else { 1 };
        self.at += length + end;
        Some(&rest[..length])
    }
}
