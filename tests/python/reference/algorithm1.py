"""Algorithm 1 on the true state: trains policies like those of tests/golden/policy_s1.json, policy_s2.json.

    /usr/bin/python3 tests/python/reference/algorithm1.py --scenario 2 --seed 0 --out FOLDER
    /usr/bin/python3 tests/python/reference/algorithm1.py --gradient

The true state takes the place of the latent one, the equations of world.py that of the learned predictor
and heads. The rest is section 4 of docs/choices.md with the schedule of configs/optimise_long.toml (no phase
ends early) and one attempt: 5,150 iterations. The gradient is written by hand (NumPy has no automatic
differentiation); `--gradient` compares it with differences. Another BLAS gives other last bits, so weights
are kept in the golden files and not made anew by a check.
"""

import argparse
import json
import pathlib
import sys
from dataclasses import dataclass, replace

import numpy as np

import generate
import objective
import world as w
from controllers import ACTIONS, HIGH

WEIGHTS = (0.05, 1e-4, 1e-5)
"""lambda_g, lambda_s, lambda_p (rows of those names)."""

ROLLOUTS, GUST_STD, HEADROOM = 64, 0.0027, 1.08
BETA, ALPHA, POWER_ALPHA = 500.0, 3.0, 30.0
WITHOUT_OBSTACLE, DISPLACED, TRUE_OBSTACLE, STAGE1, AVERAGED = 150, 75, 400, 400, 100
DISPLACEMENTS = (0.22, 0.165, 0.11, 0.055)
ETAS = [2.0**n for n in range(1, 10)]


@dataclass
class Starts:
    """Where rollouts begin: position, speed and the gusts to come, [K, 2], [K, 2] and [H, K, 2]."""

    r: np.ndarray
    v: np.ndarray
    gusts: np.ndarray


def starts(count, world, rng):
    """Row "starts in training": around the start, in the square, three tau_c clear of the obstacle."""
    r = np.empty((0, 2))
    while len(r) < count:
        drawn = np.array(world.start) + 0.03 * rng.standard_normal((count, 2))
        inside = np.all((drawn >= 0.0) & (drawn <= 1.0), axis=1)
        r = np.concatenate([r, drawn[inside & (w.clearance(drawn, world) >= 3.0 * world.collision_softness)]])
    v = w.limit(0.01 * rng.standard_normal((count, 2)), world.v_max)
    return Starts(r[:count], v, GUST_STD * rng.standard_normal((world.horizon, count, 2)))


def initial(outputs, rng, bias=None):
    """Row "initial weights" for a network 6-64-64-outputs: [W1, b1, W2, b2, W3, b3]."""
    sizes, layers = (6, 64, 64, outputs), []
    for inputs, units in zip(sizes, sizes[1:]):
        layers += [rng.standard_normal((inputs, units)) / np.sqrt(inputs), np.zeros(units)]
    layers[4] = layers[4] * 0.01
    return layers if bias is None else layers[:5] + [np.array(bias)]


def forward(net, x):
    """Hidden layers and probabilities of a network on [batch, 6]."""
    one = np.tanh(x @ net[0] + net[1])
    two = np.tanh(one @ net[2] + net[3])
    logits = two @ net[4] + net[5]
    odds = np.exp(logits - np.max(logits, axis=1, keepdims=True))
    return one, two, odds / np.sum(odds, axis=1, keepdims=True)


def backward(net, hidden, d_probability):
    """From the gradient of the probabilities: that of each layer's sums, and that of the input."""
    one, two, p = hidden
    d3 = p * (d_probability - np.sum(p * d_probability, axis=1, keepdims=True))
    d2 = (d3 @ net[4].T) * (1.0 - two * two)
    d1 = (d2 @ net[2].T) * (1.0 - one * one)
    return (d1, d2, d3), d1 @ net[0].T


def weight_gradient(x, one, two, sums):
    """Gradients of a network's weights; all arguments are [batch, units]."""
    pairs = zip((x, one, two), sums)
    return [part for before, d in pairs for part in (before.T @ d, np.sum(d, axis=0))]


def inputs_of(r, before, world):
    """The policies' input on true states, [K, 6] (row "policies' input")."""
    obstacle = np.broadcast_to(2.0 * (np.array(world.obstacle) - 0.5), r.shape)
    return np.concatenate([2.0 * (r - 0.5), (r - before) / world.v_max, obstacle], axis=1)


@dataclass
class Rollout:
    """K rollouts: r is [H + 1, K, 2], and one entry of each list belongs to a step."""

    r: np.ndarray
    x: list
    hidden: list
    action: list
    unlimited: list
    free: list


