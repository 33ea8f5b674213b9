//! The USB OTG full-speed core as a device (RM0090 chapter 34).
//!
//! Registers, FIFOs and status entries are those of the core; the host's side
//! (see [`crate::usb`]) calls it once for every transaction on the bus. What
//! a driver can see is modelled: bus reset and enumeration, the shared receive
//! FIFO with its status entries, one transmit FIFO an endpoint, NAK and STALL,
//! transfer-complete and SETUP interrupts, suspend, session and VBUS sensing.
//!
//! Which OUT packets are taken follows drivers that are known to work on the
//! silicon rather than the letter of the manual: an active endpoint whose NAK
//! bit is clear takes a packet if it fits the receive FIFO; `EPENA` is not
//! asked for. Not modelled: host mode, DMA (this core has none), isochronous
//! transfers, resume from suspend (the host resets a device that was idle), data toggles (the bus of the model loses no packets).

use std::collections::VecDeque;

/// Endpoints of the core in each direction.
pub(crate) const ENDPOINTS: usize = 4;
/// Words of FIFO memory.
const FIFO_WORDS: usize = 320;

const GINTSTS_SOF: u32 = 1 << 3;
const GINTSTS_RXFLVL: u32 = 1 << 4;
const GINTSTS_NPTXFE: u32 = 1 << 5;
const GINTSTS_ESUSP: u32 = 1 << 10;
const GINTSTS_USBSUSP: u32 = 1 << 11;
const GINTSTS_USBRST: u32 = 1 << 12;
const GINTSTS_ENUMDNE: u32 = 1 << 13;
const GINTSTS_IEPINT: u32 = 1 << 18;
const GINTSTS_OEPINT: u32 = 1 << 19;
const GINTSTS_SRQINT: u32 = 1 << 30;
/// The bits that are cleared by writing one.
const GINTSTS_W1C: u32 = 0xf030_fc0a;
const GOTGINT_SEDET: u32 = 1 << 2;

const EPCTL_USBAEP: u32 = 1 << 15;
const EPCTL_NAKSTS: u32 = 1 << 17;
const EPCTL_STALL: u32 = 1 << 21;
const EPCTL_CNAK: u32 = 1 << 26;
const EPCTL_SNAK: u32 = 1 << 27;
const EPCTL_EPDIS: u32 = 1 << 30;
const EPCTL_EPENA: u32 = 1 << 31;

const DIEPINT_XFRC: u32 = 1 << 0;
const DIEPINT_EPDISD: u32 = 1 << 1;
const DIEPINT_INEPNE: u32 = 1 << 6;
const DIEPINT_TXFE: u32 = 1 << 7;
const DOEPINT_XFRC: u32 = 1 << 0;
const DOEPINT_EPDISD: u32 = 1 << 1;
const DOEPINT_STUP: u32 = 1 << 3;

const DCTL_RWUSIG: u32 = 1 << 0;
const DCTL_SDIS: u32 = 1 << 1;

/// Packet status of a receive FIFO entry (RM0090 34.16.2, GRXSTSP).
const PKTSTS_OUT: u32 = 2;
const PKTSTS_OUT_DONE: u32 = 3;
const PKTSTS_SETUP_DONE: u32 = 4;
const PKTSTS_SETUP: u32 = 6;

/// How the device answered a transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Handshake {
    /// Data of an IN, or the acknowledge of an OUT (then empty).
    Ack(Vec<u8>),
    Nak,
    Stall,
}

