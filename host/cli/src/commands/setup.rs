//! `smartdepthsync setup`: asks for what is fixed about a rig, writes its profile, runs
//! `doctor`, and names the next command.
//!
//! Every answer has an option, so that it can be scripted. The network is never searched:
//! the phone's address comes from `adb`, which the user has connected, or from the user.

use std::io::{BufRead, IsTerminal as _};
use std::path::PathBuf;

use toml_edit::{Item, value};

use super::doctor;
use crate::context::Context;
use crate::decimal::parse_micros;
use crate::new_profile::{Camera, recorder_command, text};
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure, refuse_to_overwrite, write_file};
use crate::rig_profile::{FILE, ProfileArg};
use phone::{adb, check_address};
use recording::camera::{DEFAULT_CAMERA, Mode, Model};

/// Create the profile of a rig: asks for what is unknown, writes `rig.toml`, checks the rig as
/// `doctor` does, and names the next command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync setup --phone 192.168.1.50 --recorder k4arecorder")]
pub(crate) struct SetupArgs {
    #[command(flatten)]
    port: PortArg,
    /// The profile to write
    #[arg(long, value_name = "FILE", default_value = FILE)]
    profile: PathBuf,
    /// Replace the profile if it is there
    #[arg(long)]
    overwrite: bool,
    /// Name of the rig
    #[arg(long)]
    name: Option<String>,
    /// Address of the phone, as the app's dialog shows it
    #[arg(long, value_name = "HOST[:PORT]")]
    phone: Option<String>,
    #[command(flatten)]
    camera: CameraArg,
    /// Program that records the depth camera, with its arguments; {folder} and {fps} are filled in,
    /// and `none` means no program [default: the camera's own, if it is installed]
    #[arg(long, value_name = "COMMAND")]
    recorder: Option<String>,
    /// Never prompt; use the defaults for options that are not given
    #[arg(long)]
    yes: bool,
    /// Skip the trigger (no pulses on the wire)
    #[arg(long)]
    no_trigger: bool,
}

/// The options that name a depth camera.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub(crate) struct CameraArg {
    /// Model of the depth camera
    #[arg(long, value_name = "MODEL", value_parser = parse_model)]
    pub(crate) camera: Option<&'static Model>,
    /// Mode of the depth camera, as its programs call it
    #[arg(long, value_name = "MODE")]
    pub(crate) depth_mode: Option<String>,
    /// Exposure of the depth camera, such as 8ms, for models whose exposure can be set
    #[arg(long, value_name = "TIME", value_parser = parse_exposure)]
    pub(crate) exposure: Option<f64>,
}

impl CameraArg {
    /// The mode that is given, of this model.
    ///
    /// # Errors
    ///
    /// It has no such mode.
    pub(crate) fn mode(&self, model: &'static Model) -> Result<Option<&'static Mode>, Failure> {
        let given = self.depth_mode.as_deref();
        given
            .map(|given| {
                parse_mode(model, given).map_err(|expected| {
                    Failure::new(
                        ExitStatus::Usage,
                        format!("--depth-mode {given}: {expected}"),
                    )
                    .next_step("give one of these, or another --camera")
                })
            })
            .transpose()
    }

    /// The exposure that is given, of this mode.
    ///
    /// # Errors
    ///
    /// The mode's exposure cannot be set.
    pub(crate) fn exposure_us(&self, mode: &Mode) -> Result<Option<f64>, Failure> {
        match self.exposure {
            Some(_) if !mode.follows_exposure() => Err(Failure::new(
                ExitStatus::Usage,
                format!(
                    "--exposure: the exposure of {} cannot be set; the middle of its \
                     frames is known without it",
                    mode.name
                ),
            )
            .next_step("leave the option out")),
            given => Ok(given),
        }
    }
}

fn parse_model(text: &str) -> Result<&'static Model, String> {
    Model::find(text).ok_or_else(|| format!("expected {}", Model::ids()))
}

