//! What a foreign vehicle says, and what people call the commands that it gets.

use crpl_sitl::link::dialect::{MavCmd, MavMessage, STATUSTEXT_DATA};
use crpl_sitl::link::packet::Packet;

/// Texts of a vehicle, of which long ones come in several parts.
#[derive(Debug, Default)]
pub(super) struct Texts {
    /// Number, severity and what has come of a text that goes on.
    open: Option<(u16, u8, String)>,
}

impl Texts {
    /// A whole text and its severity, if this packet ends one.
    pub(super) fn packet(&mut self, packet: &Packet) -> Option<(u8, String)> {
        const LENGTH: usize = 50;
        if !packet.is::<STATUSTEXT_DATA>() {
            return None;
        }
        let Some(MavMessage::STATUSTEXT(message)) = packet.message() else { return None };
        let part = message.text.to_str().unwrap_or_default();
        let severity = message.severity as u8;
        if message.id == 0 {
            return Some((severity, part.to_owned()));
        }
        let begun = self.open.take().filter(|(id, ..)| *id == message.id && message.chunk_seq > 0);
        let text = begun.map_or_else(String::new, |(.., text)| text) + part;
        if part.len() < LENGTH {
            return Some((severity, text));
        }
        self.open = Some((message.id, severity, text));
        None
    }
}

/// A command as people call it.
pub(super) fn words(command: MavCmd) -> &'static str {
    match command {
        MavCmd::MAV_CMD_DO_SET_MODE => "mode",
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => "arming",
        MavCmd::MAV_CMD_NAV_TAKEOFF => "takeoff",
        _ => "command",
    }
}
