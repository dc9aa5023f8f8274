//! What people have reported of `gcs bridge`, played to the real program over its sockets.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::time::Duration;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    ATTITUDE_DATA, COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavType, PARAM_REQUEST_LIST_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::packet::Packet;
use tests::program::{self, PATIENCE, Program};

/// Somebody on UDP.
struct Peer {
    socket: UdpSocket,
    encoder: Encoder,
    decoder: Decoder,
}

impl Peer {
    fn new(system: u8, component: u8) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Self { socket, encoder: Encoder::new(system, component), decoder: Decoder::default() }
    }

    fn endpoint(&self) -> String {
        format!("udpout:{}", self.socket.local_addr().unwrap())
    }

    fn heartbeat(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        self.encoder.push(&mut out, &HEARTBEAT_DATA { custom_mode: 4, ..Default::default() });
        out
    }

    fn send(&self, bytes: &[u8], to: SocketAddr) {
        self.socket.send_to(bytes, to).unwrap();
    }

    /// The first packet for which `wanted` holds, and from where.
    fn hear(&mut self, mut wanted: impl FnMut(&Packet) -> bool) -> (Packet, SocketAddr) {
        let mut buffer = vec![0; 65_536];
        loop {
            let (length, from) = self.socket.recv_from(&mut buffer).unwrap();
            if let Some(packet) = self.decoder.datagram(&buffer[..length]).into_iter().find(&mut wanted) {
                return (packet, from);
            }
        }
    }

    /// The same if it comes in time.
    #[cfg(target_os = "linux")]
    fn hear_within(
        &mut self,
        patience: Duration,
        mut wanted: impl FnMut(&Packet) -> bool,
    ) -> Option<(Packet, SocketAddr)> {
        let before = self.socket.read_timeout().unwrap();
        self.socket.set_read_timeout(Some(patience)).unwrap();
        let mut buffer = vec![0; 65_536];
        let mut found = None;
        while let (None, Ok((length, from))) = (&found, self.socket.recv_from(&mut buffer)) {
            found = self.decoder.datagram(&buffer[..length]).into_iter().find(&mut wanted).map(|p| (p, from));
        }
        self.socket.set_read_timeout(before).unwrap();
        found
    }

    /// How many packets for which `wanted` holds have come by now.
    fn count(&mut self, mut wanted: impl FnMut(&Packet) -> bool) -> usize {
        self.socket.set_nonblocking(true).unwrap();
        let (mut buffer, mut count) = (vec![0; 65_536], 0);
        while let Ok(length) = self.socket.recv(&mut buffer) {
            count += self.decoder.datagram(&buffer[..length]).iter().filter(|p| wanted(p)).count();
        }
        count
    }
}

fn bridge(args: &[&str]) -> Program {
    Program::start("gcs", &[&["bridge", "--every", "0"][..], args].concat(), None).unwrap()
}

/// An address of this machine at which nobody listens now.
fn free() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn listens(bridge: &Program, role: &str) -> SocketAddr {
    bridge.line(&format!("{role}: listening on udpin:")).unwrap().parse().unwrap()
}

