//! `hil-sim bench`: figures of the simulator and of the firmware in it.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use hil_sim::random::Seed;
use hil_sim::rig::Rig;
use hil_sim::time::SimDuration;

/// Options of `bench`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    #[arg(long)]
    log: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let mut builder = Rig::builder().seed(Seed(1));
    if args.log {
        builder = builder.on_log(|l| println!("{l}"));
    }
    if let Some(elf) = &args.elf {
        builder = builder.elf(elf);
    }
    let mut rig = builder.build()?;
    rig.log_pin(hil_sim::pin::Pin::PA5);
    if !rig.run_until_usb_ready(SimDuration::from_secs(5))? {
        println!("not ready: {:?} {:?}", rig.usb_state(), rig.usb_log());
        bail!("USB");
    }
    println!(
        "{:?} core {:?} mco {:?} {:?}",
        rig.usb_device(),
        rig.core_rate(),
        rig.clock_output(),
        rig.usb_log()
    );
    rig.usb_write(b"hello");
    rig.run_for(SimDuration::from_millis(100))?;
    println!("echo {:?}", String::from_utf8_lossy(&rig.usb_read()));
    println!("now {} edges {:?}", rig.now(), rig.take_edges());
    println!("{:#?}", rig.backtrace());
    let t = Instant::now();
    let s0 = rig.cpu_stats();
    rig.run_for(SimDuration::from_secs(30))?;
    let s = rig.cpu_stats();
    println!(
        "30 s in {:?} awake {} slow {}",
        t.elapsed(),
        s.awake - s0.awake,
        s.slow_steps - s0.slow_steps
    );
    for (n, e) in s.exceptions.iter().enumerate() {
        if e.entries > 0 {
            println!("exc {n}: {e:?}");
        }
    }
    println!("edges {:?}", rig.take_edges().len());
    let s0 = rig.cpu_stats();
    rig.usb_write(b"*");
    let t = Instant::now();
    let mut n = 0;
    for _ in 0..1000 {
        rig.run_for(SimDuration::from_millis(1))?;
        n += rig.usb_read().len();
    }
    let s = rig.cpu_stats();
    println!(
        "stream 1 s: {n} bytes in {:?}; awake {} slow {}",
        t.elapsed(),
        s.awake - s0.awake,
        s.slow_steps - s0.slow_steps
    );
    Ok(())
}
