//! Checks that find a failed training run although its loss is low: a latent half that
//! collapsed, lost its body, holds the other one, or ignores the actions. A model that raises an
//! alarm is not shipped.
//!
//! True positions serve to judge here, never to train.

use std::fmt;

use crpl_sitl::camera::SIDE;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::encoder::infer::Latent;
use crate::encoder::probe::{covariance, effective_rank, r_squared};
use crate::encoder::weights::{LATENT, vector};
use crate::heads::labels::{self, Scene};
use crate::numeric::statistics::quantile;
use crate::predictor::Begin;
use crate::world_model::WorldModel;
use crate::world_model::config::AlarmLimits;
use crate::world_model::dataset::{self, EpisodeStart};
use crpl_sitl::camera::effects::{CameraSet, FrameId};

/// One half of the latents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LatentHalf {
    /// z_c, the UAV.
    Controllable,
    /// z_u, the obstacle.
    Uncontrollable,
}

impl LatentHalf {
    /// Both, in the order of every pair of statistics.
    pub const BOTH: [Self; 2] = [Self::Controllable, Self::Uncontrollable];

    fn name(self) -> &'static str {
        match self {
            Self::Controllable => "z_c",
            Self::Uncontrollable => "z_u",
        }
    }

    fn bodies(self) -> [&'static str; 2] {
        match self {
            Self::Controllable => ["UAV", "obstacle"],
            Self::Uncontrollable => ["obstacle", "UAV"],
        }
    }
}

/// What frames say of one half.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LatentStats {
    /// Effective rank: e to the entropy of the covariance's normalised eigenvalues.
    pub rank: f64,
    /// Standard deviation of each dimension.
    pub std: [f64; LATENT],
    /// Root of the total variance over what the gauge makes it.
    pub spread: f64,
    /// R² of the right body's position.
    pub r_squared: f64,
    /// R² of the wrong body's.
    pub leak: f64,
}

/// Errors of rollouts from rest at their end, l1, 90 % quantile, px.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActionStats {
    /// With the true actions.
    pub true_px: f64,
    /// With none.
    pub zero_px: f64,
    /// With those of another trajectory.
    pub shuffled_px: f64,
}

/// What the alarms are computed from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Diagnostics {
    /// z_c and z_u.
    pub halves: [LatentStats; 2],
    /// Whether the actions matter.
    pub actions: ActionStats,
    /// Second generalised eigenvalue of z_u; none without the closed form.
    pub eigenvalue: Option<f64>,
}

/// One thing that is wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CollapseCheck {
    /// A half hardly varies.
    Collapsed(LatentHalf, f64),
    /// A half varies in fewer directions than its body moves in.
    Rank(LatentHalf, f64),
    /// A half does not hold its body.
    Lost(LatentHalf, f64),
    /// A half holds the other body.
    Leaks(LatentHalf, f64),
    /// The closed form found no direction that is still enough to be the obstacle.
    Eigenvalue(f64),
    /// Wrong actions predict hardly worse than the true ones.
    Actions(f64),
}

impl fmt::Display for CollapseCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Collapsed(side, share) => {
                let name = side.name();
                write!(f, "{name} has collapsed: it varies by {share:.1e} of what it should")
            }
            Self::Rank(side, rank) => {
                write!(f, "{} has collapsed to an effective rank of {rank:.2}", side.name())
            }
            Self::Lost(side, r2) => {
                write!(f, "{} has lost the {} (R² {r2:.3})", side.name(), side.bodies()[0])
            }
            Self::Leaks(side, r2) => {
                write!(f, "{} holds the {}, too (R² {r2:.3})", side.name(), side.bodies()[1])
            }
            Self::Eigenvalue(value) => write!(
                f,
                "z_u may not be the obstacle: its second eigenvalue is {value:.1e}; take more frames"
            ),
            Self::Actions(ratio) => {
                write!(f, "the actions hardly matter: wrong ones predict {ratio:.1} times worse")
            }
        }
    }
}

