//! The HAL's driver of the USB core, with what embassy-usb-synopsys-otg 0.3.3 leaves out
//! (mended upstream on 2026-08-01, embassy #6684 and #6687, and not released):
//!
//! - A bus reset or an unplugged cable leaves the endpoint of a packet on its way enabled: it
//!   never sends again. A transmit is stopped in the manual's order, each step awaited: NAK,
//!   disable, flush (RM0090 34.17.6, "IN endpoint disable"). Setting both bits in one write, as
//!   the driver does, is not enough.
//! - A suspend that was noted before a reset, and is handled after it, would have the device
//!   take itself as suspended for good.
//! - What was received before a reset is handed out after it. Endpoint 0 discards it; on the
//!   others the frames' checksums find it.
//! - Endpoints start again at DATA0 after CLEAR_FEATURE(HALT) and SET_CONFIGURATION (USB 2.0
//!   9.4.5, 9.1.1.5).
//!
//! And with what upstream leaves out too (embassy #2751): a control transfer that the host does
//! not finish. The device's task waits for its next stage and serves no bus event meanwhile, so
//! each of these waits ends with a bus event or the next SETUP.

use core::future::{Future, poll_fn};
use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Poll;

use embassy_futures::poll_once;
use embassy_stm32::pac;
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::Driver;
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::Timer;
use embassy_usb::driver::{
    Bus, ControlPipe, Direction, Driver as UsbDriver, EndpointAddress, EndpointAllocError,
    EndpointError, EndpointType, Event, Unsupported,
};
use firmware::config::USB_PACKET;

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

/// Time without the pull-up before the core shows it for good, in ms: the 3 ms that the core may
/// take (Zephyr #108825), and a tick of the clock that counts them.
const SHORTEST_DISCONNECT_MS: u64 = 4;

/// True after a packet was withdrawn that the host had not acknowledged.
pub(crate) static TAKEN_BACK: AtomicBool = AtomicBool::new(false);

/// True while a SETUP waits that has come after the one that is being carried out.
static NEXT_SETUP: AtomicBool = AtomicBool::new(false);

/// True after a bus reset, until the control pipe has discarded what came before it.
static WAS_RESET: AtomicBool = AtomicBool::new(false);

/// True from a bus reset until power goes or the core is restarted: there is a host.
pub(crate) static HAS_HOST: AtomicBool = AtomicBool::new(false);

/// Woken when a control transfer may be over.
static CUT: AtomicWaker = AtomicWaker::new();

/// The driver.
pub(crate) struct OtgDriver(pub(crate) Hal);

impl UsbDriver<'static> for OtgDriver {
    type EndpointOut = <Hal as UsbDriver<'static>>::EndpointOut;
    type EndpointIn = <Hal as UsbDriver<'static>>::EndpointIn;
    type ControlPipe = OtgControl;
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
        let is_set_up = false;
        (OtgBus { bus, is_set_up }, OtgControl(control))
    }
}

/// Its bus.
pub(crate) struct OtgBus {
    bus: <Hal as UsbDriver<'static>>::Bus,
    is_set_up: bool,
}

impl Bus for OtgBus {
    async fn enable(&mut self) {
        self.bus.enable().await;
    }

    async fn disable(&mut self) {
        HAS_HOST.store(false, Ordering::Relaxed);
        self.bus.disable().await;
    }

    async fn poll(&mut self) -> Event {
        if !self.is_set_up {
            self.is_set_up = true;
            // At its first poll the driver shows the pull-up, leaves the bus and comes back, all
            // within some µs.
            let first = poll_once(self.bus.poll());
            leave_for(SHORTEST_DISCONNECT_MS).await;
            OTG.dctl().modify(|w| w.set_sdis(false));
            if let Poll::Ready(event) = first {
                return event;
            }
        }
        let mut event = pin!(self.bus.poll());
        poll_fn(|context| {
            before_events();
            event.as_mut().poll(context)
        })
        .await
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        if address.direction() == Direction::In {
            stop_transmit(address.index());
        }
        self.bus.endpoint_set_enabled(address, enabled);
        begin_at_data0(address);
    }

    // The host may name any endpoint, and the driver panics at one that is not there.
    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        if address.index() < ENDPOINTS {
            self.bus.endpoint_set_stalled(address, stalled);
            begin_at_data0(address);
        }
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        address.index() < ENDPOINTS && self.bus.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.bus.remote_wakeup().await
    }
}

