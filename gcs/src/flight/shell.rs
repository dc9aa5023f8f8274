//! The loop of a flight: sockets, timers and events around a station's [`Remote`] and its [`Crew`].

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

use std::collections::{BTreeMap, VecDeque};
use std::pin::pin;
use std::time::{Duration, SystemTime};

use anyhow::{Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::dialect::MavSeverity;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::wire::Clock;
use crpl_sitl::link::{AUTOPILOT, GPS};
use crpl_sitl::program::progress;
use crpl_sitl::program::shell::Backoff;
use crpl_sitl::program::terminal::{Signal, interrupted};
use crpl_sitl::radio::message::Percept;
use crpl_sitl::scenario::CollisionAction;
use crpl_sitl::units::{Tick, TxPower};
use indicatif::ProgressBar;
use tokio::time::{Instant, interval, sleep};

use super::remote::{Remote, RemoteEvent};
use super::{Crew, Flight, FlightEnd, Options};
use crate::tools::bridge::hub::Hub;
use crate::tools::bridge::router::Notice;
use crate::tools::bridge::tell;
use crate::tools::fleet::{News, Stack};
use crate::tools::replay;
use crate::tools::session::Session;
use crate::tools::steering::PageSteering;
use crate::watch::control::{RequestQueue, VehicleRequest};

/// The station's heartbeat.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How often, and how far apart, last words are sent: the vehicle does not answer.
const FAREWELLS: (u32, Duration) = (4, Duration::from_millis(15));

/// Commands after which a vehicle on a slow link still transmits at the power of an older one.
const POWERS: usize = 10;

/// Finds a vehicle of this scenario and flies `crew` on it.
///
/// # Errors
/// No vehicle, and whatever keeps a flight from beginning. Once it has begun, an event that ends it is in
/// [`Flight::ended`].
pub async fn fly(
    connect: &Endpoint,
    scenario: &Scenario,
    options: &Options,
    crew: &mut impl Crew,
) -> Result<Flight> {
    let session = options.find(connect).await?;
    fly_on(session, scenario, options, crew).await
}

/// The same on a vehicle that is found already.
///
/// # Errors
/// As [`fly`].
pub async fn fly_on(
    session: Session,
    scenario: &Scenario,
    options: &Options,
    crew: &mut impl Crew,
) -> Result<Flight> {
    let mut shell = FlightShell::new(session, scenario, options).await?;
    let mut beat = interval(HEARTBEAT);
    let mut resend = Backoff::default();
    let mut interrupted = pin!(interrupted());
    shell.repeat().await;
    loop {
        if let Some(why) = shell.silence()? {
            return Ok(shell.end(FlightEnd::LinkLost, &why).await);
        }
        tokio::select! {
            () = shell.hub.turn() => {}
            () = resend.elapsed() => {
                shell.repeat().await;
                resend.lengthen();
            }
            _ = beat.tick() => {
                shell.beat().await;
                crew.link(&shell.counters());
            }
            asked = shell.steering.next() => shell.ask(asked),
            signal = &mut interrupted => return Ok(shell.interrupted(signal).await),
        }
        shell.steer().await;
        for notice in shell.hub.notices() {
            tell(&notice, &shell.hub);
            if matches!(notice, Notice::ModeChange(_)) && !shell.taken_over("mode changed").await {
                return Ok(shell.not_given_back("mode changed").await);
            }
        }
        let arrived = shell.hub.arrived();
        while let Some(datagram) = shell.hub.take() {
            shell.steering.datagram(&datagram, shell.hub.elapsed());
            for event in shell.remote.datagram(&datagram, shell.hub.elapsed()) {
                match event {
                    RemoteEvent::Percept(percept) => {
                        if shell.first_percept.is_none()
                            && let Some(tlog) = crew.begin()?
                        {
                            shell.hub.log_to(&tlog)?;
                        }
                        shell.percept(&percept, arrived);
                        let foreign =
                            shell.foreign_setpoint(&percept).or_else(|| shell.foreign_power(&percept));
                        if let Some(why) = foreign {
                            shell.flight.last = Some(percept);
                            return Ok(shell.end(FlightEnd::ForeignSetpoint, &why).await);
                        }
                        let is_last =
                            options.ticks.is_some_and(|ticks| percept.telemetry.tick >= Tick(ticks));
                        if is_last || shell.has_fallen(&percept, scenario) {
                            return Ok(shell.over(percept).await);
                        }
                        let now = shell.remote.heard().unwrap_or(percept.telemetry.tick);
                        let command = crew.command_at(&percept, now);
                        if let Some(why) = crew.failure() {
                            return Ok(shell.abandoned(percept, &why).await);
                        }
                        if crew.is_done() {
                            return Ok(shell.over(percept).await);
                        }
                        shell.sent.insert(command.tick, command.accel);
                        shell.powers.push_back(command.power);
                        shell.powers.drain(..shell.powers.len().saturating_sub(POWERS));
                        let datagram = shell.remote.command(&command);
                        shell.hub.send(&datagram).await;
                        shell.flight.last = Some(percept);
                        shell.flight.latencies_us.push(arrived.elapsed().as_secs_f64() * 1e6);
                        resend = Backoff::default();
                        crew.sent();
                    }
                    RemoteEvent::Repeat(_) => {
                        shell.flight.repeats += 1;
                        shell.repeat().await;
                    }
                    RemoteEvent::Text(severity, text) => {
                        log_text(severity, &text);
                        crew.heard(severity, &text);
                    }
                    RemoteEvent::News(news) => news.log(),
                    RemoteEvent::LeftGuided(mode) => {
                        let why = format!("vehicle is in {mode}");
                        if !shell.taken_over(&why).await {
                            return Ok(shell.not_given_back(&why).await);
                        }
                    }
                    RemoteEvent::Rebooted(from, to) => {
                        let why = format!("its time went back from tick {} to {}", from.0, to.0);
                        return Ok(shell.end(FlightEnd::Rebooted, &why).await);
                    }
                }
            }
        }
    }
}

/// What the vehicle says, as loud as it says it (MAV_SEVERITY).
fn log_text(severity: u8, text: &str) {
    match severity {
        0..=3 => tracing::error!("vehicle: {text}"),
        4 => tracing::warn!("vehicle: {text}"),
        5 | 6 => tracing::info!("vehicle: {text}"),
        _ => tracing::debug!("vehicle: {text}"),
    }
}

/// Sockets and protocol of a flight.
struct FlightShell<'a> {
    connect: String,
    options: &'a Options,
    hub: Hub,
    remote: Remote,
    first_percept: Option<(Tick, Instant)>,
    /// When the link was there, on the wall: the log's beginning.
    began: SystemTime,
    last_percept: Instant,
    interval_s: f64,
    scenario: Scenario,
    /// Writes the vehicle's place into the log.
    place: Encoder,
    /// The accelerations of our commands, by their ticks.
    sent: BTreeMap<Tick, [f32; 2]>,
    /// The powers of our last commands, newest last.
    powers: VecDeque<TxPower>,
    steering: PageSteering,
    /// How the flight is going, for who looks on.
    line: ProgressBar,
    flight: Flight,
}

