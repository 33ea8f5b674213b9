//! `smartdepthsync board test`: does this board do in hardware what the simulated one
//! does? What is measured and what must hold is in the crate `bring_up`.

use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::time::Duration;

use board::bring_up::{Operator, Part, Plan};
use board::finding::Severity;
use protocol::usb::serial_number;
use session::devices::Connector as _;
use session::devices::hardware::SerialConnector;

use super::keep_trying;
use crate::context::Context;
use crate::decimal::parse_real_time;
use crate::operator::lines_of_stdin;
use crate::options::{PortArg, one_of};
use crate::outcome::{ExitStatus, Failure, write_file};

/// Measure a board: edges, captures, IMU, USB, crystal; pass or fail with reasons.
///
/// Connect PA5 to PA3 and PA2, and the IMU; nothing else. The test asks you to move the wire at
/// PA2, to unplug the cable and to press reset; Enter skips a step. It takes five minutes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync board test --hands-off")]
pub(crate) struct TestArgs {
    /// Measure only this; may be given several times: edges and widths of the trigger, outputs 2
    /// to 4, pulse per second of a lidar, data-ready of the imu, throughput of the link, the
    /// crystal beside the computer's clock and the supply, an unplugged cable and a computer that
    /// sleeps, panics and other resets, the trigger behind its buffer with PA2 wired to PA3
    /// there [default: all but buffer]
    #[arg(long = "part", value_name = "PART", value_parser = one_of(&PARTS))]
    parts: Vec<Part>,
    /// Skip the parts that need a person at the board
    #[arg(long)]
    hands_off: bool,
    /// Time over which the crystal is compared with this computer's clock, such as 60s or 5m
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_real_time)]
    clock_time: Duration,
    /// Afterwards, run the trigger and the IMU for this many hours, with a sleeping computer and a
    /// board that leaves the bus
    #[arg(long, value_name = "N", default_value_t = 0)]
    hours: u32,
    /// Store the measurements in the board: the delay of its inputs, the start delay of its
    /// outputs, its crystal against this computer's clock
    #[arg(long)]
    keep: bool,
    /// Folder for board-test.json and board-test.html; a test of some parts adds their names
    #[arg(short, long, value_name = "FOLDER", default_value = "board-test")]
    out: PathBuf,
}

/// The parts on the command line.
const PARTS: [(&str, Part); 9] = [
    ("trigger", Part::Trigger),
    ("outputs", Part::Outputs),
    ("lidar", Part::Lidar),
    ("imu", Part::Imu),
    ("link", Part::Link),
    ("clock", Part::Clock),
    ("replug", Part::Replug),
    ("resets", Part::Resets),
    ("buffer", Part::Buffer),
];

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, is in use or is reset meanwhile; the report cannot be
/// written.
pub(crate) fn run(
    args: &TestArgs,
    port: &PortArg,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let mut parts = match args.parts.as_slice() {
        [] => Part::ALL.to_vec(),
        some => some.to_vec(),
    };
    parts.extend((args.hours > 0).then_some(Part::Soak));
    let mut board = port.open()?;
    std::fs::create_dir_all(&args.out).map_err(|error| Failure::file("make", &args.out, &error))?;
    let stop = context.interrupt.question();
    let id = serial_number(&board.hello().board_id);
    let is_asked = !args.hands_off && std::io::stdin().is_terminal();
    let lines = is_asked.then(lines_of_stdin);
    let skips = || {
        let typed = lines.as_ref().map(|lines| lines.try_iter().count());
        typed.is_some_and(|lines| lines > 0)
    };
    if is_asked {
        context.say("Enter leaves out what you are asked to do.");
    }
    let operator = Operator {
        say: &|prompt| {
            // What was typed before does not leave this out.
            skips();
            context.say(prompt.to_string());
        },
        is_there: !args.hands_off,
        skips: &skips,
        stop: &stop,
        reconnect: &|within| {
            let mut connector = SerialConnector {
                port: port.port.clone(),
            };
            keep_trying(within, |_| stop(), || connector.connect(Some(&id)))
        },
    };
    let plan = Plan {
        parts: &parts,
        clock: args.clock_time,
        soak: Duration::from_secs(3_600 * u64::from(args.hours)),
        keep: args.keep,
    };
    let report = board::bring_up::run(&mut board, operator, plan)?;
    let json = serde_json::to_string_pretty(&report)?;
    let name = name_of(&args.parts);
    let page = args.out.join(format!("{name}.html"));
    write_file(&args.out.join(format!("{name}.json")), &json)?;
    write_file(&page, &report::board_test::page(&report))?;
    context.print_checks(&report, || {
        let text = report::board_test::summary(&report).text();
        format!("{text}report {}", page.display())
    })?;
    Ok(match report.count(Severity::Bad) {
        0 => ExitStatus::Good,
        _ => ExitStatus::Refused,
    })
}

/// Name of the files of a report: a test of some parts leaves the report of the whole.
fn name_of(parts: &[Part]) -> String {
    let words = PARTS.iter().filter(|(_, part)| parts.contains(part));
    let words = words.map(|(word, _)| format!("-{word}"));
    format!("board-test{}", words.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_of_some_parts_does_not_overwrite_that_of_all() {
        assert_eq!(name_of(&[]), "board-test");
        assert_eq!(name_of(&[Part::Link, Part::Imu]), "board-test-imu-link");
    }
}
