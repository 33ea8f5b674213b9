//! The commands that the documents mention.

use std::fs;
use std::path::{Path, PathBuf};

use crate::root;

/// Reads all pages; gives their paths with their text.
pub fn pages() -> Vec<(PathBuf, String)> {
    let mut pages = vec![root().join("README.md")];
    for name in ["CHANGELOG.md", "CONTRIBUTING.md"] {
        pages.push(root().join(name));
    }
    markdown(&root().join("docs"), &mut pages);
    pages
        .into_iter()
        .map(|page| {
            let text = fs::read_to_string(&page).unwrap();
            (page, text)
        })
        .collect()
}

fn markdown(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            markdown(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "md") {
            found.push(path);
        }
    }
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
