//! A snapshot onto a screen.
//!
//! Laid out for 80 columns and 24 lines; larger screens give the room to the chart
//! and the lists, smaller ones lose the chart first. Only the sixteen colours of
//! any terminal are used, and nothing is told by colour alone.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::Line;
use ratatui::widgets::{Axis, Block, Chart, Clear, Dataset, Gauge, GraphType, Paragraph, Wrap};

use super::facts::{clock, sensor_lines, state_lines, trigger_lines};
use super::{Keys, Snapshot};

/// Below this the chart is left out.
const CHART_MIN: u16 = 20;

/// Below this width, things stand below each other.
const WIDE: u16 = 70;

/// Rows that all but chart, sensors and further phones need.
const SENSORS_MIN: u16 = 16;

/// The same with a twist, whose part must not give any room.
const TWIST_MIN: u16 = 24;

/// Rows of the twist's part.
const TWIST_ROWS: u16 = 8;

/// Rows of the smallest chart.
const CHART_ROWS: u16 = 5;

pub(super) const GOOD: Style = Style::new().fg(Color::Green);
pub(super) const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
pub(super) const WARN: Style = Style::new().fg(Color::Yellow);
pub(super) const DIM: Style = Style::new().fg(Color::DarkGray);
pub(super) const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);

/// Draws it. `help` shows what the keys do.
pub(crate) fn draw(frame: &mut Frame<'_>, snapshot: &Snapshot, help: bool) {
    let area = frame.area();
    if area.width < 20 || area.height < 6 {
        frame.render_widget(
            Paragraph::new(super::lines::line(snapshot)).wrap(Wrap { trim: true }),
            area,
        );
        return;
    }
    let (warning_lines, said_lines) = (warnings(snapshot, area.width), said(snapshot, area.width));
    let mut sensors = sensor_lines(snapshot);
    // They take room from the chart, and in a small terminal have none.
    let needed = if snapshot.twist.is_some() {
        TWIST_MIN
    } else {
        SENSORS_MIN
    };
    let room = area.height.saturating_sub(needed);
    sensors.truncate(usize::from(room));
    let panels_height = if area.width >= WIDE { 8 } else { 14 };
    let middle_min = match (&snapshot.twist, area.height >= CHART_MIN) {
        (Some(_), _) => TWIST_ROWS,
        (None, true) => CHART_ROWS,
        (None, false) => 0,
    };
    let others = 2 + panels_height + sensors.len() as u16 + middle_min;
    let (warning_height, said_height) = heights(
        area.height.saturating_sub(others),
        area.height,
        &warning_lines,
        &said_lines,
    );
    let [title, panels, rows, middle, warning, talk, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(panels_height),
        Constraint::Length(sensors.len() as u16),
        Constraint::Min(0),
        Constraint::Length(warning_height),
        Constraint::Length(said_height),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(title_line(snapshot), title);
    draw_panels(frame, snapshot, panels);
    frame.render_widget(Paragraph::new(sensors), rows);
    if let Some(twist) = &snapshot.twist {
        draw_twist(frame, twist, middle);
    } else if area.height >= CHART_MIN {
        draw_chart(frame, snapshot, middle);
    }
    draw_warnings(frame, warning_lines, warning);
    draw_said(frame, said_lines, talk);
    frame.render_widget(keys_line(snapshot.keys), keys);
    if help {
        draw_help(frame, area);
    }
}

fn title_line(snapshot: &Snapshot) -> Paragraph<'_> {
    let mut text = format!(" SmartDepthSync  {}", snapshot.state.to_uppercase());
    if let Some(recording) = &snapshot.recording {
        text.push_str(&format!("  {}", clock(recording.elapsed_s)));
        if let Some(length) = recording.length_s {
            text.push_str(&format!(" of {}", clock(length)));
        }
    }
    text.push_str(&format!(
        "   board {} at {:.1} s",
        short(&snapshot.board),
        snapshot.now.as_secs_f64()
    ));
    let style = Style::new()
        .fg(Color::Black)
        .bg(if snapshot.warnings.is_empty() {
            Color::Green
        } else {
            Color::Yellow
        });
    Paragraph::new(text).style(style)
}

