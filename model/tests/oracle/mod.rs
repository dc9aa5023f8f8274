//! The oracle of the hand-written reverse mode: the same objective in burn's tensors, differentiated by
//! burn; and worlds and rollouts of which nothing is special. Used by the tests and by the bench.

use crpl_model::encoder::probe::{Affine, Probe};
use crpl_model::heads::networks::SightLine;
use crpl_model::numeric::kernel::LANES;
use crpl_model::numeric::mlp::Mlp;
use crpl_model::planning::head::Head;
use crpl_model::planning::plant::{Draws, Objective, Plant, RolloutLimits};
use crpl_model::predictor::Predictor;
use crpl_model::predictor::linear::PlaneLinear;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let z: f64 = StandardNormal.sample(rng);
    z as f32
}

/// Random weights: N(0, 1/inputs), the last layer's deviation `last` times that.
pub fn net(widths: &[usize], last: f32, rng: &mut ChaCha8Rng) -> Mlp {
    let mut net = Mlp::zeros(widths);
    let layers = net.layers.len();
    for (n, layer) in net.layers.iter_mut().enumerate() {
        let std = (layer.inputs as f32).sqrt().recip() * if n + 1 == layers { last } else { 1.0 };
        layer.w.iter_mut().for_each(|w| *w = std * normal(rng));
        layer.b.iter_mut().for_each(|b| *b = 0.3 * normal(rng));
    }
    net
}

/// Ψ_c0, Ψ_c1 and Ψ_ca of [`plant`], row by row.
const PSI_C: [[[f32; 2]; 2]; 3] =
    [[[2.0, 0.01], [0.0, 1.98]], [[-1.0, 0.0], [-0.01, -0.99]], [[0.035, 0.001], [-0.001, 0.035]]];

/// A latent world of unit scale with random heads: nothing of it is special.
pub fn plant(limits: RolloutLimits, rng: &mut ChaCha8Rng) -> Plant {
    let mut collision = net(&[4, 64, 64, 1], 3.0, rng);
    collision.layers[2].b[0] = -3.0;
    Plant {
        predictor: Predictor::Linear(PlaneLinear::from_rows(PSI_C)),
        uncontrollable: PlaneLinear::from_rows([
            [[2.0, 0.0], [0.0, 2.0]],
            [[-1.0, 0.0], [0.0, -1.0]],
            [[0.0; 2]; 2],
        ]),
        scale: 10.0,
        v_max: 0.04,
        corners: [[-5.0, -5.0], [-3.0, 5.0]],
        edge: None,
        areas: Vec::new(),
        limits,
        goal: [4.0, 0.0],
        collision: Head::new(collision, None).expect("a head's widths"),
        gain: Head::new(net(&[4, 64, 64, 1], 1.0, rng), Some(sight())).expect("a head's widths"),
    }
}

/// Latents of scale ten, a base station beside the path.
pub fn sight() -> SightLine {
    let map = |x: f64| Affine {
        matrix: nalgebra::Matrix2::new(0.1, x, -x, 0.1),
        offset: nalgebra::Vector2::new(0.5, 0.5 + x),
    };
    SightLine::new(nalgebra::Vector2::new(0.25, 0.4), &Probe { c: map(0.01), u: map(-0.02) }, 0.02)
}

/// `blocks` blocks of rollouts with starts, obstacles and gusts at random.
pub fn draws(blocks: usize, horizon: usize, rng: &mut ChaCha8Rng) -> Vec<Draws> {
    let lane = |mean: f32, std: f32, rng: &mut ChaCha8Rng| -> [f32; LANES] {
        std::array::from_fn(|_| mean + std * normal(rng))
    };
    (0..blocks)
        .map(|_| {
            let now = [lane(-4.0, 0.3, rng), lane(0.0, 0.3, rng)];
            let before = now.map(|y| y.map(|v| v - 0.1));
            let obstacle = [lane(0.0, 0.1, rng), lane(-0.5, 0.1, rng)];
            let wind = (0..horizon).map(|_| [lane(0.0, 0.8, rng), lane(0.0, 0.8, rng)]).collect();
            let obstacle = [obstacle, obstacle];
            Draws {
                start: [now, before],
                obstacles: vec![obstacle],
                reported_obstacle: None,
                wind,
                beyond: 0,
                opening: Vec::new(),
            }
        })
        .collect()
}

/// The same objective written in burn's tensors, differentiated by burn: the oracle of the
/// hand-written reverse mode, straight-through actions included.
#[cfg(feature = "train")]
pub mod by_autodiff {
    use burn::tensor::activation::{sigmoid, softmax, tanh};
    use burn::tensor::{Device, Tensor, TensorData};
    use crpl_model::planning::objective;

    use super::*;

    fn matrix(values: &[f32], shape: [usize; 2], device: &Device) -> Tensor<2> {
        Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
    }

    fn lanes(draws: &[Draws], of: impl Fn(&Draws) -> [[f32; LANES]; 2], device: &Device) -> Tensor<2> {
        let mut rows = Vec::new();
        for d in draws {
            let [x, y] = of(d);
            rows.extend(x.iter().zip(y).flat_map(|(x, y)| [*x, y]));
        }
        matrix(&rows, [draws.len() * LANES, 2], device)
    }

    struct Net(Vec<(Tensor<2>, Tensor<2>)>);

    impl Net {
        fn new(net: &Mlp, learn: bool, device: &Device) -> Self {
            let leaf = |t: Tensor<2>| if learn { t.require_grad() } else { t };
            let layer = |l: &crpl_model::numeric::mlp::Dense| {
                (
                    leaf(matrix(&l.w, [l.inputs, l.outputs], device)),
                    leaf(matrix(&l.b, [1, l.outputs], device)),
                )
            };
            Self(net.layers.iter().map(layer).collect())
        }

