//! `--radio`: the radio for everything that a vehicle says and hears, between its endpoints and itself.
//!
//! Opens no socket and reads no clock. The frames of what a vehicle sends go down one by one, and those of what
//! arrives go up, by the radio's rules ([`crate::radio::air`]); bytes that are no frame are not carried.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use anyhow::{Context, Result};

use crate::link::dialect::{DATA_TRANSMISSION_HANDSHAKE_DATA, ENCAPSULATED_DATA_DATA};
use crate::link::image::png_from_frame;
use crate::link::splitter::Splitter;
use crate::link::{MessageData, PeerId};
use crate::radio::air::scenic::{bandwidth_for, discs};
use crate::radio::air::{Air, AirRadio, CarriedFrame, FrameFate, Way};
use crate::scenario::Scenario;
use crate::sim::Sim;
use crate::units::{Tick, TxPower};

/// The word for the paper's gate, which carries setpoints alone.
pub const SETPOINTS: &str = "setpoints";
/// The word for the scenario's radio.
const ALL: &str = "all";

/// The radio that `--radio` names; `None` for the paper's gate. That of the scenario has the bandwidth on which the
/// flight's first picture takes `picture_intervals` from the start.
///
/// # Errors
/// There is no such radio; the picture cannot be encoded.
pub fn radio(name: &str, scenario: &Scenario, picture_intervals: f64) -> Result<Option<AirRadio>> {
    match name {
        SETPOINTS => Ok(None),
        ALL => {
            let picture = png_from_frame(&Sim::new(scenario.clone(), 0).frame(), Tick(0));
            let bits = 8.0 * picture.context("the first picture")?.len() as f64;
            let hertz = bandwidth_for(scenario, bits, picture_intervals);
            Ok(Some(AirRadio::of_scenario(scenario, hertz)))
        }
        other => Ok(Some(AirRadio::named(other)?)),
    }
}

/// A radio of `scenario`'s base station, link number `link` of a seed.
///
/// # Errors
/// The radio's buildings do not read.
pub fn over<T>(radio: AirRadio, scenario: &Scenario, seed: u64, link: u64) -> Result<Air<T>> {
    let mut air = Air::new(radio, seed, link)?;
    let [north, east] = scenario.scale.ned_from_paper(scenario.channel.base_station).map(f64::from);
    air.set_base([north, east, 0.0]);
    Ok(air)
}

/// Tells a radio where the vehicle and the obstacles are, and the station's power.
pub fn place<T>(air: &mut Air<T>, sim: &Sim) {
    let scenario = sim.scenario();
    let [north, east] = sim.telemetry().position.map(f64::from);
    air.set_place([north, east, scenario.scale.altitude_m]);
    air.set_discs(discs(scenario, &sim.world().obstacles()));
    set_power(air, sim.power());
}

/// Sets the station's power.
pub fn set_power<T>(air: &mut Air<T>, power: TxPower) {
    air.set_power(usize::from(power == TxPower::High));
}

/// Whether a message is part of a picture.
#[must_use]
pub fn is_picture(kind: u32) -> bool {
    kind == DATA_TRANSMISSION_HANDSHAKE_DATA::ID || kind == ENCAPSULATED_DATA_DATA::ID
}

/// A radio whose sender holds back what is long: one picture at a time, part by part, each when nothing else waits.
/// A picture that comes while parts of another one wait is left out, and reports never wait for more than a part.
#[derive(Debug)]
pub struct PacedAir<T> {
    air: Air<T>,
    /// Parts of the picture: kind, length, frame.
    parts: VecDeque<(u32, usize, T)>,
    /// Whether the parts that come belong to a picture that is left out.
    skips: bool,
    polled: Duration,
}

impl<T> PacedAir<T> {
    /// A radio with an idle sender.
    #[must_use]
    pub fn new(air: Air<T>) -> Self {
        Self { air, parts: VecDeque::new(), skips: false, polled: Duration::ZERO }
    }

    /// The radio.
    pub fn air(&mut self) -> &mut Air<T> {
        &mut self.air
    }

    /// Whether a picture would be sent now.
    #[must_use]
    pub fn is_free(&self) -> bool {
        self.parts.is_empty()
    }

    /// A frame of the message `kind` is handed to its sender.
    pub fn offer(&mut self, now: Duration, way: Way, kind: u32, bytes: usize, frame: T) {
        if way == Way::Up || !is_picture(kind) {
            self.air.offer(now, way, kind, bytes, frame);
            return;
        }
        if kind == DATA_TRANSMISSION_HANDSHAKE_DATA::ID {
            self.skips = !self.is_free();
        }
        if !self.skips {
            self.parts.push_back((kind, bytes, frame));
        }
    }

    /// Goes on to `now`, and hands out every frame whose fate is settled by then, in order of time.
    pub fn poll(&mut self, now: Duration, mut each: impl FnMut(CarriedFrame<T>)) {
        loop {
            if self.air.waiting(Way::Down) == 0
                && let Some((kind, bytes, frame)) = self.parts.pop_front()
            {
                self.air.offer(self.polled, Way::Down, kind, bytes, frame);
            }
            let next = self.air.next_event().filter(|next| *next <= now);
            self.polled = next.unwrap_or(now).max(self.polled);
            self.air.poll(self.polled, &mut each);
            if next.is_none() && (self.is_free() || self.air.waiting(Way::Down) > 0) {
                return;
            }
        }
    }

    /// When [`PacedAir::poll`] has something to do next.
    #[must_use]
    pub fn next_event(&self) -> Option<Duration> {
        self.air.next_event()
    }
}

