//! Flights that are flown from outside, by actions of anybody's controller: one, or many in one call.
//!
//! The same `Sim`, the same radio and the same records as in every other flight: equal seeds and equal actions
//! give the bytes that `gcs` writes. What a flight shows is chosen once: the state, latents, or pictures. Knows no
//! Python; the package `gcs/python` makes a Gymnasium environment of it.

pub mod batch;
pub mod fleet;
mod recorded;

use std::sync::Arc;

use crpl_model::world_model::WorldModel;
use crpl_sitl::camera::{CHANNELS, COLOURS, SIDE};
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

use crate::station::belief::Belief;
use crate::station::seen::{BeliefConfig, Heard};

/// Numbers of an action: the acceleration in x and y, shares of a_max, and the transmit power, high above 0.
pub const ACTION: usize = 3;

/// Bytes of a picture.
pub const PICTURE: usize = SIDE * SIDE * CHANNELS;

/// Numbers of [`FlightView::State`] and [`FlightView::Latent`] that do not depend on the obstacles.
const COMMON: usize = 8;

/// What a flight shows at the start of each interval.
#[derive(Debug, Clone)]
pub enum FlightView {
    /// `[r (2), v / v_max (2), link (4), then r_u (2) and v_u (2) of each obstacle]`, the truth in paper units.
    State,
    /// `[y_c (2), y_c one interval ago (2), link (4), then y_u (2) of each obstacle]`: what CRPL sees.
    Latent(Arc<WorldModel>),
    /// The picture, 100 x 100 x 3 bytes.
    Picture,
}

impl FlightView {
    /// Numbers of one observation.
    #[must_use]
    pub fn width(&self, scenario: &Scenario) -> usize {
        match self {
            Self::State => COMMON + 4 * scenario.obstacles.len(),
            // Frames tell no more obstacles apart.
            Self::Latent(_) => COMMON + 2 * scenario.obstacles.len().min(COLOURS),
            Self::Picture => PICTURE,
        }
    }
}

/// A value of an observation: numbers of [`FlightView::State`] and [`FlightView::Latent`], bytes of [`FlightView::Picture`].
pub trait ShownNumber: Send + Sized {
    /// Writes what a flight shows, in as far as it is of this kind and `out` has room.
    fn show(flight: &OpenFlight, out: &mut [Self]);
}

impl ShownNumber for f32 {
    fn show(flight: &OpenFlight, out: &mut [Self]) {
        match (&flight.view, &flight.belief) {
            (FlightView::Latent(_), Some(belief)) => flight.show_latents(belief, out),
            (FlightView::State, _) => flight.show_state(out),
            _ => {}
        }
    }
}

impl ShownNumber for u8 {
    fn show(flight: &OpenFlight, out: &mut [Self]) {
        if matches!(flight.view, FlightView::Picture) {
            out.iter_mut().zip(flight.sim.frame().rgb()).for_each(|(slot, byte)| *slot = *byte);
        }
    }
}

/// What an interval has brought.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition {
    /// -ℓ_k, the paper's stage cost of Eq. (9) with the sign of a reward.
    pub reward: f64,
    /// The vehicle has collided and fallen.
    pub terminated: bool,
    /// The horizon is reached.
    pub truncated: bool,
    /// The interval's record.
    pub record: Record,
}

/// A flight in progress that is flown from outside.
#[derive(Debug, Clone)]
pub struct OpenFlight {
    sim: Sim,
    view: FlightView,
    belief: Option<Belief>,
    before: Telemetry,
    records: Vec<Record>,
}

impl OpenFlight {
    /// A flight at tick 0. `scenario` must have passed [`Scenario::check`].
    #[must_use]
    pub fn new(scenario: &Scenario, view: &FlightView, seed: u64) -> Self {
        let sim = Sim::new(scenario.clone(), seed);
        let belief = match view {
            FlightView::Latent(world) => Some(Belief::new(world, BeliefConfig::of(scenario))),
            FlightView::State | FlightView::Picture => None,
        };
        let (before, view) = (sim.telemetry(), view.clone());
        let mut flight = Self { sim, view, belief, before, records: Vec::new() };
        flight.look(&[]);
        flight
    }

