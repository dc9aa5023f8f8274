//! A conversation with one vehicle: the shell of everything that asks and waits for answers.
//!
//! Beats once a second, finds the vehicle, repeats commands, and runs an [`Exchange`] to its end.

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::MavCmd;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::{AUTOPILOT, MessageData};
use crpl_sitl::program::terminal::interrupted;
use tokio::time::{Instant, Interval, interval, sleep_until};

use crate::tools::bridge::hub::Hub;
use crate::tools::command::{CommandQueue, CommandRequest, CommandResult};
use crate::tools::fleet::{Fleet, HeardVehicle, News};
use crate::tools::identity::Identity;

/// Heartbeats of every component, by the standard.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How often it is said that nobody has been heard yet.
const PATIENCE: Duration = Duration::from_secs(5);
/// In this time every vehicle on a link has beaten once.
const GATHER: Duration = Duration::from_millis(1200);

/// Whom to talk to.
#[derive(Debug, Clone, clap::Args)]
pub struct LinkFlags {
    /// Endpoint of the vehicle: udpout:HOST:PORT, or udpin, tcpout, tcpin, serial:DEVICE:BAUD
    #[arg(long, value_name = "ENDPOINT", default_value = "udpout:127.0.0.1:14550")]
    pub connect: Endpoint,
    /// System id of the vehicle [default: the only one on the link]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    pub sysid: Option<u8>,
    /// Component id; 1 is the autopilot
    #[arg(long, value_name = "N", default_value_t = AUTOPILOT)]
    pub component: u8,
    /// Sign all messages with the key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,
    /// How long to wait for the vehicle's first heartbeat
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub timeout: u64,
    /// Who asks
    #[command(flatten)]
    pub identity: Identity,
}

impl LinkFlags {
    /// The autopilot of the only vehicle at this endpoint.
    #[must_use]
    pub fn to(connect: Endpoint) -> Self {
        Self {
            connect,
            sysid: None,
            component: AUTOPILOT,
            signing_key: None,
            timeout: 10,
            identity: Identity::default(),
        }
    }
}

/// Questions and answers of one protocol, without socket and clock.
pub trait Exchange {
    /// What comes of it.
    type Output;
    /// A packet of the vehicle has come.
    fn packet(&mut self, packet: &Packet, now: Duration);
    /// Appends what is due by now to a datagram.
    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>);
    /// When [`Exchange::poll`] has something to do next.
    fn due(&self) -> Option<Duration>;
    /// The result, once there is one: an error in words for people.
    fn outcome(&mut self) -> Option<Result<Self::Output, String>>;
}

/// A link to one vehicle.
#[derive(Debug)]
pub struct Session {
    connect: Endpoint,
    identity: Identity,
    /// Packets that have come, of anybody.
    heard: u64,
    hub: Hub,
    station: Encoder,
    decoder: Decoder,
    fleet: Fleet,
    commands: CommandQueue,
    system: u8,
    component: u8,
    beat: Interval,
    start: Instant,
}

impl Session {
    /// Opens the link and waits for the vehicle.
    ///
    /// # Errors
    /// An endpoint or key that cannot be opened; no vehicle, or several of which none was chosen.
    pub async fn open(link: &LinkFlags) -> Result<Self> {
        let mut hub = Hub::default();
        hub.local();
        let shown = hub.open(&link.connect).await?;
        tracing::debug!("{shown}");
        if let Some(path) = &link.signing_key {
            hub.sign_with(path)?;
        }
        let mut session = Self {
            connect: link.connect.clone(),
            identity: link.identity,
            heard: 0,
            hub,
            // Until the vehicle is known, a companion takes it for the first.
            station: link.identity.encoder(link.sysid.unwrap_or(1)),
            decoder: Decoder::default(),
            fleet: Fleet::default(),
            commands: CommandQueue::default(),
            system: 0,
            component: link.component,
            beat: interval(HEARTBEAT),
            start: Instant::now(),
        };
        session.system = session.find(link).await?;
        let station = link.identity.encoder(session.system);
        if station.source() != session.station.source() {
            session.station = station;
        }
        Ok(session)
    }

