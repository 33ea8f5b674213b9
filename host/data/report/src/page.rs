//! One self-contained HTML page for people: a summary, then plots, tables, warnings and
//! settings.
//!
//! `record`, `extract` and `evaluate` fill the same [`Page`], so a reader finds
//! the same things in the same order everywhere. The file contains everything
//! (style, SVG, pictures) and no script: it works without a network, years later,
//! and printed on A4.
//!
//! - Text from outside (file names, what a phone says) is escaped here, in one
//!   place; only [`Page::figure`] and [`Page::picture`] take markup, from our own drawings.
//! - On a narrow screen drawings shrink, and the cells of a table stand below each other
//!   with their headings, so nothing is cut off.
//! - Nothing in a page depends on the time of its creation: the same input gives the same
//!   bytes.
//!
//! [`crate::chart`] draws.

use std::fmt::Write as _;

use board::finding::{Finding, Severity};
use serde_json::Value;

use crate::chart;
use crate::summary::Summary;

const STYLE: &str = "\
:root{color-scheme:light}\
*{box-sizing:border-box}\
body{font:16px/1.5 system-ui,sans-serif;color:#1b1b1b;background:#fff;max-width:58rem;margin:0 auto;padding:1rem;overflow-wrap:anywhere}\
h1{font-size:1.5rem;line-height:1.25;margin:.5rem 0}\
h2{font-size:1.15rem;margin:2rem 0 .5rem;padding-top:.5rem;border-top:1px solid #ccc}\
.verdict{border-left:.5rem solid;padding:.75rem 1rem;margin:1rem 0;background:#f4f4f4}\
.verdict b{display:block;font-size:1.15rem;text-transform:capitalize}\
.note{border-left:.25rem solid;padding:.4rem .8rem;margin:.4rem 0;background:#f7f7f7}\
.good{border-color:#1a7f37}.check{border-color:#b26a00}.bad{border-color:#b3261e}\
.wide{overflow-x:auto}\
table{border-collapse:collapse;margin:.5rem 0;min-width:50%}\
td,th{padding:.3rem .8rem .3rem 0;text-align:left;vertical-align:top;border-bottom:1px solid #ddd;font-variant-numeric:tabular-nums;overflow-wrap:normal}\
th{font-weight:600}td.n,th.n{text-align:right}\
.facts th{width:13rem;font-weight:400;color:#555}.facts td{overflow-wrap:anywhere}\
figure{margin:1rem 0}figure .wide>svg{display:block;width:100%;height:auto}\
figure .wide>svg text{font-size:14px}\
figure.picture svg{max-width:100%;height:auto;max-height:40rem}\
figcaption{color:#555;font-size:.9rem;margin-top:.3rem}\
details{margin:1rem 0}summary{cursor:pointer}pre{white-space:pre-wrap;font-size:.85rem}\
footer{margin-top:2rem;color:#555;font-size:.85rem}\
@media(max-width:40rem){body{padding:.75rem}figure .wide>svg text{font-size:26px}\
.list,.list tbody,.list tr{display:block;width:auto}.list tr:first-child{display:none}.list tr{border-bottom:1px solid #ddd;padding:.3rem 0}\
.list td{display:grid;grid-template-columns:9rem 1fr;border:0;padding:.1rem 0;text-align:left;overflow-wrap:anywhere}.list td::before{content:attr(data-h);color:#555}.facts,.facts tbody,.facts tr,.facts th,.facts td{display:block;width:auto}.facts th{border:0;padding-bottom:0}}\
@page{size:A4;margin:15mm}\
@media print{body{font-size:10pt;max-width:none;padding:0}figure,tr,.verdict,.note,h2{break-inside:avoid}h2{break-after:avoid}\
.wide{overflow:visible}}";

