//! Sessions, recordings and their results on the simulated rig.
//!
//! Every test that runs for more than a moment takes its turn (`turn.rs`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod adb_phone;
mod bring_up;
mod doctor;
mod documented_commands;
mod evaluate_rendered;
mod evaluate_video;
mod extract_mkv;
mod extract_published;
mod extract_ros;
mod extract_truth;
mod extract_vendor;
mod faults;
mod first_recording;
mod imu_csv;
mod json_objects;
mod live_view;
mod long_run;
mod moving_thing;
mod phone_bench;
mod phone_command;
mod phone_rude;
mod phone_twist;
mod readers;
mod record;
mod record_boards;
mod record_faults;
mod record_kill;
mod record_outputs;
mod record_phones;
mod record_track;
mod several_sensors;
mod strobes;
mod support;
mod synthetic;
mod turn;
mod vendor_k4a;
mod virtual_session;
mod whole_chain;
mod whole_rig;
