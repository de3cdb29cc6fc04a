"""Converged reference motions: full Cosserat-rod physics, refined until the arm's tip no longer
moves, with an error bar.

Basis, quadrature and time steps are refined together: what a motion changes by from one level to
the next, with the tolerance of its time steps, which may err alike at both, bounds the finer one's
error.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from soft_tendon_env.accuracy.input_motions import HOLD
from soft_tendon_env.model.full_physics import LEVELS, Level, full_physics
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import (
    NoEquilibriumError,
    Simulation,
    SimulationDiverged,
    Trajectory,
    simulate,
)
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import LEAST_TOLERANCE, Scene, rod_length
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

STEPS = (
    5e-2,
    1e-2,
    2e-3,
    # tolerance of time steps at a level, as a share of that of the motions; the last for those that
    # follow
)


class Reference(NamedTuple):
    """Motions and equilibria of full physics."""

    tips: tuple[
        Array | None,
        ...,
        # (rows + 1, 3) [m] for every input, the tip every HOLD, the start first; None: there is no
        # such motion
    ]
    tip_errors: tuple[float, ...]  # [m], bounds of the errors of these
    level: Level


def step_tolerance(scene: Scene, level: Level, tolerance: float) -> float:
    """Tolerance [m] of the time steps at a level of full physics, for motions with this tolerance
    [m]."""
    return max(
        STEPS[min(LEVELS.index(level), len(STEPS) - 1)] * tolerance,
        10.0 * LEAST_TOLERANCE * rod_length(scene),
    )


def trajectory(model: Model, tensions: Array) -> Trajectory | None:
    """Motion every HOLD from rest, slack, under tensions (rows, n_a) each held for HOLD; None where
    there is no such motion or rest."""
    start = Simulation(model)
    slack = np.clip(0.0, *np.array([tendon.tension_limits for tendon in model.scene.tendons]).T)
    try:
        return simulate(model, tensions, HOLD * len(tensions), HOLD, start.reset_at_rest(slack))
    except (SimulationDiverged, StrainLimitError, NoEquilibriumError):
        return None


def tip_path(model: Model, tensions: Array) -> Array | None:
    """Positions of the tip (rows + 1, 3) [m] in a `trajectory`, or (1, 3) at rest under tensions
    (n_a,); None where there is none."""
    if tensions.ndim == 1:
        rest = static_equilibrium(model, tensions)
        return rest.tip_pose[None, :3, 3] if rest.converged else None
    motion = trajectory(model, tensions)
    return None if motion is None else motion.tip_pose[:, :3, 3]


def distance(path: Array | None, reference: Array | None) -> float:
    """Largest distance [m] of the tip from a reference (samples, 3); inf where the model, nan where
    full physics has no such motion."""
    if reference is None:
        return np.nan
    return np.inf if path is None else float(np.linalg.norm(path - reference, axis=1).max())


def reference_motions(
    scene: Scene, inputs: Sequence[Array], tolerance: float, most: int = len(LEVELS)
) -> Reference:
    """Motions of full physics under inputs (rows, n_a) [N], each row held for HOLD, or equilibria
    under (n_a,), each refined until its error is below `tolerance` [m], or to the finest of the
    first `most` of LEVELS. The level is that of the last to be refined."""
    found: list[Array | None] = [None] * len(inputs)
    errors, rest = [np.inf] * len(inputs), list(range(len(inputs)))
    for level in LEVELS[:most]:
        model = full_physics(scene, level, steps := step_tolerance(scene, level, tolerance))
        label = f"full physics, {model.coordinate_count} coordinates"
        paths = run_all(
            partial(tip_path, model),
            [inputs[i] for i in rest],
            processors(),
            label,
            unit="motion",
            threads=True,
        )
        for i, now in zip(rest, paths, strict=True):
            errors[i] = (
                np.inf
                if found[i] is None
                else distance(now, found[i]) + steps * (inputs[i].ndim - 1)
            )  # equilibria have none
            found[i] = now
        rest = [i for i in rest if found[i] is None or errors[i] > tolerance]
        if not any(found[i] is not None for i in rest) and len(rest) < len(inputs):
            break
    return Reference(tuple(found), tuple(errors), level)
