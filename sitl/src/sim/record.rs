//! One line per control interval, and the paper's five metrics (Sec. IV-A6) computed from the lines.
//!
//! A record is made from what crossed the link, so a flight in process and a flight over UDP are
//! scored by the same function and, in lockstep, give the same bytes.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::radio::message::{Command, Telemetry};
use crate::scenario::Scenario;
use crate::units::{Tick, TxPower};
use crate::world::energy;
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
}

impl Record {
    /// The record of the interval between two reports of the vehicle.
    #[must_use]
    pub fn new(before: &Telemetry, command: &Command, after: &Telemetry, scenario: &Scenario) -> Self {
        let scale = &scenario.scale;
        let normalised = |accel| scale.paper_from_ned_acceleration(accel) / scenario.dynamics.a_max;
        let r_next = scale.paper_from_ned(after.position);
        let obstacles = after.obstacles(scale);
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
        }
    }
}

/// The paper's five metrics (Sec. IV-A6) of one flight, and whether it ended at the goal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Control intervals flown.
    pub ticks: u64,
    /// Whether the last position lies in the goal region.
    pub reached: bool,
    /// d_f = |r_H - r_g|, units.
    pub d_f: f64,
    /// E_comm = Σ a_p.
    pub e_comm: f64,
    /// E_ctrl = Σ P(|v|) Δt over v_1..v_H, joules.
    pub e_ctrl: f64,
    /// max_k p_coll,k.
    pub p_coll_max: f64,
    /// Intervals in outage (the paper's T_out is this times Δt).
    pub t_out: u64,
}

impl Metrics {
    /// Scores a flight; `None` if it has no record.
    #[must_use]
    pub fn of(records: &[Record], scenario: &Scenario) -> Option<Self> {
        let last = records.last()?;
        let d_f = (last.r_next - scenario.goal).norm();
        let scale = &scenario.scale;
        let watts = |r: &Record| {
            energy::propulsion_power(r.v_next.norm() * scale.mps_per_speed(), &scenario.propulsion)
        };
        Some(Self {
            ticks: records.len() as u64,
            reached: d_f <= scenario.goal_radius,
            d_f,
            e_comm: records.iter().map(|r| r.power.level()).sum(),
            e_ctrl: records.iter().map(watts).sum::<f64>() * scale.interval_s,
            p_coll_max: records.iter().map(|r| r.p_coll).fold(0.0, f64::max),
            t_out: records.iter().filter(|r| r.outage).count() as u64,
        })
    }
}
