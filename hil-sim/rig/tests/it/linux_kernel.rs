//! A USB host that nobody here wrote: the simulated board at a real Linux kernel, over USB/IP
//! (`Documentation/usb/usbip_protocol.rst` in the kernel's sources) at the level of transfers.
//! `cargo xtask linux-usb` makes the machine that boots in QEMU, and runs this. It takes two cores
//! that do nothing else: a slower kernel does not read what the board sends, the board drops and
//! counts it, and commands end with the code for losses.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use rig::clocks::oscillator::{BoardTime, OscillatorConfig};
use rig::imu::{SensorModel, SimImu, SimImuConfig};
use rig::motion::Motion;
use rig::random::{Seed, Stream};
use rig::wiring;
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::SimDuration;
use stm32f4_sim::usb::{Handshake, Token};

/// The machine: a folder with `vmlinuz` and `initrd`, made by `xtask/linux_usb.sh`.
const MACHINE: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/linux-usb");
/// Longest time for the kernel's whole run.
const LIMIT: Duration = Duration::from_secs(900);
/// Bulk packets in a frame of 1 ms (USB 2.0 table 5-9).
const PACKETS: usize = 19;
const PACKET: usize = 64;

const OP_REQ_IMPORT: u16 = 0x8003;
const CMD_SUBMIT: u32 = 1;
const CMD_UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;
const EPIPE: i32 = -32;
const ECONNRESET: i32 = -104;

/// A transfer that the kernel has asked for.
struct Transfer {
    sequence: u32,
    endpoint: u8,
    is_in: bool,
    setup: [u8; 8],
    /// Bytes to be sent, or received so far.
    data: Vec<u8>,
    length: usize,
    sent: usize,
    stage: Stage,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Setup,
    Data,
    Status,
}

/// The host controller that the kernel drives, with the board at its port.
struct Controller {
    rig: Sim,
    kernel: Option<TcpStream>,
    unread: Vec<u8>,
    transfers: Vec<Transfer>,
    /// Data toggles of the bulk endpoints, as a controller keeps them: OUT, IN.
    toggles: BTreeMap<(u8, bool), bool>,
    /// Packets with another toggle than expected.
    wrong_toggles: u32,
    log: Vec<String>,
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

impl Controller {
    fn run(&mut self, micros: u64) {
        self.rig.run_for(SimDuration::from_micros(micros)).unwrap();
    }

    /// The device appears at the port: debounce, reset, and an address, which the kernel's
    /// virtual controller keeps to itself.
    fn attach(&mut self) {
        self.rig.usb_plug();
        self.rig.usb_take_over();
        let is_there = |rig: &mut Sim| rig.usb_is_attached();
        assert!(
            self.rig
                .run_until(SimDuration::from_secs(3), is_there)
                .unwrap()
        );
        self.run(100_000);
        self.rig.usb_drive_reset(true);
        self.run(50_000);
        self.rig.usb_drive_reset(false);
        self.run(10_000);
        self.transfers.clear();
        self.toggles.clear();
        let set_address = [0, 5, 1, 0, 0, 0, 0, 0];
        self.transfers.push(Transfer {
            sequence: 0,
            endpoint: 0,
            is_in: false,
            setup: set_address,
            data: Vec::new(),
            length: 0,
            sent: 0,
            stage: Stage::Setup,
        });
        while !self.transfers.is_empty() {
            self.frame();
        }
    }

    fn detach(&mut self) {
        self.kernel = None;
        self.unread.clear();
        self.transfers.clear();
        self.rig.usb_unplug();
        self.run(20_000);
    }

    /// A frame of 1 ms: transfers take turns.
    fn frame(&mut self) {
        let mut left = PACKETS;
        let mut idle = 0;
        let mut turn = 0;
        while left > 0 && idle < self.transfers.len() {
            turn %= self.transfers.len();
            // Only the first transfer of an endpoint is on the bus.
            let key = |t: &Transfer| (t.endpoint, t.is_in || t.endpoint == 0);
            let first = self
                .transfers
                .iter()
                .position(|t| key(t) == key(&self.transfers[turn]));
            if first == Some(turn) && self.step(turn) {
                left -= 1;
                idle = 0;
                self.run(1_000 / PACKETS as u64);
            } else {
                idle += 1;
            }
            turn += 1;
        }
        let rest = left as u64 * 1_000 / PACKETS as u64;
        self.run(rest.max(1));
    }

