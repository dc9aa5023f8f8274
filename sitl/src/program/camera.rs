//! `--camera` and `--set`, which all programs that take a scenario have.

use anyhow::Result;

use crate::scenario::Scenario;

/// The flags that change a scenario.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct CameraFlag {
    /// Camera: TOML file or clean, hard, harder, or another name of docs/camera.md [default: the scenario's]
    #[arg(long, value_name = "FILE|NAME")]
    pub camera: Option<String>,
    /// Other values of the scenario's keys.
    #[arg(
        help = "Another value of a key of the scenario, such as radio.b_dt=2.5, goal[1]=0.3 or obstacle[0].position=[0.5,0.4]; repeatable",
        long,
        value_name = "KEY=VALUE"
    )]
    pub set: Vec<String>,
}

impl CameraFlag {
    /// The scenario of this name with the camera and the values that were asked for.
    ///
    /// # Errors
    /// There is no such scenario, camera or key, a file is none, a value is out of its range.
    pub fn scenario(&self, name: &str) -> Result<Scenario> {
        let mut scenario = Scenario::named(name)?;
        self.put(&mut scenario)?;
        Ok(scenario)
    }

    /// Puts the camera and the values that were asked for into a scenario.
    ///
    /// # Errors
    /// There is no such camera, or its file is none; a key or value that a scenario cannot have.
    pub fn put(&self, scenario: &mut Scenario) -> Result<()> {
        self.film(scenario)?;
        *scenario = scenario.with(&self.set)?;
        Ok(())
    }

    /// Puts the camera alone into a scenario.
    ///
    /// # Errors
    /// There is no such camera, or its file is none.
    pub fn film(&self, scenario: &mut Scenario) -> Result<()> {
        if let Some(camera) = &self.camera {
            scenario.film_with(camera)?;
        }
        Ok(())
    }

    /// Whether anything was asked for.
    #[must_use]
    pub fn changes(&self) -> bool {
        self.camera.is_some() || !self.set.is_empty()
    }
}
