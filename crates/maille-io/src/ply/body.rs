//! Rows of a PLY body: text into binary, binary into columns.

use maille::mesh::ComponentType;
use rayon::prelude::*;

use super::header::{Element, Kind, size_of};
use crate::text::{Words, parse_f32, parse_f64, parse_int, show};
use crate::{Place, ReadError};

/// Rows decoded by one task.
const ROWS: usize = 1 << 12;

/// Binary rows of one element and what follows them in the file.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) big_endian: bool,
    /// Where they stand in the file; `None` if they were text.
    pub(super) offset: Option<usize>,
}

impl<'a> Rows<'a> {
    /// An error about a row.
    pub(super) fn error(&self, element: &Element, row: usize, message: impl Into<String>) -> ReadError {
        ReadError::new(message).at(Place::Part(format!("element {}, row {}", element.name, row + 1)))
    }

    /// A walker over scalars and lists, from the first row.
    pub(super) fn cursor(self, element: &'a Element) -> Cursor<'a> {
        Cursor { rows: self, element, at: 0, row: 0 }
    }

    /// Checks that as many rows as the header claims can be there at all.
    pub(super) fn check_count(&self, element: &Element) -> Result<usize, ReadError> {
        let stride = element.least_stride();
        if element.count.saturating_mul(stride as u64) <= self.bytes.len() as u64 && element.count < u64::from(u32::MAX)
        {
            return Ok(element.count as usize);
        }
        Err(too_few(element, self.bytes.len()).at(Place::Byte(self.offset.unwrap_or(0) as u64)))
    }
}

fn too_few(element: &Element, bytes: usize) -> ReadError {
    let Element { name, count, .. } = element;
    let error = ReadError::new(format!("the header claims {count} rows of '{name}', but only {bytes} bytes follow"));
    error.with_remedy("the file has been cut short: fetch it again")
}

/// Goes through rows value by value.
pub(super) struct Cursor<'a> {
    rows: Rows<'a>,
    element: &'a Element,
    at: usize,
    row: usize,
}

impl<'a> Cursor<'a> {
    /// Number of bytes gone through.
    pub(super) fn position(&self) -> usize {
        self.at
    }

    /// Tells that a row ends here, for error messages.
    pub(super) fn end_row(&mut self) {
        self.row += 1;
    }

    /// An error about the current row.
    pub(super) fn error(&self, message: impl Into<String>) -> ReadError {
        self.rows.error(self.element, self.row, message)
    }

    /// The bytes of a scalar.
    pub(super) fn scalar(&mut self, ty: ComponentType) -> Result<&'a [u8], ReadError> {
        self.take(size_of(ty))
    }

    /// The bytes of a list and its length.
    pub(super) fn list(&mut self, count: ComponentType, item: ComponentType) -> Result<(&'a [u8], usize), ReadError> {
        let bytes = self.scalar(count)?;
        let length = integer(bytes, count, self.rows.big_endian);
        let Ok(length) = usize::try_from(length) else {
            return Err(self.error(format!("a list claims {length} items")));
        };
        Ok((self.take(length.saturating_mul(size_of(item)))?, length))
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], ReadError> {
        let rest = &self.rows.bytes[self.at..];
        let Some(bytes) = rest.get(..length) else {
            let message = format!("{length} bytes are expected here, but the file ends after {}", rest.len());
            return Err(self.error(message).with_remedy("the file has been cut short: fetch it again"));
        };
        self.at += length;
        Ok(bytes)
    }
}

/// An integer scalar; fractions are cut.
pub(super) fn integer(bytes: &[u8], ty: ComponentType, big_endian: bool) -> i64 {
    match ty {
        ComponentType::I8 => i64::from(i8::load(bytes, big_endian)),
        ComponentType::U8 => i64::from(bytes[0]),
        ComponentType::I16 => i64::from(i16::load(bytes, big_endian)),
        ComponentType::U16 => i64::from(u16::load(bytes, big_endian)),
        ComponentType::I32 => i64::from(i32::load(bytes, big_endian)),
        ComponentType::U32 => i64::from(u32::load(bytes, big_endian)),
        ComponentType::F32 => f32::load(bytes, big_endian) as i64,
        ComponentType::F64 => f64::load(bytes, big_endian) as i64,
    }
}