/// A page under construction, filled from top to bottom.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// Creates a page that begins with a summary.
    #[must_use]
    pub fn new(summary: &Summary) -> Self {
        let (title, word) = (&summary.title, summary.severity.word());
        let mut page = Self {
            title: title.clone(),
            body: String::new(),
        };
        let _ = writeln!(
            page.body,
            "<h1>{}</h1>\n<p class=\"verdict {word}\"><b>{word}</b>{}</p>",
            escape(title),
            escape(&summary.text)
        );
        page.findings(&summary.parts);
        page.facts(&summary.facts);
        page
    }

    /// Adds a heading.
    pub fn section(&mut self, heading: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(heading));
    }

    /// Adds a paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
    }

    /// Adds a table of names and their values, if there are any.
    pub fn facts<N: AsRef<str>, V: AsRef<str>>(&mut self, facts: &[(N, V)]) {
        if facts.is_empty() {
            return;
        }
        self.body.push_str("<table class=\"facts\">\n");
        for (name, value) in facts {
            let _ = writeln!(
                self.body,
                "<tr><th scope=\"row\">{}</th><td>{}</td></tr>",
                escape(name.as_ref()),
                escape(value.as_ref())
            );
        }
        self.body.push_str("</table>\n");
    }

    /// Adds a table, if it has rows. Columns of numbers are aligned to the right.
    pub fn table<const N: usize>(
        &mut self,
        head: [&str; N],
        rows: impl IntoIterator<Item = [String; N]>,
    ) {
        let rows: Vec<[String; N]> = rows.into_iter().collect();
        if rows.is_empty() {
            return;
        }
        let is_number = |text: &str| {
            text.chars()
                .all(|c| c.is_ascii_digit() || "+-−.,± ".contains(c))
                && (text.is_empty() || text.chars().any(|c| c.is_ascii_digit()))
        };
        let columns: [(&str, String); N] = std::array::from_fn(|column| {
            let mut cells = rows.iter().filter_map(|row| row.get(column));
            let class = if cells.all(|cell| is_number(cell)) {
                " class=\"n\""
            } else {
                ""
            };
            (class, escape(head.get(column).copied().unwrap_or_default()))
        });
        self.body
            .push_str("<div class=\"wide\"><table class=\"list\">\n<tr>");
        for (class, heading) in &columns {
            let _ = write!(self.body, "<th scope=\"col\"{class}>{heading}</th>");
        }
        self.body.push_str("</tr>\n");
        for row in &rows {
            self.body.push_str("<tr>");
            // On a narrow screen each cell stands in a line after its heading.
            for ((class, heading), cell) in columns.iter().zip(row) {
                let cell = escape(cell);
                let _ = write!(self.body, "<td{class} data-h=\"{heading}\">{cell}</td>");
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</table></div>\n");
    }

    /// Adds a drawing of this crate (SVG, which is not escaped) with a caption.
    pub fn figure(&mut self, svg: &str, caption: &str) {
        let _ = writeln!(
            self.body,
            "<figure><div class=\"wide\">{svg}</div><figcaption>{}</figcaption></figure>",
            escape(caption)
        );
    }

    /// Adds a histogram of counts in bins of width `bin`, the first of which begins at `first`;
    /// a line of text if all counts are in one bin. `labels` name the values and the counts.
    pub fn histogram(
        &mut self,
        labels: [&str; 2],
        (first, bin): (f64, f64),
        counts: &[u64],
        caption: &str,
    ) {
        let mut filled = (0..).zip(counts).filter(|(_, count)| **count > 0);
        if let (Some((place, count)), None) = (filled.next(), filled.next()) {
            let (from, [what, of]) = (first + f64::from(place) * bin, labels);
            let text = format!(
                "{caption} All {count} {of}: {what}, {from} to {}.",
                from + bin
            );
            return self.text(&text);
        }
        let svg = chart::histogram(labels, (first, bin), counts);
        self.figure(&svg, caption);
    }

    /// Adds a picture (SVG, which is not escaped) that is shown at its own size, or as large as
    /// fits.
    pub fn picture(&mut self, svg: &str, caption: &str) {
        let _ = writeln!(
            self.body,
            "<figure class=\"picture\">{svg}<figcaption>{}</figcaption></figure>",
            escape(caption)
        );
    }

    /// Adds a note with the colour of a severity.
    pub fn note(&mut self, severity: Severity, text: &str) {
        let (word, text) = (severity.word(), marked_up(text));
        let _ = writeln!(self.body, "<p class=\"note {word}\">{text}</p>");
    }

    /// Adds links to other pages: texts, and addresses relative to this page.
    pub fn links(&mut self, links: &[(String, String)]) {
        for (text, address) in links {
            let (text, address) = (escape(text), escape(address));
            let _ = writeln!(self.body, "<p><a href=\"{address}\">{text}</a></p>");
        }
    }

    /// Adds one note for each finding.
    pub fn findings<'a>(&mut self, findings: impl IntoIterator<Item = &'a Finding>) {
        for finding in findings {
            let word = finding.severity.word();
            let (kind, words) = (
                escape(&finding.kind.to_string()),
                marked_up(&finding.words()),
            );
            let step = finding.next_step.as_deref().map(marked_up);
            let step = step.map_or(String::new(), |step| format!("<br>help: {step}"));
            let note = format!("<p class=\"note {word}\">{kind}: {words}{step}</p>");
            let _ = writeln!(self.body, "{note}");
        }
    }

    /// Adds the settings of the result as JSON, folded.
    pub fn settings(&mut self, heading: &str, value: &Value) {
        let (heading, text) = (escape(heading), escape(&format!("{value:#}")));
        let _ = writeln!(
            self.body,
            "<details><summary>{heading}</summary><pre>{text}</pre></details>"
        );
    }

    /// Returns the page as HTML.
    #[must_use]
    pub fn html(&self) -> String {
        // The empty icon keeps browsers from asking a server for one.
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <link rel=\"icon\" href=\"data:,\"><title>{}</title><style>{STYLE}</style></head>\n\
             <body>\n{}<footer>SmartDepthSync {}</footer>\n</body></html>\n",
            escape(&self.title),
            self.body,
            env!("CARGO_PKG_VERSION")
        )
    }
}

