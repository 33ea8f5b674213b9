//! Writes messages: gathers frames into a buffer and writes that in packets.
//!
//! One task alone waits for the host; everyone else only leaves messages in the
//! outbox. Frames are encoded while the last packet is on the wire.

use core::future::{Future as _, poll_fn};
use core::pin::pin;
use core::sync::atomic::Ordering;
use core::task::Poll;

use embassy_time::{Timer, with_timeout};
use embassy_usb::class::cdc_acm::Sender;
use firmware::alive::Task;
use firmware::config::{MOST_FRAMES, TRANSMIT_BUFFER, USB_PACKET};
use firmware::outbox::{Counter, counter_of};
use heapless::Vec;
use protocol::{DeviceToHost, Filler, MAX_FILLER, MAX_FRAME, encode};

use crate::hardware::otg::{self, OtgDriver};
use crate::state::{
    ALIVE, CHECK_IN, CONNECTS, FILLER, LINK_CHANGED, ROOM, TO_SEND, wait_for, with_outbox,
};
use crate::tasks::usb;

#[embassy_executor::task]
pub(crate) async fn run(mut sender: Sender<'static, OtgDriver>) {
    let mut transmit = Transmit {
        buffer: [0; TRANSMIT_BUFFER],
        len: 0,
        ends: Vec::new(),
        in_core: Vec::new(),
        filler_seq: 0,
        connect: 0,
    };
    loop {
        ALIVE.check_in(Task::Transmit);
        transmit.fill();
        if transmit.len == 0 {
            wait_for(&TO_SEND, |outbox| !outbox.is_empty()).await;
            continue;
        }
        transmit.write(&mut sender).await;
    }
}

struct Transmit {
    /// Frames; the first `len` bytes.
    buffer: [u8; TRANSMIT_BUFFER],
    len: usize,
    /// Where the frames of numbered messages end, and where each counts if it is lost.
    ends: Vec<(usize, Counter), MOST_FRAMES>,
    /// The same of the messages that end in the packet that the core was given last: a frame takes
    /// 14 bytes at least.
    in_core: Vec<Counter, { USB_PACKET / 14 + 1 }>,
    filler_seq: u32,
    /// The connection that the buffer belongs to.
    connect: u32,
}

impl Transmit {
    /// Takes what waits, as far as the buffer holds it.
    fn fill(&mut self) {
        self.len = 0;
        self.ends.clear();
        if !with_outbox(|outbox| outbox.is_linked()) {
            return;
        }
        let connect = CONNECTS.load(Ordering::Relaxed);
        if connect != self.connect {
            // Ends what a former connection left half sent.
            self.connect = connect;
            self.buffer[0] = 0;
            self.len = 1;
            if otg::TAKEN_BACK.swap(false, Ordering::Relaxed) {
                with_outbox(|outbox| {
                    self.in_core
                        .iter()
                        .for_each(|counter| outbox.lose(*counter))
                });
                self.in_core.clear();
            }
        }
        let mut taken = false;
        while self.has_room() {
            let next = with_outbox(|outbox| outbox.pop());
            // Taken out of the option, a message would be copied, with room for the largest.
            let Some(message) = &next else {
                break;
            };
            self.put(message);
            taken = true;
        }
        if taken {
            ROOM.wake();
        }
        while FILLER.load(Ordering::Relaxed) && self.has_room() {
            let first = self.filler_seq as u8;
            let message = DeviceToHost::Filler(Filler {
                seq: self.filler_seq,
                payload: (0..MAX_FILLER)
                    .map(|i| first.wrapping_add(i as u8))
                    .collect(),
            });
            self.filler_seq = self.filler_seq.wrapping_add(1);
            self.put(&message);
        }
    }

    fn has_room(&self) -> bool {
        TRANSMIT_BUFFER - self.len >= MAX_FRAME && !self.ends.is_full()
    }

    fn put(&mut self, message: &DeviceToHost) {
        let space = self.buffer.get_mut(self.len..).unwrap_or_default();
        match encode(message, space) {
            Ok(frame) => {
                self.len += frame.len();
                if let Some(counter) = counter_of(message) {
                    // There is room: looked at before the message was taken.
                    let _ = self.ends.push((self.len, counter));
                }
            }
            Err(_) => defmt::error!("a message does not fit into a frame"),
        }
    }

    /// Writes the buffer. A host that does not read is waited for, one that
    /// goes away is not.
    async fn write(&mut self, sender: &mut Sender<'static, OtgDriver>) {
        let frames = self.buffer.get(..self.len).unwrap_or_default();
        let mut begun = 0;
        let mut written = 0;
        for packet in frames.chunks(USB_PACKET) {
            if !self.write_packet(sender, packet).await {
                break;
            }
            begun = written;
            written += packet.len();
        }
        if written > 0 {
            self.in_core.clear();
        }
        for (end, counter) in self.ends.iter().rev().take_while(|(end, _)| *end > begun) {
            if *end > written {
                with_outbox(|outbox| outbox.lose(*counter));
            } else {
                let _ = self.in_core.push(*counter);
            }
        }
        // A transfer ends with a short packet, without which the host's
        // driver waits for more.
        let ends_full = written == self.len && written.is_multiple_of(USB_PACKET);
        if ends_full
            && with_outbox(|outbox| outbox.is_empty())
            && self.write_packet(sender, &[]).await
        {
            self.in_core.clear();
        }
    }

    /// False if the host is gone.
    async fn write_packet(&self, sender: &mut Sender<'static, OtgDriver>, packet: &[u8]) -> bool {
        loop {
            ALIVE.check_in(Task::Transmit);
            let mut write = pin!(sender.write_packet(packet));
            let write = poll_fn(|context| {
                LINK_CHANGED.register(context.waker());
                // A packet for one host is not to reach the next.
                if self.is_same_host() {
                    write.as_mut().poll(context).map(Some)
                } else {
                    Poll::Ready(None)
                }
            });
            match with_timeout(CHECK_IN, write).await {
                Ok(Some(Ok(()))) => {
                    usb::packet_sent();
                    return true;
                }
                Ok(None) => return false,
                Ok(Some(Err(_))) => {
                    // The bus was reset or lost; the link follows.
                    Timer::after_millis(1).await;
                    return false;
                }
                // The host does not read. Nothing of the packet is written yet.
                Err(_) => {}
            }
        }
    }

    fn is_same_host(&self) -> bool {
        with_outbox(|outbox| outbox.is_linked()) && CONNECTS.load(Ordering::Relaxed) == self.connect
    }
}
