"""Converged reference motions: full Cosserat-rod physics, refined until the arm's tip no longer moves, with an error bar.

Full physics is an explicit Legendre basis of every strain that the rod has. Order, quadrature and step are refined together: what a motion
changes by from one level to the next bounds the error of the finer one.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from soft_tendon_env.accuracy.input_motions import HOLD
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.simulation import NoEquilibriumError, Simulation, SimulationDiverged, Trajectory, simulate
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene, breakpoints, extrapolation_columns
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array


class Level(NamedTuple):
    """How fine full physics is."""

    order: int  # of the polynomials
    cuts: int  # parts that each piece of the rod is cut into
    intervals: int  # of quadrature, per part
    step: float  # [s]


LEVELS = (
    Level(4, 1, 12, 0.01),
    Level(6, 1, 16, 0.005),
    Level(8, 1, 24, 0.0025),
    Level(11, 1, 32, 0.00125),
    Level(8, 2, 24, 0.00125),
    Level(8, 4, 24, 0.001),
)


class Reference(NamedTuple):
    """Motions of full physics."""

    tips: tuple[Array | None, ...]  # (rows + 1, 3) [m] for every input, the tip every HOLD, the start first; None: there is no such motion
    tip_errors: tuple[float, ...]  # [m], what each still changed by when it was last refined
    level: Level


def full_physics(scene: Scene, level: Level) -> Model:
    """Model of a scene with an explicit basis of every strain that the rod has."""
    borders = breakpoints(scene)
    cuts = [a + (b - a) * np.arange(1, level.cuts) / level.cuts for a, b in zip(borders[:-1], borders[1:], strict=True)]
    modes = [{"strains": list(scene.strain.free), "order": level.order, "span": "piece"}]
    strain = {"type": "explicit", "modes": modes, "borders": [*scene.strain.borders, *np.concatenate(cuts).tolist()]}
    is_damped = extrapolation_columns(scene.replace({"integrator": {"step": level.step}})) > 2
    changes = {"strain": strain, "integrator": {"step": level.step, "columns": 4 if is_damped else 2}}
    return model_on(scene.replace(changes), level.intervals)


def trajectory(model: Model, tensions: Array) -> Trajectory | None:
    """Motion every HOLD from rest, slack, under tensions (rows, n_a) each held for HOLD; None where there is no such motion or rest."""
    start = Simulation(model)
    slack = np.clip(0.0, *np.array([tendon.tension_limits for tendon in model.scene.tendons]).T)
    try:
        return simulate(model, tensions, HOLD * len(tensions), HOLD, start.reset_at_rest(slack))
    except (SimulationDiverged, StrainLimitError, NoEquilibriumError):
        return None


def distance(motion: Trajectory | None, reference: Array | None) -> float:
    """Largest distance [m] of the tip from a reference (samples, 3); inf where the model, nan where full physics has no such motion."""
    if reference is None:
        return np.nan
    return np.inf if motion is None else float(np.linalg.norm(motion.tip_pose[:, :3, 3] - reference, axis=1).max())


def reference_motions(scene: Scene, inputs: Sequence[Array], tolerance: float) -> Reference:
    """Motions of full physics under inputs (rows, n_a) [N], each row held for HOLD, each refined until it does not change by more than
    `tolerance` [m], or to the finest of LEVELS. The level is that of the last to be refined."""
    found: list[Array | None] = [None] * len(inputs)
    changes, rest = [np.inf] * len(inputs), list(range(len(inputs)))
    for level in LEVELS:
        model, label = full_physics(scene, level), f"full physics, steps of {1e3 * level.step:g} ms"
        motions = run_all(partial(trajectory, model), [inputs[i] for i in rest], processors(), label, unit="motion", threads=True)
        for i, now in zip(rest, motions, strict=True):
            changes[i] = np.inf if found[i] is None else distance(now, found[i])
            found[i] = None if now is None else now.tip_pose[:, :3, 3]
        rest = [i for i in rest if found[i] is None or changes[i] > tolerance]
        if not any(found[i] is not None for i in rest) and len(rest) < len(inputs):
            break
    return Reference(tuple(found), tuple(changes), level)
