"""`soft-tendon accuracy`: what accuracy costs in time on an arm, against full physics, and the
setting for a tolerance."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.fidelity import PRESETS, at_fidelity, build_model
from soft_tendon_env.accuracy.input_motions import HOLD
from soft_tendon_env.accuracy.loads import tried_effects
from soft_tendon_env.accuracy.reference import trajectory
from soft_tendon_env.accuracy.trial import Trial
from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import (
    markdown_table,
    measured_number,
    number,
    write_csv,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.file import save_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, fields_of
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.scene.strain import Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import GivenLength, length_text

SHARES = (2e-2, 5e-3, 1e-3, 2e-4)
"""Errors that are asked for beside those of the presets, as shares of the rod's length."""
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
        scene = settings.changed_scene()
        out = writable_folder(Path(settings.out))
        scene = scene.replace({"effects": tried_effects(scene.effects)})
        recommended = None
        if settings.within is not None:
            recommended = at_fidelity(scene, length_text(settings.within))

    length = rod_length(scene)
    shares = {length_text(share * length): share for share in SHARES}
    for name, preset in PRESETS.items():
        shares[name] = preset.share
    if settings.within is not None:
        shares[length_text(settings.within)] = settings.within / length

    trial = Trial(scene, min(shares.values()))
    records = list[dict[str, Any]]()
    for fidelity in sorted(shares, key=shares.__getitem__, reverse=True):
        try:
            model = build_model(at_fidelity(scene, fidelity), "scene")
        except ConfigurationError as error:  # nothing is within this length
            print(error)
            continue
        bound = shares[fidelity] * length
        records.append(measure(model, trial, fidelity, bound))

    print(
        f"{scene.name}: largest distance from a converged reference in {len(trial.tests)} motions"
        f" and equilibria; {machine()}.\n"
    )
    table = markdown_table(HEADER, [cells_of(record) for record in records])
    print(f"{table}\n")
    write_csv(out / f"{scene.name}.csv", records)
    if settings.within is not None and recommended is not None:
        accuracy = length_text(settings.within)
        path = out / f"{scene.name}_{accuracy}.toml"
        write_recommended(recommended, path)


def measure(model: Model, trial: Trial, fidelity: str, tolerance: float) -> dict[str, Any]:
    """Cost and error of a fidelity: tolerance and tip_error [m], cpu_time [s].

    The error is NaN where there is no reference, or the model has no such motion.
    """
    tip_error = trial.distance(model)
    return {
        "asked": fidelity,
        "tolerance": tolerance,
        "coordinates": model.coordinate_count,
        "intervals": model.grid.per_piece,
        "cpu_time": cpu_time(model, trial),
        "tip_error": tip_error if np.isfinite(tip_error) else np.nan,
    }


def cells_of(record: dict[str, Any]) -> list[str]:
    """The row of HEADER for what `measure` gives: lengths in mm, times in ms."""
    return [
        record["asked"],
        number(1e3 * record["tolerance"]),
        str(record["coordinates"]),
        str(record["intervals"]),
        number(1e3 * record["cpu_time"]),
        measured_number(1e3 * record["tip_error"]),
    ]


def cpu_time(model: Model, trial: Trial) -> float:
    """Measured CPU time [s] of a simulated second on one thread, preparations included: the lesser
    of two over all motions."""
    motions = [test.commands for test in trial.tests if not test.reference.is_equilibrium]
    if not motions:
        return np.nan
    times = list[float]()
    for _ in range(2):
        started = time.thread_time()
        for tensions in motions:
            trajectory(model, tensions)
        times.append(time.thread_time() - started)
    rows = sum(len(tensions) for tensions in motions)
    simulated = HOLD * rows
    return min(times) / simulated


def write_recommended(scene: Scene, path: Path) -> None:
    """The scene as TOML, and beside it the passive fields that it names. Raises OSError."""
    if isinstance(getattr(scene.strain, "passive", None), Snapshots):
        fields_file = path.with_suffix(SUFFIX)
        fields_of(scene).save(fields_file)
        scene = scene.replace({"strain.passive.file": fields_file.name})
    save_scene(scene, path)
    print(f"written: {path}")
