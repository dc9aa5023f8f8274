"""Scenarios: a preset's name, a TOML file, or a mapping of what differs from the paper."""

import json
import os
from collections.abc import Mapping
from typing import Any

from . import _crpl

Scenario = str | os.PathLike[str] | Mapping[str, Any]
"""A preset's name, a path of a TOML file, or parameters as nested mappings."""


def source(of: Scenario) -> str:
    """What the compiled part takes: a name, or a JSON object."""
    return json.dumps(of) if isinstance(of, Mapping) else os.fspath(of)


def scenario(of: Scenario = "2", *, camera: str | None = None, **changes: Any) -> dict[str, Any]:
    """All parameters of a scenario as a nested dict, to be changed and given back.

    ``camera`` replaces its camera by one with a name ("hard"). A change is a parameter, or a mapping of a table's:
    ``scenario("demo", radio={"b_dt": 2.5}, horizon=50)``. An unknown key is a ``ValueError``.
    """
    resolved: dict[str, Any] = json.loads(_crpl.scenario(source(of), camera))
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(resolved.get(key), dict):
            value = {**resolved[key], **value}
        resolved[key] = value
    checked: dict[str, Any] = json.loads(_crpl.scenario(json.dumps(resolved), None))
    return checked


def presets() -> dict[str, str]:
    """Names of the presets, each with a line about it."""
    return dict(_crpl.presets())
