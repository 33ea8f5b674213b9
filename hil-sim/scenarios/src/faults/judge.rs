//! Whether a run went as promised.

use std::collections::BTreeMap;
use std::path::Path;

use protocol::{DeviceToHost, ImuFlags, ResetCause, TICK_HZ, Ticks};
use recording::reader::{Item, Reader};
use smartdepthsync::outcome::ExitStatus;

use super::plan::{Fault, Plan};
use super::scene::{Delivered, imu_is_well, time_of};
use super::{Ended, TIME_OF_DAY, Verdict};
use rig::wiring::UNITS_PER_TICK;
use stm32f4_sim::time::SimDuration;

/// What a kill may cost, as the recording promises.
const KILL_COSTS: SimDuration = SimDuration::from_millis(1_000);

pub(super) fn judge(plan: &Plan, ended: &Ended) -> Result<Verdict, String> {
    let report = &ended.report;
    if let Some(wrong) = &report.wrong {
        return Err(wrong.clone());
    }
    judge_end(plan, ended)?;
    let losses = judge_losses(plan, ended)?;
    judge_recording(ended)?;
    judge_time_of_day(plan, ended)?;
    if let Some(killed) = report.killed {
        let promised = killed.units().saturating_sub(KILL_COSTS.units());
        let given: Vec<&Delivered> = report
            .delivered
            .iter()
            .filter(|delivered| delivered.at.units() <= promised)
            .collect();
        contains(&ended.killed, &given, "the killed recording")?;
    }
    let compared = report.compared;
    let mut problems = BTreeMap::new();
    for problem in &ended.file.problems {
        *problems.entry(problem.kind.clone()).or_default() += 1;
    }
    Ok(Verdict {
        plan: plan.clone(),
        exit_code: ended.status.code(),
        virtual_s: report.ended.as_secs_f64(),
        pulses: compared.pulses,
        delivered: compared.reports + compared.samples + compared.captures,
        disturbed: compared.disturbed,
        pulses_lost: losses,
        samples_lost: ended.counts.imu.lost,
        captures_lost: ended.counts.captures.lost,
        damaged_frames: ended.damaged_frames,
        reconnects: ended.file.reconnects,
        runs: report.hellos.len(),
        joint_error_us: joint(ended).map(|(error, _)| error),
        joint_sigma_us: joint(ended).map(|(_, sigma)| sigma),
        problems,
        digest: report.digest,
    })
}

/// The session went on, or ended as it should.
fn judge_end(plan: &Plan, ended: &Ended) -> Result<(), String> {
    let report = &ended.report;
    let kinds: Vec<&str> = ended
        .file
        .problems
        .iter()
        .map(|p| p.kind.as_str())
        .collect();
    if !ended.next_step {
        return Err(format!("{:?} without a next step", ended.status));
    }
    let runs = report.hellos.len();
    let expected_runs = 1 + usize::from(plan.resets());
    if runs != expected_runs {
        return Err(format!(
            "the host saw {runs} runs of the board, not {expected_runs}; {:?}, {kinds:?}",
            ended.status
        ));
    }
    if plan.resets() {
        let cause = report.hellos.last().map(|hello| hello.reset_cause);
        let expected = plan.events.iter().find_map(|event| match event.fault {
            Fault::ResetPressed => Some(ResetCause::Pin),
            Fault::WatchdogReset => Some(ResetCause::Watchdog),
            Fault::SupplyReset => Some(ResetCause::PowerOn),
            _ => None,
        });
        if cause != expected {
            return Err(format!("reset by {cause:?}, not {expected:?}"));
        }
        judge_joint(ended)?;
    }
    let harmless = plan.events.iter().all(|e| {
        matches!(
            e.fault,
            Fault::HostKilled | Fault::DepthCameraStopped | Fault::HostClockStepped
        )
    });
    match ended.status {
        ExitStatus::Good | ExitStatus::Loss => {}
        status => return Err(format!("the session ended with {status:?}; {kinds:?}")),
    }
    if harmless && ended.status != ExitStatus::Good {
        return Err(format!("loss without a reason: {kinds:?}"));
    }
    // It was whole again by the end.
    let late = |message: &DeviceToHost| {
        report.delivered.iter().rev().find(|delivered| {
            core::mem::discriminant(&delivered.message) == core::mem::discriminant(message)
        })
    };
    let Some(status) = &report.status else {
        return Err("no status ever came".to_owned());
    };
    if !imu_is_well(status) {
        return Err(format!("the IMU did not come back: {:?}", status.imu));
    }
    let last = late(&DeviceToHost::Status(status.clone()));
    let quiet = SimDuration::from_millis(1_500);
    if last.is_none_or(|last| report.ended.since(last.at) > quiet) {
        return Err("the link did not come back".to_owned());
    }
    Ok(())
}

