//! Tests of a board that leaves the bus or starts again: it must lose nothing but what its counters
//! say, and report the cause.

use std::time::Duration;

use crate::{BoardError, Received, reset_cause};
use protocol::{
    BoardModel, Failure, Hello, MIN_PULSE_WIDTH, Output, ResetCause, SELF_TEST_KEY, SelfTest,
    TickDelta,
};

use super::{BoardTest, NOBODY, PERIOD, millis};
use crate::bring_up::train::{PulseGrid, Trains};
use crate::bring_up::{BringUpError, Prompt};

/// Longest time from the link's end to a new one: start, enumeration, and a computer that has to
/// wake.
const COMES_BACK: Duration = Duration::from_secs(30);

/// Longest time of a failure: the watchdog's 7.5 s, and a margin.
const FAILS_WITHIN: TickDelta = millis(10_000);

/// Number of times that the board leaves the bus by itself.
const REPLUGS: u64 = 5;

/// Time for which the computer does not read in every other minute of a soak.
const SLEEP: Duration = Duration::from_secs(8);

/// Most messages that a computer's driver has received and drops with the port, so that the board
/// does not count them: a guess of 1,152 bytes at 20 a message.
const IN_DRIVER: u64 = 1_152 / 20;

/// Failures on request: name, command, reported cause of the reset, and message in the `Hello`.
const FAILURES: [(&str, Failure, ResetCause, Option<&str>); 6] = [
    (
        "after a panic",
        Failure::Panic,
        ResetCause::Software,
        Some("self test: panic on request"),
    ),
    (
        "after a fault",
        Failure::HardFault,
        ResetCause::Software,
        Some("HardFault at pc"),
    ),
    (
        "after a stack overflow",
        Failure::StackOverflow,
        ResetCause::Software,
        Some("the tasks' stack ended"),
    ),
    (
        "after a handler's overflow",
        Failure::HandlerOverflow,
        ResetCause::Software,
        Some("the handlers' stack ended"),
    ),
    ("after a hang", Failure::Hang, ResetCause::Watchdog, None),
    (
        "after a task that died",
        Failure::Stall,
        ResetCause::Watchdog,
        None,
    ),
];

/// A train that runs while the link is interrupted.
struct Interrupted {
    grid: PulseGrid,
    epoch: u32,
    trains: Trains,
    times: u64,
    lost: u64,
    /// Messages that the board had dropped before, and has dropped now.
    dropped: Option<(u64, u64)>,
    /// Suspends of the bus before, and now.
    suspends: Option<(u32, u32)>,
}

impl Interrupted {
    /// Adds the messages of a stretch.
    fn add(&mut self, received: &Received) {
        self.trains.compare(&self.grid, &received.pulses);
        self.trains.find(&received.pulses, MIN_PULSE_WIDTH, &[]);
        self.lost += received.lost;
        if let Some(now) = received.dropped() {
            let (before, _) = self.dropped.unwrap_or((now, now));
            self.dropped = Some((before, now));
        }
        if let Some(status) = received.statuses.last() {
            let now = status.usb.suspends;
            let (before, _) = self.suspends.unwrap_or((now, now));
            self.suspends = Some((before, now));
        }
    }

    fn suspended(&self) -> u32 {
        self.suspends
            .map_or(0, |(before, now)| now.saturating_sub(before))
    }
}

