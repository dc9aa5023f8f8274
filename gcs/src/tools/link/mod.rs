//! `gcs link`: a radio between any MAVLink vehicle and any tools, that is slow and lossy as its geometry says.
//!
//! ```text
//! vehicle <--> [vehicle's end | radio | station's end] <--> tools
//! ```
//!
//! Every frame of the vehicle's side goes down, every frame of a tool goes up, byte for byte, by the radio's rules
//! ([`crpl_sitl::radio::air`]). The radio learns where the vehicle is from what it tells, and nobody else changes
//! anything. Tools do not hear each other through it.
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`carrier`] | bytes in, through the radio, datagrams out | sockets, clocks |
//! | [`place`] | where the vehicle is | radios |
//! | [`ledger`] | one row a frame, as Parquet | sockets |
//! | [`summary`] | tables, words and Prometheus | sockets |
//! | [`show`] | the vehicle and the link on a page | sockets, clocks |
//! | [`exchange`] | how long parameters and missions took | sockets |

#![expect(clippy::disallowed_methods, reason = "a shell: it has sockets and timers")]

pub mod carrier;
pub mod exchange;
pub mod ledger;
pub mod place;
pub mod show;
pub mod summary;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufWriter;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use crpl_sitl::link::PeerId;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::links::{Arrival, BUFFER, Backlog, LinkOptions, Links, UdpPeers};
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::splitter::Splitter;
use crpl_sitl::program::columns;
use crpl_sitl::program::terminal::{interrupted, say, seconds};
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::radio::air::config::file::table;
use crpl_sitl::radio::air::track::GeometryTrack;
use crpl_sitl::radio::air::{Air, AirRadio, Way};
use tokio::time::{Instant, interval, sleep_until};

use crate::tools::bridge::metrics;
use crate::tools::replay;
use crate::watch::WatchFlags;
use crate::watch::map::MapFlags;
use carrier::{Carrier, LinkClock, Tells};
use ledger::FrameLedger;
use place::{Base, Whereabouts};
use show::LinkShow;

/// Flags of `gcs link`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = table())]
pub struct RadioLink {
    /// Endpoint of the vehicle: udpout:HOST:PORT, or udpin, tcpout, tcpin
    #[arg(long, value_name = "ENDPOINT", required_unless_present = "traffic", conflicts_with = "traffic")]
    vehicle: Option<Endpoint>,
    /// Endpoints of the tools; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1.., required_unless_present = "traffic", conflicts_with = "traffic")]
    ground: Vec<Endpoint>,
    /// The radio: TOML file or preset
    #[arg(long, value_name = "FILE|NAME")]
    radio: String,
    /// Seed of fading, shadowing and losses
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Number of this link: links of one seed have losses of their own
    #[arg(long, value_name = "N", default_value_t = 0)]
    number: u64,
    /// Where the station stands: N,E,D in the vehicle's local frame, m, or geo:LAT,LON,ALT [default: the radio
    /// file's `ground.place`, else the local frame's origin]
    #[arg(long, value_name = "N,E,D|geo:LAT,LON,ALT", allow_hyphen_values = true)]
    base: Option<Base>,
    /// System whose place counts [default: the first that tells one]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    sysid: Option<u8>,
    /// Take the vehicle's place from this CSV of time,x,y,z (s, and m north, east, down) and not from what it tells
    #[arg(long, value_name = "GEOMETRY")]
    replay: Option<PathBuf>,
    /// Write the vehicle's place to a CSV for --replay
    #[arg(long, value_name = "GEOMETRY")]
    record: Option<PathBuf>,
    /// Carry the frames of a tlog, at their times, in place of sockets' ones
    #[arg(long, value_name = "TLOG")]
    traffic: Option<PathBuf>,
    /// What makes time pass for the radio
    #[arg(long, value_enum, default_value = "wall")]
    clock: LinkClock,
    /// Write what became of each frame to a Parquet file
    #[arg(long, value_name = "FILE")]
    ledger: Option<PathBuf>,
    /// Print a row for each kind of message at the end
    #[arg(long)]
    summary: bool,
    /// Tell commands that arrive later than this
    #[arg(long, value_name = "SECONDS", default_value = "0.5", value_parser = seconds)]
    late: f64,
    /// Send neither RADIO_STATUS nor SNR_DB
    #[arg(long)]
    quiet: bool,
    /// Send LINK_NODE_STATUS, which pymavlink does not know and counts as lost
    #[arg(long)]
    node_status: bool,
    /// Serve the counters to Prometheus at http://ADDR/metrics
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
    #[command(flatten)]
    watch: WatchFlags,
    #[command(flatten)]
    map: MapFlags,
}

/// Datagrams and parts of streams that are read before what they bring is sent.
const BURST: usize = 128;
/// As a router's: a tool that does not read misses what it cannot take.
pub(crate) const LINKS: LinkOptions = LinkOptions {
    backlog: Backlog::Drop(1 << 20),
    connects_later: true,
    max_streams: 512,
    udp_peers: Some(UdpPeers { most: 64, silence: Duration::from_secs(60) }),
};

