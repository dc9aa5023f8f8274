//! Where to listen or to send: `udpin:HOST:PORT` and `tcpin:` listen, `udpout:` and `tcpout:` speak
//! first. `udpin://HOST:PORT` is the same; `udp:` means `udpin:` and `tcp:` means `tcpout:`, as
//! pymavlink has it. Without a host it is 127.0.0.1: whoever wants the world says `0.0.0.0`.

use std::net::SocketAddr;
use std::str::FromStr;
use std::{fmt, io};

use tokio::net::{UdpSocket, lookup_host};

/// Who speaks first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Bind the address and wait for peers.
    In,
    /// Send to the address from a port of the system's choice.
    Out,
}

/// Datagrams or a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    /// Datagrams.
    Udp,
    /// A stream.
    Tcp,
}

/// One end of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Datagrams or a stream.
    pub transport: Transport,
    /// Who speaks first.
    pub direction: Direction,
    /// Name or address; an IPv6 address in brackets.
    pub host: String,
    /// Port; 0 lets the system choose one to listen on.
    pub port: u16,
}

/// Not an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is no endpoint ({why}); write udpin:HOST:PORT or tcpin:HOST:PORT to listen, udpout:HOST:PORT or tcpout:HOST:PORT to connect"
)]
pub struct NoEndpoint {
    text: String,
    why: &'static str,
}

