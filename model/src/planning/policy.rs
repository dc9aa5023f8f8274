//! CRPL's two policies π_s and π_p, and how they are executed.
//!
//! They see the latent state alone: its plane coordinates y_c (now and one interval ago) and y_u.
//! They know no positions, no bandwidth and no protocol.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crpl_sitl::units::{Motion, TxPower};
use nalgebra::Vector2;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::encoder::BuiltIn;
use crate::numeric::kernel;
use crate::numeric::mlp::{Dense, Mlp};
use crate::numeric::tensors::is_sane;
use crate::planning::scope::PolicyScope;

/// Key of [`PolicyAbout`] in a policy file's metadata, as JSON.
const ABOUT: &str = "policy";

/// Key of the world model's fingerprint in files that say nothing else.
const WORLD: &str = "world_model";

/// What a policy file says of itself.
#[derive(Debug, Default, Serialize, Deserialize)]
struct PolicyAbout {
    /// Fingerprint of the world model.
    world_model: String,
    /// The world that the policies were optimised for.
    scope: Option<PolicyScope>,
}

/// Number of inputs of each policy.
pub const FEATURES: usize = 6;

/// Widths of π_s: two hidden layers of 64, five motions (Sec. IV-A5).
pub const MOTION_WIDTHS: [usize; 4] = [FEATURES, 64, 64, 5];

/// Widths of π_p: two hidden layers of 64, two powers (Sec. IV-A5).
pub const POWER_WIDTHS: [usize; 4] = [FEATURES, 64, 64, 2];

/// The policies' view of M = 2 latents: `[2 y_c/S, (y_c - y_c')/(S v_max), y_u/2]`.
///
/// `y_c`, `y_c_before` and `y_u` are plane coordinates, `scale` is S (latent units per unit of
/// length), `v_max` in units per interval.
#[must_use]
pub fn features(y_c: [f32; 2], y_c_before: [f32; 2], y_u: [f32; 2], scale: f32, v_max: f32) -> [f32; 6] {
    let (place, speed) = (2.0 / scale, 1.0 / (scale * v_max));
    [
        place * y_c[0],
        place * y_c[1],
        speed * (y_c[0] - y_c_before[0]),
        speed * (y_c[1] - y_c_before[1]),
        0.5 * y_u[0],
        0.5 * y_u[1],
    ]
}

/// Probabilities of the actions from the network's outputs.
#[must_use]
pub fn softmax(logits: &[f32]) -> Vec<f32> {
    let top = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let weights: Vec<f32> = logits.iter().map(|l| kernel::exp(l - top)).collect();
    let sum: f32 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

/// π_s and π_p.
#[derive(Debug, Clone, PartialEq)]
pub struct Policies {
    /// π_s: features to the logits of [`Motion::ALL`].
    pub motion: Mlp,
    /// π_p: features to the logits of [`TxPower::ALL`].
    pub power: Mlp,
    /// Fingerprint of the world model whose latents they read; they mean nothing in another's.
    pub world: String,
    /// The scenario that they were optimised and checked for; `None` before the check, and in files of
    /// versions that did not say it.
    pub scope: Option<PolicyScope>,
}

/// Why a policy file could not be used.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The bytes are not these two networks.
    #[error("{path}: {message}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
}

/// Names and bytes of the policies that ship with the program: those of the centroid world model for Scenario 1
/// and 2, then those of the learned one.
pub const SHIPPED: [(&str, &[u8]); 4] = [
    ("pretrained/policy_s1.safetensors", include_bytes!("../../pretrained/policy_s1.safetensors")),
    ("pretrained/policy_s2.safetensors", include_bytes!("../../pretrained/policy_s2.safetensors")),
    (
        "pretrained/learned/policy_s1.safetensors",
        include_bytes!("../../pretrained/learned/policy_s1.safetensors"),
    ),
    (
        "pretrained/learned/policy_s2.safetensors",
        include_bytes!("../../pretrained/learned/policy_s2.safetensors"),
    ),
];

