//! Child processes: cargo and the programs that it built.

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// How many tests of a program run at once.
const TEST_THREADS: &str = "RUST_TEST_THREADS";

/// Where `adb` looks for its server (the program itself asks for the port alone, on this
/// computer): where none is, and none is started,
/// which `adb` does only on a `localhost` by that name. So tests and simulated rigs leave
/// alone a phone that the developer's own server has, and leave no server behind.
const NO_ADB: [(&str, &str); 2] = [
    ("ANDROID_ADB_SERVER_ADDRESS", "127.0.0.1"),
    ("ANDROID_ADB_SERVER_PORT", "9"),
];

/// Tells tests and tools which firmware to run.
pub(crate) const ELF_VARIABLE: &str = "SMARTDEPTHSYNC_FIRMWARE_ELF";

/// The root of the workspace.
pub(crate) fn root() -> PathBuf {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().unwrap_or(manifest).to_path_buf()
}

/// Cargo's target folder, with `CARGO_TARGET_DIR` respected.
pub(crate) fn target_dir() -> PathBuf {
    // From the root, unless it is absolute.
    root().join(env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()))
}

/// An empty folder of this name in cargo's target folder.
pub(crate) fn fresh_folder(name: &str) -> Result<PathBuf> {
    let place = target_dir().join(name);
    if place.exists() {
        fs::remove_dir_all(&place).with_context(|| format!("cannot empty {}", place.display()))?;
    }
    fs::create_dir_all(&place).with_context(|| format!("cannot make {}", place.display()))?;
    Ok(place)
}

/// All files below a folder, but for what cargo makes.
pub(crate) fn files_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let entries = fs::read_dir(folder);
    for entry in entries.with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if !path.is_dir() {
            files.push(path);
        } else if path.file_name().is_some_and(|name| name != "target") {
            files.append(&mut files_below(&path)?);
        }
    }
    Ok(files)
}

/// A command at the root of the workspace, without the variables that the
/// cargo that started us has set for us alone.
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

/// Options of the compiler that leave this computer's folders out of what it makes.
pub(crate) fn remapped() -> [String; 2] {
    let cargo = env::var_os("CARGO_HOME").map_or_else(
        || PathBuf::from(env::var_os("HOME").unwrap_or_default()).join(".cargo"),
        PathBuf::from,
    );
    [(root(), "/smartdepthsync"), (cargo, "/cargo")]
        .map(|(from, to)| format!("--remap-path-prefix={}={to}", from.display()))
}

/// The cargo that started us, or the one on the path.
pub(crate) fn cargo_program() -> PathBuf {
    env::var_os("CARGO").map_or_else(|| PathBuf::from("cargo"), PathBuf::from)
}

/// Runs to the end and fails with the command line if the child does.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let line = format!("{command:?}");
    let status = command
        .status()
        .with_context(|| format!("cannot start {line}"))?;
    if !status.success() {
        bail!("{status} from {line}");
    }
    Ok(())
}

/// What a program prints, without the end of its last line.
pub(crate) fn text(command: &mut Command) -> Result<String> {
    let output = command
        .output()
        .with_context(|| format!("cannot start {command:?}"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("{} from {command:?}: {}", output.status, said.trim());
    }
    Ok(String::from_utf8(output.stdout)?.trim_end().to_owned())
}

/// Whether a program runs and answers with success.
pub(crate) fn answers(program: impl AsRef<OsStr>, args: &[&str]) -> bool {
    Command::new(program)
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Runs cargo at the root.
pub(crate) fn cargo<I: IntoIterator<Item = S>, S: AsRef<OsStr>>(args: I) -> Result<()> {
    run(command(cargo_program()).args(args))
}

/// Runs cargo with the firmware's ELF named in the environment. Of tests, two run on a
/// core unless the environment says otherwise: most sessions wait for the clock.
pub(crate) fn cargo_with_elf<S: AsRef<OsStr>>(args: &[S], elf: &Path) -> Result<()> {
    let mut cargo = command(cargo_program());
    if env::var_os(TEST_THREADS).is_none() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        cargo.env(TEST_THREADS, (2 * cores).to_string());
    }
    run(cargo.args(args).env(ELF_VARIABLE, elf).envs(NO_ADB))
}

/// A program that cargo has built in the release profile.
pub(crate) fn program(name: impl AsRef<Path>) -> PathBuf {
    target_dir().join("release").join(name)
}

/// Builds the host tool and the simulator, with the features of the whole workspace: so have
/// the tests, and no crate of the host is compiled twice.
pub(crate) fn build_programs() -> Result<()> {
    cargo("build --release --workspace --bin smartdepthsync --bin hil-sim".split(' '))
}

/// Runs the simulator that cargo has built in the release profile.
pub(crate) fn hil_sim<S: AsRef<OsStr>>(args: &[S], elf: &Path) -> Result<()> {
    run(command(program("hil-sim"))
        .args(args)
        .env(ELF_VARIABLE, elf)
        .envs(NO_ADB))
}
