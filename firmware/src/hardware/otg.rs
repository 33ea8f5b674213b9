//! The HAL's driver of the USB core, with what embassy-usb-synopsys-otg 0.3.3 leaves out
//! (mended upstream on 2026-08-01, embassy #6684 and #6687, and not released):
//!
//! - A bus reset or an unplugged cable leaves the endpoint of a packet on its way enabled: it
//!   never sends again. A transmit is stopped in the manual's order, each step awaited: NAK,
//!   disable, flush (RM0090 34.17.6, "IN endpoint disable"). Setting both bits in one write, as
//!   the driver does, is not enough.
//! - A suspend that was noted before a reset, and is handled after it, would have the device
//!   take itself as suspended for good.
//!
//! Data that came before a reset may still be read after it; the frames' checksums find that.

use core::future::{Future as _, poll_fn};
use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::pac;
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::Driver;
use embassy_time::Timer;
use embassy_usb::driver::{
    Bus, Direction, Driver as UsbDriver, EndpointAddress, EndpointAllocError, EndpointType, Event,
    Unsupported,
};

type Hal = Driver<'static, USB_OTG_FS>;

const OTG: pac::otg::Otg = pac::USB_OTG_FS;
/// Endpoints in each direction (RM0090 34.2.3).
const ENDPOINTS: usize = 4;
/// Reads of a register until a step counts as done. The core takes some of its own clocks of
/// 48 MHz; without traffic on the bus it may not do it at all.
const MOST_READS: u32 = 1_000;
/// Time without the pull-up that makes the host see the device leave, in ms: 2.5 µs are enough
/// (USB 2.0 7.1.7.3), but hubs may report only every 255 ms.
const DISCONNECT_MS: u64 = 300;

/// True after a packet was withdrawn that the host had not acknowledged.
pub(crate) static TAKEN_BACK: AtomicBool = AtomicBool::new(false);

/// The driver.
pub(crate) struct OtgDriver(pub(crate) Hal);

impl UsbDriver<'static> for OtgDriver {
    type EndpointOut = <Hal as UsbDriver<'static>>::EndpointOut;
    type EndpointIn = <Hal as UsbDriver<'static>>::EndpointIn;
    type ControlPipe = <Hal as UsbDriver<'static>>::ControlPipe;
    type Bus = OtgBus;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.0
            .alloc_endpoint_out(kind, address, max_packet_size, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.0
            .alloc_endpoint_in(kind, address, max_packet_size, interval_ms)
    }

    fn start(self, control_max_packet_size: u16) -> (OtgBus, Self::ControlPipe) {
        let (bus, control) = self.0.start(control_max_packet_size);
        (OtgBus(bus), control)
    }
}

/// Its bus.
pub(crate) struct OtgBus(<Hal as UsbDriver<'static>>::Bus);

impl Bus for OtgBus {
    async fn enable(&mut self) {
        self.0.enable().await;
    }

    async fn disable(&mut self) {
        self.0.disable().await;
    }

    async fn poll(&mut self) -> Event {
        let mut event = pin!(self.0.poll());
        poll_fn(|context| {
            before_events();
            event.as_mut().poll(context)
        })
        .await
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        if address.direction() == Direction::In && !enabled {
            stop_transmit(address.index());
        }
        self.0.endpoint_set_enabled(address, enabled);
    }

    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        self.0.endpoint_set_stalled(address, stalled);
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        self.0.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.0.remote_wakeup().await
    }
}

/// Prepares the core for the driver's handling of its interrupt flags.
fn before_events() {
    let flags = OTG.gintsts().read();
    if flags.usbrst() || flags.enumdne() {
        OTG.gintsts().write(|w| w.set_usbsusp(true));
    }
    // The cable's end is one of the session's interrupts.
    if flags.usbrst() || flags.otgint() {
        (1..ENDPOINTS).for_each(stop_transmit);
    }
}

/// Takes back the packet that an endpoint is to send, if there is one.
fn stop_transmit(endpoint: usize) {
    let control = OTG.diepctl(endpoint);
    if !control.read().epena() {
        return;
    }
    TAKEN_BACK.store(true, Ordering::Relaxed);
    control.modify(|w| w.set_snak(true));
    until(|| control.read().naksts());
    control.modify(|w| w.set_epdis(true));
    until(|| OTG.diepint(endpoint).read().epdisd());
    OTG.diepint(endpoint).write(|w| {
        w.set_inepne(true);
        w.set_epdisd(true);
    });
    until(|| OTG.grstctl().read().ahbidl());
    OTG.grstctl().write(|w| {
        w.set_txfnum(endpoint as u8);
        w.set_txfflsh(true);
    });
    until(|| !OTG.grstctl().read().txfflsh());
}

fn until(is_so: impl Fn() -> bool) {
    for _ in 0..MOST_READS {
        if is_so() {
            return;
        }
    }
}

/// Leaves the bus for long enough that the host sees it.
pub(crate) async fn leave() {
    OTG.dctl().modify(|w| w.set_sdis(true));
    Timer::after_millis(DISCONNECT_MS).await;
}

/// Leaves the bus and comes back: the host enumerates the device again.
pub(crate) async fn reconnect() {
    leave().await;
    OTG.dctl().modify(|w| w.set_sdis(false));
}
