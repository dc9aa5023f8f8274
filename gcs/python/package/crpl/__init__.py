"""A UAV that a base station flies over a fading radio link: environments, scores, and a world model.

>>> import crpl
>>> env = crpl.make("demo")
>>> observation, info = env.reset(seed=0)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
"""

from importlib.metadata import version as _version

from ._crpl import revision
from .environment import Flight, FlightVector, make, make_vec
from .evaluation import compare, evaluate, fly, metrics, score
from .recording import Run, read_run, record_dataset
from .scenarios import Scenario, presets, scenario
from .world import LatentObserver, Policy, WorldModel

__version__ = _version("crpl")

__all__ = [
    "Flight",
    "FlightVector",
    "LatentObserver",
    "Policy",
    "Run",
    "Scenario",
    "WorldModel",
    "compare",
    "evaluate",
    "fly",
    "make",
    "make_vec",
    "metrics",
    "presets",
    "read_run",
    "record_dataset",
    "revision",
    "scenario",
    "score",
]
