//! The watch over the board's messages while recording. Pure: messages in, findings out.
//!
//! A lasting state (no pulses, no samples of the IMU) is reported once when it begins and once
//! when it ends.

use protocol::{EdgeGrid, ImuFlags, ImuSample, ImuState, Pulse, Status, TICK_HZ, Ticks};

use board::Stream;
use board::finding::{EventKind, Finding};
use recording::grid::FollowedGrid;

/// Longest gap between samples of the IMU, ticks: 0.1 s, 50 samples.
const IMU_PATIENCE: u64 = TICK_HZ as u64 / 10;

/// Next step for a faulty train.
const TRAIN: &str = "stop and record again; `smartdepthsync board trigger status` says more";

/// Next step for a trigger wire without pulses.
const WIRE: &str = "check the trigger's wire and buffer";

/// Next step for an IMU with missing samples.
const IMU: &str = "check the IMU's wires; the trigger is not affected";

/// Next step for a board that has restarted its USB.
const USB: &str = "use another cable or port if it happens again";

/// Next step for missing messages.
const COUNTED: &str = "nothing to do: counted, and times are not affected";

/// A counter of the board that grows only when something goes wrong: kind of the finding, the
/// counter, the counted thing in words, and the next step.
type Counter = (EventKind, fn(&Status) -> u32, &'static str, &'static str);

const COUNTERS: [Counter; 6] = [
    (
        EventKind::TriggerLate,
        |status| status.trigger.late,
        "trigger edges came late",
        TRAIN,
    ),
    (
        EventKind::ReadbackMissing,
        |status| status.trigger.readback.missing,
        "pulses were not seen on the trigger wire",
        WIRE,
    ),
    (
        EventKind::ImuLate,
        |status| status.imu.late,
        "IMU samples were read late",
        IMU,
    ),
    (
        EventKind::CapturesLost,
        |status| status.strobe_overcaptures,
        "edges on the strobe input were lost",
        COUNTED,
    ),
    (
        EventKind::ImuRecovered,
        |status| status.imu.recoveries,
        "times the IMU was set up again after a fault",
        IMU,
    ),
    (
        EventKind::UsbRestarted,
        |status| status.usb.stuck.saturating_add(status.usb.unconfigured),
        "times the board restarted its USB",
        USB,
    ),
];

/// Returns the finding for missing messages of a stream; `None` for filler messages.
#[must_use]
pub fn lost(stream: Stream, count: u32) -> Option<Finding> {
    let kind = match stream {
        Stream::Pulses => EventKind::PulseMessagesLost,
        Stream::Imu => EventKind::ImuGap,
        Stream::Captures => EventKind::CapturesLost,
        Stream::Status => EventKind::StatusLost,
        Stream::Outputs => EventKind::OutputPulsesLost,
        Stream::Pps => EventKind::PpsLost,
        Stream::Filler => return None,
    };
    let next_step = if stream == Stream::Imu { IMU } else { COUNTED };
    Some(Finding::check(kind, format!("{count} {stream} lost")).next_step(next_step))
}

/// Returns the finding for a message whose number does not follow that of the previous one.
#[must_use]
pub fn disordered(stream: Stream) -> Finding {
    let text = format!(
        "{stream} came twice, or with numbers that do not follow: how many are missing is not known"
    );
    Finding::bad(EventKind::NumbersDisordered, text)
}

/// The state of the watch.
#[derive(Debug)]
pub struct Watch {
    grid: FollowedGrid,
    next_number: Option<u64>,
    last_pulse: Ticks,
    pulses_away: bool,
    off_grid: bool,
    last_imu: Ticks,
    imu_away: bool,
    last_status: Option<Status>,
    /// Streams whose numbers were reported as disordered.
    disordered: Vec<Stream>,
}

impl Watch {
    /// Begins to watch at board time `now`, with a train that is on its grid.
    #[must_use]
    pub const fn new(grid: EdgeGrid, now: Ticks) -> Self {
        Self {
            grid: FollowedGrid::new(grid),
            next_number: None,
            last_pulse: now,
            pulses_away: false,
            off_grid: false,
            last_imu: now,
            imu_away: false,
            last_status: None,
            disordered: Vec::new(),
        }
    }

    /// Returns the grid.
    #[must_use]
    pub const fn grid(&self) -> EdgeGrid {
        self.grid.last()
    }

