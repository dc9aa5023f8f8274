//! The sockets around a [`Router`]: UDP and TCP, listening and speaking first, read in bursts.
//!
//! A program that flies has a link of its own in it ([`Hub::local`]), so whoever watches through
//! the same program hears all that it says. Knows no message.

#![expect(clippy::disallowed_methods, reason = "a shell: it has the sockets and their clock")]

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::future::poll_fn;
use std::io::{self, BufWriter, ErrorKind};
use std::net::SocketAddr;
use std::path::Path;
use std::pin::pin;
use std::task::Poll;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::endpoint::{Direction, Endpoint, Transport};
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::link::tlog::Tlog;
use tokio::net::UdpSocket;
use tokio::time::Instant;

use super::counters::{Histogram, Row};
use super::router::{LinkId, Notice, Router};
use super::seal::Seal;
use super::tcp::{Streams, TcpEvent};

/// Datagrams that are read from one socket before the others have their turn.
const BURST: usize = 128;
/// Peers of one listening socket; the one silent for longest makes room for a new one.
const MAX_PEERS: usize = 64;

/// A UDP socket and those behind it.
#[derive(Debug)]
struct UdpPort {
    endpoint: String,
    socket: UdpSocket,
    /// Whether others than the first peer may speak.
    open: bool,
    side: Side,
    peers: Vec<Peer>,
}

/// On which side of the program an endpoint is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The vehicle's. With a key ([`Hub::seal_masters`]) all is signed on it.
    Master,
    /// That of those who share the vehicle.
    Out,
}

#[derive(Debug, Clone, Copy)]
struct Peer {
    address: SocketAddr,
    link: LinkId,
    heard: Duration,
}

/// Where a link's datagrams leave.
#[derive(Debug, Clone, Copy)]
enum Exit {
    Local,
    Udp(usize, SocketAddr),
    Tcp,
}

/// Sockets and router.
#[derive(Debug)]
pub struct Hub {
    router: Router,
    ports: Vec<UdpPort>,
    streams: Streams,
    exits: BTreeMap<LinkId, Exit>,
    local: Option<LinkId>,
    heard: VecDeque<Vec<u8>>,
    tlog: Option<Tlog<BufWriter<File>>>,
    seal: Option<Seal>,
    /// Signs all that leaves to the vehicle's side, and checks all that comes from there.
    master_seal: Option<Seal>,
    /// The links of the vehicle's side, if they are sealed.
    sealed: BTreeMap<LinkId, Decoder>,
    /// TCP endpoints of the vehicle's side: how their connections' names begin.
    master_streams: Vec<String>,
    forward: Histogram,
    start: Instant,
    /// When the last burst was there to be read.
    arrived: Instant,
    buffer: Vec<u8>,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            router: Router::default(),
            ports: Vec::new(),
            streams: Streams::default(),
            exits: BTreeMap::new(),
            local: None,
            heard: VecDeque::new(),
            tlog: None,
            seal: None,
            master_seal: None,
            sealed: BTreeMap::new(),
            master_streams: Vec::new(),
            forward: Histogram::default(),
            start: Instant::now(),
            arrived: Instant::now(),
            buffer: vec![0; 65_536],
        }
    }
}

impl Hub {
    /// Opens an endpoint; gives it with the port that the system chose, as one line to print.
    pub async fn open(&mut self, endpoint: &Endpoint) -> Result<String> {
        self.open_on(endpoint, Side::Out).await
    }

    /// The same on a side; with [`Hub::seal_masters`], call that first.
    pub async fn open_on(&mut self, endpoint: &Endpoint, side: Side) -> Result<String> {
        if endpoint.transport == Transport::Tcp {
            let (name, told) = self.streams.open(endpoint).await?;
            if side == Side::Master {
                self.master_streams.push(name);
            }
            return Ok(told);
        }
        let (socket, peer) = endpoint.open().await?;
        let local = socket.local_addr().context("reading the socket's address")?;
        let port = self.ports.len();
        let mut peers = Vec::new();
        if let Some(address) = peer {
            let link = self.router.add(endpoint.to_string());
            self.exits.insert(link, Exit::Udp(port, address));
            self.seal_link(link, side, Decoder::default());
            peers.push(Peer { address, link, heard: Duration::ZERO });
        }
        let open = endpoint.direction == Direction::In;
        let name = if open { format!("udpin:{local}") } else { endpoint.to_string() };
        self.ports.push(UdpPort { endpoint: name.clone(), socket, open, side, peers });
        Ok(if open {
            format!("listening on {name}")
        } else {
            format!("sending to {name} from port {}", local.port())
        })
    }

