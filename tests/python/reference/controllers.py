"""The four controllers of Sec. IV-A7, on true states.

CRPL is a pair of policies; its training is not here. The paper gives the others a sentence each; what
they do is section 5 of docs/choices.md.

A controller has `decide(r, v, before, link)`: position, speed, the position before, and the last
interval's (SNR, power), or None in the first interval. It returns an element of A_s and one of A_p.
"""

import numpy as np

from objective import stage_cost
from world import (
    POWERS,
    clearance,
    collision_probability,
    gain,
    limit,
    norm,
    sigmoid,
    snr,
    step,
)

ACTIONS = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=float)
"""A_s in the paper's order (Sec. IV-A1)."""

LOW, HIGH = POWERS


def nearest_action(wish):
    """Index of the feasible action nearest to a relaxed one (Sec. IV-A1); ties go to the first."""
    return int(np.argmin(np.sum(np.square(ACTIONS - np.asarray(wish)), axis=-1)))


class Network:
    """Two hidden layers of tanh units and a softmax (Sec. IV-A5). Layers are {"W": [in, out], "b": [out]}."""

    def __init__(self, layers):
        self.layers = [(np.array(layer["W"]), np.array(layer["b"])) for layer in layers]

    def __call__(self, x):
        """Probabilities of the outputs for the input x [inputs]."""
        for w, b in self.layers[:-1]:
            x = np.tanh(x @ w + b)
        w, b = self.layers[-1]
        logits = x @ w + b
        powers = np.exp(logits - np.max(logits))
        return powers / np.sum(powers)


def features(r, before, world):
    """The policies' input on true states: position, move and obstacle, each of order one.

    Row "policies' input" of docs/choices.md, with the square's middle as origin and 2 units for 1.
    """
    obstacle = np.array(world.obstacle)
    return np.concatenate([2.0 * (r - 0.5), (r - before) / world.v_max, 2.0 * (obstacle - 0.5)])


class Crpl:
    """The relaxed outputs of pi_s and pi_p, mapped to the nearest feasible actions (Sec. IV-A1)."""

    def __init__(self, world, motion, power):
        self.world, self.motion, self.power = world, Network(motion), Network(power)

    def decide(self, r, v, before, link):
        """Rows "relaxed motion" and "relaxed power" of docs/choices.md."""
        x = features(r, before, self.world)
        wish = self.motion(x) @ ACTIONS
        mean_power = self.power(x) @ np.array(POWERS)
        return ACTIONS[nearest_action(wish)], HIGH if mean_power > (LOW + HIGH) / 2.0 else LOW


class Reactive:
    """RCC and UCC: row "RCC and UCC, motion" and "RCC and UCC, power" of docs/choices.md."""

    def __init__(self, world, ahead, least, gains):
        self.world, self.ahead, self.least, self.gains = world, ahead, least, gains
        self.weak = self.strong = 0
        self.high = False

    def decide(self, r, v, before, link):
        """One decision; the power remembers the SNRs measured before."""
        return ACTIONS[self._motion(r, v)], self._power(link)

    def _desired(self, r, v):
        """(k_r (r_g - r) - k_v v) / a_max, scaled into the box of actions."""
        position, speed = self.gains
        wish = (position * (np.array(self.world.goal) - r) - speed * v) / self.world.a_max
        return wish / max(1.0, np.max(np.abs(wish)))

    def _motion(self, r, v):
        """Of the actions that keep their clearance, the nearest to the desired one; else the clearest."""
        speeds = limit(v + self.world.a_max * ACTIONS, self.world.v_max)
        steps = np.arange(1, self.ahead + 1)[:, None, None]
        clear = np.min(clearance(r + steps * speeds, self.world), axis=0)
        cost = np.sum(np.square(ACTIONS - self._desired(r, v)), axis=-1)
        score = np.where(clear >= self.least, cost, 100.0 - 100.0 * clear + 0.001 * cost)
        return int(np.argmin(score))

    def _power(self, link):
        """High after 2 weak intervals; low after 8 in which low power would have given 1.2 gamma_min."""
        if link is not None:
            gamma, power = link
            self.weak = self.weak + 1 if gamma < self.world.snr_min else 0
            self.strong = self.strong + 1 if gamma / power >= 1.2 * self.world.snr_min else 0
            self.high = self.strong < 8 if self.high else self.weak >= 2
        return HIGH if self.high else LOW


