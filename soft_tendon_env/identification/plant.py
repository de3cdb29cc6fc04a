"""Arm and measurement at given parameters: the scene, its model on a grid that stays, mount, markers, gains of commands."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.identification.parameters import DELAY, Parameter
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

TURNED = {"gravity": ("acceleration",), "tip_load": ("force", "moment"), "fluid": ("current",)}
"""Vectors of effects in the world frame, which turn against the base when the mount does."""
INSIDE = {"actuators", "tendon_elasticity", "tendon_friction", "nonlinear_elasticity", "viscoelastic_memory"}
"""Effects that know nothing of the world frame."""


class Measurement(NamedTuple):
    """How an arm is mounted, marked and commanded."""

    rotation: Array  # (3,) rotation vector of the base in the scene's world frame [deg]
    shift: Array  # (3,) [m]
    offsets: Array  # (m, 3) of the markers [m]
    gain: Array  # (n_a,) of the commands
    offset: Array  # (n_a,) of the commands, after the gain


class Plant(NamedTuple):
    """An arm and how it is measured."""

    scene: Scene  # in the frame of its base
    model: Model
    measurement: Measurement

    def positions(self, poses: Array) -> Array:
        """Positions (..., m, 3) [m] of markers in the scene's world frame, of section poses (..., m, 4, 4) from the base."""
        inside = poses[..., :3, 3] + np.einsum("...ij,...j->...i", poses[..., :3, :3], self.measurement.offsets)
        return np.asarray(inside @ base_rotation(self.measurement.rotation).T + self.measurement.shift)

    def command(self, command: Array) -> Array:
        """Commands that act (..., n_a), of those that were given."""
        return np.asarray(self.measurement.gain * command + self.measurement.offset)


def base_rotation(rotation: Array) -> Array:
    """Rotation (3, 3) of the real base, of its rotation vector (3,) [deg]."""
    return np.asarray(Rotation.from_rotvec(rotation, degrees=True).as_matrix())


class Plants:
    """Plants by coordinates of the parameters; the grid is that of the nominal scene, so that what is simulated is smooth in them."""

    def __init__(self, scene: Scene, model: Model, markers: MarkerSet, parameters: Sequence[Parameter]) -> None:
        """Raises ValueError where the mount is to turn and effects are in the world frame that cannot turn with it."""
        self.scene, self.model, self.markers, self.parameters = scene, model, markers, tuple(parameters)
        self.length = model.length
        self._models = {self._key(np.zeros(len(self.parameters))): (scene, model)}
        turns = any(parameter.name.startswith("mount.rotation") for parameter in parameters)
        if turns and (odd := [name for name in scene.effects.chosen() if name not in TURNED and name not in INSIDE]):
            raise ValueError(f"mount.rotation cannot be estimated with effects.{odd[0]}, which stands in the world and not on the arm")

    def only(self, kept: Sequence[int]) -> "Plants":
        """Plants of some of the parameters, by their places, the others at the scene's numbers."""
        return Plants(self.scene, self.model, self.markers, [self.parameters[i] for i in kept])

    def at(self, x: Array) -> Plant:
        """Plant at coordinates (k,) of the parameters. Raises ConfigurationError."""
        measurement = self.measurement(x)
        key = self._key(x)
        if key not in self._models:
            scene = self.scene_at(x, self.scene)
            if len(self._models) > 2 * len(self.parameters) + 2:
                self._models.clear()
            self._models[key] = scene, self.model.with_scene(scene)
        scene, model = self._models[key]
        return Plant(scene, model, measurement)

    def is_of_model(self, i: int) -> bool:
        """Whether the parameter changes the arm or what acts on it, and not only where its markers are seen."""
        return not self.parameters[i].name.startswith(("markers.", "mount.shift"))

    def scene_at(self, x: Array, scene: Scene) -> Scene:
        """A scene with the numbers at coordinates (k,) of the parameters, in the frame of its real base. Raises ConfigurationError."""
        changes = dict[str, Any]()
        for parameter, own in zip(self.parameters, x, strict=True):
            value = parameter.at(own)
            changes |= {"effects.actuators.delay": value} if parameter.name == DELAY else parameter.changes(value)
        return turned(scene_with_numbers(scene, changes), self.measurement(x).rotation)

    def measurement(self, x: Array) -> Measurement:
        """Mount, markers and commands at coordinates (k,)."""
        n_a = len(self.scene.tendons)
        found = Measurement(np.zeros(3), np.zeros(3), self.markers.offsets, np.ones(n_a), np.zeros(n_a))
        names = list(self.markers.markers)
        for parameter, own in zip(self.parameters, x, strict=True):
            value = parameter.at(own)
            match parameter.name.split("."):
                case ["mount", kind, axis]:
                    getattr(found, kind)[int(axis)] = value
                case ["markers", name, "offset", axis]:
                    found.offsets[names.index(name), int(axis)] = value
                case ["commands", tendon, kind]:
                    getattr(found, kind)[int(tendon)] = value
        return found

    def _key(self, x: Array) -> bytes:
        """The coordinates on which the model depends."""
        seen, pairs = ("mount.shift", "markers.", "commands."), zip(self.parameters, x, strict=True)
        return np.array([own for parameter, own in pairs if parameter.name == DELAY or not parameter.name.startswith(seen)]).tobytes()


def turned(scene: Scene, rotation: Array) -> Scene:
    """The scene in the frame of a base that is turned by a rotation vector (3,) [deg]: its world vectors turn the other way."""
    if not rotation.any():
        return scene
    R, changes = base_rotation(rotation), dict[str, Any]()
    for name, effect in scene.effects.chosen().items():
        for vector in TURNED.get(name, ()):
            if getattr(effect, "frame", "world") == "world":
                changes[f"effects.{name}.{vector}"] = (R.T @ np.array(getattr(effect, vector))).tolist()
    return scene.replace(changes)
