//! Properties of the decoder: any split, any damage, any bytes.

use proptest::collection::vec;
use proptest::prelude::*;
use protocol::*;

/// Messages of all lengths, tellable apart.
fn messages() -> impl Strategy<Value = Vec<DeviceToHost>> {
    let filler = (any::<u32>(), vec(any::<u8>(), 0..=MAX_FILLER)).prop_map(|(seq, payload)| {
        DeviceToHost::Filler(Filler {
            seq,
            payload: payload.into_iter().collect(),
        })
    });
    let imu = (any::<u32>(), any::<u64>(), any::<[i16; 3]>()).prop_map(|(seq, at, gyro)| {
        DeviceToHost::Imu(ImuSample {
            seq,
            at: Ticks(at),
            gyro,
            ..ImuSample::default()
        })
    });
    vec(prop_oneof![filler, imu], 1..12)
}

fn frames(messages: &[DeviceToHost]) -> Vec<Vec<u8>> {
    let mut buffer = [0; MAX_FRAME];
    messages
        .iter()
        .map(|message| encode(message, &mut buffer).unwrap().to_vec())
        .collect()
}

type Taken = Result<DeviceToHost, FrameError>;

/// Feeds `bytes`, cut after each of `cuts` (modulo what is left).
fn feed(decoder: &mut Decoder<DeviceToHost>, mut bytes: &[u8], cuts: &[usize]) -> Vec<Taken> {
    let mut taken = Vec::new();
    let mut cuts = cuts.iter().cycle();
    while !bytes.is_empty() {
        let cut = cuts.next().map_or(bytes.len(), |cut| 1 + cut % bytes.len());
        let (mut head, tail) = bytes.split_at(cut);
        while let Some(result) = decoder.next(&mut head) {
            taken.push(result);
        }
        assert!(head.is_empty());
        bytes = tail;
    }
    taken
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn any_split_gives_the_same_messages(sent in messages(), cuts in vec(0_usize..600, 1..40)) {
        let bytes = frames(&sent).concat();
        let mut decoder = Decoder::new();
        let taken: Vec<_> = feed(&mut decoder, &bytes, &cuts).into_iter().map(Result::unwrap).collect();
        prop_assert_eq!(&taken, &sent);
        let counters = decoder.counters();
        prop_assert_eq!(counters.frames as usize, sent.len());
        prop_assert_eq!(counters.lost_frames, 0);
        prop_assert_eq!(counters.lost_bytes, 0);
    }

    /// Whatever happens to the bytes of some frames, all others arrive, in
    /// order, and what is lost is counted.
    #[test]
    fn damage_costs_only_what_it_touches(
        sent in messages(),
        hit in any::<prop::sample::Index>(),
        damage in vec((any::<prop::sample::Index>(), 1_u8..), 1..5),
        cuts in vec(0_usize..600, 1..40),
    ) {
        let mut frames = frames(&sent);
        let hit = hit.index(sent.len());
        // The delimiter stays, and no byte becomes one: exactly one frame.
        let inside = frames[hit].len() - 1;
        let original = frames[hit].clone();
        for (place, flip) in damage {
            let byte = &mut frames[hit][place.index(inside)];
            if *byte != flip {
                *byte ^= flip;
            }
        }
        prop_assume!(frames[hit] != original);
        let mut decoder = Decoder::new();
        let taken = feed(&mut decoder, &frames.concat(), &cuts);
        prop_assert_eq!(taken.len(), sent.len());
        for (index, (taken, sent)) in taken.iter().zip(&sent).enumerate() {
            if index == hit {
                prop_assert!(taken.is_err());
            } else {
                prop_assert_eq!(taken, &Ok(sent.clone()));
            }
        }
        prop_assert_eq!(decoder.counters().lost_frames, 1);
        prop_assert_eq!(decoder.counters().lost_bytes as usize, inside);
    }

    /// Garbage of any length, delimiters and all, never stops it: the first
    /// frame after the next delimiter is taken.
    #[test]
    fn after_any_garbage_it_is_in_step_at_the_next_delimiter(
        garbage in vec(any::<u8>(), 0..3000),
        sent in messages(),
        cuts in vec(0_usize..600, 1..40),
    ) {
        let mut decoder = Decoder::new();
        let mut bytes = garbage;
        bytes.push(0);
        let noise = feed(&mut decoder, &bytes, &cuts);
        prop_assert!(noise.iter().all(Result::is_err));
        let lost = decoder.counters();
        let taken: Vec<_> = feed(&mut decoder, &frames(&sent).concat(), &cuts)
            .into_iter().map(Result::unwrap).collect();
        prop_assert_eq!(taken, sent);
        prop_assert_eq!(decoder.counters().lost_frames, lost.lost_frames);
        // Every byte but the delimiters is accounted for.
        let zeros = bytes.iter().filter(|&&byte| byte == 0).count();
        prop_assert_eq!(lost.lost_bytes as usize, bytes.len() - zeros);
    }

    #[test]
    fn a_frame_that_never_ends_is_counted_once(
        length in MAX_FRAME..10_000,
        byte in 1_u8..,
        cuts in vec(0_usize..600, 1..40),
    ) {
        let mut decoder = Decoder::new();
        let mut bytes = vec![byte; length];
        bytes.push(0);
        let taken = feed(&mut decoder, &bytes, &cuts);
        prop_assert_eq!(taken.len(), 1);
        prop_assert_eq!(decoder.counters().lost_frames, 1);
        prop_assert_eq!(decoder.counters().lost_bytes as usize, length);
    }

    #[test]
    fn a_buffer_too_short_is_an_error(sent in messages(), len in 0_usize..MAX_FRAME) {
        let mut buffer = [0; MAX_FRAME];
        for message in &sent {
            let needed = encode(message, &mut buffer).unwrap().len();
            let mut short = vec![0; len];
            let fits = encode(message, &mut short).is_ok();
            // It may want a byte more than the frame has: room to code in place.
            prop_assert!(fits || len <= needed);
            prop_assert!(!fits || len >= needed);
        }
    }
}

