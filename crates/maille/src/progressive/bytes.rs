//! Progressive meshes as bytes: flat arrays of 4-byte words, little-endian, each coarse before fine.
//!
//! `docs/src/formats.md` tells the layout. What is read may come from anywhere: [`Words`] takes no more than there is, and
//! [`check`](super::check) looks at everything that moving between levels relies on.

use super::attributes::{Attributes, Table};
use super::{CollapseLog, ProgressiveMesh};
use crate::mesh::{Attribute, ComponentType, Mesh, MeshError, MorphTarget, Semantic, Storage, Values};
use crate::simplify::Lifted;

/// Flag: there are counts of vertices beside those of wedges.
const COUNTS_VERTICES: u32 = 1;
/// Flag: triangles have materials.
const HAS_MATERIALS: u32 = 2;
/// More scalars to an element than any format has; keeps work on a single element small.
const MOST_COMPONENTS: u32 = u16::MAX as u32;

const COMPONENT_TYPES: [ComponentType; 8] = [
    ComponentType::I8,
    ComponentType::U8,
    ComponentType::I16,
    ComponentType::U16,
    ComponentType::I32,
    ComponentType::U32,
    ComponentType::F32,
    ComponentType::F64,
];

/// Bytes that are no progressive mesh.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The bytes end too early or too late, or a word means nothing.
    #[error("byte {at}: {what}")]
    Bytes {
        /// Offset of what is wrong.
        at: usize,
        /// What was found, and what was expected.
        what: String,
    },
    /// A collapse refers to what is not there at its time.
    #[error("collapse {collapse}: {what}")]
    Collapse {
        /// Which one, the first being the one that leaves the finest level.
        collapse: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Something that is not of one collapse.
    #[error("{0}")]
    Log(&'static str),
    /// The mesh is broken.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

impl ProgressiveMesh {
    /// The mesh with all its levels as bytes, the same for the same mesh on every machine, whatever level it is at, but for
    /// the word that tells that level. [`from_bytes`](Self::from_bytes) gives an equal mesh back.
    ///
    /// Linear time. Unless the mesh is at its base, a copy of it goes there first.
    pub fn to_bytes(&self) -> Vec<u8> {
        if self.at == self.collapse_count() {
            return encoded(self, self.at);
        }
        let mut base = self.clone();
        base.seek(usize::MAX);
        encoded(&base, self.at)
    }

    /// Reads what [`to_bytes`](Self::to_bytes) has written, from whatever source: no count is believed before it is compared
    /// with the bytes that are there, and whatever a level refers to is looked at, so that nothing that is done with the result
    /// can fail.
    ///
    /// Close to linear time; memory of the result, and half as much again while it is checked.
    ///
    /// # Errors
    /// [`DecodeError`] with the first fault found.
    ///
    /// # Examples
    /// ```
    /// use maille::progressive::ProgressiveMesh;
    /// let sphere = maille::mesh::shapes::sphere(3);
    /// let (mut progressive, _) = ProgressiveMesh::new(sphere, &Default::default(), Default::default())?;
    /// progressive.seek_triangles(100);
    /// let bytes = progressive.to_bytes();
    /// assert_eq!(ProgressiveMesh::from_bytes(&bytes)?, progressive);
    /// assert!(ProgressiveMesh::from_bytes(&bytes[..bytes.len() / 2]).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut words = Words { bytes, at: 0 };
        let (mut mesh, position) = decoded(&mut words)?;
        if words.left() > 0 {
            return Err(words.fault(format!("{} bytes after the end", words.left())));
        }
        mesh.check()?;
        mesh.seek(position);
        Ok(mesh)
    }
}

/// A mesh that is at its base.
fn encoded(progressive: &ProgressiveMesh, position: usize) -> Vec<u8> {
    let ProgressiveMesh { mesh, attributes, lifted, log, .. } = progressive;
    let mut out = Writer(Vec::new());
    let flag = |is_set: bool, flag: u32| if is_set { flag } else { 0 };
    let flags =
        flag(!log.vertices.is_empty(), COUNTS_VERTICES) | flag(!mesh.triangle_materials.is_empty(), HAS_MATERIALS);
    out.words(&[log.errors.len() as u32, position as u32, flags]);
    [&log.triangles, &log.wedges, &log.vertices].into_iter().for_each(|counts| out.words(counts));
    [&log.errors, &log.costs].into_iter().for_each(|values| out.floats(values));
    out.list(&log.followers);
    out.floats(log.positions.as_flattened());
    for words in [&log.vertex_parents, &log.wedge_parents, &log.corner_ends, &log.corners] {
        out.words(words);
    }
    out.floats(mesh.positions.as_flattened());
    out.words(&mesh.wedge_vertices);
    out.words(mesh.triangles.as_flattened());
    out.words(&mesh.triangle_materials);
    out.word(mesh.material_names.len() as u32);
    mesh.material_names.iter().for_each(|name| out.text(name));
    out.attributes(&mesh.triangle_attributes);
    mesh.triangle_attributes.iter().for_each(|attribute| out.values(&attribute.values));
    out.attributes(&attributes.wedges);
    out.word(attributes.morph_targets.len() as u32);
    for target in &attributes.morph_targets {
        out.text(&target.name);
        out.attributes(&target.attributes);
    }
    out.attributes(&attributes.vertices);
    out.list(&lifted.0.iter().map(|&place| place as u32).collect::<Vec<u32>>());
    for words in [&attributes.wedge_values.words, &attributes.vertex_values.words] {
        out.words(words);
    }
    for words in [&log.changed_ends, &log.changed, &log.rows.words, &log.vertex_rows.words] {
        out.words(words);
    }
    out.0
}

/// A mesh that is at its base, with lengths that agree and nothing else looked at; and the position to go to.
fn decoded(words: &mut Words<'_>) -> Result<(ProgressiveMesh, usize), DecodeError> {
    let [collapses, position, flags] = [words.size()?, words.size()?, words.size()?];
    if position > collapses {
        return Err(words.fault(format!("position {position} of {collapses} collapses")));
    }
    if flags as u32 & !(COUNTS_VERTICES | HAS_MATERIALS) != 0 {
        return Err(words.fault(format!("unknown flags {flags:#x}")));
    }
    let has = |flag: u32| flags as u32 & flag != 0;
    let levels = collapses.saturating_add(1);
    let triangle_counts = words.many(levels)?;
    let wedge_counts = words.many(levels)?;
    let vertex_counts = if has(COUNTS_VERTICES) { words.many(levels)? } else { Vec::new() };
    let [triangles, wedges] = [triangle_counts[0] as usize, wedge_counts[0] as usize];
    let vertices = vertex_counts.first().map_or(wedges, |&count| count as usize);
    let mut log = CollapseLog {
        triangles: triangle_counts,
        wedges: wedge_counts,
        vertices: vertex_counts,
        errors: words.floats(collapses)?,
        costs: words.floats(collapses)?,
        followers: words.list()?,
        positions: words.points(collapses)?,
        vertex_parents: words.many(vertices)?,
        wedge_parents: words.many(wedges)?,
        corner_ends: words.many(wedges)?,
        ..CollapseLog::default()
    };
    log.corners = words.many(last(&log.corner_ends))?;
    let mut mesh = Mesh {
        positions: words.points(vertices)?,
        wedge_vertices: words.many(wedges)?,
        triangles: words.triangles(triangles)?,
        triangle_materials: if has(HAS_MATERIALS) { words.many(triangles)? } else { Vec::new() },
        ..Mesh::default()
    };
    for _ in 0..words.size()? {
        mesh.material_names.push(words.text()?);
    }
    mesh.triangle_attributes = words.attributes(false)?;
    for attribute in &mut mesh.triangle_attributes {
        attribute.values = words.values(&attribute.values, triangles.saturating_mul(attribute.components))?;
    }
    let mut attributes = Attributes { wedges: words.attributes(false)?, ..Attributes::default() };
    for _ in 0..words.size()? {
        attributes.morph_targets.push(MorphTarget { name: words.text()?, attributes: words.attributes(true)? });
    }
    attributes.vertices = words.attributes(false)?;
    let lifted = Lifted(words.list()?.into_iter().map(|place| place as usize).collect());
    let of_targets = attributes.morph_targets.iter().flat_map(|target| &target.attributes);
    let width = width_of(attributes.wedges.iter().chain(of_targets));
    let vertex_width = width_of(attributes.vertices.iter());
    attributes.wedge_values = words.table(width, wedges)?;
    attributes.vertex_values = words.table(vertex_width, vertices)?;
    if width > 0 {
        log.changed_ends = words.many(collapses)?;
        log.changed = words.many(last(&log.changed_ends))?;
    }
    log.rows = words.table(width, log.changed.len())?;
    log.vertex_rows = words.table(vertex_width, collapses)?;
    Ok((ProgressiveMesh { mesh, attributes, lifted, log, at: collapses }, position))
}

/// Words to an element of some attributes.
fn width_of<'a>(attributes: impl Iterator<Item = &'a Attribute>) -> usize {
    attributes.map(|attribute| attribute.components).sum()
}