/// Escapes a text and marks commands between backticks as code.
fn marked_up(text: &str) -> String {
    let parts: Vec<String> = text.split('`').map(escape).collect();
    // An unpaired backtick is text.
    if parts.len().is_multiple_of(2) {
        return parts.join("`");
    }
    let mut out = String::new();
    for (index, part) in parts.iter().enumerate() {
        match index % 2 {
            0 => out.push_str(part),
            _ => out += &format!("<code>{part}</code>"),
        }
    }
    out
}

/// Escapes a text, so that it contains no markup.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // HTML allows no control characters.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn page(text: &str) -> Page {
        Page::new(&Summary {
            title: text.to_owned(),
            severity: Severity::Bad,
            text: text.to_owned(),
            parts: vec![Finding::check(text, text).next_step(text)],
            facts: vec![("fact", text.to_owned())],
        })
    }

    #[test]
    fn text_from_outside_is_never_markup() {
        let evil = "<script>alert(\"1\")</script>\u{7}'&";
        let mut page = page(evil);
        page.section(evil);
        page.text(evil);
        page.facts(&[(evil, evil)]);
        page.table([evil], [[evil.to_owned()]]);
        page.figure("<svg></svg>", evil);
        page.settings(evil, &json!({ evil: [evil, {"x": evil}] }));
        let html = page.html();
        assert!(!html.contains("<script"), "{html}");
        assert!(!html.contains('\u{7}'));
        assert_eq!(html.matches("<svg>").count(), 1);
    }

    #[test]
    fn nothing_comes_from_elsewhere() {
        let html = page("t").html();
        for foreign in ["http:", "https:", "src=", "url(", "@import", "<script"] {
            assert!(!html.contains(foreign), "{foreign}");
        }
    }

    #[test]
    fn columns_of_numbers_are_aligned_to_the_right() {
        let mut page = page("t");
        page.table(
            ["name", "value", "text"],
            [
                ["a".into(), "+1.5".into(), "2 left".into()],
                ["-".into(), String::new(), "3".into()],
            ],
        );
        let html = page.html();
        assert!(
            html.contains(
                "<td data-h=\"name\">a</td><td class=\"n\" data-h=\"value\">+1.5</td>\
                 <td data-h=\"text\">2 left</td>"
            ),
            "{html}"
        );
    }
}
