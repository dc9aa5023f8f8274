//! A sender's sequence numbers, from which its receivers learn what got lost: one counter of 8 bits a
//! component and link.

/// The sequence numbers of one component on one link, as they come in.
#[derive(Debug, Clone, Default)]
pub struct Sequence {
    newest: Option<u8>,
    /// Numbers that were passed over and have not come since, one bit each.
    missing: [u64; 4],
}

/// What a sequence number tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SequenceTracker {
    /// Frames missing between the newest one before and this one.
    pub missing: u64,
    /// Whether this one was missing until now: it was overtaken on the way, not lost.
    pub late: bool,
}

impl Sequence {
    /// Takes the number of the next frame. A step of more than half the range is one backwards: a late
    /// frame, or a sender that begins anew.
    pub fn next(&mut self, number: u8) -> SequenceTracker {
        let newest = self.newest.unwrap_or(number.wrapping_sub(1));
        let step = number.wrapping_sub(newest);
        if step == 0 || step > 128 {
            return SequenceTracker { missing: 0, late: self.set(number, false) };
        }
        for passed in 1..step {
            self.set(newest.wrapping_add(passed), true);
        }
        self.set(number, false);
        self.newest = Some(number);
        SequenceTracker { missing: u64::from(step - 1), late: false }
    }

    /// Notes whether a number is missing; gives whether it was.
    fn set(&mut self, number: u8, missing: bool) -> bool {
        let (word, bit) = (&mut self.missing[usize::from(number / 64)], 1 << (number % 64));
        let was = *word & bit != 0;
        *word = if missing { *word | bit } else { *word & !bit };
        was
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Missing and late of all these numbers together.
    fn told(numbers: impl IntoIterator<Item = u8>) -> (u64, u64) {
        let mut sequence = Sequence::default();
        numbers
            .into_iter()
            .map(|number| sequence.next(number))
            .fold((0, 0), |(missing, late), heard| (missing + heard.missing, late + u64::from(heard.late)))
    }

    #[test]
    fn gaps_are_missing_and_what_was_overtaken_is_late() {
        assert_eq!(told([250, 251, 252]), (0, 0), "any number may be the first");
        assert_eq!(told([254, 255, 3]), (3, 0), "numbers come round");
        assert_eq!(told([1, 4, 2, 3, 5]), (2, 2));
        assert_eq!(told([1, 4, 2, 2, 4, 3]), (2, 2), "a second copy fills no second gap");
        assert_eq!(told([100, 0, 1, 2]), (0, 0), "a sender began anew");
    }

    proptest! {
        /// Of frames that overtake each other by a few places and are lost at random, exactly the lost
        /// ones stay missing.
        #[test]
        fn what_is_missing_and_not_late_is_lost(
            kept in proptest::collection::vec((any::<bool>(), 0usize..6), 1..600)
        ) {
            // The first and the last frame frame the rest.
            let count = kept.len();
            let mut order: Vec<(usize, u8)> = vec![(0, 0), (count + 20, (count + 1) as u8)];
            let rest = kept.iter().enumerate().filter(|(_, (kept, _))| *kept);
            order.extend(rest.map(|(k, (_, delay))| (k + 1 + delay, (k + 1) as u8)));
            order.sort_by_key(|&(place, _)| place);
            let lost = kept.iter().filter(|(kept, _)| !kept).count() as u64;
            // More than half the range lost in a row cannot be told from a step backwards.
            prop_assume!(kept.split(|(kept, _)| *kept).all(|gap| gap.len() < 100));
            let (missing, late) = told(order.into_iter().map(|(_, number)| number));
            prop_assert_eq!(missing - late, lost);
        }
    }
}
