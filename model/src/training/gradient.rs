//! The gradient stage: an online encoder descends on the JEPA loss, a target encoder follows it
//! (Sec. II-A3 and IV-A2). Read [`train`] from top to bottom; the losses are in [`losses`].
//!
//! No labels: frames and actions only. Every number that decides the next step is in one value, so
//! an interrupted run ends with the same bytes as an uninterrupted one.

use std::path::Path;

use burn::tensor::{Gradients, Tensor};
use crpl_sitl::camera::Frame;
use crpl_sitl::world::noise::{Noise, Stream};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::encoder::infer::Latent;
use crate::encoder::module::{Batch, EncoderModule, gradient_of, values};
use crate::encoder::weights::{self, FEATURES, LATENT, Layer, Weights};
use crate::evaluation::diagnostics::{self, LatentStats};
use crate::heads::labels::Scene;
use crate::numeric::adam::{Adam, Betas};
use crate::numeric::tensors::{self, Reader, TensorError, Writer, write_all};
use crate::training::closed_form::FitError;
use crate::training::fitting::{self, TrainContext, TrainData};
use crate::training::losses::{self, Anchors, GradientPredictors, LossValue, Running, Views};
use crate::training::show::StageShow;
use crate::world_model::config::TrainConfig;
use crate::world_model::dataset::{self, Triple};
use crate::world_model::stages::{Gradient, HeadStart, Layers, PsiStart};
use crpl_sitl::camera::effects::FrameId;

/// File of the state from which `--resume` continues.
pub const PROGRESS: &str = "gradient.safetensors";

/// Why the stage stopped.
#[derive(Debug, thiserror::Error)]
pub enum GradientError {
    /// The progress could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The heads could not be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Loss or gradient overflowed.
    #[error("step {0} of the gradient stage: the loss is not finite; lower stages.gradient.learning_rate")]
    Diverged(usize),
}

/// Everything that decides the rest of the stage.
#[derive(Debug, Clone)]
struct GradientState {
    step: usize,
    online: Weights,
    target: Weights,
    psi: Option<[Layer; 5]>,
    adam: Adam,
    running: Running,
}

/// Trains `start` and returns the target encoder, with heads of its own. `dir` keeps the progress.
///
/// # Errors
/// If the loss diverges, a fit of the heads fails, or the progress cannot be read or written.
pub fn train(
    start: &Weights,
    stage: &Gradient,
    context: &TrainContext<'_>,
    dir: Option<&Path>,
    shown: &StageShow,
) -> Result<Weights, GradientError> {
    let TrainContext { config, data, planes, noise, device, .. } = *context;
    let autodiff = device.clone().autodiff();
    let anchors = Anchors::new(planes, config.encoder.scale, &autodiff);
    let progress = dir.map(|dir| dir.join(PROGRESS));
    let mut state = GradientState::load_or_begin(progress.as_deref(), start, stage, noise)?;
    let mut recent = Recent::default();
    shown.at(state.step);
    while state.step < stage.steps {
        if stage.heads == HeadStart::ClosedForm && state.step.is_multiple_of(stage.refit_every) {
            state.refit(context, stage)?;
        }
        let batch = draw(config, stage, data, noise, state.step);

        // Online encoder, with the gradient; target encoder, without.
        let mut online = EncoderModule::new(&state.online, &autodiff);
        if stage.layers == Layers::Colour {
            online = online.with_a_still_trunk();
        }
        if stage.heads == HeadStart::ClosedForm {
            online = online.with_still_heads();
        }
        let (z_c, z_u) = online.forward(&Batch::new(&batch.frames, &state.online.input, &autodiff));
        let target = EncoderModule::new(&state.target, device);
        let last = &batch.frames[batch.frames.len() / 3 * 2..];
        let (t_c, t_u) = target.forward(&Batch::new(last, &state.target.input, device));
        recent.add(&z_c, &z_u, &batch.scenes);

        // The loss, and a step down.
        let psi = GradientPredictors::new(state.psi.as_ref(), &autodiff);
        let views = Views::new(z_c, z_u, [values(t_c), values(t_u)], &batch.responses, &autodiff);
        let LossValue { loss, error_c_px, error_u } =
            losses::evaluate(&views, &psi, &anchors, stage, &mut state.running);
        let value = values(loss.clone())[0];
        let gradients = loss.backward();
        let clip_and_rate = [stage.clip as f32, learning_rate(stage, state.step)];
        if !value.is_finite() || !state.descend(&online, &psi, &gradients, clip_and_rate) {
            return Err(GradientError::Diverged(state.step));
        }
        state.target.follow(&state.online, stage.momentum as f32);

        state.step += 1;
        shown.at(state.step);
        if let Some(progress) = &progress
            && state.step.is_multiple_of(stage.save_every)
        {
            state.save(progress)?;
        }
        if state.step.is_multiple_of(REPORT_EVERY) || state.step == stage.steps {
            let diagnostics = recent.diagnostics(config.encoder.scale);
            let words = message(value, error_c_px, error_u, &diagnostics);
            let numbers =
                [("loss", f64::from(value)), ("error of z_c, px", error_c_px), ("error of z_u", error_u)];
            shown.report(state.step, words, &numbers);
        }
    }
    Ok(state.target)
}

