"""Strain parametrisations of the rod: statics-based (implicit) and explicit polynomial bases, and which of the six strains exist."""
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, field_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.tools.configuration import Configuration

Positive = Annotated[float, Field(gt=0)]
Strain = Literal["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]

STRAINS: tuple[Strain, ...] = ("torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z")
"""The six strains in the order of xi = (k, p)."""


class Modes(Configuration):
    """Legendre basis of order 0 to `order` for each of `strains`, over the whole rod or over each of its pieces.

    A piece lies between neighbouring breakpoints: base, tip, tendon ends, segment borders and the strain's `borders`.
    """

    strains: tuple[Strain, ...] = Field(min_length=1)
    order: int = Field(ge=0, le=12)
    span: Literal["rod", "piece"]

    @field_validator("strains")
    @classmethod
    def _unique(cls, strains: tuple[Strain, ...]) -> tuple[Strain, ...]:
        _check_each_once(strains)
        return strains


class StaticsBased(Configuration):
    """Statics-based strain parametrisation (30): the strain is the static answer to tensions and to `passive` moments and forces.

    The coordinates are tensions and the amplitudes of the passive fields.

    Attributes:
        strains: those that the rod has; the others are rigid (torsion and bending alone make a Kirchhoff rod).
        passive: fields beside those of the tendons: moments [N m] for torsion and bending, forces [N] for the others.
        passive_coordinates: "orthogonal" takes from the passive fields what the tendons span already, "raw" leaves them.
        rank_tolerance: combinations of fields below this relative size count as dependent and get no coordinate.
        borders: arc lengths [m] that cut the rod into further pieces.
    """

    type: Literal["statics_based"] = "statics_based"
    strains: tuple[Strain, ...] = Field(default=STRAINS, min_length=1)
    passive: tuple[Modes, ...] = ()
    passive_coordinates: Literal["orthogonal", "raw"] = "orthogonal"
    rank_tolerance: Positive = 1e-4
    borders: tuple[Positive, ...] = ()

    @field_validator("strains")
    @classmethod
    def _unique(cls, strains: tuple[Strain, ...]) -> tuple[Strain, ...]:
        _check_each_once(strains)
        return strains

    @field_validator("passive")
    @classmethod
    def _of_the_rod(cls, passive: tuple[Modes, ...], info: ValidationInfo) -> tuple[Modes, ...]:
        existing = info.data.get("strains", STRAINS)
        if rigid := [strain for modes in passive for strain in modes.strains if strain not in existing]:
            raise ValueError(f"should name strains that the rod has, {', '.join(existing)}; not {', '.join(rigid)}")
        return passive


class ExplicitStrain(Configuration):
    """Explicit strain parametrisation xi = xi* + Phi q, a sum of `modes`; strains that no mode names are rigid.

    Order 0 per piece is piecewise constant strain (PCS); with bending alone, piecewise constant curvature (PCC). `borders` are arc
    lengths [m] that cut the rod into further pieces.
    """

    type: Literal["explicit"] = "explicit"
    modes: tuple[Modes, ...] = Field(min_length=1)
    borders: tuple[Positive, ...] = ()

    @field_validator("modes")
    @classmethod
    def _independent(cls, modes: tuple[Modes, ...]) -> tuple[Modes, ...]:
        # a strain's constant over the rod is the sum of its constants over the pieces: two groups always overlap
        _check_each_once(strain for group in modes for strain in group.strains)
        return modes


def _check_each_once(strains: Iterable[Strain]) -> None:
    strains = list(strains)
    if repeated := sorted({strain for strain in strains if strains.count(strain) > 1}):
        raise ValueError(f"should name each strain once, but repeats {', '.join(repeated)}")
