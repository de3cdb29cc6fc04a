"""Learned wrench of the dead loads inside a statics-based strain (paper III-B): its file, and which of those there are fit a scene.

`accuracy.loaded_strain` trains it. A file has arrays of numbers and a text of JSON alone and is read without unpickling. It says which arm
and which tensions and loads it was made for. The strain that it gives is a set of shapes on which the arm moves under its own forces: for
another material, other loads or tensions it stays sound, and loses accuracy, which is warned of.
"""

import functools
import hashlib
import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.compiler.cache_folder import new_data_folder
from soft_tendon_env.effects.base import DeadLoads
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.scene.artifacts.artifact import Artifact, Kind, arm_of
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import LearnedLoads, StaticsBased
from soft_tendon_env.tools.files import UNREADABLE, arrays_in, parse_json, read_bytes, replacing
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Array

SUFFIX = ".loads.npz"
WEIGHTS = ("first", "first_bias", "second", "second_bias", "third", "third_bias")
SAME = 1e-9  # relative difference up to which numbers count as equal
STIFF = ("young_modulus", "density")
"""Properties of the material that a strain under load depends on."""


class LearnedStrainWarning(UserWarning):
    """A learned strain is used for something that it was not trained for, so that its accuracy is not known."""


@dataclass(frozen=True, eq=False)
class LearnedStrain(Artifact):
    """Section wrench of dead loads, sum c_r(q_a) field_r, with the amplitudes by a network of the coordinates q_a that are tensions.

    Its errors are stated for tensions within its `tension_limits`.

    Attributes:
        coordinate_range: (active, 2) [N], of the coordinates that it was trained with, those limits and a margin.
        loads: what weighs on the arm, see `loads_of`.
        weights: of the network, by the names of `mechanics.types.Network`; coordinates [N] in, amplitudes out. Layers are matrices here.
        errors: what was measured on tensions that it was not trained with, see accuracy/loaded_strain.py.
    """

    coordinate_range: Array
    loads: Mapping[str, Any]
    weights: Mapping[str, Array]
    errors: Mapping[str, float]

    @functools.cached_property
    def digest(self) -> str:
        digest = hashlib.sha256()
        for values in (self.borders, self.coefficients, *(self.weights[name] for name in WEIGHTS)):
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    def misfit(self, scene: Scene) -> str:
        if other := self.other_material(scene, STIFF, lambda own, wanted: bool(np.isclose(own, wanted, rtol=SAME))):
            return other
        here = loads_of(scene)
        for name, own in self.loads.items():
            if not np.allclose(own, here[name], rtol=SAME, atol=0.0):
                return f"{LOADS[name]} {own}, not {here[name]}"
        return self.other_limits(scene)

    def outside(self, q: Array) -> str:
        """Which coordinate of q (.., n) is outside of the range that it was trained with, in words; empty where none is."""
        low, high = self.coordinate_range.T
        active = q[..., : low.size]
        if not ((active < low) | (active > high)).any():
            return ""
        beyond = np.nan_to_num(np.maximum(low - active, active - high) / (high - low)).reshape(-1, low.size)
        row, i = np.unravel_index(np.argmax(beyond), beyond.shape)
        return f"coordinate {i} at {active.reshape(-1, low.size)[row, i]:.4g} N, outside of {low[i]:.4g} to {high[i]:.4g} N"

    def save(self, path: Path) -> None:
        """Saves it, a file without pickled objects that appears whole or not at all. Raises OSError."""
        about = {"arm": self.arm, "loads": self.loads, "errors": self.errors}
        arrays = {name: getattr(self, name) for name in ("tension_limits", "coordinate_range", "borders", "coefficients")}
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, allow_pickle=False, about=np.array(json.dumps(about)), **arrays, **self.weights)


class LearnedRange:
    """Warns (LearnedStrainWarning), once, of motions that leave what the strain of a scene was trained for; None: nothing is learned."""

    def __init__(self, name: str, learned: LearnedStrain | None) -> None:
        self._name, self._learned = name, learned

    def look(self, q: Array, members: NDArray[np.int64] | None = None) -> None:
        """At coordinates q (.., n), or those of the rows `members` alone."""
        if self._learned is None or not q.size:
            return
        if outside := self._learned.outside(q if members is None else q[members]):
            self._warn(f"a motion of {self._name!r} has {outside}, which its learned strain was trained for")

    def look_at_material(self, is_own: bool) -> None:
        """At an arm whose material is the scene's own, or another."""
        if self._learned is not None and not is_own:
            self._warn(f"arms of {self._name!r} with another material or payload have the learned strain of the scene's")

    def _warn(self, text: str) -> None:
        self._learned = None
        warnings.warn(f"{text}: how accurate it is there is not known", LearnedStrainWarning, stacklevel=4)


