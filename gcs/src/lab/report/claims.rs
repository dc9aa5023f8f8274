//! Every claim of the paper's abstract and Sec. IV: where it stands, what measures it, at which points, and the
//! number or the direction that the paper gives. What came out is no part of this table.
//!
//! A claim on RCC or UCC is measured on each pair of [`TEAMS`] that flies; the paper's `rcc` and `ucc` come first.
//! A single flight without gusts has no interval: there the paper's value stands for all that rounds to it.

use crpl_sitl::sim::metric::Metric;

use super::quantities::{FlightQuantity as Flight, Subject, SweepQuantity as Sweep};
use super::verdict::Said;
use crate::station::pilot::Controller;
use Controller::{Apc, Crpl, Rcc, Ucc};
use Metric::{
    CollisionProbability as P_COLL, Outages as T_OUT, PropulsionEnergy as E_CTRL, TerminalDistance as D_F,
    TransmitEnergy as E_COMM,
};
use Said::{Less, More, MoreThan, Near, Range, Same, Value};

/// Who flies as the paper's RCC and UCC: one line a pair. All but the first are measured only where they fly.
pub const TEAMS: &[[Controller; 2]] = &[[Rcc, Ucc], [Controller::RccPaper, Controller::UccPaper]];

/// What measures a claim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measure {
    /// A quantity of the sweep with this name.
    Sweep(&'static str, Sweep),
    /// A quantity of the flights in Scenario 1 or 2.
    Flight(u8, Flight),
}

/// A statement of the paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claim {
    /// `abstract`, or a section.
    pub section: &'static str,
    /// Whom it is about.
    pub who: Subject,
    /// What measures it.
    pub measure: Measure,
    /// What the paper says.
    pub said: Said,
}

impl Claim {
    /// The claim on each pair of [`TEAMS`] that flies, the first in any case.
    #[must_use]
    pub fn of_teams(self, flown: &[Controller]) -> Vec<Self> {
        self.on(TEAMS, flown)
    }

    fn on(self, teams: &[[Controller; 2]], flown: &[Controller]) -> Vec<Self> {
        let others = teams.iter().skip(1).map(|[rcc, ucc]| {
            let as_flown = |controller| match controller {
                Rcc => *rcc,
                Ucc => *ucc,
                other => other,
            };
            let who = Subject { of: as_flown(self.who.of), over: self.who.over.map(as_flown) };
            Self { who, ..self }
        });
        let flies = |claim: &Self| {
            let who = claim.who;
            claim != &self && flown.contains(&who.of) && who.over.is_none_or(|over| flown.contains(&over))
        };
        std::iter::once(self).chain(others.filter(flies)).collect()
    }
}

/// The claims that a sweep decides, with what measures them. The literal reading of σ_c is measured as Fig. 7 is.
pub fn of_sweep(name: &str) -> impl Iterator<Item = (Claim, Sweep)> {
    let name = if name == "sigma_literal" { "sigma" } else { name };
    CLAIMS.iter().filter_map(move |claim| match claim.measure {
        Measure::Sweep(sweep, quantity) if sweep == name => Some((*claim, quantity)),
        _ => None,
    })
}

/// The claims that the flights in Scenario 1 or 2 decide, with what measures them.
pub fn of_scenario(number: u8) -> impl Iterator<Item = (Claim, Flight)> {
    CLAIMS.iter().filter_map(move |claim| match claim.measure {
        Measure::Flight(scenario, quantity) if scenario == number => Some((*claim, quantity)),
        _ => None,
    })
}

/// The lowest bandwidth, and the largest σ_c, that the paper considers.
const B: f64 = 2.5;
const SIGMA: f64 = 0.01;
/// The lowest bandwidth, one where it is no bottleneck any more, and the highest.
const B_RANGE: [f64; 3] = [B, 4.0, 8.0];
const B_ENDS: [f64; 2] = [B, 8.0];
/// The smallest σ_c, a moderate one, and the largest.
const SIGMA_RANGE: [f64; 3] = [0.001, 0.006, SIGMA];
const SIGMA_ENDS: [f64; 2] = [0.001, SIGMA];

const fn of(of: Controller) -> Subject {
    Subject { of, over: None }
}

const fn over(of: Controller, over: Controller) -> Subject {
    Subject { of, over: Some(over) }
}

