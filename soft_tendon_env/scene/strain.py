"""Strain parametrisations of the rod: statics-based (implicit) and explicit bases.

They also say which of the six strains exist.

A parametrisation is a class under `@register("strain", "name")`, here or in a user's own file as
`examples/own_strain.py`, which has an explicit basis of its own.
"""

from abc import abstractmethod
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.polynomial import legendre
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    SerializeAsAny,
    Tag,
    field_validator,
)
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.registry import TableRegistry, register
from soft_tendon_env.tools.types import Array, Positive

Strain = Literal["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]

MOST_SNAPSHOT_FIELDS = 24  # beyond, fields hardly add anything
# Legendre order, on each piece of the rod, of the polynomials that fields from snapshots are kept
# as
SNAPSHOT_ORDER = 10
# in the order of xi = (k, p)
STRAINS: tuple[Strain, ...] = (
    "torsion",
    "bend_y",
    "bend_z",
    "stretch",
    "shear_y",
    "shear_z",
)


def _check_each_once(strains: tuple[Strain, ...]) -> tuple[Strain, ...]:
    repeated = {strain for strain in strains if strains.count(strain) > 1}
    if repeated:
        names = ", ".join(sorted(repeated))
        raise ValueError(f"should name each strain once, but repeats {names}")
    return strains


Strains = Annotated[tuple[Strain, ...], Field(min_length=1), AfterValidator(_check_each_once)]


class Modes(Configuration):
    """Legendre basis of order 0 to `order` for each of `strains`.

    It spans the whole rod or each of its pieces.

    A piece lies between neighbouring breakpoints: base, tip, tendon ends, segment borders and the
    strain's `borders`.
    """

    strains: Strains  # names, each once: torsion, bend_y, bend_z, stretch, shear_y, shear_z
    # highest order of the polynomials, 0 to 12
    order: int = Field(ge=0, le=12)
    span: Literal["rod", "piece"]  # whether each polynomial spans the rod or one of its pieces


def mode_fields(modes: tuple[Modes, ...], points: Array, borders: Array) -> Array:
    """Computes Legendre fields of modes at points along the rod.

    They are in the order of pieces, then strains, then orders.

    Args:
        modes: the groups of strains.
        points: arc lengths (intervals, 2) [m].
        borders: arc lengths (pieces + 1,) [m] of the rod's pieces, from base to tip.

    Returns:
        The fields (fields, intervals, 2, 6).
    """
    whole_rod = [(0.0, borders[-1])]
    pieces = list(pairwise(borders))
    fields = list[Array]()
    for group in modes:
        if group.span == "rod":
            spans = whole_rod
        else:
            spans = pieces
        for a, b in spans:
            polynomials = _legendre_polynomials(points, a, b, group.order)
            for strain in group.strains:
                component = STRAINS.index(strain)
                block = np.zeros((*polynomials.shape, 6))
                block[..., component] = polynomials
                fields.extend(block)
    # there may be none
    shape = (len(fields), *points.shape, 6)
    return np.array(fields).reshape(shape)


def _legendre_polynomials(points: Array, a: float, b: float, order: int) -> Array:
    """Legendre polynomials on [a, b] at points (intervals, 2), and 0 beside it.

    They are of shape (order + 1, intervals, 2).
    """
    length = b - a
    from_start = points - a
    on_unit = 2 * from_start / length - 1
    is_behind_start = points > a
    is_before_end = points < b
    is_inside = is_behind_start & is_before_end
    polynomials = legendre.legvander(on_unit, order)
    values = polynomials * is_inside[..., None]
    fields = np.moveaxis(values, -1, 0)
    return np.asarray(fields)


class Snapshots(Configuration):
    """Passive fields of the arm's own, by proper orthogonal decomposition of simulated motions.

    `soft-tendon fields SCENE` makes them.
    """

    type: Literal["snapshots"] = "snapshots"
    fields: int = Field(ge=1, le=MOST_SNAPSHOT_FIELDS)  # number of the leading ones that are used
    # path of their file; None: among those that ship and those in the user's cache, by what they
    # were made for
    file: str | None = None
    # of the only fields that are taken, as a hash; None: any that fit
    digest: str | None = Field(default=None, pattern="^[0-9a-f]{16}$")


PassiveStrain = Annotated[
    Annotated[tuple[Modes, ...], Tag("modes")] | Annotated[Snapshots, Tag("snapshots")],
    Discriminator(lambda passive: "modes" if isinstance(passive, tuple | list) else "snapshots"),
]


class RodStrain(Configuration):
    """Base of the strain parametrisations, which say the strains that the rod has.

    `borders` are arc lengths [m] that cut it into further pieces.
    """

    borders: tuple[Positive, ...] = ()  # arc lengths [m] that cut the rod into further pieces

    @property
    @abstractmethod
    def free(self) -> tuple[Strain, ...]:
        """Strains that the rod has; the others are rigid."""

    @property
    @abstractmethod
    def highest_order(self) -> int:
        """Highest Legendre order of the fields, or that of polynomials as wavy as they are.

        Quadrature has to resolve them.
        """


class ExplicitBasis(RodStrain):
    """Base of explicit strain parametrisations xi = xi* + Phi q, whose fields Phi are constant.

    A field may jump at borders of pieces: `borders`, and the ends of tendons and segments.
    """

    @abstractmethod
    def fields(self, points: Array, borders: Array) -> Array:
        """Computes the strain fields Phi, linearly independent of each other.

        Args:
            points: arc lengths (intervals, 2) [m] from the base, inside of the pieces.
            borders: arc lengths (pieces + 1,) [m] of all pieces, from base to tip.

        Returns:
            The fields (n, intervals, 2, 6), each with the strains in the order of STRAINS:
            curvatures [1/m] per unit of its coordinate, then stretch and shear.
        """


class StaticsBased(RodStrain):
    """Statics-based strain parametrisation (30).

    The strain is the static answer to tensions and to `passive` moments and forces.

    The coordinates are tensions and the amplitudes of the passive fields. With `include_loads` the
    strain answers to dead loads too (35): gravity, the payload's weight, force and moment at the
    tip in the world frame. Other loads stay outside, as forces on the coordinates.
    """

    type: Literal["statics_based"] = "statics_based"
    # strains that the rod has; the others are rigid (torsion and bending alone make a Kirchhoff
    # rod)
    strains: Strains = STRAINS
    # fields of moments [N m] and forces [N] beside the tendons': Legendre `Modes`, or type
    # "snapshots"
    passive: PassiveStrain = ()
    # orthogonal to what the tendons span already; "raw" leaves fields as they are
    passive_coordinates: Literal["orthogonal", "raw"] = "orthogonal"
    # combinations of fields below this relative size get no coordinate
    rank_tolerance: Annotated[Positive, Field(lt=1)] = 1e-4
    # whether gravity and dead loads at the tip act inside the strain (35)
    include_loads: bool = False

    @property
    def free(self) -> tuple[Strain, ...]:
        """Strains that the rod has; the others are rigid."""
        return self.strains

    @property
    def highest_order(self) -> int:
        """Highest Legendre order of the fields that have coordinates of their own, else 0."""
        if isinstance(self.passive, Snapshots):
            return SNAPSHOT_ORDER
        orders = [modes.order for modes in self.passive]
        return max(orders, default=0)

    @field_validator("passive")
    @classmethod
    def _of_the_rod(
        cls, passive: tuple[Modes, ...] | Snapshots, info: ValidationInfo
    ) -> tuple[Modes, ...] | Snapshots:
        existing = info.data.get("strains", STRAINS)
        strains = list[str]()
        if not isinstance(passive, Snapshots):
            for modes in passive:
                strains.extend(modes.strains)
        rigid = [strain for strain in strains if strain not in existing]
        if rigid:
            raise ValueError(
                f"should name strains that the rod has, {', '.join(existing)}; not"
                f" {', '.join(rigid)}"
            )
        return passive


class ExplicitStrain(ExplicitBasis):
    """Explicit strain parametrisation xi = xi* + Phi q, a sum of `modes`.

    Strains that no mode names are rigid. Order 0 per piece is piecewise constant strain (PCS).
    """

    type: Literal["explicit"] = "explicit"
    # groups of polynomials; no strain is in two of them
    modes: tuple[Modes, ...] = Field(min_length=1)

    def fields(self, points: Array, borders: Array) -> Array:
        return mode_fields(self.modes, points, borders)

    @property
    def free(self) -> tuple[Strain, ...]:
        """Strains that the rod has: those of any mode; the others are rigid."""
        return tuple(strain for modes in self.modes for strain in modes.strains)

    @property
    def highest_order(self) -> int:
        """Highest Legendre order of the fields."""
        return max(modes.order for modes in self.modes)

    @field_validator("modes")
    @classmethod
    def _independent(cls, modes: tuple[Modes, ...]) -> tuple[Modes, ...]:
        # a strain's constant over the rod is the sum of its constants over the pieces: two groups
        # always overlap
        strains_of_modes = (strain for group in modes for strain in group.strains)
        _check_each_once(tuple(strains_of_modes))
        return modes


PARAMETRISATIONS: TableRegistry[RodStrain] = TableRegistry("strain", StaticsBased, ExplicitBasis)
"""Registered strain parametrisations, by the `type` that tables name."""

register("strain", "statics_based", StaticsBased)
register("strain", "explicit", ExplicitStrain)

AnyStrain = Annotated[SerializeAsAny[RodStrain], BeforeValidator(PARAMETRISATIONS.parse)]
"""A strain parametrisation, also as a table with its `type`."""
