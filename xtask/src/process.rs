//! Child processes: cargo and the programs that it builds.

use std::env;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, IsTerminal as _, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use anyhow::{Context, Result, bail};

/// Variable of the test harness: number of tests of a program that run at once.
const TEST_THREADS: &str = "RUST_TEST_THREADS";

/// Address at which `adb` finds no server and starts none, since it starts one only on `localhost`
/// by that name. Tests and simulated rigs thus neither use a phone of the developer's own server
/// nor leave a server running.
const NO_ADB: [(&str, &str); 2] = [
    ("ANDROID_ADB_SERVER_ADDRESS", "127.0.0.1"),
    ("ANDROID_ADB_SERVER_PORT", "9"),
];

/// Number of lines of a child's output that the error of its failure shows.
const LAST_LINES: usize = 20;

/// Variable that names the firmware's ELF to tests and tools.
pub(crate) const ELF_VARIABLE: &str = "SMARTDEPTHSYNC_FIRMWARE_ELF";

/// The root of the workspace.
pub(crate) fn root() -> PathBuf {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().unwrap_or(manifest).to_path_buf()
}

/// Cargo's target folder; respects `CARGO_TARGET_DIR`.
pub(crate) fn target_dir() -> PathBuf {
    // Relative to the root, unless it is absolute.
    root().join(env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()))
}

/// Makes an empty folder of this name in cargo's target folder.
pub(crate) fn fresh_folder(name: &str) -> Result<PathBuf> {
    let place = target_dir().join(name);
    if place.exists() {
        fs::remove_dir_all(&place).with_context(|| format!("cannot empty {}", place.display()))?;
    }
    fs::create_dir_all(&place).with_context(|| format!("cannot make {}", place.display()))?;
    Ok(place)
}

/// Returns the text of a file.
pub(crate) fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Returns the files below a folder whose names end in `ending`, without those that cargo makes.
pub(crate) fn files_below(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let entries = fs::read_dir(folder);
    for entry in entries.with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() {
            if !path.ends_with("target") {
                files.append(&mut files_below(&path, ending)?);
            }
        } else if path.to_string_lossy().ends_with(ending) {
            files.push(path);
        }
    }
    Ok(files)
}

/// Returns a command at the root of the workspace, without the variables that cargo set for this
/// program alone.
pub(crate) fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text == "CARGO_MANIFEST_DIR" {
            command.env_remove(name);
        }
    }
    command
}

/// Options of the compiler that keep this computer's folders out of its output.
pub(crate) fn remapped() -> [String; 2] {
    let cargo = env::var_os("CARGO_HOME").map_or_else(
        || PathBuf::from(env::var_os("HOME").unwrap_or_default()).join(".cargo"),
        PathBuf::from,
    );
    [(root(), "/smartdepthsync"), (cargo, "/cargo")]
        .map(|(from, to)| format!("--remap-path-prefix={}={to}", from.display()))
}

/// The cargo that started this program, or the one on the path.
pub(crate) fn cargo_program() -> PathBuf {
    env::var_os("CARGO").map_or_else(|| PathBuf::from("cargo"), PathBuf::from)
}

/// Runs a command to its end. Its output is shown at once and written to a log. The error of its
/// failure names the command as typed, the last lines of the output and the log.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let line = typed(command);
    let name: String = (line.chars().take(60))
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect();
    let folder = target_dir().join("xtask-logs");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let path = folder.join(format!("{name}.log"));
    let log = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
    if io::stderr().is_terminal() && env::var_os("CARGO_TERM_COLOR").is_none() {
        command.env("CARGO_TERM_COLOR", "always");
    }
    let mut child = (command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn())
    .with_context(|| format!("cannot start `{line}`"))?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    thread::scope(|scope| {
        if let Some(out) = out {
            scope.spawn(|| copy(out, io::stdout(), &log));
        }
        if let Some(err) = err {
            copy(err, io::stderr(), &log);
        }
    });
    let status = child.wait()?;
    if !status.success() {
        let text = fs::read(&path).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let lines: Vec<&str> = text.lines().collect();
        let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n    ");
        bail!(
            "`{line}` failed ({status})\n  its last lines:\n    {last}\n  all of them: {}",
            path.display()
        );
    }
    Ok(())
}

/// Copies a child's output as it comes. If nobody reads ours any more, the child goes on.
fn copy(mut from: impl Read, mut to: impl Write, mut log: &File) {
    let mut buffer = [0; 8192];
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        let _ = to.write_all(&buffer[..count]).and_then(|()| to.flush());
        let _ = log.write_all(&buffer[..count]);
    }
}

