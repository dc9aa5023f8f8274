//! What the gradient stage minimises: the whitened prediction loss and the paper's.
//!
//! Knows latents of triples of frames and what the actions contribute; neither encoders nor data.

use burn::tensor::{Device, Tensor, TensorData};

use crate::encoder::module::values;
use crate::encoder::weights::{LATENT, Layer};
use crate::numeric::statistics::quantile;
use crate::world_model::stages::{Gradient, GradientLoss};

/// E_c, E_u and S as tensors.
#[derive(Debug, Clone)]
pub struct Anchors {
    plane_c: Tensor<2>,
    plane_u: Tensor<2>,
    scale: f64,
}

impl Anchors {
    /// `planes` are E_c and E_u, `[16][2]`; `scale` is S.
    #[must_use]
    pub fn new(planes: &[[[f32; 2]; LATENT]; 2], scale: f64, device: &Device) -> Self {
        let [plane_c, plane_u] = planes.each_ref().map(|plane| {
            Tensor::from_data(TensorData::new(plane.as_flattened().to_vec(), [LATENT, 2]), device)
        });
        Self { plane_c, plane_u, scale }
    }
}

/// Latents of n triples: the first half of them with long lags, the second half with short ones.
#[derive(Debug, Clone)]
pub struct Views {
    /// z_c of the three frames, `[n, 16]` each, oldest first.
    pub c: [Tensor<2>; 3],
    /// z_u of the same.
    pub u: [Tensor<2>; 3],
    /// The target encoder's latents of the last frame, without gradient: `[n, 16]` each.
    pub target: [Tensor<2>; 2],
    /// S a_max times the actions' response: `[n, 2]`.
    pub response: Tensor<2>,
}

impl Views {
    /// From latents `[3n, 16]` that hold all first frames, then all second, then all third ones.
    #[must_use]
    pub fn new(
        z_c: Tensor<2>,
        z_u: Tensor<2>,
        target: [Vec<f32>; 2],
        responses: &[[f32; 2]],
        device: &Device,
    ) -> Self {
        let n = responses.len();
        let split = |z: Tensor<2>| [0, 1, 2].map(|k| z.clone().narrow(0, k * n, n));
        let response = TensorData::new(responses.as_flattened().to_vec(), [n, 2]);
        Self {
            c: split(z_c),
            u: split(z_u),
            target: target.map(|t| Tensor::from_data(TensorData::new(t, [n, LATENT]), device)),
            response: Tensor::from_data(response, device),
        }
    }
}

/// Ψ: pinned to (2I, -I) and S a_max E_c, or learned.
#[derive(Debug, Clone)]
pub struct GradientPredictors {
    learned: Option<[Tensor<2>; 5]>,
}

impl GradientPredictors {
    /// Ψ_c0, Ψ_c1, Ψ_ca, Ψ_u0, Ψ_u1 with gradients, or the pinned ones.
    #[must_use]
    pub fn new(learned: Option<&[Layer; 5]>, device: &Device) -> Self {
        let tensor = |l: &Layer| {
            let data = TensorData::new(l.w.clone(), [l.shape[0], l.shape[1]]);
            Tensor::from_data(data, device).require_grad()
        };
        Self { learned: learned.map(|layers| layers.each_ref().map(tensor)) }
    }

    /// What there is to learn.
    pub fn learned(&self) -> impl Iterator<Item = &Tensor<2>> {
        self.learned.iter().flatten()
    }

    /// ẑ_c and ẑ_u of the last frames, `[n, 16]` each.
    fn predict(&self, views: &Views, anchors: &Anchors) -> [Tensor<2>; 2] {
        let [c0, c1, _] = views.c.clone();
        let [u0, u1, _] = views.u.clone();
        let response = views.response.clone();
        match &self.learned {
            None => [c1 * 2.0 - c0 + response.matmul(anchors.plane_c.clone().transpose()), u1 * 2.0 - u0],
            Some(psi) => {
                let by = |z: Tensor<2>, k: usize| z.matmul(psi[k].clone().transpose());
                [by(c1, 0) + by(c0, 1) + by(response, 2), by(u1, 3) + by(u0, 4)]
            }
        }
    }
}

/// Running means of the whitened prediction loss, factor 0.98: both losses and z_u's covariance on its plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Running {
    steps: f64,
    loss_c: f64,
    loss_u: f64,
    covariance: [f64; 4],
}

impl Running {
    /// How many numbers it is.
    pub const LENGTH: usize = 7;
    const FACTOR: f64 = 0.98;

    /// As numbers, to be saved.
    #[must_use]
    pub fn numbers(&self) -> [f64; Self::LENGTH] {
        let [a, b, c, d] = self.covariance;
        [self.steps, self.loss_c, self.loss_u, a, b, c, d]
    }

    /// From what [`Self::numbers`] gave.
    #[must_use]
    pub fn from_numbers(n: &[f64]) -> Self {
        Self { steps: n[0], loss_c: n[1], loss_u: n[2], covariance: [n[3], n[4], n[5], n[6]] }
    }

    fn add(&mut self, loss_c: f64, loss_u: f64, covariance: &[f32]) {
        let mix = |old: f64, new: f64| Self::FACTOR * old + (1.0 - Self::FACTOR) * new;
        let first = self.steps == 0.0;
        self.loss_c = if first { loss_c } else { mix(self.loss_c, loss_c) };
        self.loss_u = if first { loss_u } else { mix(self.loss_u, loss_u) };
        for (old, new) in self.covariance.iter_mut().zip(covariance) {
            *old = mix(*old, f64::from(*new));
        }
        self.steps += 1.0;
    }

