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
from soft_tendon_env.mechanics.algebra.lie import coad_apply, scale_twist, twist_of
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at
from soft_tendon_env.mechanics.effects import IntArray
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
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses, tip_twist_of
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.tendon_friction import tendons_rub
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
from soft_tendon_env.mechanics.types import Arm
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
    # by a displacement of the tip, a twist in its own frame
    tip_pose: Annotated[np.ndarray, "rows", "6"]
    tip_twist: Annotated[np.ndarray, "rows", "6"]
    backbone_position: Annotated[np.ndarray, "rows", "stations", "3"]
    tendon_length: Annotated[np.ndarray, "rows", "n_a"]
    strain: Annotated[np.ndarray, "rows", "sensors", "6"]
    strain_rate: Annotated[np.ndarray, "rows", "sensors", "6"]
    command: Annotated[np.ndarray, "rows", "parts", "n_a"]
    status: Annotated[IntArray, "rows"]  # see status: why there is no derivative


def make_cotangents(arm: Arm, places: Places, rows: int, parts: int) -> Cotangents:
    """Zeroed Cotangents for so many rows of an arm, read at these places, and parts of a period."""
    sizes = sizes_of(arm)
    sizes["rows"] = rows
    sizes["parts"] = parts
    sizes["stations"] = places.station.size
    sizes["sensors"] = places.sensor.size
    return zeros(Cotangents, sizes)


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
    return zeros(
        AdjointMemory,
        sizes_of(arm),
        filter=make_filter_memory(arm),
        tape=make_tape(arm, 1, MOST_PIECES + 1),
        rate=rate,
    )


@kernel
def has_failed(duration):
    """Whether a part of a period (parts) [s] has failed: durations are negative there."""
    for part in duration:
        if part < 0.0:
            return True
    return False


@kernel
def adjoint_rows(batch, scheme, tape, members, cotangents, scratch, memory):
    """Cotangents of the rows named in `members`, in place: from those of state and reading after a
    period to those of the state before it and of its commands. A row whose step had failed gets
    zeros; cotangents.status (rows) where there is no derivative."""
    stiffness = batch.arm.rod.root_stiffness[0]
    for row in members:
        arm = struct_at(batch.arm, batch.rows.arm, row)
        cotangents.command[row, :, :] = 0.0
        if has_failed(tape.duration[row]):
            cotangents.q[row, :] = 0.0
            cotangents.q_dot[row, :] = 0.0
            cotangents.state[row, :] = 0.0
            cotangents.status[row] = OK
            continue
        status = read_adjoint(arm, batch.places, tape, cotangents, row, scratch.work, memory)
        # a stiffer arm vibrates faster
        rate = memory.rate * arm.rod.root_stiffness[0] / stiffness
        for part in range(tape.duration.shape[1] - 1, -1, -1):
            if status == OK:
                place = (row, part)
                status = part_adjoint(arm, scheme, tape, place, rate, cotangents, scratch, memory)
        cotangents.status[row] = status


@kernel
def part_adjoint(arm, scheme, tape, place, rate, cotangents, scratch, memory):
    """Cotangents from the end of a part to its beginning, and of the command that was held; place:
    row and part; a status. It goes back in as many pieces as its slowest vibration or stiff tendons
    call for."""
    method = scheme.method
    duration = tape.duration[place]
    if duration == 0.0:
        return OK
    least = STIFF_PIECES if arm.effects.transmission.elastic else 1
    count = min(max(least, math.ceil(duration * rate)), MOST_PIECES)
    if count == 1 or not cut_part(arm, scheme, tape, place, count, scratch, memory):
        return piece_adjoint(arm, method, tape, place, cotangents, place, scratch, memory)
    pieces = memory.tape
    for piece in range(count - 1, -1, -1):
        piece_at = (0, piece)
        status = piece_adjoint(arm, method, pieces, piece_at, cotangents, place, scratch, memory)
        if status != OK:
            return status
    return OK


@kernel
def cut_part(arm, scheme, tape, place, count, scratch, memory):
    """Integrates a part in equal pieces, onto memory.tape; whether it could."""
    row, part = place
    pieces = memory.tape
    command = tape.command[row, part : part + 1]
    step = scheme.control.step
    duration_of_piece = tape.duration[row, part] / count
    begins_with_part = tape.begins[row, part] == 1
    none = Record(tape.q[row, :0], tape.q_dot[row, :0], tape.q[:0])
    start = motion_at(tape, row, part)
    copy_motion(start, motion_at(pieces, 0, 0))
    for piece in range(count):
        before = motion_at(pieces, 0, piece)
        motion = motion_at(pieces, 0, piece + 1)
        copy_motion(before, motion)
        begins = piece == 0 and begins_with_part
        tape_part(pieces, 0, piece, command[0], duration_of_piece, begins)
        held = Scheme(scheme.method, scheme.control, begins)
        duration = pieces.duration[0, piece : piece + 1]
        progress = advance(arm, held, command, duration, motion, step, scratch, none)
        if progress.status != OK:
            return False
    return True


