"""Stable-Baselines3's PPO on the state, trained for a minute, scored beside CRPL: python examples/python/ppo.py

pip install stable-baselines3 (and PyTorch).
"""

import sys
import time

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

import crpl


class Flights(VecEnv):
    """crpl's flights as Stable-Baselines3 names them."""

    def __init__(self, count):
        self.flights = crpl.make_vec("demo", count, autoreset_mode="SameStep")
        super().__init__(count, self.flights.single_observation_space, self.flights.single_action_space)

    def reset(self):
        return self.flights.reset(seed=0)[0]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        now, rewards, terminated, truncated, more = self.flights.step(self.actions)
        over = terminated | truncated
        infos = [{} for _ in range(self.num_envs)]
        for n in np.flatnonzero(over):
            infos[n] = {"terminal_observation": more["final_obs"][n], "TimeLimit.truncated": bool(truncated[n])}
        return now, 100 * rewards.astype(np.float32), over, infos

    def close(self):
        self.flights.close()

    def get_attr(self, name, indices=None):
        return [getattr(self.flights, name, None)] * self.num_envs

    set_attr = env_method = lambda self, *args, **options: None

    def env_is_wrapped(self, wrapper, indices=None):
        return [False] * self.num_envs


class Until(BaseCallback):
    """Stops the training at a time."""

    def __init__(self, end):
        super().__init__()
        self.end = end

    def _on_step(self):
        return time.monotonic() < self.end


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60
    agent = PPO("MlpPolicy", Flights(64), n_steps=100, batch_size=1600, learning_rate=1e-3, gamma=0.98, seed=0, device="cpu")
    agent.learn(10**9, callback=Until(time.monotonic() + seconds))
    print(f"{agent.num_timesteps:,} steps in {seconds:.0f} s")
    print(crpl.evaluate(agent, "demo", range(1000, 1050), against=["crpl", "rcc"], name="ppo").round(3).to_string())
