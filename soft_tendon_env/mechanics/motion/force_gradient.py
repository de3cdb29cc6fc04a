"""Gradient, by coordinates and rates, of the power that the forces of (23) have on given rates w:
of w . (f(q, q_dot) - M(q) a).

It takes no derivative by single coordinates. With zeta = J w the twists of the nodes along w, and F
= M_s alpha + ad*_eta M_s eta their inertial wrenches, alpha = J a + J_dot q_dot (M_s the screw
inertia), a change delta of q changes twists as

    delta zeta = (D_w J) delta + ad_zeta J delta,    delta eta = J_dot delta + ad_eta J delta,
    delta alpha = d/dt delta eta,

since the body Jacobian J is a derivative of poses and the order of two derivatives may be changed.
So the gradient is made of generalised forces J^T (a frozen wrench) differentiated along w and along
the motion: central differences between five configurations. The elastic force is conservative, so
its stiffness is symmetric: its product with w is a difference along w too. Wrenches of effects may
be any function of pose and twist of a node: their derivatives are differences by the six components
of each, all nodes at once.
"""

import math
from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import (
    ad_apply,
    coad_apply,
    dot,
    scale_twist,
    twist_difference,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    load6,
    load21,
    scale6,
    store6,
    symmetric_product,
)
from soft_tendon_env.mechanics.terms.dynamics import node_rows, project, sum_columns
from soft_tendon_env.mechanics.terms.external_forces import (
    NODE_SHARE,
    differ_wrenches,
    displace,
    effect_loads,
    sum_wrenches,
)
from soft_tendon_env.mechanics.terms.kinematics import poses
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.tendon_friction import tendons_rub
from soft_tendon_env.mechanics.terms.transmission import actuator_tensions
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_wrench_stress, stress_force

TOLERANCE = 1e-9  # of the strain's Newton, so that second differences are smooth
ALONG_MOTION = 0.1  # of the period, the time of the differences along the motion
SMALL_STRAIN = 1e-4  # the largest strain, curvatures times the length, of the differences along w


class GradientMemory(Struct):
    """Fields of one evaluation that are held while others fill the workspace, and the gradient."""

    # given
    w: Annotated[np.ndarray, "n"]
    a: Annotated[np.ndarray, "n"]  # accelerations
    # the gradient
    by_q: Annotated[np.ndarray, "n"]
    by_rate: Annotated[np.ndarray, "n"]  # what is not of the damping matrix in it
    # where a difference is taken
    q: Annotated[np.ndarray, "n"]
    still: Annotated[np.ndarray, "n"]  # zeros
    # generalised forces: on the two sides of a difference, and between them
    sides: Annotated[np.ndarray, "2", "n"]
    turned: Annotated[np.ndarray, "2", "n"]
    middle: Annotated[np.ndarray, "n"]
    # strains and stresses, weights included
    xi: Annotated[np.ndarray, "points x 6"]
    along: Annotated[np.ndarray, "points x 6"]  # Phi w
    rate: Annotated[np.ndarray, "points x 6"]  # xi_dot
    moving: Annotated[np.ndarray, "points x 6"]  # stresses of the rates
    damped: Annotated[np.ndarray, "points x 6"]  # stresses of what damps, along w
    field: Annotated[np.ndarray, "points x 6"]
    # twists and wrenches
    zeta: Annotated[np.ndarray, "nodes x 6"]
    alpha: Annotated[np.ndarray, "nodes x 6"]
    mu: Annotated[np.ndarray, "nodes x 6"]  # M_s zeta
    # see node_wrenches(); before it the drag: less the effects' power by twists
    kappa: Annotated[np.ndarray, "nodes x 6"]
    declared: Annotated[np.ndarray, "nodes x 6"]  # that part of it which is in the damping matrix
    displaced: Annotated[np.ndarray, "nodes x 6"]  # the same by displacements
    inertial: Annotated[np.ndarray, "nodes x 6"]  # wrench of inertia and effects
    wrench: Annotated[np.ndarray, "nodes x 6"]


@kernel
def largest_strain(rod, field):
    """The largest strain of a field over points, curvatures times the rod's length."""
    length = total(rod.length)
    squares = 0.0
    for block in range(2 * rod.packs):
        k, p = load6(field, block)
        bent = length * length * largest(dot(k, k))
        squares = max(squares, bent, largest(dot(p, p)))
    return math.sqrt(squares)


@kernel
def force_gradient(arm, command, motion, period, with_inertia, work, memory):
    """Gradients memory.by_q and by_rate along memory.w, of forces at the motion under a command
    (n_a), where an evaluation with the effects' matrices has just been; zeros where the rod has no
    strain beside it. Overwrites the workspace."""
    memory.by_q[:] = 0.0
    memory.by_rate[:] = 0.0
    hold_fields(arm, with_inertia, work, memory)
    time = ALONG_MOTION * period
    if differ_along_motion(arm, command, motion, time, work, memory):
        differ_along_w(arm, command, motion, work, memory)


