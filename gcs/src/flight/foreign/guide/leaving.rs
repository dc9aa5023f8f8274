//! Who has ended the flight on a foreign vehicle: an operator, the vehicle itself by a failsafe, a crash, a restart.

use std::time::Duration;

use crpl_sitl::link::messages::service::Timesync;

use super::{Guide, GuideEvent, GuidePhase, PATIENCE, RESTART};
use crate::flight::FlightEnd;
use crate::tools::texts::SaidText;

/// How long a vehicle that has left its mode is listened to: its texts may come behind its heartbeat.
pub(super) const REASONS: Duration = Duration::from_millis(1500);
/// How old a text or a state may be that tells why a mode was left.
const COUNTS: Duration = Duration::from_secs(5);
/// The round trips that are kept.
const TRIPS: usize = 3;
/// Above its ground, m, a vehicle is in the air.
const IN_THE_AIR_M: f32 = 1.5;
/// MAV_STATE_CRITICAL; above it are emergency, power-off and termination.
const CRITICAL: u8 = 5;
/// In texts of a vehicle that acts by itself, of ArduCopter and PX4.
const FAILSAFES: [&str; 23] = [
    "failsafe",
    "fail safe",
    "fence",
    "battery",
    "glitch",
    "ekf",
    "gps",
    "radio",
    "rc lost",
    "rc signal",
    "manual control",
    "link lost",
    "link loss",
    "connection lost",
    "ground control station lost",
    "position lost",
    "position estimate",
    "no valid position",
    "terrain",
    "vibration",
    "thrust loss",
    "dead reckon",
    "failure",
];
/// In texts of one whose motors stop.
const CRASHES: [&str; 4] = ["crash", "disarming", "terminat", "parachute"];

/// What tells by whom a mode was left, and why a vehicle does not answer.
#[derive(Debug, Default)]
pub(super) struct LeavingEvidence {
    /// Why it has left its mode, by its heartbeat.
    left: String,
    /// Its motors stopped in the air: how high, m.
    fallen_from: Option<f32>,
    /// Since when its heartbeats say that it is in distress.
    critical: Option<Duration>,
    /// The newest of its own time by TIMESYNC, ns since it booted.
    clock: Option<i64>,
    /// It has started anew.
    pub rebooted: bool,
    /// Its packets have signatures.
    pub signed: bool,
    /// Packets whose signatures do not fit the key; `None`: there is no key.
    pub refused: Option<u64>,
}

impl Guide {
    /// So many packets were refused, because their signatures do not fit the key; `None`: there is no key.
    pub fn signatures(&mut self, refused: Option<u64>) {
        self.evidence.refused = refused;
    }

    /// What signatures have to do with it that nothing is heard or nothing is answered.
    pub(super) fn signature_hint(&self) -> String {
        match self.evidence.refused {
            Some(refused @ 1..) => {
                format!("; {refused} packets have come whose signatures do not fit the key (--signing-key)")
            }
            None if self.evidence.signed => {
                "; its packets are signed: it may want signatures (--signing-key)".into()
            }
            _ => String::new(),
        }
    }

    /// The vehicle has said something.
    pub(super) fn heard_text(&mut self, said: SaidText, now: Duration) {
        self.say(format!("vehicle: {}", said.text));
        if said.is_warning() {
            (self.complaint, self.complained) = (said.text, now);
        }
    }

    /// A TIMESYNC has come back: with our own stamp, ns, and the vehicle's time.
    pub(super) fn measured(&mut self, sync: &Timesync, now: Duration) {
        let back = sync.tc1.saturating_add(RESTART.as_nanos() as i64);
        let before = self.evidence.clock.replace(sync.tc1);
        let flies = self.has_control() || matches!(self.phase, GuidePhase::Left | GuidePhase::Braking);
        if flies && before.is_some_and(|before| back < before) {
            self.evidence.rebooted = true;
            self.say("its clock has begun anew".into());
            if self.phase != GuidePhase::Left {
                self.leave("its clock has begun anew".into(), now);
            }
        }
        let Some(asked) = u64::try_from(sync.ts1).ok().map(Duration::from_nanos) else { return };
        let Some(trip) = now.checked_sub(asked).filter(|trip| *trip < PATIENCE) else { return };
        self.trips.push_back(trip.as_secs_f64() * self.foreign.speed);
        self.trips.drain(..self.trips.len().saturating_sub(TRIPS));
    }

