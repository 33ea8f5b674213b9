//! The USB device: a CDC-ACM serial port under the project's own name.
//!
//! A host counts as linked while the device is configured, not suspended, and
//! the host has its terminal ready (DTR, which opening the port sets). Where it can be,
//! VBUS is sensed on PA9: the STM32F4DISCOVERY is powered through its other connector
//! and so survives an unplugged cable, which it must notice (RM0090 34.3.3).

use core::cell::Cell;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::{Config, Driver, InterruptHandler};
use embassy_stm32::{bind_interrupts, interrupt, rcc};
use embassy_time::Timer;
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::{Builder, Handler, UsbDevice};
use firmware::boards::BOARD;
use firmware::config::{TRANSMIT_SILENT_S, UNCONFIGURED_S, USB_PACKET};
use heapless::String;
use protocol::UsbCounters;
use static_cell::StaticCell;

use crate::hardware::cycles::USB_TIME;
use crate::hardware::leds::{self, Led};
use crate::hardware::otg::{self, OtgDriver};
use crate::hardware::{resources, tim2};
use crate::state::{self, RECEIVED};

bind_interrupts!(struct Irqs {
    OTG_FS => Timed;
});

/// The driver's handler, under a meter.
struct Timed;

#[allow(unsafe_code, reason = "a handler around the driver's")]
impl interrupt::typelevel::Handler<interrupt::typelevel::OTG_FS> for Timed {
    unsafe fn on_interrupt() {
        USB_TIME.measure(|| {
            otg::before_interrupt();
            // SAFETY: called by the vector of this interrupt alone, as it asks for.
            unsafe { InterruptHandler::<USB_OTG_FS>::on_interrupt() }
        });
    }
}

// SAFETY: `Timed`, which is bound, calls it.
#[allow(unsafe_code, reason = "a handler around the driver's")]
unsafe impl
    interrupt::typelevel::Binding<interrupt::typelevel::OTG_FS, InterruptHandler<USB_OTG_FS>>
    for Irqs
{
}

pub(crate) struct Usb {
    pub(crate) device: UsbDevice<'static, OtgDriver>,
    pub(crate) sender: Sender<'static, OtgDriver>,
    pub(crate) receiver: Receiver<'static, OtgDriver>,
    pub(crate) control: ControlChanged<'static>,
}

/// Sets up the device; it appears on the bus once [`run`] runs. The core looks at VBUS by itself
/// (RM0090 34.4.3).
pub(crate) fn build(usb: resources::Usb, board_id: &[u8; 12]) -> Usb {
    static OUT: StaticCell<[u8; 256]> = StaticCell::new();
    static CONFIGURATION: StaticCell<[u8; 128]> = StaticCell::new();
    static BOS: StaticCell<[u8; 16]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static CLASS: StaticCell<State<'static>> = StaticCell::new();
    static LINK_HANDLER: StaticCell<LinkHandler> = StaticCell::new();
    static SERIAL: StaticCell<String<24>> = StaticCell::new();

    let mut otg = Config::default();
    otg.vbus_detection = BOARD.senses_vbus;
    // Tasks look at their endpoints before that of the device has let the HAL do this.
    rcc::enable_and_reset::<USB_OTG_FS>();
    let driver = Driver::new_fs(usb.core, Irqs, usb.dp, usb.dm, OUT.init([0; _]), otg);
    let driver = OtgDriver(driver);

    let mut config = embassy_usb::Config::new(protocol::usb::VENDOR_ID, protocol::usb::PRODUCT_ID);
    config.manufacturer = Some(protocol::usb::MANUFACTURER);
    config.product = Some(protocol::usb::PRODUCT);
    config.serial_number = Some(SERIAL.init(protocol::usb::serial_number(board_id)));
    // A board that can lose its session without losing power has power of its own.
    config.self_powered = BOARD.senses_vbus;

    let mut builder = Builder::new(
        driver,
        config,
        CONFIGURATION.init([0; _]),
        BOS.init([0; _]),
        &mut [],
        CONTROL.init([0; _]),
    );
    builder.handler(LINK_HANDLER.init(LinkHandler));
    let class = CdcAcmClass::new(&mut builder, CLASS.init(State::new()), USB_PACKET as u16);
    let (sender, receiver, control) = class.split_with_control();
    Usb {
        device: builder.build(),
        sender,
        receiver,
        control,
    }
}