@kernel
def hold_fields(arm, with_inertia, work, memory):
    """Fields of w, the accelerations and the rates at the motion, and the generalised forces of the
    wrenches that are known there."""
    rod = arm.rod
    strain = work.strain
    kinematics = work.kinematics
    copy(strain.xi, memory.xi)
    copy(strain.xi_dot, memory.rate)
    sum_columns(strain.Phi, memory.w, memory.along)
    sum_columns(kinematics.J, memory.w, memory.zeta)
    sum_columns(kinematics.J, memory.a, memory.alpha)
    # viscous stresses, of the rates and along w
    for m in range(0, memory.xi.size, LANES):
        viscosity = load(rod.viscosity, m)
        rate = load(strain.xi_dot, m)
        along = load(memory.along, m)
        store(memory.moving, m, -viscosity * rate)
        store(memory.damped, m, viscosity * along)
    memory.inertial[:] = 0.0
    memory.kappa[:] = 0.0
    if arm.effects.count > 0:
        hold_effects(arm, work, memory)
    share = 1.0 if with_inertia else 0.0
    by_q = work.spare.wrench
    by_rate = memory.wrench
    for pack in range(rod.packs):
        node_wrenches(rod, share, pack, kinematics, memory, by_q, by_rate)
    project_wrench(arm, kinematics.J, by_q, memory.by_q)
    project_wrench(arm, kinematics.J, by_rate, memory.by_rate)
    project_wrench(arm, kinematics.J, memory.mu, memory.middle)


@kernel
def project_wrench(arm, J, wrench, out):
    """Generalised force J^T f of body wrenches at the nodes (nodes x 6), out (n)."""
    law = arm.strain
    project(J, wrench, node_rows(), law.pack_begin, law.jacobian_end, out)


@kernel
def hold_effects(arm, work, memory):
    """Wrenches and stresses of the effects, the latter without those at rest, and what damps."""
    inputs = work.inputs
    kinematics = work.kinematics
    loads = work.loads
    # again: the evaluation has gone on to other fields since
    rubs = tendons_rub(arm)
    wrenches, stresses = effect_loads(arm, rubs, work)
    if wrenches:
        copy(loads.wrench, memory.inertial)
        differ_wrenches(arm, inputs, kinematics, loads, work.collision, work.spare)
        for pack in range(arm.rod.packs):
            damping = load21(loads.node_damping, pack)
            drag = symmetric_product(damping, load6(memory.zeta, pack))
            store6(memory.declared, pack, drag)
    if stresses:
        for m in range(0, memory.xi.size, LANES):
            stress = load(loads.stress, m)
            store(memory.moving, m, load(memory.moving, m) + stress)
            damping = load(loads.point_damping, m)
            damped = damping * load(memory.along, m)
            store(memory.damped, m, load(memory.damped, m) + damped)
    if wrenches:
        differ_at_nodes(arm, work, memory)
    if stresses:
        work.strain.xi_dot[:] = 0.0
        effect_loads(arm, rubs, work)
        for m in range(memory.moving.size):
            memory.moving[m] -= loads.stress[m]


@kernel
def differ_at_nodes(arm, work, memory):
    """Transposed derivatives of the effects' wrenches, times zeta: by displacements and by twists
    of every node, all nodes at once."""
    pose = work.kinematics.pose
    eta = work.kinematics.eta
    length = total(arm.rod.length)
    copy(pose, memory.field)
    copy(eta, memory.wrench)
    for k in range(6):
        way = NODE_SHARE * (1.0 if k < 3 else length)
        displace(pose, k, way)
        power_change(arm, k, way, work, memory, memory.displaced)
        copy(memory.field, pose)
        for at in range(k * LANES, eta.size, 6 * LANES):
            store(eta, at, load(eta, at) + way)
        power_change(arm, k, -way, work, memory, memory.kappa)
        copy(memory.wrench, eta)


@kernel
def power_change(arm, k, way, work, memory, out):
    """Change, over a way, of the power that the effects' wrenches have along zeta, into the k-th
    component of out (nodes x 6)."""
    wrench = work.loads.wrench
    sum_wrenches(arm, work.inputs, work.kinematics, work.loads, work.collision)
    share = 1.0 / way
    for at in range(0, out.size, 6 * LANES):
        change = spread(0.0)
        for m in range(at, at + 6 * LANES, LANES):
            before = load(memory.inertial, m)
            difference = load(wrench, m) - before
            change = change + load(memory.zeta, m) * difference
        store(out, at + k * LANES, share * change)


