"""System identification of a real arm: parameters of its scene and its measurement from recordings,
with what they do not contain."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.identification.findings import findings, misread_text
from soft_tendon_env.identification.fit import Intervals, fit, intervals
from soft_tendon_env.identification.markers import MarkerSet, check_places, load_markers
from soft_tendon_env.identification.parameters import (
    DELAY,
    Parameter,
    command_limits,
    read_parameters,
)
from soft_tendon_env.identification.readings import NoHoldError, Plants, Readings, mean_of_finite
from soft_tendon_env.identification.recordings import SHARE, read_recordings, split
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.checks import checked_count, checked_type
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest
from soft_tendon_env.tools.types import Array

# of the model that is fitted: equilibria are cheap, and what a coarser one lacks would go into the
# parameters
FIDELITY = "fine"
LOOK = (
    "Look at units and signs of the commands, at the unit of time, at [frame], at the scene's"
    " stiffness and at the parameters' bounds."
)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated parameters of an arm, their intervals, errors of fit and of held-out recordings,
    and findings in words."""

    parameters: tuple[Parameter, ...]
    value: Array  # (k,)
    intervals: Intervals
    scene: Scene  # with the estimated numbers
    markers: MarkerSet  # with the estimated offsets
    error_fit: dict[
        str, float
    ]  # mean distance [m] of the markers in the recordings of the fit, by their names
    error_held_out: dict[str, float]
    before: tuple[float, float]  # mean of either [m] at the numbers of the scene that was given
    noise: float  # standard deviation of a marker's coordinate [m]
    findings: tuple[str, ...]
    data: tuple[str, ...]  # files

    @property
    def errors(self) -> tuple[float, float]:
        """Mean error [m] of the recordings of the fit and of the held-out ones, NaN without any."""
        return mean_of_finite(self.error_fit.values()), mean_of_finite(self.error_held_out.values())


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
    """Identifies parameters of an arm from recorded marker positions, by least squares with priors.

    data: CSV files, see identification.recordings. markers: TOML file, see identification.markers.
    parameters: as `KEY` or `KEY=LOW..HIGH`, see identification.parameters. held_out: a share of the
    recordings, a column, see identification.recordings, or a CSV file of others. fit_to: greatest
    number of recordings to fit to, evenly over the data; None: all. fidelity: of the fitted model,
    whose errors go into the parameters. noise: standard deviation of a marker's coordinate [m];
    None: it is estimated. Raises ValueError, ConfigurationError or FileNotFoundError for data that
    cannot be used, in one line that says where.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise is {noise}: it should be a positive number of metres")
    files = [data] if isinstance(data, str | os.PathLike) else [*data]
    placed = markers if isinstance(markers, MarkerSet) else load_markers(markers, scene)
    check_places(placed, scene, "markers")
    chosen = read_parameters(parameters, scene, placed)
    recordings, judge = (
        read_recordings([Path(file) for file in files], scene, placed),
        str(held_out),
    )
    parts = (
        [recordings, read_recordings([Path(judge)], scene, placed)]
        if judge.endswith(".csv")
        else split(recordings, judge)
    )
    if fit_to is not None and checked_count("fit_to", fit_to, 1) < (count := len(parts[0])):
        parts[0] = [parts[0][int(i)] for i in (np.arange(fit_to) + 0.5) * count / fit_to]
    accurate = at_fidelity(scene, fidelity)
    period = min((one.period for part in parts for one in part if one.period), default=np.inf)
    accurate = accurate.replace(
        {"integrator.step": min(period, accurate.integrator.step)}
    )  # a command may arrive in each period
    plants = Plants(accurate, build_model(accurate), placed, chosen)
    fitted, unseen = (Readings(plants, part) for part in parts)
    try:
        found = fit(fitted, noise)
        (error_fit, error_held_out), before = (
            [part.errors(x) for part in (fitted, unseen)] for x in (found.x, 0.0 * found.x)
        )
        spread, measurement = intervals(found, fitted), plants.measurement(found.x)
        told = findings(found, spread.unseen, fitted, noise)
    except (
        NoHoldError
    ) as error:  # of the arm as it is given, or of one at the edge of those that hold the data
        raise NoHoldError(
            f"{str(error).rstrip('.')}. {misread_text(fitted, None, noise) or LOOK}"
        ) from error
    return Estimate(
        parameters=chosen,
        value=np.array([one.at(x) for one, x in zip(chosen, found.x, strict=True)]),
        intervals=spread,
        scene=plants.scene_at(found.x, scene),
        markers=placed.with_offsets(measurement.offsets),
        error_fit=error_fit,
        error_held_out=error_held_out,
        before=(mean_of_finite(before[0].values()), mean_of_finite(before[1].values())),
        noise=found.sigma,
        findings=tuple(told),
        data=tuple(os.fspath(file) for file in files),
    )


def save_estimate(found: Estimate, folder: Path) -> list[Path]:
    """Writes an estimate into a folder; returns the files. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    comment = "".join(f"# {line}".rstrip() + "\n" for line in summary(found).splitlines())
    scene = (
        "# Identified by soft-tendon"
        f" identify:\n{comment}\n{tomli_w.dumps(scene_to_dict(found.scene))}"
    )
    files = [folder / name for name in ("scene.toml", "markers.toml", "estimate.json")]
    files[0].write_text(scene, encoding="utf-8")
    files[1].write_text(tomli_w.dumps(plain(found.markers)), encoding="utf-8")
    write_json(files[-1], _as_json(found), say=False)
    return files


