"""Plausibility of a scene: a word where a number is one that no arm has, most likely because it is in another unit than SI's.

mm, N and MPa are units of their own, in which ratios come out right: what tells is length, modulus and density, and weight beside modulus.
"""

import math
import warnings
from collections.abc import Iterator, Mapping

import numpy as np

from soft_tendon_env.scene.scene import Scene, Tendon, rod_length, rod_radius, segment_index, tendon_ends, tendon_offset

LENGTHS, DENSITIES = {"cm": 1e-2, "mm": 1e-3, "um": 1e-6}, {"g/cm^3": 1e3, "t/mm^3": 1e12}
MODULI = {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
LENGTH, MODULUS, DENSITY = (1e-3, 20.0), (1e3, 1e12), (10.0, 25e3)
"""Ranges of rods [m], endoscopes to hoses; of Young's moduli [Pa], gels to diamond; of densities [kg/m^3], foams to osmium."""
SLENDER, FAR_OFF = 0.03, 0.2
"""Shares of the rod's length: a usual radius or offset, and an offset outside of the rod that no arm has; radii off a wire are usual."""
METAL, IN_MPA = 5e3, 5e5
"""Density [kg/m^3] of metals, and of rubbers full of them; a number that no metal's modulus in MPa reaches, and such rubbers' in Pa do."""
SOFT, STRAINED, STIFF_STRAINED = 1e7, 10.0, 2.0
"""Modulus [Pa] of rubbers, and strains of a section at the tensions' limits that are far beyond what these, and stiffer ones, can take."""
CRUSHED, LEAST_BENT, PLACES = 30.0, 1.5e-3, 9
"""Strain by its own weight that not even gel in water has; angle [rad] that tensions bend arms of metres; places along tendons."""


class UnitsWarning(UserWarning):
    """A scene has a number that no arm has, most likely in another unit than SI's."""


def warn_of_units(scene: Scene) -> None:
    """Warns, once, of the numbers of a scene that are likely to be in other units."""
    if found := [*_unlikely(scene)] or [*_unlikely_together(scene)][:1]:
        text = f"{scene.name!r} has numbers that look as if they were not in SI units (m, kg, s, N, Pa): {'; '.join(found)}"
        warnings.warn(text, UnitsWarning, stacklevel=4)  # where the user builds it


def _asked(value: float, usual: float, units: Mapping[str, float]) -> str:
    """The question after the unit that brings a value nearest to a usual one; none where it has a usual size already."""
    nearest = min(["", *units], key=lambda unit: abs(math.log10(value * units.get(unit, 1.0) / usual)))
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
    offset, radius = np.array([[values.max() for values in _along(scene, tendon)[:2]] for tendon in scene.tendons]).T
    if (widest := radius.max()) >= length:
        yield f"the rod has a radius of {widest:g} m on a length of {length:g} m{_asked(widest, SLENDER * length, LENGTHS)}"
    for i in np.flatnonzero(offset > np.maximum(FAR_OFF * length, radius))[:1]:
        yield f"tendons[{i}] is up to {offset[i]:g} m off the axis of a rod of {length:g} m{_asked(offset[i], SLENDER * length, LENGTHS)}"


def _unlikely_together(scene: Scene) -> Iterator[str]:
    """Materials, weights and limits of tensions that do not go together, in words."""
    length, bent, usual = rod_length(scene), [0.0], Tendon.model_fields["tension_limits"].default
    for i, segment in enumerate(scene.segments):
        E, density = segment.young_modulus, segment.density
        if density > METAL and E < IN_MPA:
            yield f"segments[{i}].young_modulus is {E:g} Pa, and its density, {density:g} kg/m^3, that of a metal{_asked(E, 5e10, MODULI)}"
        if 9.81 * density * length / E > CRUSHED:
            yield f"a rod {length:g} m long with segments[{i}].young_modulus, {E:g} Pa, is crushed by its own weight: is it mm, or MPa?"
    for i, tendon in enumerate(scene.tendons):
        (offset, radius, modulus), pull = _along(scene, tendon), max(map(abs, tendon.tension_limits))
        curvature = 4.0 * pull * offset / (np.pi * modulus * radius**4)
        strain = float(np.median(curvature * radius + pull / (np.pi * modulus * radius**2)))
        bent.append(float(curvature.mean() * np.ptp(tendon_ends(scene, tendon))))
        if tendon.tension_limits != usual and strain > (STRAINED if modulus.min() < SOFT else STIFF_STRAINED):
            yield f"tendons[{i}].tension_limits are up to {pull:g} N, which strain the rod by {strain:.0%}: is it mN, or a modulus in kPa?"
    if 0.0 < max(bent) < LEAST_BENT and length > 1.0:
        yield f"tensions within their limits bend the rod by at most {max(bent):.2g} rad: are lengths in mm?"


def _along(scene: Scene, tendon: Tendon) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset from the axis [m], the rod's radius [m] and Young's modulus [Pa] at PLACES along a tendon."""
    start, end = tendon_ends(scene, tendon)
    places = start + (end - start) * (np.arange(PLACES) + 0.5) / PLACES
    offset = np.linalg.norm(tendon_offset(scene, tendon, places)[0], axis=1)
    modulus = np.array([segment.young_modulus for segment in scene.segments])[segment_index(scene, places)]
    return offset, rod_radius(scene, places)[0], modulus
