//! One frame to its latents: the flight path, and burn for comparison.

mod rate;

use std::hint::black_box;

use crpl_model::encoder::BuiltIn;
use crpl_model::encoder::module::{self, Backend};
use crpl_model::encoder::votes::Activations;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use nalgebra::Vector2;

fn main() {
    let model = WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads");
    let scenario = Scenario::default();
    let frame = crpl_sitl::camera::render(Vector2::new(0.31, 0.62), scenario.obstacle().position, &scenario);
    rate::rate("encode, flight path, centroid", "frames", 1, || {
        black_box(model.encode(black_box(&frame)));
    });
    let learned = WorldModel::built_in(BuiltIn::Learned).expect("the shipped checkpoint reads");
    rate::rate("encode, flight path, learned", "frames", 1, || {
        black_box(learned.encode(black_box(&frame)));
    });
    let network = &learned.encoder.learned().expect("the learned encoder").encoder;
    let mut activations = Activations::default();
    rate::rate("encode, plain convolutions as in training, learned", "frames", 1, || {
        activations.set_frame(black_box(&frame));
        black_box(network.forward(&mut activations));
    });

    let device = Backend::Flex.device().expect("flex is always built");
    let weights = model.encoder.centroid().expect("the shipped encoder").weights();
    let encoder = module::EncoderModule::new(weights, &device);
    let frames = [frame];
    rate::rate("encode, burn-flex", "frames", 1, || {
        black_box(module::latents_of(&encoder, &weights.input, &device, black_box(&frames)));
    });
}
