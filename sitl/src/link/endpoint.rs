//! Where to listen or to send: `udpin:HOST:PORT` and `tcpin:` listen, `udpout:` and `tcpout:` speak
//! first. `udpin://HOST:PORT` is the same; `udp:` means `udpin:` and `tcp:` means `tcpout:`, as
//! pymavlink has it. Without a host it is 127.0.0.1: whoever wants the world says `0.0.0.0`.
//! `udpbcast:HOST:PORT` sends to all of a network, without a host to 255.255.255.255.
//! `serial:DEVICE:BAUD` is a serial line, and so are `/dev/ttyACM0:57600` and MAVProxy's
//! `/dev/ttyACM0,57600`; 57600 baud if nothing is said.

use std::net::{IpAddr, SocketAddr};
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
    /// Datagrams: send to everybody on a network; who answers is heard.
    UdpBroadcast(HostPort),
    /// A stream: a serial line.
    Serial(SerialLine),
}

/// A serial line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialLine {
    /// The device, `/dev/ttyUSB0` for one.
    pub device: String,
    /// Bits a second.
    pub baud: u32,
}

/// What autopilots' telemetry ports have.
const BAUD: u32 = 57_600;

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
    "`{text}` is no endpoint ({why}); write udpin:HOST:PORT or tcpin:HOST:PORT to listen, udpout:HOST:PORT or tcpout:HOST:PORT to connect, udpbcast:HOST:PORT or serial:DEVICE:BAUD"
)]
pub struct NoEndpoint {
    text: String,
    why: &'static str,
}

/// Why an endpoint could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The host has no address.
    #[error("{endpoint}: {why}")]
    Lookup {
        /// The endpoint.
        endpoint: Endpoint,
        /// Why, with the host's name.
        why: io::Error,
    },
    /// The device is not there, or is no serial line.
    #[error("{endpoint}: opening the line: {source}")]
    Serial {
        /// The endpoint.
        endpoint: Endpoint,
        /// Why.
        source: io::Error,
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
    /// The place in the network that it names.
    #[must_use]
    pub fn place(&self) -> Option<&HostPort> {
        match self {
            Self::UdpIn(place)
            | Self::UdpOut(place)
            | Self::TcpIn(place)
            | Self::TcpOut(place)
            | Self::UdpBroadcast(place) => Some(place),
            Self::Serial(_) => None,
        }
    }

    /// The same at another place.
    fn at(&self, place: HostPort) -> Self {
        match self {
            Self::UdpIn(_) => Self::UdpIn(place),
            Self::UdpOut(_) => Self::UdpOut(place),
            Self::TcpIn(_) => Self::TcpIn(place),
            Self::TcpOut(_) => Self::TcpOut(place),
            Self::UdpBroadcast(_) => Self::UdpBroadcast(place),
            Self::Serial(line) => Self::Serial(line.clone()),
        }
    }

    /// Whether it has somebody to speak to from the beginning. All others wait until somebody has come.
    #[must_use]
    pub fn speaks_at_once(&self) -> bool {
        matches!(self, Self::UdpOut(_) | Self::UdpBroadcast(_) | Self::Serial(_))
    }

    /// Its name before the colon.
    #[must_use]
    pub fn scheme(&self) -> &'static str {
        match self {
            Self::UdpIn(_) => "udpin",
            Self::UdpOut(_) => "udpout",
            Self::TcpIn(_) => "tcpin",
            Self::TcpOut(_) => "tcpout",
            Self::UdpBroadcast(_) => "udpbcast",
            Self::Serial(_) => "serial",
        }
    }

    /// The first address of its host.
    ///
    /// # Errors
    /// The host has no address, or it has no host.
    pub async fn address(&self) -> Result<SocketAddr, OpenError> {
        let failed = |why| OpenError::Lookup { endpoint: self.clone(), why };
        match self.place() {
            Some(place) => place.address().await.map_err(failed),
            None => Err(failed(io::Error::other("a serial line has no address"))),
        }
    }

    /// The same, `by` ports further; `None` beyond the last port. Port 0 stays; a serial line has no second.
    #[must_use]
    pub fn further(&self, by: u16) -> Option<Self> {
        let Some(HostPort { host, port }) = self.place() else {
            return (by == 0).then(|| self.clone());
        };
        let port = if *port == 0 { Some(0) } else { port.checked_add(by) };
        port.map(|port| self.at(HostPort { host: host.clone(), port }))
    }
}

