//! One frame through the learned encoder beside ONNX Runtime on the same exported weights, one thread each, in one
//! run: three rounds in turn.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use crpl_model::encoder::BuiltIn;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::camera::{CameraConfig, Film};
use crpl_sitl::units::Tick;
use crpl_sitl::world::World;
use tests::{interchange, python};

const ROUNDS: usize = 3;

fn main() -> Result<()> {
    let model = WorldModel::built_in(BuiltIn::Learned)?;
    let dir = tempfile::tempdir()?;
    let (checkpoint, vectors) = (dir.path().join("checkpoint"), dir.path().join("vectors.safetensors"));
    model.save(&checkpoint)?;
    interchange::write_vectors(&model, &vectors)?;
    let scenario = Scenario::default();
    let poses = World::new(&scenario).poses(&scenario);
    let camera = CameraConfig::case("hard").context("the camera `hard` has a name")?;
    let frame = Film::new(&camera, 1).frame(Tick(0), &poses);
    for round in 1..=ROUNDS {
        let mut times: Vec<f64> = (0..9)
            .map(|_| {
                let start = Instant::now();
                for _ in 0..60 {
                    black_box(model.encode(black_box(&frame)));
                }
                start.elapsed().as_secs_f64() / 60.0 * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let onnx = dir.path().join("encoder.onnx");
        let out = python::torch_script("world_model.py", &[&checkpoint, &vectors, &onnx])?.good()?;
        let theirs: f64 = out
            .lines()
            .find_map(|line| line.strip_prefix("ONNX Runtime: ")?.split(' ').next()?.parse().ok())
            .context("the script prints no time")?;
        let ours = times[times.len() / 2];
        println!(
            "round {round}: ours {ours:.4} ms, ONNX Runtime {theirs:.4} ms a frame, ratio {:.2}",
            ours / theirs
        );
    }
    Ok(())
}