    /// The encoder's look at the frame of this tick, in which `others` are drawn as obstacles.
    fn look(&mut self, others: &[State]) {
        if let (FlightView::Latent(world), Some(belief)) = (&self.view, &mut self.belief) {
            belief.observe(world, &Heard::from(&self.before), &self.sim.frame_with(others));
        }
    }

    /// The vehicle and its world.
    #[must_use]
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// One line per interval so far.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// The metrics so far; `None` before the first interval has ended.
    #[must_use]
    pub fn score(&self) -> Option<FlightScore> {
        FlightScore::of(&self.records, self.sim.scenario())
    }

    /// Whether the flight is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.sim.is_fallen() || self.sim.tick().0 >= self.sim.scenario().horizon
    }

    /// One control interval under an action, which is cut at ±1. The radio carries it, or the vehicle holds the last.
    pub fn step(&mut self, action: [f32; ACTION]) -> Transition {
        let command = self.command(action);
        self.sim.handle(command);
        self.sim.advance();
        let transition = self.write_down(&command);
        self.look(&[]);
        transition
    }

    /// An action as a command.
    fn command(&self, action: [f32; ACTION]) -> Command {
        let [x, y, power] = action.map(|a| f64::from(a).clamp(-1.0, 1.0));
        let scenario = self.sim.scenario();
        let wish = scenario.dynamics.a_max * Vector2::new(x, y);
        let power = if power > 0.0 { TxPower::High } else { TxPower::Low };
        let accel = scenario.scale.ned_from_paper_acceleration(wish);
        Command::new(self.sim.tick(), accel, power)
    }

    /// The interval that was flown under a command.
    fn write_down(&mut self, command: &Command) -> Transition {
        let after = self.sim.telemetry();
        let scenario = self.sim.scenario();
        let record = Record::new(&self.before, command, &after, scenario);
        let transition = Transition {
            reward: -scenario.stage_cost(record.r_next, record.flown, record.power),
            terminated: self.sim.is_fallen(),
            truncated: !self.sim.is_fallen() && self.is_over(),
            record: record.clone(),
        };
        self.before = after;
        self.records.push(record);
        transition
    }

    /// SNR in dB, transmit power and outage of the interval before (0, 1, 0 at tick 0), share of the horizon flown.
    fn link(&self) -> [f32; 4] {
        let flown = self.sim.tick().0 as f32 / self.sim.scenario().horizon.max(1) as f32;
        let (snr_db, power, outage) = (self.before.link)
            .map_or((0.0, TxPower::Low, false), |link| (link.snr_db, link.power, link.outage));
        [snr_db, power.level() as f32, f32::from(u8::from(outage)), flown]
    }

    fn show_state(&self, out: &mut [f32]) {
        let (world, scenario) = (self.sim.world(), self.sim.scenario());
        let v = world.uav.v / scenario.dynamics.v_max;
        let uav = [world.uav.r.x, world.uav.r.y, v.x, v.y].map(|x| x as f32);
        let obstacles = world.obstacles.iter().flat_map(|o| [o.r.x, o.r.y, o.v.x, o.v.y].map(|x| x as f32));
        fill(out, uav.into_iter().chain(self.link()).chain(obstacles));
    }

    fn show_latents(&self, belief: &Belief, out: &mut [f32]) {
        let latents = belief.latents();
        let uav = latents.y_c.into_iter().chain(latents.y_c_before);
        fill(out, uav.chain(self.link()).chain(latents.y_u.iter().copied().flatten()));
    }
}

