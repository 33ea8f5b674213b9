//! Facts that the host learns from a device's descriptors (USB 2.0 chapter 9, CDC 1.2).

/// Maximum packet sizes and numbers of the endpoints of a CDC-ACM function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CdcAcm {
    /// Interface of the control class, to which line requests go.
    pub control_interface: u8,
    /// Bulk IN endpoint number.
    pub data_in: u8,
    /// Bulk OUT endpoint number.
    pub data_out: u8,
    /// Bytes of the largest bulk packet to the device.
    pub out_packet: usize,
    /// Interrupt IN endpoint number, if the control interface has one.
    pub notification: Option<u8>,
}

/// The device as it introduced itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// idVendor.
    pub vendor: u16,
    /// idProduct.
    pub product: u16,
    /// bcdDevice.
    pub release: u16,
    /// Manufacturer string; empty if there is none.
    pub manufacturer: String,
    /// Product string.
    pub product_name: String,
    /// Serial number string.
    pub serial: String,
    /// Value for SET_CONFIGURATION.
    pub configuration: u8,
    /// bmAttributes of the configuration: 0x80, and 0x40 if it has power of its own.
    pub attributes: u8,
    /// Its serial port, if it has one.
    pub cdc: Option<CdcAcm>,
    pub(super) string_indices: [u8; 3],
}

/// Takes the device descriptor apart.
pub(super) fn device(d: &[u8], info: &mut DeviceInfo) -> Result<(), String> {
    if d.len() < 18 || d[0] != 18 || d[1] != 1 {
        return Err(format!("not a device descriptor: {d:02x?}"));
    }
    info.vendor = u16::from_le_bytes([d[8], d[9]]);
    info.product = u16::from_le_bytes([d[10], d[11]]);
    info.release = u16::from_le_bytes([d[12], d[13]]);
    info.string_indices = [d[14], d[15], d[16]];
    Ok(())
}

/// Finds the CDC-ACM function in a configuration descriptor.
pub(super) fn configuration(d: &[u8], info: &mut DeviceInfo) -> Result<(), String> {
    if d.len() < 9 || d[1] != 2 {
        return Err(format!("not a configuration descriptor: {d:02x?}"));
    }
    info.configuration = d[5];
    info.attributes = d[7];
    let mut at = 0;
    let mut interface = (0u8, 0u8);
    let mut control = None;
    let mut notification = None;
    let (mut data_in, mut data_out) = (None, None);
    while let Some(&len) = d.get(at) {
        let len = usize::from(len);
        let Some(item) = d.get(at..at + len).filter(|i| i.len() >= 2) else {
            return Err(format!("descriptor of {len} bytes at {at} does not fit"));
        };
        match item[1] {
            4 if item.len() >= 9 => {
                interface = (item[2], item[5]);
                // Communications class, abstract control model.
                if item[5] == 2 && item[6] == 2 {
                    control = Some(item[2]);
                }
            }
            5 if item.len() >= 7 => {
                let number = item[2] & 0xf;
                let packet = usize::from(u16::from_le_bytes([item[4], item[5]]) & 0x7ff);
                match (interface.1, item[2] & 0x80 != 0, item[3] & 3) {
                    (2, true, 3) => notification = Some(number),
                    (10, true, 2) => data_in = Some(number),
                    (10, false, 2) => data_out = Some((number, packet)),
                    _ => {}
                }
            }
            _ => {}
        }
        at += len;
    }
    if let (Some(control_interface), Some(data_in), Some((data_out, out_packet))) =
        (control, data_in, data_out)
    {
        info.cdc = Some(CdcAcm {
            control_interface,
            data_in,
            data_out,
            out_packet: out_packet.max(1),
            notification,
        });
    }
    Ok(())
}

/// Text of a string descriptor.
pub(super) fn string(d: &[u8]) -> Result<String, String> {
    if d.len() < 2 || d[1] != 3 {
        return Err(format!("not a string descriptor: {d:02x?}"));
    }
    let units: Vec<u16> = d[2..]
        .chunks_exact(2)
        .map(|c| u16::from_le_bytes([c[0], c[1]]))
        .collect();
    Ok(String::from_utf16_lossy(&units))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_descriptors_are_errors() {
        let mut info = DeviceInfo::default();
        assert!(configuration(&[9, 2, 9, 0, 1, 1, 0, 0x80, 50, 40, 4], &mut info).is_err());
        assert!(configuration(&[9, 2, 9, 0, 1, 1, 0, 0x80, 50, 0], &mut info).is_err());
        assert!(device(&[18, 1, 0], &mut info).is_err());
        assert!(string(&[3]).is_err());
    }
}
