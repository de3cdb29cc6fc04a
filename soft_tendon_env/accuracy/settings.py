"""Settings of a simulation that trade accuracy for time: strain field, quadrature intervals, integrator and step, with a cost model.

The cost model states what a simulated second takes without measuring it, so that every process and machine ranks settings alike.
"""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

from soft_tendon_env.compiler.compilation import KERNEL_SOURCES
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import TIP_TOLERANCE, Scene, breakpoints, extrapolation_columns, rod_length
from soft_tendon_env.scene.strain import ExplicitStrain
from soft_tendon_env.tools.configuration import Configuration, read_toml
from soft_tendon_env.tools.files import sources_digest
from soft_tendon_env.tools.types import Positive

OWN_FIELDS = (3, 6, 9, 12, 18, 24)
"""Numbers of the arm's own passive fields that are tried."""
LEGENDRE_ORDERS = (2, 3)
"""Orders of passive moments, over the rod and per piece."""
EXPLICIT_ORDERS = (3, 4)
"""Orders of explicit strains, per piece."""
ANGULAR = ("torsion", "bend_y", "bend_z")

STEPS = (0.02, 0.01)  # [s]
COLUMNS = (2, 3, 4)
TOLERANCES = (1e-3, 3e-4, 1e-4, 5e-5, 3e-5, 2e-5, 1e-5, 3e-6)
"""Error tolerances of the integrator, as shares of the rod's length; its order and then its step follow them."""
PACKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Numbers of packs of quadrature intervals that are tried: what fills a pack costs no more than a part of it."""
QUADRATURE_TOLERANCE = 5.0 * TIP_TOLERANCE
"""Displacement of the tip at rest by quadrature, at the limits of tension, beyond which intervals are too few whatever motions say."""

FITTED = Path(__file__).with_name("evaluation_cost.toml")
"""File of the cost model, which `python benchmarks/evaluation_cost.py --write` fits to measured times."""


class CostModel(Configuration):
    """CPU time [s] of one evaluation of the equation of motion, with its share of the step, by size of the model.

    fixed + packs (per_pack + per_field n) + solve n^2 for n coordinates and packs of LANES quadrature intervals, statics-based and explicit
    strain apart; loads inside of the strain multiply it by loads_inside. Another machine than that of the fit is faster or slower by a
    factor, which leaves the order of settings as it is; other kernels than those of the digest may change it. That an evaluation costs a
    fifth less or more where the order follows the error is left out.
    """

    machine: str
    kernels: str
    fixed: Positive
    per_pack: Positive
    solve: Positive
    per_field: dict[Literal["statics_based", "explicit"], Positive]
    loads_inside: Positive

    def of(self, model: Model) -> float:
        """The time [s] for a model."""
        n, inside = model.coordinate_count, self.loads_inside if isinstance(model.arm.strain, Loaded) else 1.0
        per_pack = self.per_pack + self.per_field[model.scene.strain.type] * n
        return inside * (self.fixed + model.grid.packs * per_pack + self.solve * n**2)


class Setting(NamedTuple):
    """Strain field, quadrature and integrator that a scene is simulated with."""

    name: str  # of the strain field
    strain: dict[str, Any]  # the scene's table
    intervals: int  # of quadrature, per piece
    step: float  # [s]
    columns: int | None
    tolerance: float | None  # [m] of the integrator

    def of(self, scene: Scene) -> Scene:
        """The scene with this setting."""
        given = {"step": self.step, "columns": self.columns, "tolerance": self.tolerance, "max_halvings": scene.integrator.max_halvings}
        quadrature = {"intervals": self.intervals, "tolerance": QUADRATURE_TOLERANCE}
        integrator = {key: value for key, value in given.items() if value is not None}
        return scene.replace({"strain": self.strain, "quadrature": quadrature, "integrator": integrator})

    def integrated(self, step: float, columns: int | None, tolerance: float | None) -> "Setting":
        """The setting with another integrator."""
        return self._replace(step=step, columns=columns, tolerance=tolerance)

    @property
    def integrator(self) -> str:
        """The integrator in words."""
        order = f"{self.columns} columns" if self.tolerance is None else f"tolerance {1e6 * self.tolerance:.3g} um"
        return f"{order}, {1e3 * self.step:g} ms"


@functools.cache
def kernel_digest() -> str:
    """16 hex digits of the sources of the kernels."""
    return sources_digest(*KERNEL_SOURCES)


@functools.cache
def cost_model() -> CostModel:
    """The cost model as it was last fitted."""
    return CostModel.parse(read_toml(FITTED), str(FITTED))


def evaluation_cost(model: Model) -> float:
    """CPU time [s] of one evaluation of the equation of motion by the cost model."""
    return cost_model().of(model)


def strain_fields(scene: Scene, fields: PassiveFields | None) -> dict[str, dict[str, Any]]:
    """Tables of the strain fields that are tried, by name; fields: the arm's own, where there are any."""
    free, borders = list(scene.strain.free), list(scene.strain.borders)
    angular = [strain for strain in ANGULAR if strain in free] or free
    kept = {"strains": free, "borders": borders}
    if not isinstance(scene.strain, ExplicitStrain):
        kept |= {"passive_coordinates": scene.strain.passive_coordinates, "rank_tolerance": scene.strain.rank_tolerance}
        kept |= {"include_loads": True} if scene.strain.include_loads else {}
    passive: dict[str, Any] = {"tendons alone": []}
    if fields is not None:
        own = [count for count in OWN_FIELDS if count <= len(fields.coefficients)]
        passive |= {f"own {count}": {"type": "snapshots", "fields": count, "digest": fields.digest} for count in own}
    spans = {"rod": "rod", **({"piece": "piece"} if len(breakpoints(scene)) > 2 else {})}
    for span, order in ((span, order) for span in spans for order in LEGENDRE_ORDERS):
        passive[f"Legendre {order} per {span}"] = [{"strains": angular, "order": order, "span": span}]
    found = {name: {"type": "statics_based", **kept, "passive": table} for name, table in passive.items()}
    for order in EXPLICIT_ORDERS:
        modes = [{"strains": free, "order": order, "span": "piece"}]
        found[f"explicit {order} per piece"] = {"type": "explicit", "modes": modes, "borders": borders}
    return found


def integrators(scene: Scene) -> Iterator[tuple[float, int | None, float | None]]:
    """Step [s], columns and tolerance [m] that are tried; more than 2 columns where the arm's damping allows them."""
    most = extrapolation_columns(scene.replace({"integrator": {"tolerance": 1.0, "step": max(STEPS)}}))
    for step in STEPS:
        for columns in COLUMNS:
            if columns <= most:
                yield step, columns, None
    for share in TOLERANCES:
        yield max(STEPS), None, share * rod_length(scene)


def quadratures(scene: Scene, least: int) -> list[int]:
    """Intervals per piece that are tried, at least `least`: the most that each number of packs holds."""
    pieces = len(breakpoints(scene)) - 1
    counts = {max(1, packs * LANES // pieces) for packs in (*PACKS, -(-least * pieces // LANES))}
    return sorted(count for count in counts if count >= least)
