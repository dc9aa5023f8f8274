//! Datagrams: `udpin` and `udpout`.

#![expect(clippy::disallowed_methods, reason = "a shell: it has a socket, and peers that fall silent")]

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::task::{Context, Poll};

use tokio::io::ReadBuf;
use tokio::net::UdpSocket;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval};

use super::{LinkPort, PortEvent, SendError, UdpPeers};
use crate::link::endpoint::{Endpoint, OpenError};

/// The receive buffer that is asked for, bytes: a burst of a few thousand frames. The system may give
/// less.
const RECEIVE_BUFFER: usize = 4 << 20;
/// Errors of a socket in a row, before it rests. They are about earlier sendings ("connection refused").
const ERRORS: usize = 64;

/// A socket and those behind it.
#[derive(Debug)]
pub(super) struct UdpPort {
    socket: UdpSocket,
    /// The peer of `udpout`.
    peer: Option<SocketAddr>,
    /// Those who come and go, if their end is to be told.
    table: Option<PeerTable>,
    /// Datagrams for which the system had no room.
    unsent: VecDeque<(SocketAddr, Vec<u8>)>,
}

impl UdpPort {
    pub(super) fn new(socket: UdpSocket, peer: Option<SocketAddr>, peers: Option<UdpPeers>) -> Self {
        // A fixed peer is never forgotten.
        let table = peers.filter(|_| peer.is_none()).map(PeerTable::new);
        Self { socket, peer, table, unsent: VecDeque::new() }
    }

    /// Binds the address that an endpoint names, or a port of the system's choice to send to it.
    pub(super) async fn open(endpoint: &Endpoint, peers: Option<UdpPeers>) -> Result<Self, OpenError> {
        let address = endpoint.address().await?;
        let (local, peer) = match (endpoint, address) {
            (Endpoint::UdpOut(_), SocketAddr::V4(_)) => (SocketAddr::from(([0; 4], 0)), Some(address)),
            (Endpoint::UdpOut(_), SocketAddr::V6(_)) => (SocketAddr::from(([0; 16], 0)), Some(address)),
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
        Ok(Self::new(socket, peer, peers))
    }
}

impl LinkPort for UdpPort {
    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<PortEvent>> {
        if let Some(gone) = self.table.as_mut().and_then(|table| table.gone(cx)) {
            return Poll::Ready(Ok(PortEvent::Closed(gone)));
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
        let mut sweep = interval((limits.silence / 8).max(std::time::Duration::from_millis(1)));
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
