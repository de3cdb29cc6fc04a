"""L D L^T factorisation and solution of the symmetric 6x6 matrix of a section.

It works on numbers or packs, every entry in a register.

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
    """Three packs of a field, from a place on."""
    return load(field, at), load(field, at + LANES), load(field, at + 2 * LANES)


@kernel(inline=True)
def load6(field, block):
    """Twist-shaped packs of a block of a field."""
    at = block * 6 * LANES
    return load3(field, at), load3(field, at + 3 * LANES)


@kernel(inline=True)
def store3(field, at, x):
    """Stores three packs in a field, from a place on."""
    store(field, at, x[0])
    store(field, at + LANES, x[1])
    store(field, at + 2 * LANES, x[2])


@kernel(inline=True)
def store6(field, block, x):
    """Stores twist-shaped packs in a block of a field."""
    at = block * 6 * LANES
    store3(field, at, x[0])
    store3(field, at + 3 * LANES, x[1])


@kernel(inline=True)
def factorise(h, free):
    """L D L^T of a 21-tuple, without pivoting.

    A pivot that is not positive shows as a 1/D that is not.
    """
    # row i, of the rows before it, where h_ij is overwritten by (L D)_ij:
    # (L D)_ij = h_ij - sum_k<j l_ik (L D)_jk,    l_ij = (L D)_ij / D_j,
    # D_i = h_ii - sum_k<i l_ik (L D)_ik
    h00 = h[0]
    h10, h11 = h[1:3]
    h20, h21, h22 = h[3:6]
    h30, h31, h32, h33 = h[6:10]
    h40, h41, h42, h43, h44 = h[10:15]
    h50, h51, h52, h53, h54, h55 = h[15:21]

    i0 = 1.0 / h00
    l10 = h10 * i0
    i1 = 1.0 / (h11 - l10 * h10)
    l20 = h20 * i0
    h21 = h21 - l20 * h10
    l21 = h21 * i1
    i2 = 1.0 / (h22 - l20 * h20 - l21 * h21)

    # rows of rigid strains are those of the identity
    zero = 0.0 * h00
    one = zero + 1.0
    row_3 = (zero, zero, zero)
    row_4 = (zero, zero, zero, zero)
    row_5 = (zero, zero, zero, zero, zero)
    i3 = one
    i4 = one
    i5 = one
    if len(free) > 3:
        l30 = h30 * i0
        h31 = h31 - l30 * h10
        l31 = h31 * i1
        h32 = h32 - l30 * h20 - l31 * h21
        l32 = h32 * i2
        row_3 = (l30, l31, l32)
        i3 = 1.0 / (h33 - l30 * h30 - l31 * h31 - l32 * h32)
    if len(free) > 4:
        l40 = h40 * i0
        h41 = h41 - l40 * h10
        l41 = h41 * i1
        h42 = h42 - l40 * h20 - l41 * h21
        l42 = h42 * i2
        h43 = h43 - l40 * h30 - l41 * h31 - l42 * h32
        l43 = h43 * i3
        row_4 = (l40, l41, l42, l43)
        h44 = h44 - l40 * h40 - l41 * h41
        i4 = 1.0 / (h44 - l42 * h42 - l43 * h43)

        l50 = h50 * i0
        h51 = h51 - l50 * h10
        l51 = h51 * i1
        h52 = h52 - l50 * h20 - l51 * h21
        l52 = h52 * i2
        h53 = h53 - l50 * h30 - l51 * h31 - l52 * h32
        l53 = h53 * i3
        h54 = h54 - l50 * h40 - l51 * h41
        h54 = h54 - l52 * h42 - l53 * h43
        l54 = h54 * i4
        row_5 = (l50, l51, l52, l53, l54)
        h55 = h55 - l50 * h50 - l51 * h51
        i5 = 1.0 / (h55 - l52 * h52 - l53 * h53 - l54 * h54)
    return (l10, l20, l21) + row_3 + row_4 + row_5 + (i0, i1, i2, i3, i4, i5)


@kernel(inline=True)
def solve_lower(f, b, free):
    """Forward substitution, L^-1 b for a twist-shaped b."""
    # x_i = b_i - sum_j<i l_ij x_j, in place
    angular, linear = b
    b0, b1, b2 = angular
    b3, b4, b5 = linear
    l10, l20, l21 = f[0:3]
    b1 = b1 - l10 * b0
    b2 = b2 - l20 * b0 - l21 * b1
    if len(free) > 3:
        l30, l31, l32 = f[3:6]
        b3 = b3 - l30 * b0 - l31 * b1
        b3 = b3 - l32 * b2
    if len(free) > 4:
        l40, l41, l42, l43 = f[6:10]
        b4 = b4 - l40 * b0 - l41 * b1
        b4 = b4 - l42 * b2 - l43 * b3
        l50, l51, l52, l53, l54 = f[10:15]
        b5 = b5 - l50 * b0 - l51 * b1
        b5 = b5 - l52 * b2 - l53 * b3
        b5 = b5 - l54 * b4
    return (b0, b1, b2), (b3, b4, b5)


@kernel(inline=True)
def solve_upper(f, b, free):
    """Backward substitution, L^-T b."""
    # x_j = b_j - sum_i>j l_ij x_i, in place
    (b0, b1, b2), (b3, b4, b5) = b
    if len(free) > 4:
        l40, l41, l42, l43 = f[6:10]
        l50, l51, l52, l53, l54 = f[10:15]
        b4 = b4 - l54 * b5
        b3 = b3 - l43 * b4 - l53 * b5
        b2 = b2 - l42 * b4 - l52 * b5
        b1 = b1 - l41 * b4 - l51 * b5
        b0 = b0 - l40 * b4 - l50 * b5
    if len(free) > 3:
        l30, l31, l32 = f[3:6]
        b2 = b2 - l32 * b3
        b1 = b1 - l31 * b3
        b0 = b0 - l30 * b3
    l10, l20, l21 = f[0:3]
    b1 = b1 - l21 * b2
    b0 = b0 - l10 * b1 - l20 * b2
    return (b0, b1, b2), (b3, b4, b5)


@kernel(inline=True)
def scale6(s, x):
    """Component by component product of two twist-shaped tuples."""
    (s0, s1, s2), (s3, s4, s5) = s
    (x0, x1, x2), (x3, x4, x5) = x
    angular = (s0 * x0, s1 * x1, s2 * x2)
    linear = (s3 * x3, s4 * x4, s5 * x5)
    return angular, linear


@kernel(inline=True)
def solve(f, b, free):
    """Solution H^-1 b by the factor of H, L^-T D^-1 L^-1 b."""
    inverse_pivots = f[15:18], f[18:21]
    forward = solve_lower(f, b, free)
    return solve_upper(f, scale6(inverse_pivots, forward), free)


@kernel(inline=True)
def squared_norm(x):
    """Sum of the squares of a twist's or wrench's components."""
    angular, linear = x
    return dot(angular, angular) + dot(linear, linear)


@kernel(inline=True)
def store_factor(field, block, f):
    """Stores a factor in a block of a field."""
    at = block * 21 * LANES
    for i in range(21):
        store(field, at + i * LANES, f[i])


@kernel(inline=True)
def load21(field, block):
    """Symmetric matrix of a block of a field."""
    at = block * 21 * LANES
    first = load3(field, at) + load3(field, at + 3 * LANES)
    second = load3(field, at + 6 * LANES) + load3(field, at + 9 * LANES)
    third = load3(field, at + 12 * LANES) + load3(field, at + 15 * LANES)
    return first + second + third + load3(field, at + 18 * LANES)


@kernel(inline=True)
def row_product(row, x):
    """Scalar product of six numbers and a twist."""
    h0, h1, h2, h3, h4, h5 = row
    angular, linear = x
    x0, x1, x2 = angular
    x3, x4, x5 = linear
    return h0 * x0 + h1 * x1 + h2 * x2 + h3 * x3 + h4 * x4 + h5 * x5


@kernel(inline=True)
def symmetric_product(h, x):
    """Product of a symmetric matrix, a 21-tuple, and a twist."""
    # row i is h_i0 to h_ii, and from there on the column h_ii to h_5i
    h00 = h[0]
    h10, h11 = h[1:3]
    h20, h21, h22 = h[3:6]
    h30, h31, h32, h33 = h[6:10]
    h40, h41, h42, h43, h44 = h[10:15]
    h50, h51, h52, h53, h54, h55 = h[15:21]
    row_0 = (h00, h10, h20, h30, h40, h50)
    row_1 = (h10, h11, h21, h31, h41, h51)
    row_2 = (h20, h21, h22, h32, h42, h52)
    row_3 = (h30, h31, h32, h33, h43, h53)
    row_4 = (h40, h41, h42, h43, h44, h54)
    row_5 = (h50, h51, h52, h53, h54, h55)
    y0 = row_product(row_0, x)
    y1 = row_product(row_1, x)
    y2 = row_product(row_2, x)
    y3 = row_product(row_3, x)
    y4 = row_product(row_4, x)
    y5 = row_product(row_5, x)
    return (y0, y1, y2), (y3, y4, y5)


@kernel(inline=True)
def zero6():
    """Zero twist or wrench of packs."""
    zero = spread(0.0)
    return (zero, zero, zero), (zero, zero, zero)


@kernel(inline=True)
def zero21():
    """Zero symmetric matrix of packs."""
    zero = spread(0.0)
    seven = (zero, zero, zero, zero, zero, zero, zero)
    return seven + seven + seven


@kernel(inline=True)
def scaled_stiffness(h, c):
    """Scaled section stiffness I + C^1/2 h C^1/2."""
    angular, linear = c
    c0, c1, c2 = angular
    c3, c4, c5 = linear
    # h_ij is scaled by c_i c_j, row by row
    row_0 = (1.0 + c0 * c0 * h[0],)
    row_1 = (
        c1 * c0 * h[1],
        1.0 + c1 * c1 * h[2],
    )
    row_2 = (
        c2 * c0 * h[3],
        c2 * c1 * h[4],
        1.0 + c2 * c2 * h[5],
    )
    row_3 = (
        c3 * c0 * h[6],
        c3 * c1 * h[7],
        c3 * c2 * h[8],
        1.0 + c3 * c3 * h[9],
    )
    row_4 = (
        c4 * c0 * h[10],
        c4 * c1 * h[11],
        c4 * c2 * h[12],
        c4 * c3 * h[13],
        1.0 + c4 * c4 * h[14],
    )
    row_5 = (
        c5 * c0 * h[15],
        c5 * c1 * h[16],
        c5 * c2 * h[17],
        c5 * c3 * h[18],
        c5 * c4 * h[19],
        1.0 + c5 * c5 * h[20],
    )
    return row_0 + row_1 + row_2 + row_3 + row_4 + row_5


@kernel(inline=True)
def is_positive(f):
    """Whether every pivot of every lane is positive (false for NaN)."""
    for inverse_pivot in f[15:21]:
        if not largest(-inverse_pivot) < 0.0:
            return False
    return True
