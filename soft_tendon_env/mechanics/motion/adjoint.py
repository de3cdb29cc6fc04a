"""Adjoint of control periods over rows: cotangents of state and reading after a period to those of
the state before and of commands.

A tape holds where every part of a period began. Backward, a part has the linear map of period_map,
its matrices of one evaluation in the middle of the way. The gradient of the forces that these
matrices leave out is taken along one direction, see force_gradient. Where stiff tendons hang slack
or give way, the evaluation is that at the end, as the integrator has it: between the ends no
tension is that of the motion. There, and where a part is long beside the slowest vibration, it is
integrated anew in pieces, each of which is then a part.

What is read by coordinates has its transposed kinematics. By rates it has the same ones, and by
coordinates besides the derivative of these along the rates, by a difference: body Jacobian and
strain columns are derivatives themselves, so that the order may be changed.
"""

import math
from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import coad_apply, scale_twist
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at
from soft_tendon_env.mechanics.motion.advance import Record, Scheme, advance
from soft_tendon_env.mechanics.motion.batch import Places
from soft_tendon_env.mechanics.motion.extrapolation import evaluate_force
from soft_tendon_env.mechanics.motion.filter_adjoint import (
    FilterMemory,
    begin_filter,
    filter_adjoint,
    make_filter_memory,
)
from soft_tendon_env.mechanics.motion.force_gradient import (
    TOLERANCE,
    GradientMemory,
    force_gradient,
    largest_strain,
    place_beside,
)
from soft_tendon_env.mechanics.motion.period_map import matrices_of_motion, transposed_map
from soft_tendon_env.mechanics.motion.scratch import (
    Tape,
    copy_motion,
    make_tape,
    motion_at,
    tape_part,
)
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.dynamics import sum_columns
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.terms.kinematics import poses, tip_twist
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.tendons import tendon_forces
from soft_tendon_env.mechanics.terms.transmission import tension_slope
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_at,
    add_station_forces,
    add_strain_stress,
    add_tendon_stress,
    add_wrench_stress,
    stress_force,
)
from soft_tendon_env.mechanics.types import Arm, IntVector
from soft_tendon_env.mechanics.workspace import sizes_of, zeros

MOST_PIECES = 16  # of a part
# of a part where tendons are stiff: with one, cosines with differences are 0.86 to 0.99, with two
# 0.93 to 0.99
STIFF_PIECES = 2
SMALL_WAY = 1e-4  # the largest strain, curvatures times the length, of differences along the rates


class Cotangents(Struct):
    """Derivatives of a scalar by the state of every row, in place, by what is read of it, and by
    the commands before it."""

    q: Annotated[np.ndarray, "rows", "n"]
    q_dot: Annotated[np.ndarray, "rows", "n"]
    state: Annotated[np.ndarray, "rows", "states"]  # internal states of the effects
    tip_pose: Annotated[
        np.ndarray, "rows", "6"
    ]  # by a displacement of the tip, a twist in its own frame
    tip_twist: Annotated[np.ndarray, "rows", "6"]
    backbone_position: Annotated[np.ndarray, "rows", "stations", "3"]
    tendon_length: Annotated[np.ndarray, "rows", "n_a"]
    strain: Annotated[np.ndarray, "rows", "sensors", "6"]
    strain_rate: Annotated[np.ndarray, "rows", "sensors", "6"]
    command: Annotated[np.ndarray, "rows", "parts", "n_a"]
    status: IntVector  # (rows), see status: why there is no derivative


def make_cotangents(arm: Arm, places: Places, rows: int, parts: int) -> Cotangents:
    """Zeroed Cotangents for so many rows of an arm, read at these places, and parts of a period."""
    read = {"stations": places.station.size, "sensors": places.sensor.size}
    return zeros(
        Cotangents,
        {**sizes_of(arm), **read, "rows": rows, "parts": parts},
        status=np.zeros(rows, dtype=np.int64),
    )


class AdjointMemory(Struct):
    """Arrays that the adjoint of one row fills besides the scratch of a step."""

    gradient: GradientMemory
    filter: FilterMemory
    tape: Tape  # of one row: a part in pieces, and at last the motion within one
    rate: float  # [1/s] of pieces that resolve the slowest vibration of the scene's arm
    impulse: Annotated[np.ndarray, "2", "n"]  # of forces in the halves of a piece
    still: Annotated[np.ndarray, "n_a"]  # zeros


def make_adjoint_memory(arm: Arm, rate: float) -> AdjointMemory:
    """Zeroed AdjointMemory for one arm. rate: [1/s] of pieces that resolve the slowest
    vibration."""
    sizes, tape = sizes_of(arm), make_tape(arm, 1, MOST_PIECES + 1)
    return zeros(
        AdjointMemory,
        sizes,
        gradient=zeros(GradientMemory, sizes),
        filter=make_filter_memory(arm),
        tape=tape,
        rate=rate,
    )


