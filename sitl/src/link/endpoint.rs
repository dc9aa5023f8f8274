//! `udpin:HOST:PORT` listens, `udpout:HOST:PORT` speaks first; `udpin://HOST:PORT` is the same.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::str::FromStr;

use tokio::net::{UdpSocket, lookup_host};

/// Who speaks first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Bind the address and wait for peers.
    In,
    /// Send to the address from a port of the system's choice.
    Out,
}

/// One end of a UDP link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Who speaks first.
    pub direction: Direction,
    /// Name or address; an IPv6 address in brackets.
    pub host: String,
    /// Port; 0 lets the system choose one to listen on.
    pub port: u16,
}

/// Not an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no endpoint ({why}); write udpin:HOST:PORT to listen or udpout:HOST:PORT to send")]
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
}

impl Endpoint {
    /// Opens the socket. The address is that of the peer to which an `Out` endpoint sends.
    pub async fn open(&self) -> Result<(UdpSocket, Option<SocketAddr>), OpenError> {
        let failed = |why: String| OpenError::Lookup { endpoint: self.clone(), why };
        let found = lookup_host(format!("{}:{}", self.host, self.port)).await;
        let address = found
            .map_err(|error| failed(error.to_string()))?
            .next()
            .ok_or_else(|| failed("it has no address".into()))?;
        let (local, peer) = match (self.direction, address) {
            (Direction::In, _) => (address, None),
            (Direction::Out, SocketAddr::V4(_)) => (SocketAddr::from(([0; 4], 0)), Some(address)),
            (Direction::Out, SocketAddr::V6(_)) => (SocketAddr::from(([0; 16], 0)), Some(address)),
        };
        let socket = UdpSocket::bind(local).await.map_err(|source| OpenError::Bind {
            endpoint: self.clone(),
            address: local,
            source,
        })?;
        Ok((socket, peer))
    }
}

impl FromStr for Endpoint {
    type Err = NoEndpoint;

    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let no = |why| NoEndpoint { text: text.into(), why };
        let (scheme, rest) = text.split_once(':').ok_or_else(|| no("it has no colon"))?;
        let direction = match scheme {
            "udpin" => Direction::In,
            "udpout" => Direction::Out,
            _ => return Err(no("only udpin and udpout are known")),
        };
        let rest = rest.strip_prefix("//").unwrap_or(rest);
        let (host, port) = rest.rsplit_once(':').ok_or_else(|| no("the port is missing"))?;
        let port = port.parse().map_err(|_| no("the port is not a number from 0 to 65535"))?;
        let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
        if host.is_empty() || (host.contains(':') && bare.is_none()) {
            return Err(no("the host is missing, or is an IPv6 address without brackets"));
        }
        if direction == Direction::Out && port == 0 {
            return Err(no("nobody listens on port 0"));
        }
        Ok(Self { direction, host: host.into(), port })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match self.direction {
            Direction::In => "udpin",
            Direction::Out => "udpout",
        };
        write!(f, "{scheme}:{}:{}", self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_spellings_name_the_same_endpoint() {
        for (text, shown) in [
            ("udpin:127.0.0.1:14550", "udpin:127.0.0.1:14550"),
            ("udpin://127.0.0.1:0", "udpin:127.0.0.1:0"),
            ("udpout://ground.example:14540", "udpout:ground.example:14540"),
            ("udpout:[::1]:14550", "udpout:[::1]:14550"),
        ] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), shown);
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line() {
        for (text, why) in [
            ("14550", "no colon"),
            ("tcp:127.0.0.1:5760", "only udpin and udpout"),
            ("udpin:127.0.0.1", "port is missing"),
            ("udpin:127.0.0.1:70000", "from 0 to 65535"),
            ("udpin::14550", "host is missing"),
            ("udpout:::1:14550", "without brackets"),
            ("udpout:127.0.0.1:0", "port 0"),
        ] {
            let error = text.parse::<Endpoint>().unwrap_err().to_string();
            assert!(error.contains(why) && !error.contains('\n'), "{text}: {error}");
        }
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
