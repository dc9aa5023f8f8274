//! `gcs check`: the chance constraints as closed-loop flights measure them.
//!
//! Algorithm 1 sees latents and smooth stand-ins of the constraints alone. Here the pair of policies
//! flies the same loop as every other flight (frames rendered and encoded, commands through the radio),
//! and the flights that keep each constraint are counted: P_safe is the share of flights without a
//! collision that never come nearer to the field's edge than its margin, P_comm the share of flights whose SNR, at the executed powers, never falls below what a packet needs,
//! max(γ_min, 2^(L/(B Δt)) - 1).

use std::sync::Arc;

use anyhow::{Result, bail};
use crpl_model::numeric::statistics::{Interval, wilson};
use crpl_model::planning::config::OptimiseConfig;
use crpl_model::planning::policy::Policies;
use crpl_model::planning::scope;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::terminal::{StopSignal, positive};
use crpl_sitl::scenario::presets;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::Snr;
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::lab::Contender;
use crate::station::models::ModelFiles;
use crate::station::pilot::Controller;

/// Flags of `gcs check`.
#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
pub struct Check {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    #[command(flatten)]
    models: ModelFiles,
    /// Number of flights
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// Standard deviation of the gusts, in units per interval, if the scenario has none
    #[arg(long, value_name = "X", default_value_t = OptimiseConfig::default().check_gust_std, value_parser = positive)]
    gust_std: f64,
    /// First of the consecutive seeds
    #[arg(long, value_name = "N", default_value_t = FIRST_CHECK)]
    first_seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// First seed of the flights that check a policy: far from the seeds of sweeps and of training.
const FIRST_CHECK: u64 = 3_000_000;

/// How often flights kept one chance constraint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConstraintRate {
    /// Share of the flights, 0 to 1.
    pub share: f64,
    /// Its 95 % Wilson interval.
    pub ci: Interval,
    /// 1 - δ, or the share that is needed.
    pub needed: f64,
}

impl ConstraintRate {
    fn of(kept: usize, flights: usize, needed: f64) -> Self {
        Self { share: kept as f64 / flights.max(1) as f64, ci: wilson(kept, flights), needed }
    }

    /// Whether the low end of the interval reaches what is needed.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.ci[0] >= self.needed
    }
}

/// Both chance constraints, measured in closed loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConstraintCheck {
    /// Flights.
    pub flights: usize,
    /// Seed of the first one.
    pub first_seed: u64,
    /// Standard deviation of the gusts' velocity change, units per interval.
    pub gust_std: f64,
    /// Flights without a collision that kept the edge's margin.
    pub safe: ConstraintRate,
    /// Flights whose SNR never fell below what a packet needs, max(γ_min, 2^(L/(B Δt)) - 1).
    pub comm: ConstraintRate,
    /// Flights that ended in the goal region.
    pub reached: ConstraintRate,
    /// Mean number of intervals in outage.
    pub t_out: f64,
    /// Mean terminal distance to the goal, units.
    pub d_f: f64,
}

impl ConstraintCheck {
    /// Flies `flights` seeds from `first_seed` on, on all cores.
    ///
    /// # Errors
    /// A flight without an interval.
    /// A signal, too, ends it.
    pub fn measure(
        contender: &Contender,
        reached: f64,
        flights: usize,
        first_seed: u64,
        stop: Option<&StopSignal>,
    ) -> Result<Self> {
        let scenario = contender.scenario();
        let safety = &scenario.safety;
        let ends: Vec<End> = (0..flights as u64)
            .into_par_iter()
            .filter(|_| stop.is_none_or(|stop| stop.get().is_none()))
            .map(|n| Ok(End::of(&contender.records(first_seed + n)?, scenario)))
            .collect::<Result<_>>()?;
        if let Some(signal) = stop.and_then(StopSignal::get) {
            bail!(signal.exit(&format!("the check has flown {} of {flights}", ends.len())));
        }
        let count = |kept: fn(&End) -> bool| ends.iter().filter(|end| kept(end)).count();
        Ok(Self {
            flights,
            first_seed,
            gust_std: scenario.disturbance.gust_std(),
            safe: ConstraintRate::of(count(|end| end.clear), flights, 1.0 - safety.collision_tolerance),
            comm: ConstraintRate::of(count(|end| end.connected), flights, 1.0 - safety.outage_tolerance),
            reached: ConstraintRate::of(count(|end| end.reached), flights, reached),
            t_out: ends.iter().map(|end| end.outages as f64).sum::<f64>() / flights.max(1) as f64,
            d_f: ends.iter().map(|end| end.d_f).sum::<f64>() / flights.max(1) as f64,
        })
    }