/// Until it has told its place, a vehicle is taken to be so far north of the station, m: then it can be asked for it.
const BESIDE_M: f64 = 10.0;

/// How often who watches is told what was carried.
const COUNTED: Duration = Duration::from_secs(1);

/// The vehicle's endpoint is the first.
const VEHICLE: usize = 0;

/// Carries frames until Ctrl-C, or to the end of a tlog; then prints what became of them.
///
/// # Errors
/// A radio, file or endpoint that cannot be opened.
pub async fn run(args: RadioLink) -> Result<()> {
    let (carrier, station) = open(&args)?;
    let notes = [("radio", args.radio.as_str()), ("seed", &args.seed.to_string())];
    let ledger = args.ledger.as_deref().map(|path| FrameLedger::create(path, &notes)).transpose()?;
    let links = Links::new(LINKS);
    let buildings = args.map.load()?;
    let page = args.watch.open()?;
    let show = page.as_ref().map(|page| LinkShow::new(page.feed(), station, buildings));
    let mut shell = LinkShell { carrier, ledger, ledger_error: None, links, peers: BTreeMap::new(), show };
    match &args.traffic {
        Some(path) => shell.carry_log(path)?,
        None => shell.serve(&args).await?,
    }
    let summary = shell.carrier.summary().by_name();
    let ended = shell.end(&args).await;
    if let Some(mut page) = page {
        page.hurry();
        page.close("over", summary).await;
    }
    ended
}

/// The radio of the flags, and north and east of its station, m.
fn open(args: &RadioLink) -> Result<(Carrier, [f64; 2])> {
    let radio = AirRadio::named(&args.radio)?;
    let mut air = Air::new(radio, args.seed, args.number)?;
    if let Some(base) = args.base {
        air.set_base(base.place());
    }
    let replay = args
        .replay
        .as_deref()
        .map(|path| GeometryTrack::load(path).with_context(|| format!("reading {}", path.display())));
    let [north, east] = air.radio().ground.place;
    let station = args.base.map_or([north, east], |base| [base.place()[0], base.place()[1]]);
    let start = [north + BESIDE_M, east, -args.base.map_or(0.0, |base| base.place()[2])];
    let whereabouts = Whereabouts::new(args.base, args.sysid, start, replay.transpose()?);
    // A log has its own radio's reports in it.
    let tells = Tells {
        status: !args.quiet && args.traffic.is_none(),
        node: args.node_status && args.traffic.is_none(),
    };
    let late = Duration::from_secs_f64(args.late);
    Ok((Carrier::new(air, whereabouts, args.clock, tells, late), station))
}

/// Who stands at the other end of a socket.
#[derive(Debug)]
struct LinkPeer {
    splitter: Splitter,
}

/// The carrier on sockets.
#[derive(Debug)]
struct LinkShell {
    carrier: Carrier,
    ledger: Option<FrameLedger<BufWriter<File>>>,
    /// Why the ledger ends early, such as a full disk, which stops no frame.
    ledger_error: Option<anyhow::Error>,
    links: Links,
    peers: BTreeMap<PeerId, LinkPeer>,
    /// Tells who watches, if anybody can.
    show: Option<LinkShow>,
}

impl LinkShell {
    async fn serve(&mut self, args: &RadioLink) -> Result<()> {
        for (role, endpoint) in
            args.vehicle.iter().map(|e| ("vehicle", e)).chain(args.ground.iter().map(|e| ("ground", e)))
        {
            let index = self.links.add(endpoint).await?;
            say(&format!("{role}: {}", self.links.describe().swap_remove(index)));
        }
        for peer in self.links.fixed() {
            self.meet(peer);
        }
        let mut scrapes = None;
        if let Some(address) = args.metrics {
            let (address, requests) = metrics::listen(address).await?;
            say(&format!("metrics: http://{address}/metrics"));
            scrapes = Some(requests);
        }
        let (start, cost) = (Instant::now(), Stopwatch::default());
        let mut buffer = vec![0; BUFFER];
        let mut interrupted = std::pin::pin!(interrupted());
        let mut second = interval(COUNTED);
        loop {
            let next = self.carrier.next_event().map(|after| start + after);
            tokio::select! {
                first = self.links.receive(&mut buffer) => self.burst(first, &mut buffer, start),
                () = until(next) => self.carrier.advance(start.elapsed()),
                _ = second.tick(), if self.show.is_some() => {
                    if let Some(show) = &mut self.show {
                        show.count(&self.carrier);
                    }
                }
                Some(reply) = scrape(&mut scrapes) => {
                    let reports = self.carrier.reports();
                    // A client that has gone away wants no answer.
                    let _ = reply.send(self.carrier.summary().prometheus(reports));
                }
                _ = &mut interrupted => {
                    let (wall, cpu) = cost.seconds();
                    say(&format!("{wall:.1} s, CPU {cpu:.2} s"));
                    return Ok(());
                }
            }
            self.flush().await;
            self.note();
        }
    }

    fn burst(&mut self, first: Arrival, buffer: &mut [u8], start: Instant) {
        self.take(first, buffer, start);
        for _ in 1..BURST {
            let Some(next) = self.links.try_receive(buffer) else { break };
            self.take(next, buffer, start);
        }
    }

