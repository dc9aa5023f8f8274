//! A MAVLink packet, borrowed from the bytes in which it came or owned. Knows the header, and not what a
//! message means.

use std::ops::{Deref, DerefMut};
use std::sync::LazyLock;

use mavlink::{MavlinkVersion, Message, MessageData};

use super::crc::{checksum, crc_extra};
use super::dialect::MavMessage;

/// First byte of a MAVLink 1 packet.
pub(super) const MAGIC_V1: u8 = 0xFE;
/// First byte of a MAVLink 2 packet.
pub(super) const MAGIC_V2: u8 = 0xFD;
/// Incompatibility flag of a packet with a signature.
pub(super) const SIGNED: u8 = 1;
/// Bytes of a signature, behind the checksum: link, timestamp, signature.
pub const TRAILER: usize = 13;

/// What the first bytes of a packet say.
#[derive(Debug, Clone, Copy)]
pub(super) struct Header {
    /// Message id.
    pub id: u32,
    /// Incompatibility flags.
    pub flags: u8,
    /// Bytes of header and payload: the checksum follows.
    pub checked: usize,
    /// Bytes of the whole packet.
    pub whole: usize,
}

impl Header {
    /// `None` if the bytes do not begin with a whole header.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let (header, flags, id) = match *bytes {
            [MAGIC_V2, _, flags, _, _, _, _, id0, id1, id2, ..] => {
                (10, flags, u32::from_le_bytes([id0, id1, id2, 0]))
            }
            [MAGIC_V1, _, _, _, _, id, ..] => (6, 0, id.into()),
            _ => return None,
        };
        let checked = header + usize::from(bytes[1]);
        let signature = if flags & SIGNED == 0 { 0 } else { TRAILER };
        Some(Self { id, flags, checked, whole: checked + 2 + signature })
    }
}

/// A packet of either protocol version, byte for byte as it came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PacketRef<'a> {
    /// From its magic byte to its checksum or signature.
    pub raw: &'a [u8],
    /// Sender's system id.
    pub system: u8,
    /// Sender's component id.
    pub component: u8,
    /// Sender's sequence number.
    pub sequence: u8,
    /// Message id.
    pub id: u32,
    /// Whether the dialect knows the message, so that its CRC was checked.
    pub known: bool,
}

impl<'a> PacketRef<'a> {
    /// A whole packet, whose header is in `raw`.
    pub(super) fn new(raw: &'a [u8], id: u32, known: bool) -> Self {
        let at = if raw[0] == MAGIC_V2 { 4 } else { 2 };
        Self { raw, sequence: raw[at], system: raw[at + 1], component: raw[at + 2], id, known }
    }

    /// Whether it is of MAVLink 2.
    #[must_use]
    pub fn is_v2(&self) -> bool {
        self.raw[0] == MAGIC_V2
    }

    /// The payload as it came: MAVLink 2 senders cut zeros at its end.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        let from = if self.is_v2() { 10 } else { 6 };
        &self.raw[from..from + usize::from(self.raw[1])]
    }

    /// Whether it carries a signature.
    #[must_use]
    pub fn signed(&self) -> bool {
        self.is_v2() && self.raw[2] & SIGNED != 0
    }

    /// The same packet with another sequence number. `None` if its checksum cannot be made anew, because the
    /// dialect does not know the message, or if it is signed.
    #[must_use]
    pub fn with_sequence(&self, sequence: u8) -> Option<Vec<u8>> {
        let extra = crc_extra(self.id).filter(|_| self.known && !self.signed())?;
        let mut raw = self.raw.to_vec();
        raw[if self.is_v2() { 4 } else { 2 }] = sequence;
        let end = raw.len().checked_sub(2)?;
        let crc = checksum(&raw[1..end], extra).to_le_bytes();
        raw[end..].copy_from_slice(&crc);
        Some(raw)
    }

    /// System and component that the message is for; 0 is all, and so is a message without a target.
    #[must_use]
    pub fn target(&self) -> Target {
        let Some((system, component)) = target_offsets(self.id) else { return Target::default() };
        let byte = |at: usize| self.payload().get(at).copied().unwrap_or(0);
        Target { system: byte(system), component: component.map_or(0, byte) }
    }
}

