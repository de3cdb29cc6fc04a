"""Time integration with step size control: which steps are accepted, how long the next one is, and the samples on the way."""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.effects import call
from soft_tendon_env.mechanics.late_binding import call_late
from soft_tendon_env.mechanics.motion.integrators import STEP_TOLERANCE, Demand, predict_strain, take_step
from soft_tendon_env.mechanics.motion.status import CROWDED, INACCURATE, NO_STRAIN, OK, OVERSHOT
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses, tip_pose_of, write_pose
from soft_tendon_env.mechanics.terms.loads import filled_packs, limits_steps, nodes_of, place_base, stored_energy, stores_energy
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate
from soft_tendon_env.mechanics.terms.transmission import delivered, values_of
from soft_tendon_env.tools.compilation import kernel

SPENT = 0.5  # of its kinetic energy, the most that an arm may spend within one step on what effects store
ROUGH = 1e-3  # of its length: the most that a step may err in which effects store energy
IDLE = 1e-3  # of its length: a motion that covers this in a step is never too much to be stored
SHORTEST_IMPACT = 1.0 / 64.0  # of the longest step: at half of this, what effects store is not looked at

LEAST_WHEN_LIMITED = 3
"""Columns of a step where effects allow none of the longest: their motion is to be right even where it is small beside the tolerance."""


class Control(NamedTuple):
    """Which steps are accepted, and how long the next one is."""

    step: float  # [s], the longest
    tolerance: float  # [m] of error estimate in one step, above which it is tried with more columns, then again with a smaller step
    adaptive: bool  # the step follows the tolerance; otherwise it stays the longest while that works
    smallest: float  # [s], below which to give up
    with_inertia: bool = True  # False for quasi-static motion, which has no kinetic energy to spend


class Progress(NamedTuple):
    """How an integration went."""

    status: int
    row: int  # of the commands, the one that failed or one past the last
    time: float  # [s] reached
    step: float  # [s] to try next
    steps: int
    rejected: int
    error: float  # [m] sum of the error estimates
    evaluations: int  # those of rejected steps with them


@kernel
def next_step(control, most_columns, step, attempt):
    """The step size to try after an attempt whose error is known; what took less than the most columns may be twice as long."""
    if not control.adaptive:
        return 2.0 * step
    factor = 0.9 * (control.tolerance / max(attempt.error, 1e-300)) ** (1.0 / attempt.columns)
    least = 2.0 if attempt.columns < most_columns else 0.2
    return step * min(4.0, max(least, factor))


@kernel
def begin_stored(arm, motion, scratch):
    """The energy that effects store in this motion, for settle()."""
    copy(motion.xi, scratch.work.xi)
    scratch.work.clock[0] = motion.clock[0]
    place_base(arm, scratch.work)
    poses(arm.rod, scratch.work)
    scratch.stored[0] = stored_energy(arm, scratch.work)


@kernel
def compare_stored(arm, motion, step, error, control, scratch):
    """Whether effects store more after the step than the arm could have spent on it, or act in a step that is too rough for them, as an
    impact is for one that is good enough for free motion, in scratch.overshot. Otherwise what they store is kept, as what was before."""
    work, n = scratch.work, motion.q.size
    work.clock[0] = motion.clock[0] + step
    place_base(arm, work)
    poses(arm.rod, work)
    before, after, own = 0.0, 0.0, 0.0
    for i in range(n):
        for j in range(n):
            before += 0.5 * motion.q_dot[i] * work.M[i, j] * motion.q_dot[j]
            after += 0.5 * scratch.v[i] * work.M[i, j] * scratch.v[j]
        own += work.drive[i] * (scratch.q[i] - motion.q[i])
    length = total(arm.rod.length)
    idle = IDLE * length / control.step
    spent = SPENT * max(before, after) + max(own, 0.0) + 0.5 * arm.rod.mass[0] * idle * idle
    stored = stored_energy(arm, work)
    acts = stored > 0.0 or scratch.stored[0] > 0.0 or filled_packs(work.node_stiffness, 21 * LANES)[1] > 0
    too_much = (control.with_inertia and stored - scratch.stored[0] > spent) or (acts and error > ROUGH * length)
    too_much = too_much and 0.5 * step >= max(control.smallest, SHORTEST_IMPACT * control.step)
    scratch.overshot[0] = 1.0 if too_much else 0.0
    if not too_much:
        scratch.stored[0] = stored


@kernel
def find_longest(arm, q_dot, time, state, scratch):
    """Longest steps [s] that effects allow from, and to, the strain of work.xi at rates q_dot (n), into scratch.longest (2)."""
    effects, work = arm.effects, scratch.work
    strain_rate(arm, q_dot, work)
    work.clock[0] = time
    copy(state, work.state)
    place_base(arm, work)
    poses(arm.rod, work)
    node_twists(arm.rod, work)
    scratch.longest[:] = math.inf
    for i in range(effects.count):
        if effects.limit[i] != 0:
            call(effects.limit[i], (values_of(effects, i), nodes_of(arm, work, i), scratch.longest))


