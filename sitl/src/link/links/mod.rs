//! Several endpoints at once, as one source and one sink of bytes. Knows sockets, not what is in them.
//!
//! The vehicle's shell and every shell of the ground station stand on it; what each wants is in its
//! [`LinkOptions`]. Nothing that a peer does ends it: an error of a socket is logged and waited out, a
//! stream that breaks is closed and told, a `tcpout` endpoint connects again, and what happens to a
//! stream whose peer does not read is the caller's choice ([`Backlog`]).
//!
//! | file | endpoints |
//! |---|---|
//! | `udp.rs` | `udpin`, `udpout`, `udpbcast` |
//! | `tcp.rs` | `tcpin`, `tcpout`, `serial` |
//! | `stream.rs` | one stream and what waits for its peer |
//!
//! A new kind of endpoint is a variant of [`Endpoint`], a `LinkPort` in a file of its own, and an arm
//! of `LinkPort::open`. What holds for every endpoint, such as a filter or a limit on its rate, has its
//! place in [`Links::send`], by the endpoint's entry.

mod stream;
mod tcp;
mod udp;

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::time::{sleep, timeout};

use super::PeerId;
use super::endpoint::{Endpoint, OpenError};
use tcp::{ConnectPort, ListenPort};
use udp::UdpPort;

/// The largest datagram.
pub const BUFFER: usize = 65_536;
/// How long peers that do not read may hold up the end.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// Arrivals that are looked at in vain at the end.
const MAX_UNREAD: usize = 1024;
/// The address of what has none: a serial line, a host whose name is not known yet.
const NO_ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0);
/// After an error of a socket that does not go away.
const PAUSE: Duration = Duration::from_millis(1);

/// What a user of links wants of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkOptions {
    /// What happens to a stream whose peer reads too slowly.
    pub backlog: Backlog,
    /// Whether a `tcpout` endpoint is open before somebody listens there, a serial line before it is plugged
    /// in, and a host before its name has an address. Otherwise that is an error of opening. Once open, all
    /// connect again after each end; a name is looked up again.
    pub connects_later: bool,
    /// Streams that one `tcpin` endpoint takes at a time; more are closed at once.
    pub max_streams: usize,
    /// Limits on the peers of a `udpin` endpoint, whose ends are then told. `None`: the user keeps his
    /// own list of them.
    pub udp_peers: Option<UdpPeers>,
}

/// What happens to a stream for whose peer so many bytes wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backlog {
    /// It is closed: its peer may connect again, and then hears the present.
    Close(usize),
    /// It stays, and what finds no room is dropped and counted.
    Drop(usize),
}

impl Backlog {
    /// Bytes that may wait.
    fn limit(self) -> usize {
        match self {
            Self::Close(limit) | Self::Drop(limit) => limit,
        }
    }
}

/// Who may stand behind a `udpin` endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UdpPeers {
    /// How many; the one silent for longest makes room for a new one.
    pub most: usize,
    /// For how long one may be silent; it is noticed after an eighth of that more.
    pub silence: Duration,
}

/// Something has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// So many bytes from a peer, in the buffer: a datagram, or a part of a stream. The first datagram
    /// of a peer is all that tells that it is there.
    Bytes(PeerId, usize),
    /// A stream has begun; its peer may wait for our first word.
    Connected(PeerId),
    /// A stream has ended, or a peer of a `udpin` endpoint is one no more ([`UdpPeers`]).
    Closed(PeerId),
}

/// Why something was not sent.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// Its stream has ended, or has not begun.
    #[error("nobody is connected")]
    Gone,
    /// The backlog is full.
    #[error("its peer does not read, and {0} bytes wait for it")]
    Full(usize),
    /// The system refused.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl SendError {
    /// Whether a stream ends with it.
    fn closes(&self, backlog: Backlog) -> bool {
        match self {
            Self::Gone => false,
            Self::Full(_) => matches!(backlog, Backlog::Close(_)),
            Self::Io(_) => true,
        }
    }
}

