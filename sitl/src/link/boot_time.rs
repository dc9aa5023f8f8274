//! `time_boot_ms` of MAVLink: milliseconds that begin at 0 again after 49.7 days.

use std::time::Duration;

/// Stamps that are further apart are no step of a clock: it was set, or began anew. In ms.
const LONGEST_STEP: i64 = 3_600_000;

/// The milliseconds from one stamp to another, below 0 if the second is older; `None` if no clock goes so.
#[must_use]
pub fn step_ms(before: u32, now: u32) -> Option<i64> {
    // The shorter way round.
    let step = i64::from(now.wrapping_sub(before) as i32);
    (step.abs() <= LONGEST_STEP).then_some(step)
}

/// Stamps as a time that goes on when they begin at 0 again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BootTime {
    last: Option<u32>,
    ms: u64,
}

impl BootTime {
    /// The time of a stamp. Where the clock was set or began anew, it is the stamp's own.
    pub fn at(&mut self, stamp: u32) -> Duration {
        let step = self.last.and_then(|last| step_ms(last, stamp));
        self.ms = step.map_or(stamp.into(), |step| self.ms.saturating_add_signed(step));
        self.last = Some(stamp);
        Duration::from_millis(self.ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_when_the_stamps_begin_at_0_again() {
        let mut time = BootTime::default();
        let ms = |ms| Duration::from_millis(ms);
        let all = u64::from(u32::MAX) + 1;
        assert_eq!(time.at(u32::MAX - 399), ms(all - 400));
        assert_eq!(time.at(0), ms(all));
        assert_eq!(time.at(u32::MAX), ms(all - 1), "overtaken on the way");
        assert_eq!(time.at(800), ms(all + 800));
        assert_eq!(time.at(500_000_000), ms(500_000_000), "set");
        assert_eq!(time.at(1000), ms(1000), "begun anew");
    }
}
