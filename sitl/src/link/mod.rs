//! Bytes: MAVLink 2 in datagrams, for the vehicle's side and for the ground station's.
//!
//! The only place that names the `mavlink` crate. Knows no physics; sockets and their clock are in
//! [`links`] alone. What a packet from the network contains is data:
//! a bad one is counted ([`splitter::Counts`]) and never an error.
//!
//! | module | what it is |
//! |---|---|
//! | [`boot_time`] | stamps that begin at 0 again |
//! | [`crc`] | the checksum of frames |
//! | [`packet`] | a packet, borrowed or owned; its header |
//! | [`splitter`] | bytes to packets, uncopied, through garbage, bad CRCs and packets cut in two |
//! | [`decoder`] | the same, for who reads the packets and keeps them |
//! | [`encoder`] | typed messages to frames with contiguous sequence numbers |
//! | [`messages`] | payloads by named fields: where in a message a field is |
//! | [`wire`] | the table "our message, theirs", both directions |
//! | [`image`] | a frame as PNG over the image transmission protocol |
//! | [`latents`] | the latents of a frame in place of its picture |
//! | [`endpoint`] | `udpin:HOST:PORT`, `udpout:`, `udpbcast:`, `tcpin:`, `tcpout:`, `serial:DEVICE:BAUD` |
//! | [`links`] | several endpoints at once, as one source and sink of bytes |
//! | [`param_file`] | `.param` files |
//! | [`sequence`] | what sequence numbers tell: missing, late |
//! | [`signing`] | signatures, the key and its file |
//! | [`tlog`] | the log that every MAVLink tool reads |

pub mod boot_time;
pub mod crc;
pub mod decoder;
pub mod encoder;
pub mod endpoint;
pub mod image;
pub mod latents;
pub mod links;
pub mod messages;
pub mod packet;
pub mod param_file;
pub mod sequence;
pub mod signing;
pub mod splitter;
pub mod tlog;
pub mod wire;

use std::net::SocketAddr;

/// What the dialect knows of a message's type: its id, its length.
pub use mavlink::MessageData;
/// The dialect that both programs speak.
pub use mavlink::dialects::common as dialect;

/// Somebody at the other end: an address, behind one of our endpoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerId {
    /// Which of our endpoints, in the order in which they were named.
    pub endpoint: usize,
    /// Its address.
    pub address: SocketAddr,
}

impl From<SocketAddr> for PeerId {
    /// An address behind the only endpoint.
    fn from(address: SocketAddr) -> Self {
        Self { endpoint: 0, address }
    }
}

impl std::fmt::Display for PeerId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.address.fmt(f)
    }
}

/// The name of a message, if the dialect has it: `HEARTBEAT` for 0.
#[must_use]
pub fn message_name(id: u32) -> Option<&'static str> {
    use mavlink::Message;
    dialect::MavMessage::default_message_from_id(id).map(|message| message.message_name())
}

/// The id of a message by its name or by its number.
#[must_use]
pub fn message_id(text: &str) -> Option<u32> {
    use mavlink::Message;
    let named = || dialect::MavMessage::message_id_from_name(&text.to_ascii_uppercase());
    text.parse().ok().filter(|id| *id < 1 << 24).or_else(named)
}

/// Component id of the autopilot (MAV_COMP_ID_AUTOPILOT1).
pub const AUTOPILOT: u8 = 1;
/// Component id of the radio (MAV_COMP_ID_TELEMETRY_RADIO).
pub const RADIO: u8 = 68;
/// Component id of the camera (MAV_COMP_ID_CAMERA).
pub const CAMERA: u8 = 100;
/// Component id of a satellite receiver (MAV_COMP_ID_GPS).
pub const GPS: u8 = 220;
/// Component id of a router between UDP links (MAV_COMP_ID_UDP_BRIDGE).
pub const BRIDGE: u8 = 240;
/// Component id of a companion computer (MAV_COMP_ID_ONBOARD_COMPUTER).
pub const COMPANION: u8 = 191;
/// System id of the ground station.
pub const STATION_SYSTEM: u8 = 255;
/// Component id of the ground station (MAV_COMP_ID_MISSIONPLANNER, as ground stations do).
pub const STATION_COMPONENT: u8 = 190;