/// Its control pipe.
pub(crate) struct OtgControl(<Hal as UsbDriver<'static>>::ControlPipe);

impl ControlPipe for OtgControl {
    fn max_packet_size(&self) -> usize {
        self.0.max_packet_size()
    }

    async fn setup(&mut self) -> [u8; 8] {
        poll_fn(|context| {
            let setup = critical_section::with(|_| {
                // Data before a SETUP is of a transfer that the host has ended: the core takes
                // none between a SETUP and its fetching.
                let mut left = [0; USB_PACKET];
                let _ = pin!(self.0.data_out(&mut left, true, true)).poll(context);
                if WAS_RESET.swap(false, Ordering::Relaxed) {
                    let _ = pin!(self.0.setup()).poll(context);
                }
                NEXT_SETUP.store(false, Ordering::Relaxed);
                pin!(self.0.setup()).poll(context)
            });
            if setup.is_ready() {
                stop_transmit(0);
            }
            setup
        })
        .await
    }

    async fn data_out(
        &mut self,
        data: &mut [u8],
        first: bool,
        last: bool,
    ) -> Result<usize, EndpointError> {
        until_cut(self.0.data_out(data, first, last)).await?
    }

    async fn data_in(&mut self, data: &[u8], first: bool, last: bool) -> Result<(), EndpointError> {
        until_cut(self.0.data_in(data, first, last)).await?
    }

    async fn accept(&mut self) {
        let _ = until_cut(self.0.accept()).await;
    }

    async fn reject(&mut self) {
        self.0.reject().await;
    }

    async fn accept_set_address(&mut self, address: u8) {
        let _ = until_cut(self.0.accept_set_address(address)).await;
    }
}

/// Waits for a stage of a control transfer, but no longer than the transfer lasts.
async fn until_cut<T>(stage: impl Future<Output = T>) -> Result<T, EndpointError> {
    let mut stage = pin!(stage);
    poll_fn(|context| {
        CUT.register(context.waker());
        if is_cut() {
            Poll::Ready(Err(EndpointError::Disabled))
        } else {
            stage.as_mut().poll(context).map(Ok)
        }
    })
    .await
}

/// Events of the bus until the driver has served them, which meanwhile keeps all others masked:
/// OTGINT, USBSUSP, USBRST, ENUMDNE, SRQINT and WKUPINT (RM0090 34.16.2, OTG_FS_GINTSTS).
const BUS_EVENTS: u32 = 1 << 2 | 7 << 11 | 3 << 30;

/// Returns true if the transfer that is being carried out is over for the host.
fn is_cut() -> bool {
    NEXT_SETUP.load(Ordering::Relaxed) || OTG.gintsts().read().0 & BUS_EVENTS != 0
}

/// Notes what ends a control transfer. To be called by the core's handler, before the driver's,
/// which clears it.
pub(crate) fn before_interrupt() {
    let flags = OTG.gintsts().read();
    let is_setup = flags.oepint() && OTG.doepint(0).read().stup();
    if is_setup {
        NEXT_SETUP.store(true, Ordering::Relaxed);
    }
    if is_setup || flags.0 & BUS_EVENTS != 0 {
        CUT.wake();
    }
    if flags.usbrst() {
        HAS_HOST.store(true, Ordering::Relaxed);
    }
}

/// Prepares the core for the driver's handling of its interrupt flags.
fn before_events() {
    let flags = OTG.gintsts().read();
    if flags.usbrst() {
        WAS_RESET.store(true, Ordering::Relaxed);
    }
    if flags.usbrst() || flags.enumdne() {
        OTG.gintsts().write(|w| w.set_usbsusp(true));
    }
    // The cable's end is one of the session's interrupts. A reset may begin between this look
    // and the driver's: its end is another chance.
    if flags.usbrst() || flags.enumdne() || flags.otgint() {
        (0..ENDPOINTS).for_each(stop_transmit);
    }
}

/// Has an endpoint go on with DATA0.
fn begin_at_data0(address: EndpointAddress) {
    let endpoint = address.index();
    critical_section::with(|_| match address.direction() {
        Direction::In => OTG.diepctl(endpoint).modify(|w| w.set_sd0pid_sevnfrm(true)),
        Direction::Out => OTG.doepctl(endpoint).modify(|w| w.set_sd0pid_sevnfrm(true)),
    });
}

/// Takes back the packet that an endpoint is to send, if there is one.
fn stop_transmit(endpoint: usize) {
    let control = OTG.diepctl(endpoint);
    if !control.read().epena() {
        return;
    }
    if endpoint > 0 {
        TAKEN_BACK.store(true, Ordering::Relaxed);
    }
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
    leave_for(DISCONNECT_MS).await;
}

async fn leave_for(ms: u64) {
    OTG.dctl().modify(|w| w.set_sdis(true));
    Timer::after_millis(ms).await;
}

/// Leaves the bus, resets the core and comes back: the host enumerates the device again. The
/// driver sets FIFOs and endpoints up at each bus reset; what it writes only once is kept.
pub(crate) async fn restart() {
    HAS_HOST.store(false, Ordering::Relaxed);
    critical_section::with(|_| {
        let (mode, phy) = (OTG.gusbcfg().read(), OTG.gccfg_v1().read());
        let (speed, handler) = (OTG.dcfg().read(), OTG.gahbcfg().read());
        let (masks_in, masks_out) = (OTG.diepmsk().read(), OTG.doepmsk().read());
        pac::RCC.ahb2rstr().modify(|w| w.set_usb_otg_fsrst(true));
        pac::RCC.ahb2rstr().modify(|w| w.set_usb_otg_fsrst(false));
        OTG.dctl().write(|w| w.set_sdis(true));
        OTG.gusbcfg().write_value(mode);
        OTG.gccfg_v1().write_value(phy);
        OTG.dcfg().write_value(speed);
        OTG.diepmsk().write_value(masks_in);
        OTG.doepmsk().write_value(masks_out);
        // The driver unmasks the others when it serves one of these.
        OTG.gintmsk().write(|w| {
            w.set_usbrst(true);
            w.set_srqim(true);
            w.set_otgint(true);
        });
        OTG.gahbcfg().write_value(handler);
    });
    leave().await;
    OTG.dctl().modify(|w| w.set_sdis(false));
}