    /// The link of this program itself.
    pub fn local(&mut self) -> LinkId {
        let router = &mut self.router;
        let link = *self.local.get_or_insert_with(|| router.add("this program".into()));
        self.exits.insert(link, Exit::Local);
        link
    }

    /// Writes every frame that passes into a tlog.
    pub fn log_to(&mut self, path: &Path) -> Result<()> {
        let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
        self.tlog = Some(Tlog::new(BufWriter::new(file)));
        Ok(())
    }

    /// Signs what this program says, and hears only what is signed, by the key in a file.
    pub fn sign_with(&mut self, path: &Path) -> Result<()> {
        self.seal = Some(Seal::open(path)?);
        Ok(())
    }

    /// Signs what goes to the vehicle's side, and lets through from there only what is signed, by the key
    /// in a file: those who share the vehicle need no key.
    pub fn seal_masters(&mut self, path: &Path) -> Result<()> {
        self.master_seal = Some(Seal::open(path)?);
        Ok(())
    }

    fn seal_link(&mut self, link: LinkId, side: Side, decoder: Decoder) {
        if side == Side::Master && self.master_seal.is_some() {
            self.sealed.insert(link, decoder);
        }
    }

    /// Hands the tlog, and the timestamps of signatures, to their files; once a second is often enough.
    pub fn save(&mut self) -> Result<()> {
        self.write(false)
    }

    /// The same at the end, when every stream has written what waits.
    pub async fn close(&mut self) -> Result<()> {
        self.streams.close().await;
        self.write(true)
    }

    fn write(&mut self, end: bool) -> Result<()> {
        self.tlog.as_mut().map_or(Ok(()), Tlog::flush).context("writing the tlog")?;
        [&self.seal, &self.master_seal].into_iter().flatten().try_for_each(|seal| seal.save(end))
    }

