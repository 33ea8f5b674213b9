//! The peripherals and pins of a board, and the driver or task that each belongs to: a file a
//! board. The compiler refuses a pin that is given away twice, and one that a timer, bus or DMA
//! stream does not reach.

/// Splits the peripherals: those that both boards use alike, and a board's own.
macro_rules! assign_with_common {
    ($($own:tt)*) => {
        assign_resources::assign_resources! {
            trigger: Trigger {
                timer: TIM2, trigger: PA5, data_ready: PA1, strobe: PA2, readback: PA3,
                falling_edges: DMA1_CH5,
            }
            imu_bus: ImuBus { i2c: I2C1, scl: PB6, sda: PB7, tx: DMA1_CH6, rx: DMA1_CH0 }
            imu_clock: ImuClock { slow: TIM3, slow_pin: PB0, fast: MCO1, fast_pin: PA8 }
            usb: Usb { core: USB_OTG_FS, dp: PA12, dm: PA11, vbus: PA9 }
            chip: Chip { adc: ADC1, flash: FLASH, handover: SPI3 }
            $($own)*
        }

        pub(crate) fn split(all: Peripherals) -> AssignedResources {
            split_resources!(all)
        }
    };
}

#[cfg(feature = "black-pill")]
mod black_pill;
#[cfg(feature = "discovery")]
mod discovery;

#[cfg(feature = "black-pill")]
pub(crate) use black_pill::*;
#[cfg(feature = "discovery")]
pub(crate) use discovery::*;
