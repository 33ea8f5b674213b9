//! A program as a process of its own, with what it says.

use std::io::Read;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use stm32f4_sim::shared::lock;

/// A process with what it says. It is ended when dropped.
#[derive(Debug)]
pub struct Session {
    /// The process.
    pub child: Child,
    said: Arc<Mutex<String>>,
    readers: Vec<JoinHandle<()>>,
}

impl Session {
    /// Starts a command, whose standard input stays what it is.
    ///
    /// # Errors
    ///
    /// It cannot be started.
    pub fn start(command: &mut Command) -> Result<Self, String> {
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| format!("cannot start {command:?}: {error}"))?;
        let said = Arc::new(Mutex::new(String::new()));
        let out = child.stdout.take().map(|pipe| listen(pipe, &said));
        let err = child.stderr.take().map(|pipe| listen(pipe, &said));
        Ok(Self {
            child,
            said,
            readers: out.into_iter().chain(err).collect(),
        })
    }

    /// What it has said so far.
    #[must_use]
    pub fn said(&self) -> String {
        lock(&self.said).clone()
    }

    /// The same of one that has ended: what it said last may still be on its way.
    pub fn all_said(&mut self) -> String {
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
        self.said()
    }

    /// Its number.
    pub(crate) fn pid(&self) -> Result<Pid, String> {
        i32::try_from(self.child.id())
            .ok()
            .and_then(Pid::from_raw)
            .ok_or_else(|| "a process without a number".to_owned())
    }

    /// Sends it a signal.
    ///
    /// # Errors
    ///
    /// It has ended.
    pub fn signal(&self, signal: Signal) -> Result<(), String> {
        kill_process(self.pid()?, signal).map_err(|error| error.to_string())
    }

    /// Waits for its end as long as `patience` and whoever is asked now and then allow it.
    ///
    /// # Errors
    ///
    /// It does not end.
    pub fn wait(
        &mut self,
        patience: Duration,
        go_on: impl Fn() -> bool,
    ) -> Result<ExitStatus, String> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.ended()? {
                return Ok(status);
            }
            if began.elapsed() > patience || !go_on() {
                return Err(format!("it does not end: {}", self.said()));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// How it ended, if it has.
    ///
    /// # Errors
    ///
    /// The system does not tell.
    pub fn ended(&mut self) -> Result<Option<ExitStatus>, String> {
        self.child.try_wait().map_err(|error| error.to_string())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // It has ended, or nobody wants it any more.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Adds all that comes out of a pipe to what was said.
fn listen(mut pipe: impl Read + Send + 'static, said: &Arc<Mutex<String>>) -> JoinHandle<()> {
    let said = Arc::clone(said);
    std::thread::spawn(move || {
        let mut buffer = [0; 1024];
        while let Ok(count @ 1..) = pipe.read(&mut buffer) {
            lock(&said).push_str(&String::from_utf8_lossy(&buffer[..count]));
        }
    })
}
