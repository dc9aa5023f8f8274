//! The learned encoder, trained end to end on a recording: pictures, actions, measured gain; no position.
//!
//! An online encoder descends, an EMA target follows it (Sec. II-A3). Read [`train`] from top to bottom; the
//! losses are in [`loss`]. A step is a function of the seed, its number and the state before it, so an
//! interrupted run ends with the bytes of one that was not.

#[cfg(feature = "train")]
pub mod ablation;
pub mod adapt;
pub mod batch;
#[cfg(feature = "train")]
pub mod device;
pub mod loss;
pub mod passes;
pub mod readings;
#[cfg(feature = "train")]
pub mod recipe;
pub mod teacher;

use std::path::Path;

use crpl_sitl::world::noise::{Noise, Stream};

use crate::encoder::votes::VoteWeights;
use crate::numeric::adam::{Adam, Betas};
use crate::numeric::mlp::Mlp;
use crate::numeric::tensors::{self, Reader, Stored, TensorError, Writer, write_all};
use crate::training::learned::batch::normal;
use crate::training::learned::loss::{GAIN_NET, GainNet, Readings, RunningMeans, TrainPhase};
use crate::training::learned::passes::{CpuPasses, Passes};
use crate::training::show::StageShow;
pub use crate::world_model::learned::LearnedConfig;
use crate::world_model::recording::Recording;

/// File of the state from which `--resume` continues.
pub const LEARNED_PROGRESS: &str = "learned.safetensors";

/// Steps between two reports.
const REPORT_EVERY: usize = 50;

/// Why the training stopped.
#[derive(Debug, thiserror::Error)]
pub enum LearnedError {
    /// The recording or the progress could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// Loss or gradient overflowed.
    #[error("step {0} of the learned encoder: the loss is not finite; lower learned.learning_rate")]
    Diverged(usize),
    /// Only the learned encoder learns from a recording.
    #[error("the world model has the encoder `{0}`, which no recording adapts: start from `learned`")]
    NotLearned(&'static str),
    /// Too few episodes.
    #[error(
        "the recording has {found} episodes, and learned.encoder.held_out = {held_out} of them are not trained on"
    )]
    Episodes {
        /// Episodes there.
        found: usize,
        /// Not trained on.
        held_out: usize,
    },
}

/// Everything that decides the rest of a run.
#[derive(Debug, Clone)]
struct LearnedState {
    step: usize,
    online: VoteWeights,
    target: VoteWeights,
    gain: Mlp,
    adam: Adam,
    means: RunningMeans,
}

/// Trains an encoder on a recording, from random weights or from `start`, and returns the EMA target. `dir` keeps
/// the progress.
///
/// # Errors
/// If the loss diverges, or a file cannot be read or written.
pub fn train(
    recording: &Recording,
    config: &LearnedConfig,
    start: Option<&VoteWeights>,
    noise: &Noise,
    dir: Option<&Path>,
    shown: &StageShow,
) -> Result<VoteWeights, LearnedError> {
    let passes = &mut CpuPasses::new(config);
    train_on(recording, config, start, noise, EncoderRun { passes, dir, shown, watch: &mut |_, _| {} })
}

/// What a run is done with; none of it but the passes' rounding changes the result.
pub struct EncoderRun<'a> {
    /// What runs the encoder.
    pub passes: &'a mut dyn Passes,
    /// Keeps the progress.
    pub dir: Option<&'a Path>,
    /// Shows the progress.
    pub shown: &'a StageShow,
    /// Is shown the number of each finished step and the target after it.
    pub watch: &'a mut dyn FnMut(usize, &VoteWeights),
}