/// What the host says is missing is what is missing. Gives the pulses.
fn judge_losses(plan: &Plan, ended: &Ended) -> Result<u64, String> {
    let report = &ended.report;
    let told = ended.counts.pulses;
    let of = |run: usize, pick: fn(&DeviceToHost) -> Option<u32>| -> Vec<u32> {
        report
            .delivered
            .iter()
            .filter(|delivered| delivered.run == run)
            .filter_map(|delivered| pick(&delivered.message))
            .collect()
    };
    let pulse = |message: &DeviceToHost| match message {
        DeviceToHost::Pulse(pulse) => Some(pulse.seq),
        _ => None,
    };
    let sample = |message: &DeviceToHost| match message {
        DeviceToHost::Imu(sample) => Some(sample.seq),
        _ => None,
    };
    let capture = |message: &DeviceToHost| match message {
        DeviceToHost::Capture(capture) => Some(capture.seq),
        _ => None,
    };
    // By the board's numbers, from the first to the last of each run that were told.
    let gaps = |run: usize, pick: fn(&DeviceToHost) -> Option<u32>| {
        let seqs = of(run, pick);
        let span = match (seqs.first(), seqs.last()) {
            (Some(first), Some(last)) => u64::from(last.wrapping_sub(*first)) + 1,
            _ => 0,
        };
        span.saturating_sub(seqs.len() as u64)
    };
    let runs = 0..report.hellos.len();
    // The first run's pulses by the pin.
    let made = report.pulses_between;
    let missing = made.saturating_sub(of(0, pulse).len() as u64)
        + runs
            .clone()
            .skip(1)
            .map(|run| gaps(run, pulse))
            .sum::<u64>();
    if missing != told.lost {
        return Err(format!(
            "{missing} pulses are missing, the host says {}",
            told.lost
        ));
    }
    for (name, pick, told) in [
        ("samples", sample as fn(&_) -> _, ended.counts.imu),
        ("captures", capture, ended.counts.captures),
    ] {
        let missing: u64 = runs.clone().map(|run| gaps(run, pick)).sum();
        if missing != told.lost {
            return Err(format!(
                "{missing} {name} are missing, the host says {}",
                told.lost
            ));
        }
    }
    // Without a fault of the IMU, an edge of data-ready without a sample is a
    // sample that was lost on the link.
    let imu_fault = plan.events.iter().any(|event| event.fault.hits_imu());
    let marked = report
        .delivered
        .iter()
        .any(|delivered| match &delivered.message {
            DeviceToHost::Imu(sample) => sample.flags.has(ImuFlags::FIRST),
            _ => false,
        });
    if imu_fault
        && !plan.resets()
        && !marked
        && ended.counts.imu.lost == 0
        && report.compared.samples_missing > 50
    {
        return Err(format!(
            "{} samples are missing without a mark",
            report.compared.samples_missing
        ));
    }
    Ok(missing)
}

/// The new run is marked and put where it really was; the train is on its grid.
fn judge_joint(ended: &Ended) -> Result<(), String> {
    let report = &ended.report;
    let Some((error_us, sigma_us)) = joint(ended) else {
        return Err(format!(
            "{} runs in the session file behind the first, {} seen",
            ended.file.runs.len(),
            report.hellos.len()
        ));
    };
    if error_us.abs() > 5.0 * sigma_us {
        return Err(format!(
            "the new run is {error_us:.1} µs off its place, with a sigma of {sigma_us:.1} µs"
        ));
    }
    let (Some(run), Some(hello)) = (ended.file.runs.last(), report.hellos.last()) else {
        return Err("no mark".to_owned());
    };
    if (run.epoch, run.reset_cause) != (hello.epoch, hello.reset_cause) {
        return Err(format!("the mark says {run:?}"));
    }
    let (Some(first), Some(again), Some(anchor)) = (report.first_train, report.train, run.anchor)
    else {
        return Err("the trigger was not started again".to_owned());
    };
    let recorded = Ticks(again.first.0 + run.shift);
    if recorded != anchor || first.period.phase_error(first.first, recorded).0.abs() > 1 {
        return Err(format!(
            "the trigger goes on at {recorded:?}, which is not on its former grid"
        ));
    }
    let pulses = report.delivered.iter().filter(|delivered| {
        delivered.run > 0 && matches!(&delivered.message, DeviceToHost::Pulse(p) if p.aligned)
    });
    if pulses.count() == 0 {
        return Err("no aligned pulse came after the reset".to_owned());
    }
    Ok(())
}

