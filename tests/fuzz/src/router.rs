//! A router with links of all kinds, some of which come and go.

use std::time::Duration;

use crpl_gcs::tools::bridge::router::rules::LinkRules;
use crpl_gcs::tools::bridge::router::{LinkId, Router};

use crate::bytes::{Choices, frame};

/// Messages that the router treats by their id, and some that it does not.
const IDS: [u32; 16] = [0, 4, 11, 22, 30, 69, 70, 75, 76, 77, 82, 84, 86, 111, 256, 300];

/// Each a byte and what it asks for: a frame, bytes, time, a link that goes and comes back.
pub fn router(data: &[u8]) {
    let mut choices = Choices::new(data);
    let how = choices.byte();
    let mut router = Router::salted(u64::from(how));
    let group = (how & 1 != 0).then(|| "both".to_owned());
    let rate = (how & 2 != 0).then_some(500.0);
    let rules = LinkRules { group, rate, drop: vec![30], ..LinkRules::default() };
    let mut links: Vec<LinkId> = (0..2).map(|k| router.add_with(format!("air {k}"), rules.clone())).collect();
    links.extend((0..3).map(|k| router.add(format!("tool {k}"))));
    if how & 4 != 0 {
        router.take_control(Some((1, links[2])));
    }
    let (mut now, mut received, mut sent) = (Duration::ZERO, 0, 0);
    while !choices.is_empty() {
        let what = choices.byte();
        let place = usize::from(what >> 5) % links.len();
        let from = links[place];
        match what & 7 {
            0..=4 => {
                let (id, number) = (IDS[usize::from(choices.byte()) % IDS.len()], choices.byte());
                let source = (choices.byte() % 4, choices.byte() % 3);
                let length = usize::from(choices.byte());
                received += 1;
                router.receive(from, &frame(number, source, id, choices.some(length)), now, |_| {});
            }
            5 => {
                let length = usize::from(choices.byte());
                let bytes = choices.some(length);
                received += bytes.len() / 8;
                router.receive(from, bytes, now, |_| {});
            }
            6 => now += Duration::from_millis(u64::from(choices.short())),
            _ => {
                router.remove(from);
                links[place] = router.add(format!("tool {place}"));
            }
        }
        router.flush(|_, datagram| {
            sent += datagram.iter().filter(|&&byte| byte == 0xFD).count().min(1);
            true
        });
        let _ = router.notices();
    }
    // No frame goes anywhere more than once.
    assert!(sent <= (received + 1) * links.len(), "{received} received, {sent} sent");
}
