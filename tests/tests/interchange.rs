//! A stranger reads our checkpoints: PyTorch and ONNX Runtime compute what our program computes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;

use crpl_model::world_model::sight::FrameEncoder;
use crpl_model::encoder::weights::{Colour, LATENT};
use crpl_model::numeric::tensors::{Writer, write_all};
use crpl_model::predictor::linear::Half;
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::dataset::{self, EpisodeStart};
use crpl_sitl::Scenario;
use crpl_sitl::camera::effects::{Effects, FrameId};
use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use crpl_sitl::world::noise::Noise;
use tests::python;

/// Episodes whose first picture is encoded and whose actions are rolled out.
const COUNT: usize = 12;

/// Steps of a rollout.
const HORIZON: usize = 100;

#[test]
fn pytorch_and_onnx_runtime_compute_what_we_compute() {
    agrees(&WorldModel::embedded().unwrap());
}

#[test]
fn so_they_do_behind_a_colour_layer() {
    let mut model = WorldModel::embedded().unwrap();
    let mut weights = model.encoder.centroid().expect("the shipped encoder").weights().clone();
    weights.input.colour = Some(Colour { w: [[1.0, -0.03, -0.04], [0.06, -0.03, 1.0]], b: [-0.1, -0.08] });
    model.encoder = FrameEncoder::Centroid(crpl_model::encoder::infer::Encoder::new(weights));
    agrees(&model);
}

fn agrees(model: &WorldModel) {
    let dir = tempfile::tempdir().unwrap();
    let (checkpoint, vectors) = (dir.path().join("checkpoint"), dir.path().join("vectors.safetensors"));
    model.save(&checkpoint).unwrap();
    write_vectors(model, &vectors);
    let onnx = dir.path().join("encoder.onnx");
    let out =
        python::torch_script("world_model.py", &[&checkpoint, &vectors, &onnx]).unwrap().good().unwrap();
    assert_eq!(out.matches(": off by ").count(), 5, "{out}");
}

/// Pictures by the clean and by a harder camera, some with a cut disc, their latents, and rollouts.
fn write_vectors(model: &WorldModel, path: &Path) {
    let (scenario, noise) = (Scenario::default(), Noise::new(77));
    let episodes = dataset::collect(COUNT, HORIZON, EpisodeStart::Edge, &scenario, &noise, 0);
    let frames: Vec<Frame> = episodes
        .iter()
        .enumerate()
        .map(|(n, episode)| {
            let clean = episode.frame(1, &scenario);
            let id = FrameId { series: n as u64, frame: 1 };
            if n % 2 == 0 { clean } else { Effects::mixed_colours().apply(clean, id, &noise) }
        })
        .collect();
    let latents: Vec<_> = frames.iter().map(|frame| model.encode(frame)).collect();
    let mut rollouts = Vec::with_capacity(COUNT * HORIZON * LATENT);
    for (latent, episode) in latents.iter().zip(&episodes) {
        let start = Half::from_fn(|k, _| f64::from(latent.z_c[k]));
        let (mut now, mut before) = (start, start);
        for action in &episode.actions {
            (now, before) = (model.linear.step_c(&now, &before, *action), now);
            rollouts.extend(now.iter().map(|z| *z as f32));
        }
    }
    let actions = episodes.iter().flat_map(|e| &e.actions).flat_map(|a| [a.x as f32, a.y as f32]);
    let mut out = Writer::default();
    let bytes = frames.iter().flat_map(|frame| frame.rgb().iter().map(|byte| f32::from(*byte)));
    out.f32("frames", &[COUNT, SIDE, SIDE, CHANNELS], bytes);
    out.f32("z_c", &[COUNT, LATENT], latents.iter().flat_map(|l| l.z_c));
    out.f32("z_u", &[COUNT, LATENT], latents.iter().flat_map(|l| l.z_u));
    out.f32("actions", &[COUNT, HORIZON, 2], actions);
    out.f32("rollout", &[COUNT, HORIZON, LATENT], rollouts);
    write_all(path, &out.bytes().unwrap()).unwrap();
}
