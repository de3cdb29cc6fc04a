"""Cholesky factorisation and solution of small symmetric positive definite systems, in place, and copies of vectors and matrices.

A matrix to be factorised is a flat vector of rows padded to whole packs, row i from i * stride, so that rows multiply pack by pack.
"""

import math

from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread
from soft_tendon_env.tools.compilation import kernel

ROWS = 4  # rows that are taken together


@kernel
def copy(source, out):
    """Copy a vector; an assignment of slices would look for overlaps and broadcasts, at a tenth of a second of compilation for each."""
    for i in range(out.size):
        out[i] = source[i]


@kernel
def copy_matrix(source, out):
    """Copy a matrix."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]


@kernel
def row_stride(n):
    """Length of a padded row."""
    return (n + LANES - 1) // LANES * LANES


@kernel
def cholesky(a, n):
    """Overwrite the lower triangle by its Cholesky factor, with 1/l_jj on the diagonal and zeros above; False if not positive definite."""
    stride = row_stride(n)
    for j in range(n):
        for m in range(j + 1, stride):
            a[j * stride + m] = 0.0
    for j in range(n):
        end = (j + LANES - 1) // LANES * LANES
        diagonal = a[j * stride + j]
        a[j * stride + j] = 0.0  # the products over whole packs take in what lies from the diagonal on: nothing, in row j
        total = spread(0.0)
        for m in range(0, end, LANES):
            row = load(a, j * stride + m)
            total = total + row * row
        pivot = diagonal - lane_sum(total)
        if not (pivot > 0.0 and pivot < math.inf):
            return False
        inverse = 1.0 / math.sqrt(pivot)
        for i in range(j + 1, n, ROWS):
            i_1, i_2, i_3 = min(i + 1, n - 1), min(i + 2, n - 1), min(i + 3, n - 1)
            t_0, t_1, t_2, t_3 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for m in range(0, end, LANES):
                row = load(a, j * stride + m)
                t_0, t_1 = t_0 + row * load(a, i * stride + m), t_1 + row * load(a, i_1 * stride + m)
                t_2, t_3 = t_2 + row * load(a, i_2 * stride + m), t_3 + row * load(a, i_3 * stride + m)
            a[i * stride + j] = (a[i * stride + j] - lane_sum(t_0)) * inverse
            if i + 1 < n:
                a[i_1 * stride + j] = (a[i_1 * stride + j] - lane_sum(t_1)) * inverse
            if i + 2 < n:
                a[i_2 * stride + j] = (a[i_2 * stride + j] - lane_sum(t_2)) * inverse
            if i + 3 < n:
                a[i_3 * stride + j] = (a[i_3 * stride + j] - lane_sum(t_3)) * inverse
        a[j * stride + j] = inverse
    return True


@kernel
def cholesky_solve(a, b):
    """Overwrite b (n) by the solution, `a` as left by cholesky()."""
    n = b.size
    stride = row_stride(n)
    for i in range(n):
        total = b[i]
        for j in range(i):
            total -= a[i * stride + j] * b[j]
        b[i] = total * a[i * stride + i]
    for i in range(n - 1, -1, -1):
        total = b[i] * a[i * stride + i]
        b[i] = total
        for j in range(i):
            b[j] -= a[i * stride + j] * total
