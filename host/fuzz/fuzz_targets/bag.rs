//! Any bytes as a ROS 1 bag: no panic.
#![no_main]

use libfuzzer_sys::fuzz_target;
use smartdepthsync::extract::bag::messages::{Image, Imu, Temperature, TimeReference};
use smartdepthsync::extract::bag::reader::{Bag, BagError};

fuzz_target!(|data: &[u8]| {
    // With and without the first line, which a fuzzer would have to guess.
    let with_magic = [b"#ROSBAG V2.0\n", data].concat();
    for bytes in [data, &with_magic] {
        let Ok(mut bag) = Bag::open(bytes) else {
            continue;
        };
        while let Ok(true) = bag.next_chunk(|message| {
            let _ = Imu::parse(message.data);
            let _ = Temperature::parse(message.data);
            let _ = TimeReference::parse(message.data);
            let _ = Image::parse(message.data);
            Ok::<(), BagError>(())
        }) {}
    }
});