    /// The rates by name. Of the constraints the low end of the interval must reach what is needed, of `reached`
    /// the share itself.
    fn rates(&self) -> [(&'static str, &ConstraintRate, bool); 3] {
        let reached = self.reached.share >= self.reached.needed;
        [
            ("P_safe", &self.safe, self.safe.holds()),
            ("P_comm", &self.comm, self.comm.holds()),
            ("reached", &self.reached, reached),
        ]
    }

    /// The smallest share over what is needed: how far from passing a check is.
    #[must_use]
    pub fn least(&self) -> f64 {
        self.rates().iter().map(|(_, rate, _)| rate.share / rate.needed).fold(f64::INFINITY, f64::min)
    }

    /// Whether both constraints hold, and enough flights reach the goal.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.rates().iter().all(|(.., holds)| *holds)
    }

    /// # Errors
    /// Names the constraint that the flights did not keep.
    pub fn verdict(&self) -> Result<()> {
        for (what, rate, holds) in self.rates() {
            if !holds {
                bail!(
                    "the policy does not ship: {what} measured in {} flights is {:.4} (95 % interval from \
                     {:.4}), needed {}",
                    self.flights,
                    rate.share,
                    rate.ci[0],
                    rate.needed
                );
            }
        }
        Ok(())
    }
}

impl std::fmt::Display for ConstraintCheck {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (what, rate, _) in self.rates() {
            writeln!(
                f,
                "{what} {:.4} [{:.4}, {:.4}] in {} closed-loop flights, gusts {}; needed {}",
                rate.share, rate.ci[0], rate.ci[1], self.flights, self.gust_std, rate.needed
            )?;
        }
        Ok(())
    }
}

/// Whether a UAV at `r` keeps `margin` to the field's edge, units; always, where there is none to keep.
fn inside(r: Vector2<f64>, margin: f64) -> bool {
    margin == 0.0 || r.iter().all(|x| (margin..=1.0 - margin).contains(x))
}

/// The result of one flight.
struct End {
    clear: bool,
    connected: bool,
    reached: bool,
    outages: usize,
    d_f: f64,
}

impl End {
    fn of(records: &[Record], scenario: &Scenario) -> Self {
        let needed = scope::required_snr(scenario);
        let d_f = records.last().map_or(f64::NAN, |last| (last.r_next - scenario.goal).norm());
        Self {
            clear: records.iter().all(|r| !r.collided && inside(r.r_next, scenario.safety.edge_margin)),
            connected: records.iter().all(|r| Snr::from_db(f64::from(r.snr_db)).0 >= needed * (1.0 - F32)),
            reached: d_f <= scenario.goal_radius,
            outages: records.iter().filter(|r| r.outage).count(),
            d_f,
        }
    }
}

/// What an SNR in dB loses on the wire, relative.
const F32: f64 = 1e-6;

/// Runs `gcs check`.
///
/// # Errors
/// Missing or mismatched files, and a policy that breaks a constraint.
pub fn run(args: &Check) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    one_obstacle(&scenario)?;
    let models = args.models.load()?;
    let contender = Contender::new(&models, Controller::Crpl, &gusty(&scenario, args.gust_std))?;
    let (flights, config) = (usize::try_from(args.episodes)?, OptimiseConfig::default());
    let check = ConstraintCheck::measure(
        &contender,
        config.check_reached,
        flights,
        args.first_seed,
        Some(&StopSignal::listen()?),
    )?;
    if args.json {
        crpl_sitl::outln!("{}", serde_json::to_string(&check)?);
    } else {
        crpl_sitl::out!("{}", columns::wrapped(&check.to_string(), 2, columns::width()));
    }
    check.verdict()
}

/// Algorithm 1 knows one obstacle, which stands.
pub(crate) fn one_obstacle(scenario: &Scenario) -> Result<()> {
    if scenario.obstacles.len() != 1 {
        bail!(
            "scenario {:?} has {} obstacles; Algorithm 1 plans for one, crpl-rh in flight for two",
            scenario.name,
            scenario.obstacles.len()
        );
    }
    Ok(())
}

/// The check that follows an optimisation with `config`.
///
/// # Errors
/// As [`ConstraintCheck::measure`].
pub fn after(
    config: &OptimiseConfig,
    world: &Arc<WorldModel>,
    policies: &Policies,
    scenario: &Scenario,
    stop: Option<&StopSignal>,
) -> Result<ConstraintCheck> {
    let contender = Contender::with_policies(world, policies, &gusty(scenario, config.check_gust_std));
    ConstraintCheck::measure(&contender, config.check_reached, config.check_flights, FIRST_CHECK, stop)
}

/// The scenario with its own gusts, or with gusts of standard deviation `gust_std` if it has none.
fn gusty(scenario: &Scenario, gust_std: f64) -> Scenario {
    let mut scenario = scenario.clone();
    if scenario.disturbance.sigma_c == 0.0 {
        scenario.disturbance.sigma_c = gust_std / scenario.disturbance.gust_scale;
    }
    scenario
}
