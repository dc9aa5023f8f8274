//! Control intervals per second of the simulator without its camera, on one core.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use sitl::msg::{Command, Motion, TxPower};
use sitl::{Scenario, Sim};

const TICKS: u64 = 1000;

/// A flight of [`TICKS`] intervals, each with a command and, if `telemetry`, a report.
fn fly(mut sim: Sim, accels: &[[f32; 2]; 5], telemetry: bool) -> Sim {
    for k in 0..TICKS {
        let accel = accels[(k / 7 % 5) as usize];
        sim.handle(Command { tick: sim.tick(), accel, power: TxPower::Low });
        sim.advance();
        if telemetry {
            std::hint::black_box(sim.telemetry());
        }
    }
    sim
}

fn steps(c: &mut Criterion) {
    let mut group = c.benchmark_group("sim");
    group.throughput(Throughput::Elements(TICKS));
    for (name, sigma_c, telemetry) in
        [("calm", 0.0, false), ("gusts", 0.005, false), ("gusts and telemetry", 0.005, true)]
    {
        let mut scenario = Scenario::default();
        scenario.disturbance.sigma_c = sigma_c;
        let a_max = scenario.dynamics.a_max;
        let accels = Motion::ALL.map(|m| scenario.scale.ned_from_paper_acceleration(m.vector() * a_max));
        group.bench_function(name, |b| {
            let new = || Sim::new(scenario.clone(), 1);
            b.iter_batched(new, |sim| fly(sim, &accels, telemetry), BatchSize::SmallInput);
        });
    }
    group.finish();
}

criterion_group!(benches, steps);
criterion_main!(benches);
