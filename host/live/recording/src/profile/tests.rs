//! Profiles as their users write them.

use super::*;

#[test]
fn the_default_profile_is_valid_and_is_the_published_rig() {
    let profile = Profile::published().unwrap();
    assert_eq!(profile.pulse_width(), 576);
    assert_eq!(profile.slew(), 4_800);
    assert_eq!(profile.frame_ratio(), 1);
    assert!((profile.phone.middle_row_us() - 9_500.0).abs() < 1e-9);
    assert_eq!(profile.imu_config().unwrap().divider, 1);
    assert_eq!(profile.phone.learnt, None);
}

/// Returns the default profile with the examples of its comments.
fn with_examples() -> String {
    let mut text = String::new();
    for line in DEFAULT.lines() {
        // Examples are comments that look like TOML; prose has no '=' or '['.
        let body = line.strip_prefix("# ").unwrap_or(line);
        let example = body.starts_with('[')
            || body
                .split_once(" = ")
                .is_some_and(|(key, _)| !key.contains(' '));
        if line.starts_with("# ") && example {
            if body.starts_with("command") {
                continue;
            }
            text.push_str(body);
        } else {
            text.push_str(line);
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_commented_examples_are_valid_too() {
    let text = with_examples();
    let profile = Profile::parse(&text, None).unwrap();
    let learnt = profile.phone.learnt.unwrap();
    assert_eq!(learnt.skew, Some(1.2e-5));
    assert!(profile.frame_sync.bias_measured.is_some());
}

#[test]
fn missing_keys_have_defaults_and_unknown_keys_are_errors() {
    let profile = Profile::parse("[phone]\naddress = \"10.0.0.7\"\n", None).unwrap();
    assert_eq!(profile.phone.address, "10.0.0.7");
    assert_eq!(profile.phone.rows, 1080);

    let error = Profile::parse("[phone]\nadress = \"x\"\n", None).unwrap_err();
    assert!(error.to_string().contains("adress"), "{error}");
    let typo = "name = \"x\"\n\n[depth]\n# fps\nfps = 30\n[phone]\nfps = 5\n";
    let error = Profile::parse(typo, Some(Path::new("rig.toml"))).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("rig.toml") && error.contains("unknown field `fps`"),
        "{error}"
    );
    assert!(error.contains("line 7"), "{error}");
    let kind = "[depth]\nmode = \"x\"\nfps = \"thirty\"\n";
    let error = Profile::parse(kind, None).unwrap_err().to_string();
    assert!(error.contains("line 3"), "{error}");
    let value = "[depth]\nmode = \"x\"\n\nfps = 25\n";
    let error = Profile::parse(value, Some(Path::new("my.toml"))).unwrap_err();
    assert!(
        error.to_string().contains("my.toml, line 4, `depth.fps`"),
        "{error}"
    );
    let error = Profile::parse("[phone\n", None).unwrap_err();
    assert!(error.to_string().contains("line 1"), "{error}");
}

#[test]
fn values_out_of_range_name_their_key_and_what_is_expected() {
    for (text, key) in [
        (
            "[[outputs]]\noutput = 5\nname = \"a\"\nevery = 1\n",
            "outputs.output",
        ),
        (
            "[[outputs]]\noutput = 2\nname = \" \"\nevery = 1\n",
            "outputs.name",
        ),
        (
            "[[outputs]]\noutput = 2\nname = \"a\"\nevery = 0\n",
            "outputs.every",
        ),
        ("[lidar]\nname = \"v\"\nbaud = 9601\n", "lidar.baud"),
        ("[lidar]\nname = \"\"\n", "lidar.name"),
        (
            "[[outputs]]\noutput = 2\nname = \"a\"\nevery = 1\n[lidar]\nname = \"a\"\n",
            "lidar.name",
        ),
        ("[depth]\nfps = 25\n", "depth.fps"),
        ("[imu]\nrate_hz = 300\n", "imu.rate_hz"),
        ("[imu]\nrate_hz = 0\n", "imu.rate_hz"),
        ("[phone]\nreadout_us = nan\n", "phone.readout_us"),
        ("[phone]\nmiddle_row = 1080\n", "phone.middle_row"),
        ("reference = \"left\"\n", "reference"),
        ("[phone]\nname = \"a/b\"\n", "phone.name"),
        ("[[phones]]\naddress = \"x\"\n", "phone.name"),
        (
            "[[phones]]\nname = \"Phone\"\naddress = \"x\"\n",
            "phones.name",
        ),
        (
            "[[phones]]\nname = \"left\"\naddress = \"x\"\nrows = 1\n",
            "phone.rows",
        ),
    ] {
        let error = Profile::parse(text, None).unwrap_err().to_string();
        assert!(error.contains(key), "{text}: {error}");
        assert!(error.contains("expected"), "{error}");
    }
}

#[test]
fn expected_values_are_stated_with_their_unit() {
    let learnt = "[phone.learnt]\nlearnt = 2024-05-17\nframe_period_ns = 33e6\n\
                  frame_period_sigma_ns = 1\nskew = 0.1\n";
    for (text, expected) in [
        (
            "[depth]\npulse_width_us = 5\n",
            "`depth.pulse_width_us` is 5, expected 8 to 10000 (µs)",
        ),
        (
            "[frame_sync]\nbias_us = inf\n",
            "`frame_sync.bias_us` is inf, expected -1000000 to 1000000 (µs)",
        ),
        (
            "[phone]\nrows = 1\n",
            "`phone.rows` is 1, expected 2 to 100000",
        ),
        (
            learnt,
            "`phone.learnt.skew` is 0.1, expected -0.001 to 0.001",
        ),
        (
            "[phone]\ntwist_s = 2\n",
            "`phone.twist_s` is 2, expected 3 to 60 (s)",
        ),
    ] {
        let error = Profile::parse(text, None).unwrap_err().to_string();
        let (place, error) = error.split_once(", `").unwrap();
        assert_eq!(format!("`{error}"), expected);
        assert!(place.starts_with("in the rig profile, line "), "{place}");
    }
}

#[test]
fn several_phones_have_defaults_and_one_of_them_is_the_reference() {
    let text = "[phone]\nname = \"left\"\nrows = 720\n\n\
                [[phones]]\nname = \"right\"\naddress = \"10.0.0.8\"\n";
    let profile = Profile::parse(text, None).unwrap();
    assert_eq!(
        (profile.phone.name.as_str(), profile.phone.rows),
        ("left", 720)
    );
    let right = &profile.phones[0];
    assert_eq!((right.address.as_str(), right.rows), ("10.0.0.8", 1080));

    let other = Profile::parse(&format!("reference = \"right\"\n{text}"), None).unwrap();
    assert_eq!(other.phone, profile.phones[0]);
    assert_eq!(other.phones, [profile.phone]);
    // What a session file keeps reads back as the same.
    let kept = toml::to_string(&other).unwrap();
    assert_eq!(Profile::parse(&kept, None).unwrap(), other);

    let error = Profile::parse("[[phones]]\nname = \"right\"\n", None).unwrap_err();
    assert!(error.to_string().contains("address"), "{error}");
    let alone = Profile::parse("[phone]\nrows = 720\n", None).unwrap();
    assert_eq!(
        (alone.phone.name.as_str(), alone.phones.len()),
        ("phone", 0)
    );
}

#[test]
fn a_written_profile_can_be_added_to_and_read_again() {
    let profile = Profile::published().unwrap();
    let text = profile.to_toml().unwrap();
    assert_eq!(Profile::parse(&text, None).unwrap(), profile);
    let more = "\n[[outputs]]\noutput = 2\nname = \"side\"\nevery = 6\n\
                [[phones]]\nname = \"right\"\naddress = \"x\"\n[lidar]\nname = \"VLP-16\"\n";
    let profile = Profile::parse(&(text + more), None).unwrap();
    assert_eq!(profile.outputs.len(), 1);
    let text = profile.to_toml().unwrap();
    assert_eq!(Profile::parse(&text, None).unwrap(), profile);
}

/// Calls `each` with the place of every number below a value.
fn each_number(value: &mut toml::Value, each: &mut dyn FnMut(&mut toml::Value)) {
    match value {
        toml::Value::Table(table) => table
            .iter_mut()
            .for_each(|(_, value)| each_number(value, each)),
        toml::Value::Array(list) => list.iter_mut().for_each(|value| each_number(value, each)),
        toml::Value::Float(_) | toml::Value::Integer(_) => each(value),
        _ => {}
    }
}

#[test]
fn no_number_can_be_none_or_beyond_all_reason() {
    let mut whole: toml::Value = with_examples().parse::<toml::Table>().unwrap().into();
    let mut count = 0;
    each_number(&mut whole, &mut |_| count += 1);
    assert!(count > 40, "{count}");
    for place in 0..count {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308] {
            let mut changed = whole.clone();
            let mut number = 0;
            let mut before = None;
            each_number(&mut changed, &mut |value| {
                if number == place {
                    before = Some(std::mem::replace(value, toml::Value::Float(wrong)));
                }
                number += 1;
            });
            let text = toml::to_string(&changed).unwrap();
            let read = Profile::parse(&text, None);
            assert!(
                read.is_err(),
                "{wrong} in place of {before:?}, number {place}"
            );
        }
    }
}

#[test]
fn errors_are_short_and_an_address_must_be_one() {
    let long = "x".repeat(1 << 20);
    for text in [
        format!("name = {long}"),
        format!("{long} = 1"),
        format!("[phone]\nname = \"{long}/\""),
        format!("[depth]\ncamera = \"{long}\""),
    ] {
        let error = Profile::parse(&text, None).unwrap_err().to_string();
        assert!(error.len() < 2_000, "{} bytes", error.len());
    }
    for wrong in ["10.0.0.7:99999", "10.0.0.7:0", "http://10.0.0.7", ":6969"] {
        let text = format!("[phone]\naddress = \"{wrong}\"");
        let error = Profile::parse(&text, None).unwrap_err().to_string();
        assert!(error.contains("phone.address"), "{error}");
    }
}
