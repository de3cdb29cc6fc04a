"""System identification of a real arm: parameters of its scene from recordings.

It also estimates the measurement, and says what the recordings do not contain.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.identification.clusters import SHARE, split
from soft_tendon_env.identification.findings import findings
from soft_tendon_env.identification.fit import Intervals, fit, intervals
from soft_tendon_env.identification.markers import MarkerSet, check_places, load_markers
from soft_tendon_env.identification.misread import misread_text
from soft_tendon_env.identification.parameters import (
    Parameter,
    Quantity,
    command_limits,
    read_parameters,
)
from soft_tendon_env.identification.readings import NoHoldError, Plants, Readings, mean_of_finite
from soft_tendon_env.identification.recordings import Recording, read_recordings
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.checks import checked_count, checked_type
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest
from soft_tendon_env.tools.types import Array

# of the model that is fitted: equilibria are cheap, and what a coarser one lacks would go into the
# parameters
FIDELITY = "fine"
FILES = (".csv", ".tsv", ".txt", ".mat", ".npz")  # endings by which held-out data are a file
LOOK = (
    "Look at units and signs of the commands, at the unit of time, at [frame], at the scene's"
    " stiffness and at the parameters' bounds."
)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated parameters of an arm, with their intervals, errors and findings.

    Errors are those of fit and of held-out recordings; findings are in words.
    """

    parameters: tuple[Parameter, ...]  # k of them, in the order in which they were named
    value: Array  # (k,)
    intervals: Intervals  # of 95 %
    scene: Scene  # with the estimated numbers
    markers: MarkerSet  # with the estimated offsets
    # mean distance [m] of the markers in the recordings of the fit, by their names
    error_fit: dict[str, float]
    error_held_out: dict[str, float]  # the same in the held-out recordings
    before: tuple[float, float]  # mean of either [m] at the numbers of the scene that was given
    noise: float  # standard deviation of a marker's coordinate [m]
    findings: tuple[str, ...]  # remarks on data and fit, in words
    data: tuple[str, ...]  # files

    @property
    def errors(self) -> tuple[float, float]:
        """Mean error [m] of the recordings of the fit and of the held-out ones, NaN without any."""
        error_fit = mean_of_finite(self.error_fit.values())
        return error_fit, mean_of_finite(self.error_held_out.values())


