"""Writes the golden vectors of tests/golden, or compares with them.

    generate.py --out tests/golden      # regenerates
    generate.py --check                 # compares with tests/golden
    generate.py --recompute FOLDER      # compares with other vectors, from their inputs

`--check` prints a line for each file and ends with 1 if one differs. `--recompute` takes the inputs, the
parameters and the policies' weights from FOLDER's files in place of inputs.py, so it judges vectors that
somebody else made.
"""

import argparse
import json
import pathlib
import sys
from dataclasses import replace

import numpy as np

import compare
import controllers
import inputs
import objective
import world as w
from fly import GOLDEN, fly, metrics

PARAMETERS = {
    "H": "horizon", "start": "start", "goal": "goal", "goal_radius": "goal_radius", "bs": "base_station",
    "v_max": "v_max", "a_max": "a_max", "G0": "reference_gain", "alpha_pl": "path_loss_exponent",
    "kappa_nlos": "nlos_attenuation", "gamma_min": "snr_min", "L_pkt": "packet_bits", "d_min": "d_min",
    "delta1": "collision_tolerance", "delta2": "outage_tolerance", "P0": "blade_profile_power",
    "Pi": "induced_power", "U_tip": "tip_speed", "v0": "hover_induced_velocity",
    "d0": "fuselage_drag_ratio", "rho": "air_density", "s_rotor": "rotor_solidity",
    "A_rotor": "rotor_area", "P_n": "noise_power", "R_o": "obstacle_radius", "R_u": "uav_radius",
    "tau_b": "blockage_softness", "tau_c": "collision_softness", "m_per_unit": "metres_per_unit",
    "s_per_step": "interval_s", "d_floor": "distance_floor", "box": "walls",
}  # fmt: skip
"""The names of the files and those of world.World."""

TOLERANCE = 1e-9


def params_of(world):
    """The parameters as a golden file names them."""
    values = {key: getattr(world, name) for key, name in PARAMETERS.items()}
    return {key: list(x) if isinstance(x, tuple) else x for key, x in values.items()}


def world_of(params):
    """The world of a file's parameters."""
    return w.World(**{PARAMETERS[key]: value for key, value in params.items()})


def dynamics_step(case, world):
    """Eq. (30)."""
    walled = replace(world, walls=case["box"])
    gust = case["sigma_c"] * np.array(case["w"])
    r, v = w.step(np.array(case["r"]), np.array(case["v"]), case["a"], gust, walled)
    return {"r_next": r, "v_next": v}


def channel(case, world):
    """Sec. IV-A3, Eq. (12), and the ground-truth risk."""
    world, r = replace(world, obstacle=tuple(case["r_u"])), np.array(case["r"])
    return {
        "d": w.norm(r - np.array(world.base_station)),
        "h_los_sq": w.sight_gain(r, world),
        "d_seg": w.sight_line_distance(r, world),
        "p_block": w.blockage(r, world),
        "h_sq": w.gain(r, world),
        "snr": w.snr(r, case["a_p"], world),
        "clearance": w.clearance(r, world),
        "p_coll": w.collision_probability(r, world),
    }


def outage(case, world):
    """Sec. IV-A4."""
    return {
        "bits": w.bits(case["B_dt"], case["snr"]),
        "outage": bool(w.outage(case["B_dt"], case["snr"], world)),
        "gamma_out": w.outage_snr(case["B_dt"], world),
    }


def propulsion(case, world):
    """Sec. IV-A6; a case has its speed in m/s or in units per interval."""
    v = w.metres_per_second(case["v_units"], world) if "v_units" in case else case["v_mps"]
    return {"v_mps": v, "P": w.propulsion_power(v, world)}


def nearest_action(case, world):
    """Sec. IV-A1."""
    index = controllers.nearest_action(case["a"])
    return {"idx": index, "action": controllers.ACTIONS[index]}


def softmin(case, world):
    """Eq. (23)."""
    return {"softmin": objective.soft_minimum(np.array(case["x"]), case["beta"])}


def p_out(case, world):
    """Eq. (26)."""
    return {"p_out": objective.smooth_outage(case["snr"], case["gamma_min"], case["alpha"])}


def log_ext(case, world):
    """Row "logarithm below e" of docs/choices.md."""
    return {"y": objective.extended_log(case["x"], case["eps"])}


def barrier(case, world):
    """The second term of Eq. (29)."""
    value = objective.barrier(case["P_safe"], case["P_comm"], case["w"], world)
    return {"eps": objective.log_end(case["w"]), "barrier": value}


