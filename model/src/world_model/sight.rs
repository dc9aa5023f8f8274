//! Either encoder of a world model: the learned one, or the hand-set one that reads centroids of colours.

use std::cell::RefCell;

use crpl_sitl::camera::{Frame, SIDE};
use nalgebra::Vector2;

use crate::encoder::infer::{Encoder, Latent};
use crate::encoder::votes::noise::ReadingNoise;
use crate::encoder::votes::{Activations, BODIES, VoteEncoder, VoteWeights, Votes};
use crate::encoder::weights::{LATENT, Weights, from_plane, on_plane, vector};
use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};
use crate::predictor::observer::{self, FRAME_NOISE, LatentReading};

/// E_c and E_u.
pub type LatentPlanes = [[[f32; 2]; LATENT]; BODIES];

/// Frame to latents.
#[derive(Debug, Clone)]
pub enum FrameEncoder {
    /// Hand-set kernels that carry centroids of colours, with heads in closed form: for the clean drawing.
    Centroid(Box<Encoder>),
    /// Trained end to end from random weights on recorded pictures.
    Learned(Box<LearnedSight>),
}

/// The learned encoder and what it knows of its own errors.
#[derive(Debug, Clone)]
pub struct LearnedSight {
    /// The network.
    pub encoder: VoteEncoder,
    /// How far a reading is off.
    pub noise: ReadingNoise,
}

thread_local! {
    /// A megabyte that is not allocated for every frame.
    static ACTIVATIONS: RefCell<Activations> = RefCell::default();
}

impl LearnedSight {
    /// What the votes say of one frame.
    #[must_use]
    pub fn votes(&self, frame: &Frame) -> Votes {
        ACTIVATIONS.with_borrow_mut(|activations| {
            activations.set_frame(frame);
            self.encoder.read(activations)
        })
    }
}

/// y = S (p - 50)/100: a place in the picture, px, in plane coordinates.
#[must_use]
pub fn plane_of_px(p: [f32; 2], scale: f64) -> [f32; 2] {
    p.map(|p| (scale * (f64::from(p) / SIDE as f64 - 0.5)) as f32)
}

impl FrameEncoder {
    /// Its name in tables and on the command line.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Centroid(_) => "centroid",
            Self::Learned(_) => "learned",
        }
    }

    /// The hand-set encoder, if it is that.
    #[must_use]
    pub fn centroid(&self) -> Option<&Encoder> {
        match self {
            Self::Centroid(encoder) => Some(encoder),
            Self::Learned(_) => None,
        }
    }

    /// The learned encoder, if it is that.
    #[must_use]
    pub fn learned(&self) -> Option<&LearnedSight> {
        match self {
            Self::Centroid(_) => None,
            Self::Learned(sight) => Some(sight),
        }
    }

    /// Number of trained values.
    #[must_use]
    pub fn parameters(&self) -> usize {
        match self {
            Self::Centroid(encoder) => encoder.weights().parameters(),
            Self::Learned(sight) => sight.encoder.weights().parameters(),
        }
    }

    /// z_c and z_u of one frame.
    #[must_use]
    pub fn encode(&self, frame: &Frame, planes: &LatentPlanes, scale: f64) -> Latent {
        match self {
            Self::Centroid(encoder) => encoder.encode(frame),
            Self::Learned(sight) => {
                let [c, u] = sight.votes(frame).p.map(|p| plane_of_px(p, scale));
                Latent { z_c: from_plane(&planes[0], c), z_u: from_plane(&planes[1], u) }
            }
        }
    }

    /// What the observer reads of one frame: y_c and y_u, each with its error.
    #[must_use]
    pub fn see(&self, frame: &Frame, planes: &LatentPlanes, scale: f64) -> [LatentReading; BODIES] {
        match self {
            Self::Centroid(encoder) => {
                let features = encoder.features(frame);
                let sigma_scale = observer::sigma_scale(features.missing[0]);
                let latent = encoder.read(features);
                let y = |n: usize, z: &[f32; LATENT]| -> Vector2<f64> { vector(on_plane(&planes[n], z)) };
                [LatentReading { y: y(0, &latent.z_c), sigma_scale }, y(1, &latent.z_u).into()]
            }
            Self::Learned(sight) => {
                let votes = sight.votes(frame);
                [0, 1].map(|body| {
                    let sigma = sight.noise.sigma_px(body, votes.spread[body]) / SIDE as f64;
                    LatentReading {
                        y: vector(plane_of_px(votes.p[body], scale)),
                        sigma_scale: sigma / FRAME_NOISE,
                    }
                })
            }
        }
    }
}

impl Stored for FrameEncoder {
    fn put(&self, out: &mut Writer) {
        match self {
            Self::Centroid(encoder) => encoder.weights().put(out),
            Self::Learned(sight) => {
                sight.encoder.weights().put(out);
                sight.noise.put(out);
            }
        }
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        if from.has("votes.vote.weight") {
            let encoder = VoteEncoder::new(VoteWeights::get(from)?);
            Ok(Self::Learned(Box::new(LearnedSight { encoder, noise: ReadingNoise::get(from)? })))
        } else {
            Ok(Self::Centroid(Box::new(Encoder::new(Weights::get(from)?))))
        }
    }
}
