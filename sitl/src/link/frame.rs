//! Bytes to frames without copying: both protocol versions, known messages and unknown ones, byte for
//! byte as they came. For whoever passes frames on; [`super::decoder`] is for whoever reads them.
//!
//! A frame of a known message is checked by its CRC. One of an unknown message cannot be, and is taken
//! for a frame if it ends where the bytes do or where another frame begins. Junk between frames is
//! skipped and counted and never hides a good frame; a frame cut in two is joined with what comes next.

use std::sync::LazyLock;

use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::crc::crc_extra;
use super::decoder::Counts;
use super::dialect::MavMessage;
use super::messages::Target;

const MAGIC_V1: u8 = 0xFE;
const MAGIC_V2: u8 = 0xFD;
const SIGNED: u8 = 1;
/// Longest frame: header, payload, checksum, signature.
const LONGEST: usize = 10 + 255 + 2 + 13;

/// One frame as it came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
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

impl<'a> Frame<'a> {
    /// The payload as it came: MAVLink 2 senders cut zeros at its end.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        let from = if self.raw[0] == MAGIC_V2 { 10 } else { 6 };
        &self.raw[from..from + usize::from(self.raw[1])]
    }

    /// Whether it carries a signature.
    #[must_use]
    pub fn signed(&self) -> bool {
        self.raw[0] == MAGIC_V2 && self.raw[2] & SIGNED != 0
    }

    /// System and component that the message is for; 0 is all, and so is a message without a target.
    #[must_use]
    pub fn target(&self) -> Target {
        let Some((system, component)) = target_offsets(self.id) else { return Target::default() };
        let byte = |at: usize| self.payload().get(at).copied().unwrap_or(0);
        Target { system: byte(system), component: component.map_or(0, byte) }
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

/// Splits what one peer sends, datagrams or a stream, into frames.
#[derive(Debug, Clone, Default)]
pub struct Splitter {
    /// A frame's beginning at the end of what came last.
    tail: Vec<u8>,
    counts: Counts,
}

/// What stands at a position.
enum Found {
    Frame {
        length: usize,
        known: bool,
    },
    /// A frame that may go on.
    Cut,
    BadCrc(usize),
    Garbage,
}

impl Splitter {
    /// What arrived so far. `frames` and `mavlink1` count what was handed on, `unknown` those among
    /// them that could not be checked.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Hands each frame in `bytes` to `each`, in order.
    pub fn split(&mut self, bytes: &[u8], mut each: impl FnMut(Frame<'_>)) {
        if self.tail.is_empty() {
            self.tail = self.scan(bytes, &mut each).to_vec();
        } else {
            let mut joined = std::mem::take(&mut self.tail);
            joined.extend_from_slice(bytes);
            self.tail = self.scan(&joined, &mut each).to_vec();
        }
    }

    /// Returns the beginning of a frame at the end of `bytes`.
    fn scan<'a>(&mut self, bytes: &'a [u8], each: &mut impl FnMut(Frame<'_>)) -> &'a [u8] {
        let (mut at, mut blamed, mut cut) = (0, 0, None);
        while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
            match find(rest) {
                Found::Frame { length, known } => {
                    self.count(rest[0], known);
                    each(frame(&rest[..length], known));
                    at += length;
                    // What seemed cut was followed by a frame: it will not go on.
                    self.counts.truncated += u64::from(cut.take().is_some());
                    continue;
                }
                Found::BadCrc(length) if at >= blamed => {
                    self.counts.bad_crc += 1;
                    blamed = at + length;
                }
                Found::Cut if at >= blamed && cut.is_none() => cut = Some(at),
                Found::Garbage if at >= blamed && cut.is_none() => self.counts.garbage_bytes += 1,
                _ => {}
            }
            at += 1;
        }
        let tail = &bytes[cut.unwrap_or(bytes.len())..];
        debug_assert!(tail.len() < LONGEST, "a whole frame is never cut");
        tail
    }

    fn count(&mut self, magic: u8, known: bool) {
        if magic == MAGIC_V1 {
            self.counts.mavlink1 += 1;
        } else {
            self.counts.frames += 1;
        }
        self.counts.unknown += u64::from(!known);
    }
}

fn frame(raw: &[u8], known: bool) -> Frame<'_> {
    if raw[0] == MAGIC_V2 {
        let id = u32::from_le_bytes([raw[7], raw[8], raw[9], 0]);
        Frame { raw, sequence: raw[4], system: raw[5], component: raw[6], id, known }
    } else {
        Frame { raw, sequence: raw[2], system: raw[3], component: raw[4], id: raw[5].into(), known }
    }
}

fn find(rest: &[u8]) -> Found {
    let (header, signature, id) = match *rest {
        [MAGIC_V2, _, flags, _, _, _, _, id0, id1, id2, ..] => {
            // Flags that nobody has defined yet change the layout: such a frame has no known end.
            if flags & !SIGNED != 0 {
                return Found::Garbage;
            }
            (10, if flags & SIGNED == 0 { 0 } else { 13 }, u32::from_le_bytes([id0, id1, id2, 0]))
        }
        [MAGIC_V1, _, _, _, _, id, ..] => (6, 0, id.into()),
        [MAGIC_V1 | MAGIC_V2, ..] => return Found::Cut,
        _ => return Found::Garbage,
    };
    let checked = header + usize::from(rest[1]);
    let whole = checked + 2 + signature;
    if rest.len() < whole {
        return Found::Cut;
    }
    let Some(extra) = crc_extra(id) else {
        let ends_well = matches!(rest.get(whole), None | Some(&(MAGIC_V1 | MAGIC_V2)));
        return if ends_well { Found::Frame { length: whole, known: false } } else { Found::Garbage };
    };
    if rest[checked..checked + 2] == calculate_crc(&rest[1..checked], extra).to_le_bytes() {
        Found::Frame { length: whole, known: true }
    } else {
        Found::BadCrc(whole)
    }
}

#[cfg(test)]
mod tests {
    use mavlink::MessageData;
    use proptest::prelude::*;

    use super::*;
    use crate::link::dialect::{
        self, COMMAND_ACK_DATA, COMMAND_LONG_DATA, HEARTBEAT_DATA, MANUAL_CONTROL_DATA,
    };
    use crate::link::encoder::Encoder;

    fn heartbeat(sequence: u8) -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = Encoder::new(7, 9);
        for _ in 0..=sequence {
            out.clear();
            encoder.push(&mut out, &HEARTBEAT_DATA { custom_mode: 0xFDFE, ..Default::default() });
        }
        out
    }

    /// A frame whose message no dialect knows.
    fn unknown() -> Vec<u8> {
        let mut frame = heartbeat(0);
        frame[9] = 0x7F;
        frame
    }

    fn old() -> Vec<u8> {
        let mut frame = vec![0xFE, 9, 5, 3, 4, 0, 0, 0, 0, 0, 2, 3, 81, 3, 3];
        let crc = calculate_crc(&frame[1..], HEARTBEAT_DATA::EXTRA_CRC);
        frame.extend(crc.to_le_bytes());
        frame
    }

    fn split(splitter: &mut Splitter, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut frames = Vec::new();
        splitter.split(bytes, |frame| frames.push(frame.raw.to_vec()));
        frames
    }

    #[test]
    fn both_versions_and_unknown_messages_come_out_byte_for_byte() {
        let frames = [heartbeat(0), old(), unknown(), heartbeat(3)];
        let mut splitter = Splitter::default();
        assert_eq!(split(&mut splitter, &frames.concat()), frames);
        let counts = splitter.counts();
        assert_eq!((counts.frames, counts.mavlink1, counts.unknown), (3, 1, 1));
        let mut seen = Vec::new();
        splitter.split(&old(), |f| seen.push((f.system, f.component, f.sequence, f.id)));
        assert_eq!(seen, [(3, 4, 5, 0)]);
    }

    #[test]
    fn a_bad_checksum_is_counted_and_not_handed_on() {
        let mut broken = heartbeat(0);
        broken[12] ^= 1;
        let mut splitter = Splitter::default();
        assert_eq!(split(&mut splitter, &[broken, heartbeat(1)].concat()), [heartbeat(1)]);
        assert_eq!(splitter.counts().bad_crc, 1);
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

    proptest! {
        #[test]
        fn however_a_stream_is_cut_its_frames_come_out(cuts in prop::collection::vec(1usize..40, 1..30)) {
            let frames: Vec<_> = (0..20).map(|k| if k % 3 == 0 { old() } else { heartbeat(k) }).collect();
            let stream = frames.concat();
            let (mut splitter, mut out, mut rest) = (Splitter::default(), Vec::new(), &stream[..]);
            for cut in cuts.iter().cycle() {
                if rest.is_empty() {
                    break;
                }
                let (now, later) = rest.split_at(rest.len().min(*cut));
                out.extend(split(&mut splitter, now));
                rest = later;
            }
            prop_assert_eq!(out, frames);
        }

        #[test]
        fn junk_never_panics_and_hides_no_frame_for_ever(
            junk in prop::collection::vec(prop::collection::vec(
                prop_oneof![Just(0xFDu8), Just(0xFE), Just(0), any::<u8>()], 0..300), 1..6)
        ) {
            let mut splitter = Splitter::default();
            for junk in &junk {
                splitter.split(junk, |_| {});
            }
            // Whatever was begun is over after the longest frame.
            let good = heartbeat(1);
            let after: usize = (0..20).map(|_| split(&mut splitter, &good).len()).sum();
            prop_assert!(after >= 5, "{after}");
        }
    }
}
