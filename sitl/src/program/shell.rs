//! Sockets and timers around one or more [`Vehicle`]s. The two paces differ only in who calls `advance`.
//!
//! - lockstep: the arrival of the setpoint for this tick. While it is missing, the percept is sent
//!   again, so a lost datagram delays a flight and changes nothing.
//! - real time: a timer, from the first setpoint on. Only here the vehicle has streams by itself; in
//!   lockstep it sends beside the percept what somebody asked for, and that changes no flight.
//!
//! Knows nothing of what a datagram means.

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

use std::net::SocketAddr;
use std::time::{Duration, SystemTime};

use tokio::net::UdpSocket;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

use crate::link::PeerId;
use crate::link::links::{Arrival, BUFFER, Backlog, LinkOptions, Links};
use crate::link::signing::{Signing, Store};
use crate::program::air::AirGap;
use crate::program::flight_log::FlightLog;
use crate::program::terminal::interrupted;
use crate::program::timing::Histogram;
use crate::radio::air::Way;
use crate::vehicle::Vehicle;

/// First pause before something is sent again.
const RESEND_FIRST: Duration = Duration::from_millis(20);
/// Longest pause before something is sent again: 5 Hz keeps the setpoint time-outs of autopilots away.
const RESEND_LAST: Duration = Duration::from_millis(200);
/// How long the last percept waits for its acknowledgement.
const LINGER: Duration = Duration::from_secs(3);
/// Heartbeats, on the wall's clock whatever the pace.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Datagrams that are handled before timers and sending have their turn.
const BATCH: usize = 64;

/// A vehicle's links. A station that does not read for some seconds of frames is closed: it is to see
/// the present. The vehicle keeps its own list of who speaks by UDP.
pub const LINKS: LinkOptions =
    LinkOptions { backlog: Backlog::Close(1 << 20), connects_later: false, max_streams: 16, udp_peers: None };

/// Why a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// After its last tick; whether a station has confirmed the last percept.
    Over {
        /// Whether it has.
        acknowledged: bool,
    },
    /// By Ctrl-C or SIGTERM.
    Interrupted,
}

/// A pause that doubles each time, and the instant at which it ends.
#[derive(Debug, Clone, Copy)]
pub struct Backoff {
    pause: Duration,
    ends: Instant,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { pause: RESEND_FIRST, ends: Instant::now() + RESEND_FIRST }
    }
}

impl Backoff {
    /// Returns when the pause is over, at once if it is over already.
    pub async fn elapsed(&self) {
        sleep_until(self.ends).await;
    }

    /// The next pause, twice as long up to a limit.
    pub fn lengthen(&mut self) {
        self.pause = (self.pause * 2).min(RESEND_LAST);
        self.ends = Instant::now() + self.pause;
    }
}

/// Vehicles behind their endpoints.
#[derive(Debug)]
pub struct Shell {
    links: Links,
    vehicles: Vec<Vehicle>,
    start: Instant,
    buffer: Vec<u8>,
    lateness: Histogram,
    /// Where each vehicle's flight is written down, if it is.
    logs: Vec<FlightLog>,
    /// Where each vehicle keeps its key, if they do.
    stores: Vec<Store>,
    /// The radio of each vehicle, if it carries everything; else none.
    airs: Vec<AirGap>,
    /// Turns true when the flight is to end; without it, a signal ends it.
    stop: Option<watch::Receiver<bool>>,
}

impl Shell {
    /// Puts a vehicle on a socket; `peer` is spoken to first, if given.
    #[must_use]
    pub fn new(socket: UdpSocket, vehicle: Vehicle, peer: Option<SocketAddr>) -> Self {
        Self::over(Links::of_socket(socket, peer, LINKS), vec![vehicle])
    }

    /// Puts vehicles, of which there must be one at least, behind endpoints that they share.
    ///
    /// # Panics
    /// There is no vehicle.
    #[must_use]
    pub fn over(links: Links, mut vehicles: Vec<Vehicle>) -> Self {
        assert!(!vehicles.is_empty(), "somebody must fly");
        for vehicle in &mut vehicles {
            // A clock before 1970 is no clock, and the vehicle then says that it has none.
            vehicle.set_epoch(SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok());
            for peer in links.fixed() {
                vehicle.add_peer(peer, Duration::ZERO);
            }
        }
        let (buffer, lateness) = (vec![0; BUFFER], Histogram::default());
        let (start, logs, stores, airs) = (Instant::now(), Vec::new(), Vec::new(), Vec::new());
        Self { links, vehicles, start, buffer, lateness, logs, stores, airs, stop: None }
    }

