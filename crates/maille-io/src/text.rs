//! Words and numbers of text files, with the line they stand in.

use crate::{Place, ReadError};

/// Goes through a text word by word. Words are separated by white space; `#` begins a comment where the format has
/// such comments.
#[derive(Clone)]
pub(crate) struct Words<'a> {
    text: &'a [u8],
    at: usize,
    line: u64,
    comments: bool,
}

impl<'a> Words<'a> {
    /// The words of `text`, whose first line is number `line`.
    pub(crate) fn new(text: &'a [u8], line: u64, comments: bool) -> Self {
        Self { text, at: 0, line, comments }
    }

    /// Where the last word was.
    pub(crate) fn place(&self) -> Place {
        Place::Line(self.line)
    }

    /// Number of bytes gone through.
    pub(crate) fn position(&self) -> usize {
        self.at
    }

    /// Number of bytes left.
    pub(crate) fn remaining(&self) -> usize {
        self.text.len() - self.at
    }

    /// The next word, `None` at the end.
    pub(crate) fn next(&mut self) -> Option<&'a [u8]> {
        self.skip(false);
        self.word()
    }

    /// The next word of this line, `None` at the end of the line.
    pub(crate) fn next_in_line(&mut self) -> Option<&'a [u8]> {
        self.skip(true);
        self.word()
    }

    /// Ends the line: the next word is on a later one.
    pub(crate) fn skip_line(&mut self) {
        while self.text.get(self.at).is_some_and(|&b| b != b'\n' && b != b'\r') {
            self.at += 1;
        }
    }

    /// The rest of this line.
    pub(crate) fn rest_of_line(&mut self) -> &'a [u8] {
        let start = self.at;
        self.skip_line();
        self.text[start..self.at].trim_ascii()
    }

    fn skip(&mut self, within_line: bool) {
        while let Some(&byte) = self.text.get(self.at) {
            match byte {
                b'\n' | b'\r' if within_line => return,
                b'\n' => self.line += 1,
                // a line may end with \r\n or, in old files, with \r alone
                b'\r' => self.line += u64::from(self.text.get(self.at + 1) != Some(&b'\n')),
                b'#' if self.comments => {
                    self.skip_line();
                    continue;
                }
                _ if byte.is_ascii_whitespace() => {}
                _ => return,
            }
            self.at += 1;
        }
    }

    fn word(&mut self) -> Option<&'a [u8]> {
        let start = self.at;
        while self.text.get(self.at).is_some_and(|&b| !(b.is_ascii_whitespace() || b == b'#' && self.comments)) {
            self.at += 1;
        }
        (self.at > start).then(|| &self.text[start..self.at])
    }

    /// An error at the last word.
    pub(crate) fn error(&self, message: impl Into<String>) -> ReadError {
        ReadError::new(message).at(self.place())
    }

    /// The next word as a number.
    pub(crate) fn number(&mut self, what: &str) -> Result<f64, ReadError> {
        match self.next() {
            Some(word) => parse_f64(word).ok_or_else(|| self.error(format!("expected {what}, found '{}'", show(word)))),
            None => Err(self.error(format!("the file ends where {what} is expected"))),
        }
    }

    /// The next word as a whole number that is not negative.
    pub(crate) fn count(&mut self, what: &str) -> Result<u64, ReadError> {
        match self.next() {
            Some(word) => parse_int(word).ok_or_else(|| self.error(format!("expected {what}, found '{}'", show(word)))),
            None => Err(self.error(format!("the file ends where {what} is expected"))),
        }
    }
}

/// A word as it can be shown in a message.
pub(crate) fn show(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(40)]).escape_debug().to_string()
}

/// A number; `nan` and `inf` are numbers, too.
pub(crate) fn parse_f64(word: &[u8]) -> Option<f64> {
    match fast_float2::parse(word.strip_prefix(b"+").unwrap_or(word)) {
        Ok(value) => Some(value),
        Err(_) => parse_odd(word),
    }
}

/// A number, rounded once to single precision.
pub(crate) fn parse_f32(word: &[u8]) -> Option<f32> {
    match fast_float2::parse(word.strip_prefix(b"+").unwrap_or(word)) {
        Ok(value) => Some(value),
        Err(_) => parse_odd(word).map(|value| value as f32),
    }
}

/// Numbers as C printed them on Windows (`-nan(ind)`, `1.#INF`, `-1.#IND00`).
fn parse_odd(word: &[u8]) -> Option<f64> {
    let lower = word.to_ascii_lowercase();
    let body = lower.strip_prefix(b"-").unwrap_or(&lower);
    if body.starts_with(b"nan(") || body.starts_with(b"1.#ind") || body.starts_with(b"1.#qnan") {
        return Some(f64::NAN);
    }
    body.starts_with(b"1.#inf").then_some(if lower.starts_with(b"-") { f64::NEG_INFINITY } else { f64::INFINITY })
}

/// A whole number of the type, with or without a sign.
pub(crate) fn parse_int<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Appends the shortest digits that give the same number when read back.
pub(crate) fn push_number<T: Into<f64> + Copy + std::fmt::Display + std::fmt::LowerExp>(out: &mut Vec<u8>, value: T) {
    use std::io::Write;
    let size = value.into().abs();
    let plain = size == 0.0 || (1e-5..1e16).contains(&size);
    let written = if plain { write!(out, "{value}") } else { write!(out, "{value:e}") };
    written.expect("writing into memory does not fail");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_know_their_lines_whatever_ends_them() {
        let mut words = Words::new(b"a b\r\nc # d\n\n e\rf", 1, true);
        let mut seen = Vec::new();
        while let Some(word) = words.next() {
            seen.push((show(word), words.place()));
        }
        let at = |word: &str, line| (word.to_owned(), Place::Line(line));
        assert_eq!(seen, [at("a", 1), at("b", 1), at("c", 2), at("e", 4), at("f", 5)]);
    }

    #[test]
    fn numbers_are_read_as_all_programs_print_them() {
        for (word, value) in [("1", 1.0), ("+1.5e2", 150.0), ("-.5", -0.5), ("-1.#INF", f64::NEG_INFINITY)] {
            assert_eq!(parse_f64(word.as_bytes()), Some(value), "{word}");
        }
        for word in ["nan", "NaN", "-nan", "-nan(ind)", "1.#QNAN0"] {
            assert!(parse_f64(word.as_bytes()).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["", "+", "1,5", "0x10", "abc"] {
            assert_eq!(parse_f64(word.as_bytes()), None, "{word}");
        }
    }
}
