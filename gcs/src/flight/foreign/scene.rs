//! What CRPL sees of a foreign vehicle: its place in the paper's square, drawn as `sitl` draws it, with
//! the obstacle of the scenario; and the modelled radio between station and vehicle.

use crpl_sitl::radio::Gate;
use crpl_sitl::radio::message::{Command, LinkReport, Percept, Telemetry};
use crpl_sitl::units::Tick;
use crpl_sitl::world::World;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::{Scenario, camera};
use nalgebra::Vector2;

/// The scene of one flight.
#[derive(Debug, Clone)]
pub struct Scene {
    scenario: Scenario,
    world: World,
    gate: Gate,
    tick: Tick,
    link: Option<LinkReport>,
    /// The paper's (0, 0) in the vehicle's local frame: north, east, m.
    origin: [f32; 2],
}

impl Scene {
    /// The square laid so that `position` (north, east, m) is the scenario's start.
    #[must_use]
    pub fn new(scenario: Scenario, position: [f32; 2]) -> Self {
        let start = scenario.scale.ned_from_paper(scenario.start);
        Self {
            world: World::new(&scenario),
            gate: Gate::default(),
            tick: Tick::default(),
            link: None,
            origin: [position[0] - start[0], position[1] - start[1]],
            scenario,
        }
    }

    /// The tick that begins now.
    #[must_use]
    pub fn tick(&self) -> Tick {
        self.tick
    }

    /// The vehicle is here now, flying so: north, east, m and m/s in its local frame.
    pub fn percept(&mut self, position: [f32; 2], velocity: [f32; 2]) -> Percept {
        let scale = &self.scenario.scale;
        let position = [position[0] - self.origin[0], position[1] - self.origin[1]];
        self.world.uav =
            State { r: scale.paper_from_ned(position), v: scale.paper_from_ned_velocity(velocity) };
        let telemetry = Telemetry {
            tick: self.tick,
            position,
            velocity,
            obstacle: scale.ned_from_paper(self.world.obstacle.r),
            second_obstacle: self.world.second_obstacle.map(|o| scale.ned_from_paper(o.r)),
            held: self.gate.held(),
            link: self.link,
        };
        Percept { telemetry, frame: camera::picture(&self.world, &self.scenario).into() }
    }

    /// How far it is from `position` to the square's edges: north and east, each downwards and upwards,
    /// m; negative outside.
    #[must_use]
    pub fn room(&self, position: [f32; 2]) -> [[f64; 2]; 2] {
        let corner = |at| self.scenario.scale.ned_from_paper(Vector2::repeat(at));
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
        let r = self.world.uav.r;
        [-r.x, r.x - 1.0, -r.y, r.y - 1.0].into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// A control interval passes with this command, or with an older one if the radio does not carry
    /// it; gives the acceleration to be flown, north, east, m/s².
    pub fn pass(&mut self, command: &Command) -> [f64; 2] {
        self.gate.submit(*command);
        let snr = self.world.snr(self.gate.power(), &self.scenario);
        self.link = Some(self.gate.transmit(self.tick, snr, &self.scenario.radio));
        self.skip();
        self.flown()
    }

    /// A control interval passes without a percept, as the clock went on.
    pub fn skip(&mut self) {
        self.world.step_obstacles(&self.scenario);
        self.tick = self.tick.next();
    }

    /// What is flown, within the scenario's limit on each axis.
    fn flown(&self) -> [f64; 2] {
        let Some(held) = self.gate.held() else { return [0.0; 2] };
        let scale = &self.scenario.scale;
        let a_max = self.scenario.dynamics.a_max;
        let paper = scale.paper_from_ned_acceleration(held.accel).map(|a| a.clamp(-a_max, a_max));
        scale.ned_from_paper_acceleration(Vector2::new(paper.x, paper.y)).map(f64::from)
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
        let mut scene = Scene::new(scenario, [-300.0, 1200.0]);
        let seen = scene.percept([-300.0, 1200.0], [0.0; 2]);
        assert_eq!(seen.frame.rgb(), sim.percept().frame.rgb());
        for (a, b) in seen.telemetry.position.iter().zip(sim.telemetry().position) {
            assert!((a - b).abs() < 1e-3);
        }
        assert_eq!(seen.telemetry.obstacle, sim.telemetry().obstacle);
    }

    #[test]
    fn an_outage_holds_the_last_action() {
        let mut scenario = Scenario::default();
        let mut scene = Scene::new(scenario.clone(), [0.0; 2]);
        scene.percept([0.0; 2], [0.0; 2]);
        let command = |tick, north| Command::new(tick, [north, 0.0], TxPower::High);
        assert_eq!(scene.pass(&command(Tick(0), 2.0)), [2.0, 0.0]);
        scenario.radio.b_dt = 1e-3;
        scene.scenario = scenario;
        scene.percept([0.0; 2], [0.0; 2]);
        assert_eq!(scene.pass(&command(Tick(1), -2.0)), [2.0, 0.0]);
        assert!(scene.percept([0.0; 2], [0.0; 2]).telemetry.link.unwrap().outage);
    }
}