    /// Puts a radio between each vehicle and the endpoints, in the vehicles' order: for real time alone, as in
    /// lockstep nothing would pass while it waits for what is lost.
    pub fn through_the_air(&mut self, airs: Vec<AirGap>) {
        self.airs = airs;
    }

    /// Ends the flight when `stop` turns true, in place of a signal.
    pub fn stop_on(&mut self, stop: watch::Receiver<bool>) {
        self.stop = Some(stop);
    }

    /// Returns when the flight is to end.
    fn stopped(&self) -> impl Future<Output = ()> + use<> {
        let stop = self.stop.clone();
        async move {
            let Some(mut stop) = stop else {
                interrupted().await;
                return;
            };
            if stop.wait_for(|stop| *stop).await.is_err() {
                // Who could have stopped it is gone: it flies to its end.
                std::future::pending().await
            }
        }
    }

    /// Gives the vehicles their keys, in their order, and keeps keys and timestamps in files.
    /// What the vehicles do with unsigned packets stays as it is.
    pub fn keep_signing(&mut self, keys: impl IntoIterator<Item = (Signing, Store)>) {
        for (vehicle, (mut signing, store)) in self.vehicles.iter_mut().zip(keys) {
            signing.set_policy(vehicle.signing_mut().policy());
            vehicle.set_signing(signing);
            self.stores.push(store);
        }
    }

    /// Writes down the vehicles' flights, in their order.
    pub fn keep_logs(&mut self, logs: impl IntoIterator<Item = FlightLog>) {
        self.logs.extend(logs);
        self.vehicles.iter_mut().zip(&self.logs).for_each(|(vehicle, _)| vehicle.keep_records());
    }

    /// Writes down the intervals that have ended.
    fn log(&mut self) {
        for (vehicle, log) in self.vehicles.iter_mut().zip(&mut self.logs) {
            log.append(&vehicle.take_records());
        }
    }

    /// Writes down how the flights have ended. What could not be written, in one line.
    pub fn close_logs(&mut self, ended: Ended) -> Option<String> {
        self.log();
        let how = if ended == Ended::Interrupted { "interrupted" } else { "over" };
        let ticks = self.vehicles.iter().map(|vehicle| vehicle.sim().tick().0);
        let failed: Vec<String> =
            self.logs.drain(..).zip(ticks).filter_map(|(log, tick)| log.finish(how, tick)).collect();
        failed.into_iter().next()
    }

    /// The vehicles, whose links are closed.
    #[must_use]
    pub fn into_vehicles(self) -> Vec<Vehicle> {
        self.vehicles
    }

    /// What each endpoint does, for a person.
    #[must_use]
    pub fn describe(&self) -> Vec<String> {
        self.links.describe()
    }

