//! The phase over an hour, with and without a look at the phone's clock.
//!
//! Pure arithmetic: clocks that wander and warm up, links whose delays are drawn from what
//! links may be like, a twist with its error, the program's own alignment, tracker and
//! steering. The trigger's grid is judged every few seconds against the true time of the
//! phone's frames.

use anyhow::{Context as _, Result};
use clock::steering::{Link as Reached, STEP_EVERY_S, Steering, has_lock};
use clock::tracker::{Asked, Exchange, Tracker};
use clock::twists::Twists;
use clock::{BoardSeconds, ClockRelation, PhoneNanos, Wander};
use evaluate::stats::{mean, quantile};
use protocol::EdgeTime;
use recording::profile::{Learnt, Profile};
use recording::session_file::{Alignment, Video};
use rig::clocks::link_delay::{Link, LinkRanges};
use rig::clocks::oscillator::{Oscillator, OscillatorConfig, TrueTime, Warming};
use rig::model_ranges::{WANDER_PPM, WARMING_PPM, WARMING_S};
use rig::random::{Random, Seed, Stream, log_uniform};
use rig::wiring::UNITS_PER_TICK;
use session::alignment::plan;
use stm32f4_sim::time::{SimDuration, UNITS_PER_SECOND};

use super::{Figure, Rigs};

/// Board and phone are asked so often, s; at times that scatter by half of it.
const ASKED_EVERY_S: [f64; 2] = [0.04, 0.02];

/// From the first exchange to the twist, and from there to the video, s.
const TO_TWIST_S: f64 = 45.0;
const TO_VIDEO_S: f64 = 12.0;

/// The phase is judged so often, s.
const JUDGED_EVERY_S: f64 = 5.0;

/// 1-sigma of the timestamp of a frame, ns, that is also what is taught.
const FRAME_JITTER_NS: f64 = 1_000.0;

/// Position of the links and of the clocks' warming in their ranges: those of
/// [`LinkRanges::RANGES`] in that order, and after them the warming.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Anywhere, by the seed, but for the range with this number, of which it is in the middle.
    Drawn(Option<usize>),
    /// In the middle.
    Middle,
}

/// The link to the phone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Arm {
    /// Not at all: the period stays.
    None,
    /// By USB.
    Usb,
    /// By Wi-Fi.
    Wifi,
}

const ARMS: [Arm; 3] = [Arm::None, Arm::Usb, Arm::Wifi];

/// One look at a phase.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Depth less phone, µs.
    error_us: f64,
    /// As stated, µs.
    sigma_us: f64,
}

/// One session.
#[derive(Clone, Debug)]
struct Session {
    /// Looks at its phase, in order.
    looks: Vec<Look>,
    /// When it was reported that the phone was cut off for good, s after that.
    reported_after_s: Option<f64>,
}

/// The rigs: with all values in the middle of their ranges, and drawn.
#[must_use]
pub fn rigs() -> Rigs<Place> {
    let without = |_: &Place| {
        let names = LinkRanges::RANGES.iter().map(|(name, _)| *name);
        let names = names.chain(["warming of the clocks"]).enumerate();
        let without = names.map(|(number, name)| (name.to_owned(), Place::Drawn(Some(number))));
        without.collect()
    };
    Rigs {
        nominal: Place::Middle,
        drawn: Box::new(|_| Place::Drawn(None)),
        without: Box::new(without),
    }
}

