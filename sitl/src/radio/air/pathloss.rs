//! Path loss in dB, one published formula a function. Knows distances, heights and frequencies only.
//!
//! Distances and heights are in metres, carriers in Hz, angles in radians. `d` is the distance in space and
//! `plan` the one on the ground. Each function names its source; the tests hold it against published numbers.

use std::f64::consts::PI;

/// Speed of light, m/s (exact, SI).
pub const LIGHT: f64 = 299_792_458.0;
/// The speed that TR 38.901 and TR 36.777 write in their break points, m/s.
const LIGHT_3GPP: f64 = 3.0e8;

/// Where the two ends of a link are: what a formula of path loss reads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ends {
    /// Distance on the ground, m.
    pub plan: f64,
    /// Height of the station's antenna above the ground, m.
    pub base_height: f64,
    /// Height of the vehicle above the ground, m.
    pub height: f64,
}

impl Ends {
    /// Distance in space, m, at least 1 m: no formula holds nearer.
    #[must_use]
    pub fn distance(&self) -> f64 {
        self.plan.hypot(self.height - self.base_height).max(1.0)
    }

    /// Elevation of the vehicle above the station's horizon, rad, in [-π/2, π/2].
    #[must_use]
    pub fn elevation(&self) -> f64 {
        (self.height - self.base_height).atan2(self.plan)
    }
}

/// The paper's, -10 log10(G0 u^-α) with u = d / `unit` (Sec. IV-A3).
#[must_use]
pub fn paper(d: f64, unit: f64, reference_gain: f64, exponent: f64) -> f64 {
    10.0 * exponent * (d / unit).log10() - 10.0 * reference_gain.log10()
}

/// Free space, 20 log10(4 π d f / c): ITU-R P.525-4, Eq. (4).
#[must_use]
pub fn free_space(d: f64, carrier: f64) -> f64 {
    20.0 * (4.0 * PI * d * carrier / LIGHT).log10()
}

/// The reflection factor of the ground for upright antennas, at a grazing angle in rad: Fresnel's for a wave
/// whose field lies in the plane of incidence. It is -1 at the horizon.
#[must_use]
pub fn ground_reflection(grazing: f64, permittivity: f64) -> f64 {
    let (sin, cos) = grazing.sin_cos();
    let root = (permittivity - cos * cos).max(0.0).sqrt();
    (permittivity * sin - root) / (permittivity * sin + root).max(1e-12)
}

/// Two rays over flat ground that reflects with the factor `reflection` in [-1, 1]: the sum of the direct and the
/// reflected field. T. S. Rappaport, Wireless Communications, 2nd ed., Sec. 4.6; for a reflection of -1 it is
/// Eq. (4.47).
#[must_use]
pub fn two_ray(ends: &Ends, carrier: f64, reflection: f64) -> f64 {
    let direct = ends.distance();
    let reflected = ends.plan.hypot(ends.height + ends.base_height).max(direct);
    let phase = 2.0 * PI * carrier / LIGHT * (reflected - direct);
    let part = reflection * direct / reflected;
    let field = (1.0 + part * phase.cos()).hypot(part * phase.sin());
    free_space(direct, carrier) - 20.0 * field.max(1e-6).log10()
}

/// Two rays far away, 40 log10 d - 20 log10(h_t h_r): Rappaport, Eq. (4.52) in dB.
#[must_use]
pub fn two_ray_far(d: f64, base_height: f64, height: f64) -> f64 {
    40.0 * d.log10() - 20.0 * (base_height * height).log10()
}

/// PL(d0) + 10 n log10(d / d0), the log-distance model.
#[must_use]
pub fn log_distance(d: f64, reference_db: f64, reference_m: f64, exponent: f64) -> f64 {
    reference_db + 10.0 * exponent * (d / reference_m).log10()
}

/// UMa with a sight line: 3GPP TR 38.901 V17.0.0, Table 7.4.1-1, PL1 and PL2, h_E = 1 m.
#[must_use]
pub fn uma_los(ends: &Ends, carrier: f64) -> f64 {
    let (d, ghz) = (ends.distance(), carrier / 1e9);
    let [base, user] = [ends.base_height, ends.height].map(|h| (h - 1.0).max(0.0));
    let break_point = 4.0 * base * user * carrier / LIGHT_3GPP;
    if ends.plan <= break_point {
        return 28.0 + 22.0 * d.log10() + 20.0 * ghz.log10();
    }
    let rise = ends.base_height - ends.height;
    28.0 + 40.0 * d.log10() + 20.0 * ghz.log10() - 9.0 * (break_point.powi(2) + rise.powi(2)).log10()
}

