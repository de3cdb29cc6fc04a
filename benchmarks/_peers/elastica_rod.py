"""The arm in PyElastica: a tapered Cosserat rod of equal elements, with a forcing class for what
PyElastica has not.

PyElastica's own are inertia, kinematics, elasticity, the clamp (`OneEndFixedBC`) and the stepper
(`PositionVerlet`). The forcing adds

- the tendons: tension along the tangent of each, as force of the elements and as moment of the
nodes between them (`tendon_stress`);
- Kelvin-Voigt damping in proportion to the strain rates; PyElastica's dampers act on velocities;
- the difference between two laws of the section: PyElastica's is incompressible, its stiffness in
  bending grows with the cube of the compression; that of the other simulators here keeps the
  section of the rod at rest.

The first element is centred on the base, so that its clamped directors are those of the base, twice
as stiff since half of it is the rod's: second order in the length of the elements. The stepper is
explicit; damping of shear against the small rotational inertia of the section bounds its step to
about a microsecond, whatever the number of elements. That is why a part of the motion has to do.
"""

import warnings
from dataclasses import dataclass

import elastica
import numpy as np
from numba import njit

from soft_tendon_env.model.grid import screw_matrices
from soft_tendon_env.scene.scene import Scene, rod_length, rod_radius, tendon_ends, tendon_offset

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "PyElastica"
DISTRIBUTION = "pyelastica"
SECONDS = 0.2
BENDING = [1, 2, 0]
SHEAR = [4, 5, 3]
"""This package's strains in the order of PyElastica's directors, y, z, x of the section: bending
and torsion; shear and stretch."""


@dataclass(frozen=True)
class Setting:
    """Number of elements, time step [s]."""

    elements: int
    step: float

    @property
    def label(self) -> str:
        return f"{self.elements} elements, " + (
            f"{1e3 * self.step:g} ms" if self.step >= 1e-3 else f"{1e6 * self.step:g} us"
        )


QUICK = (Setting(6, 1e-6),)
HARD = (Setting(20, 0.01), Setting(20, 1e-6))


def settings() -> list[Setting]:
    return [Setting(10, 1.25e-6), Setting(20, 1e-6), Setting(40, 5e-7)]


class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing):
    """PyElastica's collection with the features that are used."""


