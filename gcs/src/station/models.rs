//! The trained models that a station flies with: the world model and CRPL's policies.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::policy::{Policies, SHIPPED};
use crpl_model::planning::scope::{self, KeyDifference};
use crpl_model::world_model::{WorldModel, checkpoint};
use crpl_sitl::Scenario;
use crpl_sitl::camera::COLOURS;
use crpl_sitl::program::files::fingerprint;
use serde::Serialize;

use crate::station::pilot::laws::Laws;
use crate::station::pilot::own::OwnFlags;

/// The trained things that a station needs.
#[derive(Debug, Clone)]
pub struct Models {
    /// The world model, which encodes every frame.
    pub world: Arc<WorldModel>,
    /// A policy file instead of the shipped ones.
    pub policy: Option<PathBuf>,
    /// What happens where no policy covers the scenario.
    pub mismatch: MismatchRule,
    /// Folder of policies that were optimised on this machine, named by [`Models::cache_name`].
    pub cache: Option<PathBuf>,
    /// What `rcc` and `ucc` fly.
    pub laws: Laws,
    /// How long controllers of somebody's own are waited for.
    pub own: OwnFlags,
}

/// What happens where a policy was optimised for another world than the scenario.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MismatchRule {
    /// An error that names the difference
    #[default]
    Refuse,
    /// It flies, and every result says so
    Allow,
}

/// What a controller does with the policies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PolicyUse {
    /// It flies them: they must cover the scenario.
    Fly,
    /// It begins its own search with them: any will do, and the results say which.
    Begin,
}

/// Where the policies of a flight come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PolicyOrigin {
    /// `built-in NAME` or the file.
    pub source: String,
    /// Fingerprint of its bytes.
    pub fingerprint: String,
    /// Where the scenario leaves the world that they were optimised for; empty if they cover it.
    pub differences: Vec<KeyDifference>,
}

impl PolicyOrigin {
    /// The differences in one line, at most three of them; `None` if the policies cover the scenario.
    #[must_use]
    pub fn mismatch(&self) -> Option<String> {
        const SHOWN: usize = 3;
        let all = &self.differences;
        let shown = all.iter().take(SHOWN).map(ToString::to_string).collect::<Vec<_>>().join("; ");
        match all.len() {
            0 => None,
            n if n > SHOWN => Some(format!("{shown}; and {} more keys", n - SHOWN)),
            _ => Some(shown),
        }
    }
}

/// Policies, and where they come from.
#[derive(Debug, Clone)]
pub struct ChosenPolicies {
    /// Both policies.
    pub policies: Policies,
    /// Where they come from.
    pub origin: PolicyOrigin,
}

impl Models {
    /// The shipped world model and policies, or those in `checkpoint` and `policy`. Without a cache; a policy
    /// of another world is refused.
    ///
    /// # Errors
    /// No world model in the folder.
    pub fn load(checkpoint: Option<&Path>, policy: Option<PathBuf>) -> Result<Self> {
        let world = match checkpoint {
            Some(dir) => WorldModel::named(dir)?,
            None => WorldModel::embedded()?,
        };
        let laws = Laws::load::<&Path>(&[])?;
        Ok(Self {
            world: Arc::new(world),
            policy,
            mismatch: MismatchRule::Refuse,
            cache: None,
            laws,
            own: OwnFlags::default(),
        })
    }

    /// The policies for `scenario`: the file that was given, or the first of the shipped ones and of the
    /// cache that covers it, or, where that is allowed, the one with the fewest differences.
    ///
    /// # Errors
    /// A file that does not read, policies of another world model, and where they must cover the scenario
    /// none that does: with the differences.
    pub fn policies(&self, scenario: &Scenario, purpose: PolicyUse) -> Result<ChosenPolicies> {
        let count = scenario.obstacles.len();
        if !(1..=COLOURS).contains(&count) {
            bail!(
                "scenario {:?} has {count} obstacles; a crpl controller sees them in the frame's colours, \
                 which tell 1 to {COLOURS} apart: apc, rcc and ucc fly with any number",
                scenario.name
            );
        }
        let here = checkpoint::planning_fingerprint(&self.world)?;
        let chosen = self.nearest(scenario, &here)?;
        let theirs = &chosen.policies.world;
        if *theirs != here {
            bail!(
                "the policies ({}) were optimised in world model {}, and this is {here}: --optimise or \
                 `gcs optimise` makes policies for it",
                chosen.origin.source,
                if theirs.is_empty() { "(unnamed)" } else { theirs }
            );
        }
        let refuse = purpose == PolicyUse::Fly && self.mismatch == MismatchRule::Refuse;
        match chosen.origin.mismatch().filter(|_| refuse) {
            None => Ok(chosen),
            Some(difference) => bail!(
                "no policy for scenario {:?}: {} was optimised for another world: {difference}; --optimise \
                 makes a policy for this one, --policy-mismatch allow flies that of the other",
                scenario.name,
                chosen.origin.source
            ),
        }
    }

