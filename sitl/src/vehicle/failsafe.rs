//! Silence, counted in control intervals, and what follows it. Knows what got through the radio, not
//! who sent it.
//!
//! | silence | counts while | then, by `[failsafe]` of the scenario or `FS_*` parameters |
//! |---|---|---|
//! | of setpoints | in GUIDED, once one has got through | `hold`: the last action for ever, as in the paper (Sec. IV-A4); `brake`: to a stop, and on with the next setpoint; `return`: RTL |
//! | of stations | armed, once one was heard | `hold`; `brake`: BRAKE; `return`: RTL |
//!
//! A station is heard by its HEARTBEAT (type GCS), and by setpoints and commands to this vehicle; other
//! vehicles on the same link are none. A packet in an outage was not heard. Each loss and each end of one is told by STATUSTEXT; while an
//! action other than `hold` is under way the heartbeat says CRITICAL. Setpoint time-outs are seconds
//! of flight; those of stations are seconds on the wall, because heartbeats come by the wall, and in
//! lockstep, where setpoints are the clock, seconds of flight too.

use std::time::Duration;

use super::Vehicle;
use super::modes::Mode;
use crate::link::dialect::MavSeverity;
use crate::scenario::Action;

/// Silences under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Watch {
    setpoints: Silence,
    stations: Silence,
    /// A station has said something since the last interval.
    arrived: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Silence {
    /// Intervals without; `None` before the first packet.
    intervals: Option<u64>,
    /// What is being done about it.
    alarm: Option<Action>,
}

/// What an interval has made of a silence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Change {
    None,
    Begins(Action),
    Ends,
}

impl Silence {
    fn interval(&mut self, heard: bool, limit: u64, action: Action) -> Change {
        if heard {
            self.intervals = Some(0);
            return if self.alarm.take().is_some() { Change::Ends } else { Change::None };
        }
        let Some(intervals) = self.intervals.as_mut() else { return Change::None };
        *intervals += 1;
        if *intervals < limit || self.alarm.is_some() {
            return Change::None;
        }
        self.alarm = Some(action);
        Change::Begins(action)
    }

    fn alarmed(&self) -> bool {
        self.alarm.is_some_and(|action| action != Action::Hold)
    }
}

impl Watch {
    /// A station has said something.
    pub fn arrived(&mut self) {
        self.arrived = true;
    }

    /// Another mode: setpoints are waited for anew.
    pub fn settle(&mut self) {
        self.setpoints = Silence::default();
    }

    /// Whether the missing setpoints mean braking.
    pub fn brakes(&self) -> bool {
        self.setpoints.alarm == Some(Action::Brake)
    }

    /// Whether the vehicle acts on a silence.
    pub fn alarmed(&self) -> bool {
        self.setpoints.alarmed() || self.stations.alarmed()
    }
}

impl Vehicle {
    /// In this interval a setpoint has got through or not, and the radio works or not.
    pub(super) fn hear(&mut self, delivered: bool, outage: bool, now: Duration) {
        if delivered {
            self.conduct.waiting = false;
            self.conduct.destination = None;
        }
        let failsafe = self.settings.failsafe.clone();
        let interval_s = self.clock.interval_s();
        let arrived = std::mem::take(&mut self.watch.arrived) && !outage;

        if self.conduct.mode == Mode::Guided && self.conduct.armed {
            let limit = intervals(failsafe.setpoint_timeout_s, interval_s);
            let change = self.watch.setpoints.interval(delivered, limit, failsafe.setpoint_action);
            self.tell(change, "setpoint", failsafe.setpoint_timeout_s, now);
            if change == Change::Begins(Action::Return) {
                self.enter(Mode::Return, now);
                // The way home is part of the failsafe, until somebody asks for another mode.
                self.watch.setpoints.alarm = Some(Action::Return);
            }
        }

        let limit =
            intervals(failsafe.station_timeout_s, self.period.map_or(interval_s, |p| p.as_secs_f64()));
        let change = self.watch.stations.interval(arrived, limit, failsafe.station_action);
        self.tell(change, "station", failsafe.station_timeout_s, now);
        if let Change::Begins(action) = change
            && self.conduct.armed
            && !matches!(self.conduct.mode, Mode::Land | Mode::Return)
        {
            match action {
                Action::Hold => {}
                Action::Brake => drop(self.enter(Mode::Brake, now)),
                Action::Return => drop(self.enter(Mode::Return, now)),
            }
        }
    }

    fn tell(&mut self, change: Change, what: &'static str, seconds: f64, now: Duration) {
        let (severity, text) = match change {
            Change::None => return,
            Change::Ends => (MavSeverity::MAV_SEVERITY_NOTICE, format!("{what} heard again")),
            Change::Begins(Action::Hold) => {
                (MavSeverity::MAV_SEVERITY_NOTICE, format!("no {what} for {seconds} s: goes on"))
            }
            Change::Begins(Action::Brake) => {
                (MavSeverity::MAV_SEVERITY_CRITICAL, format!("failsafe: no {what} for {seconds} s: brakes"))
            }
            Change::Begins(Action::Return) => {
                (MavSeverity::MAV_SEVERITY_CRITICAL, format!("failsafe: no {what} for {seconds} s: returns"))
            }
        };
        let kind = match (what, change) {
            ("station", Change::Ends) => "station again",
            ("station", _) => "station lost",
            (_, Change::Ends) => "setpoint again",
            _ => "setpoint lost",
        };
        self.say(kind, severity, &text, now);
    }
}

/// How many intervals a time-out is, rounded up, and at least one.
fn intervals(timeout_s: f64, interval_s: f64) -> u64 {
    // A quotient a hair above a whole number is that number: 3.2 s are 8 intervals of 0.4 s.
    (timeout_s / interval_s - 1e-9).ceil().max(1.0) as u64
}
