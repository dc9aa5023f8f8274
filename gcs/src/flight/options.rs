//! How to fly: what a flight over a link is told before it begins.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use crpl_sitl::link::endpoint::Endpoint;

use crate::tools::bridge::hub::{Hub, LinkSide};
use crate::tools::bridge::router::rules::LinkRules;
use crate::tools::identity::Identity;
use crate::tools::session::{LinkFlags, Session};
use crate::watch::control::RequestQueue;

/// How to fly.
#[derive(Debug, Clone)]
pub struct Options {
    /// The flight ends with the percept of this tick; `None` flies until a signal comes.
    pub ticks: Option<u64>,
    /// The vehicle's system id; `None`: the only one on the link.
    pub system: Option<u8>,
    /// File with the key of message signing.
    pub signing_key: Option<PathBuf>,
    /// Endpoints that watch the flight and may talk to the vehicle through this program.
    pub forward: Vec<Endpoint>,
    /// How long to wait for the vehicle, for the first percept, and for any next one.
    pub timeout: Duration,
    /// Who flies.
    pub identity: Identity,
    /// What a page asks of the vehicle, if it may.
    pub steering: Option<RequestQueue>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ticks: None,
            system: None,
            signing_key: None,
            forward: Vec::new(),
            timeout: Duration::from_secs(30),
            identity: Identity::default(),
            steering: None,
        }
    }
}

impl Options {
    /// Opens the link to the vehicle and those to who else is there.
    ///
    /// # Errors
    /// An endpoint that cannot be opened, a key file that cannot be read.
    pub async fn open(&self, connect: &Endpoint) -> Result<Hub> {
        let mut hub = Hub::default();
        hub.local();
        hub.log_ahead();
        let shown = hub.open(connect).await?;
        tracing::debug!("{shown}");
        self.forward(&mut hub).await?;
        if let Some(path) = &self.signing_key {
            hub.sign_with(path)?;
        }
        Ok(hub)
    }

    /// Opens the link and waits for the vehicle; its tools come later.
    ///
    /// # Errors
    /// As [`Session::open`]: no vehicle, or several of which none was chosen.
    pub async fn find(&self, connect: &Endpoint) -> Result<Session> {
        let flags = LinkFlags {
            sysid: self.system,
            signing_key: self.signing_key.clone(),
            timeout: self.timeout.as_secs().max(1),
            identity: self.identity,
            ..LinkFlags::to(connect.clone())
        };
        Session::open(&flags).await
    }

    pub(super) async fn forward(&self, hub: &mut Hub) -> Result<()> {
        for endpoint in &self.forward {
            // Whoever looks on takes gaps for losses, and what has a target goes past it.
            let rules = LinkRules { renumber: true, ..LinkRules::default() };
            let shown = hub.open_on(endpoint, rules, LinkSide::Tools).await?;
            tracing::info!("forward: {shown}");
        }
        Ok(())
    }
}