/// How far the last run is off its true place in the recording, and what the
/// session says that might be, in µs.
fn joint(ended: &Ended) -> Option<(f64, f64)> {
    let [before, after] = ended.report.zeros.as_slice() else {
        return None;
    };
    let [run] = ended.file.runs.as_slice() else {
        return None;
    };
    let true_shift = after.since(*before).units() as f64 / UNITS_PER_TICK as f64;
    let error = (run.shift as f64 - true_shift) / f64::from(TICK_HZ);
    Some((error * 1e6, run.shift_sigma_us))
}

/// The finished recording holds what the host was given.
fn judge_recording(ended: &Ended) -> Result<(), String> {
    let given: Vec<&Delivered> = ended.report.delivered.iter().collect();
    contains(&ended.folder, &given, "the recording")
}

/// The time of day is recorded as it was, and nothing else goes by it.
fn judge_time_of_day(plan: &Plan, ended: &Ended) -> Result<(), String> {
    let reader = Reader::open(&ended.folder).map_err(|error| error.to_string())?;
    let mut seen: Vec<i64> = reader
        .flatten()
        .filter_map(|entry| match entry.item {
            Item::HostTime(time) => Some(time.time_ref.nanos() / 1_000_000_000),
            _ => None,
        })
        .collect();
    seen.dedup();
    let mut expected = vec![TIME_OF_DAY.cast_signed()];
    if plan.has(Fault::HostClockStepped) {
        expected.push(TIME_OF_DAY.cast_signed() + plan.clock_step_s);
    }
    if seen == expected {
        Ok(())
    } else {
        Err(format!("times of day are {seen:?}, expected {expected:?}"))
    }
}

/// Each pulse and sample is in the file as often as it was given, each in its run.
fn contains(folder: &Path, given: &[&Delivered], what: &str) -> Result<(), String> {
    let mut pulses: BTreeMap<(usize, Ticks), i64> = BTreeMap::new();
    let mut samples: BTreeMap<(usize, Ticks), i64> = BTreeMap::new();
    for delivered in given {
        let Some(at) = time_of(&delivered.message) else {
            continue;
        };
        let key = (delivered.run, at);
        match &delivered.message {
            DeviceToHost::Pulse(_) => *pulses.entry(key).or_default() += 1,
            DeviceToHost::Imu(_) => *samples.entry(key).or_default() += 1,
            _ => {}
        }
    }
    let reader = Reader::open(folder).map_err(|error| format!("{what}: {error}"))?;
    let (mut run, mut shift) = (0, 0);
    let mut last = None;
    for entry in reader {
        let entry = entry.map_err(|error| format!("{what}: {error}"))?;
        if let Item::Imu(_) = &entry.item {
            if last.is_some_and(|last| entry.at <= last) {
                return Err(format!("{what}: time goes back to {:?}", entry.at));
            }
            last = Some(entry.at);
        }
        if let Item::Run(mark) = &entry.item {
            run += 1;
            shift = mark.shift_ticks;
        }
        let key = (run, Ticks(entry.at.0.wrapping_sub(shift)));
        let count = match &entry.item {
            Item::Pulse(_) => pulses.get_mut(&key),
            Item::Imu(_) => samples.get_mut(&key),
            _ => None,
        };
        if let Some(count) = count {
            *count -= 1;
        }
    }
    for (name, left) in [("pulses", &pulses), ("samples", &samples)] {
        let missing = left.values().filter(|&&count| count > 0).count();
        let twice = left.values().filter(|&&count| count < 0).count();
        if missing + twice > 0 {
            let first = left.iter().find(|(_, count)| **count != 0);
            return Err(format!(
                "{what} lacks {missing} {name} and has {twice} twice, first {first:?}"
            ));
        }
    }
    Ok(())
}
