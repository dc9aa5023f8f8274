//! The file transfer protocol of a vehicle without files: it says so at once. MAVProxy asks for the
//! parameters as a file first, and asks for them one by one only after a refusal.
//!
//! | asked, of the autopilot | answered to the asker |
//! |---|---|
//! | None, TerminateSession, ResetSessions | Ack |
//! | ListDirectory, OpenFileRO, CalcFileCRC32 | Nak FileNotFound |
//! | anything else | Nak UnknownCommand |
//! | an Ack or a Nak | nothing |
//!
//! LOG_REQUEST_LIST is answered by one LOG_ENTRY that says that there are no logs, as ArduPilot does.

use super::Vehicle;
use crate::link::dialect;
use crate::link::messages::service::FileTransfer;
use crate::link::{AUTOPILOT, PeerId};

/// The last of the three opcodes that need no files.
const RESET_SESSIONS: u8 = 2;
const LIST_DIRECTORY: u8 = 3;
const OPEN_READ_ONLY: u8 = 4;
const CALCULATE_CRC: u8 = 14;
const ACK: u8 = 128;
const NAK: u8 = 129;
const UNKNOWN_COMMAND: u8 = 7;
const FILE_NOT_FOUND: u8 = 10;

impl Vehicle {
    /// Answers LOG_REQUEST_LIST.
    pub(super) fn logs(&mut self, from: PeerId) {
        self.reply(from, &dialect::LOG_ENTRY_DATA::default());
    }

    /// Answers FILE_TRANSFER_PROTOCOL.
    pub(super) fn files(&mut self, asked: &FileTransfer, asker: (u8, u8), from: PeerId) {
        let request = asked.opcode;
        if !asked.target.is(self.system, AUTOPILOT) || request >= ACK {
            return;
        }
        let mut data = [0; _];
        let refused = request > RESET_SESSIONS;
        if refused {
            data[0] = match request {
                LIST_DIRECTORY | OPEN_READ_ONLY | CALCULATE_CRC => FILE_NOT_FOUND,
                _ => UNKNOWN_COMMAND,
            };
        }
        let answer = FileTransfer {
            network: 0,
            target: asker.into(),
            // The answer's number is the next one.
            seq: asked.seq.wrapping_add(1),
            session: asked.session,
            opcode: if refused { NAK } else { ACK },
            size: u8::from(refused),
            request,
            burst_complete: 0,
            offset: 0,
            data,
        };
        self.reply_view(from, &answer);
    }
}
