//! The report of a recording: `report.html` in its folder.
//!
//! What was decided comes from `session.json`, the plots from `recording.mcap`,
//! which is read once from front to back.

use frame_sync::alignment::phase_sigma_us_at;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use protocol::{Period, Ticks};
use serde_json::json;

use board::StreamCount;
use page::chart::{self, Data, Envelope, Series};
use page::{Level, Page};
use recording::RecordingError;
use recording::reader::{Item, Reader};
use recording::session_file::{FramePeriodSource, SessionFile, SessionOutcome};
use timebase::BoardSeconds;

/// Name of the report in a recording's folder.
pub(crate) const REPORT_FILE: &str = "report.html";

/// The most problems and marks that are listed one by one.
const MAX_LISTED: usize = 200;

/// What the plots need of the recording.
#[derive(Debug, Default)]
pub(crate) struct Curves {
    gyro: [Envelope; 3],
    off_grid: Envelope,
    readback: Envelope,
    load: Envelope,
    temperature: Envelope,
    /// Pulses of further outputs by the sensor's name: how many, first and last.
    outputs: BTreeMap<String, (u64, Ticks, Ticks)>,
    /// Seconds of a lidar: how many, the last with the UTC that it was told, ns; and
    /// whether all tell one relation.
    gnss: Option<Gnss>,
    broken_off: bool,
}

#[derive(Clone, Copy, Debug)]
struct Gnss {
    seconds: u64,
    last: Ticks,
    utc_ns: i64,
    changed: bool,
}

impl Curves {
    /// Reads a recording.
    ///
    /// # Errors
    ///
    /// It cannot be opened. A recording that breaks somewhere gives what stands
    /// before.
    pub(crate) fn read(recording: &Path, session: &SessionFile) -> Result<Self, RecordingError> {
        let mut curves = Self::default();
        let mut reader = Reader::open(recording)?;
        for entry in reader.by_ref() {
            let Ok(entry) = entry else {
                curves.broken_off = true;
                break;
            };
            curves.take(entry.at, &entry.item, session);
        }
        curves.broken_off |= reader.broken_off();
        Ok(curves)
    }

    fn take(&mut self, at: Ticks, item: &Item, session: &SessionFile) {
        let x = at.as_secs_f64();
        match item {
            Item::Imu(imu) => {
                let rates: [f64; 3] = imu.angular_velocity.into();
                for (envelope, rate) in self.gyro.iter_mut().zip(rates) {
                    envelope.add(x, rate);
                }
            }
            Item::Temperature(value) => self.temperature.add(x, value.temperature),
            Item::Pulse(pulse) => {
                if pulse.readback {
                    self.readback.add(x, f64::from(pulse.readback_ticks));
                }
                if let (Some(alignment), Some(span)) = (session.alignment, session.recorded)
                    && (span.from..=span.to).contains(&at)
                {
                    let period = Period(alignment.period_q32);
                    self.off_grid
                        .add(x, period.phase_error(alignment.anchor, at).0 as f64);
                }
            }
            Item::Output(pulse) => {
                let name = pulse.header.frame_id.clone();
                // A damaged recording may hold any name.
                if self.outputs.len() < MAX_LISTED || self.outputs.contains_key(&name) {
                    let seen = self.outputs.entry(name).or_insert((0, at, at));
                    *seen = (seen.0 + 1, seen.1, at);
                }
            }
            Item::Gnss(second) => {
                let utc_ns = second.time_ref.nanos();
                let relation = |at: Ticks, utc: i64| i128::from(utc) - i128::from(at.as_nanos());
                let (seconds, changed) = self.gnss.map_or((0, false), |gnss| {
                    let moved = relation(gnss.last, gnss.utc_ns) != relation(at, utc_ns);
                    (gnss.seconds, gnss.changed || moved)
                });
                self.gnss = Some(Gnss {
                    seconds: seconds + 1,
                    last: at,
                    utc_ns,
                    changed,
                });
            }
            Item::Status(status) => {
                let load = status
                    .status
                    .iter()
                    .flat_map(|part| &part.values)
                    .find(|value| value.key == "cpu_permille")
                    .and_then(|value| value.value.parse::<f64>().ok());
                if let Some(load) = load {
                    self.load.add(x, load / 10.0);
                }
            }
            _ => {}
        }
    }
}

