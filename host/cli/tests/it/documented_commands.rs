//! Every command in a block of the documents is a whole one; every command has help,
//! completions and a manual page.

use std::fs;
use std::path::PathBuf;

use clap::CommandFactory as _;
use clap::error::ErrorKind;
use smartdepthsync::cli::Cli;

use crate::support::{commands, run, run_line};
use test_support::documents::{Code, arguments, pages};
use test_support::{TestFolder, below, root};

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

/// Each command in a message must run as it stands, with values in its braces.
#[test]
fn every_command_that_the_program_prints_is_a_whole_command() {
    let mut checked = 0;
    let mut wrong = Vec::new();
    let sources = ["host/cli/src", "host/live", "host/data"];
    let sources = sources
        .into_iter()
        .flat_map(|room| below(&root().join(room)));
    let is_product = |path: &PathBuf| {
        let path = path.to_string_lossy();
        path.ends_with(".rs") && !path.contains("/tests")
    };
    for path in sources.filter(is_product) {
        let text = fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        let lines = text.lines().map(str::trim_start);
        let lines = lines.filter(|line| !line.starts_with("//"));
        // A string goes on after a backslash.
        let text: String = lines
            .map(|line| {
                line.strip_suffix('\\')
                    .map_or(format!("{line}\n"), str::to_owned)
            })
            .collect();
        for code in text
            .split('`')
            .filter(|code| code.starts_with("smartdepthsync "))
        {
            let mut line = String::new();
            let mut braces = code.split('{');
            line.push_str(braces.next().unwrap());
            for (_, after) in braces.filter_map(|part| part.split_once('}')) {
                line += "1";
                line += after;
            }
            checked += 1;
            match Cli::command().try_get_matches_from(line.split_whitespace()) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::DisplayHelp => {}
                Err(_) if line.ends_with("help COMMAND") => {}
                Err(error) => wrong.push(format!("{}: {line}\n{error}", path.display())),
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(checked >= 30, "only {checked} commands were found");
}

#[test]
fn every_command_has_help_and_a_manual_page() {
    let mut cli = Cli::command();
    cli.build();
    let commands = commands(&cli, "");
    assert!(commands.len() > 15, "{commands:?}");
    let folder = TestFolder::new();
    let place = folder.path().join("man1");
    let made = run(&["man", place.to_str().unwrap()]);
    assert_eq!(made.status.code(), Some(0), "{made:?}");
    for (words, _) in commands.iter().filter(|(_, it)| !it.is_hide_set()) {
        let args = format!("{words} --help");
        let help = run_line(&args);
        assert_eq!(help.status.code(), Some(0), "{args}");
        let help = String::from_utf8_lossy(&help.stdout).into_owned();
        assert!(help.contains("Usage:"), "{args}");
        let example = help.lines().find_map(|line| line.strip_prefix("Example: "));
        let is_leaf = !help.contains("\nCommands:");
        assert_eq!(example.is_some(), is_leaf, "an example of {args}");
        if let Some(example) = example {
            let taken = Cli::command().try_get_matches_from(example.split(' '));
            assert!(taken.is_ok(), "{example}: {:?}", taken.err());
            assert!(example[15..].starts_with(words), "{example}");
        }
        let mut headings = help
            .lines()
            .filter(|line| line.ends_with(':') && !line.starts_with(' '));
        assert_eq!(
            headings.next_back(),
            Some("Options of every command:"),
            "{help}"
        );
        let page = place.join(format!("smartdepthsync-{}.1", words.replace(' ', "-")));
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
