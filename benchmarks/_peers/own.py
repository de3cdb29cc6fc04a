"""This package: reduced-order models of the arm with several strain fields, orders of integration,
steps and quadratures."""

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import PRESETS, at_fidelity
from soft_tendon_env.model.build import QuadratureWarning
from soft_tendon_env.scene.scene import Scene

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "soft_tendon_env"
DISTRIBUTION = "soft_tendon_env"
SECONDS = 2.0
REPEATS = 3  # the median counts: these runs last some milliseconds
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
ANGULAR = STRAINS[:3]


def statics_based(order: int | None, span: str = "rod") -> dict[str, Any]:
    """Tendons' fields and passive moments by Legendre polynomials up to `order`."""
    passive = [] if order is None else [{"strains": ANGULAR, "order": order, "span": span}]
    return {"type": "statics_based", "passive": passive}


def own_fields(count: int) -> dict[str, Any]:
    """Tendons' fields and the leading passive fields of the arm's own."""
    return {"type": "statics_based", "passive": {"type": "snapshots", "fields": count}}


def explicit(order: int) -> dict[str, Any]:
    """All six strains by Legendre polynomials up to `order` on each piece."""
    return {"type": "explicit", "modes": [{"strains": STRAINS, "order": order, "span": "piece"}]}


FIELDS: dict[str, dict[str, Any]] = {
    "no passive fields (paper)": statics_based(None),
    "moments 0-2": statics_based(2),
    "moments 0-2 per piece": statics_based(2, "piece"),
    "6 POD modes": own_fields(6),
    "9 POD modes": own_fields(9),
    "18 POD modes": own_fields(18),
    "24 POD modes": own_fields(24),
    "all strains, order 3": explicit(3),
    "all strains, order 4": explicit(4),
}
"""Strain fields that are tried, by what the tables call them: a scene's table `strain`."""
ORDERS = (2, 3, 4, 5, 1e-4, 1e-5)
"""Columns of extrapolation, or a tolerance [m] that the order follows."""
STEPS = (0.02, 0.01, 0.005)
INTERVALS = (4, 6)


@dataclass(frozen=True)
class Setting:
    """Strain fields (a key of FIELDS), columns of extrapolation or a tolerance [m], step [s],
    Magnus intervals per piece."""

    fields: str
    order: float = 3
    step: float = 0.02
    intervals: int = 6

    @property
    def label(self) -> str:
        order = f"{self.order} columns" if self.order >= 1 else f"tolerance {1e3 * self.order:g} mm"
        return f"{self.fields}; {order}, {1e3 * self.step:g} ms, {self.intervals} intervals"

    def scene(self, scene: Scene) -> Scene:
        order = {"columns": self.order} if self.order >= 1 else {"tolerance": self.order}
        changes = {
            "integrator": {"step": self.step, **order},
            "quadrature.intervals": self.intervals,
        }
        return scene.replace({"strain": FIELDS[self.fields], **changes})


@dataclass(frozen=True)
class Fidelity:
    """What users choose: a preset, or a length as the tip error."""

    name: str

    @property
    def label(self) -> str:
        return f'fidelity="{self.name}"'

    def scene(self, scene: Scene) -> Scene:
        return at_fidelity(scene, self.name)


CHOICES = tuple(Fidelity(name) for name in (*PRESETS, "1mm", "0.1mm"))
"""Settings that the picture names."""
QUICK = (Setting("no passive fields (paper)"), Setting("moments 0-2"))
HARD = (
    Setting("moments 0-2", step=0.01),
    Setting("9 POD modes", order=4, step=0.01),
    Setting("18 POD modes", order=1e-4, step=0.02),
)


def settings() -> Sequence[Setting | Fidelity]:
    grid = itertools.product(FIELDS, ORDERS, STEPS, INTERVALS)
    return [*(Setting(*choice) for choice in grid), *CHOICES]


def prepare(scene: Scene, setting: Setting | Fidelity) -> Run | None:
    """None where a setting has too few quadrature points for its coordinates, or where none
    reaches a length."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", QuadratureWarning
        )  # what too few intervals do is what is measured
        try:
            model = ste.build_model(setting.scene(scene), "scene")
        except ste.ConfigurationError:
            return None
    ste.simulate(model, np.zeros(len(scene.tendons)), HOLD, HOLD)  # compiles
    return lambda tensions: simulate(model, tensions)


def simulate(model: ste.Model, tensions: Array) -> Motion:
    found: list[ste.Trajectory] = []

    def run() -> None:
        found.append(ste.simulate(model, tensions, HOLD * len(tensions), HOLD))

    try:
        cpu = float(np.median([cpu_time(run) for _ in range(REPEATS)]))
    except ste.SimulationDiverged as stopped:
        return Motion(
            np.full((len(tensions) + 1, 3), np.nan), np.nan, f"SimulationDiverged: {stopped}"
        )
    halved = (
        f"{found[0].rejected} steps tried again at half their size" if found[0].rejected else ""
    )
    return Motion(found[0].tip_pose[:, :3, 3], cpu / (HOLD * len(tensions)), halved)
