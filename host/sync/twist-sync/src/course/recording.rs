//! The relation over whole recordings, from windows of natural motion.
//!
//! Any motion contains information about the offset, not only a twist. Recording a is cut into
//! windows; each with enough motion gives an estimate by [`estimate_offset`], with
//! all its gates, and the estimates are joined to a [`ClockCourse`]. Both recordings
//! are *streamed*: a few windows are in memory at a time, so that a recording of
//! hours needs no more than one of minutes. The windows of a batch are estimated in
//! parallel.
//!
//! A refused window is estimated again over a wide range of offsets, because a clock
//! may have stepped. Two refused neighbours are estimated together, and two of
//! those again, up to [`LONGEST`]: weak motion adds up.
//!
//! The caller gives an expected offset ([`Prior`]), or a first one is found by
//! [`search`](super::search).

use std::collections::VecDeque;
use std::convert::Infallible;
use std::error::Error;
use std::iter::{Fuse, Peekable};
use std::mem::discriminant;
use std::num::NonZero;
use std::{panic, thread};

use super::error::CourseError;
use super::{ClockCourse, Unsupported, search};
use crate::clock::ClockRelation;
use crate::estimate::{Estimate, Gate, Options, Refusal, Warning, estimate_offset};
use crate::faults::Why;
use crate::track::{GyroOpener, GyroSample, GyroStream, GyroTrack, MOST_SAMPLES};

/// Length of a window, ns.
const WINDOW: i64 = 10_000_000_000;
/// Largest 1-sigma of one window's estimate, seconds.
const WINDOW_SIGMA_S: f64 = 1e-3;
/// Windows that are estimated at a time.
const BATCH: usize = 8;
/// Least half-width of the search around the expected offset, seconds.
const LEAST_MARGIN_S: f64 = 0.1;
/// Largest half-width, seconds.
const MOST_MARGIN_S: f64 = 5.0;
/// Most windows that are estimated as one: 320 s.
const LONGEST: usize = 32;
/// Largest distance of windows that follow each other, seconds.
const FOLLOWS_S: f64 = 0.5;
/// Length beyond which a stretch with motion but without estimates is reported as unsupported,
/// seconds.
const UNSUPPORTED_S: f64 = 25.0;
/// 1-sigma of the offset in such a stretch, in seconds for each second of its length: a clock
/// may be steered or step.
const UNSUPPORTED_RATE: f64 = 100e-6;
/// Largest difference in rate of two clocks.
const MOST_SKEW: f64 = 500e-6;
/// Prior knowledge about the relation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// An earlier estimate of the relation.
    Relation(ClockRelation),
    /// The offset (b − a) in seconds, and the half-width of its range in seconds.
    Offset(f64, f64),
}

/// Result of [`estimate_course`]: the relation over a recording, and the windows it is from.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecordingClock {
    /// Offset and skew over time.
    pub course: ClockCourse,
    /// Number of windows of recording a.
    pub windows: usize,
    /// Accepted estimates; one may be of several windows.
    pub estimates: Vec<ClockRelation>,
    /// Windows without an estimate, by the gate that refused them.
    pub refused: Vec<RefusedWindows>,
    /// Warnings of the estimates: the first of each kind, and the number of estimates with it.
    pub warnings: Vec<(Warning, usize)>,
}

/// Windows of a recording that one gate refused.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefusedWindows {
    /// The gate, with the figures of the first refused window.
    pub gate: Gate,
    /// Number of windows.
    pub count: usize,
}

impl Options {
    /// Returns the settings for windows of natural motion, which accept a larger sigma of each
    /// window.
    #[must_use]
    pub fn for_windows() -> Self {
        Self {
            sigma_limit_s: WINDOW_SIGMA_S,
            ..Self::default()
        }
    }
}

/// Relates the clocks over whole recordings. `options` apply to each window
/// ([`Options::for_windows`]), their `wander` also to the course. Each recording is opened
/// once, and several times more where `prior` is `None`.
///
/// # Errors
///
/// Fails if a recording cannot be read, or no window can be related.
pub fn estimate_course<E: Error + Send + 'static>(
    a: GyroOpener<'_, E>,
    b: GyroOpener<'_, E>,
    prior: Option<Prior>,
    options: &Options,
) -> Result<RecordingClock, CourseError<E>> {
    let mut expected = match prior {
        Some(prior) => prior,
        None => Prior::Relation(search::first_relation(a, b, options)?),
    };
    let mut windows = Windows {
        a: a()?.peekable(),
        b: b()?.fuse(),
        b_waiting: VecDeque::new(),
        taken: 0,
    };
    let mut found = Found::default();
    loop {
        // Until the first estimate each window is judged before the next: its
        // result makes the search of all others narrow.
        let size = if found.estimates.is_empty() { 1 } else { BATCH };
        let (batch, ended) = windows.batch(size, &expected)?;
        let results = estimated(&batch, options);
        for (window, result) in batch.into_iter().zip(results) {
            found.add(window, result, options);
        }
        if let Some((latest, _)) = found.estimates.last() {
            expected = Prior::Relation(*latest);
        }
        if ended {
            break;
        }
    }
    found.join_all(options);
    found.clock(windows.taken, options)
}