def summary(found: Estimate) -> str:
    """Tables of errors and parameters, and the findings."""
    counts = zip(
        ("fit", "held out"),
        (found.error_fit, found.error_held_out),
        found.before,
        found.errors,
        strict=True,
    )
    errors = [
        (name, str(len(each)), number(1e3 * before), number(1e3 * after))
        for name, each, before, after in counts
    ]
    rows = [
        (
            one.name,
            f"{one.value:.4g}",
            f"{value:.4g}",
            f"{low:.4g} to {high:.4g}",
            "yes" if seen else "no",
        )
        for one, value, low, high, seen in zip(
            found.parameters, found.value, *found.intervals[:3], strict=True
        )
    ]
    parts = [
        markdown_table(
            ("markers' mean distance", "recordings", "before [mm]", "identified [mm]"), errors
        ),
        markdown_table(("parameter", "before", "identified", "95 % interval", "in the data"), rows),
        "\n".join(f"- {text}" for text in found.findings),
    ]
    return "\n\n".join(parts).rstrip()


def _as_json(found: Estimate) -> dict[str, Any]:
    """Estimate as plain JSON: parameters, errors, findings, randomisation, versions, digests of the
    data."""
    rows = zip(found.parameters, found.value, *found.intervals[:3], strict=True)
    parameters = {
        one.name: {
            "value": value,
            "low": low,
            "high": high,
            "before": one.value,
            "prior": one.prior,
            "identified": bool(seen),
        }
        for one, value, low, high, seen in rows
    }
    parts = zip(
        ("fit", "held_out"), (found.error_fit, found.error_held_out), found.errors, strict=True
    )
    errors = {
        name: {"mean": 1e3 * mean, "each": {one: 1e3 * error for one, error in each.items()}}
        for name, each, mean in parts
    }
    told = {
        "noise_mm": 1e3 * found.noise,
        "findings": found.findings,
        "randomize": randomize(found),
    }
    data = {Path(file).name: digest(Path(file)) for file in found.data}
    return plain({"parameters": parameters, "error_mm": errors, **told, "data": data, **origin()})


def randomize(found: Estimate) -> dict[str, Any]:
    """Table `randomize` of an environment with the identified scene: what the intervals leave open,
    of parameters that the data or a prior contain. Latency comes on top of the scene's delay.
    Offsets are tensions [N], also of arms that are driven by displacement."""
    table, ranges = dict[str, Any](), dict[str, list[float]]()
    tensions = [tendon.tension_limits for tendon in found.scene.tendons]
    unit = np.ptp(tensions, axis=1) / np.ptp(
        command_limits(found.scene), axis=1
    )  # [N] of an offset by 1
    for one, value, low, high, seen in zip(
        found.parameters, found.value, *found.intervals[:3], strict=True
    ):
        if not seen and one.prior is None:
            continue
        if one.of_scene is not None:
            table[one.name] = {"factor": [low, high]} if one.of_scene.is_factor else [low, high]
        elif one.name == DELAY:
            table["latency"] = [0.0, high - value]
        elif one.name.endswith(".gain"):
            ranges.setdefault("tension_gain", []).extend([low, high])
        elif one.name.startswith("commands."):
            ranges.setdefault("tension_offset", []).extend(
                unit[int(one.name.split(".")[1])] * np.array([low, high])
            )
    return dict[str, Any](
        plain(table | {name: [min(ends), max(ends)] for name, ends in ranges.items()})
    )
