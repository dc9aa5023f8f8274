//! Where to listen or to send: `udpin:HOST:PORT` and `tcpin:` listen, `udpout:` and `tcpout:` speak
//! first. `udpin://HOST:PORT` is the same; `udp:` means `udpin:` and `tcp:` means `tcpout:`, as
//! pymavlink has it. Without a host it is 127.0.0.1: whoever wants the world says `0.0.0.0`.

use std::net::SocketAddr;
use std::str::FromStr;
use std::{fmt, io};

use tokio::net::lookup_host;

/// One end of a link. How each kind is opened is in [`links`](super::links).
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Endpoint {
    /// Datagrams: bind the address and wait for peers.
    UdpIn(HostPort),
    /// Datagrams: send to the address from a port of the system's choice.
    UdpOut(HostPort),
    /// Streams: bind the address and wait for peers.
    TcpIn(HostPort),
    /// A stream: connect to the address.
    TcpOut(HostPort),
}

/// A place in the network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostPort {
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
    #[error("{endpoint}: looking up `{host}`: {why}", host = endpoint.place().host)]
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
}

impl Endpoint {
    /// The place that it names.
    #[must_use]
    pub fn place(&self) -> &HostPort {
        match self {
            Self::UdpIn(place) | Self::UdpOut(place) | Self::TcpIn(place) | Self::TcpOut(place) => place,
        }
    }

    /// The same at another place.
    fn at(&self, place: HostPort) -> Self {
        match self {
            Self::UdpIn(_) => Self::UdpIn(place),
            Self::UdpOut(_) => Self::UdpOut(place),
            Self::TcpIn(_) => Self::TcpIn(place),
            Self::TcpOut(_) => Self::TcpOut(place),
        }
    }

    /// Whether it has somebody to speak to from the beginning. All others wait until somebody has come.
    #[must_use]
    pub fn speaks_at_once(&self) -> bool {
        matches!(self, Self::UdpOut(_))
    }

    /// Its name before the colon.
    #[must_use]
    pub fn scheme(&self) -> &'static str {
        match self {
            Self::UdpIn(_) => "udpin",
            Self::UdpOut(_) => "udpout",
            Self::TcpIn(_) => "tcpin",
            Self::TcpOut(_) => "tcpout",
        }
    }

    /// The first address of its host.
    ///
    /// # Errors
    /// The host has no address.
    pub async fn address(&self) -> Result<SocketAddr, OpenError> {
        let failed = |why: String| OpenError::Lookup { endpoint: self.clone(), why };
        let HostPort { host, port } = self.place();
        let found = lookup_host(format!("{host}:{port}")).await.map_err(|error| failed(error.to_string()));
        found?.next().ok_or_else(|| failed("it has no address".into()))
    }

    /// The same, `by` ports further; `None` beyond the last port. Port 0 stays.
    #[must_use]
    pub fn further(&self, by: u16) -> Option<Self> {
        let HostPort { host, port } = self.place();
        let port = if *port == 0 { Some(0) } else { port.checked_add(by) };
        port.map(|port| self.at(HostPort { host: host.clone(), port }))
    }
}

impl FromStr for Endpoint {
    type Err = NoEndpoint;

    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let no = |why| NoEndpoint { text: text.into(), why };
        let (scheme, rest) = text.split_once(':').ok_or_else(|| no("it has no colon"))?;
        let kind = match scheme {
            "udpin" | "udp" => Self::UdpIn,
            "udpout" => Self::UdpOut,
            "tcpin" => Self::TcpIn,
            "tcpout" | "tcp" => Self::TcpOut,
            _ => return Err(no("only udpin, udpout, tcpin and tcpout are known")),
        };
        let endpoint = kind(rest.strip_prefix("//").unwrap_or(rest).parse().map_err(no)?);
        let listens = matches!(endpoint, Self::UdpIn(_) | Self::TcpIn(_));
        if endpoint.place().port == 0 && !listens {
            return Err(no("nobody listens on port 0"));
        }
        Ok(endpoint)
    }
}

impl FromStr for HostPort {
    type Err = &'static str;

    /// `HOST:PORT`, or `:PORT` for this machine alone.
    fn from_str(text: &str) -> Result<Self, &'static str> {
        let (host, port) = text.rsplit_once(':').ok_or("the port is missing")?;
        let port = port.parse().map_err(|_| "the port is not a number from 0 to 65535")?;
        let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
        if host.contains(':') && bare.is_none() {
            return Err("an IPv6 address needs brackets");
        }
        let host = if host.is_empty() { "127.0.0.1" } else { host };
        Ok(Self { host: host.into(), port })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let HostPort { host, port } = self.place();
        write!(f, "{}:{host}:{port}", self.scheme())
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
        assert_eq!(endpoint.further(535).map(|e| e.place().port), Some(65_535));
        assert_eq!(endpoint.further(536), None);
        assert_eq!("udpin::0".parse::<Endpoint>().unwrap().further(7).map(|e| e.place().port), Some(0));
    }
}
