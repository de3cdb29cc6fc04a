"""Readings of recordings beside those that are simulated at given parameters: residuals and their
derivatives.

Equilibria of still holds are sought by Newton's method from the last ones that were found for their
recordings, so that a fit re-solves each in a few iterations; their derivatives take one Newton step
from there (implicit function theorem). Motions begin at rest under their first command; each
command is held until the next sample.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.identification.parameters import DELAY, Parameter
from soft_tendon_env.identification.recordings import Recording, clusters
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.statics import commanded_equilibrium, static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

DIFFERENCES = (
    1e-4,
    1e-3,
    # of coordinates, central: of holds, which are exact to 1e-10, and with motions, to the steps'
    # tolerance
)


class NoHoldError(ValueError):
    """Raised where the arm has no equilibrium for a hold, or its motion cannot be simulated."""


class Measurement(NamedTuple):
    """How an arm is placed, marked and commanded."""

    position: Array  # (3,) of the base [m]
    offsets: Array  # (m, 3) of the markers [m]
    gain: Array  # (n_a,) of the commands
    offset: Array  # (n_a,) of the commands, after the gain

    def positions(self, poses: Array) -> Array:
        """Positions (..., m, 3) [m] of markers in the world, of section poses (..., m, 4, 4) along
        its axes, but beginning at the base."""
        away = poses[..., :3, 3] + np.einsum("...ij,...j->...i", poses[..., :3, :3], self.offsets)
        return np.asarray(away + self.position)


class Near(NamedTuple):
    """Equilibrium of a hold, and how it moves with forces on its coordinates while the command
    stays."""

    q: Array  # (n,)
    compliance: Array  # (n, n)
    pulls: Array  # (n_a,) bool, of elastic tendons those whose tension follows the arm


class Plants:
    """Arms by coordinates of the parameters; the grid is that of the nominal scene, so that what is
    simulated is smooth in them."""

    def __init__(
        self, scene: Scene, model: Model, markers: MarkerSet, parameters: Sequence[Parameter]
    ) -> None:
        self.scene, self.model, self.markers, self.parameters = (
            scene,
            model,
            markers,
            tuple(parameters),
        )
        is_uniform = all(effect.is_uniform for effect in scene.effects.on_arm().chosen().values())
        still = ("markers.", "base.position") if is_uniform else ("markers.",)
        self.moves_arm = [
            not one.name.startswith(still) for one in self.parameters
        ]  # beside its base

    def scene_at(self, x: Array, scene: Scene) -> Scene:
        """A scene with the numbers at coordinates (k,) of the parameters. Raises
        ConfigurationError."""
        changes = dict[str, Any]()
        for parameter, coordinate in zip(self.parameters, x, strict=True):
            if parameter.name == DELAY:
                changes["effects.actuators.delay"] = parameter.at(coordinate)
            elif parameter.of_scene is not None:
                changes |= parameter.of_scene.changes(parameter.at(coordinate))
        return scene_with_numbers(scene, changes)

    def measurement(self, x: Array) -> Measurement:
        """Base, markers and commands at coordinates (k,)."""
        n_a, names = len(self.scene.tendons), [*self.markers.markers]
        found = Measurement(
            np.array(self.scene.base.position), self.markers.offsets, np.ones(n_a), np.zeros(n_a)
        )
        for parameter, coordinate in zip(self.parameters, x, strict=True):
            match parameter.name.split("."):
                case ["base", "position", axis]:
                    found.position[int(axis)] = parameter.at(coordinate)
                case ["markers", name, "offset", axis]:
                    found.offsets[names.index(name), int(axis)] = parameter.at(coordinate)
                case ["commands", tendon, kind]:
                    getattr(found, kind)[int(tendon)] = parameter.at(coordinate)
        return found


class Readings:
    """Readings of recordings in one vector (N,): the coordinates of `measured` positions (samples
    of all recordings, m, 3) [m] that are `seen`. cluster: index of each reading (N,) that those
    with common errors share, see `clusters`."""

    def __init__(self, plants: Plants, recordings: Sequence[Recording]) -> None:
        self.plants, self.recordings = (
            plants,
            sorted(recordings, key=lambda one: bool(one.period)),
        )  # holds, then motions
        self._rests: list[Array | None] = [None] * len(recordings)
        self._difference = DIFFERENCES[any(one.period for one in recordings)]
        samples = [len(one.command) for one in self.recordings]
        self.ends, group = np.cumsum(samples), clusters(self.recordings)
        self.measured = np.concatenate(
            [
                np.empty((0, len(plants.markers.markers), 3)),
                *(one.positions for one in self.recordings),
            ]
        )
        self.seen = np.isfinite(self.measured)
        self.cluster = np.broadcast_to(np.repeat(group, samples)[:, None, None], self.seen.shape)[
            self.seen
        ]

    def positions(self, x: Array) -> Array:
        """Simulated positions (samples, m, 3) [m] at coordinates x (k,). Raises NoHoldError,
        ConfigurationError."""
        return self.plants.measurement(x).positions(self._poses(x))

    def residual(self, x: Array, poses: Array | None = None) -> Array:
        """Simulated less measured readings (N,) [m], from `_poses` at x, or others that are given.
        Raises as `positions`."""
        simulated = self.plants.measurement(x).positions(self._poses(x) if poses is None else poses)
        return np.asarray((simulated - self.measured)[self.seen])

    def jacobian(self, x: Array) -> Array:
        """Derivatives (N, k) [m] of the readings by the coordinates, by central differences within
        the bounds. Raises as `positions`."""
        columns, still = [], self._poses(x)
        arms = zip(self.recordings, self._rests, self._arms(x), strict=True)
        near = [
            None if one.period or q is None else _near(model, command[0], q)
            for one, q, (model, command) in arms
        ]
        for i, parameter in enumerate(self.plants.parameters):
            ends = np.clip([x[i] - self._difference, x[i] + self._difference], *parameter.bounds)
            places = [np.where(np.arange(x.size) == i, end, x) for end in ends]
            low, high = (
                self.residual(at, self._poses(at, near) if self.plants.moves_arm[i] else still)
                for at in places
            )
            columns.append((high - low) / (ends[1] - ends[0]))
        return np.stack(columns, axis=-1)

    def errors(self, x: Array) -> dict[str, float]:
        """Mean distance [m] of the seen markers from where they are simulated, by recordings, NaN
        without any. Raises as `positions`."""
        distance = np.linalg.norm(self.positions(x) - self.measured, axis=-1)
        return {
            one.name: mean_of_finite(part.ravel())
            for one, part in zip(self.recordings, np.split(distance, self.ends[:-1]), strict=False)
        }

    def _arms(self, x: Array) -> list[tuple[Model, Array]]:
        """The model at coordinates x (k,), with the commands (samples, n_a) of each recording."""
        model, measurement = (
            self.plants.model.with_scene(self.plants.scene_at(x, self.plants.scene)),
            self.plants.measurement(x),
        )
        return [
            (model, measurement.gain * one.command + measurement.offset) for one in self.recordings
        ]

    def _poses(self, x: Array, near: Sequence[Near | None] = ()) -> Array:
        """Poses (samples, m, 4, 4) of markers' sections from the base's place; of holds `near`
        others linear. Raises NoHoldError."""
        arms, simulated, places = self._arms(x), list[Array](), self.plants.markers.arc_lengths
        with erring_actuators():  # by the gains and offsets that are looked for
            for i, (model, command) in enumerate(arms):
                moved = _moved(model, command[0], near[i]) if near else None
                simulated += self._simulate(model, command, i) if moved is None else [moved]
        model = arms[0][0] if arms else self.plants.model
        poses = np.array([model.backbone_at(q, places) for q in simulated]).reshape(
            -1, places.size, 4, 4
        )
        poses[..., :3, 3] -= self.plants.measurement(x).position
        return poses

    def _simulate(self, model: Model, command: Array, i: int) -> list[Array]:
        """Coordinates (n,) at every sample of a recording under commands (samples, n_a). Raises
        NoHoldError."""
        one = self.recordings[i]
        try:
            if model.command_unit == "N":
                rest, tension = (
                    static_equilibrium(model, command[0], self._rests[i], settle=bool(one.period)),
                    command[0],
                )
            else:
                rest, tension = commanded_equilibrium(model, command[0])
            if not rest.converged:
                raise NoHoldError(rest.reason)
            self._rests[i] = rest.q
            if not one.period:
                return [rest.q]
            start = Simulation(model).reset(rest.q, tension=tension)
            return list(
                simulate(model, command[:-1], one.period * (len(command) - 1), one.period, start).q
            )
        except (SimulationDiverged, NoHoldError, StrainLimitError) as error:
            motion = (
                f"cannot be simulated: {error}. Its samples are {one.period:.3g} s apart, if their"
                " unit is right"
            )
            text = (
                f"motion {one.name!r} {motion}"
                if one.period
                else f"hold {one.name!r} has no equilibrium: {error}"
            )
            raise NoHoldError(f"{one.where}: {text}.") from error


def _near(model: Model, command: Array, q: Array) -> Near | None:
    """The equilibrium q (n,) of a hold under a command (n_a,); None where it does not move to first
    order."""
    path, (u, pulls) = model.arm.effects.transmission, _tension(model, command, q)
    with model.workspace() as work:
        here = Balance(model, u, work).linearise(q, 1.0)
    if here is None:
        return None
    compliance = here.compliance
    if pulls.any():
        columns = model.terms(q, np.zeros_like(q), u).actuation[:, pulls]
        answer, springs = compliance @ columns, np.diag(1.0 / path.stiffness[pulls])
        compliance = compliance - answer @ np.linalg.solve(
            springs + columns.T @ answer, columns.T @ compliance
        )
    return Near(q, compliance, pulls)


def _moved(model: Model, command: Array, near: Near | None) -> Array | None:
    """Equilibrium (n,) of a hold of another arm by one Newton step; None where that says nothing,
    as where a tendon goes slack."""
    if near is None:
        return None
    u, pulls = _tension(model, command, near.q)
    if (pulls != near.pulls).any():
        return None
    with model.workspace() as work:
        at = Balance(model, u, work).at(near.q, 1.0)
    return None if at is None else np.asarray(near.q + near.compliance @ at.force)


def _tension(model: Model, command: Array, q: Array) -> tuple[Array, Array]:
    """Tensions (n_a,) [N] under a command (n_a,) at coordinates q (n,), and which of them follow
    the arm (n_a,)."""
    path = model.arm.effects.transmission
    if not path.elastic:
        return command, np.zeros(command.size, dtype=bool)
    u = np.clip(
        path.stiffness * (command - path.length + model.tendon_lengths(q)), 0.0, path.strength
    )
    return u, (u > 0.0) & (u < path.strength)


def mean_of_finite(values: Iterable[float]) -> float:
    """Mean of the values that are there, NaN without any."""
    there = [value for value in values if np.isfinite(value)]
    return float(np.mean(there)) if there else np.nan
