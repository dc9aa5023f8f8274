//! CRPL on an autopilot that is not ours: ArduCopter in GUIDED, PX4 in OFFBOARD.
//!
//! The autopilot tells its place and speed; from these the scene is drawn as `sitl`'s camera draws it,
//! and the radio is modelled at the vehicle's place. What CRPL decides goes out as accelerations.
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`field`] | how the field lies on the ground, what is done at the end | the flight |
//! | [`limits`] | what the vehicle allows by its own parameters | the flight |
//! | [`plan`] | where a flight would be | the vehicle |
//! | [`stack`] | the autopilots and their modes | the flight |
//! | [`scene`] | telemetry to percepts, commands through the radio gate | protocols |
//! | [`tracking`] | accelerations that are flown as they were meant, and the height | protocols |
//! | [`guide`] | mode, arming, climb, setpoints in time | sockets, clocks |

#![expect(clippy::disallowed_methods, reason = "a shell: the vehicle flies by its own clock")]

pub mod field;
pub mod guide;
pub mod limits;
pub mod plan;
pub mod scene;
pub mod stack;
pub mod tracking;

use std::path::PathBuf;
use std::pin::pin;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::terminal::{self, Signal};
use crpl_sitl::radio::message::{Command, Percept};
use tokio::sync::mpsc;
use tokio::time::{Instant, interval, sleep_until};

use crate::flight::{Crew, Flight, FlightEnd, Options};
use crate::tools::bridge::hub::Hub;
use crate::tools::bridge::router::Notice;
use crate::tools::bridge::tell;
use crate::tools::identity::Identity;
use crate::watch::map::FieldPlace;
use field::{FieldFrame, WhenOver};
use guide::{Guide, GuideEvent};
pub use plan::FlightPlan;
use stack::ForeignStack;

/// How long a vehicle is asked to hold its place at the end.
const LAST_WORDS: Duration = Duration::from_secs(5);

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
    /// How the field lies on the ground.
    pub field: FieldFrame,
    /// Where its lower left corner is, north and east of the vehicle's own origin, m; `None`: where it begins is
    /// the scenario's start.
    pub origin: Option<[f32; 2]>,
    /// How far above or below its height it may come before it is stopped, m; `None`:
    /// [`FlightPlan::vertical_limit`].
    pub vertical_limit: Option<f64>,
    /// What the vehicle does when its flight is over.
    pub over: WhenOver,
}

impl Foreign {
    /// The first vehicle that is heard, in real time, in a field to the north.
    #[must_use]
    pub fn new(stack: ForeignStack) -> Self {
        let (identity, field, over) = (Identity::default(), FieldFrame::default(), WhenOver::Hold);
        Self { stack, system: None, speed: 1.0, identity, field, origin: None, vertical_limit: None, over }
    }
}

/// Takes the vehicle off and flies `crew` on it.
///
/// # Errors
/// Whatever keeps the flight from beginning; later events are in [`Flight::ended`].
pub async fn fly<C: Crew + Send + 'static>(
    connect: &Endpoint,
    scenario: &Scenario,
    foreign: &Foreign,
    options: &Options,
    crew: C,
) -> Result<(Flight, C)> {
    let mut bench = ControllerThread::seat(crew);
    let flight = fly_with(connect, scenario, foreign, options, &mut bench).await?;
    Ok((flight, bench.rise()?))
}

/// A crew on a thread of its own: a slow decision holds up neither setpoints nor heartbeats.
struct ControllerThread<C> {
    ask: std::sync::mpsc::Sender<CrewQuestion>,
    answers: mpsc::UnboundedReceiver<Result<Decision>>,
    thread: JoinHandle<C>,
}

/// What a crew is told and asked.
enum CrewQuestion {
    /// How the field lies.
    Located(FieldPlace),
    /// Which command is the answer?
    Percept(Percept),
}

/// A command, and the tlog if this is the first.
struct Decision {
    command: Command,
    tlog: Option<PathBuf>,
}

impl<C: Crew + Send + 'static> ControllerThread<C> {
    fn seat(mut crew: C) -> Self {
        let (ask, asked) = std::sync::mpsc::channel::<CrewQuestion>();
        let (answer, answers) = mpsc::unbounded_channel();
        let thread = std::thread::spawn(move || {
            let (mut first, mut located) = (true, None);
            for question in asked {
                let percept = match question {
                    CrewQuestion::Located(place) => {
                        located = Some(place);
                        continue;
                    }
                    CrewQuestion::Percept(percept) => percept,
                };
                let tlog = if std::mem::take(&mut first) { crew.begin() } else { Ok(None) };
                if let Some(place) = located.take() {
                    crew.located(place);
                }
                let decision = tlog.map(|tlog| Decision { command: crew.command(&percept), tlog });
                if answer.send(decision).is_err() {
                    break;
                }
                crew.sent();
            }
            crew
        });
        Self { ask, answers, thread }
    }

    /// The crew again, when it has finished what it does.
    fn rise(self) -> Result<C> {
        drop(self.ask);
        self.thread.join().map_err(|_| anyhow!("the controller has failed"))
    }
}

