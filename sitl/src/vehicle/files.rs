//! The file transfer protocol of a vehicle without files: it says so at once. MAVProxy asks for the
//! parameters as a file first, and asks for them one by one only after a refusal.
//!
//! | asked, of the autopilot | answered to the asker |
//! |---|---|
//! | None, TerminateSession, ResetSessions | Ack |
//! | ListDirectory, OpenFileRO, CalcFileCRC32 | Nak FileNotFound |
//! | anything else | Nak UnknownCommand |
//! | an Ack or a Nak | nothing |

use super::Vehicle;
use crate::link::decoder::Packet;
use crate::link::wire::Target;
use crate::link::{AUTOPILOT, PeerId, dialect};

/// Where the operation begins in the message, and what stands where in it (MAVLink FTP, payload format).
const OPERATION: usize = 3;
const SESSION: usize = 2;
const OPCODE: usize = 3;
const SIZE: usize = 4;
const REQUEST: usize = 5;
const DATA: usize = 12;

const LIST_DIRECTORY: u8 = 3;
const OPEN_READ_ONLY: u8 = 4;
const CALCULATE_CRC: u8 = 14;
const ACK: u8 = 128;
const NAK: u8 = 129;
const UNKNOWN_COMMAND: u8 = 7;
const FILE_NOT_FOUND: u8 = 10;

impl Vehicle {
    /// Answers FILE_TRANSFER_PROTOCOL; tells whether the packet was one.
    pub(super) fn files(&mut self, packet: &Packet, asker: (u8, u8), from: PeerId) -> bool {
        if !packet.is::<dialect::FILE_TRANSFER_PROTOCOL_DATA>() {
            return false;
        }
        let fields = packet.fields();
        let opcode = fields.u8(OPERATION + OPCODE);
        let target = Target { system: fields.u8(1), component: fields.u8(2) };
        if !target.is(self.system, AUTOPILOT) || opcode >= ACK {
            return true;
        }
        let mut payload = [0; 251];
        // The answer's number is the next one.
        payload[..2].copy_from_slice(&fields.u16(OPERATION).wrapping_add(1).to_le_bytes());
        payload[SESSION] = fields.u8(OPERATION + SESSION);
        payload[REQUEST] = opcode;
        payload[OPCODE] = if opcode <= 2 { ACK } else { NAK };
        if opcode > 2 {
            payload[SIZE] = 1;
            payload[DATA] = match opcode {
                LIST_DIRECTORY | OPEN_READ_ONLY | CALCULATE_CRC => FILE_NOT_FOUND,
                _ => UNKNOWN_COMMAND,
            };
        }
        let (target_system, target_component) = asker;
        let answer = dialect::FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system,
            target_component,
            payload,
        };
        self.reply(from, &answer);
        true
    }
}