    /// The shortest of the last round trips, s of the vehicle's time, once there are enough.
    #[must_use]
    pub fn round_trip(&self) -> Option<f64> {
        (self.trips.len() == TRIPS).then(|| self.trips.iter().copied().fold(f64::INFINITY, f64::min))
    }

    /// Notes when its heartbeats begin to say that it is in distress.
    pub(super) fn watch_state(&mut self, now: Duration) {
        let vehicle = self.system.and_then(|system| self.fleet.get(system));
        let distress = vehicle.is_some_and(|vehicle| vehicle.status >= CRITICAL);
        self.evidence.critical = distress.then(|| self.evidence.critical.unwrap_or(now));
    }

    /// Its motors have stopped: in the air, that is a fall.
    pub(super) fn disarmed(&mut self, why: String, now: Duration) {
        let high = self.place.map_or(0.0, |place| self.ground[2] - place.position[2]);
        let flew = matches!(self.phase, GuidePhase::Approach | GuidePhase::Flying);
        let climbed = matches!(self.phase, GuidePhase::Climb | GuidePhase::Left) && high > IN_THE_AIR_M;
        if flew || climbed {
            self.evidence.fallen_from = Some(high);
        }
        if flew || self.phase == GuidePhase::Climb {
            self.leave(why, now);
        }
    }

    /// It has left its mode: from now on it gets no setpoint. Its texts will tell why.
    pub(super) fn leave(&mut self, why: String, now: Duration) {
        let complaint = (std::mem::take(&mut self.complaint), self.complained);
        self.enter(GuidePhase::Left, now);
        (self.complaint, self.complained) = complaint;
        self.evidence.left = why;
    }

    /// By whom its mode was left.
    pub(super) fn judge(&mut self, now: Duration) {
        for said in self.texts.unfinished() {
            self.heard_text(said, now);
        }
        let recent = |since: Duration| now.saturating_sub(since) < COUNTS + REASONS;
        let complaint = if recent(self.complained) { self.complaint.clone() } else { String::new() };
        let lower = complaint.to_lowercase();
        let says = |words: &[&str]| words.iter().any(|word| lower.contains(word));
        let critical = self.evidence.critical.is_some_and(recent);
        let left = std::mem::take(&mut self.evidence.left);
        let quoted = if complaint.is_empty() { String::new() } else { format!("; it says: {complaint}") };
        let event = if self.evidence.rebooted {
            let why = format!("the vehicle has started anew in flight ({left}){quoted}");
            GuideEvent::Failed(FlightEnd::Rebooted, why)
        } else if let Some(high) = self.evidence.fallen_from {
            GuideEvent::Crashed(format!("{left}, {high:.1} m above the ground{quoted}"))
        } else if says(&CRASHES) {
            GuideEvent::Crashed(left + &quoted)
        } else if says(&FAILSAFES) {
            GuideEvent::Failsafe(left + &quoted)
        } else if critical {
            GuideEvent::Failsafe(format!("{left}; its heartbeat says that it is in distress{quoted}"))
        } else {
            return self.taken_over(&left);
        };
        self.phase = GuidePhase::Done;
        self.events.push_back(event);
    }

    /// Whether it has taken its mode from us and not left it.
    pub(super) fn has_control(&self) -> bool {
        let phases = [GuidePhase::Arm, GuidePhase::Climb, GuidePhase::Approach, GuidePhase::Flying];
        phases.contains(&self.phase)
    }

    /// The flight ends so, once the vehicle holds its place or does not answer.
    pub(super) fn fail_held(&mut self, how: FlightEnd, why: String, now: Duration) {
        if self.has_control() {
            self.say(format!("{why}: it is asked to hold its place"));
            self.enter(GuidePhase::Braking, now);
            self.failing = Some((how, why));
        } else {
            self.fail(how, why);
        }
    }

    /// Somebody else flies from now on.
    pub fn taken_over(&mut self, why: &str) {
        if self.phase != GuidePhase::Done {
            self.phase = GuidePhase::Done;
            self.events.push_back(GuideEvent::TakenOver(why.into()));
        }
    }

    pub(super) fn fail(&mut self, how: FlightEnd, why: String) {
        if self.phase != GuidePhase::Done {
            self.phase = GuidePhase::Done;
            self.events.push_back(GuideEvent::Failed(how, why));
        }
    }
}
