//! The shell that flies a station: percept in, command out, until the last tick or an event that ends it.
//!
//! The same loop serves a vehicle in lockstep and one in real time. What comes late or not at all
//! is asked for again; commands are repeated, which also keeps the time-outs of real autopilots
//! away. Knows no controller: the station is a [`Crew`].
//!
//! Other stations may watch through the same program (`Options::forward`). During the flight their
//! setpoints are not forwarded. An operator's change of mode is; once the vehicle has accepted it, the station
//! stops its setpoints, reports that, and goes on forwarding messages.
//!
//! | a flight ends | the vehicle is left |
//! |---|---|
//! | after its last tick, when its crew is done, or in a fall | as its last command has it |
//! | by SIGINT, SIGTERM or SIGHUP | in mode BRAKE, which is asked for four times |
//! | because its controller, a program, gives no answers | the same |
//! | because an operator changed its mode | to the operator; a page that may steer can give it back, and the flight goes on |
//! | because another station's setpoint is flown | to the other station: no more setpoints from here |
//! | because it has booted anew | as it has booted: no more setpoints from here |
//! | because the link is lost | to its own failsafe |

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

pub mod foreign;
pub mod remote;
pub mod world;

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::pin::pin;
use std::time::{Duration, SystemTime};

use anyhow::{Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::dialect::MavSeverity;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::link::wire::Clock;
use crpl_sitl::link::{AUTOPILOT, GPS};
use crpl_sitl::program::progress;
use crpl_sitl::program::shell::Backoff;
use crpl_sitl::program::terminal::{Signal, interrupted};
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::scenario::CollisionAction;
use crpl_sitl::units::{Tick, TxPower};
use indicatif::ProgressBar;
use serde::{Serialize, Serializer};
use tokio::time::{Instant, interval, sleep};

use crate::flight::remote::{Remote, RemoteEvent};
use crate::tools::bridge::hub::Hub;
use crate::tools::bridge::router::Notice;
use crate::tools::bridge::tell;
use crate::tools::fleet::{News, Stack};
use crate::tools::identity::Identity;
use crate::tools::replay;
use crate::tools::session::{LinkFlags, Session};
use crate::tools::steering::PageSteering;
use crate::watch::control::{RequestQueue, VehicleRequest};
use crate::watch::map::FieldPlace;

/// The station's heartbeat.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How often, and how far apart, last words are sent: the vehicle does not answer.
const FAREWELLS: (u32, Duration) = (4, Duration::from_millis(15));

/// Commands after which a vehicle on a slow link still transmits at the power of an older one.
const POWERS: usize = 10;

/// How to fly.
#[derive(Debug, Clone)]
pub struct Options {
    /// The flight ends with the percept of this tick; `None` flies until a signal comes.
    pub ticks: Option<u64>,
    /// The vehicle's system id; `None`: the only one on the link.
    pub system: Option<u8>,
    /// File with the key of message signing.
    pub signing_key: Option<PathBuf>,
    /// Endpoints that watch the flight and may talk to the vehicle through this program.
    pub forward: Vec<Endpoint>,
    /// How long to wait for the vehicle, for the first percept, and for any next one.
    pub timeout: Duration,
    /// Who flies.
    pub identity: Identity,
    /// What a page asks of the vehicle, if it may.
    pub steering: Option<RequestQueue>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ticks: None,
            system: None,
            signing_key: None,
            forward: Vec::new(),
            timeout: Duration::from_secs(30),
            identity: Identity::default(),
            steering: None,
        }
    }
}

impl Options {
    /// Opens the link to the vehicle and those to who else is there.
    ///
    /// # Errors
    /// An endpoint that cannot be opened, a key file that cannot be read.
    pub async fn open(&self, connect: &Endpoint) -> Result<Hub> {
        let mut hub = Hub::default();
        hub.local();
        hub.log_ahead();
        let shown = hub.open(connect).await?;
        tracing::debug!("{shown}");
        self.forward(&mut hub).await?;
        if let Some(path) = &self.signing_key {
            hub.sign_with(path)?;
        }
        Ok(hub)
    }

