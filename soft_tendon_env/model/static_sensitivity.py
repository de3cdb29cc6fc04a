"""Sensitivities of static equilibria: derivatives of shape and measurements by numbers of the scene and by tensions.

Implicit function theorem: f(q, u, p) = B u - K + F = 0 holds along a branch of equilibria, so dq = S^-1 (B du + df/dp dp) with the tangent
stiffness S = -df/dq, and a measurement y(q, p) changes by dy/dq dq + dy/dp dp. The partial derivatives are differences of fourth order at
coordinates that are held: no equilibrium is solved again, and the arms with other numbers are shared by all equilibria.
"""

from collections.abc import Iterable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion.balance_reading import read_balances
from soft_tendon_env.mechanics.motion.batch import make_reading
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.measurements import Measurements, derivatives_of, measurements_of, rows_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.parameter_differences import CENTRAL, derivative_by, step_factor
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_parameters
from soft_tendon_env.tools.checks import checked_array, checked_type, dimensions
from soft_tendon_env.tools.types import Array

STEP = 1e-4
"""Step of a coordinate as a share of its unit, a bend of the arm by a radian."""
AT_REST = 1e-6
"""Unbalanced force, as the angle [rad] by which it would bend the arm, up to which coordinates count as an equilibrium."""


class StaticDerivatives(NamedTuple):
    """Derivatives of an equilibrium by m numbers, the last axis; with a leading axis where there are several equilibria.

    Those of poses are body twists (angular, linear), in the section's own frame [rad, m].
    """

    q: Array  # (n, m)
    tip_pose: Array  # (6, m)
    stations: Array  # (stations, 6, m)
    tendon_length: Array  # (n_a, m)
    strain: Array  # (sensors, 6, m)


class StaticSensitivities(NamedTuple):
    """Measurements of equilibria, and their total derivatives."""

    reading: Measurements
    parameters: StaticDerivatives  # by the parameters, in their order, each in the unit of its key: see Parameter
    tension: StaticDerivatives  # by the tensions [N]


def static_sensitivities(
    model: Model,
    q: ArrayLike,
    tension: ArrayLike,
    parameters: Iterable[str] = (),
    *,
    stations: ArrayLike = (),
    sensors: ArrayLike = (),
) -> StaticSensitivities:
    """Sensitivities of equilibria q (n,) under tensions (n_a,) [N], or of several, (holds, n) under (holds, n_a).

    parameters: dotted keys of numbers of the scene, `"segments.*.young_modulus"`, see `scene_parameters`.
    stations, sensors: arc lengths (s,) and (k,) [m] at which poses and strains are read.

    Quadrature and passive fields stay those of the model, whose coordinates keep their meaning, see `Model.with_numbers`. Where an
    equilibrium has neutral modes, they stay as they are. Raises TypeError or ValueError for bad arrays and coordinates that are no
    equilibrium or where the arm is about to give way, ConfigurationError for keys, StrainLimitError where there is no strain.
    """
    checked_type("model", model, Model, "see build_model")
    chosen, one = scene_parameters(model.scene, parameters), dimensions(q) == 1
    rests = np.atleast_2d(checked_array("q", q, (model.coordinate_count,) if one else (None, model.coordinate_count)))
    pulls = np.atleast_2d(checked_array("tension", tension, (model.tendon_count,) if one else (len(rests), model.tendon_count)))
    if not len(rests):
        raise ValueError("q should have at least one row: there is no equilibrium to look at")
    holds = _Holds(model, rests, pulls, model.arc_lengths("stations", stations), model.arc_lengths("sensors", sensors))
    partial = np.empty((*holds.rows.shape, len(chosen)))
    for i, parameter in enumerate(chosen):
        partial[..., i] = derivative_by(model, parameter, holds.scaled_rows) * holds.unit
    found = StaticSensitivities(
        measurements_of(holds.rows[:, rests.shape[1] :], holds.places), holds.totals(partial), holds.totals(holds.by_tension())
    )
    return _first(found) if one else found


def _first(found: StaticSensitivities) -> StaticSensitivities:
    derivatives = (StaticDerivatives(*(values[0] for values in part)) for part in found[1:])
    return StaticSensitivities(found.reading.first(), *derivatives)