/// Writes the report of the recording in `folder`.
///
/// # Errors
///
/// The recording cannot be read, or the report cannot be written.
pub(crate) fn write(folder: &Path, session: &SessionFile) -> Result<PathBuf, RecordingError> {
    let curves = Curves::read(folder, session)?;
    let path = folder.join(REPORT_FILE);
    std::fs::write(&path, page(session, &curves).html()).map_err(|source| RecordingError::Io {
        action: "write",
        path: path.clone(),
        source,
    })?;
    Ok(path)
}

/// The verdict over a session in words.
pub(crate) fn verdict(session: &SessionFile) -> (Level, String) {
    let lost = session.counts.lost();
    let expected = session.alignment.map_or(String::new(), |alignment| {
        format!(
            " The middle of the depth exposure is predicted to be on the middle of the phone's \
             frame within {:.1} µs at the start, moving by at most {:.1} µs a minute (1-sigma, \
             without the constants of the profile).",
            alignment.phase_sigma_us, alignment.drift_sigma_us_per_min
        )
    });
    let problems = || {
        let first = session
            .problems
            .first()
            .map_or(String::new(), |problem| problem.text.clone());
        match session.problems.len() {
            0 => String::from("nothing more is noted"),
            1 => first,
            n => format!("{first}, and {} more (below)", n - 1),
        }
    };
    match session.outcome {
        Some(SessionOutcome::Good) => (
            Level::Good,
            format!(
                "Everything is there: {} pulses on the phone's frames, no message lost.{expected}",
                session.counts.pulses.received
            ),
        ),
        Some(SessionOutcome::Loss) => (
            Level::Warning,
            format!(
                "Recorded, but not everything is there: {}. {lost} messages were lost on the \
                 link.{expected}",
                problems()
            ),
        ),
        Some(SessionOutcome::Interrupted) => (
            Level::Warning,
            format!(
                "The session was stopped by its user; what was recorded until then is here.{expected}"
            ),
        ),
        Some(SessionOutcome::Failed) => (
            Level::Bad,
            format!(
                "The session failed: {}",
                session
                    .problems
                    .last()
                    .map_or("no reason is noted", |problem| problem.text.as_str())
            ),
        ),
        None => (
            Level::Bad,
            String::from(
                "The program was ended before it could close the session. The command repair \
                 makes a whole recording of what is there.",
            ),
        ),
    }
}

/// The report as a page.
pub(crate) fn page(session: &SessionFile, curves: &Curves) -> Page {
    let (level, verdict) = verdict(session);
    let mut page = Page::new(&format!("Recording {}", session.name), level, &verdict);
    page.facts(&facts(session));
    if curves.broken_off {
        page.note(
            Level::Warning,
            "The recording is not closed or is damaged; the plots end where it breaks. \
             The command verify says more.",
        );
    }
    warnings(&mut page, session);
    streams(&mut page, session);
    clocks(&mut page, session);
    alignment(&mut page, session);
    other_phones(&mut page, session);
    trigger(&mut page, session, curves);
    further_sensors(&mut page, session, curves);
    motion(&mut page, curves);
    marks(&mut page, session);
    page.settings("Settings: the rig profile", &json!(session.profile));
    if let Some(imu) = &session.imu {
        page.settings("Settings: the IMU", &json!(imu));
    }
    page
}

fn facts(session: &SessionFile) -> Vec<(&'static str, String)> {
    let mut facts = vec![
        ("recording", session.name.clone()),
        ("begun", session.started.clone()),
    ];
    if let Some(span) = session.recorded {
        facts.push((
            "length",
            format!("{:.3} s of board time", seconds(span.from, span.to)),
        ));
    }
    if let Some(board) = &session.board {
        facts.push((
            "board",
            format!(
                "{}, firmware {} ({}{}), reset by {:?}",
                board.id,
                board.firmware,
                board.git_revision,
                if board.git_dirty { ", changed" } else { "" },
                board.reset_cause
            ),
        ));
    }
    let several = !session.phones.is_empty();
    let others = session
        .phones
        .iter()
        .map(|phone| (&phone.name, &phone.info));
    let first = session.phone.as_ref();
    let first = first.map(|info| (&session.profile.phone.name, info));
    for (name, phone) in first.into_iter().chain(others) {
        let name = if several {
            format!("{name}: ")
        } else {
            String::new()
        };
        facts.push((
            "phone",
            match &phone.version {
                Some(version) => format!("{name}{}, app {version}", phone.address),
                None => format!("{name}{}", phone.address),
            },
        ));
    }
    facts.push(("program", session.program.clone()));
    facts
}

