"""The foreign arm in SoRoMoX: strains of few polynomials, whose tendons rub in their sheaths.

From this folder: soft-tendon collect three_tendon --robot foreign_soromox:SoromoxArm ...
"""

import os

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from foreign_arm import ForeignArm
from jax.scipy.linalg import lu_factor, lu_solve
from scipy.spatial.transform import Rotation
from soromox.actuation import ThreadlikeActuator, ThreadlikeImpedance, ThreadlikeRouting
from soromox.systems.components import JointSpec, LinkSpec
from soromox.systems.gvs import GVS, GVSSegment, StrainBasisSpec

GAMMA = 1.0 - 0.5**0.5  # of Verwer's Rosenbrock method ROS2, which is L-stable with it


class SoromoxArm(ForeignArm):
    """A rod of which each strain is a polynomial, with viscous friction in its tendons."""

    ORDER = 2  # of the polynomials
    FRICTION = 0.5  # [N s/m] by which a tendon resists its motion
    step = 0.005  # [s]

    def __init__(self, seed=0, real_time=False):
        super().__init__(seed, real_time)
        self._robot = gvs(self.scene, self.ORDER, self.FRICTION)
        self._state = jnp.zeros(self._robot.state_size)

    def advance(self, tension, steps):
        for _ in range(steps):
            self._state = next_state(self._robot, self._state, jnp.array(tension), self.step)

    def tip_pose(self):
        return np.array(measured(self._robot, self._state)[0])

    def tendon_length(self):
        return np.array(measured(self._robot, self._state)[1])


@eqx.filter_jit
def next_state(robot, state, tension, step):
    """The state `step` [s] later, by a Rosenbrock method of second order that is L-stable.

    It needs one derivative and no iteration, where Diffrax's implicit ones iterate.
    """

    def rates(state):
        return robot.forward_dynamics(0.0, state, (tension,))

    jacobian = jax.jacfwd(rates)
    slope = jacobian(state)
    identity = jnp.eye(state.size)
    factors = lu_factor(identity - GAMMA * step * slope)
    first = lu_solve(factors, rates(state))
    predicted = state + step * first
    right = rates(predicted) - 2.0 * first
    second = lu_solve(factors, right)
    mean_rate = 1.5 * first + 0.5 * second
    return state + step * mean_rate


@eqx.filter_jit
def measured(robot, state):
    """Tip's pose (4, 4) and lengths of the tendons [m]."""
    strains = robot.split_state(state)[0]
    lengths = robot.actuators[0].path_lengths(robot, strains)
    return robot.forward_kinematics_tips(strains)[-1], lengths


def gvs(scene, order, friction):
    """The arm of a scene in SoRoMoX's geometric variable strain."""
    segment = scene.segments[0]
    link = LinkSpec.circular(
        length=segment.length,
        radius=segment.radius,
        density=segment.density,
        reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        young_modulus=segment.young_modulus,
        shear_modulus=segment.young_modulus / (2.0 * (1.0 + segment.poisson_ratio)),
        material_damping_coefficient=segment.damping,
    )
    basis = StrainBasisSpec("legendre", [1] * 6, order)
    offsets = np.array([[0.0, *tendon.routing.offset] for tendon in scene.tendons])
    routing = ThreadlikeRouting.linear(intercept=jnp.array(offsets))
    base = scene.base.pose
    quaternion = Rotation.from_matrix(base[:3, :3]).as_quat()
    return GVS.from_segments(
        [GVSSegment(link, JointSpec("fixed"), basis, 8)],
        gravity=jnp.array(scene.effects.gravity.acceleration),
        base_pose=jnp.array([*quaternion, *base[:3, 3]]),
        actuators=ThreadlikeActuator.tendons(routing),
        passive_elements=ThreadlikeImpedance(
            routing=routing, stiffness=0.0, damping=friction, rest_length=0.0
        ),
    )
