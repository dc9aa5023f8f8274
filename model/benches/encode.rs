//! One picture to its latents: the flight path, and burn for comparison.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use model::jepa::{self, Backend};
use model::world_model::WorldModel;
use nalgebra::Vector2;
use sitl::Scenario;

fn encode(c: &mut Criterion) {
    let model = WorldModel::embedded().expect("the shipped checkpoint reads");
    let scenario = Scenario::default();
    let frame = sitl::camera::render(Vector2::new(0.31, 0.62), scenario.obstacle.position, &scenario);
    c.bench_function("encode/flight path", |b| b.iter(|| model.encode(black_box(&frame))));

    let device = Backend::Flex.device().expect("flex is always built");
    let weights = model.encoder.weights();
    let encoder = jepa::Encoder::new(weights, &device);
    let frames = [frame];
    c.bench_function("encode/burn-flex", |b| {
        b.iter(|| jepa::latents_of(&encoder, &weights.input, &device, black_box(&frames)));
    });
}

criterion_group!(benches, encode);
criterion_main!(benches);
