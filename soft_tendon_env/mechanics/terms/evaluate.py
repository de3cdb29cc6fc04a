"""Equation of motion (23) at one state, phase by phase: strains, poses, mass matrix, bias, external force."""

from numba.extending import overload

from soft_tendon_env.mechanics.terms import explicit, loaded, statics_based  # noqa: F401  (they register themselves)
from soft_tendon_env.mechanics.terms.dynamics import bias_force, mass_matrix, node_rows, project
from soft_tendon_env.mechanics.terms.kinematics import poses, sweep
from soft_tendon_env.mechanics.terms.loads import apply_effects
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_from_rest, strain_stage
from soft_tendon_env.tools.compilation import kernel


@kernel
def configure(arm, q, tolerance, work):
    """Configuration of the rod at q: poses, and the strain that Newton finds from the stress-free rod or else strain_from_rest().

    A motion may come to coordinates whose parts have no strain, where tendons push.
    """
    work.xi[:] = arm.rod.reference_strain
    failed, reached = strain_from_guess(arm, q, tolerance, work), 1.0
    if failed >= 0:
        failed, reached = strain_from_rest(arm, q, tolerance, work)
    poses(arm.rod, work)
    return failed, reached


@kernel
def configure_from_rest(arm, q, tolerance, work):
    """Strain and poses at q on the branch that begins at the stress-free rod; as strain_from_rest()."""
    found = strain_from_rest(arm, q, tolerance, work)
    poses(arm.rod, work)
    return found


@kernel
def projected_effects(arm, work):
    """Generalised external force F, the projection of the wrenches of all effects (24), into work.load."""
    work.wrench[:] = 0.0
    apply_effects(arm.effects, arm.rod, work)
    project(work.J, work.wrench, node_rows(), arm.strain.first, arm.strain.tip, work.load)


def external_force(arm, work):
    """Generalised external force F into work.load; without effects it stays the zero that it is."""
    if len(arm.effects):
        projected_effects(arm, work)


@overload(external_force)
def _external_force_overload(arm, work):
    if len(arm[arm.fields.index("effects")]):
        return lambda arm, work: projected_effects(arm, work)
    return lambda arm, work: None


@kernel
def evaluate(arm, u, q, q_dot, tolerance, work):
    """All terms of (23) at (q, q_dot, u), left in `work`; -1, or the block at which the strain could not be found."""
    failed = strain_stage(arm, u, q, q_dot, tolerance, work)
    if failed >= 0:
        return failed
    strain = arm.strain
    poses(arm.rod, work)
    sweep(arm.rod, strain, work)
    mass_matrix(arm.rod, strain, work)
    bias_force(arm.rod, strain, work)
    external_force(arm, work)
    return -1
