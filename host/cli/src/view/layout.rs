//! The layout of the state on a screen; the words are in [`facts`].
//!
//! Laid out for 80 columns and 24 lines. Larger screens give more room to the chart and the
//! lists, smaller ones lose the chart first. Only the sixteen colours of any terminal are used,
//! and nothing is shown by colour alone.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Clear, Dataset, Gauge, GraphType, Paragraph, Wrap};

use protocol::Ticks;

use super::facts::{self, Fact, Mood};
use super::plain::line;
use super::state::{Keys, State, Twist};
use crate::terminal::broken;

/// Height of the screen below which the chart is left out.
const CHART_MIN: u16 = 20;

/// Width of the screen below which the panels are stacked.
const WIDE: u16 = 70;

/// Rows needed by everything except chart, sensors and other phones.
const SENSORS_MIN: u16 = 16;

/// Rows needed during a twist, whose part must keep its size.
const TWIST_MIN: u16 = 24;

/// Rows of the twist's part.
const TWIST_ROWS: u16 = 8;

/// Rows of the smallest chart.
const CHART_ROWS: u16 = 5;

const GOOD: Style = Style::new().fg(Color::Green);
const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
const WARN: Style = Style::new().fg(Color::Yellow);
const DIM: Style = Style::new().fg(Color::DarkGray);
const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);

