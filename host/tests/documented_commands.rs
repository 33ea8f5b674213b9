//! Every command and option that the documents mention exists; every command has
//! help, completions and a manual page; every command prints JSON if asked to.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use clap::CommandFactory as _;
use smartdepthsync::cli::Cli;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(args)
        .output()
        .unwrap()
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

/// All that is written as code in a page: lines of blocks, and spans.
fn code(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_block = false;
    let mut prose = String::new();
    let mut long = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
            prose.push('\n');
        } else if in_block {
            // A line that goes on on the next.
            let line = line.trim().trim_start_matches("$ ");
            match line.strip_suffix('\\') {
                Some(part) => long.push_str(part),
                None => {
                    found.push(format!("{long}{line}"));
                    long.clear();
                }
            }
        } else {
            prose.push_str(line);
            prose.push(' ');
        }
    }
    found.extend(
        prose
            .split('`')
            .skip(1)
            .step_by(2)
            .map(|span| span.split_whitespace().collect::<Vec<_>>().join(" ")),
    );
    found
}

/// What follows the program's name, up to the end of the command.
fn arguments(line: &str) -> Option<Vec<String>> {
    let line = line.split(" #").next().unwrap();
    let at = line
        .match_indices("smartdepthsync ")
        .find(|(at, _)| {
            let before = &line[..*at];
            // Not as the name of a package.
            *at == 0 || (before.ends_with([' ', '/', '(']) && !before.ends_with("-p "))
        })?
        .0;
    let command = line[at..].split(['|', '>', ';']).next().unwrap();
    let command = command.split("&&").next().unwrap();
    Some(
        command
            .split_whitespace()
            .skip(1)
            .map(|word| {
                word.trim_matches(['[', ']', '"', '\'', ',', '…'])
                    .to_owned()
            })
            .filter(|word| !word.is_empty())
            .collect(),
    )
}

/// Walks a command line as far as it is commands and options; says what is unknown.
fn unknown(cli: &clap::Command, words: &[String]) -> Option<String> {
    let mut command = cli;
    let mut known: Vec<&clap::Arg> = cli.get_arguments().collect();
    for (position, word) in words.iter().enumerate() {
        if let Some(long) = word.strip_prefix("--") {
            let name = long.split('=').next().unwrap();
            let exists = name == "help"
                || name == "version"
                || name.is_empty()
                || known.iter().any(|arg| arg.get_long() == Some(name));
            if !exists {
                return Some(format!("--{name} of `{}`", command.get_name()));
            }
        } else if let Some(below) = command.find_subcommand(word) {
            command = below;
            known.extend(below.get_arguments());
        } else if position == 0 && !word.starts_with('-') && word != "help" {
            let is_word = word.chars().all(|c| c.is_ascii_lowercase() || c == '-');
            if is_word && *word != "<command>" {
                return Some(format!("the command {word}"));
            }
        }
    }
    None
}

