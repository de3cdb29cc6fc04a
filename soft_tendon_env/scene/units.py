"""Plausibility of a scene: a word where a number is one that no arm has, most likely because it is in another unit than SI's.

Each number is compared with what materials and arms have, and then with the others: mm, N and MPa are a system of units of their own, in
which ratios come out right. What tells it from metres is length, modulus and density alone, and the weight of the rod beside its modulus.
"""

import math
import warnings
from collections.abc import Iterator, Mapping

import numpy as np

from soft_tendon_env.scene.scene import Scene, Tendon, rod_length, rod_radius, segment_index, tendon_ends, tendon_offset

LENGTHS = {"cm": 1e-2, "mm": 1e-3, "um": 1e-6}
MODULI = {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
DENSITIES = {"g/cm^3": 1e3, "t/mm^3": 1e12}
LENGTH, MODULUS, DENSITY = (1e-3, 20.0), (1e3, 1e12), (10.0, 25e3)
"""Ranges of rods [m], endoscopes to hoses; of Young's moduli [Pa], gels to diamond; of densities [kg/m^3], foams to osmium."""
SLENDER = 0.03
"""A usual radius or offset, as a share of the rod's length."""
FAR_OFF = 0.2
"""Offset of a tendon outside of the rod, as a share of the rod's length, that no arm has; some radii off a thin wire are usual."""
METAL, SOFT = 5e3, 1e7
"""Density [kg/m^3] above which materials are metals, and modulus [Pa] below which none is: gels and rubbers are."""
CRUSHED = 30.0
"""Strain by a rod's own weight that is no arm's, even of gel and in water."""
STRAINED, STIFF_STRAINED = 10.0, 2.0
"""Strains of a section at the tensions' limits that are far beyond what gels and rubbers, or from the modulus SOFT on others, can take."""
LEAST_BENT = 1e-4
"""Angle [rad] by which limits of tensions bend more than nothing: less is said of arms longer than a metre."""
PLACES = 9


class UnitsWarning(UserWarning):
    """A scene has a number that no arm has, most likely in another unit than SI's."""


def warn_of_units(scene: Scene) -> None:
    """Warns, once, of the numbers of a scene that are likely to be in other units."""
    if found := [*_unlikely(scene)] or [*_unlikely_together(scene)]:
        text = f"{scene.name!r} has numbers that look as if they were not in SI units (m, kg, s, N, Pa): {'; '.join(found)}"
        warnings.warn(text, UnitsWarning, stacklevel=4)  # where the user builds it


def _asked(value: float, usual: float, units: Mapping[str, float]) -> str:
    """The question after the unit that brings a value nearest to a usual one; none where it has a usual size already."""
    distance = {unit: abs(math.log10(value * factor / usual)) for unit, factor in {**units, "": 1.0}.items()}
    nearest = min(distance, key=distance.__getitem__)
    return f": is it {nearest}?" if nearest else ""


def _unlikely(scene: Scene) -> Iterator[str]:
    """Lengths, moduli, densities, radii and offsets that no arm has, in words."""
    length = rod_length(scene)
    if not LENGTH[0] <= length <= LENGTH[1]:
        yield f"the rod is {length:g} m long{_asked(length, 0.3, LENGTHS)}"
    for i, segment in enumerate(scene.segments):
        E, density = segment.young_modulus, segment.density
        if not MODULUS[0] <= E <= MODULUS[1]:
            yield f"segments[{i}].young_modulus is {E:g} Pa{_asked(E, 5e10 if density > METAL else 5e5, MODULI)}"
        if not DENSITY[0] <= density <= DENSITY[1]:
            yield f"segments[{i}].density is {density:g} kg/m^3{_asked(density, 1e3, DENSITIES)}"
    places = length * (np.arange(PLACES) + 0.5) / PLACES
    radius = rod_radius(scene, places)[0].max()
    if radius > length:
        yield f"the rod has a radius of {radius:g} m on a length of {length:g} m{_asked(radius, SLENDER * length, LENGTHS)}"
    for i, tendon in enumerate(scene.tendons):
        offset, radii, _ = _along(scene, tendon)
        off = offset.max()
        if off >= FAR_OFF * length and off > radii.max():
            yield f"tendons[{i}] is up to {off:g} m off the axis of a rod of {length:g} m{_asked(off, SLENDER * length, LENGTHS)}"
            break


def _unlikely_together(scene: Scene) -> Iterator[str]:
    """Materials, weights and limits of tensions that do not go together, in words."""
    length = rod_length(scene)
    for i, segment in enumerate(scene.segments):
        E, density = segment.young_modulus, segment.density
        if density > METAL and E < SOFT:
            yield f"segments[{i}].young_modulus is {E:g} Pa, and its density, {density:g} kg/m^3, that of a metal{_asked(E, 5e10, MODULI)}"
            return
        if 9.81 * density * length / E > CRUSHED:
            text = f"a rod {length:g} m long with segments[{i}].young_modulus, {E:g} Pa, is crushed by its own weight"
            yield f"{text}: is it mm, or MPa?"
            return
    bent, usual = [0.0], Tendon.model_fields["tension_limits"].default
    for i, tendon in enumerate(scene.tendons):
        offset, radius, modulus = _along(scene, tendon)
        pull, start_end = max(map(abs, tendon.tension_limits)), tendon_ends(scene, tendon)
        curvature = 4.0 * pull * offset / (np.pi * modulus * radius**4)
        strain = float(np.median(curvature * radius + pull / (np.pi * modulus * radius**2)))
        bent.append(float(curvature.mean()) * (start_end[1] - start_end[0]))
        if tendon.tension_limits != usual and strain > (STRAINED if modulus.min() < SOFT else STIFF_STRAINED):
            text = f"tendons[{i}].tension_limits are up to {pull:g} N, which strain the rod by {100 * strain:.3g} %"
            yield f"{text}: is it mN, or young_modulus in another unit?"
            return
    if 0.0 < max(bent) < LEAST_BENT and length > 1.0:
        yield f"tensions within their limits bend the rod by at most {max(bent):.2g} rad: are lengths in mm?"


def _along(scene: Scene, tendon: Tendon) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset from the axis [m], the rod's radius [m] and Young's modulus [Pa] at PLACES along a tendon."""
    start, end = tendon_ends(scene, tendon)
    places = start + (end - start) * (np.arange(PLACES) + 0.5) / PLACES
    offset = np.linalg.norm(tendon_offset(scene, tendon, places)[0], axis=1)
    modulus = np.array([segment.young_modulus for segment in scene.segments])[segment_index(scene, places)]
    return offset, rod_radius(scene, places)[0], modulus
