"""Findings about an estimate in words: what the data do not contain, parameters at a bound, over-fitting, residuals with a cause."""

import re
from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.fit import Fit, Loss, fit
from soft_tendon_env.identification.intervals import SHARE, Direction, Intervals
from soft_tendon_env.identification.parameters import Parameter
from soft_tendon_env.identification.readings import Readings, mean_of_finite
from soft_tendon_env.identification.split import same_commands
from soft_tendon_env.identification.structure import suspects
from soft_tendon_env.tools.types import Array

AT_BOUND = 1e-3
"""Distance from a bound, of that of both, at which a parameter is at it."""
CHANCE, PERMUTATIONS = 0.005, 999
"""Probability of chance below which residuals have a structure, and how many permutations it is estimated from."""
ALIKE, MOST = 0.5, 3
"""Share of what the likeliest fault explains of the residuals from which another is named beside it, and how many are."""
EXACT = 1e-6
"""Root mean square residual, as a share of the rod's length, below which data are exact: cameras see 1e-5 at best."""
CORRELATED, FEWEST = 0.3, 100
"""Correlation of successive residuals from which they are no noise, and pairs below which it may be so by chance."""
COARSE = 0.5
"""Share of an interval's reach by which a finer model may move a parameter."""
UNLIKELY = 5.0
"""Factor of a Young's modulus from which a unit may be wrong."""
RISEN, MATTERS = 0.01, 1.05
"""Probability of chance below which, and factor from which, the error of held-out data counts as higher."""
FAR = 1.5
"""Root mean square residual, in parts of a known noise, from which the model lacks something."""
LACKING = "the model lacks something that no parameter here makes up for, such as routing, a payload, friction, a gain or fidelity"
EXPERIMENTS = {
    "poisson_ratio": "twist shows it: an asymmetric pair of tendons or a helix, with markers off the axis",
    "damping": "a free decay shows it",
    "time_constant": "steps of the commands show it",
    "rate_limit": "large steps of the commands show it",
    "delay": "steps of the commands show it",
    "tendon_friction": "a loading and unloading loop, or a free decay, shows it",
    "normal_drag": "motion in the fluid shows it",
    "added_mass": "motion in the fluid shows it",
    "gain": "a known weight hung from the tip or a load cell shows it",
    "density": "holds in another direction of gravity, or weighing the arm, show it",
    "young_modulus": "a known weight hung from the tip shows it",
    "mount.rotation": "measure the mount's frame, or record the arm at rest",
    "mount.shift": "measure the mount's frame",
    "offset": "a prior from the drawing is all there is: measure it",
}
"""Experiments that show a parameter, by a part of its name; the first that fits."""
FORCES = ("gain", "young_modulus", "density", "mass", "force")
"""Parts of names of parameters in proportion to force: a common factor of all of them moves nothing at rest."""


def unseen_text(direction: Direction, parameters: Sequence[Parameter]) -> str:
    """A direction that the data do not contain, with the experiment that would show it."""
    named = sorted(
        ((abs(float(part)), own.name) for own, part in zip(parameters, direction.coordinates, strict=True) if abs(part) >= SHARE),
        reverse=True,
    )
    names = [name for _, name in named]
    far = f"{direction.deviation:.2g} times a factor of e, or its prior's standard deviation or half its range"
    size = f"uncertain by {far}" if np.isfinite(direction.deviation) else "which moves nothing"
    if len(names) > 1 and all(any(part in name for part in FORCES) for name in names) and any("gain" in name for name in names):
        text = f"The data do not contain the common factor of {', '.join(names)}: all forces at rest scale together"
        return f"{text}; a known weight hung from the tip, weighing the arm, or a load cell shows it."
    what = names[0] if len(names) == 1 else f"a combination of {', '.join(names)}"
    return f"The data do not contain {what}, {size}: {experiment(names[0])}."


def experiment(name: str) -> str:
    """Experiment that shows a parameter."""
    return next((text for part, text in EXPERIMENTS.items() if part in name), "holds that move it more show it, see --next")


def bound_texts(x: Array, parameters: Sequence[Parameter]) -> list[str]:
    """Parameters at a bound."""
    found = []
    for own, at in zip(parameters, x, strict=True):
        for bound in own.bounds:
            if abs(at - bound) <= AT_BOUND * (own.bounds[1] - own.bounds[0]):
                found.append(f"{own.name} is at its bound, {own.at(bound):.4g}: {experiment(own.name)}, or the bound is wrong.")
    return found