/// How many elements there are, if the last end is that of them all.
fn last(ends: &[u32]) -> usize {
    ends.last().map_or(0, |&end| end as usize)
}

/// A meaning as two words; the text of one of its own comes apart.
fn code_of(semantic: &Semantic) -> [u32; 2] {
    match *semantic {
        Semantic::Position => [0, 0],
        Semantic::Normal => [1, 0],
        Semantic::Tangent => [2, 0],
        Semantic::Color(set) => [3, set],
        Semantic::TexCoord(set) => [4, set],
        Semantic::Joints(set) => [5, set],
        Semantic::Weights(set) => [6, set],
        Semantic::Custom(_) => [7, 0],
    }
}

/// Whether an attribute of this meaning may have so many components, and whether of integers.
fn is_shaped(semantic: &Semantic, components: u32, is_integer: bool, is_delta: bool) -> bool {
    let fits: &[u32] = match semantic {
        Semantic::Position if is_delta => &[3],
        Semantic::Position => &[],
        Semantic::Normal => &[3],
        Semantic::Tangent if is_delta => &[3],
        Semantic::Tangent | Semantic::Joints(_) | Semantic::Weights(_) => &[4],
        Semantic::Color(_) => &[3, 4],
        Semantic::TexCoord(_) => &[2],
        Semantic::Custom(_) => return (1..=MOST_COMPONENTS).contains(&components),
    };
    fits.contains(&components) && is_integer == matches!(semantic, Semantic::Joints(_))
}

