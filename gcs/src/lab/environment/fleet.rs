//! A fleet that is flown from outside: each vehicle by actions of somebody's own, on one base station's bandwidth.
//!
//! The same field, scheduler and rules as in `gcs fleet` ([`crate::lab::fleet`]): equal commands fly equal fleets.

use crpl_model::world_model::StationHeads;
use crpl_sitl::radio::message::Command;
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::{Scenario, Sim};

use super::batch::StepReport;
use super::{ACTION, FlightView, OpenFlight, PICTURE, ShownNumber, Transition, fill};
use crate::lab::fleet::FleetPlan;
use crate::lab::fleet::field::{FleetCraft, FleetField, FleetLanding};
use crate::lab::fleet::scheduler::{Scheduler, SlotRequest};

/// Numbers that a vehicle's observation has of each other vehicle: whether it flies, r (2), v / v_max (2).
pub const OTHER: usize = 5;

/// What a turn has brought one vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FleetReport {
    /// As of any flight; `terminated` too where it has landed at its goal.
    pub step: StepReport,
    /// Whether it began to touch another vehicle.
    pub met: bool,
}

/// Why a fleet cannot be flown as asked.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The scheduler reads latents.
    #[error("the scheduler `predicted` reads latents: it needs obs=\"latent\"")]
    NeedsLatents,
    /// A fleet of nobody.
    #[error("a fleet has at least one vehicle")]
    Empty,
    /// Not a range of B Δt.
    #[error("the shared B dt is {0}, not above 0")]
    Bandwidth(f64),
}

impl FleetCraft for OpenFlight {
    fn sim(&self) -> &Sim {
        &self.sim
    }

    fn sim_mut(&mut self) -> &mut Sim {
        &mut self.sim
    }
}

/// A fleet in flight.
#[derive(Debug, Clone)]
pub struct OpenFleet {
    field: FleetField<OpenFlight>,
    heads: Option<StationHeads>,
    view: FlightView,
    turn: u64,
}

impl OpenFleet {
    /// A fleet before its first turn. `scenario` must have passed [`Scenario::check`].
    ///
    /// # Errors
    /// See [`FleetError`].
    pub fn new(
        scenario: &Scenario,
        view: &FlightView,
        plan: &FleetPlan,
        seed: u64,
    ) -> Result<Self, FleetError> {
        if plan.vehicles == 0 {
            return Err(FleetError::Empty);
        }
        if !(plan.b_dt > 0.0 && plan.b_dt.is_finite()) {
            return Err(FleetError::Bandwidth(plan.b_dt));
        }
        let heads = match view {
            FlightView::Latent(world) => Some(world.station_heads(scenario)),
            FlightView::State | FlightView::Picture => None,
        };
        if plan.scheduler == Scheduler::Predicted && heads.is_none() {
            return Err(FleetError::NeedsLatents);
        }
        let craft = |seed| OpenFlight::new(scenario, view, seed);
        let field = FleetField::new(scenario, plan, seed, craft);
        Ok(Self { field, heads, view: view.clone(), turn: 0 })
    }

    /// Begins anew.
    pub fn reset(&mut self, seed: u64) {
        let (scenario, plan) = (self.field.scenario().clone(), *self.field.plan());
        self.field =
            FleetField::new(&scenario, &plan, seed, |seed| OpenFlight::new(&scenario, &self.view, seed));
        self.turn = 0;
    }

    /// Number of vehicles.
    #[must_use]
    pub fn count(&self) -> usize {
        self.field.members.len()
    }

    /// Numbers of one vehicle's observation.
    #[must_use]
    pub fn width(&self) -> usize {
        let others = self.count().saturating_sub(1);
        match self.view {
            FlightView::Picture => PICTURE,
            FlightView::State | FlightView::Latent(_) => {
                self.view.width(self.field.scenario()) + OTHER * others
            }
        }
    }

    /// What it shows.
    #[must_use]
    pub fn view(&self) -> &FlightView {
        &self.view
    }

    /// Whether a vehicle has left the field.
    #[must_use]
    pub fn has_landed(&self, n: usize) -> bool {
        self.field.members.get(n).is_none_or(|member| member.landed)
    }

    /// Whether a vehicle flies in the coming turn.
    #[must_use]
    pub fn is_airborne(&self, n: usize) -> bool {
        self.field.members.get(n).is_some_and(|member| member.is_airborne(self.turn))
    }

    /// Collisions of two vehicles so far, and the least distance of two, units.
    #[must_use]
    pub fn encounters(&self) -> (u64, f64) {
        (self.field.collisions, self.field.nearest)
    }

