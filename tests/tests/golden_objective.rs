//! The parts of CRPL's objective agree with the golden vectors to the files' own tolerance.

use crpl_model::planning::objective::{barrier, barrier_weight, log_ext, outage_surrogate, softmin};
use crpl_model::planning::plant::Objective;
use serde::Deserialize;
use tests::golden::{Table, assert_close, read};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SoftMin {
    x: Vec<f64>,
    beta: f64,
    softmin: f64,
}

#[test]
fn soft_minimum() {
    let table: Table<SoftMin> = read("softmin").unwrap();
    assert!(table.cases.len() >= 10, "{} cases", table.cases.len());
    for (i, case) in table.cases.iter().enumerate() {
        assert_close(softmin(&case.x, case.beta), case.softmin, table.tol, &format!("case {i}"));
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SmoothOutage {
    snr: f64,
    gamma_min: f64,
    alpha: f64,
    p_out: f64,
}

#[test]
fn smooth_outage() {
    let table: Table<SmoothOutage> = read("p_out").unwrap();
    assert!(table.cases.len() >= 40, "{} cases", table.cases.len());
    for (i, case) in table.cases.iter().enumerate() {
        let got = outage_surrogate(case.snr, case.gamma_min, case.alpha);
        assert_close(got, case.p_out, table.tol, &format!("case {i}"));
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Barriers {
    #[serde(rename = "doc")]
    _doc: String,
    tol: f64,
    cases: Vec<LogExt>,
    barrier_cases: Vec<Barrier>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LogExt {
    x: f64,
    eps: f64,
    y: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
struct Barrier {
    P_safe: f64,
    P_comm: f64,
    w: f64,
    eps: f64,
    barrier: f64,
}

#[test]
fn extended_logarithm() {
    let file: Barriers = read("log_barrier").unwrap();
    assert!(file.cases.len() >= 30, "{} cases", file.cases.len());
    for (i, case) in file.cases.iter().enumerate() {
        assert_close(log_ext(case.x, case.eps), case.y, file.tol, &format!("case {i}"));
    }
}

#[test]
fn barriers() {
    let file: Barriers = read("log_barrier").unwrap();
    assert!(file.barrier_cases.len() >= 15, "{} cases", file.barrier_cases.len());
    // The file has no parameters of its own: tolerances of 0.05, residual 1e-4, as the paper gives them.
    let objective = Objective::default();
    for (i, case) in file.barrier_cases.iter().enumerate() {
        let got = barrier(case.P_safe, case.P_comm, case.w, case.eps, &objective);
        assert_close(got, case.barrier, file.tol, &format!("case {i}"));
        let eta = 1.0 / (case.w - objective.barrier_residual);
        let (w, eps) = barrier_weight(eta, objective.barrier_residual);
        assert_close(w, case.w, file.tol, &format!("case {i}, w"));
        assert_close(eps, case.eps, file.tol, &format!("case {i}, end of the logarithm"));
    }
}