def identify(
    scene: Scene,
    data: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    markers: MarkerSet | str | os.PathLike[str],
    parameters: Sequence[str],
    *,
    held_out: str | float = SHARE,
    fit_to: int | None = None,
    fidelity: str = FIDELITY,
    noise: float | None = None,
) -> Estimate:
    """Identifies parameters of an arm from recorded marker positions by least squares.

    Priors keep what the data do not contain.

    Args:
        scene: the arm as it is known.
        data: CSV, .mat or .npz files, see identification.recordings.
        markers: TOML file, see identification.markers, or what was read from it.
        parameters: as `KEY` or `KEY=LOW..HIGH`, see identification.parameters.
        held_out: a share of the recordings, a column, see identification.clusters, or a file of
            others.
        fit_to: greatest number of recordings to fit to, evenly over the data; None: all.
        fidelity: of the fitted model, whose errors go into the parameters.
        noise: standard deviation of a marker's coordinate [m]; None: it is estimated.

    Returns:
        The estimate, with its intervals, errors and findings.

    Raises:
        TypeError: for what is no scene.
        ValueError: for data that cannot be used, in one line that says where.
        ConfigurationError: for markers, keys and values that the scene does not allow.
        FileNotFoundError: for data that are missing.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise is {noise}: it should be a positive number of metres")
    if isinstance(data, str | os.PathLike):
        files = [data]
    else:
        files = [*data]
    paths = [Path(file) for file in files]
    if isinstance(markers, MarkerSet):
        placed = markers
    else:
        placed = load_markers(markers, scene)
    check_places(placed, scene, "markers")
    chosen = read_parameters(parameters, scene, placed)
    fit_part, judge_part = _read_parts(paths, str(held_out), fit_to, scene, placed)
    accurate = _fitted_scene(scene, fidelity, fit_part + judge_part)
    plants = Plants(accurate, build_model(accurate), placed, chosen)
    fitted = Readings(plants, fit_part)
    judge = Readings(plants, judge_part)
    nominal = np.zeros(len(chosen))
    try:
        estimate = fit(fitted, noise)
        error_fit = fitted.errors(estimate.x)
        error_held_out = judge.errors(estimate.x)
        before_fit = fitted.errors(nominal)
        before_held_out = judge.errors(nominal)
        spread = intervals(estimate, fitted)
        texts = findings(estimate, spread.unseen, fitted, noise, judge)
    except NoHoldError as error:
        # of the arm as it is given, or of one at the edge of those that hold the data
        advice = misread_text(fitted, None, noise) or LOOK
        reason = str(error).rstrip(".")
        raise NoHoldError(f"{reason}. {advice}") from error
    pairs = zip(chosen, estimate.x, strict=True)
    values = [parameter.at(x) for parameter, x in pairs]
    measurement = plants.measurement(estimate.x)
    before_mean = mean_of_finite(before_fit.values())
    before_held_out_mean = mean_of_finite(before_held_out.values())
    return Estimate(
        parameters=chosen,
        value=np.array(values),
        intervals=spread,
        scene=plants.scene_at(estimate.x, scene),
        markers=placed.with_offsets(measurement.offsets),
        error_fit=error_fit,
        error_held_out=error_held_out,
        before=(before_mean, before_held_out_mean),
        noise=estimate.sigma,
        findings=tuple(texts),
        data=tuple(os.fspath(file) for file in files),
    )


def _read_parts(
    paths: Sequence[Path], held_out: str, fit_to: int | None, scene: Scene, markers: MarkerSet
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit to, at most `fit_to`, and held-out ones, as `identify` is given them."""
    recordings = read_recordings(paths, scene, markers)
    if held_out.lower().endswith(FILES):
        fit_part = recordings
        judge_part = read_recordings([Path(held_out)], scene, markers)
    else:
        fit_part, judge_part = split(recordings, held_out)
    if fit_to is None:
        return fit_part, judge_part
    checked_count("fit_to", fit_to, 1)
    count = len(fit_part)
    if fit_to < count:
        # the middle one of each of as many equal stretches of the data
        middle_counts = np.arange(fit_to) + 0.5
        middles = middle_counts * count / fit_to
        fit_part = [fit_part[int(middle)] for middle in middles]
    return fit_part, judge_part


def _fitted_scene(scene: Scene, fidelity: str, recordings: Sequence[Recording]) -> Scene:
    """Scene whose model is fitted, at a fidelity.

    Its steps are no longer than sample periods, since a command may arrive in each.
    """
    accurate = at_fidelity(scene, fidelity)
    periods = [recording.period for recording in recordings if recording.period]
    own_step = accurate.integrator.step
    step = min([*periods, own_step])
    return accurate.replace({"integrator.step": step})


