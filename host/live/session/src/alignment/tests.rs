use jiff::civil::date;

use super::*;
use clock::frames::FramePeriodSource;
use clock::rates::RateChange;
use clock::twists::Twists;
use clock::{BoardSeconds, BoardToPhone, ClockRelation, PhoneNanos, Wander};

/// Profile of a rig whose constants are known exactly.
fn profile() -> Profile {
    let mut profile = Profile::published().unwrap();
    profile.depth.center_offset_sigma_us = 0.0;
    profile.phone.gyro_delay_sigma_us = 0.0;
    profile.phone.readout_us = 11_006.0;
    profile.phone.readout_sigma_us = 0.0;
    profile.phone.exposure_locked = true;
    profile
}

fn clock() -> ClockRelation {
    ClockRelation {
        reference: 100.0,
        offset: 36_000.000_25,
        skew: 2e-5,
        covariance: [[9e-12, 0.0], [0.0, 1e-12]],
        wander: Wander(1e-8),
    }
}

/// Course of a rig that does not warm up.
fn course() -> Course {
    Course {
        clock: clock(),
        change: RateChange::default(),
    }
}

fn video() -> Video {
    Video {
        phase: PhoneNanos(36_110_000_000_000),
        frame_duration_ns: 33_330_652.542,
        exposure_ns: Some(4_000_000),
        boot_minus_frames_ns: 0,
    }
}

fn learnt() -> Learnt {
    Learnt {
        frame_period_ns: 33_330_650.0,
        frame_period_sigma_ns: 0.02,
        frame_jitter_ns: None,
        exposure_us: None,
        skew: Some(2.05e-5),
        skew_sigma: Some(2e-8),
        learnt: date(2026, 1, 31),
        time: None,
        board_temperature_c: None,
        board_id: Some(String::from("AB")),
    }
}

#[test]
fn the_middle_of_depth_falls_on_the_middle_of_the_row() {
    let mut profile = profile();
    profile.frame_sync.bias_us = -120.0;
    let planned = plan(&profile, &course(), &video()).unwrap();
    let alignment = planned.alignment;
    // Back from the edge to the phone's time: the same instant.
    let middle_board = BoardSeconds(alignment.plan.anchor.as_secs_f64() + (6_362.5 - 120.0) * 1e-6);
    let middle_phone = clock().to_phone(middle_board).0;
    let wanted = 36_110.0 + (2_000.0 + 5_503.0) * 1e-6;
    assert!(
        (middle_phone - wanted).abs() < 12e-9,
        "{middle_phone} {wanted}"
    );

    // The period in board ticks: the phone's seconds are shorter than the board's.
    let ticks = alignment.plan.period.as_ticks_f64();
    let expected = 33_330_652.542e-9 / (1.0 + 2e-5) * 48e6;
    assert!((ticks - expected).abs() < 1e-8);
    assert_eq!(alignment.plan.frames.source, FramePeriodSource::VideoStart);
    // 1 ppm of skew, 3.6 ppm of frame period.
    assert!((alignment.drift_sigma_us_per_min - 224.0).abs() < 1.0);
    assert!((alignment.phase_sigma_us - (9.0_f64 + 100.0 + 25.0).sqrt()).abs() < 0.05);
    assert!(planned.remarks[0].contains("no frame period learnt"));
}

#[test]
fn the_phase_becomes_less_certain_with_the_distance_from_the_twist() {
    let profile = profile();
    let alignment = plan(&profile, &course(), &video()).unwrap().alignment;
    let anchor = alignment.plan.anchor.as_secs_f64();
    let at_anchor = alignment.plan.phase_sigma_us_at(BoardSeconds(anchor));
    // A tick of the anchor is rounded.
    assert!((at_anchor - alignment.phase_sigma_us).abs() < 1e-6);
    // 50 s later it is a minute from the twist, in which 1 ppm of skew makes 60 µs; that
    // is more than what the anchor's uncertainty and 50 s of 1 ppm add up to.
    let since = 160.0 - anchor;
    let period_us = since * (2.0_f64.sqrt() * 5_000.0 / 59.0) / 33_330_652.542 * 1e6;
    let expected = (9.0 + 60.0_f64.powi(2) + 25.0 + period_us.powi(2)).sqrt();
    let found = alignment.plan.phase_sigma_us_at(BoardSeconds(160.0));
    // The clocks' wander adds a little.
    assert!(
        (0.0..0.1).contains(&(found - expected)),
        "{found} {expected}"
    );
}