@kernel(refcount=True)
def motion_within(tape, row, part, share, memory):
    """The motion at a share of a part, between its ends, with its mean acceleration in
    memory.gradient.a."""
    duration = tape.duration[row, part]
    start = motion_at(tape, row, part)
    end = motion_at(tape, row, part + 1)
    motion = motion_at(memory.tape, 0, MOST_PIECES + 1)
    copy_motion(start, motion)
    motion.clock[0] += share * duration
    for i in range(motion.q.size):
        way = end.q[i] - start.q[i]
        change = end.q_dot[i] - start.q_dot[i]
        motion.q[i] += share * way
        motion.q_dot[i] += share * change
        memory.gradient.a[i] = change / duration
    for m in range(motion.xi.size):
        strained = end.xi[m] - start.xi[m]
        motion.xi[m] += share * strained
    return motion


@kernel
def piece_adjoint(arm, method, tape, piece, cotangents, place, scratch, memory):
    """Cotangents, those of a row and part (`place`), from the end of a piece (row and part of
    `tape`) to its beginning; a status."""
    row, part = piece
    work = scratch.work
    effects = arm.effects
    gradient = memory.gradient
    filter_memory = memory.filter
    h = tape.duration[piece]
    times = tape.clock[row, part : part + 2]
    command = tape.command[row, part]
    before = tape.state[row, part]
    begins = tape.begins[piece] == 1
    by_q = cotangents.q[place[0]]
    by_rate = cotangents.q_dot[place[0]]
    by_command = cotangents.command[place]
    is_elastic = effects.transmission.elastic
    is_filtered = effects.transmission.filter >= 0
    # the command that acts in the middle of the piece, or where tendons are elastic at its end
    if is_filtered:
        begin_filter(effects, before, command, times, begins, scratch, filter_memory)
        command = filter_memory.after[1 if is_elastic else 0]
    share = 1.0 if is_elastic else 0.5
    motion = motion_within(tape, row, part, share, memory)
    copy(motion.xi, work.strain.xi)
    time = motion.clock[0]
    status = evaluate_force(
        arm, method, command, motion.q, motion.q_dot, motion.state, time, scratch
    )
    # back through the linear map, to cotangents of held forces
    if status == OK:
        matrices_of_motion(arm, method, scratch)
        status = transposed_map(scratch.first, h, scratch, by_q, by_rate, memory.impulse)
    if status != OK:
        return status
    tension_cotangents(arm, work, memory)
    if not is_filtered:
        for i in range(command.size):
            by_command[i] += filter_memory.force[0, i] + filter_memory.force[1, i]
    # what the map leaves out: derivatives of the forces at the motion
    for i in range(gradient.w.size):
        gradient.w[i] = memory.impulse[0, i] + memory.impulse[1, i]
    force_gradient(arm, command, motion, h, method.with_inertia, work, gradient)
    add_gradient(gradient, scratch.first.matrices.G, by_q, by_rate)
    if is_filtered:
        state = cotangents.state[place[0]]
        filter_adjoint(effects, before, times, begins, state, by_command, filter_memory)
    return OK


@kernel
def add_gradient(gradient, G, by_q, by_rate):
    """Adds the gradient of the forces to cotangents of coordinates and rates, less that of the
    stiffness -G, which the linear map has."""
    w = gradient.w
    for i in range(w.size):
        by_q[i] += gradient.by_q[i]
        by_rate[i] += gradient.by_rate[i]
        for j in range(w.size):
            by_q[j] += w[i] * G[i, j]


@kernel
def tension_cotangents(arm, work, memory):
    """Cotangents of the mean commands in the halves of a piece, into memory.filter.force: B^T times
    those of the held forces, through what is between commands and tensions."""
    strain = work.strain
    along = memory.gradient.along
    path = arm.effects.transmission
    for side in range(2):
        force = memory.filter.force[side]
        sum_columns(strain.Phi, memory.impulse[side], along)
        share = work.friction.share if tendons_rub(arm) else work.ones.tendon
        tendon_forces(arm.rod, arm.tendons, share, strain.tangent, along, force)
        for i in range(force.size):
            force[i] *= tension_slope(path, i, work.tendons)