/// UMa without a sight line: TR 38.901, Table 7.4.1-1.
#[must_use]
pub fn uma_nlos(ends: &Ends, carrier: f64) -> f64 {
    let ghz = carrier / 1e9;
    let loss = 13.54 + 39.08 * ends.distance().log10() + 20.0 * ghz.log10() - 0.6 * (ends.height - 1.5);
    loss.max(uma_los(ends, carrier))
}

/// Average height of buildings h and width of streets W of RMa, m: TR 38.901, Table 7.4.1-1, defaults.
const RMA: [f64; 2] = [5.0, 20.0];

/// RMa with a sight line: TR 38.901, Table 7.4.1-1, PL1 and PL2.
#[must_use]
pub fn rma_los(ends: &Ends, carrier: f64) -> f64 {
    let h = RMA[0];
    let near = |d: f64| {
        20.0 * (40.0 * PI * d * carrier / 1e9 / 3.0).log10() + (0.03 * h.powf(1.72)).min(10.0) * d.log10()
            - (0.044 * h.powf(1.72)).min(14.77)
            + 0.002 * h.log10() * d
    };
    let break_point = 2.0 * PI * ends.base_height * ends.height * carrier / LIGHT_3GPP;
    let d = ends.distance();
    if ends.plan <= break_point { near(d) } else { near(break_point) + 40.0 * (d / break_point).log10() }
}

/// RMa without a sight line: TR 38.901, Table 7.4.1-1.
#[must_use]
pub fn rma_nlos(ends: &Ends, carrier: f64) -> f64 {
    let ([h, w], base, ghz) = (RMA, ends.base_height, carrier / 1e9);
    let loss = 161.04 - 7.1 * w.log10() + 7.5 * h.log10() - (24.37 - 3.7 * (h / base).powi(2)) * base.log10()
        + (43.42 - 3.1 * base.log10()) * (ends.distance().log10() - 3.0)
        + 20.0 * ghz.log10()
        - (3.2 * (11.75 * ends.height).log10().powi(2) - 4.97);
    loss.max(rma_los(ends, carrier))
}

/// 20 log10(40 π f_c / 3), f_c in GHz, of TR 36.777's tables.
fn carrier_term(carrier: f64) -> f64 {
    20.0 * (40.0 * PI * carrier / 1e9 / 3.0).log10()
}

/// UMa-AV with a sight line: 3GPP TR 36.777 V15.0.0, Table B-2; up to 22.5 m it is UMa's.
#[must_use]
pub fn uma_av_los(ends: &Ends, carrier: f64) -> f64 {
    if ends.height <= 22.5 {
        return uma_los(ends, carrier);
    }
    28.0 + 22.0 * ends.distance().log10() + 20.0 * (carrier / 1e9).log10()
}

/// UMa-AV without a sight line: TR 36.777, Table B-2; up to 22.5 m it is UMa's. Above 100 m, where the table has
/// none, the formula's height is held at 100 m.
#[must_use]
pub fn uma_av_nlos(ends: &Ends, carrier: f64) -> f64 {
    if ends.height <= 22.5 {
        return uma_nlos(ends, carrier);
    }
    let slope = 46.0 - 7.0 * ends.height.min(100.0).log10();
    -17.5 + slope * ends.distance().log10() + carrier_term(carrier)
}

/// RMa-AV with a sight line: TR 36.777, Table B-2; up to 10 m it is RMa's.
#[must_use]
pub fn rma_av_los(ends: &Ends, carrier: f64) -> f64 {
    if ends.height <= 10.0 {
        return rma_los(ends, carrier);
    }
    let slope = (23.9 - 1.8 * ends.height.log10()).max(20.0);
    slope * ends.distance().log10() + carrier_term(carrier)
}

/// RMa-AV without a sight line: TR 36.777, Table B-2; up to 10 m it is RMa's.
#[must_use]
pub fn rma_av_nlos(ends: &Ends, carrier: f64) -> f64 {
    if ends.height <= 10.0 {
        return rma_nlos(ends, carrier);
    }
    let slope = 35.0 - 5.3 * ends.height.log10();
    (-12.0 + slope * ends.distance().log10() + carrier_term(carrier)).max(rma_av_los(ends, carrier))
}

/// d1 / d + e^(-d / p1) (1 - d1 / d), 1 up to d1: the form of both tables of sight.
fn sight_chance(plan: f64, d1: f64, p1: f64) -> f64 {
    if plan <= d1 { 1.0 } else { d1 / plan + (-plan / p1).exp() * (1.0 - d1 / plan) }
}

