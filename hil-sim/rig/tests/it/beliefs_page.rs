//! The book's page of beliefs against the models: it says of them what is so, and nothing
//! of them is missing on it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use rig::beliefs::BELIEFS;
use rig::lidar::LidarConfig;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use serde_json::Value;

const PAGE: &str = include_str!("../../../../docs/beliefs.md");

/// Everything that stands between backquotes in the page's tables.
fn named() -> BTreeSet<&'static str> {
    let rows = PAGE.lines().filter(|line| line.starts_with('|'));
    rows.flat_map(|row| row.split('`').skip(1).step_by(2))
        .collect()
}

/// The rows that a seed draws are marked with a star, and are these.
#[test]
fn drawn_rows_have_the_same_names_values_and_ranges() {
    let mut rows = 0;
    for line in PAGE.lines().filter(|line| line.starts_with("| * ")) {
        rows += 1;
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let name = cells[1].trim_start_matches("* ");
        let belief = BELIEFS.iter().find(|belief| belief.name == name);
        let belief = belief.unwrap_or_else(|| panic!("nothing draws {name:?}"));
        assert_eq!(cells[5], belief.range_text(), "{name}: the range");
        let nominal = format!("{} {}", belief.nominal, belief.unit);
        assert_eq!(cells[3], nominal.trim_end(), "{name}: the value");
    }
    assert_eq!(rows, BELIEFS.len(), "rows of the page with a star");
}

fn fields(name: String, value: &Value, into: &mut BTreeSet<String>) {
    match value {
        Value::Object(inner) => inner
            .iter()
            .for_each(|(field, value)| fields(format!("{name}.{field}"), value, into)),
        _ => {
            into.insert(name);
        }
    }
}

#[test]
fn every_field_of_the_models_is_on_the_page() {
    let value = serde_json::to_value(RigConfig::published(Seed(1))).unwrap();
    let mut all = BTreeSet::new();
    fields("rig".to_owned(), &value, &mut all);
    let value = serde_json::to_value(PhoneConfig::draw(Seed(1))).unwrap();
    fields("phone".to_owned(), &value, &mut all);
    let value = serde_json::to_value(LidarConfig::default()).unwrap();
    fields("lidar".to_owned(), &value, &mut all);
    let is_field = |name: &&str| {
        let model = name.split_once('.').map(|(model, _)| model);
        matches!(model, Some("rig" | "phone" | "lidar")) && !name.ends_with(".rs")
    };
    let named: Vec<&str> = named().into_iter().filter(is_field).collect();
    let is_named_by = |field: &str, name: &str| match name.strip_suffix('*') {
        Some(group) => field.starts_with(group),
        None => field == name,
    };
    let missing: Vec<&String> = all
        .iter()
        .filter(|field| !named.iter().any(|name| is_named_by(field, name)))
        .collect();
    assert!(missing.is_empty(), "not on the page: {missing:#?}");
    let gone: Vec<&&str> = named
        .iter()
        .filter(|name| !all.iter().any(|field| is_named_by(field, name)))
        .collect();
    assert!(gone.is_empty(), "on the page, but no field: {gone:#?}");
}

fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "tests" {
            sources(&path, into);
        } else if name.ends_with(".rs") && name != "tests.rs" {
            into.push(path);
        }
    }
}

/// The name of a constant that is a number with a unit, or several: not of an address, a
/// count or a text.
fn constant(line: &str) -> Option<&str> {
    const NUMBERS: [&str; 8] = [
        "f64",
        "[f64",
        "(f64",
        "(u16",
        "u64",
        "Duration",
        "SimDuration",
        "Self ",
    ];
    let (_, declared) = line.split_once("const ")?;
    let (name, kind) = declared.split_once(": ")?;
    let is_name = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_';
    let is_number = NUMBERS.iter().any(|number| kind.starts_with(number));
    (name.chars().all(is_name) && is_number).then_some(name)
}

#[test]
fn every_constant_with_a_unit_is_on_the_page() {
    let mut files = Vec::new();
    sources(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("src"),
        &mut files,
    );
    let named = named();
    let mut missing = Vec::new();
    let mut found = 0;
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        let models = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
        for name in models.lines().filter_map(constant) {
            found += 1;
            if !named.contains(name) {
                missing.push(format!("{} in {}", name, file.display()));
            }
        }
    }
    assert!(missing.is_empty(), "not on the page: {missing:#?}");
    assert!(found > 30, "{found} constants");
}