/// Steps between two reports on the progress bar.
const REPORT_EVERY: usize = 25;

fn message(loss: f32, error_c_px: f64, error_u: f64, diagnostics: &[LatentStats; 2]) -> String {
    let [c, u] = diagnostics;
    format!(
        "loss {loss:.3}  error {error_c_px:.2} px, {error_u:.3}  rank {:.1} {:.1}  spread {:.2} {:.2}  R² {:.3} {:.3}",
        c.rank, u.rank, c.spread, u.spread, c.r_squared, u.r_squared
    )
}

/// Linear warm-up, then a cosine down to 1 %.
fn learning_rate(stage: &Gradient, step: usize) -> f32 {
    let warm = ((step + 1) as f64 / stage.warm_up.max(1) as f64).min(1.0);
    let phase = std::f64::consts::PI * step as f64 / stage.steps as f64;
    (stage.learning_rate * warm * (0.01 + 0.99 * 0.5 * (1.0 + phase.cos()))) as f32
}

/// One step's frames: the first frames of all triples (long, then short), the second, the third.
struct Drawn {
    frames: Vec<Frame>,
    scenes: Vec<Scene>,
    /// S a_max times the response of every triple.
    responses: Vec<[f32; 2]>,
}

/// The frames of a step are a function of the seed and the step alone.
fn draw(config: &TrainConfig, stage: &Gradient, data: TrainData<'_>, noise: &Noise, step: usize) -> Drawn {
    let mut rng = noise.generator(Stream::Batches, (1 << 20) + step as u64);
    let triples: Vec<Triple> = [config.long, config.short]
        .iter()
        .flat_map(|[low, high]| dataset::triples(data.episodes, stage.batch, *low, *high, &mut rng))
        .collect();
    let unit = config.encoder.scale * data.scenario.dynamics.a_max;
    let responses = triples.iter().map(|t| data.episodes[t.episode].input_response(t.first, t.lag) * unit);
    let responses = responses.map(|d| [d.x as f32, d.y as f32]).collect();
    let places: Vec<(usize, usize)> =
        (0..3).flat_map(|n| triples.iter().map(move |t| (t.episode, t.first + n * t.lag))).collect();
    let frames = places
        .par_iter()
        .map(|&(episode, frame)| {
            let id = FrameId { series: episode as u64, frame: frame as u64 };
            data.cameras.apply(data.episodes[episode].frame(frame, data.scenario), id)
        })
        .collect();
    let scenes = places
        .iter()
        .map(|&(episode, k)| {
            let episode = &data.episodes[episode];
            Scene { uav: episode.uav[k], obstacle: episode.obstacle[k] }
        })
        .collect();
    Drawn { frames, scenes, responses }
}

