//! SNR to rate, and SNR to the chance that a packet is lost. Knows no geometry and no time.

use serde::{Deserialize, Serialize};

use crate::units::Snr;
use crate::world::channel;

/// How fast a modem sends at an SNR.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum AirRate {
    /// A packet takes no time.
    Unlimited,
    /// The paper's gate (Sec. IV-A4): a packet takes no time, and needs the SNR at which an interval carries
    /// `packet_bits`.
    Outage {
        /// B Δt, bits per interval and unit of spectral efficiency.
        b_dt: f64,
        /// L_pkt, bits.
        packet_bits: f64,
    },
    /// R = B log2(1 + γ / Γ), at most `max_bps`; below `min_snr_db` there is no link.
    Shannon {
        /// Γ, how far the modem is from Shannon's bound, dB.
        gap_db: f64,
        /// bit/s.
        max_bps: f64,
        /// dB.
        min_snr_db: f64,
    },
    /// One rate, bit/s.
    Fixed {
        /// bit/s.
        bps: f64,
        /// The SNR that it needs, dB, for [`FrameError::Step`] and [`FrameError::Waterfall`].
        snr_db: f64,
    },
    /// The fastest row whose SNR is there; below the first row there is no link.
    Table {
        /// By rising SNR.
        rows: Vec<RateRow>,
    },
}

/// A modulation and coding scheme.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateRow {
    /// The SNR that it needs, dB.
    pub snr_db: f64,
    /// bit/s.
    pub bps: f64,
}

impl AirRate {
    /// What the modem sends with at this SNR: the row that needs most of what is there, else the lowest.
    #[must_use]
    pub fn row(&self, snr_db: f64, bandwidth_hz: f64) -> RateRow {
        match self {
            Self::Unlimited => RateRow { snr_db: f64::NEG_INFINITY, bps: f64::INFINITY },
            Self::Outage { b_dt, packet_bits } => {
                RateRow { snr_db: channel::outage_snr(*b_dt, *packet_bits).to_db(), bps: f64::INFINITY }
            }
            Self::Shannon { gap_db, max_bps, min_snr_db } => {
                let gamma = Snr::from_db(snr_db.max(*min_snr_db) - gap_db);
                RateRow { snr_db: *min_snr_db, bps: channel::bits(bandwidth_hz, gamma).min(*max_bps) }
            }
            Self::Fixed { bps, snr_db } => RateRow { snr_db: *snr_db, bps: *bps },
            Self::Table { rows } => {
                let best = rows.iter().rev().find(|row| row.snr_db <= snr_db).or_else(|| rows.first());
                // A checked table has a row.
                best.copied().unwrap_or(RateRow { snr_db: f64::INFINITY, bps: 1.0 })
            }
        }
    }
}

/// When a packet is lost in noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FrameError {
    /// Never.
    None,
    /// Below the SNR that its rate needs.
    Step,
    /// 1 / (1 + (1 / p - 1) e^(x / w)), x dB above the SNR that its rate needs; `per` = p is the chance there.
    Waterfall {
        /// p in (0, 1).
        per: f64,
        /// w, dB.
        width_db: f64,
    },
    /// Any wrong bit loses it. Binary FSK without coherence, P_b = 1/2 e^(-E_b / 2 N_0) with E_b / N_0 = γ B / R:
    /// J. G. Proakis, Digital Communications, on noncoherent FSK.
    Fsk,
    /// The same with the Golay code (24, 12) of SiK's ECC: a word with more than 3 wrong bits of 24 loses it. The
    /// rate is the user's; on the air are twice as many bits.
    FskGolay,
}

impl FrameError {
    /// The chance that a packet of `bits` is lost. `bits` are those that the user and the header have, without
    /// the code's.
    #[must_use]
    pub fn loss(&self, snr_db: f64, row: RateRow, bandwidth_hz: f64, bits: f64) -> f64 {
        let wrong_bit = |bps| fsk_bit_error(Snr::from_db(snr_db).0 * bandwidth_hz / bps);
        match *self {
            Self::None => 0.0,
            Self::Step => f64::from(u8::from(snr_db < row.snr_db)),
            Self::Waterfall { per, width_db } => {
                1.0 / (1.0 + (1.0 / per - 1.0) * ((snr_db - row.snr_db) / width_db).exp())
            }
            Self::Fsk => -(bits * (-wrong_bit(row.bps)).ln_1p()).exp_m1(),
            Self::FskGolay => {
                let word = golay_word_error(wrong_bit(2.0 * row.bps));
                -((bits / 12.0).ceil() * (-word).ln_1p()).exp_m1()
            }
        }
    }
}

