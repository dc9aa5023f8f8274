//! 100,000 frames, good and bad, as fast as they go: the vehicle accounts for every one, answers, and
//! flies on.

#![expect(deprecated, reason = "PING is still what people ask with")]

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    HEARTBEAT_DATA, MavFrame, PING_DATA, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::service::Ping;
use crpl_sitl::link::messages::telemetry::{LocalPositionNed, PositionTargetLocalNed};
use crpl_sitl::link::packet::Packet;
use tests::program::{self, PATIENCE};

const FRAMES: u64 = 100_000;
/// Fewer datagrams than any socket's buffer holds.
const WINDOW: u64 = 64;
/// Acceleration alone, all three axes.
const ACCELERATION: u16 = 3135;

/// What has been sent, by what the vehicle must call it.
#[derive(Debug, Default, PartialEq)]
struct Sent {
    good: u64,
    setpoints: u64,
    not_finite: u64,
    bad_crc: u64,
    truncated: u64,
    unknown: u64,
    mavlink1: u64,
    incompatible: u64,
    garbage_bytes: u64,
}

struct Peer {
    socket: UdpSocket,
    encoder: Encoder,
    decoder: Decoder,
    sent: Sent,
    pings: u32,
    heard: Vec<Packet>,
}

impl Peer {
    fn of(vehicle: SocketAddr) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(vehicle).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        Self {
            socket,
            encoder: Encoder::new(250, 190),
            decoder: Decoder::default(),
            sent: Sent::default(),
            pings: 0,
            heard: Vec::new(),
        }
    }

    fn send(&self, datagram: &[u8]) {
        self.socket.send(datagram).unwrap();
    }

    fn heartbeat(&mut self) -> Vec<u8> {
        self.sent.good += 1;
        let mut frame = Vec::new();
        self.encoder.push(&mut frame, &HEARTBEAT_DATA { mavlink_version: 3, ..Default::default() });
        frame
    }

    fn setpoint(&mut self, north: f32) -> Vec<u8> {
        self.sent.good += 1;
        if north.is_finite() {
            self.sent.setpoints += 1;
        } else {
            self.sent.not_finite += 1;
        }
        let setpoint = SET_POSITION_TARGET_LOCAL_NED_DATA {
            afx: north,
            type_mask: PositionTargetTypemask::from_bits_retain(ACCELERATION),
            target_system: 1,
            target_component: 1,
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            ..Default::default()
        };
        let mut frame = Vec::new();
        self.encoder.push(&mut frame, &setpoint);
        frame
    }

    /// A heartbeat with one byte changed, which its own count no longer counts as good.
    fn spoilt_heartbeat(&mut self, at: usize, byte: u8) -> Vec<u8> {
        let mut frame = self.heartbeat();
        self.sent.good -= 1;
        frame[at] = byte;
        frame
    }

    /// The `k`th thing to throw at the vehicle.
    fn throw(&mut self, k: u64) {
        let datagram = match k % 10 {
            0 => self.heartbeat(),
            1 => self.setpoint(0.0),
            2 => {
                self.sent.bad_crc += 1;
                self.spoilt_heartbeat(12, 0x55)
            }
            3 => {
                self.sent.unknown += 1;
                self.spoilt_heartbeat(9, 7)
            }
            4 => {
                self.sent.garbage_bytes += 24;
                vec![(k % 200) as u8; 24]
            }
            5 => {
                self.sent.mavlink1 += 1;
                // HEARTBEAT of a ground station, its checksum included.
                let mut frame = vec![0xFE, 9, 0, 250, 190, 0, 0, 0, 0, 0, 6, 8, 0, 0, 3];
                let crc = x25(&[&frame[1..], &[50]].concat());
                frame.extend(crc.to_le_bytes());
                frame
            }
            6 => {
                // Says that it goes on for 255 bytes, and does not.
                self.sent.truncated += 1;
                let cut = self.spoilt_heartbeat(1, 255);
                self.send(&cut[..14]);
                self.heartbeat()
            }
            7 => self.setpoint(f32::NAN),
            8 => {
                let frame = self.heartbeat();
                self.send(&frame[..11]);
                frame[11..].to_vec()
            }
            _ => {
                self.sent.incompatible += 1;
                let odd = self.spoilt_heartbeat(2, 0x80);
                [self.heartbeat(), odd, self.heartbeat()].concat()
            }
        };
        self.send(&datagram);
    }

    /// Asks whether the vehicle is there, and waits until it says so.
    fn ping(&mut self) {
        self.pings += 1;
        self.sent.good += 1;
        let seq = self.pings;
        let mut datagram = Vec::new();
        self.encoder.push(&mut datagram, &PING_DATA { seq, ..Default::default() });
        self.send(&datagram);
        self.wait(|packet| Ping::of(packet).is_some_and(|ping| ping.seq == seq));
    }

    /// The next packet for which `found` holds.
    fn wait(&mut self, found: impl Fn(&Packet) -> bool) -> Packet {
        let deadline = Instant::now() + PATIENCE;
        let mut buffer = [0; 65_536];
        while Instant::now() < deadline {
            if !self.heard.is_empty() {
                let packet = self.heard.remove(0);
                if found(&packet) {
                    return packet;
                }
                continue;
            }
            match self.socket.recv(&mut buffer) {
                Ok(n) => self.heard = self.decoder.datagram(&buffer[..n]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) => panic!("the vehicle is gone: {error}"),
            }
        }
        panic!("no answer in {PATIENCE:?}");
    }

    /// The vehicle takes a setpoint and flies it.
    fn assert_it_flies_on(&mut self) {
        let push = self.setpoint(5.0);
        self.send(&push);
        self.wait(|packet| {
            PositionTargetLocalNed::of(packet).is_some_and(|target| target.acceleration[0] == 5.0)
        });
        self.wait(|packet| LocalPositionNed::of(packet).is_some_and(|place| place.position[0] > 250.5));
    }
}

