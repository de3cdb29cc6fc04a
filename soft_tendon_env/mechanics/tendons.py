"""One tendon at one pack of points: tangent, wrench column, its share of the section stiffness and of the bias.

A tendon at d = (0, y, z) runs along t_c = k~ d + p + d' (22) and pulls the section with s u, s = S t, S = [d~; I]: with the
project's sign (positive tension pulls) the actuation column is -s, so that Psi = -sum (q/|t_c|) S (I - t t^T) S^T (32).
"""

from soft_tendon_env.compilation import kernel
from soft_tendon_env.mechanics.lanes import LANES, load, sqrt


@kernel(inline=True)
def chord(geometry, at, k, p):
    """t_c = k~ d + p + d'."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    y_prime, z_prime = load(geometry, at + 2 * LANES), load(geometry, at + 3 * LANES)
    return p[0] + k[1] * z - k[2] * y, p[1] - k[0] * z + y_prime, p[2] + k[0] * y + z_prime


@kernel(inline=True)
def unit_tangent(t_c):
    """t = t_c / |t_c| and 1 / |t_c|."""
    inverse = 1.0 / sqrt(t_c[0] * t_c[0] + t_c[1] * t_c[1] + t_c[2] * t_c[2])
    return (t_c[0] * inverse, t_c[1] * inverse, t_c[2] * inverse), inverse


@kernel(inline=True)
def wrench_column(geometry, at, t):
    """s = S t = (d x t, t)."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    return (y * t[2] - z * t[1], z * t[0], -y * t[0]), t


@kernel(inline=True)
def chord_rate(geometry, at, xi_dot):
    """The rate of t_c, S^T xi_dot."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    k, p = xi_dot
    return p[0] + k[1] * z - k[2] * y, p[1] - k[0] * z, p[2] + k[0] * y


@kernel(inline=True)
def add_stiffness(h, geometry, at, w, s):
    """h + w S (I - t t^T) S^T, h and the result 21-tuples; w = q / |t_c|."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    wy, wz = w * y, w * z
    (s0, s1, s2), (s3, s4, s5) = s
    w0, w1, w2, w3, w4, w5 = w * s0, w * s1, w * s2, w * s3, w * s4, w * s5
    return (
        h[0] + (wy * y + wz * z) - w0 * s0,
        h[1] - w1 * s0,
        h[2] + wz * z - w1 * s1,
        h[3] - w2 * s0,
        h[4] - wy * z - w2 * s1,
        h[5] + wy * y - w2 * s2,
        h[6] - w3 * s0,
        h[7] + wz - w3 * s1,
        h[8] - wy - w3 * s2,
        h[9] + w - w3 * s3,
        h[10] - wz - w4 * s0,
        h[11] - w4 * s1,
        h[12] - w4 * s2,
        h[13] - w4 * s3,
        h[14] + w - w4 * s4,
        h[15] + wy - w5 * s0,
        h[16] - w5 * s1,
        h[17] - w5 * s2,
        h[18] - w5 * s3,
        h[19] - w5 * s4,
        h[20] + w - w5 * s5,
    )