/// Draws the state. With `help`, the meaning of the keys is shown above it.
pub(crate) fn draw(frame: &mut Frame<'_>, state: &State, help: bool) {
    let area = frame.area();
    if area.width < 20 || area.height < 6 {
        let line = Paragraph::new(line(state)).wrap(Wrap { trim: true });
        return frame.render_widget(line, area);
    }
    let twist = state.twist();
    let (warning_lines, said_lines) = (warnings(state, area.width), said(state, area.width));
    let mut sensors = sensor_lines(state);
    // They take room from the chart, and in a small terminal have none.
    let needed = match twist {
        Some(_) => TWIST_MIN,
        None => SENSORS_MIN,
    };
    sensors.truncate(usize::from(area.height.saturating_sub(needed)));
    let panels_height = match (area.width >= WIDE, &twist) {
        (true, _) => 8,
        (false, None) => 16,
        // The twist's part, warnings and what was said go before.
        (false, Some(_)) => 8,
    };
    let newest = |lines: Option<&Vec<Line<'_>>>| lines.map_or(0, |lines| lines.len() as u16);
    let panels_height = match twist {
        Some(_) => panels_height.min(area.height.saturating_sub(TWIST_ROWS + 5)),
        // What the session waits for, and why, goes before.
        None if state.keys() == Keys::Answer => {
            let asked = newest(said_lines.last()) + newest(warning_lines.first());
            panels_height.min(area.height.saturating_sub(asked + 4))
        }
        None => panels_height,
    };
    let middle_min = match (&twist, area.height >= CHART_MIN) {
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
    // In a small terminal a twist needs all its rows.
    let room = match twist {
        Some(_) if area.height < TWIST_MIN => area.height.saturating_sub(others),
        _ => u16::MAX,
    };
    let warning_height = warning_height.min(room);
    let said_height = said_height.min(room - warning_height);
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
    let colour = if state.warnings.is_empty() {
        Color::Green
    } else {
        Color::Yellow
    };
    frame.render_widget(bar(facts::title(state), colour), title);
    draw_panels(frame, state, panels);
    frame.render_widget(Paragraph::new(sensors), rows);
    if let Some(twist) = &twist {
        draw_twist(frame, twist, middle);
    } else if area.height >= CHART_MIN {
        draw_chart(frame, state, middle);
    }
    draw_warnings(frame, warning_lines, warning);
    draw_said(frame, said_lines, talk);
    frame.render_widget(bar(facts::keys(state.keys()), Color::Gray), keys);
    if help {
        draw_help(frame, area);
    }
}

fn draw_panels(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let [left, right] = if area.width >= WIDE {
        Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(area)
    } else if area.height > 8 {
        Layout::vertical([Constraint::Length(8), Constraint::Length(8)]).areas(area)
    } else {
        [area, Rect::ZERO]
    };
    let block = |title: &'static str| Block::bordered().title(title).border_style(DIM);
    frame.render_widget(
        Paragraph::new(trigger_lines(state)).block(block(" trigger and clocks ")),
        left,
    );
    frame.render_widget(
        Paragraph::new(fact_lines(facts::rates_and_losses(state)).collect::<Vec<_>>())
            .block(block(" rates and losses ")),
        right,
    );
}

fn draw_chart(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let block = Block::bordered()
        .title(" gyroscope of the board, rad/s: x red, y green, z blue ")
        .border_style(DIM);
    if area.height < 5 {
        return;
    }
    let Some(&(last, _)) = state.gyro.back() else {
        return frame.render_widget(Paragraph::new("no samples yet").block(block), area);
    };
    let axes: [Vec<(f64, f64)>; 3] = [0, 1, 2].map(|axis: usize| {
        let seconds = |at: Ticks| at.as_secs_f64() - last.as_secs_f64();
        let points = state.gyro.iter();
        points
            .filter_map(|(at, rates)| Some((seconds(*at), *rates.get(axis)?)))
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

fn draw_twist(frame: &mut Frame<'_>, twist: &Twist, area: Rect) {
    let [time, bar, hint] = Layout::vertical([
        Constraint::Length(3),
        Constraint::Length(3),
        Constraint::Min(0),
    ])
    .areas(area);
    let enough = twist.is_enough();
    let elapsed = if twist.length_s > 0.0 {
        twist.elapsed_s / twist.length_s
    } else {
        0.0
    };
    let title = " twist now, about all axes ";
    frame.render_widget(
        meter(title, Color::Cyan, elapsed, facts::twist_time(twist)),
        time,
    );
    // From a hundred times too much (empty) to enough (full), by its logarithm.
    let full = twist.sigma_us.map_or(0.0, |sigma| {
        1.0 - (sigma / twist.enough_us).max(1e-9).log10() / 2.0
    });
    let colour = if enough { Color::Green } else { Color::Yellow };
    let title = " expected 1-sigma of the offset, falling ";
    frame.render_widget(meter(title, colour, full, facts::twist_sigma(twist)), bar);
    let style = if enough { GOOD } else { WARN }.add_modifier(Modifier::BOLD);
    frame.render_widget(
        Paragraph::new(vec![
            Line::styled(format!(" {}", twist.advice()), style),
            Line::raw(facts::twist_motion(twist)),
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

/// Breaks a text into lines of the screen's width. Lines after the first are indented.
fn wrapped(first: &str, text: &str, width: u16) -> Vec<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let line = format!("{first}{}", words.join(" "));
    let lines = broken(&line, first.chars().count(), width.into());
    lines.lines().map(str::to_owned).collect()
}

/// Returns the lines of each warning with its next step, the newest first.
fn warnings(state: &State, width: u16) -> Vec<Vec<Line<'static>>> {
    let newest = state.warnings.iter().rev();
    newest
        .map(|warning| {
            let at = warning.at.unwrap_or_default().as_secs_f64();
            let todo = warning.next_step.as_deref().unwrap_or_default();
            let text = wrapped(&format!(" ! {at:.1} s: "), &warning.text, width).into_iter();
            let todo = wrapped("   -> ", todo, width).into_iter();
            let text = text.map(|line| Line::styled(line, BAD));
            text.chain(todo.map(|line| Line::styled(line, WARN)))
                .collect()
        })
        .collect()
}

/// Returns the lines of each sentence, the newest last.
fn said(state: &State, width: u16) -> Vec<Vec<Line<'static>>> {
    let lines = |text: &String| wrapped(" ", text, width).into_iter().map(Line::raw);
    state
        .said
        .iter()
        .map(|text| lines(text).collect())
        .collect()
}

/// Returns the rows for warnings and for sentences: enough for the whole newest one of each, if
/// there is room.
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

fn draw_help(frame: &mut Frame<'_>, area: Rect) {
    let width = 60.min(area.width);
    let height = (facts::HELP.len() as u16 + 2).min(area.height);
    let place = Rect::new(
        area.x + (area.width - width) / 2,
        area.y + (area.height - height) / 2,
        width,
        height,
    );
    frame.render_widget(Clear, place);
    frame.render_widget(
        Paragraph::new(facts::HELP.map(Line::raw).to_vec())
            .block(Block::bordered().title(" help ")),
        place,
    );
}

/// A line of one colour across the screen.
fn bar<'a>(text: impl Into<Line<'a>>, colour: Color) -> Paragraph<'a> {
    Paragraph::new(text.into()).style(Style::new().fg(Color::Black).bg(colour))
}

const fn style_of(mood: Mood) -> Style {
    match mood {
        Mood::Plain => Style::new(),
        Mood::Good => GOOD,
        Mood::Warn => WARN,
        Mood::Bad => BAD,
        Mood::Bold => BOLD,
        Mood::Dim => DIM,
    }
}

/// The line of a fact, with its name in a column of `width`.
fn fact_line(fact: Fact, width: usize) -> Line<'static> {
    let name = Span::styled(format!("{:<width$}", fact.name), DIM);
    Line::from(vec![name, Span::styled(fact.value, style_of(fact.mood))])
}

fn fact_lines(facts: Vec<Fact>) -> impl Iterator<Item = Line<'static>> {
    facts.into_iter().map(|fact| fact_line(fact, 10))
}

/// One line each of the auxiliary outputs, the lidar, and the other phones.
fn sensor_lines(state: &State) -> Vec<Line<'static>> {
    let sensors = facts::sensors(state).into_iter();
    sensors
        .map(|mut sensor| {
            let name: String = sensor.name.chars().take(16).collect();
            sensor.name = format!(" {name}");
            fact_line(sensor, 18)
        })
        .collect()
}

