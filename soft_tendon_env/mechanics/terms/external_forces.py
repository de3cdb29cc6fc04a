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
from soft_tendon_env.mechanics.terms.tendon_friction import add_lost_stress, find_shares

# of a radian, of the length, and of those a second: differences of what effects do at the nodes
NODE_SHARE = 1e-7


@kernel(refcount=True)
def nodes_of(arm, inputs, kinematics, loads, collision):
    """View of the nodes that effects get."""
    rod = arm.rod
    return Nodes(
        rod.packs,
        inputs.clock[0],
        rod.node_mass,
        rod.inertia,
        kinematics.pose,
        kinematics.eta,
        kinematics.base,
        loads.wrench,
        loads.node_stiffness,
        loads.node_damping,
        collision.before_step,
        collision.flags,
    )


@kernel(refcount=True)
def points_of(arm, i, inputs, strain, loads):
    """View of the quadrature points that the i-th effect gets, with its own internal state."""
    rod = arm.rod
    first = arm.effects.first_state
    return Points(
        rod.packs,
        inputs.clock[0],
        inputs.since[0],
        inputs.state[first[i] : first[i + 1]],
        inputs.before,
        strain.xi,
        strain.xi_dot,
        rod.reference_strain,
        rod.root_stiffness,
        loads.stress,
        loads.point_stiffness,
        loads.point_damping,
    )


@phase
def place_base(arm, time, base):
    """Pose, twist and acceleration of the base at a time [s], into base (24): the scene's, as
    effects move it."""
    effects = arm.effects
    own_pose = base[:12]
    copy(arm.base, own_pose)
    view = Base(time, own_pose, base[12:18], base[18:24])
    for i in range(effects.count):
        address = effects.base[i]
        if address != 0:
            call(address, effects.parameters[i], (view,))


@phase
def external_force(arm, work):
    """Generalised force F of all effects into work.forces.load, with the derivatives of wrenches
    and stresses at nodes and points; without the friction of tendons, which is that of a step's
    end."""
    law = arm.strain
    force = work.forces.load
    wrenches, stresses = effect_loads(arm, False, work)
    force[:] = 0.0
    if stresses:
        rows = point_rows(arm.rod)
        project(work.strain.Phi, work.loads.stress, rows, law.pack_begin, law.pack_end, force)
    if wrenches:
        of_wrenches = work.spare.matrix[0]
        project(
            work.kinematics.J,
            work.loads.wrench,
            node_rows(),
            law.pack_begin,
            law.jacobian_end,
            of_wrenches,
        )
        for j in range(law.size):
            force[j] += of_wrenches[j]


@kernel
def effect_loads(arm, rubs, work):
    """Wrenches of all effects and stresses times the weights into work.loads, with their
    derivatives; whether there are any of each. Those without any are left as they are. rubs:
    whether stresses have what friction takes from the tensions, those of a command."""
    strain = work.strain
    loads = work.loads
    if rubs:
        find_shares(arm, strain, work.tendons, work.friction)
    wrenches = any_of(arm.effects.wrench)
    if wrenches:
        loads.node_stiffness[:] = 0.0
        loads.node_damping[:] = 0.0
        sum_wrenches(arm, work.inputs, work.kinematics, loads, work.collision)
    stresses = any_of(arm.effects.stress) or rubs
    if stresses:
        loads.stress[:] = 0.0
        loads.point_stiffness[:] = 0.0
        loads.point_damping[:] = 0.0
        remember(arm, work.inputs, strain, loads)
        if rubs:
            tension = work.tendons.tension
            add_lost_stress(arm, strain, tension, work.friction.share, loads.stress)
        weigh(arm.rod, loads)
    return wrenches, stresses


@kernel
def sum_wrenches(arm, inputs, kinematics, loads, collision):
    """Wrenches of all effects into loads.wrench."""
    effects = arm.effects
    loads.wrench[:] = 0.0
    for i in range(effects.count):
        address = effects.wrench[i]
        if address != 0:
            nodes = nodes_of(arm, inputs, kinematics, loads, collision)
            call(address, effects.parameters[i], (nodes,))


