//! The risk and channel heads as networks of (y_c, y_u, s_BS), and what they are for one base station.
//!
//! The base station's state s_BS is constant in a scenario. [`Heads::at`] folds it in once, so that
//! flight and Algorithm 1 run networks of four inputs. Knows networks; neither labels nor frames.
//!
//! Free space has no preferred place and no preferred direction: the gain depends on the UAV's distance
//! d from the base station and on where the obstacle lies along and across the sight line, and on
//! nothing else. Its network reads just these ([`SightLine`]); how the gain falls with them it learns.
//! A network of the same size on the raw (y_c, y_u, s_BS) stays at 0.43 dB rms, this one at 0.1 dB.

use crpl_sitl::Scenario;
use nalgebra::Vector2;

use crate::encoder::probe::Probe;
use crate::numeric::kernel;
use crate::numeric::mlp::Mlp;
use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};

/// Widths of the risk head: y_c, y_u, s_BS in.
pub const COLLISION_WIDTHS: [usize; 4] = [6, 64, 64, 1];

/// Widths of the channel head: coordinates of the sight line in.
pub const GAIN_WIDTHS: [usize; 4] = [4, 64, 64, 1];

/// Factor on s_BS - ½: the base station's coordinates are uniform in `[0, 1]` in training, with the
/// standard deviation 1/√12.
const STATION_SCALE: f32 = 3.464_101_6;

/// Distance to the base station below which the training data's gain levels off, units: a scenario's own floor is
/// not felt below it.
const TRAINED_FLOOR: f32 = 0.02;

/// Both heads as they are trained and stored.
#[derive(Debug, Clone, PartialEq)]
pub struct Heads {
    /// `[scale_c y_c, scale_u y_u, √12 (s_BS - ½)]` to the logit of the collision probability.
    pub collision: Mlp,
    /// [`SightLine`] coordinates to (ln |h|² - gain_mean) / gain_std.
    pub gain: Mlp,
    /// Mean of ln |h|² in the training data.
    pub gain_mean: f32,
    /// Standard deviation of ln |h|² in the training data.
    pub gain_std: f32,
    /// Factor on y_c, the same for both coordinates.
    pub scale_c: f32,
    /// Factor on y_u, the same for both coordinates.
    pub scale_u: f32,
    /// Distance to the base station below which the sight line's coordinates level off, units.
    pub floor: f32,
}

impl Heads {
    /// The risk head's input.
    #[must_use]
    pub fn input(&self, y_c: [f32; 2], y_u: [f32; 2], station: Vector2<f64>) -> [f32; 6] {
        let (c, u) = (self.scale_c, self.scale_u);
        let [x, y] = place(station);
        [c * y_c[0], c * y_c[1], u * y_u[0], u * y_u[1], x, y]
    }

    /// Both heads for a base station at `station`, paper units; `probe` maps latents to positions.
    #[must_use]
    pub fn at(&self, station: Vector2<f64>, probe: &Probe) -> StationHeads {
        let (mut collision, mut gain) = (self.collision.clone(), self.gain.clone());
        // Scales into the first layer's rows, the station's rows into its bias.
        if let Some(first) = collision.layers.first_mut() {
            let known = first.w.split_off(4 * first.outputs);
            for (row, x) in known.chunks_exact(first.outputs).zip(place(station)) {
                first.b.iter_mut().zip(row).for_each(|(b, w)| *b = x.mul_add(*w, *b));
            }
            for (i, row) in first.w.chunks_exact_mut(first.outputs).enumerate() {
                let scale = if i < 2 { self.scale_c } else { self.scale_u };
                row.iter_mut().for_each(|w| *w *= scale);
            }
            first.inputs = 4;
        }
        if let Some(last) = gain.layers.last_mut() {
            last.w.iter_mut().for_each(|w| *w *= self.gain_std);
            last.b.iter_mut().for_each(|b| *b = b.mul_add(self.gain_std, self.gain_mean));
        }
        StationHeads { collision, gain, sight: SightLine::new(station, probe, self.floor) }
    }
}