fn fill(out: &mut [f32], values: impl Iterator<Item = f32>) {
    out.iter_mut().zip(values).for_each(|(slot, value)| *slot = value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::Contender;
    use crate::station::models::Models;
    use crate::station::pilot::Controller;
    use crpl_sitl::scenario::CollisionAction;

    fn fly(scenario: &Scenario, view: &FlightView, seed: u64, actions: &[[f32; ACTION]]) -> OpenFlight {
        let mut flight = OpenFlight::new(scenario, view, seed);
        for action in actions {
            let _ = flight.step(*action);
        }
        flight
    }

    fn action_of(record: &Record) -> [f32; ACTION] {
        let power = if record.power == TxPower::High { 1.0 } else { -1.0 };
        [record.wish.x as f32, record.wish.y as f32, power]
    }

    #[test]
    fn the_actions_of_a_station_give_its_records_to_the_last_bit() {
        let scenario = Scenario::named("demo").unwrap();
        let models = Models::load(None, None).unwrap();
        let rcc = Contender::new(&models, Controller::Rcc, &scenario).unwrap().records(0).unwrap();
        assert!(rcc.iter().any(|record| record.outage), "the test needs a held command");
        let actions: Vec<_> = rcc.iter().map(action_of).collect();
        let flight = fly(&scenario, &FlightView::State, 0, &actions);
        assert_eq!(flight.records(), rcc);
        assert!(flight.is_over());
    }

    #[test]
    fn latents_are_those_that_a_station_believes() {
        let scenario = Scenario::named("demo").unwrap();
        let models = Models::load(None, None).unwrap();
        let crpl = Contender::new(&models, Controller::Crpl, &scenario).unwrap().records(3).unwrap();
        let chosen = models.policies(&scenario, crate::station::models::PolicyUse::Fly).unwrap();
        let view = FlightView::Latent(models.world.clone());
        let mut flight = OpenFlight::new(&scenario, &view, 3);
        let pilot = crate::station::pilot::crpl::Crpl::new(
            Arc::new(chosen.policies),
            models.world.scale,
            crate::station::seen::MotionLimits::of(&scenario),
        );
        while !flight.is_over() {
            let latents = flight.belief.as_ref().unwrap().latents();
            let (motion, power) = pilot.decide(latents);
            let high = if power == TxPower::High { 1.0 } else { -1.0 };
            flight.step([motion.vector().x as f32, motion.vector().y as f32, high]);
        }
        assert_eq!(flight.records(), crpl);
        let mut shown = vec![f32::NAN; view.width(&scenario)];
        f32::show(&flight, &mut shown);
        assert_eq!(shown[..2], flight.belief.as_ref().unwrap().latents().y_c);
        assert!(shown.iter().all(|x| x.is_finite()) && shown[7] == 1.0);
    }

    #[test]
    fn the_reward_is_the_stage_cost_and_a_flight_ends_at_its_horizon() {
        let scenario = Scenario { horizon: 3, ..Scenario::default() };
        let mut flight = OpenFlight::new(&scenario, &FlightView::State, 0);
        let steps: Vec<_> = (0..3).map(|_| flight.step([1.0, 0.0, 1.0])).collect();
        let j: f64 = steps.iter().map(|step| step.reward).sum();
        let score = flight.score().unwrap();
        assert!((j + score[crpl_sitl::sim::metric::Metric::StageCost]).abs() < 1e-12);
        assert_eq!(
            steps.iter().map(|s| (s.terminated, s.truncated)).collect::<Vec<_>>()[1..],
            [(false, false), (false, true)]
        );
    }

    #[test]
    fn a_fall_terminates() {
        let mut scenario = Scenario { start: Vector2::new(0.36, 0.45), ..Scenario::default() };
        scenario.safety.collision_action = CollisionAction::Fall;
        let mut flight = OpenFlight::new(&scenario, &FlightView::State, 0);
        let last = std::iter::repeat_with(|| flight.step([1.0, 0.0, 1.0])).find(|step| step.terminated);
        assert!(last.is_some_and(|step| step.record.collided && !step.truncated));
    }

    #[test]
    fn the_state_and_the_picture_are_those_of_the_vehicle() {
        let scenario = Scenario::named("two-obstacles").unwrap();
        let flight = fly(&scenario, &FlightView::State, 1, &[[1.0, -0.5, 1.0]; 9]);
        let mut state = vec![0.0; FlightView::State.width(&scenario)];
        f32::show(&flight, &mut state);
        let world = flight.sim().world();
        assert_eq!(state[..2], [world.uav.r.x as f32, world.uav.r.y as f32]);
        assert_eq!(state[12..14], [world.obstacles[1].r.x as f32, world.obstacles[1].r.y as f32]);
        assert_eq!(state[5..8], [4.0, 0.0, 0.09]);
        let flight = fly(&scenario, &FlightView::Picture, 1, &[[1.0, -0.5, 1.0]; 9]);
        let mut picture = vec![0u8; PICTURE];
        u8::show(&flight, &mut picture);
        assert_eq!(picture, flight.sim().frame().rgb());
    }
}
