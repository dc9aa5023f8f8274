//! A [`Router`] on [`Links`]: reads in bursts, routes, sends.
//!
//! A program that flies has a link of its own in it ([`Hub::local`]), so whoever watches through
//! the same program hears all that it says. Knows no message and opens no socket.

#![expect(clippy::disallowed_methods, reason = "a shell: it has the links' clock")]

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use crpl_sitl::link::PeerId;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::links::{Arrival, BUFFER, Backlog, LinkOptions, Links, UdpPeers};
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::link::tlog::Tlog;
use crpl_sitl::program::timing::Histogram;
use tokio::time::Instant;

use super::counters::LinkRow;
use super::router::rules::LinkRules;
use super::router::{LinkId, Notice, Router};
use super::signer::LinkSigner;

/// Datagrams and parts of streams that are read before what they bring is sent.
const BURST: usize = 128;
/// A router's links. A tool that does not read misses what it cannot take, and stays; who listens at a
/// `tcpout` endpoint may come later. A UDP peer is forgotten after a minute of silence, as mavp2p does.
const LINKS: LinkOptions = LinkOptions {
    backlog: Backlog::Drop(1 << 20),
    connects_later: true,
    max_streams: 512,
    udp_peers: Some(UdpPeers { most: 64, silence: Duration::from_secs(60) }),
};

/// The side of the program that an endpoint belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkSide {
    /// The vehicle's side, signed after [`Hub::sign_vehicle_side`].
    Vehicle,
    /// The side of the tools that share the vehicle.
    Tools,
}

/// Where a link's datagrams leave.
#[derive(Debug, Clone, Copy)]
enum Exit {
    Local,
    Peer(PeerId),
}

/// Where a tlog goes.
#[derive(Debug)]
enum LogSink {
    /// No file is named yet.
    Ahead(Vec<u8>),
    File(BufWriter<File>),
}

impl Write for LogSink {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match self {
            Self::Ahead(kept) => kept.write(bytes),
            Self::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        match self {
            Self::Ahead(_) => Ok(()),
            Self::File(file) => file.flush(),
        }
    }
}

/// Links and router.
#[derive(Debug)]
pub struct Hub {
    router: Router,
    links: Links,
    /// The side of each endpoint.
    sides: Vec<LinkSide>,
    /// What is asked of each endpoint.
    rules: Vec<LinkRules>,
    exits: BTreeMap<LinkId, Exit>,
    /// The link of each peer.
    peers: BTreeMap<PeerId, LinkId>,
    local: Option<LinkId>,
    heard: VecDeque<Vec<u8>>,
    tlog: Option<Tlog<LogSink>>,
    /// A time of the flight's own clock for the log: what it was, when, and how far it may go on by itself.
    log_time: Option<(SystemTime, Instant, Duration)>,
    /// Why the tlog, or the timestamps of signatures, are no longer written.
    log_error: Option<String>,
    signer: Option<LinkSigner>,
    /// Signs all packets to the vehicle's side and checks all from there.
    vehicle_signer: Option<LinkSigner>,
    /// The links of the vehicle's side, if it is signed.
    signed_links: BTreeMap<LinkId, Decoder>,
    forward: Histogram,
    start: Instant,
    /// When the last burst was there to be read.
    arrived: Instant,
    buffer: Vec<u8>,
}

impl Default for Hub {
    fn default() -> Self {
        Self::new(LINKS)
    }
}

impl Hub {
    fn new(options: LinkOptions) -> Self {
        Self {
            router: Router::salted(salt()),
            links: Links::new(options),
            sides: Vec::new(),
            rules: Vec::new(),
            log_time: None,
            exits: BTreeMap::new(),
            peers: BTreeMap::new(),
            local: None,
            heard: VecDeque::new(),
            tlog: None,
            log_error: None,
            signer: None,
            vehicle_signer: None,
            signed_links: BTreeMap::new(),
            forward: Histogram::default(),
            start: Instant::now(),
            arrived: Instant::now(),
            buffer: vec![0; BUFFER],
        }
    }

    /// Opens an endpoint; gives it with the port that the system chose, as one line to print.
    ///
    /// # Errors
    /// The endpoint cannot be opened.
    pub async fn open(&mut self, endpoint: &Endpoint) -> Result<String> {
        self.open_on(endpoint, LinkRules::default(), LinkSide::Tools).await
    }

