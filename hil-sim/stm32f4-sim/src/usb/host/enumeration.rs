//! From an attached device to an open serial port, by control transfers.

use super::*;

impl UsbHost {
    pub(super) fn reset(&mut self, now: SimTime, then: Step, otg: &mut Otg) {
        if then == Step::Descriptor8 {
            self.ep0_packet = 64;
        }
        self.quiet_since = None;
        self.inflight = None;
        self.control = None;
        otg.bus_reset();
        self.phase = Phase::Reset {
            until: now + RESET,
            then,
        };
    }

    /// Begins a step of the enumeration.
    pub(super) fn begin(&mut self, step: Step, now: SimTime) {
        let get = |kind: u8, index: u8, language: u16, len: u16| {
            let [l0, l1] = len.to_le_bytes();
            let [g0, g1] = language.to_le_bytes();
            [0x80, 6, index, kind, g0, g1, l0, l1]
        };
        let interface = self.info.cdc.map_or(0, |c| c.control_interface);
        let mut data = Vec::new();
        let setup = match step {
            Step::Descriptor8 => get(1, 0, 0, 8),
            Step::SetAddress => [0x00, 5, ADDRESS, 0, 0, 0, 0, 0],
            Step::Descriptor => get(1, 0, 0, 18),
            Step::ConfigHeader => get(2, 0, 0, 9),
            Step::Config => get(2, 0, 0, self.config_len),
            Step::Language => get(3, 0, 0, 255),
            Step::Text(n) => get(3, self.info.string_indices[n], 0x0409, 255),
            Step::SetConfiguration => [0x00, 9, self.info.configuration, 0, 0, 0, 0, 0],
            Step::LineCoding => {
                // 115,200 baud, one stop bit, no parity, eight bits.
                data = vec![0x00, 0xc2, 0x01, 0x00, 0, 0, 8];
                [0x21, 0x20, 0, 0, interface, 0, 7, 0]
            }
            Step::ClearHalt { is_in } => {
                let cdc = self.info.cdc;
                let endpoint = if is_in {
                    cdc.map_or(0, |c| c.data_in) | 0x80
                } else {
                    cdc.map_or(0, |c| c.data_out)
                };
                [0x02, 1, 0, 0, endpoint, 0, 0, 0]
            }
            Step::ControlLines => {
                let lines = if self.open { 3 } else { 0 };
                self.lines_sent = Some(self.open);
                [0x21, 0x22, lines, 0, interface, 0, 0, 0]
            }
        };
        self.control = Some(Control {
            setup,
            stage: Stage::Setup,
            data,
            sent: 0,
            deadline: now + CONTROL_TIMEOUT,
        });
        self.phase = Phase::Control(step);
    }

    /// Goes on after a control transfer that worked.
    pub(super) fn finished(
        &mut self,
        step: Step,
        data: &[u8],
        now: SimTime,
        otg: &mut Otg,
    ) -> Result<(), String> {
        match step {
            Step::Descriptor8 => {
                if data.len() < 8 || data[1] != 1 {
                    return Err(format!("first bytes of the device descriptor: {data:02x?}"));
                }
                self.ep0_packet = usize::from(data[7]);
                self.phase = Phase::Settle {
                    until: now + RECOVERY,
                };
            }
            Step::SetAddress => {
                if otg.address() != ADDRESS {
                    return Err(format!(
                        "device took address {} instead of {ADDRESS}",
                        otg.address()
                    ));
                }
                self.phase = Phase::Rest {
                    until: now + RECOVERY,
                    then: Step::Descriptor,
                };
            }
            Step::Descriptor => {
                self.info = DeviceInfo::default();
                descriptors::device(data, &mut self.info)?;
                self.begin(Step::ConfigHeader, now);
            }
            Step::ConfigHeader => {
                if data.len() < 9 {
                    return Err(format!("configuration descriptor of {} bytes", data.len()));
                }
                self.config_len = u16::from_le_bytes([data[2], data[3]]);
                self.begin(Step::Config, now);
            }
            Step::Config => {
                descriptors::configuration(data, &mut self.info)?;
                self.begin(Step::Language, now);
            }
            Step::Language => self.next_text(0, now),
            Step::Text(n) => {
                let text = descriptors::string(data)?;
                match n {
                    0 => self.info.manufacturer = text,
                    1 => self.info.product_name = text,
                    _ => self.info.serial = text,
                }
                self.next_text(n + 1, now);
            }
            Step::SetConfiguration => {
                if self.info.cdc.is_none() {
                    return Err("the device has no CDC-ACM function".into());
                }
                (self.toggle_in, self.toggle_out) = (false, false);
                self.begin(Step::LineCoding, now);
            }
            Step::ClearHalt { is_in: true } => {
                self.toggle_in = false;
                self.begin(Step::ClearHalt { is_in: false }, now);
            }
            Step::ClearHalt { is_in: false } => {
                self.toggle_out = false;
                self.begin(Step::ControlLines, now);
            }
            Step::LineCoding => self.begin(Step::ControlLines, now),
            Step::ControlLines => {
                if !self.ready {
                    self.ready = true;
                    self.note(now, "serial port ready");
                }
                self.phase = Phase::Ready;
            }
        }
        Ok(())
    }

    pub(super) fn next_text(&mut self, from: usize, now: SimTime) {
        match (from..3).find(|n| self.info.string_indices[*n] != 0) {
            Some(n) => self.begin(Step::Text(n), now),
            None => self.begin(Step::SetConfiguration, now),
        }
    }

    /// A step did not work: try the whole enumeration again, or give up.
    pub(super) fn broken(&mut self, why: String, now: SimTime, otg: &mut Otg) {
        self.attempts += 1;
        self.note(now, format!("enumeration failed: {why}"));
        self.drop_device();
        if self.attempts < ATTEMPTS {
            self.reset(now, Step::Descriptor8, otg);
        } else {
            self.failure = why;
            // The port is switched off.
            self.quiet_since = Some(now);
            self.phase = Phase::Failed;
        }
    }
}
