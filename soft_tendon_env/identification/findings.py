"""Findings about an estimate in words.

They say what the data do not contain, signs that the model lacks something, data that were misread.
"""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.fit import MOST_TRIALS, UNSEEN, Fit
from soft_tendon_env.identification.misread import EXACT, misread_text
from soft_tendon_env.identification.parameters import Parameter
from soft_tendon_env.identification.readings import Readings, mean_of_finite
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.tools.types import Array

AT_BOUND = 1e-3  # distance from a bound, of that of both, at which a parameter is at it
CORRELATED = 0.3  # correlation of successive residuals that are no noise
FEWEST = 100  # pairs of successive residuals below which their correlation may be chance
CHANCE = 0.005  # probability below which residuals follow the commands
PERMUTATIONS = 999  # from which that probability is estimated, in steps of 1e-3
INDEPENDENT = 1e-9  # singular value, in parts of the largest, above which columns are independent
UNLIKELY = 5.0  # factor of a Young's modulus from which a unit may be wrong
# outliers are few, further off than both shares
OUTLYING = 6.0  # distance in medians of all
GROSS = 0.01  # distance as a share of the rod's length
FEW_OUTLIERS = 0.2  # greatest share of all positions
STILL = 0.005  # share of the rod's length within which markers may be at rest: noise
# root mean square residual, in parts of a known noise, from which the model lacks something
FAR = 1.5
# mean errors from which data may be misread: one of both shares is exceeded
MISREAD_SPREAD = 0.1  # of how far markers move
MISREAD_LENGTH = 0.02  # of the rod's length
LACKING = (
    "the model lacks something that no parameter here makes up for, such as routing, a payload,"
    " friction, a gain or fidelity"
)
EXPERIMENTS = {
    "poisson_ratio": (
        "twist shows it: an asymmetric pair of tendons or a helix, with markers off the axis"
    ),
    "damping": "a free decay shows it",
    "actuators": "large steps of the commands show it",
    "delay": "steps of the commands show it",
    "friction": "a loading and unloading loop, or a free decay, shows it",
    "gain": "a known weight hung from the tip or a load cell shows it",
    "density": "holds in another direction of gravity, or weighing the arm, show it",
    "young_modulus": "a known weight hung from the tip shows it",
    **dict.fromkeys(
        ("base.position", "base.rotation"), "measure the base's pose, or record the arm at rest"
    ),
    "bending": "a known weight hung from the tip shows it",
    "retardation": "a free decay shows it",
    "mass_per_length": "holds in another direction of gravity, or weighing it, show it",
}
"""Experiments that show a parameter, by a part of its name; the first that fits."""


def findings(
    estimate: Fit, unseen: Sequence[Array], fitted: Readings, noise: float | None
) -> list[str]:
    """Returns findings about an estimate.

    They say that the data are misread, or what they do not contain and the model lacks.

    Args:
        estimate: of `fit`.
        unseen: directions (k,) of the coordinates that the data do not contain.
        fitted: readings that it was fitted to.
        noise: standard deviation of a marker's coordinate [m], None: unknown.

    Returns:
        Sentences, of misread data these alone.
    """
    if _may_be_misread(estimate, fitted):
        text = misread_text(fitted, estimate.x, noise)
        if text:
            return [text]
    texts = list[str]()
    if not estimate.converged:
        texts.append(
            f"The fit did not converge in {MOST_TRIALS} trials of the parameters: estimate and"
            " intervals may be off. Estimate fewer, and none that the data do not contain."
        )
    texts += [_unseen_text(direction, fitted.plants.parameters) for direction in unseen]
    for parameter, x in zip(fitted.plants.parameters, estimate.x, strict=True):
        texts += _parameter_texts(parameter, x)
    return texts + _misfit_texts(estimate, fitted, noise)


def _may_be_misread(estimate: Fit, fitted: Readings) -> bool:
    """Whether an estimate leaves errors that are large beside the arm and its motion."""
    measured = np.ma.masked_invalid(fitted.measured)
    variance = measured.var(axis=0).sum(axis=-1)  # of each marker
    spread = float(np.sqrt(variance.mean()))
    bound = MISREAD_LENGTH * fitted.plants.model.length
    if spread > 0.0:  # of a single reading it is 0, and says nothing
        bound = min(MISREAD_SPREAD * spread, bound)
    errors = fitted.errors(estimate.x)
    return mean_of_finite(errors.values()) > bound


def _unseen_text(direction: Array, parameters: Sequence[Parameter]) -> str:
    """Finding that the data do not contain a direction (k,) of the parameters."""
    size = np.abs(direction)
    largest_first = np.argsort(-size)
    names = [parameters[i].name for i in largest_first if size[i] >= UNSEEN]
    what = ", ".join(names)
    if len(names) > 1:
        what = f"a combination of {what}"
    return f"The data do not contain {what}: {_experiment(' '.join(names))}."


def _parameter_texts(parameter: Parameter, x: float) -> list[str]:
    """Findings about one parameter at its coordinate: at a bound, or far from what is likely."""
    texts = list[str]()
    low, high = parameter.bounds
    for bound in (low, high):
        if abs(x - bound) <= AT_BOUND * (high - low):
            texts.append(
                f"{parameter.name} is at its bound, {parameter.at(bound):.4g}:"
                f" {_experiment(parameter.name)}, or the bound is wrong."
            )
    if parameter.name.endswith("young_modulus") and abs(x) > np.log(UNLIKELY):
        direction = "greater" if x > 0 else "less"
        texts.append(
            f"{parameter.name} is {np.exp(abs(x)):.2g} times {direction} than in the scene: is a"
            " unit wrong? Tensions in kg that are read as N make it 9.8 times less."
        )
    return texts


