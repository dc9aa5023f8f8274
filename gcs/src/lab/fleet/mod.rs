//! Several vehicles on one base station, in process: they share its bandwidth, and the field.
//!
//! Every second vehicle flies the other way: from the scenario's goal to its start, in the mirror image of the
//! scenario, so that one policy flies all of them. They leave in pairs, [`FleetPlan::headway`] intervals apart. One that
//! has stayed at its goal for `LANDS` intervals lands and leaves the field. Commands share the bandwidth as a
//! [`Scheduler`] says; reports and pictures arrive, as in the paper. A collision of two vehicles is counted, and both
//! fly on.

pub mod scheduler;
pub mod separation;
pub mod table;

use anyhow::Result;
use crpl_model::world_model::StationHeads;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::channel;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

use crate::lab::Contender;
use crate::station::Station;
use crate::station::belief::Latents;
use scheduler::{Scheduler, SharedRadio, SlotRequest};
use separation::Separation;

/// Intervals at its goal after which a vehicle lands (our choice).
const LANDS: u64 = 5;
/// How far ahead an outage is predicted, intervals (our choice).
const AHEAD: u32 = 15;

/// How a fleet flies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FleetPlan {
    /// Vehicles.
    pub vehicles: usize,
    /// How they share the bandwidth.
    pub scheduler: Scheduler,
    /// B Δt of all together.
    pub b_dt: f64,
    /// Intervals between two pairs that leave.
    pub headway: u64,
    /// Whether they keep clear of each other by their reports.
    pub separate: bool,
    /// Whether each camera draws the other vehicles, as obstacles.
    pub drawn: bool,
}

/// What became of a fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetScore {
    /// Of each vehicle.
    pub flights: Vec<FlightScore>,
    /// How often two vehicles collided: entries, not intervals.
    pub collisions: u64,
    /// Least distance of two vehicles' centres, units; infinite of one.
    pub nearest: f64,
    /// Mean power level of the slots.
    pub power: f64,
}

/// A vehicle of the fleet.
struct Member {
    sim: Sim,
    station: Station,
    leaves: u64,
    mirrored: bool,
    /// Intervals at the goal in a row.
    at_goal: u64,
    landed: bool,
    /// Intervals since a command last got through.
    waited: u64,
}

/// x is seen from the other side.
fn mirror(v: Vector2<f64>, about: f64) -> Vector2<f64> {
    Vector2::new(about - v.x, v.y)
}

impl Member {
    fn is_airborne(&self, turn: u64) -> bool {
        turn >= self.leaves && !self.landed
    }

    /// Where it says it is, in the common frame.
    fn reported(&self) -> State {
        let (report, scale) = (self.sim.telemetry(), self.sim.scenario().scale);
        let r = scale.paper_from_ned(report.position);
        let v = scale.paper_from_ned_velocity(report.velocity);
        if self.mirrored { State { r: mirror(r, 1.0), v: mirror(v, 0.0) } } else { State { r, v } }
    }

    /// A direction of the common frame in its own, and back.
    fn turned(&self, a: Vector2<f64>) -> Vector2<f64> {
        if self.mirrored { mirror(a, 0.0) } else { a }
    }
}

/// A fleet in flight.
struct FleetFlight<'a> {
    plan: FleetPlan,
    scenario: &'a Scenario,
    heads: &'a StationHeads,
    radio: SharedRadio,
    members: Vec<Member>,
    touching: Vec<(usize, usize)>,
    score: FleetScore,
    powers: Vec<f64>,
}

