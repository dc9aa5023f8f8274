//! `gcs bridge` and `--forward` of a flight as tools meet them: the real programs, over UDP and TCP.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::path::Path;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavFrame, MavMessage, POSITION_TARGET_LOCAL_NED_DATA,
    PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::messages::telemetry::PositionTargetLocalNed;
use crpl_sitl::link::packet::Packet;
use tests::program::{self, PATIENCE, Program};
use tests::python;

/// `gcs bridge` between the vehicle at `master` and one listening `out`; gives the port of that, and of the metrics.
fn bridge(master: &str, out: &str, tlog: &Path) -> (Program, SocketAddr, SocketAddr) {
    let args = ["bridge", "--connect", master, "--forward", out, "--metrics", "127.0.0.1:0", "--every", "0"];
    let log = ["--tlog", tlog.to_str().unwrap()];
    let bridge = Program::start("gcs", &[&args[..], &log].concat(), None).unwrap();
    let out = bridge.line("forward: listening on ").unwrap();
    let (_, address) = out.split_once(':').unwrap();
    let metrics = bridge.line("metrics: http://").unwrap();
    let metrics = metrics.strip_suffix("/metrics").unwrap().parse().unwrap();
    (bridge, address.parse().unwrap(), metrics)
}

/// The value of a metric for the first link whose name begins with `link`.
fn metric(address: SocketAddr, name: &str, link: &str) -> f64 {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: bridge\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let start = format!("mavlink_bridge_{name}{{link=\"{link}");
    let line = text.lines().find(|line| line.starts_with(&start));
    let line = line.unwrap_or_else(|| panic!("no {start} in\n{text}"));
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

fn flown(endpoint: &str, folder: &Path) -> String {
    let args = ["fly", "--connect", endpoint, "--scenario", "demo", "--out"];
    program::run("gcs", &[&args[..], &[folder.to_str().unwrap()]].concat()).unwrap().good().unwrap();
    std::fs::read_to_string(folder.join("record.jsonl")).unwrap()
}

fn vehicle() -> (Program, SocketAddr) {
    let args = ["--pace", "lockstep", "--scenario", "demo", "--seed", "5", "--ticks", "100"];
    program::sitl(&args).unwrap()
}

/// A router in between changes no byte of a flight, loses nothing, and logs it for everybody's tools.
#[test]
fn a_flight_through_the_bridge_is_the_flight_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_direct, address) = vehicle();
    let expected = flown(&format!("udpout:{address}"), &folder.path().join("direct"));
    for scheme in ["udp", "tcp"] {
        let (sitl, address) = vehicle();
        let tlog = folder.path().join(format!("{scheme}.tlog"));
        let master = format!("udpout:{address}");
        let (bridge, out, metrics) = bridge(&master, &format!("{scheme}in:127.0.0.1:0"), &tlog);
        let record = flown(&format!("{scheme}out:{out}"), &folder.path().join(scheme));
        assert_eq!(record, expected, "over {scheme}");
        sitl.wait().unwrap().good().unwrap();
        assert!(metric(metrics, "received_frames_total", &master) > 1000.0);
        // The system may let one datagram overtake another, but it loses none.
        let missing = metric(metrics, "missing_frames_total", &master);
        assert_eq!(missing, metric(metrics, "late_frames_total", &master));
        assert_eq!(metric(metrics, "duplicate_frames_total", &master), 0.0);
        // Every command of the flight was answered through the bridge.
        assert!(metric(metrics, "round_trip_seconds_count", &master) >= 100.0);
        bridge.interrupt().unwrap();
        let table = bridge.wait().unwrap().good().unwrap();
        assert!(table.lines().any(|line| line.starts_with(&master) && line.contains("1/1 1/68")), "{table}");
        let dump = python::mavlogdump(&tlog).unwrap();
        for message in ["LOCAL_POSITION_NED", "SET_POSITION_TARGET_LOCAL_NED", "COMMAND_ACK"] {
            assert!(dump.contains(&format!(" {message} ")), "no {message} in the tlog");
        }
    }
}

/// Somebody else at the vehicle, through a flight's `--forward`.
struct Operator {
    socket: UdpSocket,
    flight: Option<SocketAddr>,
    decoder: Decoder,
    encoder: Encoder,
}

impl Operator {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Self { socket, flight: None, decoder: Decoder::default(), encoder: Encoder::new(254, 190) }
    }

    fn endpoint(&self) -> String {
        format!("udpout:{}", self.socket.local_addr().unwrap())
    }

    /// The first packet for which `wanted` holds.
    fn hear(&mut self, mut wanted: impl FnMut(&Packet) -> bool) -> Packet {
        let mut buffer = vec![0; 65_536];
        loop {
            let (length, from) = self.socket.recv_from(&mut buffer).unwrap();
            self.flight = Some(from);
            if let Some(packet) = self.decoder.datagram(&buffer[..length]).into_iter().find(&mut wanted) {
                return packet;
            }
        }
    }

    fn say(&mut self, fill: impl FnOnce(&mut Encoder, &mut Vec<u8>)) {
        let mut datagram = Vec::new();
        fill(&mut self.encoder, &mut datagram);
        self.socket.send_to(&datagram, self.flight.unwrap()).unwrap();
    }
}

