//! A frame as PNG over MAVLink's image transmission protocol, and back.
//!
//! ```text
//! DATA_TRANSMISSION_HANDSHAKE  type PNG, size, 100x100, packets, payload 253
//! ENCAPSULATED_DATA            seqnr 0.. packets, 253 bytes each, the last padded with zeros
//! ```
//!
//! The protocol has no image number, so the PNG names its tick itself (tEXt chunk `tick`) and the checksum of its
//! pixels (tEXt chunk `crc32`): with a PNG's own checksums, which are of its parts, they reject an image that was
//! glued from two. Encoding is lossless and deterministic.

use std::collections::BTreeMap;

use super::dialect::{DATA_TRANSMISSION_HANDSHAKE_DATA, ENCAPSULATED_DATA_DATA, MavlinkDataStreamType};
use super::encoder::{DATAGRAM, Encoder};
use super::messages::View;
use super::messages::image::{EncapsulatedData, Handshake};
use super::packet::Packet;
use crate::camera::{Frame, SIDE};
use crate::units::Tick;

/// Bytes of an image in one ENCAPSULATED_DATA.
pub const CHUNK: usize = 253;
/// Chunks in a datagram, with room for the announcement in the first.
const CHUNKS: usize = (DATAGRAM - HANDSHAKE_FRAME) / CHUNK_FRAME;
/// An ENCAPSULATED_DATA frame's length at most, bytes.
const CHUNK_FRAME: usize = CHUNK + 2 + 12;
/// A DATA_TRANSMISSION_HANDSHAKE frame's length at most, bytes.
const HANDSHAKE_FRAME: usize = 13 + 12;
/// No frame of ours is as large; a handshake that announces more is not believed.
const MAX_SIZE: usize = 64 * 1024;
const KEYWORD: &str = "tick";
const CHECKSUM: &str = "crc32";

/// Why bytes are no frame.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The bytes are no PNG, or damaged.
    #[error("decoding the frame: {0}")]
    Png(String),
    /// Another size or pixel format.
    #[error("the frame is {0}, expected 100x100 RGB of 8 bits")]
    Format(String),
    /// The pixels are not those of the tick.
    #[error("the frame's pixels have another checksum than it names")]
    Glued,
    /// No tick in it.
    #[error("the frame does not name its tick")]
    NoTick,
}

