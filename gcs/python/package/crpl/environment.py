"""Gymnasium environments: one flight, and many that are stepped in one call."""

import json
from collections.abc import Sequence
from typing import Any, Literal, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import _crpl
from .scenarios import Scenario, scenario, source
from .world import WorldModel

Obs = Literal["state", "latent", "image"]
Actions = Literal["continuous", "discrete"]
Observation = NDArray[Any]
Action = NDArray[Any]

_MOTIONS = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=np.float32)
"""The paper's motions, in the order of its policies."""


def _spaces(
    parameters: dict[str, Any], obs: Obs, width: int, discrete: bool
) -> tuple[gymnasium.spaces.Box, gymnasium.Space[Any]]:
    action: gymnasium.Space[Any]
    if discrete:
        action = gymnasium.spaces.MultiDiscrete([5, 2])
    else:
        action = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
    if obs == "image":
        return gymnasium.spaces.Box(0, 255, (100, 100, 3), np.uint8), action
    low, high = np.full(width, -np.inf, np.float32), np.full(width, np.inf, np.float32)
    if obs == "state":
        # A rounding beyond the largest speed.
        low[2:4], high[2:4] = -1.0001, 1.0001
        if parameters["dynamics"]["walls"]:
            low[:2], high[:2] = 0.0, 1.0
    # Power, outage, share of the horizon.
    low[5:8], high[5:8] = (1.0, 0.0, 0.0), (4.0, 1.0, 1.0)
    return gymnasium.spaces.Box(low, high, dtype=np.float32), action


def _executed(actions: Action, discrete: bool) -> NDArray[np.float32]:
    """Actions as the compiled part takes them: [n, 3]."""
    if not discrete:
        return np.ascontiguousarray(actions, dtype=np.float32)
    power = np.where(actions[:, 1] > 0, 1.0, -1.0)[:, None]
    return np.concatenate([_MOTIONS[actions[:, 0]], power], axis=1, dtype=np.float32)


def _model(obs: Obs, world: WorldModel | str) -> _crpl.WorldModel | None:
    """What makes latents of pictures, if they are shown."""
    if obs not in ("state", "latent", "image"):
        raise ValueError(f"obs is {obs!r}: state, latent or image")
    if obs != "latent":
        return None
    return (world if isinstance(world, WorldModel) else WorldModel.load(world)).compiled


class _Batch:
    """Flights and the arrays that they write into."""

    def __init__(
        self,
        of: Scenario,
        obs: Obs,
        count: int,
        autoreset: str,
        threads: int,
        world: WorldModel | str,
    ) -> None:
        model = _model(obs, world)
        self.parameters = scenario(of)
        self.flights = _crpl.Flights(source(self.parameters), obs, range(count), autoreset, threads, model)
        shape: tuple[int, ...] = (100, 100, 3) if obs == "image" else (self.flights.width,)
        self.shape = (count, *shape)
        self.dtype: type[Any] = np.uint8 if obs == "image" else np.float32
        self.keeps_last = autoreset == "same-step"
        self.last: Observation | None = np.zeros(self.shape, self.dtype) if self.keeps_last else None

    def show(self) -> Observation:
        now: Observation = np.empty(self.shape, self.dtype)
        self.flights.show(now)
        return now

    def step(
        self, actions: NDArray[np.float32], now: Observation | None = None
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_]]:
        count = self.shape[0]
        now = np.empty(self.shape, self.dtype) if now is None else now
        numbers, flags = np.empty((count, 3)), np.empty((count, 5), np.uint8)
        self.flights.step(actions, now, self.last, numbers, flags)
        return now, numbers, flags.view(np.bool_)


class Flight(gymnasium.Env[Observation, Action]):
    """One flight. The reward is minus the paper's stage cost; docs/python.md describes spaces and infos."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2.5}

    def __init__(
        self,
        of: Scenario = "demo",
        obs: Obs = "state",
        *,
        actions: Actions = "continuous",
        world: WorldModel | str = "learned",
        render_mode: str | None = None,
    ) -> None:
        self._batch = _Batch(of, obs, 1, "disabled", 1, world)
        self._discrete = actions == "discrete"
        self._obs = obs
        self.render_mode = render_mode
        self.scenario = self._batch.parameters
        """All parameters of the flight."""
        self.observation_space, self.action_space = _spaces(
            self.scenario, obs, self._batch.flights.width, self._discrete
        )
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """A flight at tick 0: with ``seed``, the flight of ``gcs`` with this seed; without, the next one by chance."""
        super().reset(seed=seed)
        flight = int(self.np_random.integers(2**48)) if seed is None else seed
        self._batch.flights.reset(0, flight)
        self._over = False
        return self._batch.show()[0], {"seed": flight}

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """One control interval. At the end of a flight ``info["metrics"]`` holds its metrics."""
        if self._over:
            raise gymnasium.error.ResetNeeded("the flight is over, or has not begun: call reset()")
        now, numbers, flags = self._batch.step(_executed(np.asarray(action)[None], self._discrete))
        terminated, truncated, _, outage, collided = (bool(flag) for flag in flags[0])
        reward, snr_db, p_coll = (float(number) for number in numbers[0])
        info: dict[str, Any] = {"snr_db": snr_db, "outage": outage, "p_coll": p_coll, "collided": collided}
        self._over = terminated or truncated
        if self._over:
            info["metrics"] = {key: column[0] for key, column in self._batch.flights.scores([0]).items()}
        return now[0], reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The camera's picture, if ``render_mode`` is "rgb_array" and ``obs`` "image"."""
        if self.render_mode != "rgb_array" or self._obs != "image":
            return None
        picture: NDArray[np.uint8] = self._batch.show()[0]
        return picture

    def records(self) -> list[dict[str, Any]]:
        """One record per interval so far, as in ``record.jsonl``."""
        return [json.loads(line) for line in self.record_lines().splitlines()]

    def record_lines(self) -> str:
        """The bytes of ``record.jsonl`` so far."""
        return self._batch.flights.records(0)


