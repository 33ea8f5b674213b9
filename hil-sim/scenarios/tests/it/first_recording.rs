//! The commands that `hil-sim serve` and then each other print, followed to an evaluated data set.
//! The screens are kept in `target/tmp/walk`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::live_view::Tmux;
use crate::served::Served;
use crate::support;
use crate::whole_rig::PATIENCE;
use clock::BoardToPhone;
use protocol::Ticks;
use recording::session_file::SessionFile;
use test_support::TestFolder;

/// The phone's clock as the session knows it against what the rig wrote of it, within five
/// times what is stated.
fn is_near_truth(session: &SessionFile, truth: &Path) {
    let (span, clock) = (session.recorded.unwrap(), session.clock().unwrap());
    let text = std::fs::read_to_string(truth).unwrap();
    let lines = text.lines().filter_map(|line| line.split_once(','));
    let delay_s = session.profile.phone.gyro_delay_sigma_us * 1e-6;
    let mut compared = 0;
    for (ticks, phone_ns) in lines {
        let (Ok(ticks), Ok(phone_ns)) = (ticks.parse(), phone_ns.parse::<i64>()) else {
            continue;
        };
        let at = Ticks(ticks);
        if (span.from..=span.to).contains(&at) {
            let error_s = (clock.ticks_to_phone(at).0 - phone_ns) as f64 * 1e-9;
            let sigma_s = clock.offset_at(at.as_secs_f64()).sigma.hypot(delay_s);
            assert!(error_s.abs() < 5.0 * sigma_s, "{error_s} {sigma_s}");
            compared += 1;
        }
    }
    assert!(compared > 4, "{text}");
}

/// Exit code and output of a command.
struct Typed {
    code: i32,
    lines: Vec<String>,
}

/// Types a command into a shell as a person does, with Enter where the screen says so.
fn typed(terminal: &Tmux, number: usize, command: &str) -> Typed {
    terminal.forget();
    let end = format!("code of {number} = ");
    terminal.line(&format!("clear; {command}; echo '{end}'$?"));
    let begun = Instant::now();
    loop {
        let screen = terminal.lines();
        let ended = screen
            .lines()
            .find_map(|line| line.strip_prefix(end.as_str()));
        if let Some(code) = ended.and_then(|code| code.trim().parse().ok()) {
            let lines = screen.lines().take_while(|line| !line.starts_with(&end));
            let lines = lines.map(|line| line.trim_end().to_owned()).collect();
            return Typed { code, lines };
        }
        if screen.contains("Enter go on") {
            terminal.keys("Enter");
        }
        assert!(begun.elapsed() < PATIENCE, "{command} goes on:\n{screen}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Keeps a screen for people to look at.
fn keep(number: usize, typed: &Typed) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("walk");
    std::fs::create_dir_all(&folder).unwrap();
    let name = format!("{number:02}.txt");
    std::fs::write(folder.join(name), typed.lines.join("\n")).unwrap();
}

/// From an empty folder on, nothing but what is printed is typed, in a terminal of 80 columns: with
/// less than its minutes it calibrates, records, extracts, is refused a measurement, records as the
/// refusal says, measures, and ends in a data set whose constant is known.
#[test]
fn each_next_that_is_printed_leads_on_to_an_evaluated_data_set() {
    let folder = TestFolder::new();
    let place = folder.path();
    support::smartdepthsync();
    let rig = Served::start(
        place,
        &["--speed", "6", "--motion", "twist", "--wait-for-host"],
    );
    let terminal = Tmux::run_in(80, 24, &["sh"].map(OsStr::new));
    terminal.line(&format!(
        "PS1='$ '; cd {}; export HOME=$PWD",
        place.display()
    ));
    let is_command = |line: &&str| line.trim_start().starts_with("smartdepthsync ");
    let commands = rig.commands.iter().map(|line| line.trim());
    let export = commands
        .clone()
        .find(|line| line.starts_with("export PATH="));
    terminal.line(export.unwrap());
    let mut next = commands.rev().find(is_command).map(str::to_owned);
    let mut done: Vec<String> = Vec::new();
    let is_over = |done: &[String]| done.iter().filter(|it| it.starts_with("extract")).count() == 2;
    while let Some(command) = next.filter(|_| !is_over(&done)) {
        assert!(done.len() < 12, "{done:?}");
        let shorter = command.replace("--duration 1m", "--duration 12s");
        let shorter = shorter.replace("record --calibrate", "record --calibrate --duration 60s");
        let said = typed(&terminal, done.len(), &shorter);
        keep(done.len(), &said);
        let words = command.trim_start_matches("smartdepthsync ");
        let word = words.split(' ').take(2).collect::<Vec<_>>();
        let word = match word.as_slice() {
            [verb @ ("extract" | "doctor"), ..] => (*verb).to_owned(),
            words => words.join(" "),
        };
        // A refusal is an answer if it leads on.
        let is_refused = word == "evaluate precision" && said.code == 3;
        assert!(
            said.code == 0 || is_refused,
            "{command}: {}\n{}",
            said.code,
            said.lines.join("\n")
        );
        done.push(word);
        let mut last = said.lines.iter().rev().map(|line| line.trim());
        next = last
            .find(|line| !line.is_empty())
            .filter(is_command)
            .map(str::to_owned);
        assert!(
            next.is_some(),
            "{command} ends without the next one:\n{}",
            said.lines.join("\n")
        );
    }
    drop(rig);
    assert_eq!(
        done,
        [
            "doctor",
            "record --calibrate",
            "record --duration",
            "extract",
            "evaluate precision",
            "record --shift",
            "evaluate precision",
            "record --duration",
            "extract"
        ]
    );
    let recordings = std::fs::read_dir(place.join("recordings")).unwrap();
    let mut recordings: Vec<PathBuf> = recordings.map(|entry| entry.unwrap().path()).collect();
    recordings.retain(|path| path.join("session.json").exists());
    recordings.sort();
    let recording = recordings.last().unwrap();
    let name = recording.file_name().unwrap().to_string_lossy();
    let data = recording.with_file_name(format!("{name}-euroc/mav0"));
    for camera in ["cam0", "depth0"] {
        let images = std::fs::read_dir(data.join(camera).join("data")).unwrap();
        assert!(images.count() > 200, "{camera}: {done:?}");
    }
    let session = SessionFile::load(recording).unwrap();
    assert!(session.profile.frame_sync.bias_measured.is_some());
    assert!(
        session
            .profile
            .phone
            .learnt
            .as_ref()
            .unwrap()
            .skew
            .is_some()
    );
    is_near_truth(&session, &place.join("truth.csv"));
    let pages = pages(place);
    assert!(pages.len() > done.len() / 2, "{pages:?}");
    for page in pages {
        let html = std::fs::read_to_string(&page).unwrap();
        assert!(html.contains("<h1>Simulated: "), "{}", page.display());
    }
}

/// Returns the pages below a folder.
fn pages(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    let below = entries.map(|entry| entry.unwrap().path()).flat_map(|path| {
        if path.is_dir() {
            return pages(&path);
        }
        let is_page = path.extension().is_some_and(|end| end == "html");
        is_page.then_some(path).into_iter().collect()
    });
    below.collect()
}