const fn sweep(
    name: &'static str,
    section: &'static str,
    who: Subject,
    quantity: Sweep,
    said: Said,
) -> Claim {
    Claim { section, who, measure: Measure::Sweep(name, quantity), said }
}

/// Of the abstract, on the bandwidth sweep.
const fn abs_b(who: Subject, quantity: Sweep, said: Said) -> Claim {
    sweep("bandwidth", "abstract", who, quantity, said)
}

/// Of the abstract, on the disturbance sweep.
const fn abs_s(who: Subject, quantity: Sweep, said: Said) -> Claim {
    sweep("sigma", "abstract", who, quantity, said)
}

/// Of Sec. IV-D, Fig. 6.
const fn fig6(who: Subject, quantity: Sweep, said: Said) -> Claim {
    sweep("bandwidth", "IV-D", who, quantity, said)
}

/// Of Sec. IV-D, Fig. 7.
const fn fig7(who: Subject, quantity: Sweep, said: Said) -> Claim {
    sweep("sigma", "IV-D", who, quantity, said)
}

/// Of Sec. IV-C, Figs. 4 and 5, Scenario 1.
const fn one(who: Subject, quantity: Flight, said: Said) -> Claim {
    Claim { section: "IV-C", who, measure: Measure::Flight(1, quantity), said }
}

/// Of Sec. IV-C, Figs. 4 and 5, Scenario 2.
const fn two(who: Subject, quantity: Flight, said: Said) -> Claim {
    Claim { section: "IV-C", who, measure: Measure::Flight(2, quantity), said }
}

/// Fig. 3 (Sec. IV-B): what `model evaluate` prints beside its own numbers.
pub const ROLLOUTS: [(&str, &str); 9] = [
    ("share of linear rollouts within 1 px at H = 100", "0.93"),
    ("share of MLP rollouts within 1 px at H = 100", "0.84"),
    ("share of LSTM rollouts within 1 px at H = 100", "0.68"),
    ("share of rollouts of all three within 5 px at H = 100", "> 0.99"),
    ("share of rollouts of all three within 0.2 px at H = 1", "0.9"),
    ("90th percentile of the linear error at H = 100; px", "0.82"),
    ("90th percentile of the MLP error at H = 100; px", "1.08"),
    ("90th percentile of the LSTM error at H = 100; px", "1.28"),
    ("90th percentile of MLP and of LSTM over linear", "1.3 and 1.6"),
];

