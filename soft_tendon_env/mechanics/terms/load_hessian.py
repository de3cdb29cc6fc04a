"""Hessian of the rod's energy under dead loads: assembly, elimination and solution.

Blocks are eliminated from tip to base; the solution is for further right-hand sides.

A strain of an interval moves all nodes beyond by a twist W = (k, v), in the base frame (Appendix
C), so that the loads do the work F . v + (sum r_n x f_n + moment) . k, with F the sum of the dead
forces f_n on the nodes beyond, at r_n. Strains nearer to the base turn all of that, which changes
the generalised force by -y times their k, where

    y = F x v + Q k,    Q = sum (r_n . f_n I - r_n f_n^T).

So the blocks of the Hessian between intervals have rank 3, turn times y, and eliminating intervals
from the tip on only adds to Q: they give way. A dead moment has no potential: it adds moment x k to
the y of equations (`rows`), and nothing to that of unknowns (`columns`).
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    cross,
    dot,
    operator_apply,
    plus,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import add_product
from soft_tendon_env.mechanics.terms.kinematics import (
    KAPPA,
    interval_operators,
    pose_at,
    strains_at_points,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_at,
    magnus_transposed,
    wrench_at_start,
)

SIZE = 12  # unknowns of an interval: the scaled strains e at its two points
DIFFERENCE = 1e-3  # [rad] of an interval's turn: errors of 1e-12 by truncation and by rounding
STENCIL = ((-2.0, 1 / 12), (-1.0, -2 / 3), (1.0, 2 / 3), (2.0, -1 / 12))
"""Steps and weights of the first derivative."""


@kernel(inline=True)
def place(node):
    """Index in a field over points at which the unknowns of an interval begin.

    The interval ends at a node; they are LANES apart.
    """
    return (node // LANES * SIZE) * LANES + node % LANES


@kernel(inline=True)
def _node_load(rod, law, part, node, kinematics):
    """Position of a node, and `part` of the dead force on it."""
    _, position = pose_at(kinematics.pose, node)
    mass = rod.node_mass[node]
    force = times(part * mass, law.acceleration)
    last = rod.node_mass.size - 1
    if node == last:
        force = plus(force, times(part, law.force))
    return position, force


@kernel
def _interval_stress(rod, node, xi_1, xi_2, wrench, kinematics):
    """Generalised forces of a wrench beyond an interval, over the weight of its points.

    The wrench is in the base frame, the forces on the strains at its two points.
    """
    R, r = pose_at(kinematics.start, node)
    return magnus_transposed(rod.length[node], xi_1, xi_2, wrench_at_start(R, r, wrench))


@kernel
def load_stress(rod, law, part, xi, kinematics, out):
    """Generalised force of `part` of the loads on strains xi over their weight.

    xi and out are (points x 6); after poses().
    """
    moment = times(part, law.moment)
    force = (0.0, 0.0, 0.0)
    out[:] = 0.0
    # wrench on all beyond an interval, in the base frame, from the tip on
    for node in range(rod.length.size - 1, -1, -1):
        position, node_force = _node_load(rod, law, part, node, kinematics)
        moment = plus(moment, cross(position, node_force))
        force = plus(force, node_force)
        xi_1, xi_2 = strains_at_points(xi, node)
        wrench = (moment, force)
        first, second = _interval_stress(rod, node, xi_1, xi_2, wrench, kinematics)
        at = place(node)
        add_at(out, at, first)
        add_at(out, at + 6 * LANES, second)


@kernel(inline=True)
def _unit(rod, node, a):
    """Strain of a point by the a-th unknown of an interval, as a twist."""
    i = a % 6
    c = rod.root_compliance[place(node) + a * LANES]
    # the i-th component alone
    angular = (c * (i == 0), c * (i == 1), c * (i == 2))
    linear = (c * (i == 3), c * (i == 4), c * (i == 5))
    return angular, linear


@kernel(inline=True)
def _section_entry(strain, node, a, b):
    """Entry (b, a) of the scaled section stiffness at the two points of an interval.

    These do not meet each other there.
    """
    # unknowns 0 to 5 are of the first point, 6 to 11 of the second
    point = a // 6
    if b // 6 != point:
        return 0.0
    first = a % 6
    second = b % 6
    row = max(first, second)
    column = min(first, second)
    block = 2 * (node // LANES) + point
    entry = block * 21 + row * (row + 1) // 2 + column
    return strain.factor[entry * LANES + node % LANES]


@kernel
def _assemble_interval(rod, node, wrench, strain, kinematics, D):
    """Hessian D (12, 12) of an interval over the weight, but for what y makes of it.

    It is the section's, and differences of load stresses.
    """
    at = place(node)
    compliance = rod.root_compliance
    xi_1, xi_2 = strains_at_points(strain.xi, node)
    for a in range(SIZE):
        unit = _unit(rod, node, a)
        # a step of the unknown that turns the interval by DIFFERENCE
        turn = rod.length[node] * compliance[at + a * LANES]
        way = DIFFERENCE / turn if turn > 0.0 else 1.0
        for b in range(SIZE):
            D[b, a] = _section_entry(strain, node, a, b)
        for steps, share in STENCIL:
            moved = scale_twist(steps * way, unit)
            moved_1 = twist_sum(xi_1, moved) if a < 6 else xi_1
            moved_2 = twist_sum(xi_2, moved) if a >= 6 else xi_2
            stress = _interval_stress(rod, node, moved_1, moved_2, wrench, kinematics)
            for b in range(SIZE):
                of_point = stress[b // 6]
                component = of_point[b % 6 // 3][b % 3]
                scaled = compliance[at + b * LANES] * component
                D[b, a] -= scaled * share / way


@kernel
def _invert(D):
    """Overwrites a matrix by its inverse, by elimination without pivoting.

    Returns the least pivot, NaN if there is one.
    """
    least = 1e300
    n = D.shape[0]
    for k in range(n):
        pivot = D[k, k]
        if not pivot >= least:
            least = pivot
        D[k, k] = 1.0
        for j in range(n):
            D[k, j] /= pivot
        for i in range(n):
            if i != k:
                share = D[i, k]
                D[i, k] = 0.0
                for j in range(n):
                    D[i, j] -= share * D[k, j]
    return least


@kernel(inline=True)
def _add_turned_forces(position, force, Q, rows_Q):
    """Adds (r . f) I - r f^T of a node at r with a force f to Q of columns and of rows."""
    along = dot(position, force)
    for i in range(3):
        for j in range(3):
            diagonal = along if i == j else 0.0
            change = diagonal - position[i] * force[j]
            Q[i, j] += change
            rows_Q[i, j] += change


@kernel(inline=True)
def _fill_turns(rod, node, force, Q, rows_Q, strain, kinematics, memory, rows):
    """Turn and y of the unknowns of an interval.

    It is y over the weight in `rows` (12, 3), less it, and times the weight in memory.columns.
    """
    h = rod.length[node]
    turn = memory.turn[node]
    columns = memory.columns[node]
    R, r = pose_at(kinematics.start, node)
    xi_1, xi_2 = strains_at_points(strain.xi, node)
    kappa = 2.0 * KAPPA * h
    operators = interval_operators(h, 1.0, kappa, xi_1, xi_2, R, r)
    for a in range(SIZE):
        # W = (k, v) of what is beyond, and y = F x v + Q k
        A, C = operators.W_1 if a < 6 else operators.W_2
        unit = _unit(rod, node, a)
        k, v = operator_apply(A, C, unit)
        side = cross(force, v)
        for i in range(3):
            turn[a, i] = k[i]
            y = add_row_product(side[i], Q, i, k)
            y_of_rows = add_row_product(side[i], rows_Q, i, k)
            columns[a, i] = 0.5 * h * y
            rows[a, i] = -y_of_rows


@kernel(inline=True)
def add_row_product(start, Q, i, k):
    """Number added to the scalar product of a row of a matrix (3, 3) and a vector."""
    return start + Q[i, 0] * k[0] + Q[i, 1] * k[1] + Q[i, 2] * k[2]


@kernel(refcount=True)
def factorise_hessian(rod, law, part, strain, kinematics):
    """Eliminates the intervals from tip to base; the least pivot.

    After poses(), with the scaled section stiffness in strain.factor.
    """
    memory = strain.under_loads
    least = 1e300
    rows = np.empty((SIZE, 3))
    Q = np.zeros((3, 3))
    rows_Q = np.zeros((3, 3))
    moment = times(part, law.moment)
    force = (0.0, 0.0, 0.0)
    for i in range(3):  # rows_Q = moment~
        j = (i + 1) % 3
        k = (i + 2) % 3
        rows_Q[k, j] = moment[i]
        rows_Q[j, k] = -moment[i]
    for node in range(rod.length.size - 1, -1, -1):
        # F, Q and moment of all beyond the interval
        position, node_force = _node_load(rod, law, part, node, kinematics)
        moment = plus(moment, cross(position, node_force))
        force = plus(force, node_force)
        _add_turned_forces(position, node_force, Q, rows_Q)
        # the block on the diagonal, with what the intervals beyond leave in Q, and its inverse
        D = memory.inverse[node]
        columns = memory.columns[node]
        answer = memory.answer[node]
        _assemble_interval(rod, node, (moment, force), strain, kinematics, D)
        _fill_turns(rod, node, force, Q, rows_Q, strain, kinematics, memory, rows)
        add_product(memory.turn[node], columns.T, D)
        pivot = _invert(D)
        if not pivot >= least:
            least = pivot
        # the interval gives way: answer = D^-1 rows adds to Q
        answer[:] = 0.0
        add_product(D, rows, answer)
        add_product(columns.T, answer, Q)
        add_product(answer.T, columns, rows_Q)
    return least


@kernel(refcount=True)
def solve_hessian(rod, memory, x, start):
    """Strains C^1/2 H^-1 C^1/2 of wrenches, in place of these.

    They are a field over points from x[start] on.
    """
    nodes = rod.length.size
    y = np.empty(SIZE)
    c = rod.root_compliance
    # tip to base: the unknowns of an interval if all nearer to the base stood still; p, q, r is the
    # sum of y times the weight of all beyond
    p = 0.0
    q = 0.0
    r = 0.0
    for node in range(nodes - 1, -1, -1):
        first = place(node)
        at = start + first
        D = memory.inverse[node]
        turn = memory.turn[node]
        columns = memory.columns[node]
        for a in range(SIZE):
            component = a * LANES
            wrench = c[first + component] * x[at + component]
            y[a] = wrench - turn[a, 0] * p - turn[a, 1] * q - turn[a, 2] * r
        for a in range(SIZE):
            strain = 0.0
            for b in range(SIZE):
                strain += D[a, b] * y[b]
            x[at + a * LANES] = strain
            p = p + columns[a, 0] * strain
            q = q + columns[a, 1] * strain
            r = r + columns[a, 2] * strain
    # base to tip: with the turn p, q, r of the interval's start
    p = 0.0
    q = 0.0
    r = 0.0
    for node in range(nodes):
        first = place(node)
        at = start + first
        half = 0.5 * rod.length[node]
        turn = memory.turn[node]
        answer = memory.answer[node]
        start_turn = (p, q, r)
        for a in range(SIZE):
            component = a * LANES
            still = x[at + component]
            strain = add_row_product(still, answer, a, start_turn)
            x[at + component] = c[first + component] * strain
            p = p + half * turn[a, 0] * strain
            q = q + half * turn[a, 1] * strain
            r = r + half * turn[a, 2] * strain