    /// The vehicle that is wanted, or the only one.
    async fn find(&mut self, link: &LinkFlags) -> Result<u8> {
        let deadline = Duration::from_secs(link.timeout);
        let (mut until, mut told) = (deadline, PATIENCE);
        loop {
            if self.now() >= told && self.fleet.systems().is_empty() {
                told = self.now() + PATIENCE;
                tracing::info!("waiting for a vehicle at {}: {}", link.connect, self.silence(link));
            }
            let systems = self.fleet.systems();
            match link.sysid {
                Some(id) if systems.contains(&id) => return Ok(id),
                None if !systems.is_empty() && until == deadline => {
                    until = deadline.min(self.now() + GATHER);
                }
                _ => {}
            }
            if self.now() < until {
                self.turn(Some(until.min(told.max(self.now())))).await?;
                continue;
            }
            let heard: Vec<_> = systems.iter().map(ToString::to_string).collect();
            let heard = heard.join(", ");
            match (link.sysid, &systems[..]) {
                (None, &[only]) => return Ok(only),
                (_, []) => {
                    bail!("{}: no vehicle heard for {} s: {}", link.connect, link.timeout, self.silence(link))
                }
                (None, _) => bail!("{}: vehicles {heard} are there: choose one by --sysid", link.connect),
                (Some(id), _) => bail!("{}: no vehicle {id}; heard: {heard}", link.connect),
            }
        }
    }

    /// Why no vehicle may have been heard.
    fn silence(&self, link: &LinkFlags) -> String {
        let refused = self.hub.refused();
        match (refused, self.heard, &link.signing_key) {
            (1.., _, Some(key)) => format!(
                "{refused} packets have come whose signatures do not fit {}; is it the vehicle's key?",
                key.display()
            ),
            (_, 1.., _) => format!("{} packets have come, and none of an autopilot", self.heard),
            (_, _, Some(key)) => format!(
                "is one there, does it speak on that port, and is the key in {} its own?",
                key.display()
            ),
            (_, _, None) => {
                "is one there, does it speak on that port, and does it want signatures (--signing-key)?"
                    .into()
            }
        }
    }

    /// Where the vehicle is.
    #[must_use]
    pub fn endpoint(&self) -> &Endpoint {
        &self.connect
    }

    /// The open link, what writes to it, who was heard, and the vehicle's system id: for another shell to go on.
    #[must_use]
    pub fn into_parts(self) -> (Hub, Encoder, Fleet, u8) {
        (self.hub, self.station, self.fleet, self.system)
    }

    /// The vehicle's system and component.
    #[must_use]
    pub fn target(&self) -> (u8, u8) {
        (self.system, self.component)
    }

    /// The vehicle by its heartbeats.
    #[must_use]
    pub fn vehicle(&self) -> Option<&HeardVehicle> {
        self.fleet.get(self.system)
    }

    /// Time since the session began.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// Waits for packets, a heartbeat of ours or `due`; gives the packets of our vehicle.
    async fn turn(&mut self, due: Option<Duration>) -> Result<Vec<Packet>> {
        let wake = due.map(|due| self.start + due);
        tokio::select! {
            () = self.hub.turn() => {}
            () = until(wake) => {}
            _ = self.beat.tick() => {
                let mut datagram = Vec::new();
                self.identity.push_heartbeat(&mut self.station, &mut datagram);
                self.hub.send(&datagram).await;
            }
            signal = interrupted() => bail!(signal.exit("nothing more is asked")),
        }
        self.hub.notices();
        let (now, mut ours) = (self.now(), Vec::new());
        while let Some(datagram) = self.hub.take() {
            for packet in self.decoder.datagram(&datagram) {
                self.heard += 1;
                self.fleet.packet(&packet, now).iter().for_each(News::log);
                self.commands.packet(&packet, now);
                if packet.system == self.system {
                    ours.push(packet);
                }
            }
        }
        self.fleet.poll(now).iter().for_each(News::log);
        Ok(ours)
    }