/// Report G2 (asymmetric.py): of two links one is deaf upwards, and the other 20 ms slower; all commands went
/// to the deaf one.
#[test]
fn commands_reach_a_vehicle_by_the_later_of_two_links() {
    let second = free();
    let named = format!("udpin:{second}");
    let args = ["--connect", "udpin:127.0.0.1:0", "--connect", &named, "--forward", "udpin:127.0.0.1:0"];
    let bridge = bridge(&args);
    let (first, forward) = (listens(&bridge, "vehicle"), listens(&bridge, "forward"));
    let (mut vehicle, deaf, mut station) = (Peer::new(1, 1), Peer::new(1, 1), Peer::new(255, 190));
    for k in 0..20 {
        let frame = vehicle.heartbeat();
        deaf.send(&frame, first);
        std::thread::sleep(Duration::from_millis(20));
        vehicle.send(&frame, second);
        std::thread::sleep(Duration::from_millis(20));
        let mut ask = Vec::new();
        let command = COMMAND_LONG_DATA {
            command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            param1: k as f32,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        station.encoder.push(&mut ask, &command);
        station.send(&ask, forward);
    }
    let (packet, _) = vehicle.hear(Packet::is::<COMMAND_LONG_DATA>);
    assert_eq!(packet.system, 255);
}

/// Report G8: a bridge to a vehicle that waits for a first word, and to a tool that waits for the vehicle, said
/// nothing for ever.
#[test]
fn a_bridge_speaks_first_to_a_vehicle_that_waits_and_not_as_a_station() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let mut tool = Peer::new(255, 190);
    let bridge = bridge(&["--connect", &format!("udpout:{address}"), "--forward", &tool.endpoint()]);
    let (packet, _) = tool.hear(|p| p.system == 1 && p.is::<HEARTBEAT_DATA>());
    assert_eq!(packet.component, 1);
    drop(bridge);
    let mut vehicle = Peer::new(1, 1);
    let _bridge = self::bridge(&["--connect", &vehicle.endpoint(), "--forward", "udpin:127.0.0.1:0"]);
    let (hello, _) = vehicle.hear(Packet::is::<HEARTBEAT_DATA>);
    assert_eq!(Heartbeat::of(&hello).unwrap().kind, MavType::MAV_TYPE_ONBOARD_CONTROLLER as u8);
}

/// Report G7: no serial endpoint. A pseudo-terminal is a line.
#[cfg(target_os = "linux")]
#[test]
fn a_vehicle_on_a_serial_line_is_heard_and_spoken_to() {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&near).unwrap();
    unlockpt(&near).unwrap();
    let device = ptsname(&near, Vec::new()).unwrap().into_string().unwrap();
    let mut near = std::fs::File::from(near);
    let line = format!("serial:{device}:57600");
    let mut station = Peer::new(255, 190);
    let bridge = bridge(&["--connect", &line, "--forward", &station.endpoint()]);
    bridge.line("vehicle: connecting to serial:").unwrap();
    let mut vehicle = Peer::new(1, 1);
    let frame = vehicle.heartbeat();
    // Bytes of a line come as they like; those before the line is open and raw are lost.
    let (heard, from) = loop {
        let (first, rest) = frame.split_at(7);
        near.write_all(first).unwrap();
        near.write_all(rest).unwrap();
        if let Some(found) = station.hear_within(Duration::from_millis(500), |p| p.system == 1) {
            break found;
        }
    };
    assert_eq!(*heard.raw, frame[..]);
    let mut ask = Vec::new();
    let list = PARAM_REQUEST_LIST_DATA { target_system: 1, target_component: 1 };
    station.encoder.push(&mut ask, &list);
    station.send(&ask, from);
    let (mut buffer, mut decoder) = (vec![0; 512], Decoder::of_stream());
    loop {
        let length = near.read(&mut buffer).unwrap();
        if decoder.datagram(&buffer[..length]).iter().any(Packet::is::<PARAM_REQUEST_LIST_DATA>) {
            break;
        }
    }
}

/// Report G7: on board, a station's heartbeat keeps the failsafe quiet; a companion is none.
#[test]
fn a_companion_has_the_vehicle_s_system_and_is_no_station() {
    let mut vehicle = Peer::new(9, 1);
    let endpoint = vehicle.endpoint();
    let args =
        ["param", "--connect", &endpoint, "--sysid", "9", "--role", "companion", "--timeout", "60", "list"];
    let _gcs = Program::start("gcs", &args, None).unwrap();
    let (beat, from) = vehicle.hear(Packet::is::<HEARTBEAT_DATA>);
    assert_eq!((beat.system, beat.component), (9, 191));
    assert_eq!(Heartbeat::of(&beat).unwrap().kind, MavType::MAV_TYPE_ONBOARD_CONTROLLER as u8);
    let hello = vehicle.heartbeat();
    vehicle.send(&hello, from);
    let (ask, _) = vehicle.hear(|p| !p.is::<HEARTBEAT_DATA>());
    assert_eq!((ask.system, ask.component), (9, 191));

    let args = ["param", "--connect", &endpoint, "--source-system", "7", "--source-component", "3", "list"];
    let _other = Program::start("gcs", &args, None).unwrap();
    vehicle.hear(|p| p.is::<HEARTBEAT_DATA>() && (p.system, p.component) == (7, 3));
}

