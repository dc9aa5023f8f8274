"""The parts of Algorithm 1's objective (Sec. III-C and III-D).

Written from the paper and from section 4 of docs/choices.md.
"""

import numpy as np

from world import sigmoid

RESIDUAL = 1e-4
"""eps_b (Sec. IV-A5)."""


def stage_cost(distance, action, power, weights):
    """Eq. (9): lambda_g |z_c - z_g|^2 + lambda_s |a_s|^2 + lambda_p a_p^2.

    `weights` are (lambda_g, lambda_s, lambda_p); lambda_g stands for the unknown scale of a latent (row
    "lambda_g" of docs/choices.md).
    """
    goal, motion, transmit = weights
    return goal * distance**2 + motion * np.sum(np.square(action), axis=-1) + transmit * power**2


def soft_minimum(x, beta):
    """Eq. (23): -(1 / beta) ln sum e^(-beta x), over the last axis."""
    low = np.min(x, axis=-1)
    return low - np.log(np.sum(np.exp(-beta * (x - low[..., None])), axis=-1)) / beta


def smooth_outage(gamma, snr_min, alpha):
    """Eq. (26): sigmoid(alpha (1 - gamma / gamma_min))."""
    return sigmoid(alpha * (1.0 - gamma / snr_min))


def extended_log(x, end):
    """ln x, continued below `end` by its tangent (row "logarithm below e")."""
    above = np.log(np.maximum(x, end))
    return np.where(x >= end, above, np.log(end) + (x - end) / end)


def barrier_weight(eta):
    """eps_b + 1 / eta of Eq. (29)."""
    return RESIDUAL + 1.0 / eta


def log_end(weight):
    """min(0.02, w / 2): where the tangent begins (row "logarithm below e")."""
    return min(0.02, weight / 2.0)


def barrier(safe, comm, weight, world):
    """The second term of Eq. (29); "log(a / b^-1)" is read as a product (row "barrier")."""
    margins = safe - 1.0 + world.collision_tolerance, comm - 1.0 + world.outage_tolerance
    return -weight * sum(extended_log(margin, log_end(weight)) for margin in margins)
