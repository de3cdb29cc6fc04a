"""Settings of a simulation that trade accuracy for time: strain field, quadrature intervals and error tolerance, with a cost model."""

from typing import Any, NamedTuple

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import TIP_TOLERANCE, Scene, breakpoints
from soft_tendon_env.scene.strain import ExplicitStrain

OWN_FIELDS = (3, 6, 9, 12, 18, 24)  # numbers of the arm's own passive fields that are tried
LEGENDRE_ORDERS = (2, 3)  # of passive moments over the rod
ANGULAR = ("torsion", "bend_y", "bend_z")
TOLERANCES = (1e-3, 3e-4, 1e-4, 5e-5, 3e-5, 2e-5, 1e-5, 3e-6)  # of the integrator, as shares of the rod's length
PACKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # of quadrature intervals that are tried: what fills a pack costs no more than a part of it
QUADRATURE_TOLERANCE = 5.0 * TIP_TOLERANCE  # of the tip at rest, beyond which intervals are too few whatever motions say
FIXED, PER_PACK, PER_FIELD, SOLVE = 3.37e-6, 4.87e-7, 9.81e-8, 4.51e-9
"""Cost model [s], as `python benchmarks/evaluation_cost.py` fits it to measured times on an AMD EPYC."""


def evaluation_cost(model: Model) -> float:
    """CPU time [s] of one evaluation by the cost model, FIXED + packs (PER_PACK + PER_FIELD n) + SOLVE n^2, alike in every process."""
    n = model.coordinate_count
    return FIXED + model.grid.packs * (PER_PACK + PER_FIELD * n) + SOLVE * n**2


class Setting(NamedTuple):
    """Strain field, quadrature and integrator that a scene is simulated with."""

    name: str  # of the strain field
    strain: dict[str, Any]  # the scene's table
    intervals: int  # of quadrature, per piece
    tolerance: float  # [m] of the integrator

    def of(self, scene: Scene) -> Scene:
        """The scene with this setting."""
        quadrature = {"intervals": self.intervals, "tolerance": QUADRATURE_TOLERANCE}
        integrator = {"tolerance": self.tolerance, "max_halvings": scene.integrator.max_halvings}
        return scene.replace({"strain": self.strain, "quadrature": quadrature, "integrator": integrator})


def strain_fields(scene: Scene, fields: PassiveFields | None) -> dict[str, dict[str, Any]]:
    """Tables of the strain fields that are tried, by name; fields: the arm's own, where there are any."""
    free = list(scene.strain.free)
    kept: dict[str, Any] = {"type": "statics_based", "strains": free, "borders": list(scene.strain.borders)}
    if not isinstance(scene.strain, ExplicitStrain):
        kept |= scene.strain.model_dump(include={"passive_coordinates", "rank_tolerance", "include_loads"})
    passive: dict[str, Any] = {"tendons alone": []}
    if fields is not None:
        own = [count for count in OWN_FIELDS if count <= len(fields.coefficients)]
        passive |= {f"own {count}": {"type": "snapshots", "fields": count, "digest": fields.digest} for count in own}
    angular = [strain for strain in ANGULAR if strain in free] or free
    passive |= {f"Legendre {order}": [{"strains": angular, "order": order, "span": "rod"}] for order in LEGENDRE_ORDERS}
    return {name: {**kept, "passive": table} for name, table in passive.items()}


def quadratures(scene: Scene, least: int) -> list[int]:
    """Intervals per piece that are tried, at least `least`: the most that each number of packs holds."""
    pieces = len(breakpoints(scene)) - 1
    counts = {max(1, packs * LANES // pieces) for packs in (*PACKS, -(-least * pieces // LANES))}
    return sorted(count for count in counts if count >= least)