/// Returns the figures of a rig's sessions of this length.
///
/// # Errors
///
/// A session has no alignment, or does not miss its phone.
pub fn figures(seed: u64, place: Place, seconds: u32) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for arm in ARMS {
        let session = session(seed, arm, place, seconds)?;
        let mut add = |name: &str, error, sigma| {
            figures.push(Figure {
                name: format!("{arm:?}: {name}"),
                error,
                sigma,
            });
        };
        let of = |pick: fn(&Look) -> f64| -> Vec<f64> { session.looks.iter().map(pick).collect() };
        let rms = |values: Vec<f64>| {
            let squares: Vec<f64> = values.iter().map(|value| value * value).collect();
            mean(&squares).sqrt()
        };
        let largest = quantile(&of(|look| look.error_us.abs()), 0.95);
        add(
            "phase, 95 % of the time (µs)",
            largest.unwrap_or(f64::NAN),
            None,
        );
        let stated = rms(of(|look| look.sigma_us));
        add(
            "phase, rms (µs)",
            rms(of(|look| look.error_us)),
            Some(stated),
        );
        if arm != Arm::None {
            let reported = session
                .reported_after_s
                .context("the phone was not missed")?;
            add("lost lock reported (s)", reported, None);
        }
    }
    Ok(figures)
}

impl Place {
    /// Narrows the range with this number; its middle is that of its logarithm, where
    /// it does not begin at zero.
    fn within(self, number: usize, range: (f64, f64)) -> (f64, f64) {
        let is_middle = match self {
            Self::Middle => true,
            Self::Drawn(but) => but == Some(number),
        };
        if !is_middle {
            return range;
        }
        let (least, most) = range;
        let at = if least > 0.0 {
            (least * most).sqrt()
        } else {
            f64::midpoint(least, most)
        };
        (at, at)
    }

    fn links(self, mut links: LinkRanges) -> LinkRanges {
        for (number, (_, range)) in LinkRanges::RANGES.iter().enumerate() {
            let range = range(&mut links);
            *range = self.within(number, *range);
        }
        links
    }
}

/// A clock of a rig that warms up, drawn from the ranges of the models.
fn clock(
    seed: Seed,
    stream: Stream,
    rates_ppm: f64,
    warming_ppm: (f64, f64),
    random: &mut Random,
) -> Oscillator {
    let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
    let config = OscillatorConfig {
        offset_ns: 0,
        rate_ppm: random.uniform(-rates_ppm, rates_ppm),
        wander: 1e-6 * log_uniform(random, WANDER_PPM),
        warming: Warming {
            ppm: sign * log_uniform(random, warming_ppm),
            time_s: log_uniform(random, WARMING_S),
            ..Warming::default()
        },
    };
    Oscillator::new(config, seed.stream(stream))
}

fn true_time(seconds: f64) -> TrueTime {
    TrueTime::from_units(SimDuration::from_secs_f64(seconds).units())
}

fn read(clock: &Oscillator, at: f64) -> f64 {
    clock.elapsed_at(true_time(at)) as f64 / UNITS_PER_SECOND as f64
}

/// The three clocks, and the computer's steering by a time server: now and then another
/// rate.
struct Clocks {
    board: Oscillator,
    phone: Oscillator,
    computer: Oscillator,
    /// From when on, the rate, and what it has made until then, s.
    steered: Vec<(f64, f64, f64)>,
}

impl Clocks {
    fn drawn(seed: Seed, random: &mut Random, until: f64, place: Place) -> Self {
        let warming = place.within(LinkRanges::RANGES.len(), WARMING_PPM);
        let board = clock(seed, Stream::BoardClock, 30.0, warming, random);
        let phone = clock(seed, Stream::PhoneClock, 50.0, warming, random);
        let computer = clock(seed, Stream::ComputerClock, 50.0, warming, random);
        let ppm = log_uniform(random, (0.1, 10.0));
        let mut steered = vec![(0.0, 0.0, 0.0)];
        let (mut at, mut made) = (0.0, 0.0);
        while at < until {
            let before = steered[steered.len() - 1].1;
            let length = log_uniform(random, (32.0, 1_024.0));
            (at, made) = (at + length, made + before * length);
            steered.push((at, ppm * 1e-6 * random.normal(), made));
        }
        Self {
            board,
            phone,
            computer,
            steered,
        }
    }

