//! The signals that leave the board: the pulse per second with its serial line, and the trigger
//! after its buffer and divider. All are measured on the strobe input.

use protocol::pins::pin_of;
use protocol::{
    Baud, GnssSettings, MIN_PULSE_WIDTH, NMEA_SLACK_MS, Output, Pps, QueryGnss, Sentences,
    StartGnss, StopGnss, TICK_HZ, TickDelta, TrainState,
};

use super::{BoardTest, PERIOD, millis};
use crate::bring_up::BringUpError;
use crate::bring_up::serial::Line;
use crate::bring_up::train::{Extent, MAX_DELAY, Trains};

/// As a VLP-16 has it (`docs/wiring.md`): on its side of the gate the line is low when idle.
/// 2027-01-01 at tick 0.
const SETTINGS: GnssSettings = GnssSettings {
    utc_at_zero: 1_798_761_600,
    baud: Baud::B9600,
    line_inverted: true,
    sentences: Sentences::Rmc,
    delay_ms: 50,
    pulse_width: TICK_HZ / 50,
    pulse_inverted: false,
};

/// Largest error of an edge of the line, in ticks: 2 % of a bit. A receiver that samples in the
/// middle of ten bits tolerates more than ten times that.
const LINE_DOUBT: i64 = (TICK_HZ / SETTINGS.baud.hz() / 50) as i64;

/// Shortest pulse that the depth camera accepts (specification of its sync input): 8 µs.
const SHORTEST: i64 = 8 * (TICK_HZ / 1_000_000) as i64;

impl BoardTest<'_> {
    pub(super) fn lidar(&mut self) -> Result<(), BringUpError> {
        const NAME: &str = "pulse per second";
        const LINE: &str = "serial line";
        const REASON: &str = "the wire to PA2; or the timer of the auxiliary outputs";
        const GATE: &str = "a lidar like the VLP-16 wants the line low when idle: put the wire \
                            after the inverting gate, or look at the gate";
        if !self.board.hello().board.has_outputs() {
            self.skip(NAME, "this board has no such output", REASON);
            return Ok(());
        }
        self.board.call(StartGnss(SETTINGS))?;
        let pin = pin_of("pulse per second");
        if self.wire_moved((NAME, REASON), pin, |received| 2 * received.pps.len())? {
            let received = self.receive_for(millis(4_200))?;
            let mut trains = Trains::default();
            for pps in &received.pps {
                trains.look_for(pps.at, SETTINGS.pulse_width, &received.strobe);
                trains.compared(TickDelta((pps.at.0 % u64::from(TICK_HZ)) as i64));
            }
            self.captures(NAME, "width of the pulse per second", &trains);
            self.check(
                "whole seconds",
                trains.grid_error.within(0, 0) && trains.on_grid >= 3,
                trains.on_grid_text(),
                "0 ticks off the board's seconds",
                REASON,
            );
        }
        // A second's sentence has some 300 edges, more than the strobe input accepts at once; their
        // number shows that the wire is there.
        let moved = self.wire_moved((LINE, REASON), pin_of("sentences"), |received| {
            let edges = received.strobe.len();
            if edges > 40 { edges } else { usize::MAX }
        })?;
        if moved {
            let received = self.receive_for(millis(4_200))?;
            let lines: Vec<(&Pps, Option<Line>)> = (received.pps.iter())
                .map(|pps| {
                    (
                        pps,
                        Line::after(pps.at, SETTINGS.baud.hz(), &received.strobe),
                    )
                })
                .collect();
            // The last second may be incomplete.
            let whole = lines
                .get(..lines.len().saturating_sub(1))
                .unwrap_or_default();
            self.line(LINE, whole, REASON);
            let low = whole
                .iter()
                .all(|(_, line)| line.as_ref().is_some_and(|l| l.idle_low));
            let inverted = "inverted serial line";
            if low && !whole.is_empty() {
                let text = String::from("low when idle");
                self.check(inverted, true, text, "low when idle", GATE);
            } else {
                self.skip(inverted, "high when idle, as at PC12 itself", GATE);
            }
        }
        self.board.call(StopGnss)?;
        while self.board.call(QueryGnss)?.status.state != TrainState::Stopped {
            self.receive_for(millis(100))?;
        }
        Ok(())
    }

    /// Returns the sentences of these seconds.
    fn line(&mut self, name: &'static str, seconds: &[(&Pps, Option<Line>)], reason: &'static str) {
        let (mut begins, mut doubt, mut right) = (Extent::default(), Extent::default(), 0);
        for (pps, line) in seconds {
            let Some(line) = line else { continue };
            begins.add((line.begins - pps.at).0);
            doubt.add(line.doubt);
            let of_day = pps.utc.rem_euclid(86_400);
            let (hour, minute, second) = (of_day / 3_600, of_day / 60 % 60, of_day % 60);
            let expected = format!("$GPRMC,{hour:02}{minute:02}{second:02}");
            right += usize::from(line.text == expected.as_bytes());
        }
        let first = millis(SETTINGS.delay_ms.into()).0;
        let last = first + millis(NMEA_SLACK_MS).0;
        self.check(
            name,
            right == seconds.len() && right >= 2 && begins.within(first, last)
                && doubt.within(0, LINE_DOUBT),
            format!(
                "{right} of {} seconds given by their sentence, which begins {begins} after the pulse; \
                 edges at most {doubt} from their places",
                seconds.len()
            ),
            format!("all of them, from {first} to {last} ticks, {LINE_DOUBT} ticks"),
            reason,
        );
    }

    /// Checks the trigger as the camera receives it: after the buffer, at the divider's tap. Both
    /// inputs are wired to it.
    pub(super) fn buffer(&mut self) -> Result<(), BringUpError> {
        const REASON: &str =
            "the buffer's supply and its input; the divider, or a cable that loads it";
        self.start(Output::Camera, PERIOD, MIN_PULSE_WIDTH)?;
        let mut received = self.receive_for(millis(3_000))?;
        received.append(self.stop(Output::Camera)?);
        let mut trains = Trains::default();
        trains.find(&received.pulses, MIN_PULSE_WIDTH, &received.strobe);
        self.read_back("read-back after the buffer", &trains, REASON);
        let asked = i64::from(MIN_PULSE_WIDTH);
        self.check(
            "pulse after the buffer",
            trains.captured == trains.pulses
                && trains.width_error.within(SHORTEST - asked, MAX_DELAY),
            format!(
                "{} of {} pulses captured, {} from the {asked} ticks that were asked for",
                trains.captured, trains.pulses, trains.width_error
            ),
            format!("at least {SHORTEST} ticks, which the camera wants, and {MAX_DELAY} too long"),
            REASON,
        );
        Ok(())
    }
}
