//! The metadata of a checkpoint: its configuration and its metrics. Plain data; measured by
//! [`evaluation`](crate::evaluation).

use serde::{Deserialize, Serialize};

use crate::world_model::config::TrainConfig;

/// The metadata of a checkpoint; equal for equal seeds (time and revision are in card.md).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Card {
    /// `crpl-world-model/1`
    pub format: String,
    /// Backend that trained it: flex or ndarray.
    pub backend: String,
    /// Everything that decides its bytes.
    pub config: TrainConfig,
    /// Measured on held-out frames at the end of training.
    pub metrics: WorldMetrics,
}

/// Results on held-out data.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldMetrics {
    /// Decode errors.
    pub probe: ProbeMetrics,
    /// Latent rollouts.
    pub rollout: RolloutMetrics,
    /// Heads on frames, the base station where the scenario has it.
    pub heads: HeadMetrics,
    /// Heads at the end of latent rollouts, the same station.
    pub heads_after_rollout: HeadMetrics,
    /// Heads on frames, each with a base station anywhere in the frame's square.
    pub heads_anywhere: HeadMetrics,
    /// Heads at the end of latent rollouts, stations as above.
    pub heads_anywhere_after_rollout: HeadMetrics,
    /// Quality of the closed form, without labels.
    pub label_free: FitCheck,
    /// What the learned encoder's training found, without labels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned: Option<LearnedCheck>,
}

/// What a training on a recording found, without labels.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedCheck {
    /// |Ψ - (2I, -I)| with the ridge, on the planes.
    pub psi_off: f64,
    /// The same without the ridge.
    pub psi_off_free: f64,
    /// Distance of the centres at which the bodies touch, by the contacts, px.
    pub touch_px: f64,
    /// Episodes of the recording.
    pub episodes: usize,
}

/// Errors of the positions decoded from the latents, l1, px; share of variance leaked.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProbeMetrics {
    /// UAV at least 4 px from every edge, 90 % quantile.
    pub c_middle_p90_px: f64,
    /// UAV within 4 px of an edge: its disc is cut. 90 % quantile.
    pub c_edge_p90_px: f64,
    /// The same, largest error.
    pub c_edge_max_px: f64,
    /// Obstacle, 90 % quantile.
    pub u_p90_px: f64,
    /// Obstacle where the UAV covers a part of it, 90 % quantile.
    pub u_overlap_p90_px: f64,
    /// R² of the obstacle's position from z_c.
    pub leak_c_to_u: f64,
    /// R² of the UAV's position from z_u.
    pub leak_u_to_c: f64,
}

/// Errors of the UAV's position along latent rollouts from rest (both history frames equal).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RolloutMetrics {
    /// Share within 0.2 px after one step.
    pub one_step_within_02_px: f64,
    /// Share within 1 px at the end.
    pub end_within_1_px: f64,
    /// At the end with the true actions, 90 % quantile, px.
    pub true_p90_px: f64,
    /// With the actions set to zero.
    pub zero_p90_px: f64,
    /// With the actions of another trajectory.
    pub shuffled_p90_px: f64,
    /// Share of the candidates that stay in the frame and below v_max: all others are discarded. `None` in cards
    /// that were written before it was counted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceptance: Option<f64>,
}

/// Quality of the heads.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadMetrics {
    /// Area under the curve of p_coll > ½.
    pub collision_auc: f64,
    /// Expected calibration error of p_coll.
    pub collision_ece: f64,
    /// Mean absolute error of p_coll.
    pub collision_mae: f64,
    /// Root mean square error of |h|², dB.
    pub gain_rms_db: f64,
    /// 90 % quantile of its absolute error, dB.
    pub gain_p90_db: f64,
}

/// Quality of a fit, without labels.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitCheck {
    /// Rms residual of z_c's double differences, px.
    pub residual_c_px: f64,
    /// The smallest generalised eigenvalues of z_u's double differences. The second must lie below
    /// 2e-6 and the third far above, or z_u is not the obstacle.
    pub eigenvalues: [f64; 4],
}

impl WorldMetrics {
    /// The table that `model train` ends with.
    #[must_use]
    pub fn table(&self) -> String {
        let (p, r, h, e) = (&self.probe, &self.rollout, &self.heads, &self.heads_after_rollout);
        let (any, any_end) = (&self.heads_anywhere, &self.heads_anywhere_after_rollout);
        let decibels = |h: &HeadMetrics| format!("{:.3} / {:.3} dB", h.gain_rms_db, h.gain_p90_db);
        let check = &self.label_free;
        let rows = [
            ("z_c -> UAV, whole disc, p90", format!("{:.3} px", p.c_middle_p90_px)),
            ("z_c -> UAV, cut disc, p90", format!("{:.3} px", p.c_edge_p90_px)),
            ("z_c -> UAV, cut disc, largest", format!("{:.3} px", p.c_edge_max_px)),
            ("z_u -> obstacle, p90", format!("{:.3} px", p.u_p90_px)),
            ("z_u -> obstacle under the UAV, p90", format!("{:.3} px", p.u_overlap_p90_px)),
            ("leak z_c -> obstacle, R²", format!("{:.4}", p.leak_c_to_u)),
            ("leak z_u -> UAV, R²", format!("{:.4}", p.leak_u_to_c)),
            ("one step within 0.2 px", format!("{:.3}", r.one_step_within_02_px)),
            ("rollout from rest within 1 px at the end", format!("{:.3}", r.end_within_1_px)),
            ("  true actions, p90", format!("{:.3} px", r.true_p90_px)),
            ("  zero actions, p90", format!("{:.1} px", r.zero_p90_px)),
            ("  shuffled actions, p90", format!("{:.1} px", r.shuffled_p90_px)),
            ("  candidates kept for these rollouts", r.acceptance.map_or("not counted".into(), share)),
            ("collision AUC / ECE / MAE, frames", three(h)),
            ("collision AUC / ECE / MAE, after rollout", three(e)),
            ("gain rms / p90, frames", decibels(h)),
            ("gain rms / p90, after rollout", decibels(e)),
            ("  base station anywhere, ECE, frames", format!("{:.4}", any.collision_ece)),
            ("  base station anywhere, gain, frames", decibels(any)),
            ("  base station anywhere, gain, after rollout", decibels(any_end)),
            ("label-free: residual of z_c", format!("{:.3} px", check.residual_c_px)),
            ("label-free: eigenvalues of z_u", check.eigenvalues.map(|v| format!("{v:.1e}")).join(" ")),
        ];
        rows.iter().map(|(name, value)| format!("{name:<44} {value}\n")).collect()
    }
}

fn share(of: f64) -> String {
    format!("{of:.4}")
}

fn three(h: &HeadMetrics) -> String {
    format!("{:.4} / {:.4} / {:.4}", h.collision_auc, h.collision_ece, h.collision_mae)
}
