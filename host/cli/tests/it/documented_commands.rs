//! Every command in a block of the documents is a whole one; every command has help,
//! completions and a manual page.

use std::fs;
use std::process::{Command, Output};

use clap::CommandFactory as _;
use clap::error::ErrorKind;
use smartdepthsync::cli::Cli;

use test_support::documents::{Code, arguments, pages};

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(args)
        .output()
        .unwrap()
}

/// A line of a block is there to be typed: the program must take it as it stands.
#[test]
fn every_command_in_a_block_is_a_whole_command() {
    let mut checked = 0;
    let mut wrong = Vec::new();
    for (page, text) in pages() {
        for line in Code::of(&text).lines {
            let Some(words) = arguments(&line, "smartdepthsync") else {
                continue;
            };
            checked += 1;
            let words = std::iter::once("smartdepthsync").chain(words.iter().map(String::as_str));
            match Cli::command().try_get_matches_from(words) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::DisplayHelp => {}
                Err(error) => wrong.push(format!("{}: {line}\n{error}", page.display())),
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(checked >= 20, "only {checked} commands were found");
}

fn all_commands(command: &clap::Command, path: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    for below in command.get_subcommands() {
        if below.get_name() == "help" || below.is_hide_set() {
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
        let help = String::from_utf8_lossy(&help.stdout).into_owned();
        assert!(help.contains("Usage:"), "{args:?}");
        let example = help.lines().find_map(|line| line.strip_prefix("Example: "));
        let is_leaf = !help.contains("\nCommands:");
        assert_eq!(example.is_some(), is_leaf, "an example of {args:?}");
        if let Some(example) = example {
            let taken = Cli::command().try_get_matches_from(example.split(' '));
            assert!(taken.is_ok(), "{example}: {:?}", taken.err());
            assert!(example[15..].starts_with(&path.join(" ")), "{example}");
        }
        let mut headings = help
            .lines()
            .filter(|line| line.ends_with(':') && !line.starts_with(' '));
        assert_eq!(
            headings.next_back(),
            Some("Options of every command:"),
            "{help}"
        );
        let page = place.join(format!("smartdepthsync-{}.1", path.join("-")));
        let text =
            fs::read_to_string(&page).unwrap_or_else(|error| panic!("{}: {error}", page.display()));
        assert!(text.contains(".SH SYNOPSIS"), "{}", page.display());
    }
    assert!(place.join("smartdepthsync.1").exists());
}

#[test]
fn help_lists_the_commands_in_the_order_of_use() {
    let help = run(&["--help"]);
    let help = String::from_utf8_lossy(&help.stdout);
    let places = [
        "setup", "doctor", "record", "extract", "evaluate", "verify", "monitor", "board", "phone",
        "profile",
    ]
    .map(|name| help.find(&format!("\n  {name} ")).unwrap());
    assert!(places.is_sorted(), "{help}");
    assert!(!help.contains("completions") && !help.contains("\n  man "));
}

/// A short help is read; a long one is searched.
#[test]
fn short_helps_are_short() {
    for (command, most) in [("record", 12), ("extract", 10)] {
        let help = run(&[command, "-h"]);
        let help = String::from_utf8_lossy(&help.stdout);
        let options = help
            .lines()
            .filter(|line| line.trim_start().starts_with('-'));
        assert_eq!(options.count(), most, "{help}");
        let long = run(&[command, "--help"]);
        let long = String::from_utf8_lossy(&long.stdout);
        assert!(long.contains("\nMore:\n"), "{long}");
    }
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
    }
}
