//! The UDP shell that flies a station: percept in, command out, until the last tick.
//!
//! The same loop serves a vehicle in lockstep and one in real time. What comes late or not at all
//! is asked for again; commands are repeated, which also keeps the time-outs of real autopilots
//! away. Knows no controller: the station is a function.

use std::fs::File;
use std::io::{self, BufWriter};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use sitl::Scenario;
use sitl::link::decoder::Counts;
use sitl::link::endpoint::Endpoint;
use sitl::link::tlog::Tlog;
use sitl::msg::{Command, Percept};
use sitl::shell::Backoff;
use sitl::units::Tick;
use tokio::net::UdpSocket;
use tokio::time::{Instant, interval, sleep};

use crate::remote::{Event, Remote};

/// The station's heartbeat.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Pictures are asked for again when none has come for so long.
const PICTURES_MISSING: Duration = Duration::from_secs(1);
/// How often, and how far apart, the last percept is acknowledged: the vehicle does not answer.
const FAREWELLS: (u32, Duration) = (4, Duration::from_millis(15));

/// How to fly.
#[derive(Debug, Clone)]
pub struct Options {
    /// The flight ends with the percept of this tick; `None` flies until Ctrl-C.
    pub ticks: Option<u64>,
    /// Where to write the tlog.
    pub tlog: Option<PathBuf>,
    /// How long to wait for the first percept, and for any next one.
    pub patience: Duration,
    /// How long nothing at all may be heard once the link is up.
    pub silence: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self { ticks: None, tlog: None, patience: Duration::from_secs(30), silence: Duration::from_secs(5) }
    }
}

/// Why a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// After its last tick.
    Over,
    /// By Ctrl-C.
    Interrupted,
}

/// A flight from the station's side.
#[derive(Debug, Clone)]
pub struct Flight {
    /// Why it has ended.
    pub ended: Ended,
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
    /// Reports and pictures that did not fit.
    pub misfits: u64,
}

/// Flies `station`, which is asked once for each percept, in the order of ticks.
pub async fn fly(
    connect: &Endpoint,
    scenario: &Scenario,
    options: &Options,
    mut station: impl FnMut(&Percept) -> Command,
) -> Result<Flight> {
    let mut shell = Shell::open(connect, scenario, options).await?;
    let mut beat = interval(HEARTBEAT);
    let mut resend = Backoff::default();
    let mut buffer = vec![0; 65_536];
    loop {
        shell.check()?;
        tokio::select! {
            received = shell.socket.recv_from(&mut buffer) => {
                let arrived = Instant::now();
                let Some((length, from)) = heard(received).await else { continue };
                for event in shell.datagram(&buffer[..length], from)? {
                    match event {
                        Event::Percept(percept) => {
                            shell.percept(&percept, arrived);
                            if options.ticks.is_some_and(|ticks| percept.telemetry.tick >= Tick(ticks)) {
                                return shell.over(percept).await;
                            }
                            let command = station(&percept);
                            shell.last = Some((percept, command));
                            shell.send_command().await?;
                            shell.flight.latencies_us.push(arrived.elapsed().as_secs_f64() * 1e6);
                            resend = Backoff::default();
                        }
                        Event::Repeat(_) => {
                            shell.flight.repeats += 1;
                            shell.send_command().await?;
                        }
                        Event::Text(severity, text) => tracing::info!(severity, "vehicle: {text}"),
                    }
                }
            }
            () = resend.elapsed() => {
                shell.ask_again().await?;
                resend.lengthen();
            }
            _ = beat.tick() => shell.beat().await?,
            _ = tokio::signal::ctrl_c() => return shell.end(Ended::Interrupted),
        }
    }
}

/// Errors of a UDP socket are about earlier sendings ("connection refused"): the vehicle may come yet.
async fn heard(received: io::Result<(usize, SocketAddr)>) -> Option<(usize, SocketAddr)> {
    match received {
        Ok(found) => Some(found),
        Err(error) => {
            tracing::debug!("receiving: {error}");
            sleep(Duration::from_millis(1)).await;
            None
        }
    }
}

/// Socket, peer and log of a flight.
struct Shell<'a> {
    connect: &'a Endpoint,
    options: &'a Options,
    socket: UdpSocket,
    peer: Option<SocketAddr>,
    remote: Remote,
    tlog: Option<Tlog<BufWriter<File>>>,
    last: Option<(Percept, Command)>,
    first_percept: Option<Instant>,
    last_percept: Instant,
    last_heard: Option<Instant>,
    interval_s: f64,
    flight: Flight,
}

