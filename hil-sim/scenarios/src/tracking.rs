//! How well the phase holds for an hour, with and without a look at the phone's clock.
//!
//! Pure arithmetic: clocks that wander and warm up, links whose delays are drawn from what
//! links may be like, a twist with its error, the program's own alignment, tracker and
//! steering. The trigger's grid is judged every few seconds against the true time of the
//! phone's frames.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use evaluate::stats::{mean, quantile};
use protocol::Ticks;
use recording::profile::{Learnt, Profile};
use recording::session_file::{Alignment, Video};
use rig::link_delay::{Link, LinkRanges};
use rig::model_ranges::{WANDER_PPM, WARMING_PPM, WARMING_S};
use rig::oscillator::{Oscillator, OscillatorConfig, TrueTime, Warming};
use rig::random::{Random, Seed, Stream, log_uniform};
use rig::wiring::UNITS_PER_TICK;
use session::alignment::{phase_sigma_us_at, plan};
use session::steering::{Link as Reached, STEP_EVERY_S, Steering, has_lock};
use session::twists::Twists;
use stm32f4_sim::time::{SimDuration, UNITS_PER_SECOND};
use timebase::{BoardSeconds, ClockModel, PhoneNanos, Wander};
use twist_sync::tracker::{Asked, Exchange, Tracker};

use crate::study::{self as ranges, Figure, Kind, RangeStudy, Specimen};
use crate::workers;

/// Board and phone are asked so often, s; at times that scatter by half of it.
const ASKED_EVERY_S: [f64; 2] = [0.04, 0.02];

/// From the first exchange to the twist, and from there to the video, s.
const TO_TWIST_S: f64 = 45.0;
const TO_VIDEO_S: f64 = 12.0;

/// The phase is judged so often, s.
const JUDGED_EVERY_S: f64 = 5.0;

/// 1-sigma of the timestamp of a frame, ns, that is also what is taught.
const FRAME_JITTER_NS: f64 = 1_000.0;

/// What is to be studied.
#[derive(Clone, Debug)]
pub struct StudyOptions {
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// How many rigs.
    pub rigs: u32,
    /// Length of a recording, s.
    pub seconds: u32,
    /// How many run at the same time.
    pub jobs: u32,
    /// What of the world is left out, to see what it does.
    pub without: Vec<Part>,
    /// Where in their ranges the values are.
    pub place: Place,
}

/// Where in their ranges the links and the warming of the clocks are: the ranges of
/// [`LinkRanges::RANGES`] in that order, and after them the warming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Anywhere, by the seed.
    Drawn,
    /// In the middle: of its logarithm, where a range does not begin at zero.
    Middle,
    /// There too, but for this one, which is the least or the most that it can be.
    End(usize, End),
}

/// An end of a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The lower one.
    Least,
    /// The upper one.
    Most,
}

/// A part of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// The errors of the twist, and of what the phone says of its frames.
    Twist,
    /// How the shortest ways scatter.
    Scatter,
    /// Steps of the shortest ways.
    Steps,
    /// Their slow wander.
    Wander,
    /// Silences.
    Silences,
    /// Warming and wander of board and phone.
    Clocks,
    /// That a time server steers the computer's clock.
    Steered,
}

/// How the phone is reached.
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
    /// The largest change of the period in a step, ppm.
    largest_step_ppm: f64,
    /// After the phone was cut off for good: when that was told, s.
    told_after_s: Option<f64>,
}

/// All sessions, of each arm.
#[derive(Debug)]
pub struct Study(Vec<(Arm, Session)>);

/// The phase of an hour three times: with all values in the middle of their ranges, drawn, and
/// with one of them at an end; `rigs_an_end` rigs for each of those.
#[must_use]
pub fn over_ranges(options: &StudyOptions, rigs_an_end: u32) -> RangeStudy {
    let mut places = vec![
        (Kind::Nominal, Place::Middle, options.rigs),
        (Kind::Drawn, Place::Drawn, options.rigs),
    ];
    let links = LinkRanges::RANGES.iter().map(|(name, _)| *name);
    for (number, name) in links.chain(["warming of the clocks"]).enumerate() {
        for end in [End::Least, End::Most] {
            let kind = Kind::Extreme(format!("{name}: {end:?}").to_lowercase());
            places.push((kind, Place::End(number, end), rigs_an_end));
        }
    }
    let specimens: Vec<_> = (places.into_iter())
        .flat_map(|(kind, values, rigs)| {
            (0..u64::from(rigs)).map(move |n| Specimen {
                seed: options.first_seed.wrapping_add(n),
                kind: kind.clone(),
                values,
            })
        })
        .collect();
    let figures = |rig: &Specimen<Place>| {
        let options = StudyOptions {
            place: rig.values,
            ..options.clone()
        };
        let figure = |arm| {
            let session = session(rig.seed, arm, &options)?;
            Ok(Figure {
                name: format!("{arm:?}: phase at any time (µs)"),
                error: sizes_95_us(&session.looks),
                sigma: None,
            })
        };
        ARMS.into_iter().map(figure).collect()
    };
    ranges::each(&specimens, options.jobs, figures, |_| ())
}

