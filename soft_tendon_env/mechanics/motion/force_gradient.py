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
from soft_tendon_env.mechanics.algebra.lie import ad_apply, coad_apply, dot, scale_twist, twist_sum
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
from soft_tendon_env.mechanics.terms.transmission import actuator_tensions
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_wrench_stress, stress_force

TOLERANCE = 1e-9  # of the strain's Newton, so that second differences are smooth
ALONG_MOTION = 0.1  # of the period, the time of the differences along the motion
SMALL_STRAIN = 1e-4  # the largest strain, curvatures times the length, of the differences along w


class GradientMemory(Struct):
    """Fields of one evaluation that are held while others fill the workspace, and the gradient."""

    w: Annotated[np.ndarray, "n"]
    a: Annotated[np.ndarray, "n"]  # accelerations
    q: Annotated[np.ndarray, "n"]  # where a difference is taken
    still: Annotated[np.ndarray, "n"]  # zeros
    sides: Annotated[np.ndarray, "2", "n"]  # generalised forces on the two sides of a difference
    turned: Annotated[np.ndarray, "2", "n"]
    middle: Annotated[np.ndarray, "n"]
    by_q: Annotated[np.ndarray, "n"]  # the gradient
    by_rate: Annotated[np.ndarray, "n"]  # what is not of the damping matrix in it
    xi: Annotated[np.ndarray, "points x 6"]
    along: Annotated[np.ndarray, "points x 6"]  # Phi w
    rate: Annotated[np.ndarray, "points x 6"]  # xi_dot
    moving: Annotated[np.ndarray, "points x 6"]  # stresses of the rates, weights included
    damped: Annotated[np.ndarray, "points x 6"]  # stresses of what damps, along w
    field: Annotated[np.ndarray, "points x 6"]
    zeta: Annotated[np.ndarray, "nodes x 6"]
    alpha: Annotated[np.ndarray, "nodes x 6"]
    mu: Annotated[np.ndarray, "nodes x 6"]  # M_s zeta
    kappa: Annotated[
        np.ndarray, "nodes x 6"
    ]  # see node_wrenches(); before it the drag: less the effects' power by twists
    declared: Annotated[np.ndarray, "nodes x 6"]  # that part of it which is in the damping matrix
    displaced: Annotated[np.ndarray, "nodes x 6"]  # the same by displacements
    inertial: Annotated[np.ndarray, "nodes x 6"]  # wrench of inertia and effects
    wrench: Annotated[np.ndarray, "nodes x 6"]


@kernel
def largest_strain(rod, field):
    """The largest strain of a field over points, curvatures times the rod's length."""
    length, squares = total(rod.length), 0.0
    for block in range(2 * rod.packs):
        k, p = load6(field, block * 6 * LANES)
        squares = max(squares, length * length * largest(dot(k, k)), largest(dot(p, p)))
    return math.sqrt(squares)


@kernel
def force_gradient(arm, u, motion, period, with_inertia, work, memory):
    """Gradients memory.by_q and by_rate along memory.w, of forces at the motion, where an
    evaluation with the effects' matrices has just been; zeros where the rod has no strain beside
    it. Overwrites the workspace."""
    memory.by_q[:] = 0.0
    memory.by_rate[:] = 0.0
    hold_fields(arm, with_inertia, work, memory)
    if not differ_along_motion(arm, u, motion, ALONG_MOTION * period, work, memory):
        return
    differ_along_w(arm, u, motion, work, memory)


