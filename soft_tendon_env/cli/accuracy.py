"""`soft-tendon accuracy`: what accuracy costs in time on an arm, against full physics, and the cheapest setting for a tolerance."""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy import calibration, pareto
from soft_tendon_env.accuracy.fidelity import PRESETS, build_model
from soft_tendon_env.accuracy.pareto import Setting
from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.scene.file import save_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import GivenLength, length_text

HEADER = ("strain field", "coordinates", "intervals", "tolerance [um]", "evaluations", "CPU [ms]", "model [ms]", "tip [mm]")


class Accuracy(ArmSettings):
    """Accuracy against computing time of an arm under its loads: strain fields x quadrature x tolerance, against full physics."""

    within: GivenLength | None = Field(default=None, description="tolerance of the tip, such as 1mm, whose cheapest setting is written")
    out: str = Field(default="out/accuracy", description="folder for the table and the scene")


def run(settings: Accuracy) -> None:
    """Calibrate, print and write. Raises ConfigurationError where no setting is within the tolerance."""
    with mistakes():
        scene, tolerance, out = settings.changed_scene(), settings.within, writable_folder(Path(settings.out))
        calibration.check_calibration(scene, np.inf if tolerance is None else tolerance)
        scene = scene.replace({"effects": scene.effects.on_arm()})  # without what lies between commands and tensions
        inputs = calibration.usual_inputs(scene)
    fields = calibration.own_fields(scene) if tolerance is None else calibration.ensure_fields(scene)
    found = calibration.calibrate(scene, inputs, fields)
    points = [(point, build_model(point.setting.of(scene), "scene")) for point in found.front]
    for name in PRESETS:
        model = build_model(scene, name)
        preset = Setting(f"({name})", {}, model.grid.per_piece, model.scene.integrator.tolerance or 0.0)
        points.append((pareto.measure(model, preset, inputs, found.reference), model))
    costs = [(point, pareto.cpu_time(model, inputs[: max(1, len(inputs) // 2)])) for point, model in points]
    records = [record(*cost) for cost in costs]
    bar = number(1e3 * max(filter(np.isfinite, found.reference.tip_errors), default=np.nan))
    print(f"{scene.name}: largest distance from full physics on {len(inputs)} motions, per simulated second; {machine()}.")
    rows = [[*row.values()] for row in records]
    cells = [[*map(str, row[:3]), f"{1e6 * row[3]:.3g}", f"{row[4]:.0f}", *(number(1e3 * value) for value in row[5:])] for row in rows]
    print(f"Error bar of the reference: {bar} mm at the tip.\n\n{markdown_table(HEADER, cells)}\n")
    write_csv(out / f"{scene.name}.csv", records)
    if tolerance is not None:
        best = calibration.cheapest_point(scene, found, tolerance).setting
        write_recommended(best, scene, fields, out / f"{scene.name}_{length_text(tolerance)}.toml")


def record(point: pareto.Point, time: float) -> dict[str, Any]:
    """Columns of the CSV file, in SI units and in the order of HEADER; `time` was measured, `cost` is the cost model's."""
    setting = {"strain_field": point.setting.name, "coordinates": point.coordinates, "intervals": point.setting.intervals}
    costs = {"tolerance": point.setting.tolerance, "evaluations": point.evaluations, "cpu_time": time, "cost": point.cost}
    return {**setting, **costs, "tip_error": point.tip_error}


def write_recommended(setting: Setting, scene: Scene, fields: PassiveFields | None, path: Path) -> None:
    """The scene with the setting as TOML, and beside it the passive fields that it names. Raises OSError."""
    found = setting.of(scene)
    if fields is not None and "fields" in setting.strain.get("passive", ()):
        fields.save(path.with_suffix(SUFFIX))
        found = found.replace({"strain.passive.file": path.with_suffix(SUFFIX).name})
    save_scene(found, path)
    print(f"cheapest: {setting.name}, {setting.intervals} intervals per piece, tolerance {1e6 * setting.tolerance:.3g} um\nwritten: {path}")
