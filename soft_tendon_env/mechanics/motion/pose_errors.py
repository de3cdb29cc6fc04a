"""Pose errors on SE(3): twists log(g^-1 g_bar) from actual to wanted poses, their derivative, and
poses moved along twists."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import (
    coad_apply,
    coefficients,
    cross,
    dot,
    exp_se3,
    log_se3,
    matmul,
    minus,
    plus,
    rotate,
    rotate_back,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.kinematics import write_pose


@kernel(inline=True)
def pose_at(poses, row):
    """(R, r) of one of the poses (rows, 4, 4)."""
    g = poses[row]
    return (g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1], g[2, 2]), (
        g[0, 3],
        g[1, 3],
        g[2, 3],
    )


@kernel
def pose_errors(pose, wanted, out):
    """The twists out (rows, m, 6), log(g^-1 g_bar), that carry the poses g (rows, 4, 4) to the
    wanted ones g_bar (rows, m, 4, 4)."""
    for row in range(pose.shape[0]):
        R, r = pose_at(pose, row)
        R_transposed = R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]
        for j in range(wanted.shape[1]):
            R_bar, r_bar = pose_at(wanted[row], j)
            k, p = log_se3(matmul(R_transposed, R_bar), rotate_back(R, minus(r_bar, r)))
            for i in range(3):
                out[row, j, i] = k[i]
                out[row, j, 3 + i] = p[i]


@kernel
def pose_error_cotangents(error, cotangent, pose, wanted):
    """Cotangents (rows, m, 6) of body twists of the poses and of the wanted ones, from the twists
    of pose_errors() and cotangents of those.

    A wanted pose that moves along y changes the error x by T_-x^-1 y, a pose that does by -T_x^-1
    y, with the inverse tangent operator T_x^-1 = I - ad/2 + e ad^2 of dual numbers x, e = -a1 / (2
    a) as in log_se3(): exact near 0, finite at an angle of pi.
    """
    for row in range(error.shape[0]):
        for j in range(error.shape[1]):
            x, w = error[row, j], cotangent[row, j]
            Omega, force = (
                ((x[0], x[1], x[2]), (x[3], x[4], x[5])),
                ((w[0], w[1], w[2]), (w[3], w[4], w[5])),
            )
            k = Omega[0]
            c = coefficients(dot(k, k))
            e, e_dual = -0.5 * c.a1 / c.a, 0.5 * (c.a1 * c.a1 / c.a - c.a2) / c.a * dot(k, Omega[1])
            once = coad_apply(Omega, force)
            even = twist_sum(force, scale_twist(e, coad_apply(Omega, once)))
            moment, odd = (
                plus(even[0], times(e_dual, cross(k, cross(k, force[1])))),
                scale_twist(0.5, once),
            )
            for i in range(3):
                pose[row, j, i], pose[row, j, 3 + i] = (
                    -moment[i] - odd[0][i],
                    -even[1][i] - odd[1][i],
                )
                wanted[row, j, i], wanted[row, j, 3 + i] = (
                    moment[i] - odd[0][i],
                    even[1][i] - odd[1][i],
                )


@kernel
def move_poses(pose, twist, out):
    """Poses out (rows, m, 4, 4), g exp(x), of poses g (rows, 4, 4) and twists x (rows, m, 6): what
    undoes pose_errors()."""
    for row in range(pose.shape[0]):
        R, r = pose_at(pose, row)
        for j in range(twist.shape[1]):
            x = twist[row, j]
            Omega = (x[0], x[1], x[2]), (x[3], x[4], x[5])
            R_move, r_move = exp_se3(Omega, coefficients(dot(Omega[0], Omega[0])))
            write_pose(matmul(R, R_move), plus(r, rotate(R, r_move)), out[row, j])
            copy(pose[row, 3], out[row, j, 3])