/// Why an endpoint could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The host has no address.
    #[error("{endpoint}: looking up `{host}`: {why}", host = endpoint.host)]
    Lookup {
        /// The endpoint.
        endpoint: Endpoint,
        /// Why.
        why: String,
    },
    /// The port is taken, or the address is not ours.
    #[error("{endpoint}: binding {address}: {source}")]
    Bind {
        /// The endpoint.
        endpoint: Endpoint,
        /// The address that it stands for.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// Nobody listens there.
    #[error("{endpoint}: connecting to {address}: {source}")]
    Connect {
        /// The endpoint.
        endpoint: Endpoint,
        /// The address that it stands for.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// A stream, where datagrams are needed.
    #[error("{0}: only udpin and udpout can be used here")]
    Transport(Endpoint),
}

/// The receive buffer that is asked for, bytes: a burst of a few thousand frames. The system may give
/// less.
const RECEIVE_BUFFER: usize = 4 << 20;

impl Endpoint {
    /// Opens the socket of a UDP endpoint. The address is that of the peer to which an `Out` endpoint
    /// sends.
    pub async fn open(&self) -> Result<(UdpSocket, Option<SocketAddr>), OpenError> {
        if self.transport != Transport::Udp {
            return Err(OpenError::Transport(self.clone()));
        }
        let address = self.address().await?;
        let (local, peer) = match (self.direction, address) {
            (Direction::In, _) => (address, None),
            (Direction::Out, SocketAddr::V4(_)) => (SocketAddr::from(([0; 4], 0)), Some(address)),
            (Direction::Out, SocketAddr::V6(_)) => (SocketAddr::from(([0; 16], 0)), Some(address)),
        };
        let socket = UdpSocket::bind(local).await.map_err(|source| self.no_bind(local, source))?;
        if let Err(error) = socket2::SockRef::from(&socket).set_recv_buffer_size(RECEIVE_BUFFER) {
            tracing::debug!("{self}: receive buffer: {error}");
        }
        Ok((socket, peer))
    }

    /// The first address of its host.
    pub async fn address(&self) -> Result<SocketAddr, OpenError> {
        let failed = |why: String| OpenError::Lookup { endpoint: self.clone(), why };
        let mut found = lookup_host(format!("{}:{}", self.host, self.port))
            .await
            .map_err(|error| failed(error.to_string()))?;
        found.next().ok_or_else(|| failed("it has no address".into()))
    }

    pub(super) fn no_bind(&self, address: SocketAddr, source: io::Error) -> OpenError {
        OpenError::Bind { endpoint: self.clone(), address, source }
    }

    /// The same, `by` ports further; `None` beyond the last port. Port 0 stays.
    #[must_use]
    pub fn further(&self, by: u16) -> Option<Self> {
        let port = if self.port == 0 { Some(0) } else { self.port.checked_add(by) };
        port.map(|port| Self { port, ..self.clone() })
    }
}

impl FromStr for Endpoint {
    type Err = NoEndpoint;

    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let no = |why| NoEndpoint { text: text.into(), why };
        let (scheme, rest) = text.split_once(':').ok_or_else(|| no("it has no colon"))?;
        let (transport, direction) = match scheme {
            "udpin" | "udp" => (Transport::Udp, Direction::In),
            "udpout" => (Transport::Udp, Direction::Out),
            "tcpin" => (Transport::Tcp, Direction::In),
            "tcpout" | "tcp" => (Transport::Tcp, Direction::Out),
            _ => return Err(no("only udpin, udpout, tcpin and tcpout are known")),
        };
        let rest = rest.strip_prefix("//").unwrap_or(rest);
        let (host, port) = rest.rsplit_once(':').ok_or_else(|| no("the port is missing"))?;
        let port = port.parse().map_err(|_| no("the port is not a number from 0 to 65535"))?;
        let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
        if host.contains(':') && bare.is_none() {
            return Err(no("an IPv6 address needs brackets"));
        }
        if direction == Direction::Out && port == 0 {
            return Err(no("nobody listens on port 0"));
        }
        let host = if host.is_empty() { "127.0.0.1" } else { host };
        Ok(Self { transport, direction, host: host.into(), port })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match (self.transport, self.direction) {
            (Transport::Udp, Direction::In) => "udpin",
            (Transport::Udp, Direction::Out) => "udpout",
            (Transport::Tcp, Direction::In) => "tcpin",
            (Transport::Tcp, Direction::Out) => "tcpout",
        };
        write!(f, "{scheme}:{}:{}", self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_spellings_name_the_same_endpoint() {
        for (text, shown) in [
            ("udpin:127.0.0.1:14550", "udpin:127.0.0.1:14550"),
            ("udpin://127.0.0.1:0", "udpin:127.0.0.1:0"),
            ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14550"),
            ("udp://:14540", "udpin:127.0.0.1:14540"),
            ("udpout://ground.example:14540", "udpout:ground.example:14540"),
            ("udpout:[::1]:14550", "udpout:[::1]:14550"),
            ("tcp:127.0.0.1:5760", "tcpout:127.0.0.1:5760"),
            ("tcpin://0.0.0.0:5760", "tcpin:0.0.0.0:5760"),
            ("tcpout:[::1]:5760", "tcpout:[::1]:5760"),
        ] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), shown);
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line() {
        for (text, why) in [
            ("14550", "no colon"),
            ("serial:/dev/ttyUSB0:57600", "only udpin, udpout, tcpin and tcpout"),
            ("udpin:127.0.0.1", "port is missing"),
            ("udpin:127.0.0.1:70000", "from 0 to 65535"),
            ("udpout:::1:14550", "needs brackets"),
            ("udpout:127.0.0.1:0", "port 0"),
            ("tcp:127.0.0.1:0", "port 0"),
        ] {
            let error = text.parse::<Endpoint>().unwrap_err().to_string();
            assert!(error.contains(why) && !error.contains('\n'), "{text}: {error}");
        }
    }

    #[test]
    fn ports_count_up_and_end() {
        let endpoint: Endpoint = "udpin:127.0.0.1:65000".parse().unwrap();
        assert_eq!(endpoint.further(535).map(|e| e.port), Some(65_535));
        assert_eq!(endpoint.further(536), None);
        assert_eq!("udpin::0".parse::<Endpoint>().unwrap().further(7).map(|e| e.port), Some(0));
    }

    #[tokio::test]
    async fn a_port_in_use_is_named() {
        let (first, _) = "udpin:127.0.0.1:0".parse::<Endpoint>().unwrap().open().await.unwrap();
        let port = first.local_addr().unwrap().port();
        let second: Endpoint = format!("udpin:127.0.0.1:{port}").parse().unwrap();
        let error = second.open().await.unwrap_err().to_string();
        assert!(error.contains(&format!("127.0.0.1:{port}")) && error.contains("in use"), "{error}");
    }
}
