//! What the vehicle answers: setpoints, commands, image requests, echoes.

use std::time::Duration;

use super::conduct::Mode;
use super::modes;
use super::{Vehicle, camera, messages};
use crate::link::dialect::{self, MavResult, MavSeverity, MavType};
use crate::link::image::{self, ImageRequest};
use crate::link::messages::command::SetMode;
use crate::link::messages::image::Handshake;
use crate::link::messages::param::{ParamRequestList, ParamRequestRead, ParamSet};
use crate::link::messages::service::{FileTransfer, Ping, RequestDataStream, Timesync};
use crate::link::messages::status::Heartbeat;
use crate::link::messages::{Target, View};
use crate::link::packet::{Packet, PacketRef};
use crate::link::wire::{self, Ask, CMD_TX_POWER, Refusal, Setpoint};
use crate::link::{AUTOPILOT, CAMERA, MessageData, PeerId, RADIO, message_name};
use crate::radio::message::Command;
use crate::units::TxPower;

const CMD_PREFLIGHT_REBOOT: u16 = 246;
const CMD_DO_SET_HOME: u16 = 179;
const CMD_GET_HOME_POSITION: u16 = 410;
const CMD_GET_MESSAGE_INTERVAL: u16 = 510;
const CMD_SET_MESSAGE_INTERVAL: u16 = 511;
const CMD_REQUEST_MESSAGE: u16 = 512;
const CMD_REQUEST_PROTOCOL_VERSION: u16 = 519;
const CMD_REQUEST_CAPABILITIES: u16 = 520;
const CMD_DO_SET_MISSION_CURRENT: u16 = 224;
/// DATA_TRANSMISSION_HANDSHAKE, which stands for a whole frame.
pub(super) const IMAGE: f32 = 130.0;
/// What autopilots take and this one does not: it says so.
const LACKS: [u32; 5] = [
    dialect::RC_CHANNELS_OVERRIDE_DATA::ID,
    dialect::SET_ATTITUDE_TARGET_DATA::ID,
    dialect::SET_ACTUATOR_CONTROL_TARGET_DATA::ID,
    dialect::SET_GPS_GLOBAL_ORIGIN_DATA::ID,
    dialect::SET_HOME_POSITION_DATA::ID,
];
const OK: MavResult = MavResult::MAV_RESULT_ACCEPTED;

impl Vehicle {
    pub(super) fn packet(&mut self, packet: &Packet, from: PeerId, now: Duration) {
        // Our own frames, sent back by a loop in somebody's routing.
        if packet.system == self.system && matches!(packet.component, AUTOPILOT | RADIO | CAMERA) {
            return;
        }
        let asker = (packet.system, packet.component);
        if Heartbeat::of(packet).is_some_and(|beat| beat.kind == MavType::MAV_TYPE_GCS as u8) {
            self.loss_of_link.arrived();
        }
        if let Some((target, setpoint)) = wire::setpoint_of(packet) {
            if target.is(self.system, AUTOPILOT) {
                self.loss_of_link.arrived();
                let commander = (from, asker);
                if self.commander.replace(commander).is_some_and(|before| before != commander) && !self.over()
                {
                    let (system, component) = asker;
                    let text = format!("setpoints from another peer, {system}/{component}");
                    self.say("commander", MavSeverity::MAV_SEVERITY_WARNING, &text, now);
                }
                self.setpoint(setpoint, now);
            }
        } else if let Some(ask) = wire::ask_of(packet) {
            self.ask(&ask, asker, from, now);
        } else if let Some(handshake) = Handshake::of(packet) {
            self.image_request(handshake.request(), from, now);
        } else if let Some(transfer) = FileTransfer::of(packet) {
            self.files(&transfer, asker, from);
        } else if let Some(set) = ParamSet::of(packet) {
            self.param_set(set.target, &set.name.lossy(), f32::from_le_bytes(set.value), asker, from, now);
        } else if let Some(read) = ParamRequestRead::of(packet) {
            self.param_read(read.target, read.index, &read.name.lossy(), asker, from);
        } else if let Some(list) = ParamRequestList::of(packet) {
            self.param_list(list.target, from);
        } else if let Some(request) = RequestDataStream::of(packet) {
            if self.autopilot_is_meant(request.target) {
                let hz = if request.start == 0 { 0 } else { request.rate };
                self.set_group(request.stream, f64::from(hz), from, now);
            }
        } else if let Some(set) = SetMode::of(packet) {
            if set.system == self.system {
                let result = self.set_mode(set.base_mode, set.custom_mode as f32, now);
                self.ack(dialect::SET_MODE_DATA::ID as u16, result, AUTOPILOT, asker, from);
            }
        } else if let Some(ping) = Ping::of(packet) {
            // To nobody in particular it is a request; addressed to somebody, an answer.
            if ping.target == Target::default() {
                self.reply_view(from, &Ping { target: asker.into(), ..ping });
            }
        } else if let Some(sync) = Timesync::of(packet) {
            if sync.tc1 == 0 && self.autopilot_is_meant(sync.target) {
                let tc1 = self.boot_ns(now) as i64;
                self.reply_view(from, &Timesync { tc1, target: asker.into(), ..sync });
            }
        } else if packet.is::<dialect::LOG_REQUEST_LIST_DATA>() {
            if self.autopilot_is_meant(PacketRef::from(packet).target()) {
                self.logs(from);
            }
        } else if LACKS.contains(&packet.id) {
            if self.autopilot_is_meant(PacketRef::from(packet).target()) {
                let name = message_name(packet.id).unwrap_or_default();
                self.say_once(name, MavSeverity::MAV_SEVERITY_WARNING, &format!("{name} is not supported"));
            }
        } else {
            self.mission(packet, asker, from, now);
        }
    }

