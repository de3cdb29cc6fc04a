"""Lagrangian terms of (23), Appendix D, from columns at the points and the nodes.

They are mass and damping matrix, bias, generalised forces.

C is never formed: C q_dot is the projection of the inertial wrench of the motion with q_ddot = 0.
"""

from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import (
    LANES,
    WIDE,
    lane,
    lane_sums,
    load,
    load_wide,
    spread,
    spread_wide,
    store,
)
from soft_tendon_env.mechanics.algebra.lie import coad_apply, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, scale6, store6


class RowLayout(NamedTuple):
    """Layout of a column: in every pack `groups` groups of `size` numbers.

    They are whole wide packs, zero but for the first `used`.
    """

    groups: int
    size: int
    used: int


@kernel(inline=True)
def point_rows(rod):
    """Layout of a column over points.

    It has two blocks a pack, six components, those of rigid strains zero.
    """
    return RowLayout(2, 6 * LANES, len(rod.free) * LANES)


@kernel(inline=True)
def node_rows():
    """Layout of a column over nodes."""
    return RowLayout(1, 6 * LANES, 6 * LANES)


TILE = 4
"""Columns that are multiplied together, so that every number is loaded once for TILE products."""


@kernel(inline=True)
def _load_tile(columns, at, m):
    return (
        load_wide(columns, at[0] + m),
        load_wide(columns, at[1] + m),
        load_wide(columns, at[2] + m),
        load_wide(columns, at[3] + m),
    )


@kernel(inline=True)
def _tile_starts(tile, n, per_column):
    """Indices at which the columns of a tile begin; beyond the last column, that one again."""
    j = TILE * tile
    last = n - 1
    return (
        min(j, last) * per_column,
        min(j + 1, last) * per_column,
        min(j + 2, last) * per_column,
        min(j + 3, last) * per_column,
    )


@kernel(inline=True)
def _zero_tile():
    zero = spread_wide(0.0)
    return zero, zero, zero, zero


@kernel(inline=True)
def _add_products(total, x, y):
    """Sum total + x y, pack by pack, for one x and a tile of y."""
    return (
        total[0] + x * y[0],
        total[1] + x * y[1],
        total[2] + x * y[2],
        total[3] + x * y[3],
    )


@kernel(inline=True)
def _write_sums(sums, tile, out):
    """A pack to the numbers of a tile in out (n)."""
    j = TILE * tile
    n = out.size
    out[j] = lane(sums, 0)
    if j + 1 < n:
        out[j + 1] = lane(sums, 1)
    if j + 2 < n:
        out[j + 2] = lane(sums, 2)
    if j + 3 < n:
        out[j + 3] = lane(sums, 3)


@kernel(inline=True)
def _write_row(total, i, tile, out):
    """The sums over the lanes of a tile to row i of out (n, n), and to column i."""
    if i < out.shape[0]:
        sums = lane_sums(total)
        row = out[i]
        column = out[:, i]
        _write_sums(sums, tile, row)
        _write_sums(sums, tile, column)


@kernel(inline=True)
def _reach(tile, pack_begin, pack_end):
    """Range of the packs in which any column of the tile lives."""
    first = TILE * tile
    begin = pack_begin[first]
    end = pack_end[first]
    for j in range(first + 1, min(first + TILE, pack_begin.size)):
        begin = min(begin, pack_begin[j])
        end = max(end, pack_end[j])
    return begin, end


@kernel
def gram_within(columns, others, weight, rows, pack_begin, pack_end, packs, out):
    """Weighted Gram matrix out_ij in a range of packs.

    It is the sum over the rows of columns_i weight others_j, where others_j is a symmetric matrix
    times columns_j. Column j is zero but from pack_begin[j] to pack_end[j]; `rows` is the layout of
    a pack.
    """
    begin, end = packs
    n = pack_begin.size
    per_column = columns.size // n
    tiles = (n + TILE - 1) // TILE
    for tile_i in range(tiles):
        begin_i, end_i = _reach(tile_i, pack_begin, pack_end)
        at_i = _tile_starts(tile_i, n, per_column)
        # the lower triangle, tile by tile
        for tile_j in range(tile_i + 1):
            begin_j, end_j = _reach(tile_j, pack_begin, pack_end)
            at_j = _tile_starts(tile_j, n, per_column)
            row_0 = _zero_tile()
            row_1 = _zero_tile()
            row_2 = _zero_tile()
            row_3 = _zero_tile()
            first_group = max(begin, begin_i, begin_j) * rows.groups
            last_group = min(end, end_i, end_j) * rows.groups
            for group in range(first_group, last_group):
                start = group * rows.size
                for m in range(start, start + rows.used, WIDE):
                    w = load_wide(weight, m)
                    x = _load_tile(columns, at_i, m)
                    y = _load_tile(others, at_j, m)
                    row_0 = _add_products(row_0, w * x[0], y)
                    row_1 = _add_products(row_1, w * x[1], y)
                    row_2 = _add_products(row_2, w * x[2], y)
                    row_3 = _add_products(row_3, w * x[3], y)
            i = TILE * tile_i
            _write_row(row_0, i, tile_j, out)
            _write_row(row_1, i + 1, tile_j, out)
            _write_row(row_2, i + 2, tile_j, out)
            _write_row(row_3, i + 3, tile_j, out)


