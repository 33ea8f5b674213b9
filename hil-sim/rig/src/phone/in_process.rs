//! The phone's app without a socket and without a thread, for a rig that its caller steps.
//!
//! A request is answered at the true time at which the app would have answered it, and
//! with the bytes that its server would have sent. One request is served after the other.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;

use super::app::{App, Progress, Reply, Request};
use super::{PhoneConfig, Surroundings};
use crate::clocks::oscillator::TrueTime;

/// A request of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(u64);

/// Answer to a request of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// These bytes.
    Bytes(Vec<u8>),
    /// These bytes, followed by the contents of a file.
    File {
        /// The answer's head.
        head: Vec<u8>,
        /// The file.
        path: PathBuf,
    },
    /// No connection: the phone is not on the network.
    Unreachable,
    /// The connection ended without an answer.
    Closed,
}

/// A phone whose requests are calls.
pub struct AskedPhone {
    /// The app on it.
    pub app: Arc<App>,
    asked: u64,
    waiting: VecDeque<(RequestId, String)>,
    served: Option<(RequestId, TrueTime, Request)>,
    answers: Vec<(RequestId, Answer)>,
    is_away: bool,
    is_silent: bool,
}

impl AskedPhone {
    /// Switches a phone on.
    ///
    /// # Errors
    ///
    /// There is no folder for the phone's files.
    pub fn start(config: PhoneConfig, surroundings: Surroundings) -> Result<Self> {
        Ok(Self {
            app: Arc::new(App::new(config, surroundings)?.without_threads()),
            asked: 0,
            waiting: VecDeque::new(),
            served: None,
            answers: Vec::new(),
            is_away: false,
            is_silent: false,
        })
    }

    /// Sends a request, on a connection of its own.
    pub fn ask(&mut self, line: &str) -> RequestId {
        self.asked += 1;
        let id = RequestId(self.asked);
        if self.is_away {
            self.answers.push((id, Answer::Unreachable));
        } else {
            self.waiting.push_back((id, line.to_owned()));
            self.advance();
        }
        id
    }

    /// Does what is due by now.
    pub fn advance(&mut self) {
        self.app.catch_up();
        loop {
            let (id, progress) = match self.served.take() {
                Some((id, until, request)) if !self.app.has_come(until) => {
                    self.served = Some((id, until, request));
                    return;
                }
                Some((id, _, request)) => (id, self.app.go_on(request)),
                None => match self.waiting.pop_front() {
                    Some((id, line)) => (id, self.app.begin(&line)),
                    None => return,
                },
            };
            match progress {
                Progress::Waits { until, request } => self.served = Some((id, until, request)),
                Progress::Done(reply) => self.answer(id, reply),
            }
        }
    }

    fn answer(&mut self, id: RequestId, reply: Reply) {
        if reply == Reply::Crash {
            self.app.reopen();
            self.leave_network();
        }
        let answer = match reply.written(&self.app.config.version) {
            None => Answer::Closed,
            Some((head, None)) => Answer::Bytes(head.into_bytes()),
            Some((head, Some((path, _)))) => Answer::File {
                head: head.into_bytes(),
                path,
            },
        };
        if !self.is_silent {
            self.answers.push((id, answer));
        }
    }

    /// Returns the answer to a request, once, as soon as it exists.
    pub fn take_answer(&mut self, id: RequestId) -> Option<Answer> {
        let at = self.answers.iter().position(|(of, _)| *of == id)?;
        Some(self.answers.swap_remove(at).1)
    }

    /// Takes the phone off the network: connections end, new ones are refused.
    pub fn leave_network(&mut self) {
        self.is_away = true;
        let waiting = std::mem::take(&mut self.waiting);
        let served = self.served.as_ref().map(|(id, ..)| *id);
        for id in waiting.into_iter().map(|(id, _)| id).chain(served) {
            self.answers.push((id, Answer::Closed));
        }
    }

    /// Brings it back.
    pub fn join_network(&mut self) {
        self.is_away = false;
    }

    /// Makes the network lose all answers, or deliver them again.
    pub fn set_silent(&mut self, is_silent: bool) {
        self.is_silent = is_silent;
    }
}