#[derive(Clone, Copy, Debug, Default)]
struct InEndpoint {
    ctl: u32,
    int: u32,
    siz: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct OutEndpoint {
    ctl: u32,
    int: u32,
    siz: u32,
}

/// One entry of the receive FIFO: a status word and its data.
#[derive(Clone, Debug)]
struct RxEntry {
    status: u32,
    words: usize,
}

#[derive(Debug)]
pub(crate) struct Otg {
    gotgctl: u32,
    gotgint: u32,
    gahbcfg: u32,
    gusbcfg: u32,
    gintsts: u32,
    gintmsk: u32,
    grxfsiz: u32,
    dieptxf: [u32; ENDPOINTS],
    gccfg: u32,
    dcfg: u32,
    dctl: u32,
    diepmsk: u32,
    doepmsk: u32,
    daintmsk: u32,
    diepempmsk: u32,
    pcgcctl: u32,
    inep: [InEndpoint; ENDPOINTS],
    outep: [OutEndpoint; ENDPOINTS],
    rx_status: VecDeque<RxEntry>,
    rx_data: VecDeque<u32>,
    rx_words: usize,
    tx: [VecDeque<u32>; ENDPOINTS],
    vbus: bool,
    suspended: bool,
    frame: u32,
    /// Something changed that the host waits for.
    pub(crate) changed: bool,
}

impl Otg {
    pub(crate) fn new() -> Self {
        Self {
            gotgctl: 0,
            gotgint: 0,
            gahbcfg: 0,
            gusbcfg: 0x0000_0a00,
            gintsts: GINTSTS_NPTXFE,
            gintmsk: 0,
            grxfsiz: 0x200,
            dieptxf: [0x0200_0200; ENDPOINTS],
            gccfg: 0,
            dcfg: 0x0220_0000,
            dctl: 0,
            diepmsk: 0,
            doepmsk: 0,
            daintmsk: 0,
            diepempmsk: 0,
            pcgcctl: 0,
            inep: [InEndpoint::default(); ENDPOINTS],
            outep: [OutEndpoint::default(); ENDPOINTS],
            rx_status: VecDeque::new(),
            rx_data: VecDeque::new(),
            rx_words: 0,
            tx: [const { VecDeque::new() }; ENDPOINTS],
            vbus: false,
            suspended: false,
            frame: 0,
            changed: true,
        }
    }

    /// A reset of the peripheral (RCC, or the whole chip). The cable stays.
    pub(crate) fn reset(&mut self) {
        let vbus = self.vbus;
        *self = Self::new();
        self.vbus = vbus;
    }

    /// CSRST: the core's logic, not the configuration of the PHY.
    fn core_reset(&mut self) {
        let (vbus, gccfg, gusbcfg) = (self.vbus, self.gccfg, self.gusbcfg);
        *self = Self::new();
        self.vbus = vbus;
        self.gccfg = gccfg;
        self.gusbcfg = gusbcfg;
    }

    // ---- the host's side ----------------------------------------------

    /// Whether the device's pull-up shows on the bus.
    pub(crate) fn attached(&self) -> bool {
        let powered = self.gccfg & (1 << 16) != 0;
        let session = self.session_valid();
        powered && session && self.dctl & DCTL_SDIS == 0 && self.gusbcfg & (1 << 29) == 0
    }

    fn session_valid(&self) -> bool {
        let ignores_vbus = self.gccfg & (1 << 21) != 0;
        let senses_vbus = self.gccfg & (1 << 19) != 0;
        ignores_vbus || (senses_vbus && self.vbus)
    }

    /// The bus voltage comes or goes.
    pub(crate) fn set_vbus(&mut self, on: bool) {
        if self.vbus == on {
            return;
        }
        self.vbus = on;
        if self.gccfg & (1 << 19) != 0 && self.gccfg & (1 << 21) == 0 {
            if on {
                self.gintsts |= GINTSTS_SRQINT;
            } else {
                self.gotgint |= GOTGINT_SEDET;
            }
        }
        self.changed = true;
    }

    /// The host drives a bus reset: its beginning, as the core detects it.
    pub(crate) fn bus_reset(&mut self) {
        self.suspended = false;
        self.gintsts |= GINTSTS_USBRST;
        self.dcfg &= !(0x7f << 4);
        for ep in &mut self.outep {
            ep.ctl = (ep.ctl | EPCTL_NAKSTS) & !EPCTL_EPENA;
        }
        for (n, ep) in self.inep.iter_mut().enumerate() {
            ep.ctl = (ep.ctl | EPCTL_NAKSTS) & !EPCTL_EPENA;
            if n > 0 {
                ep.ctl &= !(EPCTL_USBAEP | EPCTL_STALL);
            }
        }
        for ep in &mut self.outep[1..] {
            ep.ctl &= !(EPCTL_USBAEP | EPCTL_STALL);
        }
        for tx in &mut self.tx {
            tx.clear();
        }
        self.rx_status.clear();
        self.rx_data.clear();
        self.rx_words = 0;
    }