/// 95th percentile of the size of the error.
fn sizes_95_us<'a>(looks: impl IntoIterator<Item = &'a Look>) -> f64 {
    let sizes: Vec<f64> = looks.into_iter().map(|look| look.error_us.abs()).collect();
    quantile(&sizes, 0.95).unwrap_or(f64::NAN)
}

/// Runs the study.
///
/// # Errors
///
/// A session has no alignment.
pub fn study(options: &StudyOptions) -> Result<Study> {
    let seeds = 0..u64::from(options.rigs);
    let seeds = seeds.map(|n| options.first_seed.wrapping_add(n));
    let plans: Vec<_> = seeds.flat_map(|seed| ARMS.map(|arm| (seed, arm))).collect();
    let sessions = workers::each(&plans, options.jobs as usize, |&(seed, arm)| {
        session(seed, arm, options).map(|session| (arm, session))
    });
    sessions.into_iter().collect::<Result<_>>().map(Study)
}

impl StudyOptions {
    /// 1, or 0 of a part that is left out.
    fn share(&self, part: Part) -> f64 {
        f64::from(u8::from(!self.without.contains(&part)))
    }

    fn ranges(&self, of: LinkRanges) -> LinkRanges {
        let share = |part, (from, to): (f64, f64)| {
            let share = self.share(part);
            (from * share, to * share)
        };
        // Nothing is drawn from the logarithm of zero.
        let scatter = self.share(Part::Scatter).max(1e-6);
        let (least, most) = share(Part::Wander, of.wander);
        let mut link = LinkRanges {
            jitter: (of.jitter.0 * scatter, of.jitter.1 * scatter),
            steps: share(Part::Steps, of.steps),
            // A link wanders by a part of its scatter: that stays.
            wander: (least / scatter, most / scatter),
            silences: share(Part::Silences, of.silences),
            ..of
        };
        for (number, (_, range)) in LinkRanges::RANGES.iter().enumerate() {
            let range = range(&mut link);
            *range = self.place.within(number, *range);
        }
        link
    }
}

impl Place {
    /// What is left of the range with this number.
    fn within(self, number: usize, range: (f64, f64)) -> (f64, f64) {
        let (least, most) = range;
        let at = match self {
            Self::Drawn => return range,
            Self::End(wanted, End::Least) if wanted == number => least,
            Self::End(wanted, End::Most) if wanted == number => most,
            Self::Middle | Self::End(..) if least > 0.0 => (least * most).sqrt(),
            Self::Middle | Self::End(..) => f64::midpoint(least, most),
        };
        (at, at)
    }
}

impl Study {
    fn of(&self, arm: Arm) -> impl Iterator<Item = &Session> {
        self.0
            .iter()
            .filter(move |(of, _)| *of == arm)
            .map(|(_, session)| session)
    }

    /// 95th percentile of the size of the phase at any time, µs.
    fn phase_95_us(&self, arm: Arm) -> f64 {
        sizes_95_us(self.of(arm).flat_map(|session| &session.looks))
    }

    /// RMS of errors over their stated sigmas: 1 if those are honest.
    fn error_over_sigma(&self, arm: Arm) -> f64 {
        let looks = self.of(arm).flat_map(|session| &session.looks);
        let squares: Vec<f64> = looks
            .map(|look| (look.error_us / look.sigma_us).powi(2))
            .collect();
        mean(&squares).sqrt()
    }

    /// The longest that a phone that was cut off was not missed, s.
    fn told_after_s(&self, arm: Arm) -> Option<f64> {
        let told: Option<Vec<f64>> = self.of(arm).map(|session| session.told_after_s).collect();
        told?.into_iter().reduce(f64::max)
    }

