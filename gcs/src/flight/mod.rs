//! The shell that flies a station: percept in, command out, until the last tick.
//!
//! The same loop serves a vehicle in lockstep and one in real time. What comes late or not at all
//! is asked for again; commands are repeated, which also keeps the time-outs of real autopilots
//! away. Knows no controller: the station is a function.
//!
//! Other stations may watch through the same program ([`Options::forward`]). During the flight their
//! setpoints are not forwarded. An operator's change of mode is; once the vehicle has accepted it, the station
//! stops its setpoints, reports that, and goes on forwarding messages.

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

pub mod foreign;
pub mod remote;

use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::dialect::MavSeverity;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::program::shell::Backoff;
use crpl_sitl::program::terminal::interrupted;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::scenario::CollisionAction;
use crpl_sitl::units::Tick;
use tokio::time::{Instant, interval, sleep};

use crate::flight::remote::{Remote, RemoteEvent};
use crate::tools::bridge::hub::Hub;
use crate::tools::bridge::router::Notice;
use crate::tools::bridge::tell;
use crate::tools::fleet::News;

/// The station's heartbeat.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How often, and how far apart, the last percept is acknowledged: the vehicle does not answer.
const FAREWELLS: (u32, Duration) = (4, Duration::from_millis(15));

/// How to fly.
#[derive(Debug, Clone)]
pub struct Options {
    /// The flight ends with the percept of this tick; `None` flies until Ctrl-C.
    pub ticks: Option<u64>,
    /// Where to write the tlog.
    pub tlog: Option<PathBuf>,
    /// File with the key of message signing.
    pub signing_key: Option<PathBuf>,
    /// Endpoints that watch the flight and may talk to the vehicle through this program.
    pub forward: Vec<Endpoint>,
    /// How long to wait for the first percept, and for any next one, also where the link is lost.
    pub timeout: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ticks: None,
            tlog: None,
            signing_key: None,
            forward: Vec::new(),
            timeout: Duration::from_secs(30),
        }
    }
}

impl Options {
    /// Opens the link to the vehicle and those to who else is there.
    pub async fn open(&self, connect: &Endpoint) -> Result<Hub> {
        let mut hub = Hub::default();
        hub.local();
        let shown = hub.open(connect).await?;
        tracing::debug!("{shown}");
        for endpoint in &self.forward {
            let shown = hub.open(endpoint).await?;
            tracing::info!("forward: {shown}");
        }
        if let Some(path) = &self.tlog {
            hub.log_to(path)?;
        }
        if let Some(path) = &self.signing_key {
            hub.sign_with(path)?;
        }
        Ok(hub)
    }
}

/// Why a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlightEnd {
    /// After its last tick, or after a collision at which the vehicle falls.
    #[default]
    Over,
    /// By Ctrl-C or SIGTERM.
    Interrupted,
    /// The operator has changed the vehicle's mode, and flies.
    TakenOver,
}

/// A flight from the station's side.
#[derive(Debug, Clone, Default)]
pub struct Flight {
    /// Why it has ended.
    pub ended: FlightEnd,
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
}