LOADS = {
    "acceleration": "gravity [m/s^2] of",
    "force": "a force [N] at the tip of",
    "moment": "a moment [N m] at the tip of",
    "payload": "a payload [kg] of",
}
"""Names of the loads on an arm, in words."""


def loads_of(scene: Scene) -> dict[str, Any]:
    """Loads on the scene's arm beside its own mass: see DeadLoads, and the payload [kg]."""
    loads: DeadLoads = scene.effects.dead_loads()
    return {**{name: list(vector) for name, vector in loads._asdict().items()}, "payload": float(scene.effects.payload[3])}


def learned_path(scene: Scene) -> Path:
    """Path in the user's cache of the learned strain of a scene: by its arm, tension limits and loads. Raises OSError without a folder."""
    limits = [tendon.tension_limits for tendon in scene.tendons]
    made_for = json.dumps([arm_of(scene), limits, loads_of(scene)], sort_keys=True)
    return new_data_folder("loads") / f"{hashlib.sha256(made_for.encode()).hexdigest()[:16]}{SUFFIX}"


def read_learned(path: Path) -> LearnedStrain:
    """A learned strain that `LearnedStrain.save` wrote; nothing is unpickled. Raises ValueError, FileNotFoundError."""
    try:
        content = read_bytes(path)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {describe(error)}") from error
    try:
        saved = arrays_in(content)
        about = parse_json(str(saved.pop("about")))
        arrays = {name: np.array(value, dtype=np.float64) for name, value in saved.items()}
        learned = LearnedStrain(
            arm=about["arm"],
            loads={name: about["loads"][name] for name in LOADS},
            errors={name: float(value) for name, value in about["errors"].items()},
            weights={name: arrays.pop(name) for name in WEIGHTS},
            **arrays,
        )
        _check(learned)
    except (*UNREADABLE, AttributeError) as error:
        raise ValueError(f"{path} holds no learned strain that soft-tendon learn-strain wrote: {type(error).__name__} {error}") from error
    return learned


def _check(learned: LearnedStrain) -> None:
    """Raises ValueError where shapes do not belong together or numbers are not finite."""
    inputs, hidden = learned.weights["first"].shape
    fields, pieces, orders = len(learned.coefficients), learned.borders.size - 1, learned.coefficients.shape[-1]
    tendons = len(learned.arm["tendons"])
    expected = {
        "tension_limits": (tendons, 2), "coordinate_range": (inputs, 2),
        "borders": (pieces + 1,), "coefficients": (fields, pieces, 6, orders),
        "first": (inputs, hidden), "second": (hidden, hidden), "third": (hidden, fields),
        "first_bias": (hidden,), "second_bias": (hidden,), "third_bias": (fields,),
    }  # fmt: skip
    for name, shape in expected.items():
        values = learned.weights[name] if name in WEIGHTS else getattr(learned, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(f"{name} should be finite and of shape {shape}, not {values.shape}")
    if not fields or hidden % (2 * LANES):
        raise ValueError(f"it has {fields} fields and hidden layers of {hidden}, which should be a multiple of {2 * LANES}")


KIND = Kind("a learned strain", "learn-strain", ("strain", "include_loads"), "loads", SUFFIX, read_learned)


def find_learned(scene: Scene, digest: str | None = None) -> LearnedStrain | None:
    """Learned strain of the scene's arm, among those that ship and those in the user's cache; None where there is none.

    One that was made for the scene goes before the others. With a digest: that one alone.
    """
    return min(KIND.known(scene, digest), key=lambda learned: bool(learned.misfit(scene)), default=None)


def is_learned(scene: Scene) -> bool:
    """Whether the scene has a learned strain, and loads to have it for."""
    own = scene.strain.include_loads if isinstance(scene.strain, StaticsBased) else False
    return isinstance(own, LearnedLoads) and scene.effects.dead_loads().exist


def learned_of(scene: Scene) -> LearnedStrain:
    """The learned strain that a scene with `LearnedLoads` names. Raises ConfigurationError where there is none or it does not fit."""
    assert isinstance(scene.strain, StaticsBased) and isinstance(scene.strain.include_loads, LearnedLoads)
    return KIND.named_by(scene, scene.strain.include_loads, find_learned)