fn parse_mode(model: &'static Model, text: &str) -> Result<&'static Mode, String> {
    model
        .mode(text.trim())
        .ok_or_else(|| format!("{} has {}", model.name, model.mode_names()))
}

fn parse_exposure(text: &str) -> Result<f64, String> {
    let micros = parse_micros(text).ok();
    micros
        .filter(|micros| (1.0..=200_000.0).contains(micros))
        .ok_or_else(|| String::from("expected 1us to 200ms"))
}

/// Runs the command.
///
/// # Errors
///
/// An answer is missing or cannot be used, or the profile cannot be written. What is wrong
/// with the rig is in the result.
pub(crate) fn run(args: &SetupArgs, context: &Context) -> Result<ExitStatus, Failure> {
    refuse_to_overwrite(&args.profile, args.overwrite)?;
    let known = match args.phone {
        Some(_) => None,
        // Without adb, or without a phone at USB, it is asked for.
        None => adb::wifi_address(&context.interrupt.cancel())
            .ok()
            .flatten(),
    };
    let asks = !args.yes && !context.global.json;
    let mut asker = Asker {
        input: std::io::stdin().lock(),
        asks,
        is_terminal: std::io::stdin().is_terminal(),
        context,
    };
    let text = asked_profile(args, known, &mut asker)?;
    write_file(&args.profile, &text)?;
    context.say(format!("wrote {}\n", args.profile.display()));
    let doctor = doctor::DoctorArgs {
        port: args.port.clone(),
        profile: ProfileArg {
            profile: Some(args.profile.clone()),
        },
        no_trigger: args.no_trigger,
        no_phone: false,
    };
    doctor::run(&doctor, context)
}

/// Asks questions on the terminal, or reads the answers from standard input.
struct Asker<'a, R> {
    input: R,
    asks: bool,
    is_terminal: bool,
    context: &'a Context,
}

impl<R: BufRead> Asker<'_, R> {
    /// Returns the value that is given as an option, else an answer that `parse` accepts. An empty
    /// answer means the default, as does a run without questions.
    fn ask<T>(
        &mut self,
        given: Option<T>,
        question: &str,
        default: &str,
        parse: impl Fn(&str) -> Result<T, String>,
    ) -> Result<T, Failure> {
        if let Some(given) = given {
            return Ok(given);
        }
        loop {
            let mut line = String::new();
            if self.asks {
                let shown = match default {
                    "" => String::new(),
                    default => format!(" [{default}]"),
                };
                self.context.say(format!("{question}{shown}"));
                self.input.read_line(&mut line)?;
            }
            let ended = line.is_empty();
            let answer = match line.trim() {
                "" => default,
                given => given,
            };
            match parse(answer) {
                Ok(value) => return Ok(value),
                // There will be no better answer.
                Err(expected) if ended || !self.is_terminal => {
                    let message = format!("{question}: {answer:?} is not an answer; {expected}");
                    return Err(Failure::new(ExitStatus::Usage, message).next_step(
                        "give the answer as an option; `smartdepthsync help setup` lists them",
                    ));
                }
                Err(expected) => self.context.say(expected),
            }
        }
    }
}

/// The profile that the answers make.
fn asked_profile<R: BufRead>(
    args: &SetupArgs,
    known: Option<String>,
    asker: &mut Asker<'_, R>,
) -> Result<String, Failure> {
    let as_typed = |text: &str| Ok(text.to_owned());
    let name = asker.ask(
        args.name.clone(),
        "What is the rig called?",
        "my rig",
        as_typed,
    )?;
    let by_adb = known.as_deref().unwrap_or_default();
    let question = if by_adb.is_empty() {
        "The phone's address, as the app's dialog shows it?"
    } else {
        "The phone's address (found by adb)?"
    };
    if let Some(given) = &args.phone {
        check_address(given)?;
    }
    let phone = asker.ask(args.phone.clone(), question, by_adb, |host| {
        let expected = "expected a host such as 192.168.1.23; or give --phone";
        let checked = check_address(host).map_err(|error| format!("{error}; {expected}"));
        checked.map(|()| host.to_owned())
    })?;
    let camera = ask_camera(args, asker)?;
    let usual = camera.model.recorder.first();
    let usual = usual.filter(|usual| system::find_program(usual).is_some());
    let default = usual.map_or("none", String::as_str);
    let question = "The program that records the depth camera (none: you start it yourself)?";
    let recorder = asker.ask(args.recorder.clone(), question, default, as_typed)?;
    let recorder = recorder_command(&recorder, camera.model, camera.mode);
    let mut set: Vec<(&[&str], Item)> = vec![
        (&["name"], value(name)),
        (&["phone", "address"], value(phone)),
        (&["depth", "recorder", "command"], value(recorder)),
    ];
    let port = args.port.port.as_deref();
    set.extend(port.map(|port| (["port"].as_slice(), value(port))));
    text(&camera, &set)
}

