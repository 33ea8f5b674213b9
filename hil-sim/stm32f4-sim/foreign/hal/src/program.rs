//! The program on the chip.

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use cortex_m_rt::entry;
use critical_section::Mutex;
use static_cell::StaticCell;
use stm32f4xx_hal::gpio::{Output, Pin};
use stm32f4xx_hal::otg_fs::{USB, UsbBus, UsbBusType};
use stm32f4xx_hal::pac::{self, Interrupt, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Config;
use stm32f4xx_hal::timer::{CounterUs, Event, Flag};
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbVidPid};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

/// The serial port and what a host sees of it.
struct Port {
    device: UsbDevice<'static, UsbBusType>,
    serial: SerialPort<'static, UsbBusType>,
}

/// A lamp and the timer that turns it over.
struct Blinker {
    lamp: Pin<'D', 13, Output>,
    timer: CounterUs<pac::TIM2>,
}

static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));
static BLINKER: Mutex<RefCell<Option<Blinker>>> = Mutex::new(RefCell::new(None));

#[entry]
fn main() -> ! {
    if let Some(chip) = pac::Peripherals::take() {
        start(chip);
    }
    loop {
        cortex_m::asm::wfi();
    }
}

fn start(chip: pac::Peripherals) {
    static ENDPOINTS: StaticCell<[u32; 256]> = StaticCell::new();
    static BUS: StaticCell<UsbBusAllocator<UsbBusType>> = StaticCell::new();

    let clocks = Config::hse(25.MHz()).sysclk(168.MHz()).require_pll48clk();
    let mut rcc = chip.RCC.freeze(clocks);
    let gpioa = chip.GPIOA.split(&mut rcc);
    let gpiod = chip.GPIOD.split(&mut rcc);
    if gpioa.pa0.into_pull_down_input().is_high() {
        read_checksum();
    }

    let core = (chip.OTG_FS_GLOBAL, chip.OTG_FS_DEVICE, chip.OTG_FS_PWRCLK);
    let usb = USB::new(core, (gpioa.pa11, gpioa.pa12), &rcc.clocks);
    let bus = BUS.init(UsbBus::new(usb, ENDPOINTS.init([0; 256])));
    let serial = SerialPort::new(bus);
    let strings = StringDescriptors::default()
        .manufacturer("Nobody")
        .product("Echo")
        .serial_number("25");
    let Ok(builder) = UsbDeviceBuilder::new(bus, UsbVidPid(0x1209, 0x0001)).strings(&[strings])
    else {
        return;
    };
    let device = builder.device_class(USB_CLASS_CDC).build();

    let mut timer = chip.TIM2.counter_us(&mut rcc);
    timer.listen(Event::Update);
    if timer.start(20.millis()).is_err() {
        return;
    }
    let lamp = gpiod.pd13.into_push_pull_output();

    critical_section::with(|cs| {
        PORT.replace(cs, Some(Port { device, serial }));
        BLINKER.replace(cs, Some(Blinker { lamp, timer }));
    });
    // SAFETY: what the handlers use is set up, and they share it by critical sections.
    #[allow(unsafe_code)]
    unsafe {
        NVIC::unmask(Interrupt::OTG_FS);
        NVIC::unmask(Interrupt::TIM2);
    }
}

/// Reads the data register of the CRC unit, which the simulator does not model.
#[inline(never)]
fn read_checksum() {
    const CRC_DR: *const u32 = 0x4002_3000 as *const u32;
    // SAFETY: a register of this chip, read for nothing but the read itself.
    #[allow(unsafe_code)]
    let _ = unsafe { CRC_DR.read_volatile() };
}

/// Sends every letter back in the other case.
#[interrupt]
fn OTG_FS() {
    critical_section::with(|cs| {
        let mut port = PORT.borrow_ref_mut(cs);
        let Some(Port { device, serial }) = port.as_mut() else {
            return;
        };
        if !device.poll(&mut [serial]) {
            return;
        }
        let mut bytes = [0; 64];
        if let Ok(count) = serial.read(&mut bytes) {
            for byte in &mut bytes[..count] {
                if byte.is_ascii_alphabetic() {
                    *byte ^= 0x20;
                }
            }
            let _ = serial.write(&bytes[..count]);
        }
    });
}

#[interrupt]
fn TIM2() {
    critical_section::with(|cs| {
        if let Some(Blinker { lamp, timer }) = BLINKER.borrow_ref_mut(cs).as_mut() {
            timer.clear_flags(Flag::Update);
            lamp.toggle();
        }
    });
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::asm::udf()
}
