//! Where an obstacle can be, in its plane coordinates: a straight prediction reflects at its edges.

use nalgebra::{Matrix2, Vector2};

use crate::numeric::kernel::{LANES, Lane};

/// A parallelogram in y_u, the image of the square that walls and margin leave to an obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    origin: [f32; 2],
    /// Columns: the two edges from the origin.
    edges: [[f32; 2]; 2],
    inverse: [[f32; 2]; 2],
}

impl Area {
    /// From three of its corners: the origin and the ends of its two edges; `None` if they lie in line.
    #[must_use]
    pub fn new(origin: [f32; 2], ends: [[f32; 2]; 2]) -> Option<Self> {
        let o = Vector2::from(origin);
        let edges = Matrix2::from_columns(&ends.map(|end| Vector2::from(end) - o));
        let rows = |m: &Matrix2<f32>| [[m[(0, 0)], m[(0, 1)]], [m[(1, 0)], m[(1, 1)]]];
        Some(Self { origin, edges: rows(&edges), inverse: rows(&edges.try_inverse()?) })
    }

    /// Places that went on straight, reflected as often as they met an edge. What is inside stays as it
    /// is, to the last bit.
    #[inline(always)]
    pub(super) fn reflect(&self, y: &mut [Lane; 2]) {
        let times = |m: &[[f32; 2]; 2], v: [f32; 2]| {
            [m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]]
        };
        for l in 0..LANES {
            let s = times(&self.inverse, [y[0][l] - self.origin[0], y[1][l] - self.origin[1]]);
            if s.iter().all(|v| (0.0..=1.0).contains(v)) {
                continue;
            }
            let back = times(&self.edges, s.map(fold));
            y[0][l] = self.origin[0] + back[0];
            y[1][l] = self.origin[1] + back[1];
        }
    }
}

/// A coordinate reflected at 0 and 1.
fn fold(s: f32) -> f32 {
    let along = s.rem_euclid(2.0);
    if along > 1.0 { 2.0 - along } else { along }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_line_reflects_at_the_edges_of_a_turned_square() {
        // A square of side 2 turned by 45 degrees, its origin at (0, -√2).
        let r = std::f32::consts::SQRT_2;
        let area = Area::new([0.0, -r], [[r, 0.0], [-r, 0.0]]).unwrap();
        let mut y = [[0.0; LANES], [0.0; LANES]];
        // Beyond the middle of the upper right edge by 0.5: comes back by as much.
        (y[0][0], y[1][0]) = (r / 2.0 + 0.25 * r, r / 2.0 + 0.25 * r);
        (y[0][1], y[1][1]) = (0.1, 0.2);
        area.reflect(&mut y);
        assert!((y[0][0] - 0.25 * r).abs() < 1e-5 && (y[1][0] - 0.25 * r).abs() < 1e-5);
        assert_eq!((y[0][1], y[1][1]), (0.1, 0.2));
        assert_eq!(Area::new([0.0; 2], [[1.0, 1.0], [2.0, 2.0]]), None);
    }

    #[test]
    fn a_line_beyond_both_edges_of_a_skew_area_comes_back_on_each() {
        // Edges (3, 1) and (-0.5, 5) from (1, 2).
        let area = Area::new([1.0, 2.0], [[4.0, 3.0], [0.5, 7.0]]).unwrap();
        let mut y = [[1.5; LANES], [4.0; LANES]];
        // 1.25 and -0.4 along the edges: back at 0.75 and 0.4. Then 2.6 and -2.3: at 0.6 and 0.3.
        (y[0][0], y[1][0]) = (4.95, 1.25);
        (y[0][1], y[1][1]) = (9.95, -6.9);
        area.reflect(&mut y);
        for (l, place) in [[3.05, 4.75], [2.65, 4.1], [1.5, 4.0]].into_iter().enumerate() {
            assert!((y[0][l] - place[0]).abs() < 1e-4 && (y[1][l] - place[1]).abs() < 1e-4, "{l}: {y:?}");
        }
    }
}
