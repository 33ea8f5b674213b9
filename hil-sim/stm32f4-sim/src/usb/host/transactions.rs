//! Single transactions on the bus: which comes next, and what follows from it.

use super::*;

impl UsbHost {
    pub(super) fn transact(&mut self, now: SimTime, otg: &mut Otg) -> bool {
        if let Some((transaction, end)) = self.inflight.take() {
            if now < end {
                self.next = self.next.min(end);
                self.inflight = Some((transaction, end));
                return false;
            }
            self.bus_free = end;
            self.complete(transaction, now, otg);
            return true;
        }
        if let Some(control) = &self.control {
            if now >= control.deadline {
                let step = self.phase;
                self.broken(format!("no answer within 5 s in {step:?}"), now, otg);
                return true;
            }
            self.next = self.next.min(control.deadline);
        } else if self.phase == Phase::Ready && self.configures {
            self.configures = false;
            self.begin(Step::SetConfiguration, now);
            return true;
        } else if self.phase == Phase::Ready && self.lines_sent != Some(self.open) {
            let clears = self.clears_halts && self.open;
            self.begin(
                if clears {
                    Step::ClearHalt { is_in: true }
                } else {
                    Step::ControlLines
                },
                now,
            );
            return true;
        }
        let Some((transaction, bytes)) = self.choose(otg) else {
            return false;
        };
        let begin = self.bus_free.max(now + POLL);
        let end = self.fit(begin, bytes);
        self.next = self.next.min(end);
        self.inflight = Some((transaction, end));
        false
    }

    /// The next transaction that the device would not answer with NAK.
    fn choose(&mut self, otg: &Otg) -> Option<(Transaction, usize)> {
        if let Some(control) = &self.control {
            return match control.stage {
                Stage::Setup => Some((Transaction::Setup, 8)),
                Stage::DataIn | Stage::StatusIn => otg
                    .in_ready(0)
                    .map(|_| (Transaction::ControlIn, otg.in_len(0))),
                Stage::DataOut => {
                    let end = (control.sent + self.ep0_packet.max(8)).min(control.data.len());
                    let chunk = control.data[control.sent..end].to_vec();
                    otg.out_ready(0, chunk.len()).map(|_| {
                        let n = chunk.len();
                        (Transaction::ControlOut(chunk), n)
                    })
                }
                Stage::StatusOut => otg
                    .out_ready(0, 0)
                    .map(|_| (Transaction::ControlOut(Vec::new()), 0)),
            };
        }
        let cdc = self.info.cdc?;
        if let Some(ep) = cdc.notification
            && otg.in_ready(usize::from(ep)).is_some()
        {
            return Some((Transaction::Notification(ep), otg.in_len(usize::from(ep))));
        }
        // IN and OUT take turns when both have something.
        self.out_turn = !self.out_turn;
        if self.out_turn {
            self.choose_out(otg, cdc)
                .or_else(|| self.choose_in(otg, cdc))
        } else {
            self.choose_in(otg, cdc)
                .or_else(|| self.choose_out(otg, cdc))
        }
    }

    fn choose_in(&self, otg: &Otg, cdc: CdcAcm) -> Option<(Transaction, usize)> {
        if !self.reading || !self.open || self.from_device.len() >= self.buffer_limit {
            return None;
        }
        let ep = usize::from(cdc.data_in);
        otg.in_ready(ep)
            .map(|_| (Transaction::BulkIn(cdc.data_in), otg.in_len(ep)))
    }

    fn choose_out(&self, otg: &Otg, cdc: CdcAcm) -> Option<(Transaction, usize)> {
        if self.to_device.is_empty() || !self.open {
            return None;
        }
        let len = self.to_device.len().min(cdc.out_packet);
        otg.out_ready(usize::from(cdc.data_out), len)?;
        let data: Vec<u8> = self.to_device.iter().take(len).copied().collect();
        Some((Transaction::BulkOut(cdc.data_out, data), len))
    }

