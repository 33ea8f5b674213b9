//! Any bytes, in any split, to both decoders: none panics or stalls, and both
//! take the next good frame.

#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::{Decoder, DeviceToHost, HostToDevice, MAX_FRAME, SayHello, encode};

fuzz_target!(|input: (usize, &[u8])| {
    let (split, bytes) = input;
    let mut board = Decoder::<HostToDevice>::new();
    let mut host = Decoder::<DeviceToHost>::new();
    for chunk in bytes.chunks(split.clamp(1, 4096)) {
        let mut rest = chunk;
        while board.next(&mut rest).is_some() {}
        assert!(rest.is_empty());
        let mut rest = chunk;
        while host.next(&mut rest).is_some() {}
        assert!(rest.is_empty());
    }
    let mut delimiter: &[u8] = &[0];
    let _ = board.next(&mut delimiter);
    let sent = HostToDevice {
        id: 1,
        command: SayHello.into(),
    };
    let mut buffer = [0; MAX_FRAME];
    let Ok(mut frame) = encode(&sent, &mut buffer) else {
        panic!("a command fits into a frame");
    };
    assert_eq!(board.next(&mut frame), Some(Ok(sent)));
});
