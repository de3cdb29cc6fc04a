"""Plausibility of a scene: a word where a number is one that no arm has, most likely because it is
in another unit than SI's."""

import math
import warnings
from collections.abc import Iterator, Mapping

import numpy as np

from soft_tendon_env.scene.scene import (
    Scene,
    Segment,
    Tendon,
    along_rod,
    disc_rows,
    rod_length,
    rod_radius,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.tools.types import UNITS, Array

DENSITIES, MODULI = {"g/cm^3": 1e3, "t/mm^3": 1e12}, {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
LENGTH, MODULUS, DENSITY = (1e-3, 20.0), (1e3, 1e12), (10.0, 25e3)
"""Ranges of rods [m], endoscopes to hoses; of Young's moduli [Pa], gels to diamond; of densities
[kg/m^3], foams to osmium."""
SLENDER, FAR_OFF = (
    0.03,
    0.2,
    # shares of the rod's length: a usual radius or offset, and an offset outside of the rod that no
    # arm has
)
FAR_BASE = 100.0  # lengths of the rod from the world's origin at which no base is usually
METAL, IN_MPA = (
    5e3,
    5e5,
    # density [kg/m^3] of metals and rubbers full of them; modulus that metals have not in MPa, and
    # such rubbers in Pa
)
SOFT, STRAINED, STIFF_STRAINED = (
    1e7,
    10.0,
    2.0,
)  # modulus [Pa] of rubbers; strains at the limits that these and stiffer ones cannot take
CRUSHED, LEAST_BENT, PLACES = 30.0, 1.5e-3, 9
"""Strain by its own weight that not even gel in water has; angle [rad] that tensions bend arms of
metres; places along tendons."""


class UnitsWarning(UserWarning):
    """A scene has a number that no arm has, most likely in another unit than SI's."""


def warn_of_units(scene: Scene) -> None:
    """Warns, once, of the numbers of a scene that are likely to be in other units."""
    if found := [*_unlikely(scene)]:
        text = (
            f"{scene.name!r} has numbers that look as if they were not in SI units (m, kg, s, N,"
            f" Pa): {'; '.join(found)}"
        )
        warnings.warn(text, UnitsWarning, stacklevel=4)  # where the user builds it


def _ask(value: float, usual: float, units: Mapping[str, float]) -> str:
    """The question after the unit that brings a value nearest to a usual one; none where it has a
    usual size already."""
    nearest = min(
        ["", *units], key=lambda unit: abs(math.log10(value * units.get(unit, 1.0) / usual))
    )
    return f": is it {nearest}?" if nearest else ""


def _stiffness(segment: Segment, places: Array) -> Array:
    """Bending [N m^2], about the softer axis, and stretch [N] at arc lengths (m,) [m] of a segment:
    (2, m)."""
    elasticity = segment.screw_matrices(places)[0]
    return np.stack([elasticity[1:3].min(axis=0), elasticity[3]])


def _unlikely(scene: Scene) -> Iterator[str]:
    """Numbers that no arm has, in words."""
    length, usual = rod_length(scene), Tendon.model_fields["tension_limits"].default
    if not LENGTH[0] <= length <= LENGTH[1]:
        yield f"the rod is {length:g} m long{_ask(length, 0.3, UNITS)}"
    if (away := max(map(abs, scene.base.position))) > FAR_BASE * length:
        yield (
            f"base.position is up to {away:g} m from the origin of an arm of {length:g}"
            f" m{_ask(away, length, UNITS)}"
        )
    for i, segment in enumerate(scene.segments):
        E, density = segment.young_modulus, segment.density
        if E is None or density is None:  # a section that has the stiffnesses themselves
            continue
        if not MODULUS[0] <= E <= MODULUS[1] or (density > METAL and E < IN_MPA):
            of = (
                f", and its density, {density:g} kg/m^3, that of a metal" if density > METAL else ""
            )
            yield (
                f"segments[{i}].young_modulus is {E:g}"
                f" Pa{of}{_ask(E, 5e10 if density > METAL else 5e5, MODULI)}"
            )
        if not DENSITY[0] <= density <= DENSITY[1]:
            yield f"segments[{i}].density is {density:g} kg/m^3{_ask(density, 1e3, DENSITIES)}"
        elif MODULUS[0] <= E and 9.81 * density * length / E > CRUSHED:
            yield (
                f"a rod {length:g} m long with segments[{i}].young_modulus, {E:g} Pa, is crushed by"
                " its own weight: is it mm, or MPa?"
            )
    bent = 0.0
    for i, tendon in enumerate(scene.tendons):
        start, end = tendon_ends(scene, tendon)
        places = start + (end - start) * (np.arange(PLACES) + 0.5) / PLACES
        offset, radius = (
            np.linalg.norm(tendon_offset(scene, tendon, places)[0], axis=1),
            rod_radius(scene, places)[0],
        )
        if (widest := radius.max()) >= length:
            yield (
                f"the rod has a radius of {widest:g} m on a length of {length:g}"
                f" m{_ask(widest, SLENDER * length, UNITS)}"
            )
            return
        if (wide := disc_rows(scene)[:, 2].max(initial=0.0)) >= length:
            yield (
                f"spacer discs have a radius of {wide:g} m on a length of {length:g}"
                f" m{_ask(wide, SLENDER * length, UNITS)}"
            )
            return
        if (farthest := offset.max()) > max(FAR_OFF * length, widest):
            yield (
                f"tendons[{i}] is up to {farthest:g} m off the axis of a rod of {length:g}"
                f" m{_ask(farthest, SLENDER * length, UNITS)}"
            )
            return
        bending, stretch = along_rod(scene, places, _stiffness)
        pull = max(map(abs, tendon.tension_limits))
        strain = float(np.median(pull * (offset * radius / bending + 1.0 / stretch)))
        soft = (stretch / (np.pi * radius**2)).min() < SOFT
        if tendon.tension_limits != usual and strain > (STRAINED if soft else STIFF_STRAINED):
            yield (
                f"tendons[{i}].tension_limits are up to {pull:g} N, which strain the rod by"
                f" {strain:.0%}: is it mN, or a modulus in kPa?"
            )
            return
        bent = max(bent, float((pull * offset / bending).mean() * (end - start)))
    if 0.0 < bent < LEAST_BENT and 1.0 < length <= LENGTH[1]:
        yield (
            f"tensions within their limits bend the rod by at most {bent:.2g} rad: are lengths"
            " in mm?"
        )