/// Flies a fleet of vehicles that `contender` commands, `heads` predicting their gains.
///
/// # Errors
/// As [`Contender::station`].
pub fn fly(contender: &Contender, heads: &StationHeads, plan: &FleetPlan, seed: u64) -> Result<FleetScore> {
    let scenario = contender.scenario();
    let station = contender.station()?;
    let member = |n: usize| Member {
        sim: Sim::new(scenario.clone(), seed.wrapping_mul(1000).wrapping_add(n as u64)),
        station: station.clone(),
        leaves: plan.headway * (n as u64 / 2),
        mirrored: n % 2 == 1,
        at_goal: 0,
        landed: false,
        waited: 0,
    };
    let radio = SharedRadio {
        b_dt: plan.b_dt,
        packet_bits: scenario.radio.packet_bits,
        noise_power: scenario.channel.noise_power,
    };
    let score = FleetScore { flights: Vec::new(), collisions: 0, nearest: f64::INFINITY, power: 0.0 };
    let mut flight = FleetFlight {
        plan: *plan,
        scenario,
        heads,
        radio,
        members: (0..plan.vehicles).map(member).collect(),
        touching: Vec::new(),
        score,
        powers: Vec::new(),
    };
    let mut turn = 0;
    while flight.members.iter().any(|member| !member.landed) {
        flight.interval(turn);
        turn += 1;
    }
    let FleetFlight { members, mut score, powers, .. } = flight;
    score.flights = members.iter().filter_map(|member| member.station.score()).collect();
    score.power = powers.iter().sum::<f64>() / powers.len().max(1) as f64;
    Ok(score)
}