    /// Whether there are policies that cover `scenario`, in this world model.
    ///
    /// # Errors
    /// A file that does not read.
    pub fn covers(&self, scenario: &Scenario) -> Result<bool> {
        let here = checkpoint::planning_fingerprint(&self.world)?;
        let chosen = self.nearest(scenario, &here)?;
        Ok(chosen.policies.world == here && chosen.origin.differences.is_empty())
    }

    /// Name of the file in the cache of policies for `scenario` in this world model.
    ///
    /// # Errors
    /// The world model has no fingerprint.
    pub fn cache_name(&self, scenario: &Scenario) -> Result<String> {
        let world = checkpoint::planning_fingerprint(&self.world)?;
        Ok(format!("{}-{world}.safetensors", scope::fingerprint(scenario)))
    }

    /// The given file; else the one with the fewest differences of the shipped and the cache's, those of this
    /// world model first.
    fn nearest(&self, scenario: &Scenario, world: &str) -> Result<ChosenPolicies> {
        let chosen = |source: String, bytes: &[u8]| -> Result<ChosenPolicies> {
            let policies = Policies::from_bytes(bytes).map_err(|e| anyhow::anyhow!("{source}: {e}"))?;
            let differences = match &policies.scope {
                Some(scope) => scope.differences(scenario),
                None => vec![KeyDifference {
                    key: "scenario".into(),
                    policy: "not stated".into(),
                    here: format!("{:?}", scenario.name),
                }],
            };
            let origin = PolicyOrigin { source, fingerprint: fingerprint(bytes), differences };
            Ok(ChosenPolicies { policies, origin })
        };
        let read = |path: &Path| std::fs::read(path).with_context(|| format!("reading {}", path.display()));
        if let Some(path) = &self.policy {
            return chosen(path.display().to_string(), &read(path)?);
        }
        let mut all = Vec::new();
        for (name, bytes) in SHIPPED {
            all.push(chosen(format!("built-in {name}"), bytes)?);
        }
        if let Some(dir) = &self.cache {
            let path = dir.join(self.cache_name(scenario)?);
            if path.exists() {
                all.push(chosen(path.display().to_string(), &read(&path)?)?);
            }
        }
        let nearest = all.into_iter().min_by_key(|c| (c.policies.world != world, c.origin.differences.len()));
        nearest.context("no policy ships with this program")
    }
}

/// Flags that name the trained models.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ModelFiles {
    /// World model: a folder, or `learned` or `centroid`, which are built in [default: learned]
    #[arg(long, value_name = "DIR")]
    pub checkpoint: Option<PathBuf>,
    /// File of CRPL's policies [default: the built-in ones]
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
    /// File of `gcs tune` with the numbers of rcc or ucc; repeatable [default: the built-in ones]
    #[arg(long, value_name = "FILE")]
    pub gains: Vec<PathBuf>,
    /// What to do with a policy that was optimised for another world than the scenario
    #[arg(long, value_enum, value_name = "RULE", default_value = "refuse")]
    pub policy_mismatch: MismatchRule,
    /// Optimise policies for a scenario that no policy covers, once, and keep them in the cache
    #[arg(long, conflicts_with_all = ["policy_mismatch", "policy"])]
    pub optimise: bool,
    /// Controllers of somebody's own
    #[command(flatten)]
    pub own: OwnFlags,
}

/// Folder of the policies that were optimised on this machine: $CRPL_CACHE, $XDG_CACHE_HOME/crpl or
/// ~/.cache/crpl; `None` where none of them is set.
#[must_use]
pub fn cache_folder() -> Option<PathBuf> {
    let named = |key: &str| std::env::var_os(key).filter(|value| !value.is_empty()).map(PathBuf::from);
    let xdg = || named("XDG_CACHE_HOME").map(|dir| dir.join("crpl"));
    named("CRPL_CACHE").or_else(xdg).or_else(|| named("HOME").map(|dir| dir.join(".cache/crpl")))
}

impl ModelFiles {
    /// Loads the world model; policies are loaded with the controller that needs them.
    ///
    /// # Errors
    /// No world model in the folder.
    pub fn load(&self) -> Result<Models> {
        let models = Models::load(self.checkpoint.as_deref(), self.policy.clone())?;
        let laws = Laws::load(&self.gains)?;
        Ok(Models { mismatch: self.policy_mismatch, cache: cache_folder(), laws, own: self.own, ..models })
    }
}