@kernel
def adjoint_rows(batch, scheme, tape, members, cotangents, scratch, memory):
    """Cotangents of the rows named in `members`, in place: from those of state and reading after a
    period to those of the state before it and of its commands. A row whose step had failed gets
    zeros; cotangents.status (rows) where there is no derivative."""
    for row in members:
        arm, status, failed = struct_at(batch.arm, batch.rows.arm, row), OK, False
        for duration in tape.duration[row]:
            failed = failed or duration < 0.0
        cotangents.command[row, :, :] = 0.0
        if failed:
            for values in (cotangents.q[row], cotangents.q_dot[row], cotangents.state[row]):
                values[:] = 0.0
        else:
            status = read_adjoint(arm, batch.places, tape, cotangents, row, scratch.work, memory)
            rate = memory.rate * arm.rod.root_stiffness[0] / batch.arm.rod.root_stiffness[0]
            for part in range(tape.duration.shape[1] - 1, -1, -1):
                if status == OK:
                    status = part_adjoint(
                        arm, scheme, tape, (row, part), rate, cotangents, scratch, memory
                    )
        cotangents.status[row] = status


@kernel
def part_adjoint(arm, scheme, tape, place, rate, cotangents, scratch, memory):
    """Cotangents from the end of a part to its beginning, and of the command that was held; place:
    row and part; a status. It goes back in as many pieces as its slowest vibration or stiff tendons
    call for."""
    duration, status = tape.duration[place], OK
    if duration == 0.0:
        return OK
    count = min(
        max(STIFF_PIECES if arm.effects.transmission.elastic else 1, math.ceil(duration * rate)),
        MOST_PIECES,
    )
    if count == 1 or not cut_part(arm, scheme, tape, place, count, scratch, memory):
        return piece_adjoint(arm, scheme.method, tape, place, cotangents, place, scratch, memory)
    for piece in range(count - 1, -1, -1):
        if status == OK:
            status = piece_adjoint(
                arm, scheme.method, memory.tape, (0, piece), cotangents, place, scratch, memory
            )
    return status


@kernel
def cut_part(arm, scheme, tape, place, count, scratch, memory):
    """Integrates a part in equal pieces, onto memory.tape; whether it could."""
    row, part = place
    command, pieces = tape.command[row, part : part + 1], memory.tape
    none = Record(tape.q[row, :0], tape.q_dot[row, :0], tape.q[:0])
    copy_motion(motion_at(tape, row, part), motion_at(pieces, 0, 0))
    for piece in range(count):
        begins, motion = piece == 0 and tape.begins[row, part] == 1, motion_at(pieces, 0, piece + 1)
        copy_motion(motion_at(pieces, 0, piece), motion)
        tape_part(pieces, 0, piece, command[0], tape.duration[row, part] / count, begins)
        held, lasting = (
            Scheme(scheme.method, scheme.control, begins),
            pieces.duration[0, piece : piece + 1],
        )
        if (
            advance(arm, held, command, lasting, motion, scheme.control.step, scratch, none).status
            != OK
        ):
            return False
    return True


@kernel(refcount=True)
def motion_within(tape, row, part, share, memory):
    """The motion at a share of a part, between its ends, with its mean acceleration in
    memory.gradient.a."""
    start, end, motion = (
        motion_at(tape, row, part),
        motion_at(tape, row, part + 1),
        motion_at(memory.tape, 0, MOST_PIECES + 1),
    )
    copy_motion(start, motion)
    motion.clock[0] += share * tape.duration[row, part]
    for i in range(motion.q.size):
        motion.q[i] += share * (end.q[i] - start.q[i])
        motion.q_dot[i] += share * (end.q_dot[i] - start.q_dot[i])
        memory.gradient.a[i] = (end.q_dot[i] - start.q_dot[i]) / tape.duration[row, part]
    for m in range(motion.xi.size):
        motion.xi[m] += share * (end.xi[m] - start.xi[m])
    return motion


@kernel
def piece_adjoint(arm, method, tape, piece, cotangents, place, scratch, memory):
    """Cotangents, those of a row and part (`place`), from the end of a piece (row and part of
    `tape`) to its beginning; a status."""
    row, part = piece
    sought_q, sought_v, sought_command = (
        cotangents.q[place[0]],
        cotangents.q_dot[place[0]],
        cotangents.command[place[0], place[1]],
    )
    work, gradient, path, h = scratch.work, memory.gradient, memory.filter, tape.duration[piece]
    times, u, before = (
        tape.clock[row, part : part + 2],
        tape.command[row, part],
        tape.state[row, part],
    )
    is_filtered, is_elastic, begins = (
        arm.effects.transmission.filter >= 0,
        arm.effects.transmission.elastic,
        tape.begins[piece] == 1,
    )
    if is_filtered:
        begin_filter(arm.effects, before, u, times, begins, scratch, path)
        u = path.after[1 if is_elastic else 0]
    motion = motion_within(tape, row, part, 1.0 if is_elastic else 0.5, memory)
    copy(motion.xi, work.xi)
    status = evaluate_force(
        arm, method, u, motion.q, motion.q_dot, motion.state, motion.clock[0], scratch
    )
    if status == OK:
        matrices_of_motion(arm, method, scratch)
        status = transposed_map(scratch.first, h, scratch, sought_q, sought_v, memory.impulse)
    if status != OK:
        return status
    for side in range(2):
        sum_columns(work.Phi, memory.impulse[side], gradient.along)
        tendon_forces(
            arm.rod, arm.tendons, work.share, work.tangent, gradient.along, path.force[side]
        )
        for i in range(u.size):
            path.force[side, i] *= tension_slope(arm.effects.transmission, i, work)
            if not is_filtered:
                sought_command[i] += path.force[side, i]
    for i in range(gradient.w.size):
        gradient.w[i] = memory.impulse[0, i] + memory.impulse[1, i]
    force_gradient(arm, u, motion, h, method.with_inertia, work, gradient)
    for i in range(gradient.w.size):
        sought_q[i] += gradient.by_q[i]
        sought_v[i] += gradient.by_rate[i]
        for j in range(gradient.w.size):
            sought_q[j] += gradient.w[i] * scratch.first.stiffness[i, j]
    if is_filtered:
        filter_adjoint(
            arm.effects, before, times, begins, cotangents.state[place[0]], sought_command, path
        )
    return OK


