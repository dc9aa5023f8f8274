//! Datagrams: `udpin`, `udpout` and `udpbcast`.

#![expect(clippy::disallowed_methods, reason = "a shell: it has a socket, and peers that fall silent")]

use std::collections::VecDeque;
use std::future::Future;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::net::UdpSocket;
use tokio::time::{Instant, Interval, MissedTickBehavior, Sleep, interval, sleep};

use super::{LinkOptions, LinkPort, NO_ADDRESS, PortEvent, SendError, UdpPeers};
use crate::link::endpoint::{Endpoint, HostPort, OpenError};

/// The receive buffer that is asked for, bytes: a burst of a few thousand frames. The system may give
/// less.
const RECEIVE_BUFFER: usize = 4 << 20;
/// Errors of a socket in a row, before it rests. They are about earlier sendings ("connection refused").
const ERRORS: usize = 64;

/// How often a name is looked up again, and how often as long as it has no address.
const LOOK_UP: [Duration; 2] = [Duration::from_secs(30), Duration::from_secs(3)];

/// A socket and those behind it.
#[derive(Debug)]
pub(super) struct UdpPort {
    socket: UdpSocket,
    /// The peer of `udpout`, by the address that it has first.
    peer: Option<SocketAddr>,
    /// Where that peer is now, if it is given by a name.
    name: Option<Name>,
    /// Those who come and go, if their end is to be told.
    table: Option<PeerTable>,
    /// Datagrams for which the system had no room.
    unsent: VecDeque<(SocketAddr, Vec<u8>)>,
}

impl UdpPort {
    pub(super) fn new(socket: UdpSocket, peer: Option<SocketAddr>, peers: Option<UdpPeers>) -> Self {
        // A fixed peer is never forgotten.
        let table = peers.filter(|_| peer.is_none()).map(PeerTable::new);
        Self { socket, peer, name: None, table, unsent: VecDeque::new() }
    }

    /// Binds the address that an endpoint names, or a port of the system's choice to send to it.
    pub(super) async fn open(endpoint: &Endpoint, options: &LinkOptions) -> Result<Self, OpenError> {
        let speaks = endpoint.speaks_at_once();
        let (address, known) = match endpoint.address().await {
            Err(error) if options.connects_later && speaks => {
                tracing::warn!("{error}; trying again every {} s", LOOK_UP[1].as_secs());
                (NO_ADDRESS, false)
            }
            address => (address?, true),
        };
        let (local, peer) = match address {
            SocketAddr::V4(_) if speaks => (SocketAddr::from(([0; 4], 0)), Some(address)),
            SocketAddr::V6(_) if speaks => (SocketAddr::from(([0; 16], 0)), Some(address)),
            _ => (address, None),
        };
        let socket = UdpSocket::bind(local).await.map_err(|source| OpenError::Bind {
            endpoint: endpoint.clone(),
            address: local,
            source,
        })?;
        if let Err(error) = socket2::SockRef::from(&socket).set_recv_buffer_size(RECEIVE_BUFFER) {
            tracing::debug!("{endpoint}: receive buffer: {error}");
        }
        if matches!(endpoint, Endpoint::UdpBroadcast(_))
            && let Err(error) = socket.set_broadcast(true)
        {
            tracing::warn!("{endpoint}: {error}");
        }
        let mut port = Self::new(socket, peer, options.udp_peers);
        if options.connects_later && speaks {
            port.name = Name::of(endpoint, known.then_some(address));
        }
        Ok(port)
    }

    /// Where a peer is now.
    fn whereabouts(&self, to: SocketAddr) -> Option<SocketAddr> {
        match &self.name {
            Some(name) if Some(to) == self.peer => name.address,
            _ => Some(to),
        }
    }
}

/// A host's name, which may stand for another address later.
struct Name {
    place: HostPort,
    address: Option<SocketAddr>,
    state: Lookup,
}

enum Lookup {
    Waiting(Pin<Box<Sleep>>),
    Asking(Pin<Box<dyn Future<Output = io::Result<SocketAddr>> + Send>>),
}

impl std::fmt::Debug for Name {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Name").field("place", &self.place).field("address", &self.address).finish()
    }
}

impl Name {
    fn of(endpoint: &Endpoint, address: Option<SocketAddr>) -> Option<Self> {
        let place = endpoint.place().filter(|place| place.literal().is_none())?.clone();
        Some(Self { place, address, state: Self::wait(address) })
    }

    fn wait(address: Option<SocketAddr>) -> Lookup {
        Lookup::Waiting(Box::pin(sleep(LOOK_UP[usize::from(address.is_none())])))
    }