fn trigger_lines(state: &State) -> Vec<Line<'static>> {
    let together = facts::together(state).map(|(text, mood)| {
        let style = style_of(mood).add_modifier(Modifier::BOLD);
        Line::styled(text, style)
    });
    let facts = fact_lines(facts::trigger_and_clocks(state));
    together.into_iter().chain(facts).collect()
}

#[cfg(test)]
mod tests {
    use board::finding::{EventKind, Finding};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use session::event::{Phase, PhoneName, Prompt, SessionEvent, Stamped};

    use super::*;
    use crate::view::state::tests::{begin_twist, busy};

    fn shown(width: u16, height: u16, drawing: impl FnOnce(&mut Frame<'_>)) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(drawing).unwrap();
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

    fn screen(width: u16, height: u16, state: &State, help: bool) -> String {
        shown(width, height, |frame| draw(frame, state, help))
    }

    #[test]
    fn a_text_of_several_lines_is_filled_up_and_indented() {
        let text = "error: no board\n  -> plug it in,\n     then go on";
        assert_eq!(
            wrapped(" ! 1.0 s: ", text, 34),
            [
                " ! 1.0 s: error: no board -> plug",
                "          it in, then go on"
            ]
        );
    }

    #[test]
    fn all_is_there_in_80_by_24() {
        let text = screen(80, 24, &busy(), false);
        for word in [
            "RECORDING",
            "1:01 of 5:00",
            "30.0024 fps",
            "3456",
            "cameras expose together to ± 226.6 µs",
            "+0.00 µs off grid",
            "seen, 83 ns",
            "± 4.8 µs now, 1:40 old",
            "0 messages",
            "40.0 GB free, for 1000:00:00",
            "door at 90.0 s",
            "2 IMU samples lost",
            "-> nothing to do",
            "mark: door",
            "side             output 3, 5.00/s, running, pulse 77",
            "VLP-16           gnss, 1.00/s, at 2026-11-21 04:16:07 UTC",
            "frames +1234 ± 5 µs off grid",
            "m mark",
            "gyroscope",
            "now",
        ] {
            assert!(text.contains(word), "{word}:\n{text}");
        }
    }

    #[test]
    fn a_long_fix_is_all_there_in_80_by_24() {
        let mut state = busy();
        let gone = "the depth recorder `k4arecorder` ended by itself (exit status: 1); its \
                    output is in depth_recorder.log";
        let todo = "read the recorder's log, start it again by hand in the folder of the \
                    recording, and look whether it goes on to the END";
        let gone = Finding::bad(EventKind::DepthRecorderGone, gone).next_step(todo);
        state.warnings.push_back(gone.at(Ticks(48_000_000 * 100)));
        let long = "a long sentence that goes on ".repeat(4);
        state.said.push_back(format!("error: {long}WHOLE"));
        state.phones.truncate(1);
        for twists in [false, true] {
            if twists {
                begin_twist(&mut state);
            }
            let text = screen(80, 24, &state, false);
            for word in ["depth_recorder.log", "END", "WHOLE", "m mark"] {
                assert!(text.contains(word), "{word}:\n{text}");
            }
            assert_eq!(twists, text.contains("rad/s rms"), "{text}");
        }
    }

    #[test]
    fn what_was_said_is_not_shown_without_its_beginning() {
        let mut state = busy();
        let long = format!("aligned {}(1-sigma)", "to the phone's frames ".repeat(4));
        state.said = [long, String::from("recording")].into();
        let text = screen(80, 24, &state, false);
        assert!(text.contains("\n recording"), "{text}");
        assert_eq!(
            text.contains("aligned"),
            text.contains("(1-sigma)"),
            "{text}"
        );
    }

    /// A refused twist says why, and the check that is not good is a warning.
    #[test]
    fn what_a_session_waits_for_stands_with_its_reason_at_every_size() {
        let profile = recording::profile::Profile::published().unwrap();
        let mut state = State::of_session(&profile, true);
        let mut take = |event| {
            let at = Ticks(48_000_000 * 12);
            state.take(&Stamped { at, event });
        };
        let check = Finding::check("constant bias", "not measured").next_step("measure it");
        take(SessionEvent::Checked { check });
        let phase = Phase::Twisting { number: 1 };
        take(SessionEvent::Phase { phase });
        take(SessionEvent::TwistRefused {
            number: 1,
            phone: PhoneName {
                name: String::from("phone"),
                is_only: true,
            },
            reason: String::from("there is too little motion: twist FASTER"),
        });
        let prompt = Prompt::TwistAgain;
        take(SessionEvent::Prompt { prompt });
        for (width, height) in [(120, 40), (80, 24), (60, 16), (40, 12)] {
            let text = screen(width, height, &state, false);
            for word in ["twist 1 refused", "FASTER", "twist again", "q"] {
                assert!(text.contains(word), "{width}x{height}, {word}:\n{text}");
            }
            assert!(!text.contains("no warnings"), "{text}");
        }
        let text = screen(120, 40, &state, false);
        assert!(text.contains("not measured"), "{text}");
    }

    const SIZES: [(u16, u16); 7] = [
        (1, 1),
        (19, 5),
        (20, 6),
        (40, 10),
        (69, 12),
        (80, 24),
        (200, 60),
    ];

    #[test]
    fn any_size_and_any_state_can_be_drawn() {
        let mut twisting = busy();
        begin_twist(&mut twisting);
        for (width, height) in SIZES {
            for help in [false, true] {
                for state in [&twisting, &busy(), &State::default()] {
                    screen(width, height, state, help);
                }
            }
            for (elapsed_s, sigma_us) in [(0.0, None), (3.0, Some(1e9)), (9.0, Some(0.0))] {
                let twist = Twist {
                    elapsed_s,
                    length_s: 7.0,
                    sigma_us,
                    enough_us: 10.0,
                    rms: [3.0, 2.0, f64::NAN],
                };
                shown(width, height, |frame| {
                    draw_twist(frame, &twist, frame.area());
                });
            }
        }
    }

    /// Guidance, both bars and the verdict are there in every terminal that people have.
    #[test]
    fn bars_guidance_and_verdict_have_room_in_common_sizes() {
        let mut twisting = busy();
        begin_twist(&mut twisting);
        for (width, height) in [(60, 24), (80, 24), (120, 16), (200, 50)] {
            let text = screen(width, height, &twisting, false);
            for word in [
                "twist now, about all axes",
                "expected 1-sigma",
                "rad/s rms",
                "cameras expose together to ± ",
                "q stop",
            ] {
                assert!(text.contains(word), "{width}x{height}, {word}:\n{text}");
            }
            assert!(text.matches('┌').count() >= 2, "{text}");
            let text = screen(width, height, &busy(), false);
            for word in ["cameras expose together to ± ", "off grid", "m mark"] {
                assert!(text.contains(word), "{width}x{height}, {word}:\n{text}");
            }
        }
    }
}