class Rod:
    """The rod, its simulator and what the forcing reads."""

    def __init__(self, scene: Scene, elements: int) -> None:
        self.length = rod_length(scene) / (
            elements - 0.5
        )  # of an element; the first is centred on the base
        centres = self.length * np.arange(elements)
        between = centres[:-1] + 0.5 * self.length
        material = scene.segments[0]
        if len(scene.segments) > 1 or any(material.curvature):
            raise ValueError("PyElastica's straight rod is of one material and straight at rest")
        elastic, viscous, _ = screw_matrices(scene, centres)
        self.rod = elastica.CosseratRod.straight_rod(
            elements,
            np.array([-0.5 * self.length, 0.0, 0.0]),
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            self.length * elements,
            rod_radius(scene, centres)[0],
            material.density,
            youngs_modulus=material.young_modulus,
            shear_modulus=material.young_modulus / (2.0 * (1.0 + material.poisson_ratio)),
        )
        elastic[0], viscous[0] = (
            2.0 * elastic[0],
            2.0 * viscous[0],
        )  # half of the first element is the rod's
        self.shear = elastic[:, SHEAR].T.copy()
        self.shear_damping = viscous[:, SHEAR].T.copy()
        elastic, viscous, _ = screw_matrices(scene, between)
        self.bend = elastic[:, BENDING].T.copy()
        self.bend_damping = viscous[:, BENDING].T.copy()
        for axis in range(3):  # without PyElastica's shear correction, with the taper at its place
            self.rod.shear_matrix[axis, axis] = self.shear[axis]
            self.rod.bend_matrix[axis, axis] = self.bend[axis]
        self.at_elements = routes(scene, centres, self.length)
        self.at_nodes = routes(scene, between, self.length)
        self.tension = np.zeros(len(scene.tendons))

    def simulator(self) -> Simulator:
        collection = Simulator()
        collection.append(self.rod)
        collection.constrain(self.rod).using(
            elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        collection.add_forcing_to(self.rod).using(TendonsAndDamping, rod=self)
        collection.finalize()
        return collection


def routes(scene: Scene, arc_length: Array, width: float) -> Array:
    """Offset (y, z), slope and presence of every tendon at arc lengths [m]: (n_a, places, 5).

    Presence is the share of `width` [m] around the place, as far as it is on the rod, that the
    tendon covers.
    """
    first = np.maximum(arc_length - 0.5 * width, 0.0)
    last = np.minimum(arc_length + 0.5 * width, rod_length(scene))
    found = np.empty((len(scene.tendons), len(arc_length), 5))
    for values, tendon in zip(found, scene.tendons, strict=True):
        start, end = tendon_ends(scene, tendon)
        values[:, :2], values[:, 2:4] = tendon_offset(scene, tendon, arc_length)
        values[:, 4] = np.clip(
            (np.minimum(last, end) - np.maximum(first, start)) / (last - first), 0.0, 1.0
        )
    return found


class TendonsAndDamping(elastica.NoForces):
    """Forcing by the stress that PyElastica's rod has not: tendons, Kelvin-Voigt damping, the
    section's law."""

    def __init__(self, rod: Rod) -> None:
        super().__init__()
        self.own = rod

    def apply_forces(self, system: elastica.CosseratRod, time: float = 0.0) -> None:
        own = self.own
        add_stress(
            (own.tension, own.at_elements, own.at_nodes, own.length),
            (own.shear, own.shear_damping, own.bend, own.bend_damping),
            (system.sigma, system.kappa, system.dilatation, system.voronoi_dilatation),
            (system.director_collection, system.velocity_collection, system.omega_collection),
            (system.external_forces, system.external_torques),
        )


@njit
def add_stress(tendons, section, strains, motion, out):  # type: ignore[no-untyped-def]
    """Adds forces (3, nodes) in the world frame and torques (3, elements) in that of the elements
    to `out`."""
    tension, at_elements, at_nodes, length = tendons
    shear, shear_damping, bend, bend_damping = section
    sigma, kappa, dilatation, node_dilatation = strains
    directors, velocity, omega = motion
    forces, torques = out
    elements = sigma.shape[1]
    n = np.empty(3)
    m = np.empty(3)
    for i in range(elements):
        # the backbone's slope, in the element's frame
        x = sigma[0, i]
        y = sigma[1, i]
        z = sigma[2, i] + 1.0
        turn = cross((x, y, z), (omega[0, i], omega[1, i], omega[2, i]))
        # curvature at an element: the mean of those at its ends
        left = max(i - 1, 0)
        right = min(i, elements - 2)
        k0 = 0.5 * (kappa[0, left] + kappa[0, right])
        k1 = 0.5 * (kappa[1, left] + kappa[1, right])
        k2 = 0.5 * (kappa[2, left] + kappa[2, right])
        stretched = 1.0 - 1.0 / dilatation[i]
        for axis in range(3):
            rate = turn[axis]
            for j in range(3):
                change = velocity[j, i + 1] - velocity[j, i]
                rate += directors[axis, j, i] * change / length
            elastic = shear[axis, i] * sigma[axis, i] * stretched
            n[axis] = shear_damping[axis, i] * rate + elastic
        for tendon in range(tension.size):
            t, pull, _ = tangent((x, y, z), (k0, k1, k2), at_elements[tendon, i], tension[tendon])
            for axis in range(3):
                n[axis] += pull * t[axis]
        for j in range(3):
            force = 0.0
            for axis in range(3):
                force += directors[axis, j, i] * n[axis]
            forces[j, i] += force
            forces[j, i + 1] -= force
        moment = cross((x, y, z), (n[0], n[1], n[2]))
        for axis in range(3):
            torques[axis, i] += length * moment[axis]
    for i in range(elements - 1):
        # means of the elements on either side
        x = 0.5 * (sigma[0, i] + sigma[0, i + 1])
        y = 0.5 * (sigma[1, i] + sigma[1, i + 1])
        z = 1.0 + 0.5 * (sigma[2, i] + sigma[2, i + 1])
        k = (kappa[0, i], kappa[1, i], kappa[2, i])
        w0 = 0.5 * (omega[0, i] + omega[0, i + 1])
        w1 = 0.5 * (omega[1, i] + omega[1, i + 1])
        w2 = 0.5 * (omega[2, i] + omega[2, i + 1])
        turn = cross(k, (w0, w1, w2))
        stretched = 1.0 - 1.0 / node_dilatation[i] ** 3
        for axis in range(3):
            rate = (omega[axis, i + 1] - omega[axis, i]) / length + turn[axis]
            elastic = bend[axis, i] * kappa[axis, i] * stretched
            m[axis] = bend_damping[axis, i] * rate + elastic
        for tendon in range(tension.size):
            t, pull, offset = tangent((x, y, z), k, at_nodes[tendon, i], tension[tendon])
            dy, dz = offset
            m[0] += pull * dz * t[2]
            m[1] -= pull * dy * t[2]
            m[2] += pull * (dy * t[1] - dz * t[0])
        across = cross(k, (m[0], m[1], m[2]))
        for axis in range(3):
            half = 0.5 * length * across[axis]
            torques[axis, i] += m[axis] + half
            torques[axis, i + 1] += -m[axis] + half


@njit
def tangent(slope, k, route, tension):  # type: ignore[no-untyped-def]
    """Tangent of a tendon, its tension over the tangent's length, and its offset (y, z)."""
    x, y, z = slope
    k0, k1, k2 = k
    dy, dz, slope_y, slope_z, present = route
    t0 = slope_y + x - k2 * dz
    t1 = slope_z + y + k2 * dy
    t2 = z + k0 * dz - k1 * dy
    length = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    return (t0, t1, t2), present * tension / length, (dy, dz)


@njit
def cross(a, b):  # type: ignore[no-untyped-def]
    """Cross product of two vectors."""
    first = a[1] * b[2] - a[2] * b[1]
    second = a[2] * b[0] - a[0] * b[2]
    third = a[0] * b[1] - a[1] * b[0]
    return first, second, third


def prepare(scene: Scene, setting: Setting) -> Run:
    advance(Rod(scene, setting.elements), np.zeros((1, len(scene.tendons))), 1e-9, 1e-9)  # compiles
    return lambda tensions: simulate(Rod(scene, setting.elements), setting.step, tensions)


def advance(rod: Rod, tensions: Array, step: float, hold: float) -> Array:
    """Tips at the end of each row of tensions, held for `hold` [s]; those after the first that is
    not finite are left out."""
    collection = rod.simulator()
    stepper = elastica.PositionVerlet()
    time = 0.0
    count = max(1, round(hold / step))
    tips = []
    for tension in tensions:
        rod.tension[:] = tension
        for _ in range(count):
            time = stepper.step(collection, time, step)
        tips.append(rod.rod.position_collection[:, -1].copy())
        if not np.isfinite(tips[-1]).all():
            break
    return np.array(tips)


def simulate(rod: Rod, step: float, tensions: Array) -> Motion:
    tip = np.full((len(tensions) + 1, 3), np.nan)
    tip[0] = rod.rod.position_collection[:, -1]
    found: list[Array] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cpu = cpu_time(lambda: found.append(advance(rod, tensions, step, HOLD)))
    tip[1 : len(found[0]) + 1] = found[0]
    return Motion(
        tip,
        cpu / (HOLD * len(found[0])),
        "; ".join(dict.fromkeys(str(warning.message) for warning in caught)),
    )
