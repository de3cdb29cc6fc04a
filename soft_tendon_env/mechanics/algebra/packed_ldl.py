"""L D L^T factorisation and solution of symmetric matrices of packs, one system per lane, kept in memory.

A matrix is the lower triangle by rows in a flat vector, m (m + 1) / 2 packs; a factor is L below the diagonal and 1 / D on it. For the
larger matrices whose entries do not fit into registers, see symmetric6.
"""

from soft_tendon_env.mechanics.algebra.lanes import LANES, load, smallest, store
from soft_tendon_env.tools.compilation import kernel


@kernel(inline=True)
def entry(i, j):
    """Place of entry (i, j), j <= i, in the triangle."""
    return (i * (i + 1) // 2 + j) * LANES


@kernel
def ldl_factorise(a, at, m):
    """Overwrite the matrix of order m at a[at:] by its factor, without pivoting; its least pivot (NaN if there is one)."""
    least = 1e300
    for i in range(m):
        row = at + entry(i, 0)
        for j in range(i):
            total, other = load(a, row + j * LANES), at + entry(j, 0)
            for k in range(j):
                total = total - load(a, row + k * LANES) * load(a, other + k * LANES)
            store(a, row + j * LANES, total)
        pivot = load(a, row + i * LANES)
        for j in range(i):
            u = load(a, row + j * LANES)
            factor = u * load(a, at + entry(j, j))
            pivot = pivot - u * factor
            store(a, row + j * LANES, factor)
        found = smallest(pivot)
        if not found >= least:
            least = found
        store(a, row + i * LANES, 1.0 / pivot)
    return least


@kernel
def ldl_solve(a, at, m, x, x_at):
    """Overwrite the right-hand side of m packs at x[x_at:] by the solution, with the factor at a[at:]."""
    for i in range(m):
        row, total = at + entry(i, 0), load(x, x_at + i * LANES)
        for j in range(i):
            total = total - load(a, row + j * LANES) * load(x, x_at + j * LANES)
        store(x, x_at + i * LANES, total)
    for i in range(m):
        store(x, x_at + i * LANES, load(x, x_at + i * LANES) * load(a, at + entry(i, i)))
    for i in range(m - 1, 0, -1):
        row, found = at + entry(i, 0), load(x, x_at + i * LANES)
        for j in range(i):
            store(x, x_at + j * LANES, load(x, x_at + j * LANES) - load(a, row + j * LANES) * found)