impl FromStr for Endpoint {
    type Err = NoEndpoint;

    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let no = |why| NoEndpoint { text: text.into(), why };
        if text.starts_with("/dev/") {
            return text.parse().map(Self::Serial).map_err(no);
        }
        let (scheme, rest) = text.split_once(':').ok_or_else(|| no("it has no colon"))?;
        let kind = match scheme {
            "udpin" | "udp" => Self::UdpIn,
            "udpout" => Self::UdpOut,
            "tcpin" => Self::TcpIn,
            "tcpout" | "tcp" => Self::TcpOut,
            "udpbcast" => Self::UdpBroadcast,
            "serial" => return rest.parse().map(Self::Serial).map_err(no),
            _ => return Err(no("only udpin, udpout, udpbcast, tcpin, tcpout and serial are known")),
        };
        let rest = rest.strip_prefix("//").unwrap_or(rest);
        let mut place: HostPort = rest.parse().map_err(no)?;
        if scheme == "udpbcast" && rest.starts_with(':') {
            place.host = "255.255.255.255".into();
        }
        let (endpoint, port) = (kind(place.clone()), place.port);
        let listens = matches!(endpoint, Self::UdpIn(_) | Self::TcpIn(_));
        if port == 0 && !listens {
            return Err(no("nobody listens on port 0"));
        }
        Ok(endpoint)
    }
}

impl FromStr for SerialLine {
    type Err = &'static str;

    /// `DEVICE:BAUD`, `DEVICE,BAUD` or `DEVICE`.
    fn from_str(text: &str) -> Result<Self, &'static str> {
        let (device, baud) = match text.rsplit_once([':', ',']) {
            Some((device, baud)) => {
                (device, baud.parse().map_err(|_| "the baud rate is not a whole number")?)
            }
            None => (text, BAUD),
        };
        match (device, baud) {
            ("", _) => Err("the device is missing"),
            (_, 0) => Err("the baud rate is 0"),
            _ => Ok(Self { device: device.into(), baud }),
        }
    }
}

impl HostPort {
    /// The first address of the host.
    ///
    /// # Errors
    /// The host has no address: the error names it.
    pub async fn address(&self) -> io::Result<SocketAddr> {
        let Self { host, port } = self;
        let told = |why: String| io::Error::other(format!("looking up `{host}`: {why}"));
        let found = lookup_host(format!("{host}:{port}")).await.map_err(|error| told(error.to_string()));
        found?.next().ok_or_else(|| told("it has no address".into()))
    }

    /// The address, if the host is one and no name.
    #[must_use]
    pub fn literal(&self) -> Option<SocketAddr> {
        let bare = self.host.trim_start_matches('[').trim_end_matches(']');
        bare.parse::<IpAddr>().ok().map(|address| (address, self.port).into())
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
        match self {
            Self::Serial(SerialLine { device, baud }) => write!(f, "serial:{device}:{baud}"),
            _ => self
                .place()
                .map_or(Ok(()), |HostPort { host, port }| write!(f, "{}:{host}:{port}", self.scheme())),
        }
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
            ("udpbcast::14550", "udpbcast:255.255.255.255:14550"),
            ("udpbcast:192.168.1.255:14550", "udpbcast:192.168.1.255:14550"),
            ("serial:/dev/ttyUSB0:921600", "serial:/dev/ttyUSB0:921600"),
            ("serial:COM3:115200", "serial:COM3:115200"),
            ("/dev/ttyACM0:115200", "serial:/dev/ttyACM0:115200"),
            ("/dev/ttyACM0,115200", "serial:/dev/ttyACM0:115200"),
            ("/dev/serial/by-id/usb-3D_Robotics", "serial:/dev/serial/by-id/usb-3D_Robotics:57600"),
        ] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), shown);
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line() {
        for (text, why) in [
            ("14550", "no colon"),
            ("can:can0:57600", "only udpin, udpout, udpbcast, tcpin, tcpout and serial"),
            ("serial:/dev/ttyUSB0:fast", "the baud rate is not a whole number"),
            ("serial:/dev/ttyUSB0:0", "the baud rate is 0"),
            ("serial::57600", "the device is missing"),
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
        let port = |endpoint: Endpoint| endpoint.place().map(|place| place.port);
        assert_eq!(endpoint.further(535).and_then(port), Some(65_535));
        assert_eq!(endpoint.further(536), None);
        assert_eq!("udpin::0".parse::<Endpoint>().unwrap().further(7).and_then(port), Some(0));
        let line: Endpoint = "/dev/ttyACM0".parse().unwrap();
        assert_eq!((line.further(0), line.further(1)), (Some(line.clone()), None));
    }
}
