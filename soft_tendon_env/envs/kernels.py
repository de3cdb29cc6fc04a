"""Compiled kernels of the environments, of all rows at once: targets ahead and pose errors, scaled
observations, reward terms."""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import dot
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors
from soft_tendon_env.mechanics.types import FloatVector, IntVector

EFFORT, SMOOTHNESS = -1, -2  # codes of the reward terms that do not come from a tracking error


class TargetTable(Struct):
    """Targets of rows at as many steps as there is `room` for, that of a step at its number modulo
    `room`."""

    pose: np.ndarray  # (rows, room, 4, 4) of the tip
    other: np.ndarray  # (rows, room, size) twists and what else belongs to them, side by side
    ahead: IntVector  # (m) steps ahead at which targets are wanted


@kernel
def targets_ahead(table, step_count, tip_pose, pose, other, error, off):
    """Targets of rows at their step_count (rows,) and ahead of it: poses (rows, m, 4, 4), what else
    belongs to them (rows, m, size), and the twists error (rows, m, 6) to the poses from tip_pose
    (rows, 4, 4); off (2, rows): distance [m] and angle [rad] to the first."""
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


@kernel
def scale_and_clip(values, scale, bound, out):
    """Values (rows, m) times scale (m,), within ±bound (m,), to out (rows, m) float32."""
    for row in range(values.shape[0]):
        for i in range(values.shape[1]):
            x = values[row, i] * scale[i]
            out[row, i] = (
                -bound[i] if x < -bound[i] else bound[i] if x > bound[i] else x
            )  # nan stays nan


class TermTable(Struct):
    """Terms of a reward and their weights."""

    of: IntVector  # (terms) the number of an error, EFFORT or SMOOTHNESS
    first: IntVector  # (terms + 1) where the scales of each begin
    scale: FloatVector  # the errors that halve the terms, side by side
    weight: FloatVector  # (terms) their shares of all weights
    strongest: FloatVector  # (n_a) the largest commands that are allowed
    most_change: FloatVector  # (n_a) the largest changes of the action: twos


def closeness(error, scale):
    """1 / (1 + (error / scale)^2), of a number or an array."""
    part = error / scale
    return 1.0 / (1.0 + part * part)


_closeness = kernel(inline=True)(closeness)


@kernel
def economy(values, most):
    """1 less the mean square of values (n,) as parts of the largest, most (n,)."""
    total = 0.0
    for i in range(values.size):
        part = values[i] / most[i]
        total += min(part * part, 1.0)  # an actuator's error can exceed the limits
    return 1.0 - total / values.size


@kernel
def reward_terms(table, errors, command, action_change, terms, reward):
    """Terms (terms, rows) and reward (rows,) of errors (rows, errors), commands (rows, n_a) as
    applied and changes of the action."""
    for row in range(reward.size):
        total = 0.0
        for i in range(table.of.size):
            of = table.of[i]
            if of == EFFORT:
                value = economy(command[row], table.strongest)
            elif of == SMOOTHNESS:
                value = economy(action_change[row], table.most_change)
            else:
                value = 0.0
                for k in range(table.first[i], table.first[i + 1]):
                    value += _closeness(errors[row, of], table.scale[k])
                value /= table.first[i + 1] - table.first[i]
            terms[i, row] = value
            total += table.weight[i] * value
        reward[row] = total