/// Probability of a sight line, UMa-AV: TR 36.777, Table B-1; up to 22.5 m UMa's of TR 38.901, Table 7.4.2-1.
#[must_use]
pub fn uma_av_sight(ends: &Ends) -> f64 {
    let h = ends.height;
    if h > 100.0 {
        return 1.0;
    }
    if h > 22.5 {
        return sight_chance(ends.plan, (460.0 * h.log10() - 700.0).max(18.0), 4300.0 * h.log10() - 3800.0);
    }
    let high = if h <= 13.0 { 0.0 } else { ((h - 13.0) / 10.0).powf(1.5) };
    let far = (ends.plan / 100.0).powi(3) * (-ends.plan / 150.0).exp();
    (sight_chance(ends.plan, 18.0, 63.0) * (1.0 + high * 1.25 * far)).min(1.0)
}

/// Probability of a sight line, RMa-AV: TR 36.777, Table B-1; up to 10 m RMa's of TR 38.901, Table 7.4.2-1.
#[must_use]
pub fn rma_av_sight(ends: &Ends) -> f64 {
    let h = ends.height;
    if h > 40.0 {
        return 1.0;
    }
    if h > 10.0 {
        let d1 = (1350.8 * h.log10() - 1602.0).max(18.0);
        return sight_chance(ends.plan, d1, (15_021.0 * h.log10() - 16_053.0).max(1000.0));
    }
    if ends.plan <= 10.0 { 1.0 } else { (-(ends.plan - 10.0) / 1000.0).exp() }
}