@kernel
def read_adjoint(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates and rates those of what is read at the end of
    the period; a status."""
    last = tape.q.shape[1] - 1
    q, q_dot, fields = tape.q[row, last], tape.q_dot[row, last], memory.gradient
    copy(tape.xi[row, last], work.xi)
    work.clock[0] = tape.clock[row, last]
    place_base(arm, work)
    if strain_from_guess(arm, q, TOLERANCE, work) >= 0:
        return NO_STRAIN
    strain_columns(arm, memory.still, q, q_dot, work)
    poses(arm.rod, work)
    copy(work.xi, fields.xi)
    copy(work.xi_dot, fields.rate)
    twist, strain_rate = cotangents.tip_twist[row], cotangents.strain_rate[row]
    has_rates = twist.any() or strain_rate.any()
    pull = cotangents.backbone_position[row]
    read_force(arm, places, cotangents.tip_pose[row], pull, cotangents.strain[row], work, fields)
    add_tendon_stress(
        arm.rod, arm.tendons, cotangents.tendon_length[row], work.tangent, fields.field
    )
    if has_rates:  # the twist in the frame of the tip changes as that is turned
        turned = coad_apply(tip_twist(arm.rod, work), as_wrench(twist))
        fields.wrench[:] = 0.0
        add_at(fields.wrench, fields.wrench.size - 5 * LANES - 1, scale_twist(-1.0, turned))
        add_wrench_stress(arm.rod, fields.wrench, work, fields.field)
    stress_force(arm.rod, arm.strain, work, fields.field, fields.middle)
    for i in range(q.size):
        cotangents.q[row, i] += fields.middle[i]
    if not has_rates:
        return OK
    read_force(arm, places, twist, pull[:0], strain_rate, work, fields)
    stress_force(arm.rod, arm.strain, work, fields.field, fields.middle)
    for i in range(q.size):
        cotangents.q_dot[row, i] += fields.middle[i]
    differ_reading(arm, places, tape, cotangents, row, work, memory)
    return OK


@kernel(inline=True)
def as_wrench(x):
    """Numbers (6,) as a wrench."""
    return (x[0], x[1], x[2]), (x[3], x[4], x[5])


@kernel
def read_force(arm, places, wrench, pull, force, work, fields):
    """Stress into fields.field that does the work of a wrench (6) on the tip, of `pull` (stations,
    3), or (0, 3), on the positions of the stations, and of `force` (sensors, 6) on the strains at
    the sensors."""
    fields.wrench[:] = 0.0
    fields.field[:] = 0.0
    add_at(fields.wrench, fields.wrench.size - 5 * LANES - 1, as_wrench(wrench))
    if pull.shape[0] > 0:
        add_station_forces(
            arm.rod.length,
            places.station,
            places.station_distance,
            pull,
            work,
            fields.wrench,
            fields.field,
        )
    add_wrench_stress(arm.rod, fields.wrench, work, fields.field)
    add_strain_stress(arm.rod.length, places.sensor, places.sensor_distance, force, fields.field)


@kernel
def differ_reading(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates those that rates of tip and sensors have: a
    derivative along the rates."""
    wrench, force, out, last = (
        cotangents.tip_twist[row],
        cotangents.strain_rate[row],
        cotangents.q[row],
        tape.q.shape[1] - 1,
    )
    q, q_dot = tape.q[row, last], tape.q_dot[row, last]
    fields, strained = memory.gradient, largest_strain(arm.rod, memory.gradient.rate)
    if not strained > 0.0:
        return
    time = SMALL_WAY / strained
    for i in range(2):
        way = time if i == 0 else -time
        if not place_beside(arm, memory.still, q, q_dot, way, fields.rate, work, fields):
            return
        read_force(arm, places, wrench, cotangents.backbone_position[row, :0], force, work, fields)
        stress_force(arm.rod, arm.strain, work, fields.field, fields.sides[i])
    for j in range(q.size):
        out[j] += (fields.sides[0, j] - fields.sides[1, j]) / (2.0 * time)
