//! Datagrams to MAVLink 2 packets. Knows frames and checksums, not what a message means.
//!
//! Whatever stands between two good frames is skipped and counted, byte by byte if need be, so junk
//! never hides or delays the good frame behind it. A frame cut in two by the sender is joined with
//! the next datagram, as autopilots do. MAVLink 1 frames are recognised, counted and left alone.
//! Signatures are stepped over, not checked: [`super::signing`] does that.

use std::borrow::Cow;
use std::ops::{Deref, DerefMut};

use mavlink::{Message, MessageData};

use super::crc::{checksum, crc_extra};
use super::dialect::MavMessage;
use super::frame::Frame;

const MAGIC_V1: u8 = 0xFE;
const MAGIC_V2: u8 = 0xFD;
/// Incompatibility flag of a frame with a signature.
pub(super) const SIGNED: u8 = 1;

/// A frame whose checksum is right.
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
    /// The whole frame, from its magic byte to its checksum or signature.
    pub raw: Raw,
}

/// The longest frame that is kept without an allocation: all but pictures, texts and parameters' files.
const SHORT: usize = 64;

/// A frame's bytes.
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

impl Packet {
    /// The payload as it came: zeros at its end may have been cut.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        let length = usize::from(self.raw[1]);
        &self.raw[10..10 + length]
    }

    /// The typed message, or `None` if the dialect has no such value.
    #[must_use]
    pub fn message(&self) -> Option<MavMessage> {
        MavMessage::parse(mavlink::MavlinkVersion::V2, self.id, self.payload()).ok()
    }

    /// Whether this is a message of type `M`.
    #[must_use]
    pub fn is<M: MessageData>(&self) -> bool {
        self.id == M::ID
    }
}

impl<'a> From<&'a Packet> for Frame<'a> {
    fn from(packet: &'a Packet) -> Self {
        let Packet { system, component, sequence, id, ref raw } = *packet;
        Self { raw, system, component, sequence, id, known: true }
    }
}

/// What arrived, good and bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Good frames.
    pub frames: u64,
    /// Frames of a known message with a wrong checksum.
    pub bad_crc: u64,
    /// Frames that ended too early and were not continued.
    pub truncated: u64,
    /// Frames of a message that the dialect does not know.
    pub unknown: u64,
    /// MAVLink 1 frames.
    pub mavlink1: u64,
    /// Frames with incompatibility flags that we do not understand.
    pub incompatible: u64,
    /// Bytes between frames.
    pub garbage_bytes: u64,
}

impl Counts {
    /// The sum of both.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            bad_crc: self.bad_crc + other.bad_crc,
            truncated: self.truncated + other.truncated,
            unknown: self.unknown + other.unknown,
            mavlink1: self.mavlink1 + other.mavlink1,
            incompatible: self.incompatible + other.incompatible,
            garbage_bytes: self.garbage_bytes + other.garbage_bytes,
        }
    }
}

impl std::fmt::Display for Counts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} frames; {} bad CRC, {} truncated, {} unknown, {} MAVLink 1, {} incompatible, {} bytes of garbage",
            self.frames,
            self.bad_crc,
            self.truncated,
            self.unknown,
            self.mavlink1,
            self.incompatible,
            self.garbage_bytes
        )
    }
}

/// Reads one peer's datagrams.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    /// A frame's beginning at the end of the last datagram.
    tail: Vec<u8>,
    /// Whether the bytes are a stream's: a frame may come in any number of parts.
    stream: bool,
    counts: Counts,
}

/// What stands at a position of the buffer.
enum Found {
    Good(usize),
    /// A good MAVLink 1 frame.
    Old(usize),
    /// Of no use to us, and perhaps not even a frame, over this length.
    Bad(usize, fn(&mut Counts)),
    /// A frame that may go on in the next datagram.
    Cut,
    Garbage,
}

impl Decoder {
    /// Reads a stream, such as TCP's, which cuts its bytes anywhere.
    #[must_use]
    pub fn of_stream() -> Self {
        Self { stream: true, ..Self::default() }
    }

    /// What arrived so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// The good frames of a datagram, or of a part of a stream, in order.
    pub fn datagram(&mut self, bytes: &[u8]) -> Vec<Packet> {
        let mut packets = Vec::new();
        self.datagram_into(bytes, &mut packets);
        packets
    }

