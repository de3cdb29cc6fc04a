"""Adjoint of control periods over rows: cotangents of the state after a period and of its reading to those of the state before and of the
commands.

A tape holds where every part of a period began. Backward, a part has the linear map of period_map, its matrices of one evaluation in the
middle of the way. The gradient of the forces that these matrices leave out is taken along one direction, see force_gradient. Where stiff
tendons hang slack or give way, the evaluation is that at the end, as the integrator has it: between the ends no tension is that of the
motion. There, and where a part is long beside the slowest vibration, it is integrated anew in pieces, each of which is then a part.
"""

import math

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, product
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at
from soft_tendon_env.mechanics.motion.advance import Record, Scheme, advance
from soft_tendon_env.mechanics.motion.batch import Places
from soft_tendon_env.mechanics.motion.filter_adjoint import FilterMemory, begin_filter, filter_adjoint, make_filter_memory
from soft_tendon_env.mechanics.motion.force_gradient import GradientMemory, force_gradient, make_gradient_memory
from soft_tendon_env.mechanics.motion.period_map import PeriodMap, make_period_map, matrices_of_motion, transposed_map
from soft_tendon_env.mechanics.motion.reading_adjoint import read_adjoint
from soft_tendon_env.mechanics.motion.scratch import Motion
from soft_tendon_env.mechanics.motion.stages import evaluate_force
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.motion.tape import Tape, make_tape, tape_border, tape_part
from soft_tendon_env.mechanics.terms.dynamics import combined_columns
from soft_tendon_env.mechanics.terms.tendons import tendon_forces
from soft_tendon_env.mechanics.terms.transmission import tension_slope
from soft_tendon_env.mechanics.types import Arm, FloatVector, IntVector
from soft_tendon_env.mechanics.workspace import zeros_of

MOST_PIECES = 16  # of a part
STIFF_PIECES = 2  # of a part where tendons are stiff: with one, cosines with differences are 0.86 to 0.99, with two 0.93 to 0.99


class Cotangents(Struct):
    """Derivatives of a scalar by the state of every row, in place, by what is read of it, and by the commands before it."""

    q: np.ndarray  # (rows, n)
    q_dot: np.ndarray  # (rows, n)
    state: np.ndarray  # (rows, states) internal states of the effects
    tip_pose: np.ndarray  # (rows, 6) by a displacement of the tip, a twist in its own frame
    tip_twist: np.ndarray  # (rows, 6)
    backbone_position: np.ndarray  # (rows, stations, 3)
    tendon_length: np.ndarray  # (rows, n_a)
    strain: np.ndarray  # (rows, sensors, 6)
    strain_rate: np.ndarray  # (rows, sensors, 6)
    command: np.ndarray  # (rows, parts, n_a)
    status: IntVector  # (rows), see status: why there is no derivative


def make_cotangents(arm: Arm, places: Places, rows: int, parts: int) -> Cotangents:
    """Zeroed Cotangents for so many rows of an arm, read at these places, and parts of a period."""
    n, n_a, sensors = arm.strain.size, arm.tendons.size, places.sensor.size
    return Cotangents(
        **zeros_of(
            ((rows, n), "q q_dot"),
            ((rows, arm.effects.state.size), "state"),
            ((rows, 6), "tip_pose tip_twist"),
            ((rows, places.station.size, 3), "backbone_position"),
            ((rows, n_a), "tendon_length"),
            ((rows, sensors, 6), "strain strain_rate"),
            ((rows, parts, n_a), "command"),
        ),
        status=np.zeros(rows, dtype=np.int64),
    )


