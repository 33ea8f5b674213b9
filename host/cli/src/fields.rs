//! Plain text of a result: one field a line, in the order of its JSON object.
//!
//! The names are those that `docs/json.md` explains, in words: `exposure_ns` of 8,000,000 is
//! `exposure: 8000000 ns`.

use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

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

/// Name of the only field of an object as which `serde_json` passes a number with a point, if a
/// crate of the same build (the simulator's are) enables its `arbitrary_precision`.
const NUMBER: &str = "$serde_json::private::Number";

/// A JSON value that keeps the order of fields.
enum Node {
    Null,
    Text(String),
    List(Vec<Node>),
    Object(Vec<(String, Node)>),
}

/// Returns the fields of a JSON document, one a line.
pub(crate) fn text(json: &str) -> serde_json::Result<String> {
    let mut out = String::new();
    match serde_json::from_str(json)? {
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

    fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Text(number(value)))
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
        while let Some((name, node)) = entries.next_entry::<String, Node>()? {
            match node {
                Node::Text(digits) if name == NUMBER => {
                    return Ok(Node::Text(digits.parse().map_or(digits, number)));
                }
                node => fields.push((name, node)),
            }
        }
        Ok(Node::Object(fields))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_a_line_and_lists_with_dashes() {
        let json = r#"{"z": "1\nb: 2", "a": "x\": y{", "b": {"c": -1.5, "d": null},
            "e": [1, "two"], "f": [{"g": true}, {"g": false}], "h": []}"#;
        let expected = "z: \"1\\nb: 2\"\na: x\": y{\nb:\n  c: -1.5\n  d: none\ne:\n  - 1\n  - two\n\
                        f:\n  -\n    g: yes\n  -\n    g: no\nh: none\n";
        assert_eq!(text(json).unwrap(), expected);
        assert_eq!(text("{}").unwrap(), "");
    }

    #[test]
    fn endings_of_names_are_units() {
        let json = r#"{"phase_ns": 1234567890123456789, "frame_duration_ns": 33333333.25,
            "exposure_ns": null, "gyro_noise_rad_s": [0.00123456789], "period_ns": "1.000"}"#;
        let expected = "phase: 1234567890123456789 ns\nframe duration: 33333333 ns\n\
                        exposure: not reported\ngyro noise:\n  - 0.00123457 rad/s\n\
                        period: 1.000 ns\n";
        assert_eq!(text(json).unwrap(), expected);
    }
}
