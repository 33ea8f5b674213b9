//! Commands of the host, each with its reply.
//!
//! A command is a type of its own, and its [`Request::Reply`] another: a host that
//! expects, or a board that gives, the reply of another command does not compile.

use serde::{Deserialize, Serialize};

use crate::board::BoardSettings;
use crate::edges::Period;
use crate::gnss::{GnssReport, GnssSettings};
use crate::imu::{ImuConfig, ImuSetup};
use crate::trigger::{AlignPlan, Output, TriggerAlign, TriggerStart, TriggerStatus};
use crate::units::Ticks;

/// A command with the type of its reply.
pub trait Request: Clone + Into<Command> {
    /// The reply to the command.
    type Reply;

    /// Name in messages to people.
    const NAME: &'static str;

    /// Wraps the reply as it is sent.
    fn wrap(reply: Self::Reply) -> Reply;

    /// Returns the reply of this command, or `None` if `reply` is another's.
    fn unwrap(reply: Reply) -> Option<Self::Reply>;
}

/// Declares the variants of [`Command`] and [`Reply`], in their order on the wire.
macro_rules! commands {
    ($($request:ident => $reply:ty, $name:literal;)+) => {
        /// A command as it is sent.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub enum Command {
            $(
                #[allow(missing_docs, reason = "the type says it")]
                $request($request),
            )+
        }

        /// The reply to a command that was carried out; its variants have the names
        /// of the commands.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub enum Reply {
            $(
                #[allow(missing_docs, reason = "the command says it")]
                $request($reply),
            )+
        }

        impl Command {
            /// Returns the name in messages to people.
            #[must_use]
            pub const fn name(&self) -> &'static str {
                match self {
                    $(Self::$request(_) => $name,)+
                }
            }
        }

        $(
            impl From<$request> for Command {
                fn from(request: $request) -> Self {
                    Self::$request(request)
                }
            }

            impl Request for $request {
                type Reply = $reply;

                const NAME: &'static str = $name;

                fn wrap(reply: $reply) -> Reply {
                    Reply::$request(reply)
                }

                fn unwrap(reply: Reply) -> Option<$reply> {
                    match reply {
                        Reply::$request(reply) => Some(reply),
                        _ => None,
                    }
                }
            }
        )+
    };
}

commands! {
    SayHello => (), "hello";
    Ping => Pong, "ping";
    StartTrigger => TriggerStatus, "trigger start";
    AlignTrigger => AlignPlan, "trigger align";
    SetPeriod => TriggerStatus, "trigger period";
    StopTrigger => TriggerStatus, "trigger stop";
    QueryTrigger => TriggerStatus, "trigger status";
    ConfigureImu => ImuSetup, "imu configure";
    QueryImu => ImuSetup, "imu status";
    StartGnss => GnssReport, "gnss start";
    StopGnss => GnssReport, "gnss stop";
    QueryGnss => GnssReport, "gnss status";
    SendFiller => (), "filler";
    SelfTest => (), "self test";
    QueryBoard => BoardSettings, "board settings";
    SetBoard => BoardSettings, "board settings";
    RestartIntoRom => (), "restart into the ROM";
}

/// Send a [`crate::Hello`], before the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SayHello;

/// Report the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// Any number of the host's, returned as it is.
    pub host_time: u64,
}

/// To [`Ping`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// The number of the ping.
    pub host_time: u64,
    /// When the command was taken from the link.
    pub received: Ticks,
    /// When the answer was put into the outbox.
    pub sent: Ticks,
}

/// Start a train. Where one runs that was started with the same parameters, nothing
/// changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StartTrigger {
    /// The output.
    pub output: Output,
    /// The train.
    pub start: TriggerStart,
}

/// Move the running train onto an absolute grid. An [`crate::Arrived`] follows. An align
/// replaces one that is still on its way, whose [`crate::Arrived`] then never comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlignTrigger {
    /// The output.
    pub output: Output,
    /// The grid.
    pub to: TriggerAlign,
}

/// Set another period, from the next edge that is not armed yet on. The phase continues
/// from that edge. Refused while an align is on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetPeriod {
    /// The output.
    pub output: Output,
    /// Distance of the pulses.
    pub period: Period,
}

/// Stop the train after the pulse that is being made, if any.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopTrigger(
    /// The output.
    pub Output,
);

/// Report the status of the train.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueryTrigger(
    /// The output.
    pub Output,
);

/// Set up the IMU; sampling restarts, unless it is set up so already and has not failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfigureImu(
    /// The settings.
    pub ImuConfig,
);

/// Report the setup of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueryImu;

/// Start the pulse per second and its sentences, on the next whole second of board time.
/// Where it runs with the same settings, nothing changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StartGnss(
    /// The settings.
    pub GnssSettings,
);

/// Stop the pulse per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopGnss;

/// Report the status of the pulse per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueryGnss;

/// Send as much filler as USB takes, or no more of it. To load the link in tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendFiller(
    /// True to start, false to stop.
    pub bool,
);

/// Report the settings that the board keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueryBoard;

/// Keep other settings, from now on and over power-off. Refused while an output runs: the core
/// stands still while it writes its flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetBoard(
    /// The settings.
    pub BoardSettings,
);

/// Leave the bus and restart into the chip's ROM, which takes firmware by DFU (AN2606).
/// Refused while an output runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RestartIntoRom;

/// Fail on purpose, to try out the recovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SelfTest {
    /// Must be [`SELF_TEST_KEY`]; anything else is refused.
    pub key: u32,
    /// The failure to cause.
    pub failure: Failure,
}

/// The key of [`SelfTest`], so that no stray bytes crash a rig.
pub const SELF_TEST_KEY: u32 = 0x5EED_FA11;

/// The failures that [`SelfTest`] can cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Failure {
    /// Panic with a known message; the next [`crate::Hello`] must report it.
    Panic,
    /// A task that never yields; the watchdog must reset the board.
    Hang,
    /// An undefined instruction, which ends in a HardFault.
    HardFault,
    /// One task that stops being alive while all others go on; the watchdog
    /// must reset the board.
    Stall,
    /// The handler of the camera's trigger takes 50 µs longer from now on, which the
    /// times in [`crate::Handlers`] must show.
    SlowHandler,
    /// A task that overflows its stack; the next [`crate::Hello`] must say so.
    StackOverflow,
    /// Leave the bus for 0.3 s and come back, as by a cable that is pulled. The run goes on.
    LeaveBus,
    /// A handler that overflows its stack; the next [`crate::Hello`] must say so.
    HandlerOverflow,
}