impl BoardTest<'_> {
    pub(super) fn replug(&mut self) -> Result<(), BringUpError> {
        const REASON: &str = "the USB core's transmitter stops with a packet on its way, or messages \
                              are lost where the board does not see it";
        let mut train = self.train_to_interrupt()?;
        for _ in 0..REPLUGS {
            self.fill(true)?;
            let mut received = self.receive_for(millis(300))?;
            if !self.leave_bus(&mut received, "leaving the bus")? {
                return Ok(());
            }
            train.add(&received);
            train.times += 1;
        }
        self.judge(train, "leaving the bus", true, REASON)?;

        let name = "unplugged cable";
        if self.board.hello().board == BoardModel::BlackPill {
            self.skip(name, "this board is supplied by the cable", REASON);
        } else {
            self.interrupted_by_hand(name, Prompt::Replug, |_, _| false, REASON)?;
        }
        let slept = |train: &Interrupted, h: &Received| {
            let status = h.statuses.last().zip(train.suspends);
            status.is_some_and(|(status, (_, before))| status.usb.suspends > before)
        };
        self.interrupted_by_hand("sleep of the computer", Prompt::Sleep, slept, REASON)
    }

    /// Minutes of trigger and IMU; in turn the computer does not read for a while, and the board
    /// leaves the bus. The computer may sleep meanwhile, whether the link ends by that or not.
    pub(super) fn soak(&mut self, length: Duration) -> Result<(), BringUpError> {
        let mut train = self.train_to_interrupt()?;
        for minute in 0..length.as_secs().div_ceil(60) {
            let mut received = Received::default();
            if self.link_ends(&mut received, millis(48_000), |_| false)? {
                self.come_back("soak")?;
                train.times += 1;
            }
            if minute % 2 == 0 {
                self.board.pause(SLEEP);
            } else if !self.leave_bus(&mut received, "soak")? {
                return Ok(());
            }
            received.append(self.receive_for(millis(2_000))?);
            train.add(&received);
            train.times += 1;
        }
        let reason = "what fails only after hours: heat, the supply, the cable";
        self.judge(train, "soak", true, reason)
    }

    fn train_to_interrupt(&mut self) -> Result<Interrupted, BringUpError> {
        let grid = self.start(Output::Camera, PERIOD, MIN_PULSE_WIDTH)?;
        let mut train = Interrupted {
            grid,
            epoch: self.board.hello().epoch,
            trains: Trains::default(),
            times: 0,
            lost: 0,
            dropped: None,
            suspends: None,
        };
        train.add(&self.receive_for(millis(1_500))?);
        Ok(train)
    }

    /// Makes the board leave the bus while it sends, and reconnects. Returns false, with a failed
    /// check, if the board stays.
    fn leave_bus(
        &mut self,
        received: &mut Received,
        name: &'static str,
    ) -> Result<bool, BringUpError> {
        if !self.fails_by(Failure::LeaveBus, received)? {
            self.stop(Output::Camera)?;
            let text = String::from("the board stayed on the bus");
            let reason = "the host did not see the pull-up go: a hub, or the firmware";
            self.check(name, false, text, "a link that ends", reason);
            return Ok(false);
        }
        self.come_back(name)?;
        received.append(self.receive_for(millis(1_500))?);
        Ok(true)
    }

    /// Makes the board fail. Returns false if the link does not end.
    fn fails_by(
        &mut self,
        failure: Failure,
        received: &mut Received,
    ) -> Result<bool, BringUpError> {
        let key = SELF_TEST_KEY;
        self.board.call(SelfTest { key, failure })?;
        self.link_ends(received, FAILS_WITHIN, |_| false)
    }

    /// Interrupts a train by hand: until the link ends, or `is_done`.
    fn interrupted_by_hand(
        &mut self,
        name: &'static str,
        what: Prompt,
        is_done: impl Fn(&Interrupted, &Received) -> bool,
        reason: &'static str,
    ) -> Result<(), BringUpError> {
        if !self.operator.is_there {
            self.skip(name, NOBODY, reason);
            return Ok(());
        }
        let mut train = self.train_to_interrupt()?;
        let done = self.by_hand((name, reason), what, |received| is_done(&train, received))?;
        let Some((mut received, ended)) = done else {
            return self.stop(Output::Camera).map(drop);
        };
        if ended {
            self.come_back(name)?;
        }
        received.append(self.receive_for(millis(2_500))?);
        train.add(&received);
        train.times = 1;
        // A computer that cuts the supply of its ports while it sleeps does not suspend them.
        let seen = ended || train.suspended() > 0;
        self.judge(train, name, seen, reason)
    }

    fn judge(
        &mut self,
        mut train: Interrupted,
        name: &'static str,
        seen: bool,
        reason: &'static str,
    ) -> Result<(), BringUpError> {
        train.add(&self.stop(Output::Camera)?);
        let same_run = self.board.hello().epoch == train.epoch;
        let counted = train
            .dropped
            .map_or(0, |(before, now)| now.saturating_sub(before));
        let uncounted = train.lost.checked_sub(counted);
        let most = train.times * IN_DRIVER;
        let trains = &train.trains;
        self.check(
            name,
            seen && same_run
                && trains.grid_error.within(0, 0)
                && trains.is_read_back()
                && uncounted.is_some_and(|uncounted| uncounted <= most),
            format!(
                "{} times, the bus suspended {} times: {}, {} of them read back; {} messages lost, \
                 the board counted {counted}{}",
                train.times,
                train.suspended(),
                trains.on_grid_text(),
                trains.read_back,
                train.lost,
                if same_run {
                    ""
                } else {
                    "; the board was reset"
                }
            ),
            format!(
                "0 ticks off, all read back; each lost message counted, but for those in the \
                 computer's driver (at most {most})"
            ),
            reason,
        );
        Ok(())
    }

    /// Receives messages until the link ends. Returns false if it does not, or if `done` returns
    /// true before.
    pub(super) fn link_ends(
        &mut self,
        received: &mut Received,
        within: TickDelta,
        done: impl FnMut(&Received) -> bool,
    ) -> Result<bool, BringUpError> {
        match self.hear_into(received, within, done) {
            Ok(()) => Ok(false),
            Err(BringUpError::Board(BoardError::Link(_))) => Ok(true),
            Err(BringUpError::Board(BoardError::NoAnswer { .. })) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Reconnects after a link has ended. A check fails if the board does not come back.
    fn come_back(&mut self, name: &'static str) -> Result<(), BringUpError> {
        let mut tries = 0;
        loop {
            tries += 1;
            self.board.hang_up();
            let link = (self.operator.reconnect)(COMES_BACK);
            match link.and_then(|link| self.board.reconnect(link)) {
                Ok(()) => return Ok(()),
                // A system may look at a new port once more.
                Err(BoardError::Link(_)) if tries < 3 => {}
                Err(error) => {
                    self.check(
                        name,
                        false,
                        format!("the board did not come back: {error}"),
                        format!("a link again within {} s", COMES_BACK.as_secs()),
                        "the cable; or the start of the firmware: look at its LEDs",
                    );
                    return Err(BringUpError::Gone);
                }
            }
        }
    }

    /// Checks the board after each failure and each reset.
    pub(super) fn resets(&mut self) -> Result<(), BringUpError> {
        const REASON: &str = "the reset's flags, or the memory and flash in which a run leaves its \
                              end";
        for (name, failure, cause, says) in FAILURES {
            let before = self.board.hello().clone();
            if !self.fails_by(failure, &mut Received::default())? {
                let text = String::from("the board went on");
                self.check(name, false, text, "a reset", REASON);
                continue;
            }
            let is_right = |hello: &Hello| match says {
                None => hello.last_panic.is_none() && hello.panics == before.panics,
                Some(says) => [&hello.last_panic, &hello.kept_panic]
                    .iter()
                    .all(|text| text.as_deref().is_some_and(|text| text.contains(says))),
            };
            self.started_again(name, &before, cause, is_right, REASON)?;
        }
        for (name, what, cause) in [
            (
                "after the reset button",
                Prompt::PressReset,
                ResetCause::Pin,
            ),
            ("after power-off", Prompt::SwitchPower, ResetCause::PowerOn),
        ] {
            let before = self.board.hello().clone();
            let done = self.by_hand((name, REASON), what, |_| false)?;
            if done.is_none() {
                continue;
            }
            // What a panic has left is kept, and no longer reported as the end of a run.
            let is_right = |hello: &Hello| {
                hello.last_panic.is_none()
                    && (hello.panics, &hello.kept_panic) == (before.panics, &before.kept_panic)
            };
            self.started_again(name, &before, cause, is_right, REASON)?;
        }
        Ok(())
    }

    fn started_again(
        &mut self,
        name: &'static str,
        before: &Hello,
        cause: ResetCause,
        is_right: impl Fn(&Hello) -> bool,
        reason: &'static str,
    ) -> Result<(), BringUpError> {
        self.come_back(name)?;
        // The reset was asked for.
        while self.board.queued_event().is_some() {}
        self.board.start_counting();
        let hello = self.board.hello().clone();
        self.check(
            name,
            hello.epoch != before.epoch && hello.reset_cause == cause && is_right(&hello),
            format!(
                "{}: {}; it says {}, and of all runs {} ({})",
                if hello.epoch == before.epoch {
                    "no reset; the last one"
                } else {
                    "reset"
                },
                reset_cause(hello.reset_cause),
                hello.last_panic.as_deref().unwrap_or("nothing"),
                hello.kept_panic.as_deref().unwrap_or("nothing"),
                hello.panics,
            ),
            format!("reset: {}, and what ended the run", reset_cause(cause)),
            reason,
        );
        Ok(())
    }
}
