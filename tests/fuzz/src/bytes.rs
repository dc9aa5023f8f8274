//! Bytes of the engine, read as choices.

use crpl_sitl::link::crc::{checksum, crc_extra};

/// Reads choices from the front. Beyond the end are zeros.
pub struct Choices<'a>(&'a [u8]);

impl<'a> Choices<'a> {
    /// All of them.
    pub fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    /// Whether none are left.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        self.some(1).first().copied().unwrap_or(0)
    }

    /// The next two bytes.
    pub fn short(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// So many bytes, or as many as there are.
    pub fn some(&mut self, count: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        front
    }

    /// All that are left.
    pub fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }
}

/// A MAVLink 2 frame whose checksum is right.
pub fn frame(sequence: u8, (system, component): (u8, u8), id: u32, payload: &[u8]) -> Vec<u8> {
    let [id0, id1, id2, _] = id.to_le_bytes();
    let mut frame = vec![0xFD, payload.len() as u8, 0, 0, sequence, system, component, id0, id1, id2];
    frame.extend_from_slice(payload);
    let crc = checksum(&frame[1..], crc_extra(id).unwrap_or(0));
    frame.extend(crc.to_le_bytes());
    frame
}
