"""Flies the paper's controllers in Scenario 1 or 2 and prints the metrics of Sec. IV-A6.

    /usr/bin/python3 tests/python/reference/fly.py --scenario 2
    /usr/bin/python3 tests/python/reference/fly.py --controller rcc-paper --b-dt 2.5 --gust-std 0.0015

Without gusts there is one flight. With gusts every controller meets those of the seeds S, S + 1, ... Means
over the flights are printed; T_out is in control intervals.
"""

import argparse
import json
import pathlib
from dataclasses import dataclass, field

import numpy as np

import controllers
from controllers import PLAIN_GAINS
from world import (
    collision_probability,
    metres_per_second,
    norm,
    outage,
    propulsion_power,
    scenario,
    snr,
    step,
)

GOLDEN = pathlib.Path(__file__).resolve().parents[2] / "golden"


@dataclass
class Flight:
    """What was asked, what was flown and what came of it; r has one entry more than the others."""

    r: list = field(default_factory=list)
    v: list = field(default_factory=list)
    asked: list = field(default_factory=list)
    flown: list = field(default_factory=list)
    power: list = field(default_factory=list)
    snr: list = field(default_factory=list)
    outage: list = field(default_factory=list)
    p_coll: list = field(default_factory=list)
    moved_at: list = field(default_factory=list)
    """Speeds after each interval, v_1..v_H."""


def fly(controller, world, b_dt, gusts):
    """The closed loop of Sec. IV-A4: observe, decide, transmit, move. `gusts` is [H, 2], changes of speed.

    In an outage the last action received is held, at first (0, 0) (rows "packet loss elsewhere" and "held
    action"). `b_dt` None means that no packet is lost (row "packet loss in the trajectory figures").
    """
    flight = Flight()
    r, v, held, link = np.array(world.start), np.zeros(2), np.zeros(2), None
    before = r
    for gust in gusts:
        asked, power = controller.decide(r, v, before, link)
        gamma = float(snr(r, power, world))
        lost = b_dt is not None and bool(outage(b_dt, gamma, world))
        held = held if lost else asked
        before, link = r, (gamma, power)
        flight.r.append(r)
        flight.v.append(v)
        flight.asked.append(asked)
        flight.flown.append(held)
        flight.power.append(power)
        flight.snr.append(gamma)
        flight.outage.append(lost)
        r, v = step(r, v, held, gust, world)
        flight.moved_at.append(v)
        flight.p_coll.append(float(collision_probability(r, world)))
    flight.r.append(r)
    return flight


def metrics(flight, world):
    """The metrics of Sec. IV-A6 by name; T_out in control intervals (section 1 of docs/choices.md)."""
    speed = metres_per_second(norm(np.array(flight.moved_at)), world)
    return {
        "d_f": float(norm(flight.r[-1] - np.array(world.goal))),
        "E_comm": float(np.sum(flight.power)),
        "E_ctrl": float(np.sum(propulsion_power(speed, world)) * world.interval_s),
        "p_coll_max": max(flight.p_coll),
        "T_out": float(np.sum(flight.outage)),
    }


def policy_file(name):
    """The golden policies of Scenario "S1" or "S2"."""
    return json.loads((GOLDEN / f"policy_{name.lower()}.json").read_text())


def controller(name, world, scenario_name, gains):
    """A new controller by its name on the command line."""
    if name == "crpl":
        file = policy_file(scenario_name)
        return controllers.Crpl(world, file["pi_s"], file["pi_p"])
    if name == "apc":
        return controllers.Apc(world)
    return {"rcc-paper": controllers.rcc, "ucc-paper": controllers.ucc}[name](world, gains)


NAMES = ["crpl", "apc", "rcc-paper", "ucc-paper"]


def gusts_of(args, world):
    """One list of gusts [H, 2] a flight (row `disturbance.gust_scale`)."""
    if args.gust_std == 0.0:
        return [np.zeros((world.horizon, 2))]
    drawn = (np.random.default_rng(args.first_seed + n) for n in range(args.flights))
    return [args.gust_std * rng.standard_normal((world.horizon, 2)) for rng in drawn]


def arguments():
    def names(text):
        chosen = text.split(",")
        for name in chosen:
            if name not in NAMES:
                raise argparse.ArgumentTypeError(f"{name} is none of {', '.join(NAMES)}")
        return chosen

    def positive(text):
        value = float(text)
        if not value > 0.0:
            raise argparse.ArgumentTypeError(f"{text} is not above 0")
        return value

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--scenario", choices=["1", "2"], default="2")
    add("--controller", type=names, default=NAMES, help="one or more of " + ",".join(NAMES))
    add("--b-dt", type=positive, help="B dt in bits per unit of log2(1 + SNR); without it no packet is lost")
    add("--gust-std", type=float, default=0.0, help="per axis and interval, in units per interval")
    add("--flights", type=int, default=100, help="with gusts")
    add("--first-seed", type=int, default=0)
    pair = ("POSITION", "SPEED")
    add("--gains", type=float, nargs=2, default=PLAIN_GAINS, metavar=pair, help="of rcc-paper and ucc-paper")
    args = parser.parse_args()
    if args.flights < 1 or args.first_seed < 0 or not args.gust_std >= 0.0:
        parser.error("--flights must be at least 1, --first-seed and --gust-std at least 0")
    return args


def row(name, args, world, gusts):
    """A controller's line: the share of flights that reached the goal, and the means of the metrics."""
    scenario_name = f"S{args.scenario}"
    flights = (fly(controller(name, world, scenario_name, args.gains), world, args.b_dt, g) for g in gusts)
    scores = [metrics(flight, world) for flight in flights]
    m = {key: np.mean([score[key] for score in scores]) for key in scores[0]}
    reached = np.mean([score["d_f"] <= world.goal_radius for score in scores])
    return (
        f"{name:<10} {reached:7.3f} {m['d_f']:8.4f} {m['E_comm']:7.1f} {m['E_ctrl']:8.0f} "
        f"{m['p_coll_max']:10.4f} {m['T_out']:6.2f}"
    )


def main():
    args = arguments()
    world = scenario(f"S{args.scenario}")
    gusts = gusts_of(args, world)
    loss = f"B dt {args.b_dt}" if args.b_dt else "no packet lost"
    print(f"Scenario {args.scenario}, {loss}, gust std {args.gust_std}, flights {len(gusts)}")
    print("controller reached      d_f  E_comm   E_ctrl p_coll_max  T_out")
    for name in args.controller:
        print(row(name, args, world, gusts), flush=True)


if __name__ == "__main__":
    main()
