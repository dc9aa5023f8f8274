//! Geometry to SNR: the link budget of one moment, both ways. Knows no packets.

use nalgebra::{Vector2, Vector3};

use super::blockage::{DiscObstacle, Surroundings};
use super::config::{AirEnd, AirRadio, PathModel, RadioError, SightRule};
use super::fading::{ShadowField, normal_distribution};
use super::pathloss::{self, Ends};
use crate::units::noise::Noise;

/// The way of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Way {
    /// Station to vehicle.
    Up,
    /// Vehicle to station.
    Down,
}

impl Way {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::Up, Self::Down];

    /// The word of tables and ledgers.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::Down => "down",
        }
    }
}

/// What a receiver has in a slot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkBudget {
    /// Received power, dBm.
    pub rssi_dbm: f64,
    /// Noise, dBm.
    pub noise_dbm: f64,
}

impl LinkBudget {
    /// γ, dB.
    #[must_use]
    pub fn snr_db(&self) -> f64 {
        self.rssi_dbm - self.noise_dbm
    }
}

/// A radio's channel: a function of (seed, link), place and slot.
#[derive(Debug, Clone)]
pub struct AirChannel {
    radio: AirRadio,
    around: Surroundings,
    noise: Noise,
    shadow: ShadowField,
    sight: ShadowField,
    link: u64,
}

impl AirChannel {
    /// The channel of link number `link`; links of one seed have chances of their own.
    ///
    /// # Errors
    /// The file of the buildings is wrong.
    pub fn new(radio: AirRadio, seed: u64, link: u64) -> Result<Self, RadioError> {
        let noise = Noise::new(seed);
        let field = |kind: u64| ShadowField::new(&noise, mix([link, kind, 0, 0]), radio.shadowing.distance_m);
        let (shadow, sight) = (field(0), field(1));
        Ok(Self { around: radio.surroundings()?, shadow, sight, radio, noise, link })
    }

    /// The radio.
    #[must_use]
    pub fn radio(&self) -> &AirRadio {
        &self.radio
    }

    /// The station is at another place: north and east, and the height of the ground there, to which that of its
    /// antenna is added, m.
    pub fn set_base(&mut self, [north, east, ground]: [f64; 3]) {
        self.radio.ground.place = [north, east];
        self.radio.ground.height_m += ground;
    }

    /// The station transmits at this level, or at its highest.
    pub fn set_power(&mut self, level: usize) {
        let last = self.radio.ground.powers_dbm.len().saturating_sub(1);
        self.radio.ground.power = level.min(last);
    }

    /// The upright cylinders stand here.
    pub fn set_discs(&mut self, discs: Vec<DiscObstacle>) {
        self.around.set_discs(discs);
    }

    /// The seed's chance.
    #[must_use]
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The link's number.
    #[must_use]
    pub fn link(&self) -> u64 {
        self.link
    }

    /// What the receiver of a way has in a slot, with the vehicle at `place`: north, east and height above the
    /// ground, m.
    #[must_use]
    pub fn budget(&self, way: Way, place: Vector3<f64>, slot: u64) -> LinkBudget {
        let radio = &self.radio;
        let vehicle = place + Vector3::new(0.0, 0.0, radio.vehicle.height_m);
        let base = Vector2::from(radio.ground.place).push(radio.ground.height_m);
        let (from, to) = match way {
            Way::Up => (&radio.ground, &radio.vehicle),
            Way::Down => (&radio.vehicle, &radio.ground),
        };
        let offset = vehicle - base;
        let ends = Ends { plan: offset.xy().norm(), base_height: base.z, height: vehicle.z };
        let (azimuth, elevation) = (offset.y.atan2(offset.x), ends.elevation());
        let turned = azimuth + std::f64::consts::PI;
        let gains = gain(&radio.ground, azimuth, elevation) + gain(&radio.vehicle, turned, -elevation);
        let loss = self.path_db(&ends, base, vehicle) + self.shadow_db(place);
        let fading = radio.fading.gain_db(elevation, &self.noise, mix([self.link, slot, 0, 0]));
        let rssi_dbm = from.power_dbm() - from.loss_db - to.loss_db + gains - loss + fading;
        LinkBudget { rssi_dbm, noise_dbm: to.noise_dbm(radio.bandwidth_hz) }
    }

