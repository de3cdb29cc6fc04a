"""L D L^T factorisation and solution of symmetric matrices of packs, one system per lane, kept in memory.

A matrix is the lower triangle by rows in a flat vector, m (m + 1) / 2 packs; a factor is L below the diagonal and 1 / D on it. For the
larger matrices whose entries do not fit into registers, see symmetric6.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, smallest, store


@kernel(inline=True)
def entry(i, j):
    """Place of entry (i, j), j <= i, in the triangle."""
    return (i * (i + 1) // 2 + j) * LANES


@kernel
def ldl_factorise(a, at, m):
    """Overwrite the matrix of order m at a[at:] by its factor, without pivoting; its least pivot (NaN if there is one)."""
    least = 1e300
    for k in range(m):
        pivot = load(a, at + entry(k, k))
        found = smallest(pivot)
        if not found >= least:
            least = found
        inverse = 1.0 / pivot
        store(a, at + entry(k, k), inverse)
        for i in range(m - 1, k, -1):  # downward: the rows above still have what is not yet divided by the pivot
            row = at + entry(i, 0)
            factor = load(a, row + k * LANES) * inverse
            for j in range(k + 1, i + 1):
                store(a, row + j * LANES, load(a, row + j * LANES) - factor * load(a, at + entry(j, k)))
            store(a, row + k * LANES, factor)
    return least


@kernel
def ldl_solve(a, at, m, x, x_at):
    """Overwrite the right-hand side of m packs at x[x_at:] by the solution, with the factor at a[at:]."""
    for j in range(m):
        found = load(x, x_at + j * LANES)
        for i in range(j + 1, m):
            store(x, x_at + i * LANES, load(x, x_at + i * LANES) - load(a, at + entry(i, j)) * found)
        store(x, x_at + j * LANES, found * load(a, at + entry(j, j)))
    for i in range(m - 1, 0, -1):
        row, found = at + entry(i, 0), load(x, x_at + i * LANES)
        for j in range(i):
            store(x, x_at + j * LANES, load(x, x_at + j * LANES) - load(a, row + j * LANES) * found)


SIX = 6  # right-hand sides that are solved together: their sums do not wait for each other


@kernel(inline=True)
def _load_six(x, at, apart):
    third, fourth = load(x, at + 2 * apart), load(x, at + 3 * apart)
    return load(x, at), load(x, at + apart), third, fourth, load(x, at + 4 * apart), load(x, at + 5 * apart)


@kernel(inline=True)
def _store_six(x, at, apart, y):
    store(x, at, y[0])
    store(x, at + apart, y[1])
    store(x, at + 2 * apart, y[2])
    store(x, at + 3 * apart, y[3])
    store(x, at + 4 * apart, y[4])
    store(x, at + 5 * apart, y[5])


@kernel(inline=True)
def _less(y, s, x):
    """y - s x, six times."""
    return y[0] - s * x[0], y[1] - s * x[1], y[2] - s * x[2], y[3] - s * x[3], y[4] - s * x[4], y[5] - s * x[5]


@kernel
def ldl_solve_six(a, at, m, x, x_at, apart):
    """ldl_solve() of SIX right-hand sides, which begin `apart` numbers from each other."""
    for i in range(m):
        row, y = at + entry(i, 0), _load_six(x, x_at + i * LANES, apart)
        for j in range(i):
            y = _less(y, load(a, row + j * LANES), _load_six(x, x_at + j * LANES, apart))
        _store_six(x, x_at + i * LANES, apart, y)
    for i in range(m - 1, -1, -1):
        y, inverse = _load_six(x, x_at + i * LANES, apart), load(a, at + entry(i, i))
        y = y[0] * inverse, y[1] * inverse, y[2] * inverse, y[3] * inverse, y[4] * inverse, y[5] * inverse
        for j in range(i + 1, m):
            y = _less(y, load(a, at + entry(j, i)), _load_six(x, x_at + j * LANES, apart))
        _store_six(x, x_at + i * LANES, apart, y)