fn warnings(page: &mut Page, session: &SessionFile) {
    if session.problems.is_empty() {
        return;
    }
    page.section("What went wrong");
    let rows: Vec<Vec<String>> = session
        .problems
        .iter()
        .take(MAX_LISTED)
        .map(|problem| {
            vec![
                format!("{:.3}", problem.at.as_secs_f64()),
                problem.kind.clone(),
                problem.text.clone(),
            ]
        })
        .collect();
    page.table(&["board time, s", "kind", "what"], &rows);
    if session.problems.len() > MAX_LISTED {
        page.text(&format!(
            "And {} more, in session.json.",
            session.problems.len() - MAX_LISTED
        ));
    }
}

fn streams(page: &mut Page, session: &SessionFile) {
    page.section("What came from the board");
    let counts = &session.counts;
    let row = |name: &str, count: StreamCount| {
        vec![
            name.to_owned(),
            count.received.to_string(),
            count.lost.to_string(),
        ]
    };
    page.table(
        &["stream", "received", "lost"],
        &[
            row("trigger pulses", counts.pulses),
            row("IMU samples", counts.imu),
            row("strobe edges", counts.captures),
            row("status", counts.status),
            row("pulses of further outputs", counts.outputs),
            row("seconds of a lidar", counts.pps),
        ],
    );
    page.text(&format!(
        "{} frames of the link were damaged; the link was lost and taken up again {} times.",
        session.damaged_frames, session.reconnects
    ));
}

fn clocks(page: &mut Page, session: &SessionFile) {
    if session.twists.is_empty() && session.clock.is_none() {
        return;
    }
    page.section("The clocks of phone and board");
    if let Some(clock) = session.clock {
        page.facts(&[
            (
                "phone minus board",
                format!(
                    "{:.6} s ± {:.2} µs at {:.3} s of board time",
                    clock.offset,
                    clock.covariance[0][0].max(0.0).sqrt() * 1e6,
                    clock.reference.0
                ),
            ),
            (
                "rate of the phone",
                format!(
                    "{:+.4} ± {:.4} ppm",
                    clock.skew * 1e6,
                    clock.covariance[1][1].max(0.0).sqrt() * 1e6
                ),
            ),
        ]);
    }
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.3}"));
    let rows: Vec<Vec<String>> = session
        .twists
        .iter()
        .enumerate()
        .map(|(index, twist)| {
            vec![
                (index + 1).to_string(),
                format!("{:.1}", twist.span.from.as_secs_f64()),
                format!("{:.1}", seconds(twist.span.from, twist.span.to)),
                String::from(if twist.accepted { "used" } else { "refused" }),
                number(twist.offset_sigma_us),
                number(twist.clock.map(|clock| clock.skew * 1e6)),
                number(twist.skew_sigma_ppm),
            ]
        })
        .collect();
    if !rows.is_empty() {
        page.table(
            &[
                "twist",
                "at, s",
                "length, s",
                "result",
                "offset 1σ, µs",
                "rate, ppm",
                "rate 1σ, ppm",
            ],
            &rows,
        );
    }
    if let (Some(clock), Some(span)) = (session.clock, session.recorded) {
        let line = curve(span.from, span.to, |at| clock.offset_at(at).sigma * 1e6);
        let svg = chart::series(
            "board time, s",
            "1-sigma of the offset, µs",
            0.0..1.0,
            &[Series {
                name: String::from("offset"),
                data: Data::Line(line),
            }],
        );
        if !svg.is_empty() {
            page.figure(
                &svg,
                "How well a time of the phone is known in board time, over the recording (1-sigma \
                 of the last clock relation). It grows away from the twists; a second twist at \
                 the end keeps it low at both ends.",
            );
        }
    }
}

