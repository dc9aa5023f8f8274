//! One line per control interval; [`super::metric`] scores a flight from its lines.
//!
//! A record is made from what crossed the link, so a flight in process and a flight over UDP are
//! scored by the same function and, in lockstep, give the same bytes.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::radio::message::{Command, Telemetry};
use crate::scenario::Scenario;
use crate::units::{Tick, TxPower};
use crate::world::obstacles::Obstacles;

/// Interval k of a flight: what was asked at its start, what had become of it at its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// k
    pub tick: Tick,
    /// r_k, paper units.
    pub r: Vector2<f64>,
    /// v_k, units per interval.
    pub v: Vector2<f64>,
    /// a_s,k as it was sent: normalised, paper x/y.
    pub wish: Vector2<f64>,
    /// a_p,k
    pub power: TxPower,
    /// γ_k, dB.
    pub snr_db: f32,
    /// R_k Δt < L_pkt.
    pub outage: bool,
    /// Tick of the command that was flown; `None` before the first delivery.
    pub flown_tick: Option<Tick>,
    /// The acceleration that was flown: normalised, paper x/y.
    pub flown: Vector2<f64>,
    /// r_{k+1}
    pub r_next: Vector2<f64>,
    /// v_{k+1}
    pub v_next: Vector2<f64>,
    /// Each obstacle's position at k+1, paper units, in the scenario's order.
    pub obstacles: Obstacles,
    /// Ground-truth collision probability at k+1.
    pub p_coll: f64,
    /// Whether it touched an obstacle in this interval.
    pub collided: bool,
    /// Whether it was at the field's edge, or beyond it, at k+1.
    pub edge: bool,
}

impl Record {
    /// The record of the interval between two reports of the vehicle.
    #[must_use]
    pub fn new(before: &Telemetry, command: &Command, after: &Telemetry, scenario: &Scenario) -> Self {
        let scale = &scenario.scale;
        let normalised = |accel| scale.paper_from_ned_acceleration(accel) / scenario.dynamics.a_max;
        let r_next = scale.paper_from_ned(after.position);
        let obstacles = after.obstacles(scale);
        let contact = before.contact(after, scenario);
        Self {
            tick: before.tick,
            r: scale.paper_from_ned(before.position),
            v: scale.paper_from_ned_velocity(before.velocity),
            wish: normalised(command.accel),
            power: after.link.map_or(command.power, |l| l.power),
            snr_db: after.link.map_or(f32::NAN, |l| l.snr_db),
            outage: after.link.is_some_and(|l| l.outage),
            flown_tick: after.held.map(|h| h.tick),
            flown: after.held.map_or(Vector2::zeros(), |h| normalised(h.accel)),
            r_next,
            v_next: scale.paper_from_ned_velocity(after.velocity),
            p_coll: obstacles.collision_probability(r_next, scenario),
            obstacles,
            collided: contact.obstacle.is_some(),
            edge: contact.edge,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Sim;
    use crate::world::safety;

    /// A UAV that flies towards an obstacle which comes: each tick has a risk of its own.
    fn flight() -> (Scenario, Vec<(Telemetry, Command, Telemetry)>) {
        let text =
            "[[obstacle]]\nposition = [0.3, 0.5]\nvelocity = [-0.004, 0.001]\n[radio]\nrule = \"ideal\"\n";
        let scenario = Scenario::from_toml(text).unwrap();
        let east = scenario.scale.ned_from_paper_acceleration([scenario.dynamics.a_max, 0.0].into());
        let mut sim = Sim::new(scenario.clone(), 1);
        let mut interval = || {
            let (before, command) = (sim.telemetry(), Command::new(sim.tick(), east, TxPower::High));
            sim.handle(command);
            sim.advance();
            (before, command, sim.telemetry())
        };
        let intervals = (0..8).map(|_| interval()).collect();
        (scenario, intervals)
    }

    #[test]
    fn the_risk_of_interval_k_is_that_at_its_end() {
        let (scenario, flight) = flight();
        let risk = |report: &Telemetry| {
            let (uav, at) =
                (scenario.scale.paper_from_ned(report.position), report.obstacles(&scenario.scale));
            let clearance = (uav - at[0]).norm() - scenario.obstacles[0].radius - scenario.uav_radius;
            safety::collision_probability(clearance, scenario.safety.d_min, scenario.safety.softness)
        };
        for (k, (before, command, after)) in flight.iter().enumerate() {
            let record = Record::new(before, command, after, &scenario);
            assert!((record.p_coll - risk(after)).abs() < 1e-12, "{k}: {record:?}");
            assert!(risk(before) < record.p_coll, "{k}: no risk of its own");
        }
    }

    #[test]
    fn a_record_is_of_the_interval_between_its_reports() {
        let (scenario, flight) = flight();
        let records: Vec<_> = flight
            .iter()
            .map(|(before, command, after)| Record::new(before, command, after, &scenario))
            .collect();
        for (k, pair) in records.windows(2).enumerate() {
            assert_eq!((pair[0].r_next, pair[0].v_next), (pair[1].r, pair[1].v), "{k}");
            assert_eq!((pair[0].tick.0, pair[0].flown_tick), (k as u64, Some(Tick(k as u64))));
            assert_ne!(pair[0].obstacles, pair[1].obstacles);
            let moved = pair[1].r_next - pair[1].r;
            assert!((moved - pair[1].v_next).norm() < 1e-6, "{k}: not by its new speed: {moved}");
        }
    }
}
