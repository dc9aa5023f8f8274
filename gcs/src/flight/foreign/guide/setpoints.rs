//! The setpoints of a flight on a foreign vehicle, in time.

use std::time::Duration;

use crpl_sitl::link::dialect::{
    COMMAND_LONG_DATA, MavCmd, MavFrame, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use crpl_sitl::link::{AUTOPILOT, RADIO};
use crpl_sitl::radio::message::Command;

use super::super::tracking::hold_height;
use super::{ForeignStack, Guide, GuidePhase};

/// Setpoints in the vehicle's time: PX4 wants more than 2 a second, ArduCopter one in 3 s; the height
/// is held through them, too.
const SETPOINT: Duration = Duration::from_millis(50);
/// type_mask: speed and acceleration.
const MASK_SPEED: u16 = 0x0C07;
/// type_mask: position alone.
const MASK_POSITION: u16 = 0x0DF8;

impl Guide {
    /// The station's answer to the newest percept; the datagram that brings it.
    pub fn fly(&mut self, command: &Command, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        let (Some(scene), Some(system)) = (self.scene.as_mut(), self.system) else { return datagram };
        (self.undecided, self.late) = (false, false);
        self.wish = scene.pass(command);
        if self.fleet.get(system).is_some_and(|vehicle| vehicle.components.contains(&RADIO)) {
            let power = COMMAND_LONG_DATA {
                param1: command.power.level() as f32,
                command: MavCmd::MAV_CMD_USER_1,
                target_system: system,
                target_component: RADIO,
                ..Default::default()
            };
            self.station.push(&mut datagram, &power);
        }
        self.next_setpoint = now;
        self.setpoint(now, &mut datagram);
        datagram
    }

    /// The setpoint that is due.
    pub(super) fn setpoint(&mut self, now: Duration, datagram: &mut Vec<u8>) {
        if now < self.next_setpoint {
            return;
        }
        self.next_setpoint = now + self.wall(SETPOINT).max(Duration::from_millis(4));
        let (Some(system), Some(place)) = (self.system, self.place) else { return };
        let px4 = self.foreign.stack == ForeignStack::Px4;
        let mut message = SET_POSITION_TARGET_LOCAL_NED_DATA {
            time_boot_ms: now.as_millis() as u32,
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            target_system: system,
            target_component: AUTOPILOT,
            ..Default::default()
        };
        let mask = match self.phase {
            GuidePhase::Prestream | GuidePhase::Mode | GuidePhase::Arm | GuidePhase::Climb
                if px4 || (self.airborne && self.phase == GuidePhase::Climb) =>
            {
                [message.x, message.y] = [self.ground[0], self.ground[1]];
                message.z = self.height() as f32;
                MASK_POSITION
            }
            GuidePhase::Approach => {
                [message.x, message.y] = self.start();
                message.z = self.height() as f32;
                MASK_POSITION
            }
            GuidePhase::Flying | GuidePhase::Braking => {
                let last = self.tracked.replace(place.boot).unwrap_or(place.boot);
                let dt = place.boot.saturating_sub(last).as_secs_f64();
                let velocity = [place.velocity[0], place.velocity[1]].map(f64::from);
                let here = [place.position[0], place.position[1]];
                let room = self.scene.as_ref().map_or([[f64::INFINITY; 2]; 2], |scene| scene.room(here));
                let wish = if self.late || self.astray { self.tracker.against(dt) } else { self.wish };
                let asked = self.tracker.step(wish, velocity, room, dt);
                [message.vx, message.vy] = asked.velocity.map(|v| v as f32);
                [message.afx, message.afy] = asked.accel.map(|a| a as f32);
                message.vz = hold_height(f64::from(place.position[2]), self.height()) as f32;
                MASK_SPEED
            }
            _ => return,
        };
        message.type_mask = PositionTargetTypemask::from_bits_retain(mask);
        self.foreign.field.turn(&mut message);
        self.station.push(datagram, &message);
    }
}
