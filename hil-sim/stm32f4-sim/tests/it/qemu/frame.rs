//! The frame of the program that both cores run.

const LISTING: &str = include_str!("frame.lst");

/// Where the frame is loaded.
pub(crate) const AT: u32 = 0x0800_0100;

/// Where a label of the listing is.
pub(crate) fn entry(label: &str) -> u32 {
    let (before, _) = LISTING.split_once(&format!("\n{label}:\n")).unwrap();
    AT + 2 * half_words(before).len() as u32
}

/// The whole frame.
pub(crate) fn code() -> Vec<u16> {
    half_words(LISTING)
}

fn half_words(listing: &str) -> Vec<u16> {
    let lines = listing.lines().filter_map(|line| line.strip_prefix("    "));
    let codes = lines.flat_map(|line| line.split("  ").next().unwrap_or_default().split(' '));
    codes
        .map(|code| u16::from_str_radix(code, 16).unwrap())
        .collect()
}
