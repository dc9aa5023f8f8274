"""Scores of a controller of yours beside the built-in ones, on the same seeds."""

import copy
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from . import _crpl
from .environment import Actions, FlightVector, Obs
from .scenarios import Scenario, scenario, source
from .world import WorldModel

Controller = Callable[[NDArray[Any]], Any]
"""From an observation, or a batch of them, to an action."""

OUTCOMES = ("reached", "below", "at_wall")
"""Questions about a flight that are answered by yes or no."""

_BATCH = 256


def metrics() -> pd.DataFrame:
    """The metrics, by key: symbol, title, unit, least denominator of a ratio, and whether reports compare it."""
    columns = ["key", "symbol", "title", "unit", "floor", "compared"]
    return pd.DataFrame(_crpl.metrics(), columns=columns).set_index("key")


def fly(
    controller: str,
    of: Scenario = "demo",
    seeds: Iterable[int] = range(100),
    *,
    checkpoint: str | os.PathLike[str] | None = None,
    policy: str | os.PathLike[str] | None = None,
    any_world: bool = False,
) -> pd.DataFrame:
    """Flies a built-in controller, on all cores: a row a flight, as ``gcs episodes`` flies them.

    ``checkpoint``, ``policy`` and ``any_world`` are ``--checkpoint``, ``--policy`` and ``--policy-mismatch allow``.
    """
    flown = list(seeds)
    scores = _crpl.fly(controller, source(of), flown, checkpoint, policy, any_world)
    return _table(controller, flown, scores)


def score(
    policy: Any,
    of: Scenario = "demo",
    seeds: Iterable[int] = range(100),
    *,
    obs: Obs = "state",
    actions: Actions = "continuous",
    batched: bool | None = None,
    world: WorldModel | str = "learned",
    name: str = "policy",
    threads: int = 1,
) -> pd.DataFrame:
    """Flies a controller of yours: a row a flight.

    ``policy`` is called with an observation and gives an action; with a batch of both where ``batched`` is true or it
    has an attribute ``batched`` that is. An object with ``predict``, as of Stable-Baselines3, is asked with
    ``deterministic=True``. One that has ``reset`` keeps a state: each flight gets a copy, whose ``reset()`` is called.
    """
    flown, tables = list(seeds), []
    for begin in range(0, len(flown), _BATCH):
        part = flown[begin : begin + _BATCH]
        env = FlightVector(
            of, len(part), obs, actions=actions, world=world, autoreset_mode="Disabled", threads=threads
        )
        decide = _decider(policy, batched, len(part))
        now, _ = env.reset(seed=part)
        scores: dict[str, NDArray[Any]] = {}
        waiting = np.ones(len(part), np.bool_)
        while waiting.any():
            now, _, terminated, truncated, infos = env.step(decide(now))
            over = (terminated | truncated) & waiting
            for key, column in infos.get("metrics", {}).items():
                if not key.startswith("_"):
                    scores.setdefault(key, np.zeros_like(column))[over] = column[over]
            waiting &= ~over
        tables.append(_table(name, part, scores))
    return pd.concat(tables, ignore_index=True) if tables else _table(name, [], {})


def _decider(policy: Any, batched: bool | None, count: int) -> Controller:
    """From a batch of observations to a batch of actions."""
    call = policy
    if hasattr(policy, "predict"):

        def call(observations: NDArray[Any]) -> Any:
            return policy.predict(observations, deterministic=True)[0]

        batched = True if batched is None else batched
    if batched or (batched is None and getattr(policy, "batched", False)):
        return lambda observations: np.asarray(call(observations))
    if hasattr(policy, "reset"):
        each = [copy.deepcopy(policy) for _ in range(count)]
        for one in each:
            one.reset()
        return lambda observations: np.stack([np.asarray(f(x)) for f, x in zip(each, observations, strict=True)])
    return lambda observations: np.stack([np.asarray(call(x)) for x in observations])


def _table(name: str, seeds: Sequence[int], scores: dict[str, Any]) -> pd.DataFrame:
    return pd.DataFrame({"controller": name, "seed": list(seeds), **scores})


def compare(flights: pd.DataFrame, to: str | None = None) -> pd.DataFrame:
    """From flights, a row each, to a row per controller and metric.

    Columns: mean with its 95 % interval ``lo`` and ``hi``, and the ratio to the controller ``to`` [default: the second
    in the table] on the same seeds, with its interval ``ratio_lo`` and ``ratio_hi``. Outcomes are shares of flights.
    """
    names = list(flights["controller"].unique())
    to = to or (names[1] if len(names) > 1 else names[0])
    if to not in names:
        raise ValueError(f"{to!r} is not among {names}")
    groups = {name: group.sort_values("seed") for name, group in flights.groupby("controller", sort=False)}
    other = groups[to]
    for name, group in groups.items():
        if list(group["seed"]) != list(other["seed"]):
            raise ValueError(f"{name} and {to} flew on different seeds")
    rows = []
    for name in names:
        group = groups[name]
        for key, _, _, _, floor, _ in _crpl.metrics():
            mean = _crpl.mean(group[key].astype(float).tolist())
            ratio = _crpl.ratio(group[key].astype(float).tolist(), other[key].astype(float).tolist(), floor)
            rows.append((name, key, *mean, *(ratio or [np.nan] * 3)))
        for key in OUTCOMES:
            hits = int(group[key].sum())
            rows.append((name, key, hits / max(len(group), 1), *_crpl.wilson(hits, len(group)), *[np.nan] * 3))
    columns = ["controller", "metric", "mean", "lo", "hi", "ratio", "ratio_lo", "ratio_hi"]
    table = pd.DataFrame(rows, columns=columns).set_index(["controller", "metric"])
    table.attrs.update(over=to, flights=len(other))
    return table


def evaluate(
    policy: Any,
    of: Scenario = "demo",
    seeds: Iterable[int] = range(100),
    against: Sequence[str] = ("crpl", "rcc"),
    *,
    name: str = "policy",
    any_world: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Scores a controller of yours beside built-in ones, all on the same seeds, paired by the same gusts.

    ``policy`` is a callable as of :func:`score`, which takes the ``options``, or the name of a built-in controller.
    The table is that of :func:`compare`, with ratios to the first of ``against``.
    """
    world, flown = scenario(of), list(seeds)
    if isinstance(policy, str):
        tables = [fly(policy, world, flown, any_world=any_world)]
    else:
        tables = [score(policy, world, flown, name=name, **options)]
    tables += [fly(other, world, flown, any_world=any_world) for other in against if other != policy]
    return compare(pd.concat(tables, ignore_index=True), to=against[0] if against else None)