/// What an endpoint has sent, and what it could not send.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Times that something was sent.
    pub sent: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Times that the backlog was full.
    pub full: u64,
    /// Times that the system refused.
    pub failed: u64,
}

/// Open endpoints.
#[derive(Debug)]
pub struct Links {
    options: LinkOptions,
    entries: Vec<LinkEntry>,
    /// Where the next look begins, so that no endpoint starves another.
    turn: usize,
}

/// An endpoint and its sockets.
#[derive(Debug)]
struct LinkEntry {
    name: String,
    /// What it does, for a person.
    told: String,
    /// Whether it has as many peers as come.
    many: bool,
    port: Box<dyn LinkPort>,
    counters: LinkCounters,
}

/// What happens at an endpoint, by the peer's address.
enum PortEvent {
    Bytes(SocketAddr, usize),
    Connected(SocketAddr),
    Closed(SocketAddr),
}

/// The sockets of one endpoint. A peer without an address, such as a serial line's, would be
/// `0.0.0.0:0`.
trait LinkPort: std::fmt::Debug + Send {
    /// What has come; bytes are at the buffer's beginning. Also writes what waits. An error is one of a
    /// socket that will not go away at once.
    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<PortEvent>>;

    /// Sends, or keeps for sending.
    fn send(&mut self, to: SocketAddr, bytes: &[u8]) -> Result<(), SendError>;

    /// Writes what waits; ready when nothing waits. Adds what could not be sent: to whom, and what.
    fn poll_flush(&mut self, cx: &mut Context<'_>, failed: &mut Vec<(SocketAddr, Vec<u8>)>) -> Poll<()>;

    /// The address that it has itself, if that is one for all.
    fn local(&self) -> Option<SocketAddr>;

    /// The peer that it has from the beginning and for ever.
    fn fixed(&self) -> Option<SocketAddr> {
        None
    }

    /// Whether its peers are streams.
    fn is_stream(&self) -> bool {
        false
    }
}

impl dyn LinkPort {
    async fn open(endpoint: &Endpoint, options: &LinkOptions) -> Result<Box<Self>, OpenError> {
        Ok(match endpoint {
            Endpoint::UdpIn(_) | Endpoint::UdpOut(_) | Endpoint::UdpBroadcast(_) => {
                Box::new(UdpPort::open(endpoint, options).await?)
            }
            Endpoint::TcpIn(_) => Box::new(ListenPort::open(endpoint, options).await?),
            Endpoint::TcpOut(_) | Endpoint::Serial(_) => {
                Box::new(ConnectPort::open(endpoint, options).await?)
            }
        })
    }
}

impl Links {
    /// No endpoint yet.
    #[must_use]
    pub fn new(options: LinkOptions) -> Self {
        Self { options, entries: Vec::new(), turn: 0 }
    }

    /// Opens all endpoints, or none.
    ///
    /// # Errors
    /// The first that cannot be opened.
    pub async fn open(endpoints: &[Endpoint], options: LinkOptions) -> Result<Self, OpenError> {
        let mut links = Self::new(options);
        for endpoint in endpoints {
            links.add(endpoint).await?;
        }
        Ok(links)
    }

    /// A single UDP socket; `peer` is spoken to first, if given.
    #[must_use]
    pub fn of_socket(socket: UdpSocket, peer: Option<SocketAddr>, options: LinkOptions) -> Self {
        let port: Box<dyn LinkPort> = Box::new(UdpPort::new(socket, peer, options.udp_peers));
        let local = port.local().map_or_else(|| "?".into(), |address| address.to_string());
        let (name, told) = match peer {
            None => (format!("udpin:{local}"), format!("listening on udpin:{local}")),
            Some(peer) => (format!("udpout:{peer}"), format!("sending to udpout:{peer} from {local}")),
        };
        let entry = LinkEntry { name, told, many: peer.is_none(), port, counters: LinkCounters::default() };
        Self { options, entries: vec![entry], turn: 0 }
    }