/// Relates the clocks over whole recordings in memory, like [`estimate_course`]. Times are
/// rounded to nanoseconds; samples whose time is no later than that of the one before are left
/// out.
///
/// # Errors
///
/// Fails if no window can be related, or a track has not as many rates as times.
pub fn course_of_tracks(
    a: &GyroTrack,
    b: &GyroTrack,
    prior: Option<Prior>,
    options: &Options,
) -> Result<RecordingClock, CourseError<Infallible>> {
    let unequal = a.unequal().max(b.unequal());
    if unequal > 0 {
        return Err(CourseError::NoRelation(Gate::lengths(unequal).to_string()));
    }
    // Relative to the epochs, so that no digits are lost; to whole seconds of them, because stamps
    // in whole multiples of a decimal step are judged by all their digits.
    let (a_epoch_s, b_epoch_s) = (a.whole_epoch_s(), b.whole_epoch_s());
    let between = b_epoch_s - a_epoch_s;
    let prior = prior.map(|prior| match prior {
        Prior::Offset(offset, margin) => Prior::Offset(offset - between, margin),
        Prior::Relation(relation) => Prior::Relation(relation.moved(-a_epoch_s, -between)),
    });
    let (a_opened, b_opened) = (|| Ok(a.stream()), || Ok(b.stream()));
    let mut clock = estimate_course(&a_opened, &b_opened, prior, options)?;
    for estimate in &mut clock.estimates {
        *estimate = estimate.moved(a_epoch_s, between);
    }
    clock.course = clock.course.moved(a_epoch_s, between);
    Ok(clock)
}

impl Prior {
    /// Returns offset and half-width of the search at a window, in seconds.
    fn at(&self, window: &GyroTrack) -> (f64, f64) {
        let middle = window.epoch_s + 0.5 * window.t.last().copied().unwrap_or(0.0);
        match self {
            Self::Offset(offset, margin) => (*offset, margin.clamp(LEAST_MARGIN_S, MOST_MARGIN_S)),
            Self::Relation(relation) => {
                let offset = relation.offset_at(middle);
                let distance = (middle - relation.reference).abs();
                let drift = (6.0 * offset.sigma).min(MOST_SKEW * distance);
                let known = 6.0 * relation.offset_here().sigma;
                let margin = (LEAST_MARGIN_S + known + drift).min(MOST_MARGIN_S);
                (offset.value, margin)
            }
        }
    }
}

/// A window of a, and the samples of b that may belong to it.
struct Window {
    a: GyroTrack,
    /// With at least [`MOST_MARGIN_S`] on either side of the expected offset.
    b: GyroTrack,
    /// Expected offset and half-width of the search, seconds.
    search: (f64, f64),
    /// Number of windows that were joined to this one.
    count: usize,
}

impl Window {
    /// Returns first and last time of a, in seconds.
    fn span(&self) -> (f64, f64) {
        let last = self.a.t.last().copied().unwrap_or(0.0);
        (self.a.epoch_s, self.a.epoch_s + last)
    }

    fn estimated(&self, options: &Options) -> Result<Estimate, Refusal> {
        let within = |margin: f64| {
            let (from, to) = self.span();
            let offset = self.search.0;
            let b = self.b.between(from + offset - margin, to + offset + margin);
            let search = Some((offset, margin));
            estimate_offset(&self.a, &b, &Options { search, ..*options })
        };
        let narrow = within(self.search.1);
        match &narrow {
            // A clock that has stepped has another lag.
            Err(refusal) if refusal.is_about_lag() && self.search.1 < MOST_MARGIN_S => {
                within(MOST_MARGIN_S).or(narrow)
            }
            _ => narrow,
        }
    }

    /// Joins this window and a later one; `None` if that does not follow.
    fn joined(&self, later: &Self) -> Option<Self> {
        let follows = later.span().0 - self.span().1 < FOLLOWS_S;
        follows.then(|| Self {
            a: self.a.followed_by(&later.a),
            b: self.b.followed_by(&later.b),
            search: later.search,
            count: self.count + later.count,
        })
    }
}