class AdjointMemory(Struct):
    """Arrays that the adjoint of one row fills besides the scratch of a step."""

    map: PeriodMap
    gradient: GradientMemory
    filter: FilterMemory
    tape: Tape  # of one row: a part in pieces
    rate: float  # [1/s] of pieces that resolve the slowest vibration of the scene's arm
    share: FloatVector  # (1) of a part, where its matrices are evaluated
    middle: FloatVector  # (n)
    rates: FloatVector  # (n)
    q: FloatVector  # (n) cotangents that go back through a part
    v: FloatVector  # (n)
    impulse: np.ndarray  # (2, n) of forces in the halves of a piece
    xi: FloatVector  # points x 6
    state: FloatVector  # (states)
    clock: FloatVector  # (1)
    lasting: FloatVector  # (1) [s] of a piece
    poses: np.ndarray  # (0, 4, 4) of no samples
    still: np.ndarray  # (n_a) zeros


def make_adjoint_memory(arm: Arm, rate: float) -> AdjointMemory:
    """Zeroed AdjointMemory for one arm. rate: [1/s] of pieces that resolve the slowest vibration."""
    n, n_a, points = arm.strain.size, arm.tendons.size, 2 * arm.rod.length.size
    arrays = zeros_of(
        ((n,), "middle rates q v"),
        ((points * 6,), "xi"),
        ((arm.effects.state.size,), "state"),
        ((1,), "clock share lasting"),
        ((0, 4, 4), "poses"),
        ((n_a,), "still"),
        ((2, n), "impulse"),
    )
    own = {"map": make_period_map(n, 1), "gradient": make_gradient_memory(arm), "filter": make_filter_memory(arm)}
    return AdjointMemory(tape=make_tape(arm, 1, MOST_PIECES), rate=rate, **own, **arrays)


@kernel
def adjoint_rows(batch, scheme, tape, members, cotangents, scratch, memory):
    """Cotangents of the rows named in `members`, in place: from those of state and reading after a period to those of the state before it
    and of its commands. A row whose step had failed gets zeros; cotangents.status (rows) where there is no derivative."""
    for row in members:
        own = struct_at(batch.arm, batch.rows.arm, row)
        part, status = tape.duration.shape[1] - 1, OK
        rate = memory.rate * own.rod.root_stiffness[0] / batch.arm.rod.root_stiffness[0]
        if has_failed(tape.duration[row]):
            for values in (cotangents.q[row], cotangents.q_dot[row], cotangents.state[row]):
                values[:] = 0.0
            cotangents.command[row, :, :] = 0.0
        else:
            status = read_adjoint(own, batch.places, tape, cotangents, row, scratch.work, memory)
            memory.share[0] = 1.0 if own.effects.transmission.elastic else 0.5
            while part >= 0 and status == OK:
                status = part_adjoint(own, scheme, tape, (row, part), rate, cotangents, scratch, memory)
                part -= 1
        cotangents.status[row] = status


@kernel
def has_failed(durations):
    """Whether a step of a row has failed on its way."""
    for duration in durations:
        if duration < 0.0:
            return True
    return False


@kernel
def motion_within(tape, row, part, memory):
    """The motion at memory.share of a part, between its ends, with its mean acceleration in memory.gradient.a."""
    h, q, v, xi, share = tape.duration[row, part], tape.q[row], tape.q_dot[row], tape.xi[row], memory.share[0]
    for i in range(memory.middle.size):
        memory.middle[i] = q[part, i] + share * (q[part + 1, i] - q[part, i])
        memory.rates[i] = v[part, i] + share * (v[part + 1, i] - v[part, i])
        memory.gradient.a[i] = (v[part + 1, i] - v[part, i]) / h
    for m in range(memory.xi.size):
        memory.xi[m] = xi[part, m] + share * (xi[part + 1, m] - xi[part, m])
    copy(tape.state[row, part], memory.state)
    memory.clock[0] = tape.clock[row, part] + share * h
    return Motion(memory.middle, memory.rates, memory.xi, memory.state, memory.clock)


