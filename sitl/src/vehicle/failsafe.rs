//! Loss of link, counted in control intervals, and what follows it. Knows what got through the radio, not
//! who sent it.
//!
//! | silence | counts while | then, by `[failsafe]` of the scenario or `FS_*` parameters |
//! |---|---|---|
//! | of setpoints | in GUIDED, once one has got through, but not on the way to a place or there | `hold`: the last action for ever, as in the paper (Sec. IV-A4); `brake`: to a stop, and on with the next setpoint; `return`: RTL |
//! | of stations | armed, once one was heard | `hold`; `brake`: BRAKE; `return`: RTL |
//!
//! A station is heard by its HEARTBEAT (type GCS), and by setpoints and commands to this vehicle; other
//! vehicles on the same link are none. A packet in an outage was not heard. Each loss and each end of one is told by STATUSTEXT; while an
//! action other than `hold` is under way the heartbeat says CRITICAL. Setpoint time-outs are seconds
//! of flight; those of stations are seconds on the wall, because heartbeats come by the wall, and in
//! lockstep, where setpoints are the clock, seconds of flight too.

use std::time::Duration;

use super::Vehicle;
use super::conduct::Mode;
use crate::link::dialect::MavSeverity;
use crate::scenario::Action;

/// The timeouts under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct LossOfLink {
    setpoints: Timeout,
    stations: Timeout,
    /// A station has said something since the last interval.
    arrived: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Timeout {
    /// Intervals without; `None` before the first packet.
    intervals: Option<u64>,
    /// What is being done about it.
    alarm: Option<Action>,
}

/// What an interval has changed in a timeout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TimeoutChange {
    None,
    Begins(Action),
    Ends,
}

impl Timeout {
    fn interval(&mut self, heard: bool, limit: u64, action: Action) -> TimeoutChange {
        if heard {
            self.intervals = Some(0);
            return if self.alarm.take().is_some() { TimeoutChange::Ends } else { TimeoutChange::None };
        }
        let Some(intervals) = self.intervals.as_mut() else { return TimeoutChange::None };
        *intervals += 1;
        if *intervals < limit || self.alarm.is_some() {
            return TimeoutChange::None;
        }
        self.alarm = Some(action);
        TimeoutChange::Begins(action)
    }

    fn alarmed(&self) -> bool {
        self.alarm.is_some_and(|action| action != Action::Hold)
    }
}

impl LossOfLink {
    /// A station has said something.
    pub fn arrived(&mut self) {
        self.arrived = true;
    }

    /// Another mode: setpoints are waited for anew.
    pub fn settle(&mut self) {
        self.setpoints = Timeout::default();
    }

    /// Whether the missing setpoints mean braking.
    pub fn brakes(&self) -> bool {
        self.setpoints.alarm == Some(Action::Brake)
    }

    /// Whether the vehicle acts on a timeout.
    pub fn alarmed(&self) -> bool {
        self.setpoints.alarmed() || self.stations.alarmed()
    }
}

impl Vehicle {
    /// In this interval a setpoint has got through or not, and the radio works or not.
    pub(super) fn hear(&mut self, delivered: bool, outage: bool, now: Duration) {
        if delivered {
            self.conduct.waiting = false;
            self.conduct.guided = None;
        }
        let failsafe = self.settings.failsafe.clone();
        let interval_s = self.clock.interval_s();
        let arrived = std::mem::take(&mut self.loss_of_link.arrived) && !outage;

        if self.conduct.mode == Mode::Guided && self.conduct.armed {
            let limit = intervals(failsafe.setpoint_timeout_s, interval_s);
            // On its way to a place, or there, it waits for no setpoint.
            let heard = delivered || self.conduct.guided.is_some_and(|target| target.is_place());
            let change = self.loss_of_link.setpoints.interval(heard, limit, failsafe.setpoint_action);
            self.tell(change, "setpoint", failsafe.setpoint_timeout_s, now);
            if change == TimeoutChange::Begins(Action::Return) {
                self.enter(Mode::Return, now);
                // The way home is part of the failsafe, until somebody asks for another mode.
                self.loss_of_link.setpoints.alarm = Some(Action::Return);
            }
        }

        let limit =
            intervals(failsafe.station_timeout_s, self.period.map_or(interval_s, |p| p.as_secs_f64()));
        let change = self.loss_of_link.stations.interval(arrived, limit, failsafe.station_action);
        self.tell(change, "station", failsafe.station_timeout_s, now);
        if let TimeoutChange::Begins(action) = change
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

    fn tell(&mut self, change: TimeoutChange, what: &'static str, seconds: f64, now: Duration) {
        let (severity, text) = match change {
            TimeoutChange::None => return,
            TimeoutChange::Ends => (MavSeverity::MAV_SEVERITY_NOTICE, format!("{what} heard again")),
            TimeoutChange::Begins(Action::Hold) => {
                (MavSeverity::MAV_SEVERITY_NOTICE, format!("no {what} for {seconds} s: goes on"))
            }
            TimeoutChange::Begins(Action::Brake) => {
                (MavSeverity::MAV_SEVERITY_CRITICAL, format!("failsafe: no {what} for {seconds} s: brakes"))
            }
            TimeoutChange::Begins(Action::Return) => {
                (MavSeverity::MAV_SEVERITY_CRITICAL, format!("failsafe: no {what} for {seconds} s: returns"))
            }
        };
        let kind = match (what, change) {
            ("station", TimeoutChange::Ends) => "station again",
            ("station", _) => "station lost",
            (_, TimeoutChange::Ends) => "setpoint again",
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