    /// What to keep from whom: see [`Router::hold`]. Only for a program with a link of its own.
    pub fn hold(&mut self, vehicle: Option<u8>) {
        let local = self.local();
        self.router.hold(vehicle.map(|vehicle| (vehicle, local)));
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
    pub fn rows(&self) -> Vec<Row<'_>> {
        self.router.links().map(|(name, systems, counters)| Row { name, systems, counters }).collect()
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
            let Some(seal) = &mut self.seal else { return Some(datagram) };
            let good = seal.check_datagram(&datagram);
            if !good.is_empty() {
                return Some(good);
            }
        }
    }

    /// Sends what this program says.
    pub async fn send(&mut self, datagram: &[u8]) -> Result<()> {
        let local = self.local();
        match self.seal.as_mut().map(|seal| seal.sign(datagram)) {
            None => self.receive(local, datagram)?,
            Some(signed) => {
                for part in signed {
                    self.receive(local, &part)?;
                }
            }
        }
        self.flush().await;
        Ok(())
    }

    /// Waits until something comes in, and passes on the burst that is there.
    ///
    /// Cancel-safe: nothing that was read is lost.
    pub async fn turn(&mut self) -> Result<()> {
        let event = {
            let mut stream = pin!(self.streams.next());
            let ports = &self.ports;
            poll_fn(|cx| {
                if let Poll::Ready(event) = stream.as_mut().poll(cx) {
                    return Poll::Ready(Some(event));
                }
                let ready = ports.iter().filter(|p| p.socket.poll_recv_ready(cx).is_ready()).count();
                if ready > 0 { Poll::Ready(None) } else { Poll::Pending }
            })
            .await
        };
        self.arrived = Instant::now();
        if let Some(event) = event {
            self.stream_event(event)?;
        }
        for port in 0..self.ports.len() {
            self.burst(port)?;
        }
        self.flush().await;
        self.forward.add(self.arrived.elapsed());
        Ok(())
    }

    /// Reads what a socket holds, up to a limit.
    fn burst(&mut self, port: usize) -> Result<()> {
        let mut buffer = std::mem::take(&mut self.buffer);
        for _ in 0..BURST {
            let (length, from) = match self.ports[port].socket.try_recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                // Errors of a UDP socket are about earlier sendings; the peer may come yet.
                Err(error) => {
                    tracing::debug!("{}: receiving: {error}", self.ports[port].endpoint);
                    continue;
                }
            };
            if let Some(link) = self.peer(port, from) {
                self.receive(link, &buffer[..length])?;
            }
        }
        self.buffer = buffer;
        Ok(())
    }

    /// The link of a peer, which may be new.
    fn peer(&mut self, port: usize, address: SocketAddr) -> Option<LinkId> {
        let now = self.elapsed();
        let UdpPort { endpoint, open, side, peers, .. } = &mut self.ports[port];
        let side = *side;
        if let Some(peer) = peers.iter_mut().find(|peer| peer.address == address) {
            peer.heard = now;
            return Some(peer.link);
        }
        if !*open {
            // The peer may answer from another of its addresses, or of its ports: it is one link.
            return peers.first().map(|peer| peer.link);
        }
        if peers.len() == MAX_PEERS
            && let Some(oldest) = (0..peers.len()).min_by_key(|&k| peers[k].heard)
        {
            let gone = peers.swap_remove(oldest).link;
            self.router.remove(gone);
            self.exits.remove(&gone);
            self.sealed.remove(&gone);
        }
        let link = self.router.add(format!("{endpoint} < {address}"));
        tracing::info!("{endpoint}: {address} speaks");
        peers.push(Peer { address, link, heard: now });
        self.exits.insert(link, Exit::Udp(port, address));
        self.seal_link(link, side, Decoder::default());
        Some(link)
    }

    fn stream_event(&mut self, event: TcpEvent) -> Result<()> {
        match event {
            TcpEvent::Connected { name, writer } => {
                tracing::info!("{name}: connected");
                let link = self.router.add(name.clone());
                let of_master = self.master_streams.iter().any(|of| {
                    name.strip_prefix(of.as_str())
                        .is_some_and(|peer| peer.is_empty() || peer.starts_with(" < "))
                });
                let side = if of_master { Side::Master } else { Side::Out };
                self.seal_link(link, side, Decoder::of_stream());
                self.streams.add(name, link, writer);
                self.exits.insert(link, Exit::Tcp);
            }
            TcpEvent::Bytes { name, bytes } => {
                if let Some(link) = self.streams.link(&name) {
                    self.receive(link, &bytes)?;
                }
            }
            TcpEvent::Closed { name } => {
                tracing::info!("{name}: closed");
                if let Some(link) = self.streams.remove(&name) {
                    self.router.remove(link);
                    self.exits.remove(&link);
                    self.sealed.remove(&link);
                }
            }
        }
        Ok(())
    }

    fn receive(&mut self, from: LinkId, bytes: &[u8]) -> Result<()> {
        let (now, time) = (self.elapsed(), SystemTime::now());
        let Self { router, tlog, master_seal, sealed, .. } = self;
        let mut logged = Ok(());
        let good;
        let bytes = match (master_seal, sealed.get_mut(&from)) {
            (Some(seal), Some(decoder)) => {
                let refused = seal.refused();
                good = seal.check(decoder, bytes);
                router.refused(from, seal.refused() - refused);
                &good[..]
            }
            _ => bytes,
        };
        router.receive(from, bytes, now, |frame| {
            if let (Some(tlog), Ok(())) = (tlog.as_mut(), &logged) {
                logged = tlog.frame(frame, time);
            }
        });
        logged.context("writing the tlog")
    }

    async fn flush(&mut self) {
        let Self { router, ports, streams, exits, heard, master_seal, sealed, .. } = self;
        let (mut failed, mut blocked) = (Vec::new(), Vec::new());
        let mut send = |link, datagram: &[u8]| match exits.get(&link) {
            Some(Exit::Local) => heard.push_back(datagram.to_vec()),
            Some(Exit::Tcp) if streams.send(link, datagram) => {}
            Some(Exit::Tcp) => failed.push((link, datagram.len())),
            Some(&Exit::Udp(port, address)) => match ports[port].socket.try_send_to(datagram, address) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    blocked.push((link, port, address, datagram.to_vec()));
                }
                Err(error) => {
                    tracing::debug!("{address}: sending: {error}");
                    failed.push((link, datagram.len()));
                }
            },
            None => {}
        };
        router.flush(|link, datagram| match master_seal {
            Some(seal) if sealed.contains_key(&link) => {
                seal.sign(datagram).iter().for_each(|part| send(link, part));
            }
            _ => send(link, datagram),
        });
        for (link, port, address, datagram) in blocked {
            let sent: io::Result<_> = self.ports[port].socket.send_to(&datagram, address).await;
            if sent.is_err() {
                failed.push((link, datagram.len()));
            }
        }
        for (link, bytes) in failed {
            self.router.not_sent(link, bytes);
        }
    }
}

#[cfg(test)]
mod tests;
