//! What a stranger needs to check a checkpoint: pictures, and the latents and rollouts that our program makes of them.

use std::path::Path;

use anyhow::Result;
use crpl_model::encoder::weights::LATENT;
use crpl_model::numeric::tensors::{Writer, write_all};
use crpl_model::predictor::linear::Half;
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::dataset::{self, EpisodeStart};
use crpl_sitl::Scenario;
use crpl_sitl::camera::effects::{Effects, FrameId};
use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use crpl_sitl::world::noise::Noise;

/// Episodes whose first picture is encoded and whose actions are rolled out.
const COUNT: usize = 12;

/// Steps of a rollout.
const HORIZON: usize = 100;

/// Pictures by the clean and by a harder camera, some with a cut disc, their latents, and rollouts.
///
/// # Errors
/// If the file cannot be written.
pub fn write_vectors(model: &WorldModel, path: &Path) -> Result<()> {
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
    Ok(write_all(path, &out.bytes()?)?)
}
