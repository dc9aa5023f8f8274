//! Typed messages to MAVLink 2 frames, with one contiguous sequence per component and link.

use mavlink::{MAVLinkV2MessageRaw, MavHeader, MessageData};

use super::crc::checksum;
use super::dialect;
use super::messages::View;
use super::messages::command::CommandAck;

/// What a datagram may hold, bytes: below the MTU of an Ethernet or a VPN.
pub const DATAGRAM: usize = 1400;

/// One component that sends on one link.
#[derive(Debug, Clone)]
pub struct Encoder {
    system: u8,
    component: u8,
    sequence: u8,
}

impl Encoder {
    /// A component that has sent nothing yet.
    #[must_use]
    pub fn new(system: u8, component: u8) -> Self {
        Self { system, component, sequence: 0 }
    }

    /// System and component that send.
    #[must_use]
    pub fn source(&self) -> (u8, u8) {
        (self.system, self.component)
    }

    /// Appends a frame to a datagram.
    pub fn push<M: MessageData>(&mut self, datagram: &mut Vec<u8>, message: &M) {
        let mut frame = MAVLinkV2MessageRaw::new();
        let header = MavHeader {
            system_id: self.system.into(),
            component_id: self.component,
            sequence: self.next_sequence(),
        };
        frame.serialize_message_data(header, message);
        datagram.extend_from_slice(frame.raw_bytes());
    }

    /// Appends a COMMAND_ACK to a datagram. `command` may be one that the dialect does not know,
    /// which its type cannot hold; `to` is the asker's system and component.
    pub fn push_ack(
        &mut self,
        datagram: &mut Vec<u8>,
        command: u16,
        result: dialect::MavResult,
        to: (u8, u8),
    ) {
        let (result, target) = (result as u8, to.into());
        self.push_view(datagram, &CommandAck { command, result, progress: 0, result_param2: 0, target });
    }

    /// Appends a message by its fields, whatever values they hold.
    pub fn push_view<V: View>(&mut self, datagram: &mut Vec<u8>, view: &V) {
        self.push_payload::<V::Message>(datagram, &view.payload());
    }

    /// Appends a frame of message `M` with this payload, whatever values it holds: the dialect's types
    /// refuse commands and enum values that they have no name for. Zeros at its end are cut.
    pub fn push_payload<M: MessageData>(&mut self, datagram: &mut Vec<u8>, payload: &[u8]) {
        let length = payload.iter().rposition(|&byte| byte != 0).map_or(1, |last| last + 1);
        debug_assert!(length <= M::ENCODED_LEN, "{} is {} bytes long at most", M::NAME, M::ENCODED_LEN);
        let [id0, id1, id2, _] = M::ID.to_le_bytes();
        let start = datagram.len();
        let sequence = self.next_sequence();
        datagram.extend([0xFD, length as u8, 0, 0, sequence, self.system, self.component, id0, id1, id2]);
        datagram.extend_from_slice(&payload[..length]);
        let crc = checksum(&datagram[start + 1..], M::EXTRA_CRC);
        datagram.extend(crc.to_le_bytes());
    }

    fn next_sequence(&mut self) -> u8 {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        sequence
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::decoder::Decoder;

    #[test]
    fn an_ack_is_what_the_dialect_would_have_written() {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let result = dialect::MavResult::MAV_RESULT_DENIED;
        Encoder::new(3, 68).push_ack(&mut ours, 31010, result, (255, 190));
        let ack = dialect::COMMAND_ACK_DATA {
            command: dialect::MavCmd::MAV_CMD_USER_1,
            result,
            progress: 0,
            result_param2: 0,
            target_system: 255,
            target_component: 190,
        };
        Encoder::new(3, 68).push(&mut theirs, &ack);
        assert_eq!(ours, theirs);
    }

    #[test]
    fn sequence_numbers_are_contiguous_and_wrap() {
        let mut encoder = Encoder::new(1, 1);
        let mut decoder = Decoder::default();
        for k in 0..600_u32 {
            let mut out = Vec::new();
            encoder.push(&mut out, &dialect::HEARTBEAT_DATA::default());
            assert_eq!(decoder.datagram(&out)[0].sequence, (k % 256) as u8);
        }
    }
}
