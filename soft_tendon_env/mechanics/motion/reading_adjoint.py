"""Adjoint of what is read of an arm: cotangents of the tip's pose and twist, positions along the backbone, tendon lengths, strains and
their rates to those of its state.

A reading by coordinates has its transposed kinematics. By rates it has the same ones, and by coordinates besides the derivative of these
along the rates, by a difference: body Jacobian and strain columns are derivatives themselves, so that the order may be changed.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import coad_apply, twist_scaled
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.motion.force_gradient import TOLERANCE, largest_strain, place_beside
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.terms.kinematics import poses, tip_twist
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_at,
    add_station_forces,
    add_strain_stress,
    add_tendon_stress,
    add_wrench_stress,
    stress_force,
)

SMALL_WAY = 1e-4  # the largest strain, curvatures times the length, of differences along the rates


@kernel
def read_adjoint(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates and rates those of what is read at the end of the period; a status."""
    last = tape.q.shape[1] - 1
    q, q_dot, own = tape.q[row, last], tape.q_dot[row, last], memory.gradient
    copy(tape.xi[row, last], work.xi)
    work.clock[0] = tape.clock[row, last]
    place_base(arm, work)
    if strain_from_guess(arm, q, TOLERANCE, work) >= 0:
        return NO_STRAIN
    strain_columns(arm, memory.still, q, q_dot, work)
    poses(arm.rod, work)
    copy(work.xi, own.xi)
    copy(work.xi_dot, own.rate)
    twist, strain_rate = cotangents.tip_twist[row], cotangents.strain_rate[row]
    has_rates = twist.any() or strain_rate.any()
    pull = cotangents.backbone_position[row]
    read_force(arm, places, cotangents.tip_pose[row], pull, cotangents.strain[row], work, own)
    add_tendon_stress(arm.rod, arm.tendons, cotangents.tendon_length[row], work.tangent, own.field)
    if has_rates:  # the twist in the frame of the tip changes as that is turned
        turned = coad_apply(tip_twist(arm.rod, work), as_wrench(twist))
        own.wrench[:] = 0.0
        add_at(own.wrench, own.wrench.size - 5 * LANES - 1, twist_scaled(-1.0, turned))
        add_wrench_stress(arm.rod, own.wrench, work, own.field)
    stress_force(arm.rod, arm.strain, work, own.field, own.middle)
    for i in range(q.size):
        cotangents.q[row, i] += own.middle[i]
    if not has_rates:
        return OK
    read_force(arm, places, twist, pull[:0], strain_rate, work, own)
    stress_force(arm.rod, arm.strain, work, own.field, own.middle)
    for i in range(q.size):
        cotangents.q_dot[row, i] += own.middle[i]
    differ_reading(arm, places, tape, cotangents, row, work, memory)
    return OK


@kernel(inline=True)
def as_wrench(x):
    """Numbers (6,) as a wrench."""
    return (x[0], x[1], x[2]), (x[3], x[4], x[5])


@kernel
def read_force(arm, places, wrench, pull, force, work, own):
    """Stress into own.field that does the work of a wrench (6) on the tip, of `pull` (stations, 3), or (0, 3), on the positions of the
    stations, and of `force` (sensors, 6) on the strains at the sensors."""
    own.wrench[:] = 0.0
    own.field[:] = 0.0
    add_at(own.wrench, own.wrench.size - 5 * LANES - 1, as_wrench(wrench))
    if pull.shape[0] > 0:
        add_station_forces(arm.rod.length, places.station, places.station_distance, pull, work, own.wrench, own.field)
    add_wrench_stress(arm.rod, own.wrench, work, own.field)
    add_strain_stress(arm.rod.length, places.sensor, places.sensor_distance, force, own.field)


@kernel
def differ_reading(arm, places, tape, cotangents, row, work, memory):
    """Adds to the cotangents of a row's coordinates those that rates of tip and sensors have: a derivative along the rates."""
    wrench, force, out, last = cotangents.tip_twist[row], cotangents.strain_rate[row], cotangents.q[row], tape.q.shape[1] - 1
    q, q_dot = tape.q[row, last], tape.q_dot[row, last]
    own, strained = memory.gradient, largest_strain(arm.rod, memory.gradient.rate)
    if not strained > 0.0:
        return
    time = SMALL_WAY / strained
    for i in range(2):
        way = time if i == 0 else -time
        if not place_beside(arm, memory.still, q, q_dot, way, own.rate, work, own):
            return
        read_force(arm, places, wrench, cotangents.backbone_position[row, :0], force, work, own)
        stress_force(arm.rod, arm.strain, work, own.field, own.sides[i])
    for j in range(q.size):
        out[j] += (own.sides[0, j] - own.sides[1, j]) / (2.0 * time)