def nearest(mean):
    """The feasible actions nearest to means [K, 2]."""
    squares = np.sum(np.square(ACTIONS), axis=1)
    return ACTIONS[np.argmin(squares - 2.0 * (mean @ ACTIONS.T), axis=1)]


def roll(net, start, world, act=nearest):
    """Eq. (18) with the equations as predictor; the forward pass takes the nearest action.

    Row "relaxed motion". `unlimited` is the speed before the limit, `free` says where no wall stopped it.
    """
    r, v, before = start.r, start.v, start.r - start.v
    out = Rollout([r], [], [], [], [], [])
    for gust in start.gusts:
        x = inputs_of(r, before, world)
        hidden = forward(net, x)
        action = act(hidden[2] @ ACTIONS)
        unlimited = v + world.a_max * action + gust
        before = r
        r, v = w.step(r, v, action, gust, world)
        out.r.append(r)
        for kept, value in zip((out.x, out.hidden, out.action), (x, hidden, action)):
            kept.append(value)
        out.unlimited.append(unlimited)
        out.free.append((r > 0.0) & (r < 1.0))
    out.r = np.array(out.r)
    return out


def gain_slope(r, world):
    """Gain and its gradient by position, [..., 2]."""
    base = np.array(world.base_station)
    along, to = r - base, np.array(world.obstacle) - base
    t = np.clip(np.sum(along * to, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-12), 0.0, 1.0)
    off = to - t[..., None] * along
    d, p, sight = w.norm(off), w.blockage(r, world), w.sight_gain(r, world)
    lost = 1.0 - world.nlos_attenuation
    d_p = (p * (1.0 - p) / world.blockage_softness * t / np.maximum(d, 1e-12))[..., None] * off
    squared = np.maximum(np.sum(along * along, axis=-1), world.distance_floor**2)
    d_sight = (-world.path_loss_exponent * sight / squared)[..., None] * along
    return w.gain(r, world), (1.0 - lost * p)[..., None] * d_sight - (lost * sight)[..., None] * d_p


def risk_slope(r, world):
    """Collision probability and its gradient by position."""
    p, off = w.collision_probability(r, world), r - np.array(world.obstacle)
    away = off / np.maximum(w.norm(off), 1e-12)[..., None]
    return p, -(p * (1.0 - p) / world.collision_softness)[..., None] * away


def log_slope(x, end):
    """Slope of objective.extended_log."""
    return 1.0 / max(x, end)


def evaluate(rollout, world, eta):
    """J_eta of Eq. (29) at full power, P_safe, P_comm, and the gradients by positions and actions."""
    r, action, k = rollout.r, np.array(rollout.action), rollout.r.shape[1]
    weight = objective.barrier_weight(eta)
    end = objective.log_end(weight)
    off = r[1:] - np.array(world.goal)
    cost = np.sum(objective.stage_cost(w.norm(off), action, HIGH, WEIGHTS)) / k
    required = HEADROOM * world.snr_min
    gain, d_gain = gain_slope(r[:-1], world)
    out = objective.smooth_outage(gain * HIGH / world.noise_power, required, ALPHA)
    risk, d_risk = risk_slope(r[1:], world)
    safe = np.mean(objective.soft_minimum((1.0 - risk).T, BETA))
    comm = np.mean(1.0 - out)
    j = cost + objective.barrier(safe, comm, weight, world)

    d_r = np.zeros_like(r)
    d_r[1:] = 2.0 * WEIGHTS[0] * off / k
    share = np.exp(BETA * (risk - np.max(risk, axis=0)))
    share = share / np.sum(share, axis=0)
    slope = weight * log_slope(safe - 1.0 + world.collision_tolerance, end)
    d_r[1:] += slope * share[..., None] * d_risk / k
    slope = weight * log_slope(comm - 1.0 + world.outage_tolerance, end)
    d_out = -out * (1.0 - out) * ALPHA * HIGH / (world.noise_power * required)
    d_r[:-1] += slope * d_out[..., None] * d_gain / out.size
    return j, safe, comm, d_r, 2.0 * WEIGHTS[1] * action / k


def gradient(net, rollout, d_r, d_action, world):
    """Backwards through the steps; the gradient of the nearest action is that of the mean."""
    d_r, d_v, kept = d_r.copy(), np.zeros_like(d_r[0]), []
    for k in reversed(range(len(rollout.action))):
        free, unlimited = rollout.free[k], rollout.unlimited[k]
        d_moved = np.where(free, d_r[k + 1], 0.0)
        d_speed = np.where(free, d_v, 0.0) + d_moved
        length = np.maximum(w.norm(unlimited), 1e-300)[:, None]
        way = unlimited / length
        radial = np.sum(way * d_speed, axis=1, keepdims=True)
        d_v = np.where(length > world.v_max, world.v_max / length * (d_speed - way * radial), d_speed)
        d_mean = d_action[k] + world.a_max * d_v
        sums, d_x = backward(net, rollout.hidden[k], d_mean @ ACTIONS.T)
        d_r[k] += d_moved + 2.0 * d_x[:, :2] + d_x[:, 2:4] / world.v_max
        if k > 0:
            d_r[k - 1] -= d_x[:, 2:4] / world.v_max
        kept.append(sums)
    kept.reverse()
    sums = [np.concatenate(parts) for parts in zip(*kept)]
    one, two, _ = (np.concatenate(parts) for parts in zip(*rollout.hidden))
    return weight_gradient(np.concatenate(rollout.x), one, two, sums)


