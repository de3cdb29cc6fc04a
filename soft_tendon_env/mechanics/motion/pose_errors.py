"""Pose errors on SE(3): twists log(g^-1 g_bar) from poses g to others g_bar.

It also has their derivative, and poses moved along twists.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import (
    angle_coefficients,
    columns_of,
    dexp_inverse_transposed_apply,
    log_se3,
    matmul,
    minus,
    pose_step,
    rotate_back,
    scale_twist,
    twist_of,
    write_twist,
)
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.kinematics import matrix_pose, write_pose


@kernel
def pose_errors(pose, goal, out):
    """Twists out (rows, m, 6), log(g^-1 g_bar), from poses to goals.

    They carry the poses g (rows, 4, 4) to the goals g_bar (rows, m, 4, 4).
    """
    for row in range(pose.shape[0]):
        R, r = matrix_pose(pose, row)
        x_axis, y_axis, z_axis = columns_of(R)
        R_transposed = x_axis + y_axis + z_axis
        for j in range(goal.shape[1]):
            R_bar, r_bar = matrix_pose(goal[row], j)
            turn = matmul(R_transposed, R_bar)
            away = rotate_back(R, minus(r_bar, r))
            error = log_se3(turn, away)
            write_twist(error, out[row, j])


@kernel
def pose_error_cotangents(error, cotangent, pose, goal):
    """Cotangents (rows, m, 6) of body twists of the poses and of the goals.

    They come from the twists of pose_errors() and cotangents of those.

    A goal that moves along y changes the error x by T_-x^-1 y, a pose that does by -T_x^-1 y, with
    the inverse tangent operator T_x^-1.
    """
    for row in range(error.shape[0]):
        for j in range(error.shape[1]):
            x = twist_of(error[row, j])
            force = twist_of(cotangent[row, j])
            c = angle_coefficients(x)
            by_pose = dexp_inverse_transposed_apply(x, c, 1.0, force)
            write_twist(scale_twist(-1.0, by_pose), pose[row, j])
            by_goal = dexp_inverse_transposed_apply(x, c, -1.0, force)
            write_twist(by_goal, goal[row, j])


@kernel
def move_poses(pose, twist, out):
    """Poses out (rows, m, 4, 4), g exp(x), of poses g (rows, 4, 4) and twists x (rows, m, 6).

    They undo pose_errors().
    """
    for row in range(pose.shape[0]):
        R, r = matrix_pose(pose, row)
        for j in range(twist.shape[1]):
            moved = out[row, j]
            x = twist_of(twist[row, j])
            R_moved, r_moved = pose_step(R, r, x)
            write_pose(R_moved, r_moved, moved)
            copy(pose[row, 3], moved[3])