    /// A vehicle's flight.
    #[must_use]
    pub fn flight(&self, n: usize) -> Option<&OpenFlight> {
        self.field.members.get(n).map(|member| &member.craft)
    }

    /// The metrics of a vehicle; `None` before it has flown.
    #[must_use]
    pub fn score(&self, n: usize) -> Option<FlightScore> {
        self.flight(n)?.score()
    }

    /// Writes what every vehicle sees, [`OpenFleet::width`] values each: its own flight, then of each other vehicle
    /// [`OTHER`] numbers, in its own frame; zeros of one that is not in the air.
    pub fn show_numbers(&self, out: &mut [f32]) {
        let own = self.view.width(self.field.scenario());
        let (states, v_max) = (self.field.states(), self.field.scenario().dynamics.v_max);
        for (n, out) in out.chunks_exact_mut(self.width()).enumerate().take(self.count()) {
            let (first, rest) = out.split_at_mut(own.min(out.len()));
            f32::show(&self.field.members[n].craft, first);
            let others = (0..self.count()).filter(|k| *k != n).flat_map(|k| {
                let seen = self.is_airborne(k).then(|| self.field.others(n, &[k], &states));
                seen.and_then(|seen| seen.first().map(|s| of_other(s, v_max))).unwrap_or_default()
            });
            fill(rest, others);
        }
    }

    /// Writes every vehicle's picture; the others are in it where the plan says so.
    pub fn show_pictures(&self, out: &mut [u8]) {
        let (airborne, states) = (self.field.airborne(self.turn), self.field.states());
        for (n, out) in out.chunks_exact_mut(PICTURE).enumerate().take(self.count()) {
            let frame = self.field.members[n].craft.sim.frame_with(&self.drawn(n, &airborne, &states));
            out.copy_from_slice(frame.rgb());
        }
    }

    /// The vehicles that the camera of `n` draws.
    fn drawn(&self, n: usize, airborne: &[usize], states: &[State]) -> Vec<State> {
        if self.field.plan().drawn { self.field.others(n, airborne, states) } else { Vec::new() }
    }

    /// One turn. `actions` are of all vehicles; those of vehicles on the ground are not flown.
    pub fn step(&mut self, actions: &[[f32; ACTION]]) -> Vec<FleetReport> {
        let turn = self.turn;
        let airborne: Vec<usize> =
            self.field.airborne(turn).into_iter().filter(|n| *n < actions.len()).collect();
        let states = self.field.states();
        let command = |n: &usize| {
            let command = self.field.members[*n].craft.command(actions[*n]);
            self.field.clear_command(*n, command, &airborne, &states)
        };
        let commands: Vec<Command> = airborne.iter().map(command).collect();
        let requests: Vec<SlotRequest> =
            airborne.iter().zip(&commands).map(|(n, c)| self.request(*n, c, airborne.len())).collect();
        let sent = self.field.fly(&airborne, &commands, &requests, turn);
        let met = self.field.touch(&airborne);
        let mut reports = vec![FleetReport::default(); self.count()];
        for (n, command) in airborne.iter().zip(&sent) {
            let transition = self.field.members[*n].craft.write_down(command);
            let landing = self.field.land(*n, turn);
            reports[*n] = FleetReport { step: report(&transition, landing), met: met.contains(n) };
        }
        self.turn += 1;
        self.look();
        reports
    }

    /// All encoders look at the frames of the coming turn.
    fn look(&mut self) {
        let (airborne, states) = (self.field.airborne(self.turn), self.field.states());
        for n in &airborne {
            // One that leaves now has looked at the ground already.
            if self.field.members[*n].leaves < self.turn {
                let others = self.drawn(*n, &airborne, &states);
                self.field.members[*n].craft.look(&others);
            }
        }
    }

    fn request(&self, n: usize, command: &Command, airborne: usize) -> SlotRequest {
        let latents = self.field.members[n].craft.belief.as_ref().map(super::Belief::latents);
        let predictor = self.heads.as_ref().zip(latents.as_ref());
        self.field.request(n, command.power, airborne, predictor)
    }
}

fn of_other(state: &State, v_max: f64) -> [f32; OTHER] {
    let v = state.v / v_max;
    [1.0, state.r.x, state.r.y, v.x, v.y].map(|x| x as f32)
}