struct Writer(Vec<u8>);

impl Writer {
    fn word(&mut self, word: u32) {
        self.0.extend_from_slice(&word.to_le_bytes());
    }

    /// Not by an iterator of bytes, which is many times as slow.
    fn array<T: Copy>(&mut self, values: &[T], bytes: impl Fn(T) -> [u8; 4]) {
        let start = self.0.len();
        self.0.resize(start + 4 * values.len(), 0);
        let (places, _) = self.0[start..].as_chunks_mut::<4>();
        places.iter_mut().zip(values).for_each(|(place, &value)| *place = bytes(value));
    }

    fn words(&mut self, words: &[u32]) {
        self.array(words, u32::to_le_bytes);
    }

    fn floats(&mut self, values: &[f32]) {
        self.array(values, f32::to_le_bytes);
    }

    fn list(&mut self, words: &[u32]) {
        self.word(words.len() as u32);
        self.words(words);
    }

    fn values(&mut self, values: &Values) {
        match values {
            Values::F32(values) => self.floats(values),
            Values::U32(values) => self.words(values),
        }
    }

    fn text(&mut self, text: &str) {
        self.word(text.len() as u32);
        self.0.extend_from_slice(text.as_bytes());
        self.0.resize(self.0.len().next_multiple_of(4), 0);
    }

    /// All of some attributes but their values.
    fn attributes(&mut self, attributes: &[Attribute]) {
        self.word(attributes.len() as u32);
        for Attribute { semantic, components, values, storage } in attributes {
            let component = COMPONENT_TYPES.iter().position(|&known| known == storage.component).unwrap_or(0) as u32;
            let storage = component | u32::from(storage.normalized) << 8 | u32::from(storage.srgb) << 9;
            let [meaning, set] = code_of(semantic);
            let is_integer = matches!(values, Values::U32(_));
            self.words(&[meaning, set, *components as u32, u32::from(is_integer), storage]);
            if let Semantic::Custom(name) = semantic {
                self.text(name);
            }
        }
    }
}

