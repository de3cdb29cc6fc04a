"""Batches of arms, the rows: each has an arm and a motion of its own, and the same compiled code
takes them one after another.

What a row does depends on nothing but that row, so it is the same bit for bit whatever other rows
there are, and any row may be stepped on any thread with any scratch.
"""

from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import aligned_copy
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at
from soft_tendon_env.mechanics.motion.advance import Record, Scheme, advance
from soft_tendon_env.mechanics.motion.equilibrium import ROUND_OFF
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE
from soft_tendon_env.mechanics.motion.scratch import Motion, tape_border, tape_part
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at, receive
from soft_tendon_env.mechanics.terms.external_forces import place_base, rest_states
from soft_tendon_env.mechanics.terms.kinematics import (
    poses,
    poses_inside,
    strains_inside,
    tip_pose_of,
    tip_twist,
    write_pose,
)
from soft_tendon_env.mechanics.terms.parametrisation import (
    strain_from_guess,
    strain_from_rest,
    strain_has_margin,
    strain_rate,
)
from soft_tendon_env.mechanics.terms.tendons import tendon_lengths
from soft_tendon_env.mechanics.terms.transmission import actuator_tensions
from soft_tendon_env.mechanics.types import Arm, FloatVector, IntVector
from soft_tendon_env.mechanics.workspace import sizes_of, zeros


class Rows(Struct):
    """Motion of every row, see Motion, and the address of its arm."""

    q: np.ndarray  # (rows, n)
    q_dot: np.ndarray  # (rows, n)
    xi: np.ndarray  # (rows, points x 6)
    state: np.ndarray  # (rows, states) internal states of the effects
    clock: np.ndarray  # (rows, 1) time [s]
    arm: IntVector  # (rows) addresses of the arms, all of one type
    step: FloatVector  # (rows) [s] to try next, where steps follow a tolerance


class Places(Struct):
    """Places along the rod at which poses and strains are read: interval and distance [m] from its
    start."""

    station: IntVector
    station_distance: FloatVector
    sensor: IntVector
    sensor_distance: FloatVector


class Reading(Struct):
    """Measurements of every row, or of every sample of given motions."""

    tip_pose: Annotated[np.ndarray, "rows", "4", "4"]  # identities to begin with
    tip_twist: Annotated[np.ndarray, "rows", "6"]
    tendon_length: Annotated[np.ndarray, "rows", "n_a"]
    backbone: Annotated[np.ndarray, "rows", "stations", "4", "4"]  # identities to begin with
    strain: Annotated[np.ndarray, "rows", "sensors", "6"]
    strain_rate: Annotated[np.ndarray, "rows", "sensors", "6"]
    tension: Annotated[
        np.ndarray, "rows", "n_a"
    ]  # [N] at the actuators, where effects are between commands and tensions


def make_reading(arm: Arm, places: Places, rows: int) -> Reading:
    """A Reading of zeros and identities."""
    sizes = {
        **sizes_of(arm),
        "rows": rows,
        "stations": places.station.size,
        "sensors": places.sensor.size,
    }
    reading = zeros(Reading, sizes)
    reading.tip_pose[:], reading.backbone[:] = np.eye(4), np.eye(4)
    return reading


class Outcome(Struct):
    """Outcome of the last step of every row."""

    status: IntVector  # (rows), see status
    rejected: IntVector  # (rows) steps tried again at a smaller size


class Batch(Struct):
    """The arm of a scene and its rows."""

    arm: Arm
    places: Places
    rows: Rows
    outcome: Outcome
    reading: Reading


def make_batch(arm: Arm, places: Places, motion: Motion, step: float, count: int) -> Batch:
    """Batch of so many rows of one arm in one motion, read at these places; step: [s] to try
    next."""
    fields = {
        name: aligned_copy(np.tile(values, (count, 1))) for name, values in motion._asdict().items()
    }
    rows = Rows(arm=np.full(count, arm.address), step=np.full(count, step), **fields)
    outcome = Outcome(
        status=np.zeros(count, dtype=np.int64), rejected=np.zeros(count, dtype=np.int64)
    )
    return Batch(
        arm=arm, places=places, rows=rows, outcome=outcome, reading=make_reading(arm, places, count)
    )


@kernel
def read(arm, places, q_dot, work, row, reading):
    """Measures a row into `reading` at the time of work.clock, where strain_from_guess() or
    strain_from_rest() has just left the strain."""
    strain_rate(arm, q_dot, work)
    place_base(arm, work)
    poses(arm.rod, work)
    R, r = tip_pose_of(work.pose)
    w, v = tip_twist(arm.rod, work)
    write_pose(R, r, reading.tip_pose[row])
    for i in range(3):
        reading.tip_twist[row, i] = w[i]
        reading.tip_twist[row, 3 + i] = v[i]
    tendon_lengths(arm.rod, arm.tendons, work, reading.tendon_length[row])
    poses_inside(
        arm.rod.length, places.station, places.station_distance, work, reading.backbone[row]
    )
    strains_inside(
        arm.rod.length, places.sensor, places.sensor_distance, work.xi, reading.strain[row]
    )
    strains_inside(
        arm.rod.length, places.sensor, places.sensor_distance, work.xi_dot, reading.strain_rate[row]
    )


