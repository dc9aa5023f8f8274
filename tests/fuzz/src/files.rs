//! Files that people write, and files that programs have written and a disk has damaged.

use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;

use crpl_gcs::tools::param::value::{Encoding, Kind, Number};
use crpl_gcs::tools::{mission, param, replay};
use crpl_model::encoder::weights::vector;
use crpl_model::planning::policy::Policies;
use crpl_model::predictor::Begin;
use crpl_model::world_model::WorldModel;
use crpl_sitl::link::param_file;
use crpl_sitl::radio::air::track::GeometryTrack;
use crpl_sitl::radio::air::{Air, AirRadio, Way};
use crpl_sitl::sim::metric::Metric;
use crpl_sitl::sim::record::Record;
use crpl_sitl::{Scenario, Sim, camera};

use crate::bytes::Choices;

/// Pictures and buildings are files that a file names: not those of this machine.
fn names_a_file(text: &str) -> bool {
    ["picture", "buildings", "file", "ground"].iter().any(|word| text.contains(word))
}

/// A mission: a plan or WPL.
pub fn mission(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(plan) = mission::file::parse(text) else { return };
    for home_first in [false, true] {
        let Ok(items) = plan.items_for(home_first) else { continue };
        for (k, item) in items.iter().enumerate() {
            let _ = item.to_message(k as u16, (1, 1));
        }
        let _ = mission::file::MissionPlan::downloaded(items, home_first);
    }
}

/// A parameter file, of both programs.
pub fn params(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = param_file::parse(text);
    for line in param::file::parse(text).unwrap_or_default() {
        for kind in (0..=10).map(Kind::of) {
            let Ok(number) = Number::parse(&line.value, kind) else { continue };
            for encoding in [Encoding::CCast, Encoding::Bytewise] {
                let Ok(bytes) = number.encode(encoding) else { continue };
                let _ = Number::decode(bytes, kind, encoding);
            }
        }
    }
}

/// A scenario. One that is accepted can be flown, and every number of it stays one.
pub fn scenario(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(scenario) = Scenario::from_toml(text) else { return };
    if names_a_file(text) {
        return;
    }
    let mut sim = Sim::new(scenario, 0);
    for _ in 0..3 {
        let report = sim.telemetry();
        assert!(report.position.iter().chain(report.velocity.iter()).all(|x| x.is_finite()), "{report:?}");
        sim.advance();
    }
}

/// A radio, or a track. A radio that is accepted settles every frame.
pub fn radio(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = GeometryTrack::parse(text);
    let Ok(radio) = AirRadio::parse(text, "fuzz") else { return };
    if names_a_file(text) {
        return;
    }
    let Ok(mut air) = Air::new(radio, 1, 0) else { return };
    air.set_place([100.0, 50.0, 30.0]);
    for k in 0..8 {
        air.offer(Duration::from_millis(k), Way::BOTH[k as usize % 2], 0, 40, k);
    }
    let mut settled = 0;
    for _ in 0..200 {
        let Some(next) = air.next_event() else { break };
        air.poll(next, |_| settled += 1);
    }
    assert!(settled <= 8);
}

/// Files of the shipped models, in which the engine changes bytes.
static SHIPPED: LazyLock<[&[u8]; 3]> = LazyLock::new(|| {
    [
        include_bytes!("../../../model/pretrained/policy_s2.safetensors"),
        include_bytes!("../../../model/pretrained/learned/model.safetensors"),
        include_bytes!("../../../model/pretrained/learned/config.json"),
    ]
});

/// The engine's bytes as a file, or as changes of a shipped file: two bytes of place, one of value.
fn damaged(choices: &mut Choices<'_>, shipped: &[u8]) -> Vec<u8> {
    let mut bytes = shipped.to_vec();
    while !choices.is_empty() {
        let (place, value) = (usize::from(choices.short()), choices.byte());
        let place = place % bytes.len();
        bytes[place] = value;
    }
    bytes
}

/// A policy, and a world model's tensors and configuration. What is accepted can be computed with.
pub fn checkpoint(data: &[u8]) {
    let mut choices = Choices::new(data);
    let what = choices.byte();
    let [policy, tensors, config] = *SHIPPED;
    match what % 4 {
        0 => {
            let _ = Policies::from_bytes(choices.rest());
        }
        1 => {
            let Ok(policy) = Policies::from_bytes(&damaged(&mut choices, policy)) else { return };
            let _ = policy.act(&[0.5; 6]);
        }
        2 => see(&damaged(&mut choices, tensors), config),
        _ => see(tensors, &damaged(&mut choices, config)),
    }
}

/// Reads a world model, a frame by it, and rolls it out.
fn see(tensors: &[u8], config: &[u8]) {
    let Ok(world) = WorldModel::from_bytes(tensors, config, Path::new("fuzz")) else { return };
    let scenario = Scenario::default();
    let frame = camera::render(scenario.start, scenario.goal, &scenario);
    let now = vector(world.y_c(&world.encode(&frame)));
    let _ = world.predictor.rollout(Begin { now, before: now, actions: &[scenario.goal; 3] });
}

/// Records of a flight.
pub fn record(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let scenario = Scenario::default();
    let _ = replay::from_records(text, &scenario);
    let lines = text.lines().filter_map(|line| serde_json::from_str::<Record>(line).ok());
    let records: Vec<Record> = lines.collect();
    for metric in Metric::compared() {
        let _ = metric.of(&records, &scenario);
    }
}