    /// Looks it up when that is due. An address of another family than the socket's is none for it.
    fn poll(&mut self, cx: &mut Context<'_>, is_v4: bool) {
        loop {
            self.state = match &mut self.state {
                Lookup::Waiting(pause) => {
                    if pause.as_mut().poll(cx).is_pending() {
                        return;
                    }
                    let place = self.place.clone();
                    Lookup::Asking(Box::pin(async move { place.address().await }))
                }
                Lookup::Asking(answer) => {
                    let Poll::Ready(found) = answer.as_mut().poll(cx) else { return };
                    match found {
                        Ok(address) if address.is_ipv4() == is_v4 && self.address != Some(address) => {
                            tracing::info!("{} is {address}", self.place.host);
                            self.address = Some(address);
                        }
                        Ok(_) => {}
                        Err(error) => tracing::debug!("{error}"),
                    }
                    Self::wait(self.address)
                }
            };
        }
    }
}

impl LinkPort for UdpPort {
    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<PortEvent>> {
        if let Some(gone) = self.table.as_mut().and_then(|table| table.gone(cx)) {
            return Poll::Ready(Ok(PortEvent::Closed(gone)));
        }
        if let Some(name) = &mut self.name {
            name.poll(cx, self.peer.is_none_or(|peer| peer.is_ipv4()));
        }
        let mut errors = 0;
        loop {
            let mut read = ReadBuf::new(buffer);
            match std::task::ready!(self.socket.poll_recv_from(cx, &mut read)) {
                Ok(address) => {
                    if let Some(table) = &mut self.table {
                        table.heard(address);
                    }
                    return Poll::Ready(Ok(PortEvent::Bytes(address, read.filled().len())));
                }
                Err(error) if errors == ERRORS => return Poll::Ready(Err(error)),
                Err(error) => tracing::debug!("receiving: {error}"),
            }
            errors += 1;
        }
    }

    fn send(&mut self, to: SocketAddr, bytes: &[u8]) -> Result<(), SendError> {
        let to = self.whereabouts(to).ok_or(SendError::Gone)?;
        if self.unsent.is_empty() {
            match self.socket.try_send_to(bytes, to) {
                Ok(_) => return Ok(()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
        }
        self.unsent.push_back((to, bytes.to_vec()));
        Ok(())
    }

    fn poll_flush(&mut self, cx: &mut Context<'_>, failed: &mut Vec<(SocketAddr, Vec<u8>)>) -> Poll<()> {
        while let Some((to, bytes)) = self.unsent.front() {
            let sent = std::task::ready!(self.socket.poll_send_to(cx, bytes, *to));
            let done = self.unsent.pop_front();
            if let (Err(error), Some((to, bytes))) = (sent, done) {
                tracing::debug!(%to, "sending: {error}");
                failed.push((to, bytes));
            }
        }
        Poll::Ready(())
    }

    fn local(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    fn fixed(&self) -> Option<SocketAddr> {
        self.peer
    }
}

/// Those who were heard of late.
#[derive(Debug)]
struct PeerTable {
    limits: UdpPeers,
    peers: Vec<(SocketAddr, Instant)>,
    /// Those who have made room for others, or were silent for too long, and have not been told yet.
    gone: VecDeque<SocketAddr>,
    /// When it is next looked for silent ones.
    sweep: Interval,
}

impl PeerTable {
    fn new(limits: UdpPeers) -> Self {
        let mut sweep = interval((limits.silence / 8).max(Duration::from_millis(1)));
        sweep.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self { limits, peers: Vec::new(), gone: VecDeque::new(), sweep }
    }

    fn heard(&mut self, address: SocketAddr) {
        let now = Instant::now();
        if let Some((_, heard)) = self.peers.iter_mut().find(|(other, _)| *other == address) {
            *heard = now;
            return;
        }
        if self.peers.len() >= self.limits.most
            && let Some(oldest) = (0..self.peers.len()).min_by_key(|&k| self.peers[k].1)
        {
            self.gone.push_back(self.peers.swap_remove(oldest).0);
        }
        self.peers.push((address, now));
    }

    /// The next who has gone.
    fn gone(&mut self, cx: &mut Context<'_>) -> Option<SocketAddr> {
        while self.sweep.poll_tick(cx).is_ready() {
            let (now, silence) = (Instant::now(), self.limits.silence);
            let Self { peers, gone, .. } = self;
            peers.retain(|&(address, heard)| {
                let stays = now.duration_since(heard) < silence;
                if !stays {
                    gone.push_back(address);
                }
                stays
            });
        }
        self.gone.pop_front()
    }
}
