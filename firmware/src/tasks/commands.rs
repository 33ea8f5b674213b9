//! Carries out commands.

use core::sync::atomic::Ordering;

use protocol::{Answer, Command, HostToDevice, Refusal, Reply, SELF_TEST_KEY, Ticks};

use crate::board::tim2;
use crate::state::{self, FILLER_RATE};
use crate::tasks::self_test;

/// Carries out one command, which came in at `received`, and answers it.
pub(crate) fn carry_out(message: HostToDevice, received: Ticks) {
    let result = match message.command {
        Command::Hello => {
            let hello = state::hello();
            state::send(|outbox| outbox.hello(hello));
            Ok(Reply::Done)
        }
        Command::Ping { host_time } => Ok(Reply::Pong {
            host_time,
            received,
            sent: tim2::now(),
        }),
        Command::Filler { bytes_per_second } => {
            FILLER_RATE.store(bytes_per_second, Ordering::Relaxed);
            Ok(Reply::Done)
        }
        Command::SelfTest { key, failure } => {
            if key == SELF_TEST_KEY {
                self_test::request(failure);
                Ok(Reply::Done)
            } else {
                Err(Refusal::WrongKey)
            }
        }
        _ => Err(Refusal::TriggerStopped),
    };
    let answer = Answer {
        id: message.id,
        result,
    };
    state::send(|outbox| outbox.answer(answer));
}

pub(crate) fn tmp_trigger() -> protocol::TriggerStatus {
    protocol::TriggerStatus {
        state: protocol::TrainState::Stopped,
        train: 0,
        period: protocol::Period::MIN,
        width: 0,
        pulses: 0,
        next_edge: Ticks(0),
        next_fraction: 0,
        late: 0,
        readback: protocol::Readback {
            seen: 0,
            missing: 0,
            stray: 0,
            delay: None,
        },
    }
}
pub(crate) fn tmp_imu() -> protocol::ImuStatus {
    protocol::ImuStatus {
        state: protocol::ImuState::Starting,
        clock: protocol::ImuClock::Unknown,
        samples: 0,
        late: 0,
        overcaptures: 0,
        recoveries: 0,
        last_fault: None,
    }
}
