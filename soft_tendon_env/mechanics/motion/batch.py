"""Batches of arms, the rows: each has an arm and a motion of its own.

The same compiled code takes them one after another.

What a row does depends on nothing but that row, so it is the same bit for bit whatever other rows
there are, and any row may be stepped on any thread with any scratch.
"""

from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import aligned_copy
from soft_tendon_env.mechanics.algebra.lie import write_twist
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at
from soft_tendon_env.mechanics.effects import IntArray
from soft_tendon_env.mechanics.motion.advance import Record, Scheme, advance
from soft_tendon_env.mechanics.motion.equilibrium import ROUND_OFF
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE
from soft_tendon_env.mechanics.motion.scratch import Motion, tape_border, tape_part
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at, receive
from soft_tendon_env.mechanics.terms.external_forces import place_base, rest_states
from soft_tendon_env.mechanics.terms.kinematics import (
    node_twists,
    poses,
    poses_inside,
    strains_inside,
    tip_pose_of,
    tip_twist_of,
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
    """Places along the rod at which poses and strains are read.

    They are an interval and the distance [m] from its start.
    """

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
    # [N] that act at the actuators, which is the command where nothing is between; of samples,
    # which have no command, 0
    tension: Annotated[np.ndarray, "rows", "n_a"]


def make_reading(arm: Arm, places: Places, rows: int) -> Reading:
    """A Reading of zeros and identities."""
    sizes = sizes_of(arm)
    sizes["rows"] = rows
    sizes["stations"] = places.station.size
    sizes["sensors"] = places.sensor.size
    reading = zeros(Reading, sizes)
    reading.tip_pose[:] = np.eye(4)
    reading.backbone[:] = np.eye(4)
    return reading


class Outcome(Struct):
    """Outcome of the last step of every row."""

    status: Annotated[IntArray, "rows"]  # see status
    rejected: Annotated[IntArray, "rows"]  # steps tried again at a smaller size


class Batch(Struct):
    """The arm of a scene and its rows."""

    arm: Arm
    places: Places
    rows: Rows
    outcome: Outcome
    reading: Reading


def make_batch(arm: Arm, places: Places, motion: Motion, step: float, count: int) -> Batch:
    """Batch of so many rows of one arm in one motion, read at these places.

    step: [s] to try next.
    """
    fields = {}
    for name, values in motion._asdict().items():
        fields[name] = aligned_copy(np.tile(values, (count, 1)))
    arms = np.full(count, arm.address)
    steps = np.full(count, step)
    rows = Rows(arm=arms, step=steps, **fields)
    outcome = zeros(Outcome, {"rows": count})
    reading = make_reading(arm, places, count)
    return Batch(arm=arm, places=places, rows=rows, outcome=outcome, reading=reading)


@kernel
def read(arm, places, q_dot, work, row, reading):
    """Measures a row into `reading` at the time of work.inputs, but for the tension.

    strain_from_guess() or strain_from_rest() has just left the strain.
    """
    rod = arm.rod
    strain = work.strain
    kinematics = work.kinematics
    strain_rate(arm, q_dot, strain)
    place_base(arm, work.inputs.clock[0], kinematics.base)
    poses(rod, kinematics.base, strain.xi, kinematics)
    node_twists(rod, strain, kinematics)
    R, r = tip_pose_of(kinematics.pose)
    write_pose(R, r, reading.tip_pose[row])
    write_twist(tip_twist_of(kinematics.eta), reading.tip_twist[row])
    tendon_lengths(rod, arm.tendons, strain.xi, reading.tendon_length[row])
    poses_inside(
        rod.length,
        places.station,
        places.station_distance,
        strain.xi,
        kinematics,
        reading.backbone[row],
    )
    sensors = places.sensor
    distance = places.sensor_distance
    strains_inside(rod.length, sensors, distance, strain.xi, reading.strain[row])
    strains_inside(rod.length, sensors, distance, strain.xi_dot, reading.strain_rate[row])


@kernel
def read_tension(arm, command, motion, scratch, tension):
    """Tensions (n_a) at the actuators in a motion whose strain is in the workspace.

    They are under the last command (n_a) that was given.
    """
    work = scratch.work
    arrival = scratch.arrival
    receive(arm.effects, command, False, motion.clock[0], motion.state, arrival)
    arrived = arrival.command
    acting = command_at(arm.effects, arrived, motion.state, 0.0, scratch.acting)
    at_actuators = actuator_tensions(arm, acting, work.strain.xi, work.tendons)
    copy(at_actuators, tension)


@kernel
def step_rows(batch, scheme, members, commands, durations, scratch, tape):
    """Advances the rows named in `members` under commands (rows, parts, n_a), and reads them.

    Each command lasts for its duration (rows, parts) [s].

    scheme.begins: whether the command of the first part begins with it; those of the others do. A
    row whose step fails keeps its last good motion. The tape keeps where every part began, unless
    it has no rows.
    """
    rows = batch.rows
    work = scratch.work
    reading = batch.reading
    for row in members:
        arm = struct_at(batch.arm, rows.arm, row)
        motion = Motion(
            rows.q[row],
            rows.q_dot[row],
            rows.xi[row],
            rows.state[row],
            rows.clock[row],
        )
        advance_parts(arm, scheme, commands, durations, motion, row, (batch, tape), scratch)
        has_moved = batch.outcome.status[row] == OK and total(durations[row]) != 0.0
        if not has_moved:  # otherwise settle() has just left the motion's strain
            copy(motion.xi, work.strain.xi)
            strain_from_guess(arm, motion.q, STEP_TOLERANCE, work.strain, work.kinematics)
        work.inputs.clock[0] = motion.clock[0]
        read_tension(arm, commands[row, -1], motion, scratch, reading.tension[row])
        read(arm, batch.places, motion.q_dot, work, row, reading)


@kernel
def advance_parts(arm, scheme, commands, durations, motion, row, results, scratch):
    """Advances the motion of a row part by part, and keeps on the tape where each begins.

    It has its outcome; results: batch and tape.
    """
    batch, tape = results
    rows = batch.rows
    outcome = batch.outcome
    none = Record(rows.q[:0], rows.q_dot[:0], batch.reading.tip_pose[:0])
    outcome.status[row] = OK
    outcome.rejected[row] = 0
    for part in range(commands.shape[1]):
        begins = scheme.begins or part > 0
        held = Scheme(scheme.method, scheme.control, begins)
        command = commands[row, part : part + 1]
        duration = durations[row, part : part + 1]
        step = rows.step[row]
        tape_border(tape, row, part, motion)
        progress = advance(arm, held, command, duration, motion, step, scratch, none)
        rows.step[row] = progress.step
        outcome.status[row] = progress.status
        outcome.rejected[row] += progress.rejected
        lasted = duration[0] if progress.status == OK else -1.0
        tape_part(tape, row, part, command[0], lasted, begins)
        if progress.status != OK:
            break
    tape_border(tape, row, commands.shape[1], motion)


@kernel
def place_rows(batch, members, commands, work):
    """Finds strains at the coordinates of the rows in `members`, from rest, and reads them.

    Commands (rows, n_a) have always held the arms there.
    """
    rows = batch.rows
    outcome = batch.outcome
    reading = batch.reading
    strain = work.strain
    for row in members:
        arm = struct_at(batch.arm, rows.arm, row)
        command = commands[row]
        failed, _ = strain_from_rest(arm, rows.q[row], ROUND_OFF, strain, work.kinematics)
        outcome.status[row] = OK if failed < 0 else NO_STRAIN
        outcome.rejected[row] = 0
        rows.clock[row, 0] = 0.0
        work.inputs.clock[0] = 0.0
        copy(strain.xi, rows.xi[row])
        tension = actuator_tensions(arm, command, strain.xi, work.tendons)
        copy(tension, reading.tension[row])
        read(arm, batch.places, rows.q_dot[row], work, row, reading)
        rest_states(arm, command, work.inputs, strain, work.loads)
        copy(work.inputs.state, rows.state[row])


@kernel
def read_samples(arm, places, q, q_dot, members, work, reading, good):
    """Reads motions q, q_dot (samples, n) at the samples named in `members`.

    good (samples): whether there is a strain, sought from rest: what is read depends on q and q_dot
    alone. A sample without a strain keeps what stood in `reading`.
    """
    work.inputs.clock[0] = 0.0
    for i in members:
        failed, _ = strain_from_rest(arm, q[i], STEP_TOLERANCE, work.strain, work.kinematics)
        good[i] = failed < 0
        if good[i]:
            read(arm, places, q_dot[i], work, i, reading)


@kernel
def are_firm(arm, q, members, work, firm):
    """Tells whether coordinates have a firm strain, see parametrisation.

    firm (samples) of q (samples, n), for the samples named in `members`.
    """
    for i in members:
        firm[i] = strain_has_margin(arm, q[i], STEP_TOLERANCE, work.strain, work.kinematics)


@kernel
def read_backbones(arm, places, xi, kinematics, out):
    """Poses out (samples, stations, 4, 4) of strain fields xi (samples, points x 6).

    They start from kinematics.base; out holds identities to begin with.
    """
    length = arm.rod.length
    stations = places.station
    distances = places.station_distance
    for i in range(xi.shape[0]):
        field = xi[i]
        poses(arm.rod, kinematics.base, field, kinematics)
        poses_inside(length, stations, distances, field, kinematics, out[i])
