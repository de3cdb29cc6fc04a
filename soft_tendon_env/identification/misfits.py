"""Signs in residuals that recordings are ruined or drift, and that the model lacks something."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.identification.misread import EXACT
from soft_tendon_env.identification.readings import mean_of_finite
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.tools.types import Array

Mask = NDArray[np.bool_]  # (samples, m)
CORRELATED = 0.3  # correlation of successive residuals that are no noise
FEWEST = 100  # pairs of successive residuals below which their correlation may be chance
CHANCE = 0.005  # probability below which residuals follow the commands, or drift
PERMUTATIONS = 999  # from which that probability is estimated, in steps of 1e-3
INDEPENDENT = 1e-9  # singular value, in parts of the largest, above which columns are independent
# outliers are few, further off than both shares
OUTLYING = 6.0  # distance in medians of all
GROSS = 0.01  # distance as a share of the rod's length
FEW_OUTLIERS = 0.2  # greatest share of all positions
STILL = 0.005  # share of the rod's length within which markers may be at rest: noise
# root mean square residual, in parts of a known noise, from which the model lacks something
FAR = 1.5
FAR_HELD_OUT = 2.0  # mean error of held-out recordings, in parts of the fit's, that is far from it
NAMED = 3  # held-out recordings that are named then
FEWEST_OF_DRIFT = 8  # holds below which a drift may be chance
DRIFT_DEGREE = 3  # of the polynomial over the session that follows a drift, or a jump
DRIFT_SHARE = 0.5  # of the squares of the residuals that a drift makes up at least
LACKING = (
    "the model lacks something that no parameter here makes up for, such as routing, a payload,"
    " friction, a gain or fidelity"
)


class Misfit(NamedTuple):
    """Residuals of a recording: simulated less measured positions."""

    recording: Recording
    residual: Array  # (samples, m, 3) [m], NaN where a marker was not seen
    held_out: bool

    @property
    def distance(self) -> Array:
        """Distances (samples, m) [m] of the markers, NaN where they were not seen."""
        return np.asarray(np.linalg.norm(self.residual, axis=-1))

    @property
    def error(self) -> float:
        """Mean distance [m], NaN without any."""
        return mean_of_finite(self.distance.ravel())


class Arm(NamedTuple):
    """Scales that sizes of residuals are compared with."""

    length: float  # of the rod [m]
    markers: Sequence[str]  # their names
    tendons: int


def misfit_texts(misfits: Sequence[Misfit], arm: Arm, noise: float | None) -> list[str]:
    """Findings about residuals: outliers, held-out data that are met badly, a lacking model.

    Args:
        misfits: of the recordings of the fit, and of held-out ones.
        arm: that was fitted.
        noise: standard deviation of a marker's coordinate [m], None: unknown.

    Returns:
        Sentences; none for residuals as small as those of simulated data without noise.
    """
    of_fit = [misfit for misfit in misfits if not misfit.held_out]
    residuals = [misfit.residual.ravel() for misfit in of_fit]
    squares = np.concatenate(residuals) ** 2
    mean_square = np.nanmean(squares)
    root = float(np.sqrt(mean_square))
    far_texts = _held_out_texts(misfits, arm)
    if root < EXACT * arm.length:  # of simulated data
        return far_texts
    texts = list[str]()
    if noise is not None and root > FAR * noise:
        texts.append(
            f"Residuals are {1e3 * root:.3g} mm where the noise is {1e3 * noise:.3g} mm: {LACKING}."
        )
    following = _following_commands(of_fit, arm.tendons)
    if following:
        texts.append(
            f"Residuals of holds follow the commands, by {1e3 * following:.2g} mm: {LACKING}."
        )
    # positions that stand out are what held-out data are far off by, where they are among these
    outlying = _outlying(misfits, arm.length)
    texts += _outlier_texts(misfits, outlying, arm)
    are_ruined = [
        misfit.held_out and bool(is_outlying.any())
        for misfit, is_outlying in zip(misfits, outlying, strict=True)
    ]
    if not any(are_ruined):
        texts += far_texts
    for misfit in of_fit:
        texts += _start_texts(misfit.recording, arm.length)
        texts += _correlation_texts(misfit.recording, misfit.residual)
    return texts


def drift_text(misfits: Sequence[Misfit]) -> str | None:
    """Finding that all markers drift together over a session, as where a camera moves.

    Args:
        misfits: of the recordings of the fit, and of held-out ones.

    Returns:
        A sentence; None where residuals do not drift, or holds are few.
    """
    holds = _holds_in_order(misfits)
    if len(holds) < FEWEST_OF_DRIFT:
        return None
    # a camera that moves shifts all markers alike
    means = [np.nanmean(misfit.residual[0], axis=0) for misfit in holds]
    shift = np.array(means)  # (holds, 3)
    shift -= shift.mean(axis=0)
    count = len(holds)
    place = np.linspace(-1.0, 1.0, count)
    powers = np.vander(place, DRIFT_DEGREE + 1, increasing=True)
    polynomials, _ = np.linalg.qr(powers)
    basis = polynomials[:, 1:]  # the first is constant, which the shift is free of
    squares = float((shift**2).sum())
    within = _squares_within(basis, shift)
    is_most = within >= DRIFT_SHARE * squares
    if squares == 0.0 or not is_most or not _is_beyond_chance(basis, shift):
        return None
    coefficients = basis.T @ shift
    drift = basis @ coefficients
    over_session = drift[-1] - drift[0]
    way = float(np.linalg.norm(over_session))
    first = holds[0].recording.name
    last = holds[-1].recording.name
    return (
        f"Residuals of all markers drift together over the session, by {1e3 * way:.2g} mm from"
        f" {first!r} to {last!r}: the camera, its frame or the mount moved. The estimate is biased"
        " by it: record again, or a part of the session alone."
    )


def _holds_in_order(misfits: Sequence[Misfit]) -> list[Misfit]:
    """Holds in which a marker was seen, of the first file of the fit, in the order of its rows."""
    sessions = [misfit.recording.session for misfit in misfits if not misfit.held_out]
    holds = [
        misfit
        for misfit in misfits
        if misfit.recording.session is sessions[0]
        and not misfit.recording.period
        and np.isfinite(misfit.residual).any()
    ]
    return sorted(holds, key=lambda misfit: misfit.recording.row)


def _outlying(misfits: Sequence[Misfit], length: float) -> list[Mask]:
    """Which positions (samples, m) of each recording stand out; none where they are many."""
    distances = list[Array]()
    for misfit in misfits:
        if misfit.recording.period:
            # from the mean of the sample before and the one after, which share an error of the
            # model; the first and the last have none
            inner = 0.5 * np.diff(misfit.residual, 2, axis=0)
            deviation = np.zeros_like(misfit.residual)
            deviation[1:-1] = inner
            distance = np.linalg.norm(deviation, axis=-1)
            distances.append(distance)
        else:
            distances.append(misfit.distance)
    every = np.concatenate(distances)
    of_all = OUTLYING * np.nanmedian(every)
    least = max(of_all, GROSS * length)
    count = (every > least).sum()
    seen_count = np.isfinite(every).sum()
    if count > FEW_OUTLIERS * seen_count:
        least = np.inf
    return [distance > least for distance in distances]


def _outlier_texts(misfits: Sequence[Misfit], outlying: Sequence[Mask], arm: Arm) -> list[str]:
    """Finding that a few positions stand out."""
    counts = (int(is_outlying.sum()) for is_outlying in outlying)
    count = sum(counts)
    if not count:
        return []
    farthest = list[float]()
    for misfit, is_outlying in zip(misfits, outlying, strict=True):
        distance = np.max(misfit.distance, where=is_outlying, initial=0.0)
        farthest.append(float(distance))
    worst = int(np.argmax(farthest))
    misfit = misfits[worst]
    outlying_distance = np.where(outlying[worst], misfit.distance, 0.0)
    by_marker = outlying_distance.max(axis=0)
    marker = arm.markers[int(by_marker.argmax())]
    effect = "outliers bias the estimate"
    kind = ""
    if misfit.held_out:
        effect = "the held-out error means nothing"
        kind = ", which is held out"
    return [
        f"{count} of the markers' positions stand out, above all {marker} in"
        f" {misfit.recording.name!r}{kind}, {1e3 * farthest[worst]:.3g} mm off: {effect}, leave"
        " their cells empty."
    ]


def _held_out_texts(misfits: Sequence[Misfit], arm: Arm) -> list[str]:
    """Finding that held-out recordings are met far worse than those of the fit, with the worst."""
    of_fit = [misfit.error for misfit in misfits if not misfit.held_out]
    held_out = [misfit for misfit in misfits if misfit.held_out and np.isfinite(misfit.error)]
    held_out_errors = [misfit.error for misfit in held_out]
    fit_error = mean_of_finite(of_fit)
    held_out_error = mean_of_finite(held_out_errors)
    exact = EXACT * arm.length
    least = max(FAR_HELD_OUT * fit_error, exact)
    if not held_out_error > least:
        return []
    worst_first = sorted(held_out, key=lambda misfit: -misfit.error)
    names = list[str]()
    for misfit in worst_first[:NAMED]:
        distance = np.nan_to_num(misfit.distance)
        by_marker = distance.max(axis=0)
        marker = int(by_marker.argmax())
        marker_name = arm.markers[marker]
        farthest = 1e3 * by_marker[marker]
        name = f"{misfit.recording.name!r} ({marker_name} by {farthest:.3g} mm)"
        names.append(name)
    worst = ", ".join(names)
    return [
        f"Held-out recordings are off by {1e3 * held_out_error:.2g} mm, those of the fit by"
        f" {1e3 * fit_error:.2g} mm: the worst are {worst}. They are ruined, or the model does not"
        " hold beyond the recordings of the fit."
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
    mean_square = np.nanmean(residual**2)
    if not common > CORRELATED * mean_square:
        return []
    return [
        f"Residuals of motion {recording.name!r} are no noise: successive ones have"
        f" {1e3 * np.sqrt(common):.2g} mm in common: {LACKING}; viscous damping alone cannot make"
        " up for friction or hysteresis."
    ]


def _following_commands(misfits: Sequence[Misfit], tendons: int) -> float:
    """Root mean square [m] of the part of residuals of holds that follows commands and squares.

    It is 0 where that may be chance, or where holds are few.
    """
    holds = [misfit for misfit in misfits if not misfit.recording.period]
    if len(holds) <= 2 * tendons + 2:
        return 0.0
    command_rows = [misfit.recording.command[0] for misfit in holds]
    residual_rows = [misfit.residual[0].ravel() for misfit in holds]
    commands = np.array(command_rows)
    every_column = np.array(residual_rows)
    # coordinates that all holds have
    is_seen = np.isfinite(every_column)
    is_whole = is_seen.all(axis=0)
    columns = every_column[:, is_whole]
    # an orthonormal basis of what a quadratic law of the commands could make
    constant = np.ones((len(holds), 1))
    squares = commands**2
    law = np.hstack([constant, commands, squares])
    U, values, _ = np.linalg.svd(law, full_matrices=False)
    is_independent = values > INDEPENDENT * values[0]
    basis = U[:, is_independent]
    if not _is_beyond_chance(basis, columns):
        return 0.0
    within = _squares_within(basis, columns)
    mean_square = within / columns.size
    return float(np.sqrt(mean_square))


def _is_beyond_chance(basis: Array, columns: Array) -> bool:
    """Whether columns (holds, k) lie in the span of a basis (holds, r) more than by chance.

    The basis is orthonormal. Chance is estimated by permutations of the holds (B. Phipson and
    G. K. Smyth 2010).
    """
    within = _squares_within(basis, columns)
    random = np.random.default_rng(0)
    as_large = 0
    for _ in range(PERMUTATIONS):
        permuted = random.permutation(columns)
        as_large += _squares_within(basis, permuted) >= within
    probability = (1 + as_large) / (1 + PERMUTATIONS)
    return probability <= CHANCE


def _squares_within(basis: Array, columns: Array) -> float:
    """Sum of squares of the part of columns (holds, k) in an orthonormal basis (holds, r)."""
    part = basis.T @ columns
    return float((part**2).sum())
