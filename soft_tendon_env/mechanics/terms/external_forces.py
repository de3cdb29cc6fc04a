"""External and internal loads of the effects: generalised force F (24), and its share of stiffness
and damping in the implicit step.

An effect adds body-frame wrenches at the nodes and stresses at the points, which are projected on
the coordinates once, for all effects together; where it is stiff or damps, also their derivatives,
which the step needs to first order only.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import scale_twist
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, load21, store6, symmetric_product
from soft_tendon_env.mechanics.effects import (
    EXPLICIT,
    IMPLICIT_POSE,
    IMPLICIT_TWIST,
    Base,
    Nodes,
    Points,
    call,
)
from soft_tendon_env.mechanics.terms.command_filter import rest_filter
from soft_tendon_env.mechanics.terms.dynamics import gram_within, node_rows, point_rows, project
from soft_tendon_env.mechanics.terms.transmission import add_lost_stress, find_columns, find_shares

# of a radian, of the length, and of those a second: differences of what effects do at the nodes
NODE_SHARE = 1e-7


@kernel(refcount=True)
def nodes_of(arm, work):
    """View of the nodes that effects get."""
    rod, blocks = arm.rod, (work.node_stiffness, work.node_damping)
    slices = rod.node_mass, rod.inertia, work.pose, work.eta, work.base, work.wrench
    return Nodes(rod.packs, work.clock[0], *slices, *blocks, work.before_step, work.contact)


@kernel(refcount=True)
def points_of(arm, work, i):
    """View of the quadrature points that the i-th effect gets, with its own internal state."""
    rod, first = arm.rod, arm.effects.first_state
    return Points(
        rod.packs,
        work.clock[0],
        work.since[0],
        work.state[first[i] : first[i + 1]],
        work.before,
        work.xi,
        work.xi_dot,
        rod.reference_strain,
        rod.root_stiffness,
        work.stress,
        work.point_stiffness,
        work.point_damping,
    )


@phase
def place_base(arm, work):
    """Pose, twist and acceleration of the base at the time of work.clock: the scene's, as effects
    move it."""
    effects, base = arm.effects, work.base
    copy(arm.base, base[:12])
    for i in range(effects.count):
        if effects.base[i] != 0:
            call(
                effects.base[i],
                effects.parameters[i],
                (Base(work.clock[0], base[:12], base[12:18], base[18:24]),),
            )


@phase
def external_force(arm, work):
    """Generalised force F of all effects into work.load, with the derivatives of wrenches and
    stresses at nodes and points."""
    strain, (wrenches, stresses) = arm.strain, effect_loads(arm, work)
    work.load[:] = 0.0
    if stresses:
        project(
            work.Phi,
            work.stress,
            point_rows(arm.rod),
            strain.pack_begin,
            strain.pack_end,
            work.load,
        )
    if wrenches:
        force = work.extra[0]
        project(work.J, work.wrench, node_rows(), strain.pack_begin, strain.jacobian_end, force)
        for j in range(strain.size):
            work.load[j] += force[j]


@kernel
def effect_loads(arm, work):
    """Wrenches of all effects into work.wrench and stresses times the weights into work.stress,
    with their derivatives; whether there are any of each. Those without any are left as they
    are."""
    effects, rubs = arm.effects, find_shares(arm, work)
    wrenches, stresses = any_of(effects.wrench), any_of(effects.stress) or rubs
    if wrenches:
        work.node_stiffness[:] = 0.0
        work.node_damping[:] = 0.0
        sum_wrenches(arm, work)
    if stresses:
        work.stress[:] = 0.0
        work.point_stiffness[:] = 0.0
        work.point_damping[:] = 0.0
        remember(arm, work)
        if rubs:
            add_lost_stress(arm, work)
        weigh(arm.rod, work)
    return wrenches, stresses


@kernel
def sum_wrenches(arm, work):
    """Wrenches of all effects into work.wrench."""
    work.wrench[:] = 0.0
    for i in range(arm.effects.count):
        if arm.effects.wrench[i] != 0:
            call(arm.effects.wrench[i], arm.effects.parameters[i], (nodes_of(arm, work),))


@kernel
def any_of(addresses):
    """Whether any effect has a kernel, by the addresses of all."""
    for i in range(addresses.size):
        if addresses[i] != 0:
            return True
    return False


@kernel
def weigh(rod, work):
    """Multiplies stresses and their derivatives by the weights of the points; stresses get the sign
    of a load."""
    for block in range(2 * rod.packs):
        at, weight = block * 6 * LANES, load(rod.weight, block * LANES)
        store6(work.stress, at, scale_twist(-weight, load6(work.stress, at)))
        store6(work.point_stiffness, at, scale_twist(weight, load6(work.point_stiffness, at)))
        store6(work.point_damping, at, scale_twist(weight, load6(work.point_damping, at)))


@phase
def add_implicit(arm, work):
    """Add the effects' share of stiffness and damping, J^T K J and Phi^T K Phi to first order, to
    work.G and work.D; after evaluate()."""
    rod, strain = arm.rod, arm.strain
    if any_of(arm.effects.wrench):
        differ_wrenches(arm, work)
        add_node_gram(rod, strain, work.node_stiffness, work, work.G)
        add_node_gram(rod, strain, work.node_damping, work, work.D)
    if any_of(arm.effects.stress):
        add_point_gram(rod, strain, work.point_stiffness, work, work.G)
        add_point_gram(rod, strain, work.point_damping, work, work.D)
    find_columns(arm, work)


@kernel
def differ_wrenches(arm, work):
    """Add -d wrench / d twist and -d wrench / d displacement of the effects that ask for it, by
    differences, to the blocks of the nodes. Overwrites work.wrench."""
    for i in range(arm.effects.count):
        if arm.effects.implicit[i] != EXPLICIT:
            differ_wrench(arm, i, work)


@phase
def differ_wrench(arm, i, work):
    """Differences of the wrench of the i-th effect by the six components of displacement and twist,
    of all nodes at once."""
    wanted = arm.effects.implicit[i]
    copy(work.pose, work.beside_pose)
    copy(work.eta, work.beside_twist)
    wrench_of(arm, i, work)
    copy(work.wrench, work.here_wrench)
    for k in range(6):
        way = NODE_SHARE * (1.0 if k < 3 else total(arm.rod.length))
        if wanted & IMPLICIT_POSE:
            displace(work.pose, k, way)
            wrench_of(arm, i, work)
            for at in range(
                0, work.wrench.size if k < 3 else 0, 3 * LANES
            ):  # back in the frames before: a dead load is not stiff
                turn(work.wrench, at + (k + 1) % 3 * LANES, at + (k + 2) % 3 * LANES, -way)
            add_differences(k, way, work, work.node_stiffness)
            copy(work.beside_pose, work.pose)
        if wanted & IMPLICIT_TWIST:
            for at in range(k * LANES, work.eta.size, 6 * LANES):
                store(work.eta, at, load(work.eta, at) + way)
            wrench_of(arm, i, work)
            add_differences(k, way, work, work.node_damping)
            copy(work.beside_twist, work.eta)


@kernel
def wrench_of(arm, i, work):
    """Wrench of the i-th effect alone into work.wrench."""
    work.wrench[:] = 0.0
    call(arm.effects.wrench[i], arm.effects.parameters[i], (nodes_of(arm, work),))


@kernel
def turn(field, y, z, way):
    """Turn two components of a vector by a small angle."""
    before = load(field, y)
    store(field, y, before + way * load(field, z))
    store(field, z, load(field, z) - way * before)


@kernel
def add_differences(k, way, work, blocks):
    """Add the k-th column of less the differences over a way to the symmetric part of the nodes'
    blocks (nodes x 21)."""
    for pack in range(blocks.size // (21 * LANES)):
        for j in range(6):
            m, row, column = (pack * 6 + j) * LANES, max(j, k), min(j, k)
            at = (pack * 21 + row * (row + 1) // 2 + column) * LANES
            share = (-1.0 if j == k else -0.5) / way
            store(
                blocks,
                at,
                load(blocks, at) + share * (load(work.wrench, m) - load(work.here_wrench, m)),
            )


@kernel
def displace(pose, k, way):
    """Moves poses (nodes x 12) by a small way along the k-th component of a twist in their own
    frames."""
    for at in range(0, pose.size, 12 * LANES):
        for i in range(3):
            row = at + 3 * i * LANES
            if k < 3:
                turn(pose, row + (k + 1) % 3 * LANES, row + (k + 2) % 3 * LANES, way)
            else:
                place = at + (9 + i) * LANES
                store(pose, place, load(pose, place) + way * load(pose, row + (k - 3) * LANES))


@kernel
def filled_packs(field, per_pack):
    """First pack of a field with an entry other than zero, and one past the last such pack; (0, 0)
    where there is none."""
    first, last = 0, 0
    for pack in range(field.size // per_pack):
        squares = spread(0.0)
        for m in range(pack * per_pack, (pack + 1) * per_pack, LANES):
            entry = load(field, m)
            squares = squares + entry * entry
        if lane_sum(squares) != 0.0:
            if last == 0:
                first = pack
            last = pack + 1
    return first, last


@kernel
def add_node_gram(rod, strain, blocks, work, out):
    """Adds J^T K J to out, K symmetric 6x6 blocks (nodes x 21), only over the packs where there are
    any."""
    packs = filled_packs(blocks, 21 * LANES)
    if packs[1] > 0:
        for j in range(strain.size):
            for pack in range(packs[0], packs[1]):
                at = (j * rod.packs + pack) * 6 * LANES
                store6(
                    work.loaded,
                    at,
                    symmetric_product(load21(blocks, pack * 21 * LANES), load6(work.J, at)),
                )
        gram_within(
            work.J,
            work.loaded,
            work.unit,
            node_rows(),
            strain.pack_begin,
            strain.jacobian_end,
            packs,
            work.extra,
        )
        add_matrix(work.extra, out)


@kernel
def add_point_gram(rod, strain, diagonal, work, out):
    """Adds Phi^T K Phi to out, K diagonal (points x 6), over the packs where it is not zero."""
    packs = filled_packs(diagonal, 12 * LANES)
    if packs[1] > 0:
        gram_within(
            work.Phi,
            work.Phi,
            diagonal,
            point_rows(rod),
            strain.pack_begin,
            strain.pack_end,
            packs,
            work.extra,
        )
        add_matrix(work.extra, out)


@kernel
def add_matrix(extra, out):
    """Adds a square matrix to out."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] += extra[i, j]


@phase
def remember(arm, work):
    """Brings the internal states in work.state, which belonged to the strain work.before, up to
    that of work.xi and its rate."""
    for i in range(arm.effects.count):
        if arm.effects.stress[i] != 0:
            call(arm.effects.stress[i], arm.effects.parameters[i], (points_of(arm, work, i),))


@kernel
def rest_states(arm, command, work):
    """The internal states, in work.state, of an arm that has always been at rest in this
    configuration under a command (n_a)."""
    copy(arm.effects.state, work.state)
    if work.before.size > 0:
        work.since[0] = math.inf
        remember(arm, work)
        work.since[0] = 0.0
    rest_filter(arm.effects, command, work.state)
