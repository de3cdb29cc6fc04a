"""L D L^T factorisation and solution of the symmetric 6x6 matrix of a section, on numbers or packs,
every entry in a register.

A symmetric matrix is the 21-tuple of its lower triangle by rows; a factor is L below the diagonal
by rows (15), then 1/D (6).

`free` is a tuple as long as the block of H that differs from the identity: 3 for a Kirchhoff rod, 4
with stretch, 6 with shear too. Its length is part of its type, so the compiler leaves out the rows
of rigid strains.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import dot


@kernel(inline=True)
def load3(field, at):
    return load(field, at), load(field, at + LANES), load(field, at + 2 * LANES)


@kernel(inline=True)
def load6(field, at):
    return load3(field, at), load3(field, at + 3 * LANES)


@kernel(inline=True)
def store3(field, at, x):
    store(field, at, x[0])
    store(field, at + LANES, x[1])
    store(field, at + 2 * LANES, x[2])


@kernel(inline=True)
def store6(field, at, x):
    store3(field, at, x[0])
    store3(field, at + 3 * LANES, x[1])


@kernel(inline=True)
def factorise(h, free):
    """L D L^T of a 21-tuple, without pivoting: a pivot that is not positive shows as a 1/D that is
    not."""
    (
        h00,
        h10,
        h11,
        h20,
        h21,
        h22,
        h30,
        h31,
        h32,
        h33,
        h40,
        h41,
        h42,
        h43,
        h44,
        h50,
        h51,
        h52,
        h53,
        h54,
        h55,
    ) = h
    i0 = 1.0 / h00
    l10, l20 = h10 * i0, h20 * i0
    h11 = h11 - l10 * h10
    i1 = 1.0 / h11
    h21 = h21 - l20 * h10
    l21 = h21 * i1
    h22 = h22 - l20 * h20 - l21 * h21
    i2 = 1.0 / h22
    zero, one = 0.0 * h00, 0.0 * h00 + 1.0
    l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54 = (
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
    )
    i3, i4, i5 = one, one, one
    if len(free) > 3:
        l30 = h30 * i0
        h31 = h31 - l30 * h10
        l31 = h31 * i1
        h32 = h32 - l30 * h20 - l31 * h21
        l32 = h32 * i2
        h33 = h33 - l30 * h30 - l31 * h31 - l32 * h32
        i3 = 1.0 / h33
    if len(free) > 4:
        l40, l50 = h40 * i0, h50 * i0
        h41, h51 = h41 - l40 * h10, h51 - l50 * h10
        l41, l51 = h41 * i1, h51 * i1
        h42, h52 = h42 - l40 * h20 - l41 * h21, h52 - l50 * h20 - l51 * h21
        l42, l52 = h42 * i2, h52 * i2
        h43, h53 = h43 - l40 * h30 - l41 * h31 - l42 * h32, h53 - l50 * h30 - l51 * h31 - l52 * h32
        l43, l53 = h43 * i3, h53 * i3
        h44 = h44 - l40 * h40 - l41 * h41 - l42 * h42 - l43 * h43
        i4 = 1.0 / h44
        h54 = h54 - l50 * h40 - l51 * h41 - l52 * h42 - l53 * h43
        l54 = h54 * i4
        i5 = 1.0 / (h55 - l50 * h50 - l51 * h51 - l52 * h52 - l53 * h53 - l54 * h54)
    return (
        l10,
        l20,
        l21,
        l30,
        l31,
        l32,
        l40,
        l41,
        l42,
        l43,
        l50,
        l51,
        l52,
        l53,
        l54,
        i0,
        i1,
        i2,
        i3,
        i4,
        i5,
    )


@kernel(inline=True)
def solve_lower(f, b, free):
    """Forward substitution, L^-1 b for a twist-shaped b."""
    (b0, b1, b2), (b3, b4, b5) = b
    b1 = b1 - f[0] * b0
    b2 = b2 - f[1] * b0 - f[2] * b1
    if len(free) > 3:
        b3 = b3 - f[3] * b0 - f[4] * b1 - f[5] * b2
    if len(free) > 4:
        b4 = b4 - f[6] * b0 - f[7] * b1 - f[8] * b2 - f[9] * b3
        b5 = b5 - f[10] * b0 - f[11] * b1 - f[12] * b2 - f[13] * b3 - f[14] * b4
    return (b0, b1, b2), (b3, b4, b5)


@kernel(inline=True)
def solve_upper(f, b, free):
    """Backward substitution, L^-T b."""
    (b0, b1, b2), (b3, b4, b5) = b
    if len(free) > 4:
        b4 = b4 - f[14] * b5
        b3 = b3 - f[9] * b4 - f[13] * b5
        b2 = b2 - f[8] * b4 - f[12] * b5
        b1 = b1 - f[7] * b4 - f[11] * b5
        b0 = b0 - f[6] * b4 - f[10] * b5
    if len(free) > 3:
        b2 = b2 - f[5] * b3
        b1 = b1 - f[4] * b3
        b0 = b0 - f[3] * b3
    b1 = b1 - f[2] * b2
    b0 = b0 - f[0] * b1 - f[1] * b2
    return (b0, b1, b2), (b3, b4, b5)


@kernel(inline=True)
def scale6(s, x):
    """Component by component product of two twist-shaped tuples."""
    return (s[0][0] * x[0][0], s[0][1] * x[0][1], s[0][2] * x[0][2]), (
        s[1][0] * x[1][0],
        s[1][1] * x[1][1],
        s[1][2] * x[1][2],
    )


@kernel(inline=True)
def solve(f, b, free):
    """Solution H^-1 b by the factor of H."""
    return solve_upper(
        f, scale6(((f[15], f[16], f[17]), (f[18], f[19], f[20])), solve_lower(f, b, free)), free
    )


@kernel(inline=True)
def squared_norm(x):
    return dot(x[0], x[0]) + dot(x[1], x[1])


@kernel(inline=True)
def store_factor(field, block, f):
    at = block * 21 * LANES
    for i in range(21):
        store(field, at + i * LANES, f[i])


@kernel(inline=True)
def load21(field, at):
    first, second, third = (
        load6(field, at),
        load6(field, at + 6 * LANES),
        load6(field, at + 12 * LANES),
    )
    return (
        first[0]
        + first[1]
        + second[0]
        + second[1]
        + third[0]
        + third[1]
        + load3(field, at + 18 * LANES)
    )


@kernel(inline=True)
def symmetric_product(h, x):
    """Product of a symmetric matrix, a 21-tuple, and a twist."""
    (
        h00,
        h10,
        h11,
        h20,
        h21,
        h22,
        h30,
        h31,
        h32,
        h33,
        h40,
        h41,
        h42,
        h43,
        h44,
        h50,
        h51,
        h52,
        h53,
        h54,
        h55,
    ) = h
    (x0, x1, x2), (x3, x4, x5) = x
    y0 = h00 * x0 + h10 * x1 + h20 * x2 + h30 * x3 + h40 * x4 + h50 * x5
    y1 = h10 * x0 + h11 * x1 + h21 * x2 + h31 * x3 + h41 * x4 + h51 * x5
    y2 = h20 * x0 + h21 * x1 + h22 * x2 + h32 * x3 + h42 * x4 + h52 * x5
    y3 = h30 * x0 + h31 * x1 + h32 * x2 + h33 * x3 + h43 * x4 + h53 * x5
    y4 = h40 * x0 + h41 * x1 + h42 * x2 + h43 * x3 + h44 * x4 + h54 * x5
    return (y0, y1, y2), (y3, y4, h50 * x0 + h51 * x1 + h52 * x2 + h53 * x3 + h54 * x4 + h55 * x5)


@kernel(inline=True)
def zero6():
    """Zero twist or wrench of packs."""
    zero = spread(0.0)
    return (zero, zero, zero), (zero, zero, zero)


@kernel(inline=True)
def zero21():
    """Zero symmetric matrix of packs."""
    o = spread(0.0)
    return o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o


@kernel(inline=True)
def scaled_stiffness(h, c):
    """Scaled section stiffness I + C^1/2 h C^1/2."""
    (c0, c1, c2), (c3, c4, c5) = c
    return (
        1.0 + c0 * c0 * h[0],
        c1 * c0 * h[1],
        1.0 + c1 * c1 * h[2],
        c2 * c0 * h[3],
        c2 * c1 * h[4],
        1.0 + c2 * c2 * h[5],
        c3 * c0 * h[6],
        c3 * c1 * h[7],
        c3 * c2 * h[8],
        1.0 + c3 * c3 * h[9],
        c4 * c0 * h[10],
        c4 * c1 * h[11],
        c4 * c2 * h[12],
        c4 * c3 * h[13],
        1.0 + c4 * c4 * h[14],
        c5 * c0 * h[15],
        c5 * c1 * h[16],
        c5 * c2 * h[17],
        c5 * c3 * h[18],
        c5 * c4 * h[19],
        1.0 + c5 * c5 * h[20],
    )


@kernel(inline=True)
def is_positive(f):
    """Whether every pivot of every lane is positive (false for NaN)."""
    return (
        largest(-f[15]) < 0.0
        and largest(-f[16]) < 0.0
        and largest(-f[17]) < 0.0
        and largest(-f[18]) < 0.0
        and largest(-f[19]) < 0.0
        and largest(-f[20]) < 0.0
    )