    fn shadow_db(&self, place: Vector3<f64>) -> f64 {
        match self.radio.shadowing.sigma_db {
            0.0 => 0.0,
            sigma => sigma * self.shadow.at(place.xy()),
        }
    }

    /// Path loss, and what obstacles cost.
    fn path_db(&self, ends: &Ends, base: Vector3<f64>, vehicle: Vector3<f64>) -> f64 {
        let carrier = self.radio.carrier_hz;
        let d = ends.distance();
        let blocked = || self.blockage_db(base, vehicle);
        match self.radio.path {
            PathModel::None => blocked(),
            PathModel::Paper { unit_m, reference_gain, exponent, floor } => {
                let d = ends.plan.max(floor * unit_m);
                pathloss::paper(d, unit_m, reference_gain, exponent) + blocked()
            }
            PathModel::FreeSpace => pathloss::free_space(d, carrier) + blocked(),
            PathModel::Orbit { distance_m } => pathloss::free_space(distance_m, carrier),
            PathModel::TwoRay { permittivity } => {
                let grazing = (ends.height + ends.base_height).atan2(ends.plan);
                let reflection = pathloss::ground_reflection(grazing, permittivity);
                pathloss::two_ray(ends, carrier, reflection) + blocked()
            }
            PathModel::LogDistance { reference_db, reference_m, exponent } => {
                pathloss::log_distance(d, reference_db, reference_m, exponent) + blocked()
            }
            PathModel::AlHourani { shape, excess_db } => {
                pathloss::al_hourani(ends, carrier, shape, excess_db) + blocked()
            }
            PathModel::UmaAv => match self.free(pathloss::uma_av_sight(ends), base, vehicle) {
                true => pathloss::uma_av_los(ends, carrier),
                false => pathloss::uma_av_nlos(ends, carrier),
            },
            PathModel::RmaAv => match self.free(pathloss::rma_av_sight(ends), base, vehicle) {
                true => pathloss::rma_av_los(ends, carrier),
                false => pathloss::rma_av_nlos(ends, carrier),
            },
        }
    }

    fn blockage_db(&self, base: Vector3<f64>, vehicle: Vector3<f64>) -> f64 {
        let edge = self.around.worst(base, vehicle);
        edge.map_or(0.0, |edge| self.radio.blockage.db(&edge, self.radio.carrier_hz))
    }

    /// Whether the sight line is free.
    fn free(&self, chance: f64, base: Vector3<f64>, vehicle: Vector3<f64>) -> bool {
        match self.radio.sight {
            SightRule::Obstacles => self.around.worst(base, vehicle).is_none_or(|edge| edge.reach <= 0.0),
            SightRule::Chance => normal_distribution(self.sight.at(vehicle.xy())) <= chance,
        }
    }
}

fn gain(end: &AirEnd, azimuth: f64, elevation: f64) -> f64 {
    end.gain_dbi + end.pattern.db(azimuth, elevation)
}

