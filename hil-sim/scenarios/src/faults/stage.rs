//! The host's end of the cable of a run. The rig is on a thread of its own.
//!
//! Virtual time passes only while the host waits for bytes or for the port, so a
//! run does not depend on how fast the machine is.

use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use board::BoardError;
use board::transport::{Link, LinkError};
use smartdepthsync::record::Connector;

use super::plan::Plan;
use super::scene::{Report, Scene};
use crate::board_truth::Train;
use stm32f4_sim::sim::SimBuilder;

/// What is to be done on the scene's thread.
type Work = Box<dyn FnOnce(&mut Scene) + Send>;

/// The host's end of the scene, which ends with its last clone.
#[derive(Clone)]
pub(super) struct Stage(Sender<Work>);

impl Stage {
    /// Boots a board with everything around it.
    pub(super) fn open(
        plan: &Plan,
        builder: SimBuilder,
        clock_step: Arc<AtomicI64>,
        on_kill: impl FnMut() + Send + 'static,
    ) -> Result<Self, String> {
        let (stage, inbox) = channel::<Work>();
        let (ready, started) = channel();
        let plan = plan.clone();
        std::thread::Builder::new()
            .name("scene".to_owned())
            .spawn(
                move || match Scene::new(plan, builder, clock_step, Box::new(on_kill)) {
                    Ok(mut scene) => {
                        let _ = ready.send(Ok(()));
                        inbox.into_iter().for_each(|work| work(&mut scene));
                    }
                    Err(error) => drop(ready.send(Err(error))),
                },
            )
            .map_err(|error| error.to_string())?;
        started.recv().map_err(|error| error.to_string())??;
        Ok(Self(stage))
    }

    /// Has something done on the scene's thread.
    fn ask<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Scene) -> T + Send + 'static,
    ) -> Result<T, LinkError> {
        let (reply, answer) = channel();
        let work = move |scene: &mut Scene| drop(reply.send(work(scene)));
        let gone = |reason: String| LinkError::Gone { reason };
        self.0
            .send(Box::new(work))
            .map_err(|error| gone(error.to_string()))?;
        answer.recv().map_err(|error| gone(error.to_string()))
    }

    /// The recording begins: faults count from here.
    pub(super) fn begin(&self, train: Train) -> Result<(), LinkError> {
        self.ask(move |scene| scene.begin(train))
    }

    /// What was seen by the end.
    pub(super) fn end(&self) -> Result<Report, LinkError> {
        self.ask(Scene::end)
    }
}

impl Connector for Stage {
    fn connect(&mut self, _: Option<&str>) -> board::Result<Box<dyn Link>> {
        let (opened, now) = self.ask(|scene| (scene.connect(), scene.now()))?;
        Ok(Box::new(Cable {
            stage: self.clone(),
            connection: opened.map_err(BoardError::Open)?,
            now,
        }))
    }
}

/// One connection.
struct Cable {
    stage: Stage,
    connection: u64,
    now: Duration,
}

impl Cable {
    /// Has something done, and says whether the connection is still there.
    fn ask<T: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut Scene, u64) -> T + Send + 'static,
    ) -> Result<(T, bool), LinkError> {
        let connection = self.connection;
        let (done, now, is_there) = self.stage.ask(move |scene| {
            let done = work(scene, connection);
            (done, scene.now(), scene.has(connection))
        })?;
        self.now = now;
        Ok((done, is_there))
    }
}

fn still_there(is_there: bool) -> Result<(), LinkError> {
    let unplugged = || LinkError::Gone {
        reason: String::from("unplugged"),
    };
    is_there.then_some(()).ok_or_else(unplugged)
}

impl Link for Cable {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let bytes = bytes.to_vec();
        let ((), is_there) = self.ask(move |scene, connection| scene.send(connection, &bytes))?;
        still_there(is_there)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let (bytes, is_there) =
            self.ask(move |scene, connection| scene.receive(connection, wait))?;
        into.extend_from_slice(&bytes);
        still_there(is_there || !bytes.is_empty())
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        // The scene may have ended.
        let _ = self.ask(|scene, connection| scene.close(connection));
    }
}
