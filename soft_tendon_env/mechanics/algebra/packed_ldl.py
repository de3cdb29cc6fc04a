"""L D L^T factorisation and solution of symmetric matrices of packs, one system per lane, kept in memory.

A matrix is the lower triangle by rows in a flat vector, m (m + 1) / 2 packs; a factor is L below the diagonal and 1 / D on it. For the
larger matrices whose entries do not fit into registers, see symmetric6.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, smallest, store


@kernel(inline=True)
def entry(i, j):
    """Index of entry (i, j), j <= i, in the triangle."""
    return (i * (i + 1) // 2 + j) * LANES


@kernel
def ldl_factorise(a, m):
    """Overwrite a matrix of order m by its factor, without pivoting; its least pivot (NaN if there is one)."""
    least = 1e300
    for k in range(m):
        pivot = load(a, entry(k, k))
        found = smallest(pivot)
        if not found >= least:
            least = found
        inverse = 1.0 / pivot
        store(a, entry(k, k), inverse)
        for i in range(m - 1, k, -1):  # downward: the rows above still have what is not yet divided by the pivot
            row = entry(i, 0)
            factor = load(a, row + k * LANES) * inverse
            for j in range(k + 1, i + 1):
                store(a, row + j * LANES, load(a, row + j * LANES) - factor * load(a, entry(j, k)))
            store(a, row + k * LANES, factor)
    return least


@kernel
def ldl_solve(a, m, x):
    """Overwrite the right-hand side x of m packs by the solution, with the factor a."""
    for j in range(m):
        found = load(x, j * LANES)
        for i in range(j + 1, m):
            store(x, i * LANES, load(x, i * LANES) - load(a, entry(i, j)) * found)
        store(x, j * LANES, found * load(a, entry(j, j)))
    for i in range(m - 1, 0, -1):
        row, found = entry(i, 0), load(x, i * LANES)
        for j in range(i):
            store(x, j * LANES, load(x, j * LANES) - load(a, row + j * LANES) * found)


SIX = 6  # right-hand sides that are solved together: their sums do not wait for each other


@kernel(inline=True)
def _load_six(x, at):
    return load(x[0], at), load(x[1], at), load(x[2], at), load(x[3], at), load(x[4], at), load(x[5], at)


@kernel(inline=True)
def _store_six(x, at, y):
    store(x[0], at, y[0])
    store(x[1], at, y[1])
    store(x[2], at, y[2])
    store(x[3], at, y[3])
    store(x[4], at, y[4])
    store(x[5], at, y[5])


@kernel(inline=True)
def _less(y, s, x):
    """y - s x, six times."""
    return y[0] - s * x[0], y[1] - s * x[1], y[2] - s * x[2], y[3] - s * x[3], y[4] - s * x[4], y[5] - s * x[5]


@kernel
def ldl_solve_six(a, m, x):
    """ldl_solve() of SIX right-hand sides x (SIX, m packs or more)."""
    for i in range(m):
        row, y = entry(i, 0), _load_six(x, i * LANES)
        for j in range(i):
            y = _less(y, load(a, row + j * LANES), _load_six(x, j * LANES))
        _store_six(x, i * LANES, y)
    for i in range(m - 1, -1, -1):
        y, inverse = _load_six(x, i * LANES), load(a, entry(i, i))
        y = y[0] * inverse, y[1] * inverse, y[2] * inverse, y[3] * inverse, y[4] * inverse, y[5] * inverse
        for j in range(i + 1, m):
            y = _less(y, load(a, entry(j, i)), _load_six(x, j * LANES))
        _store_six(x, i * LANES, y)