    /// The same, appended to `packets`, whose memory can then be used again.
    pub fn datagram_into(&mut self, bytes: &[u8], packets: &mut Vec<Packet>) {
        let tail = std::mem::take(&mut self.tail);
        let joined = !tail.is_empty();
        let buffer = if joined { Cow::Owned([&tail, bytes].concat()) } else { Cow::Borrowed(bytes) };
        let (mut at, mut blamed, mut cut) = (0, 0, None);
        while at < buffer.len() {
            let rest = &buffer[at..];
            match find(rest) {
                Found::Good(length) => {
                    self.counts.frames += 1;
                    packets.push(packet(&rest[..length]));
                    at += length;
                    cut = self.truncated(cut);
                    continue;
                }
                Found::Old(length) => {
                    self.counts.mavlink1 += 1;
                    at += length;
                    cut = self.truncated(cut);
                    continue;
                }
                Found::Bad(length, count) if at >= blamed => {
                    count(&mut self.counts);
                    blamed = at + length;
                }
                Found::Cut if at >= blamed && cut.is_none() => cut = Some(at),
                Found::Garbage if at >= blamed && cut.is_none() => self.counts.garbage_bytes += 1,
                _ => {}
            }
            at += 1;
        }
        // A frame cut off twice, by two datagrams, will not be mended by a third.
        match cut {
            Some(start) if self.stream || !(joined && start == 0) => self.tail = buffer[start..].to_vec(),
            _ => {
                self.truncated(cut);
            }
        }
    }

    /// A frame that seemed cut was followed by something good: it will not go on.
    fn truncated(&mut self, cut: Option<usize>) -> Option<usize> {
        self.counts.truncated += u64::from(cut.is_some());
        None
    }
}

fn find(rest: &[u8]) -> Found {
    match rest[0] {
        MAGIC_V2 => find_v2(rest),
        MAGIC_V1 => find_v1(rest),
        _ => Found::Garbage,
    }
}

fn find_v2(rest: &[u8]) -> Found {
    let [_, length, incompatible, _, _, _, _, id0, id1, id2, ..] = *rest else { return Found::Cut };
    let signature = if incompatible & SIGNED == 0 { 0 } else { 13 };
    let checked = 10 + usize::from(length);
    let whole = checked + 2 + signature;
    if rest.len() < whole {
        return Found::Cut;
    }
    // No checksum tells a frame of these two kinds from junk. It is counted if it ends where
    // something begins, and searched for good frames all the same.
    let ends_well = matches!(rest.get(whole), None | Some(&(MAGIC_V1 | MAGIC_V2)));
    if incompatible & !SIGNED != 0 {
        return if ends_well { Found::Bad(whole, |c| c.incompatible += 1) } else { Found::Garbage };
    }
    let id = u32::from_le_bytes([id0, id1, id2, 0]);
    let Some(extra) = crc_extra(id) else {
        return if ends_well { Found::Bad(whole, |c| c.unknown += 1) } else { Found::Garbage };
    };
    let sum = u16::from_le_bytes([rest[checked], rest[checked + 1]]);
    if sum == checksum(&rest[1..checked], extra) {
        Found::Good(whole)
    } else {
        Found::Bad(whole, |c| c.bad_crc += 1)
    }
}

fn find_v1(rest: &[u8]) -> Found {
    let [_, length, _, _, _, id, ..] = *rest else { return Found::Garbage };
    let checked = 6 + usize::from(length);
    let (Some(extra), Some(sum)) = (crc_extra(id.into()), rest.get(checked..checked + 2)) else {
        return Found::Garbage;
    };
    if sum == checksum(&rest[1..checked], extra).to_le_bytes() {
        Found::Old(checked + 2)
    } else {
        Found::Garbage
    }
}

fn packet(raw: &[u8]) -> Packet {
    Packet {
        sequence: raw[4],
        system: raw[5],
        component: raw[6],
        id: u32::from_le_bytes([raw[7], raw[8], raw[9], 0]),
        raw: raw.into(),
    }
}

#[cfg(test)]
mod tests {
    use mavlink::calculate_crc;
    use proptest::prelude::*;

    use super::*;
    use crate::link::dialect;
    use crate::link::encoder::Encoder;

    fn heartbeat(encoder: &mut Encoder) -> Vec<u8> {
        let mut out = Vec::new();
        encoder.push(&mut out, &dialect::HEARTBEAT_DATA { custom_mode: 0xFDFE, ..Default::default() });
        out
    }

    fn sequences(packets: &[Packet]) -> Vec<u8> {
        packets.iter().map(|p| p.sequence).collect()
    }