/// The radio of one vehicle.
#[derive(Debug)]
pub struct AirGap {
    air: PacedAir<(PeerId, Vec<u8>)>,
    splitters: BTreeMap<PeerId, Splitter>,
    placed: Option<Tick>,
}

impl AirGap {
    /// The radio of vehicle number `link`.
    ///
    /// # Errors
    /// The radio's buildings do not read.
    pub fn new(radio: AirRadio, scenario: &Scenario, seed: u64, link: u64) -> Result<Self> {
        let air = PacedAir::new(over(radio, scenario, seed, link)?);
        Ok(Self { air, splitters: BTreeMap::new(), placed: None })
    }

    /// Bytes for a peer go down, or bytes of a peer go up.
    pub fn offer(&mut self, way: Way, peer: PeerId, bytes: &[u8], now: Duration) {
        let Self { air, splitters, .. } = self;
        // Down every datagram begins with a frame; up a stream may be cut anywhere.
        let mut whole = Splitter::of_datagrams();
        let splitter = match way {
            Way::Up => splitters.entry(peer).or_default(),
            Way::Down => &mut whole,
        };
        splitter.split(bytes, |frame| {
            air.offer(now, way, frame.id, frame.raw.len(), (peer, frame.raw.to_vec()));
        });
    }

    /// Goes on to `now`, and hands out what has arrived.
    pub fn poll(&mut self, sim: &Sim, now: Duration, mut each: impl FnMut(Way, PeerId, &[u8])) {
        if self.placed != Some(sim.tick()) {
            place(self.air.air(), sim);
            self.placed = Some(sim.tick());
        }
        self.air.poll(now, |CarriedFrame { frame: (peer, bytes), way, fate, .. }| {
            if fate == FrameFate::Arrived {
                each(way, peer, &bytes);
            }
        });
    }

    /// When [`AirGap::poll`] has something to do next.
    #[must_use]
    pub fn next_event(&self) -> Option<Duration> {
        self.air.next_event()
    }

    /// A peer has gone away.
    pub fn closed(&mut self, peer: PeerId) {
        self.splitters.remove(&peer);
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use super::*;
    use crate::link::dialect::HEARTBEAT_DATA;
    use crate::link::encoder::Encoder;

    #[test]
    fn frames_arrive_late_whole_and_at_whom_they_are_for() {
        let scenario = Scenario::default();
        let radio = AirRadio::named("satellite").unwrap();
        let (mut gap, sim) = (AirGap::new(radio, &scenario, 1, 0).unwrap(), Sim::new(scenario, 1));
        let [a, b] = [1, 2].map(|port| PeerId::from(SocketAddr::from(([127, 0, 0, 1], port))));
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(1, 1);
        (0..2).for_each(|_| encoder.push(&mut bytes, &HEARTBEAT_DATA::default()));
        let mut arrived = Vec::new();
        gap.poll(&sim, Duration::ZERO, |_, _, _| unreachable!("nothing was offered"));
        gap.offer(Way::Down, a, &bytes, Duration::ZERO);
        gap.offer(Way::Up, b, &bytes[..30], Duration::ZERO);
        gap.poll(&sim, Duration::from_millis(1), |_, _, _| unreachable!("it takes longer"));
        gap.offer(Way::Up, b, &bytes[30..], Duration::from_millis(2));
        while let Some(next) = gap.next_event() {
            gap.poll(&sim, next, |way, peer, bytes| arrived.push((way, peer, bytes.to_vec())));
        }
        let of = |way: Way, peer: PeerId| {
            let mine = arrived.iter().filter(|(w, p, _)| (*w, *p) == (way, peer));
            mine.flat_map(|(_, _, bytes)| bytes.clone()).collect::<Vec<u8>>()
        };
        assert_eq!((of(Way::Down, a), of(Way::Up, b)), (bytes.clone(), bytes));
        assert_eq!(arrived.len(), 4);
    }

    #[test]
    fn the_radio_s_word_names_the_gate_the_scenario_or_a_preset() {
        let scenario = Scenario::default();
        assert_eq!(radio(SETPOINTS, &scenario, 1.0).unwrap(), None);
        assert_eq!(radio("wifi", &scenario, 1.0).unwrap().unwrap().name, "wifi");
        let [slow, fast] = [3.0, 1.0].map(|x| radio("all", &scenario, x).unwrap().unwrap().bandwidth_hz);
        assert!((fast / slow - 3.0).abs() < 1e-9);
        assert!(radio("no such", &scenario, 1.0).unwrap_err().to_string().contains("sik-57"));
    }

    #[test]
    fn a_report_waits_for_a_part_of_a_picture_and_a_second_picture_is_left_out() {
        let mut radio = AirRadio::default();
        radio.down.rate = crate::radio::air::rate::AirRate::Fixed { bps: 8e3, snr_db: -100.0 };
        let mut air = PacedAir::new(Air::new(radio, 0, 0).unwrap());
        let (begin, part) = (DATA_TRANSMISSION_HANDSHAKE_DATA::ID, ENCAPSULATED_DATA_DATA::ID);
        let at = Duration::from_millis;
        // A byte takes a millisecond.
        for (kind, frame) in [(begin, "a0"), (part, "a1"), (part, "a2"), (begin, "b0"), (part, "b1")] {
            air.offer(at(0), Way::Down, kind, 100, frame);
        }
        let mut arrived = Vec::new();
        air.poll(at(50), |frame| arrived.push((frame.done.as_millis(), frame.frame)));
        air.offer(at(50), Way::Down, 0, 10, "report");
        air.poll(at(1000), |frame| arrived.push((frame.done.as_millis(), frame.frame)));
        assert_eq!(arrived, [(100, "a0"), (110, "report"), (210, "a1"), (310, "a2")]);
        assert!(air.is_free());
    }
}
