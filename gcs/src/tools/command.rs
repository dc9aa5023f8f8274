//! COMMAND_LONG as the standard has it: sent again until answered, with a rising
//! confirmation, one at a time for each command and target. No socket, no clock.
//!
//! An answer counts if it names the command, comes from the target, and is for us or for nobody in
//! particular. IN_PROGRESS stops the repeating and prolongs the wait; a TEMPORARILY_REJECTED behind it
//! is the answer to a repeat that was on its way.

use std::collections::VecDeque;
use std::time::Duration;

use crpl_sitl::link::dialect::{COMMAND_LONG_DATA, MavCmd};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::packet::Packet;

/// Wait before a command is sent again: the standard's autopilots answer within 0.1 s.
const RETRY: Duration = Duration::from_millis(700);
/// How often a command is sent in all.
const ATTEMPTS: u8 = 5;
/// How long a vehicle may take that says IN_PROGRESS, from its last word on.
const PROGRESS: Duration = Duration::from_secs(30);

/// A command for a component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandRequest {
    /// What.
    pub command: MavCmd,
    /// param1 to param7.
    pub params: [f32; 7],
    /// System and component; component 0 asks all, and any answer counts.
    pub target: (u8, u8),
}

impl CommandRequest {
    /// A command whose remaining params are 0.
    #[must_use]
    pub fn new<const N: usize>(command: MavCmd, params: [f32; N], target: (u8, u8)) -> Self {
        let params = std::array::from_fn(|i| params.get(i).copied().unwrap_or(0.0));
        Self { command, params, target }
    }

    fn message(&self, confirmation: u8) -> COMMAND_LONG_DATA {
        let [param1, param2, param3, param4, param5, param6, param7] = self.params;
        COMMAND_LONG_DATA {
            command: self.command,
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
            confirmation,
            target_system: self.target.0,
            target_component: self.target.1,
        }
    }

    /// Whether a second one must wait for this one's answer.
    fn excludes(&self, other: &Self) -> bool {
        self.command == other.command && self.target == other.target
    }
}

/// The vehicle's answer to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandResult {
    /// MAV_RESULT_ACCEPTED.
    Accepted,
    /// Another MAV_RESULT.
    Refused(u8),
    /// No answer to any repeat.
    Unanswered,
}

impl std::fmt::Display for CommandResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Accepted => "accepted",
            Self::Refused(1) => "temporarily rejected",
            Self::Refused(2) => "denied",
            Self::Refused(3) => "not supported",
            Self::Refused(4) => "failed",
            Self::Refused(6) => "cancelled",
            Self::Refused(7) => "refused: only as COMMAND_LONG",
            Self::Refused(8) => "refused: only as COMMAND_INT",
            Self::Refused(9) => "refused: unsupported frame",
            Self::Refused(result) => return write!(f, "refused with result {result}"),
            Self::Unanswered => "not answered",
        })
    }
}

#[derive(Debug, Clone)]
struct Pending {
    request: CommandRequest,
    sent: u8,
    due: Duration,
    in_progress: bool,
}

/// The commands under way.
#[derive(Debug, Clone, Default)]
pub struct CommandQueue {
    /// System and component that ask.
    asker: (u8, u8),
    pending: Vec<Pending>,
    waiting: VecDeque<CommandRequest>,
    done: VecDeque<(CommandRequest, CommandResult)>,
}

impl CommandQueue {
    /// Sends; behind an equal command to the same target, if one is under way.
    pub fn request(&mut self, request: CommandRequest, now: Duration) {
        if self.pending.iter().any(|p| p.request.excludes(&request)) {
            self.waiting.push_back(request);
        } else {
            self.pending.push(Pending { request, sent: 0, due: now, in_progress: false });
        }
    }

