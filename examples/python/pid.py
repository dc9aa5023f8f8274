"""A PD controller of yours, scored beside CRPL and RCC on the same seeds: python examples/python/pid.py"""

import sys

import numpy as np

import crpl

GOAL = np.array(crpl.scenario("demo")["goal"])
WAY = np.array([0.5, 0.25])  # below the obstacle, in sight of the base station


class Pd:
    """Flies by way of a point to the goal; high power where the link was weak."""

    batched = False

    def reset(self):
        self.passed = False

    def __call__(self, observation):
        place, speed, snr_db = observation[:2], observation[2:4], observation[4]
        self.passed = self.passed or place[0] > WAY[0] - 0.1
        error = (GOAL if self.passed else WAY) - place
        wish = 12.0 * error - 2.5 * speed
        return np.array([*np.clip(wish, -1, 1), 1.0 if snr_db < 3.0 else -1.0], np.float32)


def main():
    flights = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    table = crpl.evaluate(Pd(), "demo", range(flights), against=["crpl", "rcc"], name="pd")
    print(table.loc[(slice(None), ["reached", "d_f", "e_comm", "p_coll_max", "t_out", "j"]), :].round(3).to_string())


if __name__ == "__main__":
    main()
