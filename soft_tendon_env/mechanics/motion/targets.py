"""Targets of rows of arms, sampled ahead in tables that move along, and the pose errors to them."""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import dot
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors
from soft_tendon_env.mechanics.types import IntVector


class TargetTable(Struct):
    """Targets of rows at as many steps as there is `room` for, that of a step at its number modulo `room`."""

    pose: np.ndarray  # (rows, room, 4, 4) of the tip
    other: np.ndarray  # (rows, room, size) what else belongs to them, side by side
    ahead: IntVector  # (m) steps ahead at which targets are wanted


@kernel
def targets_ahead(table, step_count, tip_pose, pose, other, error, off):
    """Targets of rows at their step_count (rows,) and ahead of it: poses (rows, m, 4, 4), what else belongs to them (rows, m, size), and
    the twists error (rows, m, 6) to the poses from tip_pose (rows, 4, 4); off (2, rows): distance [m] and angle [rad] to the first."""
    for row in range(step_count.size):
        for j in range(table.ahead.size):
            place = (step_count[row] + table.ahead[j]) % table.pose.shape[1]
            for i in range(4):
                for k in range(4):
                    pose[row, j, i, k] = table.pose[row, place, i, k]
            for i in range(table.other.shape[2]):
                other[row, j, i] = table.other[row, place, i]
    pose_errors(tip_pose, pose, error)
    for row in range(step_count.size):
        r, wanted, twist = tip_pose[row], pose[row, 0], error[row, 0]
        way = wanted[0, 3] - r[0, 3], wanted[1, 3] - r[1, 3], wanted[2, 3] - r[2, 3]
        turn = twist[0], twist[1], twist[2]
        off[0, row], off[1, row] = math.sqrt(dot(way, way)), math.sqrt(dot(turn, turn))
