//! The book's page of model ranges, and its drawings, against what they are about.

use std::path::Path;

use rig::model_ranges::{Draw, MODEL_RANGES};

const PAGE: &str = include_str!("../../ranges.md");

/// The rows that a seed draws are marked with a star, and are these.
#[test]
fn drawn_rows_have_the_same_names_values_and_ranges() {
    let mut rows = 0;
    for line in PAGE.lines().filter(|line| line.starts_with("| * ")) {
        rows += 1;
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let name = cells[1].trim_start_matches("* ");
        let range = MODEL_RANGES.iter().find(|range| range.name == name);
        let range = range.unwrap_or_else(|| panic!("nothing draws {name:?}"));
        let (least, most) = range.range;
        let sign = if range.draw == Draw::EitherSign {
            "±"
        } else {
            ""
        };
        let text = format!("{sign}{least} to {most} {}", range.unit);
        assert_eq!(cells[5], text.trim_end(), "{name}: the range");
        let nominal = format!("{} {}", range.nominal, range.unit);
        assert_eq!(cells[3], nominal.trim_end(), "{name}: the value");
    }
    assert_eq!(rows, MODEL_RANGES.len(), "rows of the page with a star");
}

/// A file in the second column exists below one of the folders that the page names.
#[test]
fn files_of_the_page_exist() {
    let rig = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = [
        "src",
        "..",
        "../..",
        "../../host/data",
        "../../host/sync/clock/src",
    ];
    let mut missing = Vec::new();
    for place in PAGE.lines().filter_map(|line| line.split('|').nth(2)) {
        let spans = place.split('`').skip(1).step_by(2);
        let files = spans.filter(|span| span.ends_with(".rs"));
        let is_missing =
            |file: &&str| !(folders.iter()).any(|folder| rig.join(folder).join(file).is_file());
        missing.extend(files.filter(is_missing));
    }
    assert!(missing.is_empty(), "{missing:?}");
}

/// A pin in a drawing is one of the table, and a place on a header beside it is that pin's.
#[test]
fn drawings_name_pins_and_headers_of_the_table() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/images");
    let mut found = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
        let mut pin = "";
        for word in words {
            let rest = word.strip_prefix('P').unwrap_or_default();
            let (port, number) = rest.split_at(rest.len().min(1));
            let is_number = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
            if matches!(port, "A" | "B" | "C" | "D" | "E") && is_number {
                pin = word;
                found += 1;
                let is_there = protocol::pins::pins().any(|(pin, ..)| pin == word);
                assert!(is_there, "{}: {word}", path.display());
            } else if rest.starts_with("1-") || rest.starts_with("2-") {
                let header = protocol::pins::pins().find(|row| row.0 == pin).unwrap().1;
                assert_eq!(word, header, "{}: {pin}", path.display());
            }
        }
    }
    assert!(found > 10, "only {found} pins in drawings");
}