/// A scalar in double precision.
pub(super) fn real(bytes: &[u8], ty: ComponentType, big_endian: bool) -> f64 {
    match ty {
        ComponentType::F32 => f64::from(f32::load(bytes, big_endian)),
        ComponentType::F64 => f64::load(bytes, big_endian),
        _ => integer(bytes, ty, big_endian) as f64,
    }
}

/// A scalar type of the file.
pub(super) trait Scalar: Copy + Send + Sync {
    /// The value at the start of `bytes`.
    fn load(bytes: &[u8], big_endian: bool) -> Self;
    /// In single precision.
    fn to_f32(self) -> f32;
    /// As a label: the bits of 32-bit integers, else the whole part.
    fn to_label(self) -> u32;
}

macro_rules! scalars {
    ($($ty:ty, $label:expr);*) => {$(
        impl Scalar for $ty {
            fn load(bytes: &[u8], big_endian: bool) -> Self {
                let bytes = bytes.first_chunk().expect("rows are cut to the sizes of their scalars");
                if big_endian { Self::from_be_bytes(*bytes) } else { Self::from_le_bytes(*bytes) }
            }
            fn to_f32(self) -> f32 {
                self as f32
            }
            fn to_label(self) -> u32 {
                $label(self)
            }
        }
    )*};
}
scalars!(
    i8, |v| v as u32; u8, u32::from; i16, |v| v as u32; u16, u32::from; i32, |v| v as u32; u32, |v| v; f32, |v| v as u32;
    f64, |v| v as u32
);

/// A column of rows that are all equally long.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) offset: usize,
    pub(super) ty: ComponentType,
    /// The number that stands for 1.
    pub(super) unit: f32,
    /// Which component of each output element it fills.
    pub(super) slot: usize,
}

macro_rules! by_type {
    ($ty:expr, $T:ident => $body:expr) => {
        match $ty {
            ComponentType::I8 => by_type!(@ $T, i8, $body),
            ComponentType::U8 => by_type!(@ $T, u8, $body),
            ComponentType::I16 => by_type!(@ $T, i16, $body),
            ComponentType::U16 => by_type!(@ $T, u16, $body),
            ComponentType::I32 => by_type!(@ $T, i32, $body),
            ComponentType::U32 => by_type!(@ $T, u32, $body),
            ComponentType::F32 => by_type!(@ $T, f32, $body),
            ComponentType::F64 => by_type!(@ $T, f64, $body),
        }
    };
    (@ $T:ident, $ty:ty, $body:expr) => {{
        type $T = $ty;
        $body
    }};
}

/// Fills one component of floats with a column, on all threads.
pub(super) fn fill_f32(out: &mut [f32], components: usize, rows: &[u8], stride: usize, column: Column, big: bool) {
    let unit = column.unit;
    // char colours hold bytes
    let ty = if unit == 255.0 && column.ty == ComponentType::I8 { ComponentType::U8 } else { column.ty };
    by_type!(ty, T => fill(out, components, rows, stride, column, big, |v: T| v.to_f32() / unit));
}

/// Fills one component of labels with a column, on all threads.
pub(super) fn fill_u32(out: &mut [u32], components: usize, rows: &[u8], stride: usize, column: Column, big: bool) {
    by_type!(column.ty, T => fill(out, components, rows, stride, column, big, T::to_label));
}

fn fill<T: Scalar, O: Send>(
    out: &mut [O],
    components: usize,
    rows: &[u8],
    stride: usize,
    column: Column,
    big: bool,
    convert: impl Fn(T) -> O + Sync,
) {
    out.par_chunks_mut(ROWS * components).zip(rows.par_chunks(ROWS * stride)).for_each(|(out, rows)| {
        for (out, row) in out.chunks_exact_mut(components).zip(rows.chunks_exact(stride)) {
            out[column.slot] = convert(T::load(&row[column.offset..], big));
        }
    });
}

