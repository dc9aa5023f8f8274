//! Policies for worlds that no policy knows: optimised once, checked, kept in the cache, and said.

use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use crpl_model::planning::config::OptimiseConfig;
use crpl_sitl::Scenario;
use crpl_sitl::program::files::write_whole;

use crate::lab::attempts::{Begun, optimise_for};
use crate::lab::{check, optimise};
use crate::station::models::{MismatchRule, Models, PolicyUse};
use crate::station::pilot::Controller;

/// Where policies are kept if neither `CRPL_CACHE`, `XDG_CACHE_HOME` nor `HOME` is set.
const FALLBACK: &str = "runs/policies";

/// Seed of the optimisations that start by themselves.
const SEED: u64 = 1;

/// Sees to it that the policies which `controllers` fly cover `scenario`: where none does, Algorithm 1 runs
/// for this scenario, if `optimise` says so or a person at the terminal does, and its result is kept in the
/// cache. Does nothing where a mismatch is allowed. Gives whether Algorithm 1 has run, which takes its time.
///
/// # Errors
/// Nobody wants an optimisation: the difference to the nearest policy. A scenario that Algorithm 1 cannot plan
/// for; a result that breaks a chance constraint.
pub fn cover(
    models: &mut Models,
    controllers: &[Controller],
    scenario: &Scenario,
    optimise: bool,
) -> Result<bool> {
    if !controllers.iter().any(|c| c.flies_policies()) || models.mismatch == MismatchRule::Allow {
        return Ok(false);
    }
    if let Err(refusal) = models.policies(scenario, PolicyUse::Fly) {
        // No optimisation mends a scenario that no crpl controller can fly, or a file that was given.
        if models.covers(scenario)? || check::one_obstacle(scenario).is_err() {
            return Err(refusal);
        }
        if models.policy.is_some() || !(optimise || wanted(&refusal)?) {
            return Err(refusal);
        }
        let path = optimised(models, scenario)?;
        eprintln!("policies for {:?} are kept in {}", scenario.name, path.display());
        return Ok(true);
    }
    Ok(false)
}

/// Asks a person whether to optimise; nobody is asked where input or log is not a terminal.
fn wanted(refusal: &anyhow::Error) -> Result<bool> {
    if !(std::io::stdin().is_terminal() && std::io::stderr().is_terminal()) {
        return Ok(false);
    }
    eprint!("{refusal}.\nOptimise policies for this scenario now? [Y/n] ");
    std::io::stderr().flush().context("writing to the terminal")?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer).context("reading from the terminal")?;
    Ok(matches!(answer.trim().to_lowercase().as_str(), "" | "y" | "yes"))
}

/// Optimises for `scenario`, checks in closed loop, and keeps what passes; gives the file.
fn optimised(models: &mut Models, scenario: &Scenario) -> Result<PathBuf> {
    let config = OptimiseConfig::default();
    let mut watch = optimise::Show::unsaved(&config);
    let made = optimise_for(&models.world, scenario, &config, SEED, Begun::default(), &mut watch)?;
    made.flown.verdict().with_context(|| format!("optimising for {:?}", scenario.name))?;
    let dir = models.cache.get_or_insert_with(|| FALLBACK.into()).clone();
    let path = dir.join(models.cache_name(scenario)?);
    std::fs::create_dir_all(&dir).with_context(|| format!("creating {}", dir.display()))?;
    let manifest = optimise::PolicyManifest::of(scenario, SEED, &config, &made);
    let text = serde_json::to_string_pretty(&manifest)? + "\n";
    let beside = path.with_extension("json");
    write_whole(&beside, text.as_bytes()).with_context(|| format!("writing {}", beside.display()))?;
    let bytes = made.policies.to_bytes().map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?;
    write_whole(&path, &bytes).with_context(|| format!("writing {}", path.display()))?;
    Ok(path)
}
