//! Builds the book in `docs/` with mdBook, and checks every local link.
//!
//! mdBook itself does not fail on a broken link. Here a relative target must exist, a fragment
//! must be the slug of a heading of its page, every page must be listed in `SUMMARY.md`, and the
//! book must stay short. A file of the source tree that a page names in code, by its path from
//! the root, must exist too. The same holds for README and CONTRIBUTING.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

use crate::{process, tools};

const MDBOOK_VERSION: &str = "0.5.4";

/// Largest number of words of all pages, not counting the commands' help and included files.
const MOST_WORDS: usize = 18_000;

/// Folders whose files the book names by their path from the root.
const SOURCES: [&str; 6] = [
    "firmware/",
    "protocol/",
    "host/",
    "hil-sim/",
    "xtask/",
    "docs/",
];

/// Fails if a local link of the book is broken, or if the book is too long.
pub(crate) fn check() -> Result<()> {
    // In a folder of its own, since a test does the same and may run at the same time.
    let source = pages(None, &format!("book-check-{}", std::process::id()))?;
    let links = check_links(&source, &process::root());
    fs::remove_dir_all(source)?;
    links?;
    let mut count = 0;
    for path in process::files_below(&process::root().join("docs"), ".md")? {
        count += words(&process::read(&path)?);
    }
    if count > MOST_WORDS {
        bail!("the book has {count} words, expected at most {MOST_WORDS}; shorten it");
    }
    println!("no link of the book is broken; it has {count} of at most {MOST_WORDS} words");
    Ok(())
}

/// Counts the words that contain a letter or a digit, so not the bars of tables.
fn words(text: &str) -> usize {
    let is_word = |word: &&str| word.contains(char::is_alphanumeric);
    text.split_whitespace().filter(is_word).count()
}

/// Builds the book into `target/book` and checks it.
pub(crate) fn build_and_check() -> Result<()> {
    process::cargo("build --release --quiet -p smartdepthsync".split(' '))?;
    check()?;
    let source = pages(Some(&process::program("smartdepthsync")), "book-source")?;
    let features = ["--no-default-features", "--features", "search"];
    let mdbook = tools::ensure_cargo_tool("mdbook", MDBOOK_VERSION, &features)?;
    let book = process::target_dir().join("book");
    let mut mdbook = process::command(mdbook);
    process::run(mdbook.arg("build").arg(source).arg("--dest-dir").arg(&book))?;
    println!("the book: {}", book.join("index.html").display());
    Ok(())
}

/// Copies the pages to a folder of this name in cargo's target folder and returns it. A line
/// `{{file PATH}}` is replaced by that file, by its path from the root, and `{{help}}` by the help
/// of every command if the program is given.
pub(crate) fn pages(program: Option<&Path>, name: &str) -> Result<PathBuf> {
    let root = process::root();
    let source = process::fresh_folder(name)?;
    let docs = root.join("docs");
    for path in process::files_below(&docs, "")? {
        let target = source.join(path.strip_prefix(&docs)?);
        fs::create_dir_all(target.parent().unwrap_or(&source))?;
        if path.extension().is_none_or(|extension| extension != "md") {
            fs::copy(&path, &target)?;
            continue;
        }
        let mut page = String::new();
        for line in process::read(&path)?.lines() {
            let file = line.strip_prefix("{{file ");
            if let Some(file) = file.and_then(|rest| rest.strip_suffix("}}")) {
                page += &process::read(&root.join(file))
                    .with_context(|| format!("{} includes a file", path.display()))?;
            } else if line == "{{help}}" {
                if let Some(program) = program {
                    page += &help(program, &[])?;
                }
            } else if line.starts_with("{{") {
                bail!(
                    "{}: {line}: expected `{{{{file PATH}}}}` or `{{{{help}}}}`",
                    path.display()
                );
            } else {
                page.extend([line, "\n"]);
            }
        }
        fs::write(&target, page)?;
    }
    Ok(source)
}

/// Returns the help of a command and of all commands below it.
fn help(program: &Path, words: &[&str]) -> Result<String> {
    let text = process::text(process::command(program).args(words).arg("--help"))?;
    let title = [&["smartdepthsync"], words].concat().join(" ");
    let mut out = format!("\n## {title}\n\n```text\n{}\n```\n", text.trim());
    let (_, below) = text.split_once("\nCommands:\n").unwrap_or_default();
    for line in below.lines().take_while(|line| !line.is_empty()) {
        let name = line.split_whitespace().next().unwrap_or_default();
        if line.starts_with("  ") && !line.starts_with("   ") && name != "help" {
            out += &help(program, &[words, &[name]].concat())?;
        }
    }
    Ok(out)
}

/// Links and anchors of a page.
#[derive(Default)]
struct Page {
    links: Vec<String>,
    /// Paths of the source tree, from the root.
    sources: Vec<String>,
    anchors: BTreeSet<String>,
}

