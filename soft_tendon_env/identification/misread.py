"""Data that were recorded another way than they are read: other axes, handedness, frame, tendons or units that explain them far better."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.identification.fit import Loss, fit
from soft_tendon_env.identification.markers import UNITS, MarkerSet
from soft_tendon_env.identification.plant import Plants
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.recordings import COMMANDS, Recording, check_commands
from soft_tendon_env.identification.sampling import USUAL
from soft_tendon_env.identification.simulated import with_steps
from soft_tendon_env.model.build import build_model
from soft_tendon_env.tools.types import Array

FAR = (0.1, 0.02)
"""Mean errors from which data may be misread: a share of how far markers move, and one of the rod's length."""
BETTER, ALIKE = 3.0, 1.5
"""Factor of the error by which another reading explains data far better, and up to which two of them do so alike."""
EXACT = 1e-6
"""Error, as a share of the rod's length, below which fits are alike."""
FEW, SAMPLES, LONG = 12, 60, 5.0
"""Holds, and least samples and duration [s] of a motion, by which other readings are judged."""
TRIED = 3
"""Readings that a fit is made for: those with the least error at the scene's own numbers."""

LOOK = "Look at units and signs of the commands, at the unit of time, at [frame], at the scene's stiffness and at the parameters' bounds."
"""Advice for data that the arm does not hold."""


class Reading(NamedTuple):
    """Other reading of the data: positions (in the scene's frame), commands and times by linear maps."""

    text: str
    positions: tuple[Array, Array] | None = None  # matrix (3, 3) and shift (3,) [m]
    commands: Array | None = None  # (n_a, n_a)
    time: float = 1.0

    def of(self, own: Recording) -> Recording:
        """A recording as it is read then."""
        command = own.command if self.commands is None else own.command @ self.commands.T
        positions = own.positions if self.positions is None else own.positions @ self.positions[0].T + self.positions[1]
        return replace(own, command=command, positions=positions, period=own.period * self.time)


def are_far(readings: Readings, error: float) -> bool:
    """Whether a mean error [m] is so large that the data may be misread."""
    spread = float(np.sqrt(np.ma.masked_invalid(readings.measured).var(axis=0).sum(axis=-1).mean()))
    return error > min(FAR[0] * spread or np.inf, FAR[1] * readings.plants.length)


def misread_text(readings: Readings, x: Array | None, noise: float | None, loss: Loss) -> str | None:
    """Finding that names how the data were recorded, where another reading explains them far better than the given one; None where none
    does. x (k,): the estimate, None where the fit failed. Units of time come first: with a wrong one all else takes long."""
    plants, few = readings.plants, _few(readings.recordings)
    simulated = _simulated(plants, few)
    given = _distance(simulated if x is None else _simulated(plants, few, x), few)
    for others in (_times(plants.markers, few[-1].period), [*_frames(plants.markers), *_commands(plants)]):
        read = [[other.of(own) for own in few] for other in others]
        nominal = [
            _distance(simulated if other.positions else _simulated(plants, own), own) for other, own in zip(others, read, strict=True)
        ]
        order = [int(i) for i in np.argsort(nominal, kind="stable")[:TRIED] if nominal[i] < _distance(simulated, few)]
        errors = [_fitted(plants, read[i], noise, loss) for i in order]
        least = max(min(errors, default=np.inf), EXACT * plants.length)
        if BETTER * least < given:
            names = [others[i].text for i, own in zip(order, errors, strict=True) if own <= ALIKE * least]
            text = f"The data fit {f'{given / least:.2g} times better' if np.isfinite(given) else 'only'} with {', or with '.join(names)}"
            text += f": markers are off by {1e3 * least:.2g} mm then. Set it right in [columns] or [frame] of the markers' file"
            return f"{text}, or in the scene; the estimate means nothing until then."
    return None


def _few(recordings: Sequence[Recording]) -> list[Recording]:
    """Some of the holds, and the beginning of a motion, with nothing but positions."""
    holds, motions = ([own for own in recordings if bool(own.period) == moves] for moves in (False, True))
    chosen = [holds[i] for i in np.unique(np.linspace(0, len(holds) - 1, FEW).astype(int))] if holds else []
    for own in motions[:1]:
        last = max(int(LONG / own.period), SAMPLES)
        chosen.append(replace(own, command=own.command[:last], positions=own.positions[:last]))
    return [replace(own, sensed=None) for own in chosen]