#[test]
fn a_rig_that_may_warm_up_is_less_certain_and_its_temperature_counts() {
    let profile = profile();
    let steady = plan(&profile, &course(), &video()).unwrap().alignment;
    let warming = plan(&profile, &Twists::new(clock()).course(), &video()).unwrap();
    let mut warming = warming.alignment;
    assert!(warming.drift_sigma_us_per_min > 1.02 * steady.drift_sigma_us_per_min);
    // Where the train arrives, seconds after the twist, it is nothing.
    assert!((warming.phase_sigma_us / steady.phase_sigma_us - 1.0).abs() < 0.01);
    let late = BoardSeconds(400.0);
    let of = |alignment: &Alignment| alignment.plan.phase_sigma_us_at(late);
    assert!(of(&warming) > 1.02 * of(&steady));
    // 0.3 ppm a degree, on the average of 300 s.
    warming.plan.board_temperature_c = Some(25.0);
    let at = |celsius| warming.plan.phase_sigma_us_now(late, celsius);
    assert_eq!((at(None), at(Some(25.0))), (of(&warming), of(&warming)));
    let expected = of(&warming).hypot(0.3 * 4.0 * 300.0 / 2.0);
    assert!((at(Some(29.0)) - expected).abs() < 1e-6);
}

#[test]
fn frames_that_were_lost_or_doubled_among_the_first_do_not_change_the_period() {
    let mut profile = profile();
    let true_ns = video().frame_duration_ns;
    for known in [None, Some(learnt())] {
        profile.phone.learnt = known;
        for (odd, word) in [(1.0, "lost"), (5.0, "lost"), (-5.0, "doubled")] {
            let video = Video {
                frame_duration_ns: true_ns * (59.0 + odd) / 59.0,
                ..video()
            };
            let planned = plan(&profile, &course(), &video).unwrap();
            let found = planned.alignment.plan.frames.period_ns;
            assert!((found - true_ns).abs() < 3.0, "{odd}: {found}");
            let said = planned.remarks.iter().any(|text| text.contains(word));
            assert!(said, "{:?}", planned.remarks);
        }
    }
    // A phone that is half a percent off has lost none.
    profile.phone.learnt = None;
    let video = Video {
        frame_duration_ns: 33_500_000.0,
        ..video()
    };
    let planned = plan(&profile, &course(), &video).unwrap();
    assert_eq!(planned.alignment.plan.frames.period_ns, 33_500_000.0);
}

#[test]
fn a_learnt_skew_ages_and_moves_with_the_temperature() {
    let time: Timestamp = "2026-01-31T12:00:00Z".parse().unwrap();
    let mut phone = profile().phone;
    let known = Learnt {
        time: Some(time),
        board_temperature_c: Some(25.0),
        ..learnt()
    };
    let since = std::cell::Cell::new(0.0);
    let mut sigma = |known: &Learnt, seconds: i64, celsius| {
        phone.learnt = Some(known.clone());
        let now = time + jiff::SignedDuration::from_secs(seconds);
        let prior = skew_prior(&phone, "AB", now, celsius).unwrap();
        assert_eq!(prior.rate.skew, 2.05e-5);
        since.set(prior.warmed);
        prior.rate.sigma
    };
    assert_eq!(sigma(&known, 0, None), 2e-8);
    // 0.05 ppm a minute, in the root of the time.
    let ten = sigma(&known, 600, Some(25.0));
    assert!((ten - 2e-8_f64.hypot(5e-8 * 10_f64.sqrt())).abs() < 1e-12);
    let warmer = sigma(&known, 600, Some(21.0));
    assert!((warmer - ten.hypot(1.2e-6)).abs() < 1e-12);
    let season = sigma(&known, 90 * 86_400, None);
    assert!((season - 2e-8_f64.hypot(2e-6)).abs() < 1e-12);
    // A date whose hour is not known.
    let dated = Learnt {
        time: None,
        ..known.clone()
    };
    let day = sigma(&dated, 0, None);
    assert!((1.8e-6..=2.01e-6).contains(&day), "{day}");
    // A day after, a rig may have warmed up altogether: more than in ten minutes.
    let warmed = || since.get();
    assert!((1.0..1.3).contains(&warmed()), "{}", warmed());
    sigma(&known, 600, None);
    assert!((warmed() - 1.0).abs() < 1e-12);
    sigma(&known, 60, None);
    assert!((0.15..0.25).contains(&warmed()), "{}", warmed());
    // With the board's temperatures it is the phone's share of the two.
    sigma(&known, 600, Some(25.0));
    assert!((warmed() - 0.5_f64.sqrt()).abs() < 1e-12);
}

