"""Copies of vectors and matrices, and solution of small systems: symmetric ones, and those whose
unknowns stay within bounds."""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store

MOST_AT_ONCE, MOST_ONE_BY_ONE = (
    12,
    200,
)  # solutions before each of which all, or one, of the unknowns beyond a bound are moved to it


@kernel
def copy(source, out):
    """Copy a vector; an assignment of slices would look for overlaps and broadcasts, at a tenth of
    a second of compilation for each."""
    for i in range(out.size):
        out[i] = source[i]


@kernel
def copy_matrix(source, out):
    """Copy a matrix."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]


@kernel
def total(x):
    """Sum of a vector; numba's own brings SciPy's linear algebra with it, a tenth of a warm
    start."""
    found = 0.0
    for i in range(x.size):
        found += x[i]
    return found


@kernel(inline=True)
def product(x, y):
    """Scalar product x . y of two vectors, in four sums that do not wait for each other."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = x.size // 4 * 4
    for i in range(0, whole, 4):
        a, b, c, d = (
            a + x[i] * y[i],
            b + x[i + 1] * y[i + 1],
            c + x[i + 2] * y[i + 2],
            d + x[i + 3] * y[i + 3],
        )
    for i in range(whole, x.size):
        a += x[i] * y[i]
    return (a + b) + (c + d)


@kernel
def row_stride(n):
    """Length of a row of n numbers in whole packs."""
    return (n + LANES - 1) // LANES * LANES


@kernel
def solve_positive_definite(a, n, x):
    """Solution x (n) of a symmetric positive definite system by L D L^T elimination; False if it is
    not positive definite.

    a: row i from i * row_stride(n + 1), of which the coefficients from the diagonal on are read,
    and the right-hand side after the last; overwritten.
    """
    stride = row_stride(n + 1)
    for j in range(n):
        pivot = a[j * stride + j]
        if not (pivot > 0.0 and pivot < math.inf):
            return False
        inverse = 1.0 / pivot
        a[j * stride + j] = inverse
        for i in range(j + 1, n):
            share = -inverse * a[j * stride + i]
            for m in range(
                i // LANES * LANES, stride, LANES
            ):  # left of the diagonal too, where nothing is read
                store(a, i * stride + m, load(a, i * stride + m) + share * load(a, j * stride + m))
    for i in range(n):
        x[i] = a[i * stride + n]
    for i in range(n - 1, -1, -1):
        x[i] *= a[i * stride + i]
        for k in range(i):
            x[k] -= a[k * stride + i] * x[i]
    return True


@kernel
def solve_again(a, n, x):
    """Overwrite a further right-hand side x (n) by its solution, of the system that
    solve_positive_definite() has eliminated."""
    stride = row_stride(n + 1)
    for j in range(n):
        share = a[j * stride + j] * x[j]
        for i in range(j + 1, n):
            x[i] -= a[j * stride + i] * share
    for i in range(n - 1, -1, -1):
        x[i] *= a[i * stride + i]
        for k in range(i):
            x[k] -= a[k * stride + i] * x[i]


@kernel
def add_product(a, b, out):
    """Adds the matrix product a b to out."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            share = a[i, j]
            for k in range(b.shape[1] if share != 0.0 else 0):
                out[i, k] += share * b[j, k]


@kernel
def solve_symmetric(a, x):
    """Solutions in place of right-hand sides x (n, m) of a symmetric system a (n, n), of which the
    upper triangle is read: by L D L^T elimination, in place too. Of a system that is singular they
    are not finite."""
    n, m = x.shape
    for j in range(n):
        a[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, n):
            share = a[j, i] * a[j, j]
            for k in range(i, n):
                a[i, k] -= share * a[j, k]
            for k in range(m):
                x[i, k] -= share * x[j, k]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            for k in range(m):
                x[i, k] -= a[i, j] * x[j, k]
        for k in range(m):
            x[i, k] *= a[i, i]


@kernel
def solve_bounded(a, b, least, greatest, x, part, system):
    """Solution x (m) of a x = b, but a x > b where x is at its least and a x < b where it is at its
    greatest: linear complementarity.

    a (m, m): a matrix whose principal minors are positive. By Newton's method on which unknowns are
    at a bound, from where the x that is given is, and where that goes in circles one at a time,
    which comes to an end (K. G. Murty 1974). part (m), system (m, m + 1): scratch.
    """
    m = x.size
    for i in range(m):
        part[i] = -1.0 if x[i] <= least[i] else 1.0 if x[i] >= greatest[i] else 0.0
    for repeat in range(MOST_AT_ONCE + MOST_ONE_BY_ONE):
        solve_part(a, b, least, greatest, x, part, system)
        changed = False
        for i in range(m):
            missing = b[i]
            for j in range(m):
                missing -= a[i, j] * x[j]
            change = 0.0
            if part[i] == 0.0:
                change = 1.0 if x[i] > greatest[i] else -1.0 if x[i] < least[i] else 0.0
            elif part[i] * missing < 0.0:
                change = -part[i]
            if change != 0.0 and not (changed and repeat >= MOST_AT_ONCE):
                part[i] += change
                changed = True
        if not changed:
            break
    for i in range(m):
        x[i] = min(max(x[i], least[i]), greatest[i])


@kernel
def solve_part(a, b, least, greatest, x, part, system):
    """x (m) with those at a bound there, and the rows of the others solved by elimination."""
    m = x.size
    for i in range(m):
        for j in range(m):
            system[i, j] = a[i, j] if part[i] == 0.0 else 1.0 if i == j else 0.0
        system[i, m] = b[i] if part[i] == 0.0 else least[i] if part[i] < 0.0 else greatest[i]
    for j in range(m):
        for i in range(j + 1, m):
            share = system[i, j] / system[j, j]
            for k in range(j if share != 0.0 else m + 1, m + 1):
                system[i, k] -= share * system[j, k]
    for i in range(m - 1, -1, -1):
        x[i] = system[i, m]
        for k in range(i + 1, m):
            x[i] -= system[i, k] * x[k]
        x[i] /= system[i, i]
