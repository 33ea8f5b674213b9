//! Services of the operating system for the host: files that are replaced whole, reads that can be
//! followed and cancelled, and other programs within limits.
//!
//! | module | gives |
//! |---|---|
//! | `files` | [`replace`], [`put_in_place`]: a file appears whole or not at all |
//! | `input` | [`open`], [`read_text`]: regular files, whose holes can be skipped |
//! | `monitor` | [`ReadMonitor`], [`Cancel`]: progress of long reads, and their end before time |
//! | `process` | [`Process`]: a child that is killed when it is dropped |
//! | `running` | [`run`], [`Running`]: a program's output within limits of time and length |
//! | `shell` | [`find_program`], [`shell_word`] |

mod files;
mod input;
mod monitor;
mod process;
mod running;
mod shell;

pub use files::{folder_of, new_file_in, put_in_place, replace};
pub use input::{Input, Sparse, open, read_text};
pub use monitor::{Cancel, ReadMonitor, ReadProgress, is_cancelled};
pub use process::Process;
pub use running::{Limits, Output, RunError, Running, run};
pub use shell::{find_program, shell_word};