    /// Opens one more endpoint; gives its index.
    ///
    /// # Errors
    /// It cannot be opened.
    pub async fn add(&mut self, endpoint: &Endpoint) -> Result<usize, OpenError> {
        let port = <dyn LinkPort>::open(endpoint, &self.options).await?;
        let local = port.local();
        let (name, told) = match endpoint {
            Endpoint::UdpIn(_) | Endpoint::TcpIn(_) => {
                let local = local.map_or_else(|| "?".into(), |address| address.to_string());
                let name = format!("{}:{local}", endpoint.scheme());
                (name.clone(), format!("listening on {name}"))
            }
            Endpoint::UdpOut(_) | Endpoint::UdpBroadcast(_) => {
                let port = local.map_or(0, |address| address.port());
                (endpoint.to_string(), format!("sending to {endpoint} from port {port}"))
            }
            Endpoint::TcpOut(_) | Endpoint::Serial(_) if self.options.connects_later => {
                (endpoint.to_string(), format!("connecting to {endpoint}"))
            }
            Endpoint::TcpOut(_) | Endpoint::Serial(_) => {
                (endpoint.to_string(), format!("connected to {endpoint}"))
            }
        };
        let many = matches!(endpoint, Endpoint::UdpIn(_) | Endpoint::TcpIn(_));
        self.entries.push(LinkEntry { name, told, many, port, counters: LinkCounters::default() });
        Ok(self.entries.len() - 1)
    }

    /// The peers of `udpout` endpoints: they wait for our first word, and never come and go.
    #[must_use]
    pub fn fixed(&self) -> Vec<PeerId> {
        (0..self.entries.len()).filter_map(|endpoint| self.fixed_at(endpoint)).collect()
    }

    /// The same for one endpoint.
    #[must_use]
    pub fn fixed_at(&self, endpoint: usize) -> Option<PeerId> {
        let address = self.entries.get(endpoint)?.port.fixed()?;
        Some(PeerId { endpoint, address })
    }

    /// Whether the peers of an endpoint are streams.
    #[must_use]
    pub fn is_stream(&self, endpoint: usize) -> bool {
        self.entries.get(endpoint).is_some_and(|entry| entry.port.is_stream())
    }

    /// What each endpoint does, for a person: where it listens, or to whom it sends.
    #[must_use]
    pub fn describe(&self) -> Vec<String> {
        self.entries.iter().map(|entry| entry.told.clone()).collect()
    }

    /// An endpoint's name, with the address where it listens or to which it sends.
    #[must_use]
    pub fn name(&self, endpoint: usize) -> &str {
        self.entries.get(endpoint).map_or("?", |entry| entry.name.as_str())
    }

    /// A peer's name: that of its endpoint, and where several may be behind it, its address.
    #[must_use]
    pub fn peer_name(&self, peer: PeerId) -> String {
        match self.entries.get(peer.endpoint) {
            Some(entry) if entry.many => format!("{} < {}", entry.name, peer.address),
            _ => self.name(peer.endpoint).to_owned(),
        }
    }

    /// What each endpoint has sent.
    #[must_use]
    pub fn counters(&self) -> Vec<LinkCounters> {
        self.entries.iter().map(|entry| entry.counters).collect()
    }

    /// The next thing that comes; bytes are at the buffer's beginning. Loses nothing if dropped.
    pub async fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        loop {
            match std::future::poll_fn(|cx| self.poll(cx, buffer)).await {
                Ok(arrival) => return arrival,
                Err(error) => {
                    tracing::debug!("receiving: {error}");
                    sleep(PAUSE).await;
                }
            }
        }
    }

