//! Safe file names from names that come from the network.

/// Longest name that is returned, in bytes.
const MAX_NAME: usize = 100;

/// File name extensions of the videos that phones record. A fetched file with another one gets
/// `.mp4` appended.
pub const VIDEO_ENDINGS: [&str; 5] = ["mp4", "mov", "mkv", "3gp", "webm"];

/// Returns a plain file name that resembles `raw`, for any `raw`.
///
/// The result is the last component of a Unix or Windows path, consists of ASCII letters, digits,
/// `.`, `-` and `_` only, has at most 100 bytes and one of [`VIDEO_ENDINGS`], and is never hidden,
/// empty, or a device name of Windows. The caller chooses the folder.
#[must_use]
pub fn safe_file_name(raw: &str) -> String {
    let last = raw.rsplit(['/', '\\']).next().unwrap_or_default();
    let clean: String = last
        .trim()
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_') {
                c
            } else {
                '_'
            }
        })
        .collect();
    let clean = clean.trim_matches('.');
    let (stem, ending) = match clean.rsplit_once('.') {
        Some((stem, end)) if VIDEO_ENDINGS.iter().any(|v| v.eq_ignore_ascii_case(end)) => {
            (stem, end)
        }
        _ => (clean, "mp4"),
    };
    let room = MAX_NAME - ending.len() - 1;
    // All ASCII, so it can be cut at any byte.
    let stem = stem.get(..room.min(stem.len())).unwrap_or_default();
    let stem = stem.trim_matches('.');
    if stem.is_empty() {
        format!("phone_video.{ending}")
    } else if is_device_name(stem) || stem.starts_with('-') {
        format!("_{stem}.{ending}")
    } else {
        format!("{stem}.{ending}")
    }
}

/// Returns true if Windows opens a device under this name.
fn is_device_name(stem: &str) -> bool {
    let base = stem
        .split('.')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    matches!(base.as_str(), "con" | "prn" | "aux" | "nul")
        || (base.len() == 4
            && (base.starts_with("com") || base.starts_with("lpt"))
            && base.ends_with(|c: char| c.is_ascii_digit()))
}

/// Removes the number that the app appends to a name that exists already: `gyro_1` or, through the
/// storage access framework, `gyro (1)`. `name` has no extension.
pub(crate) fn without_number(name: &str) -> &str {
    let open = name.strip_suffix(')');
    let split = open.map_or_else(|| name.rsplit_once('_'), |open| open.rsplit_once(" ("));
    match split {
        Some((bare, number)) if number.len() < 3 && is_number(number) => bare,
        _ => name,
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn good_names_stay() {
        for name in ["VID_20210504_161730.mp4", "a.MP4", "b-1.mkv"] {
            assert_eq!(safe_file_name(name), name);
        }
    }

    #[test]
    fn hostile_names_become_plain() {
        for (raw, safe) in [
            ("../../etc/passwd", "passwd.mp4"),
            ("/etc/cron.d/x.mp4", "x.mp4"),
            ("..\\..\\x.mp4", "x.mp4"),
            ("", "phone_video.mp4"),
            ("..", "phone_video.mp4"),
            (".mp4", "mp4.mp4"),
            ("...mp4", "mp4.mp4"),
            ("/", "phone_video.mp4"),
            (".bashrc", "bashrc.mp4"),
            ("a\u{202e}4pm.sh", "a_4pm.sh.mp4"),
            ("a b;rm -rf ~.mp4", "a_b_rm_-rf__.mp4"),
            ("-rf.mp4", "_-rf.mp4"),
            ("con.mp4", "_con.mp4"),
            ("COM1.mp4", "_COM1.mp4"),
            ("x\0y\n.mp4", "x_y_.mp4"),
        ] {
            assert_eq!(safe_file_name(raw), safe, "{raw:?}");
        }
        assert_eq!(safe_file_name(&"x".repeat(5000)).len(), MAX_NAME);
    }

    proptest! {
        #[test]
        fn any_name_becomes_one_plain_component(raw in any::<String>()) {
            let name = safe_file_name(&raw);
            prop_assert!(name.len() <= MAX_NAME + 1 && !name.starts_with(['.', '-']));
            prop_assert!(name.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c)));
            let path = std::path::Path::new(&name);
            prop_assert_eq!(path.components().count(), 1);
            prop_assert_eq!(path.file_name().and_then(|n| n.to_str()), Some(name.as_str()));
        }
    }
}
