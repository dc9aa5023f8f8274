//! A page in the browser that shows what a program does: a feed of lines, the page that draws them, its server, and
//! the page as one file with the lines inside.
//!
//! ```text
//! program --> Feed --> server --> page
//!                \--> document (flight.html)
//! ```
//!
//! Shared by the programs: flights and sweeps of `gcs`, trainings of `model`. Nobody who writes lines waits for who
//! reads them. docs/watch.md lists the lines.

pub mod control;
pub mod document;
pub mod feed;
mod server;

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;

use anyhow::Result;
use serde_json::Value;

use super::terminal::Signals;
use control::{PageControl, RequestQueue};
use feed::{Feed, WatchEvent};
use server::WatchServer;

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
