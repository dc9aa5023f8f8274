//! The vehicle in its world behind its radio: a state machine that knows no clock and no socket.
//!
//! Whoever calls [`Sim::advance`] chooses the pace: a loop, "the command for this tick is here", or
//! a timer. Equal seeds and equal commands give equal bytes.

pub mod metric;
pub mod record;

use std::sync::Arc;

use nalgebra::Vector2;

use crate::camera::{Body, Film, Frame};
use crate::radio::message::{Command, LinkReport, Percept, Telemetry};
use crate::radio::{Fates, Gate};
use crate::scenario::{CollisionAction, Scenario};
use crate::units::{Snr, Tick, TxPower};
use crate::world::World;
use crate::world::contact::Contact;
use crate::world::dynamics::State;
use crate::world::noise::{Noise, Stream};

/// Who flies the UAV in an interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Control {
    /// The station: the held command.
    #[default]
    Station,
    /// The vehicle itself: a normalised acceleration, within ±1 on each axis.
    Onboard(Vector2<f64>),
    /// Nobody: it stands on the ground.
    Parked,
    /// Another simulator or autopilot: [`Sim::place`] says where it is.
    External,
}

/// A flight in progress.
#[derive(Debug, Clone)]
pub struct Sim {
    scenario: Scenario,
    world: World,
    gate: Gate,
    film: Film,
    seed: u64,
    noise: Noise,
    tick: Tick,
    link: Option<LinkReport>,
    control: Control,
    contact: Contact,
    fallen: bool,
}

impl Sim {
    /// A flight at tick 0. `scenario` must have passed [`Scenario::check`].
    #[must_use]
    pub fn new(scenario: Scenario, seed: u64) -> Self {
        Self {
            world: World::new(&scenario),
            gate: Gate::default(),
            film: Film::new(&scenario.camera, seed),
            seed,
            noise: Noise::new(seed),
            tick: Tick::default(),
            link: None,
            control: Control::default(),
            contact: Contact::default(),
            fallen: false,
            scenario,
        }
    }

    /// The tick that begins now.
    #[must_use]
    pub fn tick(&self) -> Tick {
        self.tick
    }

    /// The flight's parameters.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// Ground truth, for tests and metrics; no controller may see it.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The seed of its gusts.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// What became of the commands so far.
    #[must_use]
    pub fn fates(&self) -> Fates {
        self.gate.fates()
    }

    /// Power of the base station's transmitter.
    #[must_use]
    pub fn power(&self) -> TxPower {
        self.gate.power()
    }

    /// Sets the transmitter's power alone.
    pub fn set_power(&mut self, power: TxPower) {
        self.gate.set_power(power);
    }

    /// A command has reached the transmitter.
    pub fn handle(&mut self, command: Command) {
        self.gate.submit(command);
    }

    /// The command that the transmitter sends in the interval which begins; where there is none, one that asks
    /// for nothing, at the transmitter's power.
    #[must_use]
    pub fn asked(&self) -> Command {
        self.gate.pending().unwrap_or_else(|| Command::new(self.tick, [0.0; 2], self.gate.power()))
    }

    /// Forgets the command that is held and the one that waits.
    pub fn release(&mut self) {
        self.gate.release();
    }

    /// Says who flies from the next [`Sim::step`] on.
    pub fn set_control(&mut self, control: Control) {
        self.control = control;
    }

    /// Where a UAV under [`Control::External`] is, paper units and units per interval.
    pub fn place(&mut self, uav: State) {
        self.world.uav = uav;
    }

    /// One control interval passes: the packet gets through or not, then the UAV moves.
    pub fn advance(&mut self) {
        self.transmit();
        self.step();
    }

    /// The first half of an interval: the packet gets through or not.
    pub fn transmit(&mut self) {
        let snr = self.world.snr(self.gate.power(), &self.scenario);
        self.link = Some(self.gate.transmit(self.tick, snr, &self.scenario.radio));
    }

    /// The first half of an interval where another radio than the scenario's gate carries the commands:
    /// those that [`Sim::handle`] got have arrived, and `outage` is that radio's word.
    pub fn receive(&mut self, snr: Snr, outage: bool) {
        self.link = Some(self.gate.receive(self.tick, snr, outage));
    }

    /// The second half: the obstacles move, and the UAV as [`Sim::set_control`] says.
    pub fn step(&mut self) {
        let before = self.telemetry();
        self.fly();
        self.contact = before.contact(&self.telemetry(), &self.scenario);
        let falls = self.scenario.safety.collision_action == CollisionAction::Fall;
        if falls && self.contact.obstacle.is_some() && self.control != Control::External {
            self.fallen = true;
            self.world.uav.v = Vector2::zeros();
        }
    }

    /// What the UAV touched in the interval that just ended. The way of one under [`Control::External`] is
    /// that since [`Sim::place`], so its contacts are to be told from its reports: [`Telemetry::contact`].
    #[must_use]
    pub fn contact(&self) -> Contact {
        self.contact
    }

    /// Whether it has collided where [`CollisionAction::Fall`] holds. It is then at rest where the interval
    /// of the collision ended, whoever controls it, and its flight is over.
    #[must_use]
    pub fn is_fallen(&self) -> bool {
        self.fallen
    }

