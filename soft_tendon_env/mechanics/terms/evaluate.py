"""Equation of motion (23) at one state, phase by phase: strains, drive, poses, mass matrix, bias,
external force, stiffness."""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.terms import explicit, statics_based, strain_under_loads  # noqa: F401  (they register themselves)
from soft_tendon_env.mechanics.terms.dynamics import bias_force, driving_force, mass_matrix
from soft_tendon_env.mechanics.terms.external_forces import add_implicit, external_force, place_base
from soft_tendon_env.mechanics.terms.kinematics import poses, sweep, tip_pose_of, write_pose
from soft_tendon_env.mechanics.terms.parametrisation import (
    strain_columns,
    strain_from_guess,
    strain_from_rest,
    strain_matrices,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_matrix
from soft_tendon_env.mechanics.terms.transmission import actuator_tensions


@kernel
def configure(arm, q, tolerance, work):
    """Configuration of the rod at q: poses, and the strain that Newton finds from the stress-free
    rod or else strain_from_rest(): where tendons push, a motion may come to coordinates whose parts
    have no strain. Returns as continue_strain() does."""
    copy(arm.rod.reference_strain, work.xi)
    failed, reached = strain_from_guess(arm, q, tolerance, work), 1.0
    if failed >= 0:
        failed, reached = strain_from_rest(arm, q, tolerance, work)
    place_base(arm, work)
    poses(arm.rod, work)
    return failed, reached


@kernel
def drive_strained_rod(arm, u, q, q_dot, work):
    """Drive of (23) at (q, q_dot, u), poses and Jacobians in `work`, where strain_from_guess() has
    just left the strain at q."""
    strain_columns(arm, actuator_tensions(arm, u, work), q, q_dot, work)
    driving_force(arm.rod, arm.strain, work)
    poses(arm.rod, work)
    sweep(arm.rod, arm.strain, arm.strain.size, work)


@kernel
def evaluate_forces(arm, u, q, q_dot, tolerance, work):
    """M and all forces of (23) at (q, q_dot, u), work.state and work.clock, into `work`; -1, or the
    block without a strain."""
    place_base(arm, work)
    failed = strain_from_guess(arm, q, tolerance, work)
    if failed >= 0:
        return failed
    drive_strained_rod(arm, u, q, q_dot, work)
    bias_force(arm.rod, arm.strain, work)
    if arm.effects.count > 0:
        external_force(arm, work)
    else:
        work.load[:] = 0.0  # which another arm has filled, if it shares the workspace
    mass_matrix(arm.rod, arm.strain, work)
    return -1


@kernel
def evaluate(arm, u, q, q_dot, tolerance, work):
    """All terms of (23): evaluate_forces(), and D and G of the rod."""
    failed = evaluate_forces(arm, u, q, q_dot, tolerance, work)
    if failed < 0:
        strain_matrices(arm, work)
    return failed


@kernel(refcount=True)
def evaluate_at_rest(arm, u, q, tolerance, work):
    """All terms of (23) at (q, 0, u), u the tensions; the base and the states of the effects at
    rest there too; as evaluate_forces()."""
    failed = balance_at_rest(arm, u, q, tolerance, work)
    if failed < 0:
        strain_matrices(arm, work)
        mass_matrix(arm.rod, arm.strain, work)
        work.bias[:] = 0.0
    return failed


@kernel(refcount=True)
def balance_at_rest(arm, u, q, tolerance, work):
    """Drive and load of (23) at (q, 0, u) alone, else as evaluate_at_rest(): all that the balance
    of forces takes."""
    work.u_is_command[0] = 0.0
    place_base(arm, work)
    work.base[12:] = 0.0
    failed = strain_from_guess(arm, q, tolerance, work)
    if failed >= 0:
        return failed
    drive_strained_rod(arm, u, q, np.zeros(q.size), work)
    if arm.effects.count > 0:
        work.since[0] = math.inf
        external_force(arm, work)
        work.since[0] = 0.0
    else:
        work.load[:] = 0.0
    return -1


PLACED, TOO_LARGE, TOO_FAST = 0, 1, 2
"""Outcomes of equation_of_motion(): it has placed the rod, or coordinates are too large for that,
or their rates."""


@kernel
def equation_of_motion(arm, u, q, q_dot, rests, tolerance, work, out):
    """Terms of (23) at (q, q_dot, u) and the time of work.clock, from no guess, into the matrices
    and vectors of `out`, see model.Terms, but the elastic force. The states of the effects are
    those at rest at q where it `rests`, else work.state.

    Returns the block at which the strain could not be found, or -1; the part of q that was reached;
    and whether the rod was PLACED.
    """
    time = work.clock[0]
    failed, reached = configure(arm, q, tolerance, work)
    if failed < 0 and rests:
        work.clock[0] = 0.0
        failed = evaluate_at_rest(arm, u, q, tolerance, work)
        work.clock[0] = time
    if failed < 0:
        failed = evaluate(arm, u, q, q_dot, tolerance, work)
    if failed >= 0:
        return failed, reached, PLACED
    copy_tip(work, out.tip_pose, out.tip_jacobian, out.tip_bias)
    copy_matrix(work.M, out.mass)
    copy_matrix(work.D, out.damping)
    copy_matrix(work.G, out.stiffness)
    copy(work.bias, out.bias)
    copy(work.load, out.external_force)
    actuation_matrix(arm, work, out.actuation)
    if arm.effects.count > 0:
        add_implicit(arm, work)
    kinetic, place = 0.0, 0.0
    for i in range(q.size):
        kinetic += out.bias[i]
        for j in range(q.size):
            out.external_stiffness[i, j] = work.G[i, j] - out.stiffness[i, j]
            out.external_damping[i, j] = work.D[i, j] - out.damping[i, j]
            kinetic += q_dot[i] * out.mass[i, j] * q_dot[j]
    for i in range(3):
        place += abs(out.tip_pose[i, 0]) + abs(out.tip_pose[i, 3])
    return (
        -1,
        1.0,
        TOO_LARGE if not math.isfinite(place) else PLACED if math.isfinite(kinetic) else TOO_FAST,
    )


@kernel
def copy_tip(work, pose, jacobian, bias):
    """Pose of the tip (4, 4), its body Jacobian (6, n) and bias (6,), written to these."""
    R, r = tip_pose_of(work.pose)
    write_pose(R, r, pose)
    for i in range(4):
        pose[3, i] = 1.0 if i == 3 else 0.0
    last = work.eta_bias.size - 6 * LANES + LANES - 1
    for i in range(6):
        bias[i] = work.eta_bias[last + i * LANES]
        for j in range(jacobian.shape[1]):
            jacobian[i, j] = work.J[j * work.eta_bias.size + last + i * LANES]
