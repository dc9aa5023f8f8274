//! The radio of a scenario, for whole frames: the scenario's channel, gate and obstacles.
//!
//! Up, the station's setpoint passes the paper's gate (Sec. IV-A4): it is a packet of L bits whatever its frame's
//! length. Down, every bit counts: R = B log2(1 + γ) on a bandwidth of its own, and nothing below the SNR at which
//! the gate opens.

use super::blockage::{BlockageLoss, DiscObstacle};
use super::config::{AirEnd, AirRadio, Modem, PathModel};
use super::rate::{AirRate, FrameError};
use crate::scenario::Scenario;
use crate::units::{Scale, Snr, TxPower};
use crate::world::channel;
use crate::world::obstacles::Obstacles;

/// What may wait in the vehicle's sender, bytes: as in the first SiK radios (our choice).
const QUEUE_BYTES: usize = 2048;

impl AirRadio {
    /// The radio of `scenario` with `down_hz` of bandwidth for what the vehicle sends.
    #[must_use]
    pub fn of_scenario(scenario: &Scenario, down_hz: f64) -> Self {
        let (channel, gate, scale) = (&scenario.channel, &scenario.radio, &scenario.scale);
        let end = AirEnd {
            powers_dbm: [TxPower::Low, TxPower::High].map(|power| Snr(power.level()).to_db()).into(),
            noise_dbm: Some(Snr(channel.noise_power).to_db()),
            ..AirEnd::default()
        };
        let error = FrameError::Step;
        let (b_dt, packet_bits) = (gate.b_dt, gate.packet_bits);
        let opens_db = channel::outage_snr(b_dt, packet_bits).to_db();
        let shannon = AirRate::Shannon { gap_db: 0.0, max_bps: f64::MAX, min_snr_db: opens_db };
        Self {
            name: scenario.name.clone(),
            bandwidth_hz: down_hz,
            slot_s: scale.interval_s,
            path: PathModel::Paper {
                unit_m: scale.metres_per_unit,
                reference_gain: channel.reference_gain,
                exponent: channel.path_loss_exponent,
                floor: channel.distance_floor,
            },
            blockage: BlockageLoss::Soft {
                attenuation: channel.nlos_attenuation,
                softness_m: channel.blockage_softness * scale.metres_per_unit,
            },
            ground: AirEnd {
                place: scale.ned_from_paper(channel.base_station).map(f64::from),
                ..end.clone()
            },
            vehicle: end,
            discs: discs(scenario, &scenario.obstacles.iter().map(|o| o.position).collect()),
            up: Modem { rate: AirRate::Outage { b_dt, packet_bits }, error, ..Modem::default() },
            down: Modem { rate: shannon, error, queue_bytes: QUEUE_BYTES, ..Modem::default() },
            ..Self::default()
        }
    }
}

/// The obstacles of a scenario where they are now, as cylinders without end.
#[must_use]
pub fn discs(scenario: &Scenario, obstacles: &Obstacles) -> Vec<DiscObstacle> {
    let disc = |scale: &Scale, r, radius: f64| DiscObstacle {
        centre: scale.ned_from_paper(r).map(f64::from),
        radius_m: radius * scale.metres_per_unit,
        height_m: None,
    };
    let places = obstacles.iter().zip(&scenario.obstacles);
    places.map(|(r, obstacle)| disc(&scenario.scale, *r, obstacle.radius)).collect()
}

/// The bandwidth on which `bits` take `intervals` control intervals from the scenario's start, nothing in the way and
/// at low power, Hz.
#[must_use]
pub fn bandwidth_for(scenario: &Scenario, bits: f64, intervals: f64) -> f64 {
    let gain = channel::los_gain(scenario.start, &scenario.channel);
    let snr = channel::snr(gain, TxPower::Low.level(), &scenario.channel);
    bits / (intervals * scenario.scale.interval_s * channel::bits(1.0, snr))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use nalgebra::Vector2;

    use super::*;
    use crate::radio::air::{Air, Way};
    use crate::world::World;

    #[test]
    fn the_radio_of_a_scenario_has_its_snr_with_and_without_an_obstacle_in_the_way() {
        let text = "[[obstacle]]\nposition = [0.4, 0.4]\n[[obstacle]]\nposition = [0.7, 0.6]\n";
        let scenario = Scenario::from_toml(text).unwrap();
        let mut air: Air<()> = Air::new(AirRadio::of_scenario(&scenario, 1e3), 0, 0).unwrap();
        let mut world = World::new(&scenario);
        for (x, y) in [(0.1, 0.5), (0.35, 0.8), (0.75, 0.8), (0.9, 0.2)] {
            world.uav.r = Vector2::new(x, y);
            let [north, east] = scenario.scale.ned_from_paper(world.uav.r).map(f64::from);
            air.set_place([north, east, 100.0]);
            for (level, power) in [TxPower::Low, TxPower::High].into_iter().enumerate() {
                air.set_power(level);
                let ours = air.budget(Duration::ZERO, Way::Up).snr_db();
                let theirs = world.snr(power, &scenario).to_db();
                assert!((ours - theirs).abs() < 1e-4, "{x} {y} {power:?}: {ours} {theirs}");
            }
        }
    }

    #[test]
    fn a_picture_takes_the_intervals_that_were_asked_for() {
        let scenario = Scenario { obstacles: Vec::new(), ..Scenario::default() };
        for intervals in [0.5, 3.0] {
            let hertz = bandwidth_for(&scenario, 8000.0, intervals);
            let mut air: Air<()> = Air::new(AirRadio::of_scenario(&scenario, hertz), 0, 0).unwrap();
            let [north, east] = scenario.scale.ned_from_paper(scenario.start).map(f64::from);
            air.set_place([north, east, 100.0]);
            air.offer(Duration::ZERO, Way::Down, 1, 1000, ());
            let mut took = 0.0;
            air.poll(Duration::from_secs(10), |frame| took = frame.delay().as_secs_f64());
            assert!((took / scenario.scale.interval_s - intervals).abs() < 1e-3, "{took}");
        }
    }
}
