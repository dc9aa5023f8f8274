//! How a vehicle begins a flight, and how PREFLIGHT_REBOOT begins another one.

use std::time::Duration;

use super::conduct::Conduct;
use super::geodesy::{Home, Site};
use super::heading::Heading;
use super::height::Height;
use super::{Battery, Contact, LossOfLink, Shots, Vehicle};
use crate::link::dialect::MavSeverity;
use crate::link::wire::Clock;
use crate::sim::Sim;

/// How it begins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Start {
    /// Disarmed, on the ground; else armed and in the air.
    pub on_ground: bool,
    /// Where on Earth its start is, and where it looks; else the scenario's place and north.
    pub home: Option<Home>,
}

impl Vehicle {
    /// Begins as `start` says, if nothing has been flown yet.
    pub fn set_start(&mut self, start: Start) {
        self.start = start;
        self.begin();
    }

    /// Posture and place at the beginning of a flight.
    fn begin(&mut self) {
        let scenario = self.sim.scenario();
        let start = scenario.scale.ned_from_paper(scenario.start);
        if let Some(home) = self.start.home {
            self.site = Site::with_home(&home, start);
        }
        self.home = None;
        self.heading = Heading::at(self.start.home.map_or(0.0, |home| home.heading.to_radians()));
        (self.conduct, self.height) = if self.start.on_ground {
            (Conduct::parked(), Height::hovering(0.0))
        } else {
            (Conduct::flying(), Height::hovering(scenario.scale.altitude_m))
        };
    }

    /// A fresh flight with what the parameters say now, those that take effect at boot too. Parameters, mission,
    /// fence, rally points, key and peers stay; rates, time and all that was flown begin anew.
    ///
    /// An autopilot refuses this in the air. A simulator whose vehicle begins there does not.
    pub(super) fn reboot(&mut self, now: Duration) {
        self.sim = Sim::new(self.settings.clone(), self.sim.seed());
        self.clock = Clock::new(self.sim.scenario());
        self.begin();
        self.loss_of_link = LossOfLink::default();
        self.battery = Battery::default();
        self.contact = Contact::default();
        (self.upload, self.uploaded, self.commander) = (None, None, None);
        (self.waiting_target, self.newest_target, self.newest_power) = (None, None, None);
        (self.begun, self.ready, self.acknowledged) = (false, false, false);
        (self.png, self.sendings, self.advanced) = (None, 0, now);
        self.plan.restart();
        self.shots = Shots::default();
        self.said.clear();
        for peer in self.peers.values_mut() {
            peer.images = None;
        }
        for address in self.addresses() {
            self.set_default_rates(address, now);
        }
        self.say("reboot", MavSeverity::MAV_SEVERITY_NOTICE, "rebooted", now);
        self.send_percept();
    }
}
