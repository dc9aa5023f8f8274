//! Algorithm 1 and the closed-loop check, attempt by attempt: what makes a policy for any scenario.

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::algorithm1::{
    Comparison, OptimiseOutcome, OptimiseProgress, OptimiseWatch, optimise,
};
use crpl_model::planning::config::{Attempt, HOPELESS, OptimiseConfig, OptimiseError};
use crpl_model::planning::plant::ObjectiveEstimate;
use crpl_model::planning::policy::Policies;
use crpl_model::planning::problem::PlanningProblem;
use crpl_model::planning::scope::PolicyScope;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::program::timing::Stopwatch;

use crate::lab::check::{self, ConstraintCheck, one_obstacle};

/// What [`optimise_for`] made.
#[derive(Debug, Clone)]
pub struct Optimised {
    /// The pair, with its scope.
    pub policies: Policies,
    /// What Algorithm 1 says of it.
    pub outcome: OptimiseOutcome,
    /// The chance constraints as closed-loop flights measure them.
    pub flown: ConstraintCheck,
    /// Attempts that it took.
    pub attempts: usize,
    /// Time that it took, s.
    pub wall_s: f64,
}

/// The attempt that was under way, and its progress.
pub type Begun = (Attempt, Option<OptimiseProgress>);

/// What sees the attempts and their iterations.
pub trait AttemptWatch: OptimiseWatch {
    /// What may stop it.
    fn stop(&self) -> Option<&StopSignal> {
        None
    }

    /// An attempt begins.
    fn attempt(&mut self, attempt: Attempt, config: &OptimiseConfig);
    /// Its policies have been checked.
    fn flown(&mut self, check: &ConstraintCheck);
}

/// Algorithm 1 for a scenario and the closed-loop check of what it found, with tighter constraints at each
/// attempt until a pair passes; nothing is written. `begun` is the attempt that was under way, and its progress.
///
/// # Errors
/// A scenario that Algorithm 1 cannot plan for. A result that breaks a constraint is no error here: see
/// [`ConstraintCheck::verdict`].
pub fn optimise_for(
    world: &Arc<WorldModel>,
    scenario: &Scenario,
    config: &OptimiseConfig,
    seed: u64,
    begun: Begun,
    watch: &mut impl AttemptWatch,
) -> Result<Optimised> {
    config.check()?;
    one_obstacle(scenario)?;
    let stopwatch = Stopwatch::default();
    let problem = PlanningProblem::of(world, scenario, config, seed)?;
    let (mut attempt, mut progress) = begun;
    let mut best: Option<Optimised> = None;
    let last = config.attempts.max(attempt.number + 1);
    while attempt.number < last {
        let config = config.attempt(attempt);
        watch.attempt(attempt, &config);
        let (mut policies, outcome) =
            match optimise(&problem, &config, attempt.seed(seed), progress.take(), watch) {
                Err(error) => match watch.stop().and_then(StopSignal::get) {
                    Some(signal) => bail!(signal.exit(&error.to_string())),
                    None => return Err(error.into()),
                },
                Ok(found) => found,
            };
        let flown = check::after(&config, world, &policies, scenario, watch.stop())?;
        watch.flown(&flown);
        policies.scope = Some(PolicyScope::new(scenario.clone(), flown.gust_std));
        let made = Optimised {
            policies,
            outcome,
            flown,
            attempts: attempt.number + 1,
            wall_s: stopwatch.seconds().0,
        };
        let (holds, least) = (flown.holds(), flown.least());
        if best.as_ref().is_none_or(|best| best.flown.least() <= flown.least()) {
            best = Some(made);
        }
        if holds {
            break;
        }
        attempt = if least < HOPELESS {
            attempt.afresh()
        } else {
            attempt.next(flown.safe.holds(), flown.comm.holds())
        };
    }
    let best = best.context("no attempt was made")?;
    Ok(Optimised { wall_s: stopwatch.seconds().0, ..best })
}

/// Shows nothing and saves nothing.
pub struct Quiet;

impl AttemptWatch for Quiet {
    fn attempt(&mut self, _: Attempt, _: &OptimiseConfig) {}
    fn flown(&mut self, _: &ConstraintCheck) {}
}

impl OptimiseWatch for Quiet {
    fn iteration(&mut self, _: &str, _: usize, _: usize, _: &ObjectiveEstimate, _: f64) {}
    fn phase_done(&mut self, _: &str, _: &OptimiseProgress) -> Result<(), OptimiseError> {
        Ok(())
    }
    fn compared(&mut self, _: &Comparison) {}
}