    /// The same with rules, on a side; with [`Hub::sign_vehicle_side`], call that first.
    ///
    /// # Errors
    /// The endpoint cannot be opened.
    pub async fn open_on(&mut self, endpoint: &Endpoint, rules: LinkRules, side: LinkSide) -> Result<String> {
        let index = self.links.add(endpoint).await?;
        self.sides.push(side);
        self.rules.push(rules);
        if let Some(peer) = self.links.fixed_at(index) {
            self.meet(peer);
        }
        Ok(self.links.describe().swap_remove(index))
    }

    /// The link of this program itself.
    pub fn local(&mut self) -> LinkId {
        let router = &mut self.router;
        let link = *self.local.get_or_insert_with(|| router.add("this program".into()));
        self.exits.insert(link, Exit::Local);
        link
    }

    /// Keeps every frame that passes until [`Hub::log_to`] names a file.
    pub fn log_ahead(&mut self) {
        self.tlog = Some(Tlog::new(LogSink::Ahead(Vec::new())));
    }

    /// Writes every frame that passes into a tlog, those that were kept first.
    ///
    /// # Errors
    /// The file cannot be created. One that cannot be written later stops no frame: [`Hub::log_error`].
    pub fn log_to(&mut self, path: &Path) -> Result<()> {
        let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
        let mut sink = LogSink::File(BufWriter::new(file));
        let tlog = self.tlog.get_or_insert_with(|| Tlog::new(LogSink::Ahead(Vec::new())));
        if let LogSink::Ahead(kept) = tlog.sink() {
            let kept = sink.write_all(kept);
            *tlog.sink() = sink;
            self.logged(kept);
        }
        Ok(())
    }

    /// From now on the log's stamps count from `time`, for `most` at the longest until the next call: a flight
    /// in lockstep is over in no time, and its log lasts as long as the flight. Never called, the stamps are the
    /// wall's.
    pub fn log_time(&mut self, time: SystemTime, most: Duration) {
        self.log_time = Some((time, Instant::now(), most));
    }

    /// Writes frames into the log that were neither sent nor received.
    pub fn log_note(&mut self, datagram: &[u8]) {
        let time = self.stamp();
        let written = self.tlog.as_mut().map_or(Ok(()), |tlog| tlog.datagram(datagram, time));
        self.logged(written);
    }

    fn stamp(&self) -> SystemTime {
        match self.log_time {
            None => SystemTime::now(),
            Some((time, since, most)) => time + since.elapsed().min(most),
        }
    }

    /// The rule of copies of the router: see [`Router::copies_within`].
    pub fn copies_within(&mut self, within: Duration) {
        self.router.copies_within(within);
    }

    /// Why the tlog, or the timestamps of signatures, could not be written, if so: a full disk for one.
    #[must_use]
    pub fn log_error(&self) -> Option<&str> {
        self.log_error.as_deref()
    }

    /// An error of writing is said once, and ends the log alone.
    fn logged(&mut self, result: std::io::Result<()>) {
        if let Err(error) = result {
            tracing::error!("the tlog ends here: {error}; messages are passed on all the same");
            self.log_error.get_or_insert_with(|| format!("writing the tlog: {error}"));
            self.tlog = None;
        }
    }

    /// Signs all packets of this program and accepts only signed ones, with the key in a file.
    ///
    /// # Errors
    /// The file cannot be read, or holds no key.
    pub fn sign_with(&mut self, path: &Path) -> Result<()> {
        self.signer = Some(LinkSigner::open(path)?);
        Ok(())
    }

    /// Signs all packets to the vehicle's side and accepts only signed ones from there, with the key in a file.
    /// The tools need no key.
    ///
    /// # Errors
    /// The file cannot be read, or holds no key.
    pub fn sign_vehicle_side(&mut self, path: &Path) -> Result<()> {
        self.vehicle_signer = Some(LinkSigner::open(path)?);
        Ok(())
    }

    /// Hands the tlog, and the timestamps of signatures, to their files; once a second is often enough. What
    /// cannot be written stops nothing.
    pub fn save(&mut self) {
        self.write(false);
    }

    /// The same at the end, when every stream has written what waits.
    pub async fn close(&mut self) {
        self.links.close().await;
        self.write(true);
    }

