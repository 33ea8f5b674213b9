//! The files of a release, in `target/dist`: made from the commit that is checked out, with the
//! same bytes in any folder, and tried on a Debian without Rust.
//!
//! The programs are linked statically (musl), so that one build for each processor serves the Debian
//! package and the archive on any Linux.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::image::{dfu_image, raw_image};
use crate::{dependencies, docs, firmware, process, tools, wheel};

const NAME: &str = "smartdepthsync";
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Rust's and Debian's names of the processors.
const PROCESSORS: [(&str, &str); 2] = [("x86_64", "amd64"), ("aarch64", "arm64")];

/// Debian on which the release is tried, and its only packages.
const SUITE: &str = "bookworm";
const DEBIAN: &str = "ffmpeg,python3-numpy,python3-pil,python3-pip";

/// Makes the release and tries it.
pub(crate) fn make() -> Result<()> {
    let git = |args: &[&str]| process::text(process::command("git").args(args));
    if !git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty() {
        bail!(
            "there are uncommitted changes, and a release is made from a commit; commit them first"
        );
    }
    let revision = git(&["rev-parse", "--short=12", "HEAD"])?;
    let release = Release {
        dist: process::fresh_folder("dist")?,
        epoch: git(&["log", "-1", "--format=%ct"])?,
        python: tools::ensure_release()?,
    };
    let usr = process::fresh_folder("release-tree")?.join("usr");
    let share = usr.join("share").join(NAME);
    release.firmware(&revision, &share.join("firmware"))?;
    firmware::build_agent()?;
    for agent in firmware::agents() {
        install(&agent, &share.join("phone-agent"))?;
    }
    let rule = process::root().join("host/live/udev/60-smartdepthsync.rules");
    install(&rule, &usr.join("lib/udev/rules.d"))?;
    let documents = usr.join("share/doc").join(NAME);
    for file in ["LICENSE-MIT", "LICENSE-APACHE", "NOTICE", "CHANGELOG.md"] {
        install(&process::root().join(file), &documents)?;
    }
    install(&release.inventory()?, &documents)?;

    // First the programs for this computer, which write the files for all processors.
    let own = release.programs(std::env::consts::ARCH)?;
    write_completions_and_manual(&own.join(NAME), &usr.join("share"))?;
    install(
        &docs::pages(Some(&own.join(NAME)), "release-book/book")?,
        &documents,
    )?;
    for (rust, debian) in PROCESSORS {
        let folder = release.programs(rust)?;
        for program in [NAME, "hil-sim"] {
            install(&folder.join(program), &usr.join("bin"))?;
        }
        release.pack(&usr, debian)?;
        release.wheel(rust)?;
    }
    let mut data = wheel::data_package(&release.python, &release.dist);
    process::run(release.reproducibly(&mut data).arg("--no-build-isolation"))?;
    let compiler = process::text(process::command("rustc").arg("-vV"))?;
    fs::write(release.dist.join("TOOLCHAIN"), compiler + "\n")?;
    let sums = "export LC_ALL=C; sha256sum -- * >SHA256SUMS";
    process::run(
        process::command("sh")
            .args(["-c", sums])
            .current_dir(&release.dist),
    )?;
    release.try_it()?;
    println!("the release: {}", release.dist.display());
    Ok(())
}

struct Release {
    /// Folder of its files.
    dist: PathBuf,
    /// Time of the commit, which all files have, seconds since 1970.
    epoch: String,
    /// Python of the environment with the tools from PyPI.
    python: PathBuf,
}

