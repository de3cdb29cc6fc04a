"""System identification of a real arm: parameters of its scene and its measurement from recordings, with what they do not contain."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soft_tendon_env.accuracy.fidelity import AS_SCENE, at_fidelity, checked_fidelity
from soft_tendon_env.identification.findings import (
    bound_texts,
    coarse_text,
    misfit_texts,
    over_fitting_texts,
    repeats_text,
    twins_text,
    unlikely_texts,
    unseen_text,
)
from soft_tendon_env.identification.fit import Fit, Loss, fit
from soft_tendon_env.identification.intervals import Intervals, intervals, shift
from soft_tendon_env.identification.markers import MarkerSet, check_places, load_markers
from soft_tendon_env.identification.misread import LOOK, are_far, misread_text
from soft_tendon_env.identification.parameters import Parameter, read_parameters
from soft_tendon_env.identification.plant import Measurement, Plants, base_rotation
from soft_tendon_env.identification.readings import Readings, mean_of_finite
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.identification.simulated import NoHoldError, begins_at_rest, rest_text, with_steps
from soft_tendon_env.identification.split import SHARE, split, without_twins
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.types import Array

FIDELITY = "fine"
"""Fidelity of the model that is fitted: equilibria are cheap, and what a coarser one lacks would go into the parameters."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated parameters of an arm, their intervals, errors of fit and of held-out recordings, and findings in words.

    scene: the arm with the estimated numbers, in the frame of its base. markers: with the estimated offsets, and with the frame that leads
    from the data to that base. measurement: mount and commands. error_fit, error_held_out: mean distance [m] of the markers, of each
    recording; `before`: at the numbers of the scene that was given, mean of either.
    """

    parameters: tuple[Parameter, ...]
    value: Array  # (k,)
    intervals: Intervals
    scene: Scene
    markers: MarkerSet
    measurement: Measurement
    error_fit: Array
    error_held_out: Array
    before: tuple[float, float]
    findings: tuple[str, ...]
    fit: Fit
    fitted: Readings
    held_out: Readings
    data: tuple[str, ...]

    @property
    def errors(self) -> tuple[float, float]:
        """Mean error [m] of the recordings of the fit and of the held-out ones, NaN without any."""
        return mean_of_finite(self.error_fit), mean_of_finite(self.error_held_out)


def identify(
    scene: Scene,
    data: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    markers: MarkerSet | str | os.PathLike[str],
    parameters: Sequence[str],
    *,
    held_out: str | float = SHARE,
    fidelity: str = FIDELITY,
    noise: float | None = None,
    loss: Loss = "linear",
) -> Estimate:
    """Identifies parameters of an arm from recorded marker positions, by least squares with priors.

    data: CSV files, see identification.recordings. markers: TOML file, see identification.markers. parameters: as `KEY`,
    `KEY=LOW..HIGH` or `KEY~SIGMA`, see identification.parameters. held_out: a share or number of the recordings, a column, or
    COLUMN=NUMBER, see identification.split. noise [m]: standard deviation of a marker's coordinate; by default it is estimated. loss: how
    residuals count, the others are robust.

    Raises ValueError, ConfigurationError or FileNotFoundError for data that cannot be used, in one line that says where.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise is {noise}: it should be a positive number of metres")
    files = [data] if isinstance(data, str | os.PathLike) else [*data]
    placed = markers if isinstance(markers, MarkerSet) else load_markers(markers, scene)
    check_places(placed, scene, "markers")
    chosen = read_parameters(parameters, scene, placed)
    recordings, twins = without_twins(read_recordings([Path(file) for file in files], scene, placed))
    parts = split(recordings, str(held_out))
    try:
        checked_fidelity(fidelity)
    except ValueError as error:
        raise ValueError(f"fidelity is {fidelity!r}: it {error}") from None
    accurate = with_steps(at_fidelity(scene, fidelity), [*parts.fit, *parts.held_out])
    plants = Plants(accurate, build_model(accurate), placed, chosen)
    fitted, unseen = Readings(plants, parts.fit), Readings(plants, parts.held_out)
    try:
        found = fit(fitted, noise, loss)
    except NoHoldError as error:
        raise NoHoldError(f"{str(error).rstrip('.')}. {misread_text(fitted, None, noise, loss) or LOOK}") from error
    moved = _moved(found, fitted, scene, fidelity)
    spread = intervals(found, fitted.cluster, chosen, moved)
    nominal = np.zeros(len(chosen))
    measurement = plants.measurement(found.x)
    return Estimate(
        parameters=chosen,
        value=np.array([own.at(at) for own, at in zip(chosen, found.x, strict=True)]),
        intervals=spread,
        scene=plants.scene_at(found.x, scene),
        markers=placed.with_offsets(measurement.offsets, placed.frame.to_base(base_rotation(measurement.rotation), measurement.shift)),
        measurement=measurement,
        error_fit=fitted.errors(found.x),
        error_held_out=unseen.errors(found.x),
        before=(mean_of_finite(fitted.errors(nominal)), mean_of_finite(unseen.errors(nominal))),
        findings=(
            *_findings(found, spread, fitted, unseen, noise, loss),
            *filter(None, [coarse_text(moved, found, chosen, spread), twins_text(twins), repeats_text(fitted, unseen)]),
        ),
        fit=found,
        fitted=fitted,
        held_out=unseen,
        data=tuple(os.fspath(file) for file in files),
    )


def _findings(found: Fit, spread: Intervals, fitted: Readings, unseen: Readings, noise: float | None, loss: Loss) -> list[str]:
    """Findings in words: what was done to the data, that they are misread, or what they do not contain and the model lacks."""
    recordings, length = [*fitted.recordings, *unseen.recordings], fitted.plants.length
    notes = [note for own in recordings for note in own.notes]
    restless = [own for own in recordings if own.period and not begins_at_rest(own, length)]
    notes += [f"Motion {own.name!r} does not begin at rest. {rest_text(own, length)}" for own in restless]
    error = mean_of_finite(fitted.errors(found.x))
    if are_far(fitted, error) and (text := misread_text(fitted, found.x, noise, loss)):
        return [text, *notes]
    parameters = fitted.plants.parameters
    texts = [unseen_text(direction, parameters) for direction in spread.unseen]
    texts += bound_texts(found.x, parameters) + unlikely_texts(found.x, parameters) + misfit_texts(found, fitted, noise)
    return texts + over_fitting_texts(found, fitted, unseen, loss) + notes


def _moved(found: Fit, fitted: Readings, scene: Scene, fidelity: str) -> Array:
    """Change (k,) of the estimate with a model at FIDELITY; zero with one that is, with that of the scene, which its user chose, and for
    motions, which take too long to simulate them anew."""
    if fidelity in (FIDELITY, AS_SCENE) or any(own.period for own in fitted.recordings):
        return np.zeros(found.x.size)
    plants, finer = fitted.plants, at_fidelity(scene, FIDELITY)
    return shift(found, Readings(Plants(finer, build_model(finer), plants.markers, plants.parameters), fitted.recordings))