impl<'a> FlightShell<'a> {
    async fn new(session: Session, scenario: &Scenario, options: &'a Options) -> Result<Self> {
        let connect = session.endpoint().to_string();
        let (mut hub, encoder, fleet, system) = session.into_parts();
        hub.log_ahead();
        options.forward(&mut hub).await?;
        hub.take_control(Some(system));
        Ok(Self {
            connect,
            options,
            hub,
            remote: Remote::new(scenario, system, encoder).knowing(fleet).speaking_as(options.identity),
            first_percept: None,
            began: SystemTime::now(),
            last_percept: Instant::now(),
            interval_s: scenario.scale.interval_s,
            scenario: scenario.clone(),
            place: Encoder::new(system, GPS),
            sent: BTreeMap::new(),
            powers: VecDeque::new(),
            steering: PageSteering::new(options.steering.as_ref().and_then(RequestQueue::take)),
            line: progress::live("flight", options.ticks.unwrap_or(scenario.horizon)),
            flight: Flight::default(),
        })
    }

    /// Why it is too quiet, if it is: an error before the first percept.
    fn silence(&mut self) -> Result<Option<String>> {
        self.remote.poll(self.hub.elapsed()).iter().for_each(News::log);
        let waited = self.last_percept.elapsed();
        if waited <= self.options.timeout {
            return Ok(None);
        }
        let (connect, seconds) = (&self.connect, self.options.timeout.as_secs_f64());
        let system = self.remote.system();
        match self.remote.newest() {
            None => bail!(
                "{connect}: vehicle {system} talks, but no report with a frame came for {seconds} s \
                 ({} were rejected: is its control interval {} s?)",
                self.remote.rejected_messages(),
                self.interval_s
            ),
            Some(tick) if self.remote.is_lost() => Ok(Some(format!(
                "{connect}: vehicle {system}: link lost after tick {}, and not regained for {seconds} s",
                tick.0
            ))),
            Some(tick) => Ok(Some(format!(
                "{connect}: vehicle {system} sent no new percept for {seconds} s after tick {}",
                tick.0
            ))),
        }
    }