/// Returns the command as typed at the root: its folder if it is another one, the variables that
/// were set for it, cargo by name, and arguments quoted where the shell needs it.
fn typed(command: &Command) -> String {
    let quoted = |text: &OsStr| {
        let text = text.to_string_lossy();
        let is_plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
        if !text.is_empty() && text.chars().all(is_plain) {
            text.into_owned()
        } else {
            format!("'{}'", text.replace('\'', r"'\''"))
        }
    };
    let mut words = Vec::new();
    let folder = command.get_current_dir().unwrap_or(Path::new("."));
    if folder != root() {
        let from_root = folder.strip_prefix(root()).unwrap_or(folder);
        words.push(format!("cd {} &&", quoted(from_root.as_os_str())));
    }
    for (name, value) in command.get_envs() {
        words.extend(value.map(|value| format!("{}={}", name.to_string_lossy(), quoted(value))));
    }
    let program = Path::new(command.get_program());
    let is_cargo = program.file_stem().is_some_and(|stem| stem == "cargo");
    words.push(if is_cargo {
        "cargo".to_owned()
    } else {
        quoted(program.as_os_str())
    });
    words.extend(command.get_args().map(quoted));
    words.join(" ")
}

/// Returns the output of a program, without white space at its end.
pub(crate) fn text(command: &mut Command) -> Result<String> {
    let line = typed(command);
    let output = (command.output()).with_context(|| format!("cannot start `{line}`"))?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        bail!("`{line}` failed ({}): {}", output.status, message.trim());
    }
    Ok(String::from_utf8(output.stdout)?.trim_end().to_owned())
}

/// Returns true if a program runs and succeeds.
pub(crate) fn answers(program: impl AsRef<OsStr>, args: &[&str]) -> bool {
    let output = Command::new(program).args(args).output();
    output.is_ok_and(|output| output.status.success())
}

/// Runs cargo at the root.
pub(crate) fn cargo<I: IntoIterator<Item = S>, S: AsRef<OsStr>>(args: I) -> Result<()> {
    run(command(cargo_program()).args(args))
}

/// Runs cargo with the firmware's ELF named in the environment. Two tests run per core unless the
/// environment says otherwise, since some wait for a process.
pub(crate) fn cargo_with_elf<S: AsRef<OsStr>>(args: &[S], elf: &Path) -> Result<()> {
    let mut cargo = command(cargo_program());
    if env::var_os(TEST_THREADS).is_none() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        cargo.env(TEST_THREADS, (2 * cores).to_string());
    }
    run(cargo.args(args).env(ELF_VARIABLE, elf).envs(NO_ADB))
}

/// Path of a program that cargo has built in the release profile.
pub(crate) fn program(name: impl AsRef<Path>) -> PathBuf {
    target_dir().join("release").join(name)
}

/// Builds the host tool and the simulator with the features of the whole workspace, as the tests
/// do, so that no crate of the host is compiled twice.
pub(crate) fn build_programs() -> Result<()> {
    cargo("build --release --workspace --bin smartdepthsync --bin hil-sim".split(' '))
}

/// Runs the simulator that cargo has built in the release profile on this terminal.
pub(crate) fn hil_sim<S: AsRef<OsStr>>(args: &[S], elf: &Path) -> Result<()> {
    let mut hil_sim = command(program("hil-sim"));
    hil_sim.args(args).env(ELF_VARIABLE, elf).envs(NO_ADB);
    let status = hil_sim.status();
    let status = status.with_context(|| format!("cannot start `{}`", typed(&hil_sim)))?;
    if !status.success() {
        bail!("`{}` failed ({status})", typed(&hil_sim));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_names_the_command_as_typed_its_last_lines_and_its_log() {
        let script = "(seq 1000; echo broken) >&2; exit 3";
        let error = run(command("sh").args(["-c", script]).env("A", "b c")).unwrap_err();
        let error = error.to_string();
        assert!(
            error.starts_with(
                "`A='b c' sh -c '(seq 1000; echo broken) >&2; exit 3'` failed (exit status: 3)"
            ),
            "{error}"
        );
        assert!(
            error.contains("\n    1000") && error.contains("\n    broken"),
            "{error}"
        );
        assert!(!error.contains("\n    900\n"), "{error}");
        let (_, log) = error.split_once("all of them: ").unwrap();
        assert!(
            fs::read_to_string(log).unwrap().starts_with("1\n2\n"),
            "{log}"
        );
    }

    #[test]
    fn a_command_is_shown_without_the_variables_that_are_taken_from_it() {
        let mut cargo = command("/toolchain/bin/cargo");
        cargo
            .args(["build", "-p", "it's"])
            .current_dir(root().join("firmware"));
        assert_eq!(typed(&cargo), r"cd firmware && cargo build -p 'it'\''s'");
    }
}