impl Diagnostics {
    /// What is wrong by these limits. NaN is wrong.
    #[must_use]
    pub fn alarms(&self, limits: &AlarmLimits) -> Vec<CollapseCheck> {
        let mut alarms = Vec::new();
        for (side, half) in LatentHalf::BOTH.into_iter().zip(&self.halves) {
            alarms.extend(half.alarms(side, limits));
        }
        if self.eigenvalue.is_some_and(|value| above(value, limits.eigenvalue)) {
            alarms.extend(self.eigenvalue.map(CollapseCheck::Eigenvalue));
        }
        let ActionStats { true_px, zero_px, shuffled_px } = self.actions;
        let ratio = zero_px.min(shuffled_px) / true_px;
        if below(ratio, limits.action_ratio) {
            alarms.push(CollapseCheck::Actions(ratio));
        }
        alarms
    }

    /// The table that a training run ends with.
    #[must_use]
    pub fn table(&self) -> String {
        let pair = |of: fn(&LatentStats) -> f64| self.halves.each_ref().map(of);
        let ([rank_c, rank_u], [spread_c, spread_u]) = (pair(|h| h.rank), pair(|h| h.spread));
        let ([r2_c, r2_u], [leak_c, leak_u]) = (pair(|h| h.r_squared), pair(|h| h.leak));
        let ActionStats { true_px, zero_px, shuffled_px } = self.actions;
        let eigenvalue = self.eigenvalue.map_or_else(|| "-".into(), |value| format!("{value:.1e}"));
        let rows = [
            ("alarms: effective rank, z_c / z_u", format!("{rank_c:.2} / {rank_u:.2}")),
            ("alarms: spread over the gauge's, z_c / z_u", format!("{spread_c:.2} / {spread_u:.2}")),
            ("alarms: R² of its body, z_c / z_u", format!("{r2_c:.5} / {r2_u:.5}")),
            ("alarms: R² of the other body", format!("{leak_c:.4} / {leak_u:.4}")),
            (
                "alarms: rollout, true / zero / shuffled",
                format!("{true_px:.3} / {zero_px:.1} / {shuffled_px:.1} px"),
            ),
            ("alarms: second eigenvalue of z_u", eigenvalue),
        ];
        rows.iter().map(|(name, value)| format!("{name:<44} {value}\n")).collect()
    }
}

impl LatentStats {
    /// Diagnostics of a half, `[frames][16]`, with the positions of its own and the other body. `gauge` is
    /// the standard deviation that the half should have in all.
    #[must_use]
    pub fn new(z: &[[f32; LATENT]], own: &[Vector2<f64>], other: &[Vector2<f64>], gauge: f64) -> Self {
        let covariance = covariance(z);
        let variance = covariance.trace();
        Self {
            rank: effective_rank(&covariance),
            std: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()),
            spread: variance.max(0.0).sqrt() / gauge,
            r_squared: r_squared(z, own),
            leak: r_squared(z, other),
        }
    }

    fn alarms(&self, side: LatentHalf, limits: &AlarmLimits) -> Vec<CollapseCheck> {
        let mut alarms = Vec::new();
        if below(self.spread, limits.spread) {
            alarms.push(CollapseCheck::Collapsed(side, self.spread));
        } else if below(self.rank, limits.rank) {
            alarms.push(CollapseCheck::Rank(side, self.rank));
        }
        if below(self.r_squared, limits.r_squared) {
            alarms.push(CollapseCheck::Lost(side, self.r_squared));
        }
        if above(self.leak, limits.leak) {
            alarms.push(CollapseCheck::Leaks(side, self.leak));
        }
        alarms
    }
}

/// Below, or not a number.
fn below(value: f64, limit: f64) -> bool {
    value.is_nan() || value < limit
}

/// Above, or not a number.
fn above(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}

/// Standard deviations that the gauge gives to both halves in all: S times that of a position anywhere
/// in the square, and 1 on each of two axes.
#[must_use]
pub fn gauges(scale: f64) -> [f64; 2] {
    [scale * (2.0f64 / 12.0).sqrt(), std::f64::consts::SQRT_2]
}

/// Diagnostics of both halves, with the scenes that were encoded.
#[must_use]
pub fn halves(latents: &[Latent], scenes: &[Scene], scale: f64) -> [LatentStats; 2] {
    let uav: Vec<_> = scenes.iter().map(|s| s.uav).collect();
    let obstacle: Vec<_> = scenes.iter().map(|s| s.obstacle).collect();
    let z_c: Vec<_> = latents.iter().map(|l| l.z_c).collect();
    let z_u: Vec<_> = latents.iter().map(|l| l.z_u).collect();
    let [gauge_c, gauge_u] = gauges(scale);
    [LatentStats::new(&z_c, &uav, &obstacle, gauge_c), LatentStats::new(&z_u, &obstacle, &uav, gauge_u)]
}

