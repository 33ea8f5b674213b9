//! The filter that everything printed passes.
//!
//! A text may come from a board, a phone or a file from elsewhere. A terminal obeys control
//! characters in it: they can change what is shown, set the title, or make the terminal send
//! input. Characters that reverse the direction of writing can disguise a name. Here both become
//! visible and harmless.
//!
//! The live view needs no filter, because `ratatui` drops control characters. Log lines are
//! escaped by `tracing-subscriber`.

use std::borrow::Cow;
use std::fmt::Write as _;

/// The form in which a character is shown that a terminal would obey.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shown {
    /// As `\u{1b}`.
    ForPeople,
    /// As `\u001b`, which it also is in a JSON string.
    Json,
}

/// Escapes the characters of a text that a terminal would obey. Line ends and tabs stay.
pub(crate) fn harmless(text: &str, shown: Shown) -> Cow<'_, str> {
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        let code = u32::from(c);
        // Writing into a String cannot fail.
        let _ = match shown {
            _ if !is_obeyed(c) => out.write_char(c),
            Shown::ForPeople => write!(out, "\\u{{{code:x}}}"),
            Shown::Json => write!(out, "\\u{code:04x}"),
        };
    }
    Cow::Owned(out)
}

/// The lines of a text, broken between words where they are wider than a terminal. Commands,
/// which begin with two blanks, stay whole: they are to be pasted.
pub(crate) fn wrapped(text: &str, width: usize) -> String {
    let mut out = String::with_capacity(text.len() + 64);
    for line in text.lines() {
        let is_command = line
            .strip_prefix("  ")
            .is_some_and(|text| !text.starts_with(' '));
        if is_command {
            out.push_str(line);
        } else {
            // Mark and kind of a finding are its first column.
            out += &broken(line, line.rfind("  ").map_or(0, |at| at + 2), width);
        }
        out.push('\n');
    }
    out
}

/// A line broken between words where it is wider than `width`; what is broken stands at `column`.
pub(crate) fn broken(line: &str, column: usize, width: usize) -> String {
    let column = column.min(width / 2);
    let (mut out, mut at) = (String::with_capacity(line.len() + 16), 0);
    for word in line.split_inclusive(' ') {
        if at > column && at + word.trim_end().chars().count() > width {
            out.truncate(out.trim_end_matches(' ').len());
            out.push('\n');
            out.extend(std::iter::repeat_n(' ', column));
            at = column;
        }
        out.push_str(word);
        at += word.chars().count();
    }
    out
}

/// Control characters but line end and tab, and those that turn the direction of writing
/// (Unicode Annex 9, 2.1 to 2.6).
fn is_obeyed(c: char) -> bool {
    let turns = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}' | '\u{61c}');
    turns || (c.is_control() && c != '\n' && c != '\t')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_broken_between_words_and_commands_are_not() {
        let text =
            "check  alignment  one two three four five\n  smartdepthsync extract x/y/z/long\n";
        assert_eq!(
            wrapped(text, 26),
            "check  alignment  one two\n             three four\n             five\n\
             \x20 smartdepthsync extract x/y/z/long\n"
        );
        assert_eq!(wrapped("a\n\nb", 0), "a\n\nb\n");
    }

    #[test]
    fn what_a_terminal_obeys_is_shown() {
        let plain = "bias  +3.4 µs\tok\n";
        assert_eq!(harmless(plain, Shown::ForPeople), plain);
        let text = "a\u{1b}]0;x\u{7}b\u{9b}2J\rc\u{202e}d\u{7f}";
        let shown = harmless(text, Shown::ForPeople);
        assert_eq!(
            shown,
            "a\\u{1b}]0;x\\u{7}b\\u{9b}2J\\u{d}c\\u{202e}d\\u{7f}"
        );
        // In JSON it is the same string.
        let json = serde_json::to_string(text).unwrap();
        let shown = harmless(&json, Shown::Json);
        assert!(!shown.contains(is_obeyed), "{shown}");
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), text);
    }
}