@kernel
def begin_limits(arm, motion, scratch):
    """The longest steps from a motion, for advance()."""
    copy(motion.xi, scratch.work.xi)
    strain_from_guess(arm, motion.q, STEP_TOLERANCE, scratch.work)
    find_longest(arm, motion.q_dot, motion.clock[0], motion.state, scratch)


@kernel
def settle(arm, motion, step, error, control, scratch):
    """Make the step that was just taken the motion, with its strain; a status, and the motion as it was unless that is OK."""
    work = scratch.work
    predict_strain(arm.strain, scratch.q, scratch.q_last, work)
    if strain_from_guess(arm, scratch.q, STEP_TOLERANCE, work) >= 0:
        return NO_STRAIN
    if stores_energy(arm.effects):
        call_late(compare_stored, (arm, motion, step, error, control, scratch))
        if scratch.overshot[0] != 0.0:
            return OVERSHOT
    if limits_steps(arm.effects):
        call_late(find_longest, (arm, scratch.v, motion.clock[0] + step, scratch.state, scratch))
        if step > scratch.longest[1]:
            return OVERSHOT
    copy(scratch.q, motion.q)
    copy(scratch.v, motion.q_dot)
    copy(work.xi, motion.xi)
    copy(scratch.state, motion.state)
    return OK


class Record(NamedTuple):
    """Samples of a motion."""

    q: np.ndarray  # (samples, n)
    q_dot: np.ndarray  # (samples, n)
    tip_pose: np.ndarray  # (samples, 4, 4), identities to begin with


@kernel
def sample(arm, motion, work, index, record):
    """Write the motion and its tip pose as one sample."""
    copy(motion.q, record.q[index])
    copy(motion.q_dot, record.q_dot[index])
    tip_pose(arm, motion, work, record.tip_pose[index])


@kernel
def tip_pose(arm, motion, work, out):
    """Tip pose (4, 4) of a motion; the last row of `out` is there already."""
    copy(motion.xi, work.xi)
    work.clock[0] = motion.clock[0]
    place_base(arm, work)
    poses(arm.rod, work)
    R, r = tip_pose_of(work.pose)
    write_pose(R, r, out)


@kernel
def advance(arm, method, control, commands, durations, motion, step, scratch, record):
    """Integrate the motion in place under every row of commands (rows, n_a) for its duration (rows) [s], with samples evenly among them,
    if any. A command is held until the next one, and acts as effects deliver and transmit it: as tensions, where there are none."""
    every = commands.shape[0] // max(record.q.shape[0], 1)
    time, steps, rejected, total_error, evaluations = 0.0, 0, 0, 0.0, 0
    for row in range(commands.shape[0]):
        duration, begun, start = durations[row], 0.0, motion.clock[0]
        if stores_energy(arm.effects):
            call_late(begin_stored, (arm, motion, scratch))
        limited, longest = limits_steps(arm.effects), math.inf
        if limited:
            call_late(begin_limits, (arm, motion, scratch))
            longest = scratch.longest[0]
        if not control.adaptive:
            step = control.step  # what a row costs another would make results depend on how an input is cut into calls
        while begun < duration * (1.0 - 1e-12):
            u = delivered(arm.effects, commands[row], motion.clock[0], motion.state, scratch.acting, scratch.until)
            if scratch.until[0] < 0.0:
                return Progress(CROWDED, row, time + begun, step, steps, rejected, total_error, evaluations)
            rest = min(duration - begun, scratch.until[0] - motion.clock[0])
            length = rest if step > rest * (1.0 - 1e-9) else step
            if longest < length:
                length = rest / math.ceil(rest / longest * (1.0 - 1e-9))
            least = max(method.least, LEAST_WHEN_LIMITED) if longest < control.step else method.least
            attempt = take_step(arm, method, Demand(control.tolerance, least), u, motion, length, scratch)
            evaluations += attempt.evaluations
            status = attempt.status
            if status == OK:
                status = settle(arm, motion, length, attempt.error, control, scratch)
            if status != OK:
                rejected += 1
                smaller = next_step(control, method.columns, length, attempt) if status == INACCURATE and control.adaptive else length
                step = min(0.5 * length, smaller)
                if step < control.smallest:
                    return Progress(status, row, time + begun, step, steps, rejected, total_error, evaluations)
                continue
            begun += length
            motion.clock[0] = start + begun
            if limited:
                longest = scratch.longest[0]
            steps += 1
            total_error += attempt.error
            step = min(control.step, max(next_step(control, method.columns, length, attempt), step if length < step else 0.0))
        time += duration
        motion.clock[0] = start + duration  # a sum over rows: the same however an input is cut into calls
        if record.q.shape[0] > 0 and (row + 1) % every == 0:
            sample(arm, motion, scratch.work, row // every, record)
    return Progress(OK, commands.shape[0], time, step, steps, rejected, total_error, evaluations)
