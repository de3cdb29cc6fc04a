"""Derivative of the forces of (23) by the rates, for all coordinates at once: of C q_dot + D q_dot, where no effects act.

The body Jacobian J is a derivative of poses, and the order of two derivatives may be changed: a coordinate's rate changes twists by its
column J_j, and their derivatives J_dot q_dot by 2 J_dot_j + ad_eta J_j. J_dot is a difference along the motion, of second order.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import ad_apply, coad_apply, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, scaled, store6
from soft_tendon_env.mechanics.motion.residual import add_scaled
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.dynamics import cross_gram, damping_matrix, node_rows
from soft_tendon_env.mechanics.terms.kinematics import poses, sweep
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess


@kernel
def time_within(unit, v):
    """The longest time [s] in which no coordinate moves at its rate by more than its unit; 0 at rest."""
    time = math.inf
    for i in range(v.size):
        if v[i] != 0.0:
            time = min(time, unit[i] / abs(v[i]))
    return time if time < math.inf else 0.0


@kernel
def write_rate_slopes(arm, u, tolerance, own, scratch, difference):
    """Writes the derivatives of r by the rates, where an evaluation has left columns and poses; a status. tolerance: of the strain's
    Newton. Leaves the workspace beside the motion."""
    work, course, slopes, n = scratch.work, difference.course, difference.slopes, arm.strain.size
    copy(work.xi_dot, difference.residual.rate)
    damping_matrix(arm.rod, arm.strain, work)
    work.extra[:] = 0.0
    if course.equation[own[0], 1] != 0.0:
        sweep(arm.rod, arm.strain, n, work)
        copy(work.J, difference.J)
        copy(work.eta, difference.residual.wrench)
        if differ_jacobian(arm, u, tolerance, scratch, difference) != OK:
            return NO_STRAIN
        write_turning_wrenches(arm, difference, work)
        cross_gram(difference.J, work.loaded, node_rows(), arm.strain.first, arm.strain.tip, work.extra)
    for k in own:
        h, weight = course.equation[k, 0], course.equation[k, 2]
        for i in range(n):
            for j in range(n):
                slopes.force[k, i, n + j] = weight * (work.extra[i, j] + work.D[i, j] + h * difference.stiffness[i, j])
    return OK


@kernel
def differ_jacobian(arm, u, tolerance, scratch, difference):
    """Derivative of J along the motion into difference.J_dot; a status."""
    work, q, n = scratch.work, scratch.ahead, arm.strain.size
    v = difference.place[n : 2 * n]
    time = time_within(difference.unit, v)
    difference.J_dot[:] = 0.0
    for side in range(0, 3, 2):
        way = (side - 1) * time
        for i in range(n):
            q[i] = difference.place[i] + way * v[i]
        copy(difference.xi, work.xi)
        add_scaled(way, difference.residual.rate, work.xi)
        if strain_from_guess(arm, q, tolerance, work) >= 0:
            return NO_STRAIN
        strain_columns(arm, u, q, v, work)
        poses(arm.rod, work)
        sweep(arm.rod, arm.strain, n, work)
        if time > 0.0:
            add_scaled(0.5 / way, work.J, difference.J_dot)
    return OK


@kernel
def write_turning_wrenches(arm, difference, work):
    """Writes the derivatives of the inertial wrenches by the rates into work.loaded, coordinate x nodes x 6."""
    rod, strain = arm.rod, arm.strain
    for j in range(strain.size):
        for pack in range(strain.first[j], rod.packs):
            at, node_at = (j * rod.packs + pack) * 6 * LANES, pack * 6 * LANES
            inertia, eta, column = load6(rod.inertia, node_at), load6(difference.residual.wrench, node_at), load6(difference.J, at)
            turn = twist_sum(twist_scaled(2.0, load6(difference.J_dot, at)), ad_apply(eta, column))
            wrench = twist_sum(scaled(inertia, turn), coad_apply(column, scaled(inertia, eta)))
            store6(work.loaded, at, twist_sum(wrench, coad_apply(eta, scaled(inertia, column))))