/// A MAVLink 2 packet of a known message whose checksum is right.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// Sender's system id.
    pub system: u8,
    /// Sender's component id.
    pub component: u8,
    /// Sender's sequence number.
    pub sequence: u8,
    /// Message id.
    pub id: u32,
    /// The whole packet, from its magic byte to its checksum or signature.
    pub raw: Raw,
}

impl<'a> From<&'a Packet> for PacketRef<'a> {
    fn from(packet: &'a Packet) -> Self {
        let Packet { system, component, sequence, id, ref raw } = *packet;
        Self { raw, system, component, sequence, id, known: true }
    }
}

impl From<PacketRef<'_>> for Packet {
    fn from(packet: PacketRef<'_>) -> Self {
        let PacketRef { system, component, sequence, id, raw, .. } = packet;
        Self { system, component, sequence, id, raw: raw.into() }
    }
}

impl Packet {
    /// The payload as it came: zeros at its end may have been cut.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        PacketRef::from(self).payload()
    }

    /// The typed message, or `None` if the dialect has no such value.
    #[must_use]
    pub fn message(&self) -> Option<MavMessage> {
        MavMessage::parse(MavlinkVersion::V2, self.id, self.payload()).ok()
    }

    /// Whether this is a message of type `M`.
    #[must_use]
    pub fn is<M: MessageData>(&self) -> bool {
        self.id == M::ID
    }
}

/// The longest packet that is kept without an allocation: all but frames, texts and parameters' files.
const SHORT: usize = 64;

/// A packet's bytes.
#[derive(Debug, Clone)]
pub struct Raw(Kept);

#[derive(Debug, Clone)]
enum Kept {
    Short(u8, [u8; SHORT]),
    Long(Box<[u8]>),
}

impl From<&[u8]> for Raw {
    fn from(frame: &[u8]) -> Self {
        if frame.len() > SHORT {
            return Self(Kept::Long(frame.into()));
        }
        let mut bytes = [0; SHORT];
        bytes[..frame.len()].copy_from_slice(frame);
        Self(Kept::Short(frame.len() as u8, bytes))
    }
}

impl Deref for Raw {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.0 {
            Kept::Short(length, bytes) => &bytes[..usize::from(*length)],
            Kept::Long(bytes) => bytes,
        }
    }
}

impl DerefMut for Raw {
    fn deref_mut(&mut self) -> &mut [u8] {
        match &mut self.0 {
            Kept::Short(length, bytes) => &mut bytes[..usize::from(*length)],
            Kept::Long(bytes) => bytes,
        }
    }
}

impl PartialEq for Raw {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl Eq for Raw {}

/// System and component to which a message is addressed; 0 is all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Target {
    /// System id.
    pub system: u8,
    /// Component id.
    pub component: u8,
}

impl Target {
    /// Whether a component is meant.
    #[must_use]
    pub fn is(self, system: u8, component: u8) -> bool {
        (self.system == 0 || self.system == system) && (self.component == 0 || self.component == component)
    }
}

impl From<(u8, u8)> for Target {
    /// System and component.
    fn from((system, component): (u8, u8)) -> Self {
        Self { system, component }
    }
}

/// Where a message of the dialect holds its target's system, and its target's component if it has one.
#[must_use]
pub fn target_offsets(id: u32) -> Option<(usize, Option<usize>)> {
    static TABLE: LazyLock<Vec<(u32, usize, Option<usize>)>> = LazyLock::new(|| {
        let mut ids = MavMessage::all_ids().to_vec();
        ids.sort_unstable();
        ids.into_iter()
            .filter_map(|id| probe(id).map(|(system, component)| (id, system, component)))
            .collect()
    });
    let at = TABLE.binary_search_by_key(&id, |row| row.0).ok()?;
    Some((TABLE[at].1, TABLE[at].2))
}

