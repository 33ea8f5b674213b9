//! Comparison of a train of pulses with the arithmetic that made it, and with its captures.

use std::fmt;

use protocol::{Capture, Edge, EdgeGrid, Pulse, TICK_HZ, TickDelta, Ticks, TriggerStatus};

/// Largest difference of equal delays: a signal that changes just when its input is sampled is
/// seen a tick later.
pub(crate) const TICK_OF_DOUBT: i64 = 1;

/// Longest plausible delay from an edge to its capture: 0.5 µs. Some three clocks of
/// synchroniser and eight of filter (RM0090 18.4.7) are 0.2 µs.
pub(crate) const MAX_DELAY: i64 = (TICK_HZ / 2_000_000) as i64;

/// The edges that the pulses of a train must have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseGrid {
    pub(crate) grid: EdgeGrid,
    /// Number of the pulse at the anchor.
    pub(crate) number: u64,
}

impl PulseGrid {
    /// Returns the grid of a train from its next edge on.
    pub(crate) fn from_status(status: &TriggerStatus) -> Self {
        Self {
            grid: EdgeGrid::new(status.next_edge, status.period),
            number: status.pulses,
        }
    }

    /// Returns the distance of a pulse from its edge.
    pub(crate) fn error(&self, pulse: &Pulse) -> TickDelta {
        let ahead = pulse.number.wrapping_sub(self.number) as i64;
        pulse.at - self.grid.edge(ahead).ticks
    }
}

/// Smallest and largest of some numbers of ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Extent(pub(crate) Option<(i64, i64)>);

impl fmt::Display for Extent {
    /// `7 to 8 ticks`, `7 ticks`, `nothing`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("nothing"),
            Some((low, high)) if low == high => write!(f, "{low} ticks"),
            Some((low, high)) => write!(f, "{low} to {high} ticks"),
        }
    }
}

impl Extent {
    pub(crate) fn add(&mut self, value: i64) {
        self.0 = Some(self.0.map_or((value, value), |(low, high)| {
            (low.min(value), high.max(value))
        }));
    }

    /// Returns true if there are values and all lie in `low..=high`.
    pub(crate) fn within(self, low: i64, high: i64) -> bool {
        self.0.is_some_and(|(min, max)| low <= min && max <= high)
    }

    /// Returns the largest less the smallest.
    pub(crate) fn spread(self) -> Option<i64> {
        self.0.map(|(low, high)| high.saturating_sub(low))
    }
}

/// Comparison of trains with their edges and captures.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trains {
    /// Pulses that were compared with a grid.
    pub(crate) on_grid: u64,
    /// Their distances from it.
    pub(crate) grid_error: Extent,
    /// Pulses that should be on the strobe input.
    pub(crate) pulses: u64,
    /// Those that were seen there.
    pub(crate) captured: u64,
    /// Delay from their edge to its capture.
    pub(crate) delay: Extent,
    /// Captured width less the requested one.
    pub(crate) width_error: Extent,
    /// Those that were read back.
    pub(crate) read_back: u64,
    /// Delay from their edge to the read-back.
    pub(crate) read_back_delay: Extent,
}

impl Trains {
    /// Compares the pulses with their grid.
    pub(crate) fn compare(&mut self, grid: &PulseGrid, pulses: &[Pulse]) {
        for pulse in pulses {
            self.compared(grid.error(pulse));
        }
    }

    /// Returns the number of compared pulses and their distances, in words.
    pub(crate) fn on_grid_text(&self) -> String {
        format!("{} pulses, {} off", self.on_grid, self.grid_error)
    }

    /// Returns true if all pulses were read back, after one constant.
    pub(crate) fn is_read_back(&self) -> bool {
        let spread = self.read_back_delay.spread();
        self.read_back == self.pulses
            && self.read_back_delay.within(0, MAX_DELAY)
            && spread.is_some_and(|spread| spread <= TICK_OF_DOUBT)
    }

    /// Adds the distance of a pulse from its grid.
    pub(crate) fn compared(&mut self, off: TickDelta) {
        self.on_grid += 1;
        self.grid_error.add(off.0);
    }

    /// Looks for each pulse on the strobe input: `captures` in the order of time. A
    /// capture belongs to a pulse if it comes before the pulse is over.
    pub(crate) fn find(&mut self, pulses: &[Pulse], width: u32, captures: &[Capture]) {
        for pulse in pulses {
            if let Some(delay) = pulse.readback {
                self.read_back += 1;
                self.read_back_delay.add(delay.into());
            }
            self.look_for(pulse.at, width, captures);
        }
    }

    /// Looks for a pulse that begins at `at`.
    pub(crate) fn look_for(&mut self, at: Ticks, width: u32, captures: &[Capture]) {
        self.pulses += 1;
        let end = at + TickDelta(width.into());
        let from = captures.partition_point(|capture| capture.at < at);
        let mut edges = captures.get(from..).unwrap_or_default().iter();
        let rising = edges
            .next()
            .filter(|rising| rising.edge == Edge::Rising && rising.at < end);
        let Some(rising) = rising else { return };
        self.captured += 1;
        self.delay.add((rising.at - at).0);
        if let Some(falling) = edges.next()
            && falling.edge == Edge::Falling
        {
            let seen = falling.at - rising.at;
            self.width_error.add(seen.0 - i64::from(width));
        }
    }
}
