//! `--out` of a flight: the folder that it leaves behind, or somebody who watches it.

use std::path::PathBuf;
use std::str::FromStr;

use crpl_sitl::link::endpoint::{Endpoint, NoEndpoint};

/// A value of `--out`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Out {
    /// Where to put the run folder.
    Folder(PathBuf),
    /// Where to pass the vehicle's messages to, as `gcs bridge` does.
    Endpoint(Endpoint),
}

impl FromStr for Out {
    type Err = NoEndpoint;

    /// What looks like SCHEME:HOST:PORT must be an endpoint, so a misspelt one makes no folder.
    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let port = text.rsplit_once(':').map(|(_, port)| port);
        let scheme = text.split_once(':').map_or("", |(scheme, _)| scheme);
        let known = ["udp", "tcp"].iter().any(|transport| scheme.starts_with(transport));
        let word = scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphabetic());
        let numbered = word && port.is_some_and(|p| p.bytes().all(|b| b.is_ascii_digit()));
        if known || numbered { text.parse().map(Self::Endpoint) } else { Ok(Self::Folder(text.into())) }
    }
}

/// The folder and the endpoints among the values of `--out`; the last folder counts.
#[must_use]
pub fn sorted(outs: &[Out], folder: &str) -> (PathBuf, Vec<Endpoint>) {
    let (mut dir, mut endpoints) = (PathBuf::from(folder), Vec::new());
    for out in outs {
        match out {
            Out::Folder(path) => dir.clone_from(path),
            Out::Endpoint(endpoint) => endpoints.push(endpoint.clone()),
        }
    }
    (dir, endpoints)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_folders_and_endpoints_endpoints() {
        for folder in ["runs/flight", "/tmp/x:y", "C:\\runs", "runs/12:30"] {
            assert_eq!(folder.parse(), Ok(Out::Folder(folder.into())), "{folder}");
        }
        for endpoint in ["udpout:127.0.0.1:14550", "tcpin://0.0.0.0:5760"] {
            assert!(matches!(endpoint.parse(), Ok(Out::Endpoint(_))), "{endpoint}");
        }
        for typo in ["udpuot:127.0.0.1:14550", "udpout:14550", "upd:127.0.0.1:14550", "tcpout:host"] {
            assert!(typo.parse::<Out>().is_err(), "{typo}");
        }
    }

    #[test]
    fn the_default_folder_stays_beside_endpoints() {
        let endpoint: Out = "udpout:127.0.0.1:14550".parse().unwrap();
        let (dir, endpoints) = sorted(std::slice::from_ref(&endpoint), "runs/flight");
        assert_eq!((dir, endpoints.len()), ("runs/flight".into(), 1));
        let (dir, endpoints) = sorted(&["x".parse().unwrap(), endpoint], "runs/flight");
        assert_eq!((dir, endpoints.len()), ("x".into(), 1));
    }
}
