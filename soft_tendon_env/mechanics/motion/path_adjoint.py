"""Adjoint of the path from commands to tensions over a part of a period: actuators that lag, limit their rate or delay.

The effects' kernels alone are run through the part, in the configuration of its middle, for the mean tensions in its two halves and the
internal states at its end; forward differences of these by every internal state and command give the cotangents.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.late_kernels import call_late
from soft_tendon_env.mechanics.motion.status import FOLLOWS, OK
from soft_tendon_env.mechanics.terms.external_forces import advance_states
from soft_tendon_env.mechanics.terms.transmission import delivered, transmitted
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of

SHARE = 1e-6  # of a number, or of 1, by which it is moved
SHORTEST = 1e-9  # of half of a part, what is left of it
MOST = 64  # steps of a run
APART = 1e-3  # by which strains and their rates are moved to see whether internal states follow them


class PathMemory(Struct):
    """Course of the internal states and tensions through a part."""

    start: FloatVector  # (states) where it begins
    command: FloatVector  # (n_a)
    state: FloatVector  # (states) on the way, at the end after a run
    middle: FloatVector  # (states) after the first half
    end: FloatVector  # (states) of the run that others are compared with
    tension: np.ndarray  # (2, n_a) [N] mean of each half
    known: np.ndarray  # (2, n_a) of the run that others are compared with
    force: np.ndarray  # (2, n_a) cotangents of these
    gradient: FloatVector  # (states + n_a)
    step: FloatVector  # (MOST) [s] steps of the reference
    xi: FloatVector  # points x 6
    xi_dot: FloatVector  # points x 6


def make_path_memory(arm: Arm) -> PathMemory:
    """Zeroed PathMemory for one arm."""
    states, n_a, points = arm.effects.state.size, arm.tendons.size, 2 * arm.rod.length.size
    return PathMemory(
        **zeros_of(
            ((states,), "start state middle end"),
            ((n_a,), "command"),
            ((2, n_a), "tension known force"),
            ((states + n_a,), "gradient"),
            ((MOST,), "step"),
            ((points * 6,), "xi xi_dot"),
        )
    )


@kernel
def run_path(arm, times, is_last, is_reference, scratch, path):
    """Runs internal states from path.start between two times [s]; mean tensions into path.tension. What arrives at the end of a period's
    last part has arrived. Steps are those of the reference, so that results are smooth: it ends them where commands arrive."""
    work, half, place = scratch.work, 0.5 * (times[1] - times[0]), 0
    copy(path.start, path.state)
    for side in range(2):
        mean, left = path.tension[side], half
        mean[:] = 0.0
        while left > SHORTEST * half:
            work.clock[0] = times[0] + (side + 1) * half - left
            acting = delivered(arm.effects, path.command, work.clock[0], path.state, scratch.acting, scratch.until)
            if is_reference:
                step = scratch.until[0] - work.clock[0]
                path.step[place] = step if SHORTEST * half < step < left and place < MOST - 2 else left
            step = path.step[place]
            copy(path.state, work.state)
            add_tension(0.5 * step / half, transmitted(arm, acting, work), mean)
            copy(acting, work.command)
            call_late(advance_states, arm.effects.late, (arm, step, work))
            add_tension(0.5 * step / half, transmitted(arm, acting, work), mean)
            copy(work.state, path.state)
            left, place = left - step, place + 1
        if side == 0:
            copy(path.state, path.middle)
    if is_last:
        delivered(arm.effects, path.command, times[1], path.state, scratch.acting, scratch.until)


@kernel
def add_tension(share, tension, out):
    """Adds a share of the tensions to out (n_a)."""
    for i in range(out.size):
        out[i] += share * tension[i]


@kernel
def reference_run(arm, times, is_last, scratch, path):
    """Runs the path as it was, into path.end and path.known; FOLLOWS if its states would be others in another configuration."""
    work = scratch.work
    copy(work.xi, path.xi)
    copy(work.xi_dot, path.xi_dot)
    for m in range(path.xi.size):
        work.xi[m] += APART * (1.0 + m % 5)
        work.xi_dot[m] += APART * (1.0 + m % 7)
    run_path(arm, times, is_last, True, scratch, path)
    copy(path.state, path.end)
    copy(path.xi, work.xi)
    copy(path.xi_dot, work.xi_dot)
    run_path(arm, times, is_last, True, scratch, path)
    status = OK
    for k in range(path.end.size):
        if path.state[k] != path.end[k]:
            status = FOLLOWS
    copy(path.state, path.end)
    for side in range(2):
        copy(path.tension[side], path.known[side])
    return status


@kernel
def path_adjoint(arm, times, is_last, scratch, path, state, command):
    """Cotangents `state` (states), in place from the end of a part to its beginning, and `command` (n_a), by path.force; a status.

    Leaves the states in the middle in path.middle.
    """
    status, states = reference_run(arm, times, is_last, scratch, path), path.start.size
    if status != OK:
        return status
    for number in range(path.gradient.size):
        moved, place = (path.start, number) if number < states else (path.command, number - states)
        before = moved[place]
        way = SHARE * max(abs(before), 1.0)
        moved[place] = before + way
        run_path(arm, times, is_last, False, scratch, path)
        moved[place] = before
        path.gradient[number] = change(path, state) / way
    run_path(arm, times, is_last, False, scratch, path)
    for k in range(states):
        state[k] = path.gradient[k]
    for i in range(command.size):
        command[i] = path.gradient[states + i]
    return OK


@kernel
def change(path, state):
    """Change that another run of the path makes, weighed by the cotangents of tensions and of the states at the end."""
    found = 0.0
    for side in range(2):
        for i in range(path.command.size):
            found += path.force[side, i] * (path.tension[side, i] - path.known[side, i])
    for k in range(path.end.size):
        if state[k] != 0.0:
            found += state[k] * (path.state[k] - path.end[k])
    return found