PLAIN_GAINS = (0.03, 0.24)
"""Gains of position and speed of the simplest reading, `rcc-paper` and `ucc-paper`."""


def rcc(world, gains=PLAIN_GAINS):
    """12 intervals ahead, with the clearance at which p_coll is delta_1 (row "RCC")."""
    odds = (1.0 - world.collision_tolerance) / world.collision_tolerance
    return Reactive(world, 12, world.d_min + world.collision_softness * np.log(odds), gains)


def ucc(world, gains=PLAIN_GAINS):
    """8 intervals ahead, with a clearance of 0.028 (row "UCC")."""
    return Reactive(world, 8, 0.028, gains)


class Apc:
    """The beam search on the exact equations without gusts: row "APC" of docs/choices.md."""

    DEPTH, HOLD, BEAM = 7, 4, 24
    WEIGHTS = (0.05, 1e-4, 1e-5)
    ENOUGH = 1.05

    def __init__(self, world):
        self.world = world

    def decide(self, r, v, before, link):
        """The first motion of the best sequence, and the power that it needs in the next intervals."""
        action = ACTIONS[self._search(r, v)]
        return action, self._power(r, v, action)

    def _search(self, r, v):
        """Index of the first action of the best node after DEPTH motions of HOLD intervals each."""
        r, v, cost, first = r[None], v[None], np.zeros(1), None
        for _ in range(self.DEPTH):
            action = np.tile(ACTIONS, (len(r), 1))
            r, v, cost = (np.repeat(x, len(ACTIONS), axis=0) for x in (r, v, cost))
            first = np.arange(len(ACTIONS)) if first is None else np.repeat(first, len(ACTIONS))
            for _ in range(self.HOLD):
                r, v = step(r, v, action, 0.0, self.world)
                cost = cost + self._cost(r, action)
            value = cost + self._rest(r, v)
            kept = self._kept(r, value)
            r, v, cost, first, value = r[kept], v[kept], cost[kept], first[kept], value[kept]
        return int(first[np.argmin(value)])

    def _cost(self, r, action):
        """Eq. (9) with the lowest power that keeps the link, and penalties for outage and risk."""
        low = snr(r, LOW, self.world)
        power = np.where(low >= self.ENOUGH * self.world.snr_min, LOW, HIGH)
        cost = stage_cost(norm(r - np.array(self.world.goal)), action, power, self.WEIGHTS)
        lost = sigmoid(5.0 * (1.0 - HIGH * low / self.world.snr_min))
        risk = collision_probability(r, self.world) - 0.8 * self.world.collision_tolerance
        allowed = self.world.horizon * self.world.outage_tolerance
        return cost + lost / allowed + 5.0 * np.maximum(0.0, risk)

    def _rest(self, r, v):
        """What the way after the last node is worth: the goal, from where the UAV is 6 intervals on."""
        return 12.0 * self.WEIGHTS[0] * norm(r + 6.0 * v - np.array(self.world.goal)) ** 2

    def _kept(self, r, value):
        """The best nodes, half of them above the obstacle, so that both sides survive."""
        if len(value) <= self.BEAM:
            return np.arange(len(value))
        order = np.argsort(value, kind="stable")
        above = r[order, 1] > self.world.obstacle[1]
        half = self.BEAM // 2
        return np.concatenate([order[above][:half], order[~above][:half]])

    def _power(self, r, v, action):
        """Low if low power keeps the link here and in the next two positions."""
        lowest = gain(r, self.world) / self.world.noise_power
        for _ in range(2):
            r, v = step(r, v, action, 0.0, self.world)
            lowest = min(lowest, snr(r, LOW, self.world))
        return LOW if lowest >= self.ENOUGH * self.world.snr_min else HIGH