fn alignment(page: &mut Page, session: &SessionFile) {
    let Some(alignment) = session.alignment else {
        return;
    };
    page.section("How the trigger was aligned");
    page.facts(&[
        (
            "phone's frame period",
            format!(
                "{:.3} ns, {}",
                alignment.frame_period_ns,
                match alignment.frame_period_source {
                    FramePeriodSource::Learnt => "learnt from earlier recordings",
                    FramePeriodSource::VideoStart => "as the phone reported it at the start",
                }
            ),
        ),
        ("exposure used", format!("{:.1} µs", alignment.exposure_us)),
        (
            "start of the middle row",
            format!("{:.1} µs after the first", alignment.middle_row_us),
        ),
        (
            "centre of depth exposure",
            format!(
                "{:.1} µs after the trigger's edge",
                alignment.center_offset_us
            ),
        ),
        ("bias taken out", format!("{:+.1} µs", alignment.bias_us)),
        (
            "predicted phase error",
            format!("± {:.1} µs (1-sigma)", alignment.phase_sigma_us),
        ),
        (
            "predicted drift",
            format!("± {:.1} µs/min (1-sigma)", alignment.drift_sigma_us_per_min),
        ),
        (
            "arrived",
            match (alignment.arrival_pulse, alignment.arrival) {
                (Some(pulse), Some(at)) => format!("at pulse {pulse}, {:.3} s", at.as_secs_f64()),
                _ => String::from("not confirmed"),
            },
        ),
    ]);
    if let Some(span) = session.recorded {
        let line = curve(span.from, span.to, |at| phase_sigma_us_at(&alignment, at));
        let svg = chart::series(
            "board time, s",
            "1-sigma of the phase, µs",
            0.0..1.0,
            &[Series {
                name: String::from("phase"),
                data: Data::Line(line),
            }],
        );
        if !svg.is_empty() {
            page.figure(
                &svg,
                "Predicted distance of the two exposures' middles over the recording (1-sigma), \
                 from the uncertainty of clocks and frame period. The command evaluate \
                 measures it.",
            );
        }
    }
}

/// Clocks and frames of the phones that the trigger does not follow.
fn other_phones(page: &mut Page, session: &SessionFile) {
    if session.phones.is_empty() {
        return;
    }
    page.section("Further phones");
    page.text(&format!(
        "The trigger follows {}. The frames of the other phones cannot be shifted: where they lie \
         against the depth images, and how that changes, is predicted here; the command extract \
         measures it.",
        session.profile.phone.name
    ));
    let rows: Vec<Vec<String>> = session
        .phones
        .iter()
        .map(|phone| {
            let used = phone.twists.iter().filter(|twist| twist.accepted).count();
            let mut row = vec![
                phone.name.clone(),
                format!("{used} of {}", phone.twists.len()),
            ];
            let dash = || String::from("-");
            row.extend(match phone.clock {
                Some(clock) => {
                    let sigma = |at: usize| clock.covariance[at][at].max(0.0).sqrt() * 1e6;
                    [
                        format!("{:.6} ± {:.2} µs", clock.offset, sigma(0)),
                        format!("{:+.4} ± {:.4}", clock.skew * 1e6, sigma(1)),
                    ]
                }
                None => [dash(), dash()],
            });
            row.extend(match phone.placement {
                Some(placed) => [
                    format!("{:+.1} ± {:.1}", placed.offset_us, placed.offset_sigma_us),
                    format!(
                        "{:+.1} ± {:.1}",
                        placed.drift_us_per_min, placed.drift_sigma_us_per_min
                    ),
                ],
                None => [dash(), dash()],
            });
            row
        })
        .collect();
    page.table(
        &[
            "phone",
            "twists used",
            "phone minus board, s",
            "rate, ppm",
            "frames after the depth images, µs",
            "moving, µs/min",
        ],
        &rows,
    );
}

/// The sensors on the further outputs and the lidar, by name.
fn further_sensors(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let profile = &session.profile;
    if curves.outputs.is_empty()
        && curves.gnss.is_none()
        && profile.outputs.is_empty()
        && profile.lidar.is_none()
    {
        return;
    }
    page.section("Further sensors");
    let mut rows = Vec::new();
    let known = profile.outputs.iter().map(|sensor| sensor.name.as_str());
    let others = curves.outputs.keys().map(String::as_str);
    let others = others.filter(|name| !known.clone().any(|known| known == *name));
    for name in known.clone().chain(others) {
        let set = profile.outputs.iter().find(|sensor| sensor.name == name);
        let seen = curves.outputs.get(name);
        rows.push(vec![
            name.to_owned(),
            set.map_or(String::from("-"), |set| {
                format!("output {}, {}", set.output, set.rule())
            }),
            seen.map_or(0, |seen| seen.0).to_string(),
            seen.map_or(String::from("-"), |&(_, first, last)| {
                format!("{:.3} to {:.3}", first.as_secs_f64(), last.as_secs_f64())
            }),
        ]);
    }
    if !rows.is_empty() {
        page.table(&["sensor", "trigger", "pulses", "board time, s"], &rows);
    }
    let name = profile
        .lidar
        .as_ref()
        .map_or("the lidar", |lidar| lidar.name.as_str());
    match curves.gnss {
        Some(gnss) => {
            let utc = gnss.utc_ns.div_euclid(1_000_000_000);
            let told =
                jiff::Timestamp::from_second(utc).map_or(utc.to_string(), |time| time.to_string());
            page.text(&format!(
                "{name} was told {} seconds; the last, {told}, began at {:.9} s of board time.",
                gnss.seconds,
                gnss.last.as_secs_f64()
            ));
            if gnss.changed {
                page.note(
                    Level::Warning,
                    "The relation of what was told to board time changed within the recording.",
                );
            }
        }
        None if profile.lidar.is_some() => page.note(
            Level::Warning,
            &format!("{name} is in the profile, but no second was told."),
        ),
        None => {}
    }
}