#[test]
fn a_learnt_period_is_used_unless_it_does_not_fit() {
    let mut profile = profile();
    profile.phone.learnt = Some(learnt());
    let alignment = plan(&profile, &course(), &video()).unwrap().alignment;
    assert_eq!(alignment.plan.frames.source, FramePeriodSource::Learnt);
    // What the phone reports, known to 48 ns, counts for nothing beside it.
    assert!((alignment.plan.frames.period_ns - 33_330_650.0).abs() < 1e-5);
    assert!((alignment.plan.frames.sigma_ns.unwrap() - 0.02).abs() < 1e-6);

    let mut other = video();
    other.frame_duration_ns = 33_333_333.0;
    let planned = plan(&profile, &course(), &other).unwrap();
    assert_eq!(
        planned.alignment.plan.frames.source,
        FramePeriodSource::VideoStart
    );
    assert!(planned.remarks[0].contains("does not fit"));
}

#[test]
fn a_phone_with_jittering_stamps_keeps_its_learnt_period_and_has_an_uncertain_phase() {
    let mut profile = profile();
    let mut known = learnt();
    profile.phone.learnt = Some(known.clone());
    let steady = plan(&profile, &course(), &video()).unwrap().alignment;
    let far = Video {
        frame_duration_ns: known.frame_period_ns + 900.0,
        ..video()
    };
    let source = |profile: &Profile| {
        let alignment = plan(profile, &course(), &far).unwrap().alignment;
        alignment.plan.frames.source
    };
    // 900 ns are 7 sigmas of 5 µs, and 2 of 20 µs.
    assert_eq!(source(&profile), FramePeriodSource::VideoStart);
    known.frame_jitter_ns = Some(20_000.0);
    profile.phone.learnt = Some(known);
    assert_eq!(source(&profile), FramePeriodSource::Learnt);
    let shaken = plan(&profile, &course(), &video()).unwrap().alignment;
    let expected = (steady.phase_sigma_us.powi(2) - 25.0 + 400.0).sqrt();
    assert!((shaken.phase_sigma_us - expected).abs() < 1e-6);
    let again = shaken
        .plan
        .phase_sigma_us_at(BoardSeconds(shaken.plan.anchor.as_secs_f64()));
    assert!((again - expected).abs() < 1e-6);
    // What `video_start` reports is known as badly.
    let mut file = shaken;
    file.plan.frames.sigma_ns = None;
    let at = BoardSeconds(shaken.plan.anchor.as_secs_f64() + 60.0);
    let more = file.plan.phase_sigma_us_at(at).powi(2) - shaken.plan.phase_sigma_us_at(at).powi(2);
    let drift = 60e6 * std::f64::consts::SQRT_2 * 20_000.0 / 59.0 / 33_330_650.0;
    assert!((more.sqrt() / drift - 1.0).abs() < 1e-3, "{more} {drift}");
}

