//! The app's answers as a sans-IO state machine: bytes in, events out.
//!
//! Every answer is lines of text: `SUCCESS` or `ERROR`, the server's version,
//! the body, the line `end`. The number of body lines differs between versions
//! of the app, so a reader goes on to `end` and never counts. After the `end`
//! of `get_video` raw bytes follow; the decoder therefore stops exactly behind
//! that line and says how much of its input it took.
//!
//! Memory is bounded whatever comes: one line is held at a time, no longer than
//! [`MAX_LINE`], and the body's bytes are counted against a limit. Nothing here
//! panics on any input; a decoder that has returned an error keeps returning
//! it, since it no longer knows where it is.

use std::fmt;

/// Longest line that is accepted, in bytes without its end. The longest true
/// line is a file name (at most 255 bytes on Android) or a CSV row of the
/// gyroscope (below 80).
pub const MAX_LINE: usize = 1024;

/// Version of the app's server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ServerVersion {
    /// `v.0.1`: `video_start` answers phase and frame duration.
    V0_1,
    /// `v.0.1.1`: `video_start` answers the exposure time as well.
    V0_1_1,
}

impl ServerVersion {
    fn from_line(line: &str) -> Option<Self> {
        match line {
            "v.0.1" => Some(Self::V0_1),
            "v.0.1.1" => Some(Self::V0_1_1),
            _ => None,
        }
    }

    /// The version as the app writes it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::V0_1 => "v.0.1",
            Self::V0_1_1 => "v.0.1.1",
        }
    }
}

impl fmt::Display for ServerVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// One step of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AnswerEvent<'a> {
    /// One line of a success' body, without its end.
    Line(&'a str),
    /// The answer is complete and was a success; the version of the server.
    End(ServerVersion),
    /// The answer is complete and was an error.
    Refused {
        /// Version of the server.
        version: ServerVersion,
        /// The app's words; the first line if there were several.
        text: String,
    },
}

/// Why an answer is not one of the protocol.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MalformedAnswer {
    /// A line is not what belongs there.
    #[error("expected {expected}, got {got:?} (line {line} of the answer)")]
    Line {
        /// Number of the line in the answer, from 1.
        line: u64,
        /// What belongs there.
        expected: &'static str,
        /// What came, shortened.
        got: String,
    },
    /// The answer ended before a part of it came.
    #[error("it ended without {expected}")]
    Missing {
        /// The part that did not come.
        expected: &'static str,
    },
    /// A line without an end.
    #[error("line {line} of the answer is longer than {MAX_LINE} bytes")]
    LineTooLong {
        /// Number of the line in the answer, from 1.
        line: u64,
    },
    /// A body without an end.
    #[error("it has no end: more than {limit} bytes came")]
    TooLarge {
        /// The limit in bytes.
        limit: u64,
    },
    /// A line that is not text.
    #[error("line {line} of the answer is not text")]
    NotText {
        /// Number of the line in the answer, from 1.
        line: u64,
    },
    /// The app's version is not known.
    #[error("unknown version {found:?}")]
    UnknownVersion {
        /// The version line, shortened.
        found: String,
    },
}