impl Stored for Heads {
    fn put(&self, out: &mut Writer) {
        out.mlp("heads.collision", &self.collision);
        out.mlp("heads.gain", &self.gain);
        out.f32("heads.gain_mean", &[1], [self.gain_mean]);
        out.f32("heads.gain_std", &[1], [self.gain_std]);
        out.f32("heads.scale", &[2], [self.scale_c, self.scale_u]);
        out.f32("heads.floor", &[1], [self.floor]);
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let scale = from.f32("heads.scale", &[2])?;
        Ok(Self {
            collision: from.mlp("heads.collision", &COLLISION_WIDTHS)?,
            gain: from.mlp("heads.gain", &GAIN_WIDTHS)?,
            gain_mean: from.f32("heads.gain_mean", &[1])?[0],
            gain_std: from.f32("heads.gain_std", &[1])?[0],
            scale_c: scale[0],
            scale_u: scale[1],
            floor: from.f32("heads.floor", &[1])?[0],
        })
    }
}

/// s_BS as the risk head reads it.
fn place(station: Vector2<f64>) -> [f32; 2] {
    [station.x, station.y].map(|x| (x as f32 - 0.5) * STATION_SCALE)
}

/// Both heads for one base station.
#[derive(Debug, Clone, PartialEq)]
pub struct StationHeads {
    /// `[y_c, y_u]` to the logit of the collision probability.
    pub collision: Mlp,
    /// [`SightLine`] coordinates to ln |h|².
    pub gain: Mlp,
    /// What the gain's network reads.
    pub sight: SightLine,
}

impl StationHeads {
    /// The heads for the radii, d_min, τ_c and G0 of `scenario`. The collision probability depends on the
    /// distance of the centres alone: logit = (d_min + R_u + R_o - |r - r_u|)/τ_c. So the logit of the training
    /// data's values gives that of any others, and G0 is a factor of the gain.
    #[must_use]
    pub fn scaled_to(mut self, scenario: &Scenario) -> Self {
        let trained = Scenario::default();
        let reach = |s: &Scenario| s.safety.d_min + s.uav_radius + s.obstacle().radius;
        let factor = (trained.safety.softness / scenario.safety.softness) as f32;
        let shift = ((reach(scenario) - reach(&trained)) / scenario.safety.softness) as f32;
        // Not touched at all in the world of the training data, to the last bit.
        if let Some(last) = self.collision.layers.last_mut().filter(|_| factor != 1.0 || shift != 0.0) {
            last.w.iter_mut().for_each(|w| *w *= factor);
            last.b.iter_mut().for_each(|b| *b = b.mul_add(factor, shift));
        }
        let louder = (scenario.channel.reference_gain / trained.channel.reference_gain).ln() as f32;
        if let Some(last) = self.gain.layers.last_mut().filter(|_| louder != 0.0) {
            last.b.iter_mut().for_each(|b| *b += louder);
        }
        self
    }

    /// Keys in which the shape of `scenario`'s channel differs from that of the training data: the channel head
    /// says nothing there.
    #[must_use]
    pub fn untrained(scenario: &Scenario) -> Vec<&'static str> {
        let (trained, c) = (Scenario::default(), &scenario.channel);
        let same = [
            ("obstacle[0].radius", scenario.obstacle().radius == trained.obstacle().radius),
            ("channel.path_loss_exponent", c.path_loss_exponent == trained.channel.path_loss_exponent),
            ("channel.nlos_attenuation", c.nlos_attenuation == trained.channel.nlos_attenuation),
            ("channel.blockage_softness", c.blockage_softness == trained.channel.blockage_softness),
            ("channel.distance_floor", c.distance_floor <= f64::from(TRAINED_FLOOR)),
        ];
        same.into_iter().filter(|(_, same)| !same).map(|(key, _)| key).collect()
    }

    /// Collision probability in (0, 1).
    #[must_use]
    pub fn collision(&self, y_c: [f32; 2], y_u: [f32; 2]) -> f32 {
        let logit = self.collision.forward(&[y_c[0], y_c[1], y_u[0], y_u[1]])[0];
        1.0 / (1.0 + (-logit).exp())
    }

    /// ln |h|², natural logarithm of the channel's power gain.
    #[must_use]
    pub fn log_gain(&self, y_c: [f32; 2], y_u: [f32; 2]) -> f32 {
        self.gain.forward(&self.sight.coordinates(y_c, y_u))[0]
    }
}

