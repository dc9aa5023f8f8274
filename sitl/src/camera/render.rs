//! Draws the clean frame: black background, a blue obstacle and a red UAV drawn over it. A
//! second obstacle is green, and where two overlap both colours show. A third and further ones are
//! blue too: [`COLOURS`](super::COLOURS) obstacles are as many as a frame tells apart.
//!
//! Discs have a soft rim and are area-preserving: the sum of a disc's coverage does not depend on
//! where it falls between the pixels, so its centre of mass is exact. Row = paper y, column = paper
//! x. A disc that the frame's edge cuts loses the part outside and keeps the rest as it was.

use nalgebra::Vector2;

use super::frame::{CHANNELS, Frame, OBSTACLE_CHANNELS, RED, SIDE};
use crate::units::Obstacles;

/// What the camera has to know of a scene besides positions.
pub trait Sizes {
    /// R_u, units.
    fn uav_radius(&self) -> f64;
    /// R_o of each obstacle, units.
    fn obstacle_radii(&self) -> impl Iterator<Item = f64>;
    /// w, width of a disc's soft rim, px.
    fn edge_px(&self) -> f64;
}

impl Frame {
    /// Puts a disc's coverage into one channel, where `visible` of it is seen. Of two discs in one
    /// channel the larger coverage shows.
    fn paint(&mut self, channel: usize, disc: &Disc, visible: impl Fn(i64, i64) -> f64) {
        let (columns, rows) = disc.window();
        for y in rows {
            for x in columns.clone() {
                let c = disc.at(x, y) * visible(x, y);
                let byte = &mut self.bytes[(y as usize * SIDE + x as usize) * CHANNELS + channel];
                *byte = (*byte).max((c * 255.0).round() as u8);
            }
        }
    }
}

/// A disc's coverage on the pixels around its centre, the part outside the frame left out.
pub(super) struct Disc {
    left: i64,
    top: i64,
    side: usize,
    coverage: Vec<f64>,
}

impl Disc {
    /// Coverage c = clamp((R - |pixel - p|)/w + ½, 0, 1), scaled so that the whole disc sums to
    /// π(R² + w²/12), and clamped at 1. `centre` in paper units, `radius_px` and `edge_px` in px.
    pub fn new(centre: Vector2<f64>, radius_px: f64, edge_px: f64) -> Self {
        let p = centre * SIDE as f64;
        let reach = (radius_px + edge_px / 2.0).ceil() as i64 + 1;
        let (column, row) = (p.x.floor() as i64, p.y.floor() as i64);
        let side = (2 * reach + 1) as usize;
        let (left, top) = (column - reach, row - reach);
        let mut coverage = vec![0.0; side * side];
        let mut sum = 0.0;
        for (j, line) in coverage.chunks_exact_mut(side).enumerate() {
            let dy = (top + j as i64) as f64 + 0.5 - p.y;
            for (i, c) in line.iter_mut().enumerate() {
                let dx = (left + i as i64) as f64 + 0.5 - p.x;
                *c = ((radius_px - (dx * dx + dy * dy).sqrt()) / edge_px + 0.5).clamp(0.0, 1.0);
                sum += *c;
            }
        }
        let area = std::f64::consts::PI * (radius_px * radius_px + edge_px * edge_px / 12.0);
        // A disc so small that it falls between the pixel centres leaves nothing to scale.
        let scale = if sum > 0.0 { area / sum } else { 0.0 };
        for c in &mut coverage {
            *c = (*c * scale).min(1.0);
        }
        Self { left, top, side, coverage }
    }

    /// Coverage at column `x`, row `y` of the frame.
    fn at(&self, x: i64, y: i64) -> f64 {
        let (i, j) = (x - self.left, y - self.top);
        let inside = 0..self.side as i64;
        if inside.contains(&i) && inside.contains(&j) {
            self.coverage[j as usize * self.side + i as usize]
        } else {
            0.0
        }
    }

    /// Coverage at these columns of row `y`, all inside the disc's window.
    pub fn row(&self, y: i64, columns: std::ops::Range<i64>) -> &[f64] {
        let line = (y - self.top) as usize * self.side;
        let [from, to] = [columns.start, columns.end].map(|x| line + (x - self.left) as usize);
        &self.coverage[from..to]
    }

    /// Columns and rows of the frame that the disc may touch.
    pub fn window(&self) -> (std::ops::Range<i64>, std::ops::Range<i64>) {
        let clip = |low: i64| low.max(0)..(low + self.side as i64).min(SIDE as i64);
        (clip(self.left), clip(self.top))
    }
}

