"""The inputs of the golden vectors: chosen edge cases, and random ones from seeds that are the files' names.

`random.Random(text).random()` gives the same numbers in all versions of Python.
"""

import random

from objective import barrier_weight

CHOSEN = [
    # r, v, a, w, sigma_c: from rest, at the speed limit, over each wall, in a corner
    ((0.1, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 0.0), 0.0),
    ((0.5, 0.5), (0.04, 0.0), (1.0, 0.0), (0.0, 0.0), 0.0),
    ((0.5, 0.5), (0.03, 0.04), (0.0, 1.0), (0.0, 0.0), 0.0),
    ((0.5, 0.5), (0.0399, 0.0), (1.0, 0.0), (0.0, 0.0), 0.0),
    ((0.99, 0.5), (0.04, 0.01), (1.0, 0.0), (0.3, -0.2), 0.002),
    ((0.01, 0.99), (-0.03, 0.02), (0.0, 1.0), (-1.0, 1.0), 0.01),
    ((0.5, 0.5), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0.01),
    ((0.2, 0.3), (0.01, -0.02), (0.0, -1.0), (1.5, -0.7), 0.005),
    ((0.0, 0.0), (-0.01, -0.01), (-1.0, 0.0), (0.0, 0.0), 0.0),
]


def _uniform(rng, low, high):
    return low + (high - low) * rng.random()


def _pair(rng, low, high):
    return [_uniform(rng, low, high), _uniform(rng, low, high)]


def dynamics_step():
    """Each case with and without walls."""
    rng = random.Random("dynamics_step")
    actions = ([0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0])
    cases = [tuple(list(x) if isinstance(x, tuple) else x for x in case) for case in CHOSEN]
    for _ in range(24):
        action, sigma = actions[int(5 * rng.random())], (0.0, 0.001, 0.01)[int(3 * rng.random())]
        cases.append((_pair(rng, 0, 1), _pair(rng, -0.05, 0.05), action, _pair(rng, -2.5, 2.5), sigma))
    keys = ("r", "v", "a", "w", "sigma_c")
    return [dict(zip(keys, case), box=box) for case in cases for box in (True, False)]


def channel():
    """Positions around the obstacles of both scenarios, at the base station, and random ones."""
    low, high = [0.5, 0.3], [0.5, 0.45]
    cases = [
        ([0.5, 0.5], low), ([0.1, 0.5], low), ([0.9, 0.5], high), ([0.5, 0.6], high), ([0.5, 0.25], high),
        ([0.5, 0.05], low), ([0.35, 0.5], low), ([0.65, 0.5], low), ([0.5, 0.051], high), ([0.5, 0.3], low),
    ]  # fmt: skip
    rng = random.Random("channel")
    cases += [(_pair(rng, 0, 1), _pair(rng, 0.2, 0.8)) for _ in range(40)]
    return [{"r": r, "r_u": r_u, "a_p": a_p} for r, r_u in cases for a_p in (1.0, 4.0)]


def outage():
    """SNRs on, beside and away from the threshold of each B dt."""
    snrs = (0.0, 0.1, 1 / 3, 0.5, 0.999999999999, 1.0, 1.5, 2.0, 2.3, 3.0, 10.0)
    return [{"snr": snr, "B_dt": b_dt} for snr in snrs for b_dt in (2.0, 2.3, 2.5, 3.0, 4.0, 6.0, 12.0)]


def propulsion():
    """Speeds in m/s, and in units per interval up to v_max."""
    speeds = (0, 0.5, 1, 2, 4, 6, 8, 10, 10.2, 12, 15, 18, 20, 25, 30, 40, 60)
    units = (0, 0.001, 0.0035, 0.01, 0.02, 0.03, 0.04)
    return [{"v_mps": float(v)} for v in speeds] + [{"v_units": float(v)} for v in units]


def softmin():
    """All safe, one step at the tolerance, random, short, and a single step."""
    rng = random.Random("softmin")
    cases = []
    for beta in (1.0, 10.0, 100.0, 500.0):
        random_long = [_uniform(rng, 0.5, 1.0) for _ in range(100)]
        random_short = [rng.random() for _ in range(7)]
        lists = ([1.0] * 100, [0.95] + [1.0] * 99, random_long, random_short, [0.3])
        cases += [{"x": x, "beta": beta} for x in lists]
    return cases


def p_out():
    """SNRs around gamma_min for four slopes."""
    snrs = (0, 0.2, 0.5, 0.9, 1, 1.1, 1.5, 2, 2.76, 5, 11, 400)
    slopes = (1.0, 3.0, 5.0, 10.0)
    return [{"snr": float(g), "gamma_min": 1.0, "alpha": alpha} for alpha in slopes for g in snrs]


def nearest_action():
    """Random wishes, and ties."""
    rng = random.Random("nearest_action")
    chosen = ([0.5, 0.0], [0.0, 0.0], [0.5, 0.5], [0.51, 0.2], [-0.6, -0.6])
    return [{"a": a} for a in [_pair(rng, -1, 1) for _ in range(40)] + list(chosen)]


def log_ext():
    """Above, at and below the end of the logarithm."""
    xs = (-0.9, -0.05, -0.001, 0.0, 1e-5, 1e-4, 0.001, 0.005, 0.01, 0.03, 0.05)
    return [{"x": x, "eps": eps} for eps in (1e-4, 1e-3, 1e-2) for x in xs]


def barrier():
    """Feasible and infeasible estimates at the first, second and last eta."""
    estimates = ((0.99, 0.99), (0.96, 0.951), (0.9, 0.99), (0.99, 0.5), (1.0, 0.96))
    weights = [barrier_weight(eta) for eta in (1.0, 2.0, 512.0)]
    return [{"P_safe": safe, "P_comm": comm, "w": weight} for weight in weights for safe, comm in estimates]


def flights():
    """RCC and UCC at three bandwidths and APC at one, in both scenarios."""
    reactive = [(name, b_dt) for name in ("RCC", "UCC") for b_dt in (2.5, 4.0, 12.0)]
    return [
        {"scenario": s, "controller": name, "B_dt": b_dt}
        for s in ("S1", "S2")
        for name, b_dt in reactive + [("APC", 4.0)]
    ]
