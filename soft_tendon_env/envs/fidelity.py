"""Presets of accuracy against time: strain field, quadrature and integrator together.

What each costs and how far its tip is from full physics: `python benchmarks/fidelity.py`, docs/environments.md.
"""

from collections.abc import Mapping
from typing import Any, Literal

from soft_tendon_env.scene.scene import TIP_TOLERANCE, Scene

Fidelity = Literal["fast", "standard", "fine"]


def _moments(order: int) -> list[dict[str, Any]]:
    return [{"strains": ["torsion", "bend_y", "bend_z"], "order": order, "span": "rod"}]


PRESETS: Mapping[Fidelity, Mapping[str, Any]] = {
    "fast": {
        "strain": {"type": "statics_based"},
        "quadrature": {"tolerance": 5.0 * TIP_TOLERANCE, "least": 4},
        "integrator": {"step": 0.02, "columns": 2},
    },
    "standard": {
        "strain": {"type": "statics_based", "passive": _moments(2)},
        "quadrature": {"tolerance": 5.0 * TIP_TOLERANCE, "least": 4},
        "integrator": {"step": 0.02},
    },
    "fine": {
        "strain": {"type": "statics_based", "passive": _moments(3)},
        "quadrature": {"tolerance": 0.4 * TIP_TOLERANCE, "least": 6},
        "integrator": {"step": 0.01},
    },
}
"""fast: the tendons' own coordinates, 2 evaluations a step. standard: with passive moments up to quadratic, 4 evaluations.
fine: up to cubic, at half the step."""


def at_fidelity(scene: Scene, fidelity: Fidelity | None) -> Scene:
    """The scene with the preset's strain, quadrature and integrator; None: as the scene says."""
    return scene if fidelity is None else scene.replace(PRESETS[fidelity])