#[test]
fn a_period_learnt_with_another_exposure_is_weighed_with_the_reported_one() {
    let mut profile = profile();
    let reported = learnt().frame_period_ns + 300.0;
    let of = |profile: &mut Profile, exposure_us| {
        profile.phone.learnt = Some(Learnt {
            exposure_us: Some(exposure_us),
            frame_jitter_ns: Some(10_000.0),
            ..learnt()
        });
        let video = Video {
            frame_duration_ns: reported,
            ..video()
        };
        let planned = plan(profile, &course(), &video).unwrap();
        let more = planned.alignment.plan.frames.period_ns - learnt().frame_period_ns;
        let sigma = planned.alignment.plan.frames.sigma_ns.unwrap();
        let said = planned
            .remarks
            .iter()
            .any(|text| text.contains("lock the exposure"));
        (more, sigma, said)
    };
    // The video's exposure is 4 ms.
    let (more, sigma, said) = of(&mut profile, 4_000.0);
    assert!(more.abs() < 1e-3 && (sigma - 0.02).abs() < 1e-6 && !said);
    // 2 ms apart: 200 ns against the 240 ns of 10 µs of jitter.
    let (more, sigma, said) = of(&mut profile, 2_000.0);
    let (by_exposure, by_report) = (200.0_f64.powi(2), 2.0 * (10_000.0_f64 / 59.0).powi(2));
    let sum = by_exposure + by_report;
    assert!((more - 300.0 * by_exposure / sum).abs() < 0.01, "{more}");
    assert!(
        (sigma - (by_exposure * by_report / sum).sqrt()).abs() < 0.01,
        "{sigma}"
    );
    assert!(said);
}

#[test]
fn another_phone_is_placed_against_the_grid() {
    let mut profile = profile();
    profile.frame_sync.bias_us = 40.0;
    let alignment = plan(&profile, &course(), &video()).unwrap().alignment;
    // Another clock, frames 2.5 ms later than the reference's and 100 ns longer.
    let other = ClockRelation {
        offset: 71_000.5,
        skew: -3e-5,
        ..clock()
    };
    let board = clock().to_board(video().phase.seconds()).0 + 2.5e-3 + 7.0 * 33.33e-3;
    let board = BoardSeconds(board - 7.0 * (33.33e-3 - 33_330_652.542e-9 / (1.0 + 2e-5)));
    let moved = Video {
        phase: PhoneNanos((other.to_phone(board).0 * 1e9).round() as i64),
        frame_duration_ns: (33_330_652.542 / (1.0 + 2e-5) + 100.0) * (1.0 - 3e-5),
        ..video()
    };
    for fps in [30, 5] {
        profile.depth.fps = fps;
        let mut alignment = alignment;
        alignment.plan.period.0 *= u64::from(profile.frame_ratio());
        let placed = placement(
            &profile,
            &profile.phone,
            &Twists::new(other).course(),
            &moved,
            &alignment,
        );
        // To the middle it is 7,503 µs of each phone's own clock. A tick of the
        // anchor and a few ns of seconds in floats may be off.
        let offset = 2_500.0 + 7_503.0 * 5e-5;
        assert!((placed.offset_us - offset).abs() < 0.05, "{placed:?}");
        let drift = 100.0 / 33_329_986.0 * 60e6;
        assert!((placed.drift_us_per_min - drift).abs() < 0.1, "{placed:?}");
        assert!(placed.offset_sigma_us > 3.0 && placed.offset_sigma_us < 20.0);
        assert!(placed.drift_sigma_us_per_min > 60.0);
    }
}

