//! The serial ports of this machine, and those that look like the board.

use std::path::Path;

use protocol::usb;
use serde::Serialize;
use serialport::{SerialPortInfo, SerialPortType};

/// One serial port of this machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Port {
    /// Path, as for `--port`.
    pub path: String,
    /// True if vendor, product and product string are the board's.
    pub board: bool,
    /// The USB device behind it, if it is one.
    pub usb: Option<UsbDevice>,
}

/// Identity of a USB device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UsbDevice {
    /// idVendor.
    pub vendor_id: u16,
    /// idProduct.
    pub product_id: u16,
    /// iManufacturer.
    pub manufacturer: Option<String>,
    /// iProduct.
    pub product: Option<String>,
    /// iSerialNumber; for a board, its unique ID in hex.
    pub serial_number: Option<String>,
}

/// Returns all serial ports, boards first, then by path.
///
/// # Errors
///
/// The system does not list its ports.
pub fn list() -> Result<Vec<Port>, serialport::Error> {
    // On Linux the ports are read from sysfs; a container may have none.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Ok(Vec::new());
    }
    let mut ports: Vec<Port> = serialport::available_ports()?
        .into_iter()
        .map(Port::from)
        .collect();
    ports.sort_by(|a, b| b.board.cmp(&a.board).then_with(|| a.path.cmp(&b.path)));
    Ok(ports)
}

impl From<SerialPortInfo> for Port {
    fn from(info: SerialPortInfo) -> Self {
        let usb = match info.port_type {
            SerialPortType::UsbPort(usb) => Some(UsbDevice {
                vendor_id: usb.vid,
                product_id: usb.pid,
                manufacturer: usb.manufacturer,
                product: usb.product,
                serial_number: usb.serial_number,
            }),
            _ => None,
        };
        Self {
            path: info.port_name,
            board: usb.as_ref().is_some_and(UsbDevice::is_board),
            usb,
        }
    }
}

impl UsbDevice {
    /// Returns true if this is the board's identity. The numbers alone do not suffice: they are a
    /// pair for tests that others use too. Some systems replace the spaces of a string by
    /// underscores.
    fn is_board(&self) -> bool {
        self.vendor_id == usb::VENDOR_ID
            && self.product_id == usb::PRODUCT_ID
            && self
                .product
                .as_ref()
                .is_none_or(|product| product.replace('_', " ") == usb::PRODUCT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(product: Option<&str>) -> UsbDevice {
        UsbDevice {
            vendor_id: usb::VENDOR_ID,
            product_id: usb::PRODUCT_ID,
            manufacturer: None,
            product: product.map(String::from),
            serial_number: None,
        }
    }

    #[test]
    fn the_product_string_tells_the_board_from_other_test_devices() {
        assert!(device(Some("SmartDepthSync board")).is_board());
        assert!(device(Some("SmartDepthSync_board")).is_board());
        assert!(device(None).is_board());
        assert!(!device(Some("Somebody's gadget")).is_board());
        let other = UsbDevice {
            product_id: usb::PRODUCT_ID ^ 1,
            ..device(Some(usb::PRODUCT))
        };
        assert!(!other.is_board());
    }
}
