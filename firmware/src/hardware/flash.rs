//! The end of the flash, where [`firmware::storage`] is. The core runs from the same flash and
//! pauses while a word is written, some 16 µs (DS8626 table 40): to be written only while no
//! output runs, and only with the supply that the HAL's width of 32 bits needs, which a reset by a
//! dip may lack.

#![allow(unsafe_code, reason = "memory that the linker script names")]

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, FLASH_BASE, Flash};
use embassy_stm32::peripherals::FLASH;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use firmware::config::{FLASH_SUPPLY_MV, INPUT_FILTER, MOST_PANICS, OUTPUT_START_DELAY};
use firmware::storage::{self, DEFAULTS, SLOT, Stored};
use heapless::String;
use protocol::{
    BoardSettings, MAX_CRYSTAL_PPB, MAX_INPUT_DELAY, MAX_PANIC, MAX_START_DELAY, Refusal,
};

use crate::hardware::thermometer;

// Addresses of the linker script (memory.x).
unsafe extern "C" {
    static _storage_start: u8;
    static _storage_end: u8;
}

struct Storage {
    flash: Flash<'static, Blocking>,
    used: usize,
}

static STORAGE: CriticalSectionMutex<RefCell<Option<Storage>>> =
    CriticalSectionMutex::new(RefCell::new(None));

static SETTINGS: CriticalSectionMutex<Cell<BoardSettings>> =
    CriticalSectionMutex::new(Cell::new(DEFAULTS));

static START_DELAY: AtomicU32 = AtomicU32::new(OUTPUT_START_DELAY as u32);
static INPUT_DELAY: AtomicU32 = AtomicU32::new(INPUT_FILTER);

/// [`BoardSettings::output_start_delay`].
pub(super) fn start_delay() -> u32 {
    START_DELAY.load(Ordering::Relaxed)
}

/// [`BoardSettings::input_delay`].
pub(super) fn input_delay() -> u32 {
    INPUT_DELAY.load(Ordering::Relaxed)
}

/// The settings that hold.
pub(crate) fn settings() -> BoardSettings {
    SETTINGS.lock(Cell::get)
}

/// Puts the kept settings into force, and keeps the panic that ended the last run. Returns the
/// number of panics and the newest.
pub(crate) fn init(
    flash: Peri<'static, FLASH>,
    last_panic: Option<&str>,
) -> (u32, Option<String<MAX_PANIC>>) {
    let start = (&raw const _storage_start).addr();
    let size = (&raw const _storage_end).addr() - start;
    // SAFETY: flash, to be read for ever; nothing is written to it as long as this is alive.
    let slots = unsafe { core::slice::from_raw_parts(&raw const _storage_start, size) };
    let stored = Stored::read(slots);
    let (mut panics, mut panic) = (stored.panics, stored.panic);
    let storage = Storage {
        flash: Flash::new_blocking(flash),
        used: stored.used,
    };
    STORAGE.lock(|cell| *cell.borrow_mut() = Some(storage));
    apply(stored.settings);
    if let Some(text) = last_panic
        && panics < MOST_PANICS
        && storage::panic_slot(text).is_some_and(append)
    {
        panics += 1;
        panic = String::try_from(text).ok();
    }
    (panics, panic)
}

/// Keeps other settings, and puts them into force.
///
/// # Errors
///
/// A setting above its most; no place is left, the supply is too low, or the flash took something
/// else.
pub(crate) fn store(settings: BoardSettings) -> Result<BoardSettings, Refusal> {
    let is_in_range = settings.output_start_delay <= MAX_START_DELAY
        && settings.input_delay <= MAX_INPUT_DELAY
        && (settings.crystal_ppb).is_none_or(|ppb| ppb.unsigned_abs() <= MAX_CRYSTAL_PPB);
    if !is_in_range {
        return Err(Refusal::BoardSettingOutOfRange);
    }
    if settings != self::settings() && !storage::settings_slot(settings).is_some_and(append) {
        return Err(Refusal::NotKept);
    }
    apply(settings);
    Ok(settings)
}

fn apply(settings: BoardSettings) {
    SETTINGS.lock(|cell| cell.set(settings));
    START_DELAY.store(settings.output_start_delay.into(), Ordering::Relaxed);
    INPUT_DELAY.store(settings.input_delay.into(), Ordering::Relaxed);
}

/// Writes the next slot and reads it back. The flash refuses one that lies after its end.
fn append(slot: [u8; SLOT]) -> bool {
    if thermometer::supply_mv().is_none_or(|supply| supply < FLASH_SUPPLY_MV) {
        return false;
    }
    let start = (&raw const _storage_start).addr() - FLASH_BASE;
    STORAGE.lock(|cell| {
        let mut storage = cell.borrow_mut();
        let Some(Storage { flash, used }) = storage.as_mut() else {
            return false;
        };
        let at = (start + *used * SLOT) as u32;
        *used += 1;
        let mut read = [0; SLOT];
        flash.blocking_write(at, &slot).is_ok()
            && flash.blocking_read(at, &mut read).is_ok()
            && read == slot
    })
}
