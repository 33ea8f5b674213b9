//! Puts the memory layout where the linker finds it, and the git revision into
//! the environment of the compiler.

use std::env;
use std::error::Error;
use std::path::Path;
use std::process::Command;

fn main() -> Result<(), Box<dyn Error>> {
    let out = env::var("OUT_DIR")?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");

    let memory = root.join("memory.x");
    println!("cargo:rerun-if-changed={}", memory.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // The linker looks at the root first, and there it is: this is for those that do not.
        std::fs::copy(&memory, Path::new(&out).join("memory.x"))?;
        println!("cargo:rustc-link-search={out}");
        println!("cargo:rustc-link-arg-bins=--nmagic");
        // What another chip has otherwise.
        if env::var_os("CARGO_FEATURE_BLACK_PILL").is_some() {
            let board = root.join("firmware/memory/black-pill.x");
            println!("cargo:rustc-link-arg-bins=-T{}", board.display());
        }
        println!("cargo:rustc-link-arg-bins=-Tlink.x");
        let checks = root.join("firmware/memory/checks.x");
        println!("cargo:rustc-link-arg-bins=-T{}", checks.display());
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }

    // The dirty flag is that of the moment when this script last ran: after a
    // commit, after staging, and after any change of the firmware's sources.
    for path in ["firmware", "protocol/src", "Cargo.lock"] {
        println!("cargo:rerun-if-changed={}", root.join(path).display());
    }
    for name in ["HEAD", "index"] {
        if let Some(path) = git(&root, &["rev-parse", "--git-path", name]) {
            println!("cargo:rerun-if-changed={}", root.join(path).display());
        }
    }
    let revision = git(&root, &["rev-parse", "--short=12", "HEAD"]).unwrap_or_default();
    // Without locks git leaves the index as it is, which would have this run again.
    let status = [
        "--no-optional-locks",
        "status",
        "--porcelain",
        "--untracked-files=no",
    ];
    let dirty = git(&root, &status).is_some_and(|status| !status.is_empty());
    let board = match env::var_os("CARGO_FEATURE_BLACK_PILL") {
        Some(_) => "black-pill",
        None => "discovery",
    };
    let version = env::var("CARGO_PKG_VERSION")?;
    println!("cargo:rustc-env=IMAGE=SmartDepthSync image;{board};{version};{revision};");
    println!("cargo:rustc-env=GIT_REVISION={revision}");
    println!("cargo:rustc-env=GIT_DIRTY={}", u8::from(dirty));
    Ok(())
}

/// Output of a git command, or nothing where there is no git or no repository.
fn git(root: &Path, args: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .arg("-C")
        .arg(root)
        .args(args)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
