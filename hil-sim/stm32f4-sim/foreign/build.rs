//! Puts the memory layout where the linker finds it.

use std::env;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let memory = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../memory.x");
    println!("cargo:rerun-if-changed={}", memory.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let out = env::var("OUT_DIR")?;
        std::fs::copy(&memory, Path::new(&out).join("memory.x"))?;
        println!("cargo:rustc-link-search={out}");
        println!("cargo:rustc-link-arg-bins=--nmagic");
        println!("cargo:rustc-link-arg-bins=-Tlink.x");
    }
    Ok(())
}
