//! The checksum of MAVLink frames (CRC-16/MCRF4XX), eight bytes at a time. The `mavlink` crate's goes byte
//! by byte, which is most of the time that receiving a frame takes.

use mavlink::Message;

use super::dialect::MavMessage;

/// How many bytes go at once, each through a table of its own.
const SLICE: usize = 8;
const POLYNOMIAL: u16 = 0x8408;

/// Entry b of table k: what byte b does to the checksum k bytes later.
static TABLES: [[u16; 256]; SLICE] = tables();

const fn tables() -> [[u16; 256]; SLICE] {
    let mut tables = [[0; 256]; SLICE];
    let mut byte = 0;
    while byte < 256 {
        let (mut crc, mut bit) = (byte as u16, 0);
        while bit < 8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ POLYNOMIAL } else { crc >> 1 };
            bit += 1;
        }
        tables[0][byte] = crc;
        byte += 1;
    }
    let mut k = 1;
    while k < SLICE {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[k - 1][byte];
            tables[k][byte] = (before >> 8) ^ tables[0][(before & 0xFF) as usize];
            byte += 1;
        }
        k += 1;
    }
    tables
}

/// Checksum of a frame's bytes behind its magic byte, and of its message's CRC_EXTRA.
#[must_use]
pub fn checksum(bytes: &[u8], extra: u8) -> u16 {
    let (slices, rest) = bytes.as_chunks::<SLICE>();
    let crc = slices.iter().fold(0xFFFF, |crc: u16, slice| {
        let [low, high] = crc.to_le_bytes();
        TABLES[7][usize::from(slice[0] ^ low)]
            ^ TABLES[6][usize::from(slice[1] ^ high)]
            ^ TABLES[5][usize::from(slice[2])]
            ^ TABLES[4][usize::from(slice[3])]
            ^ TABLES[3][usize::from(slice[4])]
            ^ TABLES[2][usize::from(slice[5])]
            ^ TABLES[1][usize::from(slice[6])]
            ^ TABLES[0][usize::from(slice[7])]
    });
    rest.iter()
        .chain([&extra])
        .fold(crc, |crc, &byte| (crc >> 8) ^ TABLES[0][usize::from(crc.to_le_bytes()[0] ^ byte)])
}

/// The one message whose CRC_EXTRA is 0, which elsewhere means unknown: COMPONENT_INFORMATION.
const ZERO_EXTRA: u32 = 395;

/// CRC_EXTRA of a message that the dialect knows.
#[must_use]
pub fn crc_extra(id: u32) -> Option<u8> {
    match MavMessage::extra_crc(id) {
        0 if id != ZERO_EXTRA => None,
        extra => Some(extra),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_standards_check_value() {
        // "123456789" gives 0x6F91; the extra byte is its last here.
        assert_eq!(checksum(b"12345678", b'9'), 0x6F91);
    }

    proptest! {
        #[test]
        fn it_is_the_crates(bytes in prop::collection::vec(any::<u8>(), 0..300), extra: u8) {
            prop_assert_eq!(checksum(&bytes, extra), mavlink::calculate_crc(&bytes, extra));
        }
    }
}
