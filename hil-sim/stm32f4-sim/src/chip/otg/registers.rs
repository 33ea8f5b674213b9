//! The firmware's side of the core: registers, FIFO windows and the interrupt.

use super::*;

impl Otg {
    /// The core's interrupt request.
    pub(crate) fn irq(&self) -> bool {
        self.gahbcfg & 1 != 0 && self.gintsts_now() & self.gintmsk != 0
    }

    fn diepint(&self, ep: usize) -> u32 {
        let mut int = self.inep[ep].int;
        // TXFELVL is zero in this driver: half empty; it is taken as enough
        // room for another packet only when wholly empty, the safer reading.
        if self.tx[ep].is_empty() {
            int |= DIEPINT_TXFE;
        }
        int
    }

    fn daint(&self) -> u32 {
        let mut daint = 0;
        for ep in 0..ENDPOINTS {
            let int = self.diepint(ep);
            let mut mask = self.diepmsk & !DIEPINT_TXFE;
            if self.diepempmsk & (1 << ep) != 0 {
                mask |= DIEPINT_TXFE;
            }
            if int & mask != 0 {
                daint |= 1 << ep;
            }
            if self.outep[ep].int & self.doepmsk != 0 {
                daint |= 1 << (16 + ep);
            }
        }
        daint
    }

    fn gintsts_now(&self) -> u32 {
        let mut s = self.gintsts;
        if !self.rx_status.is_empty() {
            s |= GINTSTS_RXFLVL;
        }
        if self.gotgint != 0 {
            s |= GINTSTS_OTGINT;
        }
        let daint = self.daint() & self.daintmsk;
        if daint & 0xffff != 0 {
            s |= GINTSTS_IEPINT;
        }
        if daint >> 16 != 0 {
            s |= GINTSTS_OEPINT;
        }
        s
    }

