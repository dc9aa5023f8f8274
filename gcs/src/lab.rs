//! Flights in process: the same `Sim` and the same `Station` as over UDP, without a link.

pub mod figures;

use sitl::Sim;

use crate::station::Station;

/// Flies `ticks` control intervals, pictures rendered and encoded at each.
pub fn fly(sim: &mut Sim, station: &mut Station, ticks: u64) {
    for _ in 0..ticks {
        let command = station.handle(&sim.percept());
        sim.handle(command);
        sim.advance();
    }
    station.finish(&sim.percept());
}
