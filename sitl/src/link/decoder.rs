//! What one peer sends, as packets that can be kept. MAVLink 1 packets are counted and left alone.

use super::packet::Packet;
use super::splitter::{Counts, Splitter};

/// Reads one peer's datagrams.
#[derive(Debug, Clone)]
pub struct Decoder(Splitter);

impl Default for Decoder {
    fn default() -> Self {
        Self(Splitter::of_datagrams())
    }
}

impl Decoder {
    /// Reads a stream, such as TCP's, which cuts its bytes anywhere.
    #[must_use]
    pub fn of_stream() -> Self {
        Self(Splitter::of_stream())
    }

    /// What arrived so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.0.counts()
    }

    /// The good packets of a datagram, or of a part of a stream, in order.
    pub fn datagram(&mut self, bytes: &[u8]) -> Vec<Packet> {
        let mut packets = Vec::new();
        self.datagram_into(bytes, &mut packets);
        packets
    }

    /// The same, appended to `packets`, whose memory can then be used again.
    pub fn datagram_into(&mut self, bytes: &[u8], packets: &mut Vec<Packet>) {
        self.0.split(bytes, |packet| packets.extend(packet.is_v2().then(|| Packet::from(packet))));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::link::crc::{checksum, crc_extra};
    use crate::link::dialect;
    use crate::link::encoder::Encoder;
    use crate::link::packet::SIGNED;

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
        let crc = checksum(&old[1..], crc_extra(0).unwrap()).to_le_bytes();
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
        let crc = checksum(&frame[1..checked], crc_extra(0).unwrap());
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
