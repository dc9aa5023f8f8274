"""Several vehicles of one base station, as a PettingZoo parallel environment."""

from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from . import _crpl
from .environment import Action, Actions, Obs, Observation, _executed, _model, _spaces
from .scenarios import Scenario, scenario, source
from .world import WorldModel

Scheduler = Literal["tdma", "round-robin", "predicted"]

_OTHER = 5
"""Numbers that a vehicle sees of each other one: whether it flies, place (2), velocity (2)."""


class FleetFlight(ParallelEnv[str, Observation, Action]):
    """Vehicles ``uav_0`` to ``uav_N-1`` on one base station; docs/python.md describes spaces, rewards and infos."""

    metadata = {"name": "crpl_fleet_v0", "render_modes": []}

    def __init__(
        self,
        of: Scenario = "demo",
        vehicles: int = 4,
        obs: Obs = "state",
        *,
        actions: Actions = "continuous",
        scheduler: Scheduler = "tdma",
        bandwidth: float | None = None,
        headway: int = 10,
        separation: bool = False,
        drawn: bool = False,
        collision_cost: float = 1.0,
        world: WorldModel | str = "learned",
    ) -> None:
        model = _model(obs, world)
        self.scenario = scenario(of)
        """All parameters of the flights."""
        self._fleet = _crpl.Fleet(
            source(self.scenario), obs, vehicles, scheduler, bandwidth, headway, separation, drawn, 0, model
        )
        self.possible_agents = [f"uav_{n}" for n in range(vehicles)]
        self.agents: list[str] = []
        self.collision_cost = collision_cost
        self.render_mode = None
        self._discrete = actions == "discrete"
        others = 0 if obs == "image" else _OTHER * (vehicles - 1)
        alone = self._fleet.width - others
        observed, executed = _spaces(self.scenario, obs, alone, self._discrete)
        if others:
            unbounded = np.full(others, np.inf, np.float32)
            observed = gymnasium.spaces.Box(
                np.concatenate([observed.low, -unbounded]), np.concatenate([observed.high, unbounded]), dtype=np.float32
            )
        self.observation_spaces = {
            agent: gymnasium.spaces.Box(observed.low, observed.high, dtype=observed.dtype.type)
            for agent in self.possible_agents
        }
        self.action_spaces = {agent: _copy(executed) for agent in self.possible_agents}
        self._shape = (vehicles, *(observed.shape if obs == "image" else (self._fleet.width,)))
        self._dtype: type[Any] = np.uint8 if obs == "image" else np.float32
        self._random, _ = seeding.np_random()

    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """What ``agent`` sees: its own flight in its own frame, then five numbers of each other vehicle."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """As of a single flight."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """A fleet before its first turn; with ``seed``, that of ``gcs fleet --first-seed``."""
        if seed is not None:
            self._random, _ = seeding.np_random(seed)
        fleet = int(self._random.integers(2**48)) if seed is None else seed
        self._fleet.reset(fleet)
        self.agents = list(self.possible_agents)
        airborne = self._fleet.airborne()
        infos = {agent: {"seed": fleet, "airborne": up} for agent, up in zip(self.agents, airborne)}
        return self._observations(), infos

    def step(
        self, actions: dict[str, Action]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One control interval of all. ``actions`` of vehicles that wait to leave are not flown."""
        if not self.agents:
            raise gymnasium.error.ResetNeeded("the flights are over, or have not begun: call reset()")
        numbers, flags = self._turn(actions)
        airborne = self._fleet.airborne()
        stepped = self.agents
        rewards: dict[str, float] = {}
        infos: dict[str, dict[str, Any]] = {}
        terminated: dict[str, bool] = {}
        truncated: dict[str, bool] = {}
        for agent in stepped:
            n = self._number(agent)
            terminated[agent], truncated[agent], flown, outage, collided, met = (bool(flag) for flag in flags[n])
            rewards[agent] = float(numbers[n, 0]) - self.collision_cost * met
            infos[agent] = {"airborne": airborne[n], "met": met}
            if flown:
                infos[agent] |= {
                    "snr_db": float(numbers[n, 1]),
                    "outage": outage,
                    "p_coll": float(numbers[n, 2]),
                    "collided": collided,
                }
            if terminated[agent] or truncated[agent]:
                infos[agent]["metrics"] = {key: column[0] for key, column in self._fleet.score(n).items()}
        observations = self._observations()
        self.agents = [agent for agent in stepped if not (terminated[agent] or truncated[agent])]
        return observations, rewards, terminated, truncated, infos

    def _turn(self, actions: dict[str, Action]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        wrong = set(actions) ^ set(self.agents)
        if wrong:
            raise ValueError(f"actions are wanted of {self.agents}, and of no others: see {sorted(wrong)}")
        count = len(self.possible_agents)
        all_actions = np.zeros((count, 3), np.float32)
        for agent, action in actions.items():
            all_actions[self._number(agent)] = _executed(np.asarray(action)[None], self._discrete)[0]
        numbers, flags = np.zeros((count, 3)), np.zeros((count, 6), np.uint8)
        self._fleet.step(all_actions, numbers, flags)
        return numbers, flags

    def _number(self, agent: str) -> int:
        return self.possible_agents.index(agent)

    def _observations(self) -> dict[str, Observation]:
        now: Observation = np.empty(self._shape, self._dtype)
        self._fleet.show(now)
        return {agent: now[self._number(agent)] for agent in self.agents}

    def encounters(self) -> tuple[int, float]:
        """Collisions of two vehicles so far, and the least distance of two, units (infinite of one)."""
        return self._fleet.encounters()

    def record_lines(self, agent: str) -> str:
        """The bytes of ``record.jsonl`` of a vehicle so far."""
        return self._fleet.records(self._number(agent))

    def render(self) -> None:
        """Nothing is drawn."""

    def close(self) -> None:
        """Nothing is held open."""


def _copy(space: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
    """A space with chance of its own."""
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return gymnasium.spaces.MultiDiscrete(space.nvec)
    return gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)


def make_fleet(of: Scenario = "demo", vehicles: int = 4, obs: Obs = "state", **options: Any) -> FleetFlight:
    """A fleet in a scenario; options as of :class:`FleetFlight`."""
    return FleetFlight(of, vehicles, obs, **options)