impl Policies {
    /// Untrained policies: weights N(0, 1/inputs), the last layer a hundredth of that, biases 0,
    /// but for π_p's last, which leans to low power by ±½.
    #[must_use]
    pub fn untrained(rng: &mut impl Rng) -> Self {
        let mut draw = |widths: &[usize]| {
            let mut net = Mlp::zeros(widths);
            let last = net.layers.len() - 1;
            for (n, layer) in net.layers.iter_mut().enumerate() {
                let std = (1.0 / layer.inputs as f64).sqrt() * if n == last { 0.01 } else { 1.0 };
                for w in &mut layer.w {
                    let z: f64 = StandardNormal.sample(rng);
                    *w = (std * z) as f32;
                }
            }
            net
        };
        let motion = draw(&MOTION_WIDTHS);
        let mut power = draw(&POWER_WIDTHS);
        if let Some(last) = power.layers.last_mut() {
            last.b = vec![0.5, -0.5];
        }
        Self { motion, power, world: String::new(), scope: None }
    }

    /// The policies of a built-in world model that ship with the program, optimised for the paper's Scenario 1 or 2.
    ///
    /// # Errors
    /// If no policy ships for this scenario.
    pub fn shipped(which: BuiltIn, scenario: u8) -> Result<Self, PolicyError> {
        let name = match which {
            BuiltIn::Centroid => format!("pretrained/policy_s{scenario}.safetensors"),
            BuiltIn::Learned => format!("pretrained/learned/policy_s{scenario}.safetensors"),
        };
        let Some((path, bytes)) = SHIPPED.into_iter().find(|(path, _)| *path == name) else {
            let message = format!("no policy ships for scenario {scenario}");
            return Err(PolicyError::Content { path: "pretrained".into(), message });
        };
        Self::from_bytes(bytes).map_err(|message| PolicyError::Content { path: path.into(), message })
    }

    /// Σ π_s A_s, the relaxed motion.
    #[must_use]
    pub fn mean_motion(&self, x: &[f32; FEATURES]) -> Vector2<f64> {
        let p = softmax(&self.motion.forward(x));
        Motion::ALL.iter().zip(p).map(|(m, p)| m.vector() * f64::from(p)).sum()
    }

    /// Σ π_p A_p, the relaxed power.
    #[must_use]
    pub fn mean_power(&self, x: &[f32; FEATURES]) -> f64 {
        let p = softmax(&self.power.forward(x));
        TxPower::ALL.iter().zip(p).map(|(power, p)| power.level() * f64::from(p)).sum()
    }

    /// The executed actions: the feasible ones nearest to the relaxed ones.
    #[must_use]
    pub fn act(&self, x: &[f32; FEATURES]) -> (Motion, TxPower) {
        let power = if self.mean_power(x) > 2.5 { TxPower::High } else { TxPower::Low };
        (Motion::nearest(self.mean_motion(x)), power)
    }