class FlightVector(gymnasium.vector.VectorEnv[Observation, Action, NDArray[Any]]):
    """Many flights, stepped in one call of compiled code, without Python's lock.

    Flight ``i`` of ``reset(seed=s)`` has the seed ``s + i``, and each next flight in its place the seed ``num_envs`` on.
    """

    def __init__(
        self,
        of: Scenario = "demo",
        num_envs: int = 1,
        obs: Obs = "state",
        *,
        actions: Actions = "continuous",
        world: WorldModel | str = "learned",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        copy: bool = True,
    ) -> None:
        mode = AutoresetMode(autoreset_mode)
        names = {
            AutoresetMode.NEXT_STEP: "next-step",
            AutoresetMode.SAME_STEP: "same-step",
            AutoresetMode.DISABLED: "disabled",
        }
        self._batch = _Batch(of, obs, num_envs, names[mode], threads, world)
        self._discrete = actions == "discrete"
        self.metadata = {"autoreset_mode": mode}
        self.num_envs = num_envs
        self.scenario = self._batch.parameters
        self.single_observation_space, self.single_action_space = _spaces(
            self.scenario, obs, self._batch.flights.width, self._discrete
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._buffer = None if copy else np.empty(self._batch.shape, self._batch.dtype)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """All flights at tick 0, or those of ``options["reset_mask"]``."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None:
            seed = int(self.np_random.integers(2**48))
        if isinstance(seed, int):
            seed = [seed + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds for {self.num_envs} flights")
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_))
        for index in (int(place) for place in np.flatnonzero(mask)):
            flight = seed[index]
            self._batch.flights.reset(
                index, int(self.np_random.integers(2**48)) if flight is None else int(flight)
            )
        return self._batch.show(), {"seed": np.array(self.seeds(), np.uint64)}

    def step(
        self, actions: Action
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """One control interval of all flights."""
        now, numbers, flags = self._batch.step(_executed(np.asarray(actions), self._discrete), self._buffer)
        terminated, truncated, flown = flags[:, 0], flags[:, 1], flags[:, 2]
        infos: dict[str, Any] = {
            "snr_db": numbers[:, 1],
            "outage": flags[:, 3],
            "p_coll": numbers[:, 2],
            "collided": flags[:, 4],
        }
        infos.update({f"_{key}": flown for key in list(infos)})
        over = terminated | truncated
        if over.any():
            self._add_ends(infos, over)
        return now, numbers[:, 0], terminated, truncated, infos

    def _add_ends(self, infos: dict[str, Any], over: NDArray[np.bool_]) -> None:
        """The metrics of the flights that end, and what they showed last."""
        ends = [int(index) for index in np.flatnonzero(over)]
        metrics: dict[str, Any] = {}
        for key, column in self._batch.flights.scores(ends).items():
            values = np.zeros(self.num_envs, np.asarray(column).dtype)
            values[ends] = column
            metrics[key], metrics[f"_{key}"] = values, over
        infos["metrics"], infos["_metrics"] = metrics, over
        if self._batch.last is not None:
            final = np.full(self.num_envs, None, dtype=object)
            for index in ends:
                final[index] = self._batch.last[index].copy()
            infos["final_obs"], infos["_final_obs"] = final, over
            infos["final_info"], infos["_final_info"] = {"metrics": metrics, "_metrics": over}, over

    def seeds(self) -> list[int]:
        """Seeds of the flights in progress."""
        return self._batch.flights.seeds()

    def record_lines(self, index: int) -> str:
        """The bytes of ``record.jsonl`` of a flight so far."""
        return self._batch.flights.records(index)


def make(of: Scenario = "demo", obs: Obs = "state", **options: Any) -> Flight:
    """An environment of one flight in a scenario; options as of :class:`Flight`."""
    return Flight(of, obs, **options)


def make_vec(of: Scenario = "demo", num_envs: int = 1, obs: Obs = "state", **options: Any) -> FlightVector:
    """An environment of many flights; options as of :class:`FlightVector`."""
    return FlightVector(of, num_envs, obs, **options)
