//! One piece of an OBJ file, parsed without knowledge of what is before it.

use crate::settle::Rounding;
use crate::text::{parse_f32, parse_f64, parse_int, show};

/// No texture coordinate or normal at a corner.
pub(super) const NONE: i64 = i64::MIN;

/// What a piece of the file holds.
#[derive(Default)]
pub(super) struct Piece {
    pub(super) positions: Vec<[f32; 3]>,
    /// As long as `positions`, or empty where no vertex has a colour.
    pub(super) colors: Vec<[f32; 3]>,
    pub(super) uvs: Vec<[f32; 2]>,
    pub(super) normals: Vec<[f32; 3]>,
    /// Position, texture coordinate and normal of each corner, from 0.
    pub(super) corners: Vec<Corner>,
    /// Where each face ends in `corners`.
    pub(super) face_ends: Vec<usize>,
    /// Changes of state, with the number of faces before.
    pub(super) events: Vec<(usize, Event)>,
    pub(super) rounding: Rounding,
    /// Lines and points.
    pub(super) left_out: usize,
    /// Statements of free-form surfaces.
    pub(super) free_form: usize,
}

/// A corner of a face. Indices that the file counts backwards are relative to the start of the piece and may be
/// negative.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    indices: [i32; 3],
    relative: [bool; 3],
}

/// Index that stands for none.
const ABSENT: i32 = i32::MIN;

impl Corner {
    /// The index into all positions (`kind` 0), texture coordinates (1) or normals (2) of the file, given how many
    /// there are before the piece; may be out of range; [`NONE`] where there is none.
    pub(super) fn index(&self, kind: usize, before: usize) -> i64 {
        match (self.indices[kind], self.relative[kind]) {
            (ABSENT, _) => NONE,
            (index, true) => i64::from(index) + before as i64,
            (index, false) => i64::from(index),
        }
    }
}

/// A change of state.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Event {
    Object(String),
    Group(String),
    Material(String),
    Smoothing(u32),
    Library(String),
}

/// What is wrong, and where (bytes from the start of the piece).
pub(super) struct Fault {
    pub(super) at: usize,
    pub(super) message: String,
}

/// Parses whole lines.
pub(super) fn parse(text: &[u8]) -> Result<Piece, Fault> {
    let mut piece = Piece::default();
    let mut joined = Vec::new();
    let mut at = 0;
    while at < text.len() {
        let start = at;
        let line = next_line(text, &mut at, &mut joined);
        piece.statement(line).map_err(|message| Fault { at: start, message })?;
    }
    Ok(piece)
}

/// The next line; lines that end with a backslash are joined with those that follow.
fn next_line<'t>(text: &'t [u8], at: &mut usize, joined: &'t mut Vec<u8>) -> &'t [u8] {
    let mut cut = || {
        let rest = &text[*at..];
        let length = rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
        *at += length + if rest[length..].starts_with(b"\r\n") { 2 } else { 1 };
        *at = (*at).min(text.len());
        &rest[..length]
    };
    let first = cut();
    if !first.ends_with(b"\\") {
        return first;
    }
    joined.clear();
    let mut line = first;
    while let Some(part) = line.strip_suffix(b"\\") {
        joined.extend_from_slice(part);
        joined.push(b' ');
        line = cut();
    }
    joined.extend_from_slice(line);
    joined
}

/// The words of a line, without a comment.
struct Words<'a>(&'a [u8]);

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.0.iter().position(|b| !b.is_ascii_whitespace())?;
        let rest = &self.0[start..];
        if rest[0] == b'#' {
            self.0 = &[];
            return None;
        }
        let length = rest.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(rest.len());
        self.0 = &rest[length..];
        Some(&rest[..length])
    }

    fn rest(&self) -> String {
        String::from_utf8_lossy(self.0.trim_ascii()).into_owned()
    }

    fn f32(&mut self) -> Result<Option<f32>, String> {
        let Some(word) = self.next() else { return Ok(None) };
        parse_f32(word).map(Some).ok_or_else(|| format!("expected a number, found '{}'", show(word)))
    }
}

