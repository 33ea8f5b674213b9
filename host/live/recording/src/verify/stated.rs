//! Compares what `session.json` states with the messages: clocks, markers, the first pulse on the
//! grid, spans, counts.

use std::collections::BTreeMap;

use board::Stream;
use clock::ClockRelation;
use protocol::{TICK_HZ, Ticks};

use super::fault::Fault;
use super::findings::Findings;
use crate::Item;
use crate::contents::TopicContents;
use crate::messages::ClockModel;
use crate::session_file::{SessionFile, SessionOutcome};
use crate::topic::Topic;

/// Longest time between begin or end of the recorded span and a message of a stream, ticks. IMU:
/// half a second. Pulses: as long, of the slowest camera that is at least two. Status: once a second.
const STREAMS: [(Stream, u64); 3] = [
    (Stream::Imu, TICK_HZ as u64 / 2),
    (Stream::Pulses, TICK_HZ as u64 / 2),
    (Stream::Status, 5 * TICK_HZ as u64 / 2),
];

/// Shortest span whose ends are compared, ticks: two seconds.
const LEAST: u64 = 2 * TICK_HZ as u64;

/// Largest relative difference of two numbers of which one went through decimal digits.
const DIGITS: f64 = 1e-15;

/// Facts from the messages.
pub(super) struct Stated<'a> {
    session: Option<&'a SessionFile>,
    /// Last relation of each phone's clock; the reference has no name.
    clocks: BTreeMap<Option<String>, ClockRelation>,
    /// Number of markers that are not in the session, in order, and of those that are.
    markers: (u64, usize),
    /// True if the first pulse on the grid was seen at its time.
    has_arrived: bool,
    /// First and last time of each of [`STREAMS`] within the recorded span.
    within: [Option<[Ticks; 2]>; STREAMS.len()],
}

impl<'a> Stated<'a> {
    pub(super) fn new(session: Option<&'a SessionFile>) -> Self {
        Self {
            session,
            clocks: BTreeMap::new(),
            markers: (0, 0),
            has_arrived: false,
            within: [None; STREAMS.len()],
        }
    }

    /// Takes a message in.
    pub(super) fn see(&mut self, item: &Item, at: Ticks, findings: &mut Findings) {
        match item {
            Item::Clock(model) => self.clock(None, model, at, findings),
            Item::PhoneClock(model) => {
                let name = model.header.frame_id.clone();
                self.clock(Some(name), model, at, findings);
            }
            Item::Marker(marker) => {
                let place = self.markers.1;
                let known = self.session.and_then(|session| session.markers.get(place));
                let is_known =
                    known.is_some_and(|known| known.at == at && known.label == marker.source);
                self.markers.0 += u64::from(!is_known);
                self.markers.1 += 1;
            }
            Item::Pulse(pulse) => {
                let alignment = self.session.and_then(|session| session.alignment);
                self.has_arrived |= alignment.is_some_and(|alignment| {
                    alignment.arrival == Some(at) && alignment.arrival_pulse == Some(pulse.number)
                });
            }
            _ => {}
        }
        let recorded = self.session.and_then(|session| session.recorded);
        if recorded.is_none_or(|span| !(span.from..=span.to).contains(&at)) {
            return;
        }
        let stream = item.topic().stream();
        for (place, (of, _)) in self.within.iter_mut().zip(STREAMS) {
            if stream == Some(of) {
                let [from, to] = place.unwrap_or([at; 2]);
                *place = Some([from.min(at), to.max(at)]);
            }
        }
    }

    fn clock(
        &mut self,
        name: Option<String>,
        model: &ClockModel,
        at: Ticks,
        findings: &mut Findings,
    ) {
        match model.relation() {
            Some(clock) => {
                self.clocks.insert(name, clock);
            }
            None => findings.add(&Fault::ClockImpossible, Some(at)),
        }
    }

    /// Compares the session with the messages of a file without damage. Returns the number of each
    /// comparison that was made, by its subject.
    pub(super) fn finish(
        self,
        topics: &BTreeMap<String, TopicContents>,
        file: Option<[Ticks; 2]>,
        pulses_missing: u64,
        findings: &mut Findings,
    ) -> Vec<String> {
        let Some(session) = self.session else {
            return Vec::new();
        };
        let mut compared = Vec::new();
        let clocks = self.compare_clocks(session, findings);
        if clocks > 0 {
            compared.push(format!(
                "relation of the clocks of {clocks} phones with the last that was recorded"
            ));
        }
        if self.markers.0 > 0 || self.markers.1 != session.markers.len() {
            findings.add(&Fault::MarkersDiffer, None);
        } else if self.markers.1 > 0 {
            compared.push(format!(
                "{} markers with those that were recorded",
                self.markers.1
            ));
        }
        self.compare_spans(session, file, findings);
        let alignment = session.alignment.filter(|_| session.has_recorded());
        let arrival =
            alignment.and_then(|alignment| alignment.arrival_pulse.zip(alignment.arrival));
        if self.has_arrived {
            compared.push(String::from(
                "the first pulse on the grid with its number and time",
            ));
        } else if let Some((number, at)) = arrival.filter(|_| pulses_missing == 0) {
            findings.add(&Fault::ArrivalDiffers(number), Some(at));
        }
        compared.extend(self.compare_recorded(session, topics, findings));
        compare_counts(session, topics, findings);
        compared
    }