class Adam:
    """Row "optimiser": Adam (0.9, 0.999, 1e-8)."""

    def __init__(self, net, rate):
        self.rate, self.steps = rate, 0
        self.mean = [np.zeros_like(part) for part in net]
        self.square = [np.zeros_like(part) for part in net]

    def step(self, net, slopes, longest=np.inf):
        """New weights; the gradient is shortened to the length `longest`."""
        length = np.sqrt(sum(np.sum(part * part) for part in slopes))
        slopes = [part * min(1.0, longest / max(length, 1e-300)) for part in slopes]
        self.steps += 1
        self.mean = [0.9 * m + 0.1 * g for m, g in zip(self.mean, slopes)]
        self.square = [0.999 * s + 0.001 * g * g for s, g in zip(self.square, slopes)]
        first, second = 1.0 - 0.9**self.steps, 1.0 - 0.999**self.steps
        return [
            part - self.rate * (m / first) / (np.sqrt(s / second) + 1e-8)
            for part, m, s in zip(net, self.mean, self.square)
        ]


def phase(net, world, eta, iterations, rng):
    """Iterations of stage 1; gives the mean weights of the last ones (row "mean of the last iterations")."""
    adam, tail, j = Adam(net, 1e-3), [], 0.0
    for n in range(iterations):
        rollout = roll(net, starts(ROLLOUTS, world, rng), world)
        j, safe, comm, d_r, d_action = evaluate(rollout, world, eta)
        net = adam.step(net, gradient(net, rollout, d_r, d_action, world), longest=1.0)
        if n >= iterations - AVERAGED:
            tail.append(net)
    values = f"J {j:.3f}, P_safe {safe:.3f}, P_comm {comm:.3f}"
    print(f"eta {eta:g}, {iterations} iterations, obstacle {world.obstacle}: {values}", flush=True)
    return [np.mean(parts, axis=0) for parts in zip(*tail)]


def candidate(net, side, world, rng):
    """Row "warm start": the obstacle comes from a side, so that the way round it lies on the other one."""
    way = np.array(world.goal) - np.array(world.start)
    normal = side * np.array([-way[1], way[0]]) / w.norm(way)
    for distance in DISPLACEMENTS:
        displaced = replace(world, obstacle=tuple((np.array(world.obstacle) + distance * normal).tolist()))
        net = phase(net, displaced, 1.0, DISPLACED, rng)
    return phase(net, world, 1.0, TRUE_OBSTACLE, rng)


def chosen(candidates, world, seed, batches=16):
    """Row "choice of the side": the smaller J on 65,536 common rollouts among the feasible."""
    scores = []
    for name, net in candidates.items():
        rng = np.random.default_rng([seed, 1])
        rollouts = (roll(net, starts(4096, world, rng), world) for _ in range(batches))
        j, safe, comm = np.mean([evaluate(rollout, world, 1.0)[:3] for rollout in rollouts], axis=0)
        values = f"J {j:.4f}, P_safe {safe:.4f}, P_comm {comm:.4f}"
        print(f"{name}: {values} on {4096 * batches} rollouts", flush=True)
        feasible = safe > 1.0 - world.collision_tolerance and comm > 1.0 - world.outage_tolerance
        scores.append((not feasible, j, name))
    return candidates[min(scores)[2]]


def stage1(world, seed):
    """The motion policy: warm start, choice of the side, and eta from 2 to 512."""
    rng = np.random.default_rng([seed, 0])
    nowhere = replace(world, obstacle=(0.5, 1e6))
    net = phase(initial(len(ACTIONS), rng), nowhere, 1.0, WITHOUT_OBSTACLE, rng)
    sides = {"below": candidate(net, 1.0, world, rng), "above": candidate(net, -1.0, world, rng)}
    net = chosen(sides, world, seed)
    for eta in ETAS:
        net = phase(net, world, eta, STAGE1, rng)
    return net