    /// Appends what is due by now to a datagram.
    pub fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        self.asker = station.source();
        let mut expired = Vec::new();
        for pending in &mut self.pending {
            if now < pending.due {
                continue;
            }
            if pending.in_progress || pending.sent == ATTEMPTS {
                expired.push(pending.request);
                continue;
            }
            station.push(datagram, &pending.request.message(pending.sent));
            pending.sent += 1;
            pending.due = now + RETRY;
        }
        for request in expired {
            self.close(request, CommandResult::Unanswered, now);
        }
    }

    /// When [`CommandQueue::poll`] has something to do next.
    #[must_use]
    pub fn due(&self) -> Option<Duration> {
        self.pending.iter().map(|pending| pending.due).min()
    }

    /// A packet has come; it may be an answer.
    pub fn packet(&mut self, packet: &Packet, now: Duration) {
        const ACCEPTED: u8 = 0;
        const TEMPORARILY_REJECTED: u8 = 1;
        const IN_PROGRESS: u8 = 5;
        let Some(CommandAck { command, result, target, .. }) = CommandAck::of(packet) else { return };
        let ours = target.is(self.asker.0, self.asker.1);
        let answered = |p: &&mut Pending| {
            let (system, component) = p.request.target;
            p.request.command as u32 == u32::from(command)
                && system == packet.system
                && (component == 0 || component == packet.component)
                && p.sent > 0
        };
        let Some(pending) = self.pending.iter_mut().find(answered).filter(|_| ours) else { return };
        match result {
            IN_PROGRESS => {
                pending.in_progress = true;
                pending.due = now + PROGRESS;
            }
            TEMPORARILY_REJECTED if pending.in_progress => {}
            _ => {
                let result = match result {
                    ACCEPTED => CommandResult::Accepted,
                    other => CommandResult::Refused(other),
                };
                let request = pending.request;
                self.close(request, result, now);
            }
        }
    }

    fn close(&mut self, request: CommandRequest, result: CommandResult, now: Duration) {
        self.pending.retain(|pending| pending.request != request);
        self.done.push_back((request, result));
        if let Some(next) = self.waiting.iter().position(|waiting| waiting.excludes(&request))
            && let Some(next) = self.waiting.remove(next)
        {
            self.request(next, now);
        }
    }

    /// The next command that is over.
    pub fn take(&mut self) -> Option<(CommandRequest, CommandResult)> {
        self.done.pop_front()
    }

    /// Whether a command of this kind is under way or waits.
    #[must_use]
    pub fn busy(&self, command: MavCmd) -> bool {
        self.pending.iter().map(|p| &p.request).chain(&self.waiting).any(|request| request.command == command)
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::dialect::MavResult;
    use crpl_sitl::link::messages::command::CommandLong;

    use super::*;

    const MODE: CommandRequest = CommandRequest {
        command: MavCmd::MAV_CMD_DO_SET_MODE,
        params: [1.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        target: (3, 1),
    };

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// What the queue sends at `now`: command and confirmation of each.
    fn sent(queue: &mut CommandQueue, now: Duration) -> Vec<(u16, u8)> {
        let mut datagram = Vec::new();
        queue.poll(now, &mut Encoder::new(255, 190), &mut datagram);
        let packets = Decoder::default().datagram(&datagram);
        let asks = packets.iter().filter_map(CommandLong::of);
        asks.map(|ask| (ask.command, ask.confirmation)).collect()
    }

    fn ack(from: (u8, u8), command: u16, result: MavResult, to: (u8, u8)) -> Packet {
        let mut datagram = Vec::new();
        Encoder::new(from.0, from.1).push_ack(&mut datagram, command, result, to);
        Decoder::default().datagram(&datagram).remove(0)
    }

    const US: (u8, u8) = (255, 190);
    const OK: MavResult = MavResult::MAV_RESULT_ACCEPTED;

    #[test]
    fn an_unanswered_command_is_sent_five_times_with_rising_confirmation() {
        let mut queue = CommandQueue::default();
        queue.request(MODE, at(0));
        for k in 0..5 {
            assert_eq!(sent(&mut queue, at(700 * k)), [(176, k as u8)]);
            assert_eq!(sent(&mut queue, at(700 * k + 699)), []);
        }
        assert_eq!(
            (sent(&mut queue, at(3500)), queue.take()),
            (vec![], Some((MODE, CommandResult::Unanswered)))
        );
        assert_eq!(queue.due(), None);
    }

    #[test]
    fn only_the_target_s_own_answer_to_us_counts() {
        let mut queue = CommandQueue::default();
        queue.request(MODE, at(0));
        sent(&mut queue, at(0));
        for wrong in [
            ack((2, 1), 176, OK, US),
            ack((3, 68), 176, OK, US),
            ack((3, 1), 400, OK, US),
            ack((3, 1), 176, OK, (254, 190)),
            ack((3, 1), 176, OK, (255, 1)),
        ] {
            queue.packet(&wrong, at(1));
            assert_eq!(queue.take(), None, "{wrong:?}");
        }
        queue.packet(&ack((3, 1), 176, OK, (0, 0)), at(2));
        assert_eq!(queue.take(), Some((MODE, CommandResult::Accepted)));
        queue.packet(&ack((3, 1), 176, OK, US), at(3));
        assert_eq!(queue.take(), None, "a second answer is none");
    }

    #[test]
    fn one_is_under_way_for_each_command_and_target() {
        let mut queue = CommandQueue::default();
        let other = CommandRequest { target: (4, 1), ..MODE };
        for request in [MODE, MODE, other] {
            queue.request(request, at(0));
        }
        assert_eq!(sent(&mut queue, at(0)).len(), 2);
        queue.packet(&ack((3, 1), 176, MavResult::MAV_RESULT_DENIED, US), at(5));
        assert_eq!(queue.take(), Some((MODE, CommandResult::Refused(2))));
        assert_eq!(sent(&mut queue, at(5)), [(176, 0)], "the next one starts at confirmation 0");
        assert!(queue.busy(MavCmd::MAV_CMD_DO_SET_MODE));
    }

    #[test]
    fn progress_stops_the_repeats_and_a_late_rejection_of_one_is_no_answer() {
        let mut queue = CommandQueue::default();
        queue.request(MODE, at(0));
        sent(&mut queue, at(0));
        queue.packet(&ack((3, 1), 176, MavResult::MAV_RESULT_IN_PROGRESS, US), at(10));
        assert_eq!(sent(&mut queue, at(5000)), []);
        queue.packet(&ack((3, 1), 176, MavResult::MAV_RESULT_TEMPORARILY_REJECTED, US), at(5000));
        assert_eq!(queue.take(), None);
        queue.packet(&ack((3, 1), 176, OK, US), at(6000));
        assert_eq!(queue.take(), Some((MODE, CommandResult::Accepted)));
    }

    #[test]
    fn a_vehicle_that_stays_in_progress_is_given_up() {
        let mut queue = CommandQueue::default();
        queue.request(MODE, at(0));
        sent(&mut queue, at(0));
        queue.packet(&ack((3, 1), 176, MavResult::MAV_RESULT_IN_PROGRESS, US), at(10));
        assert_eq!(sent(&mut queue, at(10) + PROGRESS), []);
        assert_eq!(queue.take(), Some((MODE, CommandResult::Unanswered)));
    }
}
