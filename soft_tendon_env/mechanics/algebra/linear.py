"""Copies of vectors and matrices, and solution of small systems.

Systems are symmetric, or have unknowns that stay within bounds.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store

MOST_AT_ONCE = 12  # solutions before each of which all unknowns beyond a bound are moved to it
MOST_ONE_BY_ONE = 200  # solutions after those, before each of which one such unknown is moved

SMALL_PIVOT = 1e-3  # of the largest entry below it, under which a pivot's row is interchanged

AT_LEAST = -1
BETWEEN = 0
AT_GREATEST = 1
"""Positions of an unknown of solve_bounded(): at its least, between its bounds, at its greatest."""


@kernel
def copy(source, out):
    """Copies a vector.

    An assignment of slices would look for overlaps and broadcasts, at a tenth of a second of
    compilation for each.
    """
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
    """Sum of a vector.

    numba's own brings SciPy's linear algebra with it, a tenth of a warm start.
    """
    result = 0.0
    for i in range(x.size):
        result += x[i]
    return result


@kernel(inline=True)
def product(x, y):
    """Scalar product x .

    y of two vectors, in four sums that do not wait for each other.
    """
    first = 0.0
    second = 0.0
    third = 0.0
    fourth = 0.0
    whole = x.size // 4 * 4
    for i in range(0, whole, 4):
        first = first + x[i] * y[i]
        second = second + x[i + 1] * y[i + 1]
        third = third + x[i + 2] * y[i + 2]
        fourth = fourth + x[i + 3] * y[i + 3]
    for i in range(whole, x.size):
        first += x[i] * y[i]
    return (first + second) + (third + fourth)


@kernel
def row_stride(n):
    """Length of a row of n numbers in whole packs."""
    return (n + LANES - 1) // LANES * LANES


@kernel
def solve_positive_definite(a, n, x):
    """Solution x (n) of a symmetric positive definite system by L D L^T elimination.

    False if it is not positive definite.

    a: row i from i * row_stride(n + 1), of which the coefficients from the diagonal on are read,
    and the right-hand side after the last; overwritten.
    """
    stride = row_stride(n + 1)
    for j in range(n):
        pivot_row = j * stride
        pivot = a[pivot_row + j]
        if not (pivot > 0.0 and pivot < math.inf):
            return False
        inverse = 1.0 / pivot
        a[pivot_row + j] = inverse
        for i in range(j + 1, n):
            row = i * stride
            share = -inverse * a[pivot_row + i]
            # whole packs: left of the diagonal too, where nothing is read
            for m in range(i // LANES * LANES, stride, LANES):
                reduced = load(a, row + m) + share * load(a, pivot_row + m)
                store(a, row + m, reduced)
    for i in range(n):
        x[i] = a[i * stride + n]
    _substitute_back(a, n, x)
    return True


@kernel
def solve_again(a, n, x):
    """Overwrites a further right-hand side x (n) by its solution.

    The system is the one that solve_positive_definite() has eliminated.
    """
    stride = row_stride(n + 1)
    for j in range(n):
        row = j * stride
        share = a[row + j] * x[j]
        for i in range(j + 1, n):
            x[i] -= a[row + i] * share
    _substitute_back(a, n, x)


@kernel
def _substitute_back(a, n, x):
    """Overwrite L^-1 b, x (n), by L^-T D^-1 L^-1 b, by the factors that elimination left in a."""
    stride = row_stride(n + 1)
    for i in range(n - 1, -1, -1):
        x[i] *= a[i * stride + i]
        for k in range(i):
            x[k] -= a[k * stride + i] * x[i]


@kernel
def solve_columns(a, n, wide, columns):
    """Overwrites right-hand sides of a system by its solutions, by elimination with pivoting.

    False if it is singular. Rows are interchanged where a pivot is negative or small. Row i of `a`
    begins at i * wide, whole packs, and has n coefficients and `columns` right-hand sides.
    """
    used = row_stride(n + columns)
    for j in range(n):
        # whole packs: left of the diagonal too, where nothing is read
        first = j // LANES * LANES
        pivot_row = j * wide
        largest = _largest_below(a, n, wide, j)
        if a[pivot_row + j] < SMALL_PIVOT * abs(a[largest * wide + j]):
            _exchange_rows(a, pivot_row, largest * wide, (first, used))
        pivot = a[pivot_row + j]
        if pivot == 0.0 or not abs(pivot) < math.inf:
            return False
        for i in range(j + 1, n):
            row = i * wide
            share = -a[row + j] / pivot
            for m in range(first, used, LANES):
                reduced = load(a, row + m) + share * load(a, pivot_row + m)
                store(a, row + m, reduced)
    # substitution from the last unknown to the first
    for i in range(n - 1, -1, -1):
        row = i * wide
        for c in range(n, n + columns):
            x = a[row + c]
            for k in range(i + 1, n):
                x -= a[row + k] * a[k * wide + c]
            a[row + c] = x / a[row + i]
    return True


@kernel
def _largest_below(a, n, wide, j):
    """Row, from the diagonal on, in which column j has its largest entry."""
    largest = j
    most = abs(a[j * wide + j])
    for i in range(j + 1, n):
        size = abs(a[i * wide + j])
        if size > most:
            most = size
            largest = i
    return largest


@kernel
def _exchange_rows(a, row, other_row, columns):
    """Exchanges two rows, which begin at `row` and `other_row`, from one column to another."""
    begin, end = columns
    for m in range(begin, end, LANES):
        kept = load(a, row + m)
        store(a, row + m, load(a, other_row + m))
        store(a, other_row + m, kept)


@kernel
def add_product(a, b, out):
    """Adds the matrix product a b to out."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            share = a[i, j]
            if share != 0.0:
                for k in range(b.shape[1]):
                    out[i, k] += share * b[j, k]


