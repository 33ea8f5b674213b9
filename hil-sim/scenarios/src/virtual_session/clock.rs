//! The phone's clock, read as the program on a phone is asked for it: with the delays of a
//! link on the way.

use std::collections::VecDeque;
use std::time::Duration;

use ::phone::PhoneError;
use ::phone::agent::PhoneExchange;
use ::session::devices::{PhoneClock, PhoneClockStarter};
use rig::clocks::link_delay::{Link, LinkRanges};
use rig::random::Stream;
use rig::whole_rig::virtual_rig::VirtualRig;
use stm32f4_sim::time::SimTime;

use super::SharedRig;

/// Time from one question to the next.
const ASKED_EVERY: Duration = Duration::from_millis(40);

/// Starts to read the clock of the rig's first phone.
pub(super) struct ClockReader {
    rig: SharedRig,
    link: Option<LinkRanges>,
}

impl ClockReader {
    pub(super) const fn new(rig: SharedRig, link: Option<LinkRanges>) -> Self {
        Self { rig, link }
    }
}

impl PhoneClockStarter for ClockReader {
    fn is_possible(&self) -> bool {
        self.link.is_some()
    }

    fn start(&mut self) -> Result<Box<dyn PhoneClock>, PhoneError> {
        let link = self.link.as_ref().ok_or(PhoneError::NotConnected)?;
        let seed = self.rig.with(|rig| rig.parts().config.seed);
        Ok(Box::new(VirtualClock {
            link: Link::drawn(link, seed.stream(Stream::PhoneLink)),
            next: self.rig.now(),
            coming: VecDeque::new(),
            asked: 0,
            rig: self.rig.clone(),
        }))
    }
}

/// The clock of a phone, behind a link.
struct VirtualClock {
    rig: SharedRig,
    link: Link,
    next: Duration,
    coming: VecDeque<PhoneExchange>,
    asked: u64,
}

impl VirtualClock {
    /// Returns the answer to a question sent at a time; `None` where the link is silent.
    fn exchange(&mut self, sent: Duration) -> Option<PhoneExchange> {
        self.asked += 1;
        let nonce = self.asked;
        let board = self.rig.with(|rig| rig.parts().board.clone());
        let nanos = u64::try_from(sent.as_nanos()).unwrap_or(u64::MAX);
        let asked = board.true_at(SimTime::from_nanos(nanos));
        let [read, back] = self.link.exchange(asked)?;
        let answer = |rig: &mut VirtualRig| Some(rig.phones.first()?.app.clock_answer(nonce, read));
        Some(PhoneExchange {
            sent,
            received: Duration::from_nanos(board.board_at(back).as_nanos()),
            answer: self.rig.with(answer)?,
        })
    }
}

impl PhoneClock for VirtualClock {
    fn device(&self) -> &str {
        "the simulated phone"
    }

    fn is_by_network(&self) -> bool {
        false
    }

    fn exchanges(&mut self) -> Vec<PhoneExchange> {
        let now = self.rig.now();
        while self.next <= now {
            let sent = self.next;
            self.next += ASKED_EVERY;
            let exchange = self.exchange(sent);
            self.coming.extend(exchange);
        }
        let coming = self.coming.iter();
        let came = coming.take_while(|exchange| exchange.received <= now);
        let came = came.count();
        self.coming.drain(..came).collect()
    }
}
