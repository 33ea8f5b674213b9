//! The commands that the documents mention.

use std::fs;
use std::path::PathBuf;

use crate::{below, root};

/// Reads all pages; gives their paths with their text.
pub fn pages() -> Vec<(PathBuf, String)> {
    let top = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|name| root().join(name));
    let is_page = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "md");
    let book = below(&root().join("docs")).into_iter().filter(is_page);
    let pages = top.into_iter().chain(book);
    pages
        .map(|page| (page.clone(), fs::read_to_string(page).unwrap()))
        .collect()
}

/// The text that a page writes as code.
#[derive(Default)]
pub struct Code {
    /// Lines of blocks; one that goes on on the next is one.
    pub lines: Vec<String>,
    /// Spans within the text.
    pub spans: Vec<String>,
}

impl Code {
    /// Finds the code in a page.
    #[must_use]
    pub fn of(text: &str) -> Self {
        let mut code = Self::default();
        let mut in_block = false;
        let mut prose = String::new();
        let mut long = String::new();
        for line in text.lines() {
            if line.trim_start().starts_with("```") {
                in_block = !in_block;
                prose.push('\n');
            } else if in_block {
                let line = line.trim().trim_start_matches("$ ");
                match line.strip_suffix('\\') {
                    Some(part) => long.push_str(part),
                    None => {
                        code.lines.push(format!("{long}{line}"));
                        long.clear();
                    }
                }
            } else {
                prose.push_str(line);
                prose.push(' ');
            }
        }
        code.spans = prose
            .split('`')
            .skip(1)
            .step_by(2)
            .map(|span| span.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        code
    }

    /// Lines and spans.
    pub fn all(&self) -> impl Iterator<Item = &String> {
        self.lines.iter().chain(&self.spans)
    }
}

/// Returns the words after a program's name, up to the end of the command; `None` if it is not
/// called there.
pub fn arguments(line: &str, program: &str) -> Option<Vec<String>> {
    let line = line.split(" #").next().unwrap();
    let name = format!("{program} ");
    let at = line
        .match_indices(&name)
        .find(|(at, _)| {
            let before = &line[..*at];
            // As the name of a package only where it is run with what follows.
            let is_package = before.ends_with("-p ") || before.ends_with("--package ");
            let is_run = line[at + name.len()..].starts_with("-- ");
            *at == 0 || (before.ends_with([' ', '/', '(']) && (!is_package || is_run))
        })?
        .0;
    let command = line[at + name.len()..]
        .split(['|', '>', ';'])
        .next()
        .unwrap();
    let command = command.split("&&").next().unwrap();
    let words = command
        .split_whitespace()
        .map(|word| word.trim_matches(['[', ']', '"', '\'', ',', '…']))
        .filter(|word| !word.is_empty());
    let words: Vec<String> = words.map(str::to_owned).collect();
    Some(match words.split_first() {
        Some((first, rest)) if first == "--" => rest.to_vec(),
        _ => words,
    })
}