/// A scene in the frame of the sight line from the base station to the UAV, each coordinate of order
/// one: [ln d, d, the obstacle's place along the line from its middle, and across it].
///
/// With r and q the UAV's and the obstacle's places seen from the base station, d² = |r|² + floor² and
/// e = r/d; the floor keeps e smooth where the UAV is over the base station.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightLine {
    /// y_c to r: matrix, row-major.
    c: [[f32; 2]; 2],
    /// Offset of r.
    c_offset: [f32; 2],
    /// y_u to q: matrix, row-major.
    u: [[f32; 2]; 2],
    /// Offset of q.
    u_offset: [f32; 2],
    floor: f32,
}

/// What the coordinates' slope needs again.
#[derive(Debug, Clone, Copy)]
struct SightGeometry {
    r: [f32; 2],
    q: [f32; 2],
    d: f32,
}

impl SightLine {
    /// As seen from `station`, paper units.
    #[must_use]
    pub fn new(station: Vector2<f64>, probe: &Probe, floor: f32) -> Self {
        let rows = |m: &nalgebra::Matrix2<f64>| {
            [[m[(0, 0)] as f32, m[(0, 1)] as f32], [m[(1, 0)] as f32, m[(1, 1)] as f32]]
        };
        let from = |offset: Vector2<f64>| {
            let o = offset - station;
            [o.x as f32, o.y as f32]
        };
        Self {
            c: rows(&probe.c.matrix),
            c_offset: from(probe.c.offset),
            u: rows(&probe.u.matrix),
            u_offset: from(probe.u.offset),
            floor,
        }
    }

    #[inline(always)]
    fn see(&self, y_c: [f32; 2], y_u: [f32; 2]) -> SightGeometry {
        let map = |m: &[[f32; 2]; 2], b: &[f32; 2], y: [f32; 2]| -> [f32; 2] {
            std::array::from_fn(|i| m[i][0].mul_add(y[0], m[i][1].mul_add(y[1], b[i])))
        };
        let r = map(&self.c, &self.c_offset, y_c);
        let q = map(&self.u, &self.u_offset, y_u);
        let d = r[0].mul_add(r[0], r[1].mul_add(r[1], self.floor * self.floor)).sqrt();
        SightGeometry { r, q, d }
    }

    /// The four coordinates.
    #[inline(always)]
    #[must_use]
    pub fn coordinates(&self, y_c: [f32; 2], y_u: [f32; 2]) -> [f32; 4] {
        let SightGeometry { r, q, d } = self.see(y_c, y_u);
        let e = [r[0] / d, r[1] / d];
        let along = q[0].mul_add(e[0], q[1] * e[1]);
        let across = q[0].mul_add(e[1], -(q[1] * e[0]));
        [kernel::ln(d) + 0.9, 3.0 * (d - 0.5), 3.0 * (along - 0.5 * d), 6.0 * across]
    }

