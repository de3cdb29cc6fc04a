"""`soft-tendon accuracy`: what accuracy costs in time on an arm, against full physics, and the cheapest setting for a tolerance."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.accuracy.calibration import (
    MARGIN,
    REFERENCE,
    calibrate,
    check_tolerance,
    made_fields,
    own_fields,
    recommended,
    refuse_obstacles,
    usual_inputs,
)
from soft_tendon_env.accuracy.fidelity import PRESETS, build_model
from soft_tendon_env.accuracy.pareto import Point, cpu_time, measure
from soft_tendon_env.accuracy.reference import Reference, reference_motions
from soft_tendon_env.accuracy.settings import Setting
from soft_tendon_env.accuracy.test_inputs import CALIBRATED, Motion, motion_tensions
from soft_tendon_env.cli.arms import ArmSettings
from soft_tendon_env.cli.errors import install_command, missing_extras, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.file import save_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import read_numbers
from soft_tendon_env.tools.messages import UserError, describe, say
from soft_tendon_env.tools.types import Array, GivenLength, length_text

STOPPED = "stopped: nothing was kept"
FIRST_UNSEEN = 3000
"""Seed of the first motion that settings are checked on."""
HEADER = ("strain field", "coordinates", "intervals", "tolerance [um]", "evaluations", "CPU [ms]", "model [ms]", "tip [mm]")


class Accuracy(ArmSettings):
    """Accuracy against computing time of an arm: strain fields x quadrature x tolerance against converged full physics.

    The scene's loads act.

    Attributes:
        motion: kinds of the motions that settings are judged by.
        seeds: seeds of the motions, each of every kind; by default 500 to 504.
        input: a CSV file of tensions [N] in place of these motions, a column per tendon and a line of names first; rows are held 20 ms.
        within: distance of the tip from full physics to stay within, such as 1mm: the cheapest setting for it is written as a TOML scene.
        check: number of further motions of these kinds on which to count how often that setting stays within it.
        out: folder for the table, the picture and the scene.
    """

    motion: tuple[Motion, ...] = Field(default=CALIBRATED, min_length=1)
    seeds: tuple[Annotated[int, Field(ge=0, lt=FIRST_UNSEEN)], ...] | None = Field(default=None, min_length=1)
    input: str | None = None
    within: GivenLength | None = None
    check: int | None = Field(default=None, ge=1, le=10000)
    out: str = "out/accuracy"

    @model_validator(mode="after")
    def _can_be_checked(self) -> "Accuracy":
        if self.check is not None and (self.within is None or self.input is not None):
            text = "counts how often the setting for --within stays within it on motions of --motion: not with --input"
            raise ConfigurationError([Problem(("check",), text)])
        return self

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Kinds of motions, each once."""
        return tuple(dict.fromkeys(self.motion))


