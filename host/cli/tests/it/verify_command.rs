//! `verify` finds every damage and every contradiction that is put into a recording, and the
//! reader gives what is left.

use std::fs;
use std::path::Path;

use board::finding::Severity;
use board::imu::Scale;
use protocol::ImuFlags;
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use recording::RecordingError;
use recording::reader::{Entry, Reader};
use recording::session_file::{ImuInfo, SessionFile};
use recording::verify::Verification;
use system::ReadMonitor;

use crate::support::run;
use crate::support::synthetic::{SECONDS, Wrong, make};
use test_support::TestFolder;
use test_support::board::imu_setup;

const MCAP: &str = "recording.mcap";

fn kinds(verification: &Verification) -> Vec<String> {
    let findings = verification.findings.iter();
    findings.map(|finding| finding.kind.to_string()).collect()
}

fn verify(recording: &Path) -> Result<Verification, RecordingError> {
    recording::verify::verify(recording, &ReadMonitor::default())
}

/// The entries that can be read.
fn entries(recording: &Path) -> Vec<Entry> {
    Reader::open(recording).unwrap().flatten().collect()
}

#[test]
fn a_whole_recording_is_whole() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    let checked = run(&["verify", folder.to_str().unwrap(), "--json"]);
    assert_eq!(checked.status.code(), Some(0), "{checked:?}");
    let report = checked.json();
    let findings = report["findings"].as_array().unwrap();
    let is_good = |finding: &serde_json::Value| finding["severity"] == "good";
    assert!(findings.iter().all(is_good), "{report}");
    // Nothing is lost; the constant was never measured, and there is no depth recording.
    assert_eq!(report["severity"], "check", "{report}");
    assert_eq!(report["verdict"]["severity"], "check", "{report}");
    assert_eq!(report["form"], 3);
    assert_eq!(report["streams"]["imu"]["received"], SECONDS * 500);
    assert_eq!(report["streams"]["pulses"]["missing"], 0);
    assert_eq!(report["grid"]["checked"], SECONDS * 30);
    assert_eq!(report["grid"]["off"], 0);
    assert_eq!(report["file"]["closed"], true);
}

/// Where the records outside of chunks begin and end.
fn boundaries(bytes: &[u8]) -> Vec<usize> {
    let mut at = 8;
    let mut all = vec![0, 8];
    while let Some(length) = bytes.get(at + 1..at + 9) {
        let length = u64::from_le_bytes(length.try_into().unwrap()) as usize;
        if at + 9 + length + 8 > bytes.len() {
            break;
        }
        at += 9 + length;
        all.push(at);
    }
    all
}

#[test]
fn a_file_that_is_cut_anywhere_is_told_and_read() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    let bytes = fs::read(folder.join(MCAP)).unwrap();
    let whole = entries(&folder);
    let mut cuts: Vec<usize> = boundaries(&bytes)
        .into_iter()
        .flat_map(|at| [at.saturating_sub(1), at, at + 1, at + 9, at + 30])
        .chain((0..20).map(|part| bytes.len() * part / 20))
        .chain([bytes.len() - 1, bytes.len() - 8, bytes.len() - 9])
        .filter(|&cut| cut < bytes.len())
        .collect();
    cuts.sort_unstable();
    cuts.dedup();
    assert!(cuts.len() > 100, "{}", cuts.len());
    let mut most = 0;
    let place = parent.path().join("cut.mcap");
    for cut in cuts {
        fs::write(&place, &bytes[..cut]).unwrap();
        let Ok(report) = verify(&place) else {
            assert!(cut < 8, "cut at {cut}");
            continue;
        };
        assert_eq!(report.severity, Severity::Check, "cut at {cut}");
        let saved = entries(&place);
        assert!(whole.starts_with(&saved), "cut at {cut}");
        assert!(saved.len() >= most, "cut at {cut}");
        most = saved.len();
    }
    assert_eq!(most, whole.len());
}

