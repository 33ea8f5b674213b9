//! Identity of the board on USB, by which a host finds its serial port among others.
//!
//! The numbers are pid.codes' pair for tests and private use
//! (<https://pid.codes/1209/0001/>): it may not be shipped in a product, and
//! other projects use it too. A host therefore also looks at the product
//! string, and takes only [`Hello`](crate::Hello) for proof. `docs/install.md` says how to
//! get a number of one's own before shipping boards.

/// Vendor ID: pid.codes.
pub const VENDOR_ID: u16 = 0x1209;

/// Product ID: pid.codes' test PID.
pub const PRODUCT_ID: u16 = 0x0001;

/// Manufacturer string.
pub const MANUFACTURER: &str = "SmartDepthSync";

/// Product string.
pub const PRODUCT: &str = "SmartDepthSync board";

/// The serial number string: the 12 bytes of the MCU's unique ID as 24 upper
/// case hex digits, in the order of [`Hello::board_id`](crate::Hello::board_id).
#[must_use]
pub fn serial_number(board_id: &[u8; 12]) -> heapless::String<24> {
    const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    let mut serial = heapless::String::new();
    for nibble in board_id.iter().flat_map(|byte| [byte >> 4, byte & 15]) {
        // 24 digits fit by construction.
        let _ = serial.push(char::from(DIGITS[usize::from(nibble)]));
    }
    serial
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_serial_number_is_the_board_id_in_hex() {
        let id = [0, 1, 0x23, 0xAB, 0xFF, 5, 6, 7, 8, 9, 10, 11];
        assert_eq!(super::serial_number(&id), "000123ABFF05060708090A0B");
    }
}
