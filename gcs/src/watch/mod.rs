//! Flights to look at: a feed of lines, the page that draws them, its server, and `flight.html`.
//!
//! ```text
//! Station --copy after each command--> FlightWatcher --> Narrator --> Feed --> server --> page
//!                                                                       \--> flight.html
//! ```
//!
//! An observer: no flight waits for it, and none changes by it. Knows the station; neither links nor run folders.
//! docs/watch.md lists the lines.

pub mod control;
pub mod document;
pub mod feed;
mod narrator;
mod server;
pub mod watcher;

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;

use anyhow::Result;
use crpl_sitl::program::terminal::Signals;
use serde_json::Value;

use crate::station::pilot::Controller;
use crate::watch::control::{PageControl, RequestQueue};
use crate::watch::feed::{Feed, ShownVehicle, WatchEvent};
use crate::watch::server::WatchServer;

/// A free port of this machine.
const ANYWHERE: &str = "127.0.0.1:0";

/// Flags of a page that shows what a program does.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct WatchFlags {
    /// Show it on a page, at this address or on a free port of this machine
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = ANYWHERE, value_parser = address)]
    pub watch: Option<SocketAddr>,
    /// Serve the page on after the end, until Ctrl-C [default: where stderr is a terminal]
    #[arg(long, requires = "watch")]
    pub watch_stay: bool,
}

/// The same flags of a page that may steer.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct SteerFlags {
    #[command(flatten)]
    watch: WatchFlags,
    /// Let the page hold, return, land and give back the vehicle; its printed address holds the token for that
    #[arg(long, requires = "watch")]
    pub control: bool,
}

impl SteerFlags {
    /// Serves the page, if it is wanted, and says where; what it asks of vehicles arrives at what is given beside it.
    ///
    /// # Errors
    /// As [`WatchFlags::open`].
    pub fn open(&self) -> Result<(Option<WatchPage>, Option<RequestQueue>)> {
        if !self.control {
            return Ok((self.watch.open()?, None));
        }
        let (control, requests) = PageControl::open()?;
        Ok((self.watch.serve(Some(control))?, Some(requests)))
    }
}

/// `IP:PORT`, or a port of this machine alone.
fn address(text: &str) -> Result<SocketAddr, String> {
    let port = |text: &str| Some(SocketAddr::from(([127, 0, 0, 1], text.parse().ok()?)));
    let address = text.parse().ok().or_else(|| port(text));
    address.ok_or_else(|| "must be an address as 127.0.0.1:8080, or a port".into())
}

/// What a feed's first line says.
#[derive(Debug, Clone, Default)]
pub struct Shown {
    /// The command, such as `gcs fly`.
    pub program: String,
    /// Seed of the gusts, if it is known.
    pub seed: Option<u64>,
    /// Whether the page may steer.
    pub control: bool,
    /// Those who have flown, and who flies.
    pub vehicles: Vec<ShownVehicle>,
}

impl Shown {
    /// One vehicle, flown by `controller`.
    #[must_use]
    pub fn one(program: &str, controller: Controller) -> Self {
        let mut shown = Self { program: program.into(), ..Self::default() };
        shown.add(controller);
        shown
    }

    /// One more vehicle, flown by `controller`.
    pub fn add(&mut self, controller: Controller) {
        let id = self.vehicles.len() as u32 + 1;
        let name = controller.to_string();
        self.vehicles.push(ShownVehicle { id, controller: Some(name.clone()), name });
    }
}

/// A page that is served.
#[derive(Debug)]
pub struct WatchPage {
    feed: Feed,
    server: WatchServer,
    stays: bool,
}

impl WatchFlags {
    /// Serves the page, if it is wanted, and says where.
    ///
    /// # Errors
    /// The address is taken, or none of this machine's.
    pub fn open(&self) -> Result<Option<WatchPage>> {
        self.serve(None)
    }

    fn serve(&self, control: Option<PageControl>) -> Result<Option<WatchPage>> {
        let Some(address) = self.watch else { return Ok(None) };
        let feed = Feed::default();
        let token = control.as_ref().map(|control| format!("/#token={}", control.token()));
        let server = WatchServer::start(address, feed.clone(), control)?;
        let stderr = std::io::stderr();
        let stays = self.watch_stay || stderr.is_terminal();
        // Whoever has closed stderr wants to know nothing.
        let _ = writeln!(stderr.lock(), "watch: http://{}{}", server.address(), token.unwrap_or_default());
        Ok(Some(WatchPage { feed, server, stays }))
    }
}

impl WatchPage {
    /// Where lines go.
    #[must_use]
    pub fn feed(&self) -> &Feed {
        &self.feed
    }

    /// The page need not stay: whoever watches has asked for the end.
    pub fn hurry(&mut self) {
        self.stays = false;
    }

    /// The last line, and the end of the server: at once, or when Ctrl-C says so.
    pub async fn close(mut self, reason: &str, summary: Value) {
        self.feed.send(&WatchEvent::End { reason: reason.into(), summary });
        self.leave().await;
    }

    /// The end of the server, without a last line.
    pub async fn leave(&mut self) {
        if self.stays {
            // One that comes at once must not be lost.
            let signals = Signals::listen();
            let _ = writeln!(std::io::stderr().lock(), "watch: the page stays until Ctrl-C");
            if let Ok(mut signals) = signals {
                signals.next().await;
            }
        }
        self.server.stop();
    }
}
