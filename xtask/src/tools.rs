//! Programs that are not Rust crates: Debian packages, a Python environment,
//! and cargo tools in `target/tools`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::process;

/// Programs that tests run: name, Debian package, purpose, and true if the tests fail without it;
/// without one of the others, tests leave out what needs it.
const TEST_PROGRAMS: [(&str, &str, &str, bool); 7] = [
    ("ffmpeg", "ffmpeg", "reads videos", true),
    (
        "mkvmerge",
        "mkvtoolnix",
        "writes depth recordings again",
        true,
    ),
    ("adb", "adb", "talks to a simulated phone", true),
    ("qemu-aarch64", "qemu-user", "runs the phone's agent", false),
    (
        "qemu-system-arm",
        "qemu-system-arm",
        "checks the simulated core",
        false,
    ),
    ("chromium", "chromium", "shows the reports", false),
    ("tmux", "tmux", "shows the live view", false),
];

/// Makes sure that the programs of [`TEST_PROGRAMS`] are there. Those that tests can do without
/// are installed in CI only.
pub(crate) fn ensure_for_tests() -> Result<()> {
    let is_ci = std::env::var_os("CI").is_some();
    let [mut needed, mut left_out] = [Vec::new(), Vec::new()];
    for (name, package, purpose, is_needed) in TEST_PROGRAMS {
        if !is_there(name) {
            println!("missing: {name}, which {purpose}");
            let packages = if is_needed || is_ci {
                &mut needed
            } else {
                &mut left_out
            };
            packages.push(package);
        }
    }
    if !left_out.is_empty() {
        let packages = left_out.join(" ");
        println!("tests leave out what needs {packages}: `sudo apt-get install` adds it");
    }
    apt_install(&needed)
}

/// Returns true if a program runs, since one that is installed may not work.
fn is_there(program: &str) -> bool {
    let version = match program {
        "ffmpeg" => "-version",
        "tmux" => "-V",
        _ => "--version",
    };
    process::answers(program, &[version])
}

/// Makes sure that `program` is on the path, from a Debian package if need be.
pub(crate) fn ensure_program(program: &str, package: &str) -> Result<()> {
    if is_there(program) {
        return Ok(());
    }
    apt_install(&[package])
}

/// Installs Debian packages as root where there is apt.
pub(crate) fn apt_install(packages: &[&str]) -> Result<()> {
    if packages.is_empty() {
        return Ok(());
    }
    let names = packages.join(" ");
    let is_root = process::text(Command::new("id").arg("-u")).is_ok_and(|id| id == "0");
    if !is_root || !process::answers("apt-get", &["--version"]) {
        bail!("a program is missing; on Debian run `sudo apt-get install {names}`");
    }
    println!("installing Debian packages: {names}");
    let apt = |args: &[&str]| {
        let mut apt = Command::new("apt-get");
        apt.env("DEBIAN_FRONTEND", "noninteractive")
            .stdout(Stdio::null());
        process::run(apt.args(["-q", "-y"]).args(args))
    };
    apt(&["update"])?;
    apt(&[&["install", "--no-install-recommends"], packages].concat())
}

/// Makes sure of the Python environment in `target/venv` with the packages of
/// `xtask/python-requirements.txt`: public readers of the formats that the host writes.
pub(crate) fn ensure_python() -> Result<PathBuf> {
    ensure_environment("venv", "python-requirements.txt")
}

/// Makes sure of the Python environment with the tools that build a release: a C compiler and
/// linker for other processors and systems (Zig), and its callers.
pub(crate) fn ensure_release() -> Result<PathBuf> {
    ensure_environment("release-tools", "release-requirements.txt")
}

/// Makes sure of the readers that are too large for every test run, each in an environment of its
/// own in `target/readers`, since two of them want different versions of one package, and of
/// ROS 1's `rosbag` for Debian's Python.
pub(crate) fn ensure_readers() -> Result<()> {
    for reader in ["open3d", "rerun", "lerobot", "fleet"].map(|name| format!("readers/{name}")) {
        ensure_environment(&reader, &format!("{reader}.txt"))?;
    }
    if process::answers("/usr/bin/python3", &["-c", "import rosbag"]) {
        return Ok(());
    }
    apt_install(&["python3-rosbag"])
}

/// Makes sure of a Python environment in the target folder with the packages that a file in
/// `xtask/` names. It is remade when that file changes.
fn ensure_environment(name: &str, requirements: &str) -> Result<PathBuf> {
    let venv = process::target_dir().join(name);
    let python = venv.join("bin/python3");
    let requirements = process::root().join("xtask").join(requirements);
    let wanted = process::read(&requirements)?;
    let stamp = venv.join("requirements.txt");
    if process::read(&stamp).is_ok_and(|have| have == wanted) && python.is_file() {
        return Ok(python);
    }
    println!("making the Python environment {}", venv.display());
    let make = || {
        process::run(
            process::command("python3")
                .args(["-m", "venv", "--clear"])
                .arg(&venv),
        )
    };
    if make().is_err() {
        apt_install(&["python3", "python3-venv"])?;
        make()?;
    }
    pip_install(&python, &["-r"], &requirements)?;
    fs::write(&stamp, wanted).with_context(|| format!("cannot write {}", stamp.display()))?;
    Ok(python)
}

/// Installs a file, or the packages that it names, into a Python environment.
pub(crate) fn pip_install(python: &Path, options: &[&str], file: &Path) -> Result<()> {
    process::run(
        process::command(python)
            // What is imported is compiled then.
            .args("-m pip install --quiet --disable-pip-version-check --no-compile".split(' '))
            .args(options)
            .arg(file),
    )
}

/// Makes sure that the compiler has the library of a target.
pub(crate) fn ensure_target(target: &str) -> Result<()> {
    let sysroot = process::text(process::command("rustc").args(["--print", "sysroot"]))
        .context("rustc does not print its sysroot; install Rust through rustup")?;
    if Path::new(&format!("{sysroot}/lib/rustlib/{target}/lib")).is_dir() {
        return Ok(());
    }
    process::run(process::command("rustup").args(["target", "add", target]))
        .with_context(|| format!("there is no Rust library for {target}"))
}

/// Returns a cargo tool of exactly this version in `target/tools`, which is built if need be.
pub(crate) fn ensure_cargo_tool(name: &str, version: &str, options: &[&str]) -> Result<PathBuf> {
    let folder = process::target_dir().join(format!("tools/{name}-{version}"));
    let program = folder.join("bin").join(name);
    if !program.is_file() {
        println!("building {name} {version} into {}", folder.display());
        process::run(
            process::command(process::cargo_program())
                .args(["install", "--quiet", "--locked", "--version", version])
                .arg("--root")
                .arg(&folder)
                .args(options)
                .arg(name),
        )?;
    }
    Ok(program)
}
