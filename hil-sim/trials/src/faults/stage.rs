//! The host's end of the cable of a run. The rig is on a thread of its own.
//!
//! Virtual time passes only while the host waits for bytes or for the port, so a
//! run does not depend on how fast the machine is.

use std::sync::atomic::AtomicI64;
use std::sync::mpsc::{Receiver, RecvError, SendError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use board::transport::serial::OpenError;
use board::transport::{Link, LinkError};
use board::{self, BoardError};
use smartdepthsync::record::Connector;

use super::plan::Plan;
use super::scene::{Report, Scene};
use crate::board_truth::Train;
use stm32f4_sim::i2c::lock;
use stm32f4_sim::sim::SimBuilder;

/// The name under which the port is told.
const PORT: &str = "the simulated board";

/// What the host asks of the scene.
pub(super) enum Request {
    Connect,
    Close(u64),
    Send(u64, Vec<u8>),
    Receive(u64, Duration),
    /// The recording begins, with this train.
    Begin(Train),
    End,
}

/// What the scene answers.
#[derive(Default)]
pub(super) struct Reply {
    pub now: Duration,
    pub bytes: Vec<u8>,
    /// The connection, or none if there is none (any more).
    pub connection: Option<u64>,
    pub busy: bool,
    pub report: Option<Box<Report>>,
}

/// The host's end of the scene; clones are the same.
#[derive(Clone)]
pub(super) struct Stage(Arc<Mutex<Mail>>);

struct Mail {
    requests: Sender<Request>,
    replies: Receiver<Reply>,
    thread: Option<JoinHandle<()>>,
}

impl Stage {
    /// Boots a board with everything around it.
    pub(super) fn open(
        plan: &Plan,
        builder: SimBuilder,
        clock_step: Arc<AtomicI64>,
        on_kill: impl FnMut() + Send + 'static,
    ) -> Result<Self, String> {
        let (requests, inbox) = channel();
        let (outbox, replies) = channel();
        let plan = plan.clone();
        let thread = std::thread::Builder::new()
            .name("scene".to_owned())
            .spawn(
                move || match Scene::new(plan, builder, clock_step, Box::new(on_kill)) {
                    Ok(mut scene) => {
                        let _ = outbox.send(scene.reply());
                        while let Ok(request) = inbox.recv() {
                            if outbox.send(scene.answer(request)).is_err() {
                                return;
                            }
                        }
                    }
                    Err(error) => {
                        let report = Report {
                            wrong: Some(error),
                            ..Report::default()
                        };
                        let reply = Reply {
                            report: Some(Box::new(report)),
                            ..Reply::default()
                        };
                        let _ = outbox.send(reply);
                    }
                },
            )
            .map_err(|error| error.to_string())?;
        let begun = replies.recv().map_err(|error| error.to_string())?;
        if let Some(report) = begun.report {
            return Err(report.wrong.unwrap_or_default());
        }
        Ok(Self(Arc::new(Mutex::new(Mail {
            requests,
            replies,
            thread: Some(thread),
        }))))
    }

    fn ask(&self, request: Request) -> Result<Reply, LinkError> {
        let mail = lock(&self.0);
        let gone = |reason: String| LinkError::Gone { reason };
        mail.requests
            .send(request)
            .map_err(|error: SendError<_>| gone(error.to_string()))?;
        mail.replies
            .recv()
            .map_err(|error: RecvError| gone(error.to_string()))
    }

    /// The recording begins: faults count from here.
    pub(super) fn begin(&self, train: Train) -> Result<(), LinkError> {
        self.ask(Request::Begin(train)).map(|_| ())
    }

    /// Switches the rig off.
    pub(super) fn end(&self) -> Result<Report, LinkError> {
        let reply = self.ask(Request::End)?;
        let thread = lock(&self.0).thread.take();
        drop(thread);
        reply.report.map(|report| *report).ok_or(LinkError::Stuck)
    }
}

impl Connector for Stage {
    fn connect(&mut self, _: Option<&str>) -> board::Result<Box<dyn Link>> {
        let reply = self.ask(Request::Connect)?;
        match reply.connection {
            Some(connection) => Ok(Box::new(Cable {
                stage: self.clone(),
                connection,
                now: reply.now,
            })),
            None if reply.busy => Err(BoardError::Open(OpenError::Busy {
                path: PORT.to_owned(),
            })),
            None => Err(BoardError::Open(OpenError::NotFound {
                path: PORT.to_owned(),
            })),
        }
    }
}

/// One connection.
struct Cable {
    stage: Stage,
    connection: u64,
    now: Duration,
}

impl Cable {
    fn taken(&mut self, reply: &Reply) -> Result<(), LinkError> {
        self.now = reply.now;
        if reply.connection == Some(self.connection) {
            Ok(())
        } else {
            Err(LinkError::Gone {
                reason: "unplugged".to_owned(),
            })
        }
    }
}

impl Link for Cable {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let reply = self
            .stage
            .ask(Request::Send(self.connection, bytes.to_vec()))?;
        self.taken(&reply)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let reply = self.stage.ask(Request::Receive(self.connection, wait))?;
        if reply.bytes.is_empty() {
            self.taken(&reply)
        } else {
            self.now = reply.now;
            into.extend_from_slice(&reply.bytes);
            Ok(())
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        // The scene may have ended.
        let _ = self.stage.ask(Request::Close(self.connection));
    }
}
