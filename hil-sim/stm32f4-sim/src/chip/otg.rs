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
//! asked for. What no manual says that a bus reset does, it does not do: a driver has to.
//! Not modelled: host mode, DMA (this core has none), isochronous transfers, resume from suspend
//! (the host resets a device that was idle), data toggles of endpoint 0, which its stages give.

mod registers;

use std::collections::VecDeque;

/// Endpoints of the core in each direction.
pub(crate) const ENDPOINTS: usize = 4;
/// Words of FIFO memory.
const FIFO_WORDS: usize = 320;

const GINTSTS_OTGINT: u32 = 1 << 2;
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
const EPCTL_DPID: u32 = 1 << 16;
const EPCTL_NAKSTS: u32 = 1 << 17;
const EPCTL_STALL: u32 = 1 << 21;
const EPCTL_CNAK: u32 = 1 << 26;
const EPCTL_SNAK: u32 = 1 << 27;
const EPCTL_SD0PID: u32 = 1 << 28;
const EPCTL_SD1PID: u32 = 1 << 29;
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

/// Answer of the device to a transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Handshake {
    /// Data of an IN, or the acknowledge of an OUT (then empty).
    Ack(Vec<u8>),
    /// Not now.
    Nak,
    /// Not at all.
    Stall,
}

/// A transaction that a host begins.
#[derive(Clone, Copy, Debug)]
pub enum Token<'a> {
    /// A SETUP for endpoint 0.
    Setup([u8; 8]),
    /// An IN for this endpoint.
    In(u8),
    /// An OUT for this endpoint, with its data and their toggle.
    Out(u8, &'a [u8], bool),
}

#[derive(Clone, Copy, Debug, Default)]
struct Endpoint {
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
    inep: [Endpoint; ENDPOINTS],
    outep: [Endpoint; ENDPOINTS],
    rx_status: VecDeque<RxEntry>,
    rx_data: VecDeque<u32>,
    rx_words: usize,
    tx: [VecDeque<u32>; ENDPOINTS],
    vbus: bool,
    suspended: bool,
    wedged: bool,
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
            inep: [Endpoint::default(); ENDPOINTS],
            outep: [Endpoint::default(); ENDPOINTS],
            rx_status: VecDeque::new(),
            rx_data: VecDeque::new(),
            rx_words: 0,
            tx: [const { VecDeque::new() }; ENDPOINTS],
            vbus: false,
            suspended: false,
            wedged: false,
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

    /// The core as a program leaves it that has just sent its last packet: on the bus, with a
    /// transmit on its way, an interrupt for each frame, and all others.
    pub(crate) fn leave_as_rom(&mut self) {
        self.gccfg = (1 << 16) | (1 << 21);
        self.gahbcfg = 1;
        self.gintmsk = u32::MAX;
        self.gintsts |= GINTSTS_SOF | GINTSTS_USBSUSP;
        self.inep[0].ctl = EPCTL_EPENA;
        self.daintmsk = u32::MAX;
        self.diepmsk = u32::MAX;
        self.doepmsk = u32::MAX;
        self.push_rx(0, PKTSTS_OUT, &[0; 8]);
    }

    // ---- the host's side ----------------------------------------------

    /// True if the device's pull-up shows on the bus.
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
        // A transmit is not stopped by a reset: the driver has to (embassy #6687).
        for ep in self.inep.iter_mut().chain(&mut self.outep) {
            ep.ctl &= !EPCTL_USBAEP;
        }
        self.wedged = false;
    }

    /// The transmitter answers no token until the next bus reset.
    pub(crate) fn wedge(&mut self) {
        self.wedged = true;
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

    /// True if the firmware wants to be interrupted every frame.
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

    /// Answer to an OUT of `len` bytes now.
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

    /// An OUT transaction, with the data toggle of the host. A packet with the other one is a
    /// repeated one: it is acknowledged and dropped (USB 2.0 8.6.3).
    pub(crate) fn out(&mut self, ep: usize, data: &[u8], toggle: bool) -> Handshake {
        match self.out_ready(ep, data.len()) {
            None => return Handshake::Nak,
            Some(Handshake::Ack(_)) => {}
            Some(other) => return other,
        }
        if ep > 0 {
            if toggle != (self.outep[ep].ctl & EPCTL_DPID != 0) {
                return Handshake::Ack(Vec::new());
            }
            self.outep[ep].ctl ^= EPCTL_DPID;
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

    /// Answer to an IN now: nothing means NAK.
    pub(crate) fn in_ready(&self, ep: usize) -> Option<Handshake> {
        let e = &self.inep[ep];
        if e.ctl & EPCTL_STALL != 0 {
            return Some(Handshake::Stall);
        }
        let active = ep == 0 || e.ctl & EPCTL_USBAEP != 0;
        let active = active && !(self.wedged && ep > 0);
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

    /// Data toggle of the next packet of an IN endpoint.
    pub(crate) fn in_toggle(&self, ep: usize) -> bool {
        self.inep[ep].ctl & EPCTL_DPID != 0
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
        e.ctl ^= EPCTL_DPID;
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
}
