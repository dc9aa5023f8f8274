"""The world model on numpy arrays: encoder, observer, predictor, heads and policies."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _crpl
from .scenarios import Scenario, source

Numbers = NDArray[np.float32]
Doubles = NDArray[np.float64]


def _numbers(values: ArrayLike) -> Numbers:
    return np.ascontiguousarray(values, dtype=np.float32)


def _doubles(values: ArrayLike) -> Doubles:
    return np.ascontiguousarray(values, dtype=np.float64)


def _of_rows(head: Callable[[Numbers, str, Numbers], None], y: ArrayLike, of: Scenario) -> Numbers:
    """What a head says [N] of y [N, 2, 2] in a scenario."""
    numbers = _numbers(y)
    out = np.empty(len(numbers), np.float32)
    head(numbers, source(of), out)
    return out


class WorldModel:
    """What was learned of the world. Latents ``z`` are [N, 2, 16], their planes ``y`` [N, 2, 2]: UAV, then obstacle."""

    def __init__(self, compiled: _crpl.WorldModel) -> None:
        self.compiled = compiled

    @classmethod
    def load(cls, name: str | os.PathLike[str] = "learned") -> "WorldModel":
        """A built-in one, "centroid" or "learned", or the folder of a checkpoint."""
        return cls(_crpl.WorldModel.load(name))

    @property
    def scale(self) -> float:
        """Latent units per unit of length."""
        return self.compiled.scale

    @property
    def fingerprint(self) -> str:
        """A name for the learned numbers."""
        return self.compiled.fingerprint

    def encode(self, frames: NDArray[np.uint8]) -> Numbers:
        """Latents of pictures: uint8 [N, 100, 100, 3] to [N, 2, 16]."""
        out = np.empty((len(frames), 2, 16), np.float32)
        self.compiled.encode(frames, out)
        return out

    def plane(self, latents: ArrayLike) -> Numbers:
        """Coordinates of latents [N, 2, 16] in their planes: y, [N, 2, 2]."""
        out = np.empty((np.shape(latents)[0], 2, 2), np.float32)
        self.compiled.plane(_numbers(latents), out)
        return out

    def see(self, frames: NDArray[np.uint8]) -> tuple[Doubles, Doubles]:
        """What the observer reads of pictures: y [N, 2, 2], and its standard deviation [N, 2], units of 0.03 px."""
        places, errors = np.empty((len(frames), 2, 2)), np.empty((len(frames), 2))
        self.compiled.see(frames, places, errors)
        return places, errors

    def places(self, y: ArrayLike) -> Doubles:
        """Where the model sees UAV and obstacle, paper units, from y [N, 2, 2]."""
        out = np.empty((np.shape(y)[0], 2, 2))
        self.compiled.places(_doubles(y), out)
        return out

    def planes_at(self, places: ArrayLike) -> Numbers:
        """The y [N, 2, 2] of places of UAV and obstacle [N, 2, 2], paper units."""
        out = np.empty((np.shape(places)[0], 2, 2), np.float32)
        self.compiled.planes_at(_doubles(places), out)
        return out

    def predict(
        self, now: ArrayLike, before: ArrayLike, actions: ArrayLike, *, obstacle: bool = False
    ) -> Doubles:
        """The UAV's y of the next T intervals [N, T, 2], from y [N, 2], y one interval ago and actions [N, T, 2].

        ``obstacle``: the obstacle's; then ``actions`` says no more than T.
        """
        flown = _doubles(actions)
        out = np.empty_like(flown)
        self.compiled.predict(_doubles(now), _doubles(before), flown, obstacle, out)
        return out

    def risk(self, y: ArrayLike, of: Scenario = "demo") -> Numbers:
        """Predicted collision probability [N] of y [N, 2, 2]."""
        return _of_rows(self.compiled.risk, y, of)

    def gain(self, y: ArrayLike, of: Scenario = "demo") -> Numbers:
        """Predicted channel gain |h|² [N] of y [N, 2, 2]."""
        return _of_rows(self.compiled.gain, y, of)

    def policy(
        self, of: Scenario = "demo", file: str | os.PathLike[str] | None = None, *, any_world: bool = False
    ) -> "Policy":
        """CRPL's policies for a scenario: built-in ones that cover it, or those of a file.

        ``any_world``: also those that were optimised for another world.
        """
        return Policy(self.compiled.policy(source(of), file, any_world))

    def observer(self, of: Scenario = "demo") -> "LatentObserver":
        """An observer of one flight."""
        return LatentObserver(self.compiled.observer(source(of)))


class Policy:
    """CRPL's policies. Called on observations "latent", one or a batch, they give actions."""

    batched = True

    def __init__(self, compiled: _crpl.NetworkPolicy) -> None:
        self.compiled = compiled

    @property
    def source(self) -> str:
        """Where they come from."""
        return self.compiled.source

    def act(self, y_c: ArrayLike, y_c_before: ArrayLike, y_u: ArrayLike) -> Numbers:
        """Actions [N, 3] of y_c, y_c one interval ago and y_u, [N, 2] each."""
        now = _numbers(y_c)
        out = np.empty((len(now), 3), np.float32)
        self.compiled.act(now, _numbers(y_c_before), _numbers(y_u), out)
        return out

    def __call__(self, observation: NDArray[Any]) -> Numbers:
        rows = np.atleast_2d(observation)
        actions = self.act(rows[:, 0:2], rows[:, 2:4], rows[:, 8:10])
        return actions if observation.ndim > 1 else actions[0]


class LatentObserver:
    """Place and speed in latents, from the pictures and the actions of one flight."""

    def __init__(self, compiled: _crpl.Observer) -> None:
        self.compiled = compiled

    def observe(self, frame: NDArray[np.uint8], flown: ArrayLike = ()) -> Doubles:
        """Takes in a picture and the accelerations flown since the last one, [K, 2].

        Gives y_c, y_c one interval ago, and y_u: [3, 2].
        """
        out = np.empty((3, 2))
        self.compiled.observe(frame, _doubles(flown).reshape(-1, 2), out)
        return out
