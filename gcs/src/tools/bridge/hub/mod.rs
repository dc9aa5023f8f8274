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

use super::counters::{LatencyHistogram, LinkRow};
use super::router::{LinkId, Notice, Router};
use super::signer::LinkSigner;
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
    side: LinkSide,
    peers: Vec<UdpPeer>,
}

/// The side of the program that an endpoint belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkSide {
    /// The vehicle's side, signed after [`Hub::sign_vehicle_side`].
    Vehicle,
    /// The side of the tools that share the vehicle.
    Tools,
}

#[derive(Debug, Clone, Copy)]
struct UdpPeer {
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
    signer: Option<LinkSigner>,
    /// Signs all packets to the vehicle's side and checks all from there.
    vehicle_signer: Option<LinkSigner>,
    /// The links of the vehicle's side, if it is signed.
    signed_links: BTreeMap<LinkId, Decoder>,
    /// TCP endpoints of the vehicle's side: how their connections' names begin.
    vehicle_streams: Vec<String>,
    forward: LatencyHistogram,
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
            signer: None,
            vehicle_signer: None,
            signed_links: BTreeMap::new(),
            vehicle_streams: Vec::new(),
            forward: LatencyHistogram::default(),
            start: Instant::now(),
            arrived: Instant::now(),
            buffer: vec![0; 65_536],
        }
    }
}

impl Hub {
    /// Opens an endpoint; gives it with the port that the system chose, as one line to print.
    pub async fn open(&mut self, endpoint: &Endpoint) -> Result<String> {
        self.open_on(endpoint, LinkSide::Tools).await
    }

    /// The same on a side; with [`Hub::sign_vehicle_side`], call that first.
    pub async fn open_on(&mut self, endpoint: &Endpoint, side: LinkSide) -> Result<String> {
        if endpoint.transport == Transport::Tcp {
            let (name, told) = self.streams.open(endpoint).await?;
            if side == LinkSide::Vehicle {
                self.vehicle_streams.push(name);
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
            self.sign_link(link, side, Decoder::default());
            peers.push(UdpPeer { address, link, heard: Duration::ZERO });
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

    /// Signs all packets of this program and accepts only signed ones, with the key in a file.
    pub fn sign_with(&mut self, path: &Path) -> Result<()> {
        self.signer = Some(LinkSigner::open(path)?);
        Ok(())
    }

    /// Signs all packets to the vehicle's side and accepts only signed ones from there, with the key in a file.
    /// The tools need no key.
    pub fn sign_vehicle_side(&mut self, path: &Path) -> Result<()> {
        self.vehicle_signer = Some(LinkSigner::open(path)?);
        Ok(())
    }

    fn sign_link(&mut self, link: LinkId, side: LinkSide, decoder: Decoder) {
        if side == LinkSide::Vehicle && self.vehicle_signer.is_some() {
            self.signed_links.insert(link, decoder);
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
        [&self.signer, &self.vehicle_signer].into_iter().flatten().try_for_each(|signer| signer.save(end))
    }

    /// This program alone sends setpoints to `vehicle`: see [`Router::take_control`]. `None` ends that.
    pub fn take_control(&mut self, vehicle: Option<u8>) {
        let local = self.local();
        self.router.take_control(vehicle.map(|vehicle| (vehicle, local)));
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
        self.router.links().map(|(name, systems, counters)| LinkRow { name, systems, counters }).collect()
    }

    /// From reading a burst to having sent what it holds.
    #[must_use]
    pub fn forward(&self) -> &LatencyHistogram {
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
    pub async fn send(&mut self, datagram: &[u8]) -> Result<()> {
        let local = self.local();
        match self.signer.as_mut().map(|signer| signer.sign(datagram)) {
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
            self.signed_links.remove(&gone);
        }
        let link = self.router.add(format!("{endpoint} < {address}"));
        tracing::info!("{endpoint}: {address} speaks");
        peers.push(UdpPeer { address, link, heard: now });
        self.exits.insert(link, Exit::Udp(port, address));
        self.sign_link(link, side, Decoder::default());
        Some(link)
    }

    fn stream_event(&mut self, event: TcpEvent) -> Result<()> {
        match event {
            TcpEvent::Connected { name, writer } => {
                tracing::info!("{name}: connected");
                let link = self.router.add(name.clone());
                let of_vehicle = self.vehicle_streams.iter().any(|of| {
                    name.strip_prefix(of.as_str())
                        .is_some_and(|peer| peer.is_empty() || peer.starts_with(" < "))
                });
                let side = if of_vehicle { LinkSide::Vehicle } else { LinkSide::Tools };
                self.sign_link(link, side, Decoder::of_stream());
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
                    self.signed_links.remove(&link);
                }
            }
        }
        Ok(())
    }

    fn receive(&mut self, from: LinkId, bytes: &[u8]) -> Result<()> {
        let (now, time) = (self.elapsed(), SystemTime::now());
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
        logged.context("writing the tlog")
    }

    async fn flush(&mut self) {
        let Self { router, ports, streams, exits, heard, vehicle_signer, signed_links, .. } = self;
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
        router.flush(|link, datagram| match vehicle_signer {
            Some(signer) if signed_links.contains_key(&link) => {
                signer.sign(datagram).iter().for_each(|part| send(link, part));
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
