//! Control intervals per second of the simulator without its camera, on one core: a command, the radio,
//! the motion and, where it says so, the report. The aim is a million.

mod rate;

use std::hint::black_box;

use crpl_sitl::radio::message::Command;
use crpl_sitl::units::{Motion, TxPower};
use crpl_sitl::{Scenario, Sim};

const TICKS: u64 = 1000;

fn main() {
    for (name, sigma_c, telemetry) in
        [("calm", 0.0, false), ("gusts", 0.005, false), ("gusts and telemetry", 0.005, true)]
    {
        let mut scenario = Scenario::default();
        scenario.disturbance.sigma_c = sigma_c;
        let a_max = scenario.dynamics.a_max;
        let accels = Motion::ALL.map(|m| scenario.scale.ned_from_paper_acceleration(m.vector() * a_max));
        rate::rate(&format!("sim, {name}"), "steps", TICKS, || {
            let mut sim = Sim::new(scenario.clone(), 1);
            for k in 0..TICKS {
                let accel = accels[(k / 7 % 5) as usize];
                sim.handle(Command::new(sim.tick(), accel, TxPower::Low));
                sim.advance();
                if telemetry {
                    black_box(sim.telemetry());
                }
            }
            black_box(sim);
        });
    }
}
