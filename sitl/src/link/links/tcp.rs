//! Streams: `tcpin`, `tcpout`, and serial lines, which are opened again as `tcpout` connects again.

use std::collections::{BTreeMap, VecDeque};
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::ops::Bound;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use serial2_tokio::SerialPort;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Sleep, sleep};

use super::stream::LinkStream;
use super::{Backlog, LinkOptions, LinkPort, NO_ADDRESS, PortEvent, SendError};
use crate::link::endpoint::{Endpoint, HostPort, OpenError};

/// Between two attempts of a `tcpout` endpoint, and after a `tcpin` endpoint could not take a stream.
const RETRY: Duration = Duration::from_secs(1);

/// A listener and its streams.
#[derive(Debug)]
pub(super) struct ListenPort {
    listener: TcpListener,
    streams: BTreeMap<SocketAddr, LinkStream>,
    /// The stream that was read last; those behind it come first, so that none starves another.
    turn: Option<SocketAddr>,
    /// Streams that were closed from here and have not been told yet.
    gone: VecDeque<SocketAddr>,
    /// The system could not give a stream, for one because it is out of file handles.
    pause: Option<Pin<Box<Sleep>>>,
    backlog: Backlog,
    max_streams: usize,
}

impl ListenPort {
    pub(super) async fn open(endpoint: &Endpoint, options: &LinkOptions) -> Result<Self, OpenError> {
        let address = endpoint.address().await?;
        let listener = TcpListener::bind(address).await.map_err(|source| OpenError::Bind {
            endpoint: endpoint.clone(),
            address,
            source,
        })?;
        Ok(Self {
            listener,
            streams: BTreeMap::new(),
            turn: None,
            gone: VecDeque::new(),
            pause: None,
            backlog: options.backlog,
            max_streams: options.max_streams,
        })
    }

    /// The next new stream.
    fn accept(&mut self, cx: &mut Context<'_>) -> Option<SocketAddr> {
        loop {
            if let Some(pause) = &mut self.pause {
                if pause.as_mut().poll(cx).is_pending() {
                    return None;
                }
                self.pause = None;
            }
            match self.listener.poll_accept(cx) {
                // One too many is closed at once.
                Poll::Ready(Ok((_, address))) if self.streams.len() >= self.max_streams => {
                    tracing::debug!(%address, "refused: {} streams are open", self.streams.len());
                }
                Poll::Ready(Ok((tcp, address))) => {
                    self.streams.insert(address, LinkStream::tcp(tcp));
                    return Some(address);
                }
                Poll::Ready(Err(error)) => {
                    tracing::warn!("accepting: {error}; trying again in {} s", RETRY.as_secs());
                    self.pause = Some(Box::pin(sleep(RETRY)));
                }
                Poll::Pending => return None,
            }
        }
    }

    /// Reads the first of these streams that has something.
    fn read(
        &mut self,
        range: (Bound<SocketAddr>, Bound<SocketAddr>),
        cx: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Option<PortEvent> {
        let mut streams = self.streams.range_mut(range);
        let (address, read) = streams.find_map(|(&address, stream)| match stream.poll_read(cx, buffer) {
            Poll::Ready(read) => Some((address, read)),
            Poll::Pending => None,
        })?;
        self.turn = Some(address);
        Some(match read {
            Ok(length) if length > 0 => PortEvent::Bytes(address, length),
            _ => {
                self.streams.remove(&address);
                PortEvent::Closed(address)
            }
        })
    }
}

impl LinkPort for ListenPort {
    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<PortEvent>> {
        if let Some(gone) = self.gone.pop_front() {
            return Poll::Ready(Ok(PortEvent::Closed(gone)));
        }
        if let Some(address) = self.accept(cx) {
            return Poll::Ready(Ok(PortEvent::Connected(address)));
        }
        let read = match self.turn {
            None => self.read((Bound::Unbounded, Bound::Unbounded), cx, buffer),
            Some(last) => self
                .read((Bound::Excluded(last), Bound::Unbounded), cx, buffer)
                .or_else(|| self.read((Bound::Unbounded, Bound::Included(last)), cx, buffer)),
        };
        read.map_or(Poll::Pending, |event| Poll::Ready(Ok(event)))
    }

    fn send(&mut self, to: SocketAddr, bytes: &[u8]) -> Result<(), SendError> {
        let stream = self.streams.get_mut(&to).ok_or(SendError::Gone)?;
        stream.send(bytes, self.backlog).inspect_err(|error| {
            if error.closes(self.backlog) {
                self.streams.remove(&to);
                self.gone.push_back(to);
            }
        })
    }

    fn poll_flush(&mut self, cx: &mut Context<'_>, _failed: &mut Vec<(SocketAddr, Vec<u8>)>) -> Poll<()> {
        let mut waits = false;
        let gone = &mut self.gone;
        self.streams.retain(|&address, stream| match stream.poll_write(cx) {
            Poll::Ready(Err(_)) => {
                gone.push_back(address);
                false
            }
            written => {
                waits |= written.is_pending();
                true
            }
        });
        if waits { Poll::Pending } else { Poll::Ready(()) }
    }

    fn local(&self) -> Option<SocketAddr> {
        self.listener.local_addr().ok()
    }