    /// The computer's clock at a true time.
    fn host(&self, at: f64) -> f64 {
        let place = self
            .steered
            .partition_point(|&(from, ..)| from <= at)
            .max(1)
            - 1;
        let (from, rate, made) = self.steered[place];
        read(&self.computer, at) + made + rate * (at - from)
    }

    fn exchange(&self, link: &mut Link, clock: &Oscillator, at: f64) -> Option<Exchange> {
        let [there, back] = link.ways(at)?;
        Some(Exchange {
            sent: self.host(at),
            received: self.host(at + there + back),
            stamp: read(clock, at + there),
        })
    }
}

/// True times of the phone's frames, and the trigger that is to meet them.
struct Frames {
    /// True period, ns of the phone.
    period_ns: f64,
    /// Phone's time of the wanted edge that belongs to the anchor, s.
    first: f64,
}

/// Relation that the twist states: the true one and its error.
fn twist(clocks: &Clocks, at: f64, random: &mut Random) -> ClockRelation {
    let reference = read(&clocks.board, at);
    let offset = |at| read(&clocks.phone, at) - read(&clocks.board, at);
    let sigma = log_uniform(random, (2e-6, 6e-6));
    let skew_sigma = log_uniform(random, (0.3e-6, 0.9e-6));
    ClockRelation {
        reference,
        offset: offset(at) + sigma * random.normal(),
        skew: offset(at + 0.5) - offset(at - 0.5) + skew_sigma * random.normal(),
        covariance: [[sigma * sigma, 0.0], [0.0, skew_sigma * skew_sigma]],
        wander: Wander::default(),
    }
}

/// Aligns to a video that begins at a true time.
fn align(
    clocks: &Clocks,
    clock: ClockRelation,
    at: f64,
    random: &mut Random,
) -> Result<(Alignment, Frames)> {
    let period_ns = 1e9 / 30.0 * (1.0 + 1e-4 * random.uniform(-1.0, 1.0));
    let sigma_ns = log_uniform(random, (0.005, 0.05));
    let mut profile = Profile::published()?;
    profile.phone.learnt = Some(Learnt {
        frame_period_ns: period_ns + sigma_ns * random.normal(),
        frame_period_sigma_ns: sigma_ns,
        frame_jitter_ns: Some(FRAME_JITTER_NS),
        exposure_us: None,
        skew: None,
        skew_sigma: None,
        learnt: jiff::civil::date(2026, 1, 31),
        time: None,
        board_temperature_c: None,
        board_id: None,
    });
    let phase = read(&clocks.phone, at) * 1e9;
    let reported = FRAME_JITTER_NS * std::f64::consts::SQRT_2 / 59.0;
    let video = Video {
        phase: PhoneNanos((phase + FRAME_JITTER_NS * random.normal()).round() as i64),
        frame_duration_ns: period_ns + reported * random.normal(),
        exposure_ns: Some(1_000_000),
        boot_minus_frames_ns: 0,
    };
    let course = Twists::new(clock).course();
    let alignment = plan(&profile, &course, &video)?.alignment;
    // From the frame's timestamp to the edge, in the phone's time.
    let lead_us = alignment.exposure_us / 2.0 + alignment.middle_row_us
        - alignment.center_offset_us
        - alignment.bias_us;
    let first = phase * 1e-9 + lead_us * 1e-6;
    Ok((alignment, Frames { period_ns, first }))
}

impl Frames {
    /// The nearest edge's time less that of its frame, µs, in the phone's true time.
    fn error_us(&self, clocks: &Clocks, (number, edge): (u64, EdgeTime)) -> Result<f64> {
        let units = (edge.raw() * i128::from(UNITS_PER_TICK)) >> 32;
        let units = u64::try_from(units).context("an edge beyond all time")?;
        let at = clocks.board.when_elapsed(units);
        let phone = clocks.phone.elapsed_at(at) as f64 / UNITS_PER_SECOND as f64;
        Ok((phone - self.first - number as f64 * self.period_ns * 1e-9) * 1e6)
    }
}

