//! The steps of a plan until their command comes. They may come in any number of reads: each names its
//! tick and its place, so neither datagrams nor the cuts of a stream mean anything.

use crate::link::PeerId;
use crate::link::wire::Step;
use crate::msg::Plan;
use crate::units::Tick;

/// The plan that is coming in.
#[derive(Debug, Default)]
pub(super) struct Steps {
    /// From whom, the first step's tick, and the plan's length.
    of: Option<(PeerId, Tick, u8)>,
    plan: Plan,
}

impl Steps {
    /// A step for interval `tick`. One that does not follow its predecessor ends the plan.
    pub fn add(&mut self, from: PeerId, tick: Tick, step: Step, accel: [f32; 2]) {
        let first = tick.0.checked_sub(u64::from(step.place) - 1).map(|first| (from, Tick(first), step.of));
        if step.place == 1 {
            (self.of, self.plan) = (first, Plan::default());
        }
        let follows = self.plan.accelerations().len() + 1 == usize::from(step.place);
        if first.is_some() && self.of == first && follows {
            self.plan.push(accel);
        } else {
            self.of = None;
        }
    }

    /// The whole plan behind a command for interval `tick`; one with a gap is none.
    pub fn take(&mut self, from: PeerId, tick: Tick) -> Option<Plan> {
        let (peer, first, length) = self.of.take()?;
        let whole = self.plan.accelerations().len() == usize::from(length);
        (peer == from && first == tick.next() && whole).then_some(self.plan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(port: u16) -> PeerId {
        std::net::SocketAddr::from(([127, 0, 0, 1], port)).into()
    }

    /// The plan of a command for tick 4, after steps `(tick, place, of)`.
    fn planned(steps: &[(u64, u8, u8)]) -> Option<usize> {
        let mut all = Steps::default();
        steps
            .iter()
            .for_each(|&(tick, place, of)| all.add(peer(1), Tick(tick), Step { place, of }, [1.0, 0.0]));
        all.take(peer(1), Tick(4)).map(|plan| plan.accelerations().len())
    }

    #[test]
    fn a_plan_is_whole_or_none() {
        assert_eq!(planned(&[(5, 1, 2), (6, 2, 2)]), Some(2));
        assert_eq!(planned(&[(9, 1, 3), (5, 1, 2), (6, 2, 2)]), Some(2), "a newer one begins anew");
        for gap in [
            &[][..],
            &[(5, 1, 2)],
            &[(6, 2, 2)],
            &[(5, 1, 3), (7, 3, 3)],
            &[(5, 1, 2), (7, 2, 2)],
            &[(5, 1, 3), (6, 2, 2)],
            &[(6, 1, 1)],
            &[(0, 2, 2)],
        ] {
            assert_eq!(planned(gap), None, "{gap:?}");
        }
    }

    #[test]
    fn a_plan_is_its_sender_s_and_serves_once() {
        let mut steps = Steps::default();
        steps.add(peer(1), Tick(5), Step { place: 1, of: 1 }, [1.0, 0.0]);
        assert_eq!(steps.take(peer(2), Tick(4)), None);
        steps.add(peer(1), Tick(5), Step { place: 1, of: 1 }, [1.0, 0.0]);
        assert!(steps.take(peer(1), Tick(4)).is_some());
        assert_eq!(steps.take(peer(1), Tick(4)), None);
    }
}
