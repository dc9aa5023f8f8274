//! Who of several vehicles may be spoken to in an interval, for how long, and at which power. Knows gains, not
//! geometry.

use crpl_sitl::units::TxPower;

use crate::station::pilot::crpl_bw::HEADROOM;

/// How the base station shares its bandwidth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scheduler {
    /// A slot of equal length for each vehicle in every interval
    Tdma,
    /// One vehicle after the other has a whole interval
    RoundRobin,
    /// As many vehicles as fit, each with the slot that its predicted gain needs, the nearest predicted outage first
    Predicted,
}

impl Scheduler {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Tdma, Self::RoundRobin, Self::Predicted];

    /// The word of tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tdma => "tdma",
            Self::RoundRobin => "round-robin",
            Self::Predicted => "predicted",
        }
    }
}

/// The radio that is shared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedRadio {
    /// B Δt of all slots together, bits per interval and unit of spectral efficiency.
    pub b_dt: f64,
    /// L_pkt, bits.
    pub packet_bits: f64,
    /// P_n.
    pub noise_power: f64,
}

impl SharedRadio {
    /// The share of an interval that a packet takes at a predicted gain |h|², with the headroom that the prediction
    /// needs: s = L / (B Δt log2(1 + γ)).
    #[must_use]
    pub fn share(&self, gain: f64, power: TxPower) -> f64 {
        let snr = gain * power.level() / (self.noise_power * HEADROOM);
        self.packet_bits / (self.b_dt * (1.0 + snr).log2()).max(f64::MIN_POSITIVE)
    }
}

/// What the base station knows of a vehicle that has a command waiting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlotRequest {
    /// Which.
    pub vehicle: usize,
    /// |h|² as predicted for this interval.
    pub gain: f64,
    /// Intervals until its share is predicted not to carry a packet at any power; `None` if not in sight.
    pub outage_in: Option<u32>,
    /// Intervals since a command last got through.
    pub waited: u64,
    /// The power that its controller asks for.
    pub power: TxPower,
}

/// A slot of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GrantedSlot {
    /// Whose.
    pub vehicle: usize,
    /// Its share of the interval, in (0, 1].
    pub share: f64,
    /// The power in it.
    pub power: TxPower,
}

impl Scheduler {
    /// The slots of interval `turn`.
    #[must_use]
    pub fn allot(self, requests: &[SlotRequest], radio: &SharedRadio, turn: u64) -> Vec<GrantedSlot> {
        let slot = |r: &SlotRequest, share| GrantedSlot { vehicle: r.vehicle, share, power: r.power };
        let n = requests.len();
        match self {
            Self::Tdma => requests.iter().map(|r| slot(r, 1.0 / n as f64)).collect(),
            Self::RoundRobin => {
                let whose = (turn % n.max(1) as u64) as usize;
                requests.get(whose).map(|r| slot(r, 1.0)).into_iter().collect()
            }
            Self::Predicted => predicted(requests, radio),
        }
    }
}

/// Stage 2 for several vehicles: the least power at which all packets fit into the interval. All begin at low power;
/// while the slots do not fit, high power goes where it saves most. What does not fit at high power either is served
/// by its urgency: the nearest predicted outage, then the longest wait. What is left of the interval widens all slots.
fn predicted(requests: &[SlotRequest], radio: &SharedRadio) -> Vec<GrantedSlot> {
    let mut order: Vec<&SlotRequest> = requests.iter().collect();
    order.sort_by_key(|r| (r.outage_in.unwrap_or(u32::MAX), std::cmp::Reverse(r.waited), r.vehicle));
    let mut slots: Vec<GrantedSlot> = order
        .iter()
        .map(|r| {
            let power = TxPower::Low;
            GrantedSlot { vehicle: r.vehicle, share: radio.share(r.gain, power), power }
        })
        .collect();
    let saving = |slot: &GrantedSlot, gain: f64| slot.share - radio.share(gain, TxPower::High);
    while total(&slots) > 1.0 {
        let candidates = (0..slots.len()).filter(|k| slots[*k].power == TxPower::Low);
        let most = candidates
            .max_by(|a, b| saving(&slots[*a], order[*a].gain).total_cmp(&saving(&slots[*b], order[*b].gain)));
        let Some(k) = most else { break };
        slots[k] = GrantedSlot {
            share: radio.share(order[k].gain, TxPower::High),
            power: TxPower::High,
            ..slots[k]
        };
    }
    let mut left = 1.0;
    slots.retain(|slot| {
        let fits = slot.share <= left;
        left -= if fits { slot.share } else { 0.0 };
        fits
    });
    let wider = 1.0 / total(&slots).max(f64::MIN_POSITIVE);
    slots.iter_mut().for_each(|slot| slot.share *= wider);
    slots
}

fn total(slots: &[GrantedSlot]) -> f64 {
    slots.iter().map(|slot| slot.share).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIO: SharedRadio = SharedRadio { b_dt: 4.0, packet_bits: 4.0, noise_power: 1.0 };

    fn request(vehicle: usize, gain: f64, outage_in: Option<u32>) -> SlotRequest {
        SlotRequest { vehicle, gain, outage_in, waited: 0, power: TxPower::Low }
    }

    #[test]
    fn equal_slots_and_turns() {
        let requests = [0, 1, 2].map(|k| request(k, 5.0, None));
        let shares: Vec<f64> = Scheduler::Tdma.allot(&requests, &RADIO, 7).iter().map(|s| s.share).collect();
        assert_eq!(shares, [1.0 / 3.0; 3]);
        let turns: Vec<usize> =
            (0..4).map(|turn| Scheduler::RoundRobin.allot(&requests, &RADIO, turn)[0].vehicle).collect();
        assert_eq!(turns, [0, 1, 2, 0]);
        for scheduler in [Scheduler::Tdma, Scheduler::RoundRobin, Scheduler::Predicted] {
            assert!(scheduler.allot(&[], &RADIO, 3).is_empty());
        }
    }

    #[test]
    fn the_least_power_that_fits_is_taken_and_no_slot_is_longer_than_there_is_room() {
        // One vehicle in good sight, one far away: low power for both does not fit, high for the far one does.
        let near = request(0, 1000.0, None);
        let far = request(1, 1.2, None);
        assert!(RADIO.share(1000.0, TxPower::Low) + RADIO.share(1.2, TxPower::Low) > 1.0);
        let slots = Scheduler::Predicted.allot(&[near, far], &RADIO, 0);
        let power = |vehicle: usize| slots.iter().find(|s| s.vehicle == vehicle).map(|s| s.power);
        assert_eq!((power(0), power(1)), (Some(TxPower::Low), Some(TxPower::High)));
        assert!((total(&slots) - 1.0).abs() < 1e-12);
        assert!(slots.iter().all(|s| s.share >= RADIO.share([1000.0, 1.2][s.vehicle], s.power)));
    }

    #[test]
    fn where_not_all_fit_the_nearest_outage_goes_first_and_then_the_longest_wait() {
        let mut requests = [0, 1, 2, 3].map(|k| request(k, 1.0, None));
        requests[2].outage_in = Some(3);
        requests[3].waited = 5;
        let served: Vec<usize> =
            Scheduler::Predicted.allot(&requests, &RADIO, 0).iter().map(|s| s.vehicle).collect();
        assert_eq!(served, [2, 3]);
    }
}