    fn is_stream(&self) -> bool {
        true
    }
}

/// A stream outward, which is made again after its end.
#[derive(Debug)]
pub(super) struct ConnectPort {
    endpoint: Endpoint,
    /// What it is called: a name may stand for other addresses later, and a serial line has none.
    address: SocketAddr,
    state: Outward,
    /// Whether it was told that nobody answers.
    complained: bool,
    backlog: Backlog,
}

/// An attempt to make a stream.
type Dialling = Pin<Box<dyn Future<Output = io::Result<LinkStream>> + Send>>;

/// Makes a stream; a name is looked up each time.
async fn dial(endpoint: Endpoint) -> io::Result<LinkStream> {
    match (&endpoint, endpoint.place()) {
        (Endpoint::Serial(line), _) => Ok(LinkStream::serial(SerialPort::open(&line.device, line.baud)?)),
        (_, Some(place)) => Ok(LinkStream::tcp(TcpStream::connect(place.address().await?).await?)),
        (_, None) => Err(io::Error::other("it has no place")),
    }
}

enum Outward {
    /// Connected, and not told yet.
    New(LinkStream),
    Up(LinkStream),
    /// Closed from here, and not told yet.
    Gone,
    Waiting(Pin<Box<Sleep>>),
    Connecting(Dialling),
}

impl std::fmt::Debug for Outward {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::New(_) => "New",
            Self::Up(_) => "Up",
            Self::Gone => "Gone",
            Self::Waiting(_) => "Waiting",
            Self::Connecting(_) => "Connecting",
        })
    }
}

impl Outward {
    fn later() -> Self {
        Self::Waiting(Box::pin(sleep(RETRY)))
    }
}

impl ConnectPort {
    pub(super) async fn open(endpoint: &Endpoint, options: &LinkOptions) -> Result<Self, OpenError> {
        let attempt: Dialling = Box::pin(dial(endpoint.clone()));
        let mut address = endpoint.place().and_then(HostPort::literal).unwrap_or(NO_ADDRESS);
        let state = if options.connects_later {
            Outward::Connecting(attempt)
        } else {
            let is_serial = matches!(endpoint, Endpoint::Serial(_));
            if !is_serial {
                address = endpoint.address().await?;
            }
            let endpoint = endpoint.clone();
            Outward::New(attempt.await.map_err(|source| match is_serial {
                true => OpenError::Serial { endpoint, source },
                false => OpenError::Connect { endpoint, address, source },
            })?)
        };
        let (endpoint, backlog) = (endpoint.clone(), options.backlog);
        Ok(Self { endpoint, address, state, complained: false, backlog })
    }
}

impl LinkPort for ConnectPort {
    fn poll(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<PortEvent>> {
        loop {
            match std::mem::replace(&mut self.state, Outward::Gone) {
                Outward::New(stream) => {
                    self.complained = false;
                    self.state = Outward::Up(stream);
                    return Poll::Ready(Ok(PortEvent::Connected(self.address)));
                }
                Outward::Up(mut stream) => match stream.poll_read(cx, buffer) {
                    Poll::Ready(Ok(length)) if length > 0 => {
                        self.state = Outward::Up(stream);
                        return Poll::Ready(Ok(PortEvent::Bytes(self.address, length)));
                    }
                    Poll::Ready(_) => {}
                    Poll::Pending => {
                        self.state = Outward::Up(stream);
                        return Poll::Pending;
                    }
                },
                Outward::Gone => {
                    self.state = Outward::later();
                    return Poll::Ready(Ok(PortEvent::Closed(self.address)));
                }
                Outward::Waiting(mut pause) => {
                    if pause.as_mut().poll(cx).is_pending() {
                        self.state = Outward::Waiting(pause);
                        return Poll::Pending;
                    }
                    self.state = Outward::Connecting(Box::pin(dial(self.endpoint.clone())));
                }
                Outward::Connecting(mut attempt) => match attempt.as_mut().poll(cx) {
                    Poll::Ready(Ok(stream)) => self.state = Outward::New(stream),
                    Poll::Ready(Err(error)) => {
                        if !self.complained {
                            let (name, every) = (&self.endpoint, RETRY.as_secs());
                            tracing::warn!("{name}: connecting: {error}; trying again every {every} s");
                        }
                        self.complained = true;
                        self.state = Outward::later();
                    }
                    Poll::Pending => {
                        self.state = Outward::Connecting(attempt);
                        return Poll::Pending;
                    }
                },
            }
        }
    }

    fn send(&mut self, _to: SocketAddr, bytes: &[u8]) -> Result<(), SendError> {
        let Outward::Up(stream) = &mut self.state else { return Err(SendError::Gone) };
        stream.send(bytes, self.backlog).inspect_err(|error| {
            if error.closes(self.backlog) {
                self.state = Outward::Gone;
            }
        })
    }

    fn poll_flush(&mut self, cx: &mut Context<'_>, _failed: &mut Vec<(SocketAddr, Vec<u8>)>) -> Poll<()> {
        let Outward::Up(stream) = &mut self.state else { return Poll::Ready(()) };
        stream.poll_write(cx).map(|written| {
            if written.is_err() {
                self.state = Outward::Gone;
            }
        })
    }

    fn local(&self) -> Option<SocketAddr> {
        None
    }

    fn is_stream(&self) -> bool {
        true
    }
}
