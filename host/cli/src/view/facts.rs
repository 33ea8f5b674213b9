//! The words of the screen: titles, facts and hints about a state. Pure, and without layout.

use recording::error_budget::micros_text;

use super::plain::lock;
use super::state::{Keys, State, Twist};

/// The lines of the help.
pub(super) const HELP: [&str; 10] = [
    "Enter  go on, where something is asked",
    "r      do the last step again (twist again)",
    "s      skip the step",
    "m      set a mark, while recording",
    "q      stop; what was recorded is kept",
    "h      this help, and away again",
    "",
    "together to: middles of the two exposures (1-sigma)",
    "phase: the last pulse against the grid it was sent to",
    "clocks: error of phone time in board time now (1-sigma)",
];

/// The judgement of a fact, which decides its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mood {
    Plain,
    Good,
    Warn,
    Bad,
    Bold,
    Dim,
}

/// A named value.
#[derive(Clone, Debug)]
pub(super) struct Fact {
    pub(super) name: String,
    pub(super) value: String,
    pub(super) mood: Mood,
}

impl Fact {
    fn new(name: impl Into<String>, value: impl Into<String>, mood: Mood) -> Self {
        Self {
            name: name.into(),
            value: value.into(),
            mood,
        }
    }
}

/// Returns the title of the screen.
pub(super) fn title(state: &State) -> String {
    let mut text = format!(" SmartDepthSync  {}", state.doing().to_uppercase());
    if let Some((elapsed, length)) = state.recorded_s() {
        text.push_str(&format!("  {}", clock(elapsed)));
        if let Some(length) = length {
            text.push_str(&format!(" of {}", clock(length)));
        }
    }
    text.push_str(&format!(
        "   board {} at {:.1} s",
        short(&state.board),
        state.now.as_secs_f64()
    ));
    text
}

/// Returns the keys and their effects, for the last line.
pub(super) const fn keys(keys: Keys) -> &'static str {
    match keys {
        Keys::Look => " q stop   h help",
        Keys::Answer => " Enter go on   r twist again / repeat   s skip   q stop   h help",
        Keys::Record => " m mark   q stop   h help",
    }
}

/// Returns how well the cameras expose together, once that is known.
pub(super) fn together(state: &State) -> Option<(String, Mood)> {
    let now = state.phase_now()?;
    let mood = if now.is_sure { Mood::Good } else { Mood::Warn };
    let sigma = micros_text(now.sigma_us);
    Some((format!("cameras expose together to ± {sigma}"), mood))
}

/// Returns the facts about trigger and clocks.
pub(super) fn trigger_and_clocks(state: &State) -> Vec<Fact> {
    let trigger = &state.trigger;
    let train = match trigger.state.as_str() {
        "" => "?",
        word => word,
    };
    let fps = trigger.fps.map(|fps| format!(", {fps:.4} fps"));
    let train = format!("{train}{}", fps.unwrap_or_default());
    let (readback, seen) = match (trigger.readback_ns, trigger.readback_missing) {
        (Some(ns), 0) => (format!("seen, {ns:.0} ns after the edge"), Mood::Good),
        (Some(ns), missing) => (format!("{ns:.0} ns, {missing} NOT SEEN"), Mood::Bad),
        (None, _) if trigger.fps.is_some() => (String::from("not wired or not seen"), Mood::Warn),
        (None, _) => (String::from("-"), Mood::Plain),
    };
    let mut facts = vec![
        Fact::new("train", train, Mood::Bold),
        phase(state),
        Fact::new("read-back", readback, seen),
    ];
    let reference = state.phones.first();
    match reference.and_then(|phone| state.clock_now(phone)) {
        Some(known) => {
            let age = clock(known.age_s);
            let is_good = known.sigma_us < 100.0;
            facts.push(Fact::new(
                "clocks",
                format!("± {:.1} µs now, {age} old", known.sigma_us),
                if is_good { Mood::Good } else { Mood::Warn },
            ));
            let relation = format!("{:.6} s, {:+.3} ppm", known.offset_s, known.skew_ppm);
            facts.push(Fact::new("", relation, Mood::Plain));
        }
        None => facts.push(Fact::new("clocks", "no twist yet", Mood::Plain)),
    }
    facts
}

/// Returns the position of the trigger on its grid. The uncertainty of the grid itself is in
/// [`together`].
fn phase(state: &State) -> Fact {
    let Some(now) = state.phase_now() else {
        return Fact::new("phase", "not aligned yet", Mood::Plain);
    };
    let phase = now.phase_us;
    let (value, mood) = match now.tracked {
        _ if now.is_twist_due => (String::from("time for a TWIST"), Mood::Warn),
        Some(tracked) => (
            format!("{phase:+.1} µs, {}", lock(&tracked)),
            if tracked.holds {
                Mood::Good
            } else {
                Mood::Warn
            },
        ),
        None => (
            format!("{phase:+.2} µs off grid"),
            if phase == 0.0 { Mood::Good } else { Mood::Bad },
        ),
    };
    Fact::new("phase", value, mood)
}

