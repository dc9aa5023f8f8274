//! The value function of a scenario, by backward induction over time.

use crpl_sitl::Scenario;
use crpl_sitl::world::dynamics::{State, limit_speed};
use crpl_sitl::world::obstacles::Obstacles;
use multiversion::multiversion;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::lattice::{Axis, Lattice, Taps, between};
use super::stage::{self, Constraints, Stage};

/// Sizes of the solution. `Default` as argued in docs/controllers.md.
#[derive(Debug, Clone, PartialEq)]
pub struct ValueConfig {
    /// Position nodes along a side of the field.
    pub places: usize,
    /// Velocity nodes in a_max, where the UAV is slow.
    pub fine: usize,
    /// Up to so many a_max.
    pub dense: usize,
}

impl Default for ValueConfig {
    fn default() -> Self {
        Self { places: 51, fine: 2, dense: 12 }
    }
}

/// V_k(r, v) at some k.
#[derive(Debug, Clone)]
struct Snapshot {
    to_go: u64,
    values: Vec<f32>,
}

/// The value function: what the rest of a flight costs, from any state at any time.
#[derive(Debug, Clone)]
pub struct Solution {
    grid: Lattice,
    /// By intervals to go, ascending; the first is 0.
    snapshots: Vec<Snapshot>,
    /// Value of the scenario's start at time 0.
    start: f64,
}

impl Solution {
    /// Solves `scenario`.
    #[must_use]
    pub fn of(scenario: &Scenario, constraints: Constraints, config: &ValueConfig) -> Self {
        let solver = Solver::new(scenario, constraints, config);
        let grid = &solver.grid;
        let evolution = stage::evolution(scenario);
        let moves = scenario.obstacles.iter().any(|o| o.velocity != Vector2::zeros());
        let mut values = vec![0.0f32; grid.nodes()];
        let mut snapshots = vec![Snapshot { to_go: 0, values: values.clone() }];
        for k in (0..scenario.horizon).rev() {
            let (now, after) = (&evolution[k as usize], &evolution[k as usize + 1]);
            let to_go = scenario.horizon - k;
            values = solver.back(&values, now, after, to_go - 1);
            if is_kept(to_go, moves) || k == 1 {
                snapshots.push(Snapshot { to_go, values: values.clone() });
            }
        }
        let start = grid.at(&values, State::at_rest(scenario.start));
        Self { grid: grid.clone(), snapshots, start }
    }

    /// What the rest of a flight costs from `state`, `to_go` intervals before its end.
    #[must_use]
    pub fn value(&self, to_go: u64, state: State) -> f64 {
        let after = self.snapshots.partition_point(|s| s.to_go < to_go);
        let nearest = self.snapshots.get(after).or(self.snapshots.last());
        nearest.map_or(0.0, |s| self.grid.at(&s.values, state))
    }

    /// The expected cost of a whole flight: J and the penalties.
    #[must_use]
    pub fn of_start(&self) -> f64 {
        self.start
    }
}

/// Which times are kept: all near the end, and ever fewer before it, where what a state costs more than another
/// hardly changes; every third one where obstacles move.
fn is_kept(to_go: u64, moves: bool) -> bool {
    const KEPT: [u64; 8] = [1, 2, 4, 8, 16, 28, 40, 60];
    if moves { to_go.is_multiple_of(3) || to_go <= 3 } else { KEPT.contains(&to_go) }
}

/// What every step of the induction needs.
struct Solver<'a> {
    scenario: &'a Scenario,
    stage: Stage<'a>,
    grid: Lattice,
    /// Velocities before the speed limit.
    free: Axis,
    /// Mean over gusts along an axis, by the push: back, none, on. One row a node of the lattice: nodes of `free`,
    /// weights.
    gusts: [Vec<Row>; 3],
}

/// A sparse row of weights.
type Row = Vec<(usize, f32)>;

impl<'a> Solver<'a> {
    fn new(scenario: &'a Scenario, constraints: Constraints, config: &ValueConfig) -> Self {
        let (push, v_max) = (scenario.dynamics.a_max, scenario.dynamics.v_max);
        let axis = |most: f64| Axis::speeds(push, config.fine, config.dense, most);
        let grid = Lattice { place: Axis::field(config.places), speed: axis(v_max) };
        let free = axis(v_max + 2.0 * push);
        let gust = scenario.disturbance.gust_std();
        let rows = |by: f64| grid.speed.nodes().iter().map(|v| blown(&free, v + by * push, gust)).collect();
        let gusts = [-1.0, 0.0, 1.0].map(rows);
        Self { scenario, stage: Stage::new(scenario, constraints), grid, free, gusts }
    }

    /// V_k from V_{k+1}, `left` intervals before the end.
    fn back(&self, next: &[f32], now: &Obstacles, after: &Obstacles, left: u64) -> Vec<f32> {
        let grid = &self.grid;
        let nodes = grid.place.nodes();
        let place = |i: usize| Vector2::new(nodes[i % nodes.len()], nodes[i / nodes.len()]);
        let nodes = 0..grid.plane();
        let arrival: Vec<f32> =
            nodes.clone().into_par_iter().map(|i| self.stage.arrival(place(i), after, left) as f32).collect();
        let departure: Vec<(f32, bool)> = nodes
            .into_par_iter()
            .map(|i| {
                let (cost, connected) = self.stage.departure(place(i), now);
                (cost as f32, connected)
            })
            .collect();
        let arrived = self.arrive(next, &arrival);
        self.choose(&arrived, &departure)
    }

