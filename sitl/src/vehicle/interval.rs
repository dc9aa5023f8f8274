//! One control interval of the vehicle: the radio, who flies it, what it touched, what it tells.

use std::time::Duration;

use super::Vehicle;
use super::guided::WaitingTarget;
use crate::link::dialect::MavSeverity;
use crate::sim::record::Record;

impl Vehicle {
    /// One control interval passes; the percept at its end goes to all peers.
    pub fn advance(&mut self, now: Duration) {
        (self.now, self.advanced) = (now, now);
        let begun = self.records.is_some().then(|| (self.sim.telemetry(), self.sim.asked()));
        let before = self.sim.telemetry().link.is_some_and(|link| link.outage);
        let arrivals = self.arrivals();
        self.sim.transmit();
        let link = self.sim.telemetry().link;
        let after = link.is_some_and(|link| link.outage);
        let target = self.target_through(after);
        self.hear(self.arrivals() > arrivals || target.is_some(), after, now);
        if let Some(WaitingTarget { target, turn, .. }) = target.filter(|_| self.takes_setpoints()) {
            self.follow_target(target);
            self.turn(turn);
        }
        self.keep_fence(now);
        let control = self.control(now);
        self.sim.set_control(control);
        self.sim.step();
        if let (Some(records), Some((report, command))) = (&mut self.records, begun) {
            records.push(Record::new(&report, &command, &self.sim.telemetry(), self.sim.scenario()));
        }
        self.tell_contact(now);
        (self.ready, self.png, self.sendings) = (false, None, 0);
        let power = link.map_or(self.sim.power(), |link| link.power);
        let speed = self.conduct.armed.then(|| self.sim.world().uav.v.norm());
        self.battery.spend(speed, power, self.sim.scenario());
        self.rise_and_land(now);
        let tick = self.sim.tick();
        match (before, after) {
            (false, true) => self.say(
                "outage begins",
                MavSeverity::MAV_SEVERITY_WARNING,
                &format!("outage begins before tick {}", tick.0),
                now,
            ),
            (true, false) => self.say(
                "outage ends",
                MavSeverity::MAV_SEVERITY_NOTICE,
                &format!("outage ends before tick {}", tick.0),
                now,
            ),
            _ => {}
        }
        if self.over() {
            let why = if self.sim.is_fallen() { ": collision" } else { "" };
            let text = format!("flight over after {} ticks{why}", tick.0);
            self.say("flight over", MavSeverity::MAV_SEVERITY_NOTICE, &text, now);
        }
        self.send_percept();
        self.take_shots(now);
    }

    /// Says once for each contact what was touched; the motors of a vehicle that falls stop.
    fn tell_contact(&mut self, now: Duration) {
        let before = std::mem::replace(&mut self.contact, self.sim.contact());
        let (contact, tick) = (self.contact, self.sim.tick().0);
        if let (Some(obstacle), None) = (contact.obstacle, before.obstacle) {
            self.tally.collisions += 1;
            let text = format!("collision with obstacle {} before tick {tick}", obstacle + 1);
            self.tell_text(MavSeverity::MAV_SEVERITY_CRITICAL, &text);
        }
        if contact.edge && !before.edge && self.sim.scenario().dynamics.walls {
            self.tally.edge_contacts += 1;
            let text = format!("edge of the field before tick {tick}");
            self.tell_text(MavSeverity::MAV_SEVERITY_WARNING, &text);
        }
        if self.sim.is_fallen() && self.conduct.armed {
            self.cut_motors(now);
        }
    }

    /// Commands that have got through the radio.
    fn arrivals(&self) -> u64 {
        let fates = self.sim.fates();
        fates.delivered + fates.delayed
    }
}
