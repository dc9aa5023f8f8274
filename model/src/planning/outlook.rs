//! What the world model expects of the next intervals: latent rollouts of Algorithm 1 under a given policy, from a
//! belief and its uncertainty, told as places, gain and risk. For who watches a flight; no controller reads it.

use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::{Matrix2, Vector2};
use rand_distr::{Distribution, StandardNormal};

use crate::numeric::kernel::{LANES, ZERO};
use crate::numeric::mlp::Mlp;
use crate::planning::plant::{Draws, Execution, Objective, Plant, RolloutOptions};
use crate::planning::policy::FEATURES;
use crate::planning::problem::{PlanningProblem, PlanningState};
use crate::planning::rollout::forward;

/// Where an outlook begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlookStart {
    /// The belief.
    pub state: PlanningState,
    /// Covariances of y_c and of y_c - y_c', latent units squared.
    pub spread: [Matrix2<f64>; 2],
    /// The y_u that the policy reads, if it is not the first obstacle's own.
    pub reported_obstacle: Option<[f32; 2]>,
}

/// Rollouts side by side. The first member begins at the belief's mean in still air; the others differ by the
/// belief's uncertainty and by gusts.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlook {
    /// y_c after each interval, `[interval][member]`.
    pub y_c: Vec<[[f32; 2]; LANES]>,
    /// What the policies read at each interval of the first member.
    pub features: Vec<[f32; FEATURES]>,
    /// |h|²/P_n in each interval, `[interval][member]`: the SNR at a_p = 1, linear.
    pub gain: Vec<[f32; LANES]>,
    /// Probability of a collision with an obstacle after each interval, `[interval][member]`.
    pub risk: Vec<[f32; LANES]>,
}

impl PlanningProblem {
    /// `horizon` intervals of the motion policy `motion`. Equal noise and index give an equal outlook.
    #[must_use]
    pub fn outlook(
        &self,
        motion: &Mlp,
        from: &OutlookStart,
        noise: &Noise,
        index: u64,
        horizon: usize,
    ) -> Outlook {
        let mut draws = self.draws_from(&from.state, noise, index, LANES, horizon).swap_remove(0);
        draws.reported_obstacle = from.reported_obstacle;
        scatter(&mut draws, &from.spread, noise, index);
        let objective = Objective { snr_min: 1.0, ..Objective::default() };
        let options = RolloutOptions { eta: None, power: 1.0, execution: Execution::Nearest };
        // The field's edge is no obstacle: a record's collision probability does not have it either.
        let plant = Plant { edge: None, ..self.plant.clone() };
        let told = forward(&plant, &objective, options, motion, &draws).told();
        Outlook {
            y_c: told.y_c.map(|y| std::array::from_fn(|l| [y[0][l], y[1][l]])).collect(),
            features: told.x.chunks_exact(FEATURES).map(|x| std::array::from_fn(|i| x[i][0])).collect(),
            gain: told.ratio,
            risk: told.risk,
        }
    }
}

