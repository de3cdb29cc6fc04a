"""Time integration with step size control: which steps are accepted, how long the next one is, and
the samples on the way."""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.effects import call
from soft_tendon_env.mechanics.motion.extrapolation import (
    STEP_TOLERANCE,
    Demand,
    Extrapolated,
    extrapolated_step,
    predict_strain,
)
from soft_tendon_env.mechanics.motion.status import (
    COMMAND_QUEUE_FULL,
    INACCURATE,
    NO_STRAIN,
    OK,
    PENETRATED,
)
from soft_tendon_env.mechanics.terms.command_filter import follow, receive
from soft_tendon_env.mechanics.terms.external_forces import any_of, nodes_of, place_base, remember
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses, tip_pose_of, write_pose
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate

ROUGH = 1e-4  # of its length: the most that a step may err in which the arm touches something
SHORTEST_IMPACT = 2.0**-16  # of the longest step: what is as short may err as any other
SHORTEST_STIFF = (
    2.0**-20
    # of the longest step: as short as that may steps become where the arm touches something or
    # tendons are elastic
)
# columns where effects limit steps: their motion is to be right even where it is small beside the
# tolerance
LEAST_WHEN_LIMITED = 3


class Control(NamedTuple):
    """Step size control: which steps are accepted, and how long the next one is."""

    step: float  # [s], the longest
    # [m] of error estimate in one step, above which it is tried with more columns, then again with
    # a smaller step
    tolerance: float
    adaptive: (
        bool  # the step follows the tolerance; otherwise it stays the longest while that works
    )
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


@kernel
def next_step(control, most_columns, step, attempt):
    """Step size to try after an attempt whose error is known; what took less than the most columns
    may be twice as long."""
    if not control.adaptive:
        return 2.0 * step
    factor = 0.9 * (control.tolerance / max(attempt.error, 1e-300)) ** (1.0 / attempt.columns)
    least = 2.0 if attempt.columns < most_columns else 0.2
    return step * min(4.0, max(least, factor))


@kernel
def while_touching(arm, control):
    """Control of a step where the arm touches something or is about to: its error decides, with
    fixed steps too. An impact is over in a short step, but the error of the rates that it leaves
    lasts: it counts as the way made in a step of the scene."""
    rough = ROUGH * total(arm.rod.length)
    tolerance = min(control.tolerance, rough)
    return Control(
        control.step, tolerance, True, control.smallest, control.horizon * tolerance / rough
    )


@phase
def find_longest(arm, motion, q_dot, step, unforeseen, control, scratch):
    """Longest step [s] that effects allow from the strain of work.xi at rates q_dot (n), which a
    step has led to, and what the arm meets there and on its way there from the motion; into
    scratch.longest (1) and work.contact."""
    effects, work = arm.effects, scratch.work
    strain_rate(arm, q_dot, work)
    work.clock[0] = motion.clock[0] + step
    copy(motion.state, work.state)
    place_base(arm, work)
    poses(arm.rod, work)
    node_twists(arm.rod, work)
    if step == 0.0:
        copy(work.pose, work.before_step.pose)
        copy(work.base, work.before_step.base)
    work.before_step.time[0] = motion.clock[0]
    scratch.longest[0] = control.step
    work.contact.tunnelled[0], work.contact.active[0] = 1.0 if unforeseen else 0.0, 0.0
    for i in range(effects.count):
        if effects.limit[i] != 0:
            call(effects.limit[i], effects.parameters[i], (nodes_of(arm, work), scratch.longest))
    if work.contact.tunnelled[0] == 0.0:  # for the next step
        copy(work.pose, work.before_step.pose)
        copy(work.base, work.before_step.base)


@kernel
def settle(arm, u, motion, step, touching, control, scratch):
    """Accepts the step that was just taken under what had arrived, u (n_a): the motion becomes its
    end, with its strain and the internal states of the effects there. A status; the motion stays
    unless that is OK."""
    work = scratch.work
    predict_strain(arm.strain, scratch.q, scratch.q_last, work)
    if strain_from_guess(arm, scratch.q, STEP_TOLERANCE, work) >= 0:
        return NO_STRAIN
    if any_of(arm.effects.limit):
        find_longest(
            arm,
            motion,
            scratch.v,
            step,
            work.contact.touched[0] != 0.0 and not touching,
            control,
            scratch,
        )
        if work.contact.tunnelled[0] != 0.0:
            return PENETRATED
    if work.before.size > 0:
        strain_rate(arm, scratch.v, work)
        copy(motion.state, work.state)
        copy(motion.xi, work.before)
        work.since[0] = step
        remember(arm, work)
        work.since[0] = 0.0
        copy(work.state, motion.state)
    follow(arm.effects, u, step, motion.state)
    copy(scratch.q, motion.q)
    copy(scratch.v, motion.q_dot)
    copy(work.xi, motion.xi)
    return OK


