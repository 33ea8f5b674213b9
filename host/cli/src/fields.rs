//! A result for people: the lines of its JSON object, without the punctuation.

/// One field a line, by the names that `docs/json.md` explains.
pub(crate) fn text(json: &str) -> String {
    json.lines().filter_map(line).collect::<Vec<_>>().join("\n")
}

/// A line of indented JSON; `None` if it only closes what is open.
fn line(line: &str) -> Option<String> {
    let text = line.trim_start();
    // Two blanks a level, and the fields of the outermost object are on the first.
    let indent = " ".repeat((line.len() - text.len()).saturating_sub(2));
    let text = text.trim_end_matches(',');
    let field = text.strip_prefix('"').and_then(|it| it.split_once("\": "));
    let (name, value) = match field.filter(|(name, _)| !name.ends_with('\\')) {
        Some((name, value)) => (format!("{name}: "), value),
        None => (String::from("- "), text),
    };
    let value = match value {
        "}" | "]" => return None,
        "{" | "[" if line == value => return None,
        "{" | "[" => String::new(),
        // A text of several lines stays as it is in JSON: no line of it looks like a field.
        value => serde_json::from_str(value)
            .ok()
            .filter(|text: &String| !text.contains('\n'))
            .unwrap_or_else(|| value.to_owned()),
    };
    Some(format!("{indent}{name}{value}").trim_end().to_owned())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_field_a_line_and_lists_with_dashes() {
        let value = json!({
            "a": "x \": y{", "z": "1\nb: 2", "b": { "c": -1.5, "d": null }, "e": [1, "two"],
            "f": [{ "g": true }, { "g": false }], "h": [],
        });
        let json = serde_json::to_string_pretty(&value).unwrap();
        let expected = "a: x \": y{\nb:\n  c: -1.5\n  d: null\ne:\n  - 1\n  - two\n\
                        f:\n  -\n    g: true\n  -\n    g: false\nh: []\nz: \"1\\nb: 2\"";
        assert_eq!(text(&json), expected);
        assert_eq!(text("{}"), "- {}");
    }
}
