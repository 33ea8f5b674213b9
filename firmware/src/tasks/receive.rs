//! Reads commands. While the answers of one more might find no place, no
//! command is taken: the host waits, and no answer is ever lost.

use embassy_time::with_timeout;
use embassy_usb::class::cdc_acm::Receiver;
use embassy_usb::driver::EndpointError;
use firmware::alive::Task;
use firmware::config::USB_PACKET;
use firmware::outbox::Outbox;
use protocol::{Decoder, HostToDevice};

use crate::hardware::otg::OtgDriver;
use crate::hardware::tim2;
use crate::state::{ALIVE, CHECK_IN, RECEIVED, ROOM, wait_for, with_outbox};
use crate::tasks::commands;

#[embassy_executor::task]
pub(crate) async fn run(mut receiver: Receiver<'static, OtgDriver>) {
    let mut decoder = Decoder::<HostToDevice>::new();
    let mut packet = [0; USB_PACKET];
    loop {
        ALIVE.check_in(Task::Receive);
        match with_timeout(CHECK_IN, receiver.read_packet(&mut packet)).await {
            Err(_) => {}
            Ok(Ok(len)) => {
                let packet = packet.get(..len).unwrap_or_default();
                take(&mut decoder, packet).await;
            }
            Ok(Err(EndpointError::BufferOverflow)) => {
                defmt::warn!("packet longer than the endpoint's")
            }
            Ok(Err(EndpointError::Disabled)) => {
                decoder.reset();
                let _ = with_timeout(CHECK_IN, receiver.wait_connection()).await;
            }
        }
    }
}

async fn take(decoder: &mut Decoder<HostToDevice>, mut packet: &[u8]) {
    let received = tim2::now();
    while let Some(frame) = decoder.next(&mut packet) {
        RECEIVED.lock(|counters| counters.set(decoder.counters()));
        if let Ok(message) = frame {
            while !with_outbox(|outbox| outbox.has_room_for_command()) {
                ALIVE.check_in(Task::Receive);
                wait_for(&ROOM, Outbox::has_room_for_command).await;
            }
            commands::carry_out(message, received);
        }
    }
    RECEIVED.lock(|counters| counters.set(decoder.counters()));
}