    fn fly(&mut self) {
        if self.control == Control::External {
            self.world.step_obstacles(&self.scenario);
            self.tick = self.tick.next();
            return;
        }
        let gust = self.scenario.disturbance.gust_std() * self.noise.normal(Stream::Wind, self.tick);
        let parked = (self.fallen || self.control == Control::Parked).then_some(self.world.uav.r);
        self.world.step(self.flown(), gust, &self.scenario);
        if let Some(place) = parked {
            self.world.uav = State::at_rest(place);
        }
        self.tick = self.tick.next();
    }

    /// The normalised acceleration that the vehicle flies, within ±1 on each axis: the held one, or
    /// its own.
    #[must_use]
    pub fn flown(&self) -> Vector2<f64> {
        let wish = match (self.control, self.gate.held()) {
            (Control::Station | Control::External, Some(held)) => {
                let a = self.scenario.scale.paper_from_ned_acceleration(held.accel);
                a / self.scenario.dynamics.a_max
            }
            (Control::Onboard(a), _) => a,
            (Control::Station | Control::External, None) | (Control::Parked, _) => Vector2::zeros(),
        };
        wish.map(|x| x.clamp(-1.0, 1.0))
    }

    /// The vehicle's report at the start of this tick. Asking twice gives the same.
    #[must_use]
    pub fn telemetry(&self) -> Telemetry {
        let scale = &self.scenario.scale;
        Telemetry {
            tick: self.tick,
            position: scale.ned_from_paper(self.world.uav.r),
            velocity: scale.ned_from_paper_velocity(self.world.uav.v),
            obstacles: self.world.obstacles.iter().map(|o| scale.ned_from_paper(o.r)).collect(),
            held: self.gate.held().filter(|_| matches!(self.control, Control::Station | Control::External)),
            link: self.link,
        }
    }

    /// The frame at the start of this tick.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.film.frame(self.tick, &self.world.poses(&self.scenario))
    }

    /// The same with other vehicles in it, which the camera draws as obstacles of this vehicle's size.
    #[must_use]
    pub fn frame_with(&self, others: &[State]) -> Frame {
        let mut poses = self.world.poses(&self.scenario);
        let body = |s: &State| Body { position: s.r, velocity: s.v, radius: self.scenario.uav_radius };
        poses.obstacles = poses.obstacles.iter().copied().chain(others.iter().map(body)).collect();
        self.film.frame(self.tick, &poses)
    }

    /// Report and frame together.
    #[must_use]
    pub fn percept(&self) -> Percept {
        Percept { telemetry: self.telemetry(), frame: Arc::new(self.frame()), latents: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Motion;

    fn fly(seed: u64, ticks: u64) -> Sim {
        let mut scenario = Scenario::default();
        scenario.disturbance.sigma_c = 0.005;
        scenario.radio.b_dt = 2.5;
        let mut sim = Sim::new(scenario, seed);
        for k in 0..ticks {
            let motion = Motion::ALL[(k % 5) as usize];
            let accel = sim
                .scenario()
                .scale
                .ned_from_paper_acceleration(motion.vector() * sim.scenario().dynamics.a_max);
            sim.handle(Command::new(Tick(k), accel, TxPower::Low));
            sim.advance();
        }
        sim
    }

    #[test]
    fn equal_seeds_give_equal_flights() {
        assert_eq!(fly(3, 60).percept(), fly(3, 60).percept());
        assert_ne!(fly(3, 60).telemetry().position, fly(4, 60).telemetry().position);
    }

    /// Flies east from beside the obstacle; gives the intervals in contact.
    fn into_the_obstacle(action: CollisionAction) -> (Sim, Vec<u64>) {
        let mut scenario = Scenario { start: Vector2::new(0.3, 0.45), ..Scenario::default() };
        scenario.safety.collision_action = action;
        let mut sim = Sim::new(scenario, 0);
        sim.set_control(Control::Onboard(Vector2::x()));
        let mut touched = Vec::new();
        for k in 0..40 {
            sim.advance();
            touched.extend(sim.contact().obstacle.map(|_| k));
        }
        (sim, touched)
    }

    #[test]
    fn a_uav_flies_on_through_an_obstacle_as_in_the_paper_and_the_collision_is_told() {
        let (sim, touched) = into_the_obstacle(CollisionAction::Continue);
        assert!(touched.len() > 3 && touched.is_sorted_by(|a, b| a + 1 == *b), "{touched:?}");
        assert!(sim.world().uav.r.x > 0.62 && !sim.is_fallen());
    }

    #[test]
    fn a_uav_that_falls_at_a_collision_stays_where_it_fell() {
        let (sim, touched) = into_the_obstacle(CollisionAction::Fall);
        let State { r, v } = sim.world().uav;
        assert!(sim.is_fallen() && v == Vector2::zeros());
        assert!(r.x > 0.38 && r.x < 0.42, "{r}");
        assert_eq!(touched[0], into_the_obstacle(CollisionAction::Continue).1[0]);
    }

    #[test]
    fn full_acceleration_survives_the_wire_width() {
        let sim = fly(1, 2);
        assert!((sim.flown() - Motion::East.vector()).norm() < 1e-7);
    }

    #[test]
    fn a_wish_beyond_the_limit_is_flown_at_the_limit() {
        let mut sim = Sim::new(Scenario::default(), 0);
        sim.handle(Command::new(Tick(0), [1000.0, -1000.0], TxPower::Low));
        sim.advance();
        assert_eq!(sim.flown(), Vector2::new(-1.0, 1.0));
    }
}
