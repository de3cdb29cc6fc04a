"""Readings of recordings beside simulated ones: residuals and their derivatives.

Equilibria of still holds are sought by Newton's method from the last ones that were found for their
recordings, so that a fit re-solves each in a few iterations; their derivatives take one Newton step
from there (implicit function theorem). Motions begin at rest under their first command; each
command is held until the next sample.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.identification.backlash import after_play
from soft_tendon_env.identification.clusters import clusters
from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.identification.parameters import Parameter, Quantity
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.statics import commanded_equilibrium, static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

HOLD_DIFFERENCE = 1e-4  # of coordinates, central: equilibria are exact to 1e-10
MOTION_DIFFERENCE = 1e-3  # of coordinates where there are motions: exact to the steps' tolerance


class NoHoldError(ValueError):
    """Raised where the arm has no equilibrium for a hold, or its motion cannot be simulated."""


class Measurement(NamedTuple):
    """How an arm is placed, marked and commanded."""

    position: Array  # (3,) of the base [m]
    offsets: Array  # (m, 3) of the markers [m]
    gain: Array  # (n_a,) of the commands
    offset: Array  # (n_a,) of the commands, after the gain
    backlash: Array  # (n_a,) half-width of the commands' play, before the gain

    def positions(self, poses: Array) -> Array:
        """Positions (..., m, 3) [m] of markers in the world.

        Section poses (..., m, 4, 4) are along its axes, but beginning at the base.
        """
        rotation = poses[..., :3, :3]
        centre = poses[..., :3, 3]
        turned = np.einsum("...ij,...j->...i", rotation, self.offsets)
        from_base = centre + turned
        return np.asarray(from_base + self.position)


class Near(NamedTuple):
    """Equilibrium of a hold, and its derivative by forces while the command stays.

    The forces act on its coordinates.
    """

    q: Array  # (n,)
    compliance: Array  # (n, n)
    pulls: Array  # (n_a,) bool, of elastic tendons those whose tension follows the arm


class Plants:
    """Arms by coordinates of the parameters.

    The grid is that of the nominal scene, so that what is simulated is smooth in them.
    """

    def __init__(
        self, scene: Scene, model: Model, markers: MarkerSet, parameters: Sequence[Parameter]
    ) -> None:
        self.scene = scene
        self.model = model
        self.markers = markers
        self.parameters = tuple(parameters)
        # quantities that leave the poses of sections as they are, seen from the base's place; that
        # place matters to an arm where an effect changes from place to place, as contact does
        still = {Quantity.MARKER_OFFSET}
        effects = scene.effects.on_arm().chosen().values()
        if all(effect.is_uniform for effect in effects):
            still.add(Quantity.BASE_POSITION)
        self.moves_arm = [parameter.quantity not in still for parameter in self.parameters]

    def scene_at(self, x: Array, scene: Scene) -> Scene:
        """A scene with the numbers at coordinates (k,) of the parameters.

        Raises ConfigurationError.
        """
        changes = dict[str, Any]()
        for parameter, coordinate in zip(self.parameters, x, strict=True):
            value = parameter.at(coordinate)
            if parameter.quantity is Quantity.COMMAND_DELAY:
                changes["effects.actuators.delay"] = value
            elif parameter.of_scene is not None:
                changes |= parameter.of_scene.changes(value)
        return scene_with_numbers(scene, changes)

    def measurement(self, x: Array) -> Measurement:
        """Base, markers and commands at coordinates (k,)."""
        n_a = len(self.scene.tendons)
        measurement = Measurement(
            position=np.array(self.scene.base.position),
            offsets=self.markers.offsets,
            gain=np.ones(n_a),
            offset=np.zeros(n_a),
            backlash=np.zeros(n_a),
        )
        arrays = {
            Quantity.BASE_POSITION: measurement.position,
            Quantity.MARKER_OFFSET: measurement.offsets,
            Quantity.COMMAND_GAIN: measurement.gain,
            Quantity.COMMAND_OFFSET: measurement.offset,
            Quantity.COMMAND_BACKLASH: measurement.backlash,
        }
        for parameter, coordinate in zip(self.parameters, x, strict=True):
            if parameter.quantity in arrays:
                arrays[parameter.quantity][parameter.index] = parameter.at(coordinate)
        return measurement


class Readings:
    """Readings of recordings in one vector (N,).

    They are the coordinates of `measured` positions (samples of all recordings, m, 3) [m] that are
    `seen`. cluster: index of each reading (N,) that those with common errors share, see `clusters`.
    """

    def __init__(self, plants: Plants, recordings: Sequence[Recording]) -> None:
        self.plants = plants
        # holds, then motions
        self.recordings = sorted(recordings, key=lambda recording: bool(recording.period))
        # equilibrium of each that was found last, from which the next one is sought
        self._rests: list[Array | None] = [None] * len(recordings)
        # commands after the play of a width, by files and widths: most parameters leave them
        self._arriving = dict[tuple[int, bytes], Array]()
        # coordinates of the parameters that were simulated last, and the poses there: residuals,
        # derivatives and errors are asked for at the same ones
        self._last_x = b""
        self._last_poses: Array = np.empty((0, 0, 4, 4))
        has_motions = any(recording.period for recording in recordings)
        if has_motions:
            self._difference = MOTION_DIFFERENCE
        else:
            self._difference = HOLD_DIFFERENCE
        samples = [len(recording.command) for recording in self.recordings]
        self.ends = np.cumsum(samples)
        marker_count = len(plants.markers.markers)
        nothing = np.empty((0, marker_count, 3))  # its shape, without recordings
        positions = [recording.positions for recording in self.recordings]
        self.measured = np.concatenate([nothing, *positions])
        self.seen = np.isfinite(self.measured)
        # the cluster of every coordinate that was seen
        sample_cluster = np.repeat(clusters(self.recordings), samples)
        by_sample = sample_cluster[:, None, None]
        reading_cluster = np.broadcast_to(by_sample, self.seen.shape)
        self.cluster = reading_cluster[self.seen]

    def positions(self, x: Array) -> Array:
        """Simulated positions (samples, m, 3) [m] at coordinates x (k,).

        Raises NoHoldError, ConfigurationError.
        """
        measurement = self.plants.measurement(x)
        return measurement.positions(self._poses(x))

    def residual(self, x: Array, poses: Array | None = None) -> Array:
        """Simulated less measured readings (N,) [m], from `_poses` at x, or others that are given.

        Raises as `positions`.
        """
        if poses is None:
            poses = self._poses(x)
        measurement = self.plants.measurement(x)
        simulated = measurement.positions(poses)
        error = simulated - self.measured
        return np.asarray(error[self.seen])

    def by_recording(self, readings: Array) -> list[Array]:
        """Readings (N,) as an array (samples, m, 3) for each recording.

        It is NaN where a marker was not seen.
        """
        whole = np.full(self.measured.shape, np.nan)
        whole[self.seen] = readings
        borders = self.ends[:-1]
        return np.split(whole, borders)

    def jacobian(self, x: Array) -> Array:
        """Derivatives (N, k) [m] of the readings by the coordinates.

        They are central differences within the bounds. Raises as `positions`.
        """
        poses = self._poses(x)  # which also finds the equilibria that the holds begin from
        near = self._near_holds(x)
        h = self._difference
        columns = list[Array]()
        for i, parameter in enumerate(self.plants.parameters):
            least, greatest = parameter.bounds
            low = max(x[i] - h, least)
            high = min(x[i] + h, greatest)
            moves = self.plants.moves_arm[i]
            residuals = list[Array]()
            for value in (low, high):
                coordinates = x.copy()
                coordinates[i] = value
                # an arm that stays keeps its poses, which take nearly all of the time
                if moves:
                    moved_poses = self._poses(coordinates, near)
                else:
                    moved_poses = poses
                residuals.append(self.residual(coordinates, moved_poses))
            low_residual, high_residual = residuals
            change = high_residual - low_residual
            columns.append(change / (high - low))
        self._last_x = b""  # holds that were solved beside x have moved the rests from there
        return np.stack(columns, axis=-1)

    def _near_holds(self, x: Array) -> list[Near | None]:
        """Equilibria of the holds with how they move, at coordinates x (k,); None for motions."""
        near = list[Near | None]()
        for recording, q, (model, command) in zip(
            self.recordings, self._rests, self._arms(x), strict=True
        ):
            is_hold = not recording.period
            if is_hold and q is not None:
                near.append(_near(model, command[0], q))
            else:
                near.append(None)
        return near

    def errors(self, x: Array) -> dict[str, float]:
        """Mean distance [m] of the seen markers from where they are simulated, by recordings.

        It is NaN without any. Raises as `positions`.
        """
        error = self.positions(x) - self.measured
        distance = np.linalg.norm(error, axis=-1)
        # without recordings there is one empty part
        borders = self.ends[:-1]
        parts = np.split(distance, borders)
        errors = dict[str, float]()
        for recording, part in zip(self.recordings, parts, strict=False):
            every_distance = part.ravel()
            errors[recording.name] = mean_of_finite(every_distance)
        return errors

    def _arms(self, x: Array) -> list[tuple[Model, Array]]:
        """The model at coordinates x (k,), with the commands (samples, n_a) of each recording."""
        plants = self.plants
        scene = plants.scene_at(x, plants.scene)
        model = plants.model.with_scene(scene)
        measurement = plants.measurement(x)
        arms = list[tuple[Model, Array]]()
        for recording in self.recordings:
            arriving = self._arriving_command(recording, measurement.backlash)
            command = measurement.gain * arriving + measurement.offset
            arms.append((model, command))
        return arms

    def _arriving_command(self, recording: Recording, backlash: Array) -> Array:
        """Commands (samples, n_a) of a recording after the play of a half-width (n_a,).

        The play depends on all that its file has before.
        """
        if not backlash.any():
            return recording.command
        session = recording.session
        if session is None:
            session = recording.command
        key = id(session), backlash.tobytes()
        if key not in self._arriving:
            self._arriving[key] = after_play(session, backlash)
        arriving = self._arriving[key]
        first = recording.row
        last = first + len(recording.command)
        return arriving[first:last]

    def _poses(self, x: Array, near: Sequence[Near | None] = ()) -> Array:
        """Poses (samples, m, 4, 4) of markers' sections from the base's place.

        Those of holds `near` others are linear. Raises NoHoldError.
        """
        key = x.tobytes()
        if not near and key == self._last_x:
            return self._last_poses
        arms = self._arms(x)
        simulated = list[Array]()  # coordinates (n,) of each sample
        with erring_actuators():  # by the gains and offsets that are looked for
            for i, (model, command) in enumerate(arms):
                moved = None
                if near:
                    moved = _moved(model, command[0], near[i])
                if moved is None:
                    simulated += self._simulate(model, command, i)
                else:
                    simulated.append(moved)
        model = self.plants.model
        if arms:
            model, _ = arms[0]
        places = self.plants.markers.arc_lengths
        samples = [model.backbone_at(q, places) for q in simulated]
        # its shape, also without recordings
        flat = np.array(samples)
        poses = flat.reshape(-1, places.size, 4, 4)
        measurement = self.plants.measurement(x)
        poses[..., :3, 3] -= measurement.position
        if not near:
            self._last_x = key
            self._last_poses = poses
        return poses

    def _simulate(self, model: Model, command: Array, i: int) -> list[Array]:
        """Coordinates (n,) at every sample of a recording under commands (samples, n_a).

        Raises NoHoldError.
        """
        recording = self.recordings[i]
        try:
            return self._simulated(model, command, i)
        except (SimulationDiverged, NoHoldError, StrainLimitError) as error:
            if recording.period:
                text = (
                    f"motion {recording.name!r} cannot be simulated: {error}. Its samples are"
                    f" {recording.period:.3g} s apart, if their unit is right"
                )
            else:
                text = f"hold {recording.name!r} has no equilibrium: {error}"
            raise NoHoldError(f"{recording.where}: {text}.") from error

    def _simulated(self, model: Model, command: Array, i: int) -> list[Array]:
        """Readings of a motion or hold.

        Raises:
            SimulationDiverged, NoHoldError, StrainLimitError: without the recording's name.
        """
        period = self.recordings[i].period
        if model.command_unit == "N":
            tension = command[0]
            near = self._rests[i]
            rest = static_equilibrium(model, tension, near, settle=bool(period))
        else:
            rest, tension = commanded_equilibrium(model, command[0])
        if not rest.converged:
            raise NoHoldError(rest.reason)
        self._rests[i] = rest.q
        if not period:
            return [rest.q]
        start = Simulation(model).reset(rest.q, tension=tension)
        duration = period * (len(command) - 1)
        held = command[:-1]
        motion = simulate(model, held, duration, period, start)
        return list(motion.q)


def _near(model: Model, command: Array, q: Array) -> Near | None:
    """Equilibrium q (n,) of a hold under a command (n_a,).

    None where it does not move to first order.
    """
    u, pulls = _tension(model, command, q)
    with model.workspace() as work:
        linearised = Balance(model, u, work).linearise(q, 1.0)
    if linearised is None:
        return None
    compliance = linearised.compliance
    if pulls.any():
        # springs of tendons that follow the arm stand in parallel with it; Woodbury's identity:
        # (K + B k B^T)^-1 = C - C B (k^-1 + B^T C B)^-1 B^T C with C = K^-1
        terms = model.terms(q, np.zeros_like(q), u)
        columns = terms.actuation[:, pulls]
        stiffness = model.arm.effects.transmission.stiffness[pulls]
        spring_compliance = np.diag(1.0 / stiffness)
        response = compliance @ columns
        stretch = columns.T @ compliance
        in_parallel = spring_compliance + columns.T @ response
        forces = np.linalg.solve(in_parallel, stretch)
        relief = response @ forces
        compliance = compliance - relief
    return Near(q, compliance, pulls)


def _moved(model: Model, command: Array, near: Near | None) -> Array | None:
    """Equilibrium (n,) of a hold of another arm by one Newton step.

    None where that says nothing, as where a tendon goes slack.
    """
    if near is None:
        return None
    u, pulls = _tension(model, command, near.q)
    if (pulls != near.pulls).any():
        return None
    with model.workspace() as work:
        balance_of_command = Balance(model, u, work)
        balance = balance_of_command.at(near.q, 1.0)
    if balance is None:
        return None
    step = near.compliance @ balance.force
    return np.asarray(near.q + step)


def _tension(model: Model, command: Array, q: Array) -> tuple[Array, Array]:
    """Tensions (n_a,) [N] under a command (n_a,) at coordinates q (n,).

    It also says which of them follow the arm (n_a,).
    """
    path = model.arm.effects.transmission
    if not path.elastic:
        none_follows = np.zeros(command.size, dtype=bool)
        return command, none_follows
    way = command - path.length
    stretch = way + model.tendon_lengths(q)
    unbounded = path.stiffness * stretch
    u = np.clip(unbounded, 0.0, path.strength)
    # a slack tendon, and one at its drive's strength, keep their tension as the arm moves
    is_taut = u > 0.0
    is_held = u < path.strength
    return u, is_taut & is_held


def mean_of_finite(values: Iterable[float]) -> float:
    """Mean of the values that are there, NaN without any."""
    finite = [value for value in values if np.isfinite(value)]
    if finite:
        return float(np.mean(finite))
    return np.nan