/// CRC-16/MCRF4XX, bit by bit.
fn x25(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0x8408 } else { crc >> 1 })
    })
}

/// The number that stands right before these words.
fn count(text: &str, words: &str) -> u64 {
    let (before, _) = text.split_once(&format!(" {words}")).unwrap_or_else(|| panic!("no `{words}`: {text}"));
    let digits = before.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default();
    digits.parse().unwrap_or_else(|_| panic!("no number before `{words}`: {text}"))
}

/// The sender waits for an answer every 64 frames, so that no socket's buffer overflows and the
/// vehicle's counters can be held against what was sent, one by one.
#[test]
fn every_frame_of_a_flood_is_accounted_for() {
    let (sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let mut peer = Peer::of(address);
    let started = Instant::now();
    for k in 0..FRAMES {
        peer.throw(k);
        if k % WINDOW == WINDOW - 1 {
            peer.ping();
        }
    }
    peer.ping();
    let rate = FRAMES as f64 / started.elapsed().as_secs_f64();
    println!("{FRAMES} frames at {rate:.0} frames/s");
    peer.assert_it_flies_on();

    sitl.interrupt().unwrap();
    let finished = sitl.wait().unwrap();
    let said =
        finished.stderr.lines().find(|line| line.contains(" setpoints,")).unwrap_or_default().to_owned();
    finished.good().unwrap();
    println!("{said}");
    let counted = Sent {
        good: count(&said, "frames;"),
        setpoints: count(&said, "setpoints,"),
        not_finite: count(&said, "x setpoint refused: not finite"),
        bad_crc: count(&said, "bad CRC"),
        truncated: count(&said, "truncated"),
        unknown: count(&said, "unknown"),
        mavlink1: count(&said, "MAVLink 1"),
        incompatible: count(&said, "incompatible"),
        garbage_bytes: count(&said, "bytes of garbage"),
    };
    assert_eq!(counted, peer.sent);
}

/// Nobody waits for anybody; what the socket's buffer cannot hold is the kernel's to drop.
#[test]
fn after_a_flood_at_full_speed_it_answers_and_flies_on() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let mut peer = Peer::of(address);
    peer.ping();
    let started = Instant::now();
    for k in 0..FRAMES {
        peer.throw(k);
    }
    let flooded = started.elapsed();
    let asked = Instant::now();
    // The buffer may be full for one more moment, and the question lost in it.
    let answered = loop {
        let mut datagram = Vec::new();
        peer.pings += 1;
        peer.encoder.push(&mut datagram, &PING_DATA { seq: peer.pings, ..Default::default() });
        peer.send(&datagram);
        let mut buffer = [0; 65_536];
        let packets =
            peer.socket.recv(&mut buffer).map_or(Vec::new(), |n| peer.decoder.datagram(&buffer[..n]));
        if packets.iter().any(|packet| Ping::of(packet).is_some_and(|ping| ping.seq > 1)) {
            break asked.elapsed();
        }
        assert!(asked.elapsed() < PATIENCE, "no answer after the flood");
    };
    println!(
        "{FRAMES} frames in {:.2} s; a PING is answered {:.1} ms after them",
        flooded.as_secs_f64(),
        1e3 * answered.as_secs_f64()
    );
    peer.assert_it_flies_on();
}
