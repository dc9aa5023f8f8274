//! CRPL on an autopilot that is not ours: ArduCopter in GUIDED, PX4 in OFFBOARD.
//!
//! The autopilot tells its place and speed; from these the scene is drawn as `sitl`'s camera draws it,
//! and the radio is modelled at the vehicle's place. What CRPL decides goes out as accelerations.
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`scene`] | telemetry to percepts, commands through the radio gate | protocols |
//! | [`tracking`] | accelerations that are flown as they were meant, and the height | protocols |
//! | [`guide`] | mode, arming, climb, setpoints in time | sockets, clocks |

#![expect(clippy::disallowed_methods, reason = "a shell: the vehicle flies by its own clock")]

pub mod guide;
pub mod scene;
pub mod tracking;

use std::pin::pin;
use std::time::Duration;

use anyhow::{Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::terminal::interrupted;
use tokio::time::{Instant, sleep_until};

use crate::flight::{Crew, Flight, FlightEnd, Options};
use crate::tools::bridge::hub::Hub;
use crate::tools::bridge::router::Notice;
use crate::tools::bridge::tell;
use crate::tools::identity::Identity;
use guide::{ForeignStack, Guide, GuideEvent};

/// Which vehicle, and how.
#[derive(Debug, Clone, Copy)]
pub struct Foreign {
    /// Its autopilot.
    pub stack: ForeignStack,
    /// Its system id, or the first that is heard.
    pub system: Option<u8>,
    /// Speed of its simulator relative to real time.
    pub speed: f64,
    /// Who flies.
    pub identity: Identity,
}

/// Takes the vehicle off and flies `crew` on it.
///
/// # Errors
/// Whatever keeps the flight from beginning; later events are in [`Flight::ended`].
pub async fn fly(
    connect: &Endpoint,
    scenario: &Scenario,
    foreign: &Foreign,
    options: &Options,
    crew: &mut impl Crew,
) -> Result<Flight> {
    let mut hub = options.open(connect).await?;
    let ticks = options.ticks.unwrap_or(scenario.horizon);
    let mut guide = Guide::new(scenario.clone(), foreign, ticks);
    let start = Instant::now();
    let mut flight = Flight::default();
    let mut begun = None;
    let mut interrupted = pin!(interrupted());
    loop {
        let now = start.elapsed();
        let datagram = guide.poll(now);
        if !datagram.is_empty() {
            hub.send(&datagram).await;
        }
        while let Some(event) = guide.take() {
            match event {
                GuideEvent::Say(text) => tracing::info!("{text}"),
                GuideEvent::TakeControl(system) => hub.take_control(Some(system)),
                GuideEvent::Percept(percept) => {
                    if begun.is_none()
                        && let Some(tlog) = crew.begin()?
                    {
                        hub.log_to(&tlog)?;
                    }
                    let arrived = Instant::now();
                    let command = crew.command(&percept);
                    let datagram = guide.fly(&command, start.elapsed());
                    hub.send(&datagram).await;
                    flight.latencies_us.push(arrived.elapsed().as_secs_f64() * 1e6);
                    flight.wall = arrived - *begun.get_or_insert(arrived);
                    flight.last = Some(percept);
                    crew.sent();
                }
                GuideEvent::Over(percept) => flight.last = Some(percept),
                GuideEvent::Holding => return Ok(end(hub, flight, FlightEnd::Over, String::new()).await),
                GuideEvent::TakenOver(why) => {
                    tracing::warn!("the operator has taken over ({why}): no more setpoints from here");
                    let why = format!("the operator has taken over: {why}");
                    return Ok(end(hub, flight, FlightEnd::TakenOver, why).await);
                }
                GuideEvent::Failed(how, why) if begun.is_some() => {
                    tracing::warn!("the flight ends: {why}");
                    return Ok(end(hub, flight, how, format!("{connect}: {why}")).await);
                }
                GuideEvent::Failed(_, why) => bail!("{connect}: {why}"),
            }
        }
        let due = start + guide.due().max(now + Duration::from_millis(1));
        tokio::select! {
            () = hub.turn() => {}
            () = sleep_until(due) => {}
            signal = &mut interrupted => {
                let datagram = guide.let_go(start.elapsed());
                hub.send(&datagram).await;
                let why = format!("{signal}: the vehicle was asked to hold its place");
                return Ok(end(hub, flight, FlightEnd::Interrupted(signal), why).await);
            }
        }
        for notice in hub.notices() {
            tell(&notice, &hub);
            if matches!(notice, Notice::ModeChange(_)) {
                guide.taken_over("mode changed");
            }
        }
        while let Some(datagram) = hub.take() {
            guide.datagram(&datagram, start.elapsed());
        }
    }
}

async fn end(mut hub: Hub, flight: Flight, ended: FlightEnd, why: String) -> Flight {
    hub.close().await;
    let lost = hub.rows().iter().map(|row| row.counters.lost()).sum();
    Flight {
        ended,
        why,
        packets: hub.counts(),
        lost,
        suppressed_setpoints: hub.router().suppressed_setpoints(),
        log_error: hub.log_error().map(str::to_owned),
        ..flight
    }
}
