//! While a flight controls a vehicle, setpoints of others are not passed on, and their changes of its mode are told.

use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::link::wire;

use super::{LinkId, Notice, Router, id};

impl Router {
    /// From now on only `by` sends setpoints to system `vehicle`; `None` ends that.
    pub fn take_control(&mut self, control: Option<(u8, LinkId)>) {
        self.vehicle = control.map(|(vehicle, _)| vehicle).or(self.vehicle);
        self.control = control;
        self.suppressed_setpoints = 0;
        self.mode_asked.clear();
    }

    /// Setpoints suppressed since [`Router::take_control`].
    #[must_use]
    pub fn suppressed_setpoints(&self) -> u64 {
        self.suppressed_setpoints
    }

    /// Frames of the controlled vehicle that never came: gaps of other stations are none of the flight's.
    #[must_use]
    pub fn vehicle_lost(&self) -> u64 {
        let sources = self.links.values().flat_map(|link| &link.sources);
        sources.filter(|((system, _), _)| Some(*system) == self.vehicle).map(|(_, source)| source.lost).sum()
    }

    /// Whether this packet is a setpoint that the flight in control suppresses.
    pub(super) fn suppresses_setpoint(&mut self, from: LinkId, frame: &PacketRef<'_>) -> bool {
        let Some((vehicle, pilot)) = self.control else { return false };
        let Target { system, .. } = frame.target();
        if let Some(ack) = CommandAck::of(*frame).filter(|_| frame.system == vehicle) {
            self.mode_answered(&ack);
        }
        if from == pilot || (system != vehicle && system != 0) {
            return false;
        }
        if let Some(command) = mode_command(frame) {
            self.mode_asked.retain(|&(other, _)| other != command);
            self.mode_asked.push((command, from));
            return false;
        }
        let flies = matches!(
            frame.id,
            id::SET_POSITION_TARGET_LOCAL_NED
                | id::SET_POSITION_TARGET_GLOBAL_INT
                | id::SET_ATTITUDE_TARGET
                | id::MANUAL_CONTROL
                | id::RC_CHANNELS_OVERRIDE
        );
        if flies {
            if self.suppressed_setpoints == 0 {
                self.notices.push(Notice::SetpointSuppressed(from));
            }
            self.suppressed_setpoints += 1;
        }
        flies
    }

    /// An operator's mode change counts once the vehicle has accepted it.
    fn mode_answered(&mut self, ack: &CommandAck) {
        const ACCEPTED: u8 = 0;
        const IN_PROGRESS: u8 = 5;
        let Some(at) = self.mode_asked.iter().position(|&(asked, _)| asked == ack.command) else { return };
        let (_, by) = self.mode_asked.swap_remove(at);
        if matches!(ack.result, ACCEPTED | IN_PROGRESS) {
            self.notices.push(Notice::ModeChange(by));
        }
    }
}

/// The command with which a frame takes the vehicle out of the mode in which it is flown from here:
/// a mode, a way home, down or up, a place, a mission, or its motors off.
fn mode_command(frame: &PacketRef<'_>) -> Option<u16> {
    const NAV_RETURN_TO_LAUNCH: u16 = 20;
    const NAV_LAND: u16 = 21;
    const NAV_TAKEOFF: u16 = 22;
    const DO_SET_MODE: u16 = 176;
    const DO_REPOSITION: u16 = 192;
    const DO_PAUSE_CONTINUE: u16 = 193;
    const MISSION_START: u16 = 300;
    const COMPONENT_ARM_DISARM: u16 = 400;
    const COMMANDS: [u16; 7] = [
        NAV_RETURN_TO_LAUNCH,
        NAV_LAND,
        NAV_TAKEOFF,
        DO_SET_MODE,
        DO_REPOSITION,
        DO_PAUSE_CONTINUE,
        MISSION_START,
    ];
    // Some vehicles answer the old message as they answer the command.
    if frame.id == id::SET_MODE {
        return Some(DO_SET_MODE);
    }
    let wire::Ask { command, params: [first, ..], .. } = wire::ask_of(*frame)?;
    let disarms = command == COMPONENT_ARM_DISARM && first == 0.0;
    (disarms || COMMANDS.contains(&command)).then_some(command)
}