class Record(NamedTuple):
    """Samples of a motion."""

    q: np.ndarray  # (samples, n)
    q_dot: np.ndarray  # (samples, n)
    tip_pose: np.ndarray  # (samples, 4, 4), identities to begin with


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
def advance(arm, scheme, commands, durations, motion, step, scratch, record):
    """Integrates the motion in place under every row of commands (rows, n_a) for its duration
    (rows) [s], with samples evenly among them, if any. A command is held until the next one, and
    acts as effects deliver and transmit it: as tensions, where there are none."""
    method, control, begins = scheme
    every, limited, contact = (
        commands.shape[0] // max(record.q.shape[0], 1),
        any_of(arm.effects.limit),
        scratch.work.contact,
    )
    steps, rejected, total_error, evaluations = 0, 0, 0.0, 0
    for row in range(commands.shape[0]):
        duration, begun, start, longest, touching = (
            durations[row],
            0.0,
            motion.clock[0],
            math.inf,
            False,
        )
        if limited:
            copy(motion.xi, scratch.work.xi)
            strain_from_guess(arm, motion.q, STEP_TOLERANCE, scratch.work)
            find_longest(arm, motion, motion.q_dot, 0.0, False, control, scratch)
            longest, touching = scratch.longest[0], contact.active[0] != 0.0
        if not control.adaptive:
            # what a row costs another would make results depend on how an input is cut into calls
            step = control.step
        while begun < duration * (1.0 - 1e-12):
            u = scratch.acting
            receive(
                arm.effects,
                commands[row],
                begins and begun == 0.0,
                motion.clock[0],
                motion.state,
                u,
                scratch.until,
            )
            if scratch.until[0] == -math.inf:
                return Progress(
                    COMMAND_QUEUE_FULL, row, step, steps, rejected, total_error, evaluations
                )
            rest = min(duration - begun, scratch.until[0] - motion.clock[0])
            length = rest if step > rest * (1.0 - 1e-9) else step
            if longest < length:
                length = longest if touching else rest / math.ceil(rest / longest * (1.0 - 1e-9))
            impact = touching and length > SHORTEST_IMPACT * control.step
            contact.touched[0] = 0.0
            aim = while_touching(arm, control) if impact else control
            horizon = max(length, aim.horizon) if impact else length
            least = (
                max(method.least, LEAST_WHEN_LIMITED) if longest < control.step else method.least
            )
            attempt = extrapolated_step(
                arm, method, Demand(aim.tolerance, least, horizon), u, motion, length, scratch
            )
            evaluations += attempt.evaluations
            status = (
                settle(arm, u, motion, length, touching, control, scratch)
                if attempt.status == OK
                else attempt.status
            )
            if status != OK:
                rejected += 1
                touching = touching or status == PENETRATED or contact.touched[0] != 0.0
                smaller = (
                    next_step(aim, method.columns, length, attempt)
                    if status == INACCURATE and aim.adaptive
                    else length
                )
                step = min(0.5 * length, smaller)
                if step < (
                    SHORTEST_STIFF * control.step
                    if touching or arm.effects.transmission.elastic
                    else control.smallest
                ):
                    return Progress(status, row, step, steps, rejected, total_error, evaluations)
                continue
            begun += length
            motion.clock[0] = start + begun
            if limited:
                longest, touching = scratch.longest[0], contact.active[0] != 0.0
            if steps < scratch.taken.shape[0]:
                scratch.taken[steps, 0], scratch.taken[steps, 1] = length, attempt.rows
            steps += 1
            total_error += attempt.error
            kept = step if length < step and not touching else 0.0
            step = min(control.step, max(next_step(aim, method.columns, length, attempt), kept))
        motion.clock[0] = (
            start + duration
        )  # a sum over rows: the same however an input is cut into calls
        receive(
            arm.effects,
            commands[row],
            False,
            motion.clock[0],
            motion.state,
            scratch.acting,
            scratch.until,
        )
        if record.q.shape[0] > 0 and (row + 1) % every == 0:
            copy(motion.q, record.q[row // every])
            copy(motion.q_dot, record.q_dot[row // every])
            tip_pose(arm, motion, scratch.work, record.tip_pose[row // every])
    return Progress(OK, commands.shape[0], step, steps, rejected, total_error, evaluations)