    /// The first vehicle.
    #[must_use]
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicles[0]
    }

    /// All vehicles.
    #[must_use]
    pub fn vehicles(&self) -> &[Vehicle] {
        &self.vehicles
    }

    /// How late each control interval began, in real time.
    #[must_use]
    pub fn lateness(&self) -> &Histogram {
        &self.lateness
    }

    /// Flies in lockstep with the station.
    pub async fn lockstep(&mut self) -> Ended {
        let mut beat = interval(HEARTBEAT);
        let mut resend = Backoff::default();
        let mut last = None;
        let mut stopped = std::pin::pin!(self.stopped());
        loop {
            self.flush().await;
            if let Some(ended) = self.ended(&mut last) {
                return ended;
            }
            let streams = self.next_stream();
            tokio::select! {
                arrival = self.links.receive(&mut self.buffer) => {
                    self.arrived(arrival);
                    let now = self.start.elapsed();
                    for vehicle in &mut self.vehicles {
                        // One that falls waits for no setpoint.
                        while vehicle.ready() {
                            vehicle.advance(now);
                            resend = Backoff::default();
                        }
                    }
                    self.log();
                }
                () = resend.elapsed() => {
                    self.vehicles.iter_mut().for_each(Vehicle::send_percept);
                    resend.lengthen();
                }
                () = until(streams) => self.stream(),
                _ = beat.tick() => self.beat(),
                () = &mut stopped => return Ended::Interrupted,
            }
        }
    }

    /// Flies by the clock, one control interval each `period`.
    pub async fn real_time(&mut self, period: Duration) -> Ended {
        let now = self.start.elapsed();
        self.vehicles.iter_mut().for_each(|vehicle| vehicle.start_streams(period, now));
        let mut beat = interval(HEARTBEAT);
        let mut timer = interval(period);
        timer.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut last = None;
        let mut stopped = std::pin::pin!(self.stopped());
        loop {
            self.flush().await;
            if let Some(ended) = self.ended(&mut last) {
                return ended;
            }
            let streams = self.next_stream();
            let air = self.airs.iter().filter_map(AirGap::next_event).min().map(|due| self.start + due);
            tokio::select! {
                arrival = self.links.receive(&mut self.buffer) => self.arrived(arrival),
                () = until(air) => {}
                due = timer.tick() => self.interval(due),
                () = until(streams) => self.stream(),
                _ = beat.tick() => self.beat(),
                () = &mut stopped => return Ended::Interrupted,
            }
        }
    }

    /// A control interval, which should have begun at `due`.
    fn interval(&mut self, due: Instant) {
        for vehicle in &mut self.vehicles {
            if vehicle.begun() && !vehicle.over() {
                self.lateness.add(due.elapsed());
                vehicle.advance(self.start.elapsed());
            } else {
                vehicle.send_percept();
            }
        }
        self.log();
    }

    /// Hands what has come to the vehicles, and what else is there already.
    fn arrived(&mut self, first: Arrival) {
        self.hand_over(first);
        for _ in 0..BATCH {
            let Some(arrival) = self.links.try_receive(&mut self.buffer) else { return };
            self.hand_over(arrival);
        }
    }

    fn hand_over(&mut self, arrival: Arrival) {
        let now = self.start.elapsed();
        for air in &mut self.airs {
            match arrival {
                Arrival::Bytes(from, length) => air.offer(Way::Up, from, &self.buffer[..length], now),
                Arrival::Closed(peer) => air.closed(peer),
                Arrival::Connected(_) => {}
            }
        }
        for vehicle in &mut self.vehicles {
            match arrival {
                Arrival::Bytes(..) if !self.airs.is_empty() => {}
                Arrival::Bytes(from, length) => vehicle.datagram(&self.buffer[..length], from, now),
                Arrival::Connected(peer) => vehicle.connected(peer, now),
                Arrival::Closed(peer) => vehicle.closed(peer),
            }
        }
    }

    /// Sends what the vehicles have to say, through their radios if they have any.
    fn hand_down(&mut self) {
        let now = self.start.elapsed();
        for (n, vehicle) in self.vehicles.iter_mut().enumerate() {
            while let Some((to, bytes)) = vehicle.poll() {
                match self.airs.get_mut(n) {
                    Some(air) => air.offer(Way::Down, to, &bytes, now),
                    None => send(&mut self.links, to, &bytes),
                }
            }
        }
    }

    /// Hands out what the radios have carried by now; whether any of it came up.
    fn carry(&mut self) -> bool {
        let now = self.start.elapsed();
        let Self { links, vehicles, airs, .. } = self;
        let mut any = false;
        for (vehicle, air) in vehicles.iter_mut().zip(airs) {
            let mut up = Vec::new();
            air.poll(vehicle.sim(), now, |way, peer, bytes| match way {
                Way::Up => up.push((peer, bytes.to_vec())),
                Way::Down => send(links, peer, bytes),
            });
            up.iter().for_each(|(peer, bytes)| vehicle.datagram(bytes, *peer, now));
            any |= !up.is_empty();
        }
        any
    }

    fn stream(&mut self) {
        let now = self.start.elapsed();
        self.vehicles.iter_mut().for_each(|vehicle| vehicle.stream(now));
    }

    fn beat(&mut self) {
        self.vehicles.iter_mut().for_each(Vehicle::beat);
        self.save_signing(false);
    }

    /// Writes keys and timestamps that have changed to their files, if there are any; all at the `end`.
    pub fn save_signing(&mut self, end: bool) {
        for (vehicle, store) in self.vehicles.iter_mut().zip(&self.stores) {
            let signing = vehicle.signing_mut();
            if (signing.take_changed() || end)
                && let Err(error) = store.save(signing, end)
            {
                tracing::warn!("{error}");
            }
        }
    }

    /// Writes what waits for stations that read slowly, for two seconds at most.
    pub async fn close(&mut self) {
        self.links.close().await;
    }

    /// Whether all flights are over and need not wait for their acknowledgement any longer; `last` is
    /// the end of that wait, once it has begun.
    fn ended(&self, last: &mut Option<Instant>) -> Option<Ended> {
        if !self.vehicles.iter().all(Vehicle::over) {
            return None;
        }
        let acknowledged = self.vehicles.iter().all(Vehicle::acknowledged);
        let patience = *last.get_or_insert_with(|| Instant::now() + LINGER);
        (acknowledged || Instant::now() >= patience).then_some(Ended::Over { acknowledged })
    }

    /// When the next stream has something to send.
    fn next_stream(&self) -> Option<Instant> {
        self.vehicles.iter().filter_map(Vehicle::next_stream).min().map(|due| self.start + due)
    }

    async fn flush(&mut self) {
        self.hand_down();
        // What has come up may have answers.
        while self.carry() {
            self.hand_down();
        }
        self.links.flush().await;
    }
}

