"""Adjoint of the path from commands to tensions over a part of a period: actuators that lag, limit their rate or delay.

The effects' kernels alone are run through the part, in one configuration of it, for the mean tensions in its two halves and the internal
states at its end; forward differences of these by every internal state and command give the cotangents, of all tendons at once where
effects treat every tendon by itself. Tensions stay on the parts of their laws that they are on in that configuration.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.status import FOLLOWS, OK
from soft_tendon_env.mechanics.terms.external_forces import advance_states
from soft_tendon_env.mechanics.terms.transmission import delivered, transmitted
from soft_tendon_env.mechanics.types import Arm, FloatVector, IntVector
from soft_tendon_env.mechanics.workspace import zeros_of

SHARE = 1e-6  # of a number, or of 1, by which it is moved
DISTINCT = 1e-9  # by which commands on their way are told apart: what repeats the one before ends no step of a run
SHORTEST = 1e-9  # of half of a part, what is left of it
MOST = 64  # steps of a run
APART = 1e-3  # by which strains and their rates are moved to see whether internal states follow them


class PathMemory(Struct):
    """Course of the internal states and tensions through a part."""

    start: FloatVector  # (states) where it begins
    command: FloatVector  # (n_a)
    begins: IntVector  # (1) 1 where the command begins with the part
    state: FloatVector  # (states) on the way, at the end after a run
    middle: FloatVector  # (states) after the first half, of the run in the other configuration
    end: FloatVector  # (states) of that run, with which others are compared
    tension: np.ndarray  # (2, n_a) [N] mean of each half
    known: np.ndarray  # (2, n_a) of the run that others are compared with
    force: np.ndarray  # (2, n_a) cotangents of these
    gradient: FloatVector  # (states + n_a) by the inputs: states at the beginning, and commands
    before: FloatVector  # (states + n_a) inputs that are moved
    change: FloatVector  # (n_a + 1) of every tendon, and of states that belong to none
    tendon: IntVector  # (states + n_a) to which an input belongs; -1: it may change all
    group: IntVector  # (states + n_a) of inputs that are moved together; -1: not at all
    groups: int
    step: FloatVector  # (MOST) [s] steps of the reference


def make_path_memory(arm: Arm, state_tendons: IntVector | None) -> PathMemory:
    """Zeroed PathMemory for one arm. state_tendons: (states,) tendon that each internal state belongs to, -1 where none, of effects that
    treat every tendon by itself; None: of others, whose inputs are moved one after the other."""
    states, n_a = arm.effects.state.size, arm.tendons.size
    tendon, group = np.full(states + n_a, -1), np.arange(states + n_a)
    if state_tendons is not None:
        tendon = np.append(state_tendons, np.arange(n_a))
        group = np.array([-1 if own == -1 else np.count_nonzero(tendon[:k] == own) for k, own in enumerate(tendon)])
    return PathMemory(
        tendon=tendon,
        group=group,
        groups=1 + int(group.max()),
        begins=np.zeros(1, dtype=np.int64),
        **zeros_of(
            ((states,), "start state middle end"),
            ((n_a,), "command"),
            ((2, n_a), "tension known force"),
            ((states + n_a,), "gradient before"),
            ((n_a + 1,), "change"),
            ((MOST,), "step"),
        ),
    )


@kernel
def run_path(arm, times, is_reference, scratch, path):
    """Runs internal states from path.start between two times [s]; mean tensions into path.tension. Steps are those of the reference, so
    that results are smooth: it ends them where commands arrive."""
    work, half, place = scratch.work, 0.5 * (times[1] - times[0]), 0
    copy(path.start, path.state)
    for side in range(2):
        mean, left = path.tension[side], half
        mean[:] = 0.0
        while left > SHORTEST * half:
            work.clock[0] = times[0] + (side + 1) * half - left
            begins = place == 0 and path.begins[0] == 1
            acting = delivered(arm.effects, path.command, begins, work.clock[0], path.state, scratch.acting, scratch.until)
            if is_reference:
                step = scratch.until[0] - work.clock[0]
                path.step[place] = step if SHORTEST * half < step < left and place < MOST - 2 else left
            step = path.step[place]
            copy(path.state, work.state)
            add_tension(0.5 * step / half, transmitted(arm, acting, work), mean)
            copy(acting, work.command)
            advance_states(arm, step, work)
            add_tension(0.5 * step / half, transmitted(arm, acting, work), mean)
            copy(work.state, path.state)
            left, place = left - step, place + 1
        if side == 0:
            copy(path.state, path.middle)
    delivered(arm.effects, path.command, False, times[1], path.state, scratch.acting, scratch.until)


@kernel
def add_tension(share, tension, out):
    """Adds a share of the tensions to out (n_a)."""
    for i in range(out.size):
        out[i] += share * tension[i]


@kernel
def begin_path(arm, tape, place, scratch, path):
    """Runs the path of a part, row and part its place, in another configuration than that of the part, for the states in the middle and
    at the end, path.end."""
    row, part = place
    work, tendons = scratch.work, path.command.size
    copy(tape.state[row, part], path.start)
    copy(tape.command[row, part], path.command)
    path.begins[0] = tape.begins[row, part]
    for k in range(path.start.size):
        path.start[k] += DISTINCT * (k // (tendons + 1) % 3 if path.tendon[k] >= 0 else 0.0)
    for i in range(tendons):
        path.command[i] += 3.0 * DISTINCT
    for m in range(work.xi.size):
        work.xi[m] += APART * (1.0 + m % 5)
        work.xi_dot[m] += APART * (1.0 + m % 7)
    run_path(arm, tape.clock[row, part : part + 2], True, scratch, path)
    copy(path.state, path.end)
    path.force[:] = 0.0


@kernel
def path_adjoint(arm, times, scratch, path, state, command):
    """Cotangents `state` (states), in place from the end of a part to its beginning, and those added to `command` (n_a), by path.force, in
    the configuration of scratch.work; a status: FOLLOWS where the states of `begin_path` were others."""
    run_path(arm, times, True, scratch, path)
    for k in range(path.end.size):
        if path.state[k] != path.end[k]:
            return FOLLOWS
    for side in range(2):
        copy(path.tension[side], path.known[side])
    states = path.start.size
    for group in range(path.groups):
        move_inputs(path, group)
        run_path(arm, times, False, scratch, path)
        find_changes(path, state)
        for number in range(path.gradient.size):
            if path.group[number] == group:
                moved, place = input_at(path, number)
                way = moved[place] - path.before[number]
                moved[place] = path.before[number]
                own = path.tendon[number]
                path.gradient[number] = (path.change.sum() if own == -1 else path.change[own]) / way
    for k in range(states):
        state[k] = path.gradient[k]
    for i in range(command.size):
        command[i] += path.gradient[states + i]
    return OK


@kernel
def input_at(path, number):
    """Array and place of an input: an internal state at the beginning, or after all of them a command."""
    states = path.start.size
    return (path.start, number) if number < states else (path.command, number - states)


@kernel
def move_inputs(path, group):
    """Moves all inputs of a group by a small way."""
    for number in range(path.gradient.size):
        if path.group[number] == group:
            moved, place = input_at(path, number)
            path.before[number] = moved[place]
            moved[place] += SHARE * max(abs(moved[place]), 1.0)


@kernel
def find_changes(path, state):
    """Changes that another run of the path makes of every tendon into path.change, weighed by the cotangents of tensions and of states at
    the end."""
    path.change[:] = 0.0
    for side in range(2):
        for i in range(path.command.size):
            path.change[i] += path.force[side, i] * (path.tension[side, i] - path.known[side, i])
    for k in range(path.end.size):
        if state[k] != 0.0:
            path.change[path.tendon[k]] += state[k] * (path.state[k] - path.end[k])