fn trigger(page: &mut Page, session: &SessionFile, curves: &Curves) {
    let off_grid = range("off the grid", &curves.off_grid);
    let readback = range("read-back", &curves.readback);
    if off_grid.is_none() && readback.is_none() {
        return;
    }
    page.section("The trigger");
    if let Some(series) = off_grid {
        let svg = chart::series("board time, s", "off the grid, ticks", -2.0..2.0, &[series]);
        page.figure(
            &svg,
            "Each pulse against the grid it was sent to, in ticks of 20.83 ns. Zero everywhere: \
             every pulse was where it should be.",
        );
    }
    match readback {
        Some(series) => {
            let svg = chart::series("board time, s", "edge to wire, ticks", 0.0..10.0, &[series]);
            page.figure(
                &svg,
                "From the trigger's edge to the same edge behind the buffer, as the board measured \
                 it. Steady: the wire is good.",
            );
        }
        None if session.counts.pulses.received > 0 => page.note(
            Level::Warning,
            "The read-back input saw no pulses: nothing proves that they reached the camera. Wire \
             PA3 behind the buffer.",
        ),
        None => {}
    }
}

fn motion(page: &mut Page, curves: &Curves) {
    let gyro: Vec<Series> = ["x", "y", "z"]
        .iter()
        .zip(&curves.gyro)
        .filter_map(|(name, envelope)| range(name, envelope))
        .collect();
    if gyro.is_empty() {
        return;
    }
    page.section("Motion and board");
    let svg = chart::series("board time, s", "rad/s", -0.1..0.1, &gyro);
    page.figure(
        &svg,
        "Gyroscope of the board: smallest and largest value in each stretch of time. The twist \
         stands out at the beginning.",
    );
    for (name, unit, envelope, least) in [
        ("load of the processor", "%", &curves.load, 0.0..10.0),
        (
            "temperature of the IMU",
            "°C",
            &curves.temperature,
            20.0..30.0,
        ),
    ] {
        if let Some(series) = range(name, envelope) {
            let svg = chart::series("board time, s", unit, least, &[series]);
            page.figure(&svg, &format!("The {name}, in {unit}."));
        }
    }
}

fn marks(page: &mut Page, session: &SessionFile) {
    if session.markers.is_empty() {
        return;
    }
    page.section("Marks");
    let from = session.recorded.map_or(Ticks::ZERO, |span| span.from);
    let rows: Vec<Vec<String>> = session
        .markers
        .iter()
        .take(MAX_LISTED)
        .map(|marker| {
            vec![
                format!("{:.3}", marker.at.as_secs_f64()),
                format!("{:.3}", seconds(from, marker.at)),
                marker.label.clone(),
            ]
        })
        .collect();
    page.table(&["board time, s", "into the recording, s", "mark"], &rows);
}

fn range(name: &str, envelope: &Envelope) -> Option<Series> {
    let columns = envelope.columns();
    (!columns.is_empty()).then(|| Series {
        name: name.to_owned(),
        data: Data::Range(columns, envelope.width()),
    })
}

/// A curve over a span, of a hundred points.
fn curve(from: Ticks, to: Ticks, value: impl Fn(BoardSeconds) -> f64) -> Vec<(f64, f64)> {
    let (from, to) = (from.as_secs_f64(), to.as_secs_f64());
    (0..=100)
        .map(|step| {
            let at = from + (to - from) * f64::from(step) / 100.0;
            (at, value(BoardSeconds(at)))
        })
        .collect()
}

fn seconds(from: Ticks, to: Ticks) -> f64 {
    to.as_secs_f64() - from.as_secs_f64()
}