    /// The table for the terminal and the book.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::from(
            "| tracked | phase, 95 % (µs) | worst (µs) | stated 1-sigma, median (µs) | error over sigma | largest step (ppm) | lost lock told within (s) |\n\
             |---|---|---|---|---|---|---|\n",
        );
        for arm in ARMS {
            let looks = || self.of(arm).flat_map(|session| &session.looks);
            let worst = looks().map(|look| look.error_us.abs()).fold(0.0, f64::max);
            let sigmas: Vec<f64> = looks().map(|look| look.sigma_us).collect();
            let step = self.of(arm).map(|session| session.largest_step_ppm);
            let told = self.told_after_s(arm);
            let _ = writeln!(
                out,
                "| {arm:?} | {:.1} | {worst:.1} | {:.1} | {:.2} | {:.3} | {} |",
                self.phase_95_us(arm),
                quantile(&sigmas, 0.5).unwrap_or(f64::NAN),
                self.error_over_sigma(arm),
                step.fold(0.0, f64::max),
                told.map_or("-".to_owned(), |told| format!("{told:.1}")),
            );
        }
        out
    }
}

/// A clock of a rig that warms up, drawn from the ranges of the models.
fn clock(
    seed: Seed,
    stream: Stream,
    (rates_ppm, moves): (f64, f64),
    warming_ppm: (f64, f64),
    random: &mut Random,
) -> Oscillator {
    let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
    let config = OscillatorConfig {
        offset_ns: 0,
        rate_ppm: random.uniform(-rates_ppm, rates_ppm),
        wander: moves * 1e-6 * log_uniform(random, WANDER_PPM),
        warming: Warming {
            ppm: moves * sign * log_uniform(random, warming_ppm),
            time_s: log_uniform(random, WARMING_S),
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
    fn drawn(seed: Seed, random: &mut Random, until: f64, options: &StudyOptions) -> Self {
        let moves = options.share(Part::Clocks);
        let warming = options.place.within(LinkRanges::RANGES.len(), WARMING_PPM);
        let board = clock(seed, Stream::BoardClock, (30.0, moves), warming, random);
        let phone = clock(seed, Stream::PhoneClock, (50.0, moves), warming, random);
        let computer = clock(seed, Stream::ComputerClock, (50.0, moves), warming, random);
        let ppm = options.share(Part::Steered) * log_uniform(random, (0.1, 10.0));
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

/// The truth about the phone's frames, and the trigger that is to meet them.
struct Frames {
    /// True period, ns of the phone.
    period_ns: f64,
    /// Phone's time of the wanted edge that belongs to the anchor, s.
    first: f64,
}

/// What the twist says, by the truth and its error.
fn twist(clocks: &Clocks, at: f64, random: &mut Random, errors: f64) -> ClockModel {
    let reference = read(&clocks.board, at);
    let offset = |at| read(&clocks.phone, at) - read(&clocks.board, at);
    let sigma = log_uniform(random, (2e-6, 6e-6));
    let skew_sigma = log_uniform(random, (0.3e-6, 0.9e-6));
    ClockModel {
        reference: BoardSeconds(reference),
        offset: offset(at) + errors * sigma * random.normal(),
        skew: offset(at + 0.5) - offset(at - 0.5) + errors * skew_sigma * random.normal(),
        covariance: [[sigma * sigma, 0.0], [0.0, skew_sigma * skew_sigma]],
        wander: Wander::default(),
    }
}

/// Aligns to a video that begins at a true time.
fn align(
    clocks: &Clocks,
    clock: ClockModel,
    at: f64,
    (random, errors): (&mut Random, f64),
) -> Result<(Alignment, Frames)> {
    let period_ns = 1e9 / 30.0 * (1.0 + 1e-4 * random.uniform(-1.0, 1.0));
    let sigma_ns = log_uniform(random, (0.005, 0.05));
    let mut profile = Profile::published()?;
    profile.phone.learnt = Some(Learnt {
        frame_period_ns: period_ns + errors * sigma_ns * random.normal(),
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
        phase: PhoneNanos((phase + errors * FRAME_JITTER_NS * random.normal()).round() as i64),
        frame_duration_ns: period_ns + errors * reported * random.normal(),
        exposure_ns: Some(1_000_000),
    };
    let course = Twists::of(clock).course();
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
    fn error_us(&self, clocks: &Clocks, edge: (u64, u128)) -> Result<f64> {
        let units = (edge.1 * u128::from(UNITS_PER_TICK)) >> 32;
        let units = u64::try_from(units).context("an edge beyond all time")?;
        let at = clocks.board.when_elapsed(units);
        let phone = clocks.phone.elapsed_at(at) as f64 / UNITS_PER_SECOND as f64;
        Ok((phone - self.first - edge.0 as f64 * self.period_ns * 1e-9) * 1e6)
    }
}

/// One session of a rig. In its last half a minute the phone answers nothing any more.
fn session(seed: u64, arm: Arm, options: &StudyOptions) -> Result<Session> {
    let seed = Seed(seed);
    let mut random = seed.stream(Stream::Tracking);
    let begin = random.uniform(5.0, 600.0);
    let video_at = begin + TO_TWIST_S + TO_VIDEO_S;
    let end = video_at + f64::from(options.seconds);
    let clocks = Clocks::drawn(seed, &mut random, end + 60.0, options);
    let errors = options.share(Part::Twist);
    let twist = twist(&clocks, begin + TO_TWIST_S, &mut random, errors);
    let (alignment, frames) = align(&clocks, twist, video_at, (&mut random, errors))?;
    let mut steering = Steering::new(&alignment, 1);
    let ticks = |at: f64| BoardSeconds(read(&clocks.board, at)).ticks();
    let mut result = Session {
        looks: Vec::new(),
        largest_step_ppm: 0.0,
        told_after_s: None,
    };
    let (ranges, kind) = match arm {
        Arm::None => {
            let mut at = video_at;
            while at < end {
                let edge = steering.edge_from(ticks(at));
                result.looks.push(Look {
                    error_us: frames.error_us(&clocks, edge)?,
                    sigma_us: phase_sigma_us_at(&alignment, ticks(at).into()),
                });
                at += JUDGED_EVERY_S;
            }
            return Ok(result);
        }
        Arm::Usb => (LinkRanges::PHONE_USB, Reached::Usb),
        Arm::Wifi => (LinkRanges::PHONE_WIFI, Reached::Network),
    };
    let link = |ranges, stream| Link::drawn(&options.ranges(ranges), seed.stream(stream));
    let mut board_link = link(LinkRanges::BOARD_USB, Stream::BoardLink);
    let mut phone_link = link(ranges, Stream::PhoneLink);
    let mut tracker = Tracker::new();
    let (mut asked, mut at) = ([begin; 2], begin);
    let (mut knows, mut steered, mut judged) = (false, video_at, video_at);
    while at < end + 60.0 {
        let place = usize::from(asked[1] < asked[0]);
        at = asked[place];
        asked[place] += ASKED_EVERY_S[place] * random.uniform(0.5, 1.5);
        let exchange = match place {
            0 => clocks.exchange(&mut board_link, &clocks.board, at),
            _ if at >= end => None,
            _ => clocks.exchange(&mut phone_link, &clocks.phone, at),
        };
        if let Some(exchange) = exchange {
            let asked = if place == 0 { Asked::A } else { Asked::B };
            tracker.take(asked, exchange);
        }
        // A twist is worked out some seconds after it.
        if !knows && at > begin + TO_TWIST_S + 5.0 {
            knows = tracker.take_relation(&twist.into());
        }
        if at < end && at < (steered + STEP_EVERY_S).min(judged + JUDGED_EVERY_S) {
            continue;
        }
        let host = clocks.host(at);
        let holds = has_lock(&tracker, kind, host);
        if at >= end {
            if !holds {
                result.told_after_s.get_or_insert(at - end);
            }
            continue;
        }
        let Some(relation) = tracker.relation_at(host).filter(|_| knows) else {
            continue;
        };
        let relation = ClockModel::from(relation);
        if at >= steered + STEP_EVERY_S && holds {
            let now = ticks(at + 0.05);
            if let Some(period) = steering.wanted(&relation, now, at - steered) {
                let ppm = (period.0 as f64 / steering.period().0 as f64 - 1.0) * 1e6;
                result.largest_step_ppm = result.largest_step_ppm.max(ppm.abs());
                let (_, edge) = steering.edge_from(now);
                steering.follow(Ticks(u64::try_from(edge >> 32)?), edge as u32, period);
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
