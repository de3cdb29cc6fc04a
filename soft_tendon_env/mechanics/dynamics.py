"""The Lagrangian terms (23), Appendix D, from the columns at the points and at the nodes.

C is never formed: C q_dot is the projection of the inertial wrench of the motion with q_ddot = 0.
"""

from soft_tendon_env.compilation import kernel
from soft_tendon_env.mechanics.lanes import LANES, lane_sum, load, spread
from soft_tendon_env.mechanics.lie import coad_apply, twist_sum
from soft_tendon_env.mechanics.section import load6, scaled, store6


@kernel
def gram(columns, weight, rows, first, last, out):
    """out_ij = sum over the rows of columns_i weight columns_j: symmetric, a pair meets where both columns live."""
    n, packs_rows = first.size, columns.size // first.size
    for i in range(n):
        for j in range(i + 1):
            total = spread(0.0)
            begin, end = max(first[i], first[j]) * rows, min(last[i], last[j]) * rows
            at_i, at_j = i * packs_rows, j * packs_rows
            for m in range(begin, end, LANES):
                total = total + load(weight, m) * load(columns, at_i + m) * load(columns, at_j + m)
            out[i, j] = lane_sum(total)
            out[j, i] = out[i, j]


@kernel
def project(columns, field, rows, first, last, out):
    """out_j = sum over the rows of columns_j field."""
    per_column = columns.size // first.size
    for j in range(first.size):
        total = spread(0.0)
        for m in range(first[j] * rows, last[j] * rows, LANES):
            total = total + load(columns, j * per_column + m) * load(field, m)
        out[j] = lane_sum(total)


@kernel
def inertial_wrench(rod, work):
    """M eta_bias + ad*_eta M eta at every node, times the node's weight (40b)."""
    for pack in range(rod.packs):
        at = pack * 6 * LANES
        inertia, eta = load6(rod.inertia, at), load6(work.eta, at)
        momentum = scaled(inertia, eta)
        store6(work.wrench, at, twist_sum(scaled(inertia, load6(work.eta_bias, at)), coad_apply(eta, momentum)))
