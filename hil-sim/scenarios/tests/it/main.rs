//! Sessions, recordings and their results on the simulated rig.
//!
//! Sessions run on virtual time in the test's thread (`bench.rs`), but for what only a
//! process and a pseudo-terminal can show (`whole_rig.rs`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod adb_phone;
mod bench;
mod bring_up;
mod calibration;
mod default_profile;
mod depth_exposures;
mod doctor;
mod documented_commands;
mod evaluate_not_strobes;
mod evaluate_rendered;
mod evaluate_video;
mod extract_mkv;
mod extract_published;
mod extract_ros;
mod extract_truth;
mod extract_vendor;
mod faults;
mod first_recording;
mod frame_clock;
mod json_objects;
mod led_rendered;
mod led_session;
mod live_view;
mod phone_bench;
mod phone_command;
mod phone_rude;
mod readers;
mod record_process;
mod record_track;
mod served;
mod session_faults;
mod sessions;
mod several_sensors;
mod strobes;
mod support;
mod synthetic;
mod vendor_k4a;
mod whole_chain;
mod whole_rig;
mod wrong_boards;