@kernel
def any_of(addresses):
    """Whether any effect has a kernel, by the addresses of all."""
    for i in range(addresses.size):
        if addresses[i] != 0:
            return True
    return False


@kernel
def weigh(rod, loads):
    """Multiplies stresses and their derivatives by the weights of the points; stresses get the sign
    of a load."""
    for block in range(2 * rod.packs):
        weight = load(rod.weight, block * LANES)
        stress = load6(loads.stress, block)
        store6(loads.stress, block, scale_twist(-weight, stress))
        stiffness = load6(loads.point_stiffness, block)
        store6(loads.point_stiffness, block, scale_twist(weight, stiffness))
        damping = load6(loads.point_damping, block)
        store6(loads.point_damping, block, scale_twist(weight, damping))


@phase
def add_implicit(arm, work):
    """Add the effects' share of stiffness and damping, J^T K J and Phi^T K Phi to first order, to
    G and D of work.matrices; after an evaluation."""
    loads = work.loads
    matrices = work.matrices
    spare = work.spare
    if any_of(arm.effects.wrench):
        differ_wrenches(arm, work.inputs, work.kinematics, loads, work.collision, spare)
        J = work.kinematics.J
        ones = work.ones.point
        add_node_gram(arm, J, loads.node_stiffness, ones, spare, matrices.G)
        add_node_gram(arm, J, loads.node_damping, ones, spare, matrices.D)
    if any_of(arm.effects.stress):
        Phi = work.strain.Phi
        add_point_gram(arm, Phi, loads.point_stiffness, spare.matrix, matrices.G)
        add_point_gram(arm, Phi, loads.point_damping, spare.matrix, matrices.D)


@kernel
def differ_wrenches(arm, inputs, kinematics, loads, collision, spare):
    """Add -d wrench / d twist and -d wrench / d displacement of the effects that ask for it, by
    differences, to the blocks of the nodes. Overwrites loads.wrench."""
    for i in range(arm.effects.count):
        if arm.effects.implicit[i] != EXPLICIT:
            differ_wrench(arm, i, inputs, kinematics, loads, collision, spare)


@phase
def differ_wrench(arm, i, inputs, kinematics, loads, collision, spare):
    """Differences of the wrench of the i-th effect by the six components of displacement and twist,
    of all nodes at once."""
    depends_on = arm.effects.implicit[i]
    pose = kinematics.pose
    eta = kinematics.eta
    wrench = loads.wrench
    copy(pose, spare.pose)
    copy(eta, spare.twist)
    wrench_of(arm, i, inputs, kinematics, loads, collision)
    copy(wrench, spare.wrench)
    length = total(arm.rod.length)
    for k in range(6):
        is_turn = k < 3
        way = NODE_SHARE * (1.0 if is_turn else length)
        if depends_on & IMPLICIT_POSE:
            displace(pose, k, way)
            wrench_of(arm, i, inputs, kinematics, loads, collision)
            if is_turn:  # back in the frames before: a dead load is not stiff
                y = (k + 1) % 3 * LANES
                z = (k + 2) % 3 * LANES
                for at in range(0, wrench.size, 3 * LANES):
                    turn(wrench, at + y, at + z, -way)
            add_differences(k, way, wrench, spare.wrench, loads.node_stiffness)
            copy(spare.pose, pose)
        if depends_on & IMPLICIT_TWIST:
            for at in range(k * LANES, eta.size, 6 * LANES):
                store(eta, at, load(eta, at) + way)
            wrench_of(arm, i, inputs, kinematics, loads, collision)
            add_differences(k, way, wrench, spare.wrench, loads.node_damping)
            copy(spare.twist, eta)


@kernel
def wrench_of(arm, i, inputs, kinematics, loads, collision):
    """Wrench of the i-th effect alone into loads.wrench."""
    effects = arm.effects
    loads.wrench[:] = 0.0
    nodes = nodes_of(arm, inputs, kinematics, loads, collision)
    call(effects.wrench[i], effects.parameters[i], (nodes,))


@kernel
def turn(field, y, z, way):
    """Turn two components of a vector by a small angle."""
    before_y = load(field, y)
    before_z = load(field, z)
    store(field, y, before_y + way * before_z)
    store(field, z, before_z - way * before_y)