    /// What is here already. After [`Links::receive`], so often as the user likes, it gives the rest of
    /// a burst, from all endpoints in turn.
    pub fn try_receive(&mut self, buffer: &mut [u8]) -> Option<Arrival> {
        // Nobody needs to be woken: `receive` looks at every socket again before it waits.
        match self.poll(&mut Context::from_waker(Waker::noop()), buffer) {
            Poll::Ready(Ok(arrival)) => Some(arrival),
            Poll::Ready(Err(error)) => {
                tracing::debug!("receiving: {error}");
                None
            }
            Poll::Pending => None,
        }
    }

    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<Arrival>> {
        let count = self.entries.len();
        for k in 0..count {
            let endpoint = (self.turn + k) % count;
            if let Poll::Ready(event) = self.entries[endpoint].port.poll(cx, buffer) {
                self.turn = endpoint + 1;
                let peer = |address| PeerId { endpoint, address };
                return Poll::Ready(event.map(|event| match event {
                    PortEvent::Bytes(address, length) => Arrival::Bytes(peer(address), length),
                    PortEvent::Connected(address) => Arrival::Connected(peer(address)),
                    PortEvent::Closed(address) => Arrival::Closed(peer(address)),
                }));
            }
        }
        Poll::Pending
    }

    /// Sends to a peer: all of `bytes`, or nothing. What the system cannot take now is kept, see
    /// [`Links::flush`].
    ///
    /// # Errors
    /// A peer that has gone away or does not read, or a refusal of the system. None is a reason to stop,
    /// and the endpoint has counted it.
    pub fn send(&mut self, to: PeerId, bytes: &[u8]) -> Result<(), SendError> {
        let Some(LinkEntry { port, counters, .. }) = self.entries.get_mut(to.endpoint) else {
            return Err(SendError::Gone);
        };
        let sent = port.send(to.address, bytes);
        match &sent {
            Ok(()) => {
                counters.sent += 1;
                counters.sent_bytes += bytes.len() as u64;
            }
            Err(SendError::Gone) => {}
            Err(SendError::Full(_)) => counters.full += 1,
            Err(SendError::Io(_)) => counters.failed += 1,
        }
        sent
    }

    /// Waits until the system has taken all datagrams, which it does unless very many were sent at once.
    /// Waits for no stream: how fast that goes on is its peer's choice. Gives what could not be sent
    /// after all: to whom, and what. Loses nothing if dropped.
    pub async fn flush(&mut self) -> Vec<(PeerId, Vec<u8>)> {
        let mut all = Vec::new();
        std::future::poll_fn(|cx| self.poll_flush(cx, &mut all, false)).await;
        all
    }

    /// Writes what waits for streams too, for two seconds at most: the end.
    pub async fn close(&mut self) {
        let mut failed = Vec::new();
        let written = std::future::poll_fn(|cx| self.poll_flush(cx, &mut failed, true));
        if timeout(LAST_WORDS, written).await.is_err() {
            tracing::debug!("closing: not all was written");
        }
        // The system resets a stream that ends with something unread, and our last words with it.
        let mut buffer = vec![0; BUFFER];
        let unread = std::iter::from_fn(|| self.try_receive(&mut buffer));
        unread.take(MAX_UNREAD).for_each(drop);
    }

    fn poll_flush(
        &mut self,
        cx: &mut Context<'_>,
        all: &mut Vec<(PeerId, Vec<u8>)>,
        streams: bool,
    ) -> Poll<()> {
        let mut waits = false;
        for (endpoint, LinkEntry { port, counters, .. }) in self.entries.iter_mut().enumerate() {
            if port.is_stream() && !streams {
                continue;
            }
            let mut failed = Vec::new();
            waits |= port.poll_flush(cx, &mut failed).is_pending();
            for (address, bytes) in failed {
                counters.sent -= 1;
                counters.sent_bytes -= bytes.len() as u64;
                counters.failed += 1;
                all.push((PeerId { endpoint, address }, bytes));
            }
        }
        if waits { Poll::Pending } else { Poll::Ready(()) }
    }
}

#[cfg(test)]
mod tests;
