use protocol::{
    Filler, Hello, ImuFlags, ImuSample, Output, Refusal, Reply, SELF_TEST_KEY, SayHello, SelfTest,
    StopTrigger,
};
use test_support::board::frame;

use super::*;

fn sample(seq: u32) -> DeviceToHost {
    DeviceToHost::Imu(ImuSample {
        seq,
        at: Ticks(1_000 + u64::from(seq) * 96_000),
        flags: ImuFlags(0),
        accel: [1, -2, 8192],
        temperature: -521,
        gyro: [3, 0, i16::MIN],
    })
}

pub(crate) fn hello(epoch: u32, protocol_version: u16) -> DeviceToHost {
    DeviceToHost::Hello(Hello {
        protocol_version,
        epoch,
        now: NOW,
        ..test_support::board::hello()
    })
}

/// Board time of [`hello`].
const NOW: Ticks = Ticks(5_000_000);

fn events(conversation: &mut Conversation) -> Vec<Event> {
    std::iter::from_fn(|| conversation.next_event()).collect()
}

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn an_answer_finds_its_command_and_a_late_one_finds_none() {
    let mut conversation = Conversation::new(40);
    let first = conversation.send(Duration::ZERO, SayHello, SECOND);
    let second = conversation.send(Duration::ZERO, StopTrigger(Output::Camera), SECOND * 3);
    assert_eq!((first, second), (40, 41));

    conversation.tick(SECOND);
    assert_eq!(events(&mut conversation), [Event::Expired { id: first }]);

    let late = DeviceToHost::Answer(Answer {
        id: first,
        result: Ok(Reply::SayHello(())),
    });
    let refused = Answer {
        id: second,
        result: Err(Refusal::TriggerStopped),
    };
    conversation.receive(&frame(&late));
    conversation.receive(&frame(&DeviceToHost::Answer(refused.clone())));
    assert_eq!(events(&mut conversation), [Event::Answer(refused)]);
    conversation.tick(SECOND * 100);
    assert_eq!(events(&mut conversation), []);
}

#[test]
fn outgoing_bytes_decode_to_the_commands_even_after_garbage() {
    let mut conversation = Conversation::new(0);
    let command = SelfTest {
        key: SELF_TEST_KEY,
        failure: protocol::Failure::Panic,
    };
    conversation.send(Duration::ZERO, command, SECOND);
    let mut bytes = vec![1, 2, 3];
    bytes.extend(conversation.take_outgoing());
    assert!(conversation.take_outgoing().is_empty());
    let mut decoder = Decoder::<HostToDevice>::new();
    let mut input = bytes.as_slice();
    assert!(matches!(decoder.next(&mut input), Some(Err(_))));
    assert_eq!(
        decoder.next(&mut input),
        Some(Ok(HostToDevice {
            id: 0,
            command: command.into()
        }))
    );
}

#[test]
fn gaps_are_counted_across_the_wrap_of_the_number() {
    let mut conversation = Conversation::new(0);
    for seq in [u32::MAX - 1, u32::MAX, 3, 4] {
        conversation.receive(&frame(&DeviceToHost::Filler(Filler {
            seq,
            payload: Default::default(),
        })));
    }
    let lost: Vec<_> = events(&mut conversation)
        .into_iter()
        .filter(|event| matches!(event, Event::Lost { .. }))
        .collect();
    assert_eq!(
        lost,
        [Event::Lost {
            stream: Stream::Filler,
            count: 3
        }]
    );
    let count = conversation.counts().get(Stream::Filler);
    assert_eq!((count.received, count.lost), (4, 3));
    assert_eq!(conversation.counts().lost(), 3);
}

#[test]
fn numbers_that_do_not_follow_are_counted_apart() {
    let mut conversation = Conversation::new(0);
    for seq in [7, 7, 7, 8, 8 + (1 << 31) + 1, 8 + (1 << 31) + 2] {
        conversation.receive(&frame(&sample(seq)));
    }
    let count = conversation.counts().get(Stream::Imu);
    assert_eq!((count.received, count.lost, count.disordered), (6, 0, 3));
    let found = events(&mut conversation);
    let disordered = |event: &&Event| matches!(event, Event::Disordered { .. });
    assert_eq!(found.iter().filter(disordered).count(), 3, "{found:?}");
}

#[test]
fn a_damaged_frame_is_told_and_its_message_shows_as_lost() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&sample(10)));
    let mut damaged = frame(&sample(11));
    damaged[4] ^= 0x10;
    conversation.receive(&damaged);
    conversation.receive(&frame(&sample(12)));
    let found = events(&mut conversation);
    assert_eq!(found.len(), 4, "{found:?}");
    assert!(matches!(found[1], Event::Damaged(_)));
    assert_eq!(
        found[2],
        Event::Lost {
            stream: Stream::Imu,
            count: 1
        }
    );
    assert_eq!(conversation.damaged_frames(), 1);
}