        fn forward(&self, mut x: Tensor<2>) -> Tensor<2> {
            for (n, (w, b)) in self.0.iter().enumerate() {
                x = x.matmul(w.clone()) + b.clone();
                if n + 1 < self.0.len() {
                    x = tanh(x);
                }
            }
            x
        }
    }

    fn psi(m: &[[f32; 2]; 2], device: &Device) -> Tensor<2> {
        // Row vectors: y' = y M^T.
        matrix(&[m[0][0], m[1][0], m[0][1], m[1][1]], [2, 2], device)
    }

    /// J and its gradient, layer by layer, weights then biases. RolloutLimits: the predictor alone.
    pub fn gradient(
        plant: &Plant,
        collision: &Mlp,
        gain: &Mlp,
        objective: &Objective,
        eta: f64,
        motion: &Mlp,
        draws: &[Draws],
    ) -> (f64, Vec<Vec<f32>>) {
        let device = Device::flex().autodiff();
        let (collision, gain) = (Net::new(collision, false, &device), Net::new(gain, false, &device));
        let policy = Net::new(motion, true, &device);
        let p: Vec<Tensor<2>> = PSI_C.iter().map(|m| psi(m, &device)).collect();
        let actions = matrix(&[0., 0., 1., 0., -1., 0., 0., 1., 0., -1.], [5, 2], &device);
        let goal = matrix(&plant.goal, [1, 2], &device);
        let obstacle = lanes(draws, |d| d.obstacles[0][0], &device);
        let (mut now, mut before) =
            (lanes(draws, |d| d.start[0], &device), lanes(draws, |d| d.start[1], &device));
        let [rollouts, _] = now.dims();
        let (scale, horizon) = (plant.scale, draws[0].wind.len());
        let mut cost = Tensor::<2>::zeros([rollouts, 1], &device);
        let mut risks = Vec::new();
        let mut connected = Tensor::<2>::zeros([rollouts, 1], &device);
        for k in 0..horizon {
            let x = Tensor::cat(
                vec![
                    now.clone() * (2.0 / scale),
                    (now.clone() - before.clone()) / (scale * plant.v_max),
                    obstacle.clone() * 0.5,
                ],
                1,
            );
            let relaxed = softmax(policy.forward(x), 1).matmul(actions.clone());
            let values: Vec<f32> = relaxed.clone().into_data().try_to_vec::<f32>().expect("floats");
            let nearest: Vec<f32> = values
                .chunks_exact(2)
                .flat_map(|w| {
                    let v = crpl_sitl::units::Motion::nearest(nalgebra::Vector2::new(
                        f64::from(w[0]),
                        f64::from(w[1]),
                    ))
                    .vector();
                    [v.x as f32, v.y as f32]
                })
                .collect();
            let nearest = matrix(&nearest, [rollouts, 2], &device);
            let action = relaxed.clone() + (nearest - relaxed).detach();
            let log_gain = gain.forward(Tensor::cat(vec![now.clone(), obstacle.clone()], 1));
            let ratio = log_gain.exp() * (4.0 / objective.snr_min);
            let outage = sigmoid((ratio.neg() + 1.0) * objective.alpha);
            connected = connected + outage.neg() + 1.0;
            let wind = lanes(draws, |d| d.wind[k], &device);
            let next = now.clone().matmul(p[0].clone())
                + before.matmul(p[1].clone())
                + (action.clone() + wind).matmul(p[2].clone());
            let is_last = (horizon - k) as u64 <= objective.cost.settle_intervals;
            let settle = if is_last { objective.cost.settle } else { 0.0 };
            cost = cost
                + (next.clone() - goal.clone()).square().sum_dim(1)
                    * ((objective.cost.goal + settle) / f64::from(scale).powi(2))
                + action.square().sum_dim(1) * objective.cost.motion
                + objective.cost.power * 16.0;
            let beside = sigmoid(collision.forward(Tensor::cat(vec![next.clone(), obstacle.clone()], 1)));
            risks.push(match &plant.edge {
                None => beside,
                Some(edge) => {
                    let low = matrix(&plant.corners[0], [1, 2], &device);
                    let high = matrix(&plant.corners[1], [1, 2], &device);
                    let sides = Tensor::cat(vec![next.clone() - low, high - next.clone()], 1);
                    let risk = sigmoid((sides.min_dim(1).neg() + edge.margin) / edge.softness);
                    beside.clone() + risk * (beside.neg() + 1.0)
                }
            });
            before = now;
            now = next;
        }
        let safe = Tensor::cat(risks, 1).neg() + 1.0;
        let least = safe.clone().min_dim(1).detach();
        let safe =
            least.clone() - ((safe - least).neg() * objective.beta).exp().sum_dim(1).log() / objective.beta;
        let (w, _) = objective::barrier_weight(eta, objective.barrier_residual);
        let log = |p: Tensor<1>, tolerance: f64| (p - 1.0 + tolerance).log();
        let j = cost.mean()
            - (log(safe.mean(), objective.collision_tolerance)
                + log((connected / horizon as f64).mean(), objective.outage_tolerance))
                * w;
        let value = f64::from(j.clone().into_scalar::<f32>());
        let grads = j.backward();
        let of =
            |t: &Tensor<2>| t.grad(&grads).expect("a leaf").into_data().try_to_vec::<f32>().expect("floats");
        (value, policy.0.iter().flat_map(|(w, b)| [of(w), of(b)]).collect())
    }
}