@kernel
def hold_fields(arm, with_inertia, work, memory):
    """Fields of w, the accelerations and the rates at the motion, and the generalised forces of the
    wrenches that are known there."""
    rod = arm.rod
    copy(work.xi, memory.xi)
    copy(work.xi_dot, memory.rate)
    sum_columns(work.Phi, memory.w, memory.along)
    sum_columns(work.J, memory.w, memory.zeta)
    sum_columns(work.J, memory.a, memory.alpha)
    for m in range(0, memory.xi.size, LANES):
        store(memory.moving, m, -load(rod.viscosity, m) * load(work.xi_dot, m))
        store(memory.damped, m, load(rod.viscosity, m) * load(memory.along, m))
    memory.inertial[:] = 0.0
    memory.kappa[:] = 0.0
    if arm.effects.count > 0:
        hold_effects(arm, work, memory)
    share = 1.0 if with_inertia else 0.0
    by_q, by_rate = work.wrench, memory.wrench
    for pack in range(rod.packs):
        node_wrenches(rod, share, pack, work, memory, by_q, by_rate)
    project(work.J, by_q, node_rows(), arm.strain.pack_begin, arm.strain.jacobian_end, memory.by_q)
    project(
        work.J, by_rate, node_rows(), arm.strain.pack_begin, arm.strain.jacobian_end, memory.by_rate
    )
    project(
        work.J,
        memory.mu,
        node_rows(),
        arm.strain.pack_begin,
        arm.strain.jacobian_end,
        memory.middle,
    )


@kernel
def hold_effects(arm, work, memory):
    """Wrenches and stresses of the effects, the latter without those at rest, and what damps."""
    wrenches, stresses = effect_loads(
        arm, work
    )  # again: the evaluation has gone on to other fields since
    if wrenches:
        copy(work.wrench, memory.inertial)
        differ_wrenches(arm, work)
        for pack in range(arm.rod.packs):
            at = pack * 6 * LANES
            damping = load21(work.node_damping, pack * 21 * LANES)
            store6(memory.declared, at, symmetric_product(damping, load6(memory.zeta, at)))
    if stresses:
        for m in range(0, memory.xi.size, LANES):
            store(memory.moving, m, load(memory.moving, m) + load(work.stress, m))
            store(
                memory.damped,
                m,
                load(memory.damped, m) + load(work.point_damping, m) * load(memory.along, m),
            )
    if wrenches:
        differ_at_nodes(arm, work, memory)
    if stresses:
        work.xi_dot[:] = 0.0
        effect_loads(arm, work)
        for m in range(memory.moving.size):
            memory.moving[m] -= work.stress[m]


@kernel
def differ_at_nodes(arm, work, memory):
    """Transposed derivatives of the effects' wrenches, times zeta: by displacements and by twists
    of every node, all nodes at once."""
    copy(work.pose, memory.field)
    copy(work.eta, memory.wrench)
    for k in range(6):
        way = NODE_SHARE * (1.0 if k < 3 else total(arm.rod.length))
        displace(work.pose, k, way)
        power_change(arm, k, way, work, memory, memory.displaced)
        copy(memory.field, work.pose)
        for at in range(k * LANES, work.eta.size, 6 * LANES):
            store(work.eta, at, load(work.eta, at) + way)
        power_change(arm, k, -way, work, memory, memory.kappa)
        copy(memory.wrench, work.eta)


@kernel
def power_change(arm, k, way, work, memory, out):
    """Change, over a way, of the power that the effects' wrenches have along zeta, into the k-th
    component of out (nodes x 6)."""
    sum_wrenches(arm, work)
    for at in range(0, out.size, 6 * LANES):
        change = spread(0.0)
        for m in range(at, at + 6 * LANES, LANES):
            change = change + load(memory.zeta, m) * (
                load(work.wrench, m) - load(memory.inertial, m)
            )
        store(out, at + k * LANES, (1.0 / way) * change)


