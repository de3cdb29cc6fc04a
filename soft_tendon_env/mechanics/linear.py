"""Small symmetric positive definite systems, in place."""

import math

from soft_tendon_env.compilation import kernel


@kernel
def cholesky(a):
    """Overwrite the lower triangle of `a` (n, n) by its Cholesky factor, 1/l_ii on the diagonal; False if not positive definite."""
    n = a.shape[0]
    for k in range(n):
        pivot = a[k, k]
        if not pivot > 0.0 or pivot == math.inf:
            return False
        inverse = 1.0 / math.sqrt(pivot)
        a[k, k] = inverse
        for i in range(k + 1, n):
            a[i, k] *= inverse
        for i in range(k + 1, n):
            factor = a[i, k]
            for j in range(k + 1, i + 1):
                a[i, j] -= factor * a[j, k]
    return True


@kernel
def cholesky_solve(a, b):
    """Overwrite b (n) by the solution, `a` as left by cholesky()."""
    n = b.size
    for i in range(n):
        total = b[i]
        for j in range(i):
            total -= a[i, j] * b[j]
        b[i] = total * a[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i] * a[i, i]
        b[i] = total
        for j in range(i):
            b[j] -= a[i, j] * total
