//! Bytes of a serial line from the times of its edges.

use protocol::{Capture, Edge, TICK_HZ, TickDelta, Ticks};

/// Bytes that are read: `$GPRMC,hhmmss`. The strobe input keeps up with the edges of this many.
const BYTES: usize = 13;

/// Bits of a byte with start and stop.
const FRAME: i64 = 10;

/// The beginning of a text on a line of 8 data bits without parity.
pub(crate) struct Line {
    /// First edge.
    pub(crate) begins: Ticks,
    /// The line is low when idle.
    pub(crate) idle_low: bool,
    /// The bytes; fewer where one had no stop bit or an edge was lost.
    pub(crate) text: Vec<u8>,
    /// Largest distance of an edge from its place in its byte, in ticks.
    pub(crate) doubt: i64,
}

impl Line {
    /// Decodes the text whose first edge is the first one after a time, such as the end of a pulse.
    pub(crate) fn after(at: Ticks, baud: u32, captures: &[Capture]) -> Option<Self> {
        let bit = i64::from(TICK_HZ / baud.max(1)).max(1);
        let from = captures.partition_point(|capture| capture.at < at);
        let mut rest = captures.get(from..)?;
        let first = rest.first()?;
        let mut line = Self {
            begins: first.at,
            idle_low: first.edge == Edge::Rising,
            text: Vec::new(),
            doubt: 0,
        };
        while let Some((start, edges)) = rest.split_first() {
            // Edges lost before the first one belong to the previous sentence.
            let is_whole = line.text.is_empty() || !start.after_loss;
            if line.text.len() == BYTES || !is_whole || start.edge != first.edge {
                break;
            }
            let end = start.at + TickDelta(bit * FRAME - bit / 2);
            let inside = edges.partition_point(|edge| edge.at < end);
            let (inside, after) = edges.split_at_checked(inside)?;
            // The level after each edge, as mark or space, from the middle of one bit to the next.
            let mut bits = [false; FRAME as usize];
            for edge in inside {
                let since = (edge.at - start.at).0;
                let place = (since + bit / 2) / bit;
                line.doubt = line.doubt.max((since - place * bit).abs());
                let is_mark = edge.edge != first.edge;
                bits.iter_mut()
                    .skip(place as usize)
                    .for_each(|bit| *bit = is_mark);
            }
            if inside.iter().any(|edge| edge.after_loss) || !bits[FRAME as usize - 1] {
                break;
            }
            let byte = (bits.iter().skip(1).take(8).enumerate())
                .fold(0, |byte, (n, bit)| byte | u8::from(*bit) << n);
            line.text.push(byte);
            rest = after;
        }
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the edges of a line that carries a text, with bits of this many ticks.
    fn edges(text: &[u8], bit: u64, idle_low: bool) -> Vec<Capture> {
        let (mut all, mut is_mark, mut at) = (Vec::new(), true, 1_000);
        for byte in text {
            let frame = u16::from(*byte) << 1 | 1 << 9;
            for n in 0..10 {
                let mark = frame >> n & 1 == 1;
                if mark != is_mark {
                    let edge = if mark == idle_low {
                        Edge::Falling
                    } else {
                        Edge::Rising
                    };
                    all.push(Capture {
                        edge,
                        at: Ticks(at),
                        ..Capture::default()
                    });
                    is_mark = mark;
                }
                at += bit;
            }
        }
        all
    }

    #[test]
    fn every_byte_is_read_on_either_polarity_and_a_wrong_rate_is_seen() {
        for idle_low in [false, true] {
            for bytes in (0..=u8::MAX).collect::<Vec<_>>().chunks(BYTES) {
                let line = Line::after(Ticks(10), 9_600, &edges(bytes, 5_000, idle_low)).unwrap();
                assert_eq!((&*line.text, line.idle_low), (bytes, idle_low));
                assert_eq!((line.begins, line.doubt), (Ticks(1_000), 0));
            }
        }
        let slow = Line::after(Ticks(0), 9_600, &edges(b"$GPRMC", 5_050, false)).unwrap();
        assert_eq!(slow.text, b"$GPRMC");
        assert_eq!(slow.doubt, 450);
        assert!(Line::after(Ticks(0), 9_600, &[]).is_none());
        let mut lost = edges(b"$GPRMC", 5_000, false);
        lost[9].after_loss = true;
        assert!(Line::after(Ticks(0), 9_600, &lost).unwrap().text.len() < 3);
    }
}
