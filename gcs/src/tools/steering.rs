//! What a page asks of vehicles, carried out by commands that are sent until they are answered. No socket, no clock.
//!
//! | asked | ArduPilot and `sitl` | PX4 |
//! |---|---|---|
//! | hold | BRAKE | LOITER |
//! | return | RTL | RTL |
//! | land | LAND | LAND |
//! | give back | GUIDED | OFFBOARD |

use std::time::Duration;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::MavCmd;
use crpl_sitl::link::encoder::Encoder;
use tokio::sync::mpsc::Receiver;

use crate::tools::command::{CommandQueue, CommandRequest, CommandResult};
use crate::tools::fleet::Stack;
use crate::watch::control::{VehicleAction, VehicleRequest};

/// MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.
const CUSTOM: f32 = 1.0;

/// The way from a page to vehicles.
#[derive(Debug, Default)]
pub struct PageSteering {
    requests: Option<Receiver<VehicleRequest>>,
    queue: CommandQueue,
    decoder: Decoder,
    open: Vec<(CommandRequest, VehicleRequest)>,
}

/// The command that sets the mode.
fn mode(action: VehicleAction, stack: Stack, target: (u8, u8)) -> CommandRequest {
    let (main, sub) = match (stack, action) {
        (Stack::Px4, VehicleAction::Hold) => (4.0, 3.0),
        (Stack::Px4, VehicleAction::Return) => (4.0, 5.0),
        (Stack::Px4, VehicleAction::Land) => (4.0, 6.0),
        (Stack::Px4, VehicleAction::GiveBack) => (6.0, 0.0),
        (_, VehicleAction::Hold) => (17.0, 0.0),
        (_, VehicleAction::Return) => (6.0, 0.0),
        (_, VehicleAction::Land) => (9.0, 0.0),
        (_, VehicleAction::GiveBack) => (4.0, 0.0),
    };
    CommandRequest::new(MavCmd::MAV_CMD_DO_SET_MODE, [CUSTOM, main, sub], target)
}

impl PageSteering {
    /// Of the page whose requests come here; `None`: there is none, or it only watches.
    #[must_use]
    pub fn new(requests: Option<Receiver<VehicleRequest>>) -> Self {
        Self { requests, ..Self::default() }
    }

    /// Whether a page may steer.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.requests.is_some()
    }

    /// The next request; never where no page may steer.
    pub async fn next(&mut self) -> VehicleRequest {
        loop {
            match &mut self.requests {
                None => std::future::pending().await,
                Some(requests) => match requests.recv().await {
                    Some(request) => return request,
                    None => self.requests = None,
                },
            }
        }
    }

    /// Asks the vehicle at `target`; the page hears its answer.
    pub fn ask(&mut self, asked: VehicleRequest, stack: Stack, target: (u8, u8), now: Duration) {
        let request = mode(asked.action, stack, target);
        tracing::info!("the page asks vehicle {}: {}", target.0, asked.action.name());
        self.queue.request(request, now);
        self.open.push((request, asked));
    }

    /// A datagram has come; there may be an answer in it.
    pub fn datagram(&mut self, bytes: &[u8], now: Duration) {
        if self.open.is_empty() {
            return;
        }
        for packet in self.decoder.datagram(bytes) {
            self.queue.packet(&packet, now);
        }
    }

    /// What is to be sent by now, which may be nothing; tells the pages what was answered.
    pub fn poll(&mut self, now: Duration, station: &mut Encoder) -> Vec<u8> {
        let mut datagram = Vec::new();
        self.queue.poll(now, station, &mut datagram);
        while let Some((request, result)) = self.queue.take() {
            let Some(at) = self.open.iter().position(|(open, _)| *open == request) else { continue };
            let (_, asked) = self.open.remove(at);
            let text = format!("vehicle {}: {}: {result}", request.target.0, asked.action.name());
            tracing::info!("{text}");
            let answer = if result == CommandResult::Accepted { Ok(text) } else { Err(text) };
            // A page that has gone away wants no answer.
            let _ = asked.answer.send(answer);
        }
        datagram
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::dialect::MavResult;
    use crpl_sitl::link::messages::View;
    use crpl_sitl::link::messages::command::CommandLong;
    use tokio::sync::{mpsc, oneshot};

    use super::*;

    #[tokio::test]
    async fn a_page_hears_what_the_vehicle_answers() {
        let (page, requests) = mpsc::channel(1);
        let mut steering = PageSteering::new(Some(requests));
        for (result, accepted) in
            [(MavResult::MAV_RESULT_ACCEPTED, true), (MavResult::MAV_RESULT_DENIED, false)]
        {
            let (answer, answered) = oneshot::channel();
            page.send(VehicleRequest { vehicle: 1, action: VehicleAction::Hold, answer }).await.unwrap();
            let asked = steering.next().await;
            steering.ask(asked, Stack::ArduPilot, (1, 1), Duration::ZERO);
            let datagram = steering.poll(Duration::ZERO, &mut Encoder::new(255, 190));
            let packet = Decoder::default().datagram(&datagram).swap_remove(0);
            let command = CommandLong::of(&packet).unwrap();
            assert_eq!((command.command, command.params[1]), (176, 17.0));
            let (mut autopilot, mut ack) = (Encoder::new(1, 1), Vec::new());
            autopilot.push_ack(&mut ack, 176, result, (255, 190));
            steering.datagram(&ack, Duration::from_millis(10));
            assert!(steering.poll(Duration::from_millis(10), &mut Encoder::new(255, 190)).is_empty());
            assert_eq!(answered.await.unwrap().is_ok(), accepted);
        }
    }

    #[test]
    fn each_stack_has_its_own_modes() {
        let params = |action, stack| mode(action, stack, (1, 1)).params;
        assert_eq!(params(VehicleAction::Return, Stack::ArduPilot)[..3], [1.0, 6.0, 0.0]);
        assert_eq!(params(VehicleAction::Return, Stack::Px4)[..3], [1.0, 4.0, 5.0]);
        assert_eq!(params(VehicleAction::GiveBack, Stack::Px4)[..3], [1.0, 6.0, 0.0]);
    }
}