@kernel(inline=True)
def node_wrenches(rod, share, pack, work, memory, by_q, by_rate):
    """Wrenches at a pack of nodes: mu = M_s zeta, the inertial one with the effects', kappa =
    ad_eta^T mu + nu + drag with nu = -ad*_zeta M_s eta - M_s ad_eta zeta, and those of which the
    generalised force belongs to the gradients."""
    at = pack * 6 * LANES
    inertia, eta, zeta = load6(rod.inertia, at), load6(work.eta, at), load6(memory.zeta, at)
    alpha = twist_sum(load6(memory.alpha, at), load6(work.eta_bias, at))
    inertia = scale_twist(share, inertia)
    momentum, mu, drag = scale6(inertia, eta), scale6(inertia, zeta), load6(memory.kappa, at)
    inertial = twist_sum(scale6(inertia, alpha), coad_apply(eta, momentum))
    rest = twist_sum(load6(memory.inertial, at), scale_twist(-1.0, inertial))
    nu = scale_twist(
        -1.0, twist_sum(coad_apply(zeta, momentum), scale6(inertia, ad_apply(eta, zeta)))
    )
    turning = scale_twist(-1.0, coad_apply(eta, mu))
    store6(memory.mu, at, mu)
    store6(memory.inertial, at, rest)
    store6(memory.kappa, at, twist_sum(turning, twist_sum(nu, drag)))
    once = twist_sum(coad_apply(alpha, mu), coad_apply(eta, twist_sum(nu, drag)))
    once = twist_sum(once, load6(memory.displaced, at))
    store6(by_q, at, twist_sum(once, scale_twist(-1.0, coad_apply(zeta, rest))))
    beside = twist_sum(drag, scale_twist(-1.0, load6(memory.declared, at)))
    store6(by_rate, at, scale_twist(-1.0, twist_sum(beside, twist_sum(turning, nu))))


@kernel
def place_beside(arm, u, q, rate, way, field, work, memory):
    """Strain, columns and poses a way along rates from coordinates q, from a guess along a field of
    strains; whether there are."""
    for j in range(q.size):
        memory.q[j] = q[j] + way * rate[j]
    for m in range(0, memory.xi.size, LANES):
        store(work.xi, m, load(memory.xi, m) + way * load(field, m))
    if strain_from_guess(arm, memory.q, TOLERANCE, work) >= 0:
        return False
    strain_columns(arm, actuator_tensions(arm, u, work), memory.q, memory.still, work)
    poses(arm.rod, work)
    return True


@kernel
def differ_along_motion(arm, u, motion, time, work, memory):
    """Derivatives along the motion of the generalised forces of frozen wrenches, taken from
    memory.by_q and by_rate; whether it could."""
    for i in range(2):
        way = time if i == 0 else -time
        for j in range(memory.q.size):
            memory.q[j] = motion.q_dot[j] + 0.5 * way * memory.a[j]
        if not place_beside(arm, u, motion.q, memory.q, way, memory.rate, work, memory):
            return False
        memory.field[:] = 0.0
        add_wrench_stress(arm.rod, memory.mu, work, memory.field)
        stress_force(arm.rod, arm.strain, work, memory.field, memory.sides[i])
        copy(memory.damped, memory.field)
        add_wrench_stress(arm.rod, memory.kappa, work, memory.field)
        stress_force(arm.rod, arm.strain, work, memory.field, memory.turned[i])
    for j in range(memory.q.size):
        after, before = memory.sides[0, j], memory.sides[1, j]
        memory.by_q[j] -= (after - 2.0 * memory.middle[j] + before) / (time * time)
        memory.by_q[j] -= (memory.turned[0, j] - memory.turned[1, j]) / (2.0 * time)
        memory.by_rate[j] -= (after - before) / time
    return True


@kernel
def differ_along_w(arm, u, motion, work, memory):
    """Derivative along w of the elastic force at rest and of the force of the frozen wrenches and
    stresses, added to memory.by_q."""
    strained = largest_strain(arm.rod, memory.along)
    if not strained > 0.0:
        return
    small = SMALL_STRAIN / strained
    for i in range(2):
        way = small if i == 0 else -small
        if not place_beside(arm, u, motion.q, memory.w, way, memory.along, work, memory):
            return
        for m in range(0, memory.field.size, LANES):
            store(memory.field, m, load(memory.moving, m) + load(work.mismatch, m))
        if arm.effects.count > 0 and effect_loads(arm, work)[1]:
            for m in range(memory.field.size):
                memory.field[m] += work.stress[m]
        add_wrench_stress(arm.rod, memory.inertial, work, memory.field)
        stress_force(arm.rod, arm.strain, work, memory.field, memory.sides[i])
    for j in range(memory.q.size):
        memory.by_q[j] += (memory.sides[0, j] - memory.sides[1, j]) / (2.0 * small)