    /// For each velocity before the speed limit, a plane: the cost of arriving with it, and what follows. A place
    /// beyond the edge is the edge.
    fn arrive(&self, next: &[f32], arrival: &[f32]) -> Vec<f32> {
        let (grid, n, plane) = (&self.grid, self.free.len(), self.grid.plane());
        let mut all = vec![0.0f32; n * n * plane];
        let buffers = || (vec![0.0f32; plane], vec![0.0f32; plane]);
        all.par_chunks_mut(plane).enumerate().for_each_init(buffers, |(total, along), (j, out)| {
            let v = Vector2::new(self.free.nodes()[j % n], self.free.nodes()[j / n]);
            let v = limit_speed(v, self.scenario.dynamics.v_max);
            total.copy_from_slice(arrival);
            let (vx, vy) = (grid.speed.pair(v.x), grid.speed.pair(v.y));
            for (jy, wy) in vy.0.iter().zip(vy.1) {
                for (jx, wx) in vx.0.iter().zip(vx.1).filter(|(_, wx)| wx.abs() * wy.abs() > 1e-6) {
                    add(total, wx * wy, &next[(jy * grid.speed.len() + jx) * plane..][..plane]);
                }
            }
            shift_along(total, &grid.place, v.x, along);
            shift_across(along, &grid.place, v.y, out);
        });
        all
    }

    /// The best motion at each velocity, over the mean of the gusts; coasting where no command gets through.
    fn choose(&self, arrived: &[f32], departure: &[(f32, bool)]) -> Vec<f32> {
        let (n, m, plane) = (self.grid.speed.len(), self.free.len(), self.grid.plane());
        let effort = self.scenario.cost.motion as f32;
        let [back, none, on] = &self.gusts;
        // Along x first: planes [vy before the limit][vx of the lattice].
        let along = |rows: &[Row]| {
            let mut all = vec![0.0f32; m * n * plane];
            all.par_chunks_mut(plane).enumerate().for_each(|(j, out)| {
                rows[j % n]
                    .iter()
                    .for_each(|(x, w)| add(out, *w, &arrived[(j / n * m + x) * plane..][..plane]));
            });
            all
        };
        let [west, coast, east] = [along(back), along(none), along(on)];
        let mut values = vec![0.0f32; self.grid.nodes()];
        let buffers = || vec![vec![0.0f32; plane]; 5];
        values.par_chunks_mut(plane).enumerate().for_each_init(buffers, |ways, (j, out)| {
            let (jx, jy) = (j % n, j / n);
            let across = |out: &mut [f32], from: &[f32], rows: &[Row]| {
                out.fill(0.0);
                rows[jy].iter().for_each(|(y, w)| add(out, *w, &from[(y * n + jx) * plane..][..plane]));
            };
            let sources = [(&coast, none), (&west, none), (&east, none), (&coast, back), (&coast, on)];
            ways.iter_mut().zip(sources).for_each(|(way, (from, rows))| across(way, from, rows));
            least(ways, effort, departure, out);
        });
        values
    }
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn add(to: &mut [f32], weight: f32, from: &[f32]) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += weight * f);
}

/// The least of coasting and of the other ways with their effort, where a command gets through.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn least(ways: &[Vec<f32>], effort: f32, departure: &[(f32, bool)], out: &mut [f32]) {
    let [coast, a, b, c, d] = ways else { return };
    for (i, out) in out.iter_mut().enumerate() {
        let (cost, connected) = departure[i];
        let pushed = effort + a[i].min(b[i]).min(c[i]).min(d[i]);
        *out = cost + if connected { coast[i].min(pushed) } else { coast[i] };
    }
}

/// Standard deviations to which a gust's bell is followed, and points in it.
const BELL: (f64, usize) = (3.0, 25);

/// Weights of the nodes of `axis` in the mean over gusts of a value at velocity `v`.
fn blown(axis: &Axis, v: f64, gust: f64) -> Row {
    let mut weights = vec![0.0f64; axis.len()];
    let points = if gust == 0.0 { 1 } else { BELL.1 };
    let at = |n: usize| BELL.0 * (2.0 * n as f64 / (points - 1).max(1) as f64 - 1.0);
    let bell = |z: f64| (-0.5 * z * z).exp();
    let sum: f64 = if points == 1 { 1.0 } else { (0..points).map(|n| bell(at(n))).sum() };
    for n in 0..points {
        let (z, w) = if points == 1 { (0.0, 1.0) } else { (at(n), bell(at(n)) / sum) };
        let (nodes, taps) = axis.pair(v + gust * z);
        nodes.iter().zip(taps).for_each(|(node, tap)| weights[*node] += w * f64::from(tap));
    }
    let row = weights.iter().enumerate().filter(|(_, w)| w.abs() > 1e-6);
    row.map(|(n, w)| (n, *w as f32)).collect()
}

/// A plane seen from `by` units further in x.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn shift_along(from: &[f32], axis: &Axis, by: f64, to: &mut [f32]) {
    let places = axis.len();
    let all: Vec<Taps> = axis.nodes().iter().map(|x| axis.taps(x + by)).collect();
    for (row, out) in from.chunks_exact(places).zip(to.chunks_exact_mut(places)) {
        for (out, (at, w)) in out.iter_mut().zip(&all) {
            *out = between([row[at[0]], row[at[1]], row[at[2]], row[at[3]]], w);
        }
    }
}

/// A plane seen from `by` units further in y.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn shift_across(from: &[f32], axis: &Axis, by: f64, to: &mut [f32]) {
    let places = axis.len();
    for (y, out) in axis.nodes().iter().zip(to.chunks_exact_mut(places)) {
        let (at, w) = axis.taps(y + by);
        let [a, b, c, d] = at.map(|n| &from[n * places..(n + 1) * places]);
        for (i, out) in out.iter_mut().enumerate() {
            *out = between([a[i], b[i], c[i], d[i]], &w);
        }
    }
}
