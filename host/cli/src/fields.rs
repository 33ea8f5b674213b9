//! Plain text of a result: one field a line, in the order of its JSON object.
//!
//! The names are those that `docs/json.md` explains, in words: `exposure_ns` of 8,000,000 is
//! `exposure: 8000000 ns`.

use std::fmt;
use std::io::{self, Write};

use serde::Serialize;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::ser::{Formatter, Serializer};

/// Endings of field names that are units. Longer ones come before their own endings.
const UNITS: [(&str, &str); 14] = [
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_ticks", "ticks"),
    ("_percent", "%"),
    ("_ppm", "ppm"),
    ("_ppb", "ppb"),
    ("_hz", "Hz"),
    ("_ns", "ns"),
    ("_us", "µs"),
    ("_ms", "ms"),
    ("_ug", "µg"),
    ("_udps", "µ°/s"),
    ("_c", "°C"),
    ("_s", "s"),
];

/// Significant digits of a number that is not whole.
const DIGITS: i32 = 6;

/// JSON with each number that is not whole as the text to be shown. A parsed number may be of
/// another type where a crate of the same build enables `arbitrary_precision`.
struct Shortened;

impl Formatter for Shortened {
    fn write_f32<W: ?Sized + Write>(&mut self, out: &mut W, value: f32) -> io::Result<()> {
        self.write_f64(out, value.into())
    }

    fn write_f64<W: ?Sized + Write>(&mut self, out: &mut W, value: f64) -> io::Result<()> {
        write!(out, "\"{}\"", number(value))
    }
}

/// A JSON value that keeps the order of fields.
enum Node {
    Null,
    Text(String),
    List(Vec<Node>),
    Object(Vec<(String, Node)>),
}

/// Returns the fields of a result, one a line.
pub(crate) fn text(result: &impl Serialize) -> serde_json::Result<String> {
    let mut json = Vec::new();
    result.serialize(&mut Serializer::with_formatter(&mut json, Shortened))?;
    let mut out = String::new();
    match serde_json::from_slice(&json)? {
        Node::Object(fields) => write_fields(&mut out, 0, &fields),
        node => write_value(&mut out, 0, "-", "", &node),
    }
    Ok(out)
}

fn write_fields(out: &mut String, depth: usize, fields: &[(String, Node)]) {
    for (field, node) in fields {
        let mut units = UNITS.iter();
        let unit = units.find_map(|(ending, unit)| Some((field.strip_suffix(ending)?, *unit)));
        let (name, unit) = unit.unwrap_or((field, ""));
        let name = format!("{}:", name.replace('_', " "));
        write_value(out, depth, &name, unit, node);
    }
}

/// Writes a value after its name, and the values in it on further lines.
fn write_value(out: &mut String, depth: usize, name: &str, unit: &str, node: &Node) {
    out.push_str(&"  ".repeat(depth));
    out.push_str(name);
    match node {
        Node::Null if unit.is_empty() => out.push_str(" none"),
        Node::Null => out.push_str(" not reported"),
        Node::List(nodes) if nodes.is_empty() => out.push_str(" none"),
        // Quoted if it has several lines, so that none of them looks like a field.
        Node::Text(text) if text.contains('\n') => out.extend([" ", &format!("{text:?}")]),
        Node::Text(text) if unit.is_empty() => out.extend([" ", text]),
        Node::Text(text) => out.extend([" ", text, " ", unit]),
        Node::List(_) | Node::Object(_) => {}
    }
    out.push('\n');
    match node {
        Node::List(nodes) => nodes
            .iter()
            .for_each(|node| write_value(out, depth + 1, "-", unit, node)),
        Node::Object(fields) => write_fields(out, depth + 1, fields),
        Node::Null | Node::Text(_) => {}
    }
}

/// Returns a number with six significant digits, or all digits before its point.
fn number(value: f64) -> String {
    let magnitude = value.abs().max(f64::MIN_POSITIVE).log10().floor() as i32;
    let decimals = (DIGITS - 1 - magnitude).clamp(0, 15) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Node, E> {
        let word = if value { "yes" } else { "no" };
        Ok(Node::Text(word.to_owned()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Text(value.to_string()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
        Ok(Node::Text(value.to_string()))
    }

    fn visit_str<E>(self, text: &str) -> Result<Node, E> {
        Ok(Node::Text(text.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Node, A::Error> {
        let mut nodes = Vec::new();
        while let Some(node) = items.next_element()? {
            nodes.push(node);
        }
        Ok(Node::List(nodes))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Node, A::Error> {
        let mut fields = Vec::new();
        while let Some(entry) = entries.next_entry()? {
            fields.push(entry);
        }
        Ok(Node::Object(fields))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_a_line_and_lists_with_dashes() {
        #[derive(Serialize)]
        struct Below {
            g: bool,
        }
        #[derive(Serialize)]
        struct Result {
            z: &'static str,
            a: &'static str,
            b: (f32, Option<u8>),
            e: [Option<&'static str>; 2],
            f: [Below; 2],
            h: [u8; 0],
        }
        let result = Result {
            z: "1\nb: 2",
            a: "x\": y{",
            b: (-1.5, None),
            e: [Some("one"), Some("two")],
            f: [true, false].map(|g| Below { g }),
            h: [],
        };
        let expected = "z: \"1\\nb: 2\"\na: x\": y{\nb:\n  - -1.5\n  - none\ne:\n  - one\n  - two\n\
                        f:\n  -\n    g: yes\n  -\n    g: no\nh: none\n";
        assert_eq!(text(&result).unwrap(), expected);
    }

    #[test]
    fn endings_of_names_are_units() {
        #[derive(Serialize)]
        struct Measured {
            phase_ns: i64,
            frame_duration_ns: f64,
            exposure_ns: Option<f64>,
            gyro_noise_rad_s: [Option<f64>; 2],
            period_ns: &'static str,
        }
        let measured = Measured {
            phase_ns: 1_234_567_890_123_456_789,
            frame_duration_ns: 33_333_333.25,
            exposure_ns: None,
            gyro_noise_rad_s: [Some(0.001_234_567_89), None],
            period_ns: "1.000",
        };
        let expected = "phase: 1234567890123456789 ns\nframe duration: 33333333 ns\n\
                        exposure: not reported\ngyro noise:\n  - 0.00123457 rad/s\n  - not reported\n\
                        period: 1.000 ns\n";
        assert_eq!(text(&measured).unwrap(), expected);
    }
}