/// All that flights can decide, in the order of the report. One line a claim.
#[rustfmt::skip]
pub const CLAIMS: &[Claim] = &[
    // Scenario 1: CRPL and APC anticipate the degradation and raise power before the SNR reaches γ_min.
    one(of(Crpl), Flight::Lead, More),
    one(of(Apc), Flight::Lead, More),
    one(of(Crpl), Flight::Violations, Same),
    one(of(Apc), Flight::Violations, Same),
    // RCC and UCC raise it only after, which violates the SNR, lower it late, and waste energy.
    one(of(Rcc), Flight::Lead, Less),
    one(of(Ucc), Flight::Lead, Less),
    one(of(Rcc), Flight::Violations, More),
    one(of(Ucc), Flight::Violations, More),
    one(of(Rcc), Flight::Overhang, More),
    one(of(Ucc), Flight::Overhang, More),
    one(over(Rcc, Crpl), Flight::Ratio(E_COMM), More),
    one(over(Ucc, Crpl), Flight::Ratio(E_COMM), More),
    // All remain close to the direct path, with similar risk: both are told from Scenario 2.
    one(of(Crpl), Flight::Detour, Less),
    one(of(Apc), Flight::Detour, Less),
    one(of(Rcc), Flight::Detour, Less),
    one(of(Ucc), Flight::Detour, Less),
    one(over(Apc, Crpl), Flight::Separation(P_COLL), Less),
    one(over(Rcc, Crpl), Flight::Separation(P_COLL), Less),
    one(over(Ucc, Crpl), Flight::Separation(P_COLL), Less),
    // About 1.2.
    one(over(Ucc, Crpl), Flight::Ratio(P_COLL), Range(1.15, 1.25)),

    // Scenario 2: CRPL and APC take a lower detour, RCC and UCC the upper side.
    two(of(Crpl), Flight::Side, Less),
    two(of(Apc), Flight::Side, Less),
    two(of(Rcc), Flight::Side, More),
    two(of(Ucc), Flight::Side, More),
    // CRPL and APC keep the SNR without sustained high power.
    two(of(Crpl), Flight::Violations, Same),
    two(of(Apc), Flight::Violations, Same),
    two(over(Crpl, Rcc), Flight::HighPower, Less),
    two(over(Crpl, Ucc), Flight::HighPower, Less),
    two(over(Apc, Rcc), Flight::HighPower, Less),
    two(over(Apc, Ucc), Flight::HighPower, Less),
    // RCC and UCC see a deeper degradation, and fall below the threshold until their delayed raise.
    two(over(Rcc, Crpl), Flight::LeastSnr, Less),
    two(over(Ucc, Crpl), Flight::LeastSnr, Less),
    two(over(Rcc, Apc), Flight::LeastSnr, Less),
    two(over(Ucc, Apc), Flight::LeastSnr, Less),
    two(of(Rcc), Flight::Violations, More),
    two(of(Ucc), Flight::Violations, More),
    two(of(Rcc), Flight::Lead, Less),
    two(of(Ucc), Flight::Lead, Less),
    // Peak risk: about 4; APC and RCC remain much closer.
    two(over(Ucc, Crpl), Flight::Ratio(P_COLL), Range(3.5, 4.5)),
    two(over(Apc, Ucc), Flight::Apartness(P_COLL), Less),
    two(over(Rcc, Ucc), Flight::Apartness(P_COLL), Less),

    // In the bandwidth-limited regime up to about 3 and 18, with less energy and risk ...
    abs_b(over(Rcc, Crpl), Sweep::LargestRatio(D_F), Value(3.0)),
    abs_b(over(Rcc, Crpl), Sweep::LargestRatio(T_OUT), Value(18.0)),
    abs_b(over(Rcc, Crpl), Sweep::Ratio(E_COMM, B), More),
    abs_b(over(Ucc, Crpl), Sweep::Ratio(E_COMM, B), More),
    abs_b(over(Rcc, Crpl), Sweep::Ratio(P_COLL, B), More),
    abs_b(over(Ucc, Crpl), Sweep::Ratio(P_COLL, B), More),
    // ... and only a moderate motion-energy overhead.
    abs_b(over(Crpl, Rcc), Sweep::Ratio(E_CTRL, B), More),
    abs_b(over(Crpl, Ucc), Sweep::Ratio(E_CTRL, B), More),
    // CRPL closely approaches the oracle: near it, and nearer than the reactive baselines are.
    abs_b(over(Crpl, Apc), Sweep::Ratio(D_F, B), Near),
    abs_b(over(Crpl, Apc), Sweep::Ratio(E_COMM, B), Near),
    abs_b(over(Crpl, Apc), Sweep::Ratio(E_CTRL, B), Near),
    abs_b(over(Crpl, Apc), Sweep::Ratio(P_COLL, B), Near),
    abs_b(over(Crpl, Apc), Sweep::Difference(T_OUT, B), Near),
    abs_b(over(Crpl, Rcc), Sweep::OracleDistance(D_F, B), Less),
    abs_b(over(Crpl, Ucc), Sweep::OracleDistance(D_F, B), Less),
    abs_b(over(Crpl, Rcc), Sweep::OracleDistance(E_COMM, B), Less),
    abs_b(over(Crpl, Ucc), Sweep::OracleDistance(E_COMM, B), Less),
    abs_b(over(Crpl, Rcc), Sweep::OracleDistance(P_COLL, B), Less),
    abs_b(over(Crpl, Ucc), Sweep::OracleDistance(P_COLL, B), Less),
    abs_b(over(Crpl, Rcc), Sweep::OracleDistance(T_OUT, B), Less),
    abs_b(over(Crpl, Ucc), Sweep::OracleDistance(T_OUT, B), Less),

    // Fig. 6, at the lowest bandwidth.
    fig6(over(Rcc, Crpl), Sweep::Ratio(D_F, B), Value(3.0)),
    fig6(over(Ucc, Crpl), Sweep::Ratio(D_F, B), Value(2.5)),
    fig6(over(Rcc, Crpl), Sweep::Ratio(E_COMM, B), Value(1.7)),
    fig6(over(Ucc, Crpl), Sweep::Ratio(E_COMM, B), Value(1.6)),
    fig6(over(Rcc, Crpl), Sweep::Ratio(T_OUT, B), Value(18.0)),
    fig6(over(Ucc, Crpl), Sweep::Ratio(T_OUT, B), Value(12.0)),
    // More than 10 times over much of the range; the strongest separation of all.
    fig6(over(Rcc, Crpl), Sweep::MedianRatio(T_OUT), MoreThan(10.0)),
    fig6(over(Ucc, Crpl), Sweep::MedianRatio(T_OUT), MoreThan(10.0)),
    fig6(over(Rcc, Crpl), Sweep::Separation([T_OUT, D_F], B), More),
    fig6(over(Ucc, Crpl), Sweep::Separation([T_OUT, D_F], B), More),
    // The largest differences arise at low bandwidth.
    fig6(over(Rcc, Crpl), Sweep::Outgrowth(D_F, B_ENDS), Less),
    fig6(over(Ucc, Crpl), Sweep::Outgrowth(D_F, B_ENDS), Less),
    fig6(over(Rcc, Crpl), Sweep::Outgrowth(E_COMM, B_ENDS), Less),
    fig6(over(Ucc, Crpl), Sweep::Outgrowth(E_COMM, B_ENDS), Less),
    fig6(over(Rcc, Crpl), Sweep::Outgrowth(T_OUT, B_ENDS), Less),
    fig6(over(Ucc, Crpl), Sweep::Outgrowth(T_OUT, B_ENDS), Less),
    // The terminal errors of all fall with B and saturate.
    fig6(of(Crpl), Sweep::Change(D_F, B_ENDS), Less),
    fig6(of(Apc), Sweep::Change(D_F, B_ENDS), Less),
    fig6(of(Rcc), Sweep::Change(D_F, B_ENDS), Less),
    fig6(of(Ucc), Sweep::Change(D_F, B_ENDS), Less),
    fig6(of(Crpl), Sweep::Bend(D_F, B_RANGE), More),
    fig6(of(Apc), Sweep::Bend(D_F, B_RANGE), More),
    fig6(of(Rcc), Sweep::Bend(D_F, B_RANGE), More),
    fig6(of(Ucc), Sweep::Bend(D_F, B_RANGE), More),
    // CRPL and RCC maintain a low risk; that of UCC is larger and more variable.
    fig6(over(Crpl, Ucc), Sweep::MedianRatio(P_COLL), Less),
    fig6(over(Rcc, Ucc), Sweep::MedianRatio(P_COLL), Less),
    fig6(over(Ucc, Crpl), Sweep::Spread(P_COLL, B), More),
    fig6(over(Ucc, Rcc), Sweep::Spread(P_COLL, B), More),
    // E_ctrl is about 1.1 to 1.2 times that of the reactive controllers.
    fig6(over(Crpl, Rcc), Sweep::Ratio(E_CTRL, B), Range(1.1, 1.2)),
    fig6(over(Crpl, Ucc), Sweep::Ratio(E_CTRL, B), Range(1.1, 1.2)),
    fig6(over(Crpl, Rcc), Sweep::MedianRatio(E_CTRL), Range(1.1, 1.2)),
    fig6(over(Crpl, Ucc), Sweep::MedianRatio(E_CTRL), Range(1.1, 1.2)),
    // CRPL's variation in terminal error and outage is contained.
    fig6(over(Rcc, Crpl), Sweep::Spread(D_F, B), More),
    fig6(over(Ucc, Crpl), Sweep::Spread(D_F, B), More),
    fig6(over(Rcc, Crpl), Sweep::Spread(T_OUT, B), More),
    fig6(over(Ucc, Crpl), Sweep::Spread(T_OUT, B), More),

    // Closeness to the oracle under uncertainty.
    abs_s(over(Crpl, Apc), Sweep::Ratio(D_F, SIGMA), Near),
    abs_s(over(Crpl, Apc), Sweep::Ratio(E_COMM, SIGMA), Near),
    abs_s(over(Crpl, Apc), Sweep::Ratio(E_CTRL, SIGMA), Near),
    abs_s(over(Crpl, Apc), Sweep::Ratio(P_COLL, SIGMA), Near),
    abs_s(over(Crpl, Apc), Sweep::Difference(T_OUT, SIGMA), Near),
    abs_s(over(Crpl, Rcc), Sweep::OracleDistance(D_F, SIGMA), Less),
    abs_s(over(Crpl, Ucc), Sweep::OracleDistance(D_F, SIGMA), Less),
    abs_s(over(Crpl, Rcc), Sweep::OracleDistance(E_COMM, SIGMA), Less),
    abs_s(over(Crpl, Ucc), Sweep::OracleDistance(E_COMM, SIGMA), Less),
    abs_s(over(Crpl, Rcc), Sweep::OracleDistance(P_COLL, SIGMA), Less),
    abs_s(over(Crpl, Ucc), Sweep::OracleDistance(P_COLL, SIGMA), Less),
    abs_s(over(Crpl, Rcc), Sweep::OracleDistance(T_OUT, SIGMA), Less),
    abs_s(over(Crpl, Ucc), Sweep::OracleDistance(T_OUT, SIGMA), Less),

    // Fig. 7, at the largest disturbance.
    fig7(over(Rcc, Crpl), Sweep::Ratio(D_F, SIGMA), Value(1.35)),
    fig7(over(Ucc, Crpl), Sweep::Ratio(D_F, SIGMA), Value(1.4)),
    fig7(over(Rcc, Crpl), Sweep::Ratio(E_COMM, SIGMA), Value(1.4)),
    fig7(over(Ucc, Crpl), Sweep::Ratio(E_COMM, SIGMA), Value(1.4)),
    fig7(over(Rcc, Crpl), Sweep::Ratio(T_OUT, SIGMA), Value(7.0)),
    fig7(over(Ucc, Crpl), Sweep::Ratio(T_OUT, SIGMA), Value(6.5)),
    fig7(over(Ucc, Crpl), Sweep::Ratio(P_COLL, SIGMA), Value(3.0)),
    // Performance changes gradually for small and moderate σ_c, and more beyond.
    fig7(of(Crpl), Sweep::Bend(D_F, SIGMA_RANGE), More),
    fig7(of(Apc), Sweep::Bend(D_F, SIGMA_RANGE), More),
    fig7(of(Rcc), Sweep::Bend(D_F, SIGMA_RANGE), More),
    fig7(of(Ucc), Sweep::Bend(D_F, SIGMA_RANGE), More),
    // The separation becomes more pronounced.
    fig7(over(Rcc, Crpl), Sweep::Outgrowth(D_F, SIGMA_ENDS), More),
    fig7(over(Ucc, Crpl), Sweep::Outgrowth(D_F, SIGMA_ENDS), More),
    fig7(over(Rcc, Crpl), Sweep::Outgrowth(E_COMM, SIGMA_ENDS), More),
    fig7(over(Ucc, Crpl), Sweep::Outgrowth(E_COMM, SIGMA_ENDS), More),
    fig7(over(Rcc, Crpl), Sweep::Outgrowth(T_OUT, SIGMA_ENDS), More),
    fig7(over(Ucc, Crpl), Sweep::Outgrowth(T_OUT, SIGMA_ENDS), More),
    // CRPL's and RCC's risk stays low; that of UCC rises more rapidly, and varies more.
    fig7(over(Crpl, Ucc), Sweep::MedianRatio(P_COLL), Less),
    fig7(over(Rcc, Ucc), Sweep::MedianRatio(P_COLL), Less),
    fig7(of(Ucc), Sweep::Change(P_COLL, SIGMA_ENDS), More),
    fig7(over(Ucc, Crpl), Sweep::Outgrowth(P_COLL, SIGMA_ENDS), More),
    fig7(over(Ucc, Rcc), Sweep::Outgrowth(P_COLL, SIGMA_ENDS), More),
    fig7(over(Ucc, Crpl), Sweep::Spread(P_COLL, SIGMA), More),
    fig7(over(Ucc, Rcc), Sweep::Spread(P_COLL, SIGMA), More),
    // CRPL's variation in terminal error and outage is contained.
    fig7(over(Rcc, Crpl), Sweep::Spread(D_F, SIGMA), More),
    fig7(over(Ucc, Crpl), Sweep::Spread(D_F, SIGMA), More),
    fig7(over(Rcc, Crpl), Sweep::Spread(T_OUT, SIGMA), More),
    fig7(over(Ucc, Crpl), Sweep::Spread(T_OUT, SIGMA), More),
    // Only a moderate increase in motion energy.
    fig7(over(Crpl, Rcc), Sweep::Ratio(E_CTRL, SIGMA), More),
    fig7(over(Crpl, Ucc), Sweep::Ratio(E_CTRL, SIGMA), More),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::report::SWEEPS;
    use crate::lab::sweep::axis::SweepPoint;
    use crate::lab::sweep::episode::SweepEpisode;
    use crate::lab::sweep::plan::{Overrides, SweepFile, SweepModels, SweepPlan};
    use crpl_sitl::sim::metric::PerMetric;

    fn plans() -> Vec<SweepPlan> {
        let plan = |(_, text, _): (&str, &str, &str)| {
            let file = SweepFile::parse(text).unwrap();
            file.resolve(&Overrides::default(), |_| Ok(SweepModels::default())).unwrap()
        };
        SWEEPS.map(plan).to_vec()
    }

    #[test]
    fn every_claim_names_points_and_controllers_that_its_sweep_flies() {
        for plan in &plans()[..2] {
            for (claim, quantity) in of_sweep(&plan.name) {
                assert!(quantity.points().iter().all(|x| plan.points.contains(x)), "{claim:?}");
                let who = std::iter::once(claim.who.of).chain(claim.who.over);
                assert!(who.into_iter().all(|who| plan.controllers.contains(&who)), "{claim:?}");
            }
        }
    }

    #[test]
    fn every_claim_is_of_a_scenario_or_of_a_sweep_that_is_flown() {
        let sweeps: usize =
            SWEEPS[..2].iter().zip(plans()).map(|(_, plan)| of_sweep(&plan.name).count()).sum();
        let scenarios = of_scenario(1).count() + of_scenario(2).count();
        assert_eq!(sweeps + scenarios, CLAIMS.len());
    }

    /// Four flights at each point, by each controller, of which every metric is the same number.
    fn episodes(plan: &SweepPlan) -> Vec<SweepEpisode> {
        let mut episodes = Vec::new();
        for (n, x) in plan.points.iter().enumerate() {
            for controller in plan.controllers.clone() {
                episodes.extend((0..4_u8).map(|seed| SweepEpisode {
                    point: SweepPoint::on(*x),
                    controller,
                    seed: seed.into(),
                    metrics: PerMetric::from_fn(|_| 1.0 + f64::from(seed) + n as f64),
                    outcomes: [true, false, false],
                }));
            }
        }
        episodes
    }

    #[test]
    fn every_claim_of_a_sweep_is_measured_on_a_whole_one() {
        for plan in &plans()[..2] {
            let episodes = episodes(plan);
            for (claim, quantity) in of_sweep(&plan.name) {
                let ours = quantity.measure(claim.who, plan, &episodes).unwrap();
                assert!(claim.said.verdict(quantity.neutral(), &ours).is_some(), "{claim:?}");
            }
        }
    }

    #[test]
    fn numbers_of_the_paper_lie_on_one_side_of_no_difference() {
        for claim in CLAIMS {
            let neutral = match claim.measure {
                Measure::Sweep(_, quantity) => quantity.neutral(),
                Measure::Flight(_, quantity) => quantity.neutral(),
            };
            match claim.said {
                Value(value) => assert!(value > neutral, "{claim:?}"),
                Range(low, high) => assert!(neutral < low && low < high, "{claim:?}"),
                MoreThan(least) => assert!(least > neutral, "{claim:?}"),
                More | Less | Same | Near => {}
            }
        }
    }

    #[test]
    fn no_claim_stands_there_twice() {
        for (n, claim) in CLAIMS.iter().enumerate() {
            assert!(!CLAIMS[..n].contains(claim), "{claim:?}");
        }
    }

    #[test]
    fn the_first_team_is_measured_in_any_case_and_each_other_where_it_flies() {
        let teams = [[Rcc, Ucc], [Controller::CrplBw, Controller::CrplRh]];
        let claim = fig6(over(Rcc, Crpl), Sweep::Ratio(D_F, B), Value(3.0));
        assert_eq!(claim.on(&teams, &[Crpl]), [claim]);
        let other = Claim { who: over(Controller::CrplBw, Crpl), ..claim };
        assert_eq!(claim.on(&teams, &[Crpl, Controller::CrplBw]), [claim, other]);
        let both = fig6(over(Rcc, Ucc), Sweep::MedianRatio(P_COLL), Less);
        assert_eq!(both.on(&teams, &[Controller::CrplBw]), [both]);
        let alone = fig6(of(Crpl), Sweep::Change(D_F, B_ENDS), Less);
        assert_eq!(alone.on(&teams, &[Crpl, Controller::CrplBw, Controller::CrplRh]), [alone]);
    }
}
