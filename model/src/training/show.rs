//! What a training shows while it runs: a bar on the terminal, and progress and curves on a page where one is served.

use crpl_sitl::program::page::feed::{Feed, WatchEvent};
use crpl_sitl::program::progress;
use indicatif::ProgressBar;

/// Parts of a stage at whose ends a page is told how far it is.
const PARTS: u64 = 200;

/// A stage of a training under way.
#[derive(Debug, Clone)]
pub struct StageShow {
    name: &'static str,
    bar: ProgressBar,
    total: u64,
    feed: Option<Feed>,
}

impl StageShow {
    /// A stage of `steps`; `feed` is where others watch.
    #[must_use]
    pub fn begin(name: &'static str, steps: usize, feed: Option<&Feed>) -> Self {
        let total = steps as u64;
        let stage = Self { name, bar: progress::bar(name, total), total, feed: feed.cloned() };
        stage.send(0);
        stage
    }

    /// One that nobody sees.
    #[must_use]
    pub fn hidden() -> Self {
        Self { name: "", bar: ProgressBar::hidden(), total: 0, feed: None }
    }

    /// So many more steps are done.
    pub fn add(&self, steps: u64) {
        let before = self.bar.position();
        self.bar.inc(steps);
        self.tell(before, before + steps);
    }

    /// So many steps are done.
    pub fn at(&self, step: usize) {
        let before = self.bar.position();
        self.bar.set_position(step as u64);
        self.tell(before, step as u64);
    }

    /// Tells the page, if a part has ended.
    fn tell(&self, before: u64, done: u64) {
        let part = |steps: u64| steps * PARTS / self.total.max(1);
        if part(before) != part(done) {
            self.send(done);
        }
    }

    fn send(&self, done: u64) {
        if let Some(feed) = &self.feed {
            feed.send(&WatchEvent::Progress { done, total: self.total, text: self.name.into() });
        }
    }

    /// What was measured by `step`: in words for the terminal, and as a point of each named curve.
    pub fn report(&self, step: usize, words: String, numbers: &[(&str, f64)]) {
        tracing::debug!(step, "{words}");
        self.bar.set_message(words);
        numbers.iter().for_each(|(what, value)| self.curve(what, step, *value));
    }

    /// A point of a curve.
    pub fn curve(&self, what: &str, step: usize, value: f64) {
        if let Some(feed) = &self.feed {
            let name = format!("{}: {what}", self.name);
            feed.send(&WatchEvent::Curve { name, x: step as f64, y: value });
        }
    }

    /// It is over.
    pub fn finish(&self) {
        self.bar.finish();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_told_of_parts_and_of_every_point() {
        let feed = Feed::default();
        let shown = StageShow { total: 1000, name: "encoder", ..StageShow::hidden() };
        let shown = StageShow { feed: Some(feed.clone()), ..shown };
        (1..=1000).for_each(|step| shown.at(step));
        shown.report(1000, "loss 2".into(), &[("loss", 2.0)]);
        let lines: Vec<_> = feed.all().iter().map(|line| line.text.to_string()).collect();
        let progress = lines.iter().filter(|line| line.contains("\"progress\"")).count();
        assert_eq!(progress as u64, PARTS);
        assert_eq!(lines[lines.len() - 1], r#"{"kind":"curve","name":"encoder: loss","x":1000.0,"y":2.0}"#);
    }
}