@kernel
def read_adjoint(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates and rates those of what is read at the end of
    the period; a status."""
    last = tape.q.shape[1] - 1
    q = tape.q[row, last]
    q_dot = tape.q_dot[row, last]
    strain = work.strain
    kinematics = work.kinematics
    fields = memory.gradient
    # strain, columns and poses at the end of the period
    copy(tape.xi[row, last], strain.xi)
    work.inputs.clock[0] = tape.clock[row, last]
    place_base(arm, work.inputs.clock[0], kinematics.base)
    if strain_from_guess(arm, q, TOLERANCE, strain, kinematics) >= 0:
        return NO_STRAIN
    strain_columns(arm, memory.still, q, q_dot, strain, kinematics)
    poses(arm.rod, kinematics.base, strain.xi, kinematics)
    copy(strain.xi, fields.xi)
    copy(strain.xi_dot, fields.rate)
    # by coordinates
    twist = cotangents.tip_twist[row]
    strain_rate = cotangents.strain_rate[row]
    has_rates = twist.any() or strain_rate.any()
    pull = cotangents.backbone_position[row]
    tip = cotangents.tip_pose[row]
    lengths = cotangents.tendon_length[row]
    read_force(arm, places, tip, pull, cotangents.strain[row], work, fields)
    add_tendon_stress(arm.rod, arm.tendons, lengths, strain.tangent, fields.field)
    if has_rates:
        # the twist in the frame of the tip changes as that is turned
        node_twists(arm.rod, strain, kinematics)
        turned = coad_apply(tip_twist_of(kinematics.eta), twist_of(twist))
        fields.wrench[:] = 0.0
        add_at(fields.wrench, tip_index(fields.wrench), scale_twist(-1.0, turned))
        add_wrench_stress(arm.rod, fields.wrench, strain.xi, kinematics, fields.field)
    add_stress_force(arm, strain.Phi, fields, cotangents.q[row])
    if not has_rates:
        return OK
    # by rates, and by coordinates the derivative of that along the rates
    read_force(arm, places, twist, pull[:0], strain_rate, work, fields)
    add_stress_force(arm, strain.Phi, fields, cotangents.q_dot[row])
    differ_reading(arm, places, tape, cotangents, row, work, memory)
    return OK


@kernel
def add_stress_force(arm, Phi, fields, out):
    """Adds the generalised force of the stress fields.field to out (n)."""
    force = fields.middle
    stress_force(arm.rod, arm.strain, Phi, fields.field, force)
    for i in range(out.size):
        out[i] += force[i]


@kernel(inline=True)
def tip_index(field):
    """Index of the last node's first component in a field over nodes."""
    return field.size - 5 * LANES - 1


@kernel
def read_force(arm, places, wrench, pull, force, work, fields):
    """Stress into fields.field that does the work of a wrench (6) on the tip, of `pull` (stations,
    3), or (0, 3), on the positions of the stations, and of `force` (sensors, 6) on the strains at
    the sensors."""
    xi = work.strain.xi
    kinematics = work.kinematics
    length = arm.rod.length
    at_nodes = fields.wrench
    stress = fields.field
    at_nodes[:] = 0.0
    stress[:] = 0.0
    add_at(at_nodes, tip_index(at_nodes), twist_of(wrench))
    if pull.shape[0] > 0:
        stations = (places.station, places.station_distance)
        add_station_forces(arm.rod, stations, pull, xi, kinematics, at_nodes, stress)
    add_wrench_stress(arm.rod, at_nodes, xi, kinematics, stress)
    add_strain_stress(length, places.sensor, places.sensor_distance, force, stress)


@kernel
def differ_reading(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates those that rates of tip and sensors have: a
    derivative along the rates."""
    last = tape.q.shape[1] - 1
    q = tape.q[row, last]
    q_dot = tape.q_dot[row, last]
    fields = memory.gradient
    still = memory.still
    wrench = cotangents.tip_twist[row]
    force = cotangents.strain_rate[row]
    no_pull = cotangents.backbone_position[row, :0]
    strained = largest_strain(arm.rod, fields.rate)
    if not strained > 0.0:
        return
    time = SMALL_WAY / strained
    for i in range(2):
        way = time if i == 0 else -time
        if not place_beside(arm, still, q, q_dot, way, fields.rate, work, fields):
            return
        read_force(arm, places, wrench, no_pull, force, work, fields)
        stress_force(arm.rod, arm.strain, work.strain.Phi, fields.field, fields.sides[i])
    out = cotangents.q[row]
    after = fields.sides[0]
    before = fields.sides[1]
    for j in range(q.size):
        out[j] += (after[j] - before[j]) / (2.0 * time)