def save_estimate(estimate: Estimate, folder: Path) -> list[Path]:
    """Writes an estimate into a folder: the scene, the markers, and all numbers as JSON.

    Args:
        estimate: of `identify`.
        folder: made where it is missing.

    Returns:
        The files.

    Raises:
        OSError: where they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene_file = folder / "scene.toml"
    markers_file = folder / "markers.toml"
    estimate_file = folder / "estimate.json"
    lines_of_summary = summary(estimate).splitlines()
    comments = [f"# {line}".rstrip() for line in lines_of_summary]
    table = scene_to_dict(estimate.scene)
    lines = [
        "# Identified by soft-tendon identify:",
        *comments,
        "",
        tomli_w.dumps(table),
    ]
    scene_file.write_text("\n".join(lines), encoding="utf-8")
    markers_toml = tomli_w.dumps(plain(estimate.markers))
    markers_file.write_text(markers_toml, encoding="utf-8")
    write_json(estimate_file, _as_json(estimate), say=False)
    return [scene_file, markers_file, estimate_file]


def summary(estimate: Estimate) -> str:
    """Tables of errors and parameters, and the findings.

    Args:
        estimate: of `identify`.

    Returns:
        Markdown.
    """
    errors = [
        (name, str(len(each)), number(1e3 * before), number(1e3 * after))
        for name, each, before, after in zip(
            ("fit", "held out"),
            (estimate.error_fit, estimate.error_held_out),
            estimate.before,
            estimate.errors,
            strict=True,
        )
    ]
    rows = [
        (
            parameter.name,
            f"{parameter.value:.4g}",
            f"{value:.4g}",
            f"{low:.4g} to {high:.4g}",
            "yes" if identified else "no",
        )
        for parameter, value, low, high, identified in _rows(estimate)
    ]
    error_header = ("markers' mean distance", "recordings", "before [mm]", "identified [mm]")
    header = ("parameter", "before", "identified", "95 % interval", "in the data")
    parts = [
        markdown_table(error_header, errors),
        markdown_table(header, rows),
        "\n".join(f"- {text}" for text in estimate.findings),
    ]
    return "\n\n".join(parts).rstrip()


def _rows(estimate: Estimate) -> Iterator[tuple[Parameter, float, float, float, bool]]:
    """Every parameter with its value, the ends of its interval, and whether the data contain it."""
    spread = estimate.intervals
    return zip(
        estimate.parameters, estimate.value, spread.low, spread.high, spread.identified, strict=True
    )


def _as_json(estimate: Estimate) -> dict[str, Any]:
    """Estimate as plain JSON.

    It has parameters, errors, findings, randomisation, versions and digests of the data.
    """
    parameters = {
        parameter.name: {
            "value": value,
            "low": low,
            "high": high,
            "before": parameter.value,
            "prior": parameter.prior,
            "identified": bool(identified),
        }
        for parameter, value, low, high, identified in _rows(estimate)
    }
    mean_fit, mean_held_out = estimate.errors
    table = {
        "parameters": parameters,
        "error_mm": {
            "fit": _errors_in_mm(estimate.error_fit, mean_fit),
            "held_out": _errors_in_mm(estimate.error_held_out, mean_held_out),
        },
        "noise_mm": 1e3 * estimate.noise,
        "findings": estimate.findings,
        "randomize": randomize(estimate),
        "data": {Path(file).name: digest(Path(file)) for file in estimate.data},
    }
    return plain({**table, **origin()})


def _errors_in_mm(errors: dict[str, float], mean: float) -> dict[str, Any]:
    """Mean error and that of each recording, of errors [m]."""
    each = {name: 1e3 * error for name, error in errors.items()}
    return {"mean": 1e3 * mean, "each": each}


def randomize(estimate: Estimate) -> dict[str, Any]:
    """Returns the table `randomize` of an environment with the identified scene.

    It has what the intervals leave open, of parameters that the data or a prior contain.

    Latency comes on top of the scene's delay. Offsets are tensions [N], also of arms that are
    driven by displacement.

    Args:
        estimate: of `identify`.

    Returns:
        Ranges by keys of the scene, `latency` [s], `tension_gain` and `tension_offset` [N].
    """
    tension_limits = [tendon.tension_limits for tendon in estimate.scene.tendons]
    tension_span = np.ptp(tension_limits, axis=1)
    limits = command_limits(estimate.scene)
    command_span = np.ptp(limits, axis=1)
    tension_of_command = tension_span / command_span
    table = dict[str, Any]()
    gains = list[float]()
    offsets = list[float]()
    for parameter, value, low, high, identified in _rows(estimate):
        if not identified and parameter.prior is None:
            continue
        if parameter.of_scene is not None:
            interval = [low, high]
            # a common factor of numbers that differ
            is_factor = parameter.of_scene.is_factor
            if is_factor:
                table[parameter.name] = {"factor": interval}
            else:
                table[parameter.name] = interval
        elif parameter.quantity is Quantity.COMMAND_DELAY:
            table["latency"] = [0.0, high - value]
        elif parameter.quantity is Quantity.COMMAND_GAIN:
            gains += [low, high]
        elif parameter.quantity is Quantity.COMMAND_OFFSET:
            unit = tension_of_command[parameter.index[0]]
            offsets += [unit * low, unit * high]
    # environments draw every tendon's from one range, which covers those of all
    if gains:
        table["tension_gain"] = [min(gains), max(gains)]
    if offsets:
        table["tension_offset"] = [min(offsets), max(offsets)]
    return dict[str, Any](plain(table))