async fn fly_with<C>(
    connect: &Endpoint,
    scenario: &Scenario,
    foreign: &Foreign,
    options: &Options,
    bench: &mut ControllerThread<C>,
) -> Result<Flight> {
    let mut hub = options.open(connect).await?;
    let ticks = options.ticks.unwrap_or(scenario.horizon);
    let mut guide = Guide::new(scenario.clone(), foreign, ticks);
    let start = Instant::now();
    let mut flight = Flight::default();
    let mut begun = None;
    let mut arrived = Instant::now();
    let mut interrupted = pin!(terminal::interrupted());
    // The signal that ends the flight, and how long the vehicle is asked to hold its place.
    let mut stopping: Option<(Signal, Duration)> = None;
    loop {
        let now = start.elapsed();
        guide.signatures(options.signing_key.is_some().then(|| hub.refused()));
        let datagram = guide.poll(now);
        if !datagram.is_empty() {
            hub.send(&datagram).await;
        }
        while let Some(event) = guide.take() {
            match event {
                GuideEvent::Say(text) => tracing::info!("{text}"),
                GuideEvent::TakeControl(system) => hub.take_control(Some(system)),
                GuideEvent::Percept(percept) => {
                    arrived = Instant::now();
                    flight.wall = arrived - *begun.get_or_insert(arrived);
                    flight.last = Some(percept.clone());
                    if bench.ask.send(CrewQuestion::Percept(percept)).is_err() {
                        guide.controller_failed(start.elapsed());
                    }
                }
                GuideEvent::Located(origin) => {
                    let place = FieldPlace { origin, heading: foreign.field.degrees };
                    // A crew that is gone is missed at the next percept.
                    let _ = bench.ask.send(CrewQuestion::Located(place));
                }
                GuideEvent::Over(percept) => flight.last = Some(percept),
                GuideEvent::Holding => {
                    if let Some((signal, _)) = stopping {
                        let why = format!("{signal}: the vehicle holds its place");
                        return Ok(end(hub, flight, FlightEnd::Interrupted(signal), why).await);
                    }
                    pass_on(&mut hub, &mut guide, start, options).await;
                    return Ok(end(hub, flight, FlightEnd::Over, String::new()).await);
                }
                GuideEvent::TakenOver(why) => {
                    tracing::warn!("the operator has taken over ({why}): no more setpoints from here");
                    let why = format!("the operator has taken over: {why}");
                    pass_on(&mut hub, &mut guide, start, options).await;
                    return Ok(end(hub, flight, FlightEnd::TakenOver, why).await);
                }
                GuideEvent::Failsafe(why) => {
                    tracing::warn!("the vehicle acts by itself ({why}): no more setpoints from here");
                    pass_on(&mut hub, &mut guide, start, options).await;
                    return Ok(end(hub, flight, FlightEnd::Failsafe, why).await);
                }
                GuideEvent::Crashed(why) => {
                    tracing::warn!("the vehicle has come down ({why}): no more setpoints from here");
                    pass_on(&mut hub, &mut guide, start, options).await;
                    return Ok(end(hub, flight, FlightEnd::Crashed, why).await);
                }
                GuideEvent::Failed(how, why) if begun.is_some() => {
                    tracing::warn!("the flight ends: {why}");
                    pass_on(&mut hub, &mut guide, start, options).await;
                    return Ok(end(hub, flight, how, format!("{connect}: {why}")).await);
                }
                GuideEvent::Failed(_, why) => bail!("{connect}: {why}"),
            }
        }
        if let Some((signal, until)) = stopping
            && start.elapsed() >= until
        {
            let why = format!("{signal}: the vehicle did not answer when it was asked to hold its place");
            return Ok(end(hub, flight, FlightEnd::Interrupted(signal), why).await);
        }
        let due = start + guide.due().max(now + Duration::from_millis(1));
        tokio::select! {
            () = hub.turn() => {}
            () = sleep_until(due) => {}
            Some(decision) = bench.answers.recv() => {
                let Decision { command, tlog } = decision?;
                if let Some(tlog) = tlog {
                    hub.log_to(&tlog)?;
                }
                let datagram = guide.fly(&command, start.elapsed());
                hub.send(&datagram).await;
                flight.latencies_us.push(arrived.elapsed().as_secs_f64() * 1e6);
            }
            signal = &mut interrupted => {
                let now = start.elapsed();
                if stopping.is_some() || !guide.let_go(now) {
                    let why = format!("{signal}: the vehicle was left as it was");
                    return Ok(end(hub, flight, FlightEnd::Interrupted(signal), why).await);
                }
                tracing::warn!("{signal}: the vehicle is asked to hold its place; once more ends at once");
                stopping = Some((signal, now + LAST_WORDS));
                interrupted.set(terminal::interrupted());
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

/// The flight is over, and others may talk to the vehicle through this program: goes on passing their messages
/// to and fro until a signal comes, the vehicle is disarmed or its link is lost.
async fn pass_on(hub: &mut Hub, guide: &mut Guide, start: Instant, options: &Options) {
    if options.forward.is_empty() {
        return;
    }
    hub.take_control(None);
    tracing::info!("messages are passed on until the vehicle is disarmed, or Ctrl-C");
    let mut interrupted = pin!(terminal::interrupted());
    let mut beat = interval(Duration::from_secs(1));
    while guide.is_armed() && !guide.is_lost() {
        tokio::select! {
            () = hub.turn() => {}
            _ = beat.tick() => {
                hub.save();
                let datagram = guide.idle(start.elapsed());
                hub.send(&datagram).await;
            }
            _ = &mut interrupted => return,
        }
        hub.notices().iter().for_each(|notice| tell(notice, hub));
        while let Some(datagram) = hub.take() {
            guide.datagram(&datagram, start.elapsed());
        }
        while guide.take().is_some() {}
    }
}

async fn end(mut hub: Hub, flight: Flight, ended: FlightEnd, why: String) -> Flight {
    hub.close().await;
    let lost = hub.router().vehicle_lost();
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
