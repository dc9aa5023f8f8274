//! The latents of a frame in place of its picture: one TUNNEL message.
//!
//! TUNNEL (385) is the message that the common dialect has for payloads of a vendor's own: it names a target and a
//! payload type, carries up to 128 bytes, and every router passes it on. Payload types from 32768 on are free for
//! experiments. The image protocol's ENCAPSULATED_DATA has no type and would collide with pictures.
//!
//! ```text
//! u32  time stamp of the frame, ms (Clock::boot_ms)
//! u8   bits of a number
//! u8   number of vectors: z_c, then z_u of each obstacle
//! then of each vector:
//!   f32  how far off it is, in units of the encoder's noise on a clean frame
//!   f32  its largest number's absolute value m
//!   ...  its numbers, each an integer q of so many bits in two's complement: z = m q / (2^(bits - 1) - 1)
//! ```
//!
//! All little endian; numbers are packed from the lowest bit on. Knows vectors, not what they mean.

use super::encoder::Encoder;
use super::messages::View;
use super::messages::image::Tunnel;
use super::packet::Packet;
use super::wire::Clock;
use crate::radio::message::{NUMBERS, SentLatent, SentLatents};

/// Most vectors in a message of the widest numbers.
pub const MAX_VECTORS: usize = 3;
/// Widths of a number that a message can have, bits.
pub const WIDTHS: std::ops::RangeInclusive<u8> = 4..=16;

/// The payload type: the second of those that are free for experiments.
const PAYLOAD: u16 = 32769;
/// Bytes before the vectors, and before the numbers of a vector.
const HEADS: [usize; 2] = [6, 8];
/// Bytes of a TUNNEL's payload.
const ROOM: usize = 128;

/// Why latents cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LatentsError {
    /// No such width.
    #[error("numbers of {0} bits: from 4 to 16")]
    Width(u8),
    /// More than the message holds.
    #[error("{0} vectors do not fit into a message")]
    Vectors(usize),
}

fn whole(bits: u8) -> f32 {
    ((1_i32 << (bits - 1)) - 1) as f32
}

/// Appends the message of a frame's latents with numbers of `bits` bits, to whoever listens.
///
/// # Errors
/// No such width, or too many vectors.
pub fn push(
    latents: &SentLatents,
    bits: u8,
    clock: &Clock,
    encoder: &mut Encoder,
    datagram: &mut Vec<u8>,
) -> Result<(), LatentsError> {
    if !WIDTHS.contains(&bits) {
        return Err(LatentsError::Width(bits));
    }
    let mut payload = Vec::with_capacity(ROOM);
    payload.extend(clock.boot_ms(latents.tick).to_le_bytes());
    payload.extend([bits, u8::try_from(latents.vectors.len()).unwrap_or(u8::MAX)]);
    for vector in &latents.vectors {
        pack(vector, bits, &mut payload);
    }
    if payload.len() > ROOM {
        return Err(LatentsError::Vectors(latents.vectors.len()));
    }
    let length = payload.len() as u8;
    payload.resize(ROOM, 0);
    let payload = payload.try_into().unwrap_or([0; ROOM]);
    encoder.push_view(datagram, &Tunnel { kind: PAYLOAD, target: [0; 2], length, payload });
    Ok(())
}

fn pack(vector: &SentLatent, bits: u8, payload: &mut Vec<u8>) {
    let most = vector.z.iter().fold(0.0_f32, |most, z| most.max(z.abs()));
    payload.extend(vector.sigma_scale.to_le_bytes());
    payload.extend(most.to_le_bytes());
    let (mut word, mut filled) = (0_u32, 0);
    for z in vector.z {
        let q = if most > 0.0 { (z / most * whole(bits)).round() as i32 } else { 0 };
        word |= (q as u32 & ((1 << bits) - 1)) << filled;
        filled += bits;
        while filled >= 8 {
            payload.push(word as u8);
            word >>= 8;
            filled -= 8;
        }
    }
    if filled > 0 {
        payload.push(word as u8);
    }
}

/// The latents of a packet, if it has any; of another flight's clock it has none.
#[must_use]
pub fn of(packet: &Packet, clock: &Clock) -> Option<SentLatents> {
    let tunnel = Tunnel::of(packet).filter(|tunnel| tunnel.kind == PAYLOAD)?;
    let payload = tunnel.payload.get(..usize::from(tunnel.length))?;
    let (head, mut rest) = payload.split_at_checked(HEADS[0])?;
    let tick = clock.tick(u32::from_le_bytes(head[..4].try_into().ok()?))?;
    let (bits, count) = (head[4], head[5]);
    if !WIDTHS.contains(&bits) {
        return None;
    }
    let mut vectors = Vec::with_capacity(usize::from(count).min(MAX_VECTORS));
    for _ in 0..count {
        let (vector, left) = unpack(rest, bits)?;
        vectors.push(vector);
        rest = left;
    }
    (count > 0).then_some(SentLatents { tick, vectors })
}

