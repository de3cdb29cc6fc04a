"""`soft-tendon accuracy`: what accuracy costs in time on an arm, against full physics, and the
setting for a tolerance."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.fidelity import PRESETS, at_fidelity, build_model
from soft_tendon_env.accuracy.input_motions import HOLD
from soft_tendon_env.accuracy.reference import trajectory
from soft_tendon_env.accuracy.trial import Trial
from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.file import save_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, fields_of
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.scene.strain import Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import GivenLength, length_text

SHARES = (
    2e-2,
    5e-3,
    1e-3,
    2e-4,
)  # of the rod's length, errors that are asked for beside those of the presets
HEADER = ("asked", "asked [mm]", "coordinates", "intervals", "CPU of a second [ms]", "tip [mm]")


class Accuracy(ArmSettings):
    """Accuracy against computing time of an arm under its loads: what each error of the tip takes,
    against a converged reference."""

    within: GivenLength | None = Field(
        default=None,
        description="tolerance of the tip, such as 1mm, whose setting is written as a scene",
    )
    out: str = Field(default="out/accuracy", description="folder for the table and the scene")


def run(settings: Accuracy) -> None:
    """Choose, measure, print and write. Raises ConfigurationError where no setting is within the
    tolerance."""
    with mistakes():
        scene, tolerance, out = (
            settings.changed_scene(),
            settings.within,
            writable_folder(Path(settings.out)),
        )
        scene = scene.replace(
            {"effects": scene.effects.everywhere()}
        )  # without obstacles, and what lies between commands and tensions
        wanted = (
            {}
            if tolerance is None
            else {length_text(tolerance): at_fidelity(scene, length_text(tolerance))}
        )
    shares = {length_text(share * rod_length(scene)): share for share in SHARES} | {
        name: preset.share for name, preset in PRESETS.items()
    }
    shares |= {length: float(tolerance or 0.0) / rod_length(scene) for length in wanted}
    trial, records = Trial(scene, min(shares.values())), list[dict[str, Any]]()
    for asked, share in sorted(shares.items(), key=lambda item: -item[1]):
        try:
            model = build_model(at_fidelity(scene, asked), "scene")
        except ConfigurationError as error:  # nothing is within this length
            print(error)
            continue
        measured = {
            "asked": asked,
            "tolerance": share * rod_length(scene),
            "coordinates": model.coordinate_count,
        }
        costs = {
            "intervals": model.grid.per_piece,
            "cpu_time": cpu_time(model, trial),
            "tip_error": trial.distance(model),
        }
        records.append(measured | costs)
    print(
        f"{scene.name}: largest distance from a converged reference in {len(trial.tests)} motions"
        f" and equilibria; {machine()}.\n"
    )
    rows = [[*row.values()] for row in records]
    cells = [
        [
            row[0],
            number(1e3 * row[1]),
            *map(str, row[2:4]),
            *(number(1e3 * value) for value in row[4:]),
        ]
        for row in rows
    ]
    print(f"{markdown_table(HEADER, cells)}\n")
    write_csv(out / f"{scene.name}.csv", records)
    for length, found in wanted.items():
        write_recommended(found, out / f"{scene.name}_{length}.toml")


def cpu_time(model: Model, trial: Trial) -> float:
    """Measured CPU time [s] of a simulated second on one thread, preparations included: the lesser
    of two over all motions."""
    motions = [test.tensions for test in trial.tests if not test.reference.is_equilibrium]
    times = list[float]()
    for _ in range(2):
        started = time.thread_time()
        for tensions in motions:
            trajectory(model, tensions)
        times.append(time.thread_time() - started)
    return min(times) / (HOLD * sum(map(len, motions))) if motions else np.nan


def write_recommended(found: Scene, path: Path) -> None:
    """The scene as TOML, and beside it the passive fields that it names. Raises OSError."""
    if isinstance(getattr(found.strain, "passive", None), Snapshots):
        fields_of(found).save(path.with_suffix(SUFFIX))
        found = found.replace({"strain.passive.file": path.with_suffix(SUFFIX).name})
    save_scene(found, path)
    print(f"written: {path}")