fn report(transition: &Transition, landing: Option<FleetLanding>) -> StepReport {
    StepReport {
        terminated: matches!(landing, Some(FleetLanding::AtGoal | FleetLanding::Fell)),
        truncated: landing == Some(FleetLanding::OutOfTime),
        ..StepReport::from(transition)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::{Contender, fleet};
    use crate::station::models::Models;
    use crate::station::pilot::Controller;
    use crpl_sitl::units::TxPower;

    const PLAN: FleetPlan = FleetPlan {
        vehicles: 3,
        scheduler: Scheduler::Tdma,
        b_dt: 6.0,
        headway: 4,
        separate: true,
        drawn: false,
    };

    /// A command as an action.
    fn action(command: &Command, scenario: &Scenario) -> [f32; ACTION] {
        let wish = scenario.scale.paper_from_ned_acceleration(command.accel) / scenario.dynamics.a_max;
        [wish.x as f32, wish.y as f32, if command.power == TxPower::High { 1.0 } else { -1.0 }]
    }

    #[test]
    fn the_actions_of_stations_fly_the_fleet_that_gcs_flies() {
        let scenario = Scenario::named("demo").unwrap();
        let models = Models::load(None, None).unwrap();
        let rcc = Contender::new(&models, Controller::Rcc, &scenario).unwrap();
        let heads = models.world.station_heads(&scenario);
        let want = fleet::fly(&rcc, &heads, &PLAN, 5).unwrap();
        assert!(want.nearest < 0.3, "the test needs vehicles that meet: {want:?}");

        let mut fleet = OpenFleet::new(&scenario, &FlightView::State, &PLAN, 5).unwrap();
        let mut stations = vec![rcc.station().unwrap(); 3];
        let mut ends = [0; 3];
        while !fleet.field.is_over() {
            let mut actions = [[0.0; ACTION]; 3];
            for n in (0..3).filter(|n| fleet.is_airborne(*n)) {
                let percept = fleet.flight(n).unwrap().sim().percept();
                actions[n] = action(&stations[n].handle(&percept), &scenario);
            }
            for (n, report) in fleet.step(&actions).iter().enumerate() {
                ends[n] += u32::from(report.step.terminated || report.step.truncated);
            }
        }
        assert_eq!(ends, [1; 3]);
        let scores: Vec<FlightScore> = (0..3).filter_map(|n| fleet.score(n)).collect();
        assert_eq!((scores, fleet.encounters()), (want.flights, (want.collisions, want.nearest)));
    }

    #[test]
    fn vehicles_see_each_other_in_their_own_frame_and_a_collision_is_told_to_both() {
        let scenario = Scenario::default();
        let plan = FleetPlan { vehicles: 2, separate: false, headway: 0, ..PLAN };
        let mut fleet = OpenFleet::new(&scenario, &FlightView::State, &plan, 1).unwrap();
        let (width, own) = (fleet.width(), FlightView::State.width(&scenario));
        let mut seen = vec![f32::NAN; 2 * width];
        fleet.show_numbers(&mut seen);
        // Each begins at the start of its own frame and sees the other at the start's mirror image.
        for n in 0..2 {
            let view = &seen[n * width..(n + 1) * width];
            assert_eq!(view[own], 1.0);
            assert!((view[0] + view[own + 1] - 1.0).abs() < 1e-6 && (view[1] - view[own + 2]).abs() < 1e-6);
        }
        let met = std::iter::repeat_with(|| fleet.step(&[[1.0, 0.0, 1.0]; 2])).take(60).find(|r| r[0].met);
        assert!(met.is_some_and(|reports| reports[1].met) && fleet.encounters().0 == 1);
    }

    #[test]
    fn what_cannot_be_flown_is_refused_and_equal_seeds_fly_equal_fleets() {
        let scenario = Scenario::default();
        let with = |plan: &FleetPlan| OpenFleet::new(&scenario, &FlightView::State, plan, 1).map(drop);
        assert!(matches!(
            with(&FleetPlan { scheduler: Scheduler::Predicted, ..PLAN }),
            Err(FleetError::NeedsLatents)
        ));
        assert!(matches!(with(&FleetPlan { vehicles: 0, ..PLAN }), Err(FleetError::Empty)));
        assert!(matches!(with(&FleetPlan { b_dt: f64::NAN, ..PLAN }), Err(FleetError::Bandwidth(_))));
        let mut fleet = OpenFleet::new(&scenario, &FlightView::State, &PLAN, 1).unwrap();
        let flown = |fleet: &mut OpenFleet| {
            fleet.reset(7);
            (0..30).map(|_| fleet.step(&[[0.7, 0.2, 1.0]; 3])).collect::<Vec<_>>()
        };
        assert_eq!(flown(&mut fleet), flown(&mut fleet));
    }
}
