//! What a foreign vehicle is asked for, and what follows from its answers.

use std::time::Duration;

use crpl_sitl::link::AUTOPILOT;
use crpl_sitl::link::MessageData;
use crpl_sitl::link::dialect::{
    ATTITUDE_DATA, BATTERY_STATUS_DATA, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, LOCAL_POSITION_NED_DATA,
    MavCmd, SYS_STATUS_DATA,
};
use crpl_sitl::link::messages::Target;
use crpl_sitl::link::messages::service::RequestDataStream;

use super::words::words;
use super::{Guide, GuideEvent, GuidePhase};
use crate::tools::command::{CommandRequest, CommandResult};

/// Time between position reports that is asked for, µs.
const REPORT_US: f32 = 50_000.0;
/// How long a refused mode or arming waits before it is asked for again: checks take their time.
const AGAIN: Duration = Duration::from_secs(1);
/// Messages that a log of the flight wants, and how often, µs.
const LOGGED: [(u32, f32); 5] = [
    (ATTITUDE_DATA::ID, 250_000.0),
    (GLOBAL_POSITION_INT_DATA::ID, 250_000.0),
    (GPS_RAW_INT_DATA::ID, 500_000.0),
    (SYS_STATUS_DATA::ID, 1_000_000.0),
    (BATTERY_STATUS_DATA::ID, 1_000_000.0),
];
const STREAM_ALL: u8 = 0;
const STREAM_POSITION: u8 = 6;

impl Guide {
    pub(super) fn request_streams(&mut self, system: u8, now: Duration) {
        let params = [LOCAL_POSITION_NED_DATA::ID as f32, REPORT_US];
        let request = CommandRequest::new(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, params, (system, AUTOPILOT));
        self.commands.request(request, now);
        for (id, every) in LOGGED {
            let params = [id as f32, every];
            let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
            self.commands.request(CommandRequest::new(command, params, (system, AUTOPILOT)), now);
        }
    }

    pub(super) fn ask_once(&mut self, command: MavCmd, params: &[f32], now: Duration) {
        let Some(system) = self.system else { return };
        if self.asked.is_some() || self.retry.is_none_or(|at| now < at) {
            return;
        }
        self.asked = Some(command);
        self.retry = None;
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        self.commands.request(CommandRequest { command, params: all, target: (system, AUTOPILOT) }, now);
    }

    pub(super) fn answered(
        &mut self,
        request: &CommandRequest,
        result: CommandResult,
        datagram: &mut Vec<u8>,
        now: Duration,
    ) {
        match request.command {
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
                if request.params[0] != LOCAL_POSITION_NED_DATA::ID as f32 => {}
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL if result != CommandResult::Accepted => {
                self.say(format!("message interval {result}: asking for data streams"));
                let (system, component) = request.target;
                for (stream, hz) in [(STREAM_POSITION, 20), (STREAM_ALL, 4)] {
                    let target = Target { system, component };
                    self.station
                        .push_view(datagram, &RequestDataStream { rate: hz, target, stream, start: 1 });
                }
            }
            command if self.asked == Some(command) && result != CommandResult::Accepted => {
                let complaint =
                    if self.complaint.is_empty() { String::new() } else { format!(": {}", self.complaint) };
                self.say(format!("{} {result}{complaint}", words(command)));
                self.asked = None;
                self.retry = Some(now + self.wall(AGAIN));
            }
            command if self.asked == Some(command) => self.accepted(command, now),
            _ => {}
        }
    }

    /// The step's command was accepted.
    fn accepted(&mut self, command: MavCmd, now: Duration) {
        match (self.phase, command) {
            (GuidePhase::Mode, MavCmd::MAV_CMD_DO_SET_MODE) => {
                self.enter(if self.airborne { GuidePhase::Climb } else { GuidePhase::Arm }, now);
                self.events.extend(self.system.map(GuideEvent::TakeControl));
            }
            (GuidePhase::Arm, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM) => self.enter(GuidePhase::Climb, now),
            (GuidePhase::Braking, MavCmd::MAV_CMD_DO_SET_MODE) => match self.failing.take() {
                Some((how, why)) => self.fail(how, format!("{why}; it holds its place")),
                None => {
                    self.phase = GuidePhase::Done;
                    self.events.push_back(GuideEvent::Holding);
                }
            },
            _ => {}
        }
    }
}