TABLES = {
    "dynamics_step": (
        dynamics_step,
        "r v a w sigma_c box",
        "Eq. (30), speed first: v' = limit(v + a_max a + sigma_c w, v_max), r' = r + v'; with box, r' is"
        " clipped to [0, 1]^2 and the speed out of a side that r' exceeded is 0",
    ),
    "channel": (
        channel,
        "r r_u a_p",
        "h_los_sq = G0 max(d, d_floor)^-alpha_pl; d_seg = distance of r_u to the segment from bs to r;"
        " p_block = sigmoid((R_o - d_seg) / tau_b); h_sq = ((1 - p_block) + p_block kappa_nlos) h_los_sq;"
        " snr = h_sq a_p / P_n; clearance = |r - r_u| - R_o - R_u;"
        " p_coll = sigmoid((d_min - clearance) / tau_c)",
    ),
    "outage": (
        outage,
        "snr B_dt",
        "bits = B_dt log2(1 + snr); outage if bits < L_pkt, strictly; gamma_out = 2^(L_pkt / B_dt) - 1."
        " Within 1e-9 of the threshold compare bits, not the flag",
    ),
    "propulsion": (
        propulsion,
        "v_mps v_units",
        "P(V) = P0 (1 + 3 V^2 / U_tip^2) + Pi (sqrt(1 + V^4 / (4 v0^4)) - V^2 / (2 v0^2))^0.5"
        " + 0.5 d0 rho s A V^3, V in m/s",
    ),
    "nearest_action": (
        nearest_action,
        "a",
        "index in A_s = [[0,0],[1,0],[-1,0],[0,1],[0,-1]]; Euclidean nearest, ties to the lowest index",
    ),
    "softmin": (softmin, "x beta", "Eq. (23): -(1 / beta) ln sum exp(-beta x)"),
    "p_out": (p_out, "snr gamma_min alpha", "Eq. (26): sigmoid(alpha (1 - snr / gamma_min))"),
}
"""Answer, names of the inputs, and definition of each table."""


def plain(x):
    """Arrays and numpy's numbers as JSON writes them."""
    if isinstance(x, dict):
        return {key: plain(value) for key, value in x.items()}
    if isinstance(x, list):
        return [plain(value) for value in x]
    return x.tolist() if isinstance(x, (np.ndarray, np.generic)) else x


def answered(cases, names, answer, world):
    """Each case's inputs, and what the reference makes of them."""
    taken = [{key: case[key] for key in names.split() if key in case} for case in cases]
    return [plain(case | answer(case, world)) for case in taken]


def table(name, given):
    """A table of cases of one pure function."""
    answer, names, doc = TABLES[name]
    params = given["params"] if given else params_of(w.World())
    cases = given["cases"] if given else getattr(inputs, name)()
    if name == "propulsion":
        cases = [{k: v for k, v in c.items() if k != "v_mps" or "v_units" not in c} for c in cases]
    return {
        "doc": doc,
        "params": params,
        "tol": TOLERANCE,
        "cases": answered(cases, names, answer, world_of(params)),
    }


def log_barrier(given):
    """The barrier and its logarithm."""
    world = w.World()
    logs = given["cases"] if given else inputs.log_ext()
    barriers = given["barrier_cases"] if given else inputs.barrier()
    return {
        "doc": "y = ln x for x >= eps, else ln eps + (x - eps) / eps; barrier ="
        " -w (y(P_safe - 1 + delta1) + y(P_comm - 1 + delta2)), w = eps_b + 1 / eta, eps = min(0.02, w / 2),"
        " eps_b 1e-4, deltas 0.05",
        "tol": TOLERANCE,
        "cases": answered(logs, "x eps", log_ext, world),
        "barrier_cases": answered(barriers, "P_safe P_comm w", barrier, world),
    }


def scores(flight, world):
    """The metrics of a golden flight: T_out in seconds, N_out in intervals."""
    m = metrics(flight, world)
    r = np.array(flight.r)
    return m | {
        "T_out": m["T_out"] * world.interval_s,
        "N_out": m["T_out"],
        "N_viol": float(np.sum(np.array(flight.snr) < world.snr_min)),
        "dmin_goal": np.min(w.norm(r - np.array(world.goal))),
        "y_mid": r[np.argmin(np.abs(r[:, 0] - 0.5)), 1],
    }


