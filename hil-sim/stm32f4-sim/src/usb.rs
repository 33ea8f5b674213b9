//! The host at the other end of the USB cable.

mod descriptors;
mod host;

pub use crate::chip::otg::{Handshake, Token};
pub use descriptors::{CdcAcm, DeviceInfo};
pub(crate) use host::UsbHost;
pub use host::{UsbCut, UsbState};
