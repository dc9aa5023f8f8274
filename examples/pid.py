#!/usr/bin/env python3
"""A PID controller in Python, scored beside CRPL:

    gcs episodes --controller crpl,"exec:python3 examples/pid.py"

One line of JSON comes in and one goes out per control interval; docs/own-controller.md describes them. It
sees what CRPL sees: places that the world model reads in the camera's frames, and the radio.
"""

import argparse
import json
import sys


class Pid:
    """A PID on the way to the goal, round obstacles, with power that follows the radio."""

    def __init__(self, hello, gains):
        self.hello, self.gains = hello, gains
        self.integral = [0.0, 0.0]

    def reset(self):
        self.integral = [0.0, 0.0]

    def decide(self, percept):
        kp, ki, kd = self.gains
        belief = percept["belief"]
        place, speed = belief["position"], belief["velocity"]
        aim = self.aim(place, belief["obstacles"])
        wish = []
        for axis in range(2):
            # A far aim asks for no more than a near one: the UAV is to come to rest in the goal.
            error = max(-0.25, min(0.25, aim[axis] - place[axis]))
            self.integral[axis] = max(-1.0, min(1.0, self.integral[axis] + error))
            wish.append(kp * error + ki * self.integral[axis] - kd * speed[axis])
        # Physical accelerations become parts of a_max; gcs flies the nearest of the five motions.
        return [part / self.hello["a_max"] for part in wish], self.power(percept["link"])

    def aim(self, place, obstacles):
        """The goal, or a place south of an obstacle that is in the way."""
        goal = self.hello["goal"]
        for obstacle, radius in zip(obstacles, self.hello["obstacle_radii"]):
            near = radius + self.hello["uav_radius"]
            ahead = (obstacle[0] + near - place[0]) * (goal[0] - place[0]) > 0
            between = min(place[1], goal[1]) - near < obstacle[1] < max(place[1], goal[1]) + near
            if ahead and between and abs(goal[0] - place[0]) > abs(goal[0] - obstacle[0]) - near:
                # Beyond it, so that it does not come to rest there.
                return [obstacle[0] + near + 0.1, obstacle[1] - near - 0.14]
        return goal

    def power(self, link):
        """High power while the last packet was lost, or nearly."""
        if link is None:
            return 1
        snr = 10 ** (link["snr_db"] / 10) / link["power"]
        needed = 2 ** (self.hello["packet_bits"] / self.hello["b_dt"]) - 1
        return 1 if snr > 1.5 * needed else 4


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gains", type=float, nargs=3, default=[0.03, 0.0, 0.4], metavar=("KP", "KI", "KD"))
    gains = parser.parse_args().gains
    pid = None
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "hello":
            pid = Pid(message, gains)
            answer = {"version": 1}
        elif message["type"] == "reset":
            pid.reset()
            continue
        else:
            wish, power = pid.decide(message)
            answer = {"tick": message["tick"], "wish": wish, "power": power}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