/// Estimates, and windows that wait for their neighbours.
#[derive(Default)]
struct Found {
    /// Each with the part of its 1-sigma that all of them share, seconds.
    estimates: Vec<(ClockRelation, f64)>,
    /// Refused windows with their refusals; each waits for another one of its size.
    waiting: Vec<(Window, Refusal)>,
    refused: Vec<RefusedWindows>,
    /// Stretches of a with motion that could not be related.
    unrelated: Vec<(f64, f64)>,
    /// Parts of windows that were left out because the offset differs there.
    stepped: Vec<Unsupported>,
    warnings: Vec<(Warning, usize)>,
}

impl Found {
    fn add(&mut self, window: Window, result: Result<Estimate, Refusal>, options: &Options) {
        match result {
            Ok(estimate) => self.accept(&window, &estimate),
            Err(refusal) => {
                self.waiting.push((window, refusal));
                self.join(false, options);
            }
        }
    }

    fn accept(&mut self, window: &Window, estimate: &Estimate) {
        for left_out in &estimate.report.left_out {
            if let Why::TimeStep(by_s) = left_out.why {
                self.stepped.push(Unsupported {
                    from_s: window.a.epoch_s + left_out.from_s,
                    to_s: window.a.epoch_s + left_out.to_s,
                    sigma_s: by_s.abs(),
                });
            }
        }
        let common_s = estimate.report.common_s;
        self.estimates.push((estimate.clock, common_s));
        for warning in &estimate.report.warnings {
            let mut known = self.warnings.iter_mut();
            match known.find(|own| discriminant(&own.0) == discriminant(warning)) {
                Some(own) => own.1 += 1,
                None => self.warnings.push((*warning, 1)),
            }
        }
    }

    /// Estimates waiting neighbours together: those of equal size, or with `all` any.
    fn join(&mut self, all: bool, options: &Options) {
        while let [.., (early, _), (late, _)] = &self.waiting[..]
            && (all || early.count == late.count)
        {
            let both = early.joined(late);
            let both = both.filter(|both| both.count <= LONGEST);
            let Some(both) = both else {
                let at = self.waiting.len() - if all { 1 } else { 2 };
                let (window, refusal) = self.waiting.remove(at);
                self.give_up(&window, &refusal);
                continue;
            };
            let last = self.waiting.pop();
            let first = self.waiting.pop();
            match both.estimated(options) {
                Ok(estimate) => self.accept(&both, &estimate),
                // The refusal of the longer window has more data.
                Err(refusal) => {
                    drop((first, last));
                    self.waiting.push((both, refusal));
                }
            }
        }
    }

    fn join_all(&mut self, options: &Options) {
        self.join(true, options);
        for (window, refusal) in std::mem::take(&mut self.waiting) {
            self.give_up(&window, &refusal);
        }
    }

    fn give_up(&mut self, window: &Window, refusal: &Refusal) {
        let failed = refusal.report.gates.iter().find(|gate| !gate.passed);
        let Some(gate) = failed else {
            return;
        };
        if refusal.is_about_lag() {
            self.unrelated.push(window.span());
        }
        let mut known = self.refused.iter_mut();
        match known.find(|own| own.gate.kind == gate.kind) {
            Some(own) => own.count += window.count,
            None => self.refused.push(RefusedWindows {
                gate: *gate,
                count: window.count,
            }),
        }
    }

    fn clock<E: Error>(
        mut self,
        windows: usize,
        options: &Options,
    ) -> Result<RecordingClock, CourseError<E>> {
        let all = &mut self.estimates;
        all.sort_by(|x, y| x.0.reference.total_cmp(&y.0.reference));
        let estimates: Vec<ClockRelation> = all.iter().map(|own| own.0).collect();
        let course = ClockCourse::with_common(all, options.wander);
        let Some(mut course) = course else {
            let most = self.refused.iter().max_by_key(|own| own.count);
            return Err(CourseError::NoRelation(if estimates.is_empty() {
                most.map_or_else(
                    || "they have no time in common".into(),
                    |most| most.gate.to_string(),
                )
            } else {
                format!(
                    "{} windows give relations that contradict each other",
                    estimates.len()
                )
            }));
        };
        course
            .unsupported
            .extend(unsupported(self.unrelated, &estimates));
        course.unsupported.append(&mut self.stepped);
        Ok(RecordingClock {
            course,
            windows,
            estimates,
            refused: self.refused,
            warnings: self.warnings,
        })
    }
}