impl FleetFlight<'_> {
    fn interval(&mut self, turn: u64) {
        let airborne: Vec<usize> =
            (0..self.members.len()).filter(|n| self.members[*n].is_airborne(turn)).collect();
        let states: Vec<State> = self.members.iter().map(Member::reported).collect();
        let commands: Vec<Command> = airborne.iter().map(|n| self.command(*n, &airborne, &states)).collect();
        let requests: Vec<SlotRequest> =
            airborne.iter().zip(&commands).map(|(n, c)| self.request(*n, c.power, airborne.len())).collect();
        let slots = self.plan.scheduler.allot(&requests, &self.radio, turn);
        for (n, command) in airborne.iter().zip(&commands) {
            let member = &mut self.members[*n];
            let slot = slots.iter().find(|slot| slot.vehicle == *n);
            let power = slot.map_or(command.power, |slot| slot.power);
            member.sim.set_power(power);
            let snr = member.sim.world().snr(power, self.scenario);
            let carries = slot.is_some_and(|slot| {
                self.powers.push(power.level());
                !channel::outage(slot.share * self.radio.b_dt, snr, self.radio.packet_bits)
            });
            if carries {
                member.sim.handle(Command { power, ..*command });
            }
            member.waited = if carries { 0 } else { member.waited + 1 };
            member.sim.receive(snr, !carries);
            member.sim.step();
        }
        self.touch(&airborne);
        airborne.iter().for_each(|n| self.land(*n, turn));
    }

    /// The station's command, if the vehicle keeps clear of the others with it.
    fn command(&mut self, n: usize, airborne: &[usize], states: &[State]) -> Command {
        let others: Vec<State> = airborne.iter().filter(|k| **k != n).map(|k| states[*k]).collect();
        let percept = self.percept(n, &others);
        let member = &mut self.members[n];
        let command = member.station.handle(&percept);
        if !self.plan.separate {
            return command;
        }
        let (scale, a_max) = (&self.scenario.scale, self.scenario.dynamics.a_max);
        let wish = member.turned(scale.paper_from_ned_acceleration(command.accel) / a_max);
        // The obstacles are the scenario's, and a mirrored vehicle's are mirrored.
        let reported = percept.telemetry.obstacles(scale);
        let obstacles: Obstacles =
            reported.iter().map(|r| if member.mirrored { mirror(*r, 1.0) } else { *r }).collect();
        let flown = Separation::of(self.scenario).of_wish(states[n], wish, &others, &obstacles);
        if flown == wish {
            return command;
        }
        let accel = scale.ned_from_paper_acceleration(a_max * member.turned(flown));
        Command { accel, ..command }
    }

    fn percept(&self, n: usize, others: &[State]) -> Percept {
        let member = &self.members[n];
        if !self.plan.drawn {
            return member.sim.percept();
        }
        let own = |state: &State| match member.mirrored {
            true => State { r: mirror(state.r, 1.0), v: mirror(state.v, 0.0) },
            false => *state,
        };
        let others: Vec<State> = others.iter().map(own).collect();
        Percept { frame: member.sim.frame_with(&others).into(), ..member.sim.percept() }
    }

    /// What the channel head predicts for a vehicle, straight on from where it is.
    fn request(&self, n: usize, power: TxPower, airborne: usize) -> SlotRequest {
        let member = &self.members[n];
        let now: Latents = member.station.latents();
        let gain = |j: u32| {
            let at = |i: usize| now.y_c[i] + j as f32 * (now.y_c[i] - now.y_c_before[i]);
            let of = |y_u: &[f32; 2]| f64::from(self.heads.log_gain([at(0), at(1)], *y_u)).exp();
            now.y_u.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let fair = 1.0 / airborne.max(1) as f64;
        let outage_in = (0..AHEAD).find(|j| self.radio.share(gain(*j), TxPower::High) > fair);
        SlotRequest { vehicle: n, gain: gain(0), outage_in, waited: member.waited, power }
    }

    /// Counts who collided.
    fn touch(&mut self, airborne: &[usize]) {
        let reach = 2.0 * self.scenario.uav_radius + self.scenario.safety.d_min;
        let mut touching = Vec::new();
        for (k, a) in airborne.iter().enumerate() {
            for b in &airborne[k + 1..] {
                let apart = (self.members[*a].reported().r - self.members[*b].reported().r).norm();
                self.score.nearest = self.score.nearest.min(apart);
                if apart <= reach {
                    touching.push((*a, *b));
                }
            }
        }
        let entered = touching.iter().filter(|pair| !self.touching.contains(pair)).count();
        self.score.collisions += entered as u64;
        self.touching = touching;
    }

    fn land(&mut self, n: usize, turn: u64) {
        let (goal, radius, horizon) = (self.scenario.goal, self.scenario.goal_radius, self.scenario.horizon);
        let member = &mut self.members[n];
        let inside = (member.sim.world().uav.r - goal).norm() <= radius;
        member.at_goal = if inside { member.at_goal + 1 } else { 0 };
        if member.at_goal >= LANDS || turn + 1 >= member.leaves + horizon || member.sim.is_fallen() {
            member.landed = true;
            let last = member.sim.percept();
            member.station.finish(&last);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::station::models::Models;
    use crate::station::pilot::Controller;

    fn flown(controller: Controller, plan: &FleetPlan) -> FleetScore {
        let scenario = Scenario::named("demo").unwrap();
        let models = Models::load(None, None).unwrap();
        let heads = models.world.station_heads(&scenario);
        fly(&Contender::new(&models, controller, &scenario).unwrap(), &heads, plan, 5).unwrap()
    }

    const PLAN: FleetPlan = FleetPlan {
        vehicles: 2,
        scheduler: Scheduler::Predicted,
        b_dt: 8.0,
        headway: 10,
        separate: true,
        drawn: false,
    };

    #[test]
    fn two_that_meet_collide_unless_they_keep_clear_and_the_same_flight_comes_again() {
        let apart = flown(Controller::Crpl, &PLAN);
        assert_eq!(apart, flown(Controller::Crpl, &PLAN));
        assert_eq!((apart.flights.len(), apart.collisions), (2, 0), "{apart:?}");
        let through = flown(Controller::Crpl, &FleetPlan { separate: false, ..PLAN });
        assert!(through.collisions > 0 && through.nearest < apart.nearest, "{through:?}");
    }

    #[test]
    fn one_vehicle_with_all_of_the_bandwidth_is_a_flight_of_its_own() {
        let alone = FleetPlan { vehicles: 1, ..PLAN };
        for scheduler in [Scheduler::Tdma, Scheduler::RoundRobin] {
            let score = flown(Controller::Rcc, &FleetPlan { scheduler, ..alone });
            assert_eq!(score, flown(Controller::Rcc, &FleetPlan { scheduler: Scheduler::Tdma, ..alone }));
            assert!(score.nearest.is_infinite());
        }
    }
}
