//! Bytes to packets without copying: datagrams or a stream, through garbage, bad checksums and packets cut
//! in two.
//!
//! Whatever stands between two good packets is skipped and counted, byte by byte if need be, so junk never
//! hides or delays the good packet behind it. A packet cut in two is joined with what comes next, as
//! autopilots send them. Signatures are stepped over, not checked: [`super::signing`] does that.
//!
//! A reader ([`super::decoder`]) and a router want different packets:
//!
//! | bytes | `Wants::Readable` | `Wants::Everything` |
//! |---|---|---|
//! | a known message, right checksum | a packet | a packet |
//! | wrong checksum | counted; of MAVLink 1: garbage | counted |
//! | an unknown message, behind which nothing or a packet begins | counted, and searched for packets | a packet |
//! | unknown incompatibility flags, the same | counted, and searched for packets | garbage: its end is unknown |
//! | a beginning | joined with what comes next; of MAVLink 1: garbage | joined with what comes next |

use std::borrow::Cow;

use super::crc::{checksum, crc_extra};
use super::packet::{Header, MAGIC_V1, MAGIC_V2, PacketRef, SIGNED};

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

/// Which packets are handed on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Wants {
    /// Of known messages with a right checksum; MAVLink 1 only whole ones.
    Readable,
    /// Of unknown messages, too, which cannot be checked.
    #[default]
    Everything,
}

/// Splits what one peer sends into packets. The default is a router's, on a stream or on datagrams.
#[derive(Debug, Clone, Default)]
pub struct Splitter {
    /// A packet's beginning at the end of what came last.
    tail: Vec<u8>,
    wants: Wants,
    /// Whether a packet comes in two parts at most.
    datagrams: bool,
    counts: Counts,
}

/// What stands at a position.
enum Found {
    Packet {
        header: Header,
        known: bool,
    },
    /// Of no use, and perhaps not even a packet, over this length.
    Bad(usize, fn(&mut Counts)),
    /// A packet that may go on.
    Cut,
    Garbage,
}

impl Splitter {
    /// A reader's, on a stream, such as TCP's, which cuts its bytes anywhere.
    #[must_use]
    pub fn of_stream() -> Self {
        Self { wants: Wants::Readable, ..Self::default() }
    }

    /// A reader's, on datagrams.
    #[must_use]
    pub fn of_datagrams() -> Self {
        Self { datagrams: true, ..Self::of_stream() }
    }

    /// What arrived so far. `frames` and `mavlink1` count what was handed on, `unknown` of a router those
    /// among them that could not be checked.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Hands each packet in `bytes` to `each`, in order.
    pub fn split(&mut self, bytes: &[u8], each: impl FnMut(PacketRef<'_>)) {
        let mut tail = std::mem::take(&mut self.tail);
        let joined = !tail.is_empty();
        let buffer = if joined {
            tail.extend_from_slice(bytes);
            Cow::Owned(tail)
        } else {
            Cow::Borrowed(bytes)
        };
        match self.scan(&buffer, each) {
            // A packet cut off twice, by two datagrams, will not be mended by a third.
            Some(0) if joined && self.datagrams => self.counts.truncated += 1,
            Some(cut) => self.tail = buffer[cut..].to_vec(),
            None => {}
        }
    }

    /// Returns where a packet begins that goes on behind the end of `bytes`.
    fn scan(&mut self, bytes: &[u8], mut each: impl FnMut(PacketRef<'_>)) -> Option<usize> {
        // No byte before `blamed` is counted again.
        let (mut at, mut blamed, mut cut) = (0, 0, None);
        while at < bytes.len() {
            let rest = &bytes[at..];
            match find(rest, self.wants) {
                Found::Packet { header, known } => {
                    self.count(rest[0], known);
                    each(PacketRef::new(&rest[..header.whole], header.id, known));
                    at += header.whole;
                    // What seemed cut was followed by a packet: it will not go on.
                    self.counts.truncated += u64::from(cut.take().is_some());
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
        cut
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

fn find(rest: &[u8], wants: Wants) -> Found {
    // Of MAVLink 1 a reader counts what is certain and nothing else.
    let doubtful = rest[0] == MAGIC_V1 && wants == Wants::Readable;
    let Some(header) = Header::of(rest) else {
        let begins = matches!(rest[0], MAGIC_V1 | MAGIC_V2) && !doubtful;
        return if begins { Found::Cut } else { Found::Garbage };
    };
    let Header { id, flags, checked, whole } = header;
    let incompatible = flags & !SIGNED != 0;
    if incompatible && wants == Wants::Everything {
        return Found::Garbage;
    }
    if rest.len() < whole {
        return if doubtful { Found::Garbage } else { Found::Cut };
    }
    let extra = if incompatible { None } else { crc_extra(id) };
    let Some(extra) = extra else {
        // No checksum tells a packet of these two kinds from junk. It is one if it ends where something
        // begins.
        let ends_well = matches!(rest.get(whole), None | Some(&(MAGIC_V1 | MAGIC_V2)));
        return match wants {
            _ if !ends_well || doubtful => Found::Garbage,
            Wants::Everything => Found::Packet { header, known: false },
            Wants::Readable if incompatible => Found::Bad(whole, |c| c.incompatible += 1),
            Wants::Readable => Found::Bad(whole, |c| c.unknown += 1),
        };
    };
    if rest[checked..checked + 2] == checksum(&rest[1..checked], extra).to_le_bytes() {
        Found::Packet { header, known: true }
    } else if doubtful {
        Found::Garbage
    } else {
        Found::Bad(whole, |c| c.bad_crc += 1)
    }
}

#[cfg(test)]
mod tests {
    use mavlink::MessageData;
    use proptest::prelude::*;

    use super::*;
    use crate::link::dialect::HEARTBEAT_DATA;
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
        let crc = checksum(&frame[1..], HEARTBEAT_DATA::EXTRA_CRC);
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
