//! The Debian package: host tool, manual pages, completions, udev rule, and the
//! firmware as ELF and raw image with their hashes. Installed into a root of its
//! own and tried there.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::image::{FLASH, dfu_image, raw_image};
use crate::process;
use anyhow::{Context, Result, bail};

/// Name of the package and of the program.
const NAME: &str = "smartdepthsync";

/// Builds `target/package/smartdepthsync_<version>_<arch>.deb` from what was built,
/// and tries it. `elves` are the firmware's, one a board.
pub(crate) fn build(elves: &[PathBuf]) -> Result<()> {
    let program = process::program(NAME);
    let base = process::fresh_folder("package")?;
    let tree = base.join("tree");
    let version = env!("CARGO_PKG_VERSION");
    let arch = process::text(Command::new("dpkg").arg("--print-architecture"))
        .context("dpkg is missing: packages are built on Debian")?;

    install(&program, &tree.join("usr/bin").join(NAME), 0o755)?;
    // The package needs no symbols; backtraces keep their names.
    if process::answers("strip", &["--version"]) {
        process::run(
            process::command("strip")
                .arg("--strip-debug")
                .arg(tree.join("usr/bin").join(NAME)),
        )?;
    }
    let rule = "host/udev/60-smartdepthsync.rules";
    install(
        &process::root().join(rule),
        &tree.join("lib/udev/rules.d/60-smartdepthsync.rules"),
        0o644,
    )?;
    for (shell, place) in [
        (
            "bash",
            "usr/share/bash-completion/completions/smartdepthsync",
        ),
        ("zsh", "usr/share/zsh/vendor-completions/_smartdepthsync"),
        (
            "fish",
            "usr/share/fish/vendor_completions.d/smartdepthsync.fish",
        ),
    ] {
        let script = process::text(Command::new(&program).args(["completions", shell]))?;
        write(&tree.join(place), format!("{script}\n").as_bytes())?;
    }
    let man = tree.join("usr/share/man/man1");
    process::run(process::command(&program).arg("man").arg(&man))?;
    for page in fs::read_dir(&man)? {
        process::run(process::command("gzip").arg("-9n").arg(page?.path()))?;
    }
    for name in ["LICENSE-MIT", "LICENSE-APACHE", "NOTICE", "CHANGELOG.md"] {
        install(
            &process::root().join(name),
            &tree.join("usr/share/doc").join(NAME).join(name),
            0o644,
        )?;
    }
    firmware(elves, &tree.join("usr/share").join(NAME).join("firmware"))?;
    let agents = tree.join("usr/share").join(NAME).join("phone-agent");
    for agent in crate::firmware::agents() {
        let name = agent.file_name().context("an agent without a name")?;
        install(&agent, &agents.join(name), 0o644)?;
    }
    control(&tree, version, &arch)?;

    let package = base.join(format!("{NAME}_{version}_{arch}.deb"));
    process::run(
        process::command("dpkg-deb")
            .args(["--root-owner-group", "--build"])
            .arg(&tree)
            .arg(&package),
    )?;
    try_it(&package, &base.join("root"), elves)?;
    println!("the package: {}", package.display());
    Ok(())
}

/// ELF, raw image and image for DFU of each board, and the SHA-256 of all.
fn firmware(elves: &[PathBuf], folder: &Path) -> Result<()> {
    let mut names = Vec::new();
    for elf in elves {
        let [elf_name, raw_name, dfu_name] = file_names(elf)?;
        install(elf, &folder.join(&elf_name), 0o644)?;
        write(&folder.join(&raw_name), &raw_image(elf)?)?;
        write(&folder.join(&dfu_name), &dfu_image(elf)?)?;
        names.extend([elf_name, raw_name, dfu_name]);
    }
    let sums = process::text(Command::new("sha256sum").args(names).current_dir(folder))?;
    write(&folder.join("SHA256SUMS"), format!("{sums}\n").as_bytes())
}

/// What a board's ELF and its images are called in the package.
fn file_names(elf: &Path) -> Result<[String; 3]> {
    let name = elf.file_name().and_then(|name| name.to_str());
    let name = name.context("an ELF without a name")?;
    Ok([".elf", ".bin", ".dfu"].map(|ending| format!("{name}{ending}")))
}

