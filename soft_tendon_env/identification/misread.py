"""Data that were misread: another reading of axes, signs, units or markers explains them better."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from soft_tendon_env.identification.columns import matches_of
from soft_tendon_env.identification.fit import fit
from soft_tendon_env.identification.markers import UNITS
from soft_tendon_env.identification.readings import Plants, Readings
from soft_tendon_env.identification.recordings import Recording, check_commands
from soft_tendon_env.tools.types import COMMANDS, Array

# error of data without noise, as a share of the rod's length: cameras see 1e-5 at best
EXACT = 1e-6
# another reading is tried on a few holds and the beginning of a motion
BETTER = 3.0  # factor by which it explains them far better
FEW = 12  # holds, evenly over the data
SAMPLES = 60  # of the motion
FEW_MARKERS = 4  # of which all orders are tried


def misread_text(readings: Readings, x: Array | None, noise: float | None) -> str | None:
    """Finding where another reading of axes, signs, units or markers explains the data far better.

    Args:
        readings: of the data as they are read.
        x: the estimate (k,), or None where the arm does not hold the data.
        noise: standard deviation of a marker's coordinate [m], None: unknown.

    Returns:
        A sentence, or None where no other reading is far better.
    """
    plants = readings.plants
    few = _few(readings.recordings)
    # readings are ranked at the scene's own numbers, and only the best of them is fitted
    text, read = _best_reading(plants, few)
    if x is None:
        estimate_x = np.zeros(len(plants.parameters))
    else:
        estimate_x = x
    simulated = _simulate(plants, few, estimate_x)
    distance = _distance(simulated, few)
    try:
        estimate = fit(Readings(plants, read), noise)
    except ValueError:  # the arm does not hold that reading either
        return None
    simulated = _simulate(plants, read, estimate.x)
    fitted_distance = _distance(simulated, read)
    least = max(fitted_distance, EXACT * plants.model.length)
    if not BETTER * least < distance:
        return None
    if np.isfinite(distance):
        better = f"{distance / least:.2g} times better"
    else:
        better = "only"
    return (
        f"The data fit {better} with {text}: markers are off by {1e3 * least:.2g} mm then. Set it"
        " right in [columns] or [frame] of the markers' file, or in the scene; the estimate means"
        " nothing until then."
    )


def _few(recordings: Sequence[Recording]) -> list[Recording]:
    """Some holds, evenly over the data, and the beginning of a motion."""
    holds = [recording for recording in recordings if not recording.period]
    motions = [recording for recording in recordings if recording.period]
    holds_per_few = len(holds) / FEW
    stride = math.ceil(holds_per_few) or 1
    chosen = holds[::stride] + motions[:1]
    beginnings = list[Recording]()
    for recording in chosen:
        beginning = replace(
            recording,
            command=recording.command[:SAMPLES],
            positions=recording.positions[:SAMPLES],
            session=None,
            row=0,
        )
        beginnings.append(beginning)
    return beginnings


def _best_reading(plants: Plants, recordings: Sequence[Recording]) -> tuple[str, list[Recording]]:
    """Other reading that agrees best with the arm at the scene's numbers, in words.

    It comes with the recordings in it.
    """
    nominal = np.zeros(len(plants.parameters))
    candidates = list[tuple[float, str, list[Recording]]]()
    frame = plants.markers.frame
    simulated = _simulate(plants, recordings, nominal)
    for text, S in _axes().items():
        # the axes of the data are exchanged, in whose frame the positions were measured
        R = frame.rotation @ S @ frame.rotation.T
        read = list[Recording]()
        for recording in recordings:
            inside = recording.positions - frame.translation
            exchanged = inside @ R.T
            positions = exchanged + frame.translation
            read.append(replace(recording, positions=positions))
        distance = _distance(simulated, read)
        candidates.append((distance, text, read))
    for text, order in _orders([*plants.markers.markers]).items():
        read = list[Recording]()
        for recording in recordings:
            positions = recording.positions[:, order]
            read.append(replace(recording, positions=positions))
        distance = _distance(simulated, read)
        candidates.append((distance, text, read))
    for text, factor in command_factors(plants).items():
        read = list[Recording]()
        for recording in recordings:
            command = factor * recording.command
            read.append(replace(recording, command=command, session=None))
        simulated = _simulate(plants, read, nominal)
        distance = _distance(simulated, read)
        candidates.append((distance, text, read))
    _, text, read = min(candidates, key=lambda candidate: candidate[0])
    return text, read


def _simulate(plants: Plants, recordings: Sequence[Recording], x: Array) -> Array:
    """Positions (samples, m, 3) [m] at coordinates x (k,).

    They are infinite where the arm does not hold the recordings.
    """
    try:
        for recording in recordings:
            check_commands(recording, plants.scene)
        return Readings(plants, recordings).positions(x)
    except ValueError:
        return np.array(np.inf)


def _distance(simulated: Array, recordings: Sequence[Recording]) -> float:
    """Mean distance [m] of simulated markers from those of recordings."""
    positions = [recording.positions for recording in recordings]
    measured = np.concatenate(positions)
    error = simulated - measured
    distance = np.linalg.norm(error, axis=-1)
    return float(np.nanmean(distance))


def _axes() -> dict[str, Array]:
    """Other axes and signs of positions, as matrices (3, 3)."""
    matrices = dict[str, Array]()
    orders = itertools.permutations(range(3))
    all_signs = itertools.product((1, -1), repeat=3)
    unit = np.eye(3)
    for order, signs in itertools.product(orders, all_signs):
        exchange = unit[list(order)]
        column = np.array(signs)[:, None]
        S = column * exchange
        axes = list[str]()
        for axis, sign in zip(order, signs, strict=True):
            name = "xyz"[axis]
            axes.append(name if sign > 0 else f"-{name}")
        names = ", ".join(axes)
        text = f"x, y, z of the data read as {names}"
        if np.linalg.det(S) < 0.0:
            text += " (a mirror image: the frame of the data is left-handed)"
        matrices[text] = S
    return matrices


def _orders(names: Sequence[str]) -> dict[str, list[int]]:
    """Other orders of the markers: all of them for a few, otherwise two exchanged."""
    orders = dict[str, list[int]]()
    own_order = [*range(len(names))]
    for first, second in itertools.combinations(own_order, 2):
        order = own_order.copy()
        order[first] = second
        order[second] = first
        text = f"markers {names[first]} and {names[second]} exchanged"
        orders[text] = order
    if len(names) > FEW_MARKERS:
        return orders
    for permutation in itertools.permutations(own_order):
        moved = [i for i in own_order if permutation[i] != i]
        if len(moved) <= 2:  # their own order, and the exchanges above
            continue
        before = ", ".join(names[i] for i in moved)
        read_as = (names[permutation[i]] for i in moved)
        after = ", ".join(read_as)
        text = f"markers {before} read as {after}"
        orders[text] = [*permutation]
    return orders


def command_factors(plants: Plants) -> dict[str, float]:
    """Factors of commands by what they mean: other units, and the other sign.

    Args:
        plants: with the columns of their data.

    Returns:
        By words the factor that makes commands as they are read commands in another reading.
    """
    effects = plants.scene.effects
    unit = effects.command_unit
    factor_of_unit = UNITS[unit]
    tendon_count = len(plants.scene.tendons)
    column_name = COMMANDS[unit]
    commands = [f"{column_name}_{i}" for i in range(tendon_count)]
    # the unit that [columns] says, of which the first stands for all
    current = 1.0
    for key, column in plants.markers.columns.items():
        if matches_of(key, commands) and column.unit:
            # counts are in the SI unit once their scale has been taken
            current = factor_of_unit.get(column.unit, 1.0)
            break
    factors = dict[str, float]()
    for name, factor in factor_of_unit.items():
        if factor != current:
            factors[f"commands in {name}"] = factor / current
    factors["commands of the other sign"] = -1.0
    return factors
