"""Strain parametrisations of the rod: statics-based (implicit) and explicit polynomial bases.

They also say which of the six strains exist.
"""

from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Positive

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
    repeated = sorted({strain for strain in strains if strains.count(strain) > 1})
    if repeated:
        raise ValueError(f"should name each strain once, but repeats {', '.join(repeated)}")
    return strains


Strains = Annotated[tuple[Strain, ...], Field(min_length=1), AfterValidator(_check_each_once)]


class Modes(Configuration):
    """Legendre basis of order 0 to `order` for each of `strains`.

    It spans the whole rod or each of its pieces.

    A piece lies between neighbouring breakpoints: base, tip, tendon ends, segment borders and the
    strain's `borders`.
    """

    strains: Strains
    order: int = Field(ge=0, le=12)
    span: Literal["rod", "piece"]


class Snapshots(Configuration):
    """Passive fields of the arm's own, by proper orthogonal decomposition of simulated motions.

    `soft-tendon fields SCENE` makes them.
    """

    type: Literal["snapshots"] = "snapshots"
    fields: int = Field(ge=1, le=MOST_SNAPSHOT_FIELDS)  # how many of them, the leading ones
    # a path; None: among those that ship and those in the user's cache, by what they were made for
    file: str | None = None
    # to have these fields and no others; None: any that fit
    digest: str | None = Field(default=None, pattern="^[0-9a-f]{16}$")


PassiveStrain = Annotated[
    Annotated[tuple[Modes, ...], Tag("modes")] | Annotated[Snapshots, Tag("snapshots")],
    Discriminator(lambda passive: "modes" if isinstance(passive, tuple | list) else "snapshots"),
]


class StaticsBased(Configuration):
    """Statics-based strain parametrisation (30).

    The strain is the static answer to tensions and to `passive` moments and forces.

    The coordinates are tensions and the amplitudes of the passive fields. With `include_loads` the
    strain answers to dead loads too (35): gravity, the payload's weight, force and moment at the
    tip in the world frame. Other loads stay outside, as forces on the coordinates.
    """

    type: Literal["statics_based"] = "statics_based"
    # those that the rod has; the others are rigid (torsion and bending alone make a Kirchhoff rod)
    strains: Strains = STRAINS
    # fields of moments [N m] and forces [N] beside the tendons': Legendre `Modes`, or type
    # "snapshots"
    passive: PassiveStrain = ()
    # orthogonal to what the tendons span already; "raw" leaves fields as they are
    passive_coordinates: Literal["orthogonal", "raw"] = "orthogonal"
    # combinations of fields below this relative size get no coordinate
    rank_tolerance: Annotated[Positive, Field(lt=1)] = 1e-4
    borders: tuple[Positive, ...] = ()  # arc lengths [m] that cut the rod into further pieces
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
        return max((modes.order for modes in self.passive), default=0)

    @field_validator("passive")
    @classmethod
    def _of_the_rod(
        cls, passive: tuple[Modes, ...] | Snapshots, info: ValidationInfo
    ) -> tuple[Modes, ...] | Snapshots:
        existing = info.data.get("strains", STRAINS)
        groups = () if isinstance(passive, Snapshots) else passive
        strains = [strain for modes in groups for strain in modes.strains]
        rigid = [strain for strain in strains if strain not in existing]
        if rigid:
            raise ValueError(
                f"should name strains that the rod has, {', '.join(existing)}; not"
                f" {', '.join(rigid)}"
            )
        return passive


class ExplicitStrain(Configuration):
    """Explicit strain parametrisation xi = xi* + Phi q, a sum of `modes`.

    Strains that no mode names are rigid.

    Order 0 per piece is piecewise constant strain (PCS). `borders` are arc lengths [m] that cut the
    rod into further pieces.
    """

    type: Literal["explicit"] = "explicit"
    modes: tuple[Modes, ...] = Field(min_length=1)
    borders: tuple[Positive, ...] = ()

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
        _check_each_once(tuple(strain for group in modes for strain in group.strains))
        return modes