/// Reads word by word, and array by array; never further than there are bytes.
struct Words<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Words<'a> {
    fn fault(&self, what: impl Into<String>) -> DecodeError {
        DecodeError::Bytes { at: self.at, what: what.into() }
    }

    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn take(&mut self, bytes: usize) -> Result<&'a [u8], DecodeError> {
        if bytes > self.left() {
            return Err(self.fault(format!("{bytes} bytes are announced, but there are only {}", self.left())));
        }
        let taken = &self.bytes[self.at..][..bytes];
        self.at += bytes;
        Ok(taken)
    }

    /// An array of so many words.
    fn array<T>(&mut self, count: usize, word: impl Fn([u8; 4]) -> T) -> Result<Vec<T>, DecodeError> {
        let bytes = self.take(count.saturating_mul(4))?;
        Ok(bytes.as_chunks::<4>().0.iter().map(|&bytes| word(bytes)).collect())
    }

    fn many(&mut self, count: usize) -> Result<Vec<u32>, DecodeError> {
        self.array(count, u32::from_le_bytes)
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f32>, DecodeError> {
        self.array(count, f32::from_le_bytes)
    }

    /// Threes of words.
    fn threes<T: Copy>(&mut self, count: usize, word: impl Fn([u8; 4]) -> T) -> Result<Vec<[T; 3]>, DecodeError> {
        let bytes = self.take(count.saturating_mul(12))?;
        let (words, _) = bytes.as_chunks::<4>();
        Ok(words.as_chunks::<3>().0.iter().map(|three| three.map(&word)).collect())
    }

    fn points(&mut self, count: usize) -> Result<Vec<[f32; 3]>, DecodeError> {
        self.threes(count, f32::from_le_bytes)
    }

    fn triangles(&mut self, count: usize) -> Result<Vec<[u32; 3]>, DecodeError> {
        self.threes(count, u32::from_le_bytes)
    }

    fn size(&mut self) -> Result<usize, DecodeError> {
        Ok(self.many(1)?[0] as usize)
    }

    fn list(&mut self) -> Result<Vec<u32>, DecodeError> {
        let count = self.size()?;
        self.many(count)
    }

    /// Values of the same type as others.
    fn values(&mut self, others: &Values, count: usize) -> Result<Values, DecodeError> {
        Ok(match others {
            Values::F32(_) => Values::F32(self.floats(count)?),
            Values::U32(_) => Values::U32(self.many(count)?),
        })
    }

    fn table(&mut self, width: usize, elements: usize) -> Result<Table, DecodeError> {
        Ok(Table { width, words: self.many(elements.saturating_mul(width))? })
    }

    fn text(&mut self) -> Result<String, DecodeError> {
        let length = self.size()?;
        let bytes = self.take(length)?;
        let text = std::str::from_utf8(bytes).map_err(|_| self.fault("a name is not UTF-8"))?.to_owned();
        let filling = length.next_multiple_of(4) - length;
        match self.take(filling)?.iter().all(|&byte| byte == 0) {
            true => Ok(text),
            false => Err(self.fault("a name is filled up with other than zeros")),
        }
    }

    fn attributes(&mut self, are_deltas: bool) -> Result<Vec<Attribute>, DecodeError> {
        let mut attributes = Vec::new();
        for _ in 0..self.size()? {
            attributes.push(self.attribute(are_deltas)?);
        }
        Ok(attributes)
    }

    /// An attribute without values.
    fn attribute(&mut self, is_delta: bool) -> Result<Attribute, DecodeError> {
        let start = self.at;
        let fault = |what: &str| DecodeError::Bytes { at: start, what: what.to_owned() };
        let words = self.many(5)?;
        let [meaning, set, components, kind, storage] = words[..] else { unreachable!("five were asked for") };
        let semantic = match meaning {
            0 => Semantic::Position,
            1 => Semantic::Normal,
            2 => Semantic::Tangent,
            3 => Semantic::Color(set),
            4 => Semantic::TexCoord(set),
            5 => Semantic::Joints(set),
            6 => Semantic::Weights(set),
            7 => Semantic::Custom(self.text()?),
            _ => return Err(fault("an attribute of unknown meaning")),
        };
        if code_of(&semantic) != [meaning, set] || kind > 1 || storage >> 10 != 0 {
            return Err(fault("an attribute of unknown kind"));
        }
        if !is_shaped(&semantic, components, kind == 1, is_delta) {
            return Err(fault("an attribute that cannot have so many components, or not of that type"));
        }
        let component = *COMPONENT_TYPES.get(storage as usize & 0xff).ok_or_else(|| fault("unknown storage"))?;
        let storage = Storage { component, normalized: storage >> 8 & 1 == 1, srgb: storage >> 9 & 1 == 1 };
        let values = if kind == 1 { Values::U32(Vec::new()) } else { Values::F32(Vec::new()) };
        Ok(Attribute { semantic, components: components as usize, values, storage })
    }
}
