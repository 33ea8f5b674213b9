//! `smartdepthsync setup`: asks for what is fixed about a rig, writes its profile, runs
//! `doctor`, and names the next command.
//!
//! Every answer has an option, so that it can be scripted. The network is never searched:
//! the phone's address comes from `adb`, which the user has connected, or from the user.

use std::io::{BufRead, IsTerminal as _};
use std::path::PathBuf;

use serde::Serialize;
use toml_edit::{Array, DocumentMut, Item, value};

use super::{PortArg, doctor};
use crate::cli::Context;
use crate::outcome::{ExitStatus, Failure, Outcome, refuse_to_overwrite};
use crate::record::preflight::Checks;
use crate::rig_profile::{FILE, ProfileArg};
use extract::run::nominal_center;
use phone::adb;
use recording::profile::{DEFAULT, Profile};

/// Modes of the depth camera with the frames a second that a rig can use, and its
/// recorder's name of the mode.
const MODES: [(&str, &[u32]); 4] = [
    ("NFOV_UNBINNED", &[30, 15, 5]),
    ("NFOV_2X2BINNED", &[30, 15, 5]),
    ("WFOV_2X2BINNED", &[30, 15, 5]),
    ("WFOV_UNBINNED", &[15, 5]),
];

/// The depth camera maker's own recorder.
const RECORDER: &str = "k4arecorder";

/// Make the profile of a rig: asks what it must know, writes `rig.toml`, checks the rig as
/// `doctor` does, and names the next command.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    /// The profile to write
    #[arg(long, value_name = "FILE", default_value = FILE)]
    profile: PathBuf,
    /// Replace the profile if it is there
    #[arg(long)]
    overwrite: bool,
    /// What the rig is called
    #[arg(long)]
    name: Option<String>,
    /// The phone's address, as the app's dialog shows it
    #[arg(long, value_name = "HOST[:PORT]")]
    phone: Option<String>,
    /// Mode of the depth camera: NFOV_UNBINNED, NFOV_2X2BINNED, WFOV_2X2BINNED, WFOV_UNBINNED
    #[arg(long, value_name = "MODE", value_parser = parse_mode)]
    depth_mode: Option<&'static str>,
    /// Frames a second of the depth camera: 30, 15 or 5
    #[arg(long, value_name = "FPS", value_parser = parse_fps)]
    fps: Option<u32>,
    /// The program that records the depth camera, with its arguments; {folder} and {fps} are
    /// filled in. `none` for none; k4arecorder if it is installed
    #[arg(long, value_name = "COMMAND")]
    recorder: Option<String>,
    /// Ask nothing: what is not given has its default
    #[arg(long)]
    yes: bool,
    /// Do not try the trigger (no pulses on the wire)
    #[arg(long)]
    no_trigger: bool,
}

fn parse_mode(text: &str) -> Result<&'static str, String> {
    let mut modes = MODES.iter().map(|(name, _)| *name);
    let found = modes.find(|name| name.eq_ignore_ascii_case(text));
    found.ok_or_else(|| {
        let names: Vec<&str> = MODES.iter().map(|(name, _)| *name).collect();
        format!("expected {}", names.join(", "))
    })
}

fn parse_fps(text: &str) -> Result<u32, &'static str> {
    let fps = text.parse().ok();
    fps.filter(|fps| [30, 15, 5].contains(fps))
        .ok_or("expected 30, 15 or 5")
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct PrintedSetup {
    profile: PathBuf,
    #[serde(flatten)]
    checks: Checks,
    /// The next command.
    next: String,
}

/// The answers.
#[derive(Clone, Debug, PartialEq)]
struct Answers {
    name: String,
    phone: String,
    mode: &'static str,
    fps: u32,
    recorder: Vec<String>,
}

/// Runs the command.
///
/// # Errors
///
/// An answer is missing or cannot be used, or the profile cannot be written. What is wrong
/// with the rig is in the result.
pub(crate) fn run(args: &Args, context: &Context) -> Result<Outcome, Failure> {
    refuse_to_overwrite(&args.profile, args.overwrite)?;
    let known = match args.phone {
        Some(_) => None,
        None => phone_by_adb(context),
    };
    let asks = !args.yes && !context.global.json;
    let mut asker = Asker {
        input: std::io::stdin().lock(),
        asks,
        is_terminal: std::io::stdin().is_terminal(),
        context,
    };
    let answers = answers(args, known, &mut asker)?;
    let text = profile_text(&answers)?;
    files::replace(&args.profile, text.as_bytes())
        .map_err(|error| Failure::file("write", &args.profile, &error))?;
    context.say(format!("wrote {}\n", args.profile.display()));
    let doctor = doctor::Args {
        port: args.port.clone(),
        profile: ProfileArg {
            profile: Some(args.profile.clone()),
        },
        phone: None,
        out: PathBuf::from(crate::recordings::FOLDER),
        no_trigger: args.no_trigger,
        no_phone: false,
    };
    let checks = doctor::look(&doctor, context);
    let is_ready = checks.failure().is_none();
    let port = args.port.port.as_deref().map_or(String::new(), |port| {
        format!(" --port {}", files::shell_word(port.as_ref()))
    });
    let profile = match args.profile.as_os_str() == FILE {
        true => String::new(),
        false => format!(" --profile {}", files::shell_word(&args.profile)),
    };
    let next = match is_ready {
        true => format!("smartdepthsync record --calibrate{port}{profile}"),
        false => format!("smartdepthsync doctor{port}{profile}"),
    };
    let printed = PrintedSetup {
        profile: args.profile.clone(),
        checks,
        next,
    };
    context.print_checks(&printed, || {
        let what = match is_ready {
            true => "next, with the phone and the rig in your hands",
            false => "mend what is BAD above; then",
        };
        let checks = crate::checks::text(&printed.checks.checks);
        format!("{checks}\n{what}\n  {}", printed.next)
    })?;
    Ok(match printed.checks.status() {
        ExitStatus::Good => Outcome::Good,
        status => Outcome::Told(status),
    })
}

