"""Recordings that the world model is trained on, and the run folders of ``gcs``."""

import json
import os
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from . import _crpl
from .environment import Actions, _Batch, _executed
from .evaluation import _decider
from .scenarios import Scenario, scenario, source

Folder = str | os.PathLike[str]


def record_dataset(
    folder: Folder,
    of: Scenario = "demo",
    *,
    episodes: int = 10,
    pictures: int = 102,
    seed: int = 0,
    policy: Any = None,
    actions: Actions = "continuous",
    format: Literal["safetensors", "png"] = "safetensors",
    overwrite: bool = False,
    resume: bool = False,
) -> int:
    """Records flights as episodes that ``model train`` learns from (docs/record.md). Gives the number in the folder.

    Each episode is a flight with a seed and a camera of its own. Without a ``policy`` random accelerations are flown
    that keep over the field, as by ``gcs record``; a policy is called with pictures. ``resume`` goes on after the
    episodes that are there.
    """
    if format not in ("safetensors", "png"):
        raise ValueError(f"format is {format!r}: safetensors or png")
    png = format == "png"
    parameters = scenario(of)
    first = _crpl.claim(folder, source(parameters), overwrite, resume)
    if policy is None:
        return _crpl.explore(folder, source(parameters), episodes, pictures, seed, png)
    parameters = scenario(parameters, horizon=max(pictures - 1, 1))
    for episode in range(first, episodes):
        batch = _Batch(parameters, "image", 1, "disabled", 1, "learned")
        batch.flights.reset(0, seed + episode)
        decide = _decider(policy, None, 1)
        shown = [batch.show()]
        for _ in range(pictures - 1):
            now, _, flags = batch.step(_executed(decide(shown[-1]), actions == "discrete"))
            shown.append(now)
            if flags[0, 0]:
                break
        batch.flights.save_episode(0, np.concatenate(shown), folder, episode, png)
    return max(first, episodes)


@dataclass(frozen=True)
class Run:
    """A run folder of ``gcs``."""

    records: pd.DataFrame
    """A row an interval, vectors split into columns ``_x`` and ``_y``, obstacles into ``obstacle_0_x`` and so on."""
    scenario: dict[str, Any]
    """All parameters of the flight."""
    manifest: dict[str, Any]
    """``run.json``: controller, seed, revision, how the flight ended, summary."""


_VECTORS = ("r", "v", "wish", "flown", "r_next", "v_next")


def _flat(record: dict[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for key, value in record.items():
        if key in _VECTORS:
            row[f"{key}_x"], row[f"{key}_y"] = value
        elif key == "obstacles":
            for n, (x, y) in enumerate(value):
                row[f"obstacle_{n}_x"], row[f"obstacle_{n}_y"] = x, y
        else:
            row[key] = value
    return row


def read_records(lines: str) -> pd.DataFrame:
    """Lines of ``record.jsonl`` as a table."""
    return pd.DataFrame([_flat(json.loads(line)) for line in lines.splitlines()])


def read_run(folder: Folder) -> Run:
    """Reads a run folder, also of a flight that has not ended."""
    path = Path(folder)
    return Run(
        records=read_records((path / "record.jsonl").read_text()),
        scenario=tomllib.loads((path / "config.toml").read_text()),
        manifest=json.loads((path / "run.json").read_text()),
    )