    fn take(&mut self, arrival: Arrival, buffer: &[u8], start: Instant) {
        match arrival {
            Arrival::Bytes(from, length) => {
                // Whom we speak to may answer from another of its addresses: it is one peer.
                let known = self.links.fixed_at(from.endpoint).unwrap_or(from);
                let peer =
                    self.peers.entry(known).or_insert_with(|| LinkPeer { splitter: Splitter::default() });
                let way = if from.endpoint == VEHICLE { Way::Down } else { Way::Up };
                self.carrier.receive(way, &mut peer.splitter, &buffer[..length], start.elapsed());
            }
            Arrival::Connected(peer) => self.meet(peer),
            Arrival::Closed(peer) => {
                self.peers.remove(&peer);
            }
        }
    }

    fn meet(&mut self, peer: PeerId) {
        self.peers.insert(peer, LinkPeer { splitter: Splitter::default() });
    }

    /// Sends what has arrived to everybody on its side.
    async fn flush(&mut self) {
        let Self { carrier, links, peers, show, .. } = self;
        let now = carrier.now();
        carrier.flush(|way, datagram| {
            if let Some(show) = show.as_mut().filter(|_| way == Way::Down) {
                show.arrived(datagram, now);
            }
            for peer in peers.keys().filter(|peer| (peer.endpoint == VEHICLE) == (way == Way::Up)) {
                if let Err(error) = links.send(*peer, datagram) {
                    tracing::debug!(%peer, "sending: {error}");
                }
            }
        });
        for (peer, bytes) in links.flush().await {
            tracing::debug!(%peer, "{} bytes were not sent", bytes.len());
        }
    }

    /// Writes and tells what is settled.
    fn note(&mut self) {
        let now = self.carrier.now();
        for line in self.carrier.words() {
            say(&line);
            if let Some(show) = &self.show {
                show.log(&line, now);
            }
        }
        let mut settled = self.carrier.settled();
        let Some(ledger) = &mut self.ledger else { return };
        if let Err(error) = settled.try_for_each(|frame| ledger.push(&frame)) {
            tracing::error!("the ledger ends here: {error:#}; frames are carried all the same");
            self.ledger_error = Some(error);
            drop(settled);
            self.ledger = None;
        }
    }

    /// Lets arrive what has come through; nobody but the page is there.
    fn flush_to_page(&mut self) {
        let Self { carrier, show, .. } = self;
        let now = carrier.now();
        carrier.flush(|way, datagram| {
            if let Some(show) = show.as_mut().filter(|_| way == Way::Down) {
                show.arrived(datagram, now);
            }
        });
    }

    /// Carries the frames of a log, as fast as it goes.
    fn carry_log(&mut self, path: &Path) -> Result<()> {
        let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
        let script = replay::from_tlog(&bytes, true).with_context(|| path.display().to_string())?;
        let vehicles = vehicles(&script);
        let mut splitters = [Splitter::default(), Splitter::default()];
        for (time, frame) in &script {
            // The system is the sender's.
            let mut system = 0;
            Splitter::default().split(frame, |frame| system = frame.system);
            let way = if vehicles.contains(&system) { Way::Down } else { Way::Up };
            self.carrier.receive(way, &mut splitters[way as usize], frame, *time);
            self.flush_to_page();
            self.note();
        }
        self.carrier.run_down();
        self.flush_to_page();
        self.note();
        Ok(())
    }

    async fn end(mut self, args: &RadioLink) -> Result<()> {
        self.links.close().await;
        self.note();
        if let Some(path) = &args.record {
            let csv = self.carrier.whereabouts().track().to_csv();
            std::fs::write(path, csv).with_context(|| format!("writing {}", path.display()))?;
        }
        let table = self.carrier.summary().table(args.summary, self.carrier.now());
        say(&columns::folded(&table, &summary::COLUMNS, columns::width()));
        let closed = self.ledger.take().map_or(Ok(()), FrameLedger::close);
        self.ledger_error.map_or(closed, Err).context("writing the ledger")
    }
}

/// The systems that have said that they are vehicles: a heartbeat with an autopilot.
fn vehicles(script: &replay::Script) -> BTreeSet<u8> {
    const NO_AUTOPILOT: u8 = 8;
    let mut vehicles = BTreeSet::new();
    for (_, frame) in script {
        Splitter::default().split(frame, |frame| {
            if Heartbeat::of(frame).is_some_and(|beat| beat.autopilot != NO_AUTOPILOT) {
                vehicles.insert(frame.system);
            }
        });
    }
    vehicles
}

async fn until(time: Option<Instant>) {
    match time {
        Some(time) => sleep_until(time).await,
        None => std::future::pending().await,
    }
}

async fn scrape(
    scrapes: &mut Option<tokio::sync::mpsc::Receiver<metrics::Scrape>>,
) -> Option<metrics::Scrape> {
    match scrapes {
        Some(scrapes) => scrapes.recv().await,
        None => std::future::pending().await,
    }
}