#[test]
fn uncertain_constants_are_part_of_the_phase_until_the_bias_is_measured() {
    let known = profile();
    let of = |profile: &Profile| plan(profile, &course(), &video()).unwrap().alignment;
    let exact = of(&known);
    let at = BoardSeconds(160.0);
    // The constant, and that of another phone of the same kind.
    let with = |(constant_us, other_us): (f64, f64), profile: &Profile| {
        let stated = &of(profile);
        let expected = exact.phase_sigma_us.hypot(constant_us);
        assert!(
            (stated.phase_sigma_us - expected).abs() < 1e-9,
            "{stated:?}"
        );
        // Another twist makes the rest smaller, so the rest says when one is due.
        assert_eq!(
            stated.plan.phase_sigma_us_at(at),
            exact.plan.phase_sigma_us_at(at)
        );
        let later = exact.plan.phase_sigma_us_at(at).hypot(constant_us);
        assert!((stated.stated_sigma_us_at(at) - later).abs() < 1e-9);
        let placed = |profile: &Profile| {
            placement(profile, &profile.phone, &course(), &video(), stated).offset_sigma_us
        };
        let expected = placed(&known).hypot(other_us);
        assert!((placed(profile) - expected).abs() < 1e-5);
    };
    with((0.0, 0.0), &known);
    let mut changed = known.clone();
    changed.depth.center_offset_sigma_us = 1_000.0;
    changed.phone.gyro_delay_sigma_us = 750.0;
    with((1_250.0, 1_250.0), &changed);
    let stated = of(&changed).promise();
    assert!(
        stated.ends_with(
            "± 1.3 ms (1-sigma), most of it from the assumed centre of the depth exposure"
        ),
        "{stated}"
    );
    // Half of the readout goes by before the middle row.
    changed.phone.gyro_delay_sigma_us = 450.0;
    changed.phone.readout_sigma_us = 1_200.0;
    with((1_250.0, 1_250.0), &changed);
    changed.frame_sync.bias_sigma_us = 0.4;
    with((1_250.0, 1_250.0), &changed);
    // Measured with the first phone, whose delay is in it.
    changed.frame_sync.bias_measured = Some(date(2026, 1, 31));
    with((0.4, 1_060.660_247), &changed);
    assert!(
        of(&changed)
            .promise()
            .ends_with("± 11.6 µs (1-sigma), most of it from clocks and frame period")
    );
    // 4 ms of exposure that may change by a third, of which the middle moves by half.
    changed.phone.exposure_locked = false;
    let moves_us = 4_000.0_f64 / 6.0;
    with(
        (moves_us.hypot(0.4), moves_us.hypot(1_060.660_247)),
        &changed,
    );
    let stated = of(&changed).promise();
    assert!(
        stated.ends_with("that is not known to be locked"),
        "{stated}"
    );
    let planned = plan(&changed, &course(), &video()).unwrap();
    let is_said = |remark: &String| remark.contains("set exposure_locked = true");
    assert!(planned.remarks.iter().any(is_said));
}

#[test]
fn a_slower_depth_camera_is_triggered_on_every_second_or_sixth_frame() {
    let mut profile = profile();
    let fast = plan(&profile, &course(), &video()).unwrap().alignment;
    profile.depth.fps = 5;
    let slow = plan(&profile, &course(), &video()).unwrap().alignment;
    assert_eq!(slow.plan.anchor, fast.plan.anchor);
    assert!(slow.plan.period.0.abs_diff(6 * fast.plan.period.0) <= 4);
}

#[test]
fn without_a_reported_exposure_the_profile_is_used_with_a_remark() {
    let profile = profile();
    for exposure_ns in [None, Some(0)] {
        let video = Video {
            exposure_ns,
            ..video()
        };
        let planned = plan(&profile, &course(), &video).unwrap();
        assert_eq!(planned.alignment.exposure_us, 10_000.0);
        assert!(planned.remarks.iter().any(|text| text.contains("exposure")));
    }
}

#[test]
fn nonsense_from_the_phone_is_refused() {
    let profile = profile();
    // A period of 1 ms would be within what the board can do.
    for frame_duration_ns in [0.0, -1.0, f64::NAN, 2e9, 1e6, 2.9e7, 4e7] {
        let video = Video {
            frame_duration_ns,
            ..video()
        };
        assert!(matches!(
            plan(&profile, &course(), &video),
            Err(AlignmentError::FramePeriod { .. })
        ));
    }
    let early = Video {
        phase: PhoneNanos(0),
        ..video()
    };
    assert!(matches!(
        plan(&profile, &course(), &early),
        Err(AlignmentError::OutOfRange { .. })
    ));
}

#[test]
fn a_skew_against_another_board_is_ignored() {
    let mut profile = profile();
    profile.phone.learnt = Some(learnt());
    let prior = |board| skew_prior(&profile.phone, board, Timestamp::now(), None);
    assert!(prior("AB").is_some());
    assert!(prior("CD").is_none());
}