/// A peer that has gone away is no reason to stop.
fn send(links: &mut Links, to: PeerId, bytes: &[u8]) {
    if let Err(error) = links.send(to, bytes) {
        tracing::debug!(%to, "sending: {error}");
    }
}

/// Returns at that instant, or never.
async fn until(instant: Option<Instant>) {
    match instant {
        Some(instant) => sleep_until(instant).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpStream;

    use super::*;
    use crate::link::decoder::Decoder;
    use crate::link::dialect;
    use crate::link::encoder::Encoder;
    use crate::link::packet::Packet;
    use crate::{Scenario, Sim};

    fn question(system: u8) -> Vec<u8> {
        let mut datagram = Vec::new();
        let ask = dialect::TIMESYNC_DATA { ts1: 7, target_system: system, ..Default::default() };
        Encoder::new(255, 190).push(&mut datagram, &ask);
        datagram
    }

    /// The systems that have answered, once one has.
    fn answers(packets: &[Packet]) -> Vec<u8> {
        packets.iter().filter(|p| p.is::<dialect::TIMESYNC_DATA>()).map(|p| p.system).collect()
    }

    #[tokio::test]
    async fn vehicles_that_share_endpoints_answer_for_themselves_by_udp_and_tcp() {
        let endpoints = ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"].map(|text| text.parse().unwrap());
        let links = Links::open(&endpoints, LINKS).await.unwrap();
        let vehicles = [1, 2].map(|system| Vehicle::new(Sim::new(Scenario::default(), 1), system, None));
        let mut shell = Shell::over(links, vehicles.into());
        let told: Vec<SocketAddr> =
            shell.describe().iter().map(|line| line.split_once(':').unwrap().1.parse().unwrap()).collect();
        let flight = tokio::spawn(async move { shell.real_time(Duration::from_millis(50)).await });

        let patience = Duration::from_secs(30);
        let (mut buffer, mut decoder) = (vec![0; BUFFER], Decoder::default());
        let udp = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        udp.send_to(&question(2), told[0]).await.unwrap();
        let found = loop {
            let length = tokio::time::timeout(patience, udp.recv(&mut buffer)).await.unwrap().unwrap();
            let found = answers(&decoder.datagram(&buffer[..length]));
            if !found.is_empty() {
                break found;
            }
        };
        assert_eq!(found, [2]);

        let mut tcp = TcpStream::connect(told[1]).await.unwrap();
        tcp.write_all(&question(1)).await.unwrap();
        let mut decoder = Decoder::of_stream();
        let found = loop {
            let length = tokio::time::timeout(patience, tcp.read(&mut buffer)).await.unwrap().unwrap();
            let found = answers(&decoder.datagram(&buffer[..length]));
            if !found.is_empty() {
                break found;
            }
        };
        assert_eq!(found, [1]);
        flight.abort();
    }
}