#[embassy_executor::task]
pub(crate) async fn run(mut device: UsbDevice<'static, OtgDriver>) {
    device.run().await;
}

/// Packets that the core took to send.
static SENT: AtomicU32 = AtomicU32::new(0);

/// Notes that a packet went into the core.
pub(crate) fn packet_sent() {
    SENT.fetch_add(1, Ordering::Relaxed);
}

/// Restarts the core if nothing is sent although the host talks to the board, or if a host that
/// has reset the bus does not get as far as a configuration: the core has stopped for a reason
/// that is not known.
#[embassy_executor::task]
pub(crate) async fn watch_core() {
    let progress = || {
        (
            SENT.load(Ordering::Relaxed),
            RECEIVED.lock(Cell::get).frames,
        )
    };
    let (mut sent, mut received) = progress();
    let mut silent = 0;
    let mut unconfigured = 0;
    loop {
        Timer::after_secs(1).await;
        let now = progress();
        let link = LINK.load(Ordering::Relaxed);
        if link != LINKED || now.0 != sent {
            silent = 0;
        } else if now.1 != received {
            silent += 1;
        }
        (sent, received) = now;
        unconfigured = if link & CONFIGURED == 0 && otg::HAS_HOST.load(Ordering::Relaxed) {
            unconfigured + 1
        } else {
            0
        };
        let reason = if silent >= TRANSMIT_SILENT_S {
            &STUCK
        } else if unconfigured >= UNCONFIGURED_S {
            &UNCONFIGURED
        } else {
            continue;
        };
        defmt::error!("the USB core has stopped: restarting it");
        (silent, unconfigured) = (0, 0);
        reason.fetch_add(1, Ordering::Relaxed);
        otg::restart().await;
    }
}

/// Follows DTR.
#[embassy_executor::task]
pub(crate) async fn watch_terminal(control: ControlChanged<'static>) {
    loop {
        control.control_changed().await;
        update(TERMINAL_READY, control.dtr());
    }
}

const CONFIGURED: u8 = 1;
const AWAKE: u8 = 2;
const TERMINAL_READY: u8 = 4;
const LINKED: u8 = CONFIGURED | AWAKE | TERMINAL_READY;

/// All of [`LINKED`] while a host is linked. Changed by tasks only.
static LINK: AtomicU8 = AtomicU8::new(AWAKE);

/// Sets or clears a condition, and acts if the link comes or goes by it.
fn update(condition: u8, on: bool) {
    let before = LINK.load(Ordering::Relaxed);
    let after = if on {
        before | condition
    } else {
        before & !condition
    };
    LINK.store(after, Ordering::Relaxed);
    let linked = after == LINKED;
    if linked != (before == LINKED) {
        defmt::info!("host {=str}", if linked { "linked" } else { "gone" });
        leds::set(Led::Link, linked);
        state::set_linked(linked, tim2::now());
    }
}

static RESETS: AtomicU32 = AtomicU32::new(0);
static SUSPENDS: AtomicU32 = AtomicU32::new(0);
static STUCK: AtomicU32 = AtomicU32::new(0);
static UNCONFIGURED: AtomicU32 = AtomicU32::new(0);

/// Returns the counts of bus events since the board's reset.
pub(crate) fn counters() -> UsbCounters {
    UsbCounters {
        resets: RESETS.load(Ordering::Relaxed),
        suspends: SUSPENDS.load(Ordering::Relaxed),
        stuck: STUCK.load(Ordering::Relaxed),
        unconfigured: UNCONFIGURED.load(Ordering::Relaxed),
    }
}

struct LinkHandler;

impl Handler for LinkHandler {
    fn enabled(&mut self, enabled: bool) {
        defmt::debug!("usb enabled: {=bool}", enabled);
        update(CONFIGURED, false);
    }

    fn reset(&mut self) {
        RESETS.fetch_add(1, Ordering::Relaxed);
        update(CONFIGURED, false);
        update(AWAKE, true);
    }

    fn configured(&mut self, configured: bool) {
        update(CONFIGURED, configured);
    }

    fn suspended(&mut self, suspended: bool) {
        SUSPENDS.fetch_add(u32::from(suspended), Ordering::Relaxed);
        update(AWAKE, !suspended);
    }
}