def _experiment(name: str) -> str:
    """Experiment that shows a parameter, or a combination of some."""
    for part, text in EXPERIMENTS.items():
        if part in name:
            return text
    return "holds that move it more show it, or measure it"


def _misfit_texts(estimate: Fit, readings: Readings, noise: float | None) -> list[str]:
    """Signs of outliers, and that the model lacks something.

    They are residuals above a known noise [m], and those that follow each other.
    """
    residual = np.full(readings.measured.shape, np.nan)  # (samples, m, 3), NaN where unseen
    residual[readings.seen] = estimate.residual
    mean_square = np.nanmean(residual**2)
    root = float(np.sqrt(mean_square))
    length = readings.plants.model.length
    if root < EXACT * length:  # of simulated data
        return []
    texts = list[str]()
    if noise is not None and root > FAR * noise:
        texts.append(
            f"Residuals are {1e3 * root:.3g} mm where the noise is {1e3 * noise:.3g} mm: {LACKING}."
        )
    following = _following_commands(residual, readings)
    if following:
        texts.append(
            f"Residuals of holds follow the commands, by {1e3 * following:.2g} mm: {LACKING}."
        )
    parts = np.split(residual, readings.ends[:-1])  # by recordings
    texts += _outlier_texts(parts, readings)
    for recording, part in zip(readings.recordings, parts, strict=True):
        texts += _start_texts(recording, length)
        texts += _correlation_texts(recording, part)
    return texts


def _outlier_texts(parts: Sequence[Array], readings: Readings) -> list[str]:
    """Finding that a few positions stand out, from residuals (samples, m, 3) of each recording."""
    deviations = list[Array]()
    for recording, part in zip(readings.recordings, parts, strict=True):
        if recording.period:
            # from the mean of the sample before and the one after, which share an error of the
            # model; the first and the last have none
            inner = 0.5 * np.diff(part, 2, axis=0)
            deviations.append(np.pad(inner, ((1, 1), (0, 0), (0, 0))))
        else:
            deviations.append(part)
    distance = np.linalg.norm(np.concatenate(deviations), axis=-1)  # (samples, m)
    of_all = OUTLYING * np.nanmedian(distance)
    least = max(of_all, GROSS * readings.plants.model.length)
    count = (distance > least).sum()
    if not 0 < count <= FEW_OUTLIERS * np.isfinite(distance).sum():
        return []
    sample, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
    marker_name = [*readings.plants.markers.markers][marker]
    recording = readings.recordings[np.searchsorted(readings.ends, sample, "right")]
    return [
        f"{count} of the markers' positions stand out, above all {marker_name} in"
        f" {recording.name!r}, {1e3 * np.nanmax(distance):.3g} mm off: outliers bias the estimate,"
        " leave their cells empty."
    ]


def _start_texts(recording: Recording, length: float) -> list[str]:
    """Finding that a motion of a rod of a length [m] does not begin at rest."""
    if not recording.period:
        return []
    first_step = recording.positions[1] - recording.positions[0]
    moved = np.linalg.norm(first_step, axis=-1).max()
    if not moved > STILL * length:
        return []
    return [
        f"Motion {recording.name!r} does not begin at rest under its first command: markers move"
        f" {1e3 * moved:.2g} mm in the first period, at rest up to {1e3 * STILL * length:.2g} mm."
        " Is the unit of time right?"
    ]


def _correlation_texts(recording: Recording, residual: Array) -> list[str]:
    """Finding that successive residuals (samples, m, 3) of a motion follow each other."""
    products = residual[1:] * residual[:-1]
    if np.isfinite(products).sum() < FEWEST:
        return []
    common = np.nanmean(products)
    if not common > CORRELATED * np.nanmean(residual**2):
        return []
    return [
        f"Residuals of motion {recording.name!r} are no noise: successive ones have"
        f" {1e3 * np.sqrt(common):.2g} mm in common: {LACKING}; viscous damping alone cannot make"
        " up for friction or hysteresis."
    ]


def _following_commands(residual: Array, readings: Readings) -> float:
    """Root mean square [m] of the part of the residuals of holds that follows commands.

    Residuals are (samples, m, 3), and follow commands and their squares; 0 where that may be
    chance, by permutations (B. Phipson and G. K. Smyth 2010), or where holds are few.
    """
    holds = [recording for recording in readings.recordings if not recording.period]
    if len(holds) <= 2 * len(readings.plants.scene.tendons) + 2:
        return 0.0
    commands = np.array([recording.command[0] for recording in holds])
    columns = residual[: len(holds)].reshape(len(holds), -1)
    columns = columns[:, np.isfinite(columns).all(axis=0)]  # coordinates that all holds have
    # an orthonormal basis of what a quadratic law of the commands could make
    constant = np.ones((len(holds), 1))
    law = np.hstack([constant, commands, commands**2])
    U, values, _ = np.linalg.svd(law, full_matrices=False)
    basis = U[:, values > INDEPENDENT * values[0]]
    follows = _squares_within(basis, columns)
    random = np.random.default_rng(0)
    as_large = 0  # permutations of the holds that follow the commands as much
    for _ in range(PERMUTATIONS):
        as_large += _squares_within(basis, random.permutation(columns)) >= follows
    chance = (1 + as_large) / (1 + PERMUTATIONS)
    return float(np.sqrt(follows / columns.size)) if chance <= CHANCE else 0.0


def _squares_within(basis: Array, columns: Array) -> float:
    """Sum of squares of the part of columns (holds, k) in the span of a basis.

    The basis (holds, r) is orthonormal.
    """
    return float(((basis.T @ columns) ** 2).sum())