/// One session of a rig. The phone answers nothing in its last half minute.
fn session(seed: u64, arm: Arm, place: Place, seconds: u32) -> Result<Session> {
    let seed = Seed(seed);
    let mut random = seed.stream(Stream::Tracking);
    let begin = random.uniform(5.0, 600.0);
    let video_at = begin + TO_TWIST_S + TO_VIDEO_S;
    let end = video_at + f64::from(seconds);
    let clocks = Clocks::drawn(seed, &mut random, end + 60.0, place);
    let twist = twist(&clocks, begin + TO_TWIST_S, &mut random);
    let (alignment, frames) = align(&clocks, twist, video_at, &mut random)?;
    let mut steering = Steering::new(&alignment.plan, 1);
    let ticks = |at: f64| BoardSeconds(read(&clocks.board, at)).ticks();
    let mut result = Session {
        looks: Vec::new(),
        reported_after_s: None,
    };
    let (ranges, kind) = match arm {
        Arm::None => {
            let mut at = video_at;
            while at < end {
                let edge = steering.edge_from(ticks(at));
                result.looks.push(Look {
                    error_us: frames.error_us(&clocks, edge)?,
                    sigma_us: alignment.plan.phase_sigma_us_at(ticks(at).into()),
                });
                at += JUDGED_EVERY_S;
            }
            return Ok(result);
        }
        Arm::Usb => (LinkRanges::PHONE_USB, Reached::Usb),
        Arm::Wifi => (LinkRanges::PHONE_WIFI, Reached::Network),
    };
    let link = |ranges, stream| Link::drawn(&place.links(ranges), seed.stream(stream));
    let mut board_link = link(LinkRanges::BOARD_USB, Stream::BoardLink);
    let mut phone_link = link(ranges, Stream::PhoneLink);
    let mut tracker = Tracker::default();
    let (mut asked, mut at) = ([begin; 2], begin);
    let (mut knows, mut steered, mut judged) = (false, video_at, video_at);
    while at < end + 60.0 {
        let which = usize::from(asked[1] < asked[0]);
        at = asked[which];
        asked[which] += ASKED_EVERY_S[which] * random.uniform(0.5, 1.5);
        let exchange = match which {
            0 => clocks.exchange(&mut board_link, &clocks.board, at),
            _ if at >= end => None,
            _ => clocks.exchange(&mut phone_link, &clocks.phone, at),
        };
        if let Some(exchange) = exchange {
            let asked = if which == 0 { Asked::A } else { Asked::B };
            tracker.add(asked, exchange);
        }
        // A twist is worked out some seconds after it.
        if !knows && at > begin + TO_TWIST_S + 5.0 {
            knows = tracker.add_relation(&twist);
        }
        if at < end && at < (steered + STEP_EVERY_S).min(judged + JUDGED_EVERY_S) {
            continue;
        }
        let host = clocks.host(at);
        let holds = has_lock(&tracker, kind, host);
        if at >= end {
            if !holds {
                result.reported_after_s.get_or_insert(at - end);
            }
            continue;
        }
        let Some(relation) = tracker.relation_at(host).filter(|_| knows) else {
            continue;
        };
        if at >= steered + STEP_EVERY_S && holds {
            let now = ticks(at + 0.05);
            if let Some(period) = steering.wanted(&relation, now, at - steered) {
                let (_, edge) = steering.edge_from(now);
                steering.follow(edge, period);
            }
            steered = at;
        }
        if at >= judged + JUDGED_EVERY_S {
            judged = at;
            let now = ticks(at);
            result.looks.push(Look {
                error_us: frames.error_us(&clocks, steering.edge_from(now))?,
                sigma_us: steering.phase_sigma_us(&relation, now.into()),
            });
        }
    }
    Ok(result)
}