    /// What the link has carried so far, by name.
    fn counters(&self) -> serde_json::Value {
        let flight = Flight {
            packets: self.hub.counts(),
            lost: self.hub.rows().iter().map(|row| row.counters.lost()).sum(),
            repeats: self.flight.repeats,
            rejected_messages: self.remote.rejected_messages(),
            suppressed_setpoints: self.hub.router().suppressed_setpoints(),
            ..Flight::default()
        };
        flight.counters()
    }

    fn percept(&mut self, percept: &Percept, arrived: Instant) {
        let (first_tick, first) = *self.first_percept.get_or_insert((percept.telemetry.tick, arrived));
        self.last_percept = arrived;
        self.flight.wall = arrived - first;
        self.log_place(percept, first_tick);
        self.show(percept);
        tracing::debug!(tick = percept.telemetry.tick.0, "percept");
    }

    /// Tick, way to the goal, and the radio, in the live line.
    fn show(&self, percept: &Percept) {
        let (telemetry, scale) = (&percept.telemetry, &self.scenario.scale);
        let away =
            (scale.paper_from_ned(telemetry.position) - self.scenario.goal).norm() * scale.metres_per_unit;
        let radio = telemetry.link.map_or_else(String::new, |link| {
            let power = if link.power == TxPower::High { "high" } else { "low" };
            let outage = if link.outage { ", OUTAGE" } else { "" };
            format!(", SNR {:.0} dB, {power} power{outage}", link.snr_db)
        });
        self.line.set_position(telemetry.tick.0);
        self.line.set_message(format!("{away:.0} m to go{radio}"));
    }

    /// The log counts by the flight's own time, so that it lasts as long in lockstep as in real time; and if the
    /// vehicle does not say where on the map it is, the log does, as its satellite receiver.
    fn log_place(&mut self, percept: &Percept, first: Tick) {
        let ticks = percept.telemetry.tick.0.saturating_sub(first.0) as f64;
        let interval = Duration::from_secs_f64(self.interval_s);
        self.hub.log_time(self.began + Duration::from_secs_f64(ticks * self.interval_s), interval);
        if !self.remote.is_on_map() {
            let (clock, mut datagram) = (Clock::new(&self.scenario), Vec::new());
            replay::push_place(&percept.telemetry, &clock, &self.scenario, &mut self.place, &mut datagram);
            self.hub.log_note(&datagram);
        }
    }

    /// What the vehicle flies, if that is not ours. A setpoint that it held before our first percept is that of
    /// a flight before this one.
    fn foreign_setpoint(&self, percept: &Percept) -> Option<String> {
        let held = percept.telemetry.held?;
        let (first, _) = self.first_percept?;
        let ours = self.sent.get(&held.tick);
        if held.tick < first || ours == Some(&held.accel) {
            return None;
        }
        let [north, east] = held.accel;
        Some(format!(
            "the vehicle flies a setpoint of tick {} that this station has not sent: {north} m/s² north, {east} \
             east",
            held.tick.0
        ))
    }

    /// The power at which the vehicle transmits, if none of our last commands asked for it.
    fn foreign_power(&self, percept: &Percept) -> Option<String> {
        let power = percept.telemetry.link?.power;
        let is_ours = self.powers.len() < POWERS || self.powers.contains(&power);
        (!is_ours).then(|| {
            format!("the vehicle transmits at power {}, which this station has not asked for", power.level())
        })
    }

    /// Whether the vehicle has collided since its last report, in a scenario in which it then falls.
    fn has_fallen(&self, percept: &Percept, scenario: &Scenario) -> bool {
        let before = self.flight.last.as_ref().map(|last| &last.telemetry);
        scenario.safety.collision_action == CollisionAction::Fall
            && before.is_some_and(|b| b.contact(&percept.telemetry, scenario).obstacle.is_some())
    }

    /// Something is missing.
    async fn repeat(&mut self) {
        for datagram in self.remote.repeat() {
            self.hub.send(&datagram).await;
        }
    }

    async fn beat(&mut self) {
        self.hub.save();
        let datagram = self.remote.heartbeat();
        self.hub.send(&datagram).await;
    }

