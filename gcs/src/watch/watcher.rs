//! One flight's observer: it copies what the station knows after each command has left, and a thread beside the
//! flight, or nobody until the flight is over, makes lines of it.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use crpl_sitl::Scenario;
use crpl_sitl::program::priority;
use crpl_sitl::radio::message::{Command, Percept, Telemetry};
use serde_json::Value;

use crate::station::Station;
use crate::watch::feed::{Feed, ShownFrame, ShownLimits, ShownVehicle, VERSION, WatchEvent, rounded};
use crate::watch::map::FieldPlace;
use crate::watch::narrator::{Narrator, SeenScene, StationSight};
use crate::watch::{Shown, document};

/// Scenes that wait to be told; of what comes beyond, pictures and beliefs are left out.
const WAITING: usize = 256;

/// Scenes that are kept until the flight is over; of more, every other one is forgotten.
const KEPT: usize = 256;

/// A narrator on a thread of its own: whoever tells it something waits for nothing.
#[derive(Debug)]
pub struct NarratorThread {
    sights: Sender<StationSight>,
    waiting: Arc<AtomicUsize>,
    thread: JoinHandle<Narrator>,
}

impl NarratorThread {
    /// Starts it.
    #[must_use]
    pub fn begin(mut narrator: Narrator) -> Self {
        let (sights, told) = channel::<StationSight>();
        let waiting = Arc::new(AtomicUsize::new(0));
        let left = waiting.clone();
        // Threads inherit their priority: the pool that the whole program shares begins here, not in the thread below.
        let _ = rayon::current_num_threads();
        let thread = std::thread::spawn(move || {
            priority::give_way();
            for sight in told {
                left.fetch_sub(1, Ordering::Relaxed);
                narrator.tell(sight);
            }
            narrator
        });
        Self { sights, waiting, thread }
    }

    /// Whether there is room for one more scene.
    #[must_use]
    pub fn keeps_up(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) < WAITING
    }

    /// Tells a sight.
    pub fn tell(&self, sight: StationSight) {
        self.waiting.fetch_add(1, Ordering::Relaxed);
        // A thread that is gone tells nothing more.
        let _ = self.sights.send(sight);
    }

    /// Waits until all is told; `None` if it has failed.
    #[must_use]
    pub fn end(self) -> Option<Narrator> {
        drop(self.sights);
        self.thread.join().ok()
    }
}

/// Where sights go.
#[derive(Debug)]
enum Telling {
    /// To a thread, while the flight is on.
    Beside(NarratorThread),
    /// Nowhere until it is over.
    After { sights: Vec<StationSight>, scenes: usize, stride: u64, narrator: Box<Narrator> },
}

/// Watches one flight.
#[derive(Debug)]
pub struct FlightWatcher {
    /// Of this flight alone, for its `flight.html`.
    own: Feed,
    /// Of the whole program, if anybody can watch it.
    live: Option<Feed>,
    telling: Telling,
    vehicle: u32,
    told: usize,
    buildings: Option<Value>,
}

/// The scenario's limits, as the page draws them.
fn limits(scenario: &Scenario) -> ShownLimits {
    ShownLimits {
        delta: scenario.safety.collision_tolerance,
        gamma_min_db: rounded(10.0 * scenario.channel.snr_min.log10(), 3),
        eta: scenario.safety.outage_tolerance,
        rate_min: scenario.radio.packet_bits,
    }
}

/// The first line of a flight in `scenario`.
#[must_use]
pub fn hello(scenario: &Scenario, shown: &Shown) -> WatchEvent {
    WatchEvent::Hello {
        version: VERSION,
        title: format!("{}: {}", shown.program, scenario.name),
        program: shown.program.clone(),
        revision: crate::revision().into(),
        seed: shown.seed,
        frame: ShownFrame::Square,
        scenario: serde_json::to_value(scenario).ok(),
        vehicles: shown.vehicles.clone(),
        limits: Some(limits(scenario)),
        ticks: Some(scenario.horizon),
        dt_s: scenario.scale.interval_s,
        control: shown.control,
    }
}