/// The address of the phone that is connected by USB, if `adb` knows one.
fn phone_by_adb(context: &Context) -> Option<String> {
    let interrupt = context.interrupt.clone();
    let stop = phone::StopSignal::new(move || interrupt.requested());
    // Without adb, or without a phone, it is asked for.
    adb::wifi_address(&stop).ok().flatten()
}

/// Asks the person at the terminal, or whoever writes to standard input.
struct Asker<'a, R> {
    input: R,
    asks: bool,
    is_terminal: bool,
    context: &'a Context,
}

impl<R: BufRead> Asker<'_, R> {
    /// An answer that `take` accepts; an empty one is the default. Without anybody to ask it
    /// is the default at once.
    fn ask<T>(
        &mut self,
        question: &str,
        default: &str,
        take: impl Fn(&str) -> Result<T, String>,
    ) -> Result<T, Failure> {
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
            match take(answer) {
                Ok(taken) => return Ok(taken),
                // Nobody is there to give a better one.
                Err(expected) if ended || !self.is_terminal => {
                    let message = format!("{question}: {answer:?} is no answer; {expected}");
                    return Err(Failure::new(ExitStatus::Usage, message).next_step(
                        "give the answer as an option; `smartdepthsync help setup` lists them",
                    ));
                }
                Err(expected) => self.context.say(expected),
            }
        }
    }
}

fn answers<R: BufRead>(
    args: &Args,
    known: Option<String>,
    asker: &mut Asker<'_, R>,
) -> Result<Answers, Failure> {
    let name = match &args.name {
        Some(name) => name.clone(),
        None => asker.ask("What is the rig called?", "my rig", |text| {
            Ok(text.to_owned())
        })?,
    };
    let phone = match &args.phone {
        Some(phone) => phone.clone(),
        None => {
            let by_adb = known.as_deref().unwrap_or_default();
            let question = match by_adb.is_empty() {
                true => "The phone's address, as the app's dialog shows it?",
                false => "The phone's address (found by adb)?",
            };
            asker.ask(question, by_adb, |text| match text.trim() {
                "" => Err(String::from(
                    "expected a host such as 192.168.1.23; or give --phone",
                )),
                host => Ok(host.to_owned()),
            })?
        }
    };
    let names: Vec<&str> = MODES.iter().map(|(name, _)| *name).collect();
    let mode = match args.depth_mode {
        Some(mode) => mode,
        None => {
            let question = format!("Mode of the depth camera ({})?", names.join(", "));
            asker.ask(&question, "NFOV_UNBINNED", parse_mode)?
        }
    };
    let rates = MODES.iter().find(|(name, _)| *name == mode);
    let rates = rates.map_or(&[30][..], |(_, rates)| rates);
    let fits = |fps: u32| match rates.contains(&fps) {
        true => Ok(fps),
        false => Err(format!("{mode} has {} frames a second", list(rates))),
    };
    let fps = match args.fps {
        Some(fps) => fits(fps).map_err(|expected| {
            Failure::new(ExitStatus::Usage, format!("--fps {fps}: {expected}"))
                .next_step("give one of these, or another --depth-mode")
        })?,
        None => {
            let question = format!("Frames a second of the depth camera ({})?", list(rates));
            let most = rates.first().copied().unwrap_or(30).to_string();
            asker.ask(&question, &most, |text| fits(parse_fps(text)?))?
        }
    };
    let recorder = match &args.recorder {
        Some(recorder) => recorder.clone(),
        None => {
            let default = match files::program(RECORDER).is_some() {
                true => RECORDER,
                false => "none",
            };
            let question =
                "The program that records the depth camera (none: you start it yourself)?";
            asker.ask(question, default, |text| Ok(text.to_owned()))?
        }
    };
    Ok(Answers {
        name,
        phone,
        mode,
        fps,
        recorder: recorder_command(&recorder, mode),
    })
}

fn list(rates: &[u32]) -> String {
    let rates: Vec<String> = rates.iter().map(u32::to_string).collect();
    rates.join(", ")
}