fn draw_panels(frame: &mut Frame<'_>, snapshot: &Snapshot, area: Rect) {
    let [left, right] = if area.width >= WIDE {
        Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(area)
    } else {
        Layout::vertical([Constraint::Length(7), Constraint::Length(7)]).areas(area)
    };
    let block = |title: &'static str| Block::bordered().title(title).border_style(DIM);
    frame.render_widget(
        Paragraph::new(trigger_lines(snapshot)).block(block(" trigger and clocks ")),
        left,
    );
    frame.render_widget(
        Paragraph::new(state_lines(snapshot)).block(block(" rates and losses ")),
        right,
    );
}

fn draw_chart(frame: &mut Frame<'_>, snapshot: &Snapshot, area: Rect) {
    let block = Block::bordered()
        .title(" gyroscope of the board, rad/s: x red, y green, z blue ")
        .border_style(DIM);
    if area.height < 5 {
        return;
    }
    let Some(&(last, _)) = snapshot.gyro.last() else {
        frame.render_widget(Paragraph::new("no samples yet").block(block), area);
        return;
    };
    let axes: [Vec<(f64, f64)>; 3] = [0, 1, 2].map(|axis: usize| {
        snapshot
            .gyro
            .iter()
            .filter_map(|(at, rates)| Some((at - last, *rates.get(axis)?)))
            .collect()
    });
    let top = axes
        .iter()
        .flatten()
        .map(|(_, rate)| rate.abs())
        .fold(0.2, f64::max);
    let colours = [Color::Red, Color::Green, Color::Blue];
    let sets = axes
        .iter()
        .zip(colours)
        .map(|(points, colour)| {
            Dataset::default()
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(colour))
                .data(points)
        })
        .collect();
    let chart = Chart::new(sets)
        .block(block)
        .x_axis(
            Axis::default()
                .bounds([-10.0, 0.0])
                .labels(["-10 s", "-5 s", "now"])
                .style(DIM),
        )
        .y_axis(
            Axis::default()
                .bounds([-top, top])
                .labels([
                    format!("{:+.1}", -top),
                    String::from("0"),
                    format!("{top:+.1}"),
                ])
                .style(DIM),
        );
    frame.render_widget(chart, area);
}

fn draw_twist(frame: &mut Frame<'_>, twist: &super::Twist, area: Rect) {
    let [time, bar, hint] = Layout::vertical([
        Constraint::Length(3),
        Constraint::Length(3),
        Constraint::Min(0),
    ])
    .areas(area);
    let enough = twist.is_enough();
    let label = format!("{:.1} of {:.0} s", twist.elapsed_s, twist.length_s);
    let elapsed = if twist.length_s > 0.0 {
        twist.elapsed_s / twist.length_s
    } else {
        0.0
    };
    let title = " twist now, about all axes ";
    frame.render_widget(meter(title, Color::Cyan, elapsed, label), time);
    // From a hundred times too much (empty) to enough (full), by its logarithm.
    let full = twist.sigma_us.map_or(0.0, |sigma| {
        1.0 - (sigma / twist.enough_us).max(1e-9).log10() / 2.0
    });
    let label = match twist.sigma_us {
        Some(sigma) if enough => format!("{sigma:.1} us: ENOUGH (needed {:.0})", twist.enough_us),
        Some(sigma) => format!("{sigma:.1} us, needed {:.0}", twist.enough_us),
        None => String::from("no motion yet"),
    };
    let colour = if enough { Color::Green } else { Color::Yellow };
    let title = " expected 1-sigma of the offset, falling ";
    frame.render_widget(meter(title, colour, full, label), bar);
    let [x, y, z] = twist.rms;
    let style = if enough { GOOD } else { WARN }.add_modifier(Modifier::BOLD);
    frame.render_widget(
        Paragraph::new(vec![
            Line::styled(format!(" {}", twist.advice()), style),
            Line::raw(format!(" x {x:.1}   y {y:.1}   z {z:.1} rad/s rms")),
        ]),
        hint,
    );
}

