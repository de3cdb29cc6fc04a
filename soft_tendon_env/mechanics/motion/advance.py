"""Time integration with step size control.

It says which steps are accepted, how long the next one is, and has the samples on the way.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.effects import NO, YES, call
from soft_tendon_env.mechanics.motion.extrapolation import (
    STEP_TOLERANCE,
    Demand,
    Extrapolated,
    extrapolated_step,
    predict_strain,
    step_error,
)
from soft_tendon_env.mechanics.motion.status import (
    COMMAND_QUEUE_FULL,
    INACCURATE,
    NO_STRAIN,
    OK,
    PENETRATED,
)
from soft_tendon_env.mechanics.terms.command_filter import IS_FULL, follow, receive
from soft_tendon_env.mechanics.terms.external_forces import any_of, nodes_of, place_base, remember
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses, tip_pose_of, write_pose
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate
from soft_tendon_env.mechanics.terms.transmission import tendons_transmit

ROUGH = 1e-4  # of its length: the most that a step may err in which the arm touches something
SHORTEST_IMPACT = 2.0**-16  # of the longest step: what is as short may err as any other
# of the longest step: as short as that may steps become where the arm touches something or tendons
# are elastic or rub
SHORTEST_STIFF = 2.0**-20
# columns where effects limit steps: their motion is to be right even where it is small beside the
# tolerance
LEAST_WHEN_LIMITED = 3
SAME = 1e-9  # of a time, by which another one may differ and be the same
DONE = 1e-12  # of a duration, what need not be integrated of it
LEAST_ERROR = 1e-300  # so that none divides by zero


class Control(NamedTuple):
    """Step size control: which steps are accepted, and how long the next one is."""

    step: float  # [s], the longest
    # [m] of error estimate in one step, above which it is tried with more columns, then again with
    # a smaller step
    tolerance: float
    # the step follows the tolerance; otherwise it stays the longest while that works
    adaptive: bool
    smallest: float  # [s], below which to give up
    # [s] over which an error of the rates counts where the arm touches something: an impact's lasts
    horizon: float = 0.0


class Scheme(NamedTuple):
    """Integration method and step size control of a motion."""

    method: Extrapolated
    control: Control
    begins: bool = True  # commands begin with the motion; False: the motion goes on under one


class Progress(NamedTuple):
    """Outcome of an integration: status, counts of steps and evaluations."""

    status: int
    row: int  # of the commands, the one that failed or one past the last
    step: float  # [s] to try next
    steps: int
    rejected: int
    error: float  # [m] sum of the error estimates
    evaluations: int  # those of rejected steps with them


class Limits(NamedTuple):
    """Limits that effects set to the next step."""

    longest: float  # [s]
    touching: bool  # the arm touches something, or is about to


@kernel
def next_step(control, most_columns, step, attempt):
    """Step size to try after an attempt whose error is known.

    What took less than the most columns may be twice as long.
    """
    if not control.adaptive:
        return 2.0 * step
    # the error of k columns grows as the k-th power of the step
    error = max(attempt.error, LEAST_ERROR)
    ratio = control.tolerance / error
    factor = 0.9 * ratio ** (1.0 / attempt.columns)
    least = 2.0 if attempt.columns < most_columns else 0.2
    longer = max(least, factor)
    return step * min(4.0, longer)


@kernel
def while_touching(arm, control):
    """Control of a step where the arm touches something or is about to.

    Its error decides, with fixed steps too. An impact is over in a short step, but the error of the
    rates that it leaves lasts: it counts as the way made in a step of the scene.
    """
    rough = ROUGH * total(arm.rod.length)
    tolerance = min(control.tolerance, rough)
    horizon = control.horizon * tolerance / rough
    return Control(control.step, tolerance, True, control.smallest, horizon)


@phase
def find_longest(arm, motion, q_dot, step, unforeseen, control, scratch):
    """Longest step [s] that effects allow, and what the arm meets, into the scratch.

    It is from the strain of work.strain at rates q_dot (n), which a step has led to, and what the
    arm meets there and on its way there from the motion; into scratch.longest (1) and
    work.collision.
    """
    effects = arm.effects
    work = scratch.work
    inputs = work.inputs
    kinematics = work.kinematics
    before_step = work.collision.before_step
    flags = work.collision.flags
    # poses and twists at the end of the step
    strain_rate(arm, q_dot, work.strain)
    inputs.clock[0] = motion.clock[0] + step
    copy(motion.state, inputs.state)
    place_base(arm, inputs.clock[0], kinematics.base)
    poses(arm.rod, kinematics.base, work.strain.xi, kinematics)
    node_twists(arm.rod, work.strain, kinematics)
    if step == 0.0:
        copy_placement(kinematics, before_step)
    before_step.time[0] = motion.clock[0]
    # effects lower the longest step and raise flags
    scratch.longest[0] = control.step
    flags.tunnelled[0] = YES if unforeseen else NO
    flags.active[0] = NO
    for i in range(effects.count):
        address = effects.limit[i]
        if address != 0:
            nodes = nodes_of(arm, inputs, kinematics, work.loads, work.collision)
            call(address, effects.parameters[i], (nodes, scratch.longest))
    if flags.tunnelled[0] == NO:  # for the next step
        copy_placement(kinematics, before_step)


@kernel
def copy_placement(kinematics, before_step):
    """Keeps poses of nodes and base as those before a step."""
    copy(kinematics.pose, before_step.pose)
    copy(kinematics.base, before_step.base)


@kernel
def settle(arm, arrived, motion, step, touching, control, scratch):
    """Accepts the step that was just taken under what had arrived (n_a).

    The motion becomes its end, with its strain and the internal states of the effects there. A
    status; the motion stays unless that is OK.
    """
    work = scratch.work
    strain = work.strain
    inputs = work.inputs
    predict_strain(arm.strain, scratch.q, scratch.q_last, strain, work.spare.stress)
    if strain_from_guess(arm, scratch.q, STEP_TOLERANCE, strain, work.kinematics) >= 0:
        return NO_STRAIN
    if any_of(arm.effects.limit):
        unforeseen = work.collision.flags.touched[0] == YES and not touching
        find_longest(arm, motion, scratch.v, step, unforeseen, control, scratch)
        if work.collision.flags.tunnelled[0] == YES:
            return PENETRATED
    if inputs.before.size > 0:
        # states from the strain of the motion to that of its end
        strain_rate(arm, scratch.v, strain)
        copy(motion.state, inputs.state)
        copy(motion.xi, inputs.before)
        inputs.since[0] = step
        remember(arm, inputs, strain, work.loads)
        inputs.since[0] = 0.0
        copy(inputs.state, motion.state)
    follow(arm.effects, arrived, step, motion.state)
    copy(scratch.q, motion.q)
    copy(scratch.v, motion.q_dot)
    copy(strain.xi, motion.xi)
    return OK


class Record(NamedTuple):
    """Samples of a motion."""

    q: np.ndarray  # (samples, n)
    q_dot: np.ndarray  # (samples, n)
    tip_pose: np.ndarray  # (samples, 4, 4), identities to begin with


@kernel
def tip_pose(arm, motion, work, out):
    """Tip pose (4, 4) of a motion; the last row of `out` is there already."""
    kinematics = work.kinematics
    xi = work.strain.xi
    time = motion.clock[0]
    copy(motion.xi, xi)
    work.inputs.clock[0] = time
    place_base(arm, time, kinematics.base)
    poses(arm.rod, kinematics.base, xi, kinematics)
    R, r = tip_pose_of(kinematics.pose)
    write_pose(R, r, out)


@kernel
def first_limits(arm, motion, control, scratch):
    """Limits of the first step of a row: none where no effect limits steps."""
    if not any_of(arm.effects.limit):
        return Limits(math.inf, False)
    work = scratch.work
    strain = work.strain
    copy(motion.xi, strain.xi)
    strain_from_guess(arm, motion.q, STEP_TOLERANCE, strain, work.kinematics)
    find_longest(arm, motion, motion.q_dot, 0.0, False, control, scratch)
    active = work.collision.flags.active[0]
    return Limits(scratch.longest[0], active == YES)


@kernel
def step_length(step, rest, limits):
    """Length [s] of a step where one is to be tried and some time is left.

    None remains that is much shorter.
    """
    length = rest if step > rest * (1.0 - SAME) else step
    if limits.longest >= length:
        return length
    if limits.touching:
        return limits.longest
    # equal steps up to the end
    return rest / math.ceil(rest / limits.longest * (1.0 - SAME))


@kernel
def try_step(arm, scheme, motion, length, limits, scratch):
    """Tries one step of a length [s] from the motion under the command in scratch.arrival.

    It returns what was attempted, its status, and the control that it was held to.
    """
    method = scheme.method
    control = scheme.control
    arrived = scratch.arrival.command
    scratch.work.collision.flags.touched[0] = NO
    aim = control
    horizon = length
    if limits.touching and length > SHORTEST_IMPACT * control.step:
        aim = while_touching(arm, control)
        horizon = max(length, aim.horizon)
    least = method.least
    if limits.longest < control.step:
        least = max(least, LEAST_WHEN_LIMITED)
    demand = Demand(aim.tolerance, least, horizon)
    attempt = extrapolated_step(arm, method, demand, arrived, motion, length, scratch)
    status = attempt.status
    if status == OK:
        status = settle(arm, arrived, motion, length, limits.touching, control, scratch)
    return attempt, status, aim


@kernel
def advance_row(arm, scheme, command, duration, motion, progress, scratch):
    """Integrates the motion in place under a command (n_a) for a duration [s].

    progress: of the rows before, and then with this one.
    """
    control = scheme.control
    columns = scheme.method.columns
    status, row, step, steps, rejected, error, evaluations = progress
    flags = scratch.work.collision.flags
    start = motion.clock[0]
    begun = 0.0
    limits = first_limits(arm, motion, control, scratch)
    if not control.adaptive:
        # what a row costs another would make results depend on how an input is cut into calls
        step = control.step
    while begun < duration * (1.0 - DONE):
        begins = scheme.begins and begun == 0.0
        receive(arm.effects, command, begins, motion.clock[0], motion.state, scratch.arrival)
        if scratch.arrival.queue[0] == IS_FULL:
            status = COMMAND_QUEUE_FULL
            break
        rest = min(duration - begun, scratch.arrival.until[0] - motion.clock[0])
        length = step_length(step, rest, limits)
        attempt, status, aim = try_step(arm, scheme, motion, length, limits, scratch)
        evaluations += attempt.evaluations
        if status != OK:
            # again with a shorter step, unless that is too short
            rejected += 1
            touched = flags.touched[0] == YES
            touching = limits.touching or status == PENETRATED or touched
            limits = Limits(limits.longest, touching)
            smaller = length
            if status == INACCURATE and aim.adaptive:
                smaller = next_step(aim, columns, length, attempt)
            step = min(0.5 * length, smaller)
            shortest = control.smallest
            if touching or tendons_transmit(arm):
                shortest = SHORTEST_STIFF * control.step
            if step < shortest:
                break
            continue
        begun += length
        motion.clock[0] = start + begun
        if any_of(arm.effects.limit):
            limits = Limits(scratch.longest[0], flags.active[0] == YES)
        if steps < scratch.taken.shape[0]:
            scratch.taken[steps, 0] = length
            scratch.taken[steps, 1] = attempt.rows
        steps += 1
        error += step_error(arm, attempt, scratch)
        # one that an end has cut says nothing against the step that was planned
        kept = step if length < step and not limits.touching else 0.0
        suggested = next_step(aim, columns, length, attempt)
        step = min(control.step, max(suggested, kept))
    if status == OK:
        row += 1
    return Progress(status, row, step, steps, rejected, error, evaluations)


@kernel
def advance(arm, scheme, commands, durations, motion, step, scratch, record):
    """Integrates the motion in place under every row of commands (rows, n_a).

    Each lasts for its duration (rows) [s], with samples evenly among them, if any. A command is
    held until the next one, and acts as effects deliver and transmit it: as tensions, where there
    are none.
    """
    samples = record.q.shape[0]
    every = commands.shape[0] // max(samples, 1)
    arrival = scratch.arrival
    progress = Progress(OK, 0, step, 0, 0, 0.0, 0)
    for row in range(commands.shape[0]):
        command = commands[row]
        duration = durations[row]
        start = motion.clock[0]
        progress = advance_row(arm, scheme, command, duration, motion, progress, scratch)
        if progress.status != OK:
            return progress
        # a sum over rows: the same however an input is cut into calls
        end = start + duration
        motion.clock[0] = end
        receive(arm.effects, command, False, end, motion.state, arrival)
        if samples > 0 and (row + 1) % every == 0:
            sample = row // every
            copy(motion.q, record.q[sample])
            copy(motion.q_dot, record.q_dot[sample])
            tip_pose(arm, motion, scratch.work, record.tip_pose[sample])
    return progress
