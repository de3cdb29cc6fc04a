"""Findings about an estimate in words.

They say what the data do not contain, signs that the model lacks something, data that were misread.
"""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.fit import MOST_TRIALS, UNSEEN, Fit
from soft_tendon_env.identification.misfits import Arm, Misfit, drift_text, misfit_texts
from soft_tendon_env.identification.misread import misread_text
from soft_tendon_env.identification.parameters import Parameter
from soft_tendon_env.identification.readings import Readings, mean_of_finite
from soft_tendon_env.identification.selection import fewer_parameters_text
from soft_tendon_env.tools.types import Array

AT_BOUND = 1e-3  # distance from a bound, of that of both, at which a parameter is at it
UNLIKELY = 5.0  # factor of a Young's modulus from which a unit may be wrong
# mean errors from which data may be misread: one of both shares is exceeded
MISREAD_SPREAD = 0.1  # of how far markers move
MISREAD_LENGTH = 0.02  # of the rod's length
EXPERIMENTS = {
    "poisson_ratio": (
        "twist shows it: an asymmetric pair of tendons or a helix, with markers off the axis"
    ),
    "damping": "a free decay shows it",
    "actuators": "large steps of the commands show it",
    "delay": "steps of the commands show it",
    "friction": "a loading and unloading loop, or a free decay, shows it",
    "backlash": "a loading and unloading loop shows it",
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
    estimate: Fit,
    unseen: Sequence[Array],
    fitted: Readings,
    noise: float | None,
    judge: Readings | None = None,
) -> list[str]:
    """Returns findings about an estimate.

    They say that the data are misread, or what they do not contain and the model lacks.

    Args:
        estimate: of `fit`.
        unseen: directions (k,) of the coordinates that the data do not contain.
        fitted: readings that it was fitted to.
        noise: standard deviation of a marker's coordinate [m], None: unknown.
        judge: held-out readings, None: there are none.

    Returns:
        Sentences, of misread data these alone.

    Raises:
        NoHoldError: where the arm does not hold the held-out readings.
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
    parameters = fitted.plants.parameters
    unseen_texts = [_unseen_text(direction, parameters) for direction in unseen]
    texts += unseen_texts
    misfits = _misfits(estimate, fitted, judge)
    drift = drift_text(misfits)
    if drift:  # which the parameters, outliers and residuals follow from
        return [*texts, drift]
    for parameter, x in zip(parameters, estimate.x, strict=True):
        texts += _parameter_texts(parameter, x)
    plants = fitted.plants
    marker_names = [*plants.markers.markers]
    tendon_count = len(plants.scene.tendons)
    arm = Arm(plants.model.length, marker_names, tendon_count)
    texts += misfit_texts(misfits, arm, noise)
    if judge is not None:
        errors_of_fit = (misfit.error for misfit in misfits if not misfit.held_out)
        fit_error = mean_of_finite(errors_of_fit)
        fewer = fewer_parameters_text(estimate, fit_error, judge)
        if fewer:
            texts.append(fewer)
    return texts


def _misfits(estimate: Fit, fitted: Readings, judge: Readings | None) -> list[Misfit]:
    """Residuals of the recordings of the fit, and of held-out ones."""
    misfits = list[Misfit]()
    parts = fitted.by_recording(estimate.residual)
    for recording, part in zip(fitted.recordings, parts, strict=True):
        misfits.append(Misfit(recording, part, held_out=False))
    if judge is None or not judge.recordings:
        return misfits
    residual = judge.residual(estimate.x)
    parts = judge.by_recording(residual)
    for recording, part in zip(judge.recordings, parts, strict=True):
        misfits.append(Misfit(recording, part, held_out=True))
    return misfits


def _may_be_misread(estimate: Fit, fitted: Readings) -> bool:
    """Whether an estimate leaves errors that are large beside the arm and its motion."""
    measured = np.ma.masked_invalid(fitted.measured)
    by_axis = measured.var(axis=0)
    variance = by_axis.sum(axis=-1)  # of each marker
    mean_variance = variance.mean()
    spread = float(np.sqrt(mean_variance))
    bound = MISREAD_LENGTH * fitted.plants.model.length
    if spread > 0.0:  # of a single reading it is 0, and says nothing
        bound = min(MISREAD_SPREAD * spread, bound)
    errors = fitted.errors(estimate.x)
    return mean_of_finite(errors.values()) > bound


def _unseen_text(direction: Array, parameters: Sequence[Parameter]) -> str:
    """Finding that the data do not contain a direction (k,) of the parameters."""
    size = np.abs(direction)
    largest_first = np.argsort(-size)
    names = list[str]()
    for i in largest_first:
        if size[i] >= UNSEEN:
            names.append(parameters[i].name)
    experiment = _experiment(" ".join(names))
    what = ", ".join(names)
    if len(names) > 1:
        what = f"a combination of {what}"
    return f"The data do not contain {what}: {experiment}."


def _parameter_texts(parameter: Parameter, x: float) -> list[str]:
    """Findings about one parameter at its coordinate: at a bound, or far from what is likely."""
    texts = list[str]()
    low, high = parameter.bounds
    near = AT_BOUND * (high - low)
    for bound in (low, high):
        if abs(x - bound) <= near:
            experiment = _experiment(parameter.name)
            texts.append(
                f"{parameter.name} is at its bound, {parameter.at(bound):.4g}: {experiment}, or the"
                " bound is wrong."
            )
    # the coordinate of a factor is its logarithm
    times = np.exp(abs(x))
    is_modulus = parameter.name.endswith("young_modulus")
    if is_modulus and times > UNLIKELY:
        if x > 0:
            direction = "greater"
        else:
            direction = "less"
        texts.append(
            f"{parameter.name} is {times:.2g} times {direction} than in the scene: is a unit wrong?"
            " Tensions in kg that are read as N make it 9.8 times less."
        )
    return texts


def _experiment(name: str) -> str:
    """Experiment that shows a parameter, or a combination of some."""
    for part, text in EXPERIMENTS.items():
        if part in name:
            return text
    return "holds that move it more show it, or measure it"