    /// A stamp that is a tick's, of now or earlier, names that tick; any other means now.
    fn setpoint(&mut self, setpoint: Result<Setpoint, Refusal>, now: Duration) {
        let setpoint = match setpoint {
            Ok(setpoint) => setpoint,
            Err(refusal) => return self.refuse(refusal, now),
        };
        let current = self.sim.tick();
        let stamped = self.clock.tick_near(setpoint.stamp_ms, current).filter(|&tick| tick <= current);
        let tick = stamped.unwrap_or(current);
        if self.over() {
            self.acknowledged |= stamped == Some(current);
            return;
        }
        if tick == current {
            self.tally.setpoints += 1;
            self.ready = true;
        } else {
            self.tally.stale += 1;
        }
        self.begun = true;
        if !self.takes_setpoints() {
            self.tally.ignored += 1;
            let is_guided = self.conduct.mode == Mode::Guided;
            let why = if is_guided { "on the ground" } else { self.conduct.mode.name() };
            self.refused("setpoint", &format!("setpoint ignored: {why}"), now);
            return;
        }
        match setpoint.level_acceleration() {
            Some(accel) => {
                self.waiting_target = None;
                self.turn(self.turn_of(&setpoint));
                self.sim.handle(Command::new(tick, accel, self.sim.power()));
            }
            None => self.guide(&setpoint, tick, now),
        }
    }

    pub(super) fn takes_setpoints(&self) -> bool {
        self.conduct.mode == Mode::Guided && self.conduct.armed && !self.height.on_ground()
    }

    fn refuse(&mut self, refusal: Refusal, now: Duration) {
        *self.tally.refused.entry(refusal).or_default() += 1;
        self.say(refusal.kind(), MavSeverity::MAV_SEVERITY_WARNING, &refusal.to_string(), now);
    }

    fn ask(&mut self, ask: &Ask, asker: (u8, u8), from: PeerId, now: Duration) {
        let (to_autopilot, to_radio) = (self.autopilot_is_meant(ask.target), self.radio_is_meant(ask.target));
        let to_camera = ask.target.is(self.system, CAMERA);
        if to_autopilot || to_radio || to_camera {
            self.loss_of_link.arrived();
        }
        let component = match (to_autopilot, to_radio) {
            (true, _) => AUTOPILOT,
            (false, true) => RADIO,
            (false, false) => CAMERA,
        };
        let [first, second, ..] = ask.params;
        match ask.command {
            CMD_TX_POWER if to_radio => {
                let result = self.tx_power([first, second]);
                self.ack(ask.command, result, RADIO, asker, from);
            }
            _ if !to_autopilot && !to_radio && !to_camera => {}
            command if (to_camera || to_autopilot) && camera::COMMANDS.contains(&command) => {
                let component = if to_camera { CAMERA } else { AUTOPILOT };
                self.camera_command(ask, component, asker, from, now);
            }
            CMD_REQUEST_MESSAGE if to_autopilot && first == IMAGE => {
                self.ack(ask.command, OK, component, asker, from);
                self.send_image(from);
            }
            CMD_DO_SET_HOME if to_autopilot => {
                let result = self.set_home(ask);
                self.ack(ask.command, result, AUTOPILOT, asker, from);
                if result == OK {
                    // Everybody's map shows it.
                    for peer in self.addresses() {
                        self.send_by_id(dialect::HOME_POSITION_DATA::ID, peer, now);
                    }
                }
            }
            CMD_GET_HOME_POSITION if to_autopilot => {
                self.ack(ask.command, OK, AUTOPILOT, asker, from);
                self.send_by_id(dialect::HOME_POSITION_DATA::ID, from, now);
            }
            CMD_REQUEST_PROTOCOL_VERSION if to_autopilot => {
                self.ack(ask.command, OK, AUTOPILOT, asker, from);
                self.send_by_id(dialect::PROTOCOL_VERSION_DATA::ID, from, now);
            }
            CMD_PREFLIGHT_REBOOT if to_autopilot => {
                // 0 asks for nothing, 1 for a reboot; it has nothing that it could shut down or flash.
                let result = if first == 0.0 || first == 1.0 { OK } else { MavResult::MAV_RESULT_DENIED };
                self.ack(ask.command, result, AUTOPILOT, asker, from);
                if first == 1.0 {
                    self.reboot(now);
                }
            }
            CMD_REQUEST_MESSAGE => {
                let found = self.requested(first, component, now);
                self.ack(ask.command, found.err().unwrap_or(OK), component, asker, from);
                if let Ok(row) = found {
                    self.send_message(row, from, now);
                }
            }
            CMD_REQUEST_CAPABILITIES if to_autopilot => {
                self.ack(ask.command, OK, AUTOPILOT, asker, from);
                self.send_by_id(dialect::AUTOPILOT_VERSION_DATA::ID, from, now);
            }
            CMD_SET_MESSAGE_INTERVAL => {
                let result = self.set_interval([first, second], component, from, now);
                self.ack(ask.command, result, component, asker, from);
            }
            CMD_GET_MESSAGE_INTERVAL => {
                let result = self.tell_interval(first, component, from);
                self.ack(ask.command, result, component, asker, from);
            }
            CMD_DO_SET_MISSION_CURRENT if to_autopilot => {
                let result = self.current_command([first, second], now);
                self.ack(ask.command, result, AUTOPILOT, asker, from);
            }
            command if to_autopilot && modes::COMMANDS.contains(&command) => {
                let result = self.mode_command(ask, now);
                self.ack(ask.command, result, AUTOPILOT, asker, from);
            }
            _ => {
                self.tally.unsupported += 1;
                self.ack(ask.command, MavResult::MAV_RESULT_UNSUPPORTED, component, asker, from);
            }
        }
    }

