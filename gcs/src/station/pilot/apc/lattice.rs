//! A lattice over position and velocity, values on it, and cubic interpolation between its nodes.

use crpl_sitl::world::dynamics::State;

/// The nodes of one coordinate, ascending; at least four.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis(Vec<f64>);

/// Where a coordinate lies: four neighbouring nodes and their weights.
pub type Taps = ([usize; 4], [f32; 4]);

impl Axis {
    /// `count` nodes from 0 to 1.
    #[must_use]
    pub fn field(count: usize) -> Self {
        Self((0..count).map(|n| n as f64 / (count - 1) as f64).collect())
    }

    /// Velocities: `fine` nodes in each `push` (a_max, units per interval) up to `dense` times it, one a push from
    /// there to `most`.
    #[must_use]
    pub fn speeds(push: f64, fine: usize, dense: usize, most: f64) -> Self {
        let slow = (1..=fine * dense).map(|n| n as f64 / fine as f64);
        let last = ((most / push).ceil() as usize).max(dense + 1);
        let fast = (dense + 1..=last).map(|n| n as f64);
        let up: Vec<f64> = slow.chain(fast).map(|n| n * push).collect();
        Self(up.iter().rev().map(|v| -v).chain([0.0]).chain(up.iter().copied()).collect())
    }

    /// The nodes.
    #[must_use]
    pub fn nodes(&self) -> &[f64] {
        &self.0
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether it has no node.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The two nodes around `x`, which is kept between the first node and the last, and their shares.
    #[must_use]
    pub fn pair(&self, x: f64) -> ([usize; 2], [f32; 2]) {
        let nodes = &self.0;
        let x = x.clamp(nodes[0], nodes[nodes.len() - 1]);
        let first = (nodes.partition_point(|n| *n <= x).max(1) - 1).min(nodes.len() - 2);
        let share = ((x - nodes[first]) / (nodes[first + 1] - nodes[first])) as f32;
        ([first, first + 1], [1.0 - share, share])
    }

    /// The cubic through the four nodes around `x`, the two inner ones being next to it; a straight line at the ends,
    /// beyond which `x` is not followed.
    #[must_use]
    pub fn taps(&self, x: f64) -> Taps {
        let nodes = &self.0;
        let ([low, high], [a, b]) = self.pair(x);
        if low == 0 || high == nodes.len() - 1 {
            return ([low, low, high, high], [0.0, a, b, 0.0]);
        }
        let (x, first) = (x.clamp(nodes[0], nodes[nodes.len() - 1]), low - 1);
        let weight = |n: usize| -> f32 {
            let others = (0..4).filter(|m| *m != n);
            others.map(|m| (x - nodes[first + m]) / (nodes[first + n] - nodes[first + m])).product::<f64>()
                as f32
        };
        (std::array::from_fn(|n| first + n), std::array::from_fn(weight))
    }
}

/// The axes of a lattice: places along both sides of the field, velocities along both of its directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice {
    /// Of a position's coordinate, units.
    pub place: Axis,
    /// Of a velocity's, units per interval.
    pub speed: Axis,
}

impl Lattice {
    /// Position nodes: the values of one velocity node, a plane; rows are y.
    #[must_use]
    pub fn plane(&self) -> usize {
        self.place.len() * self.place.len()
    }

    /// All nodes.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.plane() * self.speed.len() * self.speed.len()
    }

    /// The value at `state`, cubic between nodes.
    #[must_use]
    pub fn at(&self, values: &[f32], state: State) -> f64 {
        let (x, y) = (self.place.taps(state.r.x), self.place.taps(state.r.y));
        let (vx, vy) = (self.speed.taps(state.v.x), self.speed.taps(state.v.y));
        let (places, speeds) = (self.place.len(), self.speed.len());
        let value = between(
            vy.0.map(|jy| {
                between(
                    vx.0.map(|jx| {
                        let plane = &values[(jy * speeds + jx) * self.plane()..];
                        between(y.0.map(|iy| between(x.0.map(|ix| plane[iy * places + ix]), &x.1)), &y.1)
                    }),
                    &vx.1,
                )
            }),
            &vy.1,
        );
        f64::from(value)
    }
}

/// The cubic through four nodes by their weights, kept between the two inner ones: beside a cliff a cubic alone falls
/// below its nodes, and whoever looks for the least would go there.
#[inline(always)]
#[must_use]
pub fn between(nodes: [f32; 4], weights: &[f32; 4]) -> f32 {
    let [a, b, c, d] = nodes;
    let cubic = weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d;
    cubic.max(b.min(c)).min(b.max(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn a_cubic_is_itself_between_nodes_dense_and_sparse() {
        let grid = Lattice { place: Axis::field(21), speed: Axis::speeds(0.0035, 4, 3, 0.04) };
        assert_eq!(grid.speed.len(), 1 + 2 * (12 + 9));
        let of = |x: f64, y: f64, vx: f64, vy: f64| x * x * x - 2.0 * y + 30.0 * vx * vx + 5.0 * x * vy;
        let mut values = vec![0.0; grid.nodes()];
        let (n, m) = (grid.place.nodes(), grid.speed.nodes());
        for (i, value) in values.iter_mut().enumerate() {
            let (v, r) = (i / grid.plane(), i % grid.plane());
            *value = of(n[r % 21], n[r / 21], m[v % m.len()], m[v / m.len()]) as f32;
        }
        for (v, w) in [(0.001, -0.0271), (0.0102, 0.0125)] {
            let state = State { r: Vector2::new(0.512, 0.381), v: Vector2::new(v, w) };
            assert!((grid.at(&values, state) - of(0.512, 0.381, v, w)).abs() < 1e-5);
        }
        let outside = State { r: Vector2::new(1.5, 0.5), v: Vector2::zeros() };
        assert!((grid.at(&values, outside) - of(1.0, 0.5, 0.0, 0.0)).abs() < 1e-5);
    }
}
