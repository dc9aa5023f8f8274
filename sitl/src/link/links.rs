//! Several endpoints at once, as one source and one sink of bytes. Knows sockets, not what is in them.
//!
//! Nothing that a peer does ends it: an error of a socket is logged and waited out, a stream that
//! breaks is closed and told, a `tcpout` endpoint connects again, and a stream that is not read for so
//! long that its buffer is full is closed.

use std::collections::BTreeMap;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::{Sleep, sleep};

use super::PeerId;
use super::endpoint::{Direction, Endpoint, OpenError, Transport};

/// The largest datagram.
pub const BUFFER: usize = 65_536;
/// Bytes that wait for a stream's peer at most: some seconds of pictures.
const UNSENT: usize = 1 << 20;
/// Streams that one `tcpin` endpoint takes at a time.
const MAX_STREAMS: usize = 16;
/// Between two attempts of a `tcpout` endpoint.
const RECONNECT: Duration = Duration::from_secs(1);
/// After an error of a socket, which is about earlier sendings ("connection refused").
const PAUSE: Duration = Duration::from_millis(1);

/// Something has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// So many bytes from a peer, in the buffer: a datagram, or a part of a stream.
    Bytes(PeerId, usize),
    /// A stream has begun; its peer may wait for our first word.
    Connected(PeerId),
    /// A stream has ended.
    Closed(PeerId),
}

/// Open endpoints.
#[derive(Debug)]
pub struct Links {
    ports: Vec<Port>,
    /// Where the next look begins, so that no endpoint starves another.
    turn: usize,
}

#[derive(Debug)]
enum Port {
    Udp { socket: UdpSocket, peer: Option<SocketAddr> },
    TcpIn { listener: TcpListener, streams: BTreeMap<SocketAddr, LinkStream> },
    TcpOut { address: SocketAddr, state: Outward },
}

enum Outward {
    Up(LinkStream),
    Waiting(Pin<Box<Sleep>>),
    Connecting(Pin<Box<dyn Future<Output = io::Result<TcpStream>> + Send>>),
}

impl std::fmt::Debug for Outward {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Up(_) => "Up",
            Self::Waiting(_) => "Waiting",
            Self::Connecting(_) => "Connecting",
        })
    }
}

#[derive(Debug)]
struct LinkStream {
    tcp: TcpStream,
    unsent: Vec<u8>,
    /// Told to its user.
    announced: bool,
}

impl LinkStream {
    fn new(tcp: TcpStream) -> Self {
        // Frames are small and wait for nobody.
        let _ = tcp.set_nodelay(true);
        Self { tcp, unsent: Vec::new(), announced: false }
    }