/// Returns the long stretches of unrelated windows that contain no estimate.
fn unsupported(mut unrelated: Vec<(f64, f64)>, estimates: &[ClockRelation]) -> Vec<Unsupported> {
    unrelated.sort_by(|x, y| x.0.total_cmp(&y.0));
    let is_parted = |from: f64, to: f64| {
        estimates
            .iter()
            .any(|estimate| (from..to).contains(&estimate.reference))
    };
    let mut stretches: Vec<(f64, f64)> = Vec::new();
    for (from, to) in unrelated {
        match stretches.last_mut() {
            Some(last) if !is_parted(last.0, from) => last.1 = to,
            _ => stretches.push((from, to)),
        }
    }
    let long = stretches
        .into_iter()
        .filter(|(from, to)| to - from > UNSUPPORTED_S);
    long.map(|(from_s, to_s)| Unsupported {
        from_s,
        to_s,
        sigma_s: UNSUPPORTED_RATE * (to_s - from_s),
    })
    .collect()
}

/// Estimates the windows of a batch on all cores. One estimate stays on one thread: it takes
/// some milliseconds, and on a busy machine threads that wait for each other wait longer.
fn estimated(batch: &[Window], options: &Options) -> Vec<Result<Estimate, Refusal>> {
    let all =
        |windows: &[Window]| -> Vec<_> { windows.iter().map(|w| w.estimated(options)).collect() };
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let share = batch.len().div_ceil(threads).max(1);
    if share >= batch.len() {
        return all(batch);
    }
    thread::scope(|scope| {
        let parts: Vec<_> = batch
            .chunks(share)
            .map(|part| scope.spawn(move || all(part)))
            .collect();
        let done = parts.into_iter().map(thread::ScopedJoinHandle::join);
        done.flat_map(|part| part.unwrap_or_else(|reason| panic::resume_unwind(reason)))
            .collect()
    })
}

/// Cuts two streams into windows.
struct Windows<'a, E> {
    a: Peekable<GyroStream<'a, E>>,
    b: Fuse<GyroStream<'a, E>>,
    /// Samples of b that a window may still need.
    b_waiting: VecDeque<GyroSample>,
    /// Number of windows of a so far.
    taken: usize,
}

impl<E> Windows<'_, E> {
    /// Returns the next `size` windows, and true if a has ended.
    fn batch(&mut self, size: usize, expected: &Prior) -> Result<(Vec<Window>, bool), E> {
        let mut batch = Vec::with_capacity(size);
        while batch.len() < size {
            let Some(a) = self.next_a()? else {
                return Ok((batch, true));
            };
            let search = expected.at(&a);
            self.taken += 1;
            let b = self.b_around(&a, (search.0, search.1.max(MOST_MARGIN_S)))?;
            batch.push(Window {
                a,
                b,
                search,
                count: 1,
            });
        }
        Ok((batch, false))
    }

    fn next_a(&mut self) -> Result<Option<GyroTrack>, E> {
        let Some(first) = self.a.next().transpose()? else {
            return Ok(None);
        };
        let mut samples = vec![first];
        let end = first.at.saturating_add(WINDOW);
        let belongs = |sample: &Result<GyroSample, E>| !sample.as_ref().is_ok_and(|s| s.at >= end);
        while samples.len() < MOST_SAMPLES
            && let Some(sample) = self.a.next_if(belongs)
        {
            samples.push(sample?);
        }
        Ok(Some(GyroTrack::from_samples(&samples)))
    }

    /// Returns the samples of b around a window. Windows come in order of time.
    fn b_around(
        &mut self,
        window: &GyroTrack,
        (offset, margin): (f64, f64),
    ) -> Result<GyroTrack, E> {
        let from = nanos(window.epoch_s + offset - margin);
        let last = window.t.last().copied().unwrap_or(0.0);
        let to = nanos(window.epoch_s + last + offset + margin);
        // The next window may look back by as much as its own margin.
        let keep = from.saturating_sub(nanos(MOST_MARGIN_S));
        while self.b_waiting.back().is_none_or(|sample| sample.at < to)
            && let Some(sample) = self.b.next().transpose()?
        {
            if sample.at >= keep {
                self.b_waiting.push_back(sample);
            }
        }
        let is_old = |sample: &&GyroSample| sample.at < keep;
        let old = self.b_waiting.iter().take_while(is_old).count();
        self.b_waiting.drain(..old);
        let samples: Vec<GyroSample> = self
            .b_waiting
            .iter()
            .filter(|sample| sample.at >= from && sample.at < to)
            .take(MOST_SAMPLES)
            .copied()
            .collect();
        Ok(GyroTrack::from_samples(&samples))
    }
}

fn nanos(seconds: f64) -> i64 {
    (seconds * 1e9) as i64
}
