"""One evaluation of the equations of motion, phase by phase, and the time steps built on it."""

from numba.extending import overload

from soft_tendon_env.compilation import kernel
from soft_tendon_env.mechanics.dynamics import gram, inertial_wrench, node_rows, point_rows, project
from soft_tendon_env.mechanics.forces import apply_effects
from soft_tendon_env.mechanics.kinematics import poses, sweep
from soft_tendon_env.mechanics.strain import (
    explicit_columns,
    explicit_strain,
    solve_strain,
    solve_strain_from_rest,
    statics_bias,
    statics_columns,
    strain_tension,
)
from soft_tendon_env.mechanics.types import Explicit, StaticsBased


@kernel
def statics_stage(arm, u, q, q_dot, tolerance, work):
    """Strain, columns, bias, G, D and the drive G ([u; 0] - q) of the implicit strain (30)-(34)."""
    rod, tendons, strain = arm.rod, arm.tendons, arm.strain
    strain_tension(strain, q, work.tau)
    strain_tension(strain, q_dot, work.tau_dot)
    failed = solve_strain(rod, tendons, strain, q, tolerance, work)
    if failed >= 0:
        return failed
    statics_columns(rod, tendons, strain, u, q, q_dot, work)
    statics_bias(rod, tendons, work)
    gram(work.Y, work.unit, point_rows(arm.rod), strain.first, strain.last, work.G)
    gram(work.Phi, rod.viscosity, point_rows(arm.rod), strain.first, strain.last, work.D)
    project(work.Y, work.mismatch, point_rows(arm.rod), strain.first, strain.last, work.drive)
    return -1


@kernel
def explicit_stage(arm, u, q, q_dot, tolerance, work):
    """The same for an explicit basis: xi is linear in q, its bias zero, D constant."""
    strain = arm.strain
    explicit_strain(arm.rod, strain, q, work)
    explicit_columns(arm.rod, arm.tendons, strain, u, q_dot, work)
    gram(work.Y, work.unit, point_rows(arm.rod), strain.first, strain.last, work.G)
    work.D[:] = strain.damping
    project(work.Phi, work.mismatch, point_rows(arm.rod), strain.first, strain.last, work.drive)
    return -1


def strain_stage(arm, u, q, q_dot, tolerance, work):
    """The stage of the arm's strain parametrisation; -1, or the block at which the strain could not be found."""
    stage = statics_stage if isinstance(arm.strain, StaticsBased) else explicit_stage
    return stage(arm, u, q, q_dot, tolerance, work)


@overload(strain_stage)
def _strain_stage_overload(arm, u, q, q_dot, tolerance, work):
    if arm[2].instance_class is Explicit:
        return lambda arm, u, q, q_dot, tolerance, work: explicit_stage(arm, u, q, q_dot, tolerance, work)
    return lambda arm, u, q, q_dot, tolerance, work: statics_stage(arm, u, q, q_dot, tolerance, work)


def strain_from_guess(arm, q, tolerance, work):
    """The strain at q from the guess in work.xi; -1, or the block at which it could not be found."""
    if isinstance(arm.strain, StaticsBased):
        strain_tension(arm.strain, q, work.tau)
        return solve_strain(arm.rod, arm.tendons, arm.strain, q, tolerance, work)
    return _explicit_from_rest(arm, q, work)[0]


@overload(strain_from_guess)
def _strain_from_guess_overload(arm, q, tolerance, work):
    if arm[2].instance_class is Explicit:
        return lambda arm, q, tolerance, work: _explicit_from_rest(arm, q, work)[0]

    def statics(arm, q, tolerance, work):
        strain_tension(arm.strain, q, work.tau)
        return solve_strain(arm.rod, arm.tendons, arm.strain, q, tolerance, work)

    return statics


def strain_from_rest(arm, q, tolerance, work):
    """The strain at q into work.xi with no guess; (-1, 1.0), or (block, part of q that was reached)."""
    if isinstance(arm.strain, StaticsBased):
        return solve_strain_from_rest(arm.rod, arm.tendons, arm.strain, q, tolerance, work)
    return _explicit_from_rest(arm, q, work)


@kernel
def _explicit_from_rest(arm, q, work):
    explicit_strain(arm.rod, arm.strain, q, work)
    return -1, 1.0


@overload(strain_from_rest)
def _strain_from_rest_overload(arm, q, tolerance, work):
    if arm[2].instance_class is Explicit:
        return lambda arm, q, tolerance, work: _explicit_from_rest(arm, q, work)
    return lambda arm, q, tolerance, work: solve_strain_from_rest(arm.rod, arm.tendons, arm.strain, q, tolerance, work)


@kernel
def configure(arm, q, tolerance, work):
    """Strain and poses at q with no guess; as strain_from_rest()."""
    found = strain_from_rest(arm, q, tolerance, work)
    poses(arm.rod, work)
    return found


@kernel
def projected_effects(arm, work):
    """F, the projection of the wrenches of all effects (24)."""
    work.wrench[:] = 0.0
    apply_effects(arm.effects, arm.rod, work)
    project(work.J, work.wrench, node_rows(), arm.strain.first, arm.strain.tip, work.load)


def external_force(arm, work):
    """F into work.load; without effects it stays the zero that it is."""
    if len(arm.effects):
        projected_effects(arm, work)


@overload(external_force)
def _external_force_overload(arm, work):
    if len(arm[3]):
        return lambda arm, work: projected_effects(arm, work)
    return lambda arm, work: None


@kernel
def evaluate(arm, u, q, q_dot, tolerance, work):
    """Everything in (23) at (q, q_dot, u), left in `work`; -1, or the block at which the strain could not be found."""
    failed = strain_stage(arm, u, q, q_dot, tolerance, work)
    if failed >= 0:
        return failed
    strain = arm.strain
    poses(arm.rod, work)
    sweep(arm.rod, strain, work)
    gram(work.J, arm.rod.inertia, node_rows(), strain.first, strain.tip, work.M)
    inertial_wrench(arm.rod, work)
    project(work.J, work.wrench, node_rows(), strain.first, strain.tip, work.bias)
    external_force(arm, work)
    return -1
