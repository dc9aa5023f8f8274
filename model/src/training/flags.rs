//! Flags that the commands of training share.

use std::path::PathBuf;

use crate::world_model::config::{ConfigError, TrainConfig};

/// Names the training parameters.
#[derive(Debug, clap::Args)]
pub struct ConfigFlags {
    /// Training parameters that differ from the defaults (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Override the seed of the training parameters
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

impl ConfigFlags {
    /// The training parameters of the file, or the shipped ones, with another seed if one is given.
    ///
    /// # Errors
    /// As [`TrainConfig::load`].
    pub fn resolve(&self) -> Result<TrainConfig, ConfigError> {
        let mut config = self
            .config
            .as_ref()
            .map_or_else(|| Ok(TrainConfig::default()), |path| TrainConfig::load(path))?;
        config.seed = self.seed.unwrap_or(config.seed);
        Ok(config)
    }
}
