//! Carries out commands.

use core::sync::atomic::Ordering;

use protocol::{
    Answer, Command, HostToDevice, Output, OutputAction, Refusal, Reply, SELF_TEST_KEY, Ticks,
    TriggerStatus,
};

use crate::board::{outputs, tim2};
use crate::state::{self, FILLER_RATE};
use crate::tasks::{gnss, imu, self_test};

/// Carries out one command, which came in at `received`, and answers it.
pub(crate) fn carry_out(message: HostToDevice, received: Ticks) {
    let result = match message.command {
        Command::Hello => {
            let hello = state::hello(tim2::now());
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
        Command::TriggerStart(start) => trigger(tim2::with_pulser(|pulser, output, time| {
            pulser.start(output, time, start.into())
        })),
        Command::TriggerAlign(to) => tim2::align(message.id, &to.into()).map(Reply::Align),
        Command::TriggerPeriod(period) => {
            trigger(tim2::with_pulser(|pulser, _, _| pulser.set_period(period)))
        }
        Command::TriggerStop => {
            tim2::with_pulser(|pulser, output, time| pulser.stop(output, time));
            trigger(Ok(()))
        }
        Command::TriggerQuery => trigger(Ok(())),
        Command::ImuConfigure(config) => imu::configure(config).map(Reply::Imu),
        Command::ImuQuery => Ok(Reply::Imu(imu::setup())),
        Command::Output { output, action } => act(message.id, output, action),
        Command::GnssStart(settings) => gnss::start(settings).map(Reply::Gnss),
        Command::GnssStop => Ok(Reply::Gnss(gnss::stop())),
        Command::GnssQuery => Ok(Reply::Gnss(gnss::report())),
    };
    if let Err(refusal) = &result {
        defmt::info!("command {=u32} refused: {}", message.id, refusal);
    }
    let answer = Answer {
        id: message.id,
        result,
    };
    state::send(|outbox| outbox.answer(answer));
}

/// Carries out what one of the further outputs is asked to do.
fn act(id: u32, output: Output, action: OutputAction) -> Result<Reply, Refusal> {
    match action {
        OutputAction::Start(start) => outputs::with_output(output, |pulser, channel, time| {
            pulser.start(channel, time, start)
        })?,
        OutputAction::Align(to) => return outputs::align(output, id, &to).map(Reply::Align),
        OutputAction::Period(period) => {
            outputs::with_output(output, |pulser, _, _| pulser.set_period(period))?;
        }
        OutputAction::Stop => outputs::with_output(output, |pulser, channel, time| {
            pulser.stop(channel, time);
            Ok(())
        })?,
        OutputAction::Query => {}
    }
    let channel = outputs::channel_of(output);
    Ok(Reply::Trigger(outputs::pulser(channel).status(tim2::now())))
}

/// The state of the train behind what came of a command.
fn trigger(outcome: Result<(), Refusal>) -> Result<Reply, Refusal> {
    outcome.map(|()| Reply::Trigger(trigger_status()))
}

pub(crate) fn trigger_status() -> TriggerStatus {
    // On a copy: the status of the train as it was at one moment, worked out
    // with interrupts on.
    let (pulser, now) = tim2::with_pulser(|pulser, _, _| (*pulser, tim2::now()));
    pulser.status(now)
}
