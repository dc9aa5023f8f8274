//! The ranges of a radio's keys.

use super::{AirEnd, AirRadio, Duplex, Modem, PathModel, Pattern, RadioError};
use crate::radio::air::blockage::BlockageLoss;
use crate::radio::air::rate::{AirRate, FrameError};

impl AirRadio {
    /// Every number is in its range.
    pub(super) fn check(&self) -> Result<(), RadioError> {
        self.check_channel()?;
        for (way, modem) in [("up", &self.up), ("down", &self.down)] {
            modem.check(way)?;
        }
        for (name, end) in [("ground", &self.ground), ("vehicle", &self.vehicle)] {
            end.check(name)?;
        }
        for disc in &self.discs {
            positive("disc.radius_m", disc.radius_m)?;
        }
        for prism in &self.prisms {
            positive("prism.height_m", prism.height_m)?;
            range(
                "prism.corners",
                prism.corners.len() as f64,
                prism.corners.len() > 2,
                "at least 3 corners",
            )?;
        }
        Ok(())
    }

    fn check_channel(&self) -> Result<(), RadioError> {
        positive("carrier_hz", self.carrier_hz)?;
        positive("bandwidth_hz", self.bandwidth_hz)?;
        positive("slot_s", self.slot_s)?;
        not_negative("shadowing.sigma_db", self.shadowing.sigma_db)?;
        positive("shadowing.distance_m", self.shadowing.distance_m)?;
        match self.path {
            PathModel::Paper { unit_m, reference_gain, exponent, floor } => {
                positive("path.unit_m", unit_m)?;
                positive("path.reference_gain", reference_gain)?;
                positive("path.exponent", exponent)?;
                positive("path.floor", floor)?;
            }
            PathModel::Orbit { distance_m } => positive("path.distance_m", distance_m)?,
            PathModel::TwoRay { permittivity } => {
                range("path.permittivity", permittivity, permittivity >= 1.0, "at least 1")?;
            }
            PathModel::LogDistance { reference_m, exponent, .. } => {
                positive("path.reference_m", reference_m)?;
                positive("path.exponent", exponent)?;
            }
            _ => {}
        }
        match self.duplex {
            Duplex::Slots { up_s, down_s, guard_s } => {
                positive("duplex.up_s", up_s)?;
                positive("duplex.down_s", down_s)?;
                not_negative("duplex.guard_s", guard_s)?;
            }
            Duplex::Full | Duplex::Shared => {}
        }
        match self.blockage {
            BlockageLoss::KnifeEdge { limit_db } => not_negative("blockage.limit_db", limit_db),
            BlockageLoss::Soft { attenuation, softness_m } => {
                let good = attenuation > 0.0 && attenuation <= 1.0;
                range("blockage.attenuation", attenuation, good, "in (0, 1]")?;
                positive("blockage.softness_m", softness_m)
            }
        }
    }
}

impl AirEnd {
    fn check(&self, name: &str) -> Result<(), RadioError> {
        let known = self.power < self.powers_dbm.len();
        range(&format!("{name}.power"), self.power as f64, known, "an index of powers_dbm")?;
        for &power in &self.powers_dbm {
            range(&format!("{name}.powers_dbm"), power, power.is_finite(), "finite")?;
        }
        for (key, value) in
            [("gain_dbi", self.gain_dbi), ("height_m", self.height_m), ("loss_db", self.loss_db)]
        {
            range(&format!("{name}.{key}"), value, value.is_finite(), "finite")?;
        }
        not_negative(&format!("{name}.noise_figure_db"), self.noise_figure_db)?;
        if let Pattern::Sector { width_deg, .. } = self.pattern {
            positive(&format!("{name}.pattern.width_deg"), width_deg)?;
        }
        Ok(())
    }
}

/// Longest time that a key may hold, s: nothing overflows.
const LONGEST_S: f64 = 1e6;

impl Modem {
    fn check(&self, way: &str) -> Result<(), RadioError> {
        let times = [
            ("overhead_s", self.overhead_s),
            ("gap_s", self.gap_s),
            ("retry_s", self.retry_s),
            ("latency_s", self.latency_s),
            ("jitter_s", self.jitter_s),
        ];
        for (key, value) in times {
            range(&format!("{way}.{key}"), value, (0.0..=LONGEST_S).contains(&value), "in [0, 1e6]")?;
        }
        not_negative(&format!("{way}.serial_baud"), self.serial_baud)?;
        let filled = !self.full_packets || self.packet_bytes > 0;
        range(&format!("{way}.packet_bytes"), self.packet_bytes as f64, filled, "above 0 with full_packets")?;
        range(&format!("{way}.retries"), f64::from(self.retries), self.retries <= 1000, "at most 1000")?;
        self.check_rate(way)?;
        match self.error {
            FrameError::Waterfall { per, width_db } => {
                range(&format!("{way}.error.per"), per, per > 0.0 && per < 1.0, "in (0, 1)")?;
                positive(&format!("{way}.error.width_db"), width_db)
            }
            _ => Ok(()),
        }
    }

    fn check_rate(&self, way: &str) -> Result<(), RadioError> {
        let key = |name: &str| format!("{way}.rate.{name}");
        match &self.rate {
            AirRate::Unlimited => Ok(()),
            AirRate::Outage { b_dt, packet_bits } => {
                positive(&key("b_dt"), *b_dt)?;
                positive(&key("packet_bits"), *packet_bits)
            }
            AirRate::Shannon { gap_db, max_bps, min_snr_db } => {
                not_negative(&key("gap_db"), *gap_db)?;
                positive(&key("max_bps"), *max_bps)?;
                range(&key("min_snr_db"), *min_snr_db, (-50.0..=100.0).contains(min_snr_db), "in [-50, 100]")
            }
            AirRate::Fixed { bps, .. } => positive(&key("bps"), *bps),
            AirRate::Table { rows } => {
                range(&key("rows"), rows.len() as f64, !rows.is_empty(), "at least 1 row")?;
                let rising = rows.windows(2).all(|pair| pair[0].snr_db < pair[1].snr_db);
                range(&key("rows"), rows.len() as f64, rising, "rows by rising snr_db")?;
                rows.iter().try_for_each(|row| positive(&key("rows.bps"), row.bps))
            }
        }
    }
}

fn range(key: &str, value: f64, good: bool, range: &'static str) -> Result<(), RadioError> {
    if good { Ok(()) } else { Err(RadioError::Range { key: key.into(), value, range }) }
}

fn positive(key: &str, value: f64) -> Result<(), RadioError> {
    range(key, value, value.is_finite() && value > 0.0, "above 0")
}

fn not_negative(key: &str, value: f64) -> Result<(), RadioError> {
    range(key, value, value.is_finite() && value >= 0.0, "at least 0")
}
