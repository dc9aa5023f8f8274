//! Several vehicles on one base station, in process: they share its bandwidth, and the field.
//!
//! Every second vehicle flies the other way: from the scenario's goal to its start, in the mirror image of the
//! scenario, so that one policy flies all of them. They leave in pairs, [`FleetPlan::headway`] intervals apart. One that
//! has stayed at its goal for five intervals lands and leaves the field. Commands share the bandwidth as a
//! [`Scheduler`] says; reports and pictures arrive, as in the paper. A collision of two vehicles is counted, and both
//! fly on.

pub mod field;
pub mod scheduler;
pub mod separation;
pub mod table;

use anyhow::Result;
use crpl_model::world_model::StationHeads;
use crpl_sitl::Sim;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::world::dynamics::State;

use crate::lab::Contender;
use crate::station::Station;
use field::{FleetCraft, FleetField};
use scheduler::{Scheduler, SlotRequest};

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

/// A vehicle and the station that commands it.
struct Commanded {
    sim: Sim,
    station: Station,
}

impl FleetCraft for Commanded {
    fn sim(&self) -> &Sim {
        &self.sim
    }

    fn sim_mut(&mut self) -> &mut Sim {
        &mut self.sim
    }
}

/// Flies a fleet of vehicles that `contender` commands, `heads` predicting their gains.
///
/// # Errors
/// As [`Contender::station`].
pub fn fly(contender: &Contender, heads: &StationHeads, plan: &FleetPlan, seed: u64) -> Result<FleetScore> {
    let scenario = contender.scenario();
    let station = contender.station()?;
    let craft = |seed| Commanded { sim: Sim::new(scenario.clone(), seed), station: station.clone() };
    let mut field = FleetField::new(scenario, plan, seed, craft);
    let mut turn = 0;
    while !field.is_over() {
        interval(&mut field, heads, turn);
        turn += 1;
    }
    Ok(FleetScore {
        flights: field.members.iter().filter_map(|member| member.craft.station.score()).collect(),
        collisions: field.collisions,
        nearest: field.nearest,
        power: field.mean_power(),
    })
}

fn interval(field: &mut FleetField<Commanded>, heads: &StationHeads, turn: u64) {
    let airborne = field.airborne(turn);
    let states = field.states();
    let mut commands = Vec::new();
    for n in &airborne {
        let percept = percept(field, *n, &airborne, &states);
        let command = field.members[*n].craft.station.handle(&percept);
        commands.push(field.clear_command(*n, command, &airborne, &states));
    }
    let request = |(n, command): (&usize, &Command)| {
        let latents = field.members[*n].craft.station.latents();
        field.request(*n, command.power, airborne.len(), Some((heads, &latents)))
    };
    let requests: Vec<SlotRequest> = airborne.iter().zip(&commands).map(request).collect();
    field.fly(&airborne, &commands, &requests, turn);
    field.touch(&airborne);
    for n in airborne {
        if field.land(n, turn).is_some() {
            let Commanded { sim, station } = &mut field.members[n].craft;
            station.finish(&sim.percept());
        }
    }
}

fn percept(field: &FleetField<Commanded>, n: usize, airborne: &[usize], states: &[State]) -> Percept {
    let sim = &field.members[n].craft.sim;
    if !field.plan().drawn {
        return sim.percept();
    }
    Percept { frame: sim.frame_with(&field.others(n, airborne, states)).into(), ..sim.percept() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::station::models::Models;
    use crate::station::pilot::Controller;
    use crpl_sitl::Scenario;

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