    /// Asks a command and waits for its answer; gives also what came meanwhile, as a message that it
    /// announces may come before or behind the answer.
    ///
    /// # Errors
    /// A signal.
    pub async fn command(&mut self, request: CommandRequest) -> Result<(CommandResult, Vec<Packet>)> {
        self.commands.request(request, self.now());
        let mut heard = Vec::new();
        loop {
            let (now, mut datagram) = (self.now(), Vec::new());
            self.commands.poll(now, &mut self.station, &mut datagram);
            if !datagram.is_empty() {
                self.hub.send(&datagram).await;
            }
            while let Some((done, result)) = self.commands.take() {
                if done == request {
                    return Ok((result, heard));
                }
            }
            heard.extend(self.turn(self.commands.due()).await?);
        }
    }

    /// What the vehicle says in this time.
    ///
    /// # Errors
    /// A signal.
    pub async fn listen(&mut self, time: Duration) -> Result<Vec<Packet>> {
        let (deadline, mut heard) = (self.now() + time, Vec::new());
        while self.now() < deadline {
            heard.extend(self.turn(Some(deadline)).await?);
        }
        Ok(heard)
    }

    /// Asks for one message by REQUEST_MESSAGE; `None` if the vehicle does not send it.
    ///
    /// # Errors
    /// A signal.
    pub async fn request<M: MessageData>(&mut self) -> Result<Option<Packet>> {
        let request = CommandRequest::new(MavCmd::MAV_CMD_REQUEST_MESSAGE, [M::ID as f32], self.target());
        let (result, heard) = self.command(request).await?;
        let wanted = |packets: Vec<Packet>| packets.into_iter().find(Packet::is::<M>);
        if let Some(packet) = wanted(heard) {
            return Ok(Some(packet));
        }
        let deadline = self.now() + Duration::from_millis(500);
        while result == CommandResult::Accepted && self.now() < deadline {
            if let Some(packet) = wanted(self.turn(Some(deadline)).await?) {
                return Ok(Some(packet));
            }
        }
        Ok(None)
    }

    /// Runs an exchange to its end.
    ///
    /// # Errors
    /// What the exchange ends with, and a signal.
    pub async fn run<E: Exchange>(&mut self, exchange: &mut E) -> Result<E::Output> {
        let target = self.target();
        self.run_with(exchange, target).await
    }

    /// The same with another component of the vehicle.
    ///
    /// # Errors
    /// As [`Session::run`].
    pub async fn run_with<E: Exchange>(
        &mut self,
        exchange: &mut E,
        (system, component): (u8, u8),
    ) -> Result<E::Output> {
        loop {
            let (now, mut datagram) = (self.now(), Vec::new());
            exchange.poll(now, &mut self.station, &mut datagram);
            if let Some(outcome) = exchange.outcome() {
                self.send(&datagram).await;
                return outcome
                    .map_err(anyhow::Error::msg)
                    .with_context(|| format!("vehicle {system} component {component}"));
            }
            self.send(&datagram).await;
            for packet in self.turn(exchange.due()).await? {
                exchange.packet(&packet, self.now());
            }
        }
    }

    /// Ends the conversation: keeps what must not be forgotten.
    pub async fn close(mut self) {
        self.hub.close().await;
    }

    async fn send(&mut self, datagram: &[u8]) {
        if !datagram.is_empty() {
            self.hub.send(datagram).await;
        }
    }
}

/// Returns at that instant, or never.
async fn until(instant: Option<Instant>) {
    match instant {
        Some(instant) => sleep_until(instant).await,
        None => std::future::pending().await,
    }
}