/// The same, with `run`'s passes.
///
/// # Errors
/// As [`train`].
pub fn train_on(
    recording: &Recording,
    config: &LearnedConfig,
    start: Option<&VoteWeights>,
    noise: &Noise,
    run: EncoderRun<'_>,
) -> Result<VoteWeights, LearnedError> {
    let EncoderRun { passes, dir, shown, watch } = run;
    let found = recording.episodes().len();
    let Some(count) = found.checked_sub(config.held_out).filter(|n| *n > 0) else {
        return Err(LearnedError::Episodes { found, held_out: config.held_out });
    };
    let episodes = &recording.episodes()[..count];
    let progress = dir.map(|dir| dir.join(LEARNED_PROGRESS));
    let mut state = LearnedState::load_or_begin(progress.as_deref(), start, config, noise)?;
    shown.at(state.step);
    while state.step < config.steps {
        let mut rng = noise.generator(Stream::Batches, (2 << 20) + state.step as u64);
        let drawn = batch::draw(recording, episodes, config, &mut rng)?;

        // Online encoder on its view, kept for the gradient; target encoder on the recording's third pictures.
        let seen = passes.look(&state.online, &drawn);
        let aim = passes.aim(&state.target, &drawn);

        // The loss, its gradient by the readings and from there by the weights.
        let readings = Readings { online: &seen, target: &aim, drawn: &drawn };
        let mut gain = GainNet { net: &state.gain, gradient: Mlp::zeros(&GAIN_NET) };
        let phase = TrainPhase { step: state.step, steps: config.steps };
        let loss = loss::evaluate(&readings, &mut gain, config, phase, &mut state.means);
        let gradient = passes.backward(&drawn, &loss.gradients);
        let gain_gradient = gain.gradient;
        if !loss.value.is_finite() || !state.descend(&gradient, &gain_gradient, config) {
            return Err(LearnedError::Diverged(state.step));
        }
        state.follow(config);

        state.step += 1;
        shown.at(state.step);
        watch(state.step, &state.target);
        if let Some(progress) = &progress
            && state.step.is_multiple_of(config.save_every)
        {
            state.save(progress)?;
        }
        if state.step.is_multiple_of(REPORT_EVERY) || state.step == config.steps {
            let means = &state.means;
            shown.report(state.step, means.message(loss.value), &means.curves(loss.value));
        }
    }
    Ok(state.target)
}

impl RunningMeans {
    /// The curves of a training by name.
    fn curves(&self, loss: f32) -> [(&'static str, f64); 8] {
        [
            ("loss", loss),
            ("loss of z_c, px", self.loss_c),
            ("correlation of z_c with the actions", self.correlation),
            ("error of z_u, px", self.error_u),
            ("z_u against the teacher, px", self.teacher),
            ("error of the gain, dB", self.gain),
            ("spread of the votes for c, px", self.spread[0]),
            ("spread of the votes for u, px", self.spread[1]),
        ]
        .map(|(name, value)| (name, f64::from(value)))
    }

    fn message(&self, loss: f32) -> String {
        format!(
            "loss {loss:.2}  c {:.2} px R {:.3}  u {:.2} px moves {:.1}  teacher {:.2} ({:.0} %)  gain {:.2} dB  votes {:.1} {:.1} px",
            self.loss_c,
            self.correlation,
            self.error_u,
            self.movement,
            self.teacher,
            100.0 * self.believed,
            self.gain,
            self.spread[0],
            self.spread[1],
        )
    }
}

impl LearnedState {
    fn begin(start: Option<&VoteWeights>, config: &LearnedConfig, noise: &Noise) -> Self {
        let online = start.cloned().unwrap_or_else(|| VoteWeights::random(noise));
        let mut gain = Mlp::zeros(&GAIN_NET);
        let mut rng = noise.generator(Stream::Weights, 9);
        for layer in &mut gain.layers {
            let deviation = 1.0 / (layer.inputs as f32).sqrt();
            layer.w.iter_mut().for_each(|w| *w = deviation * normal(&mut rng));
        }
        let count = online.parameters() + gain.parts().iter().map(|p| p.len()).sum::<usize>();
        let adam = Adam::new(count, Betas::FAST, config.weight_decay as f32);
        Self { step: 0, target: online.clone(), online, gain, adam, means: RunningMeans::default() }
    }