    fn write(&mut self, end: bool) {
        let flushed = self.tlog.as_mut().map_or(Ok(()), Tlog::flush);
        self.logged(flushed);
        let saved = [&self.signer, &self.vehicle_signer].into_iter().flatten().try_for_each(|s| s.save(end));
        if let Err(error) = saved {
            if self.log_error.is_none() {
                tracing::error!("{error:#}; messages are signed and passed on all the same");
            }
            self.log_error.get_or_insert_with(|| format!("{error:#}"));
        }
    }

    /// This program alone sends setpoints to `vehicle`: see [`Router::take_control`]. `None` ends that.
    pub fn take_control(&mut self, vehicle: Option<u8>) {
        let local = self.local();
        self.router.take_control(vehicle.map(|vehicle| (vehicle, local)));
    }

    /// Packets to this program that were refused for their signatures.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.signer.as_ref().map_or(0, LinkSigner::refused)
    }

    /// Sends to everybody what is no message of a program, such as a log that is played: no rule of the
    /// router holds for it.
    pub async fn broadcast(&mut self, bytes: &[u8]) {
        let parts = match &mut self.signer {
            Some(signer) => signer.sign(bytes),
            None => vec![bytes.to_vec()],
        };
        for peer in self.peers.keys() {
            for part in &parts {
                if let Err(error) = self.links.send(*peer, part) {
                    tracing::debug!(%peer, "sending: {error}");
                }
            }
        }
        self.links.flush().await;
    }

    /// Says something to the vehicle's side that needs no answer: whoever waits there for a first word has it.
    pub async fn hello(&mut self, datagram: &[u8]) {
        let fixed = self.links.fixed();
        let streams = self.peers.keys().filter(|peer| self.links.is_stream(peer.endpoint));
        let peers: Vec<PeerId> = fixed.into_iter().chain(streams.copied()).collect();
        for peer in peers {
            if self.sides.get(peer.endpoint) != Some(&LinkSide::Vehicle) {
                continue;
            }
            let parts = match &mut self.vehicle_signer {
                Some(signer) => signer.sign(datagram),
                None => vec![datagram.to_vec()],
            };
            for part in parts {
                if let Err(error) = self.links.send(peer, &part) {
                    tracing::debug!(%peer, "sending: {error}");
                }
            }
        }
        self.links.flush().await;
    }

    /// What has happened since the last call.
    pub fn notices(&mut self) -> Vec<Notice> {
        self.router.notices()
    }

    /// The router, to look at.
    #[must_use]
    pub fn router(&self) -> &Router {
        &self.router
    }

    /// All links with their counters.
    #[must_use]
    pub fn rows(&self) -> Vec<LinkRow<'_>> {
        let open = self.router.links().map(|(name, systems, counters)| LinkRow { name, systems, counters });
        let closed =
            self.router.closed().map(|(name, counters)| LinkRow { name, systems: Vec::new(), counters });
        open.chain(closed).collect()
    }

    /// From reading a burst to having sent what it holds.
    #[must_use]
    pub fn forward(&self) -> &Histogram {
        &self.forward
    }

    /// When the last burst was there to be read.
    #[must_use]
    pub fn arrived(&self) -> Instant {
        self.arrived
    }

    /// Good and bad frames of all peers together.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let peers = self.router.links().map(|(_, _, counters)| counters.frames);
        let ours = self.local.and_then(|id| self.router.counters(id)).map(|c| c.frames.frames);
        let all = peers.fold(Counts::default(), Counts::plus);
        Counts { frames: all.frames - ours.unwrap_or_default(), ..all }
    }

    /// Time since the hub began, the router's clock.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    /// Bytes for this program, one datagram, if any are there.
    pub fn take(&mut self) -> Option<Vec<u8>> {
        loop {
            let datagram = self.heard.pop_front()?;
            let Some(signer) = &mut self.signer else { return Some(datagram) };
            let good = signer.check_datagram(&datagram);
            if !good.is_empty() {
                return Some(good);
            }
        }
    }

    /// Sends what this program says.
    pub async fn send(&mut self, datagram: &[u8]) {
        let local = self.local();
        match self.signer.as_mut().map(|signer| signer.sign(datagram)) {
            None => self.receive(local, datagram),
            Some(signed) => {
                for part in signed {
                    self.receive(local, &part);
                }
            }
        }
        self.flush().await;
    }

    /// Waits until something comes in, and passes on the burst that is there.
    ///
    /// Cancel-safe: nothing that was read is lost.
    pub async fn turn(&mut self) {
        let first = self.links.receive(&mut self.buffer).await;
        self.arrived = Instant::now();
        // Out of `self` while it is read from; never across an await.
        let mut buffer = std::mem::take(&mut self.buffer);
        self.burst(first, &mut buffer);
        self.buffer = buffer;
        self.flush().await;
        self.forward.add(self.arrived.elapsed());
    }

    /// Takes what has come, and what else is there, up to a limit.
    fn burst(&mut self, first: Arrival, buffer: &mut [u8]) {
        self.take_arrival(first, buffer);
        for _ in 1..BURST {
            let Some(next) = self.links.try_receive(buffer) else { break };
            self.take_arrival(next, buffer);
        }
    }

    fn take_arrival(&mut self, arrival: Arrival, buffer: &[u8]) {
        match arrival {
            Arrival::Bytes(from, length) => {
                let link = self.link_of(from);
                self.receive(link, &buffer[..length]);
            }
            Arrival::Connected(peer) => {
                self.forget(peer);
                let link = self.meet(peer);
                tracing::info!("{}: connected", self.router.name(link));
            }
            Arrival::Closed(peer) => self.forget(peer),
        }
    }

    /// The link of a peer, which may be new.
    fn link_of(&mut self, peer: PeerId) -> LinkId {
        // Whom we speak to may answer from another of its addresses, or of its ports: it is one link.
        let known = self.peers.get(&peer).or_else(|| self.peers.get(&self.links.fixed_at(peer.endpoint)?));
        known.copied().unwrap_or_else(|| {
            tracing::info!("{}: {peer} speaks", self.links.name(peer.endpoint));
            self.meet(peer)
        })
    }

    /// A link for a new peer.
    fn meet(&mut self, peer: PeerId) -> LinkId {
        let rules = self.rules.get(peer.endpoint).cloned().unwrap_or_default();
        let link = self.router.add_with(self.links.peer_name(peer), rules);
        self.exits.insert(link, Exit::Peer(peer));
        self.peers.insert(peer, link);
        if self.sides[peer.endpoint] == LinkSide::Vehicle && self.vehicle_signer.is_some() {
            let stream = self.links.is_stream(peer.endpoint);
            self.signed_links.insert(link, if stream { Decoder::of_stream() } else { Decoder::default() });
        }
        link
    }

    /// A peer has gone, if it was one.
    fn forget(&mut self, peer: PeerId) {
        let Some(link) = self.peers.remove(&peer) else { return };
        tracing::info!("{}: closed", self.router.name(link));
        self.router.remove(link);
        self.exits.remove(&link);
        self.signed_links.remove(&link);
    }

    fn receive(&mut self, from: LinkId, bytes: &[u8]) {
        let (now, time) = (self.elapsed(), self.stamp());
        let Self { router, tlog, vehicle_signer, signed_links, .. } = self;
        let mut logged = Ok(());
        let good;
        let bytes = match (vehicle_signer, signed_links.get_mut(&from)) {
            (Some(signer), Some(decoder)) => {
                let refused = signer.refused();
                good = signer.check(decoder, bytes);
                router.refused(from, signer.refused() - refused);
                &good[..]
            }
            _ => bytes,
        };
        router.receive(from, bytes, now, |frame| {
            if let (Some(tlog), Ok(())) = (tlog.as_mut(), &logged) {
                logged = tlog.frame(frame, time);
            }
        });
        self.logged(logged);
    }

    async fn flush(&mut self) {
        let Self { router, links, exits, heard, vehicle_signer, signed_links, .. } = self;
        let mut send = |link, datagram: &[u8]| match exits.get(&link) {
            Some(Exit::Local) => {
                heard.push_back(datagram.to_vec());
                true
            }
            Some(Exit::Peer(peer)) => {
                let sent = links.send(*peer, datagram);
                sent.inspect_err(|error| tracing::debug!(%peer, "sending: {error}")).is_ok()
            }
            None => false,
        };
        router.flush(|link, datagram| match vehicle_signer {
            Some(signer) if signed_links.contains_key(&link) => {
                let mut sent = true;
                for part in signer.sign(datagram) {
                    sent &= send(link, &part);
                }
                sent
            }
            _ => send(link, datagram),
        });
        for (peer, datagram) in self.links.flush().await {
            if let Some(link) = self.peers.get(&peer) {
                self.router.not_sent(*link, &datagram);
            }
        }
    }
}

/// What tells this program's router from others.
fn salt() -> u64 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    now.as_nanos() as u64 ^ u64::from(std::process::id()) << 32
}

#[cfg(test)]
mod tests;
