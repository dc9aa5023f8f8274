//! A record as the report that the vehicle gave.

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::{Held, LinkReport, Telemetry};
use crpl_sitl::sim::record::Record;

/// What the vehicle reported at the end of an interval.
#[must_use]
pub fn report(record: &Record, scenario: &Scenario) -> Telemetry {
    let (scale, a_max) = (&scenario.scale, scenario.dynamics.a_max);
    let accel = scale.ned_from_paper_acceleration(record.flown * a_max);
    Telemetry {
        tick: record.tick.next(),
        position: scale.ned_from_paper(record.r_next),
        velocity: scale.ned_from_paper_velocity(record.v_next),
        obstacles: record.obstacles.iter().map(|place| scale.ned_from_paper(*place)).collect(),
        held: record.flown_tick.map(|tick| Held { tick, accel }),
        link: Some(LinkReport { snr_db: record.snr_db, power: record.power, outage: record.outage }),
    }
}