/// Al-Hourani's air to ground: free space and the mean of the excess losses `excess_db` with and without a sight
/// line, which is there with probability 1 / (1 + a e^(-b (θ - a))), θ in degrees. A. Al-Hourani, S. Kandeepan,
/// S. Lardner, IEEE Wireless Commun. Lett. 3(6), 2014; `shape` is a, b.
#[must_use]
pub fn al_hourani(ends: &Ends, carrier: f64, [a, b]: [f64; 2], excess_db: [f64; 2]) -> f64 {
    let degrees = ends.elevation().to_degrees().max(0.0);
    let sight = 1.0 / (1.0 + a * (-b * (degrees - a)).exp());
    free_space(ends.distance(), carrier) + sight * excess_db[0] + (1.0 - sight) * excess_db[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of them to a tenth of a decibel.
    #[track_caller]
    fn near(ours: f64, published: f64) {
        assert!((ours - published).abs() < 0.1, "{ours:.3} dB, published {published} dB");
    }

    /// At 5 GHz, of antennas `heights` over the ground.
    fn ends(plan: f64, [base_height, height]: [f64; 2]) -> Ends {
        Ends { plan, base_height, height }
    }

    #[test]
    fn free_space_is_itu_r_p_525() {
        // P.525-4, Eq. (4): 32.4 + 20 log f(MHz) + 20 log d(km).
        for (d, carrier, published) in [(1e3, 1e6, 32.4), (1e3, 433e6, 85.13), (10e3, 2.4e9, 120.0)] {
            near(free_space(d, carrier), published);
        }
    }

    #[test]
    fn two_rays_add_their_fields() {
        // By hand, the setting of a textbook example: 900 MHz, h_t 50 m, h_r 1.5 m, 5 km, gain 2.55 dB, 1 mV/m at 1 km: -92.68 dBm.
        let eirp_dbm = 10.0 * (1e-3_f64.powi(2) * 1e3_f64.powi(2) / 30.0 * 1e3).log10();
        near(eirp_dbm + 2.55 - two_ray_far(5e3, 50.0, 1.5), -92.68);
        // Far away the sum of the rays is the asymptote; over a black ground it is free space.
        let far = ends(50e3, [50.0, 1.5]);
        near(two_ray(&far, 900e6, -1.0), two_ray_far(50e3, 50.0, 1.5));
        near(two_ray(&far, 900e6, 0.0), free_space(far.distance(), 900e6));
        // Where the rays differ by half a wave they add up: 6.02 dB over free space.
        let carrier = LIGHT / 2.0 / (1e3_f64.hypot(40.0) - 1e3);
        near(free_space(1e3, carrier) - two_ray(&ends(1e3, [20.0, 20.0]), carrier, -1.0), 6.02);
    }

    #[test]
    fn the_ground_reflects_by_fresnel() {
        let at = |degrees: f64| ground_reflection(degrees.to_radians(), 15.0);
        assert_eq!(at(0.0), -1.0);
        // Nothing comes back at Brewster's angle, tan ψ = 1 / √ε; from above it is (√ε - 1) / (√ε + 1).
        assert!(at((1.0 / 15f64.sqrt()).atan().to_degrees()).abs() < 1e-12);
        assert!((at(90.0) - 0.5896).abs() < 1e-4);
    }

    #[test]
    fn log_distance_loses_ten_n_a_decade() {
        // By hand: n = 4.4, 0 dBm at 100 m, so -57.24 dBm at 2 km.
        near(-log_distance(2e3, 0.0, 100.0, 4.4), -57.24);
    }

    /// Received power of 0 dBm in ns-3's tests of TR 38.901, Table 7.4.1-1
    /// (three-gpp-propagation-loss-model-test-suite.cc), 5 GHz.
    #[test]
    fn uma_and_rma_are_tr_38_901() {
        type Formula = fn(&Ends, f64) -> f64;
        type Table = (Formula, [f64; 2], [(f64, f64); 4]);
        let tables: [Table; 4] = [
            (uma_los, [25.0, 1.5], [(10.0, 72.938), (100.0, 86.2362), (1e3, 109.7252), (5e3, 137.6794)]),
            (uma_nlos, [25.0, 1.5], [(10.0, 82.5131), (100.0, 106.1356), (1e3, 144.7641), (5e3, 172.0753)]),
            (rma_los, [35.0, 1.5], [(10.0, 77.3784), (100.0, 87.2965), (1e3, 108.5577), (10e3, 140.3896)]),
            (rma_nlos, [35.0, 1.5], [(10.0, 77.3784), (100.0, 95.7718), (1e3, 133.5223), (5e3, 160.5169)]),
        ];
        for (formula, heights, rows) in tables {
            for (plan, published) in rows {
                near(formula(&ends(plan, heights), 5e9), published);
            }
        }
    }

    /// TR 36.777, Table B-2, by hand: at 2 GHz and d = 1 km, 100 m up.
    #[test]
    fn aerial_vehicles_are_tr_36_777() {
        let at = Ends { plan: 1e3, base_height: 100.0, height: 100.0 };
        // 28.0 + 22 * 3 + 20 log 2; -17.5 + (46 - 14) * 3 + 20 log(80 π / 3).
        near(uma_av_los(&at, 2e9), 100.02);
        near(uma_av_nlos(&at, 2e9), 116.96);
        // max(23.9 - 3.6, 20) * 3 + 20 log(80 π / 3); -12 + (35 - 10.6) * 3 + the same.
        near(rma_av_los(&at, 2e9), 99.36);
        near(rma_av_nlos(&at, 2e9), 99.66);
        // Near the ground they are the terrestrial ones; high up the sight line is always free.
        let low = ends(500.0, [35.0, 1.5]);
        assert_eq!(
            [uma_av_nlos(&low, 2e9), rma_av_los(&low, 2e9)],
            [uma_nlos(&low, 2e9), rma_los(&low, 2e9)]
        );
        assert_eq!([uma_av_sight(&Ends { height: 101.0, ..at }), rma_av_sight(&at)], [1.0; 2]);
        // Table B-1 at 50 m and 1 km: d1 = 81.53 m, p1 = 3505.7 m.
        let chance = uma_av_sight(&Ends { height: 50.0, ..at });
        assert!((chance - 0.7721).abs() < 1e-3, "{chance}");
    }

    /// The elevation angles of largest coverage: Al-Hourani 2014, 20.34, 42.44, 54.62 and 75.52 degrees.
    #[test]
    fn the_best_angles_are_al_hourani_s() {
        let towns = [
            ([4.88, 0.43], [0.1, 21.0], 20.34),
            ([9.61, 0.16], [1.0, 20.0], 42.44),
            ([12.08, 0.11], [1.6, 23.0], 54.62),
            ([27.23, 0.08], [2.3, 34.0], 75.52),
        ];
        for (shape, excess, published) in towns {
            let at = |degrees: f64| {
                let height = 1e3 * degrees.to_radians().tan();
                al_hourani(&Ends { plan: 1e3, base_height: 0.0, height }, 2e9, shape, excess)
            };
            // The coverage radius at a given loss is largest where the loss at a given radius is smallest.
            let best = (100..8990).map(|k| f64::from(k) / 100.0).min_by(|a, b| at(*a).total_cmp(&at(*b)));
            let best = best.unwrap();
            assert!((best - published).abs() < 0.1, "{best} degrees, published {published}");
        }
    }

    #[test]
    fn the_paper_s_loss_is_the_gain_of_its_world() {
        use crate::Scenario;
        use crate::world::channel;
        let channel = Scenario::default().channel;
        let uav = channel.base_station + nalgebra::Vector2::new(0.3, 0.4);
        let gain_db = 10.0 * channel::los_gain(uav, &channel).log10();
        assert!((paper(250.0, 500.0, 1.0, 2.0) + gain_db).abs() < 1e-9);
    }
}
