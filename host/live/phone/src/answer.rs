//! The app's answers: splits bytes into lines and interprets them. Without any I/O.
//!
//! Every answer is lines of text: `SUCCESS` or `ERROR`, the server's version,
//! the body, the line `end`. The number of body lines differs between versions
//! of the app, so a reader goes on to `end` and never counts. Raw bytes follow the
//! `end` of `get_video`, so [`Lines`] stops exactly after each line and leaves the
//! rest of its input.
//!
//! Memory is bounded for any input: one line is held at a time, no longer than
//! [`MAX_LINE`], and the answer's bytes are counted against a limit. No input
//! causes a panic.

use std::fmt;

/// Longest line that is accepted, in bytes without its end. The longest line of the
/// app is a file name (at most 255 bytes on Android) or a CSV row of the
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

    /// Returns the version as the app writes it.
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

/// The end of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Version of the server.
    pub version: ServerVersion,
    /// The app's words if it was an error; the first line if there were several.
    pub refused: Option<String>,
}

/// Violation of the protocol by an answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MalformedAnswer {
    /// A line differs from what the protocol expects.
    #[error("expected {expected}, got {got:?} (line {line} of the answer)")]
    Line {
        /// Number of the line in the answer, from 1.
        line: u64,
        /// Content that the protocol expects there.
        expected: &'static str,
        /// The line that was received, shortened.
        got: String,
    },
    /// The answer ended before a required part.
    #[error("it ended without {expected}")]
    Missing {
        /// The part that is missing.
        expected: &'static str,
    },
    /// A line is longer than [`MAX_LINE`].
    #[error("line {line} of the answer is longer than {MAX_LINE} bytes")]
    LineTooLong {
        /// Number of the line in the answer, from 1.
        line: u64,
    },
    /// The answer is longer than its limit.
    #[error("it has no end: more than {limit} bytes came")]
    TooLarge {
        /// The limit in bytes.
        limit: u64,
    },
    /// A line is not UTF-8.
    #[error("line {line} of the answer is not text")]
    NotText {
        /// Number of the line in the answer, from 1.
        line: u64,
    },
    /// This program does not support the app's version.
    #[error("unknown version {found:?}")]
    UnknownVersion {
        /// The version line, shortened.
        found: String,
    },
}

impl MalformedAnswer {
    /// Creates the error of a line that differs from what is expected there.
    pub(crate) fn line(line: u64, expected: &'static str, got: &str) -> Self {
        Self::Line {
            line,
            expected,
            got: shorten(got),
        }
    }
}

/// Reads one answer. `next` returns its lines; `body` receives the body lines of a success, each
/// with its number in the answer.
///
/// # Errors
///
/// Those of `next`; or a line violates the protocol, which `wrong` converts.
pub fn read<E>(
    mut next: impl FnMut() -> Result<String, E>,
    mut body: impl FnMut(u64, &str) -> Result<(), MalformedAnswer>,
    wrong: impl Fn(MalformedAnswer) -> E,
) -> Result<Answer, E> {
    let is_success = match next()?.as_str() {
        "SUCCESS" => true,
        "ERROR" => false,
        other => return Err(wrong(MalformedAnswer::line(1, "SUCCESS or ERROR", other))),
    };
    let line = next()?;
    let version = ServerVersion::from_line(&line).ok_or_else(|| {
        let found = shorten(&line);
        wrong(MalformedAnswer::UnknownVersion { found })
    })?;
    // The text of an error may itself be `end`.
    let refused = if is_success {
        None
    } else {
        Some(shorten(&next()?))
    };
    for number in 3.. {
        let line = next()?;
        if line == "end" {
            break;
        }
        if is_success {
            body(number, &line).map_err(&wrong)?;
        }
    }
    Ok(Answer { version, refused })
}

/// Splits the bytes of one answer, which may arrive in pieces of any size, into lines.
#[derive(Debug)]
pub struct Lines {
    line: Vec<u8>,
    count: u64,
    bytes: u64,
    limit: u64,
}

impl Lines {
    /// Starts an answer of at most `limit` bytes of text.
    #[must_use]
    pub const fn new(limit: u64) -> Self {
        Self {
            line: Vec::new(),
            count: 0,
            bytes: 0,
            limit,
        }
    }

