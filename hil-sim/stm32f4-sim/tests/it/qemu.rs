//! The core against QEMU's Cortex-M4: the same random instructions from the same random
//! states, and every bit of what they leave must be the same.
//!
//! An image holds some hundred cases. Each loads all registers, runs about ten
//! instructions, and appends all registers to the records; loads and stores go to a
//! scratch memory, exceptions write a log. QEMU hands its memory over by semihosting.

mod encodings;
mod frame;
mod image;
mod program;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

use stm32f4_sim::random::Seed;
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::SimDuration;
use test_support::processes::is_installed;

use image::{CASES, DONE, FAULT, LOG, RECORD_WORDS, RECORDS, SCRATCH, SRAM};
use program::{Case, case};

/// Seed of the noise of every image: each case finds the same scratch memory when run alone.
const NOISE_SEED: Seed = Seed(7);

/// A Cortex-M4F with 128 kB of SRAM and its flash where the STM32F407 has them.
const MACHINE: &str = "netduinoplus2";

/// The SRAM as a core left it.
struct Left(Vec<u8>);

impl Left {
    fn word(&self, at: u32) -> u32 {
        let at = (at - SRAM.start) as usize;
        u32::from_le_bytes(self.0[at..at + 4].try_into().unwrap())
    }

    fn record(&self, n: usize) -> Vec<u32> {
        let from = RECORDS.start + (n * RECORD_WORDS * 4) as u32;
        (0..RECORD_WORDS as u32)
            .map(|k| self.word(from + k * 4))
            .collect()
    }
}

fn noise() -> Vec<u8> {
    let mut noise = vec![0; SCRATCH.len()];
    NOISE_SEED.stream(0u64).fill(&mut noise);
    noise
}

/// The cases on QEMU.
fn on_qemu(folder: &Path, cases: &[Case], process_stack: bool) -> Left {
    let (elf, memory) = (folder.join("qemu.elf"), folder.join("sram"));
    let name = memory.to_str().unwrap();
    fs::write(&elf, image::elf(cases, &noise(), process_stack, Some(name))).unwrap();
    let run = Command::new("qemu-system-arm")
        .args([
            "-M",
            MACHINE,
            "-nographic",
            "-monitor",
            "none",
            "-serial",
            "none",
        ])
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(&elf)
        .output()
        .unwrap();
    let memory = fs::read(&memory).unwrap_or_else(|e| {
        panic!(
            "QEMU left no memory: {e}; {}",
            String::from_utf8_lossy(&run.stderr)
        )
    });
    Left(memory)
}

/// The cases on our core.
fn on_ours(folder: &Path, cases: &[Case], process_stack: bool) -> Result<Left, String> {
    let elf = folder.join("ours.elf");
    fs::write(&elf, image::elf(cases, &noise(), process_stack, None)).unwrap();
    let mut sim = Sim::builder(&elf).plugged(false).build().unwrap();
    let done = |sim: &mut Sim| {
        sim.peek(DONE, 4)
            .is_some_and(|word| word == 1u32.to_le_bytes())
    };
    let ended = sim.run_until(SimDuration::from_secs(10), done);
    if !ended.map_err(|e| e.to_string())? {
        return Err("the program does not end".into());
    }
    let left = Left(sim.peek(SRAM.start, SRAM.len()).unwrap());
    match (left.word(FAULT), left.word(FAULT + 4)) {
        (0, 0) => Ok(left),
        (cfsr, pc) => Err(format!("fault with CFSR {cfsr:#x} at {pc:#x}")),
    }
}

/// Returns the difference, if there is one.
fn difference(folder: &Path, cases: &[Case], process_stack: bool) -> Option<(usize, String)> {
    let theirs = on_qemu(folder, cases, process_stack);
    assert_eq!(
        (theirs.word(FAULT), theirs.word(FAULT + 4)),
        (0, 0),
        "QEMU took a fault (CFSR, program counter)"
    );
    let ours = match on_ours(folder, cases, process_stack) {
        Ok(ours) => ours,
        Err(why) => return Some((usize::MAX, why)),
    };
    for n in 0..cases.len() {
        let (got, expected) = (ours.record(n), theirs.record(n));
        if got != expected {
            let mut text = String::new();
            let both = got.iter().zip(&expected).enumerate();
            for (k, (got, expected)) in both {
                if got != expected {
                    write!(
                        text,
                        "{} is {got:#010x}, on QEMU {expected:#010x}; ",
                        name(k)
                    )
                    .unwrap();
                }
            }
            return Some((n, text));
        }
    }
    for at in (SCRATCH.start..LOG.end).step_by(4) {
        let (got, expected) = (ours.word(at), theirs.word(at));
        if got != expected {
            let text = format!("memory at {at:#x} is {got:#010x}, on QEMU {expected:#010x}");
            return Some((usize::MAX, text));
        }
    }
    None
}

/// The register of a word of a record.
fn name(word: usize) -> String {
    match word {
        0 => "APSR".into(),
        1 => "FPSCR".into(),
        2..=33 => format!("S{}", word - 2),
        34..=46 => format!("R{}", word - 34),
        47 => "LR".into(),
        _ => "SP".into(),
    }
}

/// Runs a case's beginnings, each one instruction longer, and says which is the first
/// that differs.
fn explain(folder: &Path, whole: &Case, process_stack: bool) -> String {
    let beginnings: Vec<Case> = (1..=whole.units.len())
        .map(|length| Case {
            units: whole.units[..length].to_vec(),
            ..whole.clone()
        })
        .collect();
    let Some((n, what)) = difference(folder, &beginnings, process_stack) else {
        let code: Vec<_> = whole.units.iter().map(|unit| &unit.code).collect();
        return format!("not alone; the case is {code:04x?}");
    };
    let n = n.min(whole.units.len() - 1);
    let code = |n: usize| &whole.units[n].code;
    let before: Vec<_> = (0..n).map(code).collect();
    format!(
        "after {} {:04x?}: {what}\nbefore it {:04x?}\nfrom S0 to S31, FPSCR, APSR, R0 to R12, LR {:08x?}",
        whole.units[n].what,
        code(n),
        before,
        whole.state
    )
}

/// Runs images by seed until `instructions` have been compared.
fn compare(first_seed: u64, instructions: usize) {
    let folder = tempfile::tempdir().unwrap();
    let mut compared = 0;
    let mut seed = first_seed;
    while compared < instructions {
        let mut random = Seed(seed).stream(1u64);
        let cases: Vec<Case> = (0..CASES).map(|_| case(&mut random)).collect();
        let process_stack = seed % 2 == 1;
        if let Some((n, what)) = difference(folder.path(), &cases, process_stack) {
            let more = match cases.get(n) {
                Some(case) => explain(folder.path(), case, process_stack),
                None => String::new(),
            };
            panic!("seed {seed}, case {n}: {what}\n{more}");
        }
        compared += cases.iter().map(|case| case.instructions).sum::<usize>();
        seed += 1;
    }
    println!("{compared} instructions are the same on QEMU");
}

#[test]
fn instructions_have_the_same_results_as_on_qemu() {
    if !is_installed("qemu-system-arm", "qemu-system-arm") {
        return;
    }
    compare(1, 150_000);
}
