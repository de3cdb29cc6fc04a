"""Observation normalisation of trained agents: running mean and variance.

They are arrays in an .npz file, read without unpickling.

The formula is that of Stable-Baselines3's VecNormalize: clip((o - mean) / sqrt(variance + epsilon),
-clip, clip), as float32.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from soft_tendon_env.tools.files import read_arrays
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.types import Array

STATISTICS = "statistics.npz"
BOX = ""  # the key of the only part of an observation that is no dictionary


class Moments(NamedTuple):
    """Running statistics of a part of the observations."""

    mean: Array  # (n,)
    variance: Array  # (n,)


@dataclass(frozen=True, eq=False)
class Normalization:
    """Observations as an agent sees them."""

    moments: Mapping[str, Moments]  # by key of a Dict observation, or under "" for a Box
    clip: float  # greatest magnitude of the result
    epsilon: float  # added to variances

    def __call__(self, observation: Any) -> Any:
        """The normalised observation, of one row or many.

        Parts without statistics pass as they are.
        """
        if not isinstance(observation, Mapping):
            return self._normalise(observation, self.moments[BOX])
        parts = dict(observation)
        for key in self.moments.keys() & parts.keys():
            moments = self.moments[key]
            parts[key] = self._normalise(parts[key], moments)
        return parts

    def _normalise(self, values: Any, moments: Moments) -> Any:
        deviation = np.sqrt(moments.variance + self.epsilon)
        scaled = (values - moments.mean) / deviation
        clipped = np.clip(scaled, -self.clip, self.clip)
        return clipped.astype(np.float32)


def normalization_of(statistics: Any) -> Normalization | None:
    """Normalisation of a VecNormalize of Stable-Baselines3.

    None where it leaves observations as they are.
    """
    if not statistics.norm_obs:
        return None
    parts = statistics.obs_rms
    if not isinstance(parts, dict):
        parts = {BOX: parts}
    keys = statistics.norm_obs_keys or [BOX]
    moments = {}
    for key in keys:
        part = parts[key]
        moments[key] = Moments(part.mean, part.var)
    return Normalization(moments, statistics.clip_obs, statistics.epsilon)


def _array_name(key: str, field: str) -> str:
    """Name of an array in a file: its field, with "KEY." before it for the parts of a Dict."""
    return f"{key}.{field}" if key else field


def save_normalization(path: Path, normalization: Normalization) -> None:
    """Write `mean` and `variance` of every part, `clip` and `epsilon`.

    Raises OSError.
    """
    arrays = {}
    for key, moments in normalization.moments.items():
        for field, value in moments._asdict().items():
            arrays[_array_name(key, field)] = value
    np.savez(
        path,
        allow_pickle=False,
        **arrays,
        clip=np.float64(normalization.clip),
        epsilon=np.float64(normalization.epsilon),
    )


def read_normalization(path: Path, space: gym.Space[Any]) -> Normalization:
    """Read what `save_normalization` wrote, without unpickling.

    Args:
        path: of the file.
        space: of the observations.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it was damaged, or is of other observations.
    """
    arrays = read_arrays(path, "arrays of mean, variance, clip and epsilon")
    try:
        is_finite = all(
            array.dtype == np.float64 and np.isfinite(array).all() for array in arrays.values()
        )
        clip = float(arrays.pop("clip"))
        epsilon = float(arrays.pop("epsilon"))
        moments = _take_moments(arrays)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{path} is no .npz file of mean, variance, clip and epsilon, or was damaged:"
            f" {first_line(error)}"
        ) from error
    is_sound = bool(moments) and is_finite and clip > 0.0 and epsilon >= 0.0
    for part in moments.values():
        is_sound &= part.mean.shape == part.variance.shape
        is_sound &= bool((part.variance >= 0.0).all())
    if arrays or not is_sound:
        text = (
            "finite numbers of type float64, as many variances of at least 0 as means, clip above 0"
        )
        raise ValueError(f"{path} should have mean, variance, clip and epsilon alone: {text}")
    _check_shapes(path, moments, space)
    return Normalization(moments, clip, epsilon)


def _take_moments(arrays: dict[str, Array]) -> dict[str, Moments]:
    """Takes the moments of all parts out of named arrays.

    Raises KeyError.
    """
    keys = []
    for name in arrays:
        key, _, field = name.rpartition(".")
        if field == "mean":
            keys.append(key)
    moments = {}
    for key in keys:
        values = [arrays.pop(_array_name(key, field)) for field in Moments._fields]
        moments[key] = Moments(*values)
    return moments


def _check_shapes(path: Path, moments: Mapping[str, Moments], space: gym.Space[Any]) -> None:
    """Raises ValueError where moments are of other observations than those of a space."""
    spaces = {BOX: space}
    if isinstance(space, gym.spaces.Dict):
        spaces = space.spaces
    shapes = {key: part.mean.shape for key, part in moments.items()}
    expected = {key: part.shape for key, part in spaces.items()}
    if shapes != expected:
        raise ValueError(
            f"{path} is of observations {shapes.get(BOX, shapes)}, this environment has"
            f" {expected.get(BOX, expected)}"
        )