fn control(tree: &Path, version: &str, arch: &str) -> Result<()> {
    let mut size = 0;
    for file in process::files_below(tree)? {
        size += file.metadata()?.len();
    }
    let text = format!(
        "Package: {NAME}\n\
         Version: {version}\n\
         Architecture: {arch}\n\
         Maintainer: SmartDepthSync maintainers <maintainers@example.org>\n\
         Section: science\n\
         Priority: optional\n\
         Depends: libc6, libgcc-s1\n\
         Recommends: ffmpeg, udev, dfu-util\n\
         Installed-Size: {}\n\
         Description: hardware sync of a phone's video with a depth camera\n \
         Host tool of SmartDepthSync: twists, aligns, records, extracts and evaluates.\n \
         With the firmware of its boards, and the rule that gives users the board.\n",
        size / 1024
    );
    write(&tree.join("DEBIAN/control"), text.as_bytes())
}

/// Installs the package into a root of its own, runs the program from there, and
/// removes it again.
fn try_it(package: &Path, root: &Path, elves: &[PathBuf]) -> Result<()> {
    for folder in ["var/lib/dpkg/info", "var/lib/dpkg/updates", "var/log"] {
        fs::create_dir_all(root.join(folder))?;
    }
    write(&root.join("var/lib/dpkg/status"), b"")?;
    let dpkg = |arguments: &[&std::ffi::OsStr]| {
        let mut command = process::command("dpkg");
        command
            .arg(format!("--root={}", root.display()))
            .arg(format!("--log={}", root.join("var/log/dpkg.log").display()))
            .args(["--force-not-root", "--force-depends", "--force-bad-path"])
            .args(arguments);
        process::run(&mut command)
    };
    dpkg(&["--install".as_ref(), package.as_os_str()])?;
    let program = root.join("usr/bin").join(NAME);
    let said = process::text(Command::new(&program).arg("--version"))?;
    if said != format!("{NAME} {}", env!("CARGO_PKG_VERSION")) {
        bail!("the installed program says {said:?}");
    }
    for file in [
        "lib/udev/rules.d/60-smartdepthsync.rules",
        "usr/share/man/man1/smartdepthsync-record.1.gz",
        "usr/share/bash-completion/completions/smartdepthsync",
        "usr/share/doc/smartdepthsync/NOTICE",
        "usr/share/smartdepthsync/phone-agent/smartdepthsync-phone-agent-arm64-v8a",
    ] {
        if !root.join(file).is_file() {
            bail!("{file} is not installed");
        }
    }
    let firmware = root.join("usr/share/smartdepthsync/firmware");
    process::run(
        Command::new("sha256sum")
            .args(["--check", "--strict", "--quiet", "SHA256SUMS"])
            .current_dir(&firmware),
    )?;
    // The first word of an image is the stack's top, in the RAM; the second the
    // reset handler, in the flash.
    for elf in elves {
        let [_, image_name, _] = file_names(elf)?;
        let image = fs::read(firmware.join(&image_name))
            .with_context(|| format!("{image_name} is not installed"))?;
        let word = |at: usize| {
            image
                .get(at..at + 4)
                .and_then(|bytes| bytes.try_into().ok())
                .map_or(0, u32::from_le_bytes)
        };
        let (stack, reset) = (word(0), word(4));
        let in_ram = (0x1000_0000..=0x1001_0000).contains(&stack)
            || (0x2000_0000..=0x2002_0000).contains(&stack);
        if !in_ram || u64::from(reset) >> 20 != FLASH >> 20 {
            bail!("{image_name} begins with {stack:#x} and {reset:#x}: no vector table");
        }
    }
    dpkg(&["--purge".as_ref(), NAME.as_ref()])?;
    if program.exists() {
        bail!("the program is still there after its removal");
    }
    println!(
        "the package was installed, tried and removed in {}",
        root.display()
    );
    Ok(())
}

fn install(from: &Path, to: &Path, mode: u32) -> Result<()> {
    let bytes = fs::read(from).with_context(|| format!("cannot read {}", from.display()))?;
    write(to, &bytes)?;
    fs::set_permissions(to, fs::Permissions::from_mode(mode))?;
    Ok(())
}

fn write(to: &Path, bytes: &[u8]) -> Result<()> {
    let folder = to.parent().context("a file without a folder")?;
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    fs::write(to, bytes).with_context(|| format!("cannot write {}", to.display()))
}