/// Runs of every length around the ones at which COBS puts in another code byte.
#[test]
fn runs_of_any_length_come_through() {
    let mut buffer = [0; MAX_FRAME];
    for byte in [0, 1, 0xFF] {
        for len in 0..=MAX_FILLER {
            let sent = DeviceToHost::Filler(Filler {
                seq: u32::MAX,
                payload: (0..len).map(|_| byte).collect(),
            });
            let mut frame = encode(&sent, &mut buffer).unwrap();
            assert_eq!(frame.iter().filter(|&&byte| byte == 0).count(), 1);
            let mut decoder = Decoder::<DeviceToHost>::new();
            assert_eq!(decoder.next(&mut frame), Some(Ok(sent)));
        }
    }
}

#[test]
fn empty_frames_are_ignored() {
    let mut decoder = Decoder::<HostToDevice>::new();
    let mut zeros: &[u8] = &[0; 100];
    assert_eq!(decoder.next(&mut zeros), None);
    assert_eq!(decoder.counters(), LinkCounters::default());
}

#[test]
fn a_good_checksum_around_no_message_is_another_protocol() {
    // A variant that this version does not have.
    let mut buffer = [0; MAX_FRAME];
    let mut frame = encode(&200_u8, &mut buffer).unwrap();
    let mut decoder = Decoder::<DeviceToHost>::new();
    assert_eq!(decoder.next(&mut frame), Some(Err(FrameError)));
    // A message with something after it.
    let ping = HostToDevice {
        id: 1,
        command: SayHello.into(),
    };
    let mut frame = encode(&(ping, 7_u8), &mut buffer).unwrap();
    let mut decoder = Decoder::<HostToDevice>::new();
    assert_eq!(decoder.next(&mut frame), Some(Err(FrameError)));
    assert_eq!(decoder.counters().lost_frames, 1);
}

#[test]
fn a_reset_forgets_half_a_frame() {
    let command = HostToDevice {
        id: 9,
        command: QueryTrigger(Output::Camera).into(),
    };
    let mut buffer = [0; MAX_FRAME];
    let frame = encode(&command, &mut buffer).unwrap();
    let mut decoder = Decoder::new();
    let mut half = &frame[..frame.len() / 2];
    assert_eq!(decoder.next(&mut half), None);
    decoder.reset();
    let mut whole = frame;
    assert_eq!(decoder.next(&mut whole), Some(Ok(command)));
}