    /// Bytes read, 0 at the end of the stream.
    fn poll_read(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<usize>> {
        while !self.unsent.is_empty() {
            match Pin::new(&mut self.tcp).poll_write(cx, &self.unsent) {
                Poll::Ready(Ok(sent)) => drop(self.unsent.drain(..sent)),
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => break,
            }
        }
        let mut buffer = ReadBuf::new(buffer);
        Pin::new(&mut self.tcp).poll_read(cx, &mut buffer).map_ok(|()| buffer.filled().len())
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut rest = bytes;
        while self.unsent.is_empty() && !rest.is_empty() {
            match self.tcp.try_write(rest) {
                Ok(sent) => rest = &rest[sent..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        if self.unsent.len() + rest.len() > UNSENT {
            return Err(io::Error::other("its peer does not read"));
        }
        self.unsent.extend_from_slice(rest);
        Ok(())
    }
}

impl Links {
    /// Opens all endpoints, or none.
    pub async fn open(endpoints: &[Endpoint]) -> Result<Self, OpenError> {
        let mut ports = Vec::with_capacity(endpoints.len());
        for endpoint in endpoints {
            ports.push(Port::open(endpoint).await?);
        }
        Ok(Self { ports, turn: 0 })
    }

    /// A single UDP socket; `peer` is spoken to first, if given.
    #[must_use]
    pub fn of_socket(socket: UdpSocket, peer: Option<SocketAddr>) -> Self {
        Self { ports: vec![Port::Udp { socket, peer }], turn: 0 }
    }

    /// The peers of `udpout` endpoints: they wait for our first word, and never come and go.
    #[must_use]
    pub fn fixed(&self) -> Vec<PeerId> {
        let peers = self.ports.iter().enumerate().filter_map(|(endpoint, port)| match port {
            Port::Udp { peer: Some(address), .. } => Some(PeerId { endpoint, address: *address }),
            _ => None,
        });
        peers.collect()
    }

    /// What each endpoint does, for a person: where it listens, or to whom it sends.
    #[must_use]
    pub fn describe(&self) -> Vec<String> {
        let port = |local: io::Result<SocketAddr>| local.map_or_else(|_| "?".into(), |a| a.to_string());
        let told = self.ports.iter().map(|each| match each {
            Port::Udp { socket, peer: None } => format!("listening on udpin:{}", port(socket.local_addr())),
            Port::Udp { socket, peer: Some(peer) } => {
                let local = socket.local_addr().map_or(0, |address| address.port());
                format!("sending to udpout:{peer} from port {local}")
            }
            Port::TcpIn { listener, .. } => format!("listening on tcpin:{}", port(listener.local_addr())),
            Port::TcpOut { address, .. } => format!("connected to tcpout:{address}"),
        });
        told.collect()
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

    /// A datagram that is here already.
    pub fn try_receive(&mut self, buffer: &mut [u8]) -> Option<Arrival> {
        let found = self.ports.iter().enumerate().find_map(|(endpoint, port)| match port {
            Port::Udp { socket, .. } => {
                socket.try_recv_from(buffer).ok().map(|(n, from)| (endpoint, n, from))
            }
            _ => None,
        });
        found.map(|(endpoint, length, address)| Arrival::Bytes(PeerId { endpoint, address }, length))
    }

    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<Arrival>> {
        let count = self.ports.len();
        for k in 0..count {
            let endpoint = (self.turn + k) % count;
            if let Poll::Ready(found) = self.ports[endpoint].poll(endpoint, cx, buffer) {
                self.turn = endpoint + 1;
                return Poll::Ready(found);
            }
        }
        Poll::Pending
    }

    /// Sends to a peer. A peer that has gone away is no reason to stop: that is logged.
    pub async fn send(&mut self, to: PeerId, bytes: &[u8]) {
        let sent = match self.ports.get_mut(to.endpoint) {
            Some(Port::Udp { socket, .. }) => socket.send_to(bytes, to.address).await.map(drop),
            Some(Port::TcpIn { streams, .. }) => match streams.get_mut(&to.address) {
                Some(stream) => stream.send(bytes).inspect_err(|_| drop(streams.remove(&to.address))),
                None => Ok(()),
            },
            Some(Port::TcpOut { state, .. }) => match state {
                Outward::Up(stream) => stream.send(bytes).inspect_err(|_| *state = later()),
                Outward::Waiting(_) | Outward::Connecting(_) => Ok(()),
            },
            None => Ok(()),
        };
        if let Err(error) = sent {
            tracing::debug!(%to, "sending: {error}");
        }
    }
}

fn later() -> Outward {
    Outward::Waiting(Box::pin(sleep(RECONNECT)))
}

impl Port {
    async fn open(endpoint: &Endpoint) -> Result<Self, OpenError> {
        if endpoint.transport == Transport::Udp {
            let (socket, peer) = endpoint.open().await?;
            return Ok(Self::Udp { socket, peer });
        }
        let address = endpoint.address().await?;
        if endpoint.direction == Direction::In {
            let listener = TcpListener::bind(address).await;
            let listener = listener.map_err(|source| endpoint.no_bind(address, source))?;
            return Ok(Self::TcpIn { listener, streams: BTreeMap::new() });
        }
        match TcpStream::connect(address).await {
            Ok(tcp) => Ok(Self::TcpOut { address, state: Outward::Up(LinkStream::new(tcp)) }),
            Err(source) => Err(OpenError::Connect { endpoint: endpoint.clone(), address, source }),
        }
    }

    fn poll(
        &mut self,
        endpoint: usize,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Poll<io::Result<Arrival>> {
        match self {
            Self::Udp { socket, .. } => {
                let mut read = ReadBuf::new(buffer);
                socket
                    .poll_recv_from(cx, &mut read)
                    .map_ok(|address| Arrival::Bytes(PeerId { endpoint, address }, read.filled().len()))
            }
            Self::TcpIn { listener, streams } => poll_listener(listener, streams, endpoint, cx, buffer),
            Self::TcpOut { address, state } => poll_outward(*address, state, endpoint, cx, buffer).map(Ok),
        }
    }
}

fn poll_listener(
    listener: &TcpListener,
    streams: &mut BTreeMap<SocketAddr, LinkStream>,
    endpoint: usize,
    cx: &mut Context<'_>,
    buffer: &mut [u8],
) -> Poll<io::Result<Arrival>> {
    while let Poll::Ready((tcp, address)) = listener.poll_accept(cx)? {
        // One too many is closed at once.
        if streams.len() < MAX_STREAMS {
            let stream = LinkStream { announced: true, ..LinkStream::new(tcp) };
            streams.insert(address, stream);
            return Poll::Ready(Ok(Arrival::Connected(PeerId { endpoint, address })));
        }
    }
    let read = streams.iter_mut().find_map(|(&address, stream)| match stream.poll_read(cx, buffer) {
        Poll::Ready(read) => Some((address, read)),
        Poll::Pending => None,
    });
    let Some((address, read)) = read else { return Poll::Pending };
    let peer = PeerId { endpoint, address };
    Poll::Ready(Ok(match read {
        Ok(length) if length > 0 => Arrival::Bytes(peer, length),
        _ => {
            streams.remove(&address);
            Arrival::Closed(peer)
        }
    }))
}

fn poll_outward(
    address: SocketAddr,
    state: &mut Outward,
    endpoint: usize,
    cx: &mut Context<'_>,
    buffer: &mut [u8],
) -> Poll<Arrival> {
    let peer = PeerId { endpoint, address };
    loop {
        match state {
            Outward::Waiting(pause) => {
                if pause.as_mut().poll(cx).is_pending() {
                    return Poll::Pending;
                }
                *state = Outward::Connecting(Box::pin(TcpStream::connect(address)));
            }
            Outward::Connecting(attempt) => match attempt.as_mut().poll(cx) {
                Poll::Ready(Ok(tcp)) => *state = Outward::Up(LinkStream::new(tcp)),
                Poll::Ready(Err(error)) => {
                    tracing::debug!(%address, "connecting: {error}");
                    *state = later();
                }
                Poll::Pending => return Poll::Pending,
            },
            Outward::Up(stream) if !stream.announced => {
                stream.announced = true;
                return Poll::Ready(Arrival::Connected(peer));
            }
            Outward::Up(stream) => match stream.poll_read(cx, buffer) {
                Poll::Ready(Ok(length)) if length > 0 => return Poll::Ready(Arrival::Bytes(peer, length)),
                Poll::Ready(_) => {
                    *state = later();
                    return Poll::Ready(Arrival::Closed(peer));
                }
                Poll::Pending => return Poll::Pending,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    async fn open(text: &str) -> Links {
        Links::open(&[text.parse().unwrap()]).await.unwrap()
    }

    fn address(links: &Links, index: usize) -> SocketAddr {
        let told = links.describe();
        told[index].split_once(':').unwrap().1.parse().unwrap()
    }

    async fn next(links: &mut Links, buffer: &mut [u8]) -> Arrival {
        tokio::time::timeout(Duration::from_secs(30), links.receive(buffer)).await.unwrap()
    }

    #[tokio::test]
    async fn each_peer_is_answered_at_its_own_address_and_endpoint() {
        let endpoints = ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"];
        let endpoints: Vec<Endpoint> = endpoints.iter().map(|text| text.parse().unwrap()).collect();
        let mut links = Links::open(&endpoints).await.unwrap();
        let mut buffer = vec![0; BUFFER];
        let peers =
            [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
        for (k, peer) in peers.iter().enumerate() {
            peer.send_to(b"hello", address(&links, k)).await.unwrap();
            let Arrival::Bytes(from, 5) = next(&mut links, &mut buffer).await else { panic!("a datagram") };
            assert_eq!((from.endpoint, from.address), (k, peer.local_addr().unwrap()));
            links.send(from, b"you").await;
            let mut answer = [0; 9];
            assert_eq!(peer.recv(&mut answer).await.unwrap(), 3);
        }
        let mut stream = TcpStream::connect(address(&links, 2)).await.unwrap();
        let Arrival::Connected(from) = next(&mut links, &mut buffer).await else { panic!("a stream") };
        links.send(from, b"first").await;
        let mut answer = [0; 5];
        stream.read_exact(&mut answer).await.unwrap();
        stream.write_all(b"hello").await.unwrap();
        assert_eq!(next(&mut links, &mut buffer).await, Arrival::Bytes(from, 5));
        drop(stream);
        assert_eq!(next(&mut links, &mut buffer).await, Arrival::Closed(from));
        links.send(from, b"gone").await;
    }

    #[tokio::test]
    async fn a_stream_outward_connects_again() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut links = open(&format!("tcp:{}", listener.local_addr().unwrap())).await;
        let mut buffer = vec![0; BUFFER];
        for _ in 0..2 {
            let Arrival::Connected(peer) = next(&mut links, &mut buffer).await else { panic!("up") };
            let (mut stream, _) = listener.accept().await.unwrap();
            links.send(peer, b"x").await;
            assert_eq!(stream.read_u8().await.unwrap(), b'x');
            drop(stream);
            assert_eq!(next(&mut links, &mut buffer).await, Arrival::Closed(peer));
        }
    }

    #[tokio::test]
    async fn a_peer_that_does_not_read_is_closed_and_stops_nobody() {
        let mut links = open("tcpin:127.0.0.1:0").await;
        let mut buffer = vec![0; BUFFER];
        let _deaf = TcpStream::connect(address(&links, 0)).await.unwrap();
        let Arrival::Connected(peer) = next(&mut links, &mut buffer).await else { panic!("a stream") };
        for _ in 0..20_000 {
            links.send(peer, &[0; 1000]).await;
        }
        let Port::TcpIn { streams, .. } = &links.ports[0] else { panic!("a listener") };
        assert!(streams.is_empty());
    }

    #[tokio::test]
    async fn what_cannot_be_opened_is_said_in_one_line() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let taken = listener.local_addr().unwrap();
        let error = Links::open(&[format!("tcpin:{taken}").parse().unwrap()]).await.unwrap_err().to_string();
        assert!(error.starts_with(&format!("tcpin:{taken}: binding")) && error.contains("in use"), "{error}");
        drop(listener);
        let error = Links::open(&[format!("tcp:{taken}").parse().unwrap()]).await.unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("tcpout:{taken}: connecting")) && !error.contains('\n'),
            "{error}"
        );
    }
}