def unlikely_texts(x: Array, parameters: Sequence[Parameter]) -> list[str]:
    """Stiffness so far from the scene's that a unit may be wrong: at rest it is in proportion to the commands where nothing else loads."""
    found = []
    for own, at in zip(parameters, x, strict=True):
        if own.name.endswith("young_modulus") and abs(at) > np.log(UNLIKELY):
            far = f"{np.exp(abs(at)):.2g} times {'greater' if at > 0 else 'less'} than in the scene"
            found.append(f"{own.name} is {far}: is a unit wrong? Tensions in kg that are read as N make it 9.8 times less.")
    return found


def misfit_texts(found: Fit, readings: Readings, noise: float | None) -> list[str]:
    """Signs that the model lacks something: residuals above a known noise [m], and residuals that follow the commands."""
    texts, root = list[str](), float(np.sqrt(np.mean(found.residual[: int(readings.seen.sum())] ** 2)))
    if root < EXACT * readings.plants.length:
        text = f"The fit explains the data to the solver's tolerance, by {1e3 * root:.1g} mm: they have no noise, as simulated data"
        return [f"{text}; intervals are no measure of a real arm."]
    if noise is not None and root > FAR * noise:
        texts.append(f"Residuals are {1e3 * root:.3g} mm where the noise is {1e3 * noise:.3g} mm: {LACKING}.")
    probability, size = commands_in_residuals(found, readings)
    if probability <= CHANCE:
        texts.append(
            f"Residuals of holds follow the commands, by {1e3 * size:.2g} mm (by chance with probability {probability:.2g}): {LACKING}."
        )
    texts += structure_texts(found, readings)
    correlation, size = memory_of_residuals(found, readings)
    if correlation > CORRELATED:
        text = f"Residuals of motions are no noise: successive ones correlate by {correlation:.2f}, {1e3 * size:.2g} mm"
        texts.append(f"{text}: {LACKING}; viscous damping alone cannot make up for friction or hysteresis.")
    return texts


def structure_texts(found: Fit, readings: Readings) -> list[str]:
    """Faults of the drawing or the commands that the residuals of holds look like."""
    likely = [own for own in suspects(found, readings) if own.probability <= CHANCE]
    if not likely:
        return []
    alike = [own for own in likely if own.explained >= ALIKE * likely[0].explained][:MOST]
    what, chance = ", or as if ".join(own.what for own in alike), max(own.probability for own in alike)
    text = f"Residuals of holds look as if {what} (by chance with probability {chance:.1g})"
    return [f"{text}: measure this first, or estimate it; zeros of sensors, slack, friction and the routing can look alike."]


def repeats_text(fitted: Readings, unseen: Readings) -> str | None:
    """Warning where held-out recordings have commands of the fit; None where they do not."""
    group, count = same_commands([*fitted.recordings, *unseen.recordings]), len(fitted.recordings)
    again = int(np.isin(group[count:], group[:count]).sum())
    if not again:
        return None
    return f"{again} of {len(group) - count} held-out recordings repeat commands of the fit: their error says little about other commands."


def twins_text(twins: Sequence[str]) -> str | None:
    """Note on recordings that are there twice; None without any."""
    if not twins:
        return None
    more = f" and {len(twins) - MOST} more" if len(twins) > MOST else ""
    return f"Recordings that stand twice in the data count once: left out are {', '.join(twins[:MOST])}{more}."


def memory_of_residuals(found: Fit, readings: Readings) -> tuple[float, float]:
    """Correlation of successive residuals of the same marker coordinate in motions, and the root mean square [m] of the part that stays;
    (0, 0) without motions, or with too few samples."""
    residual = np.full(readings.measured.shape, np.nan)
    residual[readings.seen] = found.residual[: int(readings.seen.sum())]
    ends = np.cumsum([len(own.command) for own in readings.recordings])
    moving = [residual[end - len(own.command) : end] for own, end in zip(readings.recordings, ends, strict=True) if own.period]
    products = np.concatenate([(own[1:] * own[:-1]).ravel() for own in moving] or [np.zeros(0)])
    squares = np.concatenate([own.ravel() ** 2 for own in moving] or [np.zeros(0)])
    if np.isfinite(products).sum() < FEWEST or not np.nanmean(squares) > 0.0:
        return 0.0, 0.0
    common = max(float(np.nanmean(products)), 0.0)
    return common / float(np.nanmean(squares)), float(np.sqrt(common))