@kernel
def step_rows(batch, scheme, members, commands, durations, scratch, tape):
    """Advances the rows named in `members` under commands (rows, parts, n_a), each for its duration
    (rows, parts) [s], and reads them.

    scheme.begins: whether the command of the first part begins with it; those of the others do. A
    row whose step fails keeps its last good motion. The tape keeps where every part began, unless
    it has no rows.
    """
    rows, work, acting = batch.rows, scratch.work, scratch.acting
    for row in members:
        arm = struct_at(batch.arm, rows.arm, row)
        motion = Motion(
            rows.q[row], rows.q_dot[row], rows.xi[row], rows.state[row], rows.clock[row]
        )
        advance_parts(arm, scheme, commands, durations, motion, row, (batch, tape), scratch)
        if (
            batch.outcome.status[row] != OK or total(durations[row]) == 0.0
        ):  # otherwise settle() has just left the motion's strain
            copy(motion.xi, work.xi)
            strain_from_guess(arm, motion.q, STEP_TOLERANCE, work)
        work.clock[0] = motion.clock[0]
        if arm.effects.count > 0:
            receive(
                arm.effects,
                commands[row, -1],
                False,
                motion.clock[0],
                motion.state,
                acting,
                scratch.until,
            )
            command = command_at(arm.effects, acting, motion.state, 0.0, scratch.command)
            copy(actuator_tensions(arm, command, work), batch.reading.tension[row])
        read(arm, batch.places, motion.q_dot, work, row, batch.reading)


@kernel
def advance_parts(arm, scheme, commands, durations, motion, row, results, scratch):
    """Advances the motion of a row part by part, with its outcome, and keeps on the tape where each
    begins; results: batch and tape."""
    batch, tape = results
    rows, outcome, none = (
        batch.rows,
        batch.outcome,
        Record(batch.rows.q[:0], batch.rows.q_dot[:0], batch.reading.tip_pose[:0]),
    )
    outcome.status[row], outcome.rejected[row] = OK, 0
    for part in range(commands.shape[1]):
        held = Scheme(scheme.method, scheme.control, scheme.begins or part > 0)
        tape_border(tape, row, part, motion)
        done = advance(
            arm,
            held,
            commands[row, part : part + 1],
            durations[row, part : part + 1],
            motion,
            rows.step[row],
            scratch,
            none,
        )
        rows.step[row] = done.step
        outcome.status[row] = done.status
        outcome.rejected[row] += done.rejected
        tape_part(
            tape,
            row,
            part,
            commands[row, part],
            durations[row, part] if done.status == OK else -1.0,
            held.begins,
        )
        if done.status != OK:
            break
    tape_border(tape, row, commands.shape[1], motion)


@kernel
def place_rows(batch, members, commands, work):
    """Finds strains at the coordinates of the rows in `members`, from rest, where commands (rows,
    n_a) have always held, and reads them."""
    rows, outcome = batch.rows, batch.outcome
    for row in members:
        arm = struct_at(batch.arm, rows.arm, row)
        outcome.status[row] = (
            OK if strain_from_rest(arm, rows.q[row], ROUND_OFF, work)[0] < 0 else NO_STRAIN
        )
        outcome.rejected[row], rows.clock[row, 0], work.clock[0] = 0, 0.0, 0.0
        copy(work.xi, rows.xi[row])
        read(arm, batch.places, rows.q_dot[row], work, row, batch.reading)
        rest_states(arm, commands[row], work)
        copy(work.state, rows.state[row])


@kernel
def read_samples(arm, places, q, q_dot, members, work, reading, good):
    """Reads given motions q, q_dot (samples, n) at the samples named in `members`; good (samples):
    whether there is a strain, sought from rest: what is read depends on q and q_dot alone. A sample
    without a strain keeps what stood in `reading`."""
    work.clock[0] = 0.0
    for i in members:
        good[i] = strain_from_rest(arm, q[i], STEP_TOLERANCE, work)[0] < 0
        if good[i]:
            read(arm, places, q_dot[i], work, i, reading)


@kernel
def are_firm(arm, q, members, work, firm):
    """Whether coordinates have a firm strain, see parametrisation: firm (samples) of q (samples,
    n), for the samples named in `members`."""
    for i in members:
        firm[i] = strain_has_margin(arm, q[i], STEP_TOLERANCE, work)


@kernel
def read_backbones(arm, places, xi, work, out):
    """Poses out (samples, stations, 4, 4) of strain fields xi (samples, points x 6) from work.base;
    out holds identities to begin with."""
    for i in range(xi.shape[0]):
        copy(xi[i], work.xi)
        poses(arm.rod, work)
        poses_inside(arm.rod.length, places.station, places.station_distance, work, out[i])