impl MalformedAnswer {
    /// The line with this number is not what belongs there.
    pub(crate) fn line(line: u64, expected: &'static str, got: &str) -> Self {
        Self::Line {
            line,
            expected,
            got: shorten(got),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum State {
    Status,
    Version {
        success: bool,
    },
    Body {
        version: ServerVersion,
    },
    ErrorText {
        version: ServerVersion,
        text: Option<String>,
    },
    Done,
    Failed(MalformedAnswer),
}

/// Reads one answer from bytes that come in any split.
#[derive(Debug)]
pub struct AnswerDecoder {
    state: State,
    line: Vec<u8>,
    /// `line` holds a whole line that was given out; it is dropped at the next step.
    given: bool,
    lines: u64,
    bytes: u64,
    limit: u64,
}

impl AnswerDecoder {
    /// A decoder for one answer of at most `limit` bytes of text.
    #[must_use]
    pub fn new(limit: u64) -> Self {
        Self {
            state: State::Status,
            line: Vec::with_capacity(128),
            given: false,
            lines: 0,
            bytes: 0,
            limit,
        }
    }

    /// Bytes of the answer taken so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Number of the line that was read last, from 1.
    pub(crate) fn line_number(&self) -> u64 {
        self.lines
    }

    /// Takes bytes from the front of `input` up to the next event.
    ///
    /// `None` says that all of `input` was taken and more is needed. Behind
    /// [`AnswerEvent::End`] nothing more is taken: what is left in `input`
    /// belongs to whoever reads next.
    pub fn next(&mut self, input: &mut &[u8]) -> Result<Option<AnswerEvent<'_>>, MalformedAnswer> {
        loop {
            match &self.state {
                State::Failed(e) => return Err(e.clone()),
                State::Done => return Ok(None),
                _ => {}
            }
            if self.given {
                self.line.clear();
                self.given = false;
            }
            match self.take_line(input) {
                Ok(true) => {}
                Ok(false) => return Ok(None),
                Err(e) => return self.fail(e),
            }
            self.given = true;
            self.lines = self.lines.saturating_add(1);
            // Borrowed anew in each arm, so that the state may change beside it.
            let Ok(line) = std::str::from_utf8(&self.line) else {
                let line = self.lines;
                return self.fail(MalformedAnswer::NotText { line });
            };
            match &mut self.state {
                State::Status => {
                    let success = match line {
                        "SUCCESS" => true,
                        "ERROR" => false,
                        other => {
                            let expected = "SUCCESS or ERROR";
                            let wrong = MalformedAnswer::line(self.lines, expected, other);
                            return self.fail(wrong);
                        }
                    };
                    self.state = State::Version { success };
                }
                State::Version { success } => {
                    let Some(version) = ServerVersion::from_line(line) else {
                        let found = shorten(line);
                        return self.fail(MalformedAnswer::UnknownVersion { found });
                    };
                    self.state = match *success {
                        true => State::Body { version },
                        false => State::ErrorText {
                            version,
                            text: None,
                        },
                    };
                }
                State::Body { version } if line == "end" => {
                    let version = *version;
                    self.state = State::Done;
                    return Ok(Some(AnswerEvent::End(version)));
                }
                // The line is borrowed again here: a borrow that is returned
                // from one arm of a loop would last through all of it.
                State::Body { .. } => {
                    return Ok(Some(AnswerEvent::Line(
                        std::str::from_utf8(&self.line).unwrap_or_default(),
                    )));
                }
                State::ErrorText { version, text } => {
                    if line == "end" && text.is_some() {
                        let version = *version;
                        let text = text.take().unwrap_or_default();
                        self.state = State::Done;
                        return Ok(Some(AnswerEvent::Refused { version, text }));
                    }
                    if text.is_none() {
                        *text = Some(shorten(line));
                    }
                }
                State::Done | State::Failed(_) => return Ok(None),
            }
        }
    }

    /// Moves bytes into `line`; true once a whole line is there.
    fn take_line(&mut self, input: &mut &[u8]) -> Result<bool, MalformedAnswer> {
        let end = input.iter().position(|&b| b == b'\n');
        let taken = end.unwrap_or(input.len());
        let (head, rest) = input.split_at(taken);
        let line = self.lines.saturating_add(1);
        if self.line.len() + head.len() > MAX_LINE {
            return Err(MalformedAnswer::LineTooLong { line });
        }
        self.line.extend_from_slice(head);
        let count = taken as u64 + u64::from(end.is_some());
        self.bytes = self.bytes.saturating_add(count);
        if self.bytes > self.limit {
            return Err(MalformedAnswer::TooLarge { limit: self.limit });
        }
        *input = rest.get(usize::from(end.is_some())..).unwrap_or_default();
        if end.is_some() && self.line.last() == Some(&b'\r') {
            self.line.pop();
        }
        Ok(end.is_some())
    }

    fn fail<T>(&mut self, error: MalformedAnswer) -> Result<T, MalformedAnswer> {
        self.state = State::Failed(error.clone());
        Err(error)
    }
}

/// At most 120 characters of text off the network, for an error message. (It is
/// printed with `{:?}`, which escapes control characters.)
pub(crate) fn shorten(text: &str) -> String {
    const MOST: usize = 120;
    let mut short: String = text.chars().take(MOST).collect();
    if text.chars().nth(MOST).is_some() {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// All events of `bytes`, given in pieces of the sizes in `cuts`.
    fn events(bytes: &[u8], cuts: &[usize], limit: u64) -> (Vec<String>, usize) {
        let mut decoder = AnswerDecoder::new(limit);
        let mut out = Vec::new();
        let mut at = 0;
        let mut cuts = cuts.iter().copied().cycle();
        while at < bytes.len() {
            let n = cuts.next().unwrap_or(1).clamp(1, bytes.len() - at);
            let mut input = &bytes[at..at + n];
            loop {
                match decoder.next(&mut input) {
                    Ok(Some(event)) => {
                        let done =
                            matches!(event, AnswerEvent::End(_) | AnswerEvent::Refused { .. });
                        out.push(format!("{event:?}"));
                        if done {
                            return (out, at + n - input.len());
                        }
                    }
                    Ok(None) => break,
                    Err(e) => {
                        out.push(format!("{e:?}"));
                        return (out, at + n - input.len());
                    }
                }
            }
            at += n;
        }
        (out, at)
    }

    #[test]
    fn stops_exactly_behind_the_end_line() {
        let text = b"SUCCESS\nv.0.1.1\n17\nname.mp4\nend\nend\nSUCCESS\n";
        let (seen, taken) = events(text, &[7], 1000);
        assert_eq!(seen, ["Line(\"17\")", "Line(\"name.mp4\")", "End(V0_1_1)"]);
        assert_eq!(&text[taken..], b"end\nSUCCESS\n");
    }

    #[test]
    fn reads_an_error() {
        let (seen, _) = events(b"ERROR\nv.0.1\nInvalid request\nend\n", &[3], 1000);
        assert_eq!(
            seen,
            ["Refused { version: V0_1, text: \"Invalid request\" }"]
        );
        // The word of the error may be the end word itself.
        let (seen, _) = events(b"ERROR\nv.0.1\nend\nend\n", &[100], 1000);
        assert_eq!(seen, ["Refused { version: V0_1, text: \"end\" }"]);
    }

    #[test]
    fn says_what_is_wrong() {
        let (seen, _) = events(b"HTTP/1.1 400 Bad Request\r\n", &[100], 1000);
        assert!(seen[0].contains("SUCCESS or ERROR"), "{seen:?}");
        let (seen, _) = events(b"SUCCESS\nv.0.1.2\n", &[100], 1000);
        assert!(seen[0].contains("v.0.1.2"), "{seen:?}");
        let (seen, _) = events(b"SUCCESS\nv.0.1\n\xff\xfe\n", &[100], 1000);
        assert!(seen[0].contains("NotText"), "{seen:?}");
        let long = [b"SUCCESS\nv.0.1\n".to_vec(), vec![b'x'; 2000]].concat();
        let (seen, _) = events(&long, &[100], 100_000);
        assert!(seen[0].contains("LineTooLong"), "{seen:?}");
        let endless = [b"SUCCESS\nv.0.1\n".to_vec(), b"1\n".repeat(2000)].concat();
        let (seen, _) = events(&endless, &[100], 1000);
        assert!(seen.last().unwrap().contains("TooLarge"), "{seen:?}");
    }

    #[test]
    fn an_error_lasts() {
        let mut decoder = AnswerDecoder::new(1000);
        let mut input: &[u8] = b"nonsense\nSUCCESS\n";
        let first = decoder.next(&mut input).unwrap_err();
        assert_eq!(decoder.next(&mut input).unwrap_err(), first);
    }

    proptest! {
        #[test]
        fn any_split_gives_the_same_events(
            body in proptest::collection::vec("[ -~]{0,40}", 0..20),
            cuts in proptest::collection::vec(1usize..50, 1..10),
        ) {
            let text = format!("SUCCESS\nv.0.1\n{}\nend\nrest", body.join("\n"));
            let whole = events(text.as_bytes(), &[usize::MAX], 10_000);
            let split = events(text.as_bytes(), &cuts, 10_000);
            prop_assert_eq!(whole, split);
        }

        #[test]
        fn any_bytes_are_taken_without_panic_and_within_bounds(
            bytes in proptest::collection::vec(any::<u8>(), 0..4000),
            cuts in proptest::collection::vec(1usize..3000, 1..10),
            head in 0usize..4,
        ) {
            let heads: [&[u8]; 4] = [b"", b"SUCCESS\n", b"SUCCESS\nv.0.1\n", b"ERROR\nv.0.1\n"];
            let all = [heads[head], &bytes].concat();
            let whole = events(&all, &[usize::MAX], 2000);
            let split = events(&all, &cuts, 2000);
            // Which of two limits is met first may depend on the split; that one is met may not.
            prop_assert_eq!(whole.0.len(), split.0.len());
            let mut decoder = AnswerDecoder::new(2000);
            let mut input = all.as_slice();
            while let Ok(Some(_)) = decoder.next(&mut input) {}
            prop_assert!(decoder.line.capacity() <= 2 * MAX_LINE);
        }
    }
}