/// Four numbers as one, every bit of which depends on each bit of theirs: rounds of SplitMix64 (S. Vigna, after
/// G. L. Steele et al., OOPSLA 2014).
#[must_use]
pub fn mix(words: [u64; 4]) -> u64 {
    words.iter().fold(0, |hash, word| {
        let mut z = (hash ^ word).wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;
    use crate::units::Snr;
    use crate::units::TxPower;
    use crate::world::channel;
    use crate::world::obstacles::Obstacles;

    #[test]
    fn the_paper_s_preset_is_the_paper_s_channel() {
        let radio = AirRadio::named("paper").unwrap();
        let mut channel = AirChannel::new(radio, 0, 0).unwrap();
        let scenario = Scenario::default();
        let obstacles: Obstacles = scenario.obstacles.iter().map(|o| o.position).collect();
        for (x, y) in [(0.1, 0.5), (0.5, 0.9), (0.52, 0.7), (0.9, 0.5), (0.3, 0.2)] {
            let uav = Vector2::new(x, y);
            let place = Vector3::new(500.0 * y, 500.0 * x, 100.0);
            for (level, power) in [(0, TxPower::Low), (1, TxPower::High)] {
                channel.radio.ground.power = level;
                let ours = Snr::from_db(channel.budget(Way::Up, place, 3).snr_db()).0;
                let gain = obstacles.gain(uav, &scenario);
                let theirs = channel::snr(gain, power.level(), &scenario.channel).0;
                assert!((ours / theirs - 1.0).abs() < 1e-9, "{uav:?} {power:?}: {ours} {theirs}");
            }
        }
    }

    #[test]
    fn a_budget_adds_up() {
        let text = "extends = \"perfect\"\npath = { model = \"free-space\" }\ncarrier_hz = 433e6\nbandwidth_hz = 64e3\n\
                    [ground]\npowers_dbm = [20]\ngain_dbi = 3\nloss_db = 1\n[vehicle]\nnoise_figure_db = 9\n";
        let channel = AirChannel::new(AirRadio::parse(text, "x").unwrap(), 0, 0).unwrap();
        let budget = channel.budget(Way::Up, Vector3::new(1000.0, 0.0, 0.0), 0);
        // 20 + 3 - 1 - 85.18; -173.975 + 48.06 + 9.
        assert!((budget.rssi_dbm + 63.18).abs() < 0.01, "{budget:?}");
        assert!((budget.noise_dbm + 116.91).abs() < 0.01, "{budget:?}");
    }

    #[test]
    fn chance_depends_on_seed_link_slot_and_place() {
        let radio = AirRadio::named("lte").unwrap();
        let place = Vector3::new(900.0, 100.0, 30.0);
        let at = |seed, link, slot, place| {
            AirChannel::new(radio.clone(), seed, link).unwrap().budget(Way::Down, place, slot).rssi_dbm
        };
        let one = at(1, 0, 5, place);
        assert_eq!(one, at(1, 0, 5, place));
        for other in [at(2, 0, 5, place), at(1, 1, 5, place), at(1, 0, 6, place), at(1, 0, 5, place * 2.0)] {
            assert!((one - other).abs() > 1e-6);
        }
    }

    #[test]
    fn a_house_darkens_what_is_behind_it() {
        let text = "path = { model = \"free-space\" }\n[[prism]]\ncorners = [[40, -10], [40, 10], [60, 10], [60, -10]]\n\
                    height_m = 50\n[ground]\nheight_m = 2\n";
        let mut radio = AirRadio::parse(text, "x").unwrap();
        let rssi = |radio: &AirRadio, up: f64| {
            let channel = AirChannel::new(radio.clone(), 0, 0).unwrap();
            channel.budget(Way::Up, Vector3::new(200.0, 0.0, up), 0).rssi_dbm
        };
        // Behind it some 25 to 40 dB less, above it nothing.
        assert!(rssi(&radio, 300.0) - rssi(&radio, 30.0) > 15.0);
        let free = AirRadio { prisms: Vec::new(), ..radio.clone() };
        assert_eq!(rssi(&radio, 300.0), rssi(&free, 300.0));
        assert!((20.0..=40.0).contains(&(rssi(&free, 30.0) - rssi(&radio, 30.0))));
        // A formula with a case for it takes that case.
        radio.path = PathModel::UmaAv;
        assert!(rssi(&radio, 300.0) > rssi(&radio, 30.0) + 5.0);
    }
}