/// Flies `station`, which is asked once for each percept, in the order of ticks.
pub async fn fly(
    connect: &Endpoint,
    scenario: &Scenario,
    options: &Options,
    mut station: impl FnMut(&Percept) -> Command,
) -> Result<Flight> {
    let mut shell = FlightShell::open(connect, scenario, options).await?;
    let mut beat = interval(HEARTBEAT);
    let mut resend = Backoff::default();
    let mut interrupted = pin!(interrupted());
    loop {
        shell.check()?;
        tokio::select! {
            turned = shell.hub.turn() => turned?,
            () = resend.elapsed() => {
                shell.repeat().await?;
                resend.lengthen();
            }
            _ = beat.tick() => shell.beat().await?,
            () = &mut interrupted => return shell.end(FlightEnd::Interrupted).await,
        }
        for notice in shell.hub.notices() {
            tell(&notice, &shell.hub);
            if matches!(notice, Notice::ModeChange(_)) {
                return shell.taken_over("mode changed").await;
            }
        }
        let arrived = shell.hub.arrived();
        while let Some(datagram) = shell.hub.take() {
            for event in shell.datagram(&datagram) {
                match event {
                    RemoteEvent::Percept(percept) => {
                        shell.percept(&percept, arrived);
                        let is_last =
                            options.ticks.is_some_and(|ticks| percept.telemetry.tick >= Tick(ticks));
                        if is_last || shell.has_fallen(&percept, scenario) {
                            return shell.over(percept).await;
                        }
                        let command = shell.remote.command(&station(&percept));
                        shell.hub.send(&command).await?;
                        shell.flight.last = Some(percept);
                        shell.flight.latencies_us.push(arrived.elapsed().as_secs_f64() * 1e6);
                        resend = Backoff::default();
                    }
                    RemoteEvent::Repeat(_) => {
                        shell.flight.repeats += 1;
                        shell.repeat().await?;
                    }
                    RemoteEvent::Text(severity, text) => tracing::info!(severity, "vehicle: {text}"),
                    RemoteEvent::News(news) => news.log(),
                    RemoteEvent::LeftGuided(mode) => {
                        return shell.taken_over(&format!("vehicle is in {mode}")).await;
                    }
                }
            }
        }
    }
}

/// Sockets and protocol of a flight.
struct FlightShell<'a> {
    connect: &'a Endpoint,
    options: &'a Options,
    hub: Hub,
    remote: Remote,
    first_percept: Option<Instant>,
    last_percept: Instant,
    interval_s: f64,
    flight: Flight,
}

impl<'a> FlightShell<'a> {
    async fn open(connect: &'a Endpoint, scenario: &Scenario, options: &'a Options) -> Result<Self> {
        Ok(Self {
            connect,
            options,
            hub: options.open(connect).await?,
            remote: Remote::new(scenario),
            first_percept: None,
            last_percept: Instant::now(),
            interval_s: scenario.scale.interval_s,
            flight: Flight::default(),
        })
    }

    /// A clear word instead of waiting for ever.
    fn check(&mut self) -> Result<()> {
        self.remote.poll(self.hub.elapsed()).iter().for_each(News::log);
        let (connect, waited) = (self.connect, self.last_percept.elapsed());
        if waited <= self.options.timeout {
            return Ok(());
        }
        let seconds = self.options.timeout.as_secs_f64();
        match (self.remote.system(), self.remote.newest()) {
            (None, _) => bail!("{connect}: no MAVLink vehicle heard for {seconds} s; is sitl running there?"),
            (Some(system), None) => bail!(
                "{connect}: vehicle {system} talks, but no report with a picture came for {seconds} s \
                 ({} were rejected: is its control interval {} s?)",
                self.remote.rejected_messages(),
                self.interval_s
            ),
            (Some(system), Some(tick)) if self.remote.is_lost() => {
                bail!(
                    "{connect}: vehicle {system}: link lost after tick {}, and not regained for {seconds} s",
                    tick.0
                )
            }
            (Some(system), Some(tick)) => {
                bail!("{connect}: vehicle {system} sent no new percept for {seconds} s after tick {}", tick.0)
            }
        }
    }

    fn datagram(&mut self, bytes: &[u8]) -> Vec<RemoteEvent> {
        let known = self.remote.system();
        let events = self.remote.datagram(bytes, self.hub.elapsed());
        if known.is_none() && self.remote.system().is_some() {
            self.hub.take_control(self.remote.system());
        }
        events
    }

    fn percept(&mut self, percept: &Percept, arrived: Instant) {
        let first = *self.first_percept.get_or_insert(arrived);
        self.last_percept = arrived;
        self.flight.wall = arrived - first;
        tracing::debug!(tick = percept.telemetry.tick.0, "percept");
    }

    /// Whether the vehicle has collided since its last report, in a scenario in which it then falls.
    fn has_fallen(&self, percept: &Percept, scenario: &Scenario) -> bool {
        let before = self.flight.last.as_ref().map(|last| &last.telemetry);
        scenario.safety.collision_action == CollisionAction::Fall
            && before.is_some_and(|b| b.contact(&percept.telemetry, scenario).obstacle.is_some())
    }