    /// The covariance's mean, free of the zeros that it began with, less the identity.
    fn excess(&self) -> Vec<f32> {
        let share = 1.0 - Self::FACTOR.powf(self.steps);
        let mean = self.covariance.map(|c| c / share);
        [mean[0] - 1.0, mean[1], mean[2], mean[3] - 1.0].map(|c| c as f32).to_vec()
    }
}

/// A loss to go down on, and its parts for the eye.
#[derive(Debug, Clone)]
pub struct LossValue {
    /// The scalar, `[1]`.
    pub loss: Tensor<1>,
    /// Rms prediction error of z_c a coordinate, px.
    pub error_c_px: f64,
    /// Rms prediction error of z_u a coordinate, in its standard deviations.
    pub error_u: f64,
}

/// The stage's loss of a batch; `running` moves on by a step.
#[must_use]
pub fn evaluate(
    views: &Views,
    psi: &GradientPredictors,
    anchors: &Anchors,
    stage: &Gradient,
    running: &mut Running,
) -> LossValue {
    match stage.loss {
        GradientLoss::WhitenedPrediction => whitened_prediction(views, psi, anchors, stage, running),
        GradientLoss::Paper => paper(views, psi, anchors),
    }
}

/// |ẑ_c - z_c,tar|²/S² + |ẑ_u - z_u,tar|², means over the triples (z_u: the short ones).
fn paper(views: &Views, psi: &GradientPredictors, anchors: &Anchors) -> LossValue {
    let [hat_c, hat_u] = psi.predict(views, anchors);
    let [target_c, target_u] = views.target.clone();
    let c = error(hat_c, target_c).mean().div_scalar(anchors.scale * anchors.scale);
    let u = error(short(hat_u), short(target_u)).mean();
    loss_value(c.clone() + u.clone(), &c, &u)
}

fn whitened_prediction(
    views: &Views,
    psi: &GradientPredictors,
    anchors: &Anchors,
    stage: &Gradient,
    running: &mut Running,
) -> LossValue {
    let [hat_c, hat_u] = psi.predict(views, anchors);
    let [target_c, target_u] = views.target.clone();
    let w = stage.target_weight;
    let c = error(hat_c.clone(), views.c[2].clone()) + error(hat_c, target_c) * w;
    let c = c.mean().div_scalar(anchors.scale * anchors.scale);

    // The short triples that constant velocity explains best: the others hit a wall.
    let hat_u = short(hat_u);
    let online = error(hat_u.clone(), short(views.u[2].clone()));
    let kept = kept(&online, stage.keep);
    let share = kept.clone().sum();
    let u = ((online + error(hat_u, short(target_u)) * w) * kept).sum() / share;

    // All frames' z_u: unit variance on its plane, and nothing off the planes.
    let all_u = centred(Tensor::cat(views.u.to_vec(), 0));
    let u = u / (all_u.clone().square().sum_dim(1).mean() * 0.5);
    let y = all_u.clone().matmul(anchors.plane_u.clone());
    let count = y.dims()[0] as f64;
    let covariance = y.clone().transpose().matmul(y.clone()).div_scalar(count);
    let off_u = (all_u - y.matmul(anchors.plane_u.clone().transpose())).square().sum_dim(1).mean();
    let all_c = Tensor::cat(views.c.to_vec(), 0);
    let on_c = all_c.clone().matmul(anchors.plane_c.clone()).matmul(anchors.plane_c.clone().transpose());
    let gauge = 0.25 * anchors.scale;
    let off_c = (all_c - on_c).square().sum_dim(1).mean().div_scalar(gauge * gauge);

    let (value_c, value_u) = (scalar(&c), scalar(&u));
    running.add(value_c, value_u, &values(covariance.clone()));
    let excess = TensorData::new(running.excess(), [2, 2]);
    let white = (covariance * Tensor::from_data(excess, &c.device())).sum();
    let tiny = f64::from(f32::MIN_POSITIVE);
    let loss = c.clone().div_scalar(running.loss_c.max(tiny))
        + u.clone().div_scalar(running.loss_u.max(tiny))
        + white * stage.whitening
        + (off_u + off_c) * stage.off_plane;
    let by = 1.0 / (1.0 + w);
    loss_value(loss, &(c * by), &(u * by))
}

/// `c` and `u` are means of squared norms over two coordinates, in units of length² and variance.
fn loss_value(loss: Tensor<1>, c: &Tensor<1>, u: &Tensor<1>) -> LossValue {
    let rms = |t: &Tensor<1>| (scalar(t) / 2.0).sqrt();
    LossValue { loss, error_c_px: 100.0 * rms(c), error_u: rms(u) }
}

/// Squared distance, `[n, 16]` -> `[n, 1]`.
fn error(a: Tensor<2>, b: Tensor<2>) -> Tensor<2> {
    (a - b).square().sum_dim(1)
}

/// The short triples: the second half.
fn short(z: Tensor<2>) -> Tensor<2> {
    let n = z.dims()[0] / 2;
    z.narrow(0, n, n)
}

fn centred(z: Tensor<2>) -> Tensor<2> {
    let mean = z.clone().mean_dim(0);
    z - mean
}

/// 1 for the share `keep` with the smallest errors, else 0: `[n, 1]`, without gradient.
fn kept(errors: &Tensor<2>, keep: f64) -> Tensor<2> {
    let all: Vec<f64> = values(errors.clone()).into_iter().map(f64::from).collect();
    let limit = quantile(&all, keep);
    let mask: Vec<f32> = all.iter().map(|e| f32::from(u8::from(*e <= limit))).collect();
    Tensor::from_data(TensorData::new(mask, [all.len(), 1]), &errors.device())
}

fn scalar(t: &Tensor<1>) -> f64 {
    f64::from(values(t.clone())[0])
}