def _readings(plants: Plants, recordings: Sequence[Recording]) -> Readings:
    """Readings of recordings. Raises ValueError for commands beyond their limits."""
    for own in recordings:
        check_commands(own, plants.scene)
    scene = with_steps(plants.scene, recordings)
    return Readings(plants if scene is plants.scene else Plants(scene, build_model(scene), plants.markers, plants.parameters), recordings)


def _simulated(plants: Plants, recordings: Sequence[Recording], x: Array | None = None) -> Array | float:
    """Positions (samples, m, 3) [m] at coordinates (k,), by default at the scene's numbers; infinity where there are none."""
    try:
        return _readings(plants, recordings).positions(np.zeros(len(plants.parameters)) if x is None else x)
    except ValueError:
        return np.inf


def _distance(simulated: Array | float, recordings: Sequence[Recording]) -> float:
    """Mean distance [m] of simulated markers from those of recordings."""
    return float(np.nanmean(np.linalg.norm(simulated - np.concatenate([own.positions for own in recordings]), axis=-1)))


def _fitted(plants: Plants, recordings: Sequence[Recording], noise: float | None, loss: Loss) -> float:
    """Mean distance [m] of markers after a fit; infinite where there is none."""
    try:
        readings = _readings(plants, recordings)
        return _distance(readings.positions(fit(readings, noise, loss).x), readings.recordings)
    except ValueError:
        return np.inf


def _times(markers: MarkerSet, period: float) -> list[Reading]:
    """Readings of times in other units, by which sample periods are usual."""
    factors, given = UNITS["s"], markers.sources({"time": "s"}, strict=False)["time"].factor
    usual = {unit: factor for unit, factor in factors.items() if factor != given and USUAL[0] <= period * factor / given < USUAL[1]}
    return [Reading(f"times in {unit}", time=factor / given) for unit, factor in usual.items()]


def _frames(markers: MarkerSet) -> list[Reading]:
    """Readings of positions with other axes, in a frame that is given in another way."""
    frame = markers.frame
    R, shift = frame.matrix[:3, :3], np.array(frame.translation)

    def reading(text: str, matrix: Array, after: Array = shift) -> Reading:
        """By a matrix of data in their frame, R^T (p - shift)."""
        return Reading(text, (matrix @ R.T, after - matrix @ R.T @ shift))

    found = []
    if abs(frame.quaternion[0]) < 1.0:
        found += [
            reading("the quaternion of [frame] as x, y, z, w", Rotation.from_quat(frame.quaternion).as_matrix()),
            reading("[frame] inverted", R.T, -R.T @ shift),
        ]
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)):
        axes = ", ".join("-"[sign:] + "xyz"[i] for i, sign in zip(order, signs, strict=True))
        S = np.array(signs)[:, None] * np.eye(3)[list(order)]
        hand = " (a mirror image: the frame of the data is left-handed)" if np.linalg.det(S) < 0.0 else ""
        if (S != np.eye(3)).any():
            found.append(reading(f"x, y, z of the data read as {axes}{hand}", R @ S))
    return found


def _commands(plants: Plants) -> list[Reading]:
    """Readings of commands: tendons in another order, the other sign, other units."""
    unit, n = plants.scene.effects.command_unit, len(plants.scene.tendons)
    orders = {}
    for i, j in itertools.combinations(range(n), 2):
        orders[tuple({i: j, j: i}.get(k, k) for k in range(n))] = f"tendons {i} and {j} exchanged"
    ends = [tendon.end for tendon in plants.scene.tendons]
    for group in [range(n), *([i for i in range(n) if ends[i] == end] for end in dict.fromkeys(ends))]:
        for turn, step in itertools.product(range(len(group)), (1, -1)):
            places = {i: group[(turn + step * place) % len(group)] for place, i in enumerate(group)}
            order = tuple(places.get(i, i) for i in range(n))
            orders.setdefault(order, f"tendons 0 to {n - 1} numbered {', '.join(map(str, order))}")
    found = [Reading(text, commands=np.eye(n)[list(order)]) for order, text in orders.items() if order != tuple(range(n))]
    source = plants.markers.sources({f"{COMMANDS[unit]}_0": unit}, strict=False)[f"{COMMANDS[unit]}_0"]
    given = abs(source.factor)
    units = [Reading(f"commands in {name}", commands=np.eye(n) * factor / given) for name, factor in UNITS[unit].items() if factor != given]
    return [*found, Reading("commands of the other sign", commands=-np.eye(n)), *units]
