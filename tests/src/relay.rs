//! A UDP path that loses datagrams: every nth one, both directions counted together.
//!
//! Knows nothing of what it carries. It serves one client, the one that spoke last.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};

/// How often the threads look whether the relay is still wanted.
const PULSE: Duration = Duration::from_millis(20);

/// A running relay; dropping it ends it.
#[derive(Debug)]
pub struct Relay {
    address: SocketAddr,
    path: Arc<Path>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Path {
    front: UdpSocket,
    back: UdpSocket,
    client: Mutex<Option<SocketAddr>>,
    every: u64,
    seen: AtomicU64,
    lost: AtomicU64,
    stop: AtomicBool,
}

impl Relay {
    /// A path to `target` that loses every `every`th datagram; 0 loses none.
    ///
    /// # Errors
    /// No socket can be opened.
    pub fn to(target: SocketAddr, every: u64) -> Result<Self> {
        let socket = || -> Result<UdpSocket> {
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).context("binding the relay")?;
            socket.set_read_timeout(Some(PULSE))?;
            Ok(socket)
        };
        let (front, back) = (socket()?, socket()?);
        back.connect(target).with_context(|| format!("relaying to {target}"))?;
        let address = front.local_addr()?;
        let path = Arc::new(Path {
            front,
            back,
            client: Mutex::new(None),
            every,
            seen: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            stop: AtomicBool::new(false),
        });
        let threads = [Path::up, Path::down]
            .map(|direction| {
                let path = Arc::clone(&path);
                std::thread::spawn(move || direction(&path))
            })
            .into();
        Ok(Self { address, path, threads })
    }

    /// Where a client sends to.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Datagrams so far, and how many of them were lost on purpose.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        (self.path.seen.load(Ordering::Relaxed), self.path.lost.load(Ordering::Relaxed))
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.path.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Path {
    /// Client to target.
    fn up(&self) {
        let mut buffer = vec![0; 65_536];
        while !self.stop.load(Ordering::Relaxed) {
            let Some((n, from)) = received(self.front.recv_from(&mut buffer)) else { continue };
            *self.client.lock().unwrap_or_else(PoisonError::into_inner) = Some(from);
            if self.passes() {
                // A target that is gone is for the ends to notice.
                let _ = self.back.send(&buffer[..n]);
            }
        }
    }

    /// Target to client.
    fn down(&self) {
        let mut buffer = vec![0; 65_536];
        while !self.stop.load(Ordering::Relaxed) {
            let Some(n) = received(self.back.recv(&mut buffer)) else { continue };
            let client = *self.client.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(client) = client
                && self.passes()
            {
                let _ = self.front.send_to(&buffer[..n], client);
            }
        }
    }

    /// Counts a datagram and tells whether it is one of the lucky ones.
    fn passes(&self) -> bool {
        let number = self.seen.fetch_add(1, Ordering::Relaxed) + 1;
        let lucky = self.every == 0 || !number.is_multiple_of(self.every);
        if !lucky {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        lucky
    }
}

fn received<T>(result: std::io::Result<T>) -> Option<T> {
    match result {
        Ok(received) => Some(received),
        Err(error) => {
            // A refused datagram shows up as an error of the next receive, at once.
            if !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
                std::thread::sleep(Duration::from_millis(1));
            }
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends 1..=n through a relay to an echo, one at a time, and returns what came back.
    fn echoed(every: u64, n: u8) -> (Vec<u8>, (u64, u64)) {
        let echo = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let client = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let relay = Relay::to(echo.local_addr().unwrap(), every).unwrap();
        client.connect(relay.address()).unwrap();
        let mut heard = Vec::new();
        let mut buffer = [0; 16];
        // Which datagram is lost follows from the count alone; a lost one is waited for in the count.
        let mut count = 0;
        let mut passes = || {
            count += 1;
            let lucky = every == 0 || count % every != 0;
            while !lucky && relay.counts().0 < count {
                std::thread::yield_now();
            }
            lucky
        };
        for byte in 1..=n {
            client.send(&[byte]).unwrap();
            if !passes() {
                continue;
            }
            let (m, from) = echo.recv_from(&mut buffer).unwrap();
            echo.send_to(&buffer[..m], from).unwrap();
            if passes() {
                let m = client.recv(&mut buffer).unwrap();
                heard.extend_from_slice(&buffer[..m]);
            }
        }
        (heard, relay.counts())
    }

    #[test]
    fn a_whole_path_loses_nothing() {
        assert_eq!(echoed(0, 5), (vec![1, 2, 3, 4, 5], (10, 0)));
    }

    #[test]
    fn every_third_datagram_is_lost_whichever_way_it_goes() {
        // 1 up, 2 down; 3 up lost; 4 up, 5 down; 6 up lost; ...
        assert_eq!(echoed(3, 6), (vec![1, 3, 5], (9, 3)));
    }
}
