"""The foreign arm in PyElastica: a Cosserat rod of elements, whose tendons are strings through
guides, and whose damping acts on velocities.

Such damping leaves a vibration of the rod's length at 18 Hz, which a silicone arm has not: friction
of the tendons damps it.

From this folder: soft-tendon collect three_tendon --robot foreign_elastica:ElasticaArm ...
"""

import elastica
import numpy as np
from foreign_arm import DRAWING, ForeignArm
from numba import njit
from scipy.spatial.transform import Rotation

import soft_tendon_env as ste
from soft_tendon_env.scene.scene import rod_length

DAMPING = 20.0  # [1/s] of velocities, times the share of the drawing's viscosity that is drawn


class Arm(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
    """PyElastica's collection with the features that the arm uses."""


class ElasticaArm(ForeignArm):
    """A rod of elements, whose section keeps its volume, with damping of velocities."""

    ELEMENTS = 30
    FRICTION = 1.0  # [N s/m] by which a tendon resists its motion
    step = 1e-4  # [s]: at most a third of what is stable at rest under any tension

    def __init__(self, seed=0, real_time=False):
        super().__init__(seed, real_time)
        scene = self.scene
        material = scene.segments[0]
        viscosity = material.damping / ste.load_scene(DRAWING).segments[0].damping
        # the clamp holds the first element's frame: its centre is the base
        length = rod_length(scene) / (self.ELEMENTS - 0.5)
        base = scene.base.pose
        along, across = base[:3, 0], base[:3, 1]
        self._rod = elastica.CosseratRod.straight_rod(
            self.ELEMENTS,
            start=base[:3, 3] - 0.5 * length * along,
            direction=along,
            normal=across.copy(),
            base_length=length * self.ELEMENTS,
            base_radius=material.radius,
            density=material.density,
            youngs_modulus=material.young_modulus,
            shear_modulus=material.young_modulus / (2.0 * (1.0 + material.poisson_ratio)),
        )
        self._strings = Strings(scene)
        self._arm = Arm()
        self._arm.append(self._rod)
        self._arm.constrain(self._rod).using(
            elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        gravity = np.array(scene.effects.gravity.acceleration)
        self._arm.add_forcing_to(self._rod).using(elastica.GravityForces, acc_gravity=gravity)
        self._arm.add_forcing_to(self._rod).using(
            Pull, strings=self._strings, friction=self.FRICTION, step=self.step
        )
        self._arm.dampen(self._rod).using(
            elastica.AnalyticalLinearDamper,
            uniform_damping_constant=DAMPING * viscosity,
            time_step=self.step,
        )
        self._arm.finalize()
        self._stepper = elastica.PositionVerlet()
        self._elastica_time = 0.0

    def advance(self, tension, steps):
        self._strings.tension[:] = tension
        for _ in range(steps):
            self._elastica_time = self._stepper.step(self._arm, self._elastica_time, self.step)

    def tip_pose(self):
        # rows y, z, x of the section; the last frames are those of elements' centres
        before, last = (
            Rotation.from_matrix(self._rod.director_collection[[2, 0, 1], :, k].T) for k in (-2, -1)
        )
        half = Rotation.from_rotvec(0.5 * (before.inv() * last).as_rotvec())
        pose = np.eye(4)
        pose[:3, :3] = (last * half).as_matrix()
        pose[:3, 3] = self._rod.position_collection[:, -1]
        return pose

    def tendon_length(self):
        return lengths(self._strings.paths(self._rod))


class Strings:
    """Tendons from the base through a guide at the centre of every element to the tip's face."""

    def __init__(self, scene):
        self._offsets = np.array([tendon.routing.offset for tendon in scene.tendons])
        base = scene.base.pose
        self._anchors = base[:3, 3] + self._offsets @ base[:3, 1:3].T
        self.tension = np.zeros(len(scene.tendons))

    def paths(self, rod):
        """Anchor, guides and end of every tendon, (n_a, elements + 1, 3) [m]."""
        return paths(self._anchors, self._offsets, rod.position_collection, rod.director_collection)


class Pull(elastica.NoForces):
    """The forcing by which strings pull at the guides, and resist their motion."""

    def __init__(self, strings, friction, step):
        super().__init__()
        self._strings = strings
        self._per_step = friction / step
        self._length = None  # a step ago

    def apply_forces(self, system, time=0.0):
        points = self._strings.paths(system)
        length = lengths(points)
        if self._length is None:
            self._length = length
        tension = self._strings.tension + self._per_step * (length - self._length)
        self._length = length
        pull(
            np.maximum(tension, 0.0),  # a string does not push
            points,
            system.position_collection,
            system.director_collection,
            system.external_forces,
            system.external_torques,
        )


@njit
def paths(anchors, offsets, position, directors):
    elements = directors.shape[2]
    points = np.empty((len(offsets), elements + 1, 3))
    points[:, 0] = anchors
    for a in range(len(offsets)):
        y, z = offsets[a]
        for k in range(1, elements + 1):
            e = min(k, elements - 1)
            for j in range(3):
                centre = 0.5 * (position[j, e] + position[j, e + 1])
                if k == elements:
                    centre = position[j, elements]
                points[a, k, j] = centre + y * directors[0, j, e] + z * directors[1, j, e]
    return points


@njit
def lengths(points):
    length = np.zeros(len(points))
    for a in range(len(points)):
        for k in range(1, points.shape[1]):
            length[a] += np.linalg.norm(points[a, k] - points[a, k - 1])
    return length


@njit
def pull(tension, points, position, directors, forces, torques):
    """Add what strings do to their guides: forces (3, nodes) in the world, torques (3, elements) in
    the frames of elements."""
    elements = directors.shape[2]
    for a in range(len(tension)):
        for k in range(1, elements + 1):
            guide = points[a, k]
            force = direction(guide, points[a, k - 1])
            if k < elements:
                force += direction(guide, points[a, k + 1])
            force *= tension[a]
            # a guide's force halves among the nodes of its element; the end's is the last node's
            element = min(k, elements - 1)
            second = element + 1
            first = element
            if k == elements:
                first = second
            half = 0.5 * force
            forces[:, first] += half
            forces[:, second] += half
            centre = 0.5 * (position[:, first] + position[:, second])
            lever = guide - centre
            moment = np.cross(lever, force)
            for i in range(3):
                for j in range(3):
                    torques[i, element] += directors[i, j, element] * moment[j]


@njit
def direction(begin, end):
    """Unit vector from a point to another."""
    way = end - begin
    return way / np.linalg.norm(way)
