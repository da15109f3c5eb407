//! Named attributes: what a wedge, a vertex or a triangle carries besides its position.

use std::borrow::Cow;

/// What an attribute means, by the vocabulary of glTF.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Semantic {
    /// Position deltas; only in [`MorphTarget`](super::MorphTarget).
    Position,
    /// Unit normal, 3 components.
    Normal,
    /// Unit tangent and the sign of the bitangent, 4 components (3 in a morph target).
    Tangent,
    /// Colour set n, 3 or 4 components of 0 to 1.
    Color(u32),
    /// Texture coordinates, set n, 2 components.
    TexCoord(u32),
    /// Joints that move the wedge, set n, 4 components, integers.
    Joints(u32),
    /// How much each joint of the same set counts, 4 components; all sets of a wedge sum to 1.
    Weights(u32),
    /// Anything else, by the name its file gives it.
    Custom(String),
}

impl Semantic {
    /// The name that it has in glTF: `POSITION`, `TEXCOORD_0`, ...; what is custom, the name of its file.
    pub fn gltf_name(&self) -> Cow<'_, str> {
        match self {
            Self::Position => "POSITION".into(),
            Self::Normal => "NORMAL".into(),
            Self::Tangent => "TANGENT".into(),
            Self::Color(n) => format!("COLOR_{n}").into(),
            Self::TexCoord(n) => format!("TEXCOORD_{n}").into(),
            Self::Joints(n) => format!("JOINTS_{n}").into(),
            Self::Weights(n) => format!("WEIGHTS_{n}").into(),
            Self::Custom(name) => name.into(),
        }
    }
}

impl std::fmt::Display for Semantic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Position => f.write_str("position"),
            Self::Normal => f.write_str("normal"),
            Self::Tangent => f.write_str("tangent"),
            Self::Color(n) => write!(f, "color {n}"),
            Self::TexCoord(n) => write!(f, "uv {n}"),
            Self::Joints(n) => write!(f, "joints {n}"),
            Self::Weights(n) => write!(f, "weights {n}"),
            Self::Custom(name) => f.write_str(name),
        }
    }
}

/// The values of an attribute, element after element.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Quantities that may be interpolated.
    F32(Vec<f32>),
    /// Labels and indices (joints): never interpolated.
    U32(Vec<u32>),
}

impl Values {
    /// Number of scalars.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::U32(values) => values.len(),
        }
    }

    /// Whether there are no scalars.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Type of a scalar in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the names say all")]
pub enum ComponentType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// How the file that an attribute came from stored it, so that it can be written back the same way.
///
/// Normalised integers are decoded to 0 to 1 (unsigned) or -1 to 1 (signed).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Storage {
    /// Type of each scalar.
    pub component: ComponentType,
    /// Whether integers stand for fractions of their range.
    pub normalized: bool,
    /// Whether the values are sRGB-encoded colours (as in PLY, OBJ and OFF) and not linear ones (as in glTF).
    pub srgb: bool,
}

impl Storage {
    /// 32-bit floats, linear.
    pub const F32: Self = Self { component: ComponentType::F32, normalized: false, srgb: false };
}

/// A named array of values, `components` scalars to each element.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribute {
    /// What the values mean.
    pub semantic: Semantic,
    /// Scalars per element, at least 1.
    pub components: usize,
    /// The scalars; the length is `components` times the number of elements.
    pub values: Values,
    /// How the file stored them.
    pub storage: Storage,
}

impl Attribute {
    /// A float attribute.
    pub fn new_f32(semantic: Semantic, components: usize, values: Vec<f32>) -> Self {
        Self { semantic, components, values: Values::F32(values), storage: Storage::F32 }
    }

    /// An integer attribute, kept as 32-bit unsigned in files that can.
    pub fn new_u32(semantic: Semantic, components: usize, values: Vec<u32>) -> Self {
        let storage = Storage { component: ComponentType::U32, normalized: false, srgb: false };
        Self { semantic, components, values: Values::U32(values), storage }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.values.len() / self.components
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The floats, `None` for integer attributes.
    pub fn as_f32(&self) -> Option<&[f32]> {
        match &self.values {
            Values::F32(values) => Some(values),
            Values::U32(_) => None,
        }
    }

    /// The floats for writing, `None` for integer attributes.
    pub fn as_f32_mut(&mut self) -> Option<&mut Vec<f32>> {
        match &mut self.values {
            Values::F32(values) => Some(values),
            Values::U32(_) => None,
        }
    }

    /// The integers, `None` for float attributes.
    pub fn as_u32(&self) -> Option<&[u32]> {
        match &self.values {
            Values::U32(values) => Some(values),
            Values::F32(_) => None,
        }
    }

    /// Keeps the elements named by `source`, in that order (elements may repeat or be left out).
    ///
    /// # Panics
    /// If an index is not smaller than [`len`](Self::len).
    pub fn gather(&mut self, source: &[u32]) {
        fn gathered<T: Copy>(values: &[T], components: usize, source: &[u32]) -> Vec<T> {
            let element = |&i: &u32| &values[i as usize * components..][..components];
            source.iter().flat_map(element).copied().collect()
        }
        match &mut self.values {
            Values::F32(values) => *values = gathered(values, self.components, source),
            Values::U32(values) => *values = gathered(values, self.components, source),
        }
    }
}
