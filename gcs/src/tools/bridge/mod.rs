//! `gcs bridge`: a MAVLink router, so that any number of tools share one vehicle.
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`router`] | which frame goes where; copies, losses, round trips | sockets, clocks |
//! | [`hub`] | the router on [`links`](crpl_sitl::link::links), in bursts | messages, sockets |
//! | [`signer`] | message signing | sockets |
//! | [`counters`] | what is counted, as a table and for Prometheus | sockets |
//! | [`metrics`] | `GET /metrics` | what it serves |
//! | [`spec`] | an endpoint with rules, as it is typed | sockets |

#![expect(clippy::disallowed_methods, reason = "a shell: it has the timers")]

pub mod counters;
pub mod hub;
pub mod metrics;
pub mod router;
pub mod signer;
pub mod spec;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use crpl_sitl::link::dialect::{HEARTBEAT_DATA, MavAutopilot, MavState, MavType};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::{BRIDGE, STATION_SYSTEM};
use crpl_sitl::program::columns;
use crpl_sitl::program::terminal::{interrupted, say, seconds};
use tokio::time::{Instant, interval_at};

use crate::tools::spotter::Spotter;
use crate::tools::steering::PageSteering;
use crate::watch::SteerFlags;
use crate::watch::control::{RequestQueue, VehicleRequest};
use crate::watch::map::MapFlags;
use hub::{Hub, LinkSide};
use router::{COPY_WITHIN, Notice};
use spec::EndpointSpec;

/// Flags of `gcs bridge`.
#[derive(Debug, Clone, clap::Args)]
pub struct Bridge {
    /// Endpoint of the vehicle: udpout:HOST:PORT, udpin, udpbcast, tcpout, tcpin or serial:DEVICE:BAUD;
    /// repeatable. Rules may follow, as in ENDPOINT?group=NAME&rate=BYTES&only=MESSAGES: drop,
    /// only-from and drop-from, too
    #[arg(long, value_name = "ENDPOINT", required = true)]
    connect: Vec<EndpointSpec>,
    /// Endpoints of the tools that share the vehicle, with rules if wanted; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1.., required = true)]
    forward: Vec<EndpointSpec>,
    /// For how long the same bytes of one sender are copies, which are dropped; 0 forwards them all
    #[arg(long, value_name = "SECONDS", default_value_t = COPY_WITHIN.as_secs_f64(), value_parser = seconds)]
    copies: f64,
    /// Sign all messages to the vehicle, and accept only signed ones from it, with the key in this file: TOML
    /// with `key` (64 hexadecimal digits) or `passphrase`. The tools need no key
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Serve the counters to Prometheus at http://ADDR/metrics
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
    /// Log all packets to a tlog
    #[arg(long, value_name = "FILE")]
    tlog: Option<PathBuf>,
    #[command(flatten)]
    watch: SteerFlags,
    #[command(flatten)]
    map: MapFlags,
    /// Print the counters every SECONDS; 0: only at the end
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    every: u64,
}

/// How often the log and the timestamps of signatures are written.
const SAVE: Duration = Duration::from_secs(1);

/// Prints a table of the links.
fn show(table: &str) {
    say(&columns::folded(table, &counters::COLUMNS, columns::width()));
}

/// Routes until Ctrl-C, then prints the counters.
///
/// # Errors
/// An endpoint, file or key that cannot be opened.
pub async fn run(args: Bridge) -> Result<()> {
    let mut hub = Hub::default();
    hub.copies_within(Duration::from_secs_f64(args.copies));
    if let Some(path) = &args.signing_key {
        hub.sign_vehicle_side(path)?;
    }
    let sides = [("vehicle", LinkSide::Vehicle, &args.connect), ("forward", LinkSide::Tools, &args.forward)];
    for (role, side, endpoints) in sides {
        for EndpointSpec { endpoint, rules } in endpoints {
            say(&format!("{role}: {}", hub.open_on(endpoint, rules.clone(), side).await?));
        }
    }
    if let Some(path) = &args.tlog {
        hub.log_to(path)?;
    }
    let mut scrapes = None;
    if let Some(address) = args.metrics {
        let (address, requests) = metrics::listen(address).await?;
        say(&format!("metrics: http://{address}/metrics"));
        scrapes = Some(requests);
    }
    let buildings = args.map.load()?;
    let (page, requests) = args.watch.open()?;
    let mut watched = page.as_ref().map(|page| {
        // A link of its own hears what all hear.
        hub.local();
        Watched {
            spotter: Spotter::new(page.feed().clone(), "gcs bridge", requests.is_some(), buildings),
            steering: PageSteering::new(requests.as_ref().and_then(RequestQueue::take)),
        }
    });
    route(&mut hub, scrapes, Duration::from_secs(args.every), &mut watched).await?;
    hub.close().await;
    show(&counters::table(&hub.rows(), &[], hub.elapsed()));
    if let Some(mut page) = page {
        page.hurry();
        page.close("interrupted", counters::by_name(&hub.rows())).await;
    }
    Ok(())
}

