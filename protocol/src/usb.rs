//! Identity of the board on USB, by which a host finds its serial port among others.
//!
//! The numbers are pid.codes' pair for tests and private use
//! (<https://pid.codes/1209/0001/>), unless `SMARTDEPTHSYNC_USB_ID` names another pair when
//! firmware and program are built. That pair may not be shipped in a product, and
//! other projects use it too. A host therefore also looks at the product
//! string, and takes only [`Hello`](crate::Hello) for proof.

/// Vendor and product ID of this build.
#[allow(clippy::panic, reason = "in the compiler")]
const ID: (u16, u16) = {
    let text = match option_env!("SMARTDEPTHSYNC_USB_ID") {
        Some(text) => text,
        None => "1209:0001",
    };
    match parse(text) {
        Some(id) => id,
        None => panic!("SMARTDEPTHSYNC_USB_ID: expected two IDs in hex, such as 1209:0001"),
    }
};

/// Vendor ID.
pub const VENDOR_ID: u16 = ID.0;

/// Product ID.
pub const PRODUCT_ID: u16 = ID.1;

/// Manufacturer string.
pub const MANUFACTURER: &str = "SmartDepthSync";

/// Product string.
pub const PRODUCT: &str = "SmartDepthSync board";

/// Parses a pair of IDs: four hex digits each, with a colon between.
const fn parse(text: &str) -> Option<(u16, u16)> {
    if let Some((vendor, rest)) = text.split_at_checked(4)
        && let Some((colon, product)) = rest.split_at_checked(1)
        && matches!(colon.as_bytes(), b":")
        && let (Ok(vendor), Ok(product)) = (
            u16::from_str_radix(vendor, 16),
            u16::from_str_radix(product, 16),
        )
    {
        Some((vendor, product))
    } else {
        None
    }
}

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

/// Begin of the serial number of a simulated MCU: the word in ASCII. A real one begins with its
/// coordinates on the wafer in decimal digits (`LL_GetUID_Word0` in ST's drivers): these are none.
const SIMULATED: &str = "53494D554C41544544";

/// Returns true for the [`serial_number`] of a simulated MCU.
#[must_use]
pub fn is_simulated(serial: &str) -> bool {
    serial.starts_with(SIMULATED)
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_simulated_chip_is_known_by_its_serial_number() {
        let serial = super::serial_number(b"SIMULATED 01");
        assert!(super::is_simulated(&serial));
        assert!(!super::is_simulated("280041000A47313237313930"));
    }

    #[test]
    fn a_pair_of_ids_is_parsed_or_refused() {
        assert_eq!(super::parse("1209:Fe01"), Some((0x1209, 0xFE01)));
        for wrong in ["", "1209", "1209-0001", "1209:", "1209:10001", "x209:0001"] {
            assert_eq!(super::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_serial_number_is_the_board_id_in_hex() {
        let id = [0, 1, 0x23, 0xAB, 0xFF, 5, 6, 7, 8, 9, 10, 11];
        assert_eq!(super::serial_number(&id), "000123ABFF05060708090A0B");
    }
}
