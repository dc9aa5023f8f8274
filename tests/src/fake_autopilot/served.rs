//! A copied autopilot on a socket of its own.

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use super::{Autopilot, Stack};

/// An autopilot on a socket of its own, in real time or faster; dropping it ends it.
#[derive(Debug)]
pub struct Served {
    address: SocketAddr,
    autopilot: Arc<Mutex<Autopilot>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// ArduCopter waits for a station on TCP, as its simulator does; PX4 speaks on UDP.
    ///
    /// # Errors
    /// No socket can be opened.
    pub fn start(autopilot: Autopilot, factor: f64) -> Result<Self> {
        let stack = autopilot.stack;
        let autopilot = Arc::new(Mutex::new(autopilot));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, ended) = (Arc::clone(&autopilot), Arc::clone(&stop));
        let (address, thread) = if stack == Stack::Px4 {
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).context("binding the autopilot")?;
            socket.set_nonblocking(true)?;
            let address = socket.local_addr()?;
            (address, std::thread::spawn(move || serve_udp(&socket, &shared, &ended, factor)))
        } else {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).context("binding the autopilot")?;
            let address = listener.local_addr()?;
            (address, std::thread::spawn(move || serve_tcp(&listener, &shared, &ended, factor)))
        };
        Ok(Self { address, autopilot, stop, thread: Some(thread) })
    }

    /// The endpoint at which a station finds it.
    #[must_use]
    pub fn endpoint(&self, stack: Stack) -> String {
        let scheme = if stack == Stack::Px4 { "udpout" } else { "tcpout" };
        format!("{scheme}:{}", self.address)
    }

    /// Looks at the autopilot, or changes it.
    pub fn with<T>(&self, look: impl FnOnce(&mut Autopilot) -> T) -> T {
        look(&mut self.autopilot.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A listener waits for a connection to look up.
        let _ = std::net::TcpStream::connect(self.address);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

const PULSE: Duration = Duration::from_millis(2);
/// Longest step of a vehicle's clock, and how far it runs on after a setpoint, s. Simulators slow down
/// on a busy machine, too; what a lost station does to a vehicle is told without a wall clock.
const LONGEST_STEP: f64 = 0.1;
const AFTER_SETPOINT: f64 = 0.2;

/// The clock of a served vehicle.
struct Pace {
    factor: f64,
    last: Instant,
    /// The vehicle's time, s.
    time: f64,
}

impl Pace {
    fn new(factor: f64) -> Self {
        Self { factor, last: Instant::now(), time: 0.0 }
    }

    /// Goes on by the wall's time since the last call; what the vehicle sends meanwhile.
    fn advance(&mut self, autopilot: &mut Autopilot) -> Vec<u8> {
        let passed = self.last.elapsed().as_secs_f64() * self.factor;
        self.last = Instant::now();
        // A vehicle that somebody else flies waits for nobody.
        let waits = match autopilot.setpoint {
            Some((newest, _)) if autopilot.controlled() || autopilot.stack == Stack::Px4 => {
                newest + AFTER_SETPOINT
            }
            _ => f64::INFINITY,
        };
        self.time = (self.time + passed.min(LONGEST_STEP)).min(waits.max(autopilot.time));
        autopilot.advance(self.time, self.factor)
    }
}

fn serve_udp(socket: &UdpSocket, shared: &Mutex<Autopilot>, stop: &AtomicBool, factor: f64) {
    let (mut pace, mut buffer, mut peer) = (Pace::new(factor), vec![0; 65_536], None);
    while !stop.load(Ordering::Relaxed) {
        let mut autopilot = shared.lock().unwrap_or_else(PoisonError::into_inner);
        while let Ok((length, from)) = socket.recv_from(&mut buffer) {
            peer = Some(from);
            autopilot.datagram(&buffer[..length]);
        }
        let out = pace.advance(&mut autopilot);
        drop(autopilot);
        for part in out.chunks(1400) {
            // Frames may be cut between datagrams; stations join them.
            let _ = peer.map(|peer| socket.send_to(part, peer));
        }
        std::thread::sleep(PULSE);
    }
}

fn serve_tcp(listener: &TcpListener, shared: &Mutex<Autopilot>, stop: &AtomicBool, factor: f64) {
    let Ok((mut stream, _)) = listener.accept() else { return };
    let _ = stream.set_nodelay(true);
    if stream.set_read_timeout(Some(PULSE)).is_err() {
        return;
    }
    let (mut pace, mut buffer) = (Pace::new(factor), vec![0; 65_536]);
    while !stop.load(Ordering::Relaxed) {
        let read = match stream.read(&mut buffer) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => 0,
            Err(_) => return,
        };
        let mut autopilot = shared.lock().unwrap_or_else(PoisonError::into_inner);
        autopilot.datagram(&buffer[..read]);
        let out = pace.advance(&mut autopilot);
        drop(autopilot);
        if stream.write_all(&out).is_err() {
            return;
        }
    }
}