    /// Writes the bytes of [`Policies::to_bytes`].
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let bytes = self.to_bytes().map_err(|message| PolicyError::Content { path: path.into(), message })?;
        std::fs::write(path, bytes).map_err(|source| PolicyError::Io { path: path.into(), source })
    }

    /// Both networks as a safetensors file: `motion.N.weight`, `motion.N.bias`, `power.…` (weights
    /// `[in, out]`), with the world model and the scope in its metadata.
    ///
    /// # Errors
    /// Networks whose sizes contradict their layers.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let mut bytes: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
        let raw = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        for (name, net) in [("motion", &self.motion), ("power", &self.power)] {
            for (n, layer) in net.layers.iter().enumerate() {
                let shape = vec![layer.inputs, layer.outputs];
                bytes.push((format!("{name}.{n}.weight"), shape, raw(&layer.w)));
                bytes.push((format!("{name}.{n}.bias"), vec![layer.outputs], raw(&layer.b)));
            }
        }
        let views = bytes
            .iter()
            .map(|(name, shape, data)| {
                TensorView::new(Dtype::F32, shape.clone(), data).map(|view| (name.clone(), view))
            })
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| e.to_string())?;
        // One key, so that equal policies are equal bytes: a map of several has no order.
        let about = PolicyAbout { world_model: self.world.clone(), scope: self.scope.clone() };
        let about = serde_json::to_string(&about).map_err(|e| e.to_string())?;
        let metadata = HashMap::from([(ABOUT.to_owned(), about)]);
        safetensors::serialize(views, Some(metadata)).map_err(|e| e.to_string())
    }

    /// Reads what [`Policies::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing or a tensor has another shape or type.
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let bytes = std::fs::read(path).map_err(|source| PolicyError::Io { path: path.into(), source })?;
        Self::from_bytes(&bytes).map_err(|message| PolicyError::Content { path: path.into(), message })
    }

    /// Reads the bytes of a policy file; the error names the tensor and its shape.
    ///
    /// # Errors
    /// The bytes are no safetensors file, or a tensor is missing, of another shape or type, not finite or
    /// above 1e6.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a safetensors file: {e}"))?;
        let tensor = |name: &str, shape: &[usize]| -> Result<Vec<f32>, String> {
            let view = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
            if view.dtype() != Dtype::F32 || view.shape() != shape {
                return Err(format!(
                    "tensor `{name}` is {:?} {:?}, expected F32 {shape:?}",
                    view.dtype(),
                    view.shape()
                ));
            }
            let floats = view.data().chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]]));
            let values: Vec<f32> = floats.collect();
            if values.iter().all(|v| is_sane(*v)) {
                Ok(values)
            } else {
                Err(format!("tensor `{name}` has values that are not finite, or above 1e6"))
            }
        };
        let net = |name: &str, widths: &[usize]| -> Result<Mlp, String> {
            let layers = widths.windows(2).enumerate().map(|(n, w)| {
                Ok(Dense {
                    inputs: w[0],
                    outputs: w[1],
                    w: tensor(&format!("{name}.{n}.weight"), &[w[0], w[1]])?,
                    b: tensor(&format!("{name}.{n}.bias"), &[w[1]])?,
                })
            });
            Ok(Mlp { layers: layers.collect::<Result<_, String>>()? })
        };
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|e| format!("not a safetensors file: {e}"))?;
        let metadata = |key: &str| header.metadata().as_ref().and_then(|m| m.get(key));
        let about = match (metadata(ABOUT), metadata(WORLD)) {
            (Some(text), _) => serde_json::from_str(text).map_err(|e| format!("metadata `{ABOUT}`: {e}"))?,
            (None, world) => PolicyAbout { world_model: world.cloned().unwrap_or_default(), scope: None },
        };
        Ok(Self {
            motion: net("motion", &MOTION_WIDTHS)?,
            power: net("power", &POWER_WIDTHS)?,
            world: about.world_model,
            scope: about.scope,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crpl_sitl::Scenario;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_file_gives_back_the_same_policies() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("policy.safetensors");
        let mut policies = Policies::untrained(&mut ChaCha8Rng::seed_from_u64(1));
        policies.scope = Some(PolicyScope::new(Scenario::default(), 0.0015));
        policies.save(&path).unwrap();
        assert_eq!(Policies::load(&path).unwrap(), policies);
    }

    #[test]
    fn a_wrong_file_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("policy.safetensors");
        let mut policies = Policies::untrained(&mut ChaCha8Rng::seed_from_u64(1));
        policies.motion = Mlp::zeros(&[7, 64, 64, 5]);
        policies.save(&path).unwrap();
        let error = Policies::load(&path).unwrap_err().to_string();
        assert!(error.ends_with("tensor `motion.0.weight` is F32 [7, 64], expected F32 [6, 64]"), "{error}");
        assert!(Policies::load(&dir.path().join("none")).is_err());
    }

    #[test]
    fn an_undecided_policy_coasts_at_low_power() {
        let policies = Policies::untrained(&mut ChaCha8Rng::seed_from_u64(1));
        let (motion, power) = policies.act(&[0.1, -0.3, 0.0, 0.0, 0.2, 0.5]);
        assert_eq!((motion, power), (Motion::Coast, TxPower::Low));
    }

    #[test]
    fn probabilities_of_large_outputs_are_numbers_and_follow_their_differences() {
        let p = softmax(&[1000.0, 1000.0 - 2.0_f32.ln(), -1000.0]);
        assert!((p[0] - 2.0 / 3.0).abs() < 1e-5 && (p[1] - 1.0 / 3.0).abs() < 1e-5 && p[2] < 1e-30, "{p:?}");
    }

    #[test]
    fn the_relaxed_motion_is_the_mean_of_the_motions() {
        let mut policies = Policies::untrained(&mut ChaCha8Rng::seed_from_u64(1));
        policies.motion = Mlp::zeros(&MOTION_WIDTHS);
        let Some(last) = policies.motion.layers.last_mut() else { panic!("no layers") };
        // Three times as likely as the others.
        let east = Motion::ALL.iter().position(|motion| *motion == Motion::East).unwrap();
        last.b[east] = 3.0_f32.ln();
        let mean = policies.mean_motion(&[0.0; FEATURES]);
        assert!((mean - Vector2::new(2.0 / 7.0, 0.0)).norm() < 1e-5, "{mean}");
    }
}