    /// End of the bus reset: the speed is known.
    pub(crate) fn enumerated(&mut self) {
        self.gintsts |= GINTSTS_ENUMDNE;
    }

    /// No traffic for 3 ms.
    pub(crate) fn suspend(&mut self) {
        if !self.suspended {
            self.suspended = true;
            self.gintsts |= GINTSTS_USBSUSP | GINTSTS_ESUSP;
        }
    }

    /// Start of frame.
    pub(crate) fn sof(&mut self, frame: u32) {
        self.frame = frame & 0x3fff;
        self.gintsts |= GINTSTS_SOF;
    }

    /// Whether the firmware wants to be interrupted every frame.
    pub(crate) fn wants_sof(&self) -> bool {
        self.gintmsk & GINTSTS_SOF != 0
    }

    /// Frame number, for a read between frames.
    pub(crate) fn set_frame(&mut self, frame: u32) {
        self.frame = frame & 0x3fff;
    }

    /// The address that the firmware programmed.
    pub(crate) fn address(&self) -> u8 {
        ((self.dcfg >> 4) & 0x7f) as u8
    }

    fn rx_room(&self, words: usize) -> bool {
        self.rx_words + words <= (self.grxfsiz & 0xffff).min(FIFO_WORDS as u32) as usize
    }

    fn push_rx(&mut self, ep: usize, pktsts: u32, data: &[u8]) {
        let words = data.len().div_ceil(4);
        for chunk in data.chunks(4) {
            let mut w = [0u8; 4];
            w[..chunk.len()].copy_from_slice(chunk);
            self.rx_data.push_back(u32::from_le_bytes(w));
        }
        self.rx_words += words + 1;
        self.rx_status.push_back(RxEntry {
            status: (ep as u32)
                | ((data.len() as u32) << 4)
                | (pktsts << 17)
                | ((self.frame & 0xf) << 21),
            words,
        });
    }

    /// A SETUP transaction. The core takes it whatever the NAK bits say, if
    /// it fits (room is reserved for three).
    pub(crate) fn setup(&mut self, data: [u8; 8]) -> Handshake {
        if !self.rx_room(4) {
            return Handshake::Nak;
        }
        self.inep[0].ctl = (self.inep[0].ctl | EPCTL_NAKSTS) & !EPCTL_STALL;
        self.outep[0].ctl = (self.outep[0].ctl | EPCTL_NAKSTS) & !EPCTL_STALL;
        self.push_rx(0, PKTSTS_SETUP, &data);
        self.push_rx(0, PKTSTS_SETUP_DONE, &[]);
        let count = (self.outep[0].siz >> 29) & 3;
        self.outep[0].siz = (self.outep[0].siz & !(3 << 29)) | (count.saturating_sub(1) << 29);
        Handshake::Ack(Vec::new())
    }

    fn out_active(&self, ep: usize) -> bool {
        ep == 0 || self.outep[ep].ctl & EPCTL_USBAEP != 0
    }

    /// What an OUT of `len` bytes would be answered now.
    pub(crate) fn out_ready(&self, ep: usize, len: usize) -> Option<Handshake> {
        let e = &self.outep[ep];
        if e.ctl & EPCTL_STALL != 0 {
            return Some(Handshake::Stall);
        }
        if !self.out_active(ep) || e.ctl & EPCTL_NAKSTS != 0 || !self.rx_room(len.div_ceil(4) + 2) {
            return None;
        }
        Some(Handshake::Ack(Vec::new()))
    }

    /// An OUT transaction.
    pub(crate) fn out(&mut self, ep: usize, data: &[u8]) -> Handshake {
        match self.out_ready(ep, data.len()) {
            None => return Handshake::Nak,
            Some(Handshake::Ack(_)) => {}
            Some(other) => return other,
        }
        self.push_rx(ep, PKTSTS_OUT, data);
        let e = &mut self.outep[ep];
        let max_packet = if ep == 0 {
            64 >> (e.ctl & 3)
        } else {
            (e.ctl & 0x7ff) as usize
        };
        let packets = (e.siz >> 19) & if ep == 0 { 1 } else { 0x3ff };
        let size_mask = if ep == 0 { 0x7f } else { 0x7_ffff };
        let left = (e.siz & size_mask).saturating_sub(data.len() as u32);
        let packets = packets.saturating_sub(1);
        let keep = if ep == 0 {
            e.siz & (3 << 29)
        } else {
            e.siz & !0x1fff_ffff
        };
        e.siz = keep | (packets << 19) | left;
        if packets == 0 || data.len() < max_packet {
            e.ctl = (e.ctl | EPCTL_NAKSTS) & !EPCTL_EPENA;
            self.push_rx(ep, PKTSTS_OUT_DONE, &[]);
        }
        Handshake::Ack(Vec::new())
    }

