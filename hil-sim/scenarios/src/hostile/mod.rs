//! The hostile campaign: valid recordings with absurd values in them, through whole
//! commands.
//!
//! One run is one seed: one of the [`Command`]s, a fresh copy of the
//! [`material`], and one to four [mutations](mutate) of what that command reads. They
//! keep the files' structure (checksums, JSON, lengths), so that the values get past the
//! parsers, which have fuzz targets of their own.
//!
//! The program runs in limits ([`limits`]): address space, time of the processor, size of
//! a file, time on the clock. Judged: it ends by itself, with an exit code that the
//! documents have, without a panic, and opens, makes, changes or removes nothing outside of
//! its folder but what the system has for reading ([`opens`], by `strace`). The names in the
//! mutations lead to a bait beside the folder.

pub mod bag;
pub mod limits;
pub mod material;
mod mutate;
mod opens;

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, Result};

use crate::programs::is_documented;
use crate::workers;
use material::Material;
use mutate::Draw;
use rig::random::{Seed, Stream};

/// Runs beside each other.
const BESIDE: usize = 2;

/// The commands that read files of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Command {
    /// `extract`, in any format.
    Extract,
    /// `extract` of a ROS 1 bag of the published system.
    Bag,
    /// `offset` of two gyroscope files.
    Offset,
    /// `sync` of a ROS 2 bag in sqlite3 and of the phone's file.
    Sync,
    /// `verify`.
    Verify,
    /// `repair`.
    Repair,
    /// `report`.
    Report,
    /// `evaluate precision`.
    Evaluate,
    /// `profile learn`.
    Learn,
    /// `profile check`.
    Check,
}

impl Command {
    /// All of them, those with the most to read more often.
    const DRAWN: [Self; 18] = [
        Self::Extract,
        Self::Extract,
        Self::Extract,
        Self::Extract,
        Self::Bag,
        Self::Bag,
        Self::Offset,
        Self::Offset,
        Self::Offset,
        Self::Sync,
        Self::Sync,
        Self::Verify,
        Self::Verify,
        Self::Repair,
        Self::Report,
        Self::Evaluate,
        Self::Learn,
        Self::Check,
    ];
}

/// A run that passed.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The command.
    pub command: Command,
    /// Its exit code.
    pub exit_code: i32,
    /// Most memory that it held at a time, bytes.
    pub peak: u64,
    /// How long it took.
    pub took: Duration,
}

/// A run that did not pass.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The seed.
    pub seed: u64,
    /// The command.
    pub command: Command,
    /// What was mutated.
    pub mutations: Vec<String>,
    /// What was wrong.
    pub what: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let how = self.mutations.join("; ");
        write!(
            f,
            "seed {}: {:?}: {} ({how})",
            self.seed, self.command, self.what
        )
    }
}

/// What came of a campaign.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Runs that passed.
    pub passed: Vec<Verdict>,
    /// Runs that did not.
    pub failed: Vec<Finding>,
}

impl Outcome {
    /// Of each command: runs, exit codes, most memory, longest time.
    #[must_use]
    pub fn by_command(&self) -> BTreeMap<Command, (usize, BTreeMap<i32, u32>, u64, Duration)> {
        let mut table = BTreeMap::new();
        for verdict in &self.passed {
            let (runs, codes, peak, took): &mut (usize, BTreeMap<i32, u32>, u64, Duration) =
                table.entry(verdict.command).or_default();
            *runs += 1;
            *codes.entry(verdict.exit_code).or_default() += 1;
            *peak = (*peak).max(verdict.peak);
            *took = (*took).max(verdict.took);
        }
        table
    }
}

