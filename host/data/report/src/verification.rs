//! The check of a recording in words.

use board::finding::Severity;
use recording::verify::{GridCheck, StreamCheck, Verification};

use crate::session::sentence;
use crate::summary::Summary;

/// Returns verdict, findings and figures of a check. The verdict is that on the recording, if there
/// is one.
#[must_use]
pub fn summary(verification: &Verification, verdict: Option<&Summary>) -> Summary {
    let text = match verification.severity {
        Severity::Good if verification.is_bare => {
            "Good as a file: nothing in it is damaged. There is nothing that says what it should hold."
        }
        Severity::Good => "Good: nothing is missing or changed since the recording was closed.",
        Severity::Check => "Check: something is missing, or cannot be compared.",
        Severity::Bad => "Bad: parts cannot be read or contradict each other.",
    };
    let alignment = verification.alignment.iter();
    let alignment: String = alignment
        .map(|promise| format!(" {}", sentence(promise)))
        .collect();
    let file = &verification.file;
    let mut facts = vec![
        ("recording", verification.recording.clone()),
        (
            "file",
            format!(
                "{} bytes, {} chunks good, {} damaged, {} messages, {}",
                file.bytes,
                file.chunks,
                file.bad_chunks,
                file.messages,
                if file.closed { "closed" } else { "not closed" }
            ),
        ),
    ];
    if let Some([from, to]) = verification.board_time_s {
        facts.push(("board time", format!("{from:.3} s to {to:.3} s")));
    }
    for (name, stream) in &verification.streams {
        let StreamCheck {
            received,
            missing,
            dropped_by_board: dropped,
        } = stream;
        let text =
            format!("{received} received, {missing} missing ({dropped} dropped by the board)");
        facts.push((name, text));
    }
    if let Some(grid) = &verification.grid {
        let GridCheck {
            checked,
            off,
            worst_ticks,
        } = grid;
        let most = match off {
            0 => String::new(),
            _ => format!(", the furthest by {worst_ticks} ticks"),
        };
        let text = format!("{checked} pulses held against it, {off} off{most}");
        facts.push(("grid", text));
    }
    let compared = verification.compared.iter();
    facts.extend(compared.map(|compared| ("compared", compared.clone())));
    let severity = verdict.map_or(verification.severity, |verdict| verdict.severity);
    if verification.severity != Severity::Good && !(file.closed && file.bad_chunks == 0) {
        let next = "`smartdepthsync extract` reads what is there, after the damage too; for other \
                    programs `mcap recover` makes a whole file of what is before it";
        facts.push(("next", next.to_owned()));
    }
    let parts = verdict.into_iter().flat_map(|verdict| &verdict.parts);
    Summary {
        title: format!("Check of {}", verification.recording),
        severity,
        text: verdict.map_or(format!("{text}{alignment}"), |verdict| verdict.text.clone()),
        parts: parts.chain(&verification.findings).cloned().collect(),
        facts,
    }
}
