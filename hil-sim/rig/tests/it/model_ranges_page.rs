//! The book's page of model ranges against the models.

use rig::model_ranges::MODEL_RANGES;

const PAGE: &str = include_str!("../../../../docs/model-ranges.md");

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
        assert_eq!(cells[5], range.range_text(), "{name}: the range");
        let nominal = format!("{} {}", range.nominal, range.unit);
        assert_eq!(cells[3], nominal.trim_end(), "{name}: the value");
    }
    assert_eq!(rows, MODEL_RANGES.len(), "rows of the page with a star");
}
