//! Golden vectors: reading `tests/golden/*.json` and comparing numbers with it.
//!
//! The reference in `tests/python/reference` makes the vectors; it shares no code with the programs. Each
//! file carries its definition, its parameters and its tolerance. Nothing here knows what the numbers mean.

use std::path::PathBuf;

use anyhow::{Context, Result};
use crpl_sitl::Scenario;
use nalgebra::Vector2;
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// Reads `tests/golden/NAME.json` as a `T`. Errors name the file.
///
/// # Errors
/// The file cannot be read, or is another one.
pub fn read<T: DeserializeOwned>(name: &str) -> Result<T> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden").join(format!("{name}.json"));
    let text = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
}

/// A table of cases of one pure function.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table<Case> {
    /// The definition, for the reader of the file.
    pub doc: String,
    /// Parameters that hold for all cases.
    pub params: Params,
    /// Largest relative difference.
    pub tol: f64,
    /// The cases.
    pub cases: Vec<Case>,
}

/// Parameters under the names that the reference gives them. A name that is new here is an error, so
/// none is passed over in silence.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
#[expect(missing_docs, reason = "Params::scenario says what each one is")]
pub struct Params {
    pub H: u64,
    pub start: [f64; 2],
    pub goal: [f64; 2],
    pub goal_radius: f64,
    pub bs: [f64; 2],
    pub v_max: f64,
    pub a_max: f64,
    pub G0: f64,
    pub alpha_pl: f64,
    pub kappa_nlos: f64,
    pub gamma_min: f64,
    pub L_pkt: f64,
    pub d_min: f64,
    pub delta1: f64,
    pub delta2: f64,
    pub P0: f64,
    pub Pi: f64,
    pub U_tip: f64,
    pub v0: f64,
    pub d0: f64,
    pub rho: f64,
    pub s_rotor: f64,
    pub A_rotor: f64,
    pub P_n: f64,
    pub R_o: f64,
    pub R_u: f64,
    pub tau_b: f64,
    pub tau_c: f64,
    pub m_per_unit: f64,
    pub s_per_step: f64,
    pub d_floor: f64,
    #[serde(rename = "box")]
    pub walls: bool,
}

impl Params {
    /// These parameters as a scenario; what they leave out keeps its default.
    #[must_use]
    pub fn scenario(&self) -> Scenario {
        let mut s = Scenario {
            horizon: self.H,
            start: vector(self.start),
            goal: vector(self.goal),
            goal_radius: self.goal_radius,
            uav_radius: self.R_u,
            ..Scenario::default()
        };
        s.obstacles[0].radius = self.R_o;
        s.dynamics.v_max = self.v_max;
        s.dynamics.a_max = self.a_max;
        s.dynamics.walls = self.walls;
        s.channel.base_station = vector(self.bs);
        s.channel.reference_gain = self.G0;
        s.channel.path_loss_exponent = self.alpha_pl;
        s.channel.nlos_attenuation = self.kappa_nlos;
        s.channel.noise_power = self.P_n;
        s.channel.blockage_softness = self.tau_b;
        s.channel.distance_floor = self.d_floor;
        s.channel.snr_min = self.gamma_min;
        s.radio.packet_bits = self.L_pkt;
        s.safety.d_min = self.d_min;
        s.safety.softness = self.tau_c;
        s.safety.collision_tolerance = self.delta1;
        s.safety.outage_tolerance = self.delta2;
        s.propulsion.blade_profile_power = self.P0;
        s.propulsion.induced_power = self.Pi;
        s.propulsion.tip_speed = self.U_tip;
        s.propulsion.hover_induced_velocity = self.v0;
        s.propulsion.fuselage_drag_ratio = self.d0;
        s.propulsion.air_density = self.rho;
        s.propulsion.rotor_solidity = self.s_rotor;
        s.propulsion.rotor_area = self.A_rotor;
        s.scale.metres_per_unit = self.m_per_unit;
        s.scale.interval_s = self.s_per_step;
        s
    }
}

/// Flights without disturbance, with packet loss, of a reference's controllers.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flights {
    /// The order of events in a step, for the reader of the file.
    pub doc: String,
    /// Parameters of all flights.
    pub params: Params,
    /// The flights.
    pub traces: Vec<Flight>,
}

/// A flight: what was asked, what was flown and what came of it in each of H steps.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
pub struct Flight {
    /// S1 or S2.
    pub scenario: String,
    /// RCC, UCC or APC.
    pub controller: String,
    /// B Δt
    pub B_dt: f64,
    /// 0
    pub sigma_c: f64,
    /// Its scores.
    pub metrics: FlightMetrics,
    /// The obstacle.
    pub r_u: [f64; 2],
    /// r_0..r_H
    pub r: Vec<[f64; 2]>,
    /// v_0..v_{H-1}
    pub v: Vec<[f64; 2]>,
    /// What the controller asked for.
    pub a_commanded: Vec<[f64; 2]>,
    /// What was flown.
    pub a_applied: Vec<[f64; 2]>,
    /// Transmit power.
    pub a_p: Vec<f64>,
    /// γ_k
    pub snr: Vec<f64>,
    /// Whether the packet was lost.
    pub outage: Vec<bool>,
    /// Collision probability after the step.
    pub p_coll: Vec<f64>,
}

/// Scores of a [`Flight`]; those that our records do not have are left out.
#[derive(Debug, Deserialize)]
#[expect(non_snake_case, reason = "the names of the reference files")]
#[expect(missing_docs, reason = "the metrics of crpl_sitl::sim::metric::Metric")]
pub struct FlightMetrics {
    pub d_f: f64,
    pub E_comm: f64,
    pub E_ctrl: f64,
    pub p_coll_max: f64,
    pub N_out: f64,
}

impl Flight {
    /// The scenario that it was flown in.
    #[must_use]
    pub fn scenario(&self, params: &Params) -> Scenario {
        let mut scenario = params.scenario();
        scenario.obstacles[0].position = vector(self.r_u);
        scenario.radio.b_dt = self.B_dt;
        scenario.disturbance.sigma_c = self.sigma_c;
        scenario
    }

    /// What to call it in a failure.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{} {} at B dt {}", self.scenario, self.controller, self.B_dt)
    }
}

/// A pair of the files as a vector.
#[must_use]
pub fn vector([x, y]: [f64; 2]) -> Vector2<f64> {
    Vector2::new(x, y)
}

/// Fails unless `got` lies within `tol` of `want`, relative to `want`. Where `want` is a difference
/// that cancels to almost nothing, rounding errors of 1e-6 · `tol` are allowed.
///
/// # Panics
/// If it does not.
#[track_caller]
pub fn assert_close(got: f64, want: f64, tol: f64, what: &str) {
    let error = (got - want).abs();
    assert!(error <= tol * want.abs().max(1e-6), "{what}: got {got}, golden {want}, off by {error:e}");
}

/// [`assert_close`] for both parts of a vector.
///
/// # Panics
/// If one of them does not agree.
#[track_caller]
pub fn assert_vector_close(got: Vector2<f64>, want: [f64; 2], tol: f64, what: &str) {
    assert_close(got.x, want[0], tol, &format!("{what}.x"));
    assert_close(got.y, want[1], tol, &format!("{what}.y"));
}