    /// Expects the train on another grid, from the anchor of that grid on.
    pub const fn follow(&mut self, grid: EdgeGrid) {
        self.grid.follow(grid);
    }

    /// Checks number and grid of a pulse of the camera's train.
    pub fn pulse(&mut self, pulse: &Pulse, findings: &mut Vec<Finding>) {
        if self.pulses_away {
            self.pulses_away = false;
            findings.push(Finding::good(EventKind::PulsesBack, "pulses arrive again"));
        }
        if let Some(expected) = self.next_number
            && pulse.number != expected
        {
            let text = format!("pulse {} came where {expected} was expected", pulse.number);
            findings.push(Finding::bad(EventKind::PulsesMissing, text).next_step(TRAIN));
        }
        self.next_number = Some(pulse.number.wrapping_add(1));
        self.last_pulse = pulse.at;
        let off = self.grid.off(pulse.at).0;
        match (off != 0, self.off_grid) {
            (true, false) => {
                let text = format!("pulse {} is {off} ticks off its grid", pulse.number);
                findings.push(Finding::bad(EventKind::PhaseOff, text).next_step(TRAIN));
            }
            (false, true) => {
                findings.push(Finding::good(
                    EventKind::PhaseBack,
                    "pulses are on their grid again",
                ));
            }
            _ => {}
        }
        self.off_grid = off != 0;
    }

    /// Checks the flags of an IMU sample.
    pub fn imu(&mut self, sample: &ImuSample, findings: &mut Vec<Finding>) {
        if self.imu_away {
            self.imu_away = false;
            findings.push(Finding::good(
                EventKind::ImuBack,
                "IMU samples arrive again",
            ));
        }
        self.last_imu = sample.at;
        if sample.flags.has(ImuFlags::AFTER_LOSS) {
            let text = "the board missed a data-ready edge of the IMU";
            findings.push(Finding::check(EventKind::ImuGap, text).next_step(IMU));
        }
        if sample.flags.has(ImuFlags::FIRST) {
            let text = "the IMU was set up again";
            findings.push(Finding::check(EventKind::ImuGap, text).next_step(IMU));
        }
    }

    /// Notes that messages of a stream are missing.
    pub fn lost(&mut self, stream: Stream, count: u32, findings: &mut Vec<Finding>) {
        if stream == Stream::Pulses {
            self.next_number = self.next_number.map(|next| next.wrapping_add(count.into()));
        }
        findings.extend(lost(stream, count));
    }

    /// Notes that the number of a message does not follow that of the previous one; reported once
    /// per stream.
    pub fn disordered(&mut self, stream: Stream, findings: &mut Vec<Finding>) {
        if !self.disordered.contains(&stream) {
            self.disordered.push(stream);
            findings.push(disordered(stream));
        }
    }

    /// Checks the counters of a status against the previous one.
    pub fn status(&mut self, status: &Status, findings: &mut Vec<Finding>) {
        if let Some(before) = self.last_status.replace(status.clone()) {
            for (kind, counter, what, next_step) in COUNTERS {
                let more = counter(status).saturating_sub(counter(&before));
                if more > 0 {
                    let finding = Finding::check(kind, format!("{more} {what}"));
                    findings.push(finding.next_step(next_step));
                }
            }
        }
        if status.imu.state == ImuState::Failed && !self.imu_away {
            self.imu_away = true;
            let text = match status.imu.last_fault {
                Some(fault) => format!("the IMU does not answer ({fault:?})"),
                None => String::from("the IMU does not answer"),
            };
            findings.push(Finding::bad(EventKind::ImuGone, text).next_step(IMU));
        }
    }

    /// Checks for silence at board time `now`, after all messages up to then were handled.
    pub fn time(&mut self, now: Ticks, findings: &mut Vec<Finding>) {
        let patience = 3 * u64::from(self.grid.last().period.ticks());
        if !self.pulses_away && now.0.saturating_sub(self.last_pulse.0) > patience {
            self.pulses_away = true;
            let text = "pulses have stopped";
            findings.push(Finding::bad(EventKind::PulsesMissing, text).next_step(TRAIN));
        }
        if !self.imu_away && now.0.saturating_sub(self.last_imu.0) > IMU_PATIENCE {
            self.imu_away = true;
            let text = "IMU samples have stopped";
            findings.push(Finding::bad(EventKind::ImuGap, text).next_step(IMU));
        }
    }