fn unpack(bytes: &[u8], bits: u8) -> Option<(SentLatent, &[u8])> {
    let (head, rest) = bytes.split_at_checked(HEADS[1])?;
    let (numbers, left) = rest.split_at_checked((NUMBERS * usize::from(bits)).div_ceil(8))?;
    let float = |at: usize| Some(f32::from_le_bytes(head[at..at + 4].try_into().ok()?));
    let (sigma_scale, most) = (float(0)?, float(4)?);
    if !(sigma_scale.is_finite() && most.is_finite() && sigma_scale >= 0.0 && most >= 0.0) {
        return None;
    }
    let bit = |n: usize| u32::from(numbers[n / 8] >> (n % 8) & 1);
    let step = most / whole(bits);
    let z = std::array::from_fn(|k| {
        let at = k * usize::from(bits);
        let word = (0..usize::from(bits)).fold(0, |word, n| word | bit(at + n) << n);
        // Sign extension.
        let q = (word << (32 - bits)) as i32 >> (32 - bits);
        q as f32 * step
    });
    Some((SentLatent { z, sigma_scale, half_step: step / 2.0 }, left))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;
    use crate::link::decoder::Decoder;
    use crate::units::Tick;

    fn latents(vectors: usize) -> SentLatents {
        let vector = |n: usize| SentLatent {
            z: std::array::from_fn(|k| 4.0 * ((7 * k + 3 * n) as f32).sin()),
            sigma_scale: 1.0 + n as f32,
            half_step: 0.0,
        };
        SentLatents { tick: Tick(17), vectors: (0..vectors).map(vector).collect() }
    }

    fn packet(latents: &SentLatents, bits: u8) -> Result<(Packet, usize), LatentsError> {
        let mut bytes = Vec::new();
        let clock = Clock::new(&Scenario::default());
        push(latents, bits, &clock, &mut Encoder::new(1, 191), &mut bytes)?;
        Ok((Decoder::default().datagram(&bytes).remove(0), bytes.len()))
    }

    #[test]
    fn latents_come_back_within_half_a_step_of_every_width() {
        let clock = Clock::new(&Scenario::default());
        for bits in WIDTHS {
            for vectors in 1..=MAX_VECTORS.min(if bits > 14 { 2 } else { 3 }) {
                let sent = latents(vectors);
                let (packet, _) = packet(&sent, bits).unwrap();
                let heard = of(&packet, &clock).unwrap();
                assert_eq!((heard.tick, heard.vectors.len()), (sent.tick, vectors));
                for (a, b) in sent.vectors.iter().zip(&heard.vectors) {
                    assert_eq!(a.sigma_scale, b.sigma_scale);
                    let step = b.half_step * 1.001;
                    assert!(a.z.iter().zip(&b.z).all(|(a, b)| (a - b).abs() <= step), "{bits}: {a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn the_latents_of_a_frame_are_short() {
        // 12 bytes of the frame, 5 of TUNNEL's fields, 6 of the head, two vectors of 8 and 20.
        assert_eq!(packet(&latents(2), 10).unwrap().1, 12 + 5 + 6 + 2 * (8 + 20));
        assert_eq!(packet(&latents(1), 17).unwrap_err(), LatentsError::Width(17));
        assert_eq!(packet(&latents(9), 8).unwrap_err(), LatentsError::Vectors(9));
    }

    #[test]
    fn zeros_stay_zeros_and_junk_is_nothing() {
        let clock = Clock::new(&Scenario::default());
        let mut sent = latents(1);
        sent.vectors[0].z = [0.0; NUMBERS];
        assert_eq!(of(&packet(&sent, 8).unwrap().0, &clock).unwrap().vectors[0].z, [0.0; NUMBERS]);
        let mut bytes = Vec::new();
        for length in 0..=ROOM {
            for fill in [0, 7, 255] {
                let message =
                    Tunnel { kind: PAYLOAD, target: [0; 2], length: length as u8, payload: [fill; ROOM] };
                bytes.clear();
                Encoder::new(1, 191).push_view(&mut bytes, &message);
                assert_eq!(of(&Decoder::default().datagram(&bytes)[0], &clock), None);
            }
        }
    }
}
