use protocol::{Answer, Filler, HostToDevice};
use test_support::board::frame;

use super::*;
use crate::conversation::tests::hello;

/// A board that answers with all that lay in its buffers around the answer, in one
/// piece.
struct Scripted {
    before: Vec<u32>,
    after: Vec<u32>,
    from_host: protocol::Decoder<HostToDevice>,
    to_host: Vec<u8>,
}

impl Scripted {
    fn say(&mut self, message: &DeviceToHost) {
        self.to_host.extend(frame(message));
    }

    fn filler(&mut self, numbers: &[u32]) {
        for &seq in numbers {
            self.say(&DeviceToHost::Filler(Filler {
                seq,
                payload: Default::default(),
            }));
        }
    }
}

impl Link for Scripted {
    fn now(&self) -> Duration {
        Duration::ZERO
    }

    fn send(&mut self, mut bytes: &[u8]) -> std::result::Result<(), LinkError> {
        while let Some(command) = self.from_host.next(&mut bytes) {
            let Ok(command) = command else { continue };
            let (before, after) = (self.before.clone(), self.after.clone());
            self.filler(&before);
            self.say(&hello(1, protocol::PROTOCOL_VERSION));
            self.say(&DeviceToHost::Answer(Answer {
                id: command.id,
                result: Ok(Reply::SayHello(())),
            }));
            self.filler(&after);
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, _: Duration) -> std::result::Result<(), LinkError> {
        into.append(&mut self.to_host);
        Ok(())
    }

    fn pause(&mut self, _: Duration) {}
}

/// The gap between what a former program left behind and what the board sends now
/// is nobody's loss, however the bytes are cut.
#[test]
fn what_lay_in_the_buffers_before_the_connection_is_no_loss() {
    let link = Scripted {
        before: vec![4, 5, 6],
        after: vec![60, 61, 63],
        from_host: protocol::Decoder::new(),
        to_host: Vec::new(),
    };
    let mut board = Board::connect_from(Box::new(link), 1).unwrap();
    while let Some(event) = board.next_event(Duration::ZERO).unwrap() {
        assert!(!matches!(event, Event::Lost { .. }), "{event:?}");
    }
    assert_eq!(board.conversation().counts().lost(), 0);
    // From then on gaps are losses.
    board.call(SayHello).unwrap();
    let lost = std::iter::from_fn(|| board.next_event(Duration::ZERO).unwrap())
        .filter(|event| matches!(event, Event::Lost { .. }))
        .count();
    assert_eq!(lost, 2, "from 6 to 60, and from 61 to 63");
}