    fn descend(&mut self, encoder: &VoteWeights, gain: &Mlp, config: &LearnedConfig) -> bool {
        let warm = ((self.step + 1) as f64 / config.warm_up.max(1) as f64).min(1.0);
        let phase = std::f64::consts::PI * self.step as f64 / config.steps as f64;
        let rate = config.learning_rate * warm * (0.02 + 0.98 * 0.5 * (1.0 + phase.cos()));
        let gradients = [encoder.parts(), gain.parts()].concat();
        let mut weights = self.online.parts_mut();
        weights.extend(self.gain.parts_mut());
        loss::descend(weights, &gradients, &mut self.adam, config.clip, rate)
    }

    fn follow(&mut self, config: &LearnedConfig) {
        let early = (self.step as f64 + 1.0) / (self.step as f64 + 10.0);
        let tau = config.momentum.min(early) as f32;
        for (target, online) in self.target.parts_mut().into_iter().zip(self.online.parts()) {
            target.iter_mut().zip(online).for_each(|(t, o)| *t = tau * *t + (1.0 - tau) * o);
        }
    }

    fn save(&self, path: &Path) -> Result<(), TensorError> {
        let mut out = Writer::default();
        let flat = |parts: Vec<&[f32]>| parts.concat();
        let [first, second] = self.adam.moments();
        let numbers = self.means.numbers();
        for (name, values) in [
            ("online", flat(self.online.parts())),
            ("target", flat(self.target.parts())),
            ("gain", flat(self.gain.parts())),
            ("first", first.to_vec()),
            ("second", second.to_vec()),
            ("means", numbers.to_vec()),
        ] {
            out.f32(name, &[values.len()], values);
        }
        out.f64("step", &[1], [self.step as f64]);
        write_all(path, &out.bytes()?)
    }

    fn load_or_begin(
        path: Option<&Path>,
        start: Option<&VoteWeights>,
        config: &LearnedConfig,
        noise: &Noise,
    ) -> Result<Self, TensorError> {
        let mut state = Self::begin(start, config, noise);
        let Some(path) = path.filter(|path| path.exists()) else { return Ok(state) };
        let bytes = tensors::read(path)?;
        let from = Reader::new(&bytes, path.into())?;
        let fill = |parts: Vec<&mut [f32]>, name: &str| -> Result<(), TensorError> {
            let values = from.f32(name, &[parts.iter().map(|p| p.len()).sum()])?;
            parts.into_iter().flatten().zip(values).for_each(|(w, v)| *w = v);
            Ok(())
        };
        fill(state.online.parts_mut(), "online")?;
        fill(state.target.parts_mut(), "target")?;
        fill(state.gain.parts_mut(), "gain")?;
        let count = state.adam.moments()[0].len();
        let moments = [from.f32("first", &[count])?, from.f32("second", &[count])?];
        state.step = from.f64("step", &[1])?[0] as usize;
        state.adam.restore(moments, state.step);
        let mut numbers = [0.0; RunningMeans::LENGTH];
        numbers.copy_from_slice(&from.f32("means", &[RunningMeans::LENGTH])?);
        state.means = RunningMeans::from_numbers(numbers);
        Ok(state)
    }
}

/// Writes an encoder by itself.
///
/// # Errors
/// If the file cannot be written.
pub fn save_encoder(weights: &VoteWeights, path: &Path) -> Result<(), TensorError> {
    let mut out = Writer::default();
    weights.put(&mut out);
    write_all(path, &out.bytes()?)
}

/// Reads what [`save_encoder`] wrote.
///
/// # Errors
/// If the file is missing or holds something else.
pub fn load_encoder(path: &Path) -> Result<VoteWeights, TensorError> {
    let bytes = tensors::read(path)?;
    VoteWeights::get(&Reader::new(&bytes, path.into())?)
}
