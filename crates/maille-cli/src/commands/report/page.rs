//! The page: head, sections, tables, and text made fit for HTML.

use std::fmt::Write;

use crate::output;

/// A page in the making.
pub(crate) struct Page {
    html: String,
}

impl Page {
    /// Starts a page. The title and the heading are text, the lead is HTML.
    pub(crate) fn new(title: &str, heading: &str, lead: &str) -> Self {
        Self {
            html: format!(
                "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
                 <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
                 <meta name=\"color-scheme\" content=\"light dark\">\n<title>{}</title>\n\
                 <style>{STYLE}</style>\n</head>\n<body>\n\
                 <header>\n<p class=\"brand\">Maille</p>\n<h1>{}</h1>\n<p class=\"lead\">{lead}</p>\n</header>\n<main>\n",
                escape(title),
                escape(heading)
            ),
        }
    }

    /// Adds HTML as it is.
    pub(crate) fn add(&mut self, html: &str) {
        self.html += html;
    }

    /// Adds a section.
    pub(crate) fn section(&mut self, heading: &str, content: &str) {
        let _ = write!(self.html, "<section>\n<h2>{}</h2>\n{content}</section>\n", escape(heading));
    }

    /// The whole page.
    pub(crate) fn finish(self, footer: &str) -> String {
        let version = env!("CARGO_PKG_VERSION");
        format!("{}</main>\n<footer>Made by maille {version}. {footer}</footer>\n</body>\n</html>\n", self.html)
    }
}

/// A table whose first column names the rows. Caption and cells are HTML.
pub(crate) fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    let columns = head.len();
    let head: String = head.iter().map(|cell| format!("<th scope=\"col\">{cell}</th>")).collect();
    let row = |cells: &Vec<String>| {
        let cell = |(i, cell): (usize, &String)| match i {
            0 => format!("<th scope=\"row\">{cell}</th>"),
            _ => format!("<td>{cell}</td>"),
        };
        format!("<tr>{}</tr>\n", cells.iter().enumerate().map(cell).collect::<String>())
    };
    let rows: String = rows.iter().map(row).collect();
    let width = if columns > 4 { "wide" } else { "narrow" };
    // a scrolling region has to be reached by the keyboard
    format!(
        "<div class=\"scroll\" tabindex=\"0\"><table class=\"{width}\">\n<caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n\
         <tbody>\n{rows}</tbody>\n</table></div>\n"
    )
}

/// Names and values side by side, few and large. Both are HTML.
pub(crate) fn facts(facts: &[(&str, String)]) -> String {
    let fact = |(name, value): &(&str, String)| format!("<div><dt>{name}</dt><dd>{value}</dd></div>\n");
    format!("<dl class=\"facts\">\n{}</dl>\n", facts.iter().map(fact).collect::<String>())
}

/// Names and values one below the other, small, to be unfolded. The values are text.
pub(crate) fn settings(summary: &str, settings: &[(&str, String)]) -> String {
    let setting = |(name, value): &(&str, String)| format!("<div><dt>{name}</dt><dd>{}</dd></div>\n", escape(value));
    let settings: String = settings.iter().map(setting).collect();
    format!("<details><summary>{summary}</summary>\n<dl class=\"settings\">\n{settings}</dl>\n</details>\n")
}

/// A cell with a bar behind its text, as long as the share (0 to 1).
pub(crate) fn bar(text: &str, share: f64) -> String {
    let percent = (100.0 * share).clamp(0.0, 100.0);
    format!("<span class=\"bar\" style=\"--share:{percent:.1}%\">{text}</span>")
}

/// The command that is running, as a shell takes it.
pub(crate) fn command_line() -> String {
    let quoted = |word: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=%+@".contains(c);
        if !word.is_empty() && word.chars().all(plain) { word } else { format!("'{}'", word.replace('\'', r"'\''")) }
    };
    let words = std::env::args_os().skip(1).map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("maille".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// A whole number in groups of three that no line break parts.
pub(crate) fn count(n: impl TryInto<u64>) -> String {
    output::count(n).replace(' ', "\u{202f}")
}

/// Text as HTML.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A share as a percentage of three digits.
pub(crate) fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent <= 0.0 || !percent.is_finite() {
        return "0\u{202f}%".to_owned();
    }
    let digits = (2 - percent.log10().floor() as i32).clamp(0, 7) as usize;
    let text = format!("{percent:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}\u{202f}%")
}

const STYLE: &str = include_str!("style.css");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_files_cannot_break_the_page() {
        assert_eq!(escape("<b>\"R&D\"</b>"), "&lt;b&gt;&quot;R&amp;D&quot;&lt;/b&gt;");
        let page = Page::new("<a>", "<b>", "lead").finish("");
        assert!(page.contains("<title>&lt;a&gt;</title>") && page.contains("<h1>&lt;b&gt;</h1>"));
    }

    #[test]
    fn shares_have_three_digits() {
        assert_eq!(percent(0.012_345), "1.23\u{202f}%");
        assert_eq!(percent(0.5), "50\u{202f}%");
        assert_eq!(percent(0.0), "0\u{202f}%");
    }
}
