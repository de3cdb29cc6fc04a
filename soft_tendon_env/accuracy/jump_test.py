"""Jump test: steps of the greatest tension on one, two and all tendons at long time steps, as a test of numerical stability."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.types import Explicit
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.simulation import SimulationDiverged, simulate
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

FACTORS = (1.0, 2.5)  # of the greatest tension: 60 and 150 N on the paper's arm
STEPS = (0.01, 0.02)  # [s]
DURATION = 1.0  # [s]
INTERVALS = 6


class Jump(NamedTuple):
    """Outcome of one abrupt load."""

    case: str
    survived: bool
    rejected: int  # time steps
    phantom: float  # largest tension of the strain law, as a share of the largest applied


def jump_test(scene: Scene) -> list[Jump]:
    """Outcomes of FACTORS times the greatest tension, there at once, on one, two and all tendons of a statics-based arm, at STEPS."""
    greatest = np.array([tendon.tension_limits[1] for tendon in scene.tendons])
    groups = {"tendon 0": [0], "tendons 0 and 1": [0, 1], "all tendons": list(range(greatest.size))}
    found = []
    for step in STEPS:
        model = model_on(scene.replace({"integrator": {"step": step}, "effects": scene.effects.on_arm()}), INTERVALS)
        for factor in FACTORS:
            for name, group in groups.items():
                if max(group) < greatest.size:
                    tension = np.zeros(greatest.size)
                    tension[group] = factor * greatest[group]
                    found.append(_outcome(model, tension, f"{factor * greatest[group].max():g} N on {name}, steps of {1e3 * step:g} ms"))
    return found


def _outcome(model: Model, tension: Array, case: str) -> Jump:
    strain = model.arm.strain
    assert not isinstance(strain, Explicit)
    try:
        motion = simulate(model, tension, DURATION, model.scene.integrator.step)
    except (SimulationDiverged, StrainLimitError):
        return Jump(case, False, 0, np.inf)
    phantom = max(float(np.abs(strain.tensions(q)).max()) for q in motion.q)
    return Jump(case, True, motion.rejected, phantom / tension.max())