@kernel
def add_differences(k, way, moved, unmoved, blocks):
    """Add the k-th column of less the differences over a way between wrenches (nodes x 6) to the
    symmetric part of the nodes' blocks (nodes x 21)."""
    for pack in range(blocks.size // (21 * LANES)):
        for j in range(6):
            m = (pack * 6 + j) * LANES
            difference = load(moved, m) - load(unmoved, m)
            # entries off the diagonal are met twice, as (j, k) and as (k, j)
            share = (-1.0 if j == k else -0.5) / way
            row = max(j, k)
            column = min(j, k)
            entry = row * (row + 1) // 2 + column
            at = (pack * 21 + entry) * LANES
            store(blocks, at, load(blocks, at) + share * difference)


@kernel
def displace(pose, k, way):
    """Moves poses (nodes x 12) by a small way along the k-th component of a twist in their own
    frames."""
    # a turn about an axis mixes the columns of the two others
    y = (k + 1) % 3 * LANES
    z = (k + 2) % 3 * LANES
    for at in range(0, pose.size, 12 * LANES):
        for i in range(3):
            row = at + 3 * i * LANES
            if k < 3:
                turn(pose, row + y, row + z, way)
            else:
                place = at + (9 + i) * LANES
                axis = load(pose, row + (k - 3) * LANES)
                store(pose, place, load(pose, place) + way * axis)


@kernel
def filled_packs(field, per_pack):
    """First pack of a field with an entry other than zero, and one past the last such pack; (0, 0)
    where there is none."""
    first = 0
    last = 0
    for pack in range(field.size // per_pack):
        squares = spread(0.0)
        start = pack * per_pack
        for m in range(start, start + per_pack, LANES):
            entry = load(field, m)
            squares = squares + entry * entry
        if lane_sum(squares) != 0.0:
            if last == 0:
                first = pack
            last = pack + 1
    return first, last


@kernel
def add_node_gram(arm, J, blocks, ones, spare, out):
    """Adds J^T K J to out, K symmetric 6x6 blocks (nodes x 21), only over the packs where there are
    any."""
    law = arm.strain
    packs = filled_packs(blocks, 21 * LANES)
    if packs[1] == 0:
        return
    for j in range(law.size):
        for pack in range(packs[0], packs[1]):
            row = j * arm.rod.packs + pack
            block = load21(blocks, pack)
            store6(spare.loaded, row, symmetric_product(block, load6(J, row)))
    gram_within(
        J,
        spare.loaded,
        ones,
        node_rows(),
        law.pack_begin,
        law.jacobian_end,
        packs,
        spare.matrix,
    )
    add_matrix(spare.matrix, out)


@kernel
def add_point_gram(arm, Phi, diagonal, gram, out):
    """Adds Phi^T K Phi to out, K diagonal (points x 6), over the packs where it is not zero."""
    law = arm.strain
    packs = filled_packs(diagonal, 12 * LANES)
    if packs[1] == 0:
        return
    gram_within(
        Phi,
        Phi,
        diagonal,
        point_rows(arm.rod),
        law.pack_begin,
        law.pack_end,
        packs,
        gram,
    )
    add_matrix(gram, out)


@kernel
def add_matrix(addend, out):
    """Adds a square matrix to out."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] += addend[i, j]


@phase
def remember(arm, inputs, strain, loads):
    """Brings the internal states in inputs.state, which belonged to the strain inputs.before, up to
    that of strain.xi and its rate."""
    effects = arm.effects
    for i in range(effects.count):
        address = effects.stress[i]
        if address != 0:
            points = points_of(arm, i, inputs, strain, loads)
            call(address, effects.parameters[i], (points,))


@kernel
def rest_states(arm, command, inputs, strain, loads):
    """The internal states, in inputs.state, of an arm that has always been at rest in this
    configuration under a command (n_a)."""
    copy(arm.effects.state, inputs.state)
    if inputs.before.size > 0:
        inputs.since[0] = math.inf
        remember(arm, inputs, strain, loads)
        inputs.since[0] = 0.0
    rest_filter(arm.effects, command, inputs.state)
