"""Equation of motion (23) at one state, phase by phase: strain, columns, kinematics, drive, bias,
load, matrices.

An arm is given tensions, or a command, of which effects between commands and tensions make them:
each has functions of its own.
"""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.terms import (  # noqa: F401  (they register themselves)
    explicit,
    statics_based,
    strain_under_loads,
)
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
    strain = work.strain
    kinematics = work.kinematics
    copy(arm.rod.reference_strain, strain.xi)
    failed = strain_from_guess(arm, q, tolerance, strain, kinematics)
    reached = 1.0
    if failed >= 0:
        failed, reached = strain_from_rest(arm, q, tolerance, strain, kinematics)
    place_base(arm, work.inputs.clock[0], kinematics.base)
    poses(arm.rod, kinematics.base, strain.xi, kinematics)
    return failed, reached


@kernel
def evaluate_forces(arm, tension, q, q_dot, tolerance, work):
    """M and all forces of (23) at (q, q_dot) and work.inputs under tensions (n_a), into `work`; -1,
    or the block without a strain."""
    failed = find_strain(arm, q, tolerance, work)
    if failed < 0:
        add_up_forces(arm, tension, q, q_dot, work)
    return failed


@kernel
def evaluate_forces_of_command(arm, command, q, q_dot, tolerance, work):
    """evaluate_forces() under the tensions that come of a command (n_a), without their friction."""
    failed = find_strain(arm, q, tolerance, work)
    if failed < 0:
        tension = actuator_tensions(arm, command, work.strain.xi, work.tendons)
        add_up_forces(arm, tension, q, q_dot, work)
    return failed


@kernel
def evaluate(arm, tension, q, q_dot, tolerance, work):
    """All terms of (23): evaluate_forces(), and D and G of the rod."""
    failed = evaluate_forces(arm, tension, q, q_dot, tolerance, work)
    if failed < 0:
        rod_matrices(arm, work)
    return failed


@kernel(inline=True)
def find_strain(arm, q, tolerance, work):
    """Base at the time of work.inputs, and strain (30) from the guess in work.strain.xi; -1, or the
    block without one."""
    place_base(arm, work.inputs.clock[0], work.kinematics.base)
    return strain_from_guess(arm, q, tolerance, work.strain, work.kinematics)


@kernel
def add_up_forces(arm, tension, q, q_dot, work):
    """M and all forces of (23), where find_strain() has just left the strain at q."""
    drive_strained_rod(arm, tension, q, q_dot, work)
    bias_force(arm.rod, arm.strain, work.kinematics, work.spare.wrench, work.forces.bias)
    if arm.effects.count > 0:
        external_force(arm, work)
    else:
        work.forces.load[:] = 0.0  # which another arm has filled, if it shares the workspace
    mass_matrix(arm.rod, arm.strain, work.kinematics.J, work.matrices.M)


@kernel
def drive_strained_rod(arm, tension, q, q_dot, work):
    """Drive of (23) at (q, q_dot) under tensions (n_a), with columns, poses and Jacobians, where
    find_strain() has just left the strain at q."""
    rod = arm.rod
    law = arm.strain
    strain = work.strain
    kinematics = work.kinematics
    strain_columns(arm, tension, q, q_dot, strain, kinematics)
    driving_force(rod, law, strain, work.spare.stress, work.forces.drive)
    poses(rod, kinematics.base, strain.xi, kinematics)
    sweep(rod, law, strain, kinematics)


@kernel(inline=True)
def rod_matrices(arm, work):
    """D and G of the rod, of the columns."""
    strain_matrices(arm, work.strain, work.ones.point, work.matrices)


@kernel(refcount=True)
def evaluate_at_rest(arm, tension, q, tolerance, work):
    """All terms of (23) at (q, 0) under tensions (n_a); the base and the states of the effects at
    rest there too; as evaluate_forces()."""
    failed = balance_at_rest(arm, tension, q, tolerance, work)
    if failed < 0:
        rod_matrices(arm, work)
        mass_matrix(arm.rod, arm.strain, work.kinematics.J, work.matrices.M)
        work.forces.bias[:] = 0.0
    return failed