def run(arguments: Sequence[str]) -> None:
    """Calibrate, print, draw and write. Exit status 1 where no setting is within the tolerance."""
    parser = Parser("accuracy", Accuracy)
    settings = parser.read(arguments)
    tolerance = settings.within
    with parser.mistakes():
        named = settings.changed_scene()
        refuse_obstacles(named)
        scene = named.replace({"effects": named.effects.on_arm()})
        if scene != named:
            say(f"{scene.name!r} is measured under given tensions, without what lies between commands and tensions")
        if tolerance is not None:
            check_tolerance(scene, tolerance)
        given = None if settings.input is None else [read_input(Path(settings.input), scene)]
        inputs = given or usual_inputs(scene, settings.motions, settings.seeds)
        out = writable_folder(Path(settings.out))
    try:
        fields = own_fields(scene) if tolerance is None else made_fields(scene)
        calibration = calibrate(scene, inputs, fields)
        shown = [(point, build_model(point.setting.of(scene), "scene")) for point in calibration.front]
        for name in PRESETS:
            model = build_model(scene, name)
            shown.append((measure(model, preset_setting(name, model), inputs, calibration.reference), model))
        costs = [(point, cpu_time(model, inputs[: max(1, len(inputs) // 2)])) for point, model in shown]
        print(report(settings, scene, calibration.reference, costs, fields is not None))
        write_csv(out / f"{scene.name}.csv", [record(point, time) for point, time in costs])
        if missing_extras(("pictures",)):
            print(f"no picture: {install_command(['pictures'])}")
        else:
            from soft_tendon_env.evaluation.pictures import draw_front

            draw_front(scene.name, costs, tolerance, out / f"{scene.name}.png")
        if tolerance is not None:
            best = recommended(scene, calibration, tolerance)
            write_recommended(scene, best, fields, tolerance, out)
            if settings.check is not None:
                print(checked(scene, best, settings.motions, settings.check, tolerance))
    except ConfigurationError as error:
        raise UserError(describe(error)) from error


def read_input(path: Path, scene: Scene) -> Array:
    """Table of tensions (rows, n_a) [N] in a CSV file. Raises ValueError, FileNotFoundError."""
    rows = read_numbers(path)
    table = np.array([list(row.values()) for row in rows], dtype=float)
    if table.ndim != 2 or table.shape[1] != len(scene.tendons) or not np.isfinite(table).all():
        what = f"a line of names, then rows of {len(scene.tendons)} finite tensions [N], one of each tendon of {scene.name!r}"
        raise ValueError(f"{path} should have {what}")
    return table


def preset_setting(name: str, model: Model) -> Setting:
    """Setting that a preset comes to, without its table of the strain."""
    return Setting(f"({name})", {}, model.grid.per_piece, model.scene.integrator.tolerance or 0.0)


def report(settings: Accuracy, scene: Scene, reference: Reference, costs: Sequence[tuple[Point, float]], has_fields: bool) -> str:
    """The Pareto front and the presets as a table, each with its measured CPU time, and the accuracy of the reference."""
    bar = 1e3 * max(filter(np.isfinite, reference.tip_errors), default=np.nan)
    level = reference.level
    parts = "" if level.cuts == 1 else f" in {level.cuts} parts"
    lost = sum(motion is None for motion in reference.tips)
    motions = ", ".join(settings.motion) if settings.input is None else settings.input
    lines = [
        f"{scene.name}: largest distance from full physics on {len(reference.tips)} motions ({motions}); {machine()}.",
        f"Reference: Legendre order {level.order} per piece{parts}, {level.intervals} intervals, steps of {1e3 * level.step:g} ms. "
        f"Error bar, what its last refinement changed: {number(bar)} mm at the tip.",
        "Evaluations and CPU times, measured and by the cost model, are of a simulated second.",
    ]
    if lost:
        lines.append(f"Full physics has no motion under {lost} of them: those do not count.")
    if not has_fields:
        lines.append(f"No passive fields of the arm's own are there to be tried: `soft-tendon fields {settings.scene}` makes them.")
    table = markdown_table(HEADER, [row(point, time) for point, time in costs])
    return "\n".join([*lines, "", table, ""])


def row(point: Point, time: float) -> tuple[str, ...]:
    """Cells of the table, below HEADER."""
    setting = point.setting
    numbers = (number(1e3 * value) for value in (time, point.cost, point.tip_error))
    sizes = str(point.coordinates), str(setting.intervals), f"{1e6 * setting.tolerance:.3g}"
    return setting.name, *sizes, f"{point.evaluations:.0f}", *numbers


def record(point: Point, time: float) -> dict[str, object]:
    """Columns of the CSV file, in SI units."""
    setting = {key: value for key, value in point.setting._asdict().items() if key not in ("name", "strain")}
    costs = {"evaluations": point.evaluations, "cost": point.cost, "cpu_time": time}
    return {"strain_field": point.setting.name, "coordinates": point.coordinates, **setting, **costs, "tip_error": point.tip_error}


def write_recommended(scene: Scene, point: Point, fields: PassiveFields | None, tolerance: float, out: Path) -> None:
    """The scene with the setting as TOML, and beside it the passive fields that it names. Raises OSError."""
    found, path = point.setting.of(scene), out / f"{scene.name}_{length_text(tolerance)}.toml"
    passive = point.setting.strain.get("passive")
    if fields is not None and isinstance(passive, Mapping):
        beside = path.with_suffix(SUFFIX)
        fields.save(beside)
        found = found.replace({"strain.passive.file": beside.name})
    save_scene(found, path)
    setting = point.setting
    sizes = f"{point.coordinates} coordinates, {setting.intervals} intervals per piece, tolerance {1e6 * setting.tolerance:.3g} um"
    what = f"{setting.name}: {sizes}"
    print(f"within {length_text(tolerance)}, with a margin of {MARGIN:g}: {what}\nwritten: {path}")


def checked(scene: Scene, point: Point, motions: Sequence[Motion], count: int, tolerance: float) -> str:
    """How often a setting stays within the tolerance on motions that it was not calibrated on."""
    rounds = -(-count // len(motions))
    inputs = [motion_tensions(scene, motion, FIRST_UNSEEN + seed) for seed in range(rounds) for motion in motions][:count]
    reference = reference_motions(scene, inputs, REFERENCE * rod_length(scene))
    model = build_model(point.setting.of(scene), "scene")
    errors = np.array(measure(model, point.setting, inputs, reference).tip_errors)
    there = ~np.isnan(errors)
    within = int(np.count_nonzero(errors[there] <= tolerance))
    bar = max(filter(np.isfinite, reference.tip_errors), default=np.nan)
    low, high = (number(1e3 * value) for value in (np.median(errors[there]), errors[there].max()))
    return (
        f"checked on {there.sum()} other motions: {within} of {there.sum()} within {length_text(tolerance)}; "
        f"median {low} mm, largest {high} mm, error bar of the reference {number(1e3 * bar)} mm"
    )
