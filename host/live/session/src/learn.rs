//! Learning of the phone's clocks from a recording: the distance of its
//! frames in its own time ([`clock::frames`]), and the rate of its clock against the
//! board's, from the session's twists or from an extraction. Both are stored in the rig
//! profile.

use std::path::Path;

use clock::frames::LearntFrames;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use toml_edit::{DocumentMut, Item, Table, TomlError};

use recording::profile::edit::{open, phone_table};
use recording::profile::{Learnt, Profile, ProfileError};
use recording::session_file::PhoneRecord;

/// Relative 1-sigma of a crystal's rate from one recording to the next (temperature); added to
/// the stated sigmas, which are those within one recording.
const REPEATABILITY: f64 = 2e-8;

/// Least time between two twists from which a skew is learnt, s.
const MIN_BASELINE_S: f64 = 60.0;

/// Origin of a learnt value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin<'a> {
    /// Board to whose clock the skew refers.
    pub board_id: Option<&'a str>,
    /// Time of the recording.
    pub time: Timestamp,
    /// Temperature of the board's IMU at that time, °C.
    pub board_temperature_c: Option<f64>,
}

/// Returns the profile's entry for the frames of a recording and its skew, given with its 1-sigma
/// within the recording. Changes from one recording to the next are added to the sigmas.
#[must_use]
pub fn learnt(frames: &LearntFrames, skew: Option<(f64, f64)>, origin: &Origin<'_>) -> Learnt {
    Learnt {
        frame_period_ns: frames.period_ns,
        frame_period_sigma_ns: frames.sigma_ns.hypot(REPEATABILITY * frames.period_ns),
        frame_jitter_ns: frames.jitter_ns,
        exposure_us: frames.exposure_us,
        skew: skew.map(|(skew, _)| skew),
        skew_sigma: skew.map(|(_, sigma)| sigma.hypot(REPEATABILITY)),
        learnt: origin.time.to_zoned(TimeZone::system()).date(),
        time: Some(origin.time),
        board_temperature_c: origin.board_temperature_c,
        board_id: origin.board_id.map(str::to_owned),
    }
}

/// Returns the skew from a phone's twists in a session, with its 1-sigma; `None` if they span less
/// than a minute, in which case the skew is too uncertain.
#[must_use]
pub fn skew_of_twists(phone: &PhoneRecord) -> Option<(f64, f64)> {
    let twists = phone.twists.iter();
    let accepted: Vec<f64> = twists
        .filter_map(|twist| twist.clock.map(|clock| clock.reference))
        .collect();
    let baseline = accepted.last()? - accepted.first()?;
    let clock = phone.clock.filter(|_| baseline >= MIN_BASELINE_S)?;
    Some((clock.skew, clock.covariance[1][1].max(0.0).sqrt()))
}

/// Inserts the learnt values into the text of a profile; comments and order stay. `name` is
/// that of the phone; without it, the phone is `[phone]`.
///
/// # Errors
///
/// The text is not a valid profile, or would no longer be one.
pub fn into_profile(
    text: &str,
    path: &Path,
    name: Option<&str>,
    learnt: &Learnt,
) -> Result<String, ProfileError> {
    let (profile, mut document) = open(text, path)?;
    let phone = phone_table(&mut document, &profile, name, path)?;
    let unwritable = |reason: String| ProfileError::Syntax {
        path: Some(path.to_owned()),
        reason,
    };
    let lines = toml::to_string(learnt).map_err(|error| unwritable(error.to_string()))?;
    let lines: DocumentMut = lines
        .parse()
        .map_err(|error: TomlError| unwritable(error.to_string()))?;
    // A new table, which has no position in a document yet.
    let table: Table = lines
        .iter()
        .map(|(key, item)| (key, item.clone()))
        .collect();
    phone.insert("learnt", Item::Table(table));
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clock::frames::{FramePeriod, frame_period};
    use clock::{ClockRelation, PhoneNanos, Wander};
    use recording::profile::DEFAULT;
    use recording::session_file::Twist;

    /// Frames of 33,330,652.54 ns.
    fn period() -> FramePeriod {
        let time = |k: i64| PhoneNanos(900_000_000_000_000 + k * 33_330_652 + k * 54 / 100);
        frame_period(&(0..9_000).map(time).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_profile_keeps_its_comments_and_can_be_read_again() {
        let clock = |reference| ClockRelation {
            reference,
            offset: 1.0,
            skew: 3e-6,
            covariance: [[1e-12, 0.0], [0.0, 1e-18]],
            wander: Wander(1e-8),
        };
        let twist = |reference| Twist {
            phone_gyro: None,
            span: recording::session_file::Span {
                from: Default::default(),
                to: Default::default(),
            },
            accepted: true,
            clock: Some(clock(reference)),
            offset_sigma_us: None,
            skew_sigma_ppm: None,
            board_temperature_c: None,
            report: None,
        };
        let mut twists = vec![twist(10.0)];
        let period = period();
        let last = Some(clock(300.0));
        let learnt = |twists: &[Twist]| {
            let skew = skew_of_twists(&PhoneRecord {
                twists: twists.to_vec(),
                clock: last,
                ..PhoneRecord::default()
            });
            let known = LearntFrames {
                period_ns: period.period_ns,
                sigma_ns: period.sigma_ns,
                jitter_ns: Some(period.jitter_ns),
                exposure_us: Some(2_000.0),
            };
            let origin = Origin {
                board_id: None,
                time: "2026-01-31T12:00:00Z".parse().unwrap(),
                board_temperature_c: Some(27.5),
            };
            super::learnt(&known, skew, &origin)
        };
        let one_twist = learnt(&twists);
        assert_eq!(one_twist.skew, None);
        twists.push(twist(300.0));
        let two_twists = learnt(&twists);
        assert_eq!(two_twists.skew, Some(3e-6));
        assert!(two_twists.skew_sigma.unwrap() >= REPEATABILITY);

        let path = Path::new("rig.toml");
        let text = into_profile(DEFAULT, path, None, &two_twists).unwrap();
        assert!(text.contains("# Where the app (OpenCamera Sensors) listens"));
        let profile = Profile::parse(&text, None).unwrap();
        assert_eq!(profile.phone.learnt, Some(two_twists));
        // A second time replaces the first.
        let again = into_profile(&text, path, Some("phone"), &one_twist).unwrap();
        assert_eq!(
            Profile::parse(&again, None).unwrap().phone.learnt,
            Some(one_twist.clone())
        );
        // With several phones, the one with that name learns.
        let several = format!("{text}\n[[phones]]\nname = \"right\"\naddress = \"x\"\n");
        let taught = into_profile(&several, path, Some("right"), &one_twist).unwrap();
        let profile = Profile::parse(&taught, None).unwrap();
        assert_eq!(profile.phones[0].learnt, Some(one_twist));
        assert!(profile.phone.learnt.unwrap().skew.is_some());
    }
}
