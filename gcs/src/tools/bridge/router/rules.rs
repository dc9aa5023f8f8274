//! What a link takes and passes on beyond the router's own rules: its group, filters by message, and its rate.

use std::time::Duration;

use crpl_sitl::link::packet::PacketRef;

/// How long a link may send beyond its rate: this much is sent at once after a pause, and this much of
/// heartbeats and of messages with a target may be sent on credit.
const BURST: Duration = Duration::from_secs(1);
/// A rate allows one frame of any length at a time.
const LONGEST: f64 = 280.0;
const HEARTBEAT: u32 = 0;

/// What is asked of a link. The default asks nothing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinkRules {
    /// Links of one group are several ways to the same peers: what was heard on one counts as heard on all,
    /// and nothing goes from one to another.
    pub group: Option<String>,
    /// Messages that are sent to it; empty: all.
    pub only: Vec<u32>,
    /// Messages that are not sent to it.
    pub drop: Vec<u32>,
    /// Messages that are accepted from it; empty: all.
    pub only_from: Vec<u32>,
    /// Messages that are not accepted from it.
    pub drop_from: Vec<u32>,
    /// Bytes a second that are sent to it. Heartbeats and messages with a target go first.
    pub rate: Option<f64>,
    /// Whether its receivers count losses by sequence numbers: a frame that goes elsewhere then leaves no gap
    /// (`numbers.rs`).
    pub renumber: bool,
}

impl LinkRules {
    /// Whether a message may be sent to the link.
    #[must_use]
    pub fn sends(&self, id: u32) -> bool {
        allows(&self.only, &self.drop, id)
    }

    /// Whether a message is accepted from the link.
    #[must_use]
    pub fn accepts(&self, id: u32) -> bool {
        allows(&self.only_from, &self.drop_from, id)
    }

    /// Whether both are of one group.
    #[must_use]
    pub fn joins(&self, other: &Self) -> bool {
        self.group.is_some() && self.group == other.group
    }
}

fn allows(only: &[u32], drop: &[u32], id: u32) -> bool {
    (only.is_empty() || only.contains(&id)) && !drop.contains(&id)
}

/// What a link may still send, bytes; negative while it is in debt.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Budget {
    left: f64,
    at: Option<Duration>,
}

impl Budget {
    /// Whether a frame may go at `rate` bytes a second, which it then has.
    pub fn takes(&mut self, rate: f64, frame: &PacketRef<'_>, now: Duration) -> bool {
        let burst = (rate * BURST.as_secs_f64()).max(LONGEST);
        let passed = self.at.map_or(BURST, |at| now.saturating_sub(at));
        self.at = Some(now);
        self.left = (self.left + rate * passed.as_secs_f64()).min(burst);
        let first = frame.id == HEARTBEAT || frame.target().system != 0;
        let length = frame.raw.len() as f64;
        let floor = if first { -burst } else { 0.0 };
        let takes = self.left - length >= floor;
        if takes {
            self.left -= length;
        }
        takes
    }
}
