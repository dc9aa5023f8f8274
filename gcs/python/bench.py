"""Environment steps a second on one core, beside peers in the same run: python gcs/python/bench.py

A peer that is not installed is left out, and that is said. Figures are medians of the rounds: steps a second of the
wall's time, and of the processor's time, which other programs on the machine do not take away.
"""

import argparse
import os
import statistics
import time

os.environ["SCIPY_ARRAY_API"] = "1"  # crazyflow refuses a SciPy that was imported without it

import gymnasium  # noqa: E402
import numpy as np  # noqa: E402

import crpl  # noqa: E402


def rates(step, flights, seconds, rounds):
    """Medians over the rounds of environment steps a second, of the wall's and of the processor's time."""
    wall, cpu = [], []
    for _ in range(rounds):
        begin, used, count = time.perf_counter(), time.process_time(), 0
        while time.perf_counter() - begin < seconds:
            step()
            count += flights
        wall.append(count / (time.perf_counter() - begin))
        cpu.append(count / (time.process_time() - used))
    return statistics.median(wall), statistics.median(cpu)


def vector(obs, flights, **options):
    env = crpl.make_vec("demo", flights, obs, **options)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (flights, 3)).astype(np.float32)
    return lambda: env.step(actions)


def single(env, action):
    env.reset(seed=0)

    def step():
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return step


def cartpole(flights):
    env = gymnasium.make_vec("CartPole-v1", num_envs=flights, vectorization_mode="vector_entry_point")
    env.reset(seed=0)
    actions = np.zeros(flights, np.int64)
    return lambda: env.step(actions)


def pybullet():
    from gym_pybullet_drones.envs.HoverAviary import HoverAviary

    env = HoverAviary()
    return single(env, np.zeros(env.action_space.shape, np.float32))


def crazyflow(flights):
    import jax
    from crazyflow.sim import Sim

    sim = Sim(n_worlds=flights, device="cpu")
    sim.reset()

    def step():
        sim.step()
        # JAX computes on while Python goes on.
        jax.block_until_ready(sim.data)

    return step


def pyflyt():
    import PyFlyt.gym_envs  # noqa: F401

    env = gymnasium.make("PyFlyt/QuadX-Hover-v1")
    return single(env, np.zeros(env.action_space.shape, np.float32))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", metavar="TEXT", help="only rows whose name contains it")
    args = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[0]})
    motionless = np.zeros(3, np.float32)
    rows = [
        ("crpl, state, 256 flights", 256, lambda: vector("state", 256)),
        ("crpl, image, 64 flights", 64, lambda: vector("image", 64)),
        ("crpl, image, 64 flights, copy=False", 64, lambda: vector("image", 64, copy=False)),
        ("crpl, latent, 64 flights", 64, lambda: vector("latent", 64)),
        ("crpl, state, one flight", 1, lambda: single(crpl.make("demo"), motionless)),
        ("gymnasium CartPole-v1, vectorised, 256", 256, lambda: cartpole(256)),
        ("gymnasium CartPole-v1, one", 1, lambda: single(gymnasium.make("CartPole-v1"), 0)),
        ("gym-pybullet-drones HoverAviary, one", 1, pybullet),
        ("PyFlyt QuadX-Hover-v1, one", 1, pyflyt),
        ("crazyflow Sim.step, CPU, 256 worlds", 256, lambda: crazyflow(256)),
    ]
    print(f"one core, {args.rounds} rounds of {args.seconds} s, revision {crpl.revision()}")
    for name, flights, make in rows:
        if args.only not in name:
            continue
        try:
            step = make()
        except ImportError as error:
            print(f"{name:<42} not installed ({error.name})")
            continue
        step()
        wall, cpu = rates(step, flights, args.seconds, args.rounds)
        print(f"{name:<42} {wall:>12,.0f} steps/s {cpu:>12,.0f} steps/CPU s", flush=True)


if __name__ == "__main__":
    main()