    /// One transaction of a transfer; false if the device answers NAK.
    fn step(&mut self, index: usize) -> bool {
        let transfer = &mut self.transfers[index];
        let endpoint = transfer.endpoint;
        let reads = if endpoint == 0 {
            transfer.setup[0] & 0x80 != 0
        } else {
            transfer.is_in
        };
        let mut done = false;
        let answer = match (endpoint, transfer.stage) {
            (0, Stage::Setup) => self.rig.usb_transact(Token::Setup(transfer.setup)),
            (0, Stage::Status) if reads => self.rig.usb_transact(Token::Out(0, &[], true)),
            (0, Stage::Status) => self.rig.usb_transact(Token::In(0)),
            _ if reads => self.rig.usb_transact(Token::In(endpoint)),
            _ => {
                let end = (transfer.sent + PACKET).min(transfer.data.len());
                let toggle = self.toggles.get(&(endpoint, false)).copied();
                let packet = &transfer.data[transfer.sent..end];
                let token = Token::Out(endpoint, packet, toggle.unwrap_or_default());
                self.rig.usb_transact(token)
            }
        };
        match answer {
            Handshake::Nak => return false,
            Handshake::Stall => {
                self.complete(index, EPIPE);
                return true;
            }
            Handshake::Ack(packet) => match (endpoint, transfer.stage) {
                (0, Stage::Setup) => {
                    let empty = transfer.length == 0;
                    transfer.stage = if empty { Stage::Status } else { Stage::Data };
                }
                (0, Stage::Status) => done = true,
                _ if reads => {
                    let is_short = packet.len() < PACKET;
                    let toggle = self.toggles.entry((endpoint, true)).or_default();
                    if endpoint > 0 && self.rig.usb_in_toggle(endpoint) == *toggle {
                        // Before this packet it was the other one.
                        self.wrong_toggles += 1;
                    }
                    *toggle = !*toggle;
                    transfer.data.extend(packet);
                    if is_short || transfer.data.len() >= transfer.length {
                        done = endpoint > 0;
                        transfer.stage = Stage::Status;
                    }
                }
                _ => {
                    transfer.sent = (transfer.sent + PACKET).min(transfer.data.len());
                    let toggle = self.toggles.entry((endpoint, false)).or_default();
                    *toggle = !*toggle;
                    if transfer.sent == transfer.data.len() {
                        done = endpoint > 0;
                        transfer.stage = Stage::Status;
                    }
                }
            },
        }
        if done {
            self.complete(index, 0);
        }
        true
    }

    /// Answers a transfer.
    fn complete(&mut self, index: usize, status: i32) {
        let transfer = self.transfers.remove(index);
        if transfer.endpoint == 0 {
            let [kind, request, _, _, target, ..] = transfer.setup;
            self.log.push(format!("{:02x?} {status}", transfer.setup));
            match (kind, request) {
                // SET_CONFIGURATION and SET_INTERFACE; CLEAR_FEATURE of an endpoint.
                (0, 9) | (1, 11) => self.toggles.clear(),
                (2, 1) => {
                    self.toggles.remove(&(target & 0xf, target & 0x80 != 0));
                }
                _ => {}
            }
        }
        if transfer.sequence == 0 {
            return;
        }
        let reads = transfer.is_in;
        let actual = if reads {
            transfer.data.len()
        } else {
            transfer.sent
        };
        let mut reply = vec![0; 48];
        for (at, value) in [
            (0, RET_SUBMIT),
            (4, transfer.sequence),
            (20, status as u32),
            (24, actual as u32),
        ] {
            reply[at..at + 4].copy_from_slice(&value.to_be_bytes());
        }
        if reads {
            reply.extend(transfer.data);
        }
        self.send(&reply);
    }

    fn send(&mut self, bytes: &[u8]) {
        if let Some(kernel) = &mut self.kernel {
            kernel.set_nonblocking(false).unwrap();
            let _ = kernel.write_all(bytes);
            kernel.set_nonblocking(true).unwrap();
        }
    }