impl<'a> Shell<'a> {
    async fn open(connect: &'a Endpoint, scenario: &Scenario, options: &'a Options) -> Result<Self> {
        let tlog = match &options.tlog {
            Some(path) => {
                let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
                Some(Tlog::new(BufWriter::new(file)))
            }
            None => None,
        };
        let (socket, peer) = connect.open().await?;
        Ok(Self {
            connect,
            options,
            socket,
            peer,
            remote: Remote::new(scenario),
            tlog,
            last: None,
            first_percept: None,
            last_percept: Instant::now(),
            last_heard: None,
            interval_s: scenario.scale.interval_s,
            flight: Flight {
                ended: Ended::Over,
                last: None,
                latencies_us: Vec::new(),
                wall: Duration::ZERO,
                repeats: 0,
                packets: Counts::default(),
                misfits: 0,
            },
        })
    }

    /// A clear word instead of waiting for ever.
    fn check(&self) -> Result<()> {
        let (connect, waited) = (self.connect, self.last_percept.elapsed());
        if self.last_heard.is_some_and(|at| at.elapsed() > self.options.silence) {
            let tick = self
                .remote
                .newest()
                .map_or("before the first percept".into(), |t| format!("at tick {}", t.0));
            bail!("{connect}: the link is silent for {} s {tick}", self.options.silence.as_secs_f64());
        }
        if waited <= self.options.patience {
            return Ok(());
        }
        let seconds = self.options.patience.as_secs_f64();
        match (self.remote.system(), self.remote.newest()) {
            (None, _) => bail!("{connect}: no MAVLink vehicle heard for {seconds} s; is sitl running there?"),
            (Some(system), None) => bail!(
                "{connect}: vehicle {system} talks, but no report with a picture came for {seconds} s \
                 ({} did not fit: is its control interval {} s?)",
                self.remote.misfits(),
                self.interval_s
            ),
            (Some(system), Some(tick)) => {
                bail!("{connect}: vehicle {system} sent no new percept for {seconds} s after tick {}", tick.0)
            }
        }
    }

    fn datagram(&mut self, bytes: &[u8], from: SocketAddr) -> Result<Vec<Event>> {
        let events = self.remote.datagram(bytes);
        let heard = self.remote.take_heard();
        if !heard.is_empty() {
            self.last_heard = Some(Instant::now());
            // Who listens answers to where the vehicle speaks from.
            if self.connect.direction == sitl::link::endpoint::Direction::In {
                self.peer = Some(from);
            }
        }
        if let Some(tlog) = &mut self.tlog {
            let now = SystemTime::now();
            for packet in &heard {
                tlog.frame(&packet.raw, now).context("writing the tlog")?;
            }
        }
        Ok(events)
    }

    fn percept(&mut self, percept: &Percept, arrived: Instant) {
        let first = *self.first_percept.get_or_insert(arrived);
        self.last_percept = arrived;
        self.flight.wall = arrived - first;
        tracing::debug!(tick = percept.telemetry.tick.0, "percept");
    }

    async fn send_command(&mut self) -> Result<()> {
        let Some((_, command)) = &self.last else { return Ok(()) };
        let datagram = self.remote.command(command);
        self.send(&datagram).await
    }

    /// Something is missing: our command may be lost, or the pictures are not flowing.
    async fn ask_again(&mut self) -> Result<()> {
        if self.last.is_none() || self.last_percept.elapsed() > PICTURES_MISSING {
            let datagram = self.remote.image_request();
            self.send(&datagram).await?;
        }
        self.send_command().await
    }

    async fn beat(&mut self) -> Result<()> {
        let datagram = self.remote.heartbeat();
        self.send(&datagram).await
    }

    async fn send(&mut self, datagram: &[u8]) -> Result<()> {
        let Some(peer) = self.peer else { return Ok(()) };
        if let Some(tlog) = &mut self.tlog {
            tlog.datagram(datagram, SystemTime::now()).context("writing the tlog")?;
        }
        if let Err(error) = self.socket.send_to(datagram, peer).await {
            tracing::debug!(%peer, "sending: {error}");
        }
        Ok(())
    }

    /// The last percept is here: says so often enough for a path that loses datagrams.
    async fn over(mut self, percept: Percept) -> Result<Flight> {
        let (times, pause) = FAREWELLS;
        for k in 0..times {
            if k > 0 {
                sleep(pause).await;
            }
            let datagram = self.remote.acknowledgement(percept.telemetry.tick);
            self.send(&datagram).await?;
        }
        self.flight.last = Some(percept);
        self.end(Ended::Over)
    }

    fn end(mut self, ended: Ended) -> Result<Flight> {
        if let Some(tlog) = &mut self.tlog {
            tlog.flush().context("writing the tlog")?;
        }
        let last = self.flight.last.take().or(self.last.map(|(percept, _)| percept));
        let (packets, misfits) = (self.remote.counts(), self.remote.misfits());
        Ok(Flight { ended, last, packets, misfits, ..self.flight })
    }
}