#[test]
fn every_flipped_bit_is_found_and_costs_a_chunk_at_most() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    let bytes = fs::read(folder.join(MCAP)).unwrap();
    let chunks = verify(&folder).unwrap().file.chunks;
    let all = entries(&folder).len();
    let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
    let mut places: Vec<usize> = (0..80).map(|_| rng.random_range(0..bytes.len())).collect();
    // The heads of all records, which no chunk's checksum covers.
    for (number, at) in boundaries(&bytes).into_iter().enumerate() {
        // Every fifth of the small records between chunks.
        if bytes.get(at) != Some(&6) && number % 5 > 0 {
            continue;
        }
        places.extend((at..at + 9).step_by(3));
    }
    places.extend(bytes.len() - 40..bytes.len());
    places.retain(|&place| place < bytes.len());
    let place = parent.path().join("flipped.mcap");
    let mut assumed = 0;
    for at in places {
        let bit = rng.next_u32() % 8;
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << bit;
        fs::write(&place, &flipped).unwrap();
        let report = verify(&place).unwrap();
        assert_ne!(report.severity, Severity::Good, "bit {bit} of byte {at}");
        let lost = chunks - report.file.chunks;
        assert!(lost <= 1, "bit {bit} of byte {at}: {lost} chunks lost");
        assumed += usize::from(kinds(&report).contains(&String::from("topics_assumed")));
        let saved = entries(&place).len();
        // A chunk is half a second: 500 samples in four kinds of messages, and few others.
        assert!(
            saved + 1_100 > all,
            "bit {bit} of byte {at}: {saved} of {all}"
        );
    }
    assert!(assumed > 0, "no bit of the part that describes the topics");
}

#[test]
fn what_the_board_dropped_is_told_from_what_the_link_lost() {
    for board_knows in [false, true] {
        let parent = TestFolder::new();
        let wrong = Wrong {
            sample_lost: Some(1_234),
            board_knows,
            ..Wrong::default()
        };
        let report = verify(&make(parent.path(), wrong)).unwrap();
        assert_eq!(report.severity, Severity::Check, "{report:?}");
        let imu = report.streams["imu"];
        assert_eq!(imu.missing, 1);
        assert_eq!(imu.dropped_by_board, u64::from(board_knows));
        assert_eq!(kinds(&report), ["messages_missing"]);
    }
}

#[test]
fn a_loss_on_the_auxiliary_outputs_is_counted() {
    let parent = TestFolder::new();
    let wrong = Wrong {
        outputs_lost: &[2, 3],
        ..Wrong::default()
    };
    let folder = make(parent.path(), wrong);
    let report = verify(&folder).unwrap();
    assert_eq!(report.severity, Severity::Check, "{report:?}");
    assert_eq!(
        run(&["verify", folder.to_str().unwrap()]).status.code(),
        Some(4)
    );
    let outputs = report.streams["outputs"];
    assert_eq!((outputs.received, outputs.missing), (SECONDS - 2, 2));
    assert_eq!(kinds(&report), ["messages_missing"]);
}

#[test]
fn a_pulse_off_its_grid_by_one_tick_is_found() {
    let parent = TestFolder::new();
    let wrong = Wrong {
        pulse_late: Some((77, 1)),
        ..Wrong::default()
    };
    let folder = make(parent.path(), wrong);
    let report = verify(&folder).unwrap();
    assert_eq!(report.severity, Severity::Bad);
    assert_eq!(kinds(&report), ["off_grid"]);
    assert_eq!(report.grid.unwrap().worst_ticks, 1);
}

#[test]
fn a_silence_of_the_imu_is_found_and_must_have_a_reason() {
    for (flags, severity, kind) in [
        (ImuFlags::AFTER_LOSS, Severity::Check, "imu_gap"),
        (ImuFlags(0), Severity::Bad, "imu_gap_unexplained"),
    ] {
        let parent = TestFolder::new();
        let wrong = Wrong {
            imu_silence: Some((700, flags)),
            ..Wrong::default()
        };
        let folder = make(parent.path(), wrong);
        let mut session = SessionFile::load(&folder).unwrap();
        let setup = imu_setup();
        let scale = Scale::from_setup(&setup).unwrap();
        session.imu = Some(ImuInfo { setup, scale });
        session.save(&folder).unwrap();
        let report = verify(&folder).unwrap();
        assert_eq!(report.severity, severity);
        assert_eq!(kinds(&report), [kind]);
    }
}

#[test]
fn what_the_session_names_must_be_there() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    fs::remove_file(folder.join("twist_1_phone_gyro.csv")).unwrap();
    let report = verify(&folder).unwrap();
    assert_eq!(kinds(&report), ["file_missing"]);
    fs::write(folder.join("session.json"), "{").unwrap();
    let report = verify(&folder).unwrap();
    assert_eq!(report.severity, Severity::Bad);
    assert_eq!(kinds(&report), ["session_file_damaged"]);
}

#[test]
fn an_attachment_that_is_too_short_is_damage() {
    let parent = TestFolder::new();
    let place = parent.path().join("short.mcap");
    // Shorter than its own checksum.
    let hostile = [
        b"\x89MCAP0\r\n".as_slice(),
        &[9, 2, 0, 0, 0, 0, 0, 0, 0, 1, 2],
    ]
    .concat();
    fs::write(&place, hostile).unwrap();
    let report = verify(&place).unwrap();
    assert!(report.file.cut_off_at.is_some());
    for entry in Reader::open(&place).unwrap() {
        let _ = entry;
    }
}
