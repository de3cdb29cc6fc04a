"""Linear systems whose unknowns stay within bounds: linear complementarity."""

from soft_tendon_env.compiler.compilation import kernel

MOST_AT_ONCE, MOST_ONE_BY_ONE = 12, 200
"""Solutions of which all, or one, of the unknowns that are on the wrong side of a bound change in each."""


@kernel
def solve_bounded(a, b, least, greatest, x, part, system):
    """Solution x (m) of a x = b, but a x > b where x is at its least and a x < b where it is at its greatest.

    a (m, m): a matrix whose principal minors are positive. By Newton's method on which unknowns are at a bound, from where the x that is
    given is, and where that goes in circles one at a time, which comes to an end (K. G. Murty 1974). part (m), system (m, m + 1): scratch.
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