#[test]
fn half_a_frame_at_the_beginning_is_no_damage() {
    let mut conversation = Conversation::new(0);
    let whole = frame(&sample(1));
    conversation.receive(&whole[7..]);
    conversation.receive(&whole);
    assert_eq!(events(&mut conversation), [Event::Message(sample(1))]);
    assert_eq!(conversation.damaged_frames(), 0);
}

#[test]
fn a_reset_is_noticed_and_is_no_loss() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(1_000_000)));
    let last = conversation.latest();
    assert_eq!(last, Ticks(1_000 + 1_000_000 * 96_000));
    conversation.receive(&frame(&hello(2, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(0)));
    let found = events(&mut conversation);
    let Event::Restarted {
        last: reported,
        counts,
    } = &found[2]
    else {
        panic!("{:?}", found[2]);
    };
    assert_eq!((*reported, counts.imu.received), (last, 1));
    assert_eq!(conversation.counts().lost(), 0);
    assert_eq!(conversation.latest(), NOW);
}

#[test]
fn what_was_dropped_while_the_line_was_cut_shows_as_loss() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(0)));
    conversation.receive(&frame(&sample(1))[..5]);
    let id = conversation.send(Duration::ZERO, SayHello, SECOND);
    conversation.cut();
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(500)));
    assert_eq!(conversation.counts().imu.lost, 499);
    assert_eq!(conversation.damaged_frames(), 0);
    assert!(events(&mut conversation).contains(&Event::Expired { id }));
}

#[test]
fn what_comes_before_the_hello_of_a_new_run_is_of_the_new_run() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(40)));
    conversation.cut();
    conversation.receive(&frame(&sample(0)));
    conversation.receive(&frame(&sample(1)));
    assert_eq!(events(&mut conversation).len(), 2);
    conversation.receive(&frame(&hello(2, PROTOCOL_VERSION)));
    let found = events(&mut conversation);
    let last_known = NOW;
    assert!(matches!(found[0], Event::Restarted { last, .. } if last == last_known));
    assert_eq!(found[1], Event::Message(sample(0)));
    assert_eq!(found[2], Event::Message(sample(1)));
    assert_eq!(conversation.counts().lost(), 0);
}

#[test]
fn what_comes_before_the_hello_of_the_same_run_is_given_out_once() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    conversation.receive(&frame(&sample(40)));
    conversation.cut();
    conversation.receive(&frame(&sample(44)));
    conversation.cut();
    conversation.receive(&frame(&sample(46)));
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION)));
    let samples: Vec<_> = events(&mut conversation)
        .into_iter()
        .filter(|event| matches!(event, Event::Message(DeviceToHost::Imu(_))))
        .collect();
    let expected = [40, 44, 46].map(|seq| Event::Message(sample(seq)));
    assert_eq!(samples, expected);
    assert_eq!(conversation.counts().imu.lost, 4);
}

#[test]
fn another_version_is_told_whether_or_not_its_hello_is_understood() {
    let mut conversation = Conversation::new(0);
    conversation.receive(&frame(&hello(1, PROTOCOL_VERSION + 8)));
    let found = PROTOCOL_VERSION + 8;
    assert_eq!(events(&mut conversation), [Event::OtherVersion { found }]);

    // A Hello of a far version: the version, then fields nobody here knows.
    let strange = (0_u8, 700_u16, [0xFF_u8; 3], "unheard of");
    let mut buffer = [0; MAX_FRAME];
    let bytes = encode(&strange, &mut buffer).unwrap();
    conversation.receive(bytes);
    assert_eq!(
        events(&mut conversation),
        [Event::OtherVersion { found: 700 }]
    );
}

#[test]
fn frames_are_kept_as_they_came() {
    let mut conversation = Conversation::new(0);
    conversation.keep_frames(true);
    let whole = frame(&sample(1));
    conversation.receive(&whole);
    conversation.receive(&[9; MAX_FRAME + 40]);
    conversation.receive(&[0]);
    let found = events(&mut conversation);
    assert_eq!(found[0], Event::Frame(whole[..whole.len() - 1].to_vec()));
    assert_eq!(found[1], Event::Message(sample(1)));
    assert_eq!(found[2], Event::Frame(vec![9; MAX_FRAME]));
    assert_eq!(found[3], Event::Damaged(FrameError));
}
