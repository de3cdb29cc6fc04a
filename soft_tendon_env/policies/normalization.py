"""Observation normalisation of trained agents: running mean and variance as arrays in an .npz file,
read without unpickling.

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
    mean: Array  # (n,) of a part of the observations
    variance: Array  # (n,)


@dataclass(frozen=True, eq=False)
class Normalization:
    """Observations as an agent sees them."""

    moments: Mapping[str, Moments]  # by key of a Dict observation, or under "" for a Box
    clip: float  # greatest magnitude of the result
    epsilon: float  # added to variances

    def __call__(self, observation: Any) -> Any:
        """The normalised observation, of one row or many; parts without statistics pass as they
        are."""
        if not isinstance(observation, Mapping):
            return self._normalise(observation, self.moments[BOX])
        return {
            key: self._normalise(part, self.moments[key]) if key in self.moments else part
            for key, part in observation.items()
        }

    def _normalise(self, values: Any, moments: Moments) -> Any:
        scaled = (values - moments.mean) / np.sqrt(moments.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


def normalization_of(statistics: Any) -> Normalization | None:
    """Normalisation of a VecNormalize of Stable-Baselines3; None where it leaves observations as
    they are."""
    if not statistics.norm_obs:
        return None
    parts = (
        statistics.obs_rms if isinstance(statistics.obs_rms, dict) else {BOX: statistics.obs_rms}
    )
    keys = statistics.norm_obs_keys or [BOX]
    return Normalization(
        {key: Moments(parts[key].mean, parts[key].var) for key in keys},
        statistics.clip_obs,
        statistics.epsilon,
    )


def save_normalization(path: Path, normalization: Normalization) -> None:
    """Write `mean`, `variance` (with "KEY." before them for the parts of a Dict), `clip` and
    `epsilon`. Raises OSError."""
    arrays = {
        f"{key}.{name}" if key else name: value
        for key, of in normalization.moments.items()
        for name, value in of._asdict().items()
    }
    np.savez(
        path,
        allow_pickle=False,
        **arrays,
        clip=np.float64(normalization.clip),
        epsilon=np.float64(normalization.epsilon),
    )


def read_normalization(path: Path, space: gym.Space[Any]) -> Normalization:
    """Read what `save_normalization` wrote, for observations of a space, without unpickling. Raises
    ValueError, FileNotFoundError."""
    arrays = read_arrays(path, "arrays of mean, variance, clip and epsilon")
    try:
        finite = all(
            array.dtype == np.float64 and np.isfinite(array).all() for array in arrays.values()
        )
        clip, epsilon = float(arrays.pop("clip")), float(arrays.pop("epsilon"))
        keys = [
            name.removesuffix("mean").removesuffix(".")
            for name in arrays
            if name.rpartition(".")[2] == "mean"
        ]
        moments = {
            key: Moments(
                *(arrays.pop(f"{key}.{name}" if key else name) for name in Moments._fields)
            )
            for key in keys
        }
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{path} is no .npz file of mean, variance, clip and epsilon, or was damaged:"
            f" {first_line(error)}"
        ) from error
    alike = all(
        of.mean.shape == of.variance.shape and (of.variance >= 0.0).all() for of in moments.values()
    )
    if arrays or not (moments and finite and alike and clip > 0.0 and epsilon >= 0.0):
        text = (
            "finite numbers of type float64, as many variances of at least 0 as means, clip above 0"
        )
        raise ValueError(f"{path} should have mean, variance, clip and epsilon alone: {text}")
    shapes = {key: of.mean.shape for key, of in moments.items()}
    wanted = {
        key: part.shape
        for key, part in (
            space.spaces if isinstance(space, gym.spaces.Dict) else {BOX: space}
        ).items()
    }
    if shapes != wanted:
        raise ValueError(
            f"{path} is of observations {shapes.get(BOX, shapes)}, this environment has"
            f" {wanted.get(BOX, wanted)}"
        )
    return Normalization(moments, clip, epsilon)