/// Program and arguments; the maker's own recorder by itself gets those that it needs.
fn recorder_command(text: &str, mode: &str) -> Vec<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let whole = match words.as_slice() {
        [] | ["none"] => Vec::new(),
        [program] if program.rsplit('/').next() == Some(RECORDER) => vec![
            program,
            "--external-sync",
            "sub",
            "-c",
            "OFF",
            "-d",
            mode,
            "-r",
            "{fps}",
            "{folder}/depth.mkv",
        ],
        words => words.to_vec(),
    };
    whole.into_iter().map(str::to_owned).collect()
}

/// The commented default profile with the answers in it.
fn profile_text(answers: &Answers) -> Result<String, Failure> {
    let broken = |error: String| {
        Failure::new(ExitStatus::Error, format!("the default profile: {error}"))
            .next_step("report this: it is an error of the program")
    };
    let mut document: DocumentMut = DEFAULT
        .parse()
        .map_err(|error: toml_edit::TomlError| broken(error.to_string()))?;
    let mut set = |table: Option<&str>, key: &str, new: Item| {
        let item = match table {
            Some(table) => document.get_mut(table).and_then(|table| table.get_mut(key)),
            None => document.get_mut(key),
        };
        if let Some(item) = item {
            *item = new;
        }
    };
    set(None, "name", value(answers.name.as_str()));
    set(Some("phone"), "address", value(answers.phone.as_str()));
    set(Some("depth"), "mode", value(answers.mode));
    set(Some("depth"), "fps", value(i64::from(answers.fps)));
    let recorder = document
        .get_mut("depth")
        .and_then(|depth| depth.get_mut("recorder"));
    if let Some(command) = recorder.and_then(|recorder| recorder.get_mut("command")) {
        *command = value(
            answers
                .recorder
                .iter()
                .map(String::as_str)
                .collect::<Array>(),
        );
    }
    let center = document
        .get_mut("depth")
        .and_then(|depth| depth.get_mut("center_offset_us"));
    if let (Some(center), Some(nominal)) = (center, nominal_center(answers.mode)) {
        *center = value(nominal as f64 * 1e-3);
    }
    let text = document.to_string();
    let profile = Profile::parse(&text, None)?;
    let is_as_asked = profile.phone.address == answers.phone
        && profile.depth.recorder.command == answers.recorder
        && profile.depth.fps == answers.fps;
    match is_as_asked {
        true => Ok(text),
        false => Err(broken(String::from("a key of it is gone"))),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Interrupt;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn asked(options: &[&str], lines: &str, by_adb: Option<&str>) -> Result<Answers, Failure> {
        let line = Line::try_parse_from(std::iter::once(&"setup").chain(options)).unwrap();
        let context = Context::quiet(Interrupt::default());
        let mut asker = Asker {
            input: lines.as_bytes(),
            asks: !line.args.yes,
            is_terminal: false,
            context: &context,
        };
        answers(&line.args, by_adb.map(str::to_owned), &mut asker)
    }

    #[test]
    fn what_is_typed_and_what_is_given_come_to_the_same() {
        let typed = "desk\n10.0.0.7\nwfov_unbinned\n5\nk4arecorder\n";
        let typed = asked(&[], typed, None).unwrap();
        let given = [
            "--name",
            "desk",
            "--phone",
            "10.0.0.7",
            "--depth-mode",
            "WFOV_UNBINNED",
            "--fps",
            "5",
            "--recorder",
            "k4arecorder",
            "--yes",
        ];
        assert_eq!(asked(&given, "", None).unwrap(), typed);
        assert_eq!(typed.recorder.last().unwrap(), "{folder}/depth.mkv");
        let text = profile_text(&typed).unwrap();
        let profile = Profile::parse(&text, None).unwrap();
        assert_eq!(profile.name, "desk");
        assert_eq!(profile.depth.mode, "WFOV_UNBINNED");
        assert!((profile.depth.center_offset_us - 10_122.5).abs() < 1e-9);
        assert!(
            text.contains("# Where the app (OpenCamera Sensors) listens"),
            "{text}"
        );
    }

    #[test]
    fn defaults_are_taken_and_an_address_never_invented() {
        let default = asked(&["--recorder", "none"], "", Some("10.1.1.1")).unwrap();
        assert_eq!((default.phone.as_str(), default.fps), ("10.1.1.1", 30));
        assert!(default.recorder.is_empty());
        let nobody = asked(&["--yes"], "", None).unwrap_err();
        assert_eq!(nobody.status(), ExitStatus::Usage);
        assert!(nobody.to_string().contains("address"), "{nobody}");
        let wrong = asked(&["--phone", "x"], "\nNFOV\n", None).unwrap_err();
        assert!(wrong.to_string().contains("NFOV_UNBINNED"), "{wrong}");
        let rate = asked(
            &[
                "--phone",
                "x",
                "--depth-mode",
                "WFOV_UNBINNED",
                "--fps",
                "30",
                "--yes",
            ],
            "",
            None,
        );
        assert!(rate.unwrap_err().to_string().contains("15, 5"));
    }

    #[test]
    fn another_recorder_keeps_its_arguments() {
        let command = recorder_command("my-recorder {folder}/d.mkv {fps}", "NFOV_UNBINNED");
        assert_eq!(command, ["my-recorder", "{folder}/d.mkv", "{fps}"]);
    }
}