/// Returns the facts about rates and losses.
pub(super) fn rates_and_losses(state: &State) -> Vec<Fact> {
    let (rates, losses) = (state.rates(), &state.losses);
    let imu = match (state.imu_runs, rates.temperature) {
        (Some(false), _) => Fact::new("IMU", "DOES NOT ANSWER", Mood::Bad),
        (_, Some(celsius)) => {
            let value = format!("{:.1}/s, {celsius:.1} C", rates.imu);
            Fact::new("IMU", value, Mood::Plain)
        }
        (_, None) => Fact::new("IMU", format!("{:.1}/s", rates.imu), Mood::Plain),
    };
    let relinks = match losses.reconnects {
        0 => String::new(),
        n => format!(", {n} relinks"),
    };
    let is_complete = losses.messages + losses.damaged + u64::from(losses.reconnects) == 0;
    let late = state.trigger.late;
    let last = state.trigger.pulse;
    let last = last.map_or(String::new(), |pulse| format!("{pulse}, "));
    let pulses = match late {
        0 => format!(
            "{last}{:.2}/s, strobe {:.2}/s",
            rates.pulses, rates.captures
        ),
        late => format!("{last}{late} LATE"),
    };
    let lost = format!(
        "{} messages, {} damaged{relinks}",
        losses.messages, losses.damaged
    );
    let mut facts = vec![
        imu,
        Fact::new("pulses", pulses, bad_if(late > 0)),
        Fact::new(
            "lost",
            lost,
            if is_complete { Mood::Good } else { Mood::Bad },
        ),
        Fact::new("load", format!("{:.1} %", rates.load_percent), Mood::Plain),
    ];
    facts.push(match &state.disk {
        Some(disk) => {
            let left = disk.left_s.map(|left| format!(", for {}", clock(left)));
            let free = disk.free as f64 * 1e-9;
            let is_low = disk.free < 1_000_000_000;
            Fact::new(
                "disk",
                format!("{free:.1} GB free{}", left.unwrap_or_default()),
                if is_low { Mood::Warn } else { Mood::Plain },
            )
        }
        None => Fact::new("disk", "nothing is recorded", Mood::Dim),
    });
    if let Some((at, label)) = &state.mark {
        let mark = format!("{label} at {:.1} s", at.as_secs_f64());
        facts.push(Fact::new("last mark", mark, Mood::Plain));
    }
    facts
}

/// Returns a fact about each auxiliary output, the lidar, and each phone but the reference.
pub(super) fn sensors(state: &State) -> Vec<Fact> {
    let sensors = state.sensors().into_iter().map(|sensor| {
        let mut text = format!("{}, {:.2}/s", sensor.at, sensor.rate);
        if !sensor.state.is_empty() {
            text.push_str(&format!(", {}", sensor.state));
        }
        match (sensor.utc_text(), sensor.pulse) {
            (Some(utc), _) => text.push_str(&format!(", at {utc}")),
            (None, Some(pulse)) => text.push_str(&format!(", pulse {pulse}")),
            (None, None) => {}
        }
        if sensor.late > 0 {
            text.push_str(&format!(", {} LATE", sensor.late));
        }
        Fact::new(sensor.name, text, bad_if(sensor.late > 0))
    });
    let phones = state.phones.iter().skip(1).map(|phone| {
        let mut text = match state.clock_now(phone) {
            Some(known) => format!("clocks ± {:.1} µs now", known.sigma_us),
            None => String::from("no twist yet"),
        };
        if let Some(placed) = &phone.placement {
            let (offset, sigma) = (placed.offset_us, placed.offset_sigma_us);
            text.push_str(&format!(", frames {offset:+.0} ± {sigma:.0} µs off grid"));
        }
        Fact::new(phone.name.as_str(), text, Mood::Plain)
    });
    sensors.chain(phones).collect()
}

/// Returns the progress of a twist in words.
pub(super) fn twist_time(twist: &Twist) -> String {
    format!("{:.1} of {:.0} s", twist.elapsed_s, twist.length_s)
}

/// Returns the expected uncertainty of a twist in words.
pub(super) fn twist_sigma(twist: &Twist) -> String {
    match twist.sigma_us {
        Some(sigma) if twist.is_enough() => {
            format!("{sigma:.1} µs: ENOUGH (needed {:.0})", twist.enough_us)
        }
        Some(sigma) => format!("{sigma:.1} µs, needed {:.0}", twist.enough_us),
        None => String::from("no motion yet"),
    }
}

/// Returns the motion of a twist in words.
pub(super) fn twist_motion(twist: &Twist) -> String {
    let [x, y, z] = twist.rms;
    format!(" x {x:.1}   y {y:.1}   z {z:.1} rad/s rms")
}

const fn bad_if(is_bad: bool) -> Mood {
    if is_bad { Mood::Bad } else { Mood::Plain }
}

/// Returns the end of a long ID, which is the part that differs.
fn short(id: &str) -> String {
    let skip = id.chars().count().saturating_sub(8);
    id.chars().skip(skip).collect()
}

/// Returns a time in seconds as `1:02:03`.
fn clock(seconds: f64) -> String {
    let sign = if seconds < 0.0 { "-" } else { "" };
    let whole = seconds.abs().min(1e9) as u64;
    let (hours, minutes, seconds) = (whole / 3_600, whole / 60 % 60, whole % 60);
    match hours {
        0 => format!("{sign}{minutes}:{seconds:02}"),
        _ => format!("{sign}{hours}:{minutes:02}:{seconds:02}"),
    }
}
