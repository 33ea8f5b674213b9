//! The relation of two clocks over a completed recording, from estimates at some times (twists,
//! windows of motion) and from exchanges with the clocks between them.
//!
//! One [`Tracker`] runs over all of it forwards, and another one backwards: with time reversed,
//! a question becomes an answer and vice versa. At each instant the two use different
//! data, and their best combination uses all of it.
//!
//! Limits: those of the tracker, except for a step of an asymmetry, which each of the two meets
//! from its own side.

use super::{Asked, Exchange, Tracker};
use crate::ClockRelation;

/// Distance from the exchanges beyond which a relation is left out, in sigmas.
const CONTRADICTION: f64 = 6.0;

/// Distance of the relations that are returned, s.
const KNOT_S: f64 = 10.0;

impl Exchange {
    fn reversed(&self) -> Self {
        Self {
            sent: -self.received,
            received: -self.sent,
            stamp: -self.stamp,
        }
    }
}

fn reversed(relation: &ClockRelation) -> ClockRelation {
    let [[offset, both], [_, skew]] = relation.covariance;
    ClockRelation {
        reference: -relation.reference,
        offset: -relation.offset,
        covariance: [[offset, -both], [-both, skew]],
        ..*relation
    }
}

/// Returns the relation at each of the `knots`, times of the computer, from all data before it.
fn pass(
    exchanges: impl Iterator<Item = (Asked, Exchange)>,
    known: impl Iterator<Item = ClockRelation>,
    knots: impl Iterator<Item = f64>,
) -> Vec<Option<ClockRelation>> {
    let mut tracker = Tracker::default();
    let (mut known, mut knots) = (known.peekable(), knots.peekable());
    let mut found = Vec::new();
    let mut is_related = false;
    for (asked, exchange) in exchanges {
        while let Some(knot) = knots.next_if(|knot| *knot <= exchange.sent) {
            found.push(tracker.relation_at(knot).filter(|_| is_related));
        }
        if !tracker.add(asked, exchange) {
            continue;
        }
        let Some(now) = tracker.relation_at(exchange.sent) else {
            continue;
        };
        while let Some(next) = known.next_if(|next| next.reference <= now.reference) {
            let expected = now.offset_at(next.reference);
            let sigma = expected.sigma.hypot(next.offset_at(next.reference).sigma);
            if !is_related || (next.offset - expected.value).abs() <= CONTRADICTION * sigma {
                is_related |= tracker.add_relation(&next);
            }
        }
    }
    found.extend(knots.map(|knot| tracker.relation_at(knot).filter(|_| is_related)));
    found
}

/// Returns the relation every ten seconds from the first exchange to the last.
///
/// `known` are relations of twists or windows of motion in order of time. The exchanges of each
/// clock are in the order in which they were asked for; those of the two may be interleaved.
#[must_use]
pub fn followed(exchanges: &[(Asked, Exchange)], known: &[ClockRelation]) -> Vec<ClockRelation> {
    let (Some((_, first)), Some((_, last))) = (exchanges.first(), exchanges.last()) else {
        return Vec::new();
    };
    let count = ((last.sent - first.sent) / KNOT_S).clamp(0.0, 1e6) as u32;
    let knot = |place: u32| first.sent + KNOT_S * f64::from(place);
    let forwards = pass(
        exchanges.iter().copied(),
        known.iter().copied(),
        (0..=count).map(knot),
    );
    let backwards = pass(
        exchanges
            .iter()
            .rev()
            .map(|(asked, each)| (*asked, each.reversed())),
        known.iter().rev().map(reversed),
        (0..=count).rev().map(|place| -knot(place)),
    );
    let backwards = backwards.iter().rev();
    let backwards = backwards.map(|relation| relation.as_ref().map(reversed));
    let both = forwards.into_iter().zip(backwards);
    both.filter_map(|(before, after)| match (before, after) {
        (Some(before), Some(after)) => Some(before.joined(&after)),
        (one, other) => one.or(other),
    })
    .collect()
}