impl FlightWatcher {
    /// Watches the flight of the last vehicle of `shown`; `live` is where others watch.
    #[must_use]
    pub fn new(station: &Station, shown: &Shown, live: Option<Feed>) -> Self {
        let own = Feed::default();
        let vehicle: Vec<ShownVehicle> = shown.vehicles.last().cloned().into_iter().collect();
        let id = vehicle.first().map_or(1, |vehicle| vehicle.id);
        own.send(&hello(station.scenario(), &Shown { vehicles: vehicle, control: false, ..shown.clone() }));
        if let Some(live) = &live {
            live.send(&hello(station.scenario(), shown));
        }
        let feeds: Vec<Feed> = std::iter::once(own.clone()).chain(live.clone()).collect();
        let narrator = Narrator::new(feeds, id, station.scenario(), Some(station.world()));
        let telling = match &live {
            Some(_) => Telling::Beside(NarratorThread::begin(narrator)),
            None => Telling::After { sights: Vec::new(), scenes: 0, stride: 1, narrator: Box::new(narrator) },
        };
        Self { own, live, telling, vehicle: id, told: 0, buildings: shown.buildings.clone() }
    }

    /// The feeds that it tells.
    pub fn feeds(&self) -> impl Iterator<Item = &Feed> {
        std::iter::once(&self.own).chain(&self.live)
    }

    /// The command to `percept` has left.
    pub fn saw(&mut self, station: &Station, percept: &Percept, command: Command) {
        let wanted = match &self.telling {
            Telling::Beside(thread) => thread.keeps_up(),
            Telling::After { stride, .. } => percept.telemetry.tick.0.is_multiple_of(*stride),
        };
        let scene = wanted.then(|| SeenScene {
            frame: percept.frame.clone(),
            belief: Some(station.belief().clone()),
            foresight: station.pilot().foresight(),
        });
        self.add(station, percept.telemetry, Some(command), scene);
    }

    fn add(
        &mut self,
        station: &Station,
        telemetry: Telemetry,
        command: Option<Command>,
        scene: Option<SeenScene>,
    ) {
        let records = station.records().get(self.told..).unwrap_or_default().to_vec();
        self.told += records.len();
        let sight = StationSight { telemetry, command, records, scene };
        match &mut self.telling {
            Telling::Beside(thread) => thread.tell(sight),
            Telling::After { sights, scenes, stride, .. } => {
                *scenes += usize::from(sight.scene.is_some());
                sights.push(sight);
                if *scenes > KEPT {
                    *stride *= 2;
                    *scenes = 0;
                    for sight in sights.iter_mut() {
                        let keeps = sight.telemetry.tick.0.is_multiple_of(*stride);
                        sight.scene.take_if(|_| !keeps);
                        *scenes += usize::from(sight.scene.is_some());
                    }
                }
            }
        }
    }

    /// Where on Earth the field lies.
    pub fn locate(&self, place: FieldPlace) {
        let FieldPlace { origin, heading } = place;
        let event = WatchEvent::Geo { origin, heading, buildings: self.buildings.clone() };
        Feed::send_to(self.feeds(), &event);
    }

    /// Counters of the flight's link, by name.
    pub fn link(&self, tick: u64, counters: &Value) {
        let event = WatchEvent::Link { vehicle: self.vehicle, tick, counters: counters.clone() };
        Feed::send_to(self.feeds(), &event);
    }

    /// The flight is over: tells what is left and gives the flight as one page. `last` is its last report, `summary`
    /// its metrics by name.
    #[must_use]
    pub fn finish(
        mut self,
        station: &Station,
        last: Option<&Telemetry>,
        reason: &str,
        summary: Value,
    ) -> String {
        if let Some(last) = last {
            self.add(station, *last, None, None);
        }
        let narrator = match self.telling {
            Telling::Beside(thread) => thread.end(),
            Telling::After { sights, mut narrator, .. } => {
                sights.into_iter().for_each(|sight| narrator.tell(sight));
                Some(*narrator)
            }
        };
        if let Some(mut narrator) = narrator {
            narrator.finish();
        }
        let end = WatchEvent::End { reason: reason.into(), summary };
        self.own.send(&end);
        document::flight(&self.own.all())
    }
}
