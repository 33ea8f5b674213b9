//! Carries out commands.

use core::sync::atomic::Ordering;

use firmware::boards::BOARD;
use protocol::{
    Answer, Command, DeviceToHost, HostToDevice, Output, Ping, Pong, Refusal, Reply, Request,
    SELF_TEST_KEY, SelfTest, SendFiller, StartTrigger, Ticks, TriggerStatus,
};

use crate::hardware::{flash, tim2, triggers};
use crate::state::{self, FILLER};
use crate::tasks::self_test::{self, Wanted};
use crate::tasks::{gnss, imu};

/// Carries out one command, which came in at `received`, and answers it.
pub(crate) fn carry_out(message: HostToDevice, received: Ticks) {
    let id = message.id;
    let result = match message.command {
        Command::SayHello(command) => answer(command, |_| {
            let hello = state::hello(tim2::now());
            state::send(DeviceToHost::Hello(hello));
            Ok(())
        }),
        Command::Ping(command) => answer(command, |Ping { host_time }| {
            Ok(Pong {
                host_time,
                received,
                sent: tim2::now(),
            })
        }),
        Command::StartTrigger(command) => answer_of(command.output, command, start),
        Command::AlignTrigger(command) => answer_of(command.output, command, |align| {
            triggers::align(align.output, id, &align.to)
        }),
        Command::SetPeriod(command) => answer_of(command.output, command, |set| {
            triggers::with_pulser(set.output, |pulser, _, _| pulser.set_period(set.period))?;
            state_of(set.output)
        }),
        Command::StopTrigger(command) => answer_of(command.0, command, |stop| {
            triggers::with_pulser(stop.0, |pulser, output, time| pulser.stop(output, time));
            state_of(stop.0)
        }),
        Command::QueryTrigger(command) => answer_of(command.0, command, |query| state_of(query.0)),
        Command::ConfigureImu(command) => answer(command, |configure| imu::configure(configure.0)),
        Command::QueryImu(command) => answer(command, |_| Ok(imu::setup())),
        Command::StartGnss(command) => answer(command, |start| gnss::start(start.0)),
        Command::StopGnss(command) => answer(command, |_| Ok(gnss::stop())),
        Command::QueryGnss(command) => answer(command, |_| Ok(gnss::report())),
        Command::SendFiller(command) => answer(command, |SendFiller(on)| {
            FILLER.store(on, Ordering::Relaxed);
            Ok(())
        }),
        Command::SelfTest(command) => answer(command, |SelfTest { key, failure }| {
            if key != SELF_TEST_KEY {
                return Err(Refusal::WrongKey);
            }
            self_test::request(Wanted::Failure(failure));
            Ok(())
        }),
        Command::QueryBoard(command) => answer(command, |_| Ok(flash::settings())),
        Command::SetBoard(command) => answer(command, |set| {
            while_idle().and_then(|()| flash::store(set.0))
        }),
        Command::RestartIntoRom(command) => answer(command, |_| {
            while_idle()?;
            self_test::request(Wanted::Rom);
            Ok(())
        }),
    };
    if let Err(refusal) = &result {
        defmt::info!("command {=u32} refused: {}", id, refusal);
    }
    state::send(DeviceToHost::Answer(Answer { id, result }));
}

/// Carries a command out and wraps its reply.
fn answer<R: Request>(
    command: R,
    carry_out: impl FnOnce(R) -> Result<R::Reply, Refusal>,
) -> Result<Reply, Refusal> {
    carry_out(command).map(R::wrap)
}

/// Carries out a command to an output, which this board may not have.
fn answer_of<R: Request>(
    output: Output,
    command: R,
    carry_out: impl FnOnce(R) -> Result<R::Reply, Refusal>,
) -> Result<Reply, Refusal> {
    if output != Output::Camera && !BOARD.model.has_outputs() {
        return Err(Refusal::NotOnThisBoard);
    }
    answer(command, carry_out)
}

/// Refuses a command that stops the core for a while, unless all outputs are idle.
fn while_idle() -> Result<(), Refusal> {
    if triggers::is_any_running() {
        Err(Refusal::OutputRunning)
    } else {
        Ok(())
    }
}

fn start(command: StartTrigger) -> Result<TriggerStatus, Refusal> {
    triggers::with_pulser(command.output, |pulser, output, time| {
        pulser.start(output, time, command.start)
    })?;
    state_of(command.output)
}

fn state_of(output: Output) -> Result<TriggerStatus, Refusal> {
    Ok(triggers::status(output))
}