/// A frame as PNG that names its tick.
///
/// # Errors
/// The frame cannot be compressed.
pub fn png_from_frame(frame: &Frame, tick: Tick) -> Result<Vec<u8>, ImageError> {
    let failed = |error: png::EncodingError| ImageError::Png(error.to_string());
    let mut bytes = Vec::with_capacity(4096);
    let mut encoder = png::Encoder::new(&mut bytes, SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_deflate_compression(png::DeflateCompression::FdeflateUltraFast);
    encoder.set_filter(png::Filter::Up);
    encoder.add_text_chunk(KEYWORD.into(), tick.0.to_string()).map_err(failed)?;
    let checksum = format!("{:08x}", crc32fast::hash(frame.rgb()));
    encoder.add_text_chunk(CHECKSUM.into(), checksum).map_err(failed)?;
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(frame.rgb()).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// The frame in a PNG, and its tick.
///
/// # Errors
/// The bytes are no PNG, or none of a frame's size with a tick in it.
pub fn frame_from_png(bytes: &[u8]) -> Result<(Tick, Frame), ImageError> {
    let (tick, frame) = picture_from_png(bytes)?;
    Ok((tick.ok_or(ImageError::NoTick)?, frame))
}

/// The frame in a PNG of anybody's, and its tick if it names one.
///
/// # Errors
/// The bytes are no PNG, or none of a frame's size, or the pixels have another checksum than it names.
pub fn picture_from_png(bytes: &[u8]) -> Result<(Option<Tick>, Frame), ImageError> {
    let failed = |error: png::DecodingError| ImageError::Png(error.to_string());
    let limits = png::Limits { bytes: 4 << 20 };
    let mut reader =
        png::Decoder::new_with_limits(std::io::Cursor::new(bytes), limits).read_info().map_err(failed)?;
    let info = reader.info();
    let (width, height) = info.size();
    let rgb = info.color_type == png::ColorType::Rgb && info.bit_depth == png::BitDepth::Eight;
    if (width, height) != (SIDE as u32, SIDE as u32) || !rgb {
        let format = format!("{width}x{height} {:?} {:?}", info.color_type, info.bit_depth);
        return Err(ImageError::Format(format));
    }
    let texts = |keyword| info.uncompressed_latin1_text.iter().filter(move |t| t.keyword == keyword);
    let tick = texts(KEYWORD).find_map(|t| t.text.parse().ok()).map(Tick);
    let checksum = texts(CHECKSUM).find_map(|t| u32::from_str_radix(&t.text, 16).ok());
    let mut pixels = vec![0; SIDE * SIDE * 3];
    reader.next_frame(&mut pixels).map_err(failed)?;
    reader.finish().map_err(failed)?;
    if checksum.is_some_and(|checksum| checksum != crc32fast::hash(&pixels)) {
        return Err(ImageError::Glued);
    }
    let frame = Frame::from_rgb(pixels).ok_or_else(|| ImageError::Format("cut short".into()))?;
    Ok((tick, frame))
}

/// What a DATA_TRANSMISSION_HANDSHAKE asks of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageRequest {
    /// A stream of PNG.
    Start,
    /// All fields zero: no more images.
    Stop,
    /// A type that we do not have.
    OtherType(u8),
    /// An announcement, not a request.
    NoRequest,
}

/// MAVLINK_DATA_STREAM_IMG_PNG.
const PNG: u8 = MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG as u8;

impl Handshake {
    /// What it asks for. Type 0 (JPEG) with quality 0 is the standard's stop message.
    #[must_use]
    pub fn request(&self) -> ImageRequest {
        let empty = (self.size, self.width, self.height, self.packets, self.payload) == (0, 0, 0, 0, 0);
        match (empty, self.kind, self.quality) {
            (false, ..) => ImageRequest::NoRequest,
            (true, 0, 0) => ImageRequest::Stop,
            (true, PNG, _) => ImageRequest::Start,
            (true, other, _) => ImageRequest::OtherType(other),
        }
    }
}

/// Appends the request for a stream of PNG.
pub fn push_request(encoder: &mut Encoder, datagram: &mut Vec<u8>) {
    let request = DATA_TRANSMISSION_HANDSHAKE_DATA {
        mavtype: MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG,
        jpg_quality: 100,
        ..Default::default()
    };
    encoder.push(datagram, &request);
}

/// Appends the acknowledgement of a stop: all zero.
pub fn push_stopped(encoder: &mut Encoder, datagram: &mut Vec<u8>) {
    encoder.push(datagram, &DATA_TRANSMISSION_HANDSHAKE_DATA::default());
}

/// How many datagrams an image takes.
#[must_use]
pub fn datagram_count(png: &[u8]) -> usize {
    png.len().div_ceil(CHUNK * CHUNKS).max(1)
}

/// Datagram `index` of an image; the first one announces it.
pub fn datagram(png: &[u8], index: usize, encoder: &mut Encoder) -> Vec<u8> {
    let mut out = Vec::with_capacity(DATAGRAM);
    if index == 0 {
        let announcement = DATA_TRANSMISSION_HANDSHAKE_DATA {
            size: png.len() as u32,
            width: SIDE as u16,
            height: SIDE as u16,
            packets: png.len().div_ceil(CHUNK) as u16,
            mavtype: MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG,
            payload: CHUNK as u8,
            jpg_quality: 100,
        };
        encoder.push(&mut out, &announcement);
    }
    for (k, chunk) in png.chunks(CHUNK).enumerate().skip(index * CHUNKS).take(CHUNKS) {
        let mut data = [0; CHUNK];
        data[..chunk.len()].copy_from_slice(chunk);
        encoder.push(&mut out, &ENCAPSULATED_DATA_DATA { seqnr: k as u16, data });
    }
    out
}

/// Puts images together from chunks that may come twice, late or never.
#[derive(Debug, Default)]
pub struct Reassembler {
    announced: Option<Handshake>,
    chunks: BTreeMap<u16, [u8; CHUNK]>,
    rejected: u64,
}

impl Reassembler {
    /// Takes a packet; hands out a frame when its last part has come.
    pub fn push(&mut self, packet: &Packet) -> Option<(Tick, Frame)> {
        if let Some(handshake) = Handshake::of(packet) {
            // The same announcement again is a repeat of the same image: what has come is kept.
            if self.announced.is_some_and(|known| known != handshake) {
                self.clear();
            }
            self.announced = credible(&handshake).then_some(handshake);
        } else {
            let EncapsulatedData { seq, data } = EncapsulatedData::of(packet)?;
            if usize::from(seq) * CHUNK >= MAX_SIZE {
                return None;
            }
            self.chunks.insert(seq, data);
        }
        self.complete()
    }

    /// Forgets the parts of an unfinished image: a new one begins.
    pub fn clear(&mut self) {
        self.announced = None;
        self.chunks.clear();
    }

    /// Images whose bytes were complete but not a frame.
    #[must_use]
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    fn complete(&mut self) -> Option<(Tick, Frame)> {
        let Handshake { size, packets, payload, .. } = self.announced?;
        if self.chunks.range(..packets).count() < usize::from(packets) {
            return None;
        }
        let mut png: Vec<u8> = self
            .chunks
            .range(..packets)
            .flat_map(|(_, chunk)| &chunk[..usize::from(payload)])
            .copied()
            .collect();
        png.truncate(size as usize);
        self.clear();
        match frame_from_png(&png) {
            Ok(found) => Some(found),
            Err(error) => {
                tracing::trace!("{error}");
                self.rejected += 1;
                None
            }
        }
    }
}

/// Whether an announcement fits together and has a size that we are willing to hold.
fn credible(handshake: &Handshake) -> bool {
    let (size, payload) = (handshake.size as usize, usize::from(handshake.payload));
    handshake.kind == PNG
        && (1..=CHUNK).contains(&payload)
        && (1..=MAX_SIZE).contains(&size)
        && size.div_ceil(payload) == usize::from(handshake.packets)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::camera;
    use crate::link::decoder::Decoder;
    use crate::scenario::Scenario;

    fn picture(x: f64) -> Frame {
        camera::render(Vector2::new(x, 0.31), Vector2::new(0.5, 0.45), &Scenario::default())
    }

    fn packets(frame: &Frame, tick: u64) -> Vec<Packet> {
        let png = png_from_frame(frame, Tick(tick)).unwrap();
        let mut decoder = Decoder::default();
        let mut encoder = Encoder::new(1, 1);
        let datagrams = (0..datagram_count(&png)).map(|k| datagram(&png, k, &mut encoder));
        datagrams.flat_map(|bytes| decoder.datagram(&bytes)).collect()
    }

    fn feed<'a>(
        images: &mut Reassembler,
        packets: impl IntoIterator<Item = &'a Packet>,
    ) -> Option<(Tick, Frame)> {
        packets.into_iter().filter_map(|packet| images.push(packet)).last()
    }

    #[test]
    fn pictures_are_lossless_name_their_tick_and_are_always_the_same_bytes() {
        for (k, x) in [0.0, 0.1, 0.45, 0.777, 1.0].into_iter().enumerate() {
            let frame = picture(x);
            let png = png_from_frame(&frame, Tick(k as u64)).unwrap();
            assert_eq!(frame_from_png(&png).unwrap(), (Tick(k as u64), frame.clone()));
            assert_eq!(png, png_from_frame(&frame, Tick(k as u64)).unwrap());
            assert!(png.len() < 10 * CHUNK, "{} bytes", png.len());
        }
        let noise: Vec<u8> = (0..SIDE * SIDE * 3).map(|i| (i * i % 251) as u8).collect();
        let frame = Frame::from_rgb(noise).unwrap();
        let large = png_from_frame(&frame, Tick(7)).unwrap();
        let lengths = (0..datagram_count(&large)).map(|k| datagram(&large, k, &mut Encoder::new(1, 1)).len());
        assert!(lengths.max().unwrap() <= DATAGRAM);
        assert_eq!(frame_from_png(&png_from_frame(&frame, Tick(7)).unwrap()).unwrap(), (Tick(7), frame));
    }

    #[test]
    fn chunks_may_come_in_any_order_twice_and_in_a_later_repeat() {
        let frame = picture(0.3);
        let packets = packets(&frame, 5);
        let mut images = Reassembler::default();
        assert_eq!(feed(&mut images, packets.iter().rev()), Some((Tick(5), frame.clone())));
        let (odd, even): (Vec<_>, Vec<_>) = packets.iter().enumerate().partition(|(k, _)| k % 2 == 1);
        assert_eq!(feed(&mut images, odd.iter().chain(&odd).map(|(_, p)| *p)), None);
        assert_eq!(feed(&mut images, even.iter().map(|(_, p)| *p)), Some((Tick(5), frame)));
    }

    #[test]
    fn an_image_glued_from_two_is_no_image_and_the_next_repeat_is() {
        let (old, new) = (packets(&picture(0.31), 5), packets(&picture(0.32), 6));
        let mut images = Reassembler::default();
        assert_eq!(feed(&mut images, &old[..3]), None);
        let mut glued = new.clone();
        glued[2] = old[2].clone();
        assert_eq!(feed(&mut images, &glued), None);
        assert_eq!(images.rejected(), 1);
        assert_eq!(feed(&mut images, &new), Some((Tick(6), picture(0.32))));
    }

    /// Late parts of the last picture under the new one's name: a flight in lockstep saw the picture before.
    #[test]
    fn a_new_tick_with_the_old_pixels_is_no_image() {
        let length = |frame: &Frame| png_from_frame(frame, Tick(5)).unwrap().len();
        let old = picture(0.31);
        let mut others = (1..500).map(|k| picture(0.31 + 0.001 * f64::from(k)));
        let new = others.find(|new| length(new) == length(&old) && *new != old).unwrap();
        // The announcement and the chunk with the tick and the checksum; then the old picture's pixels.
        let [old, new] = [packets(&old, 5), packets(&new, 6)];
        let mut images = Reassembler::default();
        assert_eq!(feed(&mut images, new[..2].iter().chain(&old[2..])), None);
        assert_eq!(images.rejected(), 1);
    }

    #[test]
    fn announcements_that_do_not_fit_together_are_not_believed() {
        let good = Handshake::of(&packets(&picture(0.3), 5)[0]).unwrap();
        assert!(credible(&good));
        for bad in [
            Handshake { packets: good.packets + 1, ..good },
            Handshake { payload: 0, ..good },
            Handshake { payload: 254, ..good },
            Handshake { size: u32::MAX, packets: u16::MAX, ..good },
            Handshake { kind: 0, ..good },
        ] {
            assert!(!credible(&bad), "{bad:?}");
        }
    }

    #[test]
    fn requests_are_told_apart() {
        let zero = Handshake { kind: 0, size: 0, width: 0, height: 0, packets: 0, payload: 0, quality: 0 };
        assert_eq!(zero.request(), ImageRequest::Stop);
        assert_eq!(Handshake { kind: PNG, ..zero }.request(), ImageRequest::Start);
        assert_eq!(Handshake { kind: PNG, quality: 50, ..zero }.request(), ImageRequest::Start);
        assert_eq!(Handshake { quality: 50, ..zero }.request(), ImageRequest::OtherType(0));
        assert_eq!(Handshake { kind: PNG, size: 9, ..zero }.request(), ImageRequest::NoRequest);
    }

    #[test]
    fn other_pictures_are_named_for_what_they_are() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 10, 20);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().unwrap().write_image_data(&[0; 200]).unwrap();
        let error = frame_from_png(&bytes).unwrap_err().to_string();
        assert_eq!(error, "the frame is 10x20 Grayscale Eight, expected 100x100 RGB of 8 bits");
        assert!(frame_from_png(b"no picture").is_err());
    }
}