#[test]
fn everything_that_the_documents_mention_exists() {
    let mut cli = Cli::command();
    cli.build();
    let mut pages = vec![root().join("README.md")];
    for name in ["CHANGELOG.md", "CONTRIBUTING.md"] {
        pages.push(root().join(name));
    }
    markdown(&root().join("docs"), &mut pages);
    let mut checked = 0;
    let mut wrong = Vec::new();
    for page in &pages {
        for line in code(&fs::read_to_string(page).unwrap()) {
            let Some(words) = arguments(&line) else {
                continue;
            };
            checked += 1;
            if let Some(what) = unknown(&cli, &words) {
                wrong.push(format!("{}: {what}: {line}", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "not there:\n{}", wrong.join("\n"));
    assert!(checked >= 30, "only {checked} commands were found");
}

#[test]
fn the_check_finds_what_is_not_there() {
    let mut cli = Cli::command();
    cli.build();
    let words = |line: &str| arguments(line).unwrap();
    let unknown = |line: &str| unknown(&cli, &words(line));
    assert_eq!(unknown("smartdepthsync record --duration 5m"), None);
    assert_eq!(unknown("sudo smartdepthsync -v verify X --json"), None);
    assert!(unknown("smartdepthsync recrod").is_some());
    assert!(unknown("smartdepthsync verify X --out Y").is_some());
    assert!(unknown("smartdepthsync evaluate precision --no-such").is_some());
    assert_eq!(arguments("cargo build -p smartdepthsync --release"), None);
}

#[test]
fn commands_of_xtask_that_the_documents_mention_exist() {
    let folder = root().join("xtask/src");
    let read = |path: PathBuf| fs::read_to_string(path).unwrap();
    let source = read(folder.join("main.rs"));
    let commands = source.split_once("enum Command {").unwrap().1;
    let commands = commands.split_once("\n}").unwrap().0.to_lowercase();
    let all: String = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| read(entry.unwrap().path()))
        .collect();
    let mut pages = vec![root().join("README.md"), root().join("CONTRIBUTING.md")];
    markdown(&root().join("docs"), &mut pages);
    let mut checked = 0;
    for page in pages {
        for line in code(&fs::read_to_string(&page).unwrap()) {
            let Some((_, rest)) = line.split_once("cargo xtask ") else {
                continue;
            };
            let name: String = rest
                .chars()
                .take_while(|c| c.is_ascii_lowercase() || *c == '-')
                .filter(|c| *c != '-')
                .collect();
            if name.is_empty() {
                continue;
            }
            checked += 1;
            let variant = commands.lines().any(|line| {
                line.trim()
                    .strip_prefix(name.as_str())
                    .is_some_and(|rest| rest.starts_with([',', ' ', '(']))
            });
            assert!(
                variant,
                "{}: there is no `cargo xtask {name}`",
                page.display()
            );
            // What follows `test` is cargo's.
            let options = rest
                .split_whitespace()
                .filter_map(|word| word.strip_prefix("--"))
                .filter(|_| name != "test");
            for option in options {
                let field = option
                    .split(['=', '`', ']', ','])
                    .next()
                    .unwrap()
                    .replace('-', "_");
                let name = field.replace('_', "-");
                let known = field.is_empty()
                    || all.contains(&format!("{field}:"))
                    || all.contains(&format!("long = \"{name}\""));
                assert!(known, "{}: {line}", page.display());
            }
        }
    }
    assert!(checked >= 10, "{checked}");
}

fn all_commands(command: &clap::Command, path: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    for below in command.get_subcommands() {
        if below.get_name() == "help" {
            continue;
        }
        path.push(below.get_name().to_owned());
        found.push(path.clone());
        all_commands(below, path, found);
        path.pop();
    }
}

#[test]
fn every_command_has_help_and_a_manual_page() {
    let mut cli = Cli::command();
    cli.build();
    let mut commands = Vec::new();
    all_commands(&cli, &mut Vec::new(), &mut commands);
    assert!(commands.len() > 15, "{commands:?}");
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("man1");
    let made = run(&["man", place.to_str().unwrap()]);
    assert_eq!(made.status.code(), Some(0), "{made:?}");
    for path in &commands {
        let mut args: Vec<&str> = path.iter().map(String::as_str).collect();
        args.push("--help");
        let help = run(&args);
        assert_eq!(help.status.code(), Some(0), "{args:?}");
        assert!(
            String::from_utf8_lossy(&help.stdout).contains("Usage:"),
            "{args:?}"
        );
        let page = place.join(format!("smartdepthsync-{}.1", path.join("-")));
        let text =
            fs::read_to_string(&page).unwrap_or_else(|error| panic!("{}: {error}", page.display()));
        assert!(text.contains(".SH SYNOPSIS"), "{}", page.display());
    }
    assert!(place.join("smartdepthsync.1").exists());
}

#[test]
fn completions_know_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let output = run(&["completions", shell]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let script = String::from_utf8(output.stdout).unwrap();
        for word in ["record", "verify", "second-twist"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
        if shell == "bash" {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("completions");
            fs::write(&file, script).unwrap();
            let source = format!(
                ". {}; COMP_WORDS=(smartdepthsync ver); COMP_CWORD=1; _smartdepthsync smartdepthsync ver smartdepthsync; echo \"${{COMPREPLY[@]}}\"",
                file.display()
            );
            let completed = Command::new("bash").args(["-c", &source]).output().unwrap();
            assert_eq!(
                String::from_utf8_lossy(&completed.stdout).trim(),
                "verify",
                "{completed:?}"
            );
        }
    }
}

#[test]
fn the_log_can_be_json_and_errors_say_what_to_do() {
    let output = run(&[
        "-vvv",
        "--log-format",
        "json",
        "--json",
        "info",
        "--port",
        "/no/such/port",
    ]);
    assert_eq!(output.status.code(), Some(5), "{output:?}");
    let error: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(error["error"]["next_step"].is_string(), "{error}");
    for line in String::from_utf8(output.stderr).unwrap().lines() {
        let entry: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(entry["level"].is_string(), "{line}");
    }
}