/// Turns the text of one element into binary little-endian rows.
pub(super) fn to_binary(words: &mut Words<'_>, element: &Element) -> Result<Vec<u8>, ReadError> {
    let mut out = Vec::new();
    if element.properties.is_empty() {
        return Ok(out);
    }
    // every value takes a digit and what separates it from the next
    let least = element.count.saturating_mul(2 * element.properties.len() as u64).saturating_sub(1);
    if least > words.remaining() as u64 {
        return Err(too_few(element, words.remaining()).at(words.place()));
    }
    for _ in 0..element.count {
        for property in &element.properties {
            match property.kind {
                Kind::Scalar(ty) => push_word(&mut out, words, ty, &property.name)?,
                Kind::List { count, item } => {
                    let length: u32 = words
                        .count(&format!("the length of '{}'", property.name))?
                        .try_into()
                        .map_err(|_| words.error("a list is too long"))?;
                    if !fits(length, count) {
                        return Err(words.error(format!("a list of {length} items is too long for its type")));
                    }
                    out.extend_from_slice(&length.to_le_bytes()[..size_of(count)]);
                    for _ in 0..length {
                        push_word(&mut out, words, item, &property.name)?;
                    }
                }
            }
        }
    }
    Ok(out)
}

fn fits(length: u32, ty: ComponentType) -> bool {
    length
        <= match ty {
            ComponentType::I8 => i8::MAX as u32,
            ComponentType::U8 => u8::MAX.into(),
            ComponentType::I16 => i16::MAX as u32,
            ComponentType::U16 => u16::MAX.into(),
            ComponentType::I32 => i32::MAX as u32,
            _ => u32::MAX,
        }
}

fn push_word(out: &mut Vec<u8>, words: &mut Words<'_>, ty: ComponentType, name: &str) -> Result<(), ReadError> {
    let Some(word) = words.next() else {
        let error = words.error(format!("the file ends where a value of '{name}' is expected"));
        return Err(error.with_remedy("the file has been cut short: fetch it again"));
    };
    let bad = |words: &Words<'_>| words.error(format!("expected a number for '{name}', found '{}'", show(word)));
    match ty {
        ComponentType::F32 => out.extend_from_slice(&parse_f32(word).ok_or_else(|| bad(words))?.to_le_bytes()),
        ComponentType::F64 => out.extend_from_slice(&parse_f64(word).ok_or_else(|| bad(words))?.to_le_bytes()),
        _ => {
            // some writers give integers a decimal point
            let value = parse_int(word).or_else(|| parse_f64(word).map(|v| v as i64)).ok_or_else(|| bad(words))?;
            out.extend_from_slice(&value.to_le_bytes()[..size_of(ty)]);
        }
    }
    Ok(())
}

/// Rows with their scalars turned into little endian.
pub(super) fn to_little_endian(bytes: &[u8], element: &Element) -> Result<Vec<u8>, ReadError> {
    let rows = Rows { bytes, big_endian: true, offset: None };
    let (mut cursor, mut out) = (rows.cursor(element), Vec::with_capacity(bytes.len()));
    let mut push = |bytes: &[u8], ty| {
        bytes.chunks_exact(size_of(ty)).for_each(|value| out.extend(value.iter().rev()));
    };
    while cursor.position() < bytes.len() {
        for property in &element.properties {
            match property.kind {
                Kind::Scalar(ty) => push(cursor.scalar(ty)?, ty),
                Kind::List { count, item } => {
                    let start = cursor.position();
                    let (items, _) = cursor.list(count, item)?;
                    push(&bytes[start..start + size_of(count)], count);
                    push(items, item);
                }
            }
        }
    }
    Ok(out)
}
