"""Plausibility of a scene: a warning where a number is one that no arm has.

Most likely such a number is in another unit than SI's.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from soft_tendon_env.scene.plausibility import implausible
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

# units that numbers may be in by mistake, as factors of the SI unit
DENSITIES = {"g/cm^3": 1e3, "t/mm^3": 1e12}
MODULI = {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
# usual ranges
SHORTEST_ROD = 1e-3  # [m], of micro-robots
LONGEST_ROD = 20.0  # [m], of hoses
SOFTEST = 1e3  # Young's modulus [Pa] of gels
STIFFEST = 1e12  # of diamond
LIGHTEST = 10.0  # density [kg/m^3] of foams
HEAVIEST = 25e3  # of osmium
# usual sizes, by which a unit is guessed
USUAL_LENGTH = 0.3  # of a rod [m]
USUAL_DENSITY = 1e3  # [kg/m^3]
USUAL_MODULUS = 5e5  # of a soft arm [Pa]
USUAL_METAL_MODULUS = 5e10  # [Pa]
SLENDER = 0.03  # share of the rod's length that a usual radius or offset is
FAR_OFF = 0.2  # that an offset outside of the rod is on no arm
FAR_BASE = 100.0  # lengths of the rod from the world's origin at which no base is usually
METAL = 5e3  # density [kg/m^3] of metals and rubbers full of them
IN_MPA = 5e5  # modulus that metals have not in MPa, and such rubbers in Pa
SOFT = 1e7  # modulus [Pa] of rubbers
# strains at the tension limits that no material takes
STRAINED = 10.0  # of rubbers
STIFF_STRAINED = 2.0  # of stiffer ones
CRUSHED = 30.0  # strain by its own weight that not even gel in water has
GRAVITY = 9.81  # [m/s^2]
LEAST_BENT = 1.5e-3  # angle [rad] by which tensions bend arms of metres at least
LONG_ROD = 1.0  # length [m] above which a rod that hardly bends may be in mm
PLACES = 9  # along tendons, at which they are looked at


class UnitsWarning(UserWarning):
    """A scene has a number that no arm has, most likely in another unit than SI's."""


def warn_of_units(scene: Scene) -> None:
    """Warns, once, of the numbers of a scene that are likely to be in other units.

    Args:
        scene: that a model is built of.
    """
    numbers = [*_unlikely(scene)]
    if not numbers:  # shares of the arm say something only where its own sizes are plausible
        numbers = [*implausible(scene)]
    if numbers:
        text = (
            f"{scene.name!r} has numbers that look as if they were not in SI units (m, kg, s, N,"
            f" Pa): {'; '.join(numbers)}"
        )
        warnings.warn(text, UnitsWarning, stacklevel=4)  # where the user builds it


def _ask(value: float, usual: float, units: Mapping[str, float]) -> str:
    """The question after the unit that brings a value nearest to a usual one.

    There is none where it has a usual size already.
    """
    factors = {"": 1.0, **units}  # "": as it is

    def decades_off(unit: str) -> float:
        """Distance of the value, in a unit, to the usual one, in powers of ten."""
        converted = value * factors[unit]
        return abs(math.log10(converted / usual))

    nearest = min(factors, key=decades_off)
    if nearest:
        return f": is it {nearest}?"
    return ""


def _stiffness(segment: Segment, places: Array) -> Array:
    """Bending [N m^2] and stretch stiffness [N] at arc lengths of a segment: (2, m).

    Bending is about the softer axis; the arc lengths (m,) are in [m].
    """
    elasticity = segment.screw_matrices(places)[0]
    bending = elasticity[1:3].min(axis=0)
    stretch = elasticity[3]
    return np.stack([bending, stretch])


def _unlikely(scene: Scene) -> Iterator[str]:
    """Numbers that no arm has, in words."""
    length = rod_length(scene)
    if not SHORTEST_ROD <= length <= LONGEST_ROD:
        question = _ask(length, USUAL_LENGTH, UNITS)
        yield f"the rod is {length:g} m long{question}"
    distances = map(abs, scene.base.position)
    distance = max(distances)
    if distance > FAR_BASE * length:
        yield (
            f"base.position is up to {distance:g} m from the origin of an arm of {length:g}"
            f" m{_ask(distance, length, UNITS)}"
        )
    for i, segment in enumerate(scene.segments):
        yield from _unlikely_material(segment, i, length)
    bent = 0.0  # angle [rad] by which the limit of the strongest tension bends the rod
    for i, tendon in enumerate(scene.tendons):
        path = _Path.of_tendon(scene, tendon)
        text = _unlikely_radius(scene, path) or _unlikely_tendon(path, i)
        if text:  # one is enough: they are likely in the same wrong unit
            yield text
            return
        bent = max(bent, path.bent())
    is_hardly_bent = 0.0 < bent < LEAST_BENT
    if is_hardly_bent and LONG_ROD < length <= LONGEST_ROD:
        yield (
            f"tensions within their limits bend the rod by at most {bent:.2g} rad: are lengths"
            " in mm?"
        )


