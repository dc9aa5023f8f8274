//! What the risk and channel heads learn from and how they are judged: collision probability and
//! ln |h|² of a scene and a base station.
//!
//! The encoder is frozen: labels never reach it. Frames are drawn where it matters: a third near a
//! collision, a third near a blocked line of sight, a third anywhere.

use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::{channel, safety};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// How the heads are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadsConfig {
    /// Labelled frames.
    pub frames: usize,
    /// Steps of Adam, each head.
    pub steps: usize,
    /// Frames a step.
    pub batch: usize,
    /// Learning rate at the start; falls to 1 % of it as a cosine.
    pub learning_rate: f64,
    /// Smallest distance to the base station in the gain's label, units: ln d^-2 has no bound there,
    /// and no link fails there.
    pub distance_floor: f64,
}

impl Default for HeadsConfig {
    fn default() -> Self {
        Self { frames: 24_000, steps: 6000, batch: 512, learning_rate: 2e-2, distance_floor: 0.02 }
    }
}

/// A place of both bodies, paper units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// r_c
    pub uav: Vector2<f64>,
    /// r_u
    pub obstacle: Vector2<f64>,
}

/// Ground truth of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Label {
    /// p_coll
    pub collision: f64,
    /// ln |h|², distance kept above the floor.
    pub log_gain: f64,
}

impl Scene {
    /// Its frame.
    #[must_use]
    pub fn frame(&self, scenario: &Scenario) -> crpl_sitl::camera::Frame {
        crpl_sitl::camera::render(self.uav, self.obstacle, scenario)
    }

    /// Its ground truth for a base station at `station`.
    #[must_use]
    pub fn label(&self, station: Vector2<f64>, scenario: &Scenario, distance_floor: f64) -> Label {
        let radius = scenario.obstacle().radius;
        let clearance = safety::clearance(self.uav, self.obstacle, scenario.uav_radius, radius);
        let mut link = scenario.channel.clone();
        link.base_station = station;
        link.distance_floor = link.distance_floor.max(distance_floor);
        Label {
            collision: safety::collision_probability(
                clearance,
                scenario.safety.d_min,
                scenario.safety.softness,
            ),
            log_gain: channel::gain(self.uav, self.obstacle, radius, &link).ln(),
        }
    }
}

/// UAV anywhere in `[0,1]`², obstacle anywhere that its walls allow.
#[must_use]
pub fn uniform_scene(scenario: &Scenario, rng: &mut impl Rng) -> Scene {
    let mut place = |margin: f64| margin + (1.0 - 2.0 * margin) * rng.random::<f64>();
    let uav = Vector2::new(place(0.0), place(0.0));
    let margin = scenario.obstacle().margin;
    Scene { uav, obstacle: Vector2::new(place(margin), place(margin)) }
}

/// Where the base stands in a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BaseStation {
    /// Where the scenario has it.
    Given,
    /// Anywhere in the frame's square, uniformly: what the heads are trained on.
    Anywhere,
}

impl BaseStation {
    /// s_BS, paper units.
    #[must_use]
    pub fn draw(self, scenario: &Scenario, rng: &mut impl Rng) -> Vector2<f64> {
        match self {
            Self::Given => scenario.channel.base_station,
            Self::Anywhere => Vector2::new(rng.random(), rng.random()),
        }
    }
}

/// `count` scenes, each with its base station's place: a third near a collision, a third near a
/// blocked sight line, a third anywhere.
#[must_use]
pub fn sample(
    count: usize,
    station: BaseStation,
    scenario: &Scenario,
    rng: &mut impl Rng,
) -> Vec<(Scene, Vector2<f64>)> {
    let margin = scenario.obstacle().margin;
    let inside = |r: Vector2<f64>| r.map(|x| x.clamp(margin, 1.0 - margin));
    (0..count)
        .map(|n| {
            let scene = uniform_scene(scenario, rng);
            let station = station.draw(scenario, rng);
            let obstacle = match n % 3 {
                0 => {
                    let angle = std::f64::consts::TAU * rng.random::<f64>();
                    let distance = 0.04 + 0.2 * rng.random::<f64>();
                    scene.uav + distance * Vector2::new(angle.cos(), angle.sin())
                }
                1 => {
                    let along = scene.uav + (station - scene.uav) * rng.random::<f64>();
                    let mut aside = || -> f64 { StandardNormal.sample(rng) };
                    along + 0.08 * Vector2::new(aside(), aside())
                }
                _ => scene.obstacle,
            };
            (Scene { obstacle: inside(obstacle), ..scene }, station)
        })
        .collect()
}

/// Area under the receiver's curve of `score` for the events `hit`; ½ if all or none are hits.
#[must_use]
pub fn auc(score: &[f64], hit: &[bool]) -> f64 {
    let mut order: Vec<usize> = (0..score.len()).collect();
    order.sort_by(|a, b| score[*a].total_cmp(&score[*b]));
    let (mut ranks, mut hits) = (0.0, 0.0);
    for (rank, &n) in order.iter().enumerate() {
        if hit[n] {
            ranks += rank as f64 + 1.0;
            hits += 1.0;
        }
    }
    let pairs = hits * (score.len() as f64 - hits);
    if pairs > 0.0 { (ranks - hits * (hits + 1.0) / 2.0) / pairs } else { 0.5 }
}

/// Expected calibration error: mean distance of predicted and true probability over ten bins.
#[must_use]
pub fn calibration_error(predicted: &[f64], truth: &[f64]) -> f64 {
    let mut bins = [(0.0, 0.0); 10];
    for (p, t) in predicted.iter().zip(truth) {
        let bin = &mut bins[((p * 10.0) as usize).min(9)];
        bin.0 += p;
        bin.1 += t;
    }
    bins.iter().map(|(p, t)| (p - t).abs()).sum::<f64>() / predicted.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_the_worlds() {
        let scenario = Scenario::default();
        let scene = Scene { uav: Vector2::new(0.5, 0.52), obstacle: Vector2::new(0.5, 0.40) };
        let station = scenario.channel.base_station;
        let label = scene.label(station, &scenario, 0.02);
        assert!((label.collision - 0.5).abs() < 1e-9, "contact is one half, not {}", label.collision);
        let above = Scene { uav: Vector2::new(0.5, 0.05), obstacle: Vector2::new(0.2, 0.8) };
        assert!((above.label(station, &scenario, 0.02).log_gain - 2500f64.ln()).abs() < 1e-6);
        let far = Vector2::new(0.5, 0.55);
        assert!((above.label(far, &scenario, 0.02).log_gain - 4f64.ln()).abs() < 1e-6);
    }

    #[test]
    fn scores_of_a_perfect_and_of_a_blind_judge() {
        let hit: Vec<bool> = (0..100).map(|k| k >= 60).collect();
        let rising: Vec<f64> = (0..100).map(f64::from).collect();
        let falling: Vec<f64> = (0..100).map(|k| -f64::from(k)).collect();
        assert!((auc(&rising, &hit) - 1.0).abs() < 1e-12 && auc(&falling, &hit).abs() < 1e-12);
        assert!((calibration_error(&[0.25, 0.75], &[0.35, 0.75]) - 0.05).abs() < 1e-12);
    }
}
