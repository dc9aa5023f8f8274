//! What was flown in each interval, as far as the station knows: from the vehicle's reports, and after the newest of
//! them from what was sent.

use std::collections::BTreeMap;

use crpl_sitl::radio::message::{Command, Held};
use crpl_sitl::units::Tick;

use super::seen::Heard;

/// Reports and commands that are remembered: more than any window of the observer.
const KEPT: usize = 256;

/// Reports by tick, and commands by tick.
#[derive(Debug, Clone, Default)]
pub struct ActionLog {
    reports: BTreeMap<Tick, Heard>,
    sent: BTreeMap<Tick, Held>,
}

impl ActionLog {
    /// A report has come.
    pub fn add(&mut self, heard: Heard) {
        self.reports.insert(heard.tick, heard);
        while self.reports.len() > KEPT {
            self.reports.pop_first();
        }
    }

    /// A command goes out.
    pub fn send(&mut self, command: &Command) {
        self.sent.insert(command.tick, Held { tick: command.tick, accel: command.accel });
        while self.sent.len() > KEPT {
            self.sent.pop_first();
        }
    }

    /// The newest report.
    #[must_use]
    pub fn newest(&self) -> Option<&Heard> {
        self.reports.last_key_value().map(|(_, heard)| heard)
    }

    /// What the vehicle says it flew in an interval: what the next report tells, if that command was there already,
    /// else what it held before. A command is flown from its own tick on.
    #[must_use]
    pub fn flown(&self, interval: Tick) -> Option<Held> {
        let after = self.reports.range(interval.next()..).next();
        let after = after.and_then(|(_, heard)| heard.held).filter(|held| held.tick <= interval);
        let before = || self.reports.range(..=interval).next_back().and_then(|(_, heard)| heard.held);
        after.or_else(before)
    }

    /// What it flew, or flies if the radio goes on as the newest report tells: in an outage what it held there, else
    /// what was sent, as late as then.
    #[must_use]
    pub fn expected(&self, interval: Tick) -> Option<Held> {
        let sent = |tick: Tick| self.sent.range(..=tick).next_back().map(|(_, held)| *held);
        let Some(newest) = self.newest() else { return sent(interval) };
        if interval < newest.tick {
            return self.flown(interval);
        }
        match newest.held {
            Some(held) if newest.link.is_some_and(|link| link.outage) => Some(held),
            Some(held) => {
                let late = newest.tick.0.saturating_sub(held.tick.0 + 1);
                sent(Tick(interval.0.saturating_sub(late))).or(Some(held))
            }
            None => sent(interval),
        }
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::radio::message::LinkReport;
    use crpl_sitl::units::TxPower;

    use super::*;

    fn log(reports: &[(u64, Option<u64>, bool)], sent: u64) -> ActionLog {
        let mut log = ActionLog::default();
        (0..sent).for_each(|k| log.send(&Command::new(Tick(k), [k as f32, 0.0], TxPower::Low)));
        for (tick, held, outage) in reports {
            log.add(Heard {
                tick: Tick(*tick),
                held: held.map(|k| Held { tick: Tick(k), accel: [k as f32, 0.0] }),
                link: Some(LinkReport { snr_db: 0.0, power: TxPower::Low, outage: *outage }),
            });
        }
        log
    }

    fn ticks(log: &ActionLog, intervals: std::ops::Range<u64>) -> Vec<Option<u64>> {
        intervals.map(|k| log.expected(Tick(k)).map(|held| held.tick.0)).collect()
    }

    #[test]
    fn what_was_reported_counts_and_then_what_was_sent() {
        let log = log(&[(1, Some(0), false), (2, Some(0), true), (4, Some(3), false)], 7);
        // Of interval 2 nothing was heard: the command of 3 was not there yet.
        assert_eq!(ticks(&log, 0..7), [0, 0, 0, 3, 4, 5, 6].map(Some));
    }

    #[test]
    fn an_outage_goes_on_and_so_does_a_delay() {
        let held = log(&[(5, Some(2), true)], 9);
        assert_eq!(ticks(&held, 5..8), [2; 3].map(Some));
        let late = log(&[(5, Some(2), false)], 9);
        assert_eq!(ticks(&late, 5..8), [3, 4, 5].map(Some));
        assert_eq!(ticks(&log(&[], 0), 0..2), [None; 2]);
    }
}
