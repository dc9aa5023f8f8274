//! Flights of `mavlink:ENDPOINT`: the lab is the vehicle, in lockstep, and somebody's own station flies it.
//!
//! The vehicle is that of `sitl`, so its percepts, radio and gusts are those of every other controller; its records
//! are those of `sitl --out`. A new flight is a vehicle whose time begins at zero again, on the same endpoint.
//! One endpoint has one vehicle: flights follow each other.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::links::Links;
use crpl_sitl::program::shell::{Ended, LINKS, Shell};
use crpl_sitl::program::terminal;
use crpl_sitl::sim::record::Record;
use crpl_sitl::vehicle::Vehicle;
use crpl_sitl::{Scenario, Sim};
use tokio::time::{sleep, timeout};

use crate::station::pilot::own::name::OwnController;
use crate::station::pilot::own::{OwnFlags, START};

/// The vehicle's system id.
const SYSTEM: u8 = 1;

/// How long the endpoint stays shut after a flight. A station that is ending still answers for a moment, and would fly
/// the first intervals of the next vehicle (our choice).
const PAUSE: Duration = Duration::from_secs(1);

/// A station of somebody's own, and the endpoint at which it finds its vehicle.
#[derive(Debug)]
pub struct MavlinkFlights {
    controller: OwnController,
    endpoint: Endpoint,
    scenario: Scenario,
    patience: Duration,
    /// Held during a flight.
    flying: Mutex<()>,
}

impl MavlinkFlights {
    /// Flights in `scenario`; nothing is opened yet.
    ///
    /// # Errors
    /// The controller's name holds no endpoint.
    pub fn new(controller: OwnController, flags: OwnFlags, scenario: &Scenario) -> Result<Self> {
        let endpoint: Endpoint =
            controller.rest().parse().map_err(anyhow::Error::msg).context(controller.name())?;
        let (scenario, patience) = (scenario.clone(), flags.patience());
        Ok(Self { controller, endpoint, scenario, patience, flying: Mutex::default() })
    }

    /// A whole flight.
    ///
    /// # Errors
    /// An endpoint that cannot be opened, a station that does not come or falls silent, a signal.
    pub fn records(&self, seed: u64) -> Result<Vec<Record>> {
        let _one = self.flying.lock().unwrap_or_else(PoisonError::into_inner);
        terminal::block_on(self.fly(seed))
            .with_context(|| format!("{}: flight of seed {seed}", self.controller.name()))
    }

    async fn fly(&self, seed: u64) -> Result<Vec<Record>> {
        let links = Links::open(std::slice::from_ref(&self.endpoint), LINKS).await?;
        let sim = Sim::new(self.scenario.clone(), seed);
        let mut vehicle = Vehicle::new(sim, SYSTEM, Some(self.scenario.horizon));
        vehicle.keep_records();
        let mut shell = Shell::over(links, vec![vehicle]);
        for line in shell.describe() {
            tracing::debug!("seed {seed}: {line}");
        }
        let (mut patience, mut flown) = (START.max(self.patience), 0);
        loop {
            match timeout(patience, shell.lockstep()).await {
                Ok(Ended::Over { .. }) => break,
                Ok(Ended::Interrupted) => bail!("interrupted"),
                Err(_) => {
                    let tick = shell.vehicle().sim().tick().0;
                    ensure!(tick > flown, "no setpoint for tick {tick} within {patience:?}");
                    (flown, patience) = (tick, self.patience);
                }
            }
        }
        shell.close().await;
        let records = shell.into_vehicles().iter_mut().flat_map(Vehicle::take_records).collect();
        sleep(PAUSE).await;
        Ok(records)
    }
}
