//! Flights in process over a radio that carries everything: reports, pictures or latents down, setpoints up, each at
//! the length of its MAVLink frames.
//!
//! An interval of Δt passes so:
//!
//! | time | what happens |
//! |---|---|
//! | 0 | the vehicle sends its report; its camera takes a picture, if the one before has left |
//! | 0 to `DECIDES` Δt | what arrives is heard |
//! | `DECIDES` Δt | the station decides, from what has arrived, for this interval |
//! | to Δt | the command that has arrived by then is flown in this interval |
//!
//! A report, with its latents if they are sent, goes when the one before has left. The last line is the paper's: a packet takes up to Δt, and is flown in the interval in which it was sent. A report
//! goes before the parts of a picture that wait. Encoding on board takes no time. Chance is the radio's, by its seed,
//! so equal seeds give equal flights.

pub mod table;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Sim;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::SET_POSITION_TARGET_LOCAL_NED_DATA;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::image::{self, Reassembler};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::wire::{self, Clock, TelemetryReader};
use crpl_sitl::link::{AUTOPILOT, COMPANION, MessageData, RADIO, STATION_COMPONENT, STATION_SYSTEM, latents};
use crpl_sitl::program::air::{self, PacedAir, is_picture};
use crpl_sitl::radio::air::{AirRadio, CarriedFrame, FrameFate, Way};
use crpl_sitl::radio::message::Command;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Snr, Tick, TxPower};

use crate::station::Station;
use crate::station::sighting::Sighting;

/// When in an interval the station decides: what arrives later counts in the next one (our choice: down goes more
/// than up).
const DECIDES: f64 = 0.75;

/// What the vehicle sends of its camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Downlink {
    /// The picture, as PNG
    Picture,
    /// What the encoder makes of it on board
    Latent,
    /// Nothing: its reports alone
    Telemetry,
}

impl Downlink {
    /// The word of tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Latent => "latent",
            Self::Telemetry => "telemetry",
        }
    }
}

/// A radio that carries everything, and what goes over it.
#[derive(Debug, Clone, PartialEq)]
pub struct AirPlan {
    /// The radio.
    pub radio: AirRadio,
    /// What the vehicle sends of its camera.
    pub downlink: Downlink,
    /// Width of a latent's number, bits.
    pub latent_bits: u8,
}

/// What went over the radio in a flight.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AirTally {
    /// Of each decision the age of what it went by, intervals.
    pub ages: Vec<f64>,
    /// Intervals without a decision, because nothing had arrived yet.
    pub silent: u64,
    /// Bits that the vehicle and the station have put on the air.
    pub bits: [u64; 2],
    /// Pictures or latents that were taken, and that arrived whole.
    pub sights: [u64; 2],
}

/// What is on the air.
#[derive(Debug, Clone)]
enum AirParcel {
    Down(Packet),
    Up(Command),
}

/// Vehicle and station with their radio between them.
struct AirFlight<'a> {
    sim: &'a mut Sim,
    station: &'a mut Station,
    world: Arc<WorldModel>,
    air: PacedAir<AirParcel>,
    plan: &'a AirPlan,
    clock: Clock,
    vehicle: [Encoder; 2],
    companion: Encoder,
    ground: Encoder,
    reports: TelemetryReader,
    images: Reassembler,
    /// Frames of a report and of latents that have not left.
    unsent: usize,
    /// Whether the command of this interval has arrived.
    arrived: bool,
    tally: AirTally,
}

/// Flies `ticks` intervals over `plan`'s radio, whose chance has seed and number of the flight's own; gives a record
/// an interval, of what was true, and what went over the radio.
///
/// # Errors
/// A radio whose buildings do not read; latents that do not fit into a message.
pub fn fly(
    sim: &mut Sim,
    station: &mut Station,
    world: &Arc<WorldModel>,
    plan: &AirPlan,
    ticks: u64,
) -> Result<(Vec<Record>, AirTally)> {
    let air = PacedAir::new(air::over(plan.radio.clone(), sim.scenario(), sim.seed(), 0)?);
    let clock = Clock::new(sim.scenario());
    let mut flight = AirFlight {
        sim,
        station,
        world: world.clone(),
        air,
        plan,
        clock,
        vehicle: [AUTOPILOT, RADIO].map(|component| Encoder::new(1, component)),
        companion: Encoder::new(1, COMPANION),
        ground: Encoder::new(STATION_SYSTEM, STATION_COMPONENT),
        reports: TelemetryReader::default(),
        images: Reassembler::default(),
        unsent: 0,
        arrived: false,
        tally: AirTally::default(),
    };
    let mut records = Vec::new();
    for _ in 0..ticks {
        if flight.sim.is_fallen() {
            break;
        }
        records.push(flight.interval()?);
    }
    Ok((records, flight.tally))
}