def coarse_text(moved: Array, found: Fit, parameters: Sequence[Parameter], spread: Intervals) -> str | None:
    """Warning where a finer model would change an estimate by a good part of its interval; None where it would not. moved (k,): the
    change of the coordinates, see intervals.shift."""
    names = []
    for own, change, x, linear, identified in zip(parameters, moved, found.x, spread.linear, spread.identified, strict=True):
        reach = 0.5 * abs(own.coordinate(linear[1]) - own.coordinate(linear[0]))
        if identified and abs(change) > COARSE * reach:
            names.append(f"{own.name} to about {own.at(x + change):.4g}")
    return f"A finer model would move {', '.join(names)}: take a finer fidelity." if names else None


def commands_in_residuals(found: Fit, readings: Readings) -> tuple[float, float]:
    """Probability that the residuals of holds follow their commands by chance, and the root mean square [m] of the part that does.

    Regression of each marker coordinate's residual on commands and their squares, in means of holds with the same commands, whose errors
    are common; the probability by permutations of them, which takes nothing for granted about errors within one (B. Phipson and G. K. Smyth
    2010). (1, 0) where they are too few.
    """
    still = np.array([not own.period for own in readings.recordings])
    _, group = np.unique(readings.group[still], return_inverse=True)
    if not group.size:
        return 1.0, 0.0
    mean = (group == np.arange(group.max() + 1)[:, None]) / np.bincount(group)[:, None]
    residual = np.full(readings.measured.shape, np.nan)
    residual[readings.seen] = found.residual[: int(readings.seen.sum())]
    columns = mean @ residual[: len(group)].reshape(len(group), -1)
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    command = mean @ np.array([own.command[0] for own in readings.recordings[: len(group)]]).reshape(len(group), -1)
    basis = np.hstack([np.ones((len(mean), 1)), command, command**2])
    if len(mean) <= basis.shape[1] + 1 or not columns.any():
        return 1.0, 0.0
    U, values, _ = np.linalg.svd(basis, full_matrices=False)
    U = U[:, values > 1e-9 * values[0]]
    follows = float(((U.T @ columns) ** 2).sum())
    random = np.random.default_rng(0)
    drawn = [float(((U.T @ random.permutation(columns)) ** 2).sum()) for _ in range(PERMUTATIONS)]
    return (1 + sum(own >= follows for own in drawn)) / (1 + PERMUTATIONS), float(np.sqrt(follows / columns.size))


def over_fitting_texts(found: Fit, fitted: Readings, unseen: Readings, loss: Loss) -> list[str]:
    """Warnings about parameters that lower the error of the fit and raise that of held-out data: each kind is left out in a fit of its own.

    The rise is tested in held-out groups of the same commands by Student's t, one-sided, for as many tests as there are kinds.
    """
    from scipy.stats import ttest_rel  # here: it takes longer to import than all else that most scenes need

    parameters, texts = fitted.plants.parameters, list[str]()
    kinds = list(dict.fromkeys(_family(own.name) for own in parameters))
    for kind in kinds if len(kinds) > 1 and unseen.recordings else ():
        kept = [i for i, own in enumerate(parameters) if _family(own.name) != kind]
        few, others = (Readings(fitted.plants.only(kept), own.recordings) for own in (fitted, unseen))
        x = fit(few, found.sigma, loss, found.x[kept]).x
        seen = [mean_of_finite(few.errors(x)), mean_of_finite(fitted.errors(found.x))]
        each = np.array([others.errors(x), unseen.errors(found.x)])
        groups = np.array([[mean_of_finite(own[unseen.group == i]) for i in range(unseen.group.max() + 1)] for own in each])
        before, after = groups[:, np.isfinite(groups).all(axis=0)]
        chance = len(kinds) * ttest_rel(after, before, alternative="greater").pvalue
        if seen[1] < seen[0] and after.mean() > MATTERS * before.mean() and chance <= RISEN:
            text = f"{kind} over-fits: with it the error of the fit goes from {1e3 * seen[0]:.3g} to {1e3 * seen[1]:.3g} mm"
            texts.append(f"{text}, that of held-out data from {1e3 * before.mean():.3g} to {1e3 * after.mean():.3g} mm.")
    return texts


def _family(name: str) -> str:
    """Name of parameters that are left out together: those of a vector, of all markers, of all commands."""
    return re.sub(r"\.\d+$", "", re.sub(r"^(markers|commands)\.[^.]+\.", r"\1.*.", name))
