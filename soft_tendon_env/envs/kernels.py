"""Compiled kernels of the environments, of all rows at once.

They are targets ahead and pose errors, scaled observations and reward terms.
"""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import dot
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors
from soft_tendon_env.mechanics.types import FloatVector, IntVector

EFFORT = -1
"""Code of the reward term of the commands, in place of the number of a tracking error."""

SMOOTHNESS = -2
"""Code of the reward term of changes of the action, likewise."""


class TargetTable(Struct):
    """Targets of rows at `room` steps that follow one another.

    The target of a step stands at the number of the step modulo `room`.
    """

    pose: np.ndarray  # (rows, room, 4, 4) of the tip
    other: np.ndarray  # (rows, room, size) twists and what else belongs to them, side by side
    ahead: IntVector  # (m) steps ahead at which targets are read


@kernel
def targets_ahead(table, step_count, tip_pose, pose, other, error, offset):
    """Targets of rows at their step_count (rows,) and ahead of it, and the tips' errors to them.

    Writes poses (rows, m, 4, 4), what else belongs to them `other` (rows, m, size), the twists
    `error` (rows, m, 6) to the poses from tip_pose (rows, 4, 4), and `offset` (2, rows), distance
    [m] and angle [rad] to the first.
    """
    room = table.pose.shape[1]
    for row in range(step_count.size):
        for j in range(table.ahead.size):
            place = (step_count[row] + table.ahead[j]) % room
            for i in range(4):
                for k in range(4):
                    pose[row, j, i, k] = table.pose[row, place, i, k]
            for i in range(table.other.shape[2]):
                other[row, j, i] = table.other[row, place, i]
    pose_errors(tip_pose, pose, error)
    for row in range(step_count.size):
        tip = tip_pose[row]
        target = pose[row, 0]
        twist = error[row, 0]
        x = target[0, 3] - tip[0, 3]
        y = target[1, 3] - tip[1, 3]
        z = target[2, 3] - tip[2, 3]
        way = x, y, z
        turn = twist[0], twist[1], twist[2]
        offset[0, row] = math.sqrt(dot(way, way))
        offset[1, row] = math.sqrt(dot(turn, turn))


@kernel
def scale_and_clip(values, scale, bound, out):
    """Values (rows, m) times scale (m,), within ±bound (m,), to out (rows, m) float32."""
    for row in range(values.shape[0]):
        for i in range(values.shape[1]):
            limit = bound[i]
            scaled = values[row, i] * scale[i]
            # comparisons with nan are false, so that nan stays nan
            if scaled < -limit:
                scaled = -limit
            elif scaled > limit:
                scaled = limit
            out[row, i] = scaled


class TermTable(Struct):
    """Terms of a reward and their weights."""

    source: IntVector  # (terms) the number of an error, EFFORT or SMOOTHNESS
    first: IntVector  # (terms + 1) where the scales of each begin
    scale: FloatVector  # the errors that halve the terms, side by side
    weight: FloatVector  # (terms) their shares of all weights
    strongest: FloatVector  # (n_a) the largest commands that are allowed
    most_change: FloatVector  # (n_a) the largest changes of the action: twos


def closeness(error, scale):
    """Reward of an error, 1 / (1 + (error / scale)^2), of a number or an array."""
    part = error / scale
    return 1.0 / (1.0 + part * part)


_closeness = kernel(inline=True)(closeness)


@kernel
def economy(values, most):
    """1 less the mean square of values (n,) as parts of the largest, most (n,)."""
    total = 0.0
    for i in range(values.size):
        part = values[i] / most[i]
        square = part * part
        total += min(square, 1.0)  # an actuator's error can exceed the limits
    return 1.0 - total / values.size


@kernel(inline=True)
def mean_closeness(error, scale, first, end):
    """Mean of an error's closeness at the scales from `first` on and before `end`."""
    total = 0.0
    for k in range(first, end):
        total += _closeness(error, scale[k])
    return total / (end - first)


@kernel
def reward_terms(table, errors, command, action_change, terms, reward):
    """Terms (terms, rows) and reward (rows,) of every row.

    They follow from errors (rows, errors), commands (rows, n_a) as applied and changes of the
    action.
    """
    for row in range(reward.size):
        total = 0.0
        for i in range(table.source.size):
            source = table.source[i]
            if source == EFFORT:
                value = economy(command[row], table.strongest)
            elif source == SMOOTHNESS:
                value = economy(action_change[row], table.most_change)
            else:
                first = table.first[i]
                end = table.first[i + 1]
                value = mean_closeness(errors[row, source], table.scale, first, end)
            terms[i, row] = value
            total += table.weight[i] * value
        reward[row] = total
