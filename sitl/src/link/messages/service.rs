//! Time, streams, files, keys.

use super::Target;

views! {
    /// A request to everybody, or the answer to one.
    Ping = PING_DATA {
        /// Stamp of the asker, µs.
        0 => time_usec: u64,
        /// The asker's number.
        8 => seq: u32,
        /// 0, 0 in a request; in an answer, who asked.
        12 => target: Target,
    }

    /// Two clocks compared.
    Timesync = TIMESYNC_DATA {
        /// Clock of the answerer, ns; 0 in a request.
        0 => tc1: i64,
        /// Clock of the asker, ns.
        8 => ts1: i64,
        /// Whom it is for.
        16 => target: Target,
    }

    /// The older way to set rates: of a whole group of messages.
    RequestDataStream = REQUEST_DATA_STREAM_DATA {
        /// Hz.
        0 => rate: u16,
        /// Whom it is for.
        2 => target: Target,
        /// MAV_DATA_STREAM.
        4 => stream: u8,
        /// 0 stops it.
        5 => start: u8,
    }

    /// An operation of MAVLink FTP.
    FileTransfer = FILE_TRANSFER_PROTOCOL_DATA {
        /// Network id; 0 is all.
        0 => network: u8,
        /// Whom it is for.
        1 => target: Target,
        /// Number of the operation.
        3 => seq: u16,
        /// Session id.
        5 => session: u8,
        /// What is asked, or how it went.
        6 => opcode: u8,
        /// Bytes of data.
        7 => size: u8,
        /// In an answer, the opcode that was asked.
        8 => request: u8,
        /// 1 if a burst ends.
        9 => burst_complete: u8,
        /// Place in the file, bytes.
        11 => offset: u32,
        /// Data, by the opcode.
        15 => data: [u8; 239],
    }

    /// The key of message signing.
    SetupSigning = SETUP_SIGNING_DATA {
        /// Timestamps go on from here, 10 µs since 2015.
        0 => initial_timestamp: u64,
        /// Whom it is for.
        8 => target: Target,
        /// The key; all zero is none.
        10 => key: [u8; 32],
    }
}