/// Latents since the last report, and where the bodies were: for the eye, not for the training.
#[derive(Default)]
struct Recent {
    latents: Vec<Latent>,
    scenes: Vec<Scene>,
}

impl Recent {
    fn add(&mut self, z_c: &Tensor<2>, z_u: &Tensor<2>, scenes: &[Scene]) {
        let (c, u) = (values(z_c.clone()), values(z_u.clone()));
        let rows = c.chunks_exact(LATENT).zip(u.chunks_exact(LATENT));
        self.latents.extend(
            rows.map(|(c, u)| Latent {
                z_c: std::array::from_fn(|k| c[k]),
                z_u: std::array::from_fn(|k| u[k]),
            }),
        );
        self.scenes.extend(scenes);
    }

    fn diagnostics(&mut self, scale: f64) -> [LatentStats; 2] {
        let diagnostics = diagnostics::halves(&self.latents, &self.scenes, scale);
        self.latents.clear();
        self.scenes.clear();
        diagnostics
    }
}

impl GradientState {
    /// Random heads of their own on the trunk's start; the target begins where the online encoder does.
    fn begin(start: &Weights, stage: &Gradient, noise: &Noise) -> Self {
        let mut rng = noise.generator(Stream::Weights, 4);
        let mut normal = |shape: &[usize]| {
            let deviation = 1.0 / (shape[1] as f64).sqrt();
            let mut layer = Layer::zeros(shape);
            for w in &mut layer.w {
                let deviate: f64 = StandardNormal.sample(&mut rng);
                *w = (deviation * deviate) as f32;
            }
            layer
        };
        let online = match stage.heads {
            HeadStart::ClosedForm => start.clone(),
            HeadStart::Random => {
                let head_c = normal(&[LATENT, FEATURES]);
                Weights { head_c, head_u: normal(&[LATENT, FEATURES]), ..start.clone() }
            }
        };
        let psi = (stage.psi == PsiStart::Learned)
            .then(|| [LATENT, LATENT, 2, LATENT, LATENT].map(|inputs| normal(&[LATENT, inputs])));
        let mut state = Self {
            step: 0,
            target: online.clone(),
            online,
            psi,
            adam: Adam::default(),
            running: Running::default(),
        };
        let count = state.parts_mut().iter().map(|p| p.len()).sum();
        state.adam = Adam::new(count, Betas::FAST, 0.0);
        state
    }

    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        let psi = self.psi.iter_mut().flatten().map(|l| l.w.as_mut_slice());
        self.online.parts_mut().into_iter().chain(psi).collect()
    }

    /// Calibrates the colour layer and fits the heads to the trunk as it is now, online and target.
    fn refit(&mut self, context: &TrainContext<'_>, stage: &Gradient) -> Result<(), GradientError> {
        let picks = fitting::pick_some(context, stage.refit_frames, (1 << 40) + self.step as u64);
        let online = calibrated(self.online.clone(), &fitting::some_frames(context, &picks));
        (self.online, _) = fitting::refitted(context, online, &picks)?;
        let Weights { input, head_c, head_u, .. } = self.online.clone();
        self.target.input.whole_mass = input.whole_mass;
        (self.target.head_c, self.target.head_u) = (head_c, head_u);
        Ok(())
    }

    /// One step of Adam; false if the gradient is not finite.
    fn descend(
        &mut self,
        online: &EncoderModule,
        psi: &GradientPredictors,
        gradients: &Gradients,
        [clip, rate]: [f32; 2],
    ) -> bool {
        let encoder = online.gradients(gradients);
        let psi: Vec<Vec<f32>> = psi.learned().map(|t| gradient_of(t, gradients)).collect();
        let gradient: Vec<&[f32]> =
            encoder.parts().into_iter().chain(psi.iter().map(Vec::as_slice)).collect();
        let squares: f64 = gradient.iter().flat_map(|g| g.iter()).map(|g| f64::from(*g).powi(2)).sum();
        let norm = squares.sqrt() as f32;
        if !norm.is_finite() {
            return false;
        }
        let scale = if norm > clip { clip / norm } else { 1.0 };
        let mut adam = std::mem::take(&mut self.adam);
        let weights = self.parts_mut().into_iter().flatten();
        adam.step(weights, gradient.into_iter().flatten(), scale, rate);
        self.adam = adam;
        true
    }

    fn save(&mut self, path: &Path) -> Result<(), TensorError> {
        let mut out = Writer::default();
        let mut put = |name: &str, parts: &[&[f32]]| {
            let count = parts.iter().map(|p| p.len()).sum();
            out.f32(name, &[count], parts.iter().flat_map(|p| p.iter().copied()));
        };
        put("target", &self.target.parts());
        let [first, second] = self.adam.moments();
        put("first", &[first]);
        put("second", &[second]);
        let online: Vec<&[f32]> = self.parts_mut().into_iter().map(|p| &*p).collect();
        put("online", &online);
        out.f32("whole_mass", &[3], self.online.input.whole_mass);
        out.f64("step", &[1], [self.step as f64]);
        out.f64("running", &[Running::LENGTH], self.running.numbers());
        write_all(path, &out.bytes()?)
    }

    fn load_or_begin(
        path: Option<&Path>,
        start: &Weights,
        stage: &Gradient,
        noise: &Noise,
    ) -> Result<Self, TensorError> {
        let mut state = Self::begin(start, stage, noise);
        let Some(path) = path.filter(|path| path.exists()) else { return Ok(state) };
        let bytes = tensors::read(path)?;
        let from = Reader::new(&bytes, path.into())?;
        fill(&mut state.target.parts_mut(), &from, "target")?;
        fill(&mut state.parts_mut(), &from, "online")?;
        let count = state.adam.moments()[0].len();
        let moments = [from.f32("first", &[count])?, from.f32("second", &[count])?];
        let mass = from.f32("whole_mass", &[3])?;
        for input in [&mut state.online.input, &mut state.target.input] {
            input.whole_mass.copy_from_slice(&mass);
        }
        state.step = from.f64("step", &[1])?[0] as usize;
        state.adam.restore(moments, state.step);
        state.running = Running::from_numbers(&from.f64("running", &[Running::LENGTH])?);
        Ok(state)
    }
}