impl AirFlight<'_> {
    fn interval(&mut self) -> Result<Record> {
        let scenario = self.sim.scenario();
        let (k, seconds) = (self.sim.tick(), scenario.scale.interval_s);
        let at = |part: f64| Duration::from_secs_f64((k.0 as f64 + part) * seconds);
        let before = self.sim.telemetry();
        air::place(self.air.air(), self.sim);
        self.arrived = false;
        if self.unsent == 0 {
            self.report(at(0.0));
            self.send_latents(at(0.0))?;
        }
        self.take_picture(at(0.0))?;
        self.run(at(DECIDES));
        let command = self.decide(k);
        if let Some(command) = command {
            self.send(&command, at(DECIDES));
        }
        self.run(at(1.0));
        let snr = Snr::from_db(self.air.air().budget(at(DECIDES), Way::Up).snr_db());
        if let Some(command) = command {
            // An older command that has arrived changes nothing in the station's own transmitter.
            self.sim.set_power(command.power);
        }
        self.sim.receive(snr, !self.arrived);
        self.sim.step();
        let nothing = Command::new(k, [0.0; 2], TxPower::Low);
        let after = self.sim.telemetry();
        Ok(Record::new(&before, &command.unwrap_or(nothing), &after, self.sim.scenario()))
    }

    fn decide(&mut self, now: Tick) -> Option<Command> {
        let command = self.station.decide(now);
        let [seen, heard] = self.station.newest();
        let newest = if self.station.sees_frames() { seen } else { heard };
        match newest.filter(|_| command.is_some()) {
            Some(newest) => self.tally.ages.push(now.0.saturating_sub(newest.0) as f64),
            None => self.tally.silent += 1,
        }
        command
    }

    /// The vehicle's report.
    fn report(&mut self, now: Duration) {
        let mut bytes = Vec::new();
        let [autopilot, radio] = &mut self.vehicle;
        let down = -self.sim.scenario().scale.altitude_m as f32;
        wire::push_telemetry(&self.sim.telemetry(), &self.clock, [down, 0.0], autopilot, radio, &mut bytes);
        for packet in Decoder::default().datagram(&bytes) {
            self.offer(packet, now);
        }
    }

    /// The picture of this interval, if that is what is sent and the one before has left.
    fn take_picture(&mut self, now: Duration) -> Result<()> {
        if self.plan.downlink != Downlink::Picture || !self.air.is_free() {
            return Ok(());
        }
        let png = image::png_from_frame(&self.sim.frame(), self.sim.tick())?;
        let autopilot = &mut self.vehicle[0];
        let parts = (0..image::datagram_count(&png)).map(|n| image::datagram(&png, n, autopilot));
        let bytes: Vec<u8> = parts.flatten().collect();
        for packet in Decoder::of_stream().datagram(&bytes) {
            self.air.offer(now, Way::Down, packet.id, packet.raw.len(), AirParcel::Down(packet));
        }
        self.tally.sights[0] += 1;
        Ok(())
    }

    /// The latents of this interval, if that is what is sent.
    fn send_latents(&mut self, now: Duration) -> Result<()> {
        if self.plan.downlink != Downlink::Latent {
            return Ok(());
        }
        let sighting = Sighting::of(&self.world, &self.sim.frame(), self.sim.scenario().obstacles.len());
        let mut bytes = Vec::new();
        let sent = sighting.to_latents(&self.world, self.sim.tick());
        latents::push(&sent, self.plan.latent_bits, &self.clock, &mut self.companion, &mut bytes)?;
        for packet in Decoder::default().datagram(&bytes) {
            self.offer(packet, now);
        }
        self.tally.sights[0] += 1;
        Ok(())
    }

    /// A frame of a report or of latents is handed to the sender.
    fn offer(&mut self, packet: Packet, now: Duration) {
        self.unsent += 1;
        self.air.offer(now, Way::Down, packet.id, packet.raw.len(), AirParcel::Down(packet));
    }

    /// The setpoint goes up; the power is the station's own transmitter's, and crosses nothing.
    fn send(&mut self, command: &Command, now: Duration) {
        air::set_power(self.air.air(), command.power);
        let mut bytes = Vec::new();
        wire::push_setpoint(command.tick, command.accel, &self.clock, 1, &mut self.ground, &mut bytes);
        let kind = SET_POSITION_TARGET_LOCAL_NED_DATA::ID;
        self.air.offer(now, Way::Up, kind, bytes.len(), AirParcel::Up(*command));
    }

    /// Lets the radio work to `end`.
    fn run(&mut self, end: Duration) {
        let mut settled = Vec::new();
        self.air.poll(end, |frame| settled.push(frame));
        settled.into_iter().for_each(|frame| self.settle(frame));
    }

    /// A frame's fate is known.
    fn settle(&mut self, frame: CarriedFrame<AirParcel>) {
        if frame.packets > 0 {
            self.tally.bits[usize::from(frame.way == Way::Up)] += 8 * frame.bytes as u64;
        }
        if frame.way == Way::Down && !is_picture(frame.kind) {
            self.unsent = self.unsent.saturating_sub(1);
        }
        match frame.frame {
            _ if frame.fate != FrameFate::Arrived => {}
            AirParcel::Up(command) => {
                self.arrived |= command.tick == self.sim.tick();
                self.sim.handle(command);
            }
            AirParcel::Down(packet) => self.hear(&packet),
        }
    }

    fn hear(&mut self, packet: &Packet) {
        if let Some(report) = self.reports.push(packet, &self.clock) {
            self.station.hear(&report);
        } else if let Some((tick, frame)) = self.images.push(packet) {
            self.tally.sights[1] += 1;
            if self.station.sees_frames() {
                let obstacles = self.station.scenario().obstacles.len();
                self.station.see(tick, &Sighting::of(&self.world, &frame, obstacles));
            }
        } else if let Some(sent) = latents::of(packet, &self.clock)
            && let Some(sighting) = Sighting::of_latents(&self.world, &sent)
        {
            self.tally.sights[1] += 1;
            self.station.see(sent.tick, &sighting);
        }
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;

    use super::*;
    use crate::lab::{self, Contender};
    use crate::station::models::Models;
    use crate::station::pilot::Controller;

    fn plan(radio: AirRadio, downlink: Downlink) -> AirPlan {
        AirPlan { radio, downlink, latent_bits: 10 }
    }

    /// The first intervals of a flight, with and without a radio for everything.
    fn both(controller: Controller, plan: &AirPlan) -> (Vec<Record>, Vec<Record>, AirTally) {
        const TICKS: u64 = 30;
        let mut scenario = Scenario::named("demo").unwrap();
        scenario.radio.b_dt = 8.0;
        let models = Models::load(None, None).unwrap();
        let contender = Contender::new(&models, controller, &scenario).unwrap();
        let mut sim = Sim::new(scenario.clone(), 3);
        let mut station = contender.station().unwrap();
        let (records, tally) = fly(&mut sim, &mut station, &models.world, plan, TICKS).unwrap();
        let (mut sim, mut station) = (Sim::new(scenario, 3), contender.station().unwrap());
        lab::fly(&mut sim, &mut station, TICKS);
        (records, station.records().to_vec(), tally)
    }

    #[test]
    fn over_a_perfect_radio_a_flight_is_the_one_without_a_radio() {
        for controller in [Controller::Crpl, Controller::Rcc, Controller::Apc] {
            let (air, direct, tally) = both(controller, &plan(AirRadio::default(), Downlink::Picture));
            assert_eq!(air.len(), direct.len());
            for (a, b) in air.iter().zip(&direct) {
                // The SNR is the perfect radio's.
                assert_eq!(Record { snr_db: b.snr_db, ..a.clone() }, *b, "{controller}");
            }
            assert!(tally.ages.iter().all(|age| *age == 0.0) && tally.silent == 0);
            assert_eq!(tally.sights, [30, 30]);
        }
    }

    #[test]
    fn latents_steer_as_pictures_do_in_fewer_bits() {
        let perfect = AirRadio::default();
        let (pictures, _, costly) = both(Controller::Crpl, &plan(perfect.clone(), Downlink::Picture));
        let (latents, _, cheap) = both(Controller::Crpl, &plan(perfect, Downlink::Latent));
        let apart = |k: usize| (pictures[k].r_next - latents[k].r_next).norm();
        assert!((0..30).all(|k| apart(k) < 0.05), "{}", apart(29));
        assert!(cheap.sights == [30, 30] && cheap.bits[0] < costly.bits[0], "{cheap:?} {costly:?}");
    }

    #[test]
    fn late_pictures_are_flown_by_as_what_they_are_and_the_flight_comes_again() {
        let scenario = Scenario::named("demo").unwrap();
        let radio = air::radio("all", &scenario, 2.0).unwrap().unwrap();
        let slow = plan(radio, Downlink::Picture);
        let (first, _, tally) = both(Controller::Crpl, &slow);
        let (again, ..) = both(Controller::Crpl, &slow);
        assert_eq!(first, again);
        assert!(tally.silent >= 2 && tally.sights[0] < 20, "{tally:?}");
        assert!(!tally.ages.is_empty() && tally.ages.iter().all(|age| *age >= 1.0), "{tally:?}");
        // Late, and yet on its way.
        assert!(first.last().unwrap().r_next.x > scenario.start.x + 0.02);
    }
}
