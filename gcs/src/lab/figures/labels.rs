//! Where words stand in the picture of a flight: beside what they name, and over nothing else.

use crpl_model::evaluation::chart::{self, Note};
use crpl_sitl::Scenario;
use crpl_sitl::sim::record::Record;
use nalgebra::Vector2;

/// Directions in which words may stand.
const DIRECTIONS: usize = 16;
/// From words to what they must not cover, where a tick is numbered.
const CLEAR: f64 = 0.004;

/// Words that have a place, and what must not be covered.
pub struct Labels {
    /// The words so far.
    pub notes: Vec<Note>,
    taken: Vec<Vector2<f64>>,
    /// Width of a letter and height of a line, in field widths.
    letter: (f64, f64),
}

impl Labels {
    /// No words yet.
    pub fn new(path: &[Vector2<f64>], records: &[Record], scenario: &Scenario, panel: bool) -> Self {
        let mut taken: Vec<Vector2<f64>> = path.to_vec();
        taken.extend(path.windows(2).map(|pair| (pair[0] + pair[1]) / 2.0));
        taken.push(scenario.channel.base_station);
        taken.push(scenario.goal);
        let last = records.last().map(|r| r.obstacles);
        for (n, obstacle) in scenario.obstacles.iter().enumerate() {
            let centre = last.and_then(|all| all.get(n).copied()).unwrap_or(obstacle.position);
            let rim = (0..24).map(|n| f64::from(n) / 24.0 * std::f64::consts::TAU);
            taken.extend(rim.flat_map(|a| {
                [0.5, 1.0].map(|s| centre + Vector2::new(a.cos(), a.sin()) * (s * obstacle.radius))
            }));
        }
        Self { notes: Vec::new(), taken, letter: chart::letter_share(panel) }
    }

    /// Puts words beside a thing of this radius, where there is most room.
    pub fn put(&mut self, text: &str, at: Vector2<f64>, radius: f64) {
        if let Some((middle, _)) = self.best(text, at, radius) {
            self.say(text, middle);
        }
    }

    /// Puts words beside a place, or nowhere if they would cover something.
    pub fn put_if_free(&mut self, text: &str, at: Vector2<f64>) {
        if let Some((middle, _)) = self.best(text, at, 0.006).filter(|(_, room)| *room > CLEAR) {
            self.say(text, middle);
        }
    }

    /// Half the width and half the height of words.
    fn half(&self, text: &str) -> Vector2<f64> {
        Vector2::new(self.letter.0 * text.chars().count() as f64, self.letter.1) / 2.0
    }

    /// The middle of the words with most room around them, and how much there is: at most enough.
    fn best(&self, text: &str, at: Vector2<f64>, radius: f64) -> Option<(Vector2<f64>, f64)> {
        let half = self.half(text);
        let places = (0..DIRECTIONS).map(|n| {
            let angle = n as f64 / DIRECTIONS as f64 * std::f64::consts::TAU;
            let way = Vector2::new(angle.cos(), angle.sin());
            at + way * (radius + 0.012) + way.component_mul(&half)
        });
        let inside = places.filter(|m| (0..2).all(|i| m[i] - half[i] > 0.01 && m[i] + half[i] < 0.99));
        let measured = inside.map(|middle| (middle, self.room(middle, half).min(0.02)));
        measured.fold(None, |best: Option<(Vector2<f64>, f64)>, next| match best {
            Some(best) if best.1 >= next.1 => Some(best),
            _ => Some(next),
        })
    }

    /// From the edge of words to the nearest thing that is taken; negative if they cover it.
    fn room(&self, middle: Vector2<f64>, half: Vector2<f64>) -> f64 {
        let outside = |r: &Vector2<f64>| {
            let away = (r - middle).abs() - half;
            if away.x < 0.0 && away.y < 0.0 { away.x.max(away.y) } else { away.map(|x| x.max(0.0)).norm() }
        };
        self.taken.iter().map(outside).fold(f64::INFINITY, f64::min)
    }

    fn say(&mut self, text: &str, middle: Vector2<f64>) {
        let half = self.half(text);
        for x in [-1.0, -0.5, 0.0, 0.5, 1.0] {
            self.taken.extend([-1.0, 0.0, 1.0].map(|y| middle + half.component_mul(&Vector2::new(x, y))));
        }
        self.notes.push(Note { text: text.into(), at: (middle.x, middle.y) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First use, F1: "goal" was written over the path.
    #[test]
    fn words_cover_neither_the_path_nor_each_other() {
        let scenario = Scenario::default();
        let path: Vec<Vector2<f64>> = (0..=50)
            .map(|n| scenario.start + (scenario.goal - scenario.start) * (f64::from(n) / 50.0))
            .collect();
        let mut labels = Labels::new(&path, &[], &scenario, false);
        labels.put("goal", scenario.goal, scenario.goal_radius);
        labels.put("start", scenario.start, 0.01);
        for (k, at) in path.iter().enumerate().step_by(10).skip(1) {
            labels.put_if_free(&format!("k = {k}"), *at);
        }
        assert!(labels.notes.len() > 4, "{:?}", labels.notes);
        let boxes: Vec<(Vector2<f64>, Vector2<f64>)> = labels
            .notes
            .iter()
            .map(|note| (Vector2::new(note.at.0, note.at.1), labels.half(&note.text)))
            .collect();
        for (n, (middle, half)) in boxes.iter().enumerate() {
            for r in &path {
                let away = (r - middle).abs() - half;
                assert!(away.x > 0.0 || away.y > 0.0, "{} covers the path", labels.notes[n].text);
            }
            for (m, (other, its)) in boxes.iter().enumerate().filter(|(m, _)| *m != n) {
                let away = (other - middle).abs() - half - its;
                assert!(away.x > -1e-9 || away.y > -1e-9, "{n} {m}");
            }
        }
    }
}
