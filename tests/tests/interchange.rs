//! A stranger reads our checkpoints: PyTorch and ONNX Runtime compute what our program computes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use crpl_model::encoder::BuiltIn;
use crpl_model::encoder::weights::Colour;
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::sight::FrameEncoder;
use tests::{interchange, python};

#[test]
fn pytorch_and_onnx_runtime_compute_what_we_compute() {
    agrees(&WorldModel::built_in(BuiltIn::Centroid).unwrap());
}

#[test]
fn so_they_do_with_the_learned_encoder() {
    agrees(&WorldModel::built_in(BuiltIn::Learned).unwrap());
}

#[test]
fn so_they_do_behind_a_colour_layer() {
    let mut model = WorldModel::built_in(BuiltIn::Centroid).unwrap();
    let mut weights = model.encoder.centroid().expect("the shipped encoder").weights().clone();
    weights.input.colour = Some(Colour { w: [[1.0, -0.03, -0.04], [0.06, -0.03, 1.0]], b: [-0.1, -0.08] });
    model.encoder = FrameEncoder::Centroid(Box::new(crpl_model::encoder::infer::Encoder::new(weights)));
    agrees(&model);
}

fn agrees(model: &WorldModel) {
    let dir = tempfile::tempdir().unwrap();
    let (checkpoint, vectors) = (dir.path().join("checkpoint"), dir.path().join("vectors.safetensors"));
    model.save(&checkpoint).unwrap();
    interchange::write_vectors(model, &vectors).unwrap();
    let onnx = dir.path().join("encoder.onnx");
    let out =
        python::torch_script("world_model.py", &[&checkpoint, &vectors, &onnx]).unwrap().good().unwrap();
    assert_eq!(out.matches(": off by ").count(), 5, "{out}");
}
