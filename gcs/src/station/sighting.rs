//! What a frame shows, as the observer reads it: encoded on the ground, or on board and sent as latents.

use crpl_model::encoder::weights::{LATENT, from_plane, on_plane, vector};
use crpl_model::predictor::observer::{FRAME_NOISE, LatentReading};
use crpl_model::world_model::WorldModel;
use crpl_sitl::camera::{COLOURS, Frame};
use crpl_sitl::radio::message::{Percept, SentLatent, SentLatents};
use crpl_sitl::units::Tick;

/// The readings of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// y_c.
    pub c: LatentReading,
    /// y_u of each obstacle that the frames tell apart.
    pub u: Vec<LatentReading>,
}

impl Sighting {
    /// Encodes a frame of a world with so many obstacles.
    #[must_use]
    pub fn of(world: &WorldModel, frame: &Frame, obstacles: usize) -> Self {
        let seen = obstacles.min(COLOURS);
        if seen < 2 {
            let [c, u] = world.see(frame);
            return Self { c, u: vec![u; seen] };
        }
        let one_each = frame.one_obstacle_each();
        let mut readings = one_each.iter().map(|frame| world.see(frame)).peekable();
        let c = readings.peek().map_or(LatentReading::from(nalgebra::Vector2::zeros()), |[c, _]| *c);
        Self { c, u: readings.map(|[_, u]| u).take(seen).collect() }
    }

    /// What a percept of a world with so many obstacles shows: its latents, or its frame encoded here.
    #[must_use]
    pub fn of_percept(world: &WorldModel, percept: &Percept, obstacles: usize) -> Option<Self> {
        match &percept.latents {
            Some(latents) => Self::of_latents(world, latents),
            None => Some(Self::of(world, &percept.frame, obstacles)),
        }
    }

    /// As latents to be sent: z_c, then z_u of each obstacle.
    #[must_use]
    pub fn to_latents(&self, world: &WorldModel, tick: Tick) -> SentLatents {
        let sent = |plane, reading: &LatentReading| SentLatent {
            z: from_plane(plane, [reading.y.x as f32, reading.y.y as f32]),
            sigma_scale: reading.sigma_scale as f32,
            half_step: 0.0,
        };
        let c = sent(&world.plane_c, &self.c);
        let u = self.u.iter().map(|u| sent(&world.plane_u, u));
        SentLatents { tick, vectors: std::iter::once(c).chain(u).collect() }
    }

    /// What was read on board. What the quantising adds to its error is added here: an integer's error is even in
    /// its step, s²/12 in each number, and the plane's columns are orthonormal. `None` without a z_c.
    #[must_use]
    pub fn of_latents(world: &WorldModel, latents: &SentLatents) -> Option<Self> {
        let noise = world.scale * FRAME_NOISE;
        let reading = |plane: &[[f32; 2]; LATENT], sent: &SentLatent| {
            let added = f64::from(sent.half_step) / 3f64.sqrt() / noise;
            LatentReading {
                y: vector(on_plane(plane, &sent.z)),
                sigma_scale: f64::from(sent.sigma_scale).hypot(added),
            }
        };
        let (c, u) = latents.vectors.split_first()?;
        Some(Self {
            c: reading(&world.plane_c, c),
            u: u.iter().map(|u| reading(&world.plane_u, u)).collect(),
        })
    }
}