    /// Sends something often enough for a path that loses datagrams.
    async fn last_words(&mut self, mut words: impl FnMut(&mut Remote) -> Vec<u8>) {
        let (times, pause) = FAREWELLS;
        for k in 0..times {
            if k > 0 {
                sleep(pause).await;
            }
            let datagram = words(&mut self.remote);
            self.hub.send(&datagram).await;
        }
    }

    /// The last percept is here.
    async fn over(mut self, percept: Percept) -> Flight {
        let tick = percept.telemetry.tick;
        self.last_words(|remote| remote.acknowledgement(tick)).await;
        self.flight.last = Some(percept);
        self.end(FlightEnd::Over, "").await
    }

    /// Nobody decides any longer: the vehicle brakes.
    async fn abandoned(mut self, percept: Percept, why: &str) -> Flight {
        self.last_words(Remote::brake).await;
        self.flight.last = Some(percept);
        self.end(FlightEnd::NoController, &format!("{why}: the vehicle was asked to brake")).await
    }

    /// The program is asked to end in flight: the vehicle brakes.
    async fn interrupted(mut self, signal: Signal) -> Flight {
        self.last_words(Remote::brake).await;
        self.end(FlightEnd::Interrupted(signal), &format!("{signal}: the vehicle was asked to brake")).await
    }

    /// A page asks something of the vehicle.
    fn ask(&mut self, asked: VehicleRequest) {
        let target = (self.remote.system(), AUTOPILOT);
        self.steering.ask(asked, Stack::ArduPilot, target, self.hub.elapsed());
    }

    /// Sends on what a page has asked.
    async fn steer(&mut self) {
        let datagram = self.steering.poll(self.hub.elapsed(), self.remote.encoder());
        if !datagram.is_empty() {
            self.hub.send(&datagram).await;
        }
    }

    /// The operator flies from now on. Says so; and as long as others talk to the vehicle through
    /// this program, goes on passing their messages to and fro, until a signal comes or the link is lost. Whether
    /// a page has given the vehicle back.
    async fn taken_over(&mut self, why: &str) -> bool {
        self.flight.suppressed_setpoints = self.hub.router().suppressed_setpoints();
        self.hub.take_control(None);
        tracing::warn!("the operator has taken over ({why}): no more setpoints from here");
        let said =
            self.remote.text(MavSeverity::MAV_SEVERITY_WARNING, "Operator has control: setpoints stopped");
        self.hub.send(&said).await;
        let mut beat = interval(HEARTBEAT);
        let mut interrupted = pin!(interrupted());
        while (!self.options.forward.is_empty() || self.steering.is_open()) && !self.remote.is_lost() {
            tokio::select! {
                () = self.hub.turn() => {}
                _ = beat.tick() => self.beat().await,
                asked = self.steering.next() => self.ask(asked),
                _ = &mut interrupted => break,
            }
            self.steer().await;
            let mut is_back = false;
            while let Some(datagram) = self.hub.take() {
                self.steering.datagram(&datagram, self.hub.elapsed());
                let events = self.remote.datagram(&datagram, self.hub.elapsed());
                is_back |=
                    events.iter().any(|event| matches!(event, RemoteEvent::News(news) if news.gives_back()));
            }
            self.remote.poll(self.hub.elapsed()).iter().for_each(News::log);
            if is_back && self.steering.is_open() {
                self.steer().await;
                self.hub.take_control(Some(self.remote.system()));
                self.last_percept = Instant::now();
                tracing::warn!("the vehicle is given back: setpoints go on");
                return true;
            }
        }
        false
    }

    /// The end of a flight that an operator has taken over.
    async fn not_given_back(self, why: &str) -> Flight {
        self.end(FlightEnd::TakenOver, &format!("the operator has taken over: {why}")).await
    }

    async fn end(mut self, ended: FlightEnd, why: &str) -> Flight {
        if !matches!(ended, FlightEnd::Over | FlightEnd::TakenOver) {
            tracing::warn!("the flight ends: {why}");
        }
        self.line.finish_and_clear();
        self.hub.close().await;
        let suppressed_setpoints =
            self.flight.suppressed_setpoints.max(self.hub.router().suppressed_setpoints());
        let lost = self.hub.router().vehicle_lost();
        let (packets, rejected_messages) = (self.hub.counts(), self.remote.rejected_messages());
        let log_error = self.hub.log_error().map(str::to_owned);
        let why = why.to_owned();
        Flight {
            ended,
            why,
            packets,
            lost,
            suppressed_setpoints,
            rejected_messages,
            log_error,
            ..self.flight
        }
    }
}
