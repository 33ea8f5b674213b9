//! Programs that are killed at one of the system calls by which they change files.

use std::os::unix::process::ExitStatusExt as _;
use std::process::{Command, Stdio};

use crate::processes::bound;

/// The calls by which a program changes files, or sends; regular expressions as strace takes them.
const WRITES: [&str; 8] = [
    "openat",
    "/^p?writev?(64)?$",
    "/^rename",
    "/^mkdir",
    "/^(sym)?link",
    "/^unlink",
    "ftruncate",
    "/^f(data)?sync$",
];

/// Runs a command again and again, killed at another of its writes each time: of each kind the first ones,
/// then in steps that grow by an eighth, until there is no such write. `check` sees what each kill left, with
/// the kind and number of the write. Returns the number of kills.
///
/// The tracer counts each kind of call in each thread by itself. Where one thread comes to its number, all end.
pub fn at_writes(
    first: usize,
    command: impl Fn() -> Command,
    mut check: impl FnMut(&str, usize),
) -> usize {
    let mut kills = 0;
    for call in WRITES {
        let mut number = 1;
        while is_killed_at(call, number, &command()) {
            kills += 1;
            check(call, number);
            number += 1 + number.saturating_sub(first) / 8;
        }
    }
    kills
}

/// Runs a command. Returns true if it was killed when a thread began this call for the `number`th time.
fn is_killed_at(call: &str, number: usize, command: &Command) -> bool {
    let mut traced = bound("strace");
    traced.args(["-f", "-qq", "-o", "/dev/null", "-e"]);
    traced.arg(format!("trace={call}")).arg("-e");
    traced.arg(format!("inject={call}:signal=SIGKILL:when={number}"));
    traced.arg(command.get_program()).args(command.get_args());
    traced
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // The tracer ends as the program did.
    let status = traced.status().unwrap();
    status.signal() == Some(9) || status.code() == Some(128 + 9)
}