@kernel
def project(columns, field, rows, pack_begin, pack_end, out):
    """Generalised force of a wrench field: out_j = sum over the rows of columns_j field."""
    n = pack_begin.size
    per_column = columns.size // n
    tiles = (n + TILE - 1) // TILE
    for tile in range(tiles):
        begin, end = _reach(tile, pack_begin, pack_end)
        at = _tile_starts(tile, n, per_column)
        total = _zero_tile()
        for group in range(begin * rows.groups, end * rows.groups):
            start = group * rows.size
            for m in range(start, start + rows.used, WIDE):
                x = load_wide(field, m)
                y = _load_tile(columns, at, m)
                total = _add_products(total, x, y)
        _write_sums(lane_sums(total), tile, out)


@kernel
def sum_columns(Phi, q_dot, xi_dot):
    """Sum of columns, as the strain rate xi_dot = Phi q_dot."""
    per_column = xi_dot.size
    for m in range(0, per_column, LANES):
        total = spread(0.0)
        for j in range(q_dot.size):
            column = load(Phi, j * per_column + m)
            total = total + q_dot[j] * column
        store(xi_dot, m, total)


@kernel(inline=True)
def mass_matrix(rod, law, J, M):
    """Mass matrix M = int J^T M J dX (40a), of the body Jacobians J at the nodes."""
    gram_within(
        J,
        J,
        rod.inertia,
        node_rows(),
        law.pack_begin,
        law.jacobian_end,
        (0, rod.packs),
        M,
    )


@kernel(inline=True)
def damping_matrix(rod, law, strain, D):
    """Damping matrix D = int Phi^T Upsilon Phi dX, of the strain columns at the points."""
    gram_within(
        strain.Phi,
        strain.Phi,
        rod.viscosity,
        point_rows(rod),
        law.pack_begin,
        law.pack_end,
        (0, rod.packs),
        D,
    )


@kernel(inline=True)
def stiffness_matrix(rod, law, strain, ones, G):
    """Stiffness G = int Phi^T Phi_w dX; symmetric.

    It is of the columns Phi and their wrenches Phi_w times the weight in strain.Y.
    """
    gram_within(
        strain.Phi,
        strain.Y,
        ones,
        point_rows(rod),
        law.pack_begin,
        law.pack_end,
        (0, rod.packs),
        G,
    )


@kernel
def driving_force(rod, law, strain, stress, drive):
    """Drive B u - K - D q_dot = int Phi^T (mismatch - Upsilon xi_dot) dX.

    Overwrites `stress` (points x 6).
    """
    for m in range(0, stress.size, LANES):
        viscosity = load(rod.viscosity, m)
        viscous = viscosity * load(strain.xi_dot, m)
        mismatch = load(strain.mismatch, m)
        store(stress, m, mismatch - viscous)
    rows = point_rows(rod)
    project(strain.Phi, stress, rows, law.pack_begin, law.pack_end, drive)


@kernel
def bias_force(rod, law, kinematics, wrench, bias):
    """Bias force C q_dot = int J^T (M J_dot + ad*_eta M J) q_dot dX (40b).

    It is by the inertial wrenches at zero q_ddot; overwrites `wrench` (nodes x 6).
    """
    for pack in range(rod.packs):
        inertia = load6(rod.inertia, pack)
        eta = load6(kinematics.eta, pack)
        eta_bias = load6(kinematics.eta_bias, pack)
        # M J_dot q_dot + ad*_eta M eta
        accelerated = scale6(inertia, eta_bias)
        momentum = scale6(inertia, eta)
        turning = coad_apply(eta, momentum)
        store6(wrench, pack, twist_sum(accelerated, turning))
    rows = node_rows()
    project(kinematics.J, wrench, rows, law.pack_begin, law.jacobian_end, bias)