    /// From a slope in the coordinates to the slope in y_c.
    #[inline(always)]
    #[must_use]
    pub fn pull_back(&self, y_c: [f32; 2], y_u: [f32; 2], slope: [f32; 4]) -> [f32; 2] {
        let SightGeometry { r, q, d } = self.see(y_c, y_u);
        let by_e =
            [3.0 * slope[2] * q[0] - 6.0 * slope[3] * q[1], 3.0 * slope[2] * q[1] + 6.0 * slope[3] * q[0]];
        let by_d = slope[0] / d + 3.0 * slope[1] - 1.5 * slope[2];
        // e = r/d and d depends on r: de/dr = I/d - r r'/d³, dd/dr = r'/d.
        let radial = by_d - (by_e[0] * r[0] + by_e[1] * r[1]) / (d * d);
        let by_r: [f32; 2] = std::array::from_fn(|i| (by_e[i] + radial * r[i]) / d);
        std::array::from_fn(|i| self.c[0][i] * by_r[0] + self.c[1][i] * by_r[1])
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;
    use crate::encoder::probe::Affine;

    fn probe() -> Probe {
        Probe {
            c: Affine { matrix: Matrix2::new(0.1, 0.02, -0.01, 0.09), offset: Vector2::new(0.4, 0.5) },
            u: Affine { matrix: Matrix2::new(0.2, -0.03, 0.05, 0.22), offset: Vector2::new(0.5, 0.45) },
        }
    }

    #[test]
    fn turning_the_scene_about_the_base_station_changes_nothing() {
        let station = Vector2::new(0.3, 0.2);
        let sight = SightLine::new(station, &probe(), 0.02);
        let seen = |angle: f64| {
            let turn = |r: Vector2<f64>| station + nalgebra::Rotation2::new(angle) * r;
            let y = |a: &Affine, r| a.invert(turn(r)).map(|y| [y.x as f32, y.y as f32]).unwrap();
            sight.coordinates(y(&probe().c, Vector2::new(0.3, 0.1)), y(&probe().u, Vector2::new(0.1, 0.15)))
        };
        for (a, b) in seen(0.0).into_iter().zip(seen(1.1)) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
        // d, and the obstacle 0.12 beyond along (0.3, 0.1) and to its left.
        let [_, d, _, across] = seen(0.0);
        assert!((d / 3.0 + 0.5 - (0.1f32 + 4e-4).sqrt()).abs() < 1e-5 && across < 0.0, "{d} {across}");
    }

    #[test]
    fn the_slope_is_that_of_finite_differences() {
        let sight = SightLine::new(Vector2::new(0.45, 0.55), &probe(), 0.02);
        let slope = [0.7, -0.4, 1.3, 0.9];
        for (y_c, y_u) in [([0.3, -0.2], [0.5, 0.1]), ([2.0, 1.0], [-1.0, 0.4]), ([0.5, 0.6], [0.3, 0.3])] {
            let value = |y: [f32; 2]| {
                sight
                    .coordinates(y, y_u)
                    .iter()
                    .zip(slope)
                    .map(|(x, s)| f64::from(*x) * f64::from(s))
                    .sum::<f64>()
            };
            let found = sight.pull_back(y_c, y_u, slope);
            for i in 0..2 {
                let step = 4e-3;
                let (mut up, mut down) = (y_c, y_c);
                up[i] += step;
                down[i] -= step;
                let wanted = (value(up) - value(down)) / f64::from(up[i] - down[i]);
                assert!(
                    (f64::from(found[i]) - wanted).abs() < 2e-3 * (1.0 + wanted.abs()),
                    "{} instead of {wanted}",
                    found[i]
                );
            }
        }
    }

    #[test]
    fn folding_the_base_station_in_changes_no_risk() {
        let mut collision = Mlp::zeros(&COLLISION_WIDTHS);
        for (n, layer) in collision.layers.iter_mut().enumerate() {
            let values = layer.w.iter_mut().chain(&mut layer.b).enumerate();
            values.for_each(|(k, w)| *w = 0.3 * ((k * (n + 3)) as f32).sin());
        }
        let (scale_c, scale_u, floor) = (0.3, 1.2, 0.02);
        let gain = Mlp::zeros(&GAIN_WIDTHS);
        let heads = Heads { collision, gain, gain_mean: 1.5, gain_std: 2.0, scale_c, scale_u, floor };
        let (y_c, y_u, station) = ([1.0, -2.0], [0.3, 0.4], Vector2::new(0.8, 0.1));
        let whole = heads.collision.forward(&heads.input(y_c, y_u, station))[0];
        let at = heads.at(station, &probe());
        let folded = at.collision.forward(&[y_c[0], y_c[1], y_u[0], y_u[1]])[0];
        assert!((whole - folded).abs() < 1e-5 && whole != 0.0, "{whole} {folded}");
        assert!((at.log_gain(y_c, y_u) - 1.5).abs() < 1e-6);
    }
}