/// A bar in a box, full at 1.
fn meter(title: &'static str, colour: Color, full: f64, label: String) -> Gauge<'static> {
    Gauge::default()
        .block(Block::bordered().title(title).border_style(DIM))
        .gauge_style(Style::new().fg(colour))
        .ratio(full.clamp(0.0, 1.0))
        .label(label)
}

/// Lines of a text as wide as the screen; those after the first stand further to the right.
fn wrapped(first: &str, text: &str, width: u16) -> Vec<String> {
    let width = usize::from(width);
    let further = " ".repeat(first.chars().count().min(width / 2));
    let mut lines = Vec::new();
    let mut line = first.to_owned();
    for word in text.split_whitespace() {
        let has_words = line != first && line != further;
        if has_words && line.chars().count() + 1 + word.chars().count() > width {
            lines.push(std::mem::replace(&mut line, further.clone()));
        }
        if !line.is_empty() && !line.ends_with(' ') {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines.push(line);
    lines
}

/// The warnings with what to do about them, the newest first, each in its lines.
fn warnings(snapshot: &Snapshot, width: u16) -> Vec<Vec<Line<'static>>> {
    let newest = snapshot.warnings.iter().rev();
    newest
        .map(|warning| {
            let at = format!(" ! {:.1} s: ", warning.at.as_secs_f64());
            let text = wrapped(&at, &warning.text, width).into_iter();
            let todo = wrapped("   -> ", warning.todo, width).into_iter();
            let text = text.map(|line| Line::styled(line, BAD));
            text.chain(todo.map(|line| Line::styled(line, WARN)))
                .collect()
        })
        .collect()
}

/// What was said, the newest last, each in its lines.
fn said(snapshot: &Snapshot, width: u16) -> Vec<Vec<Line<'static>>> {
    let lines = |text: &String| {
        wrapped(" ", text, width)
            .into_iter()
            .map(Line::raw)
            .collect()
    };
    snapshot.said.iter().map(lines).collect()
}

/// Rows of warnings and of what was said: at least the newest of each as a whole, where
/// there is room for it.
fn heights(
    room: u16,
    screen: u16,
    warnings: &[Vec<Line<'_>>],
    said: &[Vec<Line<'_>>],
) -> (u16, u16) {
    let (most_warnings, least_said) = if screen >= 30 { (6, 4) } else { (2, 2) };
    let newest = |lines: Option<&Vec<Line<'_>>>| lines.map_or(0, |lines| lines.len() as u16);
    let all: u16 = warnings.iter().map(|lines| lines.len() as u16).sum();
    let wanted = all.clamp(1, most_warnings).max(newest(warnings.first()));
    let talk = newest(said.last())
        .max(least_said)
        .min(room.max(least_said));
    let warning = (wanted + 1).min(room.saturating_sub(talk).max(most_warnings.min(wanted) + 1));
    (warning, talk)
}

fn draw_warnings(frame: &mut Frame<'_>, warnings: Vec<Vec<Line<'static>>>, area: Rect) {
    if warnings.is_empty() {
        frame.render_widget(Paragraph::new(" no warnings").style(GOOD), area);
        return;
    }
    let lines: Vec<Line<'_>> = warnings.into_iter().flatten().collect();
    frame.render_widget(Paragraph::new(lines), area);
}

fn draw_said(frame: &mut Frame<'_>, said: Vec<Vec<Line<'static>>>, area: Rect) {
    let mut room = usize::from(area.height);
    let mut shown = Vec::new();
    // Whole ones; of the newest, if it is longer than the room, its beginning.
    for lines in said.into_iter().rev() {
        if lines.len() > room && !shown.is_empty() {
            break;
        }
        room = room.saturating_sub(lines.len());
        shown.splice(0..0, lines);
    }
    frame.render_widget(Paragraph::new(shown), area);
}

fn keys_line<'a>(keys: Keys) -> Paragraph<'a> {
    let text = match keys {
        Keys::Look => " q stop   h help",
        Keys::Answer => " Enter go on   r twist again / repeat   s skip   q stop   h help",
        Keys::Record => " m mark   q stop   h help",
    };
    Paragraph::new(text).style(Style::new().fg(Color::Black).bg(Color::Gray))
}

fn draw_help(frame: &mut Frame<'_>, area: Rect) {
    let text = [
        "Enter  go on, where something is asked",
        "r      do the last step again (twist again)",
        "s      skip the step",
        "m      set a mark, while recording",
        "q      stop; what was recorded is kept",
        "h      this help, and away again",
        "",
        "phase: the last pulse against the grid it was sent to,",
        "       and how well that grid is known (1-sigma)",
        "clocks: error of phone time in board time now (1-sigma)",
    ];
    let width = 60.min(area.width);
    let height = (text.len() as u16 + 2).min(area.height);
    let place = Rect::new(
        area.x + (area.width - width) / 2,
        area.y + (area.height - height) / 2,
        width,
        height,
    );
    frame.render_widget(Clear, place);
    frame.render_widget(
        Paragraph::new(text.map(Line::raw).to_vec()).block(Block::bordered().title(" help ")),
        place,
    );
}

/// The end of a long ID, which is what differs.
fn short(id: &str) -> String {
    let skip = id.chars().count().saturating_sub(8);
    id.chars().skip(skip).collect()
}

#[cfg(test)]
mod tests {
    use protocol::Ticks;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::view::{
        Clock, Disk, Losses, OtherPhone, Recording, Sensor, Trigger, Twist, Warning,
    };

    fn busy() -> Snapshot {
        Snapshot {
            state: String::from("recording"),
            board: String::from("0123456789ABCDEF01234567"),
            now: Ticks(48_000_000 * 123),
            gyro: (0..250)
                .map(|k| {
                    let at = 113.0 + f64::from(k) * 0.04;
                    (at, [at.sin(), at.cos(), 0.3])
                })
                .collect(),
            trigger: Trigger {
                state: String::from("running"),
                fps: Some(30.0024),
                pulse: Some(3_456),
                phase_us: Some(0.0),
                phase_sigma_us: Some(3.4),
                twist_due: false,
                tracked: None,
                readback_ns: Some(83.0),
                readback_missing: 0,
                late: 0,
            },
            clock: Some(Clock {
                offset_s: 94_000.25,
                sigma_us: 3.1,
                skew_ppm: -15.2,
                age_s: 100.0,
            }),
            losses: Losses::default(),
            disk: Some(Disk {
                free: 40_000_000_000,
                left_s: Some(3_600_000.0),
            }),
            recording: Some(Recording {
                elapsed_s: 61.0,
                length_s: Some(300.0),
            }),
            markers: vec![(Ticks(48_000_000 * 90), String::from("door"))],
            warnings: vec![Warning {
                at: Ticks(48_000_000 * 99),
                text: String::from("2 IMU samples lost"),
                todo: "nothing to do",
            }],
            sensors: vec![
                Sensor {
                    name: String::from("side"),
                    at: String::from("output 3"),
                    state: String::from("running"),
                    rate: 5.0,
                    pulse: Some(77),
                    ..Sensor::default()
                },
                Sensor {
                    name: String::from("VLP-16"),
                    at: String::from("gnss"),
                    rate: 1.0,
                    utc: Some(1_795_234_567),
                    ..Sensor::default()
                },
            ],
            phones: vec![OtherPhone {
                name: String::from("right phone"),
                clock: None,
                placement_us: Some((1_234.0, 5.0)),
            }],
            said: vec![String::from("mark: door")],
            keys: Keys::Record,
            ..Snapshot::default()
        }
    }

    fn screen(width: u16, height: u16, snapshot: &Snapshot, help: bool) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, snapshot, help)).unwrap();
        let buffer = terminal.backend().buffer();
        (0..height)
            .map(|y| {
                (0..width)
                    .map(|x| buffer[(x, y)].symbol())
                    .collect::<String>()
                    + "\n"
            })
            .collect()
    }

    #[test]
    fn all_is_there_in_80_by_24() {
        let text = screen(80, 24, &busy(), false);
        for word in [
            "RECORDING",
            "1:01 of 5:00",
            "30.0024 fps",
            "3456",
            "+0.00 us off grid, +-3.4 us",
            "seen, 83 ns",
            "+-3.1 us now, 1:40 old",
            "0 messages",
            "40.0 GB free, for 1000:00:00",
            "door at 90.0 s",
            "2 IMU samples lost",
            "-> nothing to do",
            "mark: door",
            "side             output 3, 5.00/s, running, pulse 77",
            "VLP-16           gnss, 1.00/s, told 2026-11-21 04:16:07 UTC",
            "frames +1234 +-5 us off grid",
            "m mark",
            "gyroscope",
            "now",
        ] {
            assert!(text.contains(word), "{word}:\n{text}");
        }
    }

    #[test]
    fn a_long_fix_is_all_there_in_80_by_24() {
        let mut snapshot = busy();
        snapshot.warnings.push(Warning {
            at: Ticks(48_000_000 * 100),
            text: String::from("the depth recorder `k4arecorder` ended by itself (exit status: 1); its output is in depth_recorder.log"),
            todo: "read the recorder's log, start it again by hand in the folder of the recording, and look whether it goes on to the END",
        });
        snapshot.said.push(format!(
            "error: {}WHOLE",
            "a long sentence that goes on ".repeat(4)
        ));
        for twist in [
            None,
            Some(Twist {
                elapsed_s: 1.0,
                length_s: 9.0,
                sigma_us: None,
                enough_us: 10.0,
                rms: [0.0; 3],
            }),
        ] {
            let twists = twist.is_some();
            snapshot.twist = twist;
            snapshot.sensors.clear();
            snapshot.phones.clear();
            let text = screen(80, 24, &snapshot, false);
            for word in ["depth_recorder.log", "END", "WHOLE", "m mark"] {
                assert!(text.contains(word), "{word}:\n{text}");
            }
            assert_eq!(twists, text.contains("rad/s rms"), "{text}");
        }
    }

    #[test]
    fn what_was_said_is_not_shown_without_its_beginning() {
        let mut snapshot = busy();
        let long = format!("aligned {}(1-sigma)", "to the phone's frames ".repeat(4));
        snapshot.said = vec![long, String::from("recording")];
        let text = screen(80, 24, &snapshot, false);
        assert!(text.contains("\n recording"), "{text}");
        assert_eq!(
            text.contains("aligned"),
            text.contains("(1-sigma)"),
            "{text}"
        );
    }

    #[test]
    fn any_size_and_any_state_can_be_drawn() {
        let mut twisting = busy();
        for (elapsed, sigma) in [
            (0.0, None),
            (3.0, Some(1e9)),
            (7.0, Some(0.0)),
            (9.0, Some(5.0)),
        ] {
            twisting.twist = Some(Twist {
                elapsed_s: elapsed,
                length_s: 7.0,
                sigma_us: sigma,
                enough_us: 10.0,
                rms: [3.0, 2.0, f64::NAN],
            });
            for (width, height) in [
                (1, 1),
                (19, 5),
                (20, 6),
                (40, 10),
                (69, 12),
                (80, 24),
                (200, 60),
            ] {
                for help in [false, true] {
                    screen(width, height, &twisting, help);
                    screen(width, height, &busy(), help);
                    screen(width, height, &Snapshot::default(), help);
                }
            }
        }
    }

    #[test]
    fn the_twist_says_when_it_is_enough() {
        let mut snapshot = busy();
        snapshot.twist = Some(Twist {
            elapsed_s: 5.0,
            length_s: 7.0,
            sigma_us: Some(4.2),
            enough_us: 10.0,
            rms: [3.0, 2.0, 1.0],
        });
        let text = screen(80, 24, &snapshot, false);
        assert!(text.contains("4.2 us: ENOUGH"), "{text}");
        assert!(text.contains("enough: hold still"), "{text}");
    }
}
