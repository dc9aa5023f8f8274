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