@kernel(inline=True)
def node_wrenches(rod, share, pack, kinematics, memory, by_q, by_rate):
    """Wrenches at a pack of nodes: mu = M_s zeta, the inertial one with the effects', kappa =
    ad_eta^T mu + nu + drag with nu = -ad*_zeta M_s eta - M_s ad_eta zeta, and those of which the
    generalised force belongs to the gradients."""
    inertia = scale_twist(share, load6(rod.inertia, pack))
    eta = load6(kinematics.eta, pack)
    eta_bias = load6(kinematics.eta_bias, pack)
    zeta = load6(memory.zeta, pack)
    alpha = twist_sum(load6(memory.alpha, pack), eta_bias)
    drag = load6(memory.kappa, pack)
    momentum = scale6(inertia, eta)
    mu = scale6(inertia, zeta)
    # what is left of the effects' wrench by F = M_s alpha + ad*_eta M_s eta
    accelerated = scale6(inertia, alpha)
    inertial = twist_sum(accelerated, coad_apply(eta, momentum))
    rest = twist_difference(load6(memory.inertial, pack), inertial)
    # nu, and ad_eta^T mu = -ad*_eta mu
    transported = scale6(inertia, ad_apply(eta, zeta))
    turned_momentum = coad_apply(zeta, momentum)
    nu = scale_twist(-1.0, twist_sum(turned_momentum, transported))
    turning = scale_twist(-1.0, coad_apply(eta, mu))
    held = twist_sum(nu, drag)
    store6(memory.mu, pack, mu)
    store6(memory.inertial, pack, rest)
    store6(memory.kappa, pack, twist_sum(turning, held))
    # by coordinates, and by rates less what the damping matrix has
    moved = twist_sum(coad_apply(alpha, mu), coad_apply(eta, held))
    moved = twist_sum(moved, load6(memory.displaced, pack))
    store6(by_q, pack, twist_difference(moved, coad_apply(zeta, rest)))
    undeclared = twist_difference(drag, load6(memory.declared, pack))
    of_rates = twist_sum(undeclared, twist_sum(turning, nu))
    store6(by_rate, pack, scale_twist(-1.0, of_rates))


@kernel
def place_beside(arm, command, q, rate, way, field, work, memory):
    """Strain, columns and poses a way along rates from coordinates q, from a guess along a field of
    strains; whether there are."""
    strain = work.strain
    kinematics = work.kinematics
    for j in range(q.size):
        memory.q[j] = q[j] + way * rate[j]
    for m in range(0, memory.xi.size, LANES):
        change = way * load(field, m)
        store(strain.xi, m, load(memory.xi, m) + change)
    if strain_from_guess(arm, memory.q, TOLERANCE, strain, kinematics) >= 0:
        return False
    tension = actuator_tensions(arm, command, strain.xi, work.tendons)
    strain_columns(arm, tension, memory.q, memory.still, strain, kinematics)
    poses(arm.rod, kinematics.base, strain.xi, kinematics)
    return True


@kernel
def differ_along_motion(arm, command, motion, time, work, memory):
    """Derivatives along the motion of the generalised forces of frozen wrenches, taken from
    memory.by_q and by_rate; whether it could."""
    rod = arm.rod
    law = arm.strain
    field = memory.field
    strain = work.strain
    mean_rate = memory.q
    for i in range(2):
        way = time if i == 0 else -time
        for j in range(memory.q.size):
            mean_rate[j] = motion.q_dot[j] + 0.5 * way * memory.a[j]
        if not place_beside(arm, command, motion.q, mean_rate, way, memory.rate, work, memory):
            return False
        # J^T mu, and J^T kappa with the stresses of what damps
        field[:] = 0.0
        add_wrench_stress(rod, memory.mu, strain.xi, work.kinematics, field)
        stress_force(rod, law, strain.Phi, field, memory.sides[i])
        copy(memory.damped, field)
        add_wrench_stress(rod, memory.kappa, strain.xi, work.kinematics, field)
        stress_force(rod, law, strain.Phi, field, memory.turned[i])
    # second and first differences
    squared_time = time * time
    turned_after = memory.turned[0]
    turned_before = memory.turned[1]
    for j in range(memory.q.size):
        after = memory.sides[0, j]
        before = memory.sides[1, j]
        second = after - 2.0 * memory.middle[j] + before
        turned = turned_after[j] - turned_before[j]
        memory.by_q[j] -= second / squared_time
        memory.by_q[j] -= turned / (2.0 * time)
        memory.by_rate[j] -= (after - before) / time
    return True


@kernel
def differ_along_w(arm, command, motion, work, memory):
    """Derivative along w of the elastic force at rest and of the force of the frozen wrenches and
    stresses, added to memory.by_q."""
    rod = arm.rod
    strain = work.strain
    field = memory.field
    strained = largest_strain(rod, memory.along)
    if not strained > 0.0:
        return
    small = SMALL_STRAIN / strained
    for i in range(2):
        way = small if i == 0 else -small
        if not place_beside(arm, command, motion.q, memory.w, way, memory.along, work, memory):
            return
        for m in range(0, field.size, LANES):
            mismatch = load(strain.mismatch, m)
            store(field, m, load(memory.moving, m) + mismatch)
        if arm.effects.count > 0:
            _, stresses = effect_loads(arm, tendons_rub(arm), work)
            if stresses:
                for m in range(field.size):
                    field[m] += work.loads.stress[m]
        add_wrench_stress(rod, memory.inertial, strain.xi, work.kinematics, field)
        stress_force(rod, arm.strain, strain.Phi, field, memory.sides[i])
    after = memory.sides[0]
    before = memory.sides[1]
    for j in range(memory.q.size):
        difference = after[j] - before[j]
        memory.by_q[j] += difference / (2.0 * small)