/// The dialect's name of a message, such as `HEARTBEAT`.
#[must_use]
pub fn message_name(id: u32) -> Option<&'static str> {
    MavMessage::default_message_from_id(id).map(|message| message.message_name())
}

/// Finds the offsets by asking the dialect itself which byte of a payload comes back as the target.
fn probe(id: u32) -> Option<(usize, Option<usize>)> {
    const MARK: u8 = 0x55;
    let message = MavMessage::default_message_from_id(id)?;
    message.target_system_id()?;
    let mut payload = [0; 255];
    message.ser(MavlinkVersion::V2, &mut payload);
    let finds = |read: fn(&MavMessage) -> Option<u8>| {
        (0..payload.len()).find(|&at| {
            let mut marked = payload;
            marked[at] = MARK;
            MavMessage::parse(MavlinkVersion::V2, id, &marked).is_ok_and(|m| read(&m) == Some(MARK))
        })
    };
    Some((finds(Message::target_system_id)?, finds(Message::target_component_id)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::dialect::{
        self, COMMAND_ACK_DATA, COMMAND_LONG_DATA, HEARTBEAT_DATA, MANUAL_CONTROL_DATA,
    };
    use crate::link::encoder::Encoder;
    use crate::link::splitter::Splitter;

    #[test]
    fn messages_have_the_dialect_s_names() {
        assert_eq!([0, 109, 0xFF_FFFF].map(message_name), [Some("HEARTBEAT"), Some("RADIO_STATUS"), None]);
    }

    #[test]
    fn a_packet_with_another_number_is_what_its_sender_would_have_sent() {
        let sent = |number: u8| {
            let (mut encoder, mut all) = (Encoder::new(3, 68), Vec::new());
            for _ in 0..=number {
                all.clear();
                encoder.push(&mut all, &COMMAND_ACK_DATA { target_system: 255, ..Default::default() });
            }
            all
        };
        let old = [0xFE, 9, 7, 1, 1, 0, 0, 0, 0, 0, 2, 3, 81, 3, 3];
        let old = |number: u8| {
            let bytes = [&old[..2], &[number], &old[3..]].concat();
            [&bytes[..], &checksum(&bytes[1..], crc_extra(0).unwrap()).to_le_bytes()].concat()
        };
        for (before, after) in [(sent(200), sent(3)), (old(7), old(250))] {
            let number = if after[0] == MAGIC_V2 { 3 } else { 250 };
            let mut found = None;
            Splitter::default().split(&before, |packet| found = packet.with_sequence(number));
            assert_eq!(found, Some(after));
        }
        let mut unknown = sent(0);
        unknown[9] = 0x7F;
        Splitter::default().split(&unknown, |packet| assert_eq!(packet.with_sequence(1), None));
    }

    #[test]
    fn targets_are_found_where_the_standard_puts_them() {
        assert_eq!(target_offsets(COMMAND_LONG_DATA::ID), Some((30, Some(31))));
        assert_eq!(target_offsets(COMMAND_ACK_DATA::ID), Some((8, Some(9))));
        assert_eq!(target_offsets(dialect::SET_POSITION_TARGET_LOCAL_NED_DATA::ID), Some((50, Some(51))));
        // SET_MODE, which the dialect calls deprecated.
        assert_eq!(target_offsets(11), Some((4, None)));
        assert_eq!(target_offsets(dialect::PARAM_SET_DATA::ID), Some((4, Some(5))));
        assert_eq!(target_offsets(MANUAL_CONTROL_DATA::ID), Some((10, None)));
        assert_eq!(target_offsets(dialect::TIMESYNC_DATA::ID), Some((16, Some(17))));
        assert_eq!(target_offsets(HEARTBEAT_DATA::ID), None);
        let addressed = MavMessage::all_ids().iter().filter(|&&id| target_offsets(id).is_some()).count();
        assert!(addressed > 60, "{addressed}");
    }
}