    /// Compares the relation of each phone's clock with the last that was recorded, and returns the
    /// number of phones.
    fn compare_clocks(&self, session: &SessionFile, findings: &mut Findings) -> usize {
        let mut compared = 0;
        for (place, phone) in session.phones.iter().enumerate() {
            let name = (place > 0).then(|| phone.name.clone());
            let recorded = self.clocks.get(&name);
            // The number of messages is compared with what was written.
            let Some(recorded) = recorded else { continue };
            let is_same = phone.clock.is_some_and(|stated| is_same(recorded, &stated));
            compared += usize::from(is_same);
            if !is_same {
                findings.add(&Fault::ClockDiffers(phone.name.clone()), None);
            }
        }
        compared
    }

    /// Checks that the spans of the session lie within the board time of the file.
    fn compare_spans(
        &self,
        session: &SessionFile,
        file: Option<[Ticks; 2]>,
        findings: &mut Findings,
    ) {
        let [first, last] = file.unwrap_or_default();
        let second = u64::from(TICK_HZ);
        let bounds = first.0.saturating_sub(second)..=last.0.saturating_add(second);
        let twists = session.phones.iter().flat_map(|phone| &phone.twists);
        let spans = twists.map(|twist| ("a twist", twist.span));
        let recorded = session.recorded.map(|span| ("the recorded span", span));
        for (what, span) in spans.chain(recorded) {
            if !(bounds.contains(&span.from.0) && bounds.contains(&span.to.0)) {
                findings.add(&Fault::SpanOutside { what }, Some(span.from));
            }
        }
    }

    /// Checks that the streams cover the recorded span, and that it is as long as was asked for.
    fn compare_recorded(
        &self,
        session: &SessionFile,
        topics: &BTreeMap<String, TopicContents>,
        findings: &mut Findings,
    ) -> Option<String> {
        let span = session.recorded.filter(|_| session.outcome.is_some())?;
        let kept = span.to.0.saturating_sub(span.from.0);
        let second = f64::from(TICK_HZ);
        let seconds = |ticks: u64| ticks as f64 / second;
        let is_ended = matches!(
            session.outcome,
            Some(SessionOutcome::Good | SessionOutcome::Loss)
        );
        if let Some(asked_s) = session.asked_s.filter(|_| is_ended)
            && seconds(kept) < asked_s - 0.1
        {
            let kept_s = seconds(kept);
            findings.add(&Fault::Shorter { kept_s, asked_s }, None);
        }
        if kept < LEAST {
            return None;
        }
        for ((stream, most), within) in STREAMS.into_iter().zip(self.within) {
            let is_of = |topic: &Topic| topic.stream() == Some(stream);
            let mut own = Topic::ALL.into_iter().filter(is_of);
            // A stream that never was is compared with what was written.
            if !own.any(|topic| topics.contains_key(topic.name())) {
                continue;
            }
            let missing = within.map_or([kept; 2], |[from, to]| {
                [from.0 - span.from.0, span.to.0 - to.0]
            });
            let missing_s = missing.map(|ticks| if ticks > most { seconds(ticks) } else { 0.0 });
            if missing_s != [0.0; 2] {
                findings.add(
                    &Fault::SpanNotCovered { stream, missing_s },
                    Some(span.from),
                );
            }
        }
        let kept_s = seconds(kept);
        Some(format!(
            "pulses, samples and status with the recorded span of {kept_s:.1} s, from its begin to its end"
        ))
    }
}

/// Checks that the session did not count more messages than there are.
fn compare_counts(
    session: &SessionFile,
    topics: &BTreeMap<String, TopicContents>,
    findings: &mut Findings,
) {
    for topic in Topic::ALL {
        let Some(stream) = topic.stream() else {
            continue;
        };
        let counted = session.counts.get(stream).received;
        let found = topics.get(topic.name()).map_or(0, |found| found.messages);
        if counted > found {
            let fault = Fault::CountsDiffer {
                stream,
                counted,
                found,
            };
            findings.add(&fault, None);
        }
    }
}

/// Returns true if two relations are the same, but for the last digits.
fn is_same(a: &ClockRelation, b: &ClockRelation) -> bool {
    let numbers = |clock: &ClockRelation| {
        let [[c00, c01], [c10, c11]] = clock.covariance;
        let (reference, offset) = (clock.reference, clock.offset);
        [
            reference,
            offset,
            clock.skew,
            c00,
            c01,
            c10,
            c11,
            clock.wander.0,
        ]
    };
    let mut both = numbers(a).into_iter().zip(numbers(b));
    both.all(|(a, b)| (a - b).abs() <= DIGITS * a.abs())
}
