//! The image transmission protocol, and what a companion sends in place of an image.

views! {
    /// An image request or announcement.
    Handshake = DATA_TRANSMISSION_HANDSHAKE_DATA {
        /// Bytes of the image.
        0 => size: u32,
        /// Pixels.
        4 => width: u16,
        /// Pixels.
        6 => height: u16,
        /// Number of ENCAPSULATED_DATA.
        8 => packets: u16,
        /// MAVLINK_DATA_STREAM_TYPE.
        10 => kind: u8,
        /// Bytes in each ENCAPSULATED_DATA.
        11 => payload: u8,
        /// JPEG quality in percent; of no meaning for a PNG.
        12 => quality: u8,
    }

    /// A part of an image.
    EncapsulatedData = ENCAPSULATED_DATA_DATA {
        /// Its number, from 0.
        0 => seq: u16,
        /// Its bytes; the last part has zeros behind the image's end.
        2 => data: [u8; 253],
    }

    /// A payload of a vendor's own.
    Tunnel = TUNNEL_DATA {
        /// Its type.
        0 => kind: u16,
        /// System and component; 0 is everybody.
        2 => target: [u8; 2],
        /// Bytes of the payload that count.
        4 => length: u8,
        /// The payload.
        5 => payload: [u8; 128],
    }
}