/// Looks at a model through the cameras of its training: `count` frames, bodies anywhere, and
/// `rollouts` flights of `horizon` steps from rest.
#[must_use]
pub fn measure(
    model: &WorldModel,
    [count, rollouts, horizon]: [usize; 3],
    cameras: &CameraSet,
    scenario: &Scenario,
    noise: &Noise,
    eigenvalue: Option<f64>,
) -> Diagnostics {
    let mut rng = noise.generator(Stream::Evaluation, 20);
    let scenes: Vec<Scene> = (0..count).map(|_| labels::uniform_scene(scenario, &mut rng)).collect();
    let numbered: Vec<usize> = (0..count).collect();
    let latents = model.encode_all(&numbered, |&n| {
        let id = FrameId { series: n as u64, frame: 0 };
        cameras.apply(scenes[n].frame(scenario), id)
    });
    let actions = rollouts_from_rest(model, [rollouts, horizon], cameras, scenario, noise);
    Diagnostics { halves: halves(&latents, &scenes, model.scale), actions, eigenvalue }
}

/// Keeps the alarms' episodes apart from the training and the evaluation ones.
const ALARM_EPISODES: u64 = 11;

fn rollouts_from_rest(
    model: &WorldModel,
    [count, horizon]: [usize; 2],
    cameras: &CameraSet,
    scenario: &Scenario,
    noise: &Noise,
) -> ActionStats {
    let episodes = dataset::collect(count, horizon, EpisodeStart::Rest, scenario, noise, ALARM_EPISODES);
    let mut errors: [Vec<f64>; 3] = Default::default();
    for (n, episode) in episodes.iter().enumerate() {
        let id = FrameId { series: n as u64, frame: 1 };
        let start = model.encode(&cameras.apply(episode.frame(1, scenario), id));
        let goal = episode.uav[episode.uav.len() - 1];
        let other = &episodes[(n + 1) % episodes.len()].actions;
        let zero = vec![Vector2::zeros(); horizon];
        for (errors, actions) in errors.iter_mut().zip([&episode.actions, &zero, other]) {
            let y = vector(model.y_c(&start));
            let path = model.predictor.rollout(Begin { now: y, before: y, actions });
            let end = path.last().copied().unwrap_or(y);
            errors.push(SIDE as f64 * (model.probe.c.apply(end) - goal).abs().sum());
        }
    }
    let [true_px, zero_px, shuffled_px] = errors.map(|e| quantile(&e, 0.9));
    ActionStats { true_px, zero_px, shuffled_px }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Diagnostics {
        let half = LatentStats { rank: 2.0, spread: 1.0, r_squared: 0.9999, leak: 0.0, ..Default::default() };
        let actions = ActionStats { true_px: 0.1, zero_px: 100.0, shuffled_px: 140.0 };
        Diagnostics { halves: [half; 2], actions, eigenvalue: Some(8e-7) }
    }

    #[test]
    fn each_failure_says_so_in_words() {
        let limits = AlarmLimits::default();
        assert_eq!(good().alarms(&limits), []);
        let words = |change: fn(&mut Diagnostics)| {
            let mut diagnostics = good();
            change(&mut diagnostics);
            let alarms = diagnostics.alarms(&limits);
            alarms.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
        };
        assert_eq!(
            words(|f| f.halves[0].spread = 1e-3),
            "z_c has collapsed: it varies by 1.0e-3 of what it should"
        );
        assert_eq!(words(|f| f.halves[1].rank = 1.02), "z_u has collapsed to an effective rank of 1.02");
        assert_eq!(words(|f| f.halves[1].r_squared = 0.3), "z_u has lost the obstacle (R² 0.300)");
        assert_eq!(words(|f| f.halves[0].leak = 0.54), "z_c holds the obstacle, too (R² 0.540)");
        assert_eq!(
            words(|f| f.eigenvalue = Some(3.3e-5)),
            "z_u may not be the obstacle: its second eigenvalue is 3.3e-5; take more frames"
        );
        assert_eq!(
            words(|f| f.actions.zero_px = 0.5),
            "the actions hardly matter: wrong ones predict 5.0 times worse"
        );
        assert!(words(|f| f.actions.true_px = f64::NAN).starts_with("the actions hardly matter"));
    }
}
