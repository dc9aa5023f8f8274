//! An obstacle's speed from its last frames: latents in, latents per interval out.

use crpl_sitl::units::Tick;

/// Frames from which the speed is read.
const WINDOW: usize = 8;

/// A step against the former speed, this large beside it, is a turn and no noise of the encoder.
const TURN: f32 = 0.9;

/// Where the obstacle was, oldest first.
#[derive(Debug, Clone, Default)]
pub struct Track(Vec<(Tick, [f32; 2])>);

impl Track {
    /// Adds the newest place; after a turn, what came before it says nothing more.
    pub fn follow(&mut self, tick: Tick, y_u: [f32; 2]) {
        if let ([.., (t1, b), (t2, c)], speed) = (self.0.as_slice(), self.speed())
            && t2 > t1
        {
            let gap = (tick.0 - t2.0) as f32;
            let moved: [f32; 2] = std::array::from_fn(|i| y_u[i] - c[i]);
            let turned = (0..2).any(|i| {
                let (was, is) = (gap * speed[i], moved[i]);
                was * is < 0.0 && (was - is).abs() > TURN * (was.abs() + (c[i] - b[i]).abs())
            });
            if turned {
                self.0.drain(..self.0.len() - 1);
            }
        }
        self.0.push((tick, y_u));
        if self.0.len() > WINDOW {
            self.0.remove(0);
        }
    }

    /// Least-squares slope per interval; zero of fewer than two places.
    #[must_use]
    pub fn speed(&self) -> [f32; 2] {
        let n = self.0.len() as f32;
        let mean_t = self.0.iter().map(|(t, _)| t.0 as f32).sum::<f32>() / n;
        let spread: f32 = self.0.iter().map(|(t, _)| (t.0 as f32 - mean_t).powi(2)).sum();
        if self.0.len() < 2 || spread == 0.0 {
            return [0.0; 2];
        }
        std::array::from_fn(|i| {
            let mean_y = self.0.iter().map(|(_, y)| y[i]).sum::<f32>() / n;
            self.0.iter().map(|(t, y)| (t.0 as f32 - mean_t) * (y[i] - mean_y)).sum::<f32>() / spread
        })
    }

    /// The newest place and the one an interval before it, as the speed has it.
    #[must_use]
    pub fn last_two(&self, y_u: [f32; 2]) -> [[f32; 2]; 2] {
        let speed = self.speed();
        [y_u, std::array::from_fn(|i| y_u[i] - speed[i])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(k: u64) -> f32 {
        0.002 * ((k * 7) as f32).sin()
    }

    #[test]
    fn the_speed_is_told_through_noise_and_gaps() {
        let mut track = Track::default();
        for k in [0u64, 1, 2, 4, 5, 8, 9] {
            track.follow(Tick(k), [0.05 * k as f32 + noise(k), -0.1 * k as f32 + noise(k + 3)]);
        }
        let [x, y] = track.speed();
        assert!((x - 0.05).abs() < 1e-3 && (y + 0.1).abs() < 1e-3, "{x} {y}");
        let [now, before] = track.last_two([1.0, 1.0]);
        assert_eq!(now, [1.0, 1.0]);
        assert!((before[0] - 0.95).abs() < 1e-3 && (before[1] - 1.1).abs() < 1e-3);
    }

    #[test]
    fn after_a_bounce_the_old_speed_is_forgotten() {
        let mut track = Track::default();
        let place = |k: u64| 0.125 * if k < 10 { k as f32 } else { 19.5 - k as f32 };
        (0..14).for_each(|k| track.follow(Tick(k), [place(k) + noise(k), 0.0]));
        assert!((track.speed()[0] + 0.125).abs() < 0.01, "{:?}", track.speed());
        assert_eq!(Track::default().speed(), [0.0; 2]);
    }
}