@kernel(refcount=True)
def balance_at_rest(arm, tension, q, tolerance, work):
    """Drive and load of (23) at (q, 0) under tensions (n_a) alone, else as evaluate_at_rest(): all
    that the balance of forces takes."""
    failed = find_strain(arm, q, tolerance, work)
    work.kinematics.base[12:] = 0.0
    if failed >= 0:
        return failed
    drive_strained_rod(arm, tension, q, np.zeros(q.size), work)
    if arm.effects.count > 0:
        work.inputs.since[0] = math.inf
        external_force(arm, work)
        work.inputs.since[0] = 0.0
    else:
        work.forces.load[:] = 0.0
    return -1


PLACED = 0
TOO_LARGE = 1
TOO_FAST = 2
"""Outcomes of equation_of_motion(): it has placed the rod, or coordinates are too large for that,
or their rates."""


@kernel
def equation_of_motion(arm, tension, q, q_dot, rests, tolerance, work, out):
    """Terms of (23) at (q, q_dot) and the time of work.inputs under tensions (n_a), from no guess,
    into the matrices and vectors of `out`, see model.Terms, but the elastic force. The states of
    the effects are those at rest at q where it `rests`, else work.inputs.state.

    Returns the block at which the strain could not be found, or -1; the part of q that was reached;
    and whether the rod was PLACED.
    """
    clock = work.inputs.clock
    time = clock[0]
    failed, reached = configure(arm, q, tolerance, work)
    if failed < 0 and rests:
        clock[0] = 0.0
        failed = evaluate_at_rest(arm, tension, q, tolerance, work)
        clock[0] = time
    if failed < 0:
        failed = evaluate(arm, tension, q, q_dot, tolerance, work)
    if failed >= 0:
        return failed, reached, PLACED
    matrices = work.matrices
    copy_tip(work.kinematics, out.tip_pose, out.tip_jacobian, out.tip_bias)
    copy_matrix(matrices.M, out.mass)
    copy_matrix(matrices.D, out.damping)
    copy_matrix(matrices.G, out.stiffness)
    copy(work.forces.bias, out.bias)
    copy(work.forces.load, out.external_force)
    actuation_matrix(arm, work.strain, work.ones.tendon, work.spare, out.actuation)
    # the effects' share of D and G
    if arm.effects.count > 0:
        add_implicit(arm, work)
    for i in range(q.size):
        for j in range(q.size):
            all_stiffness = matrices.G[i, j]
            all_damping = matrices.D[i, j]
            out.external_stiffness[i, j] = all_stiffness - out.stiffness[i, j]
            out.external_damping[i, j] = all_damping - out.damping[i, j]
    return -1, 1.0, placement(q_dot, out)


@kernel
def placement(q_dot, out):
    """Whether the numbers in `out` at rates q_dot (n) are finite: PLACED, TOO_LARGE or TOO_FAST."""
    place = 0.0
    for i in range(3):
        turned = abs(out.tip_pose[i, 0])
        away = abs(out.tip_pose[i, 3])
        place += turned + away
    if not math.isfinite(place):
        return TOO_LARGE
    kinetic = 0.0
    for i in range(q_dot.size):
        kinetic += out.bias[i]
        for j in range(q_dot.size):
            kinetic += q_dot[i] * out.mass[i, j] * q_dot[j]
    return PLACED if math.isfinite(kinetic) else TOO_FAST


@kernel
def copy_tip(kinematics, pose, jacobian, bias):
    """Pose of the tip (4, 4), its body Jacobian (6, n) and bias (6,), written to these."""
    R, r = tip_pose_of(kinematics.pose)
    write_pose(R, r, pose)
    for i in range(4):
        pose[3, i] = 1.0 if i == 3 else 0.0
    per_column = kinematics.eta_bias.size
    last = per_column - 6 * LANES + LANES - 1  # first component of the last node
    for i in range(6):
        at = last + i * LANES
        bias[i] = kinematics.eta_bias[at]
        for j in range(jacobian.shape[1]):
            jacobian[i, j] = kinematics.J[j * per_column + at]