/// Item 3: everybody on a network hears a broadcast endpoint, and may answer.
#[test]
fn a_broadcast_is_heard_by_whoever_listens() {
    let mut listener = Peer::new(255, 190);
    listener.socket = UdpSocket::bind("0.0.0.0:0").unwrap();
    listener.socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let port = listener.socket.local_addr().unwrap().port();
    let everybody = format!("udpbcast:127.255.255.255:{port}");
    let bridge = bridge(&["--connect", "udpin:127.0.0.1:0", "--forward", &everybody]);
    let address = listens(&bridge, "vehicle");
    bridge.line("forward: sending to udpbcast:").unwrap();
    let mut vehicle = Peer::new(1, 1);
    let frame = vehicle.heartbeat();
    vehicle.send(&frame, address);
    let (heard, from) = listener.hear(|p| p.system == 1);
    assert_eq!(*heard.raw, frame[..]);
    let answer = listener.heartbeat();
    listener.send(&answer, from);
    vehicle.hear(|p| p.system == 255 && p.component == 190);
}

/// Report G9: a host that could not be looked up at the start ended the bridge.
#[test]
fn a_host_without_an_address_is_looked_up_again_and_ends_nothing() {
    let mut station = Peer::new(255, 190);
    let args = [
        "--connect",
        "udpin:127.0.0.1:0",
        "--forward",
        "udpout:no-such-host.invalid:14550",
        &station.endpoint(),
    ];
    let bridge = bridge(&args);
    let address = listens(&bridge, "vehicle");
    bridge.logs("looking up `no-such-host.invalid`").unwrap();
    bridge.line("forward: sending to udpout:127.0.0.1").unwrap();
    let mut vehicle = Peer::new(1, 1);
    let frame = vehicle.heartbeat();
    vehicle.send(&frame, address);
    station.hear(|p| p.system == 1);
}

/// Report G13: two equal endpoints gave two equal series; HEAD was refused.
#[test]
fn two_equal_endpoints_are_two_series_and_head_is_answered() {
    let station = Peer::new(255, 190);
    let twice = station.endpoint();
    let args = ["--connect", "udpin:127.0.0.1:0", "--forward", &twice, &twice, "--metrics", "127.0.0.1:0"];
    let bridge = bridge(&args);
    let metrics = bridge.line("metrics: http://").unwrap();
    let metrics: SocketAddr = metrics.strip_suffix("/metrics").unwrap().parse().unwrap();
    let ask = |method: &str| {
        let mut stream = TcpStream::connect(metrics).unwrap();
        write!(stream, "{method} /metrics HTTP/1.1\r\n\r\n").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    };
    let text = ask("GET");
    let mut series: Vec<_> =
        text.lines().filter_map(|line| line.rsplit_once(' ')).map(|(name, _)| name).collect();
    let all = series.len();
    series.sort_unstable();
    series.dedup();
    assert_eq!(series.len(), all, "{text}");
    assert!(ask("HEAD").starts_with("HTTP/1.1 200 OK"));
}

/// Report G17, and the filters of item 3, as they are typed.
#[test]
fn an_endpoint_with_rules_gets_what_they_allow() {
    let (mut all, mut few) = (Peer::new(255, 190), Peer::new(254, 190));
    let filtered = format!("{}?drop=ATTITUDE", few.endpoint());
    let bridge = bridge(&["--connect", "udpin:127.0.0.1:0", "--forward", &filtered, &all.endpoint()]);
    let address = listens(&bridge, "vehicle");
    let mut vehicle = Peer::new(1, 1);
    for _ in 0..10 {
        let mut datagram = vehicle.heartbeat();
        vehicle.encoder.push(&mut datagram, &ATTITUDE_DATA { roll: 0.1, ..Default::default() });
        vehicle.send(&datagram, address);
    }
    let mut heard = 0;
    all.hear(|p| {
        heard += usize::from(p.is::<ATTITUDE_DATA>());
        heard == 10
    });
    few.hear(|p| {
        assert!(!p.is::<ATTITUDE_DATA>(), "a filtered message");
        p.is::<HEARTBEAT_DATA>()
    });
    assert_eq!(few.count(Packet::is::<ATTITUDE_DATA>), 0);
}