/// Runs seeds, two at a time, and tells of each as it ends.
///
/// # Errors
///
/// The material cannot be made, or a run cannot be set up.
pub fn campaign(
    program: &Path,
    seeds: &[u64],
    each: &(dyn Fn(u64, &Result<Verdict, Finding>) + Sync),
) -> Result<Outcome> {
    let folder = tempfile::tempdir().context("no temporary folder")?;
    // As the kernel names it.
    let place = folder
        .path()
        .canonicalize()
        .context("no temporary folder")?;
    let program = &program.canonicalize().context("finding the program")?;
    let material = Material::make(&place.join("material"))?;
    let results: Vec<Result<_>> = workers::each(seeds, BESIDE, |&seed| {
        let root = place.join(format!("seed-{seed}"));
        let result = run(seed, program, &material, &root)?;
        each(seed, &result);
        std::fs::remove_dir_all(&root).context("removing a run's folder")?;
        Ok(result)
    });
    let mut outcome = Outcome::default();
    for result in results {
        match result? {
            Ok(verdict) => outcome.passed.push(verdict),
            Err(finding) => outcome.failed.push(finding),
        }
    }
    Ok(outcome)
}

fn run(
    seed: u64,
    program: &Path,
    material: &Material,
    root: &Path,
) -> Result<Result<Verdict, Finding>> {
    let mut draw = Draw::new(Seed(seed).stream(Stream::Test), root);
    let command = *draw.one_of(&Command::DRAWN);
    material.copy_to(root)?;
    let files = material::Files::in_folder(root);
    let count = draw.below(4) + 1;
    let mutations: Vec<String> = (0..count)
        .map(|_| mutate::mutate(&mut draw, command, &files))
        .collect::<Result<_>>()?;
    let arguments = arguments(&mut draw, command, &files);
    let ended = limits::run(program, &arguments, &files.work, root)?;
    let finding = |what: String| {
        Ok(Err(Finding {
            seed,
            command,
            mutations: mutations.clone(),
            what,
        }))
    };
    let said: String = ended.said.chars().take(2_000).collect();
    if !ended.strays.is_empty() {
        let strays = ended.strays.join(", ");
        return finding(format!("opened outside of its folder: {strays}"));
    }
    let Some(code) = ended.code else {
        return finding(format!(
            "{}, after {:.1?} with {} MB: {said}",
            ended.how,
            ended.took,
            ended.peak / 1_000_000
        ));
    };
    if !is_documented(code) || said.contains("panicked") {
        return finding(format!("exit code {code}: {said}"));
    }
    Ok(Ok(Verdict {
        command,
        exit_code: code,
        peak: ended.peak,
        took: ended.took,
    }))
}

fn arguments(draw: &mut Draw<'_>, command: Command, files: &material::Files) -> Vec<OsString> {
    let words = |words: &[&dyn AsRef<OsStr>]| {
        let words = words.iter().map(|word| word.as_ref().to_owned());
        words.collect::<Vec<OsString>>()
    };
    let (recording, out) = (&files.recording, &files.work.join("out"));
    let formats = ["euroc", "tum", "topics"];
    match command {
        Command::Extract => {
            let format = draw.one_of(&formats);
            words(&[&"extract", &"--format", format, &"--out", out, recording])
        }
        Command::Bag => {
            let format = draw.one_of(&formats);
            let mut all = words(&[&"extract", &"--format", format, &"--exposure-us", &"4000"]);
            all.extend(words(&[
                &"--readout-us",
                &"11006",
                &"--out",
                out,
                &files.bag,
            ]));
            all.extend(words(&[&"--phone", recording]));
            all
        }
        Command::Offset => words(&[
            &"offset",
            &"--mcu",
            &files.board_csv,
            &"--phone",
            &files.phone_csv,
        ]),
        Command::Sync => words(&[
            &"sync",
            &"--write",
            out,
            &files.sqlite_bag,
            &files.phone_csv,
        ]),
        Command::Verify => words(&[&"verify", recording]),
        Command::Repair => words(&[&"repair", recording, out]),
        Command::Report => words(&[&"report", recording]),
        Command::Evaluate => words(&[&"evaluate", &"precision", &files.video]),
        Command::Learn => words(&[
            &"profile",
            &"learn",
            recording,
            &"--profile",
            &files.profile,
            &"--timestamps",
            &files.timestamps,
        ]),
        Command::Check => words(&[&"profile", &"check", &files.profile]),
    }
}