    fn complete(&mut self, transaction: Transaction, now: SimTime, otg: &mut Otg) {
        match transaction {
            Transaction::Setup | Transaction::ControlIn | Transaction::ControlOut(_) => {
                self.complete_control(transaction, now, otg);
            }
            Transaction::Notification(ep) => {
                otg.take_in(usize::from(ep));
            }
            Transaction::BulkIn(ep) => {
                let toggle = otg.in_toggle(usize::from(ep));
                match otg.take_in(usize::from(ep)) {
                    // A repeated packet is acknowledged and dropped (USB 2.0 8.6.3).
                    Handshake::Ack(_) if toggle != self.toggle_in => {
                        self.note(now, "a bulk packet with the wrong data toggle");
                    }
                    Handshake::Ack(data) => {
                        self.toggle_in = !self.toggle_in;
                        for b in data {
                            let b = corrupt(&mut self.random, self.corrupt_in_ppm, b);
                            self.from_device.push_back(b);
                        }
                    }
                    Handshake::Nak => {}
                    Handshake::Stall => {
                        self.note(now, "bulk IN stalled");
                        self.broken("bulk IN stalled".into(), now, otg);
                    }
                }
            }
            Transaction::BulkOut(ep, data) => {
                match otg.out(usize::from(ep), &data, self.toggle_out) {
                    Handshake::Ack(_) => {
                        self.toggle_out = !self.toggle_out;
                        self.to_device.drain(..data.len().min(self.to_device.len()));
                    }
                    Handshake::Nak => {}
                    Handshake::Stall => self.broken("bulk OUT stalled".into(), now, otg),
                }
            }
        }
    }

    fn complete_control(&mut self, transaction: Transaction, now: SimTime, otg: &mut Otg) {
        let Phase::Control(step) = self.phase else {
            return;
        };
        let Some(mut control) = self.control.take() else {
            return;
        };
        let reads = control.setup[0] & 0x80 != 0;
        let wanted = usize::from(u16::from_le_bytes([control.setup[6], control.setup[7]]));
        let answer = match &transaction {
            Transaction::Setup => otg.setup(control.setup),
            Transaction::ControlIn => otg.take_in(0),
            Transaction::ControlOut(data) => otg.out(0, data, true),
            _ => return,
        };
        if let Some((_, cutting)) = &mut self.cut
            && let Cutting::After(left, delay) = *cutting
        {
            *cutting = match left {
                0 | 1 => Cutting::At(now + delay),
                _ => Cutting::After(left - 1, delay),
            };
        }
        let got = match answer {
            Handshake::Ack(data) => data,
            Handshake::Nak => {
                self.control = Some(control);
                return;
            }
            Handshake::Stall => {
                let why = format!("{step:?} was refused (STALL)");
                // Optional things may be refused.
                match step {
                    Step::Text(n) => self.next_text(n + 1, now),
                    Step::Language => self.next_text(3, now),
                    Step::LineCoding => self.begin(Step::ControlLines, now),
                    _ => self.broken(why, now, otg),
                }
                return;
            }
        };
        let mut done = false;
        match control.stage {
            Stage::Setup => {
                control.stage = match (reads, wanted) {
                    (_, 0) => Stage::StatusIn,
                    (true, _) => Stage::DataIn,
                    (false, _) => Stage::DataOut,
                };
            }
            Stage::DataIn => {
                let short = got.len() < self.ep0_packet;
                control.data.extend_from_slice(&got);
                if short || control.data.len() >= wanted {
                    control.stage = Stage::StatusOut;
                }
            }
            Stage::DataOut => {
                control.sent = (control.sent + self.ep0_packet.max(8)).min(control.data.len());
                if control.sent == control.data.len() {
                    control.stage = Stage::StatusIn;
                }
            }
            Stage::StatusIn | Stage::StatusOut => done = true,
        }
        if !done {
            self.control = Some(control);
            return;
        }
        let data = if reads { control.data } else { Vec::new() };
        if let Err(why) = self.finished(step, &data, now, otg) {
            self.broken(why, now, otg);
        }
    }
}

/// Damages a byte with a chance of `ppm` in a million.
pub(super) fn corrupt(random: &mut Random, ppm: u32, byte: u8) -> u8 {
    if ppm > 0 && random.bits() % 1_000_000 < u64::from(ppm) {
        byte ^ (1 << (random.bits() % 8))
    } else {
        byte
    }
}