@kernel
def solve_symmetric(a, x):
    """Solutions in place of right-hand sides x (n, m) of a symmetric system a (n, n).

    Its upper triangle is read: by L D L^T elimination, in place too. Of a system that is singular
    they are not finite.
    """
    n, m = x.shape
    # elimination: 1 / D on the diagonal, D L^T above it, and L^-1 x
    for j in range(n):
        a[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, n):
            share = a[j, i] * a[j, j]
            for k in range(i, n):
                a[i, k] -= share * a[j, k]
            for k in range(m):
                x[i, k] -= share * x[j, k]
    # substitution from the last unknown to the first
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            for k in range(m):
                x[i, k] -= a[i, j] * x[j, k]
        for k in range(m):
            x[i, k] *= a[i, i]


@kernel
def place_between(x, least, greatest):
    """Position of a number: AT_LEAST or below, AT_GREATEST or above, or BETWEEN."""
    if x <= least:
        return AT_LEAST
    if x >= greatest:
        return AT_GREATEST
    return BETWEEN


@kernel
def solve_bounded(a, b, least, greatest, x, part, system):
    """Solution x (m) of a x = b within bounds: linear complementarity.

    But a x > b where x is at its least and a x < b where it is at its greatest.

    a (m, m): a matrix whose principal minors are positive. By Newton's method on which unknowns are
    at a bound, from where the x that is given is, and where that goes in circles one at a time,
    which comes to an end (K. G. Murty 1974). part (m) int64, system (m, m + 1): scratch.
    """
    m = x.size
    for i in range(m):
        part[i] = place_between(x[i], least[i], greatest[i])
    for repeat in range(MOST_AT_ONCE + MOST_ONE_BY_ONE):
        solve_part(a, b, least, greatest, x, part, system)
        one_by_one = repeat >= MOST_AT_ONCE
        changed = False
        for i in range(m):
            change = _change_of_part(a, b, least, greatest, x, part, i)
            if change != 0 and not (changed and one_by_one):
                part[i] += change
                changed = True
        if not changed:
            break
    # where the search has ended at its most solutions, an unknown may be beyond a bound
    for i in range(m):
        x[i] = min(max(x[i], least[i]), greatest[i])


@kernel
def _change_of_part(a, b, least, greatest, x, part, i):
    """Change of part[i] that the solution x of solve_part() calls for.

    It is to the bound that an unknown between them has passed, or off the bound that its row pushes
    it away from.
    """
    if part[i] == BETWEEN:
        if x[i] > greatest[i]:
            return 1
        if x[i] < least[i]:
            return -1
        return 0
    missing = b[i]
    for j in range(x.size):
        missing -= a[i, j] * x[j]
    if part[i] * missing < 0.0:
        return -part[i]
    return 0


@kernel
def solve_part(a, b, least, greatest, x, part, system):
    """Solution x (m) with unknowns at a bound there, and the others by elimination.

    Elimination solves the rows of the others.
    """
    m = x.size
    # rows of the system: a x = b of unknowns between their bounds, x = bound of the others
    for i in range(m):
        if part[i] == BETWEEN:
            for j in range(m):
                system[i, j] = a[i, j]
            system[i, m] = b[i]
        else:
            for j in range(m):
                system[i, j] = 0.0
            system[i, i] = 1.0
            system[i, m] = least[i] if part[i] == AT_LEAST else greatest[i]
    # Gauss elimination without pivoting: the principal minors are positive
    for j in range(m):
        for i in range(j + 1, m):
            share = system[i, j] / system[j, j]
            if share != 0.0:
                for k in range(j, m + 1):
                    system[i, k] -= share * system[j, k]
    for i in range(m - 1, -1, -1):
        x[i] = system[i, m]
        for k in range(i + 1, m):
            x[i] -= system[i, k] * x[k]
        x[i] /= system[i, i]