/// The stated rule: setpoints of others are kept back; a mode change that the vehicle accepts ends
/// CRPL's sending, and the operator's messages still pass.
#[test]
fn an_operator_watches_a_flight_and_takes_it_over() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--scenario", "demo"]).unwrap();
    let mut operator = Operator::new();
    let gcs = Program::start(
        "gcs",
        &[
            "fly",
            "--connect",
            &format!("udpout:{address}"),
            "--scenario",
            "demo",
            "--forward",
            &operator.endpoint(),
            "--out",
            folder.path().to_str().unwrap(),
        ],
        None,
    )
    .unwrap();
    // Watches: the vehicle flies what CRPL sends, so the stamp of its echo moves on.
    let stamp = |packet: &Packet| PositionTargetLocalNed::of(packet).unwrap().time_boot_ms;
    let first = stamp(&operator.hear(Packet::is::<POSITION_TARGET_LOCAL_NED_DATA>));
    operator.hear(|p| p.is::<POSITION_TARGET_LOCAL_NED_DATA>() && stamp(p) > first + 400);
    operator.say(|encoder, out| {
        encoder.push(out, &HEARTBEAT_DATA::default());
        let away = SET_POSITION_TARGET_LOCAL_NED_DATA { afx: 5.0, target_system: 1, ..Default::default() };
        encoder.push(out, &away);
    });
    let mode = COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_DO_SET_MODE,
        param1: 1.0,
        param2: 4.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    operator.say(|encoder, out| encoder.push(out, &mode));
    let ack = operator.hear(|p| CommandAck::of(p).is_some_and(|ack| ack.command == 176));
    assert_eq!(CommandAck::of(&ack).unwrap().result, 0, "accepted");
    let said = operator.hear(|p| p.is::<STATUSTEXT_DATA>() && p.system == 255);
    let Some(MavMessage::STATUSTEXT(said)) = said.message() else { panic!("a text") };
    assert!(said.text.to_str().unwrap().contains("Operator has control"), "{:?}", said.text);
    // What was on its way arrives; then the vehicle flies the last command on, and hears no new one.
    let held: Vec<_> =
        (0..6).map(|_| stamp(&operator.hear(Packet::is::<POSITION_TARGET_LOCAL_NED_DATA>))).collect();
    assert!(held[2..].windows(2).all(|pair| pair[0] == pair[1]), "CRPL sends on: {held:?}");
    // The operator's own setpoints now pass; the radio may lose one, so he repeats them.
    let west = SET_POSITION_TARGET_LOCAL_NED_DATA {
        afy: -1.25,
        type_mask: PositionTargetTypemask::from_bits_retain(3135),
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    let flown = (0..50).any(|_| {
        operator.say(|encoder, out| encoder.push(out, &west));
        let echo = operator.hear(Packet::is::<POSITION_TARGET_LOCAL_NED_DATA>);
        PositionTargetLocalNed::of(&echo).unwrap().acceleration[1] == -1.25
    });
    assert!(flown, "the operator is not heard");
    gcs.interrupt().unwrap();
    let ended = gcs.wait().unwrap();
    assert_eq!(ended.status.code(), Some(4), "{}", ended.stderr);
    let printed = ended.stdout;
    assert!(printed.contains("taken over: the operator has taken over"), "{printed}");
    assert!(printed.contains("1 setpoints of other stations not forwarded"), "{printed}");
    let run = std::fs::read_to_string(folder.path().join("run.json")).unwrap();
    let run: serde_json::Value = serde_json::from_str(&run).unwrap();
    assert_eq!(run["summary"]["taken_over"], true, "{run}");
}

#[test]
fn what_cannot_be_opened_is_said_in_one_line() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let taken = format!("udpin:{}", socket.local_addr().unwrap());
    for (args, word) in [
        (vec!["--connect", "udpout:127.0.0.1:9", "--forward", taken.as_str()], "in use"),
        (vec!["--connect", "can:can0:9", "--forward", "udpin:127.0.0.1:0"], "only udpin"),
        (vec!["--connect", "udpin:127.0.0.1:0", "--forward", "udpin:127.0.0.1:0?speed=3"], "no rule"),
        (vec!["--connect", "udpout:127.0.0.1:9"], "--forward"),
        (
            vec!["--connect", "udpin:127.0.0.1:0", "--forward", "udpin:127.0.0.1:0", "--tlog", "/no/where"],
            "/no/where",
        ),
    ] {
        let finished = program::run("gcs", &[&["bridge"][..], &args].concat()).unwrap();
        let lines: Vec<_> = finished.stderr.lines().collect();
        assert!(!finished.status.success() && lines.len() == 1 && lines[0].contains(word), "{lines:?}");
    }
}