def power_gradient(net, x, snr, world):
    """Stage 2's loss on flights x [F, H, 6] with the SNRs of unit power [F, H], and its gradient.

    lambda_p E[a_p^2] and the second half of the barrier at the last eta; the expectation over both powers
    is exact (row "relaxed power").
    """
    powers, flights = np.array(w.POWERS), len(x)
    hidden = forward(net, x.reshape(-1, 6))
    required = HEADROOM * world.snr_min
    lost = objective.smooth_outage(snr.reshape(-1, 1) * powers, required, POWER_ALPHA)
    weight = objective.barrier_weight(ETAS[-1])
    end, p = objective.log_end(weight), hidden[2]
    margin = 1.0 - np.mean(np.sum(p * lost, axis=1)) - 1.0 + world.outage_tolerance
    loss = WEIGHTS[2] * np.sum(p * powers**2) / flights - weight * objective.extended_log(margin, end)
    d_p = WEIGHTS[2] * powers**2 / flights + weight * log_slope(margin, end) * lost / len(p)
    sums, _ = backward(net, hidden, np.broadcast_to(d_p, p.shape))
    return loss, weight_gradient(x.reshape(-1, 6), hidden[0], hidden[1], sums)


def stage2(motion, world, seed):
    """Row "stage 2": once, 600 iterations at 5e-3 on minibatches of 64 of 512 stored flights."""
    rng = np.random.default_rng([seed, 2])
    stored = roll(motion, starts(512, world, rng), world)
    x = np.array(stored.x).transpose(1, 0, 2)
    snr = (w.gain(stored.r[:-1], world) / world.noise_power).T
    net = initial(len(w.POWERS), rng, bias=[0.5, -0.5])
    adam = Adam(net, 5e-3)
    for _ in range(600):
        batch = rng.integers(0, len(x), ROLLOUTS)
        loss, slopes = power_gradient(net, x[batch], snr[batch], world)
        net = adam.step(net, slopes)
    print(f"stage 2: loss {loss:.5f}", flush=True)
    return net


def layers(net):
    """A network as the golden files write it, of float32 values."""
    short = [part.astype(np.float32).astype(float).tolist() for part in net]
    return [{"W": weights, "b": biases} for weights, biases in zip(short[::2], short[1::2])]


def differences(net, loss, rng, count=40):
    """Central differences of a loss in random weights: [(part, index, slope)]."""
    for _ in range(count):
        part = int(rng.integers(len(net)))
        index = tuple(int(rng.integers(size)) for size in net[part].shape)
        values = []
        for side in (1e-6, -1e-6):
            moved = [x.copy() for x in net]
            moved[part][index] += side
            values.append(loss(moved))
        yield part, index, (values[0] - values[1]) / 2e-6


def gradient_errors(world):
    """Largest differences between the gradients and central differences, relative to the largest slope.

    The nearest action has no derivative, so the rollouts take the mean here.
    """
    rng = np.random.default_rng(5)
    few = replace(world, horizon=12, start=(0.4, 0.56))
    start, net = starts(3, few, rng), initial(len(ACTIONS), rng)
    net[4] = net[4] * 100.0
    start.v = start.v + np.array([0.03, 0.0])

    def rolled(net):
        return roll(net, start, few, act=lambda mean: mean)

    *_, d_r, d_action = evaluate(rolled(net), few, 2.0)
    motion = gradient(net, rolled(net), d_r, d_action, few)
    found = differences(net, lambda n: evaluate(rolled(n), few, 2.0)[0], rng)
    yield "motion", max(abs(motion[p][i] - d) for p, i, d in found) / max(np.max(np.abs(g)) for g in motion)
    x, snr = rng.standard_normal((4, 9, 6)), 4.0 * rng.random((4, 9))
    net = initial(len(w.POWERS), rng, bias=[0.5, -0.5])
    power = power_gradient(net, x, snr, few)[1]
    found = differences(net, lambda n: power_gradient(n, x, snr, few)[0], rng)
    yield "power", max(abs(power[p][i] - d) for p, i, d in found) / max(np.max(np.abs(g)) for g in power)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", choices=["1", "2"], default="2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=pathlib.Path, help="folder for policy_sN.json")
    parser.add_argument("--gradient", action="store_true", help="compare the gradients with differences")
    args = parser.parse_args()
    name = f"S{args.scenario}"
    world = w.scenario(name)
    if args.gradient:
        for what, error in gradient_errors(world):
            print(f"{what}: gradient off by {error:.1e} of the largest slope")
        return
    motion = stage1(world, args.seed)
    made = {"pi_s": layers(motion), "pi_p": layers(stage2(motion, world, args.seed))}
    file = generate.policy(f"policy_{name.lower()}", made)
    print(json.dumps(file["metrics_noise_free"]))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / f"policy_{name.lower()}.json").write_text(json.dumps(file) + "\n")


if __name__ == "__main__":
    sys.exit(main())
