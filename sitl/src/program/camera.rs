//! `--camera`, which all programs that take a scenario have.

use anyhow::Result;

use crate::scenario::Scenario;

/// The flag that replaces a scenario's camera.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct CameraFlag {
    /// Camera: TOML file or clean, hard, harder, or another name of docs/camera.md [default: the scenario's]
    #[arg(long, value_name = "FILE|NAME")]
    pub camera: Option<String>,
}

impl CameraFlag {
    /// The scenario of this name with the camera that was asked for.
    ///
    /// # Errors
    /// There is no such scenario or camera, or a file is none.
    pub fn scenario(&self, name: &str) -> Result<Scenario> {
        let mut scenario = Scenario::named(name)?;
        self.put(&mut scenario)?;
        Ok(scenario)
    }

    /// Puts the camera that was asked for into a scenario.
    ///
    /// # Errors
    /// There is no such camera, or its file is none.
    pub fn put(&self, scenario: &mut Scenario) -> Result<()> {
        if let Some(camera) = &self.camera {
            scenario.film_with(camera)?;
        }
        Ok(())
    }
}