def _unlikely_material(segment: Segment, i: int, length: float) -> Iterator[str]:
    """Numbers of the material of segment i, in a rod of a length [m]."""
    E = segment.young_modulus
    density = segment.density
    if E is None or density is None:  # a section that has the stiffnesses themselves
        return
    is_metal = density > METAL
    is_plausible = SOFTEST <= E <= STIFFEST
    if not is_plausible or (is_metal and E < IN_MPA):
        if is_metal:
            reason = f", and its density, {density:g} kg/m^3, that of a metal"
        else:
            reason = ""
        if is_metal:
            usual = USUAL_METAL_MODULUS
        else:
            usual = USUAL_MODULUS
        question = _ask(E, usual, MODULI)
        yield f"segments[{i}].young_modulus is {E:g} Pa{reason}{question}"
    # the strain at the base of a standing rod
    weight = GRAVITY * density * length
    compression = weight / E
    if not LIGHTEST <= density <= HEAVIEST:
        question = _ask(density, USUAL_DENSITY, DENSITIES)
        yield f"segments[{i}].density is {density:g} kg/m^3{question}"
    elif E >= SOFTEST and compression > CRUSHED:
        yield (
            f"a rod {length:g} m long with segments[{i}].young_modulus, {E:g} Pa, is crushed by"
            " its own weight: is it mm, or MPa?"
        )


class _Path(NamedTuple):
    """A tendon and the rod around it, at places along it."""

    tendon: Tendon
    rod_length: float  # [m]
    length: float  # of the tendon along the rod [m]
    offset: Array  # (m,) from the axis [m]
    radius: Array  # (m,) of the rod [m]
    bending: Array  # (m,) stiffness of the rod about the softer axis [N m^2]
    stretch: Array  # (m,) stiffness [N]

    @classmethod
    def of_tendon(cls, scene: Scene, tendon: Tendon) -> "_Path":
        """Path of a scene's tendon."""
        start, end = tendon_ends(scene, tendon)
        length = end - start
        shares = np.arange(PLACES) + 0.5
        from_start = length * shares / PLACES
        places = start + from_start
        offset, _ = tendon_offset(scene, tendon, places)
        radius, _ = rod_radius(scene, places)
        bending, stretch = along_rod(scene, places, _stiffness)
        return cls(
            tendon,
            rod_length=rod_length(scene),
            length=length,
            offset=np.linalg.norm(offset, axis=1),
            radius=radius,
            bending=bending,
            stretch=stretch,
        )

    @property
    def pull(self) -> float:
        """Greatest tension within the limits, also of a push [N]."""
        return max(map(abs, self.tendon.tension_limits))

    def strain(self) -> float:
        """Strain that this tension makes: bending at the surface, and compression."""
        moment = self.offset * self.radius
        of_bending = moment / self.bending
        of_compression = 1.0 / self.stretch
        strain = self.pull * (of_bending + of_compression)
        return float(np.median(strain))

    def bent(self) -> float:
        """Angle [rad] by which this tension bends the rod."""
        moment = self.pull * self.offset
        curvature = moment / self.bending
        return float(curvature.mean() * self.length)


def _unlikely_radius(scene: Scene, path: _Path) -> str:
    """The radius of a rod, or of discs, that is as large as the rod is long, in words.

    It is empty where there is none.
    """
    length = path.rod_length
    widest = path.radius.max()
    disc_radii = disc_rows(scene)[:, 2]
    disc = disc_radii.max(initial=0.0)
    for name, radius in (("the rod has", widest), ("spacer discs have", disc)):
        if radius >= length:
            question = _ask(radius, SLENDER * length, UNITS)
            return f"{name} a radius of {radius:g} m on a length of {length:g} m{question}"
    return ""


def _unlikely_tendon(path: _Path, i: int) -> str:
    """Place or limits of tendon i that no arm has, in words; empty where there are none."""
    length = path.rod_length
    farthest = path.offset.max()
    greatest_radius = path.radius.max()
    plausible = max(FAR_OFF * length, greatest_radius)
    if farthest > plausible:
        question = _ask(farthest, SLENDER * length, UNITS)
        return (
            f"tendons[{i}] is up to {farthest:g} m off the axis of a rod of {length:g} m{question}"
        )
    area = np.pi * path.radius**2  # of a solid circle
    modulus = path.stretch / area
    strain = path.strain()
    if modulus.min() < SOFT:
        greatest = STRAINED
    else:
        greatest = STIFF_STRAINED
    limits_field = Tendon.model_fields["tension_limits"]
    is_usual = path.tendon.tension_limits == limits_field.default
    if strain > greatest and not is_usual:
        return (
            f"tendons[{i}].tension_limits are up to {path.pull:g} N, which strain the rod by"
            f" {strain:.0%}: is it mN, or a modulus in kPa?"
        )
    return ""