@kernel
def part_adjoint(arm, scheme, tape, place, rate, cotangents, scratch, memory):
    """Cotangents from the end of a part to its beginning, and of the command that was held; place: row and part; a status.

    It goes back in as many pieces as its slowest vibration or stiff tendons call for.
    """
    row, part = place
    duration, command, state = tape.duration[row, part], cotangents.command[row, part], cotangents.state[row]
    command[:] = 0.0
    if duration == 0.0:
        return OK
    copy(cotangents.q[row], memory.q)
    copy(cotangents.q_dot[row], memory.v)
    status, least = OK, STIFF_PIECES if memory.share[0] == 1.0 else 1
    count = min(max(least, math.ceil(duration * rate)), MOST_PIECES)
    if count == 1 or not cut_part(arm, scheme, tape, place, count, scratch, memory):
        status = piece_adjoint(arm, scheme.method, tape, place, state, command, scratch, memory)
    else:
        for back in range(count):
            if status == OK:
                status = piece_adjoint(arm, scheme.method, memory.tape, (0, count - 1 - back), state, command, scratch, memory)
    copy(memory.q, cotangents.q[row])
    copy(memory.v, cotangents.q_dot[row])
    return status


@kernel
def cut_part(arm, scheme, tape, place, count, scratch, memory):
    """Integrates a part in equal pieces, onto memory.tape; whether it could."""
    row, part = place
    command, own, lasting = tape.command[row, part : part + 1], memory.tape, memory.lasting
    none = Record(tape.q[row, :0], tape.q_dot[row, :0], memory.poses)
    motion = Motion(memory.middle, memory.rates, memory.xi, memory.state, memory.clock)
    copy(tape.q[row, part], motion.q)
    copy(tape.q_dot[row, part], motion.q_dot)
    copy(tape.xi[row, part], motion.xi)
    copy(tape.state[row, part], motion.state)
    motion.clock[0] = tape.clock[row, part]
    lasting[0] = tape.duration[row, part] / count
    tape_border(own, 0, 0, motion)
    for piece in range(count):
        begins = piece == 0 and tape.begins[row, part] == 1
        tape_part(own, 0, piece, command[0], lasting[0], begins)
        held = Scheme(scheme.method, scheme.control, begins)
        if advance(arm, held, command, lasting, motion, scheme.control.step, scratch, none).status != OK:
            return False
        tape_border(own, 0, piece + 1, motion)
    return True


@kernel
def piece_adjoint(arm, method, tape, place, state, command, scratch, memory):
    """Cotangents memory.q, memory.v and `state` (states) from the end of a part on a tape to its beginning, in place, and those added to
    `command` (n_a), which was held; place: row and part; a status."""
    row, part = place
    work, gradient, path, h = scratch.work, memory.gradient, memory.filter, tape.duration[row, part]
    times, u, is_filtered = tape.clock[row, part : part + 2], tape.command[row, part], arm.effects.transmission.filter >= 0
    begins = tape.begins[row, part] == 1
    if is_filtered:
        begin_filter(arm.effects, tape.state[row, part], u, times, begins, path)
        u = path.after[0 if memory.share[0] < 1.0 else 1]
    motion = motion_within(tape, row, part, memory)
    copy(motion.xi, work.xi)
    status = evaluate_force(arm, method, u, motion.q, motion.q_dot, motion.state, motion.clock[0], scratch)
    if status != OK:
        return status
    matrices_of_motion(arm, method, scratch)
    status = transposed_map(scratch.first, h, memory.map, memory.q, memory.v, memory.impulse)
    if status != OK:
        return status
    for side in range(2):
        combined_columns(work.Phi, memory.impulse[side], gradient.along)
        tendon_forces(arm.rod, arm.tendons, work.share, work.tangent, gradient.along, path.force[side])
        for i in range(command.size):
            path.force[side, i] *= tension_slope(arm.effects.transmission, i, work)
            if not is_filtered:
                command[i] += path.force[side, i]
    for i in range(gradient.w.size):
        gradient.w[i] = memory.impulse[0, i] + memory.impulse[1, i]
    force_gradient(arm, u, motion, h, method.with_inertia, work, gradient)
    for i in range(memory.q.size):
        memory.q[i] += gradient.by_q[i] + product(scratch.first.stiffness[i], gradient.w)
        memory.v[i] += gradient.by_rate[i]
    if is_filtered:
        filter_adjoint(arm.effects, times, begins, state, command, path)
    return OK
