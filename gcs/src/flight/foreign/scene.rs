//! What CRPL sees of a foreign vehicle: its place in the paper's square, drawn as `sitl` draws it, with
//! the obstacle of the scenario; and the modelled radio between station and vehicle.

use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::sim::Control;
use crpl_sitl::units::Tick;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

/// The scene of one flight: a [`Sim`] whose UAV another autopilot flies.
#[derive(Debug, Clone)]
pub struct ForeignScene {
    sim: Sim,
    /// The paper's (0, 0) in the vehicle's local frame: north, east, m.
    origin: [f32; 2],
}

impl ForeignScene {
    /// The square laid so that `position` (north, east, m) is the scenario's start.
    #[must_use]
    pub fn new(scenario: Scenario, position: [f32; 2]) -> Self {
        let origin = Self::origin_at_start(&scenario, position);
        Self::at(scenario, origin)
    }

    /// The square laid so that the paper's (0, 0) is at `origin`: north, east, m in the vehicle's local frame.
    #[must_use]
    pub fn at(scenario: Scenario, origin: [f32; 2]) -> Self {
        // The seed draws nothing: the other autopilot has gusts of its own.
        let mut sim = Sim::new(scenario, 0);
        sim.set_control(Control::External);
        Self { sim, origin }
    }

    /// The paper's (0, 0) if `position` is the scenario's start.
    #[must_use]
    pub fn origin_at_start(scenario: &Scenario, position: [f32; 2]) -> [f32; 2] {
        let start = scenario.scale.ned_from_paper(scenario.start);
        [position[0] - start[0], position[1] - start[1]]
    }

    /// The paper's (0, 0) in the vehicle's local frame: north, east, m.
    #[must_use]
    pub fn origin(&self) -> [f32; 2] {
        self.origin
    }

    /// The tick that begins now.
    #[must_use]
    pub fn tick(&self) -> Tick {
        self.sim.tick()
    }

    /// The percept of a vehicle at `position` with `velocity`: north, east, m and m/s in its local frame.
    pub fn percept(&mut self, position: [f32; 2], velocity: [f32; 2]) -> Percept {
        let scale = self.sim.scenario().scale;
        let position = [position[0] - self.origin[0], position[1] - self.origin[1]];
        self.sim
            .place(State { r: scale.paper_from_ned(position), v: scale.paper_from_ned_velocity(velocity) });
        self.sim.percept()
    }

    /// Distance from `position` to the square's edges: north and east, each downwards and upwards, m;
    /// negative outside.
    #[must_use]
    pub fn room(&self, position: [f32; 2]) -> [[f64; 2]; 2] {
        let corner = |at| self.sim.scenario().scale.ned_from_paper(Vector2::repeat(at));
        let (low, high) = (corner(0.0), corner(1.0));
        std::array::from_fn(|axis| {
            let here = position[axis] - self.origin[axis];
            let (low, high) = (low[axis].min(high[axis]), low[axis].max(high[axis]));
            [f64::from(here - low), f64::from(high - here)]
        })
    }

    /// How far outside the paper's square the vehicle is, units; negative inside.
    #[must_use]
    pub fn outside(&self) -> f64 {
        let r = self.sim.world().uav.r;
        [-r.x, r.x - 1.0, -r.y, r.y - 1.0].into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// A control interval passes with this command, or with an older one if the radio does not carry it.
    /// Returns the acceleration to fly, north, east, m/s², within the scenario's limit on each axis.
    pub fn pass(&mut self, command: &Command) -> [f64; 2] {
        self.sim.handle(*command);
        self.sim.advance();
        let scenario = self.sim.scenario();
        let a = scenario.dynamics.a_max * self.sim.flown();
        scenario.scale.ned_from_paper_acceleration(a).map(f64::from)
    }

    /// A control interval passes without a percept.
    pub fn skip(&mut self) {
        self.sim.step();
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Sim;
    use crpl_sitl::units::TxPower;

    use super::*;

    /// What our own vehicle would show at the same place.
    #[test]
    fn a_scene_is_what_sitl_shows_wherever_the_vehicle_stands() {
        let scenario = Scenario::default();
        let sim = Sim::new(scenario.clone(), 0);
        let mut scene = ForeignScene::new(scenario, [-300.0, 1200.0]);
        let seen = scene.percept([-300.0, 1200.0], [0.0; 2]);
        assert_eq!(seen.frame.rgb(), sim.percept().frame.rgb());
        for (a, b) in seen.telemetry.position.iter().zip(sim.telemetry().position) {
            assert!((a - b).abs() < 1e-3);
        }
        assert_eq!(seen.telemetry.obstacles, sim.telemetry().obstacles);
    }

    /// One radio: behind the obstacle this scene loses the packet that `sitl` loses there.
    #[test]
    fn an_outage_holds_the_last_action() {
        let mut scenario = Scenario::default();
        scenario.radio.b_dt = 2.0;
        let mut scene = ForeignScene::new(scenario.clone(), [0.0; 2]);
        let command = |tick, north, power| Command::new(Tick(tick), [north, 0.0], power);
        let start = scene.percept([0.0; 2], [0.0; 2]).telemetry.position;
        assert_eq!(scene.pass(&command(0, 2.0, TxPower::High)), [2.0, 0.0]);
        let shadow = scenario.scale.ned_from_paper(Vector2::new(0.5, 0.7));
        let behind = [shadow[0] - start[0], shadow[1] - start[1]];
        assert!(!scene.percept(behind, [0.0; 2]).telemetry.link.is_none_or(|link| link.outage));
        assert_eq!(scene.pass(&command(1, -2.0, TxPower::Low)), [2.0, 0.0]);
        let told = scene.percept(behind, [0.0; 2]).telemetry;
        assert_eq!(told.held.map(|held| held.tick), Some(Tick(0)));

        let mut sim = Sim::new(scenario, 0);
        sim.set_control(Control::External);
        sim.place(State::at_rest(Vector2::new(0.5, 0.7)));
        sim.handle(command(0, -2.0, TxPower::Low));
        sim.transmit();
        assert_eq!(sim.telemetry().link, told.link);
        assert!(told.link.is_some_and(|link| link.outage));
    }
}