impl Piece {
    fn statement(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = Words(line);
        let event = match words.next() {
            None => return Ok(()),
            Some(b"v") => return self.vertex(words),
            Some(b"f" | b"fo") => return self.face(words),
            Some(b"vn") => {
                self.normals.push(numbers(&mut words, 3)?);
                return Ok(());
            }
            Some(b"vt") => {
                let [u, v, _] = numbers(&mut words, 1)?;
                self.uvs.push([u, v]);
                return Ok(());
            }
            Some(b"o") => Event::Object(words.rest()),
            Some(b"g") => Event::Group(words.rest()),
            Some(b"usemtl") => Event::Material(words.rest()),
            Some(b"mtllib") => Event::Library(words.rest()),
            Some(b"s") => Event::Smoothing(words.next().and_then(parse_int).unwrap_or(0)),
            Some(b"l" | b"p") => {
                self.left_out += 1;
                return Ok(());
            }
            Some(b"curv" | b"surf") => {
                self.free_form += 1;
                return Ok(());
            }
            // the format is older than any list of its statements: what is unknown is skipped
            Some(_) => return Ok(()),
        };
        self.events.push((self.face_ends.len(), event));
        Ok(())
    }

    /// `v x y z`, `v x y z w`, `v x y z r g b` or `v x y z r g b a`.
    fn vertex(&mut self, mut words: Words<'_>) -> Result<(), String> {
        let mut position = [0.0; 3];
        for value in &mut position {
            let word = words.next().ok_or("a vertex needs three coordinates")?;
            let exact = parse_f64(word).ok_or_else(|| format!("expected a coordinate, found '{}'", show(word)))?;
            *value = self.rounding.round(exact);
        }
        let mut more = [0.0; 3];
        let mut count = 0;
        while count < 3 {
            let Some(value) = words.f32()? else { break };
            more[count] = value;
            count += 1;
        }
        if count == 3 {
            self.colors.resize(self.positions.len(), [1.0; 3]);
            self.colors.push(more);
        } else if !self.colors.is_empty() {
            self.colors.push([1.0; 3]);
        }
        self.positions.push(position);
        Ok(())
    }

    fn face(&mut self, mut words: Words<'_>) -> Result<(), String> {
        while let Some(word) = words.next() {
            let corner = self.corner(word)?;
            self.corners.push(corner);
        }
        self.face_ends.push(self.corners.len());
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&self, word: &[u8]) -> Result<Corner, String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corner = Corner { indices: [ABSENT; 3], relative: [false; 3] };
        for (kind, part) in word.split(|&b| b == b'/').enumerate() {
            if kind > 2 {
                return Err(format!("'{}' has more than three indices", show(word)));
            }
            if part.is_empty() && kind > 0 {
                continue;
            }
            let bad = || format!("expected an index, found '{}'", show(part));
            let index: i32 = parse_index(part).ok_or_else(bad)?;
            corner.relative[kind] = index < 0;
            corner.indices[kind] = match index {
                0 => return Err("an index is 0, but they count from 1".into()),
                1.. => index - 1,
                _ => (counts[kind] as i64 + i64::from(index)).try_into().map_err(|_| bad())?,
            };
        }
        Ok(corner)
    }
}

/// Whole numbers are most of an OBJ file: this is several times as fast as going through UTF-8.
fn parse_index(digits: &[u8]) -> Option<i32> {
    let (negative, digits) = match digits.strip_prefix(b"-") {
        Some(rest) => (true, rest),
        None => (false, digits),
    };
    if digits.is_empty() || digits.len() > 10 {
        return None;
    }
    let mut value = 0_i64;
    for &digit in digits {
        value = value * 10 + i64::from(digit.is_ascii_digit().then(|| digit - b'0')?);
    }
    (value < i64::from(i32::MAX)).then_some(if negative { -value } else { value } as i32)
}

/// Up to three numbers, the first `needed` of which must be there.
fn numbers(words: &mut Words<'_>, needed: usize) -> Result<[f32; 3], String> {
    let mut values = [0.0; 3];
    for (i, value) in values.iter_mut().enumerate() {
        match words.f32()? {
            Some(number) => *value = number,
            None if i < needed => return Err(format!("{needed} numbers are expected, found {i}")),
            None => break,
        }
    }
    Ok(values)
}