    /// What an IN would be answered now: nothing means NAK.
    pub(crate) fn in_ready(&self, ep: usize) -> Option<Handshake> {
        let e = &self.inep[ep];
        if e.ctl & EPCTL_STALL != 0 {
            return Some(Handshake::Stall);
        }
        let active = ep == 0 || e.ctl & EPCTL_USBAEP != 0;
        if !active || e.ctl & EPCTL_EPENA == 0 || e.ctl & EPCTL_NAKSTS != 0 {
            return None;
        }
        let len = self.in_len(ep);
        (self.tx[ep].len() >= len.div_ceil(4)).then(|| Handshake::Ack(Vec::new()))
    }

    /// Bytes of the next packet of an IN endpoint.
    pub(crate) fn in_len(&self, ep: usize) -> usize {
        let e = &self.inep[ep];
        let max_packet = if ep == 0 {
            64 >> (e.ctl & 3)
        } else {
            e.ctl & 0x7ff
        };
        let size = e.siz & if ep == 0 { 0x7f } else { 0x7_ffff };
        size.min(max_packet) as usize
    }

    /// An IN transaction; the host has acknowledged the data.
    pub(crate) fn take_in(&mut self, ep: usize) -> Handshake {
        match self.in_ready(ep) {
            None => return Handshake::Nak,
            Some(Handshake::Ack(_)) => {}
            Some(other) => return other,
        }
        let len = self.in_len(ep);
        let mut data = Vec::with_capacity(len.div_ceil(4) * 4);
        for _ in 0..len.div_ceil(4) {
            let word = self.tx[ep].pop_front().unwrap_or(0);
            data.extend_from_slice(&word.to_le_bytes());
        }
        data.truncate(len);
        let e = &mut self.inep[ep];
        let size_mask = if ep == 0 { 0x7f } else { 0x7_ffff };
        let left = (e.siz & size_mask) - (len as u32).min(e.siz & size_mask);
        let packets = ((e.siz >> 19) & if ep == 0 { 3 } else { 0x3ff }).saturating_sub(1);
        e.siz = (packets << 19) | left;
        if packets == 0 {
            e.ctl &= !EPCTL_EPENA;
            e.int |= DIEPINT_XFRC;
        }
        Handshake::Ack(data)
    }

    // ---- the firmware's side ------------------------------------------

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

    pub(crate) fn read(&mut self, offset: u32) -> u32 {
        match offset {
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
                    _ => 0,
                }
            }
            0xb00..=0xb7c => {
                let ep = ((offset - 0xb00) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.outep[ep].ctl | if ep == 0 { EPCTL_USBAEP } else { 0 },
                    0x08 => self.outep[ep].int,
                    0x10 => self.outep[ep].siz,
                    _ => 0,
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
            _ => 0,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
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
                    _ => {}
                }
            }
            0xb00..=0xb7c => {
                let ep = ((offset - 0xb00) / 0x20) as usize;
                match offset & 0x1f {
                    0x00 => self.write_doepctl(ep, value),
                    0x08 => self.outep[ep].int &= !value,
                    0x10 => self.outep[ep].siz = value,
                    _ => {}
                }
            }
            0xe00 => self.pcgcctl = value,
            0x1000..=0x4fff => {
                let ep = ((offset >> 12) - 1) as usize;
                // What does not fit the FIFO is lost, as on the chip.
                if self.tx[ep].len() < FIFO_WORDS {
                    self.tx[ep].push_back(value);
                }
                self.changed = true;
            }
            _ => {}
        }
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
        ctl |= e.ctl & (EPCTL_NAKSTS | EPCTL_EPENA);
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
        if value & EPCTL_EPDIS != 0 && e.ctl & EPCTL_EPENA != 0 {
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
        ctl |= e.ctl & (EPCTL_NAKSTS | EPCTL_EPENA);
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