/// Moves every member but the first off the mean, and takes the first one's gusts away.
fn scatter(draws: &mut Draws, spread: &[Matrix2<f64>; 2], noise: &Noise, index: u64) {
    let mut rng = noise.generator(Stream::Evaluation, index);
    let roots = spread.map(|c| c.cholesky().map_or(Matrix2::zeros(), |root| root.l()));
    let mut drawn = |root: &Matrix2<f64>| {
        root * Vector2::new(StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng))
    };
    for l in 1..LANES {
        let (place, speed) = (drawn(&roots[0]), drawn(&roots[1]));
        for i in 0..2 {
            draws.start[0][i][l] += place[i] as f32;
            draws.start[1][i][l] += (place[i] - speed[i]) as f32;
        }
    }
    for gust in &mut draws.wind {
        (gust[0][0], gust[1][0]) = (ZERO[0], ZERO[0]);
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use crpl_sitl::world::channel;

    use super::*;
    use crate::encoder::BuiltIn;
    use crate::planning::config::OptimiseConfig;
    use crate::planning::policy::Policies;
    use crate::world_model::WorldModel;

    fn looked(spread: f64, index: u64) -> (WorldModel, Outlook) {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
        let scenario = Scenario::numbered(2).unwrap();
        let config =
            OptimiseConfig { starts: 1, gust_std: 0.0, gust_factor: 1.0, ..OptimiseConfig::default() };
        let problem = PlanningProblem::of(&world, &scenario, &config, 0).unwrap();
        let (y_c, y_u) = world.latents_at(scenario.start, scenario.obstacle().position);
        let state = PlanningState { y_c: [y_c; 2], y_u: [[y_u; 2]].into_iter().collect() };
        let spread = [Matrix2::identity() * spread.powi(2), Matrix2::identity() * spread.powi(2)];
        let start = OutlookStart { state, spread, reported_obstacle: None };
        let policies = Policies::shipped(BuiltIn::Centroid, 2).unwrap();
        let outlook = problem.outlook(&policies.motion, &start, &Noise::new(0), index, 100);
        (world, outlook)
    }

    #[test]
    fn the_shipped_policy_is_expected_at_the_goal() {
        let (world, outlook) = looked(0.01, 3);
        let goal = Scenario::numbered(2).unwrap().goal;
        let place = |member: usize| {
            let [x, y] = outlook.y_c[99][member];
            world.probe.c.apply(Vector2::new(x.into(), y.into()))
        };
        assert!((place(0) - goal).norm() < 0.05, "{}", place(0));
        assert!((1..LANES).all(|member| (place(member) - goal).norm() < 0.2));
        assert!((1..LANES).any(|member| place(member) != place(0)));
        assert!(outlook.risk.iter().flatten().all(|p| (0.0..=1.0).contains(p)));
    }

    #[test]
    fn equal_noise_gives_an_equal_outlook_and_another_tick_another() {
        assert_eq!(looked(0.01, 3).1, looked(0.01, 3).1);
        assert_ne!(looked(0.01, 3).1, looked(0.01, 4).1);
        // The first member is the mean in still air, whatever the tick.
        let first = |outlook: Outlook| outlook.y_c.iter().map(|y| y[0]).collect::<Vec<_>>();
        assert_eq!(first(looked(0.01, 3).1), first(looked(0.1, 4).1));
    }

    #[test]
    fn members_spread_by_the_covariances_of_place_and_speed() {
        let scatter_of = |place: f64, speed: f64| {
            let lane = |v: f32| [v; LANES];
            let mut all: [Vec<f64>; 2] = Default::default();
            for index in 0..200 {
                let mut draws = Draws {
                    start: [[lane(2.0), lane(-1.0)], [lane(1.5), lane(-1.2)]],
                    obstacles: Vec::new(),
                    reported_obstacle: None,
                    wind: vec![[lane(0.7); 2]; 3],
                    beyond: 0,
                    opening: Vec::new(),
                };
                let spread = [place, speed].map(|s| Matrix2::identity() * s.powi(2));
                scatter(&mut draws, &spread, &Noise::new(2), index);
                let [now, before] = &draws.start;
                assert_eq!([now[0][0], now[1][0], before[0][0], before[1][0]], [2.0, -1.0, 1.5, -1.2]);
                for (gust, l) in draws.wind.iter().flat_map(|gust| (0..LANES).map(move |l| (gust, l))) {
                    assert_eq!([gust[0][l], gust[1][l]], [if l == 0 { 0.0 } else { 0.7 }; 2]);
                }
                for l in 1..LANES {
                    for (i, mean, step) in [(0, 2.0, 0.5), (1, -1.0, 0.2)] {
                        all[0].push(f64::from(now[i][l]) - mean);
                        all[1].push(f64::from(now[i][l] - before[i][l]) - step);
                    }
                }
            }
            all.map(|all| (all.iter().map(|v| v * v).sum::<f64>() / all.len() as f64).sqrt())
        };
        let near = |found: f64, wanted: f64| (found - wanted).abs() < 0.03 * wanted + 1e-6;
        let [place, speed] = scatter_of(0.2, 0.0);
        assert!(near(place, 0.2) && near(speed, 0.0), "{place} {speed}");
        let [place, speed] = scatter_of(0.0, 0.1);
        assert!(near(place, 0.0) && near(speed, 0.1), "{place} {speed}");
        let [place, speed] = scatter_of(0.2, 0.1);
        assert!(near(place, 0.2) && near(speed, 0.1), "{place} {speed}");
    }

    #[test]
    fn gain_is_the_snr_at_the_power_of_one_and_the_edge_is_no_risk() {
        let (world, outlook) = looked(0.0, 0);
        let mut scenario = Scenario::numbered(2).unwrap();
        let snr = |uav: Vector2<f64>| {
            let o = scenario.obstacle();
            channel::gain(uav, o.position, o.radius, &scenario.channel) / scenario.channel.noise_power
        };
        let [x, y] = outlook.y_c[0][0];
        let there = world.probe.c.apply(Vector2::new(x.into(), y.into()));
        let told = f64::from(outlook.gain[0][0]);
        assert!((told / snr(there)).ln().abs() < 0.3, "{told} instead of {}", snr(there));

        // At the edge's margin the constraint's own risk would be a half.
        scenario.safety.edge_margin = 0.05;
        let config = OptimiseConfig { starts: 1, ..OptimiseConfig::default() };
        let problem = PlanningProblem::of(&world, &scenario, &config, 0).unwrap();
        let (y_c, y_u) = world.latents_at(Vector2::new(0.5, 0.02), Vector2::new(0.5, 0.9));
        let state = PlanningState { y_c: [y_c; 2], y_u: [[y_u; 2]].into_iter().collect() };
        let start = OutlookStart { state, spread: [Matrix2::zeros(); 2], reported_obstacle: None };
        let motion = Policies::shipped(BuiltIn::Centroid, 2).unwrap().motion;
        let risk = problem.outlook(&motion, &start, &Noise::new(0), 0, 1).risk[0][0];
        assert!(risk < 0.01, "{risk}");
    }
}