    /// Takes what the kernel has sent. False once it has gone.
    fn receive(&mut self) -> bool {
        let Some(kernel) = &mut self.kernel else {
            return false;
        };
        let mut chunk = [0; 4096];
        loop {
            match kernel.read(&mut chunk) {
                Ok(0) => return false,
                Ok(count) => self.unread.extend(&chunk[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => return false,
            }
        }
        while self.unread.len() >= 48 {
            let head: [u8; 48] = self.unread[..48].try_into().unwrap();
            let (command, sequence) = (word(&head, 0), word(&head, 4));
            let (is_in, endpoint) = (word(&head, 12) == 1, word(&head, 16) as u8);
            if command == CMD_UNLINK {
                self.unread.drain(..48);
                let victim = word(&head, 20);
                let before = self.transfers.len();
                self.transfers
                    .retain(|transfer| transfer.sequence != victim);
                let was_there = self.transfers.len() < before;
                let status = if was_there { ECONNRESET } else { 0 };
                let mut reply = vec![0; 48];
                reply[..4].copy_from_slice(&RET_UNLINK.to_be_bytes());
                reply[4..8].copy_from_slice(&sequence.to_be_bytes());
                reply[20..24].copy_from_slice(&status.to_be_bytes());
                self.send(&reply);
                continue;
            }
            assert_eq!(command, CMD_SUBMIT);
            let length = word(&head, 24) as usize;
            let data = if is_in { 0 } else { length };
            if self.unread.len() < 48 + data {
                break;
            }
            let data = self.unread.drain(..48 + data).skip(48).collect();
            self.transfers.push(Transfer {
                sequence,
                endpoint,
                is_in,
                setup: head[40..48].try_into().unwrap(),
                data,
                length,
                sent: 0,
                stage: if endpoint == 0 {
                    Stage::Setup
                } else {
                    Stage::Data
                },
            });
        }
        true
    }

    /// Hands the device over to the kernel that has connected.
    fn import(&mut self, mut kernel: TcpStream) {
        let mut request = [0; 40];
        kernel.read_exact(&mut request).unwrap();
        assert_eq!(request[2..4], OP_REQ_IMPORT.to_be_bytes());
        self.attach();
        let mut reply = vec![0; 8 + 312];
        reply[..4].copy_from_slice(&[0x01, 0x11, 0x00, 0x03]);
        let device = &mut reply[8..];
        device[..4].copy_from_slice(b"/sim");
        device[256..259].copy_from_slice(b"1-1");
        for (at, value) in [(288, 1_u32), (292, 2), (296, 2)] {
            device[at..at + 4].copy_from_slice(&value.to_be_bytes());
        }
        device[300..302].copy_from_slice(&protocol::usb::VENDOR_ID.to_be_bytes());
        device[302..304].copy_from_slice(&protocol::usb::PRODUCT_ID.to_be_bytes());
        kernel.write_all(&reply).unwrap();
        kernel.set_nodelay(true).unwrap();
        kernel.set_nonblocking(true).unwrap();
        self.kernel = Some(kernel);
    }
}

/// The kernel in QEMU, without acceleration.
struct Machine {
    qemu: Child,
    lines: Receiver<String>,
}

impl Machine {
    fn boot(port: u16) -> Self {
        let parameters = format!(
            "console=ttyS0 quiet panic=-1 usbip_port={port} usb_id={:04x}:{:04x}",
            protocol::usb::VENDOR_ID,
            protocol::usb::PRODUCT_ID
        );
        let mut qemu = Command::new("qemu-system-x86_64")
            .args(["-accel", "tcg", "-m", "512", "-nographic", "-no-reboot"])
            .args(["-nic", "user,model=e1000"])
            .args(["-kernel", &format!("{MACHINE}/vmlinuz")])
            .args(["-initrd", &format!("{MACHINE}/initrd")])
            .args(["-append", &parameters])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let stdout = BufReader::new(qemu.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.split(b'\n').map_while(Result::ok) {
                let line = String::from_utf8_lossy(&line).trim().to_owned();
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { qemu, lines }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.qemu.kill();
        let _ = self.qemu.wait();
    }
}

/// Steps of the machine's script, which prints `STEP name: ok` or what went wrong.
const STEPS: [&str; 10] = [
    "enumerate",
    "info",
    "reopen",
    "autosuspend",
    "modem-manager",
    "unbind",
    "reset",
    "unplug",
    "minute",
    "end",
];

#[test]
#[ignore = "boots a kernel in QEMU: cargo xtask linux-usb"]
fn a_real_kernel_gets_on_with_the_board() {
    let seed = Seed(7);
    let board_time = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
    let config = SimImuConfig::typical(seed).with_model(SensorModel::Mpu9150);
    let sensor = SimImu::new(config, Motion::rest(), board_time, seed).shared();
    let builder = wiring::board().model(sensor.clone()).i2c_target(sensor);
    let rig = builder.plugged(false).build().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let machine = Machine::boot(listener.local_addr().unwrap().port());
    let mut controller = Controller {
        rig,
        kernel: None,
        unread: Vec::new(),
        transfers: Vec::new(),
        toggles: BTreeMap::new(),
        wrong_toggles: 0,
        log: Vec::new(),
    };
    let began = Instant::now();
    let mut steps = Vec::new();
    let mut behind = Duration::ZERO;
    while steps.len() < STEPS.len() {
        assert!(began.elapsed() < LIMIT, "{steps:?}");
        for line in machine.lines.try_iter() {
            println!("{line}");
            if let Some(step) = line.strip_prefix("STEP ") {
                steps.push(step.to_owned());
            }
        }
        match listener.accept() {
            Ok((kernel, _)) => {
                kernel.set_nonblocking(false).unwrap();
                controller.import(kernel);
            }
            Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
        }
        if controller.kernel.is_some() && !controller.receive() {
            println!("detached");
            controller.detach();
        }
        if controller.kernel.is_some() && !controller.rig.usb_is_attached() {
            println!("the device has left the bus");
            controller.kernel = None;
            controller.unread.clear();
            controller.transfers.clear();
        }
        controller.frame();
        // A board is no faster than real time; one that fell behind stays there.
        let virtual_time = Duration::from_nanos(controller.rig.now().as_nanos());
        let ahead = (virtual_time + behind).saturating_sub(began.elapsed());
        if ahead.is_zero() {
            behind = began.elapsed().saturating_sub(virtual_time);
        }
        std::thread::sleep(ahead);
    }
    for request in &controller.log {
        println!("control {request}");
    }
    let expected = STEPS.map(|step| format!("{step}: ok"));
    assert_eq!(steps, expected);
    assert_eq!(controller.wrong_toggles, 0);
}