fn fill(parts: &mut [&mut [f32]], from: &Reader<'_>, name: &str) -> Result<(), TensorError> {
    let count = parts.iter().map(|p| p.len()).sum();
    let values = from.f32(name, &[count])?;
    let mut rest = values.as_slice();
    for part in parts {
        let (own, others) = rest.split_at(part.len());
        part.copy_from_slice(own);
        rest = others;
    }
    Ok(())
}

/// Calibrates the whole mass of each channel behind a trained colour layer: the median of the masses
/// of `frames`, most of which show whole discs. No labels.
#[must_use]
pub fn calibrated(mut weights: Weights, frames: &[Frame]) -> Weights {
    let Some(colour) = weights.input.colour else { return weights };
    let masses: Vec<[f64; 2]> = frames
        .par_iter()
        .map(|frame| {
            let pixels = frame.rgb().chunks_exact(crpl_sitl::camera::CHANNELS).map(|p| colour.apply(p));
            pixels.fold([0.0; 2], |sum, y| [sum[0] + f64::from(y[0]), sum[1] + f64::from(y[1])])
        })
        .collect();
    for (k, channel) in weights::Colour::CHANNELS.into_iter().enumerate() {
        let own: Vec<f64> = masses.iter().map(|m| m[k]).collect();
        let median = crate::numeric::statistics::quantile(&own, 0.5);
        if median > 0.0 {
            weights.input.whole_mass[channel] = median as f32;
        }
    }
    weights
}
