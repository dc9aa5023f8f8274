//! The trained models that a station flies with: the world model and CRPL's policies.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::{WorldModel, checkpoint};
use crpl_sitl::Scenario;
use crpl_sitl::camera::COLOURS;

/// The trained things that a station needs.
#[derive(Debug, Clone)]
pub struct Models {
    /// The world model, which encodes every picture.
    pub world: Arc<WorldModel>,
    /// A policy file instead of the shipped ones.
    pub policy: Option<PathBuf>,
}

impl Models {
    /// The shipped world model and policies, or those in `checkpoint` and `policy`.
    pub fn load(checkpoint: Option<&Path>, policy: Option<PathBuf>) -> Result<Self> {
        let world = match checkpoint {
            Some(dir) => WorldModel::load(dir)?,
            None => WorldModel::embedded()?,
        };
        Ok(Self { world: Arc::new(world), policy })
    }

    /// The policies for `scenario`, which must have been optimised in this world model's latents.
    ///
    /// # Errors
    /// No policy for the scenario, a file that does not read, or another world model.
    pub fn policies(&self, scenario: &Scenario) -> Result<Policies> {
        let count = scenario.obstacles.len();
        if !(1..=COLOURS).contains(&count) {
            bail!(
                "scenario {:?} has {count} obstacles; a crpl controller sees them in the frame's colours, \
                 which tell 1 to {COLOURS} apart: apc, rcc and ucc fly with any number",
                scenario.name
            );
        }
        let policies = self.read_policies(scenario)?;
        let here = checkpoint::fingerprint(&self.world)?;
        if policies.world != here {
            let name = self.policy.as_ref().map_or("the shipped policy".into(), |p| p.display().to_string());
            bail!(
                "{name} was optimised in world model {}, and this is {here}: run `gcs optimise` on it",
                if policies.world.is_empty() { "(unnamed)" } else { &policies.world }
            );
        }
        Ok(policies)
    }

    fn read_policies(&self, scenario: &Scenario) -> Result<Policies> {
        if let Some(path) = &self.policy {
            return Ok(Policies::load(path)?);
        }
        let number = scenario.number().with_context(|| {
            let o = scenario.obstacle().position;
            format!(
                "no shipped policy for an obstacle at ({}, {}): train one with `gcs optimise \
                 --scenario FILE` and give it by --policy",
                o.x, o.y
            )
        })?;
        Ok(Policies::shipped(number)?)
    }
}

/// Flags that name the trained models.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ModelFiles {
    /// Folder of the world model [default: the built-in one]
    #[arg(long, value_name = "DIR")]
    pub checkpoint: Option<PathBuf>,
    /// File of CRPL's policies [default: the built-in ones]
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
}

impl ModelFiles {
    /// Loads the world model; policies are loaded with the controller that needs them.
    ///
    /// # Errors
    /// No world model in the folder.
    pub fn load(&self) -> Result<Models> {
        Models::load(self.checkpoint.as_deref(), self.policy.clone())
    }
}