    /// Notes that the link was lost until `now`: missed messages show by their numbers, not as
    /// silence.
    pub const fn resume(&mut self, now: Ticks) {
        self.last_pulse = now;
        self.last_imu = now;
    }
}

#[cfg(test)]
mod tests {
    use board::finding::FindingKind;

    use super::*;
    use protocol::{EdgeTime, Period};

    const GRID: EdgeGrid = EdgeGrid {
        anchor: EdgeTime::from_ticks(Ticks(1_000_000)),
        period: Period::from_ticks(1_600_000),
    };

    fn watch() -> Watch {
        Watch::new(GRID, GRID.anchor.ticks)
    }

    fn pulse(number: u64) -> Pulse {
        Pulse {
            train: 1,
            number,
            at: GRID.edge(number as i64).ticks,
            aligned: true,
            ..Pulse::default()
        }
    }

    fn kinds(findings: &[Finding]) -> Vec<FindingKind> {
        findings
            .iter()
            .map(|finding| finding.kind.clone())
            .collect()
    }

    #[test]
    fn a_good_train_gives_no_findings() {
        let mut watch = watch();
        let mut findings = Vec::new();
        for number in 0..1_000 {
            watch.pulse(&pulse(number), &mut findings);
            watch.last_imu = pulse(number).at;
            watch.time(pulse(number).at, &mut findings);
        }
        assert_eq!(findings, []);
    }

    #[test]
    fn a_jump_of_the_number_and_a_pulse_off_its_grid_are_reported_once() {
        let mut watch = watch();
        let mut findings = Vec::new();
        watch.pulse(&pulse(0), &mut findings);
        watch.pulse(&pulse(2), &mut findings);
        for number in 3..6 {
            let mut off = pulse(number);
            off.at = Ticks(off.at.0 + 1);
            watch.pulse(&off, &mut findings);
        }
        watch.pulse(&pulse(6), &mut findings);
        assert_eq!(
            kinds(&findings),
            [
                EventKind::PulsesMissing,
                EventKind::PhaseOff,
                EventKind::PhaseBack
            ]
        );
    }

    #[test]
    fn messages_lost_on_the_link_are_not_reported_as_missing_pulses_too() {
        let mut watch = watch();
        let mut findings = Vec::new();
        watch.pulse(&pulse(0), &mut findings);
        watch.lost(Stream::Pulses, 3, &mut findings);
        watch.pulse(&pulse(4), &mut findings);
        assert_eq!(kinds(&findings), [EventKind::PulseMessagesLost]);
    }

    #[test]
    fn silence_is_reported_when_it_begins_and_when_it_ends() {
        let mut watch = watch();
        let mut findings = Vec::new();
        for second in 1..10 {
            watch.time(
                Ticks(GRID.anchor.ticks.0 + second * 48_000_000),
                &mut findings,
            );
        }
        assert_eq!(
            kinds(&findings),
            [EventKind::PulsesMissing, EventKind::ImuGap]
        );
        findings.clear();
        watch.pulse(&pulse(300), &mut findings);
        let sample = ImuSample {
            at: pulse(300).at,
            flags: ImuFlags::FIRST,
            ..ImuSample::default()
        };
        watch.imu(&sample, &mut findings);
        assert_eq!(
            kinds(&findings),
            [EventKind::PulsesBack, EventKind::ImuBack, EventKind::ImuGap]
        );
        findings.clear();
        watch.resume(Ticks(GRID.anchor.ticks.0 + 900 * 48_000_000));
        watch.time(
            Ticks(GRID.anchor.ticks.0 + 900 * 48_000_000 + 1),
            &mut findings,
        );
        assert_eq!(findings, []);
    }

    #[test]
    fn a_counter_of_the_status_that_grows_is_a_finding() {
        let mut watch = watch();
        let mut findings = Vec::new();
        let mut status = Status::default();
        watch.status(&status, &mut findings);
        status.usb.unconfigured = 1;
        status.usb.stuck = 2;
        watch.status(&status, &mut findings);
        watch.status(&status, &mut findings);
        assert_eq!(kinds(&findings), [EventKind::UsbRestarted]);
        assert_eq!(findings[0].text, "3 times the board restarted its USB");
    }
}