/// Draws UAV and obstacle at these paper positions.
#[must_use]
pub fn render(uav: Vector2<f64>, obstacle: Vector2<f64>, sizes: &impl Sizes) -> Frame {
    render_all(uav, &Obstacles::from([obstacle]), sizes)
}

/// Draws UAV and all obstacles at these paper positions.
#[must_use]
pub fn render_all(uav: Vector2<f64>, obstacles: &Obstacles, sizes: &impl Sizes) -> Frame {
    let px = SIDE as f64;
    let edge = sizes.edge_px();
    let red = Disc::new(uav, sizes.uav_radius() * px, edge);
    let mut frame = Frame::black();
    for (n, (centre, radius)) in obstacles.iter().copied().zip(sizes.obstacle_radii()).enumerate() {
        let disc = Disc::new(centre, radius * px, edge);
        let channel = OBSTACLE_CHANNELS.get(n).copied().unwrap_or(OBSTACLE_CHANNELS[0]);
        frame.paint(channel, &disc, |x, y| 1.0 - red.at(x, y));
    }
    frame.paint(RED, &red, |_, _| 1.0);
    frame
}

#[cfg(test)]
mod tests {
    use crate::Scenario;

    use super::*;

    /// Sum and centre of mass (px) of one channel.
    fn moments(frame: &Frame, channel: usize) -> (f64, f64, f64) {
        let (mut m, mut mx, mut my) = (0.0, 0.0, 0.0);
        for y in 0..SIDE {
            for x in 0..SIDE {
                let c = f64::from(frame.pixel(x, y)[channel]) / 255.0;
                m += c;
                mx += c * (x as f64 + 0.5);
                my += c * (y as f64 + 0.5);
            }
        }
        (m, mx / m, my / m)
    }

    #[test]
    fn area_and_centre_do_not_depend_on_the_place_between_pixels() {
        let scenario = Scenario::default();
        let area = std::f64::consts::PI * (4.0 + 16.0 / 12.0);
        for k in 0..50 {
            let r = Vector2::new(0.30 + 0.000_37 * f64::from(k), 0.61 - 0.000_53 * f64::from(k));
            let frame = render(r, Vector2::new(0.8, 0.8), &scenario);
            let (m, x, y) = moments(&frame, 0);
            assert!((m / area - 1.0).abs() < 4e-3, "area {m} at {r}");
            assert!(
                (x - 100.0 * r.x).abs() < 0.05 && (y - 100.0 * r.y).abs() < 0.05,
                "centre {x} {y} at {r}"
            );
        }
    }

    #[test]
    fn the_edge_cuts_a_disc_and_changes_nothing_else() {
        let scenario = Scenario::default();
        let whole = render(Vector2::new(0.5, 0.2), Vector2::new(0.8, 0.8), &scenario);
        let cut = render(Vector2::new(1.0, 0.2), Vector2::new(0.8, 0.8), &scenario);
        for y in 0..SIDE {
            for x in 90..SIDE {
                assert_eq!(cut.pixel(x, y)[0], whole.pixel(x - 50, y)[0], "column {x}, row {y}");
            }
        }
    }

    #[test]
    fn a_disc_between_the_pixels_is_invisible() {
        let mut scenario = Scenario { uav_radius: 1e-4, ..Scenario::default() };
        scenario.camera.edge_px = 1e-3;
        let frame = render(Vector2::new(0.5, 0.2), Vector2::new(0.8, 0.8), &scenario);
        assert!(frame.rgb().chunks_exact(CHANNELS).all(|pixel| pixel[0] == 0));
    }

    #[test]
    fn each_of_two_obstacles_is_seen_as_if_it_were_alone() {
        let text = "[[obstacle]]\n[[obstacle]]\nposition = [0.5, 0.55]\n";
        let scenario = Scenario::from_toml(text).unwrap();
        let uav = Vector2::new(0.44, 0.5);
        let [first, second] = [0, 1].map(|n: usize| scenario.obstacles[n].position);
        let both = render_all(uav, &Obstacles::from([first, second]), &scenario);
        // They overlap between their centres, and both colours show.
        assert_eq!(both.pixel(52, 50), [0, 255, 255]);
        let alone = [first, second].map(|centre| render(uav, centre, &scenario));
        assert_eq!(both.one_obstacle_each(), alone);
    }

    #[test]
    fn the_uav_is_drawn_over_the_obstacle() {
        let r = Vector2::new(0.45, 0.45);
        let frame = render(r, r, &Scenario::default());
        let [red, _, blue] = frame.pixel(44, 44);
        assert!(red > 200 && u16::from(red) + u16::from(blue) == 255, "red {red}, blue {blue}");
        assert_eq!(frame.pixel(51, 44), [0, 0, 255]);
    }
}