/// 1/2 e^(-E_b / 2 N_0), binary FSK without coherence.
#[must_use]
pub fn fsk_bit_error(energy_per_bit: f64) -> f64 {
    0.5 * (-energy_per_bit / 2.0).exp()
}

/// The chance of more than 3 wrong bits of 24.
#[must_use]
pub fn golay_word_error(bit_error: f64) -> f64 {
    let good = [1.0, 24.0, 276.0, 2024.0];
    let right = good.iter().zip(0..).map(|(n, k)| n * bit_error.powi(k) * (1.0 - bit_error).powi(24 - k));
    (1.0 - right.sum::<f64>()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROW: RateRow = RateRow { snr_db: 3.0, bps: 1e4 };

    #[test]
    fn fsk_needs_the_published_energy_per_bit() {
        // The textbooks' curve: P_b = 1e-3 at 10.94 dB and 1e-5 at 13.35 dB.
        for (db, published) in [(10.94, 1e-3), (13.35, 1e-5)] {
            let error = fsk_bit_error(10f64.powf(db / 10.0));
            assert!((error / published).log10().abs() < 0.01, "{error}");
        }
        // As wide as fast: SNR is E_b / N_0. 1000 bits at P_b = 1e-3: 1 - 0.999^1000.
        let loss = FrameError::Fsk.loss(10.0 * (2.0 * 500f64.ln()).log10(), ROW, 1e4, 1000.0);
        assert!((loss - 0.632_305).abs() < 1e-6, "{loss}");
    }

    #[test]
    fn golay_corrects_three_errors_of_twenty_four() {
        // Σ_{k>3} C(24, k) p^k (1-p)^(24-k) at p = 0.01 and 0.1, by hand.
        for (p, published) in [(0.01, 9.0e-5), (0.1, 0.214_26)] {
            let word = golay_word_error(p);
            assert!((word / published - 1.0).abs() < 0.01, "{word}");
        }
        // The code is worth more than the rate that it costs.
        let [plain, coded] = [FrameError::Fsk, FrameError::FskGolay].map(|e| e.loss(11.0, ROW, 1e4, 480.0));
        let by_hand = 1.0 - (1.0 - golay_word_error(fsk_bit_error(10f64.powf(1.1) / 2.0))).powi(40);
        assert!(coded < plain && (coded - by_hand).abs() < 1e-12, "{plain} {coded}");
    }

    #[test]
    fn the_fastest_row_that_the_snr_allows_is_taken() {
        let rows = [(0.0, 1e3), (5.0, 2e3), (9.0, 4e3)].map(|(snr_db, bps)| RateRow { snr_db, bps });
        let rate = AirRate::Table { rows: rows.to_vec() };
        for (snr, bps) in [(-20.0, 1e3), (0.0, 1e3), (4.9, 1e3), (5.0, 2e3), (30.0, 4e3)] {
            assert_eq!(rate.row(snr, 1.0).bps, bps, "{snr}");
        }
        assert_eq!(FrameError::Step.loss(-0.1, rate.row(-0.1, 1.0), 1.0, 8.0), 1.0);
        assert_eq!(FrameError::Step.loss(0.0, rate.row(0.0, 1.0), 1.0, 8.0), 0.0);
    }

    #[test]
    fn shannon_s_rate_has_a_gap_and_a_limit() {
        let rate = AirRate::Shannon { gap_db: 3.0, max_bps: 5e6, min_snr_db: -6.0 };
        // 1 MHz at 3 dB and a gap of 3 dB: log2(1 + 1) = 1 Mbit/s.
        assert!((rate.row(3.0, 1e6).bps - 1e6).abs() < 1e-3);
        assert_eq!(rate.row(60.0, 1e6).bps, 5e6);
        assert_eq!(rate.row(-90.0, 1e6).bps, rate.row(-6.0, 1e6).bps);
    }

    #[test]
    fn a_waterfall_passes_through_its_point() {
        let error = FrameError::Waterfall { per: 0.1, width_db: 0.5 };
        assert!((error.loss(3.0, ROW, 1.0, 1.0) - 0.1).abs() < 1e-12);
        assert!(error.loss(6.0, ROW, 1.0, 1.0) < 1e-3 && error.loss(0.0, ROW, 1.0, 1.0) > 0.97);
    }

    #[test]
    fn the_paper_s_gate_opens_where_its_world_s_does() {
        let rate = AirRate::Outage { b_dt: 4.0, packet_bits: 4.0 };
        assert!(rate.row(0.0, 1.0).snr_db.abs() < 1e-12);
    }
}
