"""Arguments of `reset`, plain specs and closed environments: what the single and the vector environments check of their calls."""

import dataclasses
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector import AutoresetMode

from soft_tendon_env.tools.checks import checked_count
from soft_tendon_env.tools.configuration import plain


def checked_seed(seed: Any, name: str = "seed") -> int | None:
    """A seed of `reset`: None or a whole number of at least 0, NumPy's among them. Raises TypeError or ValueError."""
    return None if seed is None else checked_count(name, seed, 0)


def checked_seeds(seed: Any, rows: int) -> list[int | None] | None:
    """A seed for each row: s + i from a number s, or those of a list. Raises TypeError or ValueError."""
    if seed is None:
        return None
    if isinstance(seed, list | tuple) or isinstance(seed, np.ndarray) and seed.ndim > 0:
        if len(seed) != rows:
            raise ValueError(f"seed should be an int or a list of {rows}, not of {len(seed)}")
        return [checked_seed(own, f"seed[{i}]") for i, own in enumerate(seed)]
    first = checked_count("seed", seed, 0)
    return [first + i for i in range(rows)]


def check_options(options: Any) -> None:
    """Raises TypeError where the options of `reset` are no table."""
    if not isinstance(options, dict | None):
        raise TypeError(f"options should be a dict or None, not {type(options).__name__}")


def refuse_closed(closed: bool, called: str) -> None:
    """Raises ClosedEnvironmentError."""
    if closed:
        raise ClosedEnvironmentError(f"{called} was called after close: make a new environment")


class PlainSpec:
    """An environment whose `spec` goes to JSON, whatever its options were given as: NumPy's numbers and arrays, paths, a Scene."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            named = {key: value.name.lower() if isinstance(value, AutoresetMode) else value for key, value in spec.kwargs.items()}
            spec = dataclasses.replace(spec, kwargs=plain(named))
        self._spec = spec
