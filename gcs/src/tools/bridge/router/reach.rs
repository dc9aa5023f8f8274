//! To which links a frame goes, by its target and by where its sender lives.

use std::time::Duration;

use crpl_sitl::link::messages::Target;
use crpl_sitl::link::packet::PacketRef;

use super::link::Link;
use super::{LinkId, Router, history};

/// How far a message goes.
#[derive(Debug, Clone, Copy)]
enum Reach {
    All,
    System,
    Component,
}

impl Router {
    /// The links to which a frame goes.
    pub(super) fn targets(&self, from: LinkId, frame: &PacketRef<'_>, now: Duration) -> Vec<LinkId> {
        let source = (frame.system, frame.component);
        let Target { system, component } = frame.target();
        let reach = if system == 0 { Reach::All } else { self.reach(system, component) };
        let wanted = |link: &Link| match reach {
            Reach::All => true,
            Reach::System => link.sources.keys().any(|&(s, _)| s == system),
            Reach::Component => link.sources.contains_key(&(system, component)),
        };
        let rules = self.links.get(&from).map(|link| &link.rules);
        let goes = |link: &Link| {
            if rules.is_some_and(|rules| rules.joins(&link.rules)) {
                return false;
            }
            let one_of = |holds: &dyn Fn(&Link) -> bool| {
                let mut joined = self.links.values().filter(|l| l.rules.joins(&link.rules));
                holds(link) || link.rules.group.is_some() && joined.any(holds)
            };
            one_of(&wanted) && !one_of(&|l| l.is_home_of(source, now))
        };
        self.links.iter().filter(|&(&id, link)| id != from && goes(link)).map(|(&id, _)| id).collect()
    }

    /// Every other frame goes to no link on which its sender may live, as long as it goes anywhere.
    pub(super) fn withhold(&mut self, targets: &mut Vec<LinkId>, frame: &PacketRef<'_>) {
        let source = (frame.system, frame.component);
        let certain = |id: &LinkId| self.links.get(id).is_some_and(|link| !link.is_doubted(source));
        if !targets.iter().all(certain)
            && targets.iter().any(certain)
            && (self.is_fresh_doubt(targets, source) || history::fingerprint(self.salt, frame.raw) & 1 == 1)
        {
            targets.retain(certain);
            let doubts = self.links.values_mut().filter_map(|link| link.doubts.get_mut(&source));
            doubts.for_each(|doubt| doubt.withheld = doubt.withheld.saturating_add(1));
        }
    }

    /// Whether one of these links is in doubt of late: the next frame is withheld at once.
    fn is_fresh_doubt(&self, targets: &[LinkId], source: (u8, u8)) -> bool {
        let mut doubts = targets.iter().filter_map(|id| self.links.get(id)?.doubts.get(&source));
        doubts.any(|doubt| doubt.withheld == 0)
    }

    fn reach(&self, system: u8, component: u8) -> Reach {
        let known =
            component != 0 && self.links.values().any(|link| link.sources.contains_key(&(system, component)));
        if known { Reach::Component } else { Reach::System }
    }
}
