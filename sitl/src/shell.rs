//! Sockets and timers around a [`Vehicle`]. The two paces differ only in who calls `advance`.
//!
//! - lockstep: the arrival of the setpoint for this tick. While it is missing, the percept is sent
//!   again, so a lost datagram delays a flight and changes nothing.
//! - real time: a timer, from the first setpoint on. Only here the vehicle has streams by itself; in
//!   lockstep it sends beside the percept what somebody asked for, and that changes no flight.
//!
//! Knows nothing of what a datagram means.

use std::net::SocketAddr;
use std::time::{Duration, SystemTime};

use tokio::net::UdpSocket;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until};

use crate::vehicle::Vehicle;

/// First pause before something is sent again.
const RESEND_FIRST: Duration = Duration::from_millis(20);
/// Longest pause before something is sent again: 5 Hz keeps the setpoint time-outs of autopilots away.
const RESEND_LAST: Duration = Duration::from_millis(200);
/// How long the last percept waits for its acknowledgement.
const LINGER: Duration = Duration::from_secs(3);
/// Heartbeats, on the wall's clock whatever the pace.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// Why a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// After its last tick; whether a station has confirmed the last percept.
    Over {
        /// Whether it has.
        acknowledged: bool,
    },
    /// By Ctrl-C.
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

/// A vehicle on a socket.
#[derive(Debug)]
pub struct Shell {
    socket: UdpSocket,
    vehicle: Vehicle,
    start: Instant,
    buffer: Vec<u8>,
}

impl Shell {
    /// Puts a vehicle on a socket; `peer` is spoken to first, if given.
    #[must_use]
    pub fn new(socket: UdpSocket, mut vehicle: Vehicle, peer: Option<SocketAddr>) -> Self {
        // A clock before 1970 is no clock, and the vehicle then says that it has none.
        vehicle.set_epoch(SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok());
        if let Some(peer) = peer {
            vehicle.add_peer(peer, Duration::ZERO);
        }
        Self { socket, vehicle, start: Instant::now(), buffer: vec![0; 65_536] }
    }

    /// The vehicle.
    #[must_use]
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicle
    }

    /// Flies in lockstep with the station.
    pub async fn lockstep(&mut self) -> Ended {
        let mut beat = interval(HEARTBEAT);
        let mut resend = Backoff::default();
        let mut last = None;
        loop {
            self.flush().await;
            if let Some(ended) = self.ended(&mut last) {
                return ended;
            }
            let streams = self.next_stream();
            tokio::select! {
                () = receive(&self.socket, &mut self.buffer, &mut self.vehicle, self.start) => {
                    if self.vehicle.ready() {
                        self.vehicle.advance(self.start.elapsed());
                        resend = Backoff::default();
                    }
                }
                () = resend.elapsed() => {
                    self.vehicle.send_percept();
                    resend.lengthen();
                }
                () = until(streams) => self.vehicle.stream(self.start.elapsed()),
                _ = beat.tick() => self.vehicle.beat(),
                _ = tokio::signal::ctrl_c() => return Ended::Interrupted,
            }
        }
    }

    /// Flies by the clock, one control interval each `period`.
    pub async fn real_time(&mut self, period: Duration) -> Ended {
        self.vehicle.start_streams(period, self.start.elapsed());
        let mut beat = interval(HEARTBEAT);
        let mut timer = interval(period);
        timer.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut last = None;
        loop {
            self.flush().await;
            if let Some(ended) = self.ended(&mut last) {
                return ended;
            }
            let streams = self.next_stream();
            tokio::select! {
                () = receive(&self.socket, &mut self.buffer, &mut self.vehicle, self.start) => {}
                _ = timer.tick() => {
                    if self.vehicle.begun() && !self.vehicle.over() {
                        self.vehicle.advance(self.start.elapsed());
                    } else {
                        self.vehicle.send_percept();
                    }
                }
                () = until(streams) => self.vehicle.stream(self.start.elapsed()),
                _ = beat.tick() => self.vehicle.beat(),
                _ = tokio::signal::ctrl_c() => return Ended::Interrupted,
            }
        }
    }

    /// Whether the flight is over and need not wait for its acknowledgement any longer; `last` is
    /// the end of that wait, once it has begun.
    fn ended(&self, last: &mut Option<Instant>) -> Option<Ended> {
        if !self.vehicle.over() {
            return None;
        }
        let acknowledged = self.vehicle.acknowledged();
        let patience = *last.get_or_insert_with(|| Instant::now() + LINGER);
        (acknowledged || Instant::now() >= patience).then_some(Ended::Over { acknowledged })
    }

    /// When the next stream has something to send.
    fn next_stream(&self) -> Option<Instant> {
        self.vehicle.next_stream().map(|due| self.start + due)
    }

    async fn flush(&mut self) {
        while let Some((to, bytes)) = self.vehicle.poll() {
            // A peer that has gone away is no reason to stop flying.
            if let Err(error) = self.socket.send_to(&bytes, to.address).await {
                tracing::debug!(%to, "sending: {error}");
            }
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

/// Hands the next datagram to the vehicle.
async fn receive(socket: &UdpSocket, buffer: &mut [u8], vehicle: &mut Vehicle, start: Instant) {
    match socket.recv_from(buffer).await {
        Ok((length, from)) => vehicle.datagram(&buffer[..length], from, start.elapsed()),
        // "Connection refused" by a peer that has gone away, and the like.
        Err(error) => {
            tracing::debug!("receiving: {error}");
            sleep(Duration::from_millis(1)).await;
        }
    }
}
