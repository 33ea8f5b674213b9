//! Every command of the three programs, and every option that the documents
//! mention by itself, is in a program's `--help`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use crate::support;
use test_support::documents::{Code, arguments, pages};

/// Help of a command.
#[derive(Debug, Default)]
struct Help {
    options: BTreeSet<String>,
    below: BTreeMap<String, Help>,
    /// The rest is another program's.
    passes_on: bool,
}

impl Help {
    fn read(program: &Path, path: &mut Vec<String>) -> Self {
        let output = Command::new(program)
            .args(&*path)
            .arg("--help")
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{path:?}: {output:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        let mut help = Self {
            passes_on: text.contains("[CARGO_ARGS]"),
            ..Self::default()
        };
        let mut in_commands = false;
        for line in text.lines() {
            let trimmed = line.trim_start();
            if !line.starts_with(' ') {
                in_commands = line == "Commands:";
            } else if trimmed.starts_with('-') {
                let words = trimmed.split([' ', ',', '=', '[']);
                let options = words.filter_map(|word| word.strip_prefix("--"));
                help.options.extend(options.map(str::to_owned));
            } else if in_commands && line.starts_with("  ") && !line.starts_with("   ") {
                let name = trimmed.split_whitespace().next().unwrap();
                if name != "help" {
                    path.push(name.to_owned());
                    help.below
                        .insert(name.to_owned(), Self::read(program, path));
                    path.pop();
                }
            }
        }
        help
    }

    /// Words of a command line that do not exist.
    fn unknown(&self, words: &[String]) -> Option<String> {
        let mut help = self;
        for (index, word) in words.iter().enumerate() {
            if let Some(option) = word.strip_prefix("--") {
                let name = option.split('=').next().unwrap();
                if !help.passes_on && !name.is_empty() && !help.options.contains(name) {
                    return Some(word.clone());
                }
            } else if let Some(below) = help.below.get(word) {
                help = below;
            } else if index == 0
                && word != "help"
                && !word.starts_with('-')
                && word.chars().all(|c| c.is_ascii_lowercase() || c == '-')
            {
                return Some(word.clone());
            }
        }
        None
    }

    fn all_options(&self, into: &mut BTreeSet<String>) {
        into.extend(self.options.iter().cloned());
        for below in self.below.values() {
            below.all_options(into);
        }
    }
}

fn xtask() -> Help {
    let program = support::smartdepthsync().with_file_name("xtask");
    assert!(
        program.is_file(),
        "{} is missing: run this test through `cargo xtask test`",
        program.display()
    );
    Help::read(&program, &mut Vec::new())
}

fn smartdepthsync() -> Help {
    Help::read(support::smartdepthsync(), &mut Vec::new())
}

fn hil_sim() -> Help {
    let program = Path::new(env!("CARGO_BIN_EXE_hil-sim"));
    Help::read(program, &mut Vec::new())
}

#[test]
fn commands_of_the_programs_are_in_their_help() {
    let mut wrong = Vec::new();
    // What `cargo xtask` passes on.
    let mut xtask = xtask();
    xtask.below.insert("hil-sim".to_owned(), hil_sim());
    let demo = hil_sim().below.remove("demo").unwrap();
    xtask.below.insert("demo".to_owned(), demo);
    for (name, help, least) in [
        ("cargo xtask", xtask, 30),
        ("hil-sim", hil_sim(), 3),
        ("smartdepthsync", smartdepthsync(), 40),
    ] {
        assert!(help.below.len() >= 5, "{help:?}");
        let mut checked = 0;
        for (page, text) in pages() {
            for line in Code::of(&text).all() {
                let Some(words) = arguments(line, name) else {
                    continue;
                };
                checked += 1;
                if let Some(what) = help.unknown(&words) {
                    wrong.push(format!("{}: {what}: {line}", page.display()));
                }
            }
        }
        assert!(checked >= least, "only {checked} commands of {name}");
    }
    assert!(wrong.is_empty(), "not there:\n{}", wrong.join("\n"));
}

#[test]
fn options_written_alone_are_in_a_help() {
    let mut known = BTreeSet::new();
    hil_sim().all_options(&mut known);
    xtask().all_options(&mut known);
    smartdepthsync().all_options(&mut known);
    // Options of cargo and of the shell's tools.
    let others = ["locked", "no-default-features"];
    let mut checked = 0;
    let mut wrong = Vec::new();
    for (page, text) in pages() {
        for span in Code::of(&text).spans {
            if !span.starts_with("--") {
                continue;
            }
            let words = span.split([' ', '=', '[', ',', '/']);
            for option in words.filter_map(|word| word.strip_prefix("--")) {
                checked += 1;
                if !known.contains(option) && !others.contains(&option) {
                    wrong.push(format!("{}: --{option}", page.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "not there:\n{}", wrong.join("\n"));
    assert!(checked >= 35, "only {checked} options");
}

#[test]
fn the_check_finds_unknown_commands_and_options() {
    let help = hil_sim();
    let unknown = |line: &str| help.unknown(&arguments(line, "hil-sim").unwrap());
    assert_eq!(unknown("target/release/hil-sim serve --speed 1"), None);
    assert_eq!(unknown("cargo run -p hil-sim -- serve --for 10s"), None);
    assert!(unknown("hil-sim sevre").is_some());
    assert!(unknown("hil-sim serve --no-such").is_some());
    assert_eq!(
        arguments("cargo build -p hil-sim --release", "hil-sim"),
        None
    );
    let help = smartdepthsync();
    let unknown = |line: &str| help.unknown(&arguments(line, "smartdepthsync").unwrap());
    assert_eq!(unknown("sudo smartdepthsync -v verify X --json"), None);
    assert!(unknown("smartdepthsync verify X --out Y").is_some());
    assert!(unknown("smartdepthsync evaluate precision --no-such").is_some());
}