/// Checks the pages of `source` as if they were in `docs/`, and the two at the root.
fn check_links(source: &Path, root: &Path) -> Result<()> {
    let root = &root.canonicalize()?;
    let docs = root.join("docs");
    let mut pages = BTreeMap::new();
    for path in process::files_below(source, ".md")? {
        let page = parse(&process::read(&path)?);
        pages.insert(docs.join(path.strip_prefix(source)?), page);
    }
    for path in ["README.md", "CONTRIBUTING.md"].map(|name| root.join(name)) {
        let page = parse(&process::read(&path)?);
        pages.insert(path, page);
    }
    let summary = docs.join("SUMMARY.md");
    let listed = pages.get(&summary).context("SUMMARY.md is missing")?;
    let listed: BTreeSet<PathBuf> = listed.links.iter().map(|link| docs.join(link)).collect();

    let mut broken = Vec::new();
    for (path, page) in &pages {
        let name = path.strip_prefix(root)?.display();
        if path.starts_with(&docs) && *path != summary && !listed.contains(path) {
            broken.push(format!("{name} is not listed in SUMMARY.md"));
        }
        for link in &page.links {
            let reason = broken_link(path, link, &pages);
            broken.extend(reason.map(|reason| format!("{name}: {link}: {reason}")));
        }
        for source in page.sources.iter().filter(|path| !root.join(path).exists()) {
            broken.push(format!("{name}: {source}: no such file"));
        }
    }
    if !broken.is_empty() {
        bail!("broken links in the book:\n  {}", broken.join("\n  "));
    }
    Ok(())
}

fn broken_link(page: &Path, link: &str, pages: &BTreeMap<PathBuf, Page>) -> Option<&'static str> {
    if link.contains("://") || link.starts_with("mailto:") {
        return None;
    }
    let (file, fragment) = link.split_once('#').unwrap_or((link, ""));
    let target = match file {
        "" => page.to_path_buf(),
        _ => page.parent()?.join(file),
    };
    let Ok(target) = target.canonicalize() else {
        return Some("no such file");
    };
    let page = pages.get(&target).filter(|_| !fragment.is_empty())?;
    (!page.anchors.contains(fragment)).then_some("no such heading")
}

fn parse(text: &str) -> Page {
    let mut page = Page::default();
    let mut heading: Option<String> = None;
    for event in Parser::new_ext(text, Options::ENABLE_TABLES | Options::ENABLE_FOOTNOTES) {
        match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                page.links.push(dest_url.into_string());
            }
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => {
                let slug = slug(&heading.take().unwrap_or_default());
                let more = (1..).map(|count| format!("{slug}-{count}"));
                let mut anchors = std::iter::once(slug.clone()).chain(more);
                let anchor = anchors.find(|anchor| !page.anchors.contains(anchor));
                page.anchors.extend(anchor);
            }
            Event::Text(text) | Event::Code(text) if heading.is_some() => {
                heading.get_or_insert_default().push_str(&text);
            }
            Event::Code(text) if is_source(&text) => page.sources.push(text.into_string()),
            _ => {}
        }
    }
    page
}

fn is_source(code: &str) -> bool {
    SOURCES.iter().any(|folder| code.starts_with(folder)) && !code.contains([' ', '*', '<'])
}

/// Returns the id that mdBook gives a heading.
fn slug(title: &str) -> String {
    let is_kept = |c: &char| c.is_alphanumeric() || c.is_whitespace() || "-_".contains(*c);
    let kept: String = title.trim().chars().filter(is_kept).collect();
    kept.to_ascii_lowercase().replace(char::is_whitespace, "-")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every file that the pages include exists, and no link is broken.
    #[test]
    fn the_pages_of_this_tree_are_whole() {
        check().unwrap();
    }

    #[test]
    fn bars_of_tables_are_no_words() {
        assert_eq!(
            words("# Two words\n\n| a | 3 |\n|---|---|\n| `c d` | – |\n"),
            6
        );
    }

    #[test]
    fn headings_become_mdbook_slugs() {
        let page = parse("# Clock & time\n\n## `Ticks`, 48 MHz\n\n## Same\n\n## Same\n");
        let anchors: Vec<&str> = page.anchors.iter().map(String::as_str).collect();
        assert_eq!(anchors, ["clock--time", "same", "same-1", "ticks-48-mhz"]);
    }

    #[test]
    fn a_missing_file_and_a_missing_heading_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let docs = folder.path().join("docs");
        fs::create_dir(&docs).unwrap();
        let write = |name: &str, text: &str| fs::write(docs.join(name), text).unwrap();
        write("../README.md", "[b](docs/b.md#b)");
        write("../CONTRIBUTING.md", "");
        write("SUMMARY.md", "[A](a.md)\n[B](b.md)");
        write("a.md", "# A\n[b](b.md#b) [web](https://example.org/x)");
        write("b.md", "# B\n[a](a.md)");
        check_links(&docs, folder.path()).unwrap();
        write("../README.md", "[b](docs/b.md#c)");
        write("b.md", "# B\n[a](a.md#nowhere) [c](c.md)");
        let error = check_links(&docs, folder.path()).unwrap_err().to_string();
        assert!(error.contains("a.md#nowhere: no such heading"), "{error}");
        assert!(error.contains("c.md: no such file"), "{error}");
        let own = "README.md: docs/b.md#c: no such heading";
        assert!(error.contains(own), "{error}");
        write(
            "b.md",
            "# B\n`host/src/gone.rs`, but `cargo run --path host/x`",
        );
        let error = check_links(&docs, folder.path()).unwrap_err().to_string();
        assert!(
            error.contains("b.md: host/src/gone.rs: no such file"),
            "{error}"
        );
        write("b.md", "# B");
        write("d.md", "# D");
        let error = check_links(&docs, folder.path()).unwrap_err().to_string();
        assert!(error.contains("d.md is not listed"), "{error}");
    }
}