/// A word for those who speak only when they are spoken to: no ground station's, which would keep a
/// vehicle's failsafe quiet when the real station is lost.
fn push_hello(bridge: &mut Encoder, datagram: &mut Vec<u8>) {
    let message = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
        ..Default::default()
    };
    bridge.push(datagram, &message);
}

/// A page that shows the vehicles, and may ask something of them.
struct Watched {
    spotter: Spotter,
    steering: PageSteering,
}

impl Watched {
    /// Passes a page's request on to a vehicle that was heard.
    fn ask(&mut self, asked: VehicleRequest, now: Duration) {
        let system = u8::try_from(asked.vehicle).unwrap_or_default();
        match self.spotter.autopilot(system) {
            Some((stack, component)) => self.steering.ask(asked, stack, (system, component), now),
            None => {
                let answer = Err(format!("vehicle {} was not heard", asked.vehicle));
                // A page that has gone away wants no answer.
                let _ = asked.answer.send(answer);
            }
        }
    }

    /// Takes in what the hub has heard; what is to be sent by now.
    fn turn(&mut self, hub: &mut Hub, bridge: &mut Encoder) -> Vec<u8> {
        let now = hub.elapsed();
        while let Some(datagram) = hub.take() {
            self.spotter.datagram(&datagram, now);
            self.steering.datagram(&datagram, now);
        }
        self.steering.poll(now, bridge)
    }
}

/// The next request of a page, if there is one that may steer.
async fn asked(watched: &mut Option<Watched>) -> VehicleRequest {
    match watched {
        Some(watched) => watched.steering.next().await,
        None => std::future::pending().await,
    }
}

async fn route(
    hub: &mut Hub,
    mut scrapes: Option<tokio::sync::mpsc::Receiver<metrics::Scrape>>,
    period: Duration,
    watched: &mut Option<Watched>,
) -> Result<()> {
    let mut tick = interval_at(Instant::now(), SAVE);
    let mut bridge = Encoder::new(STATION_SYSTEM, BRIDGE);
    let mut printed = Instant::now();
    let mut before = Vec::new();
    let mut interrupted = std::pin::pin!(interrupted());
    loop {
        tokio::select! {
            () = hub.turn() => {}
            _ = tick.tick() => {
                hub.save();
                let mut hello = Vec::new();
                push_hello(&mut bridge, &mut hello);
                hub.hello(&hello).await;
                if let Some(watched) = watched {
                    watched.spotter.counters(&counters::by_name(&hub.rows()), hub.elapsed());
                }
                let since = printed.elapsed();
                if !period.is_zero() && since >= period {
                    printed = Instant::now();
                    show(&counters::table(&hub.rows(), &before, since));
                    before = hub.rows().iter().map(|r| (r.counters.received(), r.counters.sent_frames)).collect();
                }
            }
            Some(reply) = next(&mut scrapes) => {
                // A client that has gone away wants no answer.
                let _ = reply.send(counters::prometheus(&hub.rows(), hub.forward(), hub.elapsed()));
            }
            request = asked(watched) => {
                if let Some(watched) = watched {
                    watched.ask(request, hub.elapsed());
                }
            }
            _ = &mut interrupted => return Ok(()),
        }
        for notice in hub.notices() {
            tell(&notice, hub);
        }
        if let Some(watched) = watched {
            let datagram = watched.turn(hub, &mut bridge);
            if !datagram.is_empty() {
                hub.send(&datagram).await;
            }
        }
    }
}

async fn next(scrapes: &mut Option<tokio::sync::mpsc::Receiver<metrics::Scrape>>) -> Option<metrics::Scrape> {
    match scrapes {
        Some(scrapes) => scrapes.recv().await,
        None => std::future::pending().await,
    }
}

/// Logs who has appeared where.
pub fn tell(notice: &Notice, hub: &Hub) {
    match notice {
        Notice::Found(link, system, component) => {
            tracing::info!("{}: system {system} component {component}", hub.router().name(*link));
        }
        Notice::SetpointSuppressed(link) => {
            tracing::warn!(
                "{}: setpoints not forwarded: this flight controls the vehicle",
                hub.router().name(*link)
            );
        }
        Notice::ModeChange(link) => {
            tracing::warn!("{}: the operator has changed the mode", hub.router().name(*link));
        }
    }
}
