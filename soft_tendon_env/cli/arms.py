"""`soft-tendon accuracy`: what accuracy costs in time on an arm, against full physics, and the cheapest setting for a tolerance. `fields`:
passive strain fields of an arm from snapshots of full physics (POD). `identify`: its parameters from measured marker positions."""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy import calibration, pareto
from soft_tendon_env.accuracy.fidelity import PRESETS, build_model
from soft_tendon_env.accuracy.pareto import Setting
from soft_tendon_env.accuracy.proper_orthogonal_fields import KINDS, fields_path, make_passive_fields
from soft_tendon_env.accuracy.test_inputs import USUAL
from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import from_set
from soft_tendon_env.cli.scenes import coordinate_count
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.identification.identify import FIDELITY, identify, save_estimate, summary
from soft_tendon_env.identification.recordings import SHARE
from soft_tendon_env.scene.file import load_scene, save_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, parsed_changes
from soft_tendon_env.tools.types import GivenLength, length_text

HEADER = ("strain field", "coordinates", "intervals", "tolerance [um]", "evaluations", "CPU [ms]", "model [ms]", "tip [mm]")


class ArmSettings(Configuration):
    """The arm that a command is about."""

    scene: str = Field(description="a shipped scene's name, or the path of a TOML file")
    set: tuple[str, ...] = Field(default=(), description="changes of the scene, such as effects.gravity.acceleration=[0,0,-9.81]")

    def changed_scene(self) -> Scene:
        """The scene with the changes of --set. Raises ConfigurationError, ValueError."""
        scene = load_scene(self.scene)
        with from_set():
            return scene.replace(parsed_changes(self.set)) if self.set else scene


class Accuracy(ArmSettings):
    """Accuracy against computing time of an arm under its loads: strain fields x quadrature x tolerance, against full physics."""

    within: GivenLength | None = Field(default=None, description="tolerance of the tip, such as 1mm, whose cheapest setting is written")
    out: str = Field(default="out/accuracy", description="folder for the table and the scene")


class Fields(ArmSettings):
    """Make the passive strain fields of an arm's own from simulated motions (POD), and report how accurate the arm is with them.

    The loads of the scene, and smaller ones in all directions, act on half of the motions each.
    """

    out: str | None = Field(default=None, description="the .json file to write; by default in the user's cache, where every scene finds it")
    within: GivenLength | None = Field(default=None, description="tolerance of the tip, such as 1mm, to report the fewest fields for")


def run_accuracy(settings: Accuracy) -> None:
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


def run_fields(settings: Fields) -> None:
    """Make, write and report."""
    with mistakes():
        scene, out = settings.changed_scene(), settings.out
        if out is not None and not out.endswith(".json"):
            raise ValueError(f"--out is {out}: it should be the path of a .json file, such as {scene.name}{SUFFIX}")
    found, path = make_passive_fields(scene), fields_path(scene) if out is None else Path(out)
    found.save(path)
    bare = {"type": "statics_based", "strains": list(scene.strain.free), "borders": list(scene.strain.borders)}
    print(f"written: {path}\n\n{report(scene, found, coordinate_count(scene.replace({'strain': bare})))}")
    if settings.within is not None:
        count = found.needed(settings.within, USUAL)
        file = "" if out is None else f', file = "{path.name}"'
        entry = f'passive = {{ type = "snapshots", fields = {count}{file} }}'
        print(f"\n{'no number of fields is enough' if count is None else f'In the scene, under [strain]: {entry}'}")


def report(scene: Scene, fields: PassiveFields, bare: int) -> str:
    """Table of the errors by number of fields; the arm has `bare` coordinates without any."""
    rows = []
    for i, count in enumerate(np.array(fields.errors["fields"], dtype=int)):
        errors = [number(1e3 * fields.errors[kind][i]) for kind in KINDS]
        rows.append((str(bare + count), str(count), f"{fields.singular_values[count - 1]:.2g}" if count else "-", *errors))
    intro = f"{scene.name}, digest {fields.digest}. Errors: largest distance of the tip from full physics on other motions."
    return f"{intro}\n\n{markdown_table(('coordinates', 'fields', 'singular value', *(f'{kind} [mm]' for kind in KINDS)), rows)}"


DATA = "CSV files: a row a hold (hold, tension_i or displacement_i, MARKER_x, MARKER_y, MARKER_z) or, with time, a sample of a motion"
KEYS = "keys such as segments.*.young_modulus or markers.*.offset; KEY=LOW..HIGH with bounds"
HELD_OUT = "held-out recordings that judge the fit: a share, 0 for none, or a column that marks them"


class Identify(ArmSettings):
    """Identify an arm from measured marker positions: parameters of its scene by least squares, judged on held-out data."""

    data: tuple[str, ...] = Field(min_length=1, description=DATA)
    markers: str = Field(description="TOML file: markers' places on the arm, frame and columns", json_schema_extra={"flag": "--markers"})
    parameters: tuple[str, ...] = Field(min_length=1, description=KEYS, json_schema_extra={"flag": "--parameters"})
    held_out: str = Field(default=SHARE, description=HELD_OUT)
    noise: GivenLength | None = Field(default=None, description="standard deviation of a marker's coordinate, such as 0.5mm")
    fidelity: str = Field(default=FIDELITY, description="of the fitted model: fast, standard, fine, scene or a length such as 1mm")
    out: str = Field(default="out/identified", description="folder for scene.toml, markers.toml and estimate.json")


def run_identify(settings: Identify) -> None:
    """Identify, print and write."""
    with mistakes():
        scene, out = settings.changed_scene(), writable_folder(Path(settings.out))
        options = {name: getattr(settings, name) for name in ("held_out", "fidelity", "noise")}
        found = identify(scene, settings.data, settings.markers, settings.parameters, **options)
    print(summary(found))
    for path in save_estimate(found, out):
        print(f"written: {path}")
