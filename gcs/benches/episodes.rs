//! Closed-loop flights a second on one core, in process, every picture rendered and encoded; and what a control
//! interval spends on rendering, on encoding and on the rest.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

mod rate;

use std::hint::black_box;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use crpl_gcs::lab::Contender;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::camera::Frame;
use crpl_sitl::{Scenario, Sim};

fn main() {
    let models = Models::load(None, None).expect("the shipped world model");
    let scenario = Scenario::named("demo").expect("a preset");
    for controller in Controller::value_variants() {
        // A controller that has no policy for this scenario cannot be measured in it.
        let Ok(contender) = Contender::new(&models, *controller, &scenario) else { continue };
        let mut seed = 0;
        rate::rate(&format!("flights, {controller}"), "episodes", 1, || {
            seed += 1;
            black_box(contender.fly(seed).expect("a flight"));
        });
    }
    shares(&models, &scenario);
}

/// Where the time of a CRPL flight goes: the same pictures are rendered and encoded again alone.
fn shares(models: &Models, scenario: &Scenario) {
    let flights = if std::env::args().any(|arg| arg == "--bench") { 100 } else { 1 };
    let contender = Contender::new(models, Controller::Crpl, scenario).expect("the shipped policy");
    let [mut whole, mut render, mut encode] = [Duration::ZERO; 3];
    for seed in 0..flights {
        let records = timed(&mut whole, || contender.records(seed).expect("a flight"));
        let scenes: Vec<Sim> = records
            .iter()
            .map(|record| {
                let mut there = scenario.clone();
                (there.start, there.obstacles[0].position) = (record.r, record.obstacles[0]);
                Sim::new(there, 0)
            })
            .collect();
        let frames: Vec<Frame> = timed(&mut render, || scenes.iter().map(Sim::frame).collect());
        timed(&mut encode, || {
            for frame in &frames {
                black_box(models.world.encode(frame));
            }
        });
    }
    let intervals = (flights * scenario.horizon) as f64;
    let micros = |time: Duration| time.as_secs_f64() * 1e6 / intervals;
    let rest = whole.saturating_sub(render + encode);
    println!("crpl, an interval: {:.1} us", micros(whole));
    for (name, time) in [("render", render), ("encode", encode), ("policy, world, radio, records", rest)] {
        let share = 100.0 * time.as_secs_f64() / whole.as_secs_f64();
        println!("  {name:<30} {:>8.1} us  {share:>5.1} %", micros(time));
    }
}

fn timed<T>(sum: &mut Duration, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let done = work();
    *sum += start.elapsed();
    done
}