    #[test]
    fn good_frames_survive_what_stands_between_them() {
        let mut encoder = Encoder::new(1, 1);
        let mut broken = heartbeat(&mut Encoder::new(1, 1));
        broken[12] ^= 1;
        let mut unknown = heartbeat(&mut Encoder::new(1, 1));
        unknown[9] = 7;
        let mut incompatible = heartbeat(&mut Encoder::new(1, 1));
        incompatible[2] = 2;
        let old = [0xFE, 9, 0, 1, 1, 0, 0, 0, 0, 0, 2, 3, 81, 3, 3];
        let crc = calculate_crc(&old[1..], crc_extra(0).unwrap()).to_le_bytes();
        let mut bytes = b"junk".to_vec();
        for part in [&broken, &unknown, &incompatible, &[&old[..], &crc].concat()] {
            bytes.extend(heartbeat(&mut encoder));
            bytes.extend_from_slice(part);
        }
        bytes.extend(heartbeat(&mut encoder));
        let mut decoder = Decoder::default();
        assert_eq!(sequences(&decoder.datagram(&bytes)), [0, 1, 2, 3, 4]);
        let expected = Counts {
            frames: 5,
            bad_crc: 1,
            unknown: 1,
            incompatible: 1,
            mavlink1: 1,
            garbage_bytes: 4,
            ..Counts::default()
        };
        assert_eq!(decoder.counts(), expected);
    }

    #[test]
    fn a_frame_cut_in_two_is_joined_and_one_cut_for_good_hides_nothing() {
        let mut encoder = Encoder::new(1, 1);
        let (first, second) = (heartbeat(&mut encoder), heartbeat(&mut encoder));
        let mut decoder = Decoder::default();
        assert!(decoder.datagram(&first[..9]).is_empty());
        assert_eq!(sequences(&decoder.datagram(&first[9..])), [0]);
        assert!(decoder.datagram(&first[..15]).is_empty());
        assert_eq!(sequences(&decoder.datagram(&second)), [1]);
        assert_eq!(sequences(&decoder.datagram(&second)), [1]);
        assert_eq!(decoder.counts().frames, 3);
        assert!(decoder.counts().truncated + decoder.counts().bad_crc >= 1, "{}", decoder.counts());
    }

    #[test]
    fn a_stream_is_cut_anywhere() {
        let (mut encoder, mut bytes) = (Encoder::new(1, 1), Vec::new());
        for _ in 0..20 {
            bytes.extend(heartbeat(&mut encoder));
        }
        for part in 1..40 {
            let mut decoder = Decoder::of_stream();
            let packets: Vec<Packet> = bytes.chunks(part).flat_map(|part| decoder.datagram(part)).collect();
            assert_eq!(sequences(&packets), (0..20).collect::<Vec<u8>>(), "parts of {part}");
            assert_eq!(decoder.counts(), Counts { frames: 20, ..Counts::default() });
        }
    }

    #[test]
    fn a_signature_is_stepped_over() {
        let mut frame = heartbeat(&mut Encoder::new(1, 1));
        let checked = frame.len() - 2;
        frame[2] = SIGNED;
        let crc = calculate_crc(&frame[1..checked], crc_extra(0).unwrap());
        frame[checked..].copy_from_slice(&crc.to_le_bytes());
        frame.extend([9; 13]);
        frame.extend(heartbeat(&mut Encoder::new(2, 1)));
        assert_eq!(Decoder::default().datagram(&frame).len(), 2);
    }

    proptest! {
        #[test]
        fn junk_never_panics(
            junk in prop::collection::vec(prop::collection::vec(
                prop_oneof![Just(0xFDu8), Just(0xFE), Just(0), any::<u8>()], 0..300), 1..6)
        ) {
            let mut decoder = Decoder::default();
            for junk in &junk {
                decoder.datagram(junk);
            }
        }

        // Junk that begins like a frame may, by a chance of 1 in 65,536, have its CRC, too, and is a
        // frame then; so what hides nothing for certain is junk with one beginning, whose length
        // byte says that it goes on beyond the good frame or ends where nothing fits.
        #[test]
        fn junk_never_hides_a_good_frame(
            junk in prop::collection::vec((
                prop::collection::vec(0u8..0xFD, 0..300), any::<bool>()), 1..6)
        ) {
            let mut encoder = Encoder::new(1, 1);
            let mut decoder = Decoder::default();
            for (k, (junk, begins)) in junk.iter().enumerate() {
                let mut bytes = junk.clone();
                if *begins {
                    bytes.extend([0xFD, 0xFF, 0, 0]);
                }
                bytes.extend(heartbeat(&mut encoder));
                let found = decoder.datagram(&bytes);
                prop_assert!(found.iter().any(|p| p.sequence == k as u8 && p.is::<dialect::HEARTBEAT_DATA>()));
            }
        }
    }
}