    fn pop_status(&mut self) -> u32 {
        let Some(entry) = self.rx_status.pop_front() else {
            return 0;
        };
        self.rx_words = self.rx_words.saturating_sub(1);
        if entry.words == 0 {
            // A status entry without data takes effect when it is popped.
            let ep = (entry.status & 0xf) as usize;
            match (entry.status >> 17) & 0xf {
                PKTSTS_SETUP_DONE => self.outep[ep].int |= DOEPINT_STUP,
                PKTSTS_OUT_DONE => self.outep[ep].int |= DOEPINT_XFRC,
                _ => {}
            }
        }
        self.changed = true;
        entry.status
    }

    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x000 => {
                let mut v = self.gotgctl & !(1 << 19);
                if self.session_valid() {
                    v |= 1 << 19;
                }
                v | (1 << 16)
            }
            0x004 => self.gotgint,
            0x008 => self.gahbcfg,
            0x00c => self.gusbcfg,
            // AHB idle; flushes and resets are done at once.
            0x010 => 1 << 31,
            0x014 => self.gintsts_now(),
            0x018 => self.gintmsk,
            0x01c => self.rx_status.front().map_or(0, |e| e.status),
            0x020 => self.pop_status(),
            0x024 => self.grxfsiz,
            0x028 => self.dieptxf[0],
            0x02c => 0x0008_0200,
            0x038 => self.gccfg,
            // The core's revision in the STM32F40x.
            0x03c => 0x0000_1200,
            0x104..=0x10c => self.dieptxf[((offset - 0x100) / 4) as usize],
            0x800 => self.dcfg,
            0x804 => self.dctl,
            // Full speed; suspend status; frame number.
            0x808 => (3 << 1) | u32::from(self.suspended) | (self.frame << 8),
            0x810 => self.diepmsk,
            0x814 => self.doepmsk,
            0x818 => self.daint(),
            0x81c => self.daintmsk,
            0x834 => self.diepempmsk,
            0x900..=0x97c => {
                let ep = ((offset - 0x900) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.inep[ep].ctl | if ep == 0 { EPCTL_USBAEP } else { 0 },
                    0x08 => self.diepint(ep),
                    0x10 => self.inep[ep].siz,
                    0x18 => {
                        let size = (self.dieptxf[ep] >> 16) as usize;
                        size.saturating_sub(self.tx[ep].len()) as u32
                    }
                    _ => return None,
                }
            }
            0xb00..=0xb7c => {
                let ep = ((offset - 0xb00) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.outep[ep].ctl | if ep == 0 { EPCTL_USBAEP } else { 0 },
                    0x08 => self.outep[ep].int,
                    0x10 => self.outep[ep].siz,
                    _ => return None,
                }
            }
            0xe00 => self.pcgcctl,
            0x1000..=0x4fff => {
                // Every FIFO window reads the one receive FIFO.
                match self.rx_data.pop_front() {
                    Some(word) => {
                        self.rx_words = self.rx_words.saturating_sub(1);
                        self.changed = true;
                        word
                    }
                    None => 0,
                }
            }
            _ => return None,
        })
    }

    /// The endpoint whose transmit FIFO a write at `offset` goes into while that is full,
    /// or while it lies beyond the core's memory.
    pub(crate) fn overfills(&self, offset: u32) -> Option<usize> {
        if !(0x1000..0x5000).contains(&offset) {
            return None;
        }
        let ep = ((offset >> 12) - 1) as usize;
        let (start, depth) = (self.dieptxf[ep] & 0xffff, self.dieptxf[ep] >> 16);
        let beyond = (start + depth) as usize > FIFO_WORDS;
        (beyond || self.tx[ep].len() >= depth as usize).then_some(ep)
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> bool {
        match offset {
            0x000 => self.gotgctl = value,
            0x004 => self.gotgint &= !value,
            0x008 => self.gahbcfg = value & 0x1e1,
            0x00c => {
                self.gusbcfg = value;
                self.changed = true;
            }
            0x010 => self.write_grstctl(value),
            0x014 => self.gintsts &= !(value & GINTSTS_W1C),
            0x018 => self.gintmsk = value,
            0x024 => self.grxfsiz = value & 0xffff,
            0x028 => self.dieptxf[0] = value,
            0x038 => {
                let before = self.session_valid();
                self.gccfg = value;
                let senses = self.gccfg & (1 << 19) != 0 && self.gccfg & (1 << 21) == 0;
                if senses && !before && self.session_valid() {
                    // Sensing was switched on with the cable in.
                    self.gintsts |= GINTSTS_SRQINT;
                }
                self.changed = true;
            }
            0x104..=0x10c => self.dieptxf[((offset - 0x100) / 4) as usize] = value,
            0x800 => self.dcfg = value,
            0x804 => {
                self.dctl = value & (DCTL_SDIS | DCTL_RWUSIG | 0x870);
                self.changed = true;
            }
            0x810 => self.diepmsk = value,
            0x814 => self.doepmsk = value,
            0x81c => self.daintmsk = value,
            0x834 => self.diepempmsk = value,
            0x900..=0x97c => {
                let ep = ((offset - 0x900) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.write_diepctl(ep, value),
                    0x08 => self.inep[ep].int &= !value,
                    0x10 => self.inep[ep].siz = value,
                    _ => return false,
                }
            }
            0xb00..=0xb7c => {
                let ep = ((offset - 0xb00) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.write_doepctl(ep, value),
                    0x08 => self.outep[ep].int &= !value,
                    0x10 => self.outep[ep].siz = value,
                    _ => return false,
                }
            }
            0xe00 => self.pcgcctl = value,
            0x1000..=0x4fff => {
                let ep = ((offset >> 12) - 1) as usize;
                self.tx[ep].push_back(value);
                self.changed = true;
            }
            _ => return false,
        }
        true
    }

    fn write_grstctl(&mut self, value: u32) {
        if value & 1 != 0 {
            self.core_reset();
        }
        if value & (1 << 4) != 0 {
            self.rx_status.clear();
            self.rx_data.clear();
            self.rx_words = 0;
        }
        if value & (1 << 5) != 0 {
            let n = ((value >> 6) & 0x1f) as usize;
            if n == 0x10 {
                for tx in &mut self.tx {
                    tx.clear();
                }
            } else if let Some(tx) = self.tx.get_mut(n) {
                tx.clear();
            }
        }
        self.changed = true;
    }

    fn write_diepctl(&mut self, ep: usize, value: u32) {
        let e = &mut self.inep[ep];
        let mut ctl = value & (0x03c0_0000 | EPCTL_USBAEP | 0x7ff | 0x000c_0000);
        ctl |= e.ctl & (EPCTL_NAKSTS | EPCTL_EPENA | EPCTL_DPID);
        if value & EPCTL_SD0PID != 0 {
            ctl &= !EPCTL_DPID;
        } else if value & EPCTL_SD1PID != 0 {
            ctl |= EPCTL_DPID;
        }
        ctl |= value & EPCTL_STALL;
        if ep == 0 {
            ctl |= EPCTL_USBAEP;
            // STALL of a control endpoint is cleared by the core only.
            ctl |= e.ctl & EPCTL_STALL;
        }
        if value & EPCTL_SNAK != 0 {
            ctl |= EPCTL_NAKSTS;
            e.int |= DIEPINT_INEPNE;
        }
        if value & EPCTL_CNAK != 0 {
            ctl &= !EPCTL_NAKSTS;
        }
        // Only while NAK is in effect already (RM0090 34.17.6, "IN endpoint disable").
        let can_disable = e.ctl & EPCTL_EPENA != 0 && e.ctl & EPCTL_NAKSTS != 0;
        if value & EPCTL_EPDIS != 0 && can_disable {
            ctl &= !EPCTL_EPENA;
            e.int |= DIEPINT_EPDISD;
        } else if value & EPCTL_EPENA != 0 {
            ctl |= EPCTL_EPENA;
        }
        e.ctl = ctl;
        self.changed = true;
    }

    fn write_doepctl(&mut self, ep: usize, value: u32) {
        let e = &mut self.outep[ep];
        let mut ctl = value & (EPCTL_USBAEP | 0x7ff | 0x000c_0000 | (1 << 20));
        ctl |= e.ctl & (EPCTL_NAKSTS | EPCTL_EPENA | EPCTL_DPID);
        if value & EPCTL_SD0PID != 0 {
            ctl &= !EPCTL_DPID;
        } else if value & EPCTL_SD1PID != 0 {
            ctl |= EPCTL_DPID;
        }
        ctl |= value & EPCTL_STALL;
        if ep == 0 {
            ctl |= EPCTL_USBAEP | (e.ctl & EPCTL_STALL);
        }
        if value & EPCTL_SNAK != 0 {
            ctl |= EPCTL_NAKSTS;
        }
        if value & EPCTL_CNAK != 0 {
            ctl &= !EPCTL_NAKSTS;
        }
        if value & EPCTL_EPDIS != 0 && e.ctl & EPCTL_EPENA != 0 {
            ctl &= !EPCTL_EPENA;
            e.int |= DOEPINT_EPDISD;
        } else if value & EPCTL_EPENA != 0 {
            ctl |= EPCTL_EPENA;
        }
        e.ctl = ctl;
        self.changed = true;
    }
}
