//! Programs of others on the chip, and what the chip does not know.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod foreign_hal;
mod qemu;

use std::path::PathBuf;

/// The ELF of a program in `foreign/`, which `cargo xtask test` builds.
fn foreign_elf(name: &str) -> PathBuf {
    // target/<profile>/deps/<test>
    let test = std::env::current_exe().unwrap();
    let target = test.ancestors().nth(3).unwrap();
    let elf = target
        .join("bare-metal/thumbv7em-none-eabihf/release")
        .join(name);
    assert!(
        elf.is_file(),
        "{} is missing: run this test through `cargo xtask test`, which builds it",
        elf.display()
    );
    elf
}