impl Release {
    /// Makes a build independent of its folder and time.
    fn reproducibly<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        let folder = self.python.parent().unwrap_or(&self.python);
        let path = std::env::var("PATH").unwrap_or_default();
        command
            .env("PATH", format!("{}:{path}", folder.display()))
            .env("SOURCE_DATE_EPOCH", &self.epoch)
            .env("CARGO_PROFILE_RELEASE_STRIP", "debuginfo")
            .env("CARGO_ENCODED_RUSTFLAGS", process::remapped().join("\x1f"))
    }

    /// Adds the ELF, raw image and DFU image of each board, also to `folder`.
    fn firmware(&self, revision: &str, folder: &Path) -> Result<()> {
        let black_pill = firmware::build_black_pill()?;
        for (elf, key) in [
            (black_pill, "black-pill"),
            (firmware::build()?, "discovery"),
        ] {
            let image = raw_image(&elf)?;
            let mark = format!("{key};{VERSION};{revision};");
            if !image.windows(mark.len()).any(|at| at == mark.as_bytes()) {
                bail!("the firmware of {key} does not contain {mark:?}");
            }
            let to = self.dist.join(format!("{NAME}-firmware-{key}.elf"));
            fs::copy(&elf, &to)?;
            fs::write(to.with_extension("bin"), image)?;
            fs::write(to.with_extension("dfu"), dfu_image(&elf)?)?;
            for ending in ["elf", "bin", "dfu"] {
                install(&to.with_extension(ending), folder)?;
            }
        }
        Ok(())
    }

    /// Adds the bills of materials and the licences of all that is linked into the programs, the
    /// firmware and the wheel. Returns the file of the licences.
    fn inventory(&self) -> Result<PathBuf> {
        let cyclonedx = tools::ensure_cargo_tool("cargo-cyclonedx", "0.5.9", &[])?;
        let about = tools::ensure_cargo_tool("cargo-about", "0.9.3", &["--features", "cli"])?;
        // Leaves a file beside each manifest, in which the names of our crates contain the folder.
        let args = "cyclonedx --quiet --format json --target all --override-filename release-bom";
        let mut command = process::command(cyclonedx);
        process::run(self.reproducibly(&mut command).args(args.split(' ')))?;
        let root = process::root();
        for (folder, part) in [
            ("host/cli", NAME),
            ("hil-sim/scenarios", "hil-sim"),
            ("host/sync/twist-sync-python", "twist-sync"),
            ("firmware", "smartdepthsync-firmware"),
        ] {
            let bom = process::read(&root.join(folder).join("release-bom.json"))?;
            let bom = bom.replace(&*root.to_string_lossy(), "");
            fs::write(self.dist.join(format!("{part}.cdx.json")), bom)?;
        }
        for file in process::files_below(&root, "release-bom.json")? {
            fs::remove_file(&file)?;
        }
        let config = process::target_dir().join("about.toml");
        // Each crate has its licences in its top folder; searching below it takes minutes.
        let settings = format!(
            "accepted = [{}]\nmax-depth = 1\nignore-dev-dependencies = true\ntargets = [\
             \"x86_64-unknown-linux-musl\", \"aarch64-unknown-linux-musl\", \"thumbv7em-none-eabihf\"]\n",
            dependencies::allowed()?,
        );
        fs::write(&config, settings)?;
        let licences = self.dist.join("LICENCES.txt");
        let args = "generate --workspace --frozen --fail --config".split(' ');
        let mut command = process::command(about);
        command.args(args).arg(&config).arg("--output-file");
        process::run(command.arg(&licences).arg("xtask/licences.hbs"))?;
        Ok(licences)
    }

    /// Builds the programs and returns their folder.
    fn programs(&self, processor: &str) -> Result<PathBuf> {
        let target = format!("{processor}-unknown-linux-musl");
        tools::ensure_target(&target)?;
        let args = "zigbuild --release --locked --workspace --bin smartdepthsync --bin hil-sim";
        let mut cargo = process::command(process::cargo_program());
        self.reproducibly(&mut cargo).args(args.split(' '));
        process::run(cargo.args(["--target", &target]))?;
        Ok(process::target_dir().join(target).join("release"))
    }

    /// Adds the wheel of `twist-sync` for a processor.
    fn wheel(&self, processor: &str) -> Result<()> {
        let target = format!("{processor}-unknown-linux-gnu");
        tools::ensure_target(&target)?;
        let mut maturin = wheel::maturin(&self.python, &self.dist);
        self.reproducibly(&mut maturin);
        process::run(maturin.args(["--zig", "--target", &target]))
    }

    /// Makes the archive and the Debian package of the tree `usr`.
    fn pack(&self, usr: &Path, architecture: &str) -> Result<()> {
        let tree = usr.parent().context("a tree without a folder")?;
        let mut modes = process::command("chmod");
        process::run(modes.args(["-R", "u=rwX,go=rX"]).arg(tree))?;
        let name = format!("{NAME}-{VERSION}-linux-{architecture}");
        let archive = self.dist.join(format!("{name}.tar.gz"));
        process::run(
            process::command("tar")
                .args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner"])
                .arg(format!("--mtime=@{}", self.epoch))
                .arg(format!("--transform=s,^usr,{name},"))
                .args(["--use-compress-program", "gzip -9n", "--create", "--file"])
                .arg(archive)
                .arg("--directory")
                .arg(tree)
                .arg("usr"),
        )?;
        let control = process::read(&process::root().join("xtask/debian-control"))?
            .replace("VERSION", VERSION)
            .replace("ARCHITECTURE", architecture);
        fs::create_dir_all(tree.join("DEBIAN"))?;
        fs::write(tree.join("DEBIAN/control"), control)?;
        let package = self
            .dist
            .join(format!("{NAME}_{VERSION}_{architecture}.deb"));
        process::run(
            process::command("dpkg-deb")
                .env("SOURCE_DATE_EPOCH", &self.epoch)
                // More threads would split the data at other places.
                .env("DPKG_DEB_THREADS_MAX", "1")
                .args(["--root-owner-group", "--build"])
                .arg(tree)
                .arg(package),
        )
    }

    /// Tries the release for this computer's processor on a bare Debian, and starts the programs
    /// for the other processor.
    fn try_it(&self) -> Result<()> {
        for (rust, debian) in PROCESSORS {
            if rust == std::env::consts::ARCH {
                tools::ensure_program("mmdebstrap", "mmdebstrap")?;
                let inside = format!("chroot \"$1\" sh -eux /dist/try_release.sh {debian}");
                let script = process::root().join("xtask/try_release.sh");
                let (dist, script) = (self.dist.display(), script.display());
                process::run(
                    process::command("mmdebstrap")
                        .args(["--variant=apt", "--format=null"])
                        .arg(format!("--include={DEBIAN}"))
                        .arg(format!("--customize-hook=copy-in {dist} /"))
                        .arg(format!("--customize-hook=copy-in {script} /dist"))
                        .arg(format!("--customize-hook={inside}"))
                        .args([SUITE, "-"]),
                )?;
            } else {
                let emulator = format!("qemu-{rust}");
                tools::ensure_program(&emulator, "qemu-user")?;
                let root = process::fresh_folder("release-root")?;
                let package = self.dist.join(format!("{NAME}_{VERSION}_{debian}.deb"));
                let mut unpack = process::command("dpkg-deb");
                process::run(unpack.arg("--extract").arg(package).arg(&root))?;
                for program in [NAME, "hil-sim"] {
                    let program = root.join("usr/bin").join(program);
                    process::run(process::command(&emulator).arg(program).arg("--version"))?;
                }
            }
        }
        Ok(())
    }
}

/// Writes the shell completions and manual pages that the program prints.
fn write_completions_and_manual(program: &Path, share: &Path) -> Result<()> {
    for (shell, place) in [
        ("bash", "bash-completion/completions/smartdepthsync"),
        ("zsh", "zsh/vendor-completions/_smartdepthsync"),
        ("fish", "fish/vendor_completions.d/smartdepthsync.fish"),
    ] {
        let script = process::text(Command::new(program).args(["completions", shell]))?;
        let place = share.join(place);
        fs::create_dir_all(place.parent().context("a file without a folder")?)?;
        fs::write(place, script + "\n")?;
    }
    let man = share.join("man/man1");
    process::run(process::command(program).arg("man").arg(&man))?;
    process::run(
        process::command("gzip")
            .args(["-9n", "--recursive"])
            .arg(&man),
    )
}

/// Copies a file or folder into a folder.
fn install(from: &Path, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    process::run(process::command("cp").arg("-r").arg(from).arg(folder))
}