def trace(case, world):
    """A flight without gusts, with packet loss (Sec. IV-A4)."""
    world = replace(world, obstacle=w.OBSTACLES[case["scenario"]])
    made = {"RCC": controllers.rcc, "UCC": controllers.ucc, "APC": controllers.Apc}[case["controller"]]
    flight = fly(made(world), world, case["B_dt"], np.zeros((world.horizon, 2)))
    return {
        "sigma_c": 0.0,
        "metrics": scores(flight, world),
        "r_u": list(world.obstacle),
        "r": flight.r,
        "v": flight.v,
        "a_commanded": flight.asked,
        "a_applied": flight.flown,
        "a_p": flight.power,
        "snr": flight.snr,
        "outage": flight.outage,
        "p_coll": flight.p_coll,
    }


def closed_loop(given):
    """Flights of RCC, UCC and APC."""
    params = given["params"] if given else params_of(w.World())
    flights = given["traces"] if given else inputs.flights()
    return {
        "doc": "flights without gusts, H = 100; order in a step: observe, choose, SNR from r_k and a_p,"
        " outage -> hold, dynamics; p_coll[k] at r_{k+1}. APC's search has ties that the last bit of an"
        " exponential decides: compare its first 19 steps to 1e-9, then positions to 0.05 and d_f to 0.02",
        "params": params,
        "traces": answered(flights, "scenario controller B_dt", trace, world_of(params)),
    }


def policy(name, given):
    """Outputs of the policies on states of their own flight, and the flight; the weights are kept."""
    world = w.scenario(name[-2:].upper())
    weights = given or json.loads((GOLDEN / f"{name}.json").read_text())
    crpl = controllers.Crpl(world, weights["pi_s"], weights["pi_p"])
    flight = fly(crpl, world, None, np.zeros((world.horizon, 2)))
    before = [flight.r[0], *flight.r]
    xs = [controllers.features(flight.r[k], before[k], world) for k in range(0, 60, 3)]
    return plain({
        "doc": "policies of Algorithm 1 on the true state; layers x @ W + b, tanh hidden, softmax output;"
        " input x = [2 (r_k - 0.5), (r_k - r_{k-1}) / v_max, 2 (r_u - 0.5)], r_{-1} = r_0; a_s = the action"
        " nearest to sum pi_s A_s; a_p = 4 if sum pi_p A_p > 2.5. Weights are float32 values, probabilities"
        " float64; the cases are states of the flight, every third",
        "r_u": list(world.obstacle),
        "pi_s": weights["pi_s"],
        "pi_p": weights["pi_p"],
        "cases": [{"x": x, "pi_s": crpl.motion(x), "pi_p": crpl.power(x)} for x in xs],
        "metrics_noise_free": scores(flight, world),
        "trajectory": flight.r,
        "a_p": flight.power,
    })  # fmt: skip


def files():
    """How each file is made: of what is given in a file of that name, or of inputs.py."""
    made = {name: (lambda given, name=name: table(name, given)) for name in TABLES}
    made |= {"log_barrier": log_barrier, "closed_loop": closed_loop}
    policies = ("policy_s1", "policy_s2")
    return made | {name: (lambda given, name=name: policy(name, given)) for name in policies}


def write(folder):
    """Writes every file; tables with a value a line, flights and weights compact."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in files().items():
        indent = 1 if name in TABLES or name == "log_barrier" else None
        text = json.dumps(make(None), indent=indent)
        (folder / f"{name}.json").write_text(text + "\n")
        print(f"{folder / name}.json")


def checked(folder, recompute):
    """Compares each file of `folder` and prints a line; whether all agree."""
    agree = True
    for name, make in files().items():
        try:
            golden = json.loads((folder / f"{name}.json").read_text())
            print(f"{name}: agrees, {compare.file(make(golden if recompute else None), golden)}")
        except (compare.Difference, OSError, ValueError, KeyError, TypeError) as difference:
            print(f"{name}: DIFFERS, {difference}")
            agree = False
    return agree


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=pathlib.Path, help="write the files into this folder")
    what.add_argument("--check", action="store_true", help="compare with tests/golden")
    what.add_argument("--recompute", type=pathlib.Path, help="compare with a folder, from its inputs")
    args = parser.parse_args()
    if args.out:
        write(args.out)
        return 0
    return 0 if checked(args.recompute or GOLDEN, args.recompute is not None) else 1


if __name__ == "__main__":
    sys.exit(main())