class _Holds:
    """Equilibria of one model, with their unbalanced forces and measurements as rows of numbers, a row per equilibrium."""

    def __init__(self, model: Model, q: Array, tension: Array, stations: Array, sensors: Array) -> None:
        """Raises ValueError where forces are not balanced, StrainLimitError."""
        self.model, self.q, self.tension = model, q, tension
        self.places = model.grid.places(stations, sensors)
        self.guess = np.array([model.packed_strain(own) for own in q]).reshape(len(q), model.arm.rod.reference_strain.size)
        self.rows = self.rows_at(model, q, tension)
        self.unit = np.ones(self.rows.shape[1])
        self.unit[: q.shape[1]] = model.bending_energy / model.coordinate_scale()
        self._check_balance()

    def rows_at(self, model: Model, q: Array, tension: Array) -> Array:
        """Rows (samples, numbers) of a model at coordinates near the equilibria: as many for each, one after the other."""
        force, reading = np.empty_like(q), make_reading(model.arm, self.places, len(q))
        with model.workspace() as work:
            failed = read_balances(model.arm, self.places, tension, q, self.guess, work, force, reading)
        if failed >= 0:
            hold = failed * len(self.q) // len(q)
            raise StrainLimitError(f"no strain balances the coordinates next to q[{hold}] or with numbers a little off: see Model.tip_pose")
        return np.hstack([force, rows_of(reading)])

    def scaled_rows(self, model: Model, _change: float) -> Array:
        """Rows of a model with other numbers, forces as the angles [rad] by which they bend the arm."""
        return self.rows_at(model, self.q, self.tension) / self.unit

    def _check_balance(self) -> None:
        off = np.abs(self.rows / self.unit)[:, : self.q.shape[1]].max(axis=1, initial=0.0)
        for hold in np.flatnonzero(~(off <= AT_REST)):
            text = f"coordinates should be an equilibrium, but q[{hold}] is off by {off[hold]:.2g} rad under tension[{hold}]"
            raise ValueError(f"{text}: see static_equilibrium")

    @cached_property
    def by_coordinates(self) -> Array:
        """Derivatives of the rows by the coordinates, (holds, numbers, n)."""
        holds, n = self.q.shape
        steps = step_factor(self.model) * STEP * self.model.coordinate_scale()
        moves = np.array([k * np.diag(steps) for k in CENTRAL])  # (4, n, n)
        q = (self.q[:, None, None] + moves).reshape(-1, n)
        rows = self.rows_at(self.model, q, np.repeat(self.tension, len(CENTRAL) * n, axis=0)).reshape(holds, len(CENTRAL), n, -1)
        return np.asarray(np.einsum("k,hkjm->hmj", [*CENTRAL.values()], rows) / steps)

    @cached_property
    def compliance(self) -> Array:
        """S^-1 (holds, n, n). Raises ValueError where S is singular."""
        inverses, balance = [], Balance(self.model, self.tension[0])
        for hold, slopes in enumerate(self.by_coordinates):
            if (inverse := balance.inverse(-slopes[: self.q.shape[1]])) is None:
                raise ValueError(f"q[{hold}] has no derivative: {balance.obstacle}")
            inverses.append(inverse)
        return np.array(inverses)

    def by_tension(self) -> Array:
        """Derivatives of the rows by the tensions at coordinates that are held, (holds, numbers, n_a): B, and nothing else."""
        still, partial = np.zeros(self.q.shape[1]), np.zeros((*self.rows.shape, self.tension.shape[1]))
        for own, q, tension in zip(partial, self.q, self.tension, strict=True):
            own[: still.size] = self.model.terms(q, still, tension).actuation
        return partial

    def totals(self, partial: Array) -> StaticDerivatives:
        """Total derivatives, of derivatives (holds, numbers, m) of the rows at coordinates that are held."""
        n = self.q.shape[1]
        q = self.compliance @ partial[:, :n]
        slopes = partial + self.by_coordinates @ q
        return StaticDerivatives(q, *derivatives_of(self.rows[:, n:], slopes[:, n:], self.places))