    /// Opens the link and waits for the vehicle; its tools come later.
    ///
    /// # Errors
    /// As [`Session::open`]: no vehicle, or several of which none was chosen.
    pub async fn find(&self, connect: &Endpoint) -> Result<Session> {
        let flags = LinkFlags {
            sysid: self.system,
            signing_key: self.signing_key.clone(),
            timeout: self.timeout.as_secs().max(1),
            identity: self.identity,
            ..LinkFlags::to(connect.clone())
        };
        Session::open(&flags).await
    }

    async fn forward(&self, hub: &mut Hub) -> Result<()> {
        for endpoint in &self.forward {
            let shown = hub.open(endpoint).await?;
            tracing::info!("forward: {shown}");
        }
        Ok(())
    }
}

/// Who decides on the ground, and who writes it down.
pub trait Crew {
    /// The command for the interval that this percept begins; asked once for each percept, in the order of
    /// ticks.
    fn command(&mut self, percept: &Percept) -> Command;

    /// The same where the percept has come late: the interval that begins is `now`.
    fn command_at(&mut self, percept: &Percept, _now: Tick) -> Command {
        self.command(percept)
    }

    /// The flight begins with its first percept, which is here. Gives the file of the tlog, if there is to be
    /// one.
    ///
    /// # Errors
    /// A run folder that cannot be made: the flight does not begin.
    fn begin(&mut self) -> Result<Option<PathBuf>> {
        Ok(None)
    }

    /// The command is on its way: there is time to write.
    fn sent(&mut self) {}

    /// The vehicle says something, of severity 0 (emergency) to 7 (debug).
    fn heard(&mut self, _severity: u8, _text: &str) {}

    /// Where on Earth the field lies, if that is known: told once, after [`Crew::begin`].
    fn located(&mut self, _place: FieldPlace) {}

    /// Counters of the link, by name: once a second, and at the end.
    fn link(&mut self, _counters: &serde_json::Value) {}

    /// Whether the flight is over with the newest percept, before [`Options::ticks`]: the command to it is not
    /// sent.
    fn is_done(&self) -> bool {
        false
    }

    /// Why the crew cannot fly on, if it cannot: the command to the newest percept is not sent, and the vehicle
    /// brakes.
    fn failure(&self) -> Option<String> {
        None
    }
}

impl<F: FnMut(&Percept) -> Command> Crew for F {
    fn command(&mut self, percept: &Percept) -> Command {
        self(percept)
    }
}

/// How a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlightEnd {
    /// After its last tick, or after a collision at which the vehicle falls.
    #[default]
    Over,
    /// By a signal.
    Interrupted(Signal),
    /// The operator has changed the vehicle's mode, and flies.
    TakenOver,
    /// A failsafe of the vehicle, or a crash, has ended it.
    Failsafe,
    /// Nothing came for [`Options::timeout`].
    LinkLost,
    /// The vehicle's time has gone back.
    Rebooted,
    /// The vehicle flies a setpoint, or transmits at a power, that this station has not sent.
    ForeignSetpoint,
    /// The controller, a program of somebody's own, gives no answers.
    NoController,
}

impl FlightEnd {
    /// Its name in tables and JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Over => "over",
            Self::Interrupted(_) => "interrupted",
            Self::TakenOver => "taken over",
            Self::Failsafe => "failsafe",
            Self::LinkLost => "link lost",
            Self::Rebooted => "rebooted",
            Self::ForeignSetpoint => "foreign setpoint",
            Self::NoController => "no controller",
        }
    }

    /// The exit code of a program whose flight has ended so; `None`: success.
    #[must_use]
    pub fn exit_code(self) -> Option<u8> {
        match self {
            Self::Over => None,
            Self::Interrupted(signal) => Some(signal.exit_code()),
            Self::LinkLost => Some(3),
            Self::TakenOver => Some(4),
            Self::Rebooted => Some(5),
            Self::ForeignSetpoint => Some(6),
            Self::Failsafe => Some(8),
            Self::NoController => Some(9),
        }
    }
}

