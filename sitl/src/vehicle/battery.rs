//! The battery: what propulsion and radio have really spent, taken from a pack of constant voltage.
//! Knows energy, not why it was spent. An empty pack is reported and ends no flight: the paper has
//! no battery.
//!
//! | value | ours, because |
//! |---|---|
//! | 14.8 V, 5 Ah | a pack of this size: 266 kJ, 26 minutes of hover at the paper's 167 W |
//! | one unit of transmit power is 1 W | the paper gives a_p no unit; its E_comm, Σ a_p, is then watts an interval |

use crate::link::dialect::{
    self, MavBatteryChargeState, MavBatteryFault, MavBatteryFunction, MavBatteryType,
};
use crate::scenario::Scenario;
use crate::units::TxPower;
use crate::world::energy;

const VOLTS: f64 = 14.8;
const CAPACITY_J: f64 = VOLTS * 5.0 * 3600.0;
const RADIO_WATTS: f64 = 1.0;
/// "Not in use" in `voltages`.
const NO_CELL: u16 = u16::MAX;

/// A pack in use.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Battery {
    spent_j: f64,
    /// In the interval that just ended.
    watts: Option<f64>,
}

impl Battery {
    /// A control interval has passed at this speed, units per interval, or with the motors off, and at
    /// this transmit power.
    pub fn spend(&mut self, speed: Option<f64>, power: TxPower, scenario: &Scenario) {
        let scale = &scenario.scale;
        let propulsion = speed.map_or(0.0, |speed| {
            energy::propulsion_power(speed * scale.mps_per_speed(), &scenario.propulsion)
        });
        let watts = propulsion + RADIO_WATTS * power.level();
        self.spent_j += watts * scale.interval_s;
        self.watts = Some(watts);
    }

    /// Percent left.
    pub fn remaining(&self) -> i8 {
        (100.0 * (1.0 - self.spent_j / CAPACITY_J)).round().clamp(0.0, 100.0) as i8
    }

    /// Volts times 1000.
    pub fn millivolts(&self) -> u16 {
        (VOLTS * 1e3) as u16
    }

    /// Amperes times 100; -1, unknown, before the first interval.
    pub fn centiamperes(&self) -> i16 {
        self.watts.map_or(-1, |watts| (watts / VOLTS * 100.0).round() as i16)
    }

    /// BATTERY_STATUS.
    pub fn status(&self) -> dialect::BATTERY_STATUS_DATA {
        let mut voltages = [NO_CELL; 10];
        voltages[0] = self.millivolts();
        let left_j = (CAPACITY_J - self.spent_j).max(0.0);
        dialect::BATTERY_STATUS_DATA {
            current_consumed: (self.spent_j / VOLTS / 3.6).round() as i32,
            energy_consumed: (self.spent_j / 100.0).round() as i32,
            temperature: i16::MAX,
            voltages,
            current_battery: self.centiamperes(),
            id: 0,
            battery_function: MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL,
            mavtype: MavBatteryType::MAV_BATTERY_TYPE_LIPO,
            battery_remaining: self.remaining(),
            time_remaining: self.watts.map_or(0, |watts| (left_j / watts) as i32),
            charge_state: self.charge(),
            fault_bitmask: MavBatteryFault::empty(),
            ..Default::default()
        }
    }

    fn charge(&self) -> MavBatteryChargeState {
        match self.remaining() {
            ..=4 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_EMERGENCY,
            5..=9 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_CRITICAL,
            10..=19 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW,
            _ => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hover_empties_it_and_it_stays_empty() {
        let (mut battery, scenario) = (Battery::default(), Scenario::default());
        assert_eq!((battery.remaining(), battery.centiamperes()), (100, -1));
        let mut seconds = 0.0;
        while battery.remaining() > 50 {
            battery.spend(Some(0.0), TxPower::Low, &scenario);
            seconds += scenario.scale.interval_s;
        }
        let half = 0.495 * CAPACITY_J / (79.0 + 88.0 + 1.0);
        assert!((seconds - half).abs() < 1.0, "{seconds} s to a half, {half} s by hand");
        assert!((f64::from(battery.status().time_remaining) - CAPACITY_J / 168.0 + seconds).abs() < 2.0);
        for _ in 0..10_000 {
            battery.spend(Some(0.04), TxPower::High, &scenario);
        }
        let status = battery.status();
        assert_eq!((status.battery_remaining, status.time_remaining), (0, 0));
        assert_eq!(status.charge_state, MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_EMERGENCY);
    }
}
