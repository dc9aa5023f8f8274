//! The passes of a training step by burn, on a device of its own: `model train --device`.
//!
//! Pictures go to the device and votes come back; the losses, Adam and the EMA stay on the CPU, in the code of every
//! other run. Sums on a GPU have another order, so a run there ends with other bytes than one on the CPU.

use burn::tensor::Device;
use rayon::prelude::*;

use crate::encoder::module::NoBackend;
use crate::encoder::votes::module::{VoteBatch, VoteModule};
use crate::encoder::votes::{BODIES, VoteWeights, Votes, VotesGradient};
use crate::training::learned::batch::{DrawnPictures, PIXELS};
use crate::training::learned::passes::{CpuPasses, Passes};
use crate::world_model::learned::LearnedConfig;

/// Where the learned encoder's passes run.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum EncoderDevice {
    /// The CPU, by our own code.
    #[default]
    Cpu,
    /// A GPU by Vulkan, Metal or DirectX, by burn-wgpu (cargo feature `wgpu`).
    Wgpu,
}

impl EncoderDevice {
    /// The passes there.
    ///
    /// # Errors
    /// If the device is not in this build.
    pub fn passes(self, config: &LearnedConfig) -> Result<Box<dyn Passes>, NoBackend> {
        match self {
            Self::Cpu => Ok(Box::new(CpuPasses::new(config))),
            Self::Wgpu => Ok(Box::new(DevicePasses::new(wgpu()?))),
        }
    }
}

#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device, NoBackend> {
    Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice))
}

#[cfg(not(feature = "wgpu"))]
fn wgpu() -> Result<Device, NoBackend> {
    Err(NoBackend { kind: "device", name: "wgpu" })
}

/// burn's passes on any of its devices.
pub struct DevicePasses {
    device: Device,
    online: Option<(VoteModule, VoteBatch)>,
}

impl DevicePasses {
    /// On `device`.
    #[must_use]
    pub fn new(device: Device) -> Self {
        Self { device, online: None }
    }
}

impl Passes for DevicePasses {
    fn look(&mut self, online: &VoteWeights, drawn: &DrawnPictures) -> Vec<Votes> {
        let seen = pictures(0..drawn.frames.len(), |k, pixels| drawn.seen(k, pixels));
        let device = self.device.clone().autodiff();
        let module = VoteModule::new(online, &device);
        let batch = module.forward(&slices(&seen), &device);
        let votes = batch.votes();
        self.online = Some((module, batch));
        votes.into_iter().enumerate().map(|(k, votes)| drawn.undo(k, votes)).collect()
    }

    fn aim(&mut self, target: &VoteWeights, drawn: &DrawnPictures) -> Vec<[[f32; 2]; BODIES]> {
        let recorded = pictures(drawn.third(), |k, pixels| drawn.flips[k].pixels(&drawn.frames[k], pixels));
        let batch = VoteModule::new(target, &self.device).forward(&slices(&recorded), &self.device);
        drawn.third().zip(batch.votes()).map(|(k, votes)| drawn.undo(k, votes).p).collect()
    }

    fn backward(&mut self, drawn: &DrawnPictures, by: &[VotesGradient]) -> VoteWeights {
        let Some((module, batch)) = self.online.take() else { return VoteWeights::zeros() };
        module.backward(batch, &drawn.redo(by), &self.device.clone().autodiff())
    }
}

/// Pictures `[100][100][3]`, each drawn by `draw`.
fn pictures(which: std::ops::Range<usize>, draw: impl Fn(usize, &mut [f32]) + Sync) -> Vec<Vec<f32>> {
    let one = |k| {
        let mut pixels = vec![0.0; PIXELS];
        draw(k, &mut pixels);
        pixels
    };
    which.into_par_iter().map(one).collect()
}

fn slices(pictures: &[Vec<f32>]) -> Vec<&[f32]> {
    pictures.iter().map(Vec::as_slice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(not(feature = "wgpu"))]
    #[test]
    fn a_device_that_is_not_built_in_is_refused_with_the_feature_to_build_it() {
        let refused = EncoderDevice::Wgpu.passes(&LearnedConfig::default()).err();
        let words = refused.map(|error| error.to_string());
        assert_eq!(
            words.as_deref(),
            Some("device wgpu is not in this build: build with the cargo feature `wgpu`")
        );
    }
}