    /// Something is missing.
    async fn repeat(&mut self) -> Result<()> {
        for datagram in self.remote.repeat() {
            self.hub.send(&datagram).await?;
        }
        Ok(())
    }

    async fn beat(&mut self) -> Result<()> {
        self.hub.save()?;
        let datagram = self.remote.heartbeat();
        self.hub.send(&datagram).await
    }

    /// The last percept is here: says so often enough for a path that loses datagrams.
    async fn over(mut self, percept: Percept) -> Result<Flight> {
        let (times, pause) = FAREWELLS;
        for k in 0..times {
            if k > 0 {
                sleep(pause).await;
            }
            let datagram = self.remote.acknowledgement(percept.telemetry.tick);
            self.hub.send(&datagram).await?;
        }
        self.flight.last = Some(percept);
        self.end(FlightEnd::Over).await
    }

    /// The operator flies from now on. Says so; and as long as others talk to the vehicle through
    /// this program, goes on passing their messages to and fro, until Ctrl-C or the link is lost.
    async fn taken_over(mut self, why: &str) -> Result<Flight> {
        self.flight.suppressed_setpoints = self.hub.router().suppressed_setpoints();
        self.hub.take_control(None);
        tracing::warn!("the operator has taken over ({why}): no more setpoints from here");
        let said =
            self.remote.text(MavSeverity::MAV_SEVERITY_WARNING, "Operator has control: setpoints stopped");
        self.hub.send(&said).await?;
        let mut beat = interval(HEARTBEAT);
        let mut interrupted = pin!(interrupted());
        while !self.options.forward.is_empty() && !self.remote.is_lost() {
            tokio::select! {
                turned = self.hub.turn() => turned?,
                _ = beat.tick() => self.beat().await?,
                () = &mut interrupted => break,
            }
            while let Some(datagram) = self.hub.take() {
                self.remote.datagram(&datagram, self.hub.elapsed());
            }
            self.remote.poll(self.hub.elapsed()).iter().for_each(News::log);
        }
        self.end(FlightEnd::TakenOver).await
    }

    async fn end(mut self, ended: FlightEnd) -> Result<Flight> {
        self.hub.close().await?;
        let suppressed_setpoints =
            self.flight.suppressed_setpoints.max(self.hub.router().suppressed_setpoints());
        let lost = self.hub.rows().iter().map(|row| row.counters.lost()).sum();
        let (packets, rejected_messages) = (self.hub.counts(), self.remote.rejected_messages());
        Ok(Flight { ended, packets, lost, suppressed_setpoints, rejected_messages, ..self.flight })
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use crpl_sitl::Sim;
    use crpl_sitl::units::TxPower;
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
        let flight = fly(&connect, &scenario, options, |percept| {
            percepts.push(percept.clone());
            station(percept)
        });
        let flight = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap();
        percepts.extend(flight.last.clone());
        (percepts, flight)
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
        let options = Options { tlog: Some(path.clone()), ..options() };
        flown(vehicle(true).await, &options).await;
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
        let error = fly(&connect, &Scenario::default(), &options, station).await.unwrap_err().to_string();
        assert!(error.starts_with(&format!("{connect}: no MAVLink vehicle heard")), "{error}");
    }

    #[tokio::test]
    async fn a_link_that_falls_silent_is_told_with_its_tick() {
        let target = vehicle(true).await;
        let cut = relay(target, u64::MAX).await;
        let options = Options { timeout: Duration::from_secs(1), ..Options::default() };
        // The vehicle's flight is over after its last tick, and then it falls silent.
        let connect = endpoint(&format!("udpout:{cut}"));
        let scenario = Scenario::default();
        let flight = fly(&connect, &scenario, &options, station);
        let error = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap_err().to_string();
        let (what, tick) = error.rsplit_once(' ').unwrap();
        assert!(what.ends_with("vehicle 1 sent no new percept for 1 s after tick"), "{error}");
        assert!(tick.parse::<u64>().unwrap() <= TICKS, "{error}");
    }
}
