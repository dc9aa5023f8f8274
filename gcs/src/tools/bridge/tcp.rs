//! TCP links: one task a connection, and a peer that reads slowly never holds up the others.

use std::net::SocketAddr;
use std::time::Duration;

use anyhow::{Context, Result};
use crpl_sitl::link::endpoint::{Direction, Endpoint};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::time::{sleep, timeout};

use super::router::LinkId;

/// Chunks that may wait to be read or written on one connection.
const QUEUE: usize = 1024;
/// How long a peer that does not read may hold up the end.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// How long after its end or failure a connection is tried again.
const RETRY: Duration = Duration::from_secs(1);

/// What happens on a connection, which is named by its peers' addresses.
#[derive(Debug)]
pub enum TcpEvent {
    /// It is there; what is put into `writer` is written.
    Connected {
        /// Endpoint and peer, unique among open connections.
        name: String,
        /// To write.
        writer: mpsc::Sender<Vec<u8>>,
    },
    /// Something was read.
    Bytes {
        /// Which connection.
        name: String,
        /// What.
        bytes: Vec<u8>,
    },
    /// It is over.
    Closed {
        /// Which connection.
        name: String,
    },
}

/// All TCP connections of a hub.
#[derive(Debug)]
pub struct Streams {
    events: mpsc::Receiver<TcpEvent>,
    sender: mpsc::Sender<TcpEvent>,
    open: Vec<(String, LinkId, mpsc::Sender<Vec<u8>>)>,
}

impl Default for Streams {
    fn default() -> Self {
        let (sender, events) = mpsc::channel(QUEUE);
        Self { events, sender, open: Vec::new() }
    }
}

impl Streams {
    /// Listens, or connects and goes on connecting; gives how its connections' names begin, and the line
    /// to print.
    pub async fn open(&mut self, endpoint: &Endpoint) -> Result<(String, String)> {
        let address = endpoint.address().await?;
        let sender = self.sender.clone();
        if endpoint.direction == Direction::Out {
            tokio::spawn(connect(endpoint.to_string(), address, sender));
            return Ok((endpoint.to_string(), format!("connecting to {endpoint}")));
        }
        let listener =
            TcpListener::bind(address).await.with_context(|| format!("{endpoint}: binding {address}"))?;
        let name = format!("tcpin:{}", listener.local_addr().context("reading the socket's address")?);
        tokio::spawn(accept(name.clone(), listener, sender));
        let told = format!("listening on {name}");
        Ok((name, told))
    }

    /// The next event; never ends. Cancel-safe.
    pub async fn next(&mut self) -> TcpEvent {
        match self.events.recv().await {
            Some(event) => event,
            // Cannot happen while `sender` is ours.
            None => std::future::pending().await,
        }
    }

    /// Notes a connection.
    pub fn add(&mut self, name: String, link: LinkId, writer: mpsc::Sender<Vec<u8>>) {
        self.open.push((name, link, writer));
    }

    /// The link of a connection.
    #[must_use]
    pub fn link(&self, name: &str) -> Option<LinkId> {
        self.open.iter().find(|(other, ..)| other == name).map(|&(_, link, _)| link)
    }

    /// Forgets a connection; gives its link.
    pub fn remove(&mut self, name: &str) -> Option<LinkId> {
        let at = self.open.iter().position(|(other, ..)| other == name)?;
        Some(self.open.swap_remove(at).1)
    }

    /// Ends all connections when they have written what waits, or after two seconds.
    pub async fn close(&mut self) {
        let mut open: Vec<String> = self.open.drain(..).map(|(name, ..)| name).collect();
        let _ = timeout(LAST_WORDS, async {
            while !open.is_empty() {
                if let TcpEvent::Closed { name } = self.next().await {
                    open.retain(|other| *other != name);
                }
            }
        })
        .await;
    }

    /// Sends on a link; whether there was room.
    pub fn send(&self, link: LinkId, bytes: &[u8]) -> bool {
        let open = self.open.iter().find(|&&(_, other, _)| other == link);
        open.is_some_and(|(_, _, writer)| writer.try_send(bytes.to_vec()).is_ok())
    }
}

/// Connects, serves the connection to its end, and again.
async fn connect(name: String, address: SocketAddr, events: mpsc::Sender<TcpEvent>) {
    let mut told = false;
    while !events.is_closed() {
        match TcpStream::connect(address).await {
            Ok(stream) => {
                told = false;
                serve(name.clone(), stream, &events).await;
            }
            Err(error) if !told => {
                tracing::warn!("{name}: {error}; trying again every {} s", RETRY.as_secs());
                told = true;
            }
            Err(_) => {}
        }
        sleep(RETRY).await;
    }
}

/// Takes connections, each in a task of its own.
async fn accept(name: String, listener: TcpListener, events: mpsc::Sender<TcpEvent>) {
    while !events.is_closed() {
        match listener.accept().await {
            Ok((stream, peer)) => {
                let (name, events) = (format!("{name} < {peer}"), events.clone());
                tokio::spawn(async move { serve(name, stream, &events).await });
            }
            // Out of file handles, for one: others may end.
            Err(error) => {
                tracing::warn!("{name}: {error}");
                sleep(RETRY).await;
            }
        }
    }
}

/// Reads and writes until either side ends. Who listens no more ends the task.
async fn serve(name: String, stream: TcpStream, events: &mpsc::Sender<TcpEvent>) {
    // Small packets at once: a command waits for no other.
    let _ = stream.set_nodelay(true);
    let (mut from, mut to) = stream.into_split();
    let (writer, mut queue) = mpsc::channel::<Vec<u8>>(QUEUE);
    if events.send(TcpEvent::Connected { name: name.clone(), writer }).await.is_err() {
        return;
    }
    let write = async {
        while let Some(bytes) = queue.recv().await {
            if let Err(error) = to.write_all(&bytes).await {
                tracing::info!("{name}: {error}");
                return;
            }
        }
    };
    let read = async {
        let mut buffer = vec![0; 65_536];
        loop {
            match from.read(&mut buffer).await {
                Ok(0) => return,
                Ok(length) => {
                    let event = TcpEvent::Bytes { name: name.clone(), bytes: buffer[..length].to_vec() };
                    if events.send(event).await.is_err() {
                        return;
                    }
                }
                Err(error) => {
                    tracing::info!("{name}: {error}");
                    return;
                }
            }
        }
    };
    tokio::select! {
        () = write => {}
        () = read => {}
    }
    let _ = events.send(TcpEvent::Closed { name }).await;
}
