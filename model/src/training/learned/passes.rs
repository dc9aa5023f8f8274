//! The passes of a training step through the encoder: forward online, forward target, backward.
//!
//! [`CpuPasses`] is our own code, the default; `device` has burn's, for a GPU. Everything else of a step is the same.

use rayon::prelude::*;

use crate::encoder::votes::network::Scratch;
use crate::encoder::votes::{
    Activations, BODIES, VoteEncoder, VoteGradient, VoteWeights, Votes, VotesGradient,
};
use crate::training::learned::batch::{DrawnPictures, PIXELS};
use crate::world_model::learned::LearnedConfig;

/// Pictures whose gradients are summed one after the other; chunks run side by side and are added in their order,
/// so the number of threads changes no bit.
const CHUNK: usize = 12;

/// What runs the encoder in a step.
pub trait Passes {
    /// The online encoder's readings of all pictures, in the recording's coordinates; kept for [`Passes::backward`].
    fn look(&mut self, online: &VoteWeights, drawn: &DrawnPictures) -> Vec<Votes>;

    /// The target's places in the third pictures, in the recording's coordinates, px.
    fn aim(&mut self, target: &VoteWeights, drawn: &DrawnPictures) -> Vec<[[f32; 2]; BODIES]>;

    /// The gradient by the online weights, of all pictures of the last [`Passes::look`].
    fn backward(&mut self, drawn: &DrawnPictures, by: &[VotesGradient]) -> VoteWeights;
}

/// Our own passes, on all threads of rayon's pool.
pub struct CpuPasses {
    online: Option<VoteEncoder>,
    slots: Vec<Slot>,
    chunks: Vec<(VoteGradient, Scratch)>,
}

/// Forward pass of one picture, kept for the backward pass.
#[derive(Default)]
struct Slot {
    activations: Activations,
    pixels: Vec<f32>,
}

impl CpuPasses {
    /// Room for a step of this configuration.
    #[must_use]
    pub fn new(config: &LearnedConfig) -> Self {
        let pictures = 6 * config.triples;
        Self {
            online: None,
            slots: (0..pictures).map(|_| Slot { pixels: vec![0.0; PIXELS], ..Slot::default() }).collect(),
            chunks: (0..pictures.div_ceil(CHUNK)).map(|_| Default::default()).collect(),
        }
    }
}

impl Passes for CpuPasses {
    fn look(&mut self, online: &VoteWeights, drawn: &DrawnPictures) -> Vec<Votes> {
        let online = self.online.insert(VoteEncoder::new(online.clone()));
        let each = self.slots.par_iter_mut().enumerate().map(|(k, Slot { activations, pixels })| {
            drawn.seen(k, pixels);
            activations.set_pixels(pixels.iter().copied());
            drawn.undo(k, online.forward(activations))
        });
        each.collect()
    }

    fn aim(&mut self, target: &VoteWeights, drawn: &DrawnPictures) -> Vec<[[f32; 2]; BODIES]> {
        let target = VoteEncoder::new(target.clone());
        let each = drawn.third().into_par_iter().map_init(
            || (Activations::default(), vec![0.0; PIXELS]),
            |(activations, pixels), k| {
                drawn.flips[k].pixels(&drawn.frames[k], pixels);
                activations.set_pixels(pixels.iter().copied());
                drawn.undo(k, target.forward(activations)).p
            },
        );
        each.collect()
    }

    fn backward(&mut self, drawn: &DrawnPictures, by: &[VotesGradient]) -> VoteWeights {
        let Self { online: Some(online), slots, chunks } = self else { return VoteWeights::zeros() };
        let by = drawn.redo(by);
        let pictures = slots.par_chunks_mut(CHUNK).zip(by.par_chunks(CHUNK));
        pictures.zip(chunks.par_iter_mut()).for_each(|((slots, by), (gradient, scratch))| {
            gradient.clear();
            for (slot, by) in slots.iter_mut().zip(by) {
                online.backward(&slot.activations, by, scratch, gradient);
            }
        });
        let mut sum = VoteGradient::default();
        chunks.iter().for_each(|(gradient, _)| sum.add(gradient));
        sum.unpacked()
    }
}