impl Serialize for FlightEnd {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.key())
    }
}

/// A flight from the station's side.
#[derive(Debug, Clone, Default)]
pub struct Flight {
    /// How it has ended.
    pub ended: FlightEnd,
    /// Why, in one line.
    pub why: String,
    /// The newest percept. After `ticks` it closes the last interval; the station has not been
    /// asked for a command to it.
    pub last: Option<Percept>,
    /// From the last datagram of a percept to its command on the socket, one a percept, µs.
    pub latencies_us: Vec<f64>,
    /// From the first percept to the last.
    pub wall: Duration,
    /// How often the vehicle has asked again for a command.
    pub repeats: u64,
    /// What arrived.
    pub packets: Counts,
    /// Frames of the vehicle that never came.
    pub lost: u64,
    /// Setpoints of other stations that were not forwarded to the vehicle.
    pub suppressed_setpoints: u64,
    /// Reports and frames that were rejected.
    pub rejected_messages: u64,
    /// Why the tlog is not complete, if so.
    pub log_error: Option<String>,
}

impl Flight {
    /// What the link has carried, by name.
    #[must_use]
    pub fn counters(&self) -> serde_json::Value {
        serde_json::json!({
            "frames": self.packets.frames,
            "frames_lost": self.lost,
            "repeats": self.repeats,
            "rejected": self.rejected_messages,
            "setpoints_held_back": self.suppressed_setpoints,
        })
    }
}

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

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use crpl_sitl::Sim;
    use crpl_sitl::vehicle::Vehicle;
    use tokio::net::UdpSocket;

    use super::*;

    const TICKS: u64 = 30;
    const TIMEOUT: Duration = Duration::from_secs(60);

    fn endpoint(text: &str) -> Endpoint {
        text.parse().unwrap()
    }

    fn station(percept: &Percept) -> Command {
        let [north, east] = percept.telemetry.position;
        let power = if percept.telemetry.tick.0.is_multiple_of(3) { TxPower::High } else { TxPower::Low };
        Command::new(percept.telemetry.tick, [(north * 7.0).sin(), (east * 7.0).cos()], power)
    }

    fn direct() -> Vec<Percept> {
        let mut sim = Sim::new(Scenario::default(), 3);
        let mut percepts = vec![sim.percept()];
        for k in 0..TICKS as usize {
            sim.handle(station(&percepts[k]));
            sim.advance();
            percepts.push(sim.percept());
        }
        percepts
    }

    /// A vehicle on a free port; gives its address.
    async fn vehicle(lockstep: bool) -> SocketAddr {
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let address = socket.local_addr().unwrap();
        let vehicle = Vehicle::new(Sim::new(Scenario::default(), 3), 1, Some(TICKS));
        tokio::spawn(async move {
            let mut shell = crpl_sitl::program::shell::Shell::new(socket, vehicle, None);
            if lockstep { shell.lockstep().await } else { shell.real_time(Duration::from_millis(10)).await }
        });
        address
    }

    /// A relay to `vehicle` that loses every n-th datagram; gives the address to connect to.
    async fn relay(vehicle: SocketAddr, n: u64) -> SocketAddr {
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let address = socket.local_addr().unwrap();
        tokio::spawn(async move {
            let (mut buffer, mut station, mut count) = (vec![0; 65_536], None, 0_u64);
            while let Ok((length, from)) = socket.recv_from(&mut buffer).await {
                count += 1;
                let to = if from == vehicle {
                    station
                } else {
                    station = Some(from);
                    Some(vehicle)
                };
                if let Some(to) = to.filter(|_| !count.is_multiple_of(n)) {
                    let _ = socket.send_to(&buffer[..length], to).await;
                }
            }
        });
        address
    }

    async fn flown(address: SocketAddr, options: &Options) -> (Vec<Percept>, Flight) {
        let mut percepts = Vec::new();
        let connect = endpoint(&format!("udpout:{address}"));
        let scenario = Scenario::default();
        let mut crew = |percept: &Percept| {
            percepts.push(percept.clone());
            station(percept)
        };
        let flight = fly(&connect, &scenario, options, &mut crew);
        let flight = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap();
        percepts.extend(flight.last.clone());
        (percepts, flight)
    }

    /// A crew with a tlog.
    struct Logging(PathBuf);

    impl Crew for Logging {
        fn command(&mut self, percept: &Percept) -> Command {
            station(percept)
        }

        fn begin(&mut self) -> Result<Option<PathBuf>> {
            Ok(Some(self.0.clone()))
        }
    }

    fn options() -> Options {
        Options { ticks: Some(TICKS), ..Options::default() }
    }

    #[tokio::test]
    async fn lockstep_over_udp_is_the_flight_in_process() {
        let (percepts, flight) = flown(vehicle(true).await, &options()).await;
        assert_eq!(percepts, direct());
        assert_eq!(flight.ended, FlightEnd::Over);
        assert_eq!(flight.latencies_us.len(), TICKS as usize);
        assert_eq!(flight.rejected_messages, 0);
    }

    #[tokio::test]
    async fn lockstep_over_a_lossy_path_is_the_flight_in_process() {
        let address = relay(vehicle(true).await, 7).await;
        let (percepts, _) = flown(address, &options()).await;
        assert_eq!(percepts, direct());
    }

    #[tokio::test]
    async fn real_time_flies_to_its_end() {
        let (percepts, _) = flown(vehicle(false).await, &options()).await;
        assert_eq!(percepts.last().map(|p| p.telemetry.tick), Some(Tick(TICKS)));
    }

    #[tokio::test]
    async fn the_log_holds_both_directions() {
        let path = std::env::temp_dir().join(format!("fly-{}.tlog", std::process::id()));
        let connect = endpoint(&format!("udpout:{}", vehicle(true).await));
        let flight = fly(&connect, &Scenario::default(), &options(), &mut Logging(path.clone())).await;
        assert_eq!(flight.unwrap().ended, FlightEnd::Over);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let (mut at, mut systems, mut last) = (0, std::collections::BTreeSet::new(), 0);
        while at < bytes.len() {
            let time = u64::from_be_bytes(bytes[at..at + 8].try_into().unwrap());
            assert!(time >= last && bytes[at + 8] == 0xFD);
            last = time;
            systems.insert(bytes[at + 13]);
            at += 8 + 12 + usize::from(bytes[at + 9]);
        }
        assert_eq!(systems.into_iter().collect::<Vec<_>>(), [1, 255]);
    }

    #[tokio::test]
    async fn nobody_there_is_said_in_one_line() {
        let silent = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let connect = endpoint(&format!("udpout:{}", silent.local_addr().unwrap()));
        let options = Options { timeout: Duration::from_millis(200), ..Options::default() };
        let mut crew = station;
        let scenario = Scenario::default();
        let flight = fly(&connect, &scenario, &options, &mut crew);
        let error = flight.await.unwrap_err().to_string();
        assert!(error.starts_with(&format!("{connect}: no vehicle heard for 1 s")), "{error}");
    }

    #[tokio::test]
    async fn a_link_that_falls_silent_is_told_with_its_tick() {
        let target = vehicle(true).await;
        let cut = relay(target, u64::MAX).await;
        let options = Options { timeout: Duration::from_secs(1), ..Options::default() };
        // The vehicle's flight is over after its last tick, and then it falls silent.
        let connect = endpoint(&format!("udpout:{cut}"));
        let scenario = Scenario::default();
        let mut crew = station;
        let flight = fly(&connect, &scenario, &options, &mut crew);
        let flight = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap();
        assert_eq!(flight.ended, FlightEnd::LinkLost);
        let (what, tick) = flight.why.rsplit_once(' ').unwrap();
        assert!(what.ends_with("vehicle 1 sent no new percept for 1 s after tick"), "{what}");
        assert!(tick.parse::<u64>().unwrap() <= TICKS, "{tick}");
    }
}
