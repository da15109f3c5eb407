//! Results on stdout: text for people, one JSON object for machines.

use std::io::{self, Write};
use std::path::Path;

use serde_json::Value;

/// Prints one JSON object on a line of its own.
pub(crate) fn print_json(object: &Value) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{object}")?;
    stdout.flush()
}

/// Prints text as it is.
pub(crate) fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes())?;
    stdout.flush()
}

/// Lines of a name and a value, the values aligned.
#[derive(Default)]
pub(crate) struct Listing {
    lines: Vec<(String, String)>,
}

impl Listing {
    /// Adds a line with a name and a value.
    pub(crate) fn line(&mut self, name: impl Into<String>, value: impl Into<String>) {
        self.lines.push((name.into(), value.into()));
    }

    /// Adds a line of its own.
    pub(crate) fn heading(&mut self, text: impl Into<String>) {
        self.lines.push((text.into(), String::new()));
    }

    /// The whole text.
    pub(crate) fn text(&self) -> String {
        let valued = self.lines.iter().filter(|(_, value)| !value.is_empty());
        let width = valued.map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        let line = |(name, value): &(String, String)| match value.is_empty() {
            true => format!("{name}\n"),
            false => format!("  {name:<width$}  {value}\n"),
        };
        self.lines.iter().map(line).collect()
    }
}

/// A table: the first column to the left, the others to the right.
pub(crate) fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell_width = |column: usize| rows.iter().filter_map(|row| row.get(column)).map(|c| c.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|column| cell_width(column).unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(i, (cell, &width))| match i {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    rows.iter().map(line).collect()
}

/// A whole number with thin groups of three: 1 234 567.
pub(crate) fn count(n: impl TryInto<u64>) -> String {
    let digits = n.try_into().unwrap_or(u64::MAX).to_string();
    let groups: Vec<&str> = (digits.as_bytes().rchunks(3).rev())
        .map(|group| std::str::from_utf8(group).expect("digits are ASCII"))
        .collect();
    groups.join(" ")
}

/// A number with as many digits as tell something (4), plainly where that is short.
pub(crate) fn number(x: f64) -> String {
    let magnitude = x.abs();
    if x == 0.0 {
        "0".to_owned()
    } else if !(1e-4..1e7).contains(&magnitude) {
        format!("{x:.3e}")
    } else {
        let digits = (3 - magnitude.log10().floor() as i32).max(0) as usize;
        let text = format!("{x:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

/// A distance in model units and as percent of a diagonal.
pub(crate) fn distance(x: f64, diagonal: f64) -> String {
    match diagonal > 0.0 {
        true => format!("{} ({}% of the diagonal)", number(x), number(100.0 * x / diagonal)),
        false => number(x),
    }
}

/// A number of bytes: 1.2 MB.
pub(crate) fn bytes(n: u64) -> String {
    let mut value = n as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if value < 1000.0 || unit == "GB" {
            return if unit == "B" { format!("{n} B") } else { format!("{value:.1} {unit}") };
        }
        value /= 1000.0;
    }
    unreachable!("the last unit takes every size")
}

/// Seconds: 0.52 s, 2.1 ms.
pub(crate) fn seconds(s: f64) -> String {
    if s < 0.1 { format!("{:.1} ms", 1000.0 * s) } else { format!("{s:.2} s") }
}

/// Files that have been written, with their sizes.
pub(crate) fn written(files: &[impl AsRef<Path>]) -> String {
    let with_size = |path: &Path| {
        let size = std::fs::metadata(path).map(|meta| format!(" ({})", bytes(meta.len()))).unwrap_or_default();
        format!("{}{size}", path.display())
    };
    files.iter().map(|path| with_size(path.as_ref())).collect::<Vec<_>>().join(", ")
}

/// Paths for JSON.
pub(crate) fn paths(files: &[impl AsRef<Path>]) -> Vec<String> {
    files.iter().map(|path| path.as_ref().display().to_string()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(count(1_234_567_u64), "1 234 567");
        assert_eq!(count(12_usize), "12");
        assert_eq!(number(0.0123456), "0.01235");
        assert_eq!(number(1234.0), "1234");
        assert_eq!(number(1.5), "1.5");
        assert_eq!(number(-2e-9), "-2.000e-9");
        assert_eq!(bytes(999), "999 B");
        assert_eq!(bytes(1_250_000), "1.2 MB");
    }

    #[test]
    fn listings_and_tables_align() {
        let mut listing = Listing::default();
        listing.heading("file");
        listing.line("a", "1");
        listing.line("long", "2");
        assert_eq!(listing.text(), "file\n  a     1\n  long  2\n");
        let rows = [vec!["name".to_owned(), "n".to_owned()], vec!["x".to_owned(), "100".to_owned()]];
        assert_eq!(table(&rows), "name    n\nx     100\n");
    }
}