    /// param1 is the level; param2 the boot ms of the command's tick, or 0. A late duplicate of an
    /// older command must not undo a newer one.
    fn tx_power(&mut self, [level, stamp]: [f32; 2]) -> MavResult {
        let Ok(power) = TxPower::from_level(level) else { return MavResult::MAV_RESULT_DENIED };
        let now = self.clock.boot_ms(self.sim.tick()) as f32;
        if stamp > 0.0 && stamp <= now {
            if self.newest_power.is_some_and(|newest| stamp < newest) {
                return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
            }
            self.newest_power = Some(stamp);
        }
        self.sim.set_power(power);
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// Sends one peer the autopilot's message with this number.
    fn send_by_id(&mut self, id: u32, to: PeerId, now: Duration) {
        if let Some(row) = messages::row(id, AUTOPILOT) {
            self.send_message(row, to, now);
        }
    }

    pub(super) fn image_request(&mut self, request: ImageRequest, from: PeerId, now: Duration) {
        let Some(peer) = self.peers.get_mut(&from) else { return };
        match request {
            ImageRequest::Start => {
                let is_new = peer.images.is_none();
                peer.images.get_or_insert(1);
                if is_new {
                    self.send_image(from);
                }
            }
            ImageRequest::Stop => {
                peer.images = None;
                let mut datagram = Vec::new();
                image::push_stopped(&mut peer.autopilot, &mut datagram);
                self.outbox.push_back((from, datagram));
            }
            ImageRequest::OtherType(kind) => {
                let text = format!("image type {kind} refused: only PNG (5)");
                self.say("image type", MavSeverity::MAV_SEVERITY_WARNING, &text, now);
            }
            ImageRequest::NoRequest => {}
        }
    }

    fn autopilot_is_meant(&self, target: Target) -> bool {
        target.is(self.system, AUTOPILOT)
    }

    fn radio_is_meant(&self, target: Target) -> bool {
        target.is(self.system, RADIO)
    }

    pub(super) fn reply<M: MessageData>(&mut self, to: PeerId, message: &M) {
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        peer.autopilot.push(&mut datagram, message);
        self.outbox.push_back((to, datagram));
    }

    /// The same, of a message by its fields.
    pub(super) fn reply_view<V: View>(&mut self, to: PeerId, view: &V) {
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        peer.autopilot.push_view(&mut datagram, view);
        self.outbox.push_back((to, datagram));
    }

    /// The same, as a message of the same layout.
    pub(super) fn reply_twin<M: MessageData, V: View>(&mut self, to: PeerId, view: &V) {
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        peer.autopilot.push_payload::<M>(&mut datagram, &view.payload());
        self.outbox.push_back((to, datagram));
    }

    pub(super) fn ack(
        &mut self,
        command: u16,
        result: MavResult,
        component: u8,
        asker: (u8, u8),
        to: PeerId,
    ) {
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        peer.encoder(component).push_ack(&mut datagram, command, result, asker);
        self.outbox.push_back((to, datagram));
    }
}