    /// Returns the number of bytes of the answer consumed so far.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Consumes bytes from the front of `input` up to the end of a line. Returns `None` if all of
    /// `input` was consumed and more is needed.
    ///
    /// # Errors
    ///
    /// The line or the answer is too long, or not UTF-8.
    pub fn next(&mut self, input: &mut &[u8]) -> Result<Option<String>, MalformedAnswer> {
        let line = self.count.saturating_add(1);
        let end = input.iter().position(|&b| b == b'\n');
        let (head, rest) = input.split_at(end.unwrap_or(input.len()));
        if self.line.len() + head.len() > MAX_LINE {
            return Err(MalformedAnswer::LineTooLong { line });
        }
        self.line.extend_from_slice(head);
        let taken = head.len() as u64 + u64::from(end.is_some());
        self.bytes = self.bytes.saturating_add(taken);
        if self.bytes > self.limit {
            return Err(MalformedAnswer::TooLarge { limit: self.limit });
        }
        *input = rest.get(1..).unwrap_or_default();
        if end.is_none() {
            return Ok(None);
        }
        self.count = line;
        let text = String::from_utf8(std::mem::take(&mut self.line));
        let mut text = text.map_err(|_| MalformedAnswer::NotText { line })?;
        if text.ends_with('\r') {
            text.pop();
        }
        Ok(Some(text))
    }
}

/// Shortens text from the network to 120 characters, for an error message. (It is printed with
/// `{:?}`, which escapes control characters.)
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

    /// The end of the answer in `bytes`, which come in pieces of the sizes in `cuts`, its
    /// body, and how many of the bytes were taken. `None` if it has no end.
    type Outcome = (Option<Result<Answer, MalformedAnswer>>, Vec<String>, usize);

    fn outcome(bytes: &[u8], cuts: &[usize], limit: u64) -> Outcome {
        let mut lines = Lines::new(limit);
        let mut cuts = cuts.iter().copied().cycle();
        let (mut rest, mut piece) = (bytes, &bytes[..0]);
        let mut body = Vec::new();
        let answer = read(
            || {
                while !piece.is_empty() || !rest.is_empty() {
                    if piece.is_empty() {
                        let size = cuts.next().unwrap_or(1).clamp(1, rest.len());
                        (piece, rest) = rest.split_at(size);
                    }
                    if let Some(line) = lines.next(&mut piece).map_err(Some)? {
                        return Ok(line);
                    }
                }
                Err(None)
            },
            |_, line| {
                body.push(line.to_owned());
                Ok(())
            },
            Some,
        );
        let answer = match answer {
            Ok(answer) => Some(Ok(answer)),
            Err(error) => error.map(Err),
        };
        (answer, body, bytes.len() - rest.len() - piece.len())
    }

    #[test]
    fn stops_exactly_after_the_end_line() {
        let text = b"SUCCESS\nv.0.1.1\n17\nname.mp4\nend\nend\nSUCCESS\n";
        let (answer, body, taken) = outcome(text, &[7], 1000);
        let version = ServerVersion::V0_1_1;
        let refused = None;
        assert_eq!(answer, Some(Ok(Answer { version, refused })));
        assert_eq!(body, ["17", "name.mp4"]);
        assert_eq!(&text[taken..], b"end\nSUCCESS\n");
    }

    #[test]
    fn reads_an_error() {
        let version = ServerVersion::V0_1;
        for (text, word) in [
            (
                &b"ERROR\nv.0.1\nInvalid request\nend\n"[..],
                "Invalid request",
            ),
            // The word of the error may be the end word itself.
            (b"ERROR\nv.0.1\nend\nend\n", "end"),
        ] {
            let refused = Some(word.to_owned());
            let answer = Answer { version, refused };
            assert_eq!(outcome(text, &[3], 1000).0, Some(Ok(answer)));
        }
    }

    #[test]
    fn says_what_is_wrong() {
        let long = [b"SUCCESS\nv.0.1\n".to_vec(), vec![b'x'; 2000]].concat();
        let endless = [b"SUCCESS\nv.0.1\n".to_vec(), b"1\n".repeat(2000)].concat();
        for (text, limit, word) in [
            (
                &b"HTTP/1.1 400 Bad Request\r\n"[..],
                1000,
                "SUCCESS or ERROR",
            ),
            (b"SUCCESS\nv.0.1.2\n", 1000, "v.0.1.2"),
            (b"SUCCESS\nv.0.1\n\xff\xfe\n", 1000, "NotText"),
            (&long, 100_000, "LineTooLong"),
            (&endless, 1000, "TooLarge"),
        ] {
            let error = outcome(text, &[100], limit).0.unwrap().unwrap_err();
            assert!(format!("{error:?}").contains(word), "{error:?}");
        }
        assert_eq!(outcome(b"SUCCESS\nv.0.1\n", &[100], 1000).0, None);
    }
}