fn ask_camera<R: BufRead>(args: &SetupArgs, asker: &mut Asker<'_, R>) -> Result<Camera, Failure> {
    let given = &args.camera;
    let question = format!("Which depth camera ({})?", Model::ids());
    let model = asker.ask(given.camera, &question, DEFAULT_CAMERA, parse_model)?;
    let question = format!("Mode of the depth camera ({})?", model.mode_names());
    let default = &model.default_mode.name;
    let mode = asker.ask(given.mode(model)?, &question, default, |text| {
        parse_mode(model, text)
    })?;
    let mut camera = Camera::new(model, Some(mode));
    camera.exposure_us = given.exposure_us(mode)?;
    Ok(camera)
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::context::{Global, Interrupt};
    use recording::profile::Profile;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: SetupArgs,
    }

    fn asked(options: &str, lines: &str, by_adb: Option<&str>) -> Result<String, Failure> {
        let words = std::iter::once("setup").chain(options.split_terminator(' '));
        let line = Line::try_parse_from(words).unwrap();
        let context = Context {
            global: Global {
                json: true,
                quiet: false,
                verbose: 0,
            },
            interrupt: Interrupt::default(),
        };
        let mut asker = Asker {
            input: lines.as_bytes(),
            asks: !line.args.yes,
            is_terminal: false,
            context: &context,
        };
        asked_profile(&line.args, by_adb.map(str::to_owned), &mut asker)
    }

    #[test]
    fn what_is_typed_and_what_is_given_come_to_the_same() {
        let typed = "desk\n10.0.0.7\n\nwfov_unbinned\nk4arecorder\n";
        let typed = asked("", typed, None).unwrap();
        let given = "--name desk --phone 10.0.0.7 --depth-mode WFOV_UNBINNED --yes";
        let given = format!("{given} --recorder k4arecorder");
        assert_eq!(asked(&given, "", None).unwrap(), typed);
        let profile = Profile::parse(&typed, None).unwrap();
        assert_eq!(profile.name, "desk");
        assert_eq!(profile.depth.mode, "WFOV_UNBINNED");
        assert_eq!(
            profile.depth.recorder.command.last().unwrap(),
            "{folder}/depth.mkv"
        );
        assert!((profile.depth.center_offset_us - 10_122.5).abs() < 1e-9);
        assert!(
            typed.contains("# Where the app (OpenCamera Sensors) listens"),
            "{typed}"
        );
    }

    #[test]
    fn another_camera_brings_its_modes() {
        let typed = "desk\n10.0.0.7\nrealsense-d400\n1280x720\nnone\n";
        let typed = asked("--exposure 6ms", typed, None).unwrap();
        let profile = Profile::parse(&typed, None).unwrap();
        assert_eq!(
            (profile.depth.camera.as_str(), profile.depth.fps),
            ("realsense-d400", 15)
        );
        assert_eq!(profile.depth.center_offset_us, 880.0 + 3_000.0);
        assert_eq!(profile.depth.pulse_width_us, 110.0);
        let mode = asked("--phone x --camera oak --depth-mode NFOV --yes", "", None);
        assert!(mode.unwrap_err().to_string().contains("800P"));
    }

    #[test]
    fn defaults_are_taken_and_an_address_never_invented() {
        let default = asked("--recorder none", "", Some("10.1.1.1")).unwrap();
        let Profile { phone, depth, .. } = Profile::parse(&default, None).unwrap();
        assert_eq!((phone.address.as_str(), depth.fps), ("10.1.1.1", 30));
        assert!(depth.recorder.command.is_empty());
        let nobody = asked("--yes", "", None).unwrap_err();
        assert_eq!(nobody.status(), ExitStatus::Usage);
        assert!(nobody.to_string().contains("address"), "{nobody}");
        let wrong = asked("--phone x", "\n\nNFOV\n", None).unwrap_err();
        assert!(wrong.to_string().contains("NFOV_UNBINNED"), "{wrong}");
    }

    #[test]
    fn another_recorder_keeps_its_arguments() {
        let typed = "\n\n\nmy-recorder {folder}/d.mkv {fps}\n";
        let text = asked("--phone x", typed, None).unwrap();
        let command = Profile::parse(&text, None).unwrap().depth.recorder.command;
        assert_eq!(command, ["my-recorder", "{folder}/d.mkv", "{fps}"]);
    }
}
